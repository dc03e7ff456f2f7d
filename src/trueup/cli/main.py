"""The `trueup` command: parser, error handling, exit codes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import metadata
from typing import Annotated

import typer

from trueup.cli import (
    augment,
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
    policy,
    record,
    replay,
    report,
)
from trueup.cli.console import out, problem
from trueup.errors import TrueupError

app = typer.Typer(
    name="trueup",
    help="Measure, explain and close the sim-to-real gap of a robot from its logs. --debug shows tracebacks of errors.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for module in (
    convert,
    record,
    replay,
    gap,
    identify,
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


# Letters of a file's name that are shown.
_NAME = 200
_INTERRUPTED = 130  # typer's code for Ctrl-C, too


@app.callback(invoke_without_command=True)
def version(
    show: Annotated[bool, typer.Option("--version", help="Show the version.", is_eager=True)] = False,
) -> None:
    """Answer `trueup --version`; everything else is done by the commands."""
    if show:
        out.print(f"trueup {metadata.version('trueup')}")
        raise typer.Exit


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code.

    0: done; 1: a bug in trueup; 2: bad input; 3: a bar was not met or nothing could be identified; 130: Ctrl-C.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"] or ["--help"]
    try:
        # typer returns the code of typer.Exit when it does not handle exits by itself
        code = app(arguments, standalone_mode=False, prog_name="trueup")
    except TrueupError as error:
        if debug:
            raise
        problem(f"{error.what}: {error.details}" if error.details else error.what, error.hint)
        code = error.exit_code
    except (typer.Abort, KeyboardInterrupt):
        code = _INTERRUPTED
    except BrokenPipeError:
        code = 0  # the reader, e.g. head, has seen enough
    except OSError as error:
        if debug:
            raise
        # What the machine refuses (names that are too long, disks, rights) is none of ours.
        named = "" if error.filename is None else f" {str(error.filename)[:_NAME]!r}"
        problem(f"this machine refuses{named}", error.strerror or str(error))
        code = 2
    except Exception as error:
        # Usage errors of typer and click share no public base class, but only they can format themselves.
        usage = getattr(error, "format_message", None)
        if usage is not None:
            problem(usage(), "trueup --help lists the commands, trueup COMMAND --help their options.")
            raise SystemExit(2) from None
        if debug:
            raise
        problem(
            f"this is a bug in trueup: {type(error).__name__}: {error}",
            "Run it again with --debug and report the traceback.",
        )
        code = 1
    if code == _INTERRUPTED:
        problem(
            "interrupted", "What was finished is kept: give the same command again, with --resume if it asks for that."
        )
    raise SystemExit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
