"""Environments: one arm for Gymnasium, many for Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from trueup.augment.side_by_side import SideBySide
from trueup.errors import ConfigError, needing
from trueup.policy.arms import Arms, EngineArm, MujocoArms
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.sim import MujocoSimulator, make_simulator

with needing("policies", "rl"):
    import gymnasium
    from gymnasium import spaces
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

Observation = Float32[np.ndarray, "O"]
Action = Float32[np.ndarray, "J"]


class PandaReach(gymnasium.Env[Observation, Action]):
    """A torque-controlled arm that reaches for a goal (ES thesis, 2.1): `gymnasium.make("TrueupPandaReach-v0")`.

    Actions are torques on top of what carries the weight [Nm]. Episodes end when their time is up, and before only
    where the engine or the policy says what is no number; both truncate them, for no place of the task is an end.
    `reset(options={"goal": [x, y, z]})` sets a goal [m].

    Args:
        robot: name of a shipped robot, path of a robot.yaml, or a description; it follows torques.
        engine: `mujoco` or `dart`.
        config: of an episode; the thesis's if None.
        reaching: one arm's episodes, for anything else than a robot in an engine; all before is left out then.

    Raises:
        ConfigError: a robot that follows no torques, or an engine that is not there.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(
        self,
        robot: str | RobotSpec = "panda_torque",
        engine: str = "mujoco",
        config: ReachConfig | None = None,
        *,
        reaching: Reaching | None = None,
        render_mode: str | None = None,
    ) -> None:
        if reaching is None:
            config = config or ReachConfig()
            spec = robot if isinstance(robot, RobotSpec) else load_robot(robot)
            simulator = make_simulator(engine, spec, find_model(spec))
            # MuJoCo takes the physics steps of a control step at once.
            arm: Arms = (
                MujocoArms(simulator, 1, config.control_s, delay_s=spec.delay_s)
                if isinstance(simulator, MujocoSimulator)
                else EngineArm(simulator, config.control_s, delay_s=spec.delay_s)
            )
            reaching = Reaching(arm, simulator.model, config)
        if reaching.arms.count != 1:
            raise ConfigError("an environment of Gymnasium has one arm", got=reaching.arms.count)
        self.reaching, self.render_mode = reaching, render_mode
        self.observation_space = spaces.Box(-1.0, 1.0, (reaching.width,), np.float32)
        most = reaching.most.astype(np.float32)
        self.action_space = spaces.Box(-most, most, dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Raises:
            ConfigError: an option that is none, or a goal out of reach.
        """
        super().reset(seed=seed)
        given = dict(options or {})
        goal = given.pop("goal", None)
        if given:
            raise ConfigError("options of a reset", got=sorted(given), available=["goal"])
        goals = None if goal is None else _place(goal)[None]
        seen = self.reaching.begin(np.zeros(1, int), self.np_random, goals=goals)
        return seen[0].astype(np.float32), self._info(
            np.linalg.norm(self.reaching.workspace.start - self.reaching.goal[0])
        )

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step."""
        done = self.reaching.step(np.asarray(action)[None], self.np_random)
        seen = done.observation[0].astype(np.float32)
        return seen, float(done.reward[0]), False, bool(done.lost[0] or done.ended[0]), self._info(done.distance_m[0])

    def _info(self, distance_m: float | np.floating[Any]) -> dict[str, Any]:
        return {"distance_m": float(distance_m), "goal": self.reaching.goal[0].copy()}


class ReachVector(SideBySide):
    """Many arms as Stable-Baselines3 wants to see them; an episode that ends is followed by the next at once.

    Args:
        reaching: episodes of N arms.
        seed: of all draws.
    """

    def __init__(self, reaching: Reaching, *, seed: int = 0) -> None:
        self.reaching = reaching
        self._rng = np.random.default_rng(seed)
        count, most = reaching.arms.count, reaching.most.astype(np.float32)
        self._sum: Float64[np.ndarray, "N"] = np.zeros(count)
        self._length = np.zeros(count, int)
        self._action = np.zeros((count, len(most)))
        super().__init__(
            count, spaces.Box(-1.0, 1.0, (reaching.width,), np.float32), spaces.Box(-most, most, dtype=np.float32)
        )

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Draw from here on as from the beginning of this seed."""
        self._rng = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> Float32[np.ndarray, "N O"]:
        """Begin an episode of each arm."""
        self._sum[:], self._length[:] = 0.0, 0
        return self.reaching.begin(np.arange(self.num_envs), self._rng).astype(np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Take actions for `step_wait`."""
        self._action = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, rewards, which episodes ended, and of those the last observation."""
        done = self.reaching.step(self._action, self._rng)
        self._sum += done.reward
        self._length += 1
        over = done.lost | done.ended
        infos: list[dict[str, Any]] = [{"distance_m": float(distance)} for distance in done.distance_m]
        seen = done.observation
        rows = np.flatnonzero(over)
        for row in rows.tolist():
            infos[row] |= {
                "terminal_observation": done.observation[row].astype(np.float32),
                # An arm that is lost, too: every reward is below zero, and an end without any would be worth seeking.
                "TimeLimit.truncated": True,
                "episode": {"r": float(self._sum[row]), "l": int(self._length[row])},
            }
        if rows.size:
            self._sum[rows], self._length[rows] = 0.0, 0
            seen = self.reaching.begin(rows, self._rng)
        return seen.astype(np.float32), done.reward.astype(np.float32), over, infos


def _place(goal: Any) -> Float64[np.ndarray, "3"]:
    try:
        found = np.asarray(goal, np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (3,):
        raise ConfigError("a goal is a place", got=goal, expected="three numbers [m]")
    return found
