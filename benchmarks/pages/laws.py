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
        name: of((DOCS / name).read_text())
        for name, of in (("friction.md", _laws), ("identification-reference.md", _fitted))
    }


def _laws(text: str) -> str:
    laws = [(name.replace("_", " "), _effect(law), law.source) for name, law in LAWS.items()]
    text = with_rows(text, ("law", "torque or effect", "from"), laws)
    numbers = [(f"`{own.name}`", str(own.default), f"{own.label} [{own.unit}]") for own in NUMBERS]
    return with_rows(text, ("number", "default", "meaning"), numbers)


def _fitted(text: str) -> str:
    """Some rows of the table of everything that can be fitted; numbers of one unit and scale share a row."""
    alike: dict[tuple[str, str], list[str]] = {}
    for own in NUMBERS:
        if own.excite:
            alike.setdefault((own.unit, own.search.transform), []).append(f"`{own.name}`")
    rows = [
        f"| {', '.join(names)} | {unit} | joint | {scale} | friction | `user` |\n"
        for (unit, scale), names in alike.items()
    ]
    return re.sub(r"(^\|.*\| `user` \|\n)+", "".join(rows), text, count=1, flags=re.M)


def _effect(law: Law) -> str:
    if law.brake is None:
        return law.formula
    held = law.brake(0.0, 1.0, 1.0, [1.0] * len(law.numbers))
    formula = re.sub(r" ([*/+]) ", r"\1", law.formula)
    return f"`{formula}`, {'holds' if held else 'zero'} at rest"
