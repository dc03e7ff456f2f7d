"""The friction laws as machine code that MuJoCo calls. Compiled by numba, which needs its own subset of Python.

Two callbacks, since MuJoCo repeats only parts of a step when it takes derivatives: what is added to the passive forces
is added where they are computed, and friction rows are written, never added to.
"""

from __future__ import annotations

import ctypes
import inspect
from functools import cache
from typing import Any

import mujoco
import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from trueup.robots.friction import LAWS, LEAST_WIDTH, MARK, NUMBERS, WIDTH
from trueup.sim.structs import offset

_SLOT = {number.name: 1 + index for index, number in enumerate(NUMBERS)}
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_FRICTION_OF_JOINT = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
_ACTUATION_OFF = int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
_TO_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_FIXED_GAIN, _AFFINE_BIAS = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_AFFINE)


@cache
def callbacks() -> tuple[Any, Any, Any]:
    """The function pointers for `mjcb_control` and `mjcb_passive`, and the compiled code that must stay alive.

    They are compiled in each process (a second): offsets of MuJoCo's structs are constants in them, so a copy kept on
    disk would read wrong memory after an upgrade of MuJoCo.
    """
    signature = types.void(types.int64, types.int64)
    # Where Python raises on a division by zero, numpy's rules say inf: a callback has nobody to raise to.
    compiled = [
        numba.cfunc(signature, error_model="numpy")(_plain(part)) for part in (_compilable_rows(), _compilable_forces())
    ]
    prototype = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
    rows, forces = (prototype(part.address) for part in compiled)
    return rows, forces, compiled


def _plain(function: Any) -> Any:
    """The function itself, where a type checker of the tests has wrapped it."""
    return inspect.unwrap(function)


def _compilable_rows() -> Any:
    """For `mjcb_control`: how much friction the constraint solver may use on each joint. It must not allocate."""
    # Model
    n_joints, width = offset("mjModel", "njnt"), offset("mjModel", "nuser_jnt")
    user, kind = offset("mjModel", "jnt_user"), offset("mjModel", "jnt_type")
    dof, qpos_row = offset("mjModel", "jnt_dofadr"), offset("mjModel", "jnt_qposadr")
    coulomb = offset("mjModel", "dof_frictionloss")
    # Data
    qpos, qvel, bias = offset("mjData", "qpos"), offset("mjData", "qvel"), offset("mjData", "qfrc_bias")
    ne, nf = offset("mjData", "ne"), offset("mjData", "nf")
    row_kind, row_dof = offset("mjData", "efc_type"), offset("mjData", "efc_id")
    row_loss = offset("mjData", "efc_frictionloss")

    asymmetry, with_laws = _SLOT["asymmetry"], _compilable_laws()
    least, most, mark, hinge, slide, of_joint = LEAST_WIDTH, WIDTH, MARK, _HINGE, _SLIDE, _FRICTION_OF_JOINT

    def rows(model: int, data: int) -> None:
        slots = _longs(model + width)[0]
        if slots < least or slots > most:
            return
        laws = _longs(model + user)[0]
        numbers, types_ = _doubles(laws), _ints(_longs(model + kind)[0])
        dofs, places = _ints(_longs(model + dof)[0]), _ints(_longs(model + qpos_row)[0])
        position = _doubles(_longs(data + qpos)[0])
        loss = _doubles(_longs(model + coulomb)[0])
        velocity, carried = _doubles(_longs(data + qvel)[0]), _doubles(_longs(data + bias)[0])
        kinds, owners = _ints(_longs(data + row_kind)[0]), _ints(_longs(data + row_dof)[0])
        friction = _doubles(_longs(data + row_loss)[0])
        row = _ints(data + ne)[0]
        last = row + _ints(data + nf)[0]
        for joint in range(_longs(model + n_joints)[0]):
            p = joint * slots
            if numbers[p] != mark or (types_[joint] != hinge and types_[joint] != slide):
                continue
            i = dofs[joint]
            # Rows of joints come in their order; rows of tendons, with numbers of their own, after them.
            while row < last and kinds[row] == of_joint and owners[row] < i:
                row += 1
            if row >= last or kinds[row] != of_joint or owners[row] != i:
                continue
            v = velocity[i]
            total = with_laws(loss[i], laws + 8 * p, slots, v, carried[i], position[places[joint]])
            side = 1.0 if v > 0.0 else -1.0 if v < 0.0 else 0.0
            friction[row] = max(0.0, (1.0 + side * numbers[p + asymmetry]) * total)

    return rows


