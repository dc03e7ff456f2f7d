"""Logs of robots whose numbers are known, from other people's models and none of trueup's code.

A case is a robot with a drive. `make` writes what its user would have: a nominal model, a robot description and logs;
and, beside them, the true numbers. The truth is simulated at 0.25 ms in MuJoCo or DART with a controller of its own.
Cases of group A differ from the nominal model in numbers that a fit can find; cases of group B in one more thing that
none of them can express.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal
from zlib import crc32

import mujoco
import numpy as np

from benchmarks.foreign_plants import FINE_S, DartPlant, Gear, MujocoPlant, Plant
from benchmarks.foreign_robots import (
    ROBOTS,
    Drive,
    carried_inertia,
    inverse_dynamics,
    joint_dofs,
    torque_limits,
)

Cause = Literal["late-feedback", "integral", "backlash", "elastic", "payload", "sign"]
Range = tuple[float, float]
POSITION_NOISE, VELOCITY_NOISE, TORQUE_NOISE = 3e-4, 5e-3, 0.02  # rad, rad/s, part of a joint's rms
SLOPE_S = 0.004  # half-width of the differences that turn a track into velocities
STIFFEST_RAD_S = 90.0  # servos are not faster than this: rotors are heavy enough


@dataclass(frozen=True)
class Case:
    """What one truth is like. Ranges are drawn from anew for each seed.

    Attributes:
        name: of the case.
        robot: key of `ROBOTS`.
        group: `A` for numbers that a fit can find, `B` for a cause besides that it cannot.
        drive: what the robot follows.
        commands: `fast` commands move every 2 ms and are logged at 100 Hz; `held` ones are constant between stamps.
        engine: what moves the links.
        cause: of group B.
        at: joints that the cause is about; all if empty.
        amount: its size: late feedback [s], integral gain per kp [1/s], backlash [rad], twist of elastic joints under
            their typical torque [rad], payload [kg]; of a sign, 1 if the command is mirrored, too, else 0.
        command_hz: how often the command changes.
        log_hz: of the command in the log; as `command_hz` if held.
        measured_hz: of what is measured.
        delay_s: of the command.
        shared_delay: one for all joints.
        kp: factor of the nominal gain.
        kv: factor of the nominal gain.
        damping: of the joint, as a part of critical damping (position) or of the typical torque (others).
        friction: dry friction as a part of the typical torque.
        mass: factor of the masses of `heavier`.
        heavier: bodies whose mass differs, with their inertia.
        offsets: joints with a constant torque.
        velocity: whether velocities are logged.
        torque: whether torques are logged.
        motions: how many.
        duration_s: of each.
    """

    name: str
    robot: str
    group: Literal["A", "B"] = "A"
    drive: Drive = "position"
    commands: Literal["fast", "held"] = "fast"
    engine: Literal["mujoco", "dart"] = "mujoco"
    cause: Cause | None = None
    at: tuple[str, ...] = ()
    amount: float = 0.0
    command_hz: float = 500.0
    log_hz: float = 100.0
    measured_hz: float = 100.0
    delay_s: Range = (0.006, 0.022)
    shared_delay: bool = True
    kp: Range = (0.4, 1.3)
    kv: Range = (0.4, 1.1)
    damping: Range = (0.05, 0.2)
    friction: Range = (0.1, 0.4)
    mass: Range = (0.8, 1.2)
    heavier: tuple[str, ...] = ()
    offsets: tuple[str, ...] = ()
    velocity: bool = False
    torque: bool = False
    motions: int = 8
    duration_s: float = 5.0

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that move."""
        return ROBOTS[self.robot].joints

    @property
    def home(self) -> tuple[float, ...]:
        """Middle of the motions, (J,) [rad or m]."""
        return ROBOTS[self.robot].home

    @property
    def amplitude(self) -> tuple[float, ...]:
        """Largest distance from there, (J,) [rad or m]."""
        return ROBOTS[self.robot].amplitude

    def drawn(self, seed: int, purpose: str) -> np.random.Generator:
        """Draws for one purpose, which depend on the case's name and the seed."""
        return np.random.default_rng([crc32(f"{self.name} {purpose}".encode()), seed])


