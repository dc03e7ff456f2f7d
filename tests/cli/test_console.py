"""What is printed: names and paths may hold control characters, and a terminal must not obey them."""

import io

import pytest
from rich.table import Table
from rich.text import Text

from trueup.cli import console

HOSTILE = "arm\x1b[2J\x07\x9b2J\u202e\r"


@pytest.fixture
def said():
    """What `out` writes, to a terminal and to a file."""

    def said(*objects, terminal, **options):
        file = io.StringIO()
        made = type(console.out)(file=file, force_terminal=terminal, highlight=False, soft_wrap=True, width=80)
        made.print(*objects, **options)
        return file.getvalue()

    return said


def table():
    made = Table(title=HOSTILE)
    made.add_column(HOSTILE)
    made.add_row(HOSTILE)
    made.add_row(Text(HOSTILE))
    return made


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("what", [lambda: HOSTILE, lambda: Text(HOSTILE), table], ids=["words", "text", "table"])
def test_no_control_character_comes_through(said, what, terminal):
    shown = said(what(), terminal=terminal, markup=False)
    assert "arm" in shown
    for character in ("\x1b[2J", "\x07", "\x9b", "\u202e", "\r"):
        assert character not in shown
    assert "\ufffd" in shown


def test_what_is_printed_otherwise_is_as_it_was(said):
    assert said("a line\nand [bold]another[/bold]", 3, terminal=False) == "a line\nand another 3\n"
    assert said("[bold]b[/bold]", terminal=True) == "\x1b[1mb\x1b[0m\n"
    assert said("[b] é 日本", terminal=False, markup=False) == "[b] é 日本\n"


def test_messages_go_the_same_way(capsys):
    console.problem(f"no {HOSTILE}", f"try {HOSTILE}")
    console.note(HOSTILE)
    assert "\x1b[2J" not in capsys.readouterr().err
