"""What the robots of a case do: tracks, drives, and what no number of a model expresses, at a fine step."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.foreign_cases import Case
from benchmarks.foreign_plants import FINE_S, Gear, MujocoPlant, Plant
from benchmarks.foreign_robots import carried_inertia, inverse_dynamics, joint_dofs

POSITION_NOISE, VELOCITY_NOISE = 3e-4, 5e-3  # of encoders, rad and rad/s (m and m/s of slides)
_SHAPE_S = 0.002


@dataclass
class Numbers:
    """Numbers of a robot's joints, each (J,), and the masses of its bodies."""

    kp: np.ndarray
    kv: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    armature: np.ndarray
    torque_offset: np.ndarray
    delay_s: np.ndarray
    limit: np.ndarray
    mass: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """All motions of a case at the measured rate, (T, E, J), and its commands when they change, (K, E, J)."""

    time_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    command: np.ndarray
    saturated: np.ndarray


def tracks_of(case: Case, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations that the motions are about, at the rate of commands, each (K, E, J)."""
    rng, kinds = case.drawn(seed, "tracks"), ("mixed", "slow", "fast", "steps")
    time_s = np.arange(0.0, case.duration_s, _SHAPE_S)
    shapes = [_shape(rng, time_s, len(case.joints), kinds[index % 4]) for index in range(case.motions)]
    q = np.array(case.home) + np.array(case.amplitude) * np.stack(shapes, axis=1)
    v = np.gradient(q, time_s, axis=0)
    a = np.gradient(v, time_s, axis=0)
    every = round(1 / case.command_hz / _SHAPE_S)
    return q[::every], v[::every], a[::every]


def _shape(rng: np.random.Generator, time_s: np.ndarray, J: int, kind: str) -> np.ndarray:
    """One motion between -1 and 1, (T, J): sines that stand still now and then, and smooth steps."""
    end = time_s[-1]
    pace = np.ones_like(time_s)
    for start in rng.uniform(1.2, end - 1.5, 1 if kind == "fast" else 2):
        pace *= 1 - _rise((time_s - start) / 0.2) * _rise((start + 0.9 - time_s) / 0.2)
    phase = np.cumsum(pace) * (time_s[1] - time_s[0])
    bands = {"slow": (0.1, 0.5), "fast": (0.5, 1.5)}.get(kind, (0.1, 1.5))
    shape = np.zeros((len(time_s), J))
    for joint in range(J):
        for f in np.exp(rng.uniform(*np.log(bands), 4)):
            shape[:, joint] += (
                rng.uniform(0.4, 1.0) * min(1.0, 0.5 / f) * np.sin(2 * np.pi * (f * phase + rng.uniform()))
            )
        shape[:, joint] *= rng.uniform(0.6, 1.0) / np.abs(shape[:, joint]).max()
        for start in rng.uniform(0.8, end - 1.2, 3 if kind == "steps" else 1):
            shape[:, joint] += rng.uniform(-0.4, 0.4) * _rise((time_s - start) / rng.uniform(0.2, 0.5))
    inside = _rise(time_s / 1.0) * _rise((end - 0.3 - time_s) / 0.8)
    shape = rng.uniform(-0.2, 0.2, J) + inside[:, None] * shape
    return shape / np.maximum(1.0, np.abs(shape).max(axis=0))


def _rise(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 with the least jerk."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def true_model(path: Path, case: Case, true: Numbers, cause: dict[str, Any], *, drives: bool = False) -> mujoco.MjModel:
    """The model at `path` with the true numbers, without limits and contacts, at the fine step.

    Actuators are left out, or are the true drives of its joints, in their order.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for at, joint in enumerate(case.joints if drives else ()):
        gain, bias = _affine(case, true, at)
        spec.add_actuator(
            name=joint,
            target=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            gainprm=[gain, *[0.0] * 9],
            biasprm=[*bias, *[0.0] * 7],
            forcelimited=bool(np.isfinite(true.limit[at])),
            forcerange=[-true.limit[at], true.limit[at]] if np.isfinite(true.limit[at]) else [0.0, 0.0],
        )
    if case.cause == "payload":
        body = spec.body(cause["body"]).add_body(name="unmodelled payload", pos=cause["position_m"])
        body.mass, body.inertia, body.explicitinertial = cause["mass_kg"], [cause["inertia_kg_m2"]] * 3, True
        body.ipos = [0, 0, 0]  # if not given, it is `pos` once more
    model = spec.compile()
    model.opt.timestep, model.opt.integrator = FINE_S, mujoco.mjtIntegrator.mjINT_EULER
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 50, 1e-12
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    for name, mass in true.mass.items():
        body = model.body(name).id
        model.body_inertia[body] *= mass / model.body_mass[body]
        model.body_mass[body] = mass
    dofs = joint_dofs(model, case.joints)
    model.dof_armature[dofs], model.dof_damping[dofs] = true.armature, true.damping
    model.dof_frictionloss[dofs] = true.frictionloss
    model.dof_solref[dofs] = [2 * FINE_S, 1.0]
    model.dof_solimp[dofs] = [0.999, 0.9999, 0.001, 0.5, 2.0]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _affine(case: Case, true: Numbers, at: int) -> tuple[float, tuple[float, float, float]]:
    """What the drive of a joint makes of a command, and of 1, position and velocity."""
    kp, kv, offset = (float(own[at]) for own in (true.kp, true.kv, true.torque_offset))
    return {
        "position": (kp, (offset, -kp, -kv)),
        "velocity": (kv, (offset, 0.0, -kv)),
        "torque": (1.0, (offset, 0.0, 0.0)),
    }[case.drive]


def simulate(
    case: Case, path: Path, true: Numbers, seed: int, *, cause: dict[str, Any], settle_s: float | None = None
) -> Run:
    """Drive the true robot along all motions of a case, from rest in its controller.

    Args:
        case: the case; its engine moves the links.
        path: of the nominal model.
        true: what differs from it.
        seed: of the motions.
        cause: what no number expresses.
        settle_s: how long the first command holds before the motion begins [s].
    """
    model = true_model(path, case, true, cause)
    tracks = tracks_of(case, seed)
    start = tracks[0][0]
    gear = _gear(case, model, true, cause)
    plant = _plant(case, model, start)
    moved: Plant | Gear = plant
    if gear is not None:
        gear.attach(plant)
        moved = gear
    drive = _Servo(case, true, cause, start)
    commander = _commander(case, path, tracks, true, seed)
    settle_s = settle_s if settle_s is not None else (3.0 if case.cause == "integral" else 1.0)
    ticks = round(1 / case.command_hz / FINE_S)
    waiting = round(settle_s * case.command_hz)
    late = np.round(true.delay_s / FINE_S).astype(int)
    reading = round(1 / case.measured_hz / FINE_S)
    commands, column = np.zeros((waiting + len(tracks[0]), *start.shape)), np.arange(len(case.joints))
    rows: list[tuple[np.ndarray, ...]] = []
    full = np.zeros(len(case.joints))
    for step in range(len(commands) * ticks):
        if step % ticks == 0:
            commands[step // ticks] = commander(step // ticks - waiting, plant)
        command = commands[np.maximum(step - late, 0) // ticks, :, column].T
        torque = drive.torque(command, moved.q, moved.v)
        running = step - waiting * ticks
        if running >= 0 and running % reading == 0:
            rows.append((plant.q.copy(), plant.v.copy(), torque))
            full += (np.abs(torque) >= true.limit).mean(axis=0)
        moved.step(torque)
    position, velocity, torque = (np.stack(part) for part in zip(*rows, strict=True))
    _check_range(case, model, position)
    time_s = np.arange(len(rows)) / case.measured_hz
    return Run(time_s, position, velocity, torque, commands[waiting:], full / len(rows))


def _plant(case: Case, model: mujoco.MjModel, start: np.ndarray) -> Plant:
    """The links of a case in its engine."""
    if case.engine == "mujoco":
        return MujocoPlant(model, case.joints, start)
    from benchmarks.foreign_dart import DartPlant  # an extra of its own

    return DartPlant(model, case.joints, start)


class _Servo:
    """What the drive makes of command, position and velocity, at the fine step."""

    def __init__(self, case: Case, true: Numbers, cause: dict[str, Any], start: np.ndarray):
        self._case, self._true = case, true
        self._late = round(cause.get("late_s", 0.0) / FINE_S)
        self._seen = [(start, np.zeros_like(start))] * (self._late + 1)
        self._ki, self._most = cause.get("ki", 0.0), cause.get("most_nm", 0.0)
        self._sum = np.zeros_like(start)

    def torque(self, command: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Torques [Nm], (E, J)."""
        true = self._true
        if self._late:
            self._seen = [*self._seen[1:], (q.copy(), v.copy())]
            q, v = self._seen[0]
        if self._case.drive == "position":
            error = command - q
            self._sum = np.clip(self._sum + FINE_S * self._ki * error, -self._most, self._most)
            wanted = true.kp * error - true.kv * v + self._sum
        elif self._case.drive == "velocity":
            wanted = true.kv * (command - v)
        else:
            wanted = command
        return np.clip(wanted + true.torque_offset, -true.limit, true.limit)


def _commander(
    case: Case, path: Path, tracks: tuple[np.ndarray, ...], true: Numbers, seed: int
) -> Callable[[int, Plant], np.ndarray]:
    """What commands the robot at a tick: its track, or a loop around it that knows the nominal model."""
    q, v, _ = tracks
    rng, end = case.drawn(seed, "loop"), len(q) - 1
    if case.drive == "position":
        return lambda tick, _: q[max(tick, 0)]

    def seen(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
        shape = plant.q.shape
        return plant.q + rng.normal(0, POSITION_NOISE, shape), plant.v + rng.normal(0, VELOCITY_NOISE, shape)

    if case.drive == "velocity":
        return lambda tick, plant: (tick >= 0) * v[np.clip(tick, 0, end)] + 3.0 * (q[max(tick, 0)] - seen(plant)[0])
    model = mujoco.MjModel.from_xml_path(str(path))
    torque = np.stack(
        [inverse_dynamics(model, case.joints, *(part[:, motion] for part in tracks)) for motion in range(q.shape[1])],
        axis=1,
    )
    carried = carried_inertia(model, case.joints, case.home) + true.armature

    def follow(tick: int, plant: Plant) -> np.ndarray:
        at, (seen_q, seen_v) = max(tick, 0), seen(plant)
        error = 10.0**2 * (q[at] - seen_q) + 2 * 0.7 * 10.0 * ((tick >= 0) * v[at] - seen_v)
        return np.clip(torque[at] + carried * error, -true.limit, true.limit)

    return follow


def cause_of(case: Case, model: mujoco.MjModel, true: Numbers, typical: np.ndarray) -> dict[str, Any]:
    """The numbers of what no parameter expresses; arrays are (J,)."""
    here = np.array([joint in (case.at or case.joints) for joint in case.joints])
    about = {"kind": case.cause, "joints": case.at or case.joints}
    match case.cause:
        case "late-feedback":
            return about | {"late_s": round(case.amount / FINE_S) * FINE_S}
        case "integral":
            return about | {"ki": here * case.amount * true.kp, "most_nm": 3.0 * typical}
        case "backlash":
            return about | {"play_rad": here * case.amount, "link_friction": 0.2}
        case "elastic":
            return about | {"stiffness": here * np.maximum(typical / case.amount, 2 * true.kp), "link_friction": 0.2}
        case "payload":
            body = int(model.jnt_bodyid[model.joint(case.joints[-1]).id])
            out = model.body_ipos[body] / max(np.linalg.norm(model.body_ipos[body]), 1e-9)
            place = {"body": model.body(body).name, "position_m": model.body_ipos[body] + 0.06 * out}
            return about | {"mass_kg": case.amount, "inertia_kg_m2": 0.4 * case.amount * 0.03**2} | place
        case "sign":
            return about | {"mirrored": ["measured", "command"] if case.amount else ["measured"]}
    return {}


def _gear(case: Case, model: mujoco.MjModel, true: Numbers, cause: dict[str, Any]) -> Gear | None:
    """The soft or loose gear of a case; what belongs to its motors leaves `model`."""
    if case.cause not in {"backlash", "elastic"}:
        return None
    dofs, data = joint_dofs(model, case.joints), mujoco.MjData(model)
    play = np.asarray(cause.get("play_rad", np.zeros(len(dofs))))
    asked = np.asarray(cause.get("stiffness", np.where(play > 0, np.inf, 0.0)))
    soft, left = asked > 0, cause["link_friction"]
    model.dof_armature[dofs] *= ~soft
    model.dof_damping[dofs] *= ~soft
    model.dof_frictionloss[dofs] *= np.where(soft, left, 1.0)
    data.qpos[dofs] = case.home
    mujoco.mj_forward(model, data)
    full = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    link = 1 / np.diag(np.linalg.inv(full))[dofs]
    shared = 1 / (1 / link + 1 / true.armature)  # of motor against link
    stiffness = np.minimum(asked, 0.1 * shared / FINE_S**2)
    cause["stiffness"] = stiffness
    damping = 2 * (0.3 if play.any() else 0.05) * np.sqrt(stiffness * shared)
    return Gear(stiffness, damping, play, true.armature, (1 - left) * true.frictionloss, true.damping)


def _check_range(case: Case, model: mujoco.MjModel, position: np.ndarray) -> None:
    """A truth has no stops: its motions must not come near them."""
    for index, name in enumerate(case.joints):
        joint = model.joint(name)
        low, high = joint.range if model.jnt_limited[joint.id] else (-20.0, 20.0)
        if position[..., index].min() < low + 0.02 or position[..., index].max() > high - 0.02:
            extent = f"{position[..., index].min():.3f} to {position[..., index].max():.3f}"
            raise RuntimeError(f"case {case.name}: {name} moves from {extent}, its range is {low:.3f} to {high:.3f}")
