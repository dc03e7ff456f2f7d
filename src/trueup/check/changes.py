"""What may be wrong with how a log is read: kinds of changes, each a function that proposes some.

A proposal is a reading and what it says. Whether it is true is not judged here: `search.py` compares readings.
A new kind is one function and one line in `KINDS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from trueup.check.evidence import ZERO, Evidence, Score, loss
from trueup.check.reading import Columns, Reading, Side, Unit, units_of
from trueup.check.setting import listed

# A servo whose error is larger than this share of its motion does not follow its command.
LOST = 0.15
# The model explains less than this of what it should explain.
_UNEXPLAINED = 0.8
# A relation between two columns that explains this much is one.
_RELATED = 0.85
_MOST_PAIRS, _MOST_SUSPECTS = 120, 12
# An order of all joints is looked for where so many are puzzling; each swap has to be worth so much.
_FEWEST_PUZZLING, _WORTH_A_SWAP = 3, 0.3
# A factor within this of a unit's is that unit's: a soft servo moves less than it is told. Within these it is soft.
_NEAR_UNIT, _SOFT = 0.15, (0.7, 1.4)
# A joint is out of its range for this share of the time, and in it where it is out for less; what a mirrored joint
# beside a unit has to be better by.
_OUTSIDE, _INSIDE, _EACH_MIRRORED = 0.3, 0.05, 0.5
# Mirrored joints are looked for together among so many; each turn has to be worth so much.
_MOST_MIRRORED, _WORTH_A_TURN = 8, 0.3
# Units that few logs have, and what one of them has to be better by.
_RARELY, _RARE, _COUNTS = ("mrad", "rev", "cm"), 1.5, "encoder counts"
# How far the measured velocity may be from the derivative of the position.
_SAME_RATE, _OTHER_RATE = 0.05, 1.0
# What a factor that is none of a unit has to be better by.
_ANY_FACTOR = 1.5
_QUARTER = 0.5 * math.pi
# Zeros that are tried besides quarters and eighths of a turn [rad], how they are looked for from there, and what such
# a one has to be better by; gears of both series; and by how much what is left has to fall for it (of the logarithm).
_ZEROS: tuple[float, ...] = (-1.3, -1.0, -0.6, -0.3, 0.3, 0.6, 1.0, 1.3)
_FINER, _ANY_ZERO = (0.15, 0.08, 0.04, 0.02), 1.2
_GEARS, _PROMISING = (1.0, 0.8, 0.5, 1.0 / 3.0, 0.2), 1.1
_DIRECTIONS = ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, -1))
_CLOCKS = (1e-3, 1e3, 1e-6, 1e6, 0.5, 2.0)
_SIDES: tuple[Side, ...] = ("command", "measured", "both")


@dataclass(frozen=True, eq=False)
class Proposal:
    """One change of how a log is read.

    Attributes:
        kind: of the finding.
        joints: numbers of those that it is about; empty for all.
        reading: with the change.
        side: which series it changes; empty if it is none of them.
        says: what is wrong if it is true, after the names of the joints, without a full stop.
        turned: joints that also count the other way round.
        units: side and joint -> unit, where a factor is a unit's.
        freedom: how much a change that is chosen among many has to be better than one of few (of the logarithm).
        value: of the change: a factor, an offset, a lag.
        order: joint -> joint whose columns it gets, command and measurement together.
        again: the same with a factor of so much more, where the factor is a first guess.
    """

    kind: str
    joints: tuple[int, ...]
    reading: Reading
    side: str
    says: str
    units: dict[tuple[str, int], Unit] = field(default_factory=dict)
    freedom: float = 0.0
    value: float = 0.0
    order: dict[int, int] = field(default_factory=dict)
    again: Callable[[float], Proposal] | None = None
    turned: tuple[int, ...] = ()

    def words(self, names: Sequence[str]) -> str:
        """What is wrong if it is true, without the names of its joints; `names` are those of all joints."""
        turned = [names[joint] for joint in self.turned]
        count = "count" if len(turned) > 1 else "counts"
        return self.says + (f", and {listed(turned)} {count} the other way round" if turned else "")

    @property
    def alike(self) -> tuple[str, tuple[int, ...]]:
        """What is the same in proposals that differ only in the series that they change."""
        return self.kind, self.joints


@dataclass(frozen=True, eq=False)
class Looked:
    """What a proposal is made from.

    Attributes:
        evidence: the motions.
        reading: as they are read so far.
        score: of that.
        length_units: SI unit of each joint's position.
    """

    evidence: Evidence
    reading: Reading
    score: Score
    length_units: tuple[str, ...]

    @cached_property
    def rough(self) -> Score:
        """Of the same reading, by a first look."""
        return self.evidence.coarse.score(self.reading)

    @cached_property
    def unmodelled(self) -> np.ndarray:
        """What of a servo's error is left without the model, by joint; see `Evidence.unmodelled`."""
        return self.evidence.unmodelled(self.reading)

    @property
    def servo(self) -> bool:
        """Whether a position or velocity is commanded."""
        return self.evidence.followed(self.reading) != "torque"

    @property
    def moved(self) -> list[int]:
        """Joints that move."""
        return [int(joint) for joint in np.flatnonzero(~np.isnan(self.score.left))]

    @property
    def lost(self) -> list[int]:
        """Joints that do not do what they are told."""
        return [joint for joint in self.moved if self.score.left[joint] > LOST]

    @property
    def apart(self) -> list[int]:
        """Joints that do not do what they are told, or stay as far from it on average as no servo sags."""
        far = np.abs(self.score.zero) > 0.9 * ZERO
        return [joint for joint in self.moved if self.score.left[joint] > LOST or (self.servo and far[joint])]

    @property
    def puzzling(self) -> list[int]:
        """Joints of which the model does not explain what it could, or that are out of their range."""
        if not self.evidence.sure:
            return [int(joint) for joint in np.flatnonzero(self.score.outside > 0.1)]
        share = 1.0 - self.score.left / np.maximum(self.score.blind, 1e-12)
        bad = (share < _UNEXPLAINED) | (self.score.left > LOST) | (self.score.outside > 0.1)
        return [joint for joint in self.moved if bad[joint]]

    @property
    def suspects(self) -> list[int]:
        """Joints that may be read wrongly: what the model says of one depends on those behind it, too."""
        found = {*self.lost, *self.puzzling}
        return self.moved if self.puzzling and len(self.moved) <= _MOST_SUSPECTS else sorted(found)


