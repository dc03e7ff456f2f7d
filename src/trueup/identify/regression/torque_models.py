"""Models of joint torques that are fitted to some motions and predict others, and simple rivals of theirs.

A learner takes episodes whose torque is known and answers with a function that predicts that of others, stamp by stamp.
Nothing of the others is seen before: delays, filters and blocks are chosen on the motions that are fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float64, Int

from trueup.core.episode import Episode
from trueup.core.graybox_result import HELD_OUT, GrayboxResult, JointFit
from trueup.errors import NotIdentifiable
from trueup.identify.regression.currents import Factor, as_torque, factors_by_mass
from trueup.identify.regression.graybox import GrayboxSettings, fit_graybox, predict_graybox
from trueup.identify.regression.graybox_delay import best_delay, spread
from trueup.identify.regression.graybox_terms import unsigned
from trueup.identify.regression.inverse_dynamics import (
    InverseDynamicsSettings,
    inverse_dynamics_from_episodes,
    predict_inverse_dynamics,
)
from trueup.identify.regression.inverse_dynamics_result import InverseDynamicsFit
from trueup.identify.regression.linkage import Linkage
from trueup.identify.regression.mass_regression import choose_cutoff, model_torque
from trueup.identify.regression.samples import SampleSettings, gather

Prediction = Callable[[Sequence[Episode]], Float64[np.ndarray, "T J"]]
Learner = Callable[[Sequence[Episode]], Prediction]


@dataclass(frozen=True)
class TorqueRobot:
    """What learners know of a robot.

    Attributes:
        model: compiled.
        joints: the J joints that move.
        judged: those whose torque is predicted.
        currents: those whose torque is in A, since nobody knows the factor.
        epsilon: width of the smoothed sign of the velocity [rad/s or m/s].
    """

    model: mujoco.MjModel
    joints: tuple[str, ...]
    judged: tuple[str, ...]
    currents: tuple[str, ...] = ()
    epsilon: float = 0.05

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Joints that move and whose torque says nothing."""
        return tuple(name for name in self.joints if name not in self.judged)

    def columns(self, joints: Sequence[str]) -> Int[np.ndarray, "K"]:
        """Where joints are among those that move."""
        return np.array([self.joints.index(name) for name in joints], np.int64)


def learn_mean(robot: TorqueRobot) -> Learner:
    """The mean torque of each joint."""

    def learn(train: Sequence[Episode]) -> Prediction:
        mean = np.nanmean(gather(train, SampleSettings(), joints=robot.joints).torque, axis=0)
        return lambda others: np.tile(mean, (sum(len(item.measured) for item in others), 1))

    return learn


def learn_simple(robot: TorqueRobot) -> Learner:
    """Least squares on velocity, its sign and a constant, joint by joint."""

    def table(velocity: Float64[np.ndarray, "T"]) -> Float64[np.ndarray, "T 3"]:
        return np.stack([velocity, np.tanh(velocity / robot.epsilon), np.ones_like(velocity)], axis=1)

    def learn(train: Sequence[Episode]) -> Prediction:
        samples = gather(train, SampleSettings(), joints=robot.joints)
        values = np.zeros((3, len(robot.joints)))
        for number in range(len(robot.joints)):
            own, torque = table(samples.velocity[:, number]), samples.torque[:, number]
            known = np.isfinite(own).all(axis=1) & np.isfinite(torque)
            values[:, number] = np.linalg.lstsq(own[known], torque[known], rcond=None)[0]

        def predict(others: Sequence[Episode]) -> Float64[np.ndarray, "T J"]:
            velocity = gather(others, SampleSettings(), joints=robot.joints).velocity
            return np.stack([table(velocity[:, at]) @ values[:, at] for at in range(len(robot.joints))], axis=1)

        return predict

    return learn


def learn_model(robot: TorqueRobot) -> Learner:
    """The model's own torque; of the motions, the low-pass and unknown factors of currents are fitted."""

    def learn(train: Sequence[Episode]) -> Prediction:
        train, factors = in_torque(robot, train)
        plain = SampleSettings(smooth_torque=True)
        settings = replace(plain, cutoff_hz=choose_cutoff(spread(train), robot.model, plain, robot.joints))

        def predict(others: Sequence[Episode]) -> Float64[np.ndarray, "T J"]:
            samples = gather(others, settings, joints=robot.joints)
            torque = model_torque(robot.model, samples, epsilon=robot.epsilon)
            return np.asarray(torque / _per_unit(robot, factors))

        return predict

    return learn


def learn_graybox(robot: TorqueRobot, settings: GrayboxSettings) -> Learner:
    """A gray box of each joint that has as many blocks as predict best within what is fitted."""

    def learn(train: Sequence[Episode]) -> Prediction:
        fitted, chosen = graybox_of(train, robot, settings)
        blocks = {name: block for name, joint in fitted.joints.items() if (block := _best_block(joint))}
        if not blocks:
            why = next((note for joint in fitted.joints.values() for note in joint.notes[-1:]), "no joint can be used")
            raise NotIdentifiable(why)

        def predict(others: Sequence[Episode]) -> Float64[np.ndarray, "T J"]:
            own = predict_graybox(others, fitted, chosen, blocks)
            result = np.full((len(own), len(robot.joints)), np.nan)
            result[:, robot.columns(tuple(fitted.joints))] = own
            return result

        return predict

    return learn


