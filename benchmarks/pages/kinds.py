"""Tables of the docs that list what there is: formats, metrics, methods, quantities, from the tables in the code."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from benchmarks.pages.markdown import with_items, with_rows
from trueup.augment.networks import METHODS, method
from trueup.dataset.importers.detect import FORMATS, importer
from trueup.identify import QUANTITIES
from trueup.measure import METRICS

DOCS = Path(__file__).resolve().parents[2] / "docs"
_BETTER = {True: "", False: " ↑", None: " 0"}
_UNITS = {"signal^2": "signal²", "signal/s^2": "signal/s²"}


def pages() -> Mapping[str, str]:
    """Page -> its text with its table as the code has it."""
    return {
        "logs.md": _with_table("logs.md", ("name", "looks for", "one episode is", "what is assumed"), _formats()),
        "metrics.md": _with_table("metrics.md", ("name", "formula", "unit", "signals"), _metrics()),
        "good-data.md": with_items(
            (DOCS / "good-data.md").read_text(), "To find a number, move the joint or body like this:", _motions()
        ),
        "augmentation.md": _with_table("augmentation.md", ("method", "what it is"), _methods()),
    }


def _formats() -> Iterable[Sequence[str]]:
    for name in FORMATS:
        module = importer(name)
        yield f"`{name}`", module.LOOKS_FOR, module.EPISODE, module.ASSUMES


def _metrics() -> Iterable[Sequence[str]]:
    for name, item in METRICS.items():
        signals = item.kind if item.kind != "joint" else ", ".join(item.signals) or "all"
        unit, better = _UNITS.get(item.unit, item.unit), _BETTER[item.lower_is_better]
        yield f"`{name}`{better}", item.description, unit, signals


def _methods() -> Iterable[Sequence[str]]:
    for name in METHODS:
        yield f"`{name}`", method(name).about


def _motions() -> Iterable[str]:
    """What shows a quantity, in the words in which a fit asks for it."""
    by_motion: dict[str, list[str]] = {}
    for name, item in QUANTITIES.items():
        by_motion.setdefault(item.excite.format(target="it"), []).append(f"`{name}`")
    for motion, names in by_motion.items():
        yield f"{', '.join(names)}: {motion}"


def _with_table(page: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return with_rows((DOCS / page).read_text(), heads, rows)
