"""Tables of the friction laws, in pages that are otherwise written by hand."""

import re
from pathlib import Path

from trueup.robots.friction import LAWS, NUMBERS, Law

DOCS = Path(__file__).resolve().parents[2] / "docs"


def with_tables(page: str, text: str) -> str:
    """The text of a page of docs/ with its tables as the laws are."""
    if page == "friction":
        brakes = {name: law for name, law in LAWS.items() if law.brake}
        others = {name: law for name, law in LAWS.items() if not law.brake}
        text = _replaced(text, "| law | torque |", [_row(name, law, _at_rest(law)) for name, law in brakes.items()])
        text = _replaced(
            text, "| law | what it does |", [_row(name, law, law.drive or "any joint") for name, law in others.items()]
        )
        numbers = [f"| `{own.name}` | {own.unit} | {own.default} | {own.label} |" for own in NUMBERS]
        return _replaced(text, "| number | unit | default |", numbers)
    fitted = [own for own in NUMBERS if own.excite]
    rows = [
        f"| `{own.name}` | {own.unit} | joint | {own.search.transform} | friction | the joint's `user` |"
        for own in fitted
    ]
    return re.sub(r"(^\|.*\| the joint's `user` \|\n)+", "\n".join(rows) + "\n", text, count=1, flags=re.M)


def _row(name: str, law: Law, note: str) -> str:
    formula = law.formula.replace("|", r"\|")
    return f"| {name.replace('_', ' ')} | {f'`{formula}`' if law.brake else formula} | {note} | {law.source} |"


def _at_rest(law: Law) -> str:
    held = law.brake is not None and law.brake(0.0, 1.0, 1.0, [1.0] * len(law.numbers))
    return "holds" if held else "zero"


def _replaced(text: str, header: str, rows: list[str]) -> str:
    """The text with other rows in the table whose header begins like this."""
    before, found, after = text.partition(f"\n{header}")
    assert found, header
    head, line, rest = after.split("\n", 2)
    kept = re.sub(r"\A(\|.*\n)+", "", rest)
    return "\n".join([before + found + head, line, *rows, kept])


def main() -> None:
    """Write the tables."""
    for page in ("friction", "identification"):
        path = DOCS / f"{page}.md"
        path.write_text(with_tables(page, path.read_text()))