def signs(looked: Looked) -> Iterator[Proposal]:
    """A joint that counts the other way round, in one series or in both."""
    for joint in looked.suspects:
        for side in _SIDES if joint in looked.lost else ("both",):
            yield _sign(looked, (joint,), side)
    several = _mirrored(looked)
    if len(several) > 1:
        yield _sign(looked, several, "both")


def swaps(looked: Looked) -> Iterator[Proposal]:
    """Two joints that have each other's names."""
    lost, puzzling = looked.lost, looked.puzzling
    if looked.servo:
        yield from _permutations(looked)
    pairs = [pair for pair in combinations(looked.moved, 2) if {*pair} & {*puzzling, *lost}]
    for one, other in pairs[:_MOST_PAIRS]:
        if looked.length_units[one] != looked.length_units[other]:
            continue
        sides: Sequence[Side] = ("both",) if looked.servo or not {one, other} <= set(lost) else _SIDES
        for side in sides:
            yield _swap(looked, {one: other, other: one}, side)
    yield from _orders(looked)


def units(looked: Looked) -> Iterator[Proposal]:
    """Positions in another unit than the log says; of servos, commands, too."""
    signal = looked.evidence.followed(looked.reading)
    far = [joint for joint in looked.puzzling if looked.score.outside[joint] > 0.1 or not looked.servo]
    sides: tuple[Side, ...] = ("both",) if signal == "position" else ("measured",)
    for joint in far if len(far) <= 8 else []:
        for unit in _units(looked, joint):
            for side in sides:
                yield _unit(looked, (joint,), {joint: unit}, side)
    puzzling = looked.puzzling
    if len(puzzling) >= 2 or (len(puzzling) == 1 and len(looked.moved) == 1):
        hinges = tuple(joint for joint, unit in enumerate(looked.length_units) if unit == "rad")
        names = [unit.name for unit in _units(looked, hinges[0])] if hinges else []
        for name in names:
            own = {joint: unit for joint in hinges for unit in _units(looked, joint) if unit.name == name}
            if len(own) == len(hinges) > 1:
                for side in _SIDES if looked.servo else sides:
                    whole = _unit(looked, hinges, own, side)
                    yield whole
                    yield from _with_mirrored(looked, whole)


