"""Gray-box regression: a linear torque model per joint that grows block by block (GapONet 3.1, A.3.1)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.core.episode import Episode
from trueup.core.graybox_result import BlockFit, Coefficient, GrayboxResult, IntervalMethod, JointFit
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.identify.regression import graybox_terms as terms
from trueup.identify.regression.covariance import Covariance, robust_covariance
from trueup.identify.regression.graybox_scores import Sums, block_scores, sums_of
from trueup.identify.regression.graybox_terms import BLOCKS, JointRows
from trueup.identify.regression.samples import CommandVelocity, Motion, Samples, SampleSettings, gather
from trueup.identify.regression.torque_limit import AT_LIMIT, apparent_limit
from trueup.robots.spec import CommandSignal

_FEWEST = 50  # samples
_FOLDS = 10
_FEWEST_FOLDS = 3
_WORST_CONDITION = 1e12  # of normal equations; beyond it a fold has nothing left to fit a term to


@dataclass(frozen=True)
class GrayboxSettings:
    """How the torque model is fitted.

    Attributes:
        blocks: which to add, in order; each contains those before it.
        delay_s: the command acts this much later [s].
        epsilon: width of the smoothed Coulomb step [rad/s or m/s]; below the noise of the velocity the term becomes
            noise, far above it the term becomes viscous.
        cutoff_hz: low-pass of what is differentiated [Hz].
        command_velocity: where the commanded velocity comes from: `signal` (zero if the log has none), `derived`
            from the commanded position, or `zero`.
        derive_velocity: take the derivative of the position although the log has a velocity.
        torque_limits: joint -> largest torque; samples beyond 98 % of it say nothing about gains and are left out.
            Where no limit is given, one is looked for.
        kp_setting: of the drives' position gain, at which `K_p` holds; the largest one of motions with several if None.
        follows: what the drives are told. The block `pd` has `K_d` and `K_i` for a velocity, `K_u` for a torque.
    """

    blocks: tuple[str, ...] = tuple(BLOCKS)
    delay_s: float = 0.0
    epsilon: float = 0.05
    cutoff_hz: float = 15.0
    command_velocity: CommandVelocity = "signal"
    derive_velocity: bool = False
    torque_limits: Mapping[str, float] = field(default_factory=dict)
    kp_setting: float | None = None
    follows: CommandSignal = "position"

    def __post_init__(self) -> None:
        """Refuse what cannot be fitted."""
        if self.blocks != tuple(BLOCKS)[: len(self.blocks)] or not self.blocks:
            raise ConfigError(
                "blocks grow in a fixed order", got=self.blocks, expected=f"a beginning of {list(BLOCKS)}"
            )
        if not 0.0 < self.epsilon < np.inf:
            raise ConfigError("epsilon must be above 0", got=self.epsilon)

    @property
    def samples(self) -> SampleSettings:
        """How rows are made of episodes."""
        return SampleSettings(
            delay_s=self.delay_s,
            cutoff_hz=self.cutoff_hz,
            command_velocity=self.command_velocity,
            derive_velocity=self.derive_velocity,
            follows=self.follows,
        )


class _Data(NamedTuple):
    """The complete rows of one joint, and what they belong to."""

    rows: JointRows
    motion: Int[np.ndarray, "N"]
    train: Bool[np.ndarray, "N"]
    columns: Float64[np.ndarray, "N 12"]


class _Fit(NamedTuple):
    """Coefficients that were fitted, and the residual of all rows."""

    values: Float64[np.ndarray, "K"]
    covariance: Covariance
    residual: Float64[np.ndarray, "N"]


class _Sums(NamedTuple):
    """What the errors of a joint sum up to with a block, motion by motion: as fitted to train, and held out."""

    fitted: Sums
    held_out: Sums


def fit_graybox(
    episodes: Iterable[Episode], *, settings: GrayboxSettings | None = None, joints: Sequence[str] | None = None
) -> GrayboxResult:
    """Fit eq. 1 per joint in growing blocks on the train motions and score each model on every split.

    Ordinary least squares; intervals allow for autocorrelated residuals (see `covariance`). A coefficient that the
    motions cannot tell is left out with the reason, and so is a block of which nothing is left.

    Args:
        episodes: in the joint names and units of the robot, with measured position and torque, and a command of what
            the drives follow. Without any split all of them are fitted and nothing is held out.
        settings: blocks, delay, filter and sources.
        joints: the joints to fit; all if None.

    Raises:
        DataError: no episode, or none to fit.
        MissingSignal: no torque, or no such command.
        NameMismatch: an episode lacks a joint.
        UnitError: a signal is not in SI.
    """
    settings = settings or GrayboxSettings()
    samples = gather(episodes, settings.samples, joints=joints)
    if not np.isfinite(samples.command).any():
        raise MissingSignal(
            f"the episodes have no commanded {settings.follows}",
            hint="Say what the drives follow, or fit the dynamics.",
        )
    notes, splits = _splits(samples)
    folds = _folds(samples)
    fits, sums = {}, []
    for number, joint in enumerate(samples.joints):
        fits[joint], errors = _fit_joint(samples, number, splits, folds, settings)
        sums.append(errors)
    return GrayboxResult(
        joints=fits,
        settings={**asdict(settings), "blocks": list(settings.blocks)},
        notes=notes,
        total=_total(samples, splits, sums, fits),
    )


def predict_graybox(
    episodes: Iterable[Episode], fitted: GrayboxResult, settings: GrayboxSettings, blocks: Mapping[str, str]
) -> Float64[np.ndarray, "T J"]:
    """The torque that a gray box predicts at all stamps, one motion after the other [Nm or N]; NaN where it cannot.

    Args:
        episodes: as of `fit_graybox`.
        fitted: to other motions.
        settings: with which it was; `kp_setting` says at which setting `K_p` holds, also of these motions.
        blocks: joint -> block up to which its model goes; of other joints nothing is predicted.
    """
    samples = gather(episodes, settings.samples, joints=tuple(fitted.joints))
    result = np.full(samples.torque.shape, np.nan)
    for number, joint in enumerate(samples.joints):
        if joint not in blocks:
            continue
        table = terms.columns(_raw_rows(samples, number, settings), settings.epsilon)
        known = fitted.joints[joint].block(blocks[joint]).coefficients
        used = {name: item.value for name, item in known.items() if item.value is not None}
        result[:, number] = table[:, _index(tuple(used))] @ np.array(list(used.values()))
    return result


def _kp_factors(motions: Sequence[Motion], settings: GrayboxSettings) -> Float64[np.ndarray, "E"]:
    """Position gains of the motions, per that at which `K_p` holds."""
    known = {motion.kp_setting for motion in motions if motion.kp_setting is not None}
    at = settings.kp_setting or (max(known) if len(known) > 1 else None)
    return np.array([(motion.kp_setting or at) / at if at else 1.0 for motion in motions])


def _folds(samples: Samples) -> Int[np.ndarray, "E"]:
    """The fold of each motion; repetitions of a motion are in one, since they would give it away. All 0 if too few."""
    executed = list(dict.fromkeys(motion.executed for motion in samples.motions))
    if len(executed) < _FEWEST_FOLDS:
        return np.zeros(len(samples.motions), dtype=np.int64)
    fold = {name: number % _FOLDS for number, name in enumerate(executed)}
    return np.array([fold[motion.executed] for motion in samples.motions], dtype=np.int64)


def _total(
    samples: Samples, splits: tuple[str, ...], joints: Sequence[Mapping[str, _Sums]], fits: Mapping[str, JointFit]
) -> tuple[BlockFit, ...]:
    """The blocks over all joints that could be fitted; a joint without a block stays as it was before it."""
    fitted = [sums for sums in joints if sums]
    units = {unit for unit, sums in zip(samples.length_units, joints, strict=True) if sums}
    if len(units) != 1:
        return ()
    unit = terms.unit("tau_0", units.pop())
    result = []
    latest = [next(iter(sums.values())) for sums in fitted]
    for own in zip(*(fit.blocks for fit in fits.values()), strict=True):
        block = own[0].block
        if not any(block in sums for sums in fitted):
            result.append(BlockFit(block, next(item.left_out for item in own if item.left_out), {}, {}, {}))
            continue
        latest = [
            sums.get(block, _Sums(*(item._replace(without=item.included) for item in before)))
            for sums, before in zip(fitted, latest, strict=True)
        ]
        by_split, by_payload = block_scores(
            samples.motions, splits, [item.fitted for item in latest], [item.held_out for item in latest], unit=unit
        )
        result.append(BlockFit(block, "", {}, by_split, by_payload))
    return tuple(result)


def _splits(samples: Samples) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Notes, and the split of each motion."""
    splits = tuple(motion.split for motion in samples.motions)
    notes = samples.notes
    if not any(splits):
        return (*notes, "no episode has a split: all are fitted, nothing is held out"), ("train",) * len(splits)
    if "train" not in splits:
        raise DataError("there is no train motion to fit", available=sorted(set(splits)))
    if "" in splits:
        notes = (*notes, f"{splits.count('')} episodes without a split are not used")
    return notes, splits


