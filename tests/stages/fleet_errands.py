"""What workers of a fleet do in tests; pytest's own modules cannot be imported there."""

import os

from trueup.core.close_result import CLOSE_NAME
from trueup.core.fleet_result import FleetUnit
from trueup.stages.fleet import _Outcome


def end_for_one(task):
    """The unit arm-2 kills its process, whenever it is tried; of the others nothing is asked."""
    if task.name == "arm-2":
        os._exit(9)
    (task.folder / CLOSE_NAME).write_text("{}")
    return _Outcome(FleetUnit(task.name, task.name, "measured"))
