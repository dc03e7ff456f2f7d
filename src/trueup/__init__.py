"""True up your simulator to your robot: measure, explain and close the sim-to-real gap from its logs.

    import trueup

    data = trueup.import_logs("logs/", "data/arm")
    closed = trueup.close("data/arm", trueup.load_robot("so101"), "runs/first")

Names are loaded when they are first used, so that `import trueup` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trueup.dataset import Dataset as Dataset
    from trueup.report import write_report as write_report
    from trueup.robots import load_robot as load_robot
    from trueup.stages import check_setup as check_setup
    from trueup.stages import close as close
    from trueup.stages import demo_dataset as demo_dataset
    from trueup.stages import fit as fit
    from trueup.stages import gap as gap
    from trueup.stages import import_logs as import_logs
    from trueup.stages import replay as replay

_WHERE = {
    "Dataset": "trueup.dataset",
    "check_setup": "trueup.stages",
    "close": "trueup.stages",
    "demo_dataset": "trueup.stages",
    "fit": "trueup.stages",
    "gap": "trueup.stages",
    "import_logs": "trueup.stages",
    "load_robot": "trueup.robots",
    "replay": "trueup.stages",
    "write_report": "trueup.report",
}

__all__ = [
    "Dataset",
    "check_setup",
    "close",
    "demo_dataset",
    "fit",
    "gap",
    "import_logs",
    "load_robot",
    "replay",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in _WHERE:
        raise AttributeError(f"module 'trueup' has no attribute {name!r}")
    return getattr(import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    """The public names, and what every module has."""
    return sorted({*globals(), *__all__})
