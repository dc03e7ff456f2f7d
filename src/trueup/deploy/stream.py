"""A trained network inside a control loop: a sample in, a corrected sample out, and never a surprise.

Realeasy, Algorithms 2 and 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter_ns

import numpy as np
from jaxtyping import Float

from trueup.core.model_card import ModelCard
from trueup.deploy.agreement import check_causal, check_joints, check_rate, check_units
from trueup.deploy.cell import Cell
from trueup.deploy.intake import Intake
from trueup.deploy.latency import Latency
from trueup.deploy.network import Network
from trueup.deploy.settings import StreamSettings
from trueup.deploy.span import Span, index_of
from trueup.deploy.stall import Unrest, simulated_part
from trueup.deploy.step import Status, Step, Why
from trueup.errors import DataError, MissingSignal

# Share of each new period in the average of periods: about the last hundred samples.
_FORGET = 0.01
_ROUNDING = 1e-6
_NAN, _MISSED, _STALLED = int(Why.NAN), int(Why.MISSED), int(Why.STALLED)
_OUT_OF_RANGE, _OFF_RATE, _DIVERGED = int(Why.OUT_OF_RANGE), int(Why.OFF_RATE), int(Why.DIVERGED)


class Stream:
    """Corrects what a simulator says, one sample at a time.

    It refuses at once what can be known at once, and never raises because of a number afterwards: what is wrong with a
    sample stands in the answer, and `StreamSettings` says what counts as wrong. One control loop, one stream; it is
    not for several threads.

    Args:
        network: an opened model folder with a causal network.
        rate_hz: how often the loop will call it [Hz].
        joints: names of the joints of the arrays that it will be given, in their order.
        units: signal -> unit of all joints, or one per joint; None where everything is in SI.
        settings: when the network is trusted.

    Raises:
        ConfigError: another rate than the network's, or the network looks into the future.
        NameMismatch: other joints than the network's, or in another order.
        UnitError: other units than the network's.
        DataError: the network cannot be run.
    """

    def __init__(
        self,
        network: Network,
        *,
        rate_hz: float,
        joints: Sequence[str],
        units: Mapping[str, str | Sequence[str]] | None = None,
        settings: StreamSettings | None = None,
    ) -> None:
        # No more than thirty attributes: with more, each of them takes CPython longer to find, 0.1 us in a step.
        network = network.of_joints(joints)
        card = network.card
        check_causal(card)
        check_rate(card, rate_hz)
        check_joints(card, joints)
        if units is not None:
            check_units(card, units)
        self._card = card
        self._settings = settings = settings or StreamSettings()
        self._span = Span(card.inputs, card.margin if settings.margin is None else settings.margin)
        self._cell = Cell.of(network, compiled=settings.compiled)
        self._raw = np.zeros(len(card.inputs))
        self._base = index_of(card.base)
        self._values = np.full(len(card.outputs), np.nan)
        self._step = Step(card, self._values, self._raw, self._span)
        self._intake = Intake(card, self._raw)
        for place in self._intake.conditions.values():
            place.fill(math.nan)
        self._simulated = simulated_part(card.inputs, self._raw)
        self._unrest = Unrest(card.inputs, settings.moving_speed)
        self.latency = Latency()
        self._record = self.latency.record if settings.measure else None
        self._warmup = card.warmup_steps if settings.warmup_steps is None else settings.warmup_steps
        self._period_s = 1 / card.rate_hz
        # Stamps are sums and products of fractions: what is five periods shall not be a rounding error more.
        self._missed_s = settings.missed_periods * self._period_s * (1 + _ROUNDING)
        self._gap_s = settings.gap_periods * self._period_s * (1 + _ROUNDING)
        self._fastest_s = self._period_s * (1 - settings.rate_tolerance)
        self._slowest_s = self._period_s * (1 + settings.rate_tolerance)
        self._cell.rehearse(self._span.clipped(np.zeros_like(self._raw)).astype(np.float32))
        self.reset()

    @staticmethod
    def load(
        folder: Path | str,
        *,
        rate_hz: float,
        joints: Sequence[str],
        units: Mapping[str, str | Sequence[str]] | None = None,
        settings: StreamSettings | None = None,
    ) -> Stream:
        """Open a model folder; the errors are those of `Network.load` and `Stream`."""
        return Stream(Network.load(folder), rate_hz=rate_hz, joints=joints, units=units, settings=settings)

    @property
    def card(self) -> ModelCard:
        """What the network says of itself."""
        return self._card

    @property
    def latest(self) -> Step:
        """The answer to the latest sample."""
        return self._step

    def reset(self) -> None:
        """Forget everything but the latencies: what follows is as after the stream was made."""
        self._started = self._answered = False
        self._calm = False  # the sample before was an ordinary one, and so may be the next
        self._warming = self._warmup
        self._image = b""
        self._repeats = 0
        self._held = 0
        self._seen_s = self._good_s = math.nan
        self._mean_s = self._period_s
        self._values.fill(np.nan)
        self._step.status, self._step.flags, self._step.age_s = Status.HELD, 0, math.inf

    def under(self, **conditions: float) -> None:
        """Say what the motion is under, for networks that read it: e.g. `under(payload=2.0)` [kg].

        It holds until it is said otherwise. Before it is said it is not a number, and so is every answer held.

        Raises:
            MissingSignal: the network reads no such condition.
            DataError: not a number.
        """
        places = self._intake.conditions
        for name, value in conditions.items():
            if name not in places:
                raise MissingSignal(
                    f"model {self._card.name!r} reads no condition {name!r}",
                    available=places or None,
                    hint=f"Leave {name} out: what the network says does not depend on it.",
                )
            if not math.isfinite(value):
                raise DataError(f"condition {name!r} of model {self._card.name!r}", got=value, expected="a number")
            places[name][:] = value
        self._calm = False

    def step(
        self,
        simulated: Mapping[str, Float[np.ndarray, "J"]],
        command: Mapping[str, Float[np.ndarray, "J"]] | None = None,
        measured: Mapping[str, Float[np.ndarray, "J"]] | None = None,
        *,
        time_s: float | None = None,
    ) -> Step:
        """Correct the next sample.

        Args:
            simulated: signal -> values of all joints of the loop, SI, (J,). Signals that the network does not read are
                not looked at.
            command: likewise, what the simulator was asked for; for networks that read it.
            measured: likewise, what the sensors said in the sample before, in the first one what is simulated; for
                networks that read it.
            time_s: when the sample was made [s], on any clock that goes on steadily. Without it, samples that are
                missing and a rate that is wrong are not seen.

        Returns:
            The stream's one answer object, overwritten by the next call.

        Raises:
            MissingSignal: a signal that the network reads is not given.
            DataError: an array has another length than there are joints, or holds no numbers.
        """
        began = perf_counter_ns()
        self._intake.fill(simulated, command, measured)
        answer = self._advance(time_s)
        if self._record is not None:
            self._record(perf_counter_ns() - began)
        return answer

    def step_vector(self, x: Float[np.ndarray, "I"], *, time_s: float | None = None) -> Step:
        """`step` for loops that keep all input channels in one vector, in the card's order, SI, (I,).

        Raises:
            DataError: its length is another, or it holds no numbers.
        """
        began = perf_counter_ns()
        if len(x) != self._raw.size:
            raise DataError(
                f"the input of model {self._card.name!r}", got=f"{len(x)} channels", expected=f"{self._raw.size}"
            )
        try:
            self._raw[...] = x
        except (TypeError, ValueError) as error:
            raise DataError(
                f"the input of model {self._card.name!r}", got=error, expected=f"{self._raw.size} numbers"
            ) from error
        answer = self._advance(time_s)
        if self._record is not None:
            self._record(perf_counter_ns() - began)
        return answer

    def poll(self, time_s: float) -> Step:
        """The answer when no sample has come; for loops whose samples come from elsewhere.

        Call it at the times at which the loop needs a value; it holds and says so as soon as a sample is missing. It
        needs the times of the samples: without `time_s` in the steps, nothing is ever missing.

        Args:
            time_s: now, on the clock of the samples [s]. If it is not finite, nobody knows whether a sample is missing:
                the answer is held.
        """
        if not math.isfinite(time_s):
            return self._hold(_NAN, None)
        since = time_s - self._seen_s
        if since > self._missed_s:
            return self._hold(_MISSED | (_STALLED if since > self._gap_s else 0), time_s)
        return self._step

    def _advance(self, time_s: float | None) -> Step:
        """An ordinary sample after an ordinary one, in as few operations as can be; all else is `_careful`."""
        raw = self._raw
        image = self._simulated.tobytes()
        if time_s is None:
            timely, mean_s, seen_s = True, self._period_s, math.nan
        else:
            gap_s = time_s - self._seen_s
            mean_s, seen_s = self._mean_s + _FORGET * (gap_s - self._mean_s), time_s
            timely = 0.0 < gap_s <= self._missed_s and self._fastest_s < mean_s < self._slowest_s
        if not (self._calm and timely and image != self._image and self._span.covers(raw)):
            return self._careful(image, time_s)
        self._image, self._repeats, self._mean_s = image, 0, mean_s
        self._seen_s = self._good_s = seen_s
        cell = self._cell
        cell.x[...] = raw
        if not cell.run():
            return self._judged(_DIVERGED)
        self._values[...] = cell.y
        return self._step

    def _careful(self, image: bytes, time_s: float | None) -> Step:
        """Any sample at any time."""
        if time_s is not None and not math.isfinite(time_s):
            return self._hold(_NAN, None)
        flags = self._timed(time_s)
        if flags & _STALLED:
            return self._hold(flags, time_s)
        raw = self._raw
        covered = self._span.covers(raw)
        if not covered and not np.isfinite(raw).all():
            return self._hold(flags | _NAN, time_s)
        inside = raw if covered else self._span.clipped(raw)
        if image != self._image:
            self._image, self._repeats = image, 0
        else:
            # What is in the cell is the latest sample that was used: the short way keeps no commands.
            self._unrest.repeated(self._cell.x, inside, first=self._repeats == 0)
            self._repeats += 1
            if self._repeats > self._settings.stalled_steps and self._unrest.moves(raw):
                return self._hold(flags | _STALLED, time_s)
        self._cell.x[:] = inside
        if not self._started:
            self._started, self._warming = True, self._warmup
            self._cell.start()
        if not self._cell.run():
            flags |= _DIVERGED
        if not covered:
            flags |= _OUT_OF_RANGE
        self._good_s, self._held = self._seen_s, 0
        return self._judged(flags)

    def _timed(self, time_s: float | None) -> int:
        """What is wrong with the time of a sample; after too long without a usable one, begin anew."""
        flags = 0
        unusable_s = (self._held + 1) * self._period_s
        if time_s is None:
            self._seen_s = math.nan
        else:
            gap_s = time_s - self._seen_s  # NaN, and thus nothing below, if the sample before had no time
            if -self._gap_s <= gap_s <= 0.0:
                return _STALLED
            if 0.0 < gap_s <= self._gap_s:
                self._mean_s += _FORGET * (gap_s - self._mean_s)
                if not self._fastest_s < self._mean_s < self._slowest_s:
                    flags |= _OFF_RATE
            if gap_s > self._missed_s:
                flags |= _MISSED
            self._seen_s = time_s
            if not math.isnan(self._good_s):
                # A clock that was set back by so much is that of a simulation that was begun again.
                unusable_s = abs(time_s - self._good_s)
        if unusable_s > self._gap_s:
            self._started, self._mean_s = False, self._period_s
        return flags

    def _judged(self, flags: int) -> Step:
        """The answer to a sample that the network has seen."""
        step = self._step
        if flags & _DIVERGED:
            self._started = False
        if flags & (_OUT_OF_RANGE | _OFF_RATE | _DIVERGED):
            self._warming = self._warmup
            step.status = Status.FALLBACK
        elif self._warming:
            self._warming -= 1
            step.status = Status.WARMING
        else:
            step.status = Status.OK
        if step.status is Status.OK or (step.status is Status.WARMING and self._settings.correct_while_warming):
            self._values[:] = self._cell.y
        else:
            self._values[:] = self._raw[self._base]
        step.flags, step.age_s = flags, 0.0
        self._answered = True
        self._calm = step.status is Status.OK and not flags
        return step

    def _hold(self, flags: int, time_s: float | None) -> Step:
        """The answer to a sample that is of no use: the one before, marked."""
        self._held += 1
        self._calm = False
        age_s = self._held * self._period_s
        if time_s is not None and time_s > self._good_s:
            age_s = time_s - self._good_s
        step = self._step
        step.status, step.flags = Status.HELD, flags
        step.age_s = age_s if self._answered else math.inf
        return step