def _compilable_laws() -> Any:
    """Coulomb friction and the formulas of the laws that are on, given the address and width of a joint's numbers."""

    def coulomb(loss: float, _at: int, _slots: int, _v: float, _g: float, _q: float) -> float:
        return loss

    total, slot = _inlined(coulomb), 1
    for law in LAWS.values():
        if law.brake is not None:
            total = _with_law(total, _inlined(law.brake), 8 * slot, slot + len(law.numbers))
        slot += len(law.numbers)
    return total


def _with_law(before: Any, brake: Any, first: int, end: int) -> Any:
    def total(loss: float, at: int, slots: int, v: float, g: float, q: float) -> float:
        so_far = before(loss, at, slots, v, g, q)
        numbers = _doubles(at + first)
        if end <= slots and numbers[0] != 0.0:
            so_far += brake(v, g, q, numbers)
        return so_far

    return _inlined(total)


def _inlined(function: Any) -> Any:
    return numba.njit(error_model="numpy", inline="always")(_plain(function))


def _compilable_forces() -> Any:
    """For `mjcb_passive`: what is a force of known size. It must not allocate."""
    n_joints, width = offset("mjModel", "njnt"), offset("mjModel", "nuser_jnt")
    user, kind = offset("mjModel", "jnt_user"), offset("mjModel", "jnt_type")
    dof, qpos_row = offset("mjModel", "jnt_dofadr"), offset("mjModel", "jnt_qposadr")
    damping, disabled = offset("mjModel", "dof_damping"), offset("mjModel", "opt", "disableflags")
    qpos, qvel, passive = offset("mjData", "qpos"), offset("mjData", "qvel"), offset("mjData", "qfrc_passive")
    servo = _compilable_servo()

    asymmetry, dead_band = _SLOT["asymmetry"], _SLOT["dead_band"]
    static_positive, static_negative = _SLOT["static_positive"], _SLOT["static_negative"]
    least, most, mark, hinge, slide, actuation_off = LEAST_WIDTH, WIDTH, MARK, _HINGE, _SLIDE, _ACTUATION_OFF

    def forces(model: int, data: int) -> None:
        slots = _longs(model + width)[0]
        if slots < least or slots > most:
            return
        numbers = _doubles(_longs(model + user)[0])
        types_ = _ints(_longs(model + kind)[0])
        dofs, places = _ints(_longs(model + dof)[0]), _ints(_longs(model + qpos_row)[0])
        viscous = _doubles(_longs(model + damping)[0])
        driven = _ints(model + disabled)[0] & actuation_off == 0
        position, velocity = _doubles(_longs(data + qpos)[0]), _doubles(_longs(data + qvel)[0])
        force = _doubles(_longs(data + passive)[0])
        for joint in range(_longs(model + n_joints)[0]):
            p = joint * slots
            if numbers[p] != mark or (types_[joint] != hinge and types_[joint] != slide):
                continue
            i = dofs[joint]
            v = velocity[i]
            # The share that MuJoCo's own damping lacks in one direction and has too much in the other.
            force[i] -= numbers[p + asymmetry] * viscous[i] * abs(v)
            if driven and (numbers[p + dead_band] > 0.0 or numbers[p + static_positive] + numbers[p + static_negative]):
                at = _longs(model + user)[0] + 8 * p
                force[i] += servo(model, data, joint, at, position[places[joint]], v)

    return forces


