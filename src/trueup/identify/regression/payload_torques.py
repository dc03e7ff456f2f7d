"""What a robot carries, by its torques alone: inverse dynamics of motions with a payload and without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.core.episode import Episode
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.identify.regression.mass_regression import choose_cutoff
from trueup.identify.regression.samples import TORQUE_UNIT, Samples, SampleSettings, gather

# What is read as a torque: a torque that was measured, a motor current of unknown factor, or the command.
TorqueSignal = Literal["torque", "current", "command"]
INERTIAL = 10  # mass, first moments, and the inertia about the body's origin: xx, yy, zz, xy, xz, yz
_TERMS = 4  # of a joint: armature, viscous and Coulomb friction, a constant
_ROWS = 1200  # of each of the two, about
_ROUNDS = 8
_LEAST_SPEED = 0.2  # of a joint's RMS velocity; slower, dry friction is no function of the velocity
_EPSILON = 0.05  # width of the smoothed Coulomb step [rad/s or m/s]
_PIECE_S = 0.5  # pieces of motion that count as independent
_EXPLAINED = 0.5  # share of the torque's variance without which a joint is left out
# How well the model is believed, one standard deviation: masses; centers, as a share of the radius of gyration;
# inertias; and a torque in Nm, which may be a current times a constant.
_MASS, _CENTER, _INERTIA, _FACTOR = 0.1, 0.1, 0.2, 0.05
# What is believed of a payload: next to nothing [kg, kg m, kg m2]; of the logarithm of a current's factor; of joints,
# in typical torques.
_PAYLOAD, _LOOSE, _FRICTION = (10.0, 1.0, 0.1), 1.0, 10.0
_LEAST_ROWS = 100


@dataclass(frozen=True, eq=False)
class TorqueLoad:
    """A payload that torques show.

    Attributes:
        mass: [kg].
        center: in the frame of the body that carries it, (3,) [m].
        covariance: of mass and center, (4, 4) [kg, m].
        factors: joint -> Nm (or N) per logged unit; 1 for a torque that is what it says.
        left_out: joints whose torque the model does not explain.
    """

    mass: float
    center: Float64[np.ndarray, "3"]
    covariance: Float64[np.ndarray, "4 4"]
    factors: Mapping[str, float]
    left_out: tuple[str, ...]


def torque_signal(episodes: Sequence[Episode], *, torque_driven: bool) -> TorqueSignal:
    """Which signal of all these logs is a torque.

    Raises:
        MissingSignal: none.
    """
    names: tuple[TorqueSignal, ...] = ("torque", "current")
    for name in names:
        if all(name in episode.measured for episode in episodes):
            return name
    if torque_driven:
        return "command"
    raise MissingSignal(
        "the logs hold neither torques nor motor currents", available=sorted(set(episodes[0].measured.signals))
    )


def weigh_by_torque(
    model: mujoco.MjModel,
    body: str,
    free: Sequence[Episode],
    loaded: Sequence[Episode],
    *,
    signal: TorqueSignal,
    joints: Sequence[str],
    delay_s: float = 0.0,
) -> TorqueLoad:
    """Mass and center of mass of a payload, by least squares that are linear but for the factors.

    With y the logged torque of a joint, tau_0 what the model says without friction, Y_b the regressor of body b (10
    columns), and s = 1 where the payload is carried and 0 elsewhere,

        g y = tau_0 + sum_b Y_b delta_b + a ddq + d dq + c tanh(dq / eps) + o + s Y_body phi,

    phi = (m, m c, I). All of g, delta, a, d, c, o and phi are unknown and the same in all motions: what the model has
    wrong shows in both kinds of motions, the payload in one. delta and g have a prior: the model's masses are known to
    10 %, a torque in Nm to 5 %; of a current, g is unknown.

    Source: Atkeson, An, Hollerbach 1986, "Estimation of inertial parameters of manipulator loads and links", for Y.

    Args:
        model: without the payload; hinges and slides on a fixed base.
        body: that carries it.
        free: motions without it, in the robot's names.
        loaded: motions with it.
        signal: which is read as a torque.
        joints: that count.
        delay_s: of a command.

    Raises:
        ConfigError: a joint is neither hinge nor slide.
        DataError: too few rows, or no joint whose torque the model explains.
        TrueupError: what a log lacks.
    """
    if model.nv != model.njnt or model.nq != model.njnt:
        raise ConfigError("torques are compared for hinges and slides on a fixed base", got=f"{model.nv} freedoms")
    if signal == "current":
        free, loaded = [_as_torque(log) for log in free], [_as_torque(log) for log in loaded]
    settings = SampleSettings(
        delay_s=delay_s if signal == "command" else 0.0,
        smooth_torque=True,
        torque="command" if signal == "command" else "measured",
    )
    settings = replace(settings, cutoff_hz=choose_cutoff(free, model, settings, joints))

    def rows_of(own: SampleSettings, later_s: float = 0.0) -> tuple[_Rows, _Rows]:
        own = replace(own, delay_s=own.delay_s + later_s)
        one, other = ([_later(log, later_s) for log in logs] for logs in (free, loaded))
        return tuple(_Rows.of(gather(logs, own, joints=joints), model, body) for logs in (one, other))  # type: ignore[return-value]

    one, other = rows_of(settings)
    spread = _Spreads.of(model, one)
    kept = _explained(one, spread, signal)
    if not kept.any():
        raise DataError("the model explains the torques of no joint by half", got=f"{signal} of {len(joints)} joints")
    solved = _solved(one.joined(other), spread, kept, signal)
    found = _inertial(solved)
    # What a low-pass takes away, and when within a sample a torque was read, nobody knows.
    half_s = 0.5 / float(np.median([log.measured.rate_hz for log in loaded]))
    ways = rows_of(replace(settings, cutoff_hz=0.5 * settings.cutoff_hz)), rows_of(settings, half_s)
    shifts = [_inertial(_solved(a.joined(b), spread, kept, signal)) - found for a, b in ways]
    place = slice(solved.values.size - INERTIAL, solved.values.size - INERTIAL + 4)
    covariance = solved.covariance[place, place] + sum(np.outer(shift, shift) for shift in shifts)
    mass = float(found[0])
    safe = np.copysign(max(abs(mass), 1e-3), mass)
    center = np.clip(found[1:] / safe, -2.0, 2.0)
    slope = np.eye(4) / safe  # c = h / m: dc = (dh - c dm) / m
    slope[0], slope[1:, 0] = [1.0, 0.0, 0.0, 0.0], -center / safe
    factors = dict(zip(joints, map(float, solved.factors), strict=True))
    left_out = tuple(name for name, own in zip(joints, kept, strict=True) if not own)
    return TorqueLoad(mass, center, slope @ covariance @ slope.T, factors, left_out)


def _inertial(solved: _Solved) -> Float64[np.ndarray, "4"]:
    """Mass and first moments of the payload [kg, kg m]."""
    return solved.values[-INERTIAL:][:4]


def _later(log: Episode, later_s: float) -> Episode:
    """The log with its torques read this much earlier than their stamps say [s]."""
    measured = log.measured
    if not later_s or "torque" not in measured:
        return log
    time_s, torque = measured.time_s, np.asarray(measured["torque"], np.float64)
    moved = np.stack([np.interp(time_s - later_s, time_s, own) for own in torque.T], axis=1)
    return replace(log, measured=replace(measured, signals={**measured.signals, "torque": moved}))


def _as_torque(log: Episode) -> Episode:
    """A current in the place of the torque, of which only its factor is unknown."""
    measured = log.measured
    units = tuple(TORQUE_UNIT.get(unit, unit) for unit in measured.units["position"])
    signals = {**measured.signals, "torque": measured["current"]}
    return replace(log, measured=replace(measured, signals=signals, units={**measured.units, "torque": units}))


@dataclass(frozen=True, eq=False)
class _Rows:
    """T rows of J joints.

    Attributes:
        logged: (T, J).
        model: what the model says, (T, J).
        links: regressors of the B bodies that move, (T, J, 10 B).
        payload: that of the body that carries it, zero without it, (T, J, 10).
        velocity: (T, J).
        acceleration: (T, J).
        piece: number of the piece of motion, (T,).
    """

    logged: Float64[np.ndarray, "T J"]
    model: Float64[np.ndarray, "T J"]
    links: Float64[np.ndarray, "T J L"]
    payload: Float64[np.ndarray, "T J K"]
    velocity: Float64[np.ndarray, "T J"]
    acceleration: Float64[np.ndarray, "T J"]
    piece: Int[np.ndarray, "T"]

    @staticmethod
    def of(samples: Samples, model: mujoco.MjModel, body: str) -> _Rows:
        states = [samples.position, samples.velocity, samples.acceleration, samples.torque]
        complete = np.flatnonzero(np.all([np.isfinite(values).all(axis=1) for values in states], axis=0))
        complete = complete[:: max(1, complete.size // _ROWS)]
        if complete.size < _LEAST_ROWS:
            raise DataError("too few rows to compare torques", got=complete.size, expected=f"at least {_LEAST_ROWS}")
        position, velocity, acceleration, logged = (values[complete] for values in states)
        said, table = _regressors(model, samples.joints, position, velocity, acceleration)
        bodies = moving_bodies(model)
        place = INERTIAL * bodies.index(int(model.body(body).id))
        columns = [model.joint(name).id for name in samples.joints]
        springs = model.jnt_stiffness[columns] * (position - model.qpos_spring[columns])
        number = samples.motion * 100_000 + np.floor(samples.time_s / _PIECE_S).astype(np.int64) % 100_000
        return _Rows(
            logged,
            said + springs,
            table,
            table[:, :, place : place + INERTIAL],
            velocity,
            acceleration,
            np.unique(number[complete], return_inverse=True)[1],
        )

    def without_payload(self) -> _Rows:
        return replace(self, payload=np.zeros_like(self.payload))

    def joined(self, loaded: _Rows) -> _Rows:
        """These rows without the payload, and those with it."""
        own = self.without_payload()
        pairs = {
            name: np.concatenate([getattr(own, name), getattr(loaded, name)])
            for name in ("logged", "model", "links", "payload", "velocity", "acceleration")
        }
        return _Rows(**pairs, piece=np.concatenate([own.piece, own.piece.max() + 1 + loaded.piece]))

    def table(self) -> Float64[np.ndarray, "T J P"]:
        """All columns: links, terms of the joints, and payload."""
        own = np.eye(self.logged.shape[1])
        speed, ones = np.tanh(self.velocity / _EPSILON), np.ones_like(self.velocity)
        terms = [term[:, :, None] * own for term in (self.acceleration, self.velocity, speed, ones)]
        return np.concatenate([self.links, *terms, self.payload], axis=2)


@dataclass(frozen=True, eq=False)
class _Spreads:
    """What is believed before: standard deviations of all numbers but the factors, and typical torques.

    Attributes:
        links: (L,).
        torque: typical of each joint, by the model, (J,).
    """

    links: Float64[np.ndarray, "L"]
    torque: Float64[np.ndarray, "J"]

    @staticmethod
    def of(model: mujoco.MjModel, rows: _Rows) -> _Spreads:
        links = []
        for body in moving_bodies(model):
            mass, place = float(model.body_mass[body]), model.body_ipos[body]
            radius = float(np.sqrt(0.5 * model.body_inertia[body].sum() / mass)) if mass > 0 else 0.0
            first = _MASS * mass * np.abs(place) + _CENTER * mass * max(radius, 0.01)
            inertia = _INERTIA * (float(model.body_inertia[body].max()) + mass * float(place @ place))
            links.append([_MASS * mass, *first, *([inertia] * 6)])
        size = np.sqrt((rows.model**2).mean(axis=0))
        return _Spreads(np.maximum(np.concatenate(links), 1e-9), np.maximum(size, 1e-6))

    def prior(self, rows: _Rows) -> Float64[np.ndarray, "P"]:
        """Standard deviations of all numbers around zero, in the order of the columns of `table`, (P,)."""
        moving = [np.sqrt((own**2).mean(axis=0)) for own in (rows.acceleration, rows.velocity)]
        sizes = [self.torque / np.maximum(own, 1e-6) for own in moving]
        terms = [_FRICTION * own for own in (*sizes, self.torque, self.torque)]
        return np.concatenate([self.links, *terms, np.repeat(_PAYLOAD, (1, 3, 6))])


def _explained(rows: _Rows, spread: _Spreads, signal: TorqueSignal) -> Bool[np.ndarray, "J"]:
    """Joints whose torque the model explains where nothing is carried: others have no torque, or one without a sign."""
    rows = rows.without_payload()
    found = _solved(rows, spread, np.ones(rows.logged.shape[1], bool), signal)
    torque = rows.logged * found.factors
    left = torque - rows.model - rows.table() @ found.values
    size = np.maximum(torque.std(axis=0), 1e-12)
    return np.asarray((left.std(axis=0) < np.sqrt(1.0 - _EXPLAINED) * size) & (found.factors > 0))


@dataclass(frozen=True, eq=False)
class _Solved:
    """Values of all columns, (P,), their covariance, (P, P), and Nm per logged unit, (J,)."""

    values: Float64[np.ndarray, "P"]
    covariance: Float64[np.ndarray, "P P"]
    factors: Float64[np.ndarray, "J"]


def _solved(rows: _Rows, spread: _Spreads, kept: Bool[np.ndarray, "J"], signal: TorqueSignal) -> _Solved:
    """Gauss-Newton for g y = tau, which is linear but for g; joints weigh by what is left of them.

    Pieces of half a second count as independent: the covariance is A^-1 (B + L) A^-1 with A the weighted squares and
    the precision L of the prior, B the sum of squares of the pieces' scores (Liang & Zeger 1986).
    """
    std, table = spread.prior(rows), rows.table()
    count, width = std.size, rows.logged.shape[1]
    moving = np.abs(rows.velocity) >= _LEAST_SPEED * np.sqrt((rows.velocity**2).mean(axis=0))
    used = moving & kept
    begun = _factors(rows, used) if signal == "current" else np.ones(width)
    widths = np.concatenate([std, np.full(width, _LOOSE if signal == "current" else _FACTOR)])
    values, logs, noise = np.zeros(count), np.zeros(width), spread.torque.copy()
    for _ in range(_ROUNDS):
        said = rows.model + table @ values
        left = (rows.logged * (begun * np.exp(logs)) - said) * used
        # A change of log g moves tau = g y by tau; taken of the model's tau, which has less noise than y.
        columns = np.concatenate([table, -said[:, :, None] * np.eye(width)], axis=2) * widths * used[:, :, None]
        noise = np.maximum(np.sqrt((left**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1)), 1e-4 * spread.torque)
        weighed = columns / noise[:, None]
        flat = weighed.reshape(-1, count + width)
        square = flat.T @ flat + np.eye(count + width)
        now = np.concatenate([values, logs]) / widths
        step = np.linalg.solve(square, flat.T @ (left / noise).ravel() - now) * widths
        values, logs = values + step[:count], logs + np.clip(step[count:], -0.5, 0.5)
    scores = np.einsum("tjp,tj->tp", weighed, left / noise)
    sums = np.zeros((int(rows.piece.max()) + 1, scores.shape[1]))
    np.add.at(sums, rows.piece, scores)
    inverse = np.linalg.inv(square)
    middle = sums.T @ sums * len(sums) / max(1, len(sums) - 1) + np.eye(len(square))
    covariance = (inverse @ middle @ inverse * np.outer(widths, widths))[:count, :count]
    return _Solved(values, covariance, begun * np.exp(logs))


def _factors(rows: _Rows, used: Bool[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Nm per logged unit of each joint: y = tau / g and friction, by least squares; 1 where that says nothing."""
    found = np.ones(rows.logged.shape[1])
    for joint in range(found.size):
        own = used[:, joint]
        speed = rows.velocity[own, joint]
        terms = (rows.model[own, joint], rows.acceleration[own, joint], speed, np.tanh(speed / _EPSILON))
        columns = np.stack([*terms, np.ones_like(speed)], axis=1)
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        slope = np.linalg.lstsq(columns / size, rows.logged[own, joint], rcond=1e-6)[0][0] / size[0]
        found[joint] = 1.0 / slope if abs(slope) > 1e-9 else 1.0
    return found


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """Numbers of the bodies that move."""
    return [int(body) for body in range(1, model.nbody) if model.body_weldid[body] > 0]