def graybox_of(
    train: Sequence[Episode], robot: TorqueRobot, settings: GrayboxSettings
) -> tuple[GrayboxResult, GrayboxSettings]:
    """The gray box of these motions, with the delay that fits them best, and the setting at which `K_p` holds."""
    train = [replace(item, meta=replace(item.meta, split="train")) for item in train]
    known = [item.meta.kp_setting for item in train if item.meta.kp_setting is not None]
    if settings.kp_setting is None and len(set(known)) > 1:
        settings = replace(settings, kp_setting=max(known))
    settings = replace(settings, delay_s=best_delay(spread(train), settings, joints=robot.judged))
    return fit_graybox(train, settings=settings, joints=robot.judged), settings


def _best_block(joint: JointFit) -> str:
    """The block with the least error on motions that were not fitted; the last one where there are too few motions."""
    fitted = [block for block in joint.blocks if not block.left_out]
    scored = [block for block in fitted if HELD_OUT in block.splits]
    if scored:
        return min(scored, key=lambda block: block.splits[HELD_OUT].rmse.value).block
    return fitted[-1].block if fitted else ""


def learn_dynamics(robot: TorqueRobot, settings: InverseDynamicsSettings) -> Learner:
    """Inverse dynamics with possible bodies near the model's; currents without a factor are scaled to its masses."""

    def learn(train: Sequence[Episode]) -> Prediction:
        fitted, cutoff_hz, factors = dynamics_of(train, robot, settings)
        linkage = Linkage(robot.model, robot.joints)
        rows = SampleSettings(smooth_torque=True, cutoff_hz=cutoff_hz)

        def predict(others: Sequence[Episode]) -> Float64[np.ndarray, "T J"]:
            samples = gather(others, rows, joints=robot.joints)
            torque = predict_inverse_dynamics(fitted, linkage, samples, epsilon=settings.epsilon)
            return np.asarray(torque / _per_unit(robot, factors))

        return predict

    return learn


def dynamics_of(
    train: Sequence[Episode], robot: TorqueRobot, settings: InverseDynamicsSettings
) -> tuple[InverseDynamicsFit, float, dict[str, Factor]]:
    """Inverse dynamics of these motions, the low-pass [Hz] that fits them best, and factors of currents."""
    train, factors = in_torque(robot, train)
    cutoff_hz = choose_cutoff(spread(train), robot.model, SampleSettings(smooth_torque=True), robot.joints)
    without = {*robot.unmeasured, *(set(robot.currents) - set(factors))}
    fitted = inverse_dynamics_from_episodes(
        train, robot.model, joints=robot.joints, unmeasured=without, cutoff_hz=cutoff_hz, settings=settings
    )
    return fitted, cutoff_hz, factors


def in_torque(robot: TorqueRobot, train: Sequence[Episode]) -> tuple[list[Episode], dict[str, Factor]]:
    """Motions whose currents are torques as far as the model's masses tell; zero where they do not."""
    if not robot.currents:
        return list(train), {}
    factors = factors_by_mass(train, robot.model, joints=robot.joints, wanted=robot.currents)
    values = {name: item.value for name, item in factors.items()}
    without = set(robot.currents) - set(factors)
    return [as_torque(item, "torque", values, unmeasured=without) for item in train], factors


def _per_unit(robot: TorqueRobot, factors: Mapping[str, Factor]) -> Float64[np.ndarray, "J"]:
    """Torque per unit in which each joint is judged; NaN where no torque can be told from its current."""
    value = {name: factors[name].value if name in factors else np.nan for name in robot.currents}
    value |= dict.fromkeys(robot.unmeasured, np.nan)
    return np.array([value.get(name, 1.0) for name in robot.joints])


def held_out_predictions(
    episodes: Sequence[Episode], folds: Sequence[tuple[Collection[str], Collection[str]]], learner: Learner
) -> dict[str, Float64[np.ndarray, "T J"]]:
    """Motion -> torque that is predicted for it by what was fitted to other motions.

    Args:
        episodes: all of them.
        folds: ids of motions to fit, and of those to predict.
        learner: see above.
    """
    result: dict[str, Float64[np.ndarray, "T J"]] = {}
    for fitted, others in folds:
        predict = learner([item for item in episodes if item.meta.id in fitted])
        held = [item for item in episodes if item.meta.id in others]
        ends = np.cumsum([len(item.measured) for item in held])
        parts = np.split(predict(held), ends[:-1])
        result |= {item.meta.id: part for item, part in zip(held, parts, strict=True)}
    return result


def unsigned_joints(episodes: Sequence[Episode], robot: TorqueRobot) -> dict[str, str]:
    """Joints whose torque looks like an absolute value beside that of the model, each with the reason.

    Where there is one, other torques that never change their sign are taken for absolute values, too.

    Raises:
        ConfigError: a joint is neither hinge nor slide.
    """
    some = spread(episodes)
    torque = gather(some, SampleSettings(), joints=robot.joints).torque
    told = model_torque(robot.model, gather(some, SampleSettings(smooth_torque=True), joints=robot.joints))
    found, one_sided = {}, []
    for joint, number in zip(robot.judged, robot.columns(robot.judged), strict=True):
        known = np.isfinite(torque[:, number]) & np.isfinite(told[:, number])
        own = torque[known, number]
        if own.size and (why := unsigned(own, told[known, number], "model's torque")):
            found[joint] = why
        elif own.size and (own.min() >= 0.0 or own.max() <= 0.0):
            one_sided.append(joint)
    if found:
        found |= dict.fromkeys(one_sided, f"the torque never changes its sign, as that of {next(iter(found))}")
    return found
