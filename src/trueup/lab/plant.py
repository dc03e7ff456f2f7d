"""The physics of a virtual robot's joints around MuJoCo's rigid bodies, as one compiled loop.

MuJoCo moves the links; everything between a command and the torque on a link happens here: transport, the robot's own
controller, motors, springs, friction. One control step: take the commands that have arrived, compute motor torques,
then a number of physics steps, in which motors and links advance together by the semi-implicit Euler rule.
"""

from __future__ import annotations

import inspect
import math
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np

from trueup.sim.stepping import engine_step

# Rows of the log.
POSITION, VELOCITY, TORQUE, MOTOR_POSITION, MOTOR_TORQUE, RISE, CURRENT, VOLTAGE = range(8)
LOGGED = 8

# A joint with its brake on: stiff enough not to be seen, soft enough for the physics step.
_BRAKE_STIFFNESS, _BRAKE_DAMPING = 2e4, 50.0
# How fast a bristle comes to rest [s].
_BRISTLE_S = 2e-3


class Engine(NamedTuple):
    """MuJoCo's model and data, seen as arrays; (J,) unless said otherwise."""

    model: int
    data: int
    qpos: np.ndarray  # (nq,), as are the next three of (nv,)
    qvel: np.ndarray
    qacc: np.ndarray
    applied: np.ndarray
    xpos: np.ndarray  # (B, 3)
    xmat: np.ndarray  # (B, 9)
    anchor: np.ndarray  # (J, 3), of MuJoCo's joints
    axis: np.ndarray  # (J, 3)
    column: np.ndarray  # which of MuJoCo's joints is the robot's
    place: np.ndarray  # its coordinate
    freedom: np.ndarray  # its degree of freedom
    hinge: np.ndarray
    carries: np.ndarray  # (J, B), whether a joint carries a body
    known_mass: np.ndarray  # (B,), what the compensation takes the bodies for
    known_com: np.ndarray  # (B, 3)
    gravity: np.ndarray  # (3,), of a base at rest, which the compensation knows
    pull: np.ndarray  # (3,), what MuJoCo pulls with


# The joints, one record each: many arrays as arguments would take longer to pass than a control step takes. Names as in
# `JointTruth` and `LabSpec`; limits are infinite where there is none, and `torque_rate` is per control step.
NUMBERS = np.dtype(
    [
        (name, np.float64)
        for name in (
            "motor_inertia",
            "static_nm",
            "coulomb_nm",
            "asymmetry",
            "stribeck_velocity",
            "load",
            "viscous",
            "sigmoid_level",
            "sigmoid_slope",
            "sigmoid_shift",
            "bristle_stiffness",
            "motor_friction_nm",
            "gravity_error",
            "gravity_offset_nm",
            "stiffness",
            "damping",
            "ripple_nm",
            "ripple_phase",
            "ripple_phase_second",
            "torque_limit",
            "torque_rate",
            "no_load_speed",
            "brake_nm",
            "copper",
            "kp",
            "kd",
            "resistance_ohm",
            "torque_constant_nm_a",
            "back_emf_v_s_rad",
            "voltage_limit",
        )
    ]
)
# What changes of a joint, besides MuJoCo's own state: `spring` is the torque between motor and link, `drive` that of
# the motor, `rise` the temperature above the surroundings, `weight` what the compensation gives, `softness` what
# warmth leaves of friction; `voltage` and `current` are of a servo.
JOINT_STATE = np.dtype(
    [
        (name, np.float64)
        for name in (
            "motor_position",
            "motor_velocity",
            "bristle",
            "spring",
            "drive",
            "reference",
            "rise",
            "weight",
            "softness",
            "voltage",
            "current",
        )
    ]
)


class Settings(NamedTuple):
    """What is no joint's own."""

    physics_step_s: float
    steps: int
    torque_control: bool
    servo: bool
    pd: bool
    smoothing: float  # share of the way to a new position that the reference goes in one control step
    delay: float  # [control steps]
    jitter: float  # [control steps]
    ripple_periods: float  # per radian
    rise_k_per_w: float  # 0 without warming
    time_constant_s: float
    softening: float


class State(NamedTuple):
    """What changes, besides MuJoCo's own state."""

    joints: np.ndarray  # (J,) of JOINT_STATE
    active: np.ndarray  # (2, J), the command that is followed: position or torque, velocity
    follows_velocity: np.ndarray  # (1,)
    ring: np.ndarray  # (R, 2, J), commands on their way
    ring_velocity: np.ndarray  # (R,), whether they have velocities
    arrival: np.ndarray  # (R,), when they arrive [control steps]
    counters: np.ndarray  # tick, next command to arrive, latest arrival


