"""What robots have that no number of the catalogue expresses, as what it would do along a fitted motion.

A cause has columns. A column is what one unit of it adds: a force at a joint, or a shift of where a joint is measured.
Forces that follow from the motion are taken along the simulated one, so that they have no noise. What a drive has
summed up is taken from the measured one, which it saw.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.units import joint_unit
from trueup.identify.drive import Drive
from trueup.identify.inertial import Inertial, inertial_of
from trueup.identify.problem import Problem
from trueup.identify.segments import Segment

# Poses per second at which the equations of motion are evaluated [1/s].
_POSES_HZ = 100.0
# Below this share of its usual speed, or load, a joint is on its way from one sign to the other.
_SOFT_SPEED, _SOFT_LOAD = 0.05, 0.1
# Share of a joint's friction that is the link's, and not the motor's.
_LINK_FRICTION = 0.3
# Measured speeds above this percentile are the largest.
_FASTEST = 98.0
# A payload's unit: small against any link [kg], and how far out it is moved for its first moments [m].
_MASS, _ARM = 1e-3, 0.1
# Of a coefficient that can only be 1.
_ONE = (0.5, 2.0)
_ANY, _POSITIVE = (-np.inf, np.inf), (0.0, np.inf)

# A time step takes its forces from as long ago [s].
_LEAST_LATE_S = 0.0005

# Something of each joint in each simulation step of each window, (W, N, J), or at each measured stamp, (T, J).
Field = Mapping[Segment, np.ndarray]


@dataclass(frozen=True, eq=False)
class Column:
    """What one unit of a cause adds.

    Attributes:
        joint: number of the joint at which it does; None for the whole robot.
        field: forces of the joints in each simulation step [Nm or N per unit], (W, N, J), or shifts of the simulated
            positions at the measured stamps [rad or m per unit], (T, J), of which only `joint` counts if there is one.
        shifts: whether `field` holds shifts.
        within: values that make sense; zero does in any case.
        logged: the part of the forces that a drive exerts, and logs with its torque; none if None.
    """

    joint: int | None
    field: Field
    shifts: bool = False
    within: tuple[float, float] = _POSITIVE
    logged: Field | None = None

    @property
    def bounds(self) -> tuple[float, float]:
        """Between which a fit looks: of what is positive, from zero."""
        return min(self.within[0], 0.0), np.inf

    def sensible(self, value: float) -> bool:
        """Whether a value makes sense."""
        return bool(self.within[0] <= value <= self.within[1])

    def of(self, segment: Segment) -> np.ndarray:
        """The field along one segment, zero at other joints."""
        return self._own(self.field[segment])

    def forces(self, segment: Segment) -> Float64[np.ndarray, "2 W N J"]:
        """The forces along one segment, and which part of them a drive logs."""
        total = self.of(segment)
        return np.stack([total, np.zeros_like(total) if self.logged is None else self._own(self.logged[segment])])

    def _own(self, values: np.ndarray) -> np.ndarray:
        if self.joint is None:
            return values
        own = np.zeros_like(values)
        own[..., self.joint] = values[..., self.joint]
        return own


class Motions:
    """The motions of a fitted model, and what the causes would add to them.

    Args:
        problem: the fit.
        z: where it ended, (P,).

    Attributes:
        problem: as given.
        z: as given.
        courses: segment -> motion.
        joints: names of the J joints.
        signal: that the robot follows.
        drives: of the fitted model, J.

    Raises:
        DataError: the model cannot be simulated.
    """

    def __init__(self, problem: Problem, z: Float64[np.ndarray, "P"]) -> None:
        self.problem, self.z = problem, z
        self.courses = problem.courses(z)
        nominal = problem.nominal
        self.joints, self.signal = nominal.robot.joint_names, nominal.robot.controller.signal
        self._step_s = nominal.simulator.timestep_s
        self._qpos, self._qvel = nominal.simulator.places
        candidate = problem.candidate(problem.parameters.values(z))
        self.model = candidate.compile()
        self.drives: list[Drive] = [candidate.drive(joint, self.model) for joint in self.joints]

    def unit(self, joint: int, hinge: str) -> str:
        """A unit of a hinge as this joint has it."""
        return joint_unit(hinge, self.problem.nominal.length_unit(self.joints[joint]))

    @cached_property
    def torque(self) -> Float64[np.ndarray, "J"]:
        """Root mean square of the torque of each drive [Nm or N]."""
        return _rms([course.torque for course in self.courses.values()])

    @cached_property
    def loads(self) -> Field:
        """Torque that the links take, without rotors and friction of the joints [Nm or N]."""
        return {segment: self._inverse(segment, course.model) for segment, course in self.courses.items()}

    @property
    def _every(self) -> int:
        """Simulation steps from one pose to the next."""
        return max(1, round(1.0 / (_POSES_HZ * self._step_s)))

    @cached_property
    def _soft_speed(self) -> Float64[np.ndarray, "J"]:
        return np.maximum(_SOFT_SPEED * _rms([course.velocity for course in self.courses.values()]), 1e-9)

    @cached_property
    def end_body(self) -> int:
        """The body of the deepest joint."""
        bodies = [int(self.model.jnt_bodyid[self.model.joint(name).id]) for name in self.joints]

        def depth(body: int) -> int:
            return 0 if body == 0 else 1 + depth(int(self.model.body_parentid[body]))

        return max(bodies, key=depth)

    def each(self, field: Field, joints: Sequence[int] | None = None, **further: object) -> list[Column]:
        """One column per joint, or per one of these."""
        own = range(len(self.joints)) if joints is None else joints
        return [Column(joint, field, **further) for joint in own]  # type: ignore[arg-type]

    def _exerted(self, field: Field, joints: Sequence[int] | None = None) -> list[Column]:
        """One column per joint of what drives do, and log."""
        return self.each(field, joints, logged=field)

    @property
    def driven(self) -> list[int]:
        """Joints whose drives feed a state back."""
        if self.signal == "torque":
            return []
        return [number for number, drive in enumerate(self.drives) if drive.kp or drive.kv]

    def late(self, late_s: float) -> list[Column]:
        """The drive acts on a state of `late_s` earlier: kv (v - v(t - T)) and kp (q - q(t - T)), in any proportion."""
        kp, kv = self._gains

        def apart(values: np.ndarray) -> np.ndarray:
            rows = np.arange(values.shape[1] - 1)
            place = np.maximum(rows - late_s / self._step_s, 0.0)
            low = np.floor(place).astype(int)
            share = (place - low)[:, None]
            return np.asarray(values[:, :-1] - (1 - share) * values[:, low] - share * values[:, low + 1])

        stiffness = {
            segment: segment.setup.kp_factor * kp * apart(course.position) for segment, course in self.courses.items()
        }
        damping = {segment: kv * apart(course.velocity) for segment, course in self.courses.items()}
        stiff = [joint for joint in self.driven if kp[joint]]
        return [*self._exerted(damping, self.driven), *self._exerted(stiffness, stiff)]

    def integral(self) -> list[Column]:
        """The sum of the servo's error, as the robot measured it."""
        joints = [number for number in self.driven if self.drives[number].ki is None]
        sums = {}
        for segment, course in self.courses.items():
            measured = self._measured(segment)
            told = course.command[self.signal]
            error = told - measured if self.signal == "position" else told
            sums[segment] = (np.cumsum(error, axis=1) - error) * self._step_s
            if self.signal == "velocity":
                sums[segment] -= measured - measured[:, :1]
        return self._exerted(sums, joints)

    def beginnings(self) -> list[Column]:
        """A constant torque of each driven joint in each motion: what an integral term begins with."""
        zeros = {segment: np.zeros_like(course.position[:, :-1]) for segment, course in self.courses.items()}
        ones = [{**zeros, segment: np.ones_like(own)} for segment, own in zeros.items()]
        return [Column(joint, field, within=_ANY, logged=field) for joint in self.driven for field in ones]

    def backlash(self) -> list[Column]:
        """Half of the play between motor and link, on the side to which load and friction of the link press it."""
        pressed = {segment: load + _LINK_FRICTION * self._friction(segment) for segment, load in self.loads.items()}
        size = np.maximum(_SOFT_LOAD * _rms(list(pressed.values())), 1e-12)
        twist = {segment: 0.5 * np.tanh(own / size) for segment, own in pressed.items()}
        return self._twisted(twist, np.zeros(len(self.joints)))

    def elastic(self) -> list[Column]:
        """The link hangs behind its motor by its load over the stiffness."""
        return self._twisted(self.loads, self.model.dof_armature[self._qvel])

    def _twisted(self, twist: Field, rotors: Float64[np.ndarray, "J"]) -> list[Column]:
        """Motors that are ahead of their links by a twist s, and drives that act on where the motors are.

        To the link, a drive with gains kp and kv and a rotor with inertia I add -(kp s + kv ds/dt + I d2s/dt2).
        """
        kp, kv = self._gains
        drives = {
            segment: -(segment.setup.kp_factor * kp * own + kv * np.gradient(own, self._step_s, axis=1))
            for segment, own in twist.items()
        }
        forces = drives
        if rotors.any():
            forces = {segment: own - rotors * self._bent(twist[segment]) for segment, own in drives.items()}
        driven = self.driven
        others = [joint for joint in range(len(self.joints)) if joint not in driven]
        return [*self.each(forces, driven, logged=drives), *self._behind(twist, others)]

    def _bent(self, values: np.ndarray) -> np.ndarray:
        """The second derivative of what is known at the poses only and straight between them, (W, N, J)."""
        rows, steps = np.arange(0, values.shape[1], self._every), np.arange(values.shape[1])
        if rows.size < 2:
            return np.zeros_like(values)
        apart_s = self._every * self._step_s
        bent = np.gradient(np.gradient(values[:, rows], apart_s, axis=1), apart_s, axis=1)
        return np.asarray(np.apply_along_axis(lambda own: np.interp(steps, rows, own), 1, bent))

    def _behind(self, twist: Field, joints: Sequence[int]) -> list[Column]:
        """Links that are measured behind their motors by a twist."""
        shifts = {
            segment: -segment.plan.at_stamps(np.concatenate([own, own[:, -1:]], axis=1)[None])[0]
            for segment, own in twist.items()
        }
        return self.each(shifts, joints, shifts=True)

    @property
    def _gains(self) -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"]]:
        """Stiffness of the drives as described, and what damps joints: of how much no fit can tell whose it is."""
        kp, kv = (np.array([getattr(drive, name) or 0.0 for drive in self.drives]) for name in ("kp", "kv"))
        return kp, kv + self.model.dof_damping[self._qvel]

    def _friction(self, segment: Segment) -> Float64[np.ndarray, "W N J"]:
        """What friction of the fitted model takes, in the direction of the motion [Nm or N]."""
        velocity = self.courses[segment].velocity[:, :-1]
        dry = self.model.dof_frictionloss[self._qvel] * np.tanh(velocity / self._soft_speed)
        return np.asarray(dry + self.model.dof_damping[self._qvel] * velocity)

    def load_friction(self) -> list[Column]:
        """Friction in proportion to the load of weight and Coriolis forces, as the law `load` of the catalogue has it.

        Where a joint rests, it acts against its last motion.
        """
        forces = {}
        for segment, course in self.courses.items():
            load = self._inverse(segment, course.model, steady=True)
            forces[segment] = -np.abs(load) * self._direction(course.velocity[:, :-1])
        return self.each(forces)

    def _direction(self, velocity: Float64[np.ndarray, "W N J"]) -> Float64[np.ndarray, "W N J"]:
        """Where joints move to, -1 to 1; kept while they are slower than is told from rest."""
        rows = np.where(np.abs(velocity) >= self._soft_speed, np.arange(velocity.shape[1])[:, None], 0)
        last = np.maximum.accumulate(rows, axis=1)
        return np.asarray(np.tanh(np.take_along_axis(velocity, last, axis=1) / self._soft_speed))

    def warming(self) -> list[Column]:
        """Fitted friction, as much less as time goes on; over all recordings where their clocks go on."""
        begins = {segment: float(segment.plan.measured.time_s[0]) for segment in self.courses}
        longest = max(segment.seconds for segment in self.courses)
        if max(begins.values()) - min(begins.values()) > longest:
            begins = dict.fromkeys(begins, min(begins.values()))
        times = {segment: segment.plan.grid_s - begin for segment, begin in begins.items()}
        middle = float(np.mean([own.mean() for own in times.values()]))
        return self.each(
            {segment: self._friction(segment) * (times[segment] - middle)[..., None] for segment in self.courses}
        )

    def speed_limit(self) -> list[Column]:
        """A brake above the largest speed that was measured."""
        speeds = [
            np.abs(np.gradient(segment.plan.measured["position"], segment.plan.measured.time_s, axis=0))
            for segment in self.courses
        ]
        top = np.nanpercentile(np.concatenate(speeds), _FASTEST, axis=0)
        forces = {}
        for segment, course in self.courses.items():
            velocity = course.velocity[:, :-1]
            forces[segment] = -np.sign(velocity) * np.maximum(np.abs(velocity) - top, 0.0)
        return self._exerted(forces)

    def payload(self) -> list[Column]:
        """A mass at the origin of the last body, and its first moments along the axes of that body."""

        def heavier(place: np.ndarray) -> Field:
            return {
                segment: (self.loads[segment] - self._inverse(segment, _with_point(course.model, self.end_body, place)))
                / _MASS
                for segment, course in self.courses.items()
            }

        mass = heavier(np.zeros(3))
        moments = []
        for axis in _ARM * np.eye(3):
            there, opposite = heavier(axis), heavier(-axis)
            moments.append({key: (there[key] - opposite[key]) / (2 * _ARM) for key in mass})
        return [Column(None, mass), *(Column(None, field, within=_ANY) for field in moments)]

    def mirrored(self) -> list[Column]:
        """The torque of a robot whose joint turns the other way than the model says, for each joint."""
        found = []
        for joint in range(len(self.joints)):
            field = {
                segment: self.loads[segment] - self._inverse(segment, course.model, mirrored=joint)
                for segment, course in self.courses.items()
            }
            found.append(_AtJoint(joint, field, within=_ONE))
        return list(found)

    def mirrored_measurement(self) -> list[Column]:
        """A joint that is measured the other way round than it is commanded."""
        twice = {segment: 2.0 * segment.plan.measured["position"] for segment in self.courses}
        return self.each(twice, shifts=True, within=_ONE)

    def _measured(self, segment: Segment) -> Float64[np.ndarray, "W N J"]:
        """Measured positions in each simulation step, as the simulation counts them [rad or m]."""
        plan, values = segment.plan, segment.plan.measured["position"]
        columns = [np.interp(plan.grid_s, plan.measured.time_s, column) for column in np.nan_to_num(values).T]
        return np.asarray(np.stack(columns, axis=-1) + self.courses[segment].zeros)

    def _inverse(
        self, segment: Segment, model: mujoco.MjModel, *, mirrored: int | None = None, steady: bool = False
    ) -> np.ndarray:
        """Torque that a model's links take along a motion, without rotors, friction and limits, (W, N, J).

        Args:
            segment: whose motion.
            model: with the links.
            mirrored: a joint that turns the other way.
            steady: as if nothing was accelerated.
        """
        course, model = self.courses[segment], copy.copy(model)
        sign = np.where(np.arange(len(self.joints)) == mirrored, -1.0, 1.0)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model.dof_damping[:], model.dof_armature[:], model.jnt_user[:] = 0.0, 0.0, 0.0
        data = mujoco.MjData(model)
        windows, steps = course.position.shape[0], course.position.shape[1] - 1
        rows = np.unique(np.append(np.arange(0, steps, self._every), steps - 1))
        acceleration = (0.0 if steady else 1.0) * np.gradient(course.velocity, self._step_s, axis=1)
        out, some = np.empty((windows, steps, sign.size)), np.empty((rows.size, sign.size))
        for window in range(windows):
            for place, row in enumerate(rows):
                data.qpos[self._qpos] = sign * course.position[window, row]
                data.qvel[self._qvel] = sign * course.velocity[window, row]
                data.qacc[self._qvel] = sign * acceleration[window, row]
                mujoco.mj_inverse(model, data)
                some[place] = sign * data.qfrc_inverse[self._qvel]
            for joint in range(sign.size):
                out[window, :, joint] = np.interp(np.arange(steps), rows, some[:, joint])
        return out


