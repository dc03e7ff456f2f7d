"""An observation, moved by what a correction of the state changes in it, part by part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from trueup.errors import ConfigError


def moved(observation: Any, fresh: Any, corrected: Any) -> Any:
    """The observation, moved as the corrected one is from the fresh one.

    What is no number (switches, words) is that of the corrected one where the two differ. What does not differ stays as
    it is, bit by bit.
    """
    if isinstance(observation, Mapping):
        return {name: moved(part, fresh[name], corrected[name]) for name, part in observation.items()}
    if isinstance(observation, tuple):
        return tuple(moved(*parts) for parts in zip(observation, fresh, corrected, strict=True))
    seen, before, after = np.asarray(observation), np.asarray(fresh), np.asarray(corrected)
    differs = after != before
    if not _are_numbers(seen, before, after):
        return np.where(differs, after, seen)[()]
    # Infinite numbers that do not differ, and what bytes of an image wrap around.
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(differs, seen + (after - before), seen).astype(seen.dtype)[()]


def refuse_changed(observation: Any, asked: tuple[Any, Any], fresh: Any, corrected: Any) -> None:
    """What a correction moves must be, in the observation, as the environment says it.

    Only that can be compared: an environment may give other parts other values after it has observed, such as the
    action before. What differs from one time of asking to the next is noise, and not compared.

    Args:
        observation: what came out of the environment's step.
        asked: what it says right afterwards, twice, with other random numbers.
        fresh: what it says of the simulated state.
        corrected: what it says of the corrected state.

    Raises:
        ConfigError: it was scaled, delayed, cut or put into another form on its way.
    """
    own, *others = (dict(_parts(each)) for each in (observation, *asked, fresh, corrected))
    for name, seen in own.items():
        parts = [other.get(name) for other in others]
        shapes = [None if part is None else part.shape for part in parts]
        if any(shape != seen.shape for shape in shapes):
            raise _changed(f"{name} of shape {seen.shape}", shapes[0])
        first, second, before, after = (np.asarray(part) for part in parts)
        asked_for = first.astype(seen.dtype)
        close = np.isclose(seen, asked_for) if _are_numbers(seen, first) else seen == asked_for
        wrong = (after != before) & (first == second) & ~close
        if np.any(wrong):
            raise _changed(f"{name} with {seen[wrong][0]}", first[wrong][0])


def _changed(got: str, expected: object) -> ConfigError:
    return ConfigError(
        "the observations are not what _get_obs() says",
        got=got,
        expected=expected,
        hint="Put what scales, clips or delays observations into a wrapper around ResidualEnv, or into _get_obs(), and "
        "let that say the same however often it is called.",
    )


def _parts(observation: Any, name: str = "the observation") -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(observation, Mapping):
        for key, part in observation.items():
            yield from _parts(part, f"{name}[{key!r}]")
    elif isinstance(observation, tuple):
        for number, part in enumerate(observation):
            yield from _parts(part, f"{name}[{number}]")
    else:
        yield name, np.asarray(observation)


def _are_numbers(*parts: np.ndarray) -> bool:
    return all(np.issubdtype(part.dtype, np.number) for part in parts)
