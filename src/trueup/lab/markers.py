"""A motion capture beside a virtual robot: poses of its bodies from its coordinates, as cameras see them."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.timeseries import BODY_PREFIX
from trueup.lab.spec import Markers

POSITION, ROTATION = (f"{BODY_PREFIX}{name}" for name in ("position", "rotation"))


class MotionCapture:
    """Sees where the frames of some bodies are, in the axes of the world.

    It has data of its own: looking at a robot must not move it.

    Args:
        model: of the robot as it is.
        markers: bodies and noise.
    """

    def __init__(self, model: mujoco.MjModel, markers: Markers) -> None:
        self.bodies = markers.bodies
        self._markers = markers
        self._model, self._data = model, mujoco.MjData(model)
        self._numbers = np.array([model.body(name).id for name in self.bodies], int)

    def draw(self, rng: np.random.Generator, rows: int) -> Float64[np.ndarray, "N M 6"]:
        """What makes the noise of so many looks: the same draws for many at once and one after the other."""
        return rng.standard_normal((rows, len(self.bodies), 6))

    def poses(self, places: Float64[np.ndarray, "N Q"]) -> dict[str, Float64[np.ndarray, "N M ..."]]:
        """True poses: `body.position` (N, M, 3) and `body.rotation` (N, M, 3, 3).

        Args:
            places: coordinates of the whole model, those of passive joints with them, (N, Q).
        """
        position = np.empty((len(places), len(self.bodies), 3))
        rotation = np.empty((len(places), len(self.bodies), 9))
        for row, place in enumerate(places):
            self._data.qpos[:] = place
            mujoco.mj_kinematics(self._model, self._data)
            position[row], rotation[row] = self._data.xpos[self._numbers], self._data.xmat[self._numbers]
        return {POSITION: position, ROTATION: rotation.reshape(*rotation.shape[:2], 3, 3)}

    def seen(
        self, poses: dict[str, Float64[np.ndarray, "N M ..."]], drawn: Float64[np.ndarray, "N M 6"]
    ) -> dict[str, Float64[np.ndarray, "N M ..."]]:
        """The poses as they are measured."""
        from scipy.spatial.transform import Rotation  # takes 0.1 s that robots without markers do not need

        markers = self._markers
        position = poses[POSITION] + markers.position_noise_m * drawn[..., :3]
        if markers.position_step_m:
            position = np.round(position / markers.position_step_m) * markers.position_step_m
        turn = Rotation.from_rotvec(markers.rotation_noise_rad * drawn[..., 3:].reshape(-1, 3)).as_matrix()
        return {POSITION: position, ROTATION: turn.reshape(poses[ROTATION].shape) @ poses[ROTATION]}
