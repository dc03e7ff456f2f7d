"""The `trueup` command: parser, error handling, exit codes."""

from __future__ import annotations

import errno
import functools
import os
import re
import sys
import traceback
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Annotated, Any

import typer
from typer.main import get_command

from trueup.cli import (
    augment,
    check,
    close,
    compensate,
    convert,
    demo,
    deploy,
    design,
    doctor,
    experiment,
    fleet,
    gap,
    identify,
    info,
    init,
    payload,
    policy,
    record,
    replay,
    report,
    selftest,
    torque,
)
from trueup.cli.console import note, out, problem, volume
from trueup.core.workers import wait_briefly
from trueup.errors import TrueupError, how_to_install, meant

app = typer.Typer(
    name="trueup",
    help="Measure, explain and close the sim-to-real gap of a robot from its logs. For every command: --quiet prints "
    "results, warnings and errors only, --verbose all notes, --json the result as JSON, --debug tracebacks of errors.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for module in (
    info,
    init,
    convert,
    record,
    replay,
    gap,
    check,
    identify,
    payload,
    selftest,
    torque,
    augment,
    compensate,
    policy,
    deploy,
    design,
    experiment,
    report,
    close,
    fleet,
    demo,
    doctor,
):
    module.register(app)


# Flags of all commands, wherever they stand.
_EVERYWHERE = ("--debug", "--quiet", "--verbose", "--json")
# Letters of a file's name that are shown.
_NAME = 200
# What MuJoCo draws with, which it looks at when it is loaded, if only to compute.
_WINDOWS = "MUJOCO_GL"
# What pathlib says of links that lead to themselves, before Python 3.13.
_LOOP = "Symlink loop"
_INTERRUPTED = 130  # typer's code for Ctrl-C, too
# What to do about what the machine refuses.
_REMEDIES = {
    errno.ENAMETOOLONG: "Give a shorter name.",
    errno.ENOTDIR: "A part of this path is a file and no folder: give another path.",
    errno.ELOOP: "This path is a link that leads to itself: give another one.",
    errno.EEXIST: "Give another name.",
    errno.ENOENT: "Look whether the path is right.",
    errno.EISDIR: "It is a folder: give a file.",
    errno.EACCES: "Give a path that you may read and write.",
    errno.EPERM: "Give a path that you may read and write.",
    errno.EROFS: "Give a path that you may read and write.",
    errno.ENOSPC: "Make room on this disk, or give a path on another one.",
    errno.EDQUOT: "Make room on this disk, or give a path on another one.",
    errno.EMFILE: "Allow more open files (`ulimit -n`), or give fewer --jobs.",
    errno.ENOMEM: "Give fewer --jobs, or less data.",
}


@app.callback(invoke_without_command=True)
def version(
    show: Annotated[bool, typer.Option("--version", help="Show the version.", is_eager=True)] = False,
) -> None:
    """Answer `trueup --version`; everything else is done by the commands."""
    if show:
        out.print(f"trueup {metadata.version('trueup')}")
        raise typer.Exit


