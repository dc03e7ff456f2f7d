"""Poses that lead several sites of a robot at once, as near to where they should be as its joints allow (mink).

For robots with several limbs, some of which have too few joints to reach every point, and for closed chains, which stay
closed. `kinematics.py` leads one end effector, and refuses what it cannot reach.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.packages import load
from trueup.record.scene import Scene

_ITERATIONS = 30
# Joints that still change by less in a step have arrived [rad or m].
_ARRIVED = 1e-5
# A site that misses by one metre weighs as much as one that is turned by a radian; a closed chain that opens weighs
# more than both. Joints are held weakly: by that, those that no site leads are where they should be.
_CLOSED_COST, _HINT_COST, _REST_COST = 100.0, 1e-2, 1e-3
# Ends of closed chains that are no further apart are together [m or rad].
_OPEN = 1e-4
# The largest step of a joint [rad or m]: longer ones leave what the Jacobian says.
_STEP = 0.3


class SiteKinematics:
    """Follows targets of several sites.

    Args:
        scene: the robot.
        sites: that are led.
        turned: whether their rotations count, too.

    Raises:
        ConfigError: the model has no such site.
        MissingDependency: mink is not installed.
    """

    def __init__(self, scene: Scene, sites: Sequence[str], *, turned: bool = False) -> None:
        there = [scene.model.site(row).name for row in range(scene.model.nsite)]
        for name in sites:
            if name not in there:
                raise ConfigError(f"the model of {scene.robot.name!r} has no site {name!r}", available=there)
        self._scene = scene
        self._mink: Any = load("mink")
        load("daqp")  # its solver
        self._configuration = self._mink.Configuration(scene.model)
        self._tasks = {
            name: self._mink.FrameTask(name, "site", position_cost=1.0, orientation_cost=1.0 if turned else 0.0)
            for name in sites
        }
        model = scene.model
        self._posture = self._mink.PostureTask(model, cost=_REST_COST)
        self._hinted = self._mink.PostureTask(model, cost=0.0)
        self._closed = [self._mink.EqualityConstraintTask(model, cost=_CLOSED_COST)] if model.neq else []
        self._bounds = [self._mink.ConfigurationLimit(model)]
        self._columns = model.jnt_dofadr[[model.joint(name).id for name in scene.joints]]

    def poses(
        self, position: Float64[np.ndarray, "J"]
    ) -> dict[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3 3"]]]:
        """Where each site is in a pose, and how it is turned."""
        self._configuration.update(self._scene.qpos(position))
        data = self._configuration.data
        return {name: (data.site(name).xpos.copy(), data.site(name).xmat.reshape(3, 3).copy()) for name in self._tasks}

    def follow(
        self,
        start: Float64[np.ndarray, "J"],
        targets: Mapping[str, Float64[np.ndarray, "K 4 4"]],
        hints: Mapping[str, Float64[np.ndarray, "K"]] | None = None,
    ) -> Float64[np.ndarray, "K J"]:
        """Poses whose sites are as near to their targets as they get, each found from the one before.

        Args:
            start: pose from which the first is looked for, (J,).
            targets: site -> where it should be, as homogeneous matrices in the world.
            hints: joint -> where it should be where the sites leave a choice.

        Raises:
            NoPlan: a closed chain cannot be kept closed.
        """
        hints = hints or {}
        count = len(next(iter({**targets, **hints}.values())))
        scene, model = self._scene, self._scene.model
        self._configuration.update(scene.qpos(start))
        rest, cost = scene.qpos(scene.home), np.zeros(model.nv)
        self._posture.set_target(rest)
        cost[[self._columns[scene.joints.index(name)] for name in hints]] = _HINT_COST
        self._hinted.set_cost(cost)
        poses = np.empty((count, len(scene.joints)))
        for row in range(count):
            for name, task in self._tasks.items():
                task.set_target(self._mink.SE3.from_matrix(targets[name][row]))
            wanted = scene.home.copy()
            for name, values in hints.items():
                wanted[scene.joints.index(name)] = values[row]
            self._hinted.set_target(scene.qpos(wanted))
            poses[row] = self._reach(row, count)
        return poses

    def _reach(self, row: int, count: int) -> Float64[np.ndarray, "J"]:
        tasks = [*self._tasks.values(), *self._closed, self._hinted, self._posture]
        for _ in range(_ITERATIONS):
            try:
                step = self._mink.solve_ik(self._configuration, tasks, 1.0, "daqp", 1e-6, limits=self._bounds)
            except self._mink.MinkError as problem:
                raise NoPlan("inverse kinematics failed", got=" ".join(str(problem).split())[:120]) from problem
            size = float(np.abs(step).max())
            self._configuration.integrate_inplace(step * min(1.0, _STEP / max(size, _STEP)), 1.0)
            if size < _ARRIVED:
                break
        apart = float(np.abs(self._apart()).max(initial=0.0))
        if apart > _OPEN:
            raise NoPlan(
                "a closed chain would have to open",
                got=f"{1000 * apart:.1f} mm at {row + 1} of {count} points",
                hint="Ask for smaller movements of its sites.",
            )
        limits = self._scene.limits
        pose: Float64[np.ndarray, "J"] = np.clip(
            self._configuration.q[self._scene.qpos_columns], limits.low, limits.high
        )
        return pose

    def _apart(self) -> Float64[np.ndarray, "N"]:
        """How far each closed chain is from being closed [m or rad]."""
        if not self._closed:
            return np.zeros(0)
        error: Float64[np.ndarray, "N"] = self._closed[0].compute_error(self._configuration)
        return error
