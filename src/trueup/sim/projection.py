"""Bodies that were moved one by one, and the joints that hold them together (SAT, VII: the paper's stated limit).

`JointGaps` says how far bodies have come apart where they are joined, `Projection` finds the robot that is nearest to
them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, Float64

from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import MissingSignal, NameMismatch
from trueup.sim.closed_chains import equalities

POSITION, ROTATION = (f"{BODY_PREFIX}{name}" for name in ("position", "rotation"))
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
# Of the distance to where a joint was simulated: only so much that joints which move no marked body stay there.
_HOLD = 1e-3
_ITERATIONS = 20
# A Gauss-Newton step that moves no joint further than this is the last [rad or m].
_ARRIVED = 1e-10
_CLOSED = 1e-9


@dataclass(frozen=True, eq=False)
class Gaps:
    """How far bodies are from being joined.

    Attributes:
        joints: C joints, and connections of closed chains, both of whose bodies are known.
        apart_m: distance between the two halves of each, across a slide only, (T, C).
        turned_rad: angle between the two halves, about a hinge's own axis excepted, (T, C); 0 for connections.
    """

    joints: tuple[str, ...]
    apart_m: Float64[np.ndarray, "T C"]
    turned_rad: Float64[np.ndarray, "T C"]


class JointGaps:
    """Measures how far bodies have come apart.

    Bodies that are fixed to the world are where the model has them; of others a joint is looked at if both of its
    bodies are given.

    Args:
        model: that the bodies are of.
        bodies: names of M bodies.

    Raises:
        NameMismatch: a body is not in the model.
    """

    def __init__(self, model: mujoco.MjModel, bodies: Sequence[str]) -> None:
        self._model, self._bodies = model, _numbers(model, bodies)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self._fixed: dict[int, tuple[np.ndarray, np.ndarray]] = {
            number: (data.xpos[number].copy(), data.xmat[number].reshape(3, 3).copy())
            for number in range(model.nbody)
            if model.body_weldid[number] == 0
        }
        known = {*self._bodies, *self._fixed}
        # Several joints between two bodies would have to be told from one another.
        self._joints = [
            number
            for number in range(model.njnt)
            if int(model.jnt_type[number]) in (_HINGE, _SLIDE)
            and model.body_jntnum[model.jnt_bodyid[number]] == 1
            and int(model.jnt_bodyid[number]) in self._bodies
            and int(model.body_parentid[model.jnt_bodyid[number]]) in known
        ]
        self._connections = [
            number
            for number in range(model.neq)
            if model.eq_type[number] == mujoco.mjtEq.mjEQ_CONNECT
            and model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_BODY
            and {int(model.eq_obj1id[number]), int(model.eq_obj2id[number])} <= known
        ]
        self.joints = (
            *(model.joint(number).name for number in self._joints),
            *(model.equality(number).name or f"connection {number}" for number in self._connections),
        )

    def of(self, series: TimeSeries) -> Gaps:
        """The gaps of bodies that have both signals, in the order in which they were named.

        Raises:
            MissingSignal: there are no positions or no rotations.
        """
        for name in (POSITION, ROTATION):
            if name not in series:
                raise MissingSignal(f"gaps between bodies need {name}", available=series.signals)
        rows = len(series)
        apart, turned = np.zeros((rows, len(self.joints))), np.zeros((rows, len(self.joints)))
        for column, number in enumerate(self._joints):
            apart[:, column], turned[:, column] = self._joint(number, series)
        for column, number in enumerate(self._connections, start=len(self._joints)):
            data = self._model.eq_data[number]
            ends = (self._model.eq_obj1id[number], data[:3]), (self._model.eq_obj2id[number], data[3:6])
            first, second = (self._point(int(body), place, series) for body, place in ends)
            apart[:, column] = _lengths(first - second)
        return Gaps(self.joints, apart, turned)

    def _joint(self, number: int, series: TimeSeries) -> tuple[Float64[np.ndarray, "T"], Float64[np.ndarray, "T"]]:
        model = self._model
        body = int(model.jnt_bodyid[number])
        parent = int(model.body_parentid[body])
        seat = _matrix(model.body_quat[body])
        place, axis = model.jnt_pos[number], model.jnt_axis[number]
        off = self._point(body, place, series) - self._point(parent, model.body_pos[body] + seat @ place, series)
        held, own = self._turn(parent, series) @ seat, self._turn(body, series)
        if int(model.jnt_type[number]) == _SLIDE:
            along = held @ axis
            off = off - (off * along).sum(axis=-1, keepdims=True) * along
            return _lengths(off), _angle(np.swapaxes(held, -1, -2) @ own)
        first, second = held @ axis, own @ axis
        sine = _lengths(np.cross(first, second))
        turned: np.ndarray = np.arctan2(sine, (first * second).sum(axis=-1))
        return _lengths(off), turned

    def _point(self, body: int, place: np.ndarray, series: TimeSeries) -> Float64[np.ndarray, "T 3"]:
        if body in self._fixed:
            position, turn = self._fixed[body]
            return np.broadcast_to(position + turn @ place, (len(series), 3))
        at = self._bodies.index(body)
        return np.asarray(series[POSITION][:, at] + series[ROTATION][:, at] @ place)

    def _turn(self, body: int, series: TimeSeries) -> Float64[np.ndarray, "*T 3 3"]:
        if body in self._fixed:
            turn: np.ndarray = self._fixed[body][1]
            return turn
        return np.asarray(series[ROTATION][:, self._bodies.index(body)])


class Projection:
    """Finds the joint positions whose bodies are nearest to given ones: a robot again, with all constraints kept.

    Weighted Gauss-Newton over the coordinates of the model, sample by sample, from the simulated motion; closed chains
    are kept closed by their Lagrange multipliers. Joints that move none of the bodies stay as they were simulated.

    Args:
        model: that the bodies are of.
        joints: names of J joints of the robot.
        bodies: names of M bodies.
        rotation_m: how many meters of distance a radian counts as.

    Raises:
        NameMismatch: a joint or body is not in the model.
    """

    def __init__(
        self, model: mujoco.MjModel, joints: Sequence[str], bodies: Sequence[str], *, rotation_m: float = 0.05
    ) -> None:
        known = [model.joint(number).name for number in range(model.njnt)]
        missing = [name for name in joints if name not in known]
        if missing:
            raise NameMismatch(f"joints {missing} are not in the model", left=joints, right=known)
        self._model, self._data = model, mujoco.MjData(model)
        self._bodies = _numbers(model, bodies)
        self._coordinates = np.array([model.joint(name).qposadr[0] for name in joints], int)
        self._dofs = np.array([model.joint(name).dofadr[0] for name in joints], int)
        self._weights: Mapping[str, float] = {POSITION: 1.0, ROTATION: rotation_m}

    def nearest(self, series: TimeSeries) -> TimeSeries:
        """The series with joint positions and bodies of the nearest robot; its other signals are as they were.

        Args:
            series: with the `position` that was simulated, and `body.position`, `body.rotation` or both of the bodies,
                in the order in which they were named.

        Raises:
            MissingSignal: there are no joint positions, or no poses of bodies.
        """
        wanted = [name for name in self._weights if name in series]
        if not wanted or "position" not in series:
            raise MissingSignal("a projection needs joint positions and poses of bodies", available=series.signals)
        signals = {name: np.array(values) for name, values in series.signals.items()}
        simulated = np.asarray(series["position"], np.float64)
        self._data.qpos[:] = self._model.qpos0
        for row in range(len(series)):
            # Passive joints of closed chains are near to where they were.
            self._data.qpos[self._coordinates] = simulated[row]
            self._solve({name: np.asarray(series[name][row], np.float64) for name in wanted}, simulated[row])
            signals["position"][row] = self._data.qpos[self._coordinates]
            for name, values in self._poses().items():
                if name in signals:
                    signals[name][row] = values
        return TimeSeries(series.time_s, series.joints, signals, series.units, series.bodies)

    def _solve(self, wanted: Mapping[str, np.ndarray], simulated: Float64[np.ndarray, "J"]) -> None:
        model, data = self._model, self._data
        for _ in range(_ITERATIONS):
            mujoco.mj_fwdPosition(model, data)
            jacobian, residual = self._residual(wanted, simulated)
            normal, pull = jacobian.T @ jacobian, jacobian.T @ residual
            chains, open_by = equalities(model, data)
            size, count = model.nv, len(open_by)
            # A passive joint that nothing asks for is held by its chain, or by next to nothing.
            system = np.zeros((size + count, size + count))
            system[:size, :size] = normal + 1e-12 * np.trace(normal) * np.eye(size)
            system[:size, size:], system[size:, :size] = chains.T, chains
            right = np.concatenate([pull, -open_by])
            step = np.linalg.lstsq(system, right, rcond=None)[0] if count else np.linalg.solve(system, right)
            mujoco.mj_integratePos(model, data.qpos, np.ascontiguousarray(step[:size]), 1.0)
            if np.abs(step[:size]).max() < _ARRIVED and np.abs(open_by).max(initial=0.0) < _CLOSED:
                break
        mujoco.mj_fwdPosition(model, data)

    def _residual(
        self, wanted: Mapping[str, np.ndarray], simulated: Float64[np.ndarray, "J"]
    ) -> tuple[Float64[np.ndarray, "R V"], Float64[np.ndarray, "R"]]:
        """What is left to go, and how each coordinate goes there."""
        model, data = self._model, self._data
        rows, left = [], []
        own = self._poses()
        for place, body in enumerate(self._bodies):
            forward, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
            mujoco.mj_jacBody(model, data, forward, turning, body)
            if POSITION in wanted:
                rows.append(forward)
                left.append(wanted[POSITION][place] - own[POSITION][place])
            if ROTATION in wanted:
                weight = self._weights[ROTATION]
                rows.append(weight * turning)
                left.append(weight * _turn_between(own[ROTATION][place], wanted[ROTATION][place]))
        hold = np.zeros((len(self._dofs), model.nv))
        hold[np.arange(len(self._dofs)), self._dofs] = _HOLD * self._weights[ROTATION]
        rows.append(hold)
        left.append(_HOLD * self._weights[ROTATION] * (simulated - data.qpos[self._coordinates]))
        return np.concatenate(rows), np.concatenate(left)

    def _poses(self) -> dict[str, Float64[np.ndarray, "M ..."]]:
        turned = self._data.xmat[self._bodies].reshape(-1, 3, 3)
        return {POSITION: self._data.xpos[self._bodies], ROTATION: turned}


def _numbers(model: mujoco.MjModel, bodies: Sequence[str]) -> list[int]:
    known = [model.body(number).name for number in range(model.nbody)]
    missing = [name for name in bodies if name not in known]
    if missing:
        raise NameMismatch(
            f"bodies {missing} are not in the model", left=bodies, right=known[1:], right_name="model has"
        )
    return [known.index(name) for name in bodies]


def _lengths(vectors: Float[np.ndarray, "T 3"]) -> Float64[np.ndarray, "T"]:
    return np.asarray(np.sqrt((vectors**2).sum(axis=-1)))


def _matrix(quaternion: np.ndarray) -> Float64[np.ndarray, "3 3"]:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def _turn_between(start: Float[np.ndarray, "3 3"], end: Float[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3"]:
    """Axis times angle, in the axes of the world, that turns one into the other."""
    quaternion, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(end @ start.T).ravel())
    mujoco.mju_quat2Vel(turn, quaternion, 1.0)
    return turn


def _angle(turn: Float[np.ndarray, "T 3 3"]) -> Float64[np.ndarray, "T"]:
    skew = np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=-1
    )
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    return np.asarray(np.arctan2(0.5 * _lengths(skew), cosine))