@dataclass(frozen=True)
class Truth:
    """What is in truth.json.

    Attributes:
        case: its fields.
        seed: of the draws.
        parameters: true values, such as `kp[elbow]`, of all that a default fit may change.
        nominal: what the model says, by the same names.
        sums: of parameters of which data show the sum better than the parts.
        noise: standard deviations of what was added to the logs.
        cause: what no parameter expresses; empty in group A.
        step_s: of the simulation.
        joints: names.
        limits: largest torques of the drives, by joint; None where there is no limit.
        saturated: share of the time at these limits, by joint.
    """

    case: dict[str, Any]
    seed: int
    parameters: dict[str, float]
    nominal: dict[str, float]
    sums: dict[str, float]
    noise: dict[str, float]
    cause: dict[str, Any]
    step_s: float
    joints: tuple[str, ...]
    limits: dict[str, float | None]
    saturated: dict[str, float]


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


def make(case: Case, seed: int, out: Path) -> Truth:
    """Write `model.xml`, `robot.yaml`, `logs/m00.npz`, ... and `truth.json` into `out`; the same bytes for a seed."""
    robot = ROBOTS[case.robot]
    (out / "logs").mkdir(parents=True, exist_ok=True)
    (out / "model.xml").write_text(robot.nominal(case.drive).to_xml())
    (out / "robot.yaml").write_text(_description(case))
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    nominal, true, typical = numbers(case, model, seed)
    cause = _cause(case, model, true, typical)
    run = simulate(case, out / "model.xml", true, seed, cause=cause)
    noise = _write_logs(case, run, seed, out / "logs")
    limits = [float(limit) if np.isfinite(limit) else None for limit in true.limit]
    truth = Truth(
        case=asdict(case),
        seed=seed,
        parameters=_named(case, model, true),
        nominal=_named(case, model, nominal),
        sums=_sums(case, true),
        noise=noise,
        cause=_plain(cause),
        step_s=FINE_S,
        joints=case.joints,
        limits=dict(zip(case.joints, limits, strict=True)),
        saturated=dict(zip(case.joints, run.saturated.round(4).tolist(), strict=True)),
    )
    (out / "truth.json").write_text(json.dumps(asdict(truth), indent=1) + "\n")
    return truth


def numbers(case: Case, model: mujoco.MjModel, seed: int) -> tuple[Numbers, Numbers, np.ndarray]:
    """Nominal and true numbers, and the rms torque of each joint along a motion, (J,)."""
    rng, J = case.drawn(seed, "numbers"), len(case.joints)
    dofs = joint_dofs(model, case.joints)
    actuators = [model.actuator(name).id for name in case.joints]
    kp, kv = (0.0 - model.actuator_biasprm[actuators, at] for at in (1, 2))
    zero = np.zeros(J)
    nominal = Numbers(
        *(kp, kv, model.dof_damping[dofs], model.dof_frictionloss[dofs], model.dof_armature[dofs]),
        *(zero, zero, torque_limits(model, case.joints)),
        mass={name: float(model.body(name).mass[0]) for name in _moving(model)},
    )

    def some(bounds: Range, spread: float = 1.2) -> np.ndarray:
        low, high = bounds
        spread = min(spread, (high / low) ** 0.5)
        return rng.uniform(low * spread, high / spread) * spread ** rng.uniform(-1, 1, J)

    carried = carried_inertia(model, case.joints, case.home)
    kp, kv = kp * some(case.kp), kv * some(case.kv)
    armature = np.where(
        nominal.armature > 0,
        nominal.armature * some((0.6, 1.8)),
        some((0.1, 0.35)) * np.sqrt(carried * _largest(carried)),
    )
    if case.drive == "position":
        armature = np.maximum(armature, kp * some((1.0, 1.5)) / STIFFEST_RAD_S**2 - carried)
    armature = np.maximum(armature, 0.005 * kv * some((0.8, 1.2)) - carried)  # and slower than the fine step
    track = [values[:, 0] for values in _tracks(case, seed)]
    typical = inverse_dynamics(model, case.joints, *(values[::10] for values in track)) + armature * track[2][::10]
    typical = np.sqrt((typical**2).mean(axis=0))
    if case.drive == "position":
        viscous = some(case.damping) * 2 * np.sqrt(kp * (carried + armature))
    else:
        viscous = some(case.damping) * typical / np.sqrt((track[1] ** 2).mean(axis=0))
    delay = rng.uniform(*case.delay_s, 1 if case.shared_delay else J)
    true = Numbers(
        kp=kp,
        kv=kv,
        damping=nominal.damping * some((0.5, 1.8)) + viscous,
        frictionloss=some(case.friction, 1.5) * typical,
        armature=armature,
        torque_offset=np.array([joint in case.offsets for joint in case.joints])
        * rng.choice([-1, 1], J)
        * 0.15
        * typical,
        delay_s=np.broadcast_to(np.round(delay / FINE_S) * FINE_S, J),
        limit=nominal.limit,
        mass=nominal.mass | {name: nominal.mass[name] * rng.uniform(*case.mass) for name in case.heavier},
    )
    return nominal, true, typical


