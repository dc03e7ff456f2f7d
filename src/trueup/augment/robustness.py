"""How much of a position error a correction takes away: errors of one motion, and shares with paired intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int

from trueup.augment.components import POSITION
from trueup.core.hold import SAME_INSTANT_S
from trueup.core.model_card import ModelCard
from trueup.core.results import Estimate, Verdict
from trueup.core.robustness_result import ERROR_KINDS, ErrorKind, Improvement
from trueup.core.timeseries import TimeSeries
from trueup.errors import ConfigError, DataError, MissingSignal, UnitError
from trueup.measure import by_motion, position_distance, ratio_interval
from trueup.measure.uncertainty import estimate

JOINT_POSITION = "position"


def judged_signal(card: ModelCard) -> str:
    """The position that a network corrects: of joints, or of bodies.

    Raises:
        ConfigError: it corrects none.
    """
    corrected = dict.fromkeys(output.quantity for output in card.outputs)
    for signal in (JOINT_POSITION, POSITION):
        if signal in corrected:
            return signal
    raise ConfigError(
        f"the network {card.name!r} corrects no position",
        got=", ".join(corrected),
        expected=f"{JOINT_POSITION} or {POSITION}",
        hint="How far it carries is asked of positions; train one that corrects them.",
    )


def judged_parts(card: ModelCard, measured: TimeSeries, scored: Sequence[str]) -> tuple[str, ...]:
    """The joints or bodies whose position a network corrects and somebody measured; of joints the scored ones.

    Where no joint that it corrects is scored, all of them stand.

    Args:
        card: of the network on the joints or bodies of a robot.
        measured: of a motion, in the robot's names.
        scored: names of the robot's scored joints.

    Raises:
        ConfigError: it corrects no position.
        MissingSignal: none of them was measured.
    """
    signal = judged_signal(card)
    parts = tuple(dict.fromkeys(output.joint for output in card.outputs if output.quantity == signal))
    known = _owners(measured, signal) if signal in measured else ()
    there = [name for name in parts if name in known]
    if not there:
        raise MissingSignal(
            f"{signal!r}, which the network {card.name!r} corrects, was not measured",
            got=", ".join(measured.signals),
            available=known,
        )
    return tuple(name for name in there if name in scored) or tuple(there)


def position_errors(
    measured: TimeSeries, run: TimeSeries, signal: str, parts: Sequence[str]
) -> Float64[np.ndarray, "2"]:
    """Mean and largest absolute error of a position, each the mean over joints [rad or m] or bodies [m].

    Args:
        measured: in the names of the run; its stamps are among these.
        run: simulated or corrected.
        signal: `position` or `body.position`.
        parts: the joints or bodies that count.

    Raises:
        MissingSignal: the position of one of them was not measured, or not simulated.
        DataError: nothing finite was measured of one of them.
    """
    for series in (measured, run):
        missing = [name for name in parts if signal not in series or name not in _owners(series, signal)]
        if missing:
            raise MissingSignal(
                f"there is no {signal!r} of {missing}", available=series.signals if signal not in series else parts
            )
    rows = np.searchsorted(measured.time_s, run.time_s - SAME_INSTANT_S).clip(max=len(measured) - 1)
    truth, own = _columns(measured, signal, parts)[rows], _columns(run, signal, parts)
    away = np.abs(truth - own) if signal == JOINT_POSITION else position_distance(truth, own)
    if not np.isfinite(away).any(axis=0).all():
        raise DataError(f"{signal!r} was measured nowhere of one of {list(parts)}")
    return np.array([np.nanmean(away), np.nanmax(away, axis=0).mean()])


def unit_of(series: TimeSeries, signal: str, parts: Sequence[str]) -> str:
    """The unit of the positions of all parts.

    Raises:
        UnitError: some are angles and some are lengths.
    """
    owners = _owners(series, signal)
    units = {series.units[signal][owners.index(name)] for name in parts}
    if len(units) > 1:
        raise UnitError(
            "errors of angles and lengths have no mean",
            got=", ".join(sorted(units)),
            hint="Name joints of one kind under `scored` in robot.yaml.",
        )
    return units.pop()


def _owners(series: TimeSeries, signal: str) -> tuple[str, ...]:
    return series.joints if signal == JOINT_POSITION else series.bodies


def _columns(series: TimeSeries, signal: str, names: Sequence[str]) -> Float64[np.ndarray, "T N ..."]:
    owners = _owners(series, signal)
    return np.asarray(series[signal], np.float64)[:, [owners.index(name) for name in names]]


def improvements(
    simulated: Float64[np.ndarray, "E 2"],
    corrected: Float64[np.ndarray, "E 2"],
    unit: str,
    *,
    motions: Int[np.ndarray, "E"] | None = None,
    draws: int = 2000,
    seed: int = 0,
) -> dict[ErrorKind, Improvement]:
    """What a correction takes away of the errors of E recordings, with paired intervals over motions.

    Args:
        simulated: mean and largest error of each recording.
        corrected: likewise, after correction.
        unit: of the errors.
        motions: number of the motion that each executed; repetitions are drawn together. All differ if None.
        draws: bootstrap resamples.
        seed: of the bootstrap.

    Raises:
        DataError: there is no error that could be taken away.
    """
    if not simulated.any(axis=0).all():
        raise DataError(
            "the simulator makes no error that could be taken away", hint="Was this dataset recorded from it?"
        )
    every = np.ones_like(simulated)
    if motions is not None:
        simulated, corrected, every = (by_motion(sums, motions) for sums in (simulated, corrected, every))
    left, before, after = (
        ratio_interval(*pair, draws=draws, seed=seed)
        for pair in ((corrected, simulated), (simulated, every), (corrected, every))
    )
    found: dict[ErrorKind, Improvement] = {}
    for at, kind in enumerate(ERROR_KINDS):
        value, low, high = (float(end[at]) for end in left)
        gone = estimate(1.0 - value, "1", 1.0 - high, 1.0 - low, bounds=(-np.inf, 1.0))
        found[kind] = Improvement(_error(before, at, unit), _error(after, at, unit), gone, _verdict(gone))
    return found


def _error(ends: tuple[np.ndarray, ...], at: int, unit: str) -> Estimate:
    value, low, high = (float(end[at]) for end in ends)
    return estimate(value, unit, low, high, bounds=(0.0, np.inf))


def _verdict(gone: Estimate) -> Verdict:
    if gone.low is None or gone.high is None:
        return "undecided"
    return "better" if gone.low > 0.0 else "worse" if gone.high < 0.0 else "undecided"
