"""The commands of the pages, read from their text: fenced blocks, lines, what is shown below them."""

import re
import shlex
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
PAGES = {path.stem: path for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))}
TEXT = {page: path.read_text() for page, path in PAGES.items()}
BLOCK = re.compile(
    r"(?:^<!-- (?P<what>run|file)(?:: (?P<value>[^>]+?))? -->\n)?^```(?P<kind>\w*)\n(?P<body>.*?)^```$", re.M | re.S
)
SHELL = ("sh", "console")


@dataclass(frozen=True)
class Block:
    """A fenced block: its page and first line there, its language and text, what the comment before it asks for."""

    page: str
    number: int
    kind: str
    body: str
    what: str = ""
    value: str = ""

    @property
    def first(self):
        """What it begins with, by which tables name it."""
        return next(line for line in self.body.splitlines() if line)

    def __str__(self):
        return f"{PAGES[self.page].name}:{self.number}"


@dataclass(frozen=True)
class Line:
    """A command: where it stands, its words, the code that it ends with as the page says, and what is shown of it."""

    page: str
    number: int
    words: tuple[str, ...]
    code: int = 0
    shown: tuple[str, ...] = ()

    @property
    def killed(self):
        """Whether the page has it killed on its way."""
        return self.shown == ("Killed",)

    def begins(self, words):
        """Whether it begins with these, after the name of the program."""
        return f"{' '.join(self.words)} ".startswith(f"trueup {words} ")

    def option(self, name):
        """What is given for an option; None if it is not given."""
        return self.words[self.words.index(name) + 1] if name in self.words else None

    def __str__(self):
        return f"{PAGES[self.page].name}:{self.number}: {' '.join(self.words)}"


def blocks_of(page):
    """All fenced blocks of a page, in order."""
    text = TEXT[page]
    return [
        Block(
            page,
            text[: found.start("body")].count("\n") + 1,
            *(found[key] or "" for key in ("kind", "body", "what", "value")),
        )
        for found in BLOCK.finditer(text)
    ]


def lines_of(block):
    """The commands of a shell block; its variables stand for their values, as in a shell."""
    found, variables = [], {}
    for number, text, shown in _commands(block):
        for name, value in variables.items():
            text = re.sub(rf"\${name}\b", value, text)
        words = tuple(shlex.split(text, comments=True))
        if assigned := re.fullmatch(r"([A-Z]\w*)=(.*)", " ".join(words)):
            variables[assigned[1]] = assigned[2]
        elif words == ("echo", "$?"):
            last = found.pop()
            found.append(Line(last.page, last.number, last.words, int(shown[0]), last.shown))
        elif words:
            refused = any(line.startswith("error: ") for line in shown)
            found.append(Line(block.page, number, words, 2 if refused else 0, tuple(shown)))
    return found


def _commands(block):
    """Number, text and output of each command, lines that end in a backslash joined with the next."""
    rows = [[number, line] for number, line in enumerate(block.body.splitlines(), start=block.number)]
    for row, after in reversed(list(pairwise(rows))):
        if row[1].endswith("\\"):
            row[1], after[1] = row[1][:-1] + after[1], ""
    if block.kind == "sh":
        return [(number, line, []) for number, line in rows if line]
    found = []
    for number, line in rows:
        if line.startswith("$ "):
            found.append((number, line.removeprefix("$ "), []))
        elif found and line:
            found[-1][2].append(line)
    return found


def lines(page, *firsts):
    """The commands of a page that no comment marks, with one of these first words if given."""
    return [
        line
        for block in blocks_of(page)
        if block.kind in SHELL and not block.what
        for line in lines_of(block)
        if not firsts or line.words[0] in firsts
    ]
