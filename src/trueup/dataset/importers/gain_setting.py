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
