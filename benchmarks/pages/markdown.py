"""Tables as Markdown."""

import re
from collections.abc import Iterable, Sequence


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> str:
    """The first columns to the left, numbers to the right."""
    rule = [*["---"] * left, *["---:"] * (len(heads) - left)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (heads, rule, *rows))


def with_rows(text: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A page with other rows in its one table with these heads.

    Raises:
        ValueError: it has no such table, or several.
    """
    lines = [f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads))]
    lines += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    table = re.compile(rf"^{re.escape(lines[0])}\n(\|.*\n)+", re.M)
    if len(table.findall(text)) != 1:
        raise ValueError(f"the page has no table {lines[0]}")
    return table.sub(lambda _: "\n".join(lines) + "\n", text)


def with_section(text: str, heading: str, content: str) -> str:
    """A page with this under a heading of the second level; at the end, if it has no such heading yet."""
    made = f"## {heading}\n\n{content}"
    found = re.compile(rf"^## {re.escape(heading)}\n.*?(?=^## |\Z)", re.M | re.S)
    if not found.search(text):
        return f"{text.rstrip()}\n\n{made}"
    return found.sub(lambda match: made if match.end() == len(text) else f"{made}\n", text, count=1)
