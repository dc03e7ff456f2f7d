"""Arms in MuJoCo with a network that makes them more like the robot: of what was learned from its logs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from trueup.core.model_card import ModelCard
from trueup.deploy.network import Network
from trueup.errors import ConfigError, NameMismatch
from trueup.policy.arms import MujocoArms

_STATE = ("position", "velocity")
_WHOLE = 1e-6


class AugmentedArms:
    """Arms whose simulator a network makes more like the robot.

    A network that corrects signals (`trueup augment train`) corrects what is read: the same as an
    `augment.ResidualSimulator` around each arm, with one run of the network for all. What is read of an arm is
    corrected by the sample at the beginning of the period that has passed; the physics goes on as if there were no
    network (Realeasy, II-B).

    A network that corrects commands (`trueup compensate train`, for the simulator) is asked at the beginning of each of
    its periods, and adds its delta actions to the torques (ASAP; GapONet).

    Args:
        arms: of MuJoCo, with control steps of one period of the network.
        network: an opened model folder, for these joints.
        control_s: control step of the arms as they are seen [s].

    Raises:
        ConfigError: a network that looks into the future or has other inputs or outputs, or whose periods do not make
            up a control step.
        NameMismatch: it is of a robot with other joints.
    """

    def __init__(self, arms: MujocoArms, network: Network, control_s: float) -> None:
        network = network.of_joints(arms.joints)
        card = network.card
        _refuse_unfit(card, arms)
        self._inner, self._network = arms, network
        self.count, self.control_s = arms.count, control_s
        self._samples = samples_of(card, control_s)
        if abs(arms.control_s * card.rate_hz - 1) > _WHOLE:
            raise ConfigError("arms step by the network's periods", got=arms.control_s, expected=1 / card.rate_hz)
        self._outputs = ["y", *(f"{state.name}_out" for state in card.states)]
        # Signal -> output, joint.
        self._places = {
            signal: np.array(
                [(k, arms.joints.index(o.joint)) for k, o in enumerate(card.outputs) if o.signal == signal]
            )
            for signal in dict.fromkeys(output.signal for output in card.outputs)
        }
        self._acts = "torque" in self._places
        self._x: Float32[np.ndarray, "N I"] = np.zeros((self.count, len(card.inputs)), np.float32)
        self._memory = {state.name: state.initial(self._each) for state in card.states}
        self._new = np.ones(self.count, bool)
        self._correction = {name: np.zeros((self.count, len(arms.joints))) for name in (*_STATE, "torque")}

    @property
    def joints(self) -> tuple[str, ...]:
        """See `Arms`."""
        return self._inner.joints

    @property
    def position(self) -> Float64[np.ndarray, "N J"]:
        """See `Arms`."""
        return self._inner.position + self._correction["position"]

    @property
    def velocity(self) -> Float64[np.ndarray, "N J"]:
        """See `Arms`."""
        return self._inner.velocity + self._correction["velocity"]

    def begin(self, rows: Int[np.ndarray, "R"], position: Float[np.ndarray, "R J"], rng: np.random.Generator) -> None:
        """See `Arms`; the network knows nothing of these arms' pasts."""
        self._inner.begin(rows, position, rng)
        self._new[rows] = True
        for values in self._correction.values():
            values[rows] = 0.0

    def step(self, torque: Float[np.ndarray, "N J"]) -> None:
        """See `Arms`."""
        inner = self._inner
        for _ in range(self._samples):
            read = {"position": inner.position, "velocity": inner.velocity}
            if self._acts:
                self._correct(read, torque)
                inner.step(torque + self._correction["torque"])
            else:
                inner.step(torque)
                self._correct({**read, "torque": inner.torque}, torque)

    @property
    def _each(self) -> Float32[np.ndarray, "M I"]:
        """What the network reads; the joints of a modular one stand side by side, like arms."""
        return self._x.reshape(self.count * self._network.card.copies, -1)

    def _correct(self, read: Mapping[str, Float[np.ndarray, "N J"]], torque: Float[np.ndarray, "N J"]) -> None:
        """The network over one sample of each arm: where it was, what its drives did from there on, what was asked."""
        card = self._network.card
        for number, channel in enumerate(card.inputs):
            if channel.series == "condition":  # nothing is carried
                continue
            source = torque if channel.series == "command" else read[channel.signal]
            self._x[:, number] = source[:, self.joints.index(channel.joint)]
        each = self._each
        if self._new.any():
            begun = np.flatnonzero(np.repeat(self._new, card.copies))
            for state in card.states:
                memory, fresh = (
                    np.moveaxis(v, state.batch_axis, 0) for v in (self._memory[state.name], state.initial(each))
                )
                memory[begun] = fresh[begun]
            self._new[:] = False
        y, *after = self._network.session.run(self._outputs, {"x": each[None], **self._memory})
        self._memory = {state.name: np.array(values) for state, values in zip(card.states, after, strict=True)}
        correction = y.reshape(self.count, -1) - self._x[:, card.base]
        for signal, places in self._places.items():
            self._correction[signal][:, places[:, 1]] = correction[:, places[:, 0]]
        if self._acts:
            # The engine would take such a torque for none, and nobody would know.
            mad = ~np.isfinite(self._correction["torque"]).all(axis=1)
            self._correction["torque"][mad] = 0.0
            self._correction["position"][mad] = np.nan


def samples_of(card: ModelCard, control_s: float) -> int:
    """Samples of a network in a control step.

    Raises:
        ConfigError: no whole number of them.
    """
    samples = control_s * card.rate_hz
    if round(samples) < 1 or abs(samples - round(samples)) > _WHOLE:
        raise ConfigError(
            f"control steps are no whole number of samples of the network {card.name!r}",
            got=f"{1 / control_s:g} Hz and {card.rate_hz:g} Hz",
            hint="Choose reach: {control_hz: ...} that divides the network's rate.",
        )
    return round(samples)


def _refuse_unfit(card: ModelCard, arms: MujocoArms) -> None:
    if strangers := [joint for joint in card.joints if joint not in arms.joints]:
        raise NameMismatch(
            f"the network {card.name!r} is of another robot",
            left=strangers,
            right=arms.joints,
            left_name="it has",
            right_name="robot has",
        )
    if not card.causal:
        raise ConfigError(
            f"the network {card.name!r} ({card.method}) looks into the future and cannot go step by step",
            hint="Take a causal one, e.g. of realeasy-rt.",
        )
    read = {(channel.series, channel.signal) for channel in card.inputs}
    written = {(channel.series, channel.signal) for channel in card.outputs}
    reading = written <= {("simulated", signal) for signal in _STATE}
    known = {*(("simulated", signal) for signal in _STATE), ("command", "torque")}
    known |= {("simulated", "torque")} if reading else {("condition", "payload")}
    if read - known or not (reading or written == {("command", "torque")}):
        raise ConfigError(
            f"the network {card.name!r} is not one for arms that take torques",
            got=sorted(".".join(pair) for pair in read | written),
            expected="corrected positions and velocities, or corrected torques",
            hint="Train it on logs of this robot with data: {signals: [position, velocity]}, or by compensate.",
        )
