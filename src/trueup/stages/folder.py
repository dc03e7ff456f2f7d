"""A folder of results: what an earlier command has left must not stand in a report as if it belonged to a new one."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json, remove
from trueup.core.fit_result import FIT_CONFIG, STOCK_ROBOT, FitResult
from trueup.errors import OutputExists

# State of the searches of a fit; gone when everything is written.
CHECKPOINTS = "checkpoints"
_ORIGIN = ("config", "data_hash", "seed")
_FIT_FILES = (
    *("fit.json", "graybox.json", "fit.samples.npz"),
    *("model.fitted.xml", "robot.fitted.yaml", "isaac.actuators.yaml", STOCK_ROBOT, FIT_CONFIG),
)


def forget_explanation(folder: Path, *, unless_of: str | None = None) -> None:
    """Remove the attribution of a measurement that is replaced; `unless_of` is the hash of a dataset whose stays."""
    path = folder / "explain.json"
    if path.is_file() and (unless_of is None or provenance_of(path).get("data_hash") != unless_of):
        path.unlink()


def forget_fit(folder: Path) -> None:
    """Remove what an identification left, the state of its searches included.

    Raises:
        DataError: something that is called like it cannot be removed.
    """
    for name in _FIT_FILES:
        remove(folder / name)
    shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)


def forget_other_ladder(folder: Path) -> None:
    """Remove a ladder that quotes another measurement than the one in the folder."""
    ladder, gap = folder / "ladder.json", folder / "gap.json"
    if ladder.is_file():
        origins = [provenance_of(path) for path in (ladder, gap)]
        if any(origins[0].get(key) != origins[1].get(key) for key in _ORIGIN):
            ladder.unlink()


def refuse_other_fit(folder: Path, data_hash: str) -> None:
    """Refuse a folder with the fit of another dataset: it took long, and would be shown as one of this data.

    Raises:
        OutputExists: there is one.
    """
    path = folder / "fit.json"
    if path.is_file() and FitResult.load(path).provenance.get("data_hash") != data_hash:
        raise OutputExists(f"{folder} holds the fit of another dataset (fit.json)", hint="Choose another --out.")


def provenance_of(path: Path) -> dict[str, Any]:
    """Where a result comes from; of a file that is none, nothing is known."""
    tree = read_json(path)
    found = tree.get("provenance") if isinstance(tree, dict) else None
    return found if isinstance(found, dict) else {}