class _AtJoint(Column):
    """A column that is about one joint, and acts on all."""

    def of(self, segment: Segment) -> np.ndarray:
        """The whole field."""
        return self.field[segment]


@dataclass(frozen=True)
class Cause:
    """One kind of thing that a model lacks.

    Attributes:
        name: in fit.json.
        words: with the joints in `{joints}` and the size in `{size}`.
        unit: of the size at a hinge.
        columns: what one unit of it adds.
        beginnings: whether each motion begins with an unknown torque of its own.
        size: the size that is told, by the coefficient; None where parameters hide an unknown part of it.
        together: whether its columns make sense only together.
        single: whether only one joint is looked for, since several look alike.
        least: a smaller size is no cause, since every simulation has as much of its own.
    """

    name: str
    words: str
    unit: str
    columns: Callable[[Motions], list[Column]]
    beginnings: bool = False
    size: Callable[[float], float] | None = float
    together: bool = False
    single: bool = False
    least: float = 0.0


def late_feedback(late_s: float) -> Cause:
    """The drive acts on a state of so long ago [s]."""
    return Cause(
        "late-feedback",
        "late feedback in the drive of {joints} ({size})",
        "s",
        lambda motions: motions.late(late_s),
        # What parameters cannot hide of it goes with the square.
        size=lambda share: late_s * max(share, 0.0) ** 0.5,
        least=_LEAST_LATE_S,
    )