def relations(looked: Looked) -> Iterator[Proposal]:
    """What a straight line between command and motion says: a unit, a gear, a sign, an offset in one of the series."""
    if not looked.servo:
        return
    related = {}
    for joint in looked.apart:
        slope, offset, share = _line(looked, joint, joint)
        if share < _RELATED or slope == 0.0:
            continue
        related[joint] = slope
        sign = 1.0 if slope > 0 else -1.0
        yield from _scaled(looked, joint, slope)
        for factor in (sign,) if _SOFT[0] < abs(slope) < _SOFT[1] else (sign, slope):
            if abs(factor) < 0.02 or (factor == -1.0 and abs(offset) < 0.2):
                continue
            for rest in _offsets(offset):
                if factor == 1.0 and rest == 0.0:
                    continue
                yield from _gear(looked, (joint,), factor, _without_sag(looked, joint, factor, rest))
    # A whole robot whose series counts the other way round, or is that of motors behind gears that are alike.
    mirrored = tuple(joint for joint, slope in related.items() if _SOFT[0] < -slope < _SOFT[1])
    if len(mirrored) > 1:
        yield from _gear(looked, mirrored, -1.0, 0.0)
    middle = float(np.median(list(related.values()))) if related else 1.0
    alike = tuple(joint for joint, slope in related.items() if abs(slope / middle - 1.0) < _NEAR_UNIT)
    if len(alike) > 1 and not _SOFT[0] < abs(middle) < _SOFT[1]:
        yield from _gear(looked, alike, middle, 0.0)


def offsets(looked: Looked) -> Iterator[Proposal]:
    """A zero of another pose than the model's, in both series (or, of motors and velocities, in the measured one)."""
    signal = looked.evidence.followed(looked.reading)
    side: Side = "both" if signal == "position" else "measured"
    for joint in looked.suspects:
        if looked.length_units[joint] != "rad":
            continue
        for quarter in (1, -1, 2, 0.5, -0.5, 1.5, -1.5):
            yield _zero(looked, joint, quarter * _QUARTER, side, 0.3 if float(quarter).is_integer() else 0.8)
        yield from _any_zero(looked, joint, side)


def gears(looked: Looked) -> Iterator[Proposal]:
    """Both series of a servo's joint on the motor's side of a gear, or in a unit of its own."""
    if looked.evidence.followed(looked.reading) != "position":
        return
    for joint in looked.suspects:
        low, high = looked.evidence.first.limits[joint]
        position = looked.reading.measured.of(looked.evidence.coarse.gather("position"), moved=True)[:, joint]
        farthest = max(float(np.max(position)) / max(high, 1e-9), float(np.min(position)) / min(low, -1e-9), 1e-9)
        # Of what is far out of its range, what brings it back, and a little more.
        factors = np.array(_GEARS) / farthest if farthest > 2.0 and np.isfinite(farthest) else (*_GEARS[1:], 2.0, 3.0)
        tried = (_geared(looked, (joint,), float(factor), 0.0, "both") for factor in factors)
        if (found := _promising(looked, tried)) is not None:
            yield found


