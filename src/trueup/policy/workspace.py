"""Where the end of an arm can be: forward kinematics of many poses at once, and goals that can be reached."""

from __future__ import annotations

from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float, Float64

from trueup.core.policy_card import Kinematics
from trueup.deploy.looking import compiled
from trueup.deploy.policy import arrays_of
from trueup.errors import ConfigError, NameMismatch

# Poses that stand for all; from how many of the nearest a pose for a goal is looked for, and how near is there [m].
_POSES = 20_000
_STARTS = 6
_THERE = 1e-3
# Of each joint's range, what goals stay away from at both ends.
_MARGIN = 0.1
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


class Chain:
    """From the base of a model to a site: hinges and slides, and what is fixed between them.

    Args:
        model: compiled.
        joints: names of J joints, in the order of positions.
        site: at the end.

    Raises:
        NameMismatch: there is no such site or joint.
        ConfigError: another joint is on the way to the site.
    """

    def __init__(self, model: mujoco.MjModel, joints: tuple[str, ...], site: str) -> None:
        sites = [model.site(number).name for number in range(model.nsite)]
        if site not in sites:
            raise NameMismatch(f"the model has no site {site!r}", left=[site], right=sites)
        known = [model.joint(number).name for number in range(model.njnt)]
        if missing := [name for name in joints if name not in known]:
            raise NameMismatch(f"the model has no joints {missing}", left=joints, right=known)
        self.joints = joints
        self.ranges = np.array([model.joint(name).range for name in joints], np.float64)
        columns = {int(model.joint(name).id): column for column, name in enumerate(joints)}
        end = model.site(site)
        parts = [_frame(np.asarray(end.pos), np.asarray(end.quat))]
        turns: list[tuple[int, Float64[np.ndarray, "3"], bool, Float64[np.ndarray, "4 4"]]] = []
        body = int(model.site_bodyid[end.id])
        while body:
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            for joint in reversed(range(first, first + count)):
                kind = int(model.jnt_type[joint])
                if joint not in columns or kind not in (_HINGE, _SLIDE):
                    raise ConfigError(
                        f"joint {model.joint(joint).name!r} is on the way to {site!r}", available=list(joints)
                    )
                # A hinge turns about its anchor; what has been collected comes after it.
                anchor = _frame(model.jnt_pos[joint], np.array([1.0, 0, 0, 0]))
                back = _frame(-model.jnt_pos[joint], np.array([1.0, 0, 0, 0]))
                after = back @ _product(parts)
                hinge = kind == _HINGE
                turns.append((columns[joint], np.array(model.jnt_axis[joint]), hinge, after))
                parts = [anchor]
            parts.insert(0, _frame(model.body_pos[body], model.body_quat[body]))
            body = int(model.body_parentid[body])
        turns.reverse()
        fixed = [_product(parts), *(after for _, _, _, after in turns)]
        self.kinematics = Kinematics(
            tuple(column for column, _, _, _ in turns),
            tuple(tuple(map(float, axis)) for _, axis, _, _ in turns),
            tuple(hinge for _, _, hinge, _ in turns),
            tuple(tuple(map(float, frame[:3, :3].ravel())) for frame in fixed),
            tuple(tuple(map(float, frame[:3, 3])) for frame in fixed),
        )
        self._arrays = arrays_of(self.kinematics)
        self._places, *_ = compiled()

    def place(
        self, position: Float64[np.ndarray, "N J"], out: Float64[np.ndarray, "N 3"] | None = None
    ) -> Float64[np.ndarray, "N 3"]:
        """Where the site is, in the axes of the world [m].

        Args:
            position: of the joints [rad or m].
            out: written, if it is given.
        """
        out = np.empty((len(position), 3)) if out is None else out
        self._places(position, *self._arrays, out)
        return out


