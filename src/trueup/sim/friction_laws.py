"""The friction laws as machine code that MuJoCo calls. Compiled by numba, which needs its own subset of Python."""

from __future__ import annotations

import ctypes
import inspect
import math
from functools import cache
from typing import Any

import mujoco
import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from trueup.sim.friction import MARK, NAMES, WIDTH
from trueup.sim.structs import offset

_SLOT = {name: 1 + index for index, name in enumerate(NAMES)}
_JOINT_TRANSMISSION = int(mujoco.mjtTrn.mjTRN_JOINT)
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@cache
def callback() -> tuple[Any, Any]:
    """The function pointer for MuJoCo, and the compiled code that it needs to stay alive.

    It is compiled in each process (half a second): offsets of MuJoCo's structs are constants in it, so a copy kept on
    disk would read wrong memory after an upgrade of MuJoCo.
    """
    laws = numba.cfunc(types.void(types.int64, types.int64))(_plain(_compilable()))
    pointer = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(laws.address)
    return pointer, laws


def _plain(function: Any) -> Any:
    """The function itself, where a type checker of the tests has wrapped it."""
    return inspect.unwrap(function)


def _compilable() -> Any:
    """The callback in the subset of Python that numba compiles; it must not allocate."""
    # Model
    n_joints, width = offset("mjModel", "njnt"), offset("mjModel", "nuser_jnt")
    user, kind = offset("mjModel", "jnt_user"), offset("mjModel", "jnt_type")
    dof, qpos_row = offset("mjModel", "jnt_dofadr"), offset("mjModel", "jnt_qposadr")
    damping, invweight = offset("mjModel", "dof_damping"), offset("mjModel", "dof_invweight0")
    timestep = offset("mjModel", "opt", "timestep")
    # Data
    qpos, qvel = offset("mjData", "qpos"), offset("mjData", "qvel")
    bias, passive = offset("mjData", "qfrc_bias"), offset("mjData", "qfrc_passive")
    ne, nf = offset("mjData", "ne"), offset("mjData", "nf")
    row_dof, row_loss = offset("mjData", "efc_id"), offset("mjData", "efc_frictionloss")
    servo = _compilable_servo()

    stribeck, stribeck_velocity, load = _SLOT["stribeck"], _SLOT["stribeck_velocity"], _SLOT["load"]
    asymmetry = _SLOT["asymmetry"]
    tanh_coulomb, tanh_velocity = _SLOT["tanh_coulomb"], _SLOT["tanh_velocity"]
    level, slope, shift = _SLOT["sigmoid_level"], _SLOT["sigmoid_slope"], _SLOT["sigmoid_shift"]
    dead_band, static_positive = _SLOT["dead_band"], _SLOT["static_positive"]
    static_negative = _SLOT["static_negative"]
    slots, mark, hinge, slide = WIDTH, MARK, _HINGE, _SLIDE

    def laws(model: int, data: int) -> None:
        if _longs(model + width)[0] != slots:
            return
        numbers = _doubles(_longs(model + user)[0])
        types_ = _ints(_longs(model + kind)[0])
        dofs, rows = _ints(_longs(model + dof)[0]), _ints(_longs(model + qpos_row)[0])
        viscous, inverse_inertia = _doubles(_longs(model + damping)[0]), _doubles(_longs(model + invweight)[0])
        step = _doubles(model + timestep)[0]
        position, velocity = _doubles(_longs(data + qpos)[0]), _doubles(_longs(data + qvel)[0])
        carried, force = _doubles(_longs(data + bias)[0]), _doubles(_longs(data + passive)[0])
        first = _ints(data + ne)[0]
        last = first + _ints(data + nf)[0]
        friction_dof, friction = _ints(_longs(data + row_dof)[0]), _doubles(_longs(data + row_loss)[0])
        row = first
        for joint in range(_longs(model + n_joints)[0]):
            p = joint * slots
            if numbers[p] != mark or (types_[joint] != hinge and types_[joint] != slide):
                continue
            i = dofs[joint]
            v = velocity[i]
            side = 1.0
            if v > 0.0:
                side += numbers[p + asymmetry]
            elif v < 0.0:
                side -= numbers[p + asymmetry]
            smooth = numbers[p + tanh_coulomb] * math.tanh(v / numbers[p + tanh_velocity])
            if numbers[p + level] != 0.0:
                s, v0 = numbers[p + slope], numbers[p + shift]
                smooth += 0.5 * numbers[p + level] * (math.tanh(0.5 * s * (v + v0)) - math.tanh(0.5 * s * v0))
            smooth = side * smooth + (side - 1.0) * viscous[i] * v
            # An explicit force must not turn a motion around within a step, or it shakes instead of braking.
            most = abs(v) / (step * inverse_inertia[i])
            force[i] -= min(max(smooth, -most), most)
            while row < last and friction_dof[row] < i:
                row += 1
            if row < last and friction_dof[row] == i:
                ratio = v / numbers[p + stribeck_velocity]
                dry = friction[row] + numbers[p + stribeck] * math.exp(-ratio * ratio)
                friction[row] = side * (dry + numbers[p + load] * abs(carried[i]))
            if numbers[p + dead_band] > 0.0 or numbers[p + static_positive] + numbers[p + static_negative] > 0.0:
                force[i] += servo(model, data, joint, position[rows[joint]], v, p)

    return laws