def efforts(looked: Looked) -> Iterator[Proposal]:
    """Torques on the motor's side of a gear, or in another unit."""
    if looked.servo or not looked.evidence.sure:
        return
    found = {}
    for joint in looked.moved:
        needed = looked.evidence.needed(looked.reading)[:, joint]
        command = looked.reading.command.of(
            looked.evidence.commanded(looked.evidence.signal, looked.reading.lag_s), moved=False
        )[:, joint]
        gain = float(command @ needed) / max(float(needed @ needed), 1e-30)
        found[joint] = gain
        if abs(gain) > 1e-9 and not 0.4 < gain < 2.5:
            yield _effort(looked, (joint,), 1.0 / gain)
    if len(found) > 1:
        gains = np.array(list(found.values()))
        middle = float(np.median(gains))
        if middle > 0 and np.all(np.abs(gains / middle - 1.0) < 0.5) and not 0.4 < middle < 2.5:
            yield _effort(looked, tuple(found), 1.0 / middle)


def gravity(looked: Looked) -> Iterator[Proposal]:
    """Another direction of gravity, or somebody else who carries the weight."""
    dynamics = looked.evidence.first
    size = float(np.linalg.norm(dynamics.gravity)) or 9.81
    if not looked.evidence.sure or not looked.puzzling:
        return
    now = np.array(dynamics.gravity if looked.reading.gravity is None else looked.reading.gravity)
    for direction in _DIRECTIONS:
        pull = size * np.array(direction, float)
        if np.allclose(pull, now):
            continue
        changed = replace(looked.reading, gravity=(float(pull[0]), float(pull[1]), float(pull[2])))
        yield Proposal("gravity", (), changed, "", f"gravity pulls along {_axis(direction)}", freedom=0.3)
    if now.any():
        changed = replace(looked.reading, gravity=(0.0, 0.0, 0.0))
        yield Proposal("gravity-compensation", (), changed, "", "something other than the drives carries the weight")
    if looked.evidence.compensated and not looked.reading.uncompensated:
        changed = replace(looked.reading, uncompensated=True)
        yield Proposal("gravity-compensation", (), changed, "", "the drives carry the weight themselves")


def delays(looked: Looked) -> Iterator[Proposal]:
    """Commands that act much later than usual, or before they are stamped."""
    step_s = max(0.01, looked.evidence.motions[0].step_s)
    for lag_s in np.arange(-1.0, 1.0 + step_s, step_s):
        if lag_s < -2.5 * step_s or lag_s > 0.2:
            words = f"act {lag_s:.2f} s after their stamps" if lag_s > 0 else f"are stamped {-lag_s:.2f} s too late"
            changed = replace(looked.reading, lag_s=float(lag_s))
            yield Proposal("delay", (), changed, "command", f"commands {words}", freedom=1.0, value=float(lag_s))


def clocks(looked: Looked) -> Iterator[Proposal]:
    """Stamps in another unit, or of a motion that was played faster or slower."""
    rates = looked.evidence.rates / looked.reading.clock_scale
    known = rates[np.isfinite(rates)]
    signal = looked.evidence.followed(looked.reading)
    told = known.size > 1 and float(np.ptp(known)) < 0.05 * abs(float(np.median(known)))
    for scale in _CLOCKS:
        agrees = told and abs(float(np.median(known)) / scale - 1.0) < 0.05
        if not agrees and (signal == "position" or not looked.evidence.sure or not looked.puzzling):
            continue
        changed = replace(looked.reading, clock_scale=looked.reading.clock_scale * scale)
        says = f"time stamps are in units of {scale:g} s"
        yield Proposal("clock", (), changed, "", says, freedom=-0.5 if agrees else 0.3, value=scale)