def _fit_joint(
    samples: Samples, number: int, splits: tuple[str, ...], folds: Int[np.ndarray, "E"], settings: GrayboxSettings
) -> tuple[JointFit, dict[str, _Sums]]:
    length_unit = samples.length_units[number]
    data, notes = _joint_data(samples, number, splits, settings)
    fitted = data.rows.where(data.train)
    motions = np.unique(data.motion[data.train])
    why = terms.unusable(fitted)
    if why:
        nothing = tuple(_left_out(block, settings.follows, length_unit, {}, why) for block in settings.blocks)
        return JointFit(nothing, "none", motions.size, int(data.train.sum()), (*notes, why)), {}
    loads = np.array([samples.motions[motion].payload_kg for motion in motions])
    payload_motions = {float(load): int((loads == load).sum()) for load in np.unique(loads)}
    reasons = terms.missing_evidence(fitted, payload_motions)
    fits: list[BlockFit] = []
    method: IntervalMethod = "none"
    # Its columns have the lengths and angles of those of the rows, which is all that least squares are about.
    triangle = np.asarray(np.linalg.qr(np.column_stack([data.columns, data.rows.torque])[data.train], mode="r"))
    constant = data.columns[:, _index(("tau_0",))]
    previous = data.rows.torque - data.rows.torque[data.train].mean()
    unseen = _held_out(constant, data, folds)
    errors: dict[str, _Sums] = {}
    for block in settings.blocks:
        names = terms.term_names(settings.blocks[: settings.blocks.index(block) + 1], settings.follows)
        present = tuple(name for name in names if name not in reasons)
        reasons |= terms.dependent(triangle[:, _index(present)], present)
        own = terms.blocks_of(settings.follows)[block]
        if all(name in reasons for name in own):
            why = "; ".join(dict.fromkeys(reasons[name] for name in own))
            fits.append(_left_out(block, settings.follows, length_unit, reasons, f"not identifiable: {why}"))
            continue
        used = tuple(name for name in names if name not in reasons)
        fit = _least_squares(data, triangle, used)
        method = fit.covariance.method
        weak = terms.weak_points(triangle[:, _index(used)], used, fitted, payload_motions)
        coefficients = _coefficients(names, used, fit, length_unit, reasons, weak)
        predicted = _held_out(data.columns[:, _index(used)], data, folds)
        count = len(samples.motions)
        errors[block] = _Sums(
            sums_of(data.motion, previous, fit.residual, motions=count),
            sums_of(data.motion, unseen, predicted, motions=count),
        )
        by_split, by_payload = block_scores(
            samples.motions,
            splits,
            [errors[block].fitted],
            [errors[block].held_out],
            unit=terms.unit("tau_0", length_unit),
        )
        fits.append(BlockFit(block, "", coefficients, by_split, by_payload))
        previous, unseen = fit.residual, predicted
    return JointFit(tuple(fits), method, motions.size, int(data.train.sum()), tuple(notes)), errors