def _compilable_servo() -> Any:
    """What dead band and static threshold take away from the torque of a joint's own actuator."""
    n_actuators = offset("mjModel", "nu")
    user = offset("mjModel", "jnt_user")
    transmission, target = offset("mjModel", "actuator_trntype"), offset("mjModel", "actuator_trnid")
    gain, bias = offset("mjModel", "actuator_gainprm"), offset("mjModel", "actuator_biasprm")
    limited, limits = offset("mjModel", "actuator_forcelimited"), offset("mjModel", "actuator_forcerange")
    clamped, clamps = offset("mjModel", "actuator_ctrllimited"), offset("mjModel", "actuator_ctrlrange")
    ctrl = offset("mjData", "ctrl")
    dead_band, static_velocity = _SLOT["dead_band"], _SLOT["static_velocity"]
    static_positive, static_negative = _SLOT["static_positive"], _SLOT["static_negative"]
    gains, biases = mujoco.mjNGAIN, mujoco.mjNBIAS
    to_joint = _JOINT_TRANSMISSION

    def servo(model: int, data: int, joint: int, q: float, v: float, p: int) -> float:
        numbers = _doubles(_longs(model + user)[0])
        kinds, targets = _ints(_longs(model + transmission)[0]), _ints(_longs(model + target)[0])
        change = 0.0
        for actuator in range(_longs(model + n_actuators)[0]):
            if kinds[actuator] != to_joint or targets[2 * actuator] != joint:
                continue
            kp = _doubles(_longs(model + gain)[0])[gains * actuator]
            b = _doubles(_longs(model + bias)[0])
            b0, b1, b2 = b[biases * actuator], b[biases * actuator + 1], b[biases * actuator + 2]
            u = _doubles(_longs(data + ctrl)[0])[actuator]
            if _bytes(_longs(model + clamped)[0])[actuator]:
                c = _doubles(_longs(model + clamps)[0])
                u = min(max(u, c[2 * actuator]), c[2 * actuator + 1])
            low, high = -1e300, 1e300
            if _bytes(_longs(model + limited)[0])[actuator]:
                f = _doubles(_longs(model + limits)[0])
                low, high = f[2 * actuator], f[2 * actuator + 1]
            asked = kp * u + b0 + b1 * q + b2 * v
            given = asked
            band = numbers[p + dead_band]
            if b1 < 0.0 and band > 0.0:
                error = kp * u / -b1 - q
                given += b1 * min(max(error, -band), band)
            still = abs(v) < numbers[p + static_velocity]
            if b1 == 0.0 and still and -numbers[p + static_negative] < given < numbers[p + static_positive]:
                given = 0.0
            change += min(max(given, low), high) - min(max(asked, low), high)
        return change

    return numba.njit(_plain(servo))


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