def modes(looked: Looked) -> Iterator[Proposal]:
    """Commands of another kind than the robot's description says."""
    own = looked.evidence.followed(looked.reading)
    if len(looked.lost) * 2 < len(looked.moved) and own != "torque":
        return
    if own == "torque" and not looked.puzzling:
        return
    for signal in ("position", "velocity", "torque"):
        if signal != own and not (signal == "torque" and not looked.evidence.sure):
            says = f"what is logged as a {own} command looks like a {signal}"
            yield Proposal("control-mode", (), replace(looked.reading, signal=signal), "command", says, freedom=0.7)


# In the order in which they are proposed.
KINDS: dict[str, Callable[[Looked], Iterator[Proposal]]] = {
    "sign": signs,
    "relation": relations,
    "unit": units,
    "swap": swaps,
    "offset": offsets,
    "gear": gears,
    "effort": efforts,
    "gravity": gravity,
    "delay": delays,
    "clock": clocks,
    "control-mode": modes,
}


def proposals(looked: Looked) -> Iterator[Proposal]:
    """All that may be wrong."""
    for propose in KINDS.values():
        yield from propose(looked)


def _promising(looked: Looked, tried: Iterable[Proposal]) -> Proposal | None:
    """The one that explains most, if that is much more than now, by a first look."""
    evidence, base = looked.evidence.coarse, looked.rough
    left = [(float(loss(evidence.score(one.reading), base).sum()), one) for one in tried]
    least, found = min(left, key=lambda item: item[0])
    return found if least < float(loss(base, base).sum()) - _PROMISING else None


def _any_zero(looked: Looked, joint: int, side: Side) -> Iterator[Proposal]:
    """The zero that explains most, from a few and then nearer and nearer."""
    found = _promising(looked, [_zero(looked, joint, value, side, _ANY_ZERO) for value in _ZEROS])
    if found is None:
        return
    for width in _FINER:
        near = (found.value - width, found.value, found.value + width)
        found = _promising(looked, [_zero(looked, joint, value, side, _ANY_ZERO) for value in near]) or found
    yield found


def _zero(looked: Looked, joint: int, value: float, side: Side, freedom: float) -> Proposal:
    changed = looked.reading.with_columns(side, lambda columns: columns.changed(joint, offset=value))
    about = "" if freedom < _ANY_ZERO else "about "
    says = f"has its zero {about}{math.degrees(abs(value)):.0f} degrees from where the model has it"
    return Proposal("offset", (joint,), changed, side, says, freedom=freedom, value=value)


def _sign(looked: Looked, joints: tuple[int, ...], side: Side) -> Proposal:
    changed = _flipped(looked.reading, joints, side)
    says = f"{'counts' if len(joints) == 1 else 'count'} the other way round {_in(side)}"
    return Proposal("sign", joints, changed, side, says, freedom=_EACH_MIRRORED * (len(joints) - 1), value=-1.0)


def _mirrored(looked: Looked) -> tuple[int, ...]:
    """Joints that explain the motions best if all of them count the other way round.

    What the model says of a joint depends on where those before and behind it are: of two that are mirrored, one alone
    may explain nothing. They are found by turning one or two more, or back, as long as that helps. The lag is that of
    the present reading, or none, which damping makes up for: with one that is too long nothing is explained.
    """
    evidence, suspects, base = looked.evidence.coarse, looked.suspects, looked.rough
    if len(suspects) > _MOST_MIRRORED:
        return ()

    def misses(joints: frozenset[int]) -> float:
        turned = _flipped(looked.reading, sorted(joints), "both")
        scores = [evidence.score(replace(turned, lag_s=lag_s)) for lag_s in {0.0, looked.reading.lag_s}]
        return min(float(loss(score, base).sum()) for score in scores) + _EACH_MIRRORED * len(joints)

    turns = [frozenset(own) for count in (1, 2) for own in combinations(suspects, count)]
    found, least = frozenset[int](), misses(frozenset())
    for _ in suspects:
        tried = [(misses(found ^ turn), found ^ turn) for turn in turns]
        best, joints = min(tried, key=lambda one: one[0])
        if best > least - _WORTH_A_TURN:
            break
        found, least = joints, best
    return tuple(sorted(found))


