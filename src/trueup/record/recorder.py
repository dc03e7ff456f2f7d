"""The recorder: drives a robot along plans, keeps what it commanded and measured, and recovers when it stops."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Flag
from trueup.core.protocols import Hardware, TrajectoryIO
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.core.units import joint_unit
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, NoPlan, RobotStopped, TrueupError
from trueup.record.following import Followed, follow, own_steps
from trueup.record.motion import MotionSettings, joint_motion
from trueup.record.plan import Plan
from trueup.record.profile import ClockSettings
from trueup.record.scene import Scene

_SEEDS = 4  # of the planner, for one way
_WHOLE = 1e-6  # rates may miss a whole ratio by this share
# What went wrong leaves a robot in motion: it is given this long to come to rest before anything is asked of it [s].
_SETTLE_S = 0.2
_LISTEN_EVERY_S = 0.05
# Noise and its weight keep a robot that stands at home this near to it; farther away, a command of home would be a jolt
# [rad or m].
_AT_HOME = 0.01
_SEE_TO_IT = "See to the robot, then repeat with --resume: what was recorded is kept."


@dataclass(frozen=True)
class RecordSettings:
    """How plans are recorded.

    Attributes:
        control_hz: commands per second [Hz]; the plans' rate is a multiple of it.
        record_hz: rows per second of the recording [Hz]; one of the two is a multiple of the other. All commands are
            kept where there are fewer of them.
        transfer_share: share of the limits of velocity and acceleration on the way to the start of a motion.
        settle_s: wait at the start of a motion before it is recorded [s]; joints creep for a while after they moved.
        tolerance_rad: how far a joint may be from where it should be before and after a motion [rad or m].
        path_tolerance_rad: how far a joint may be from its command on the way [rad or m]; delay and a soft controller
            take half of it at full speed.
        silent_s: unchanged readings for longer than this, while the command moves, mean a silent robot [s].
        patience_s: how long a silent robot may take to answer again; it is not driven before that [s].
        recoveries: how often a robot may stop on its way home or to a start before it is given up.

    Raises:
        ConfigError: a number that makes no recording.
    """

    control_hz: float = 1000.0
    record_hz: float = 100.0
    transfer_share: float = 0.5
    settle_s: float = 0.5
    tolerance_rad: float = 0.05
    path_tolerance_rad: float = 0.2
    silent_s: float = 0.2
    patience_s: float = 2.0
    recoveries: int = 3

    def __post_init__(self) -> None:
        """Refuse what makes no recording."""
        for name in ("control_hz", "record_hz", "tolerance_rad", "path_tolerance_rad", "silent_s", "patience_s"):
            if not (getattr(self, name) > 0 and np.isfinite(getattr(self, name))):
                raise ConfigError(f"{name} must be positive", got=getattr(self, name))
        if not 0 <= self.settle_s < np.inf:
            raise ConfigError("settle_s must not be negative", got=self.settle_s)
        if not 0 < self.transfer_share <= 1:
            raise ConfigError("transfer_share is no share", got=self.transfer_share, expected="above 0, up to 1")
        if self.recoveries < 1:
            raise ConfigError("recoveries must be at least 1", got=self.recoveries)
        rates = sorted((self.control_hz, self.record_hz), reverse=True)
        whole_ratio(rates[0], rates[1], "control_hz must be a multiple of record_hz, or the other way round")

    @property
    def step_s(self) -> float:
        """From one command or reading to the next of either [s]."""
        return 1.0 / max(self.control_hz, self.record_hz)

    @property
    def every(self) -> int:
        """Steps per recorded row."""
        return round(1.0 / (self.step_s * self.record_hz))

    @property
    def hold(self) -> int:
        """Steps per command."""
        return round(1.0 / (self.step_s * self.control_hz))


@dataclass(frozen=True, eq=False)
class Recording:
    """One recorded motion, on a clock that begins with its first command.

    Attributes:
        measured: what the robot's sensors said.
        command: what was sent to it.
        flags: what went wrong: `stopped`, `silent`, `failed`, `goal_missed`, `off_path`, `late`.
    """

    measured: TimeSeries
    command: TimeSeries
    flags: tuple[Flag, ...]


class Recorder:
    """Executes plans on one robot, one after the other (Algorithm 3 of the LSTM thesis, lines 22 to 33; Algorithm 4).

    Before a motion it drives to the plan's start on a planned way. After a stop, a silence or a missed goal it
    recovers the robot and drives home, so that the next motion finds it well.

    Args:
        robot: the robot; between motions it holds its last command.
        scene: the robot among its obstacles, for the ways between motions. A clearance below that of the plans keeps
            a robot that stopped a little beside its path from counting as stuck.
        settings: rates, speeds, tolerances.

    Raises:
        NameMismatch: robot and scene do not have the same joints; both lists are printed.
        ConfigError: the robot follows no positions, or not at this control rate.
    """

    def __init__(self, robot: Hardware, scene: Scene, settings: RecordSettings | None = None) -> None:
        if sorted(robot.joints) != sorted(scene.joints):
            raise NameMismatch("the robot is not that of the scene", left=robot.joints, right=scene.joints)
        self._signals: list[str] = [name for name in ("position", "velocity") if name in robot.command_signals]
        if "position" not in self._signals:
            raise ConfigError(
                "a recorder commands positions, which this robot does not follow",
                available=robot.command_signals,
                hint="A lab's robot follows them with `controller: {kind: impedance}`; a TorqueServo leads others.",
            )
        self.robot, self.scene = robot, scene
        self.settings = settings or RecordSettings()
        if isinstance(robot, TrajectoryIO):
            own_steps(robot, self.settings.step_s)
        self._commanded: Float64[np.ndarray, "J"] | None = None
        self._lost: RobotStopped | None = None
        self._ways = MotionSettings(
            clock=ClockSettings(rate_hz=self.settings.control_hz, rest_s=0.1),
            acceleration_share=self.settings.transfer_share,
        )

    def record(self, plan: Plan) -> Recording:
        """Drive to the start of a plan, follow it, and see that the robot is well afterwards.

        Raises:
            NameMismatch: the plan is of other joints.
            ConfigError: its rate does not fit.
            NoPlan: there is no way to its start.
            RobotStopped: the robot stops again and again, or did so after the motion before and is not well yet.
            DataError: it said nothing at all.
        """
        if sorted(plan.joints) != sorted(self.scene.joints):
            raise NameMismatch(f"plan {plan.id!r} is of another robot", left=plan.joints, right=self.scene.joints)
        if self._lost is not None:
            raise self._lost
        columns = [plan.joints.index(name) for name in self.scene.joints]
        self.reach(plan.start[columns])
        self.robot.wait_until_s(self.robot.now_s() + self.settings.settle_s)
        done = self._follow(plan)
        flags = [*self._late(done), *self._troubles(done), *self._off_path(done)]
        missed: list[Flag] = []
        try:
            missed = self._missed(plan.goal[columns]) if done.trouble is None else []
            if done.trouble is not None or missed:
                self._revive(done)
                self._drive_to(self.scene.home)
        except TrueupError as error:  # what was recorded comes first
            self._lost = error if isinstance(error, RobotStopped) else _stuck(error)
            if done.trouble is None and not missed:
                flags.append(Flag("failed", detail=error.summary))
        flags += missed
        if done.measured is None or done.command is None or len(done.measured) < 2:
            detail = f"{done.trouble.kind}: {done.trouble.detail}" if done.trouble else "no reading"
            raise DataError(f"nothing of motion {plan.id!r} was recorded", got=detail)
        return Recording(self._in_units(done.measured), self._in_units(done.command), tuple(flags))

    def reach(self, pose: Float64[np.ndarray, "J"]) -> None:
        """Drive to a pose (in the order of the scene's joints), by way of home if there is no straight way.

        Raises:
            NoPlan: there is no way.
            RobotStopped: the robot stopped on its way more often than it may.
        """
        try:
            self._drive_to(pose)
        except NoPlan:
            self._drive_to(self.scene.home)
            self._drive_to(pose)

    def recover(self) -> None:
        """Make the robot take commands again, and drive home, also after it was given up.

        Raises:
            NoPlan: there is no way home.
            RobotStopped: the robot stopped on its way more often than it may.
        """
        self._revive(None)
        self._drive_to(self.scene.home)
        self._lost = None

    def _drive_to(self, pose: Float64[np.ndarray, "J"]) -> None:
        why = ""
        for _ in range(self.settings.recoveries):
            here = self._here()
            if np.abs(pose - here).max() < 1e-9:
                return
            way = self._way(here, pose)
            done = self._follow(way)
            missed = self._missed(pose) if done.trouble is None else []
            if done.trouble is None and not missed:
                return
            why = f"{done.trouble.kind}: {done.trouble.detail}" if done.trouble else missed[0].detail
            self._revive(done)
        raise RobotStopped(
            f"the robot did not get where it should {self.settings.recoveries} times, and is given up",
            got=why,
            hint=_SEE_TO_IT,
        )

    def _revive(self, done: Followed | None) -> None:
        """Make the robot take commands again after what went wrong.

        A silent robot is waited for: where it is must be known before it is sent anywhere.

        Raises:
            RobotStopped: it stays silent, or its driver raises errors.
        """
        self._commanded = None
        with _answering():
            deadline_s = self.robot.now_s() + self.settings.patience_s
            self.robot.wait_until_s(self.robot.now_s() + _SETTLE_S)
            self.robot.recover()
            while self._still_silent(done):
                if self.robot.now_s() >= deadline_s:
                    raise RobotStopped("the robot is silent, and is given up", hint=_SEE_TO_IT)
                self.robot.wait_until_s(self.robot.now_s() + _LISTEN_EVERY_S)

    def _still_silent(self, done: Followed | None) -> bool:
        """Whether a robot that was silent in a motion still reads what it read last."""
        if done is None or done.measured is None or done.trouble is None or done.trouble.kind != "silent":
            return False
        last = done.measured.signals
        return all(np.array_equal(values, last[name][-1]) for name, values in self.robot.read().items())

    def _here(self) -> Float64[np.ndarray, "J"]:
        """Where the next way begins: the last command if the robot is there, home if it is, else where it is."""
        measured = self._position()
        for pose, near in ((self._commanded, self.settings.tolerance_rad), (self.scene.home, _AT_HOME)):
            if pose is not None and np.abs(measured - pose).max() <= near:
                return pose
        limits = self.scene.limits
        return np.asarray(np.clip(measured, limits.low, limits.high))

    def _position(self) -> Float64[np.ndarray, "J"]:
        with _answering():
            reading = self.robot.read()
        if "position" not in reading:
            raise MissingSignal("the robot does not say where it is", available=reading)
        position = np.array(reading["position"], np.float64)
        if position.shape != (len(self.robot.joints),) or not np.isfinite(position).all():
            raise DataError("the robot does not say where it is", got=position)
        return np.asarray(position[[self.robot.joints.index(name) for name in self.scene.joints]])

    def _follow(self, plan: Plan) -> Followed:
        settings = self.settings
        skip = whole_ratio(
            plan.rate_hz, settings.control_hz, f"the rate of plan {plan.id!r} must be a multiple of control_hz"
        )
        columns = [plan.joints.index(name) for name in self.robot.joints]
        command = {name: np.ascontiguousarray(getattr(plan, name)[::skip, columns]) for name in self._signals}
        with _answering():
            done = follow(
                self.robot,
                command,
                step_s=settings.step_s,
                every=settings.every,
                silent_s=settings.silent_s,
                hold=settings.hold,
            )
        order = [self.robot.joints.index(name) for name in self.scene.joints]
        self._commanded = command["position"][-1][order] if done.trouble is None else None
        return done

    def _in_units(self, series: TimeSeries) -> TimeSeries:
        """The same numbers with the units of joints that slide."""
        lengths = dict(zip(self.scene.joints, self.scene.length_units, strict=True))
        units = {
            name: own
            if name.startswith(BODY_PREFIX)
            else tuple(joint_unit(unit, lengths[joint]) for unit, joint in zip(own, series.joints, strict=True))
            for name, own in series.units.items()
        }
        return replace(series, units=units)

    def _missed(self, pose: Float64[np.ndarray, "J"]) -> list[Flag]:
        away = np.abs(self._position() - pose)
        worst = int(np.argmax(away))
        if away[worst] <= self.settings.tolerance_rad:
            return []
        joint = self.scene.joints[worst]
        return [
            Flag("goal_missed", signal="position", joint=joint, detail=f"{joint} is {away[worst]:.3g} from its goal")
        ]

    def _way(self, here: Float64[np.ndarray, "J"], pose: Float64[np.ndarray, "J"]) -> Plan:
        """A way from here to there; what one seed of the planner does not find, another may."""
        for seed in range(_SEEDS):
            try:
                return joint_motion(
                    self.scene,
                    here,
                    pose,
                    velocity_share=self.settings.transfer_share,
                    seed=seed,
                    settings=self._ways,
                    id="way",
                )
            except NoPlan:
                if seed + 1 == _SEEDS:
                    raise
        raise AssertionError("a seed was tried last")

    def _off_path(self, done: Followed) -> list[Flag]:
        """A joint that was far from its command and may have caught up, e.g. one that stalled for a while."""
        if done.measured is None or done.command is None or "position" not in done.measured:
            return []
        asked = np.repeat(done.command["position"], self.settings.hold, axis=0)
        rows = min(len(done.measured), len(asked))
        away = np.abs(done.measured["position"][:rows] - asked[:rows])
        if not rows or not away.max() > self.settings.path_tolerance_rad:
            return []
        row, column = np.unravel_index(int(np.argmax(away)), away.shape)
        joint, time_s = self.robot.joints[int(column)], float(done.measured.time_s[row])
        detail = f"{joint} was {away.max():.3g} from its command"
        return [Flag("off_path", signal="position", joint=joint, detail=detail, start_s=time_s)]

    def _troubles(self, done: Followed) -> list[Flag]:
        if done.trouble is None:
            return []
        return [Flag(done.trouble.kind, detail=done.trouble.detail, start_s=round(done.trouble.time_s, 9))]

    def _late(self, done: Followed) -> list[Flag]:
        if not done.late:
            return []
        detail = f"{done.late} control steps began late, by up to {1e3 * done.latest_s:.1f} ms"
        steps = self.settings.every * self.settings.hold
        many = done.command is None or done.late > 0.01 * len(done.command) * steps
        return [Flag("late", series="command", detail=detail, severity="warning" if many else "note")]


def whole_ratio(rate_hz: float, of_hz: float, what: str) -> int:
    """How often one rate goes into another.

    Raises:
        ConfigError: not a whole number of times.
    """
    ratio = rate_hz / of_hz
    if round(ratio) < 1 or abs(ratio - round(ratio)) > _WHOLE * ratio:
        raise ConfigError(what, got=f"{rate_hz:g} and {of_hz:g} Hz")
    return round(ratio)


def _stuck(error: TrueupError) -> RobotStopped:
    return RobotStopped("the robot could not be brought home", got=error.summary, hint=_SEE_TO_IT)


@contextlib.contextmanager
def _answering() -> Iterator[None]:
    """A driver that loses its connection outside of a motion is a robot that has stopped."""
    try:
        yield
    except OSError as error:
        raise RobotStopped("the robot does not answer", got=error, hint=_SEE_TO_IT) from error
