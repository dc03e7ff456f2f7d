"""Logs of robots whose numbers are known, from other people's models and none of trueup's code.

A case is a robot with a drive. `make` writes what its user would have: a nominal model, a robot description and logs;
and, beside them, the true numbers. The truth is simulated at 0.25 ms in MuJoCo or DART with a controller of its own.
Cases of group A differ from the nominal model in numbers that a fit can find; cases of group B in one more thing that
none of them can express.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.foreign_cases import CASES, Case, Range
from benchmarks.foreign_motions import POSITION_NOISE, VELOCITY_NOISE, Numbers, Run, cause_of, simulate, tracks_of
from benchmarks.foreign_plants import FINE_S
from benchmarks.foreign_robots import ROBOTS, carried_inertia, inverse_dynamics, joint_dofs, torque_limits

__all__ = ["CASES", "Case", "Truth", "make", "numbers"]

TORQUE_NOISE = 0.02  # of a joint's rms
STIFFEST_RAD_S = 90.0  # servos are not faster than this: rotors are heavy enough


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


def make(case: Case, seed: int, out: Path) -> Truth:
    """Write `model.xml`, `robot.yaml`, `logs/m00.npz`, ... and `truth.json` into `out`; the same bytes for a seed."""
    robot = ROBOTS[case.robot]
    (out / "logs").mkdir(parents=True, exist_ok=True)
    (out / "model.xml").write_text(robot.nominal(case.drive).to_xml())
    (out / "robot.yaml").write_text(_description(case))
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    nominal, true, typical = numbers(case, model, seed)
    cause = cause_of(case, model, true, typical)
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
    if case.cause == "late-feedback":  # and than what is late
        armature = np.maximum(armature, np.maximum(kp * (case.amount / 0.35) ** 2, kv * case.amount / 0.5) - carried)
    track = [values[:, 0] for values in tracks_of(case, seed)]
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
        delay_s=np.broadcast_to(np.round(np.round(delay / FINE_S) * FINE_S, 6), J),
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
            found |= {f"encoder_zero[m{motion:02d}:{joint}]": 0.0 for motion in range(case.motions)}
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