def _held_out(table: Float64[np.ndarray, "N K"], data: _Data, folds: Int[np.ndarray, "E"]) -> Float64[np.ndarray, "N"]:
    """The residual of each row under coefficients that were fitted without its fold; NaN where that cannot be."""
    own = folds[data.motion]
    scale = 1.0 / np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    scaled = table * scale
    numbers = np.unique(own)
    grams = {fold: scaled[own == fold].T @ scaled[own == fold] for fold in numbers}
    moments = {fold: scaled[own == fold].T @ data.rows.torque[own == fold] for fold in numbers}
    gram, moment = sum(grams.values()), sum(moments.values())
    residual = np.full(own.size, np.nan)
    for fold in numbers if numbers.size > 1 else ():
        rest = gram - grams[fold]
        if np.linalg.cond(rest) < _WORST_CONDITION:
            inside = own == fold
            values = np.linalg.solve(rest, moment - moments[fold])
            residual[inside] = data.rows.torque[inside] - scaled[inside] @ values
    return residual


def _joint_data(
    samples: Samples, number: int, splits: tuple[str, ...], settings: GrayboxSettings
) -> tuple[_Data, list[str]]:
    raw = _raw_rows(samples, number, settings)
    arrays = {name: own for name, own in vars(raw).items() if isinstance(own, np.ndarray)}
    needs = [name for name in arrays if name != "acceleration" or "coupling" in settings.blocks]
    usable = np.all([np.isfinite(arrays[name]) for name in needs], axis=0)
    split = np.array(splits)[samples.motion]
    usable &= split != ""
    cut, notes = _beyond_limit(raw, usable, split == "train", settings.torque_limits.get(samples.joints[number]))
    usable &= ~cut
    rows = raw.where(usable)
    table = terms.columns(rows, settings.epsilon)
    return _Data(rows, samples.motion[usable], split[usable] == "train", table), notes