def _regressors(
    model: mujoco.MjModel,
    joints: Sequence[str],
    position: Float64[np.ndarray, "T J"],
    velocity: Float64[np.ndarray, "T J"],
    acceleration: Float64[np.ndarray, "T J"],
) -> tuple[Float64[np.ndarray, "T J"], Float64[np.ndarray, "T J L"]]:
    """Torques of the model without friction, and what they change by per inertial number of each moving body.

    Of a body with mass m, first moments h and inertia I about its origin, in its frame, whose origin accelerates by a
    (gravity taken off) and which turns with w and dw, force and moment are
    f = m a + dw x h + w x (w x h) and n = h x a + I dw + w x (I w); the joints bear J_p^T f + J_r^T n.
    """
    bare = mujoco.MjModel.__copy__(model)
    bare.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    for field in ("dof_damping", "dof_dampingpoly", "jnt_stiffness", "jnt_stiffnesspoly", "jnt_user"):
        if hasattr(bare, field):
            getattr(bare, field)[:] = 0.0
    data, bodies = mujoco.MjData(bare), moving_bodies(model)
    columns = [model.joint(name).id for name in joints]
    said, table = np.empty_like(position), np.empty((*position.shape, INERTIAL * len(bodies)))
    linear, turning, spin, change = np.empty((3, bare.nv)), np.empty((3, bare.nv)), np.empty(6), np.empty(6)
    for row in range(len(position)):
        data.qpos[columns], data.qvel[columns], data.qacc[columns] = position[row], velocity[row], acceleration[row]
        mujoco.mj_inverse(bare, data)
        said[row] = data.qfrc_inverse[columns]
        mujoco.mj_rnePostConstraint(bare, data)
        for number, body in enumerate(bodies):
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectVelocity(bare, data, kind, body, spin, 1)
            mujoco.mj_objectAcceleration(bare, data, kind, body, change, 1)
            mujoco.mj_jac(bare, data, linear, turning, data.xpos[body], body)
            axes = data.xmat[body].reshape(3, 3)
            force, moment = _wrench(spin[:3], change[:3], change[3:])
            own = (axes.T @ linear).T @ force + (axes.T @ turning).T @ moment
            table[row, :, INERTIAL * number : INERTIAL * (number + 1)] = own[columns]
    return said, table


def _wrench(
    w: Float64[np.ndarray, "3"], dw: Float64[np.ndarray, "3"], a: Float64[np.ndarray, "3"]
) -> tuple[Float64[np.ndarray, "3 10"], Float64[np.ndarray, "3 10"]]:
    """Force and moment per inertial number, in the body's frame."""
    cross = _cross(w)
    force, moment = np.zeros((3, INERTIAL)), np.zeros((3, INERTIAL))
    force[:, 0] = a
    force[:, 1:4] = _cross(dw) + cross @ cross
    moment[:, 1:4] = -_cross(a)
    moment[:, 4:] = _turned(dw) + cross @ _turned(w)
    return force, moment


def _cross(v: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _turned(v: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 6"]:
    """I v per xx, yy, zz, xy, xz, yz of I."""
    x, y, z = v
    return np.array([[x, 0.0, 0.0, y, z, 0.0], [0.0, y, 0.0, x, 0.0, z], [0.0, 0.0, z, 0.0, x, y]])