class Orders(NamedTuple):
    """What happens from outside during a run of N control steps."""

    command: np.ndarray  # (N, 2, J)
    with_velocity: bool
    jitter: np.ndarray  # (N,), even in [0, 1)
    stop: int  # first tick at which the robot has stopped
    until_stop: bool  # end the run there
    stalls: np.ndarray  # (F, 3): joint, first tick, tick after the last
    pull: np.ndarray  # (N, 3), gravity in the frame of a base that moves; (0, 3) where it does not


# Wrappers for Python take a third of the compilation, and nobody calls these functions from there.
_INNER: dict[str, Any] = {"nogil": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@cache
def compiled() -> tuple[Any, Any]:
    """`advance(engine, numbers, settings, state, orders, log, places)` and `weigh(engine, numbers, state)`, compiled.

    `advance` runs N control steps, writes the state after each into `log` (N, LOGGED, J) and, where `places` (N, nq)
    has rows, all of MuJoCo's coordinates there, and returns how many steps it has done: all, unless the robot stopped
    before. `weigh` computes the torques that carry the arm, as far as the robot knows.
    """
    weigh = numba.njit(nogil=True)(_plain(_weigh))
    friction, receive, control = (numba.njit(**_INNER)(_plain(own)) for own in (friction_level, _receive, _control))
    joint = numba.njit(**_INNER)(_plain(_joint_of(friction)))
    return numba.njit(nogil=True)(_plain(_loop(engine_step(), weigh, receive, control, joint))), weigh


def _plain(function: Any) -> Any:
    """The function itself, where a type checker of the tests has wrapped it."""
    return inspect.unwrap(function)


def friction_level(
    static: float,
    coulomb: float,
    asymmetry: float,
    stribeck_velocity: float,
    load: float,
    viscous: float,
    sigmoid_level: float,
    slope: float,
    shift: float,
    velocity: float,
    torque: float,
    side: float,
) -> float:
    """How much a joint that moves at `velocity` [rad/s] and carries `torque` [Nm] is braked at most [Nm].

    `side` is the direction, +1 or -1, of the motion that is braked, or would be if the joint did not stick.
    """
    speed = abs(velocity)
    total = coulomb + load * abs(torque) + viscous * speed
    if static != coulomb:
        ratio = velocity / stribeck_velocity
        total += (static - coulomb) * math.exp(-ratio * ratio)
    if sigmoid_level != 0.0:
        rise = math.tanh(0.5 * slope * (velocity + shift)) - math.tanh(0.5 * slope * shift)
        total += 0.5 * sigmoid_level * abs(rise)
    return (1.0 + side * asymmetry) * total


def _weigh(engine: Engine, numbers: np.ndarray, state: State) -> None:
    for j in range(engine.column.size):
        state.joints[j].weight = 0.0
    gx, gy, gz = engine.gravity[0], engine.gravity[1], engine.gravity[2]
    for b in range(engine.known_mass.size):
        mass = engine.known_mass[b]
        if mass == 0.0:
            continue
        turn, com = engine.xmat[b], engine.known_com[b]
        x = engine.xpos[b, 0] + turn[0] * com[0] + turn[1] * com[1] + turn[2] * com[2]
        y = engine.xpos[b, 1] + turn[3] * com[0] + turn[4] * com[1] + turn[5] * com[2]
        z = engine.xpos[b, 2] + turn[6] * com[0] + turn[7] * com[1] + turn[8] * com[2]
        for j in range(engine.column.size):
            if not engine.carries[j, b]:
                continue
            axis = engine.axis[engine.column[j]]
            if engine.hinge[j]:
                place = engine.anchor[engine.column[j]]
                rx, ry, rz = x - place[0], y - place[1], z - place[2]
                pull = axis[0] * (ry * gz - rz * gy) + axis[1] * (rz * gx - rx * gz) + axis[2] * (rx * gy - ry * gx)
            else:
                pull = axis[0] * gx + axis[1] * gy + axis[2] * gz
            state.joints[j].weight -= mass * pull
    for j in range(engine.column.size):
        state.joints[j].weight = (1.0 + numbers[j].gravity_error) * state.joints[j].weight + numbers[
            j
        ].gravity_offset_nm


def _receive(settings: Settings, state: State, orders: Orders, k: int) -> None:
    """Send this step's command on its way, and take those that have arrived."""
    counters, slots = state.counters, state.arrival.size
    tick = counters[0]
    slot = tick % slots
    lag = math.ceil(settings.delay + settings.jitter * orders.jitter[k] - 1e-9)
    counters[2] = max(counters[2], tick + lag)
    # Element by element: for a whole row numba compiles the text of an error about shapes, which takes seconds.
    for signal in range(2):
        for j in range(state.joints.size):
            state.ring[slot, signal, j] = orders.command[k, signal, j]
    state.ring_velocity[slot] = orders.with_velocity
    state.arrival[slot] = counters[2]
    while counters[1] <= tick and state.arrival[counters[1] % slots] <= tick:
        slot = counters[1] % slots
        for signal in range(2):
            for j in range(state.joints.size):
                state.active[signal, j] = state.ring[slot, signal, j]
        state.follows_velocity[0] = state.ring_velocity[slot]
        counters[1] += 1


def _control(engine: Engine, numbers: np.ndarray, settings: Settings, state: State, stopped: bool) -> None:  # noqa: FBT001
    """Motor torques from commands and from what the motors' own sensors say."""
    control_step_s = settings.physics_step_s * settings.steps
    for j in range(engine.column.size):
        rate = 0.0
        if settings.torque_control:
            wanted = state.active[0, j] + state.joints[j].weight
        elif settings.pd:
            wanted = numbers[j].kp * (state.active[0, j] - state.joints[j].motor_position)
            wanted -= numbers[j].kd * state.joints[j].motor_velocity
        else:
            if state.follows_velocity[0]:
                state.joints[j].reference = state.active[0, j]
                rate = state.active[1, j]
            else:
                way = settings.smoothing * (state.active[0, j] - state.joints[j].reference)
                state.joints[j].reference += way
                rate = way / control_step_s
            place = state.joints[j].motor_position
            if numbers[j].stiffness > 0.0:
                place -= state.joints[j].weight / numbers[j].stiffness
            wanted = (
                numbers[j].kp * (state.joints[j].reference - place)
                + numbers[j].kd * (rate - state.joints[j].motor_velocity)
                + state.joints[j].weight
            )
        if settings.servo:
            # The winding turns the voltage into torque in every physics step.
            aim = numbers[j].kp * (state.active[0, j] - state.joints[j].motor_position)
            aim -= numbers[j].kd * state.joints[j].motor_velocity
            most = numbers[j].voltage_limit
            state.joints[j].voltage = 0.0 if stopped else min(max(aim, -most), most)
            continue
        if stopped:
            wanted = state.joints[j].weight
        change = numbers[j].torque_rate
        wanted = min(max(wanted, state.joints[j].drive - change), state.joints[j].drive + change)
        limit = numbers[j].torque_limit
        if wanted * state.joints[j].motor_velocity > 0.0:
            limit *= max(0.0, 1.0 - abs(state.joints[j].motor_velocity) / numbers[j].no_load_speed)
        state.joints[j].drive = min(max(wanted, -limit), limit)


def _joint_of(friction: Any) -> Any:
    """The physics of one joint, with the friction that it calls."""

    def joint(
        engine: Engine, numbers: np.ndarray, settings: Settings, state: State, j: int, brake: float
    ) -> tuple[float, float]:
        """One joint's motor through one physics step; returns the torque on the link and the power lost."""
        dt = settings.physics_step_s
        q, v = engine.qpos[engine.place[j]], engine.qvel[engine.freedom[j]]
        elastic = numbers[j].stiffness > 0.0
        if settings.servo:
            against = numbers[j].back_emf_v_s_rad * state.joints[j].motor_velocity
            state.joints[j].current = (state.joints[j].voltage - against) / numbers[j].resistance_ohm
            state.joints[j].drive = numbers[j].torque_constant_nm_a * state.joints[j].current
        drive = state.joints[j].drive
        # The bristle is bent by the motion; what it resists is the direction in which it is bent.
        before = state.joints[j].bristle
        bent = before + v * dt
        if numbers[j].ripple_nm != 0.0:
            angle = settings.ripple_periods * state.joints[j].motor_position
            drive += numbers[j].ripple_nm * (
                math.sin(angle + numbers[j].ripple_phase) + 0.5 * math.sin(2.0 * angle + numbers[j].ripple_phase_second)
            )
        held = state.joints[j].softness * numbers[j].motor_friction_nm + brake
        level = state.joints[j].softness * friction(
            numbers[j].static_nm,
            numbers[j].coulomb_nm,
            numbers[j].asymmetry,
            numbers[j].stribeck_velocity,
            numbers[j].load,
            numbers[j].viscous,
            numbers[j].sigmoid_level,
            numbers[j].sigmoid_slope,
            numbers[j].sigmoid_shift,
            v,
            state.joints[j].spring,
            1.0 if bent > 0.0 else -1.0,
        )
        lost = 0.0
        if elastic:
            pull = numbers[j].stiffness * (state.joints[j].motor_position - q) + numbers[j].damping * (
                state.joints[j].motor_velocity - v
            )
            state.joints[j].spring = pull
            # Dry friction as an impulse that stops the motor or is used up: it never drives it.
            inertia = numbers[j].motor_inertia
            free = state.joints[j].motor_velocity + dt / inertia * (drive - pull)
            most = dt / inertia * held
            turned = min(free + most, 0.0) if free < 0.0 else max(free - most, 0.0)
            lost += inertia / dt * (free - turned) * turned
            state.joints[j].motor_velocity = turned
            state.joints[j].motor_position += dt * turned
            total = level
        else:
            pull = drive
            total = level + held
        stiff, damp = numbers[j].bristle_stiffness, _BRISTLE_S * numbers[j].bristle_stiffness
        if not elastic and brake > 0.0:
            stiff, damp = _BRAKE_STIFFNESS, _BRAKE_DAMPING
        elif not elastic and stiff == 0.0 and total > 0.0:
            stiff, damp = _BRAKE_STIFFNESS, 0.0
        # A spring that slips when it carries all that friction can: no creep below that, and stable at any speed.
        most_bent = total / stiff if stiff > 0.0 else 0.0
        after = min(max(bent, -most_bent), most_bent)
        state.joints[j].bristle = after
        brakes = stiff * after + damp * (after - before) / dt
        lost += brakes * v
        if not elastic:
            # What the sensor between motor and link will see, but for the motor's inertia.
            state.joints[j].spring = drive - (brakes * held / total if total > 0.0 else 0.0)
        return pull - brakes, lost

    return joint


def _loop(step: Any, weigh: Any, receive: Any, control: Any, joint: Any) -> Any:
    """The loop over control steps, with the functions that it calls."""

    def advance(
        engine: Engine,
        numbers: np.ndarray,
        settings: Settings,
        state: State,
        orders: Orders,
        log: np.ndarray,
        places: np.ndarray,
    ) -> int:
        joints, dt = engine.column.size, settings.physics_step_s
        power, brake = np.zeros(joints), np.zeros(joints)
        for k in range(orders.command.shape[0]):
            tick = state.counters[0]
            stopped = tick >= orders.stop
            if stopped and orders.until_stop:
                return k
            receive(settings, state, orders, k)
            for j in range(joints):
                brake[j] = numbers[j].brake_nm if stopped else 0.0
                power[j] = 0.0
                state.joints[j].softness = math.exp(-settings.softening * state.joints[j].rise)
            for f in range(orders.stalls.shape[0]):
                if orders.stalls[f, 1] <= tick < orders.stalls[f, 2]:
                    brake[orders.stalls[f, 0]] = numbers[orders.stalls[f, 0]].brake_nm
            if orders.pull.shape[0]:
                for axis in range(3):
                    engine.pull[axis] = orders.pull[k, axis]
            weigh(engine, numbers, state)
            control(engine, numbers, settings, state, stopped)
            for _ in range(settings.steps):
                for j in range(joints):
                    engine.applied[engine.freedom[j]], lost = joint(engine, numbers, settings, state, j, brake[j])
                    power[j] += lost / settings.steps
                step(engine.model, engine.data)
                for j in range(joints):
                    if numbers[j].stiffness == 0.0:
                        i = engine.freedom[j]
                        state.joints[j].spring -= numbers[j].motor_inertia * engine.qacc[i]
                        state.joints[j].motor_position = engine.qpos[engine.place[j]]
                        state.joints[j].motor_velocity = engine.qvel[i]
            for j in range(joints):
                q, v = engine.qpos[engine.place[j]], engine.qvel[engine.freedom[j]]
                if numbers[j].stiffness > 0.0:
                    state.joints[j].spring = numbers[j].stiffness * (state.joints[j].motor_position - q) + (
                        numbers[j].damping * (state.joints[j].motor_velocity - v)
                    )
                watts = power[j] + numbers[j].copper * state.joints[j].drive ** 2
                warm = settings.rise_k_per_w * watts - state.joints[j].rise
                state.joints[j].rise += dt * settings.steps / settings.time_constant_s * warm
                log[k, POSITION, j] = q
                log[k, VELOCITY, j] = v
                log[k, TORQUE, j] = state.joints[j].spring
                log[k, MOTOR_POSITION, j] = state.joints[j].motor_position
                log[k, MOTOR_TORQUE, j] = state.joints[j].drive
                log[k, RISE, j] = state.joints[j].rise
                log[k, CURRENT, j] = state.joints[j].current
                log[k, VOLTAGE, j] = state.joints[j].voltage
            if places.shape[0]:
                for i in range(engine.qpos.size):
                    places[k, i] = engine.qpos[i]
            state.counters[0] = tick + 1
        return int(orders.command.shape[0])

    return advance