def _flipped(reading: Reading, joints: Sequence[int], side: Side) -> Reading:
    def flip(columns: Columns) -> Columns:
        for joint in joints:
            columns = columns.changed(joint, factor=-1.0)
        return columns

    return reading.with_columns(side, flip)


def _swap(looked: Looked, order: dict[int, int], side: Side) -> Proposal:
    changed = looked.reading.with_columns(side, lambda columns: columns.permuted(order))
    says = f"are swapped {_in(side)}" if len(order) == 2 else f"are in the wrong order {_in(side)}"
    whole = order if side == "both" else {}
    return Proposal("swap", tuple(sorted(order)), changed, side, says, order=whole)


def _unit(looked: Looked, joints: tuple[int, ...], own: dict[int, Unit], side: Side) -> Proposal:
    def change(columns: Columns) -> Columns:
        for joint, unit in own.items():
            columns = columns.changed(joint, factor=unit.si, offset=unit.zero)
        return columns

    name = next(iter(own.values())).name
    sides = ("measured", "command") if side == "both" else (side,)
    return Proposal(
        "unit",
        joints,
        looked.reading.with_columns(side, change),
        side,
        f"{'is' if len(joints) == 1 else 'are'} logged in {name} {_in(side)}",
        units={(one, joint): unit for one in sides for joint, unit in own.items()},
        freedom=0.3
        + max(_against(looked, joint, unit) for joint, unit in own.items())
        + max(_seldom(looked, joint, unit) for joint, unit in own.items()),
        value=next(iter(own.values())).si,
    )


def _with_mirrored(looked: Looked, whole: Proposal) -> Iterator[Proposal]:
    """The same unit, and joints that are out of their range with it and in it the other way round are mirrored."""
    evidence = looked.evidence.coarse
    outside = evidence.score(whole.reading).outside
    far = [joint for joint in whole.joints if outside[joint] > _OUTSIDE]
    if not far or whole.side == "command":
        return

    turned = evidence.score(_flipped(whole.reading, far, "both")).outside
    mirrored = [joint for joint in far if turned[joint] < _INSIDE]
    if mirrored:
        reading = _flipped(whole.reading, mirrored, "both")
        freedom = whole.freedom + _EACH_MIRRORED * len(mirrored)
        yield replace(whole, reading=reading, turned=tuple(mirrored), freedom=freedom)


def _against(looked: Looked, joint: int, unit: Unit) -> float:
    """What a measured velocity has against a unit of the position, where it is none of the same unit."""
    rate = looked.evidence.rates[joint]
    if math.isnan(rate) or abs(rate - 1.0) < _SAME_RATE or abs(rate * unit.si - 1.0) < _SAME_RATE:
        return 0.0
    return _OTHER_RATE


def _seldom(looked: Looked, joint: int, unit: Unit) -> float:
    """Degrees are likelier than shares of a range, and these than what few logs have, or counts that are not whole."""
    counts = unit.name.startswith(_COUNTS) and not looked.evidence.whole[joint]
    return _RARE if unit.name in _RARELY or counts else 0.0 if unit.scale == 1.0 else 0.1


def _scaled(looked: Looked, joint: int, slope: float) -> Iterator[Proposal]:
    """One series in a unit that nobody has said, of a motion that is `slope` times its command."""
    signal = looked.evidence.followed(looked.reading)
    sign = 1.0 if slope > 0 else -1.0
    for unit in _units(looked, joint):
        if signal != "position" and unit.zero:
            continue
        ways: list[Side] = []
        if abs(abs(slope) * unit.si - 1.0) < _NEAR_UNIT:
            ways.append("measured")
        if abs(abs(slope) / unit.si - 1.0) < _NEAR_UNIT:
            ways.append("command")
        for side in ways:

            def change(columns: Columns, unit: Unit = unit) -> Columns:
                return columns.changed(joint, factor=sign * unit.si, offset=sign * unit.zero)

            says = f"is logged in {unit.name} {_in(side)}" + (", and counts the other way round" if sign < 0 else "")
            yield Proposal(
                "unit",
                (joint,),
                looked.reading.with_columns(side, change),
                side,
                says,
                units={(side, joint): unit},
                freedom=(0.2 if sign > 0 else 0.5)
                + (_against(looked, joint, unit) if side == "measured" else 0.0)
                + _seldom(looked, joint, unit),
                value=sign * unit.si,
            )


