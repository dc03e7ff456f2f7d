"""Tables of the friction laws and of all that can be fitted, in pages that are otherwise written by hand."""

import re
from collections.abc import Mapping
from pathlib import Path

from benchmarks.pages.markdown import with_rows
from trueup.identify import QUANTITIES
from trueup.robots.friction import LAWS, NUMBERS, Law

DOCS = Path(__file__).resolve().parents[2] / "docs"


def pages() -> Mapping[str, str]:
    """Page -> its text with its tables as the laws are."""
    return {
        name: of((DOCS / name).read_text())
        for name, of in (("friction.md", _laws), ("identification-reference.md", _fitted))
    }


def _laws(text: str) -> str:
    laws = [(name.replace("_", " "), _effect(law), law.source) for name, law in LAWS.items()]
    text = with_rows(text, ("law", "torque or effect", "from"), laws)
    numbers = [(f"`{own.name}`", str(own.default), f"{own.label} [{own.unit}]") for own in NUMBERS]
    return with_rows(text, ("number", "default", "meaning"), numbers)


def _fitted(text: str) -> str:
    """The table of everything that can be fitted; what is alike shares a row."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, item in QUANTITIES.items():
        alike.setdefault((item.of, item.search.transform, item.cause), []).append(f"`{name}` [{item.unit}]")
    rows = [(", ".join(names), *columns) for columns, names in alike.items()]
    return with_rows(text, ("quantity", "one per", "scale", "cause"), rows)


def _effect(law: Law) -> str:
    if law.brake is None:
        return law.formula
    held = law.brake(0.0, 1.0, 1.0, [1.0] * len(law.numbers))
    formula = re.sub(r" ([*/+]) ", r"\1", law.formula)
    return f"`{formula}`, {'holds' if held else 'zero'} at rest"
