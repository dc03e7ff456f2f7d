"""A close that takes seconds."""

from dataclasses import replace

from trueup.identify import IdentifyConfig
from trueup.identify.config import DataChoice, SolverChoice
from trueup.robots import load_robot
from trueup.stages import close

ROBOT = load_robot("demo_arm")
# Two quantities, little motion: a fit of seconds.
QUICK = IdentifyConfig(
    fit={"delay_s": "all", "kp": "all"},
    data=DataChoice(budget_s=6.0),
    solver=SolverChoice(max_iterations=4),
)
OTHER = replace(QUICK, data=DataChoice(budget_s=7.0))
METHODS = ("moving-average",)


def quick(data, out, **options):
    return close(data, ROBOT, out, **{"config": QUICK, "methods": METHODS, "jobs": 2, **options})


def files_in(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
