"""docs/options.md: every command with its arguments and options, from the help that it prints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from typer.main import get_command

from trueup.cli.main import app

TEXT = """# Commands and options

The help that `trueup COMMAND --help` prints, of all commands. What several have in common comes first.

## Options of several commands

{shared}

{commands}
"""
# What so many commands explain in the same words is explained once.
_SHARED_BY = 3


def pages() -> dict[str, str]:
    """The page, from the command line."""
    commands = dict(_commands(get_command(app)))
    counts = Counter(line for command in commands.values() for line in _lines(command))
    usual = {line.partition(":")[0]: line for line, _ in reversed(counts.most_common())}  # one for each name
    shared = [line for line in usual.values() if counts[line] >= _SHARED_BY]
    sections = [_section(words, command, shared) for words, command in commands.items()]
    return {"options.md": TEXT.format(shared="\n".join(sorted(shared)), commands="\n\n".join(sections))}


def _commands(group: Any, *names: str) -> Iterator[tuple[str, Any]]:
    for name, command in sorted(getattr(group, "commands", {}).items()):
        if hasattr(command, "commands"):
            yield from _commands(command, *names, name)
        else:
            yield " ".join(("trueup", *names, name)), command


def _section(words: str, command: Any, shared: list[str]) -> str:
    about = " ".join((command.help or "").split("\n\n")[0].split())
    lines = list(_lines(command))
    own = [line for line in lines if line not in shared]
    also = ", ".join(line.removeprefix("- ").partition(": ")[0] for line in lines if line in shared)
    parts = [f"## {words}", about, "\n".join(own), f"Also {also}." if also else ""]
    return "\n\n".join(filter(None, parts))


def _lines(command: Any) -> Iterator[str]:
    """`- NAME: what it is`, of each argument and option."""
    for parameter in command.params:
        if getattr(parameter, "hidden", False):
            continue
        names = [name for name in parameter.opts if name.startswith("-")] or [(parameter.name or "").upper()]
        said, default = getattr(parameter, "help", "") or "", parameter.default
        given = default is not None and default != () and not callable(default)
        if given and not getattr(parameter, "is_flag", False) and "efault" not in said:
            said = f"{said} Default: `{getattr(default, 'value', default)}`."
        yield f"- {', '.join(f'`{name}`' for name in names)}: {said}"
