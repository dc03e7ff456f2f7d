"""Tables as Markdown."""

import re
from collections.abc import Iterable, Sequence


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> str:
    """The first columns to the left, numbers to the right."""
    rule = [*["---"] * left, *["---:"] * (len(heads) - left)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (heads, rule, *rows))


def with_part(text: str, name: str, content: str) -> str:
    """A page with another text between its lines `<!-- made: NAME -->` and `<!-- /made: NAME -->`.

    Raises:
        ValueError: it has no such lines, or several.
    """
    begin, end = f"<!-- made: {name} -->\n", f"<!-- /made: {name} -->\n"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ValueError(f"the page has no place for {name}")
    before, rest = text.split(begin)
    return f"{before}{begin}{content.strip()}\n{end}{rest.split(end)[1]}"


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
