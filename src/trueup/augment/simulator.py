"""A simulator whose signals a trained network corrects; a Simulator again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from trueup.augment.correction import refuse_other_joints
from trueup.core.model_card import Channel, ModelCard
from trueup.core.protocols import RolloutRequest, RolloutResult, Simulator
from trueup.deploy import Network, Predictor
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.errors import ConfigError, DataError, MissingSignal, UnitError

# What a Simulator says of itself, and in which units: angles and torques, or lengths and forces of sliding joints.
_UNITS = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "torque": ("Nm", "N")}
# Of these, states, between whose rows one may interpolate; torque jumps with the command.
_STATE = ("position", "velocity")
# Samples this near to a physics row are on it; share of a physics step, as when a replay reads at its stamps.
_SAME_ROW = 1e-6


class ResidualSimulator:
    """Any simulator, read through a network that corrects what it says.

    The physics inside goes on as if there were no network: its state is never set to what the network says (Realeasy,
    II-B and VI: no hard-setting, so no jumps and no collisions that it would make). What is read of it is corrected.
    A controller that acts on what it reads feels the correction; the links do not.

    The network sees samples of its own rate, `card.rate_hz`, counted from the start. A physics step need not divide
    their period: position and velocity are interpolated between the physics rows around a sample, and the torque, the
    command too, is the one acting then. These are the inputs of `augment.correction.corrected` on a replay. The first
    sample is the start itself.

    Between samples the correction is held. The torque that acts from row k to k + 1 depends on the command of that
    step, so `step` knows it only when it returns row k + 1, and so it is with the samples of this step. One rule for
    `step` and `rollout`, so that both say the same: **what a physics step returns, position and velocity after it and
    torque in it, is corrected by the latest sample that lies before its end.** Torque that is read at a sample has that
    sample's correction; position and velocity on the very row of a sample still have that of the sample before.

    A network that looks into the future corrects whole motions only: `rollout` interpolates its correction linearly
    between the samples, and `reset` and `step` refuse.

    Whether inputs are inside of the training range is not looked at; `deploy.Stream` does that beside a robot.

    Args:
        simulator: with a robot in it that has the network's joints, in any order, and perhaps others.
        network: an opened model folder.
        warmup: leave the first `card.warmup_steps` samples after a start uncorrected, as a control loop does while the
            state of the network knows too little. False corrects at once: motions start at rest, where little is to be
            known.

    Raises:
        NameMismatch: joints of the network are not in the simulator; both lists are printed.
        MissingSignal: the network reads or corrects a signal that no simulator has.
        UnitError: in another unit than SI.
        ConfigError: the network wants more samples per second than the simulator has steps.
    """

    def __init__(self, simulator: Simulator, network: Network, *, warmup: bool = False) -> None:
        network = network.of_joints(simulator.joints)
        card = network.card
        refuse_other_joints(simulator.joints, card, "the simulator")
        _refuse_other_signals(card)
        _refuse_slower(simulator.timestep_s, card)
        self._inner = simulator
        self._network = network
        self._predictor = Predictor(network)
        self._withheld = card.warmup_steps if warmup else 0
        self._sources = _grouped(card.inputs, simulator.joints)
        self._targets = _grouped(card.outputs, simulator.joints)
        self._steps_per_sample = 1.0 / (card.rate_hz * simulator.timestep_s)
        self._copies: _Copies | None = None

    @property
    def card(self) -> ModelCard:
        """What the network says of itself."""
        return self._network.card

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J controlled joints, as the simulator inside has them."""
        return self._inner.joints

    @property
    def timestep_s(self) -> float:
        """Physics step [s]."""
        return self._inner.timestep_s

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Command signals that the controller follows, the first is required; then others that the network reads."""
        return tuple(dict.fromkeys((*self._inner.command_signals, *self._commands_read)))

    def rollout(self, request: RolloutRequest) -> RolloutResult:
        """Simulate B motions of N steps and correct them, all at once.

        Row 0, the initial state, is corrected by the first sample. A command channel of the network is the command as
        the request has it: if that is delayed, the network sees it delayed.

        Raises:
            MissingSignal: the controller or the network needs a signal that the command lacks.
            DataError: a motion diverged, or the network's output is not finite.
        """
        self._refuse_missing(request.command)
        result = self._inner.rollout(request)
        signals = {name: getattr(result, name) for name in _UNITS}
        steps = result.position.shape[1] - 1
        row, share = self._samples(steps)
        commands = {name: values[:, row] for name, values in request.command.items()}
        with np.errstate(over="ignore", invalid="ignore"):  # what diverged is refused below, by name
            between = {name: _between(signals[name][:, row], signals[name][:, row + 1], share) for name in _STATE}
            x = np.swapaxes(self._read({**between, "torque": signals["torque"][:, row]}, commands), 0, 1)
        correction = self._predictor.run(x) - x[..., self.card.base]
        self._refuse_not_finite(correction)
        correction[: self._withheld] = 0.0
        self._add(signals, self._at_rows(np.swapaxes(correction, 0, 1), row, steps))
        return replace(result, **signals)

    def reset(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> None:
        """Put B independent copies of the robot into these states, at time 0; each has a network state of its own.

        Raises:
            ConfigError: the network looks into the future.
        """
        self._refuse_future()
        self._inner.reset(position, velocity)
        self._copies = _Copies(
            {"position": np.array(position), "velocity": np.array(velocity)},
            np.zeros((len(position), len(self.card.outputs)), np.float32),
            self._place(0),
        )

    def step(self, command: Mapping[str, Float[np.ndarray, "B J"]]) -> dict[str, Float[np.ndarray, "B J"]]:
        """Advance every copy by one physics step, and run the network if a sample is due.

        A copy that diverged stays NaN, and the others stand.

        Returns:
            `position` and `velocity` after the step and `torque` during it, corrected, each (B, J).

        Raises:
            ConfigError: the network looks into the future.
            MissingSignal: the controller or the network needs a signal that the command lacks.
            DataError: `reset` was not called.
        """
        self._refuse_future()
        copies = self._copies
        if copies is None:
            raise DataError("step before reset", hint="Call reset(position, velocity) first.")
        self._refuse_missing(command)
        after = dict(self._inner.step(dict(command)))
        with np.errstate(over="ignore", invalid="ignore"):  # a copy that diverged
            while copies.due[0] <= copies.steps:
                between = {name: _between(copies.state[name], after[name], copies.due[1]) for name in _STATE}
                self._run(copies, self._read({**between, "torque": after["torque"]}, command))
        copies.steps += 1
        copies.state = {name: np.array(after[name]) for name in _STATE}
        self._add(after, dict.fromkeys(_UNITS, copies.correction))
        return after

    def _run(self, copies: _Copies, x: Float32[np.ndarray, "B I"]) -> None:
        """The network over one sample of each copy."""
        card = self.card
        # The joints of a modular network stand side by side, like copies.
        own = x.reshape(len(x) * card.copies, -1)
        if copies.samples == 0:
            copies.memory = {state.name: state.initial(own) for state in card.states}
        names = ["y", *(f"{state.name}_out" for state in card.states)]
        y, *memory = self._network.session.run(names, {"x": own[None], **copies.memory})
        copies.memory = {state.name: values for state, values in zip(card.states, memory, strict=True)}
        if copies.samples >= self._withheld:
            copies.correction = y.reshape(len(x), -1) - x[:, card.base]
        copies.samples += 1
        copies.due = self._place(copies.samples)

    def _place(self, sample: int) -> tuple[int, float]:
        """The physics row before a sample, and how far the sample is from there to the next."""
        place = sample * self._steps_per_sample
        row = math.floor(place + _SAME_ROW)
        return row, place - row if place - row >= _SAME_ROW else 0.0

    def _samples(self, steps: int) -> tuple[Int[np.ndarray, "T"], Float64[np.ndarray, "T"]]:
        """Row and share of all samples of a motion: those before its end, or up to it for a network that sees it."""
        places = [self._place(sample) for sample in range(int(steps / self._steps_per_sample) + 2)]
        row = np.array([row for row, _ in places])
        share = np.array([share for _, share in places])
        if self.card.causal:
            seen = row < steps
            return row[seen], share[seen]
        seen = row + share <= steps
        last = np.minimum(row[seen], steps - 1)
        return last, share[seen] + (row[seen] - last)

    def _at_rows(
        self, correction: Float32[np.ndarray, "B T K"], row: Int[np.ndarray, "T"], steps: int
    ) -> dict[str, Float[np.ndarray, "B N1 K"]]:
        """The correction of each signal at the N + 1 rows of a motion."""
        ticks = np.arange(steps + 1)
        if self.card.causal:
            # What step k - 1 returns is row k of the states, and row k - 1 of the torque.
            known = np.searchsorted(row, np.maximum(ticks - 1, 0), side="right") - 1
            states = correction[:, known]
            torque = np.concatenate([states[:, 1:], states[:, -1:]], axis=1)
        else:
            place = ticks / self._steps_per_sample
            before = np.minimum((place + _SAME_ROW).astype(np.int64), len(row) - 1)
            after = np.minimum(before + 1, len(row) - 1)
            states = _between(correction[:, before], correction[:, after], np.clip(place - before, 0.0, 1.0))
            torque = np.concatenate([states[:, :-1], states[:, -2:-1]], axis=1)
        return {"position": states, "velocity": states, "torque": torque}

    def _read(
        self, simulated: Mapping[str, Float[np.ndarray, "*rest J"]], command: Mapping[str, Float[np.ndarray, "*rest J"]]
    ) -> Float32[np.ndarray, "*rest I"]:
        """The network's inputs, in its order."""
        series = {"simulated": simulated, "command": command}
        shape = simulated["position"].shape[:-1]
        x = np.empty((*shape, len(self.card.inputs)), np.float32)
        for group in self._sources:
            x[..., group.numbers] = series[group.series][group.signal][..., group.columns]
        return x

    def _add(
        self, signals: dict[str, Float[np.ndarray, "*rest J"]], correction: Mapping[str, Float[np.ndarray, "*rest K"]]
    ) -> None:
        """Corrected signals in place of the simulator's own; the arrays that it gave away stay as they are."""
        for group in self._targets:
            values = np.array(signals[group.signal])
            values[..., group.columns] += correction[group.signal][..., group.numbers]
            signals[group.signal] = values

    @property
    def _commands_read(self) -> tuple[str, ...]:
        """Command signals among the network's inputs."""
        return tuple(group.signal for group in self._sources if group.series == "command")

    def _refuse_missing(self, command: Mapping[str, object]) -> None:
        for signal in self._commands_read:
            if signal not in command:
                raise MissingSignal(
                    f"the network {self.card.name!r} reads the command {signal!r}, which is not given",
                    available=command,
                )

    def _refuse_future(self) -> None:
        if not self.card.causal:
            raise ConfigError(
                f"the network {self.card.name!r} ({self.card.method}) looks into the future and cannot go step by step",
                hint="rollout corrects whole motions with it. For steps take a causal one, e.g. of realeasy-rt.",
            )

    def _refuse_not_finite(self, correction: Float32[np.ndarray, "T B K"]) -> None:
        bad = ~np.isfinite(correction)
        if bad.any():
            sample, motion, output = (int(number) for number in np.argwhere(bad)[0])
            raise DataError(
                f"an output of {self.card.name!r} is not finite",
                got=f"{self.card.outputs[output].name} at {sample / self.card.rate_hz:.3f} s of motion {motion}",
            )


