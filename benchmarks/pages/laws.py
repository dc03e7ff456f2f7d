"""Tables of the friction laws, in pages that are otherwise written by hand."""

import re
from collections.abc import Mapping
from pathlib import Path

from benchmarks.pages.markdown import with_rows
from trueup.robots.friction import LAWS, NUMBERS, Law

DOCS = Path(__file__).resolve().parents[2] / "docs"


def pages() -> Mapping[str, str]:
    """Page -> its text with its tables as the laws are."""
    return {
        name: of((DOCS / name).read_text()) for name, of in (("friction.md", _laws), ("identification.md", _fitted))
    }


def _laws(text: str) -> str:
    brakes = [_row(name, law, f"`{law.formula}`", _at_rest(law)) for name, law in LAWS.items() if law.brake]
    others = [_row(name, law, law.formula, law.drive or "any joint") for name, law in LAWS.items() if not law.brake]
    text = with_rows(text, ("law", "torque", "at rest", "from"), brakes)
    text = with_rows(text, ("law", "what it does", "of", "from"), others)
    numbers = [(f"`{own.name}`", own.unit, str(own.default), own.label) for own in NUMBERS]
    return with_rows(text, ("number", "unit", "default", "meaning"), numbers)


def _fitted(text: str) -> str:
    """Some rows of the table of everything that can be fitted."""
    rows = [
        f"| `{own.name}` | {own.unit} | joint | {own.search.transform} | friction | the joint's `user` |\n"
        for own in NUMBERS
        if own.excite
    ]
    return re.sub(r"(^\|.*\| the joint's `user` \|\n)+", "".join(rows), text, count=1, flags=re.M)


def _row(name: str, law: Law, formula: str, note: str) -> tuple[str, ...]:
    return name.replace("_", " "), formula, note, law.source


def _at_rest(law: Law) -> str:
    held = law.brake is not None and law.brake(0.0, 1.0, 1.0, [1.0] * len(law.numbers))
    return "holds" if held else "zero"