@functools.cache
def _command() -> Callable[..., Any]:
    """The parser of all commands: to build it takes longer than to use it, which tests do by the thousand."""
    return get_command(app)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code.

    0: done; 1: a bug in trueup; 2: bad input; 3: a bar was not met or nothing could be identified; 130: Ctrl-C.
    """
    try:
        _run(list(sys.argv[1:] if argv is None else argv))
    finally:  # what else this process prints has no flags
        volume.set(quiet=False, verbose=False, json=False)


def _run(arguments: list[str]) -> None:
    """One command, until `SystemExit`."""
    wait_briefly()
    debug, quiet, verbose, as_json = (flag in arguments for flag in _EVERYWHERE)
    volume.set(quiet=quiet, verbose=verbose, json=as_json)
    arguments = [argument for argument in arguments if argument not in _EVERYWHERE] or ["--help"]
    try:
        # typer returns the code of typer.Exit when it does not handle exits by itself
        code = _command()(arguments, standalone_mode=False, prog_name="trueup")
    except TrueupError as error:
        if debug:
            raise
        problem(f"{error.what}: {error.details}" if error.details else error.what, error.hint)
        code = error.exit_code
    except (typer.Abort, KeyboardInterrupt):
        code = _INTERRUPTED
    except BrokenPipeError:
        code = 0  # the reader, e.g. head, has seen enough
    except MemoryError as error:
        if debug:
            raise
        problem(f"this machine has too little memory: got {str(error) or 'no room'}", _REMEDIES[errno.ENOMEM])
        code = 2
    except OSError as error:
        if debug:
            raise
        # What the machine refuses (names that are too long, disks, rights) is none of ours.
        named = "" if error.filename is None else f" {str(error.filename)[:_NAME]!r}"
        problem(
            f"this machine refuses{named}: got {error.strerror or error}",
            _REMEDIES.get(error.errno or 0, "Try another path or machine; --debug shows where it was refused."),
        )
        code = 2
    except Exception as error:
        # Usage errors of typer and click share no public base class, but only they can format themselves.
        if hasattr(error, "format_message"):
            raise SystemExit(_misused(error)) from None
        if debug:
            raise
        extra = _extra_of(error)
        if isinstance(error, RuntimeError) and str(error).startswith(_LOOP):
            problem(f"this machine refuses a path: got {error}", _REMEDIES[errno.ELOOP])
            raise SystemExit(2) from None
        if _WINDOWS in str(error) or _is_of_windows(error):
            said = os.environ.get(_WINDOWS, "")
            problem(
                f"MuJoCo cannot be loaded with {_WINDOWS}={said[:_NAME]}: got {error}",
                f"Unset {_WINDOWS}, or set it to one of egl, osmesa and glfw that is installed here.",
            )
            raise SystemExit(2) from None
        if extra is None:
            problem(
                f"this is a bug in trueup: {type(error).__name__}: {error}",
                "Run it again with --debug and report the traceback.",
            )
        else:
            problem(f"this needs a package that cannot be imported: got {error}", how_to_install(extra))
        code = 1 if extra is None else 2
    if code == _INTERRUPTED:
        problem(
            "interrupted", "What was finished is kept: give the same command again, with --resume if it asks for that."
        )
    if as_json and not volume.answered and code in (None, 0):
        note("this command has no result to print as JSON")
    raise SystemExit(code if isinstance(code, int) else 0)


def _misused(error: Any) -> int:
    """Say what is wrong with a line, and what the commands or options are; of a group alone, show its help."""
    context, message = getattr(error, "ctx", None), error.format_message()
    if context is None or context.parent is None:
        problem(message, "trueup --help lists the commands, trueup COMMAND --help their options.")
        return 2
    if message == context.get_help():  # what typer says of a group without a command
        out.print(message, markup=False)
        return 0
    own = f"{context.command_path} --help"
    if hasattr(context.command, "commands"):
        problem(
            f"{message} Commands of {context.command_path}: {', '.join(context.command.commands)}.",
            f"{own} says what they do.",
        )
        return 2
    message = message.replace("Value error, ", "")
    words = re.findall(r"'([^']+)'", message)
    near = meant(f"{words[1]!r}", words[2:]) if len(words) > 2 else ""
    problem(message, f"Did you mean {near!r}? {own} lists the options." if near else f"{own} lists the options.")
    return 2


def _is_of_windows(error: Exception) -> bool:
    """Whether what MuJoCo draws with cannot be loaded, of which it says nothing itself."""
    frames = traceback.walk_tb(error.__traceback__)
    modules = [str(frame.f_globals.get("__name__", "")).partition(".")[0] for frame, _ in frames]
    return _WINDOWS in os.environ and "OpenGL" in modules


def _extra_of(error: Exception) -> str | None:
    """The extra that brings the package which an import lacks; None if it is another error."""
    if not isinstance(error, ImportError):
        return None
    package = str(error.name).partition(".")[0]
    extras = doctor.EXTRAS.items()
    return next((extra for extra, (_, modules) in extras if package in (module for _, module in modules)), None)


if __name__ == "__main__":
    main()