class Workspace:
    """Goals for the end of an arm.

    Args:
        chain: of the arm.
        home: where its episodes begin, (J,) [rad or m].
        nearest_m: goals are at least this far from there [m].
        farthest_m: and at most this far [m].
        lowest_m: and at least this high [m].
        seed: of the poses that stand for all.

    Raises:
        ConfigError: no goal is left.
    """

    def __init__(
        self,
        chain: Chain,
        home: Float[np.ndarray, "J"],
        *,
        nearest_m: float = 0.1,
        farthest_m: float = 0.6,
        lowest_m: float = 0.1,
        seed: int = 0,
    ) -> None:
        self.chain = chain
        self.start = chain.place(np.asarray(home, np.float64)[None])[0]
        low, high = chain.ranges.T
        share = np.random.default_rng([seed, 9]).uniform(_MARGIN, 1.0 - _MARGIN, (_POSES, len(chain.joints)))
        self._poses = low + share * (high - low)
        self._cloud = chain.place(self._poses)
        away = np.linalg.norm(self._cloud - self.start, axis=1)
        self.goals = self._cloud[(away >= nearest_m) & (away <= farthest_m) & (self._cloud[:, 2] >= lowest_m)]
        if not len(self.goals):
            raise ConfigError(
                "no goal is left",
                got=f"{nearest_m:g} to {farthest_m:g} m away and {lowest_m:g} m high",
                expected=f"{away.min():.2f} to {away.max():.2f} m away",
            )

    def draw(self, rng: np.random.Generator, count: int) -> Float64[np.ndarray, "N 3"]:
        """Goals that a pose within the joints' ranges reaches."""
        goals: Float64[np.ndarray, "N 3"] = self.goals[rng.integers(len(self.goals), size=count)]
        return goals

    def check(self, goal: Float[np.ndarray, "3"]) -> None:
        """Refuse a goal that no pose reaches.

        Raises:
            ConfigError: it is out of reach, or not three finite numbers.
        """
        goal = np.asarray(goal, np.float64)
        if goal.shape != (3,) or not np.isfinite(goal).all():
            raise ConfigError("a goal is a place", got=goal.tolist(), expected="three finite numbers [m]")
        place = self._nearest(goal)
        away = float(np.linalg.norm(place - goal))
        if away > _THERE:
            x, y, z = place
            raise ConfigError(
                "the goal is out of reach",
                got=f"({goal[0]:.3f}, {goal[1]:.3f}, {goal[2]:.3f}) m",
                expected=f"the nearest place that a pose reaches is ({x:.3f}, {y:.3f}, {z:.3f}) m, {away:.3f} m away",
            )

    def _nearest(self, goal: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
        """The place nearest to a goal that poses within the joints' ranges were found for [m]."""
        from scipy.optimize import least_squares

        apart, rows = self._tree.query(goal, k=_STARTS)
        best: Float64[np.ndarray, "3"] = self._cloud[rows[0]]
        if apart[0] <= _THERE:
            return best
        for row in rows.tolist():
            found = least_squares(
                lambda pose: self.chain.place(pose[None])[0] - goal, self._poses[row], bounds=self.chain.ranges.T
            )
            best = min(best, found.fun + goal, key=lambda place: float(np.linalg.norm(place - goal)))
            if np.linalg.norm(best - goal) <= _THERE:
                break
        return best

    @cached_property
    def _tree(self):  # type: ignore[no-untyped-def]  # noqa: ANN202 - scipy's, loaded when a goal is checked
        from scipy.spatial import cKDTree

        return cKDTree(self._cloud)


def _frame(place: Float[np.ndarray, "3"], quaternion: Float[np.ndarray, "4"]) -> Float64[np.ndarray, "4 4"]:
    out, turn = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(turn, np.asarray(quaternion, np.float64))
    out[:3, :3], out[:3, 3] = turn.reshape(3, 3), place
    return out


def _product(parts: list[Float64[np.ndarray, "4 4"]]) -> Float64[np.ndarray, "4 4"]:
    out = np.eye(4)
    for part in parts:
        out = out @ part
    return out