def _largest(carried: np.ndarray) -> np.ndarray:
    """The largest of those of the same kind, hinge or slide."""
    slides = carried > 30.0
    return np.where(slides, carried, carried[~slides].max())


def _moving(model: mujoco.MjModel) -> list[str]:
    """Bodies that move and have a mass."""
    return [model.body(i).name for i in range(1, model.nbody) if model.body_weldid[i] != 0 and model.body_mass[i] > 0]


def _tracks(case: Case, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations that the motions are about, at the rate of commands, each (K, E, J)."""
    rng, kinds = case.drawn(seed, "tracks"), ("mixed", "slow", "fast", "steps")
    fine = np.arange(0.0, case.duration_s + 0.02, SLOPE_S / 2)
    shapes = [_shape(rng, fine, len(case.joints), kinds[index % 4]) for index in range(case.motions)]
    q = np.array(case.home) + np.array(case.amplitude) * np.stack(shapes, axis=1)
    v = np.gradient(q, fine, axis=0)
    a = np.gradient(v, fine, axis=0)
    at = np.arange(0.0, case.duration_s, 1 / case.command_hz)
    flat = [
        np.stack([np.interp(at, fine, column) for column in values.reshape(len(fine), -1).T], axis=1)
        for values in (q, v, a)
    ]
    q, v, a = (values.reshape(len(at), *q.shape[1:]) for values in flat)
    return q, v, a


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
            shape[:, joint] += rng.uniform(-0.4, 0.4) * _rise((time_s - start) / rng.uniform(0.15, 0.4))
    inside = _rise(time_s / 1.0) * _rise((end - 0.3 - time_s) / 0.8)
    shape = rng.uniform(-0.2, 0.2, J) + inside[:, None] * shape
    return shape / np.maximum(1.0, np.abs(shape).max(axis=0))


def _rise(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 with the least jerk."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def true_model(path: Path, case: Case, true: Numbers, cause: dict[str, Any]) -> mujoco.MjModel:
    """The model at `path` with the true numbers, without actuators, limits and contacts, at the fine step."""
    spec = mujoco.MjSpec.from_file(str(path))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    if case.cause == "payload":
        body = spec.body(cause["body"]).add_body(name="unmodelled payload", pos=cause["position_m"])
        body.mass, body.inertia, body.explicitinertial = cause["mass_kg"], [cause["inertia_kg_m2"]] * 3, True
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
    tracks = _tracks(case, seed)
    start = tracks[0][0]
    gear = _gear(case, model, true, cause)
    plant: Plant = (DartPlant if case.engine == "dart" else MujocoPlant)(model, case.joints, start)
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


def _cause(case: Case, model: mujoco.MjModel, true: Numbers, typical: np.ndarray) -> dict[str, Any]:
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
            return about | {"stiffness": here * typical / case.amount, "link_friction": 0.2}
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


def _write_logs(case: Case, run: Run, seed: int, folder: Path) -> dict[str, float]:
    """One npz file per motion, as a robot would log it; returns the noise that was added."""
    rng, joints = case.drawn(seed, "noise"), np.array(case.joints)
    signs = {series: np.ones(len(joints)) for series in ("measured", "command")}
    if case.cause == "sign":
        signs["measured"][np.isin(joints, case.at)] = -1
        signs["command"][np.isin(joints, case.at)] = -1 if case.amount else 1
    noise = {"position": POSITION_NOISE} | ({"velocity": VELOCITY_NOISE} if case.velocity else {})
    noise |= {"torque_per_rms": TORQUE_NOISE} if case.torque else {}
    every = round(case.command_hz / case.log_hz)
    command = run.command[::every]
    for motion in range(case.motions):
        logged = {"position": run.position[:, motion] + rng.normal(0, POSITION_NOISE, run.position[:, motion].shape)}
        if case.velocity:
            logged["velocity"] = run.velocity[:, motion] + rng.normal(0, VELOCITY_NOISE, logged["position"].shape)
        if case.torque:
            rms = np.sqrt((run.torque[:, motion] ** 2).mean(axis=0))
            logged["torque"] = run.torque[:, motion] + TORQUE_NOISE * rms * rng.normal(0, 1, logged["position"].shape)
        arrays = {f"measured.{name}": signs["measured"] * values for name, values in logged.items()}
        arrays |= {"measured.time_s": run.time_s, "command.time_s": np.arange(len(command)) / case.log_hz}
        arrays |= {f"command.{case.drive}": signs["command"] * command[:, motion]}
        np.savez(folder / f"m{motion:02d}.npz", joints=joints, robot=np.array(case.robot), **arrays)
    return noise


def _description(case: Case) -> str:
    """robot.yaml."""
    lines = ["schema: trueup.robot/1", f"name: {case.robot}", "model: model.xml", "joints:"]
    lines += [f"- name: {name}" for name in case.joints]
    lines += ["controller:", "  kind: model", f"  command: {case.drive}"]
    lines += ["replay:", "  window_s: 0.5"] if case.drive == "torque" else []
    return "\n".join(lines) + "\n"


def _named(case: Case, model: mujoco.MjModel, values: Numbers) -> dict[str, float]:
    """All that a default fit may change, by the names of trueup's parameters."""
    gains = {"position": ("kp", "kv"), "velocity": ("kv",), "torque": ()}[case.drive]
    found = {
        f"{name}[{joint}]": float(value)
        for name in ("delay_s", *gains, "damping", "frictionloss", "armature", "torque_offset")
        for joint, value in zip(case.joints, getattr(values, name), strict=True)
    }
    for joint in case.joints:
        found[f"joint_offset[{joint}]"] = 0.0
        if case.drive == "torque":
            found[f"torque_gain[{joint}]"] = 1.0
    for body, mass in values.mass.items():
        found[f"mass[{body}]"] = mass
        found |= {f"com_{axis}[{body}]": float(at) for axis, at in zip("xyz", model.body(body).ipos, strict=True)}
        found[f"inertia_scale[{body}]"] = 1.0
    return found


def _sums(case: Case, true: Numbers) -> dict[str, float]:
    """On a position servo, its damping acts as viscous friction does."""
    if case.drive != "position":
        return {}
    both = true.kv + true.damping
    return {f"kv+damping[{joint}]": float(value) for joint, value in zip(case.joints, both, strict=True)}


def _plain(tree: dict[str, Any]) -> dict[str, Any]:
    """The same in types that JSON has."""
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in tree.items()}


CASES: tuple[Case, ...] = (
    Case("ur5e", "ur5e", velocity=True, heavier=("wrist_2_link", "wrist_3_link")),
    Case("iiwa14_torque", "iiwa14", drive="torque", delay_s=(0.004, 0.008), velocity=True, heavier=("link6", "link7")),
    Case("vx300s", "vx300s", commands="held", command_hz=50.0, log_hz=50.0, shared_delay=False),
)