def _raw_rows(samples: Samples, number: int, settings: GrayboxSettings) -> JointRows:
    """All rows of one joint, NaN where something is not known."""
    command, position = samples.command[:, number], samples.position[:, number]
    rate, velocity = samples.command_velocity[:, number], samples.velocity[:, number]
    error, velocity_error = command - position, rate - velocity
    if settings.follows == "position":
        error = _kp_factors(samples.motions, settings)[samples.motion] * error
    elif settings.follows == "torque":
        error = velocity_error = 0.0 * command
    return JointRows(
        error=error,
        velocity_error=velocity_error,
        command=command,
        command_velocity=rate,
        position=position,
        velocity=velocity,
        acceleration=samples.acceleration[:, number],
        payload_kg=samples.payload_kg,
        torque=samples.torque[:, number],
        length_unit=samples.length_units[number],
        follows=settings.follows,
    )


def _beyond_limit(
    raw: JointRows,
    usable: Bool[np.ndarray, "N"],
    train: Bool[np.ndarray, "N"],
    limit: float | None,
) -> tuple[Bool[np.ndarray, "N"], list[str]]:
    """Samples whose torque is cut off, and what to say about them."""
    size = np.abs(raw.torque)
    fitted = usable & train
    origin = "the given torque limit"
    if limit is None and fitted.sum() > _FEWEST:
        drive = [raw.command] if raw.follows == "torque" else [raw.error, raw.velocity_error]
        limit = apparent_limit(raw.torque[fitted], np.stack([np.ones(size.size), *drive], axis=1)[fitted])
        origin = "what looks like a torque limit"
    if limit is None:
        return np.zeros(size.size, bool), []
    cut = usable & (size >= AT_LIMIT * limit)
    share = cut.sum() / max(usable.sum(), 1)
    told = f"{cut.sum()} samples ({share:.1%}) at {origin} of {limit:.4g} are left out"
    return cut, [told] if cut.any() else []


def _index(names: tuple[str, ...]) -> list[int]:
    return [terms.COLUMNS.index(name) for name in names]


def _least_squares(data: _Data, triangle: Float64[np.ndarray, "R 13"], names: tuple[str, ...]) -> _Fit:
    table = data.columns[:, _index(names)]
    design, motion = table[data.train], data.motion[data.train]
    folded = triangle[:, _index(names)]
    scale = 1.0 / np.linalg.norm(folded, axis=0)
    values = np.linalg.lstsq(folded * scale, triangle[:, -1], rcond=None)[0] * scale
    residual = data.rows.torque - table @ values
    _, cluster = np.unique(motion, return_inverse=True)
    starts = np.flatnonzero(np.diff(cluster, prepend=-1))
    grams = np.stack([part.T @ part for part in np.split(design, starts[1:])])
    covariance = robust_covariance(grams, design * residual[data.train][:, None], cluster)
    return _Fit(values, covariance, residual)


def _coefficients(
    names: tuple[str, ...],
    used: tuple[str, ...],
    fit: _Fit,
    length_unit: str,
    reasons: Mapping[str, str],
    weak: Mapping[str, str],
) -> dict[str, Coefficient]:
    error, half = fit.covariance.standard_error, fit.covariance.half_width()
    result = {}
    for name in names:
        unit = terms.unit(name, length_unit)
        if name not in used:
            result[name] = Coefficient(unit, status="not identifiable", note=reasons[name])
            continue
        k = used.index(name)
        value = float(fit.values[k])
        result[name] = Coefficient(
            unit,
            value=value,
            low=value - float(half[k]),
            high=value + float(half[k]),
            standard_error=float(error[k]),
            status="weak" if name in weak else "ok",
            note=weak.get(name, reasons.get("K_v", "") if name == "K_d" else ""),
        )
    return result


def _left_out(block: str, follows: CommandSignal, length_unit: str, reasons: Mapping[str, str], why: str) -> BlockFit:
    own = terms.blocks_of(follows)[block]
    coefficients = {
        name: Coefficient(terms.unit(name, length_unit), status="not identifiable", note=reasons.get(name, why))
        for name in own
    }
    return BlockFit(block, why, coefficients, {}, {})
