"""Poses that put the end effector where it should be, by differential inverse kinematics (mink)."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.errors import NoPlan
from trueup.record.packages import load
from trueup.record.scene import Scene

_POSITION_M = 1e-6
_ROTATION_RAD = 1e-5
_ITERATIONS = 30
# Two targets that are near to one another must have poses that are: else the arm has turned over in between.
_LARGEST_CHANGE = 0.35
# Small, since it pulls solutions towards standing still: enough that a singular pose does not jump.
_DAMPING = 1e-8


class InverseKinematics:
    """Follows targets of the end effector from one pose to the next, within the position limits.

    Args:
        scene: the robot.
        hold_rotation: keep the rotation that the end effector starts with; else only positions count.

    Raises:
        ConfigError: the model has no site for the end effector.
        MissingDependency: mink is not installed.
    """

    def __init__(self, scene: Scene, *, hold_rotation: bool) -> None:
        scene.require_site()
        self._scene = scene
        self._mink: Any = load("mink")
        load("daqp")  # its solver
        self._configuration = self._mink.Configuration(scene.model)
        self._task = self._mink.FrameTask(
            scene.site, "site", position_cost=1.0, orientation_cost=1.0 if hold_rotation else 0.0
        )
        self._hold = hold_rotation
        self._bounds = [self._mink.ConfigurationLimit(scene.model)]
        others = np.setdiff1d(np.arange(scene.model.nq), scene.qpos_columns)
        self._still = [self._mink.DofFreezingTask(scene.model, others.tolist())] if others.size else None

    def follow(
        self, start: Float64[np.ndarray, "J"], targets: Float64[np.ndarray, "K 3"], *, jumps: bool = False
    ) -> Float64[np.ndarray, "K J"]:
        """Poses whose end effector is at the targets, each found from the one before.

        Args:
            start: pose from which the first is looked for, (J,).
            targets: positions in the world [m].
            jumps: whether targets may be far from one another, so that poses may be, too.

        Raises:
            NoPlan: a target is out of reach, or the pose would have to jump.
        """
        _, rotation = self._scene.pose(start)
        frame = np.eye(4)
        frame[:3, :3] = rotation
        poses = np.empty((len(targets), len(start)))
        before = start
        self._configuration.update(self._scene.qpos(start))
        for row, target in enumerate(targets):
            frame[:3, 3] = target
            self._task.set_target(self._mink.SE3.from_matrix(frame))
            poses[row] = self._reach(target, row, len(targets))
            change = float(np.abs(poses[row] - before).max())
            if not jumps and change > _LARGEST_CHANGE:
                raise NoPlan(
                    "the line passes too near a singular pose",
                    got=f"a joint changes by {change:.2f} rad at {row + 1} of {len(targets)} points",
                    hint="Choose another start or another line.",
                )
            before = poses[row]
        return poses

    def _reach(self, target: Float64[np.ndarray, "3"], row: int, count: int) -> Float64[np.ndarray, "J"]:
        limits, columns = self._scene.limits, self._scene.qpos_columns
        error = np.inf
        for _ in range(_ITERATIONS):
            full = self._task.compute_error(self._configuration)
            error = float(np.linalg.norm(full[:3]))
            turned = float(np.linalg.norm(full[3:])) if self._hold else 0.0
            if error < _POSITION_M and turned < _ROTATION_RAD:
                # The solver keeps limits up to its own tolerance.
                pose: Float64[np.ndarray, "J"] = np.clip(self._configuration.q[columns], limits.low, limits.high)
                return pose
            try:
                velocity = self._mink.solve_ik(
                    self._configuration,
                    [self._task],
                    1.0,
                    "daqp",
                    _DAMPING,
                    limits=self._bounds,
                    constraints=self._still,
                )
            except self._mink.MinkError as problem:
                raise NoPlan("inverse kinematics failed", got=" ".join(str(problem).split())[:120]) from problem
            self._configuration.integrate_inplace(velocity, 1.0)
        raise NoPlan(
            f"the end effector cannot reach {np.round(target, 3).tolist()} m",
            got=f"{1000 * error:.1f} mm short of point {row + 1} of {count}",
            expected="a target within reach and joint limits",
            hint="Choose another start, a shorter line or another direction.",
        )