def _without_sag(looked: Looked, joint: int, factor: float, offset: float) -> float:
    """An offset without what a servo is off by under its load, where the model knows that; quarters of turns stay."""
    if not offset or _round(offset) or abs(factor) != 1.0 or not looked.evidence.sure:
        return offset
    zero = looked.evidence.score(_geared(looked, (joint,), factor, offset, "measured").reading).zero[joint]
    return offset - factor * float(np.nan_to_num(zero))


def _gear(looked: Looked, joints: tuple[int, ...], factor: float, offset: float) -> Iterator[Proposal]:
    """What makes `factor * command + offset` of the commands of joints, or the reverse of their measurements."""
    for side in ("command", "measured"):
        yield _geared(looked, joints, factor, offset, side)


def _geared(looked: Looked, joints: tuple[int, ...], factor: float, offset: float, side: Side) -> Proposal:
    def change(columns: Columns) -> Columns:
        own = (1.0 / factor, -offset / factor) if side == "measured" else (factor, offset)
        for joint in joints:
            columns = columns.changed(joint, factor=own[0], offset=own[1])
        return columns

    own = 1.0 / factor if side == "measured" else factor
    kind = "offset" if factor == 1.0 else ("sign" if factor == -1.0 else "scale")
    one = len(joints) == 1
    words = []
    if factor < 0:
        words.append(f"{'counts' if one else 'count'} the other way round")
    if abs(factor) != 1.0:
        # Of both series no line says how much it is, only the model's torques.
        about = "about " if side == "both" else ""
        words.append(f"{'is' if one else 'are'} {about}{_times(abs(own))}")
    if offset:
        words.append(f"has its zero {_far(abs(offset))} away")
    return Proposal(
        kind,
        joints,
        looked.reading.with_columns(side, change),
        side,
        f"{' and '.join(words)} {_in(side)}",
        freedom=(0.0 if kind != "scale" else _ANY_FACTOR) + (0.0 if not offset else 0.3 if _round(offset) else 0.6),
        value=offset if abs(factor) == 1.0 else own,
        again=(lambda much: _geared(looked, joints, factor * much, offset, side)) if kind == "scale" else None,
    )


def _effort(looked: Looked, joints: tuple[int, ...], factor: float) -> Proposal:
    for exact in (1e-3, 1e3):
        if abs(factor / exact - 1.0) < 0.3:
            factor = exact

    def change(columns: Columns) -> Columns:
        for joint in joints:
            columns = columns.changed(joint, factor=factor)
        return columns

    says = f"{'has' if len(joints) == 1 else 'have'} commanded torques, each of which is {_times(abs(factor))}"
    if factor < 0:
        says += ", and count the other way round"
    return Proposal(
        "scale",
        joints,
        looked.reading.with_columns("command", change),
        "command",
        says,
        freedom=_ANY_FACTOR,
        value=factor,
    )


def _permutations(looked: Looked) -> Iterator[Proposal]:
    """Which command explains which measurement, of the joints that do not follow their own."""
    lost = looked.lost
    if len(lost) < 2:
        return
    share = np.array([[abs(_line(looked, joint, source)[2]) for source in lost] for joint in lost])
    rows, columns = linear_sum_assignment(-share)
    order = {lost[row]: lost[column] for row, column in zip(rows, columns, strict=True) if row != column}
    if (
        not order
        or min(share[row, column] for row, column in zip(rows, columns, strict=True) if row != column) < _RELATED
    ):
        return
    yield _swap(looked, order, "command")
    # The measured columns in the order of the commands.
    yield _swap(looked, {source: joint for joint, source in order.items()}, "measured")


