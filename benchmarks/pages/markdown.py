"""Tables as Markdown."""

import re
from collections.abc import Iterable, Sequence


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> str:
    """The first columns to the left, numbers to the right."""
    rule = [*["---"] * left, *["---:"] * (len(heads) - left)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (heads, rule, *rows))


def with_section(text: str, content: str) -> str:
    """A page with another text in its section that has the same heading, up to the next one of that level.

    Raises:
        ValueError: it has no such section, or several.
    """
    heading = content.strip().splitlines()[0]
    level = heading.split()[0]
    section = re.compile(rf"^{re.escape(heading)}\n.*?(?=^{level} |\Z)", re.M | re.S)
    if len(section.findall(text)) != 1:
        raise ValueError(f"the page has no section {heading!r}")
    made: str = section.sub(lambda _: f"{content.strip()}\n\n", text)
    return made.rstrip() + "\n"


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


def with_items(text: str, before: str, items: Iterable[str]) -> str:
    """A page with other items in the list below this line.

    Raises:
        ValueError: it has no such list, or several.
    """
    listed = re.compile(rf"^{re.escape(before)}\n\n(- .*\n)+", re.M)
    if len(listed.findall(text)) != 1:
        raise ValueError(f"the page has no list below {before!r}")
    lines = "".join(f"- {item}\n" for item in items)
    return listed.sub(lambda _: f"{before}\n\n{lines}", text)
