"""Damping by the trapezoidal rule, in a simulator that takes it from one end of each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from jaxtyping import Float64, Int

# Where damping would take more than this share of the inertia, in any of so many poses, all of it takes no more.
_MOST, _POSES = 0.8, 8
# A drive is at its limit from this share of it on.
_AT_LIMIT = 0.999
_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_FIXED, _DIRECT = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtDyn.mjDYN_NONE)
_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_EXPLICIT = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)


@dataclass(frozen=True, eq=False)
class Drives:
    """What the actuators of B models make of velocities and of their U inputs, and how much torque they have.

    Attributes:
        damping: torque per velocity, against it, (B, J) [Nm s/rad or N s/m].
        gain: torque per input, (B, J, U).
        low: least torque, (B, J) [Nm or N].
        high: largest torque, (B, J) [Nm or N].
    """

    damping: Float64[np.ndarray, "B J"]
    gain: Float64[np.ndarray, "B J U"]
    low: Float64[np.ndarray, "B J"]
    high: Float64[np.ndarray, "B J"]

    @staticmethod
    def all_of(models: Sequence[mujoco.MjModel], dofs: Int[np.ndarray, "J"]) -> Drives:
        """Those of several models, which may repeat, on these degrees of freedom."""
        known = {id(model): Drives.of(model) for model in models}
        own = [known[id(model)] for model in models]
        names = [part.name for part in fields(Drives)]
        return Drives(*(np.stack([getattr(one, name)[0, dofs] for one in own]) for name in names))

    @staticmethod
    def of(model: mujoco.MjModel) -> Drives:
        """Those of one model on all of its V degrees of freedom, (1, V)."""
        damping, gain = np.zeros(model.nv), np.zeros((model.nv, model.nu))
        most = np.full((2, model.nv), np.inf)
        for joint in np.flatnonzero(model.jnt_actfrclimited):
            most[:, model.jnt_dofadr[joint]] = model.jnt_actfrcrange[joint] * [-1.0, 1.0]
        for actuator in range(model.nactuator):
            if model.actuator_trntype[actuator] != _JOINT:
                continue
            dof = model.jnt_dofadr[model.actuator_trnid[actuator, 0]]
            gear = float(model.actuator_gear[model.actuator_outadr[actuator], 0])
            if model.actuator_biastype[actuator] == _AFFINE:
                damping[dof] -= model.actuator_biasprm[actuator, 2] * gear**2
            if model.actuator_gaintype[actuator] == _FIXED and model.actuator_dyntype[actuator] == _DIRECT:
                gain[dof, model.actuator_ctrladr[actuator]] += gear * model.actuator_gainprm[actuator, 0]
            if model.actuator_forcelimited[actuator]:
                own = np.sort(model.actuator_forcerange[actuator] * gear) * [-1.0, 1.0]
                most[:, dof] = np.minimum(most[:, dof], own)
        return Drives(damping[None], gain[None], -most[:1], most[1:])

    def at_step_ends(
        self,
        torque: Float64[np.ndarray, "B N1 J"],
        velocity: Float64[np.ndarray, "B N1 J"],
        later: Float64[np.ndarray, "B N U"] | None = None,
    ) -> Float64[np.ndarray, "B N1 J"]:
        """Torques at the ends of steps, from those with the velocities of the middle of the steps before them.

        Args:
            torque: as simulated, [Nm or N].
            velocity: as simulated, [rad/s or m/s].
            later: what the inputs at the ends of steps are beside those of the simulation; nothing if None.
        """
        low, high = self.low[:, None], self.high[:, None]
        free = (torque > _AT_LIMIT * low) & (torque < _AT_LIMIT * high)
        ends = torque.copy()
        ends[:, :-1] -= 0.5 * self.damping[:, None] * np.diff(velocity, axis=1)
        if later is not None:
            ends[:, :-1] += np.einsum("bju,bnu->bnj", self.gain, later)
        return np.where(free, np.clip(ends, low, high), torque)


def at_step_ends(velocity: Float64[np.ndarray, "B N1 J"]) -> Float64[np.ndarray, "B N1 J"]:
    """Velocities at the ends of steps, from those of the middle of the steps before them [rad/s or m/s]."""
    ends = velocity.copy()
    ends[:, 1:-1] = 0.5 * (velocity[:, 1:-1] + velocity[:, 2:])
    return ends


def damp_by_trapezoid(model: mujoco.MjModel) -> None:
    """Make the damping of a compiled model an error of the second order of its time step, not of the first.

    With M the mass matrix, D what damps, h the step and f all other forces, MuJoCo's implicit integrators take the
    velocity v' after a step from (M + h D) v' = M v + h f: the damping of its end. The trapezoidal rule, (M + h D / 2)
    v' = (M - h D / 2) v + h f, is the same with M - h D / 2 in place of M, and so with an armature that is lower by
    h D / 2. The integrator `Euler` takes the damping of drives from the beginning of a step, for which the armature is
    higher by as much. Since positions move on with v', velocities are those in the middle of steps (leapfrog), which is
    of second order: `at_step_ends` reads them.

    A part of it is done where all would leave less than a fifth of the inertia. Runge-Kutta stays as it is.

    Source: Crank, Nicolson 1947, "A practical method for numerical evaluation of solutions of partial differential
    equations of the heat-conduction type"; Hairer, Lubich, Wanner 2006, "Geometric numerical integration", I.1.4.

    Args:
        model: its armatures are changed in place.
    """
    kind = mujoco.mjtIntegrator
    if model.opt.integrator == kind.mjINT_RK4:
        return
    drives, joints = Drives.of(model).damping[0], model.dof_damping
    if model.opt.integrator == kind.mjINT_EULER:
        own = -drives + (-joints if model.opt.disableflags & _EXPLICIT else joints)
    else:
        own = drives + joints
    lower = 0.5 * model.opt.timestep * own
    lower *= min(1.0, _MOST / max(_share(model, np.maximum(lower, 0.0)), 1e-300))
    model.dof_armature[:] -= lower
    model.dof_M0[:] -= lower  # which is the inertia of joints of which MuJoCo knows that it does not change


def _share(model: mujoco.MjModel, lower: Float64[np.ndarray, "V"]) -> float:
    """The largest share of the inertia in any direction that this is, over poses."""
    if np.all(lower <= _MOST * model.dof_armature):
        return 0.0
    data, rng, largest = mujoco.MjData(model), np.random.default_rng(0), 0.0
    turning = np.isin(model.jnt_type, (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)))
    limited = model.jnt_limited.astype(bool)
    low, high = np.full(model.njnt, -np.pi / 2), np.full(model.njnt, np.pi / 2)
    low[limited], high[limited] = model.jnt_range[limited].T
    root, full = np.sqrt(lower), np.empty((model.nv, model.nv))
    for number in range(_POSES):
        if number:
            data.qpos[model.jnt_qposadr[turning]] = rng.uniform(low, high)[turning]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, full)
        largest = max(largest, float(np.linalg.eigvalsh(root[:, None] * np.linalg.inv(full) * root)[-1]))
    return largest
