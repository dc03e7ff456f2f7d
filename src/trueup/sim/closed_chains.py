"""Closed kinematic chains: passive joints have no commands and no sensors, and follow from those that have."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import DataError

_ITERATIONS = 50
_ARRIVED = 1e-10
# Of controlled joints on their way from the model's own pose [rad or m].
_STRIDE = 0.1
# Further apart than this a chain is open: m, or rad of a welded frame. Less is what sensors and assembly leave open.
_OPEN = 5e-3


class ClosedChains:
    """Where the passive joints of a model are when its controlled ones are known.

    Args:
        model: compiled.
        coordinates: of the controlled joints in qpos, (J,).
        dofs: likewise in qvel.
    """

    def __init__(self, model: mujoco.MjModel, coordinates: np.ndarray, dofs: np.ndarray) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._coordinates, self._dofs = coordinates, dofs
        self._passive = np.setdiff1d(np.arange(model.nv), dofs)

    def close(
        self, position: Float64[np.ndarray, "J"], velocity: Float64[np.ndarray, "J"]
    ) -> tuple[Float64[np.ndarray, "Q"], Float64[np.ndarray, "V"]]:
        """All coordinates and velocities of the model with these of the controlled joints.

        Gauss-Newton over the passive joints from the model's own pose, and least squares for their velocities.

        Raises:
            DataError: no pose of the passive joints closes the chains.
        """
        model, data = self._model, self._data
        mujoco.mj_resetData(model, data)
        home = data.qpos[self._coordinates].copy()
        # In small strides: a chain closes in several ways, and a long one could end in another than it came from.
        strides = max(1, int(np.ceil(np.abs(position - home).max(initial=0.0) / _STRIDE)))
        for share in np.linspace(0.0, 1.0, strides + 1)[1:]:
            data.qpos[self._coordinates] = home + share * (position - home)
            self._relax()
        mujoco.mj_fwdPosition(model, data)
        jacobian, apart = equalities(model, data)
        # What couples controlled joints alone is not for a passive one to close.
        most = np.abs(apart[jacobian[:, self._passive].any(axis=1)]).max(initial=0.0)
        if not most <= _OPEN:
            raise DataError(
                "a pose opens a closed chain",
                got=f"{most:.3g} m or rad between its ends",
                expected=f"at most {_OPEN:g}",
                hint="Its joints cannot all be where the log has them: look at their zeros and signs in robot.yaml.",
            )
        speed = np.zeros(model.nv)
        speed[self._dofs] = velocity
        speed[self._passive] = np.linalg.lstsq(jacobian[:, self._passive], -jacobian @ speed, rcond=None)[0]
        return data.qpos.copy(), speed

    def _relax(self) -> None:
        model, data = self._model, self._data
        for _ in range(_ITERATIONS):
            mujoco.mj_fwdPosition(model, data)
            jacobian, apart = equalities(model, data)
            step = np.zeros(model.nv)
            step[self._passive] = np.linalg.lstsq(jacobian[:, self._passive], -apart, rcond=None)[0]
            mujoco.mj_integratePos(model, data.qpos, step, 1.0)
            if np.abs(step).max(initial=0.0) < _ARRIVED:
                return


def open_by(data: mujoco.MjData) -> float:
    """How far the worst equality constraint is open [m or rad], after `mj_fwdPosition`; 0 where there is none."""
    return float(np.abs(data.efc_pos[: data.ne]).max(initial=0.0))


def equalities(
    model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[Float64[np.ndarray, "C V"], Float64[np.ndarray, "C"]]:
    """Jacobian of the equality constraints, and how far they are open, after `mj_fwdPosition`."""
    count = data.ne
    if not count:
        return np.zeros((0, model.nv)), np.zeros(0)
    jacobian = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        jacobian = data.efc_J.reshape(data.nefc, model.nv).copy()
    return jacobian[:count], data.efc_pos[:count].copy()
