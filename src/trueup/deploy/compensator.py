"""A learned compensation inside a control loop: the next command, corrected within limits; and never a surprise.

GapONet, 4.3: what is sent is the target plus a delta action. Here the delta action is bounded in size and in change,
and their sum by what the robot may be commanded. Whatever goes wrong, it fades out and the target goes on alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.model_card import Input, ModelCard
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.deploy.compensator_settings import CompensatorSettings, Limits
from trueup.deploy.latency import Latency
from trueup.deploy.network import Network
from trueup.deploy.settings import StreamSettings
from trueup.deploy.step import Status, Why
from trueup.deploy.stream import Stream
from trueup.errors import ConfigError, DataError, MissingSignal

_PAYLOAD = "payload"
# Ranges of training are those of float32.
_ROUNDING = 1e-6
_LIMITED, _TARGET = int(Why.LIMITED), int(Why.TARGET)
_OUTSIDE, _UNKNOWN = int(Why.PAYLOAD), int(Why.NO_PAYLOAD)


class Compensated:
    """The answer to the latest target; a compensator has one, and every step overwrites it.

    Attributes:
        target: what to command, (J,) [rad or m], not to be written to; NaN only for a joint that has never had a target
            nor a position that was a number.
        delta: what it is beyond the target as the robot may be commanded it, before their sum is cut to the robot's
            limits, (J,).
        status: OK where the network's correction is on its way in; else it is on its way out.
        flags: `why` as a plain number.
    """

    __slots__ = ("delta", "flags", "status", "target")

    def __init__(self, target: Float64[np.ndarray, "J"], delta: Float64[np.ndarray, "J"]) -> None:
        self.target, self.delta = target.view(), delta.view()
        self.target.flags.writeable = self.delta.flags.writeable = False
        self.status = Status.HELD
        self.flags = 0

    @property
    def why(self) -> Why:
        """What is wrong; `Why.NONE` if nothing is."""
        return Why(self.flags)


class Compensator:
    """Adds to the targets of a control loop what a trained compensation says that they lack.

    A loop may be a whole number of times as fast as the network: it is asked every so many targets, and what it says is
    approached along a straight line in between. Limits of changes are those per second at the rate that was promised.

    It refuses at once what can be known at once; afterwards it raises for arrays of wrong shapes only.

    Args:
        stream: of a model folder that corrects commanded positions of all joints.
        limits: what the robot may be commanded; no command leaves them, whatever its target was.
        loop_hz: how often `step` will be called [Hz]; None for the network's own rate.
        settings: how far the network is trusted.
        payload_kg: what the robot carries [kg]; None where it is not known yet: without, and a network that reads it,
            nothing is corrected until `carry` says it.

    Raises:
        ConfigError: the loop is no whole number of times as fast as the network, limits are of another robot, or the
            network corrects something else.
        DataError: a payload that is none.
        MissingSignal: a payload, and the network reads none.
    """

    def __init__(
        self,
        stream: Stream,
        *,
        limits: Limits,
        loop_hz: float | None = None,
        settings: CompensatorSettings | None = None,
        payload_kg: float | None = None,
    ) -> None:
        card = stream.card
        count = len(card.joints)
        if [(o.series, o.signal, o.joint) for o in card.outputs] != [("command", "position", j) for j in card.joints]:
            raise ConfigError(
                f"model {card.name!r} corrects no commands",
                got=[output.name for output in card.outputs],
                expected="the commanded position of each joint",
            )
        if len(limits.low) != count:
            raise ConfigError("limits of another robot", got=f"{len(limits.low)} joints", expected=f"{count}")
        self.every = calls_per_step(card, card.rate_hz if loop_hz is None else loop_hz)
        self._stream, self._settings = stream, settings or CompensatorSettings()
        period_s = 1.0 / card.rate_hz / self.every
        self.largest, rate = self._settings.sizes(card)
        self._change = rate * period_s
        self._low, self._high = np.array(limits.low, float), np.array(limits.high, float)
        self._command_change = None if limits.rate is None else np.array(limits.rate) * period_s
        self._out, self._delta = np.full(count, np.nan), np.zeros(count)
        self._nominal, self._asked, self._wanted = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count)
        self._answer = Compensated(self._out, self._delta)
        self._payload = next((i for i in card.inputs if i.series == "condition" and i.signal == _PAYLOAD), None)
        self._carrying = 0
        if self._payload is not None:
            self._carrying = _UNKNOWN
            # Some payload, so that the history is there when the true one becomes known.
            stream.under(payload=_nearest(self._payload, 0.0))
        if payload_kg is not None:
            self.carry(payload_kg)
        self.reset()

    @staticmethod
    def load(
        folder: Path | str,
        *,
        joints: Sequence[str],
        limits: Limits,
        loop_hz: float | None = None,
        settings: CompensatorSettings | None = None,
        payload_kg: float | None = None,
        stream: StreamSettings | None = None,
    ) -> Compensator:
        """Open a model folder; the errors are those of `Network.load`, `Stream` and `Compensator`.

        Args:
            folder: of a compensation.
            joints: of the loop's arrays, in their order.
            limits: see the class.
            loop_hz: see the class.
            settings: see the class.
            payload_kg: see the class.
            stream: when the network's answers count.
        """
        network = Network.load(folder)
        rate_hz = network.card.rate_hz
        if loop_hz is not None:
            rate_hz = loop_hz / calls_per_step(network.card, loop_hz)
        made = Stream(network, rate_hz=rate_hz, joints=joints, settings=stream)
        return Compensator(made, limits=limits, loop_hz=loop_hz, settings=settings, payload_kg=payload_kg)

    @property
    def card(self) -> ModelCard:
        """What the network says of itself."""
        return self._stream.card

    @property
    def latest(self) -> Compensated:
        """The answer to the latest target."""
        return self._answer

    @property
    def latency(self) -> Latency:
        """How long the network's own steps took."""
        return self._stream.latency

    def reset(self) -> None:
        """Forget targets, corrections and history, as when the robot was stopped; the payload stays."""
        self._stream.reset()
        for values in (self._out, self._nominal, self._asked):
            values.fill(np.nan)
        self._delta.fill(0.0)
        self._wanted.fill(0.0)
        self._turn = self._said = 0
        self._answer.status, self._answer.flags = Status.HELD, 0

    def carry(self, payload_kg: float) -> None:
        """Say what the robot carries from now on [kg]; the correction changes no faster than ever.

        Raises:
            MissingSignal: the network reads no payload.
            DataError: a payload that is none.
        """
        if self._payload is None:
            raise MissingSignal(f"model {self.card.name!r} reads no payload", hint="Leave the payload out.")
        if not 0 <= payload_kg < math.inf:
            raise DataError("a payload", got=f"{payload_kg} kg", expected=">= 0 kg")
        nearest = _nearest(self._payload, payload_kg)
        self._carrying = 0 if abs(nearest - payload_kg) <= _ROUNDING * max(1.0, nearest) else _OUTSIDE
        self._stream.under(payload=payload_kg if self._settings.outside == "keep" else nearest)

    def step(
        self,
        position: Float[np.ndarray, "J"],
        velocity: Float[np.ndarray, "J"],
        target: Float[np.ndarray, "J"],
        *,
        time_s: float | None = None,
    ) -> Compensated:
        """Correct the next target.

        Args:
            position: what the sensors say (of the robot, or of the simulator that is to move like one), (J,).
            velocity: likewise.
            target: where the joints are wanted, (J,) [rad or m].
            time_s: when that was [s], on any clock that goes on steadily. Without it, a loop that is late or at
                another rate is not seen.

        Returns:
            The compensator's one answer object, overwritten by the next call.

        Raises:
            DataError: an array has another length than there are joints, or holds no numbers.
        """
        answer, delta = self._answer, self._delta
        here, moving = self._array(position, "position"), self._array(velocity, "velocity")
        flags = self._take(self._array(target, "target"), here)
        if self._turn == 0:
            self._said = self._ask(here, moving, time_s)
        way = (self._wanted - delta) / (self.every - self._turn)
        self._turn = (self._turn + 1) % self.every
        change = np.clip(way, -self._change, self._change)
        limited = (change != way).any()
        delta += change
        if self._command_change is not None:
            # Where the target moves as fast as it may, what it lacks must wait. The delta of before is always allowed.
            room = self._asked - self._nominal
            held = np.fmin(np.fmax(delta, room - self._command_change), room + self._command_change)
            limited |= (held != delta).any()
            delta[:] = held
        np.clip(delta, -self.largest, self.largest, out=delta)
        np.add(self._nominal, delta, out=self._asked)
        np.clip(self._asked, self._low, self._high, out=self._out)
        limited |= (self._out != self._asked).any()
        answer.flags = flags | self._said | (_LIMITED if limited else 0)
        return answer

    def _take(self, target: Float64[np.ndarray, "J"], position: Float64[np.ndarray, "J"]) -> int:
        """The target as the robot may be commanded it; where it is none, the one before, at first the position."""
        nominal = self._nominal
        before = np.where(np.isnan(nominal), np.where(np.isfinite(position), position, np.nan), nominal)
        allowed = np.clip(np.where(np.isfinite(target), target, before), self._low, self._high)
        if self._command_change is not None:
            allowed = np.fmin(np.fmax(allowed, nominal - self._command_change), nominal + self._command_change)
        nominal[:] = allowed
        return 0 if (allowed == target).all() else _TARGET

    def _ask(self, position: Float64[np.ndarray, "J"], velocity: Float64[np.ndarray, "J"], time_s: float | None) -> int:
        """What the network wants to add; nothing where it is not to be trusted. Returns what is wrong."""
        answer, wanted = self._answer, self._wanted
        said = self._stream.step(
            {"position": position, "velocity": velocity}, {"position": self._nominal}, time_s=time_s
        )
        flags, answer.status = said.flags | self._carrying, said.status
        off = self._carrying == _UNKNOWN or (self._carrying == _OUTSIDE and self._settings.outside == "off")
        if off and answer.status is Status.OK:
            answer.status = Status.FALLBACK
        if answer.status is not Status.OK:
            wanted.fill(0.0)
            return flags
        np.subtract(said.values, self._nominal, out=wanted)
        if (np.abs(wanted) > self.largest).any():
            np.clip(wanted, -self.largest, self.largest, out=wanted)
            flags |= _LIMITED
        return flags

    def _array(self, values: Any, what: str) -> Float64[np.ndarray, "J"]:
        try:
            array = np.asarray(values, np.float64)
        except (TypeError, ValueError) as error:
            raise DataError(f"the {what} of a compensator", got=error, expected="numbers") from error
        if array.shape != self._delta.shape:
            expected = f"one number for each of {self._delta.size} joints"
            raise DataError(f"the {what} of a compensator", got=f"shape {array.shape}", expected=expected)
        return array


def calls_per_step(card: ModelCard, loop_hz: float) -> int:
    """How many targets of a loop there are for each step of the network.

    Raises:
        ConfigError: it is no whole number.
    """
    ratio = loop_hz / card.rate_hz if math.isfinite(loop_hz) else 0.0
    every = round(ratio)
    if every < 1 or abs(ratio / every - 1) > RATE_TOLERANCE:
        raise ConfigError(
            f"model {card.name!r} fits no loop of this rate",
            got=f"{loop_hz:g} Hz",
            expected=f"a whole multiple of {card.rate_hz:g} Hz",
            hint=f"Run the loop at {max(every, 1) * card.rate_hz:g} Hz, or train a network for your rate.",
        )
    return every


def _nearest(channel: Input, payload_kg: float) -> float:
    return min(max(payload_kg, channel.low), channel.high)
