"""Every error that trueup raises on purpose.

One base class, so that `except TrueupError` catches all of them. A message says what is wrong, what was
found, what was expected, what is available and what to do next; the command line prints it in one or two
lines and exits with the class's `exit_code`.
"""

import contextlib
import re
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches

# Names that are looked through for one that was meant, and how much of it has to be right.
_MOST_NAMES, _NEAR = 1000, 0.75


def _plain(value: object, limit: int) -> str:
    """On one line, printable and short: names and values come from files that anybody may have written."""
    text = re.sub(r"\s*\n\s*", " ", str(value)[: 4 * limit])
    text = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    if text.count("\\x") > 8:  # bytes tell nobody anything
        text = text.partition("\\x")[0] + "…"
    return text if len(text) <= limit else f"{text[:limit]}…"


def _listing(names: Iterable[object], limit: int = 24) -> str:
    shown = [_plain(name, 60) for name in names]
    more = f", … ({len(shown) - limit} more)" if len(shown) > limit else ""
    return ", ".join(shown[:limit]) + more if shown else "none"


def meant(text: str, names: Sequence[str]) -> str:
    """The name that is nearest to a quoted word of a text, or to its last one; empty if none is near."""
    words = [*re.findall(r"'([^']{2,60})'", text), *text.split()[-1:]]
    small = {name.lower(): name for name in names[:_MOST_NAMES]}
    for word in words:
        if word not in names and (near := get_close_matches(word.lower(), small, 1, _NEAR)):
            return small[near[0]]
    return ""


def _restored(kind: type["TrueupError"], message: tuple[object, ...], state: dict[str, object]) -> "TrueupError":
    error = kind.__new__(kind)
    error.args = message
    error.__dict__.update(state)
    return error


class TrueupError(Exception):
    """Base of all errors raised by trueup.

    Args:
        what: what is wrong, with the file or name that it is about.
        got: what was found.
        expected: what should have been there.
        available: the names that do exist.
        hint: the next step for the user.
    """

    exit_code = 2

    def __init__(
        self,
        what: str,
        *,
        got: object = None,
        expected: object = None,
        available: Iterable[object] | None = None,
        hint: str | None = None,
    ) -> None:
        self.what = what = _plain(what, 3200)
        self.hint = "\n".join(_plain(line, 2000) for line in hint.rstrip().split("\n")[:20]) if hint else None
        details = []
        if got is not None:
            details.append(f"got {_plain(got, 400)}")
        if expected is not None:
            details.append(f"expected {_plain(expected, 1000)}")
        if available is not None:
            names = list(map(str, available))
            near = meant(f"{what} {got if isinstance(got, str) else ''}", names)
            asked = f"did you mean {_plain(near, 60)!r}? " if near else ""
            details.append(f"{asked}available: {_listing(names)}")
        self.details = "; ".join(details)
        super().__init__(": ".join(part for part in (what, self.details) if part))

    def __reduce__(self) -> tuple[object, ...]:
        """An error of a worker process arrives as it was, whatever its class asks for when it is made."""
        return _restored, (type(self), self.args, self.__dict__)

    @property
    def summary(self) -> str:
        """The message without the hint."""
        return super().__str__()

    def __str__(self) -> str:
        """The message, with the hint on a line of its own."""
        return f"{self.summary}\n{self.hint}" if self.hint else self.summary


class DataError(TrueupError):
    """The content of a file or array cannot be used: empty, truncated, ragged, not finite, not increasing."""


class Diverged(DataError):
    """A training came to numbers that are not finite; with other settings it may not."""


class FormatError(TrueupError):
    """A file or folder is of no known format, or of a version that this release cannot read."""


class NameMismatch(TrueupError):
    """Names of joints, signals or runs do not agree; nothing is ever matched by position."""

    def __init__(
        self,
        what: str,
        *,
        left: Iterable[object],
        right: Iterable[object],
        left_name: str = "got",
        right_name: str = "expected",
        hint: str | None = None,
    ) -> None:
        super().__init__(f"{what}: {left_name} [{_listing(left)}], {right_name} [{_listing(right)}]", hint=hint)


class UnitError(TrueupError):
    """A unit is unknown, or cannot be converted into the one that is needed."""


class MissingSignal(TrueupError):
    """A signal, episode, split or run was asked for that is not there."""


class ConfigError(TrueupError):
    """An option, a YAML file or a model description is wrong."""


class ImpossibleLinks(ConfigError):
    """A URDF has masses or inertias that no body has."""


class OutputExists(TrueupError):
    """The output is already there and neither `--overwrite` nor `--resume` was given."""


class MissingDependency(TrueupError):
    """An optional package is needed and not installed."""


def how_to_install(extra: str) -> str:
    """The command that brings the packages of an extra; there is no release that a name alone would find."""
    return f"pip install '.[{extra}]' in the checkout of trueup"


@contextlib.contextmanager
def needing(what: str, extra: str) -> Iterator[None]:
    """Imports of the packages of an extra: `what` needs them.

    Raises:
        MissingDependency: one is not installed, or broken.
    """
    try:
        yield
    except ImportError as error:
        package = str(error.name or error).partition(".")[0]
        if package == "trueup":
            raise
        raise MissingDependency(
            f"{what} needs {package}, which cannot be imported", got=error, hint=how_to_install(extra)
        ) from error


class NoPlan(TrueupError):
    """No motion was found: a pose is in collision, a line is out of reach, or the planner's attempts are used up."""


class RobotStopped(TrueupError):
    """A robot has stopped and takes no commands until it is told to recover."""


class NotIdentifiable(TrueupError):
    """The data do not determine what was asked for, e.g. the delay of a constant command."""

    exit_code = 3


class BarNotMet(TrueupError):
    """A bar given with `--fail-above` was not met."""

    exit_code = 3


class SetupWrong(TrueupError):
    """Logs, robot.yaml and model certainly do not fit together; nothing was fitted."""

    exit_code = 3