def _compilable_servo() -> Any:
    """What dead band and static threshold take away from the torque of a joint's own actuators."""
    n_actuators = offset("mjModel", "nactuator")
    transmission, target = offset("mjModel", "actuator_trntype"), offset("mjModel", "actuator_trnid")
    gain_kind, gain = offset("mjModel", "actuator_gaintype"), offset("mjModel", "actuator_gainprm")
    bias_kind, bias = offset("mjModel", "actuator_biastype"), offset("mjModel", "actuator_biasprm")
    plugin, gear = offset("mjModel", "actuator_plugin"), offset("mjModel", "actuator_gear")
    limited, limits = offset("mjModel", "actuator_forcelimited"), offset("mjModel", "actuator_forcerange")
    clamped, clamps = offset("mjModel", "actuator_ctrllimited"), offset("mjModel", "actuator_ctrlrange")
    input_row, output_row = offset("mjModel", "actuator_ctrladr"), offset("mjModel", "actuator_outadr")
    state_row, states = offset("mjModel", "actuator_actadr"), offset("mjModel", "actuator_actnum")
    joint_limited, joint_limits = offset("mjModel", "jnt_actfrclimited"), offset("mjModel", "jnt_actfrcrange")
    ctrl, act = offset("mjData", "ctrl"), offset("mjData", "act")
    dead_band, static_velocity = _SLOT["dead_band"], _SLOT["static_velocity"]
    static_positive, static_negative = _SLOT["static_positive"], _SLOT["static_negative"]
    gains, biases = int(mujoco.mjNGAIN), int(mujoco.mjNBIAS)
    to_joint, fixed, affine = _TO_JOINT, _FIXED_GAIN, _AFFINE_BIAS
    clamp = _clamp()

    def servo(model: int, data: int, joint: int, at: int, q: float, v: float) -> float:
        law = _doubles(at)
        kinds, targets = _ints(_longs(model + transmission)[0]), _ints(_longs(model + target)[0])
        asked, given = 0.0, 0.0
        for a in range(_longs(model + n_actuators)[0]):
            if kinds[a] != to_joint or targets[2 * a] != joint or _ints(_longs(model + plugin)[0])[a] >= 0:
                continue
            if _ints(_longs(model + gain_kind)[0])[a] != fixed:
                continue
            state = _ints(_longs(model + state_row)[0])[a]
            if state >= 0:
                u = _doubles(_longs(data + act)[0])[state + _ints(_longs(model + states)[0])[a] - 1]
            else:
                row = _ints(_longs(model + input_row)[0])[a]
                u = _doubles(_longs(data + ctrl)[0])[row]
                u = clamp(u, _longs(model + clamped)[0] + row, _longs(model + clamps)[0] + 16 * row)
            k = _doubles(_longs(model + gain)[0] + 8 * gains * a)[0]
            b = _doubles(_longs(model + bias)[0] + 8 * biases * a)
            b0, b1, b2 = 0.0, 0.0, 0.0
            if _ints(_longs(model + bias_kind)[0])[a] == affine:
                b0, b1, b2 = b[0], b[1], b[2]
            g = _doubles(_longs(model + gear)[0])[6 * _ints(_longs(model + output_row)[0])[a]]
            full = k * u + b0 + b1 * g * q + b2 * g * v
            less = full
            band = abs(g) * law[dead_band]
            if b1 < 0.0 and band > 0.0:
                error = k * u / -b1 - g * q
                less += b1 * min(max(error, -band), band)
            still = b1 == 0.0 and b2 == 0.0 and abs(v) < law[static_velocity]
            if still and -law[static_negative] < g * full < law[static_positive]:
                less = 0.0
            on, range_ = _longs(model + limited)[0] + a, _longs(model + limits)[0] + 16 * a
            asked += g * clamp(full, on, range_)
            given += g * clamp(less, on, range_)
        on, range_ = _longs(model + joint_limited)[0] + joint, _longs(model + joint_limits)[0] + 16 * joint
        return clamp(given, on, range_) - clamp(asked, on, range_)

    return numba.njit(error_model="numpy")(_plain(servo))


def _clamp() -> Any:
    def clamp(value: float, limited: int, limits: int) -> float:
        """`value` within the two doubles at `limits`, if the byte at `limited` says so."""
        if _bytes(limited)[0] == 0:
            return value
        low, high = _doubles(limits)[0], _doubles(limits)[1]
        return min(max(value, low), high)

    return numba.njit(_plain(clamp))


@intrinsic
def _doubles(_context: Any, _address: Any) -> Any:
    """A pointer to doubles from an address."""
    return types.CPointer(types.float64)(types.int64), _to_pointer


@intrinsic
def _ints(_context: Any, _address: Any) -> Any:
    """A pointer to 32-bit integers from an address."""
    return types.CPointer(types.int32)(types.int64), _to_pointer


@intrinsic
def _longs(_context: Any, _address: Any) -> Any:
    """A pointer to 64-bit integers, sizes and addresses among them, from an address."""
    return types.CPointer(types.int64)(types.int64), _to_pointer


@intrinsic
def _bytes(_context: Any, _address: Any) -> Any:
    """A pointer to bytes from an address."""
    return types.CPointer(types.uint8)(types.int64), _to_pointer


def _to_pointer(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> Any:
    return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))