@dataclass(eq=False)
class _Copies:
    """Where B copies are, and what their network remembers.

    Attributes:
        state: position and velocity before the next step, uncorrected, each (B, J).
        correction: of the latest sample, (B, K).
        due: where the next sample lies: the physics row before it, and the share of a step from there.
        steps: physics steps so far.
        samples: samples that the network has seen.
        memory: its states.
    """

    state: dict[str, np.ndarray]
    correction: Float32[np.ndarray, "B K"]
    due: tuple[int, float]
    steps: int = 0
    samples: int = 0
    memory: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Group:
    """Channels of one signal: their numbers in the card, and the columns of their joints in the simulator."""

    series: str
    signal: str
    numbers: Int[np.ndarray, "C"]
    columns: Int[np.ndarray, "C"]


def _grouped(channels: Sequence[Channel], joints: Sequence[str]) -> list[_Group]:
    groups: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for number, channel in enumerate(channels):
        groups.setdefault((channel.series, channel.signal), []).append((number, joints.index(channel.joint)))
    return [_Group(*key, *np.array(pairs).T) for key, pairs in groups.items()]


def _between(
    before: Float[np.ndarray, "*rest C"], after: Float[np.ndarray, "*rest C"], share: Float64[np.ndarray, "T"] | float
) -> Float[np.ndarray, "*rest C"]:
    """Linear interpolation; `share` is one number, or one per row, (T,)."""
    share = np.asarray(share)[..., None]
    # 0 * (inf - inf) is NaN: a row that is hit exactly must not feel its neighbor.
    return np.asarray(np.where(share == 0.0, before, before + share * (after - before)))