CAUSES: tuple[Cause, ...] = (
    Cause(
        "integral",
        "an integral term in the drive of {joints} ({size})",
        "Nm/(rad s)",
        Motions.integral,
        beginnings=True,
    ),
    Cause("backlash", "backlash between motor and link of {joints} ({size})", "rad", Motions.backlash),
    Cause("elastic-joint", "an elastic gear of {joints}", "", Motions.elastic, size=None),
    Cause("load-friction", "friction that grows with the load of {joints} ({size})", "", Motions.load_friction),
    Cause("warming", "friction of {joints} that falls with time ({size})", "1/s", Motions.warming),
    Cause("speed-limit", "a largest speed of the drive of {joints}", "", Motions.speed_limit, size=None),
    Cause(
        "payload",
        "a mass at {joints} that the model does not have",
        "",
        Motions.payload,
        size=None,
        together=True,
    ),
    Cause(
        "mirrored",
        "{joints} counting the other way round than in the model",
        "",
        Motions.mirrored,
        size=None,
        single=True,
    ),
    Cause(
        "mirrored-measurement",
        "{joints} measured the other way round than commanded",
        "",
        Motions.mirrored_measurement,
        size=None,
    ),
)


def _rms(parts: Sequence[np.ndarray]) -> Float64[np.ndarray, "J"]:
    """Root mean square over all but the last axis of several arrays."""
    return np.asarray(np.sqrt(np.mean([np.mean(own**2, axis=(0, 1)) for own in parts], axis=0)))


def _with_point(model: mujoco.MjModel, body: int, place: np.ndarray) -> mujoco.MjModel:
    """A copy of a model with a small point mass in the frame of a body."""
    model = copy.copy(model)
    both = inertial_of(model, model.body(body).name).plus(Inertial.point(_MASS, place))
    moments, axes = np.linalg.eigh(both.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = both.mass, both.com, moments
    mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
    model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)  # or these axes do not count
    return model
