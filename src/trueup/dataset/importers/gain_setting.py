"""The setting of the drives' position gain while a motion was recorded, as logs and mappings say it."""

from __future__ import annotations

import math

from trueup.errors import ConfigError, DataError


def kp_setting_of(value: object, where: str, *, error: type[ConfigError] | type[DataError] = DataError) -> float | None:
    """A setting, in whatever unit the firmware has; None where nothing is said.

    Args:
        value: a number, or a text that is one.
        where: it was said, for messages.
        error: what is raised.

    Raises:
        ConfigError: no finite number above 0, if that is asked for.
        DataError: likewise.
    """
    if value is None or value == "":
        return None
    try:
        setting = float(value) if isinstance(value, str | int | float) and not isinstance(value, bool) else math.nan
    except (ValueError, OverflowError):
        setting = math.nan
    if not 0 < setting < math.inf:
        raise error(f"{where} is no setting of a gain", got=repr(value), expected="a finite number above 0, or nothing")
    return setting


def agreed_kp_setting(said: float | None, stated: float | None, source: str) -> float | None:
    """The setting that a log says, or else the mapping.

    Raises:
        ConfigError: they say different ones.
    """
    if said is not None and stated not in (None, said):
        raise ConfigError(
            f"{source} says another kp_setting than the mapping",
            got=f"{said:g}",
            expected=f"{stated:g}",
            hint="Leave `kp_setting` out of the mapping: each file then has its own.",
        )
    return stated if said is None else said