def _refuse_other_signals(card: ModelCard) -> None:
    """A simulator has these signals, in SI; commands are the caller's."""
    channels: tuple[Channel, ...] = (*card.inputs, *card.outputs)
    for channel in channels:
        if channel.series == "measured":
            raise ConfigError(
                f"the network {card.name!r} reads a robot's sensors, and a simulator has none",
                got=channel.name,
                expected="a network without data: measured",
                hint="Beside a robot, give the readings to a Stream.",
            )
        if channel.series == "simulated" and channel.signal not in _UNITS:
            raise MissingSignal(
                f"the network {card.name!r} needs {channel.signal!r}, which no simulator has", available=_UNITS
            )
        allowed = _UNITS.get(channel.signal)
        if allowed and channel.unit not in allowed:
            raise UnitError(
                f"the network {card.name!r}: {channel.name}", got=channel.unit, expected=" or ".join(allowed)
            )


def _refuse_slower(timestep_s: float, card: ModelCard) -> None:
    if 1.0 / timestep_s < card.rate_hz * (1.0 - RATE_TOLERANCE):
        raise ConfigError(
            f"the simulator has too few steps per second for the network {card.name!r}",
            got=f"{1.0 / timestep_s:g} steps of {timestep_s:g} s",
            expected=f"at least {card.rate_hz:g}",
            hint="Take a smaller simulation.timestep_s in robot.yaml, or train a network at this rate.",
        )
