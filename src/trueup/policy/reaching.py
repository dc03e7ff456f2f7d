"""Arms that reach for goals, side by side: the episodes behind every environment."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from trueup.deploy.looking import compiled
from trueup.errors import ConfigError
from trueup.policy.arms import Arms
from trueup.policy.reach import ReachConfig
from trueup.policy.thesis_friction import ThesisFriction
from trueup.policy.workspace import Chain, Workspace
from trueup.sim.compiled_robot import ABSURD


@dataclass(frozen=True, eq=False)
class Outcome:
    """One control step of N arms.

    Attributes:
        observation: after it, (N, O).
        reward: (N,).
        lost: whose engine or policy said what is no number: their episodes are over, (N,).
        ended: whose time is up, (N,).
        distance_m: from the goal, (N,) [m].
    """

    observation: Float64[np.ndarray, "N O"]
    reward: Float64[np.ndarray, "N"]
    lost: Bool[np.ndarray, "N"]
    ended: Bool[np.ndarray, "N"]
    distance_m: Float64[np.ndarray, "N"]


class Reaching:
    """Episodes of N arms.

    Args:
        arms: that take torques.
        model: of the arm, for where its end is.
        config: of an episode.
        home: where episodes begin, (J,) [rad or m]; the model's keyframe `home` if None.
        friction: what becomes of actions in a simulation without friction, as the ES thesis has it; None for what the
            arms themselves do.
        friction_share: its numbers are those of the arm times 1 - this to 1 + this, each by itself, drawn anew for each
            episode.
        offset_nm: added to every action, (J,) [Nm]: what the robot's own compensation of gravity gets wrong (ES thesis,
            Table 3.1).
        noise: standard deviations of what is seen of positions and velocities [rad, rad/s]; none if None.

    Raises:
        ConfigError: torques that are not one per joint, friction of another number of joints, no pose to begin in, or
            no goal within reach.
    """

    def __init__(
        self,
        arms: Arms,
        model: mujoco.MjModel,
        config: ReachConfig,
        *,
        home: Float[np.ndarray, "J"] | None = None,
        friction: ThesisFriction | None = None,
        friction_share: float = 0.0,
        offset_nm: Float[np.ndarray, "J"] | None = None,
        noise: tuple[float, float] | None = None,
    ) -> None:
        joints = arms.joints
        if len(config.torque_nm) != len(joints):
            raise ConfigError(
                "reach: torque_nm has one number for each joint", got=len(config.torque_nm), expected=len(joints)
            )
        if friction is not None and len(friction.numbers) != len(joints):
            raise ConfigError(
                "friction: thesis has numbers for the joints of a Panda",
                got=f"{len(joints)} joints",
                expected=f"{len(friction.numbers)}",
                hint="Take friction: simulator, and put friction into robot.yaml.",
            )
        self.arms, self.config = arms, config
        self.home = home_of(model, joints) if home is None else np.asarray(home, np.float64)
        self.workspace = Workspace(
            Chain(model, joints, config.site),
            self.home,
            nearest_m=config.nearest_m,
            farthest_m=config.farthest_m,
            lowest_m=config.lowest_m,
        )
        self.most = np.array(config.torque_nm, np.float64)
        self._friction, self._noise = friction, noise
        self._friction_share = friction_share
        self._friction_scale: Float64[np.ndarray, "N J 5"] | None = (
            np.ones((arms.count, len(joints), 5)) if friction is not None and friction_share else None
        )
        self._offset = None if offset_nm is None else np.asarray(offset_nm, np.float64)
        count = arms.count
        self.goal: Float64[np.ndarray, "N 3"] = np.tile(self.workspace.start, (count, 1))
        self._start: Float64[np.ndarray, "N"] = np.ones(count)
        self._age: Int[np.ndarray, "N"] = np.zeros(count, int)
        self._velocity: Float64[np.ndarray, "N J"] = np.zeros((count, len(joints)))
        self._seen: Float64[np.ndarray, "N O"] = np.zeros((count, 3 * len(joints) + 3))
        self._reward: Float64[np.ndarray, "N"] = np.zeros(count)
        self._distance_m: Float64[np.ndarray, "N"] = np.zeros(count)
        self._place: Float64[np.ndarray, "N 3"] = np.zeros((count, 3))
        self._costs = config.reward.costs
        _, self._compiled, self._sound, self._within = compiled()
        self._torque: Float64[np.ndarray, "N J"] = np.zeros((count, len(joints)))
        self._mad: Bool[np.ndarray, "N"] = np.zeros(count, bool)
        self.lost_episodes = 0

    @property
    def width(self) -> int:
        """Numbers of an observation."""
        return int(self._seen.shape[1])

    def begin(
        self, rows: Int[np.ndarray, "R"], rng: np.random.Generator, *, goals: Float[np.ndarray, "R 3"] | None = None
    ) -> Float64[np.ndarray, "N O"]:
        """Begin episodes of R arms; what all see.

        Args:
            rows: numbers of the arms.
            rng: of goals, and of what the arms draw anew.
            goals: drawn if None [m].

        Raises:
            ConfigError: a goal is out of reach, or where the arm begins.
        """
        if goals is None:
            self.goal[rows] = self.workspace.draw(rng, rows.size)
        else:
            for goal in goals:
                self.workspace.check(goal)
            self.goal[rows] = goals
        # As it is seen, like the distance that is held against it: a reward begins with a distance of 1.
        self._start[rows] = np.linalg.norm(np.tanh(self.workspace.start - self.goal[rows]), axis=1)
        if (self._start[rows] < 1e-6).any():
            raise ConfigError("the goal is where the arm begins", got=self.goal[rows].round(3).tolist())
        self.arms.begin(rows, np.tile(self.home, (rows.size, 1)), rng)
        if self._friction_scale is not None:
            share = self._friction_share
            self._friction_scale[rows] = rng.uniform(1 - share, 1 + share, (rows.size, *self._friction_scale.shape[1:]))
        self._age[rows], self._velocity[rows] = 0, self.arms.velocity[rows]
        self._look(rng)
        return self._seen.copy()

    def step(self, action: Float[np.ndarray, "N J"], rng: np.random.Generator) -> Outcome:
        """One control step.

        Args:
            action: torques of the policy [Nm], cut to the largest; one that is no number moves nothing, and its episode
                is lost.
            rng: of the noise of what is seen.
        """
        torque = self._torque
        sane = self._within(np.asarray(action, np.float64), self.most, torque, self._mad)
        if self._friction is not None:
            torque = self._friction.applied(torque, self.arms.velocity, self._friction_scale)
        self.arms.step(torque if self._offset is None else torque + self._offset)
        self._age += 1
        lost = self._look(rng)
        if not sane:
            lost = lost | self._mad
        self.lost_episodes += int(np.count_nonzero(lost))
        return Outcome(
            self._seen.copy(), self._reward.copy(), lost, self._age >= self.config.steps, self._distance_m.copy()
        )

    def _look(self, rng: np.random.Generator) -> Bool[np.ndarray, "N"]:
        """See all arms, and say which are lost: those are seen at home, at rest."""
        position, velocity = self.arms.position, self.arms.velocity
        lost: Bool[np.ndarray, "N"] = np.zeros(len(position), bool)
        if not self._sound(position, velocity, ABSURD, lost):
            position, velocity = position.copy(), velocity.copy()
            position[lost], velocity[lost] = self.home, 0.0
        self._compare(position, velocity, self._reward)
        if self._noise is not None:
            read, pace = (
                values + size * rng.standard_normal(values.shape)
                for values, size in zip((position, velocity), self._noise, strict=True)
            )
            # What a step is worth does not depend on how well it was seen.
            true_m = self._distance_m.copy()
            self._compare(read, pace, np.empty_like(self._reward))
            self._distance_m = true_m
        self._velocity = velocity
        return lost

    def _compare(
        self,
        position: Float64[np.ndarray, "N J"],
        velocity: Float64[np.ndarray, "N J"],
        reward: Float64[np.ndarray, "N"],
    ) -> None:
        self.workspace.chain.place(position, self._place)
        self._compiled(
            *(position, velocity, self._velocity, self._place, self.goal, self._start),
            *(self.config.control_s, self._costs, self._seen, reward, self._distance_m),
        )


def home_of(model: mujoco.MjModel, joints: tuple[str, ...]) -> Float64[np.ndarray, "J"]:
    """The joints' positions in the model's keyframe `home`.

    Raises:
        ConfigError: it has none.
    """
    keys = [model.key(number).name for number in range(model.nkey)]
    if "home" not in keys:
        raise ConfigError("the model has no keyframe `home` for episodes to begin in", available=keys)
    places = [int(model.joint(name).qposadr[0]) for name in joints]
    return np.array(model.key("home").qpos[places], np.float64)
