"""Regular expressions that come with logs, matched by RE2: the time is in proportion to the text, whatever they are.

Python's own take years for some expressions and names of forty letters. RE2 (https://github.com/google/re2/wiki/Syntax)
is part of pyarrow; it has neither look-around nor back-references.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import pyarrow as pa
import pyarrow.compute as pc

from trueup.errors import ConfigError

_LONGEST = 1000
_WHOLE = "whole__"
# Escapes and classes are passed over; what is left are groups without a name, of which pyarrow takes none.
_NAMELESS = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]|\((?!\?)", re.DOTALL)


def group_names(pattern: str, *, where: str) -> tuple[str, ...]:
    """Names of the groups of a pattern.

    Args:
        pattern: the expression.
        where: how messages call it.

    Raises:
        ConfigError: it is not a regular expression.
    """
    # Beside the pattern, not around it: a parenthesis too many must not close ours.
    return _names(_extracted([], f"(?P<{_WHOLE}>){_named(pattern)}", where))


def matches(pattern: str, texts: Sequence[str], *, where: str) -> list[dict[str, str] | None]:
    """The named groups of each text that a pattern matches in full (empty where a group has no part), or None.

    Args:
        pattern: of which `group_names` found nothing to refuse.
        texts: what is looked at.
        where: how messages call the pattern.
    """
    found = _extracted(texts, rf"\A(?P<{_WHOLE}>{_named(pattern)})\z", where)
    names = _names(found)
    return [None if groups is None else {name: groups[name] for name in names} for groups in found.to_pylist()]


def _named(pattern: str) -> str:
    return _NAMELESS.sub(lambda found: "(?:" if found[0] == "(" else found[0], pattern)


def _names(found: pa.StructArray) -> tuple[str, ...]:
    return tuple(field.name for field in found.type if field.name != _WHOLE)


def _extracted(texts: Sequence[str], expression: str, where: str) -> pa.StructArray:
    # The name of a file need not be Unicode; that of an episode must.
    array = pa.array([text.encode(errors="replace").decode() for text in texts], pa.string())
    if len(expression) > _LONGEST:
        raise ConfigError(f"{where} is too long", got=f"{len(expression)} characters", expected=f"{_LONGEST} at most")
    try:
        return pc.extract_regex(array, expression)
    except (pa.ArrowException, ValueError) as error:
        raise ConfigError(
            f"{where} is not a regular expression",
            got=error,
            hint="RE2 reads it, which has no look-around and no back-references.",
        ) from error