def _orders(looked: Looked) -> Iterator[Proposal]:
    """All joints in an order that is found swap by swap, each the best of all: names that say nothing."""
    evidence = looked.evidence.coarse
    joints = [joint for joint in looked.moved if looked.length_units[joint] == "rad"]
    if len(looked.puzzling) < _FEWEST_PUZZLING or not 3 <= len(joints) <= _MOST_SUSPECTS:
        return
    base = looked.rough
    order = np.arange(len(looked.length_units))

    def misses(own: np.ndarray) -> float:
        changed = looked.reading.with_columns("both", lambda columns: columns.permuted(dict(enumerate(own.tolist()))))
        return float(loss(evidence.score(changed), base).sum())

    least, swaps = misses(order), 0
    while swaps < len(joints):
        tried = []
        for one, other in combinations(joints, 2):
            own = order.copy()
            own[[one, other]] = own[[other, one]]
            tried.append((misses(own), tuple(own.tolist())))
        best, found = min(tried)
        if best > least - _WORTH_A_SWAP:
            break
        least, order, swaps = best, np.array(found), swaps + 1
    if swaps > 1:
        yield _swap(looked, {joint: int(own) for joint, own in enumerate(order) if joint != own}, "both")


def follows(looked: Looked, joint: int) -> float:
    """Share of a joint's motion that a straight line over its own command explains."""
    return _line(looked, joint, joint)[2]


def _line(looked: Looked, joint: int, source: int) -> tuple[float, float, float]:
    """Slope and offset of a joint's motion over a command, and the share of its variance that they explain."""
    evidence, reading = looked.evidence, looked.reading
    signal = evidence.followed(reading)
    position, velocity, _ = evidence.state(reading)
    actual = (position if signal == "position" else velocity)[:, joint]
    best = (0.0, 0.0, 0.0)
    for lag_s in (reading.lag_s, *np.arange(0.0, 0.36, 0.06)):
        command = reading.command.of(evidence.commanded(evidence.signal, float(lag_s)), moved=signal == "position")
        column = command[:, source]
        spread = float(np.var(column))
        if spread < 1e-12 or np.var(actual) < 1e-12:
            continue
        slope = float(np.mean((column - column.mean()) * (actual - actual.mean()))) / spread
        share = slope**2 * spread / float(np.var(actual))
        if share > best[2]:
            offset = float(actual.mean() - slope * column.mean()) if signal == "position" else 0.0
            best = (slope, offset, share)
    return best


def _offsets(offset: float) -> tuple[float, ...]:
    """The offset if it is one, and the quarter of a turn that it is near to."""
    if abs(offset) < 0.15:
        return (0.0,)
    quarter = round(offset / _QUARTER) * _QUARTER
    return (quarter, offset) if quarter and abs(offset - quarter) < 0.2 else (offset,)


def _times(factor: float) -> str:
    return f"{factor:.4g} times too small" if factor >= 1 else f"{1 / factor:.4g} times too large"


def _round(offset: float) -> bool:
    return abs(offset / _QUARTER - round(offset / _QUARTER)) < 1e-9


def _far(value: float) -> str:
    return f"{math.degrees(value):.4g} degrees" if _round(value) else f"{value:.4g} rad"


def _units(looked: Looked, joint: int) -> tuple[Unit, ...]:
    low, high = looked.evidence.first.limits[joint]
    return units_of(looked.length_units[joint], float(low), float(high))


def _in(side: str) -> str:
    return {"both": "in command and measurement", "command": "in the command", "measured": "in the measurement"}[side]


def _axis(direction: Sequence[int]) -> str:
    return next(f"{'+' if part > 0 else '-'}{name}" for name, part in zip("xyz", direction, strict=True) if part)
