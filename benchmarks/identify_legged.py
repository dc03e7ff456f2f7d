"""Legged robots that hang in the air by their trunk, as for PACE: a quadruped of 12 joints, a humanoid of 29."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from benchmarks.identify_cases import Case, commanded, record, true_simulator
from trueup.identify import Nominal
from trueup.identify.config import make_parameters
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec

_STEP_S, _RATE_HZ = 0.002, 200.0
_NOISE = 1e-3  # rad
_LOW_HZ, _HIGH_HZ = 0.1, 10.0
_ROLL, _PITCH, _YAW = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
# Name, axis, distance to the next joint [m], mass [kg] and length [m] of the link.
_Link = tuple[str, tuple[float, float, float], float, float, float]
_LEG: tuple[_Link, ...] = (
    ("hip_roll", _ROLL, 0.06, 0.8, 0.08),
    ("hip_pitch", _PITCH, 0.25, 1.5, 0.22),
    ("knee", _PITCH, 0.25, 0.4, 0.24),
)
_HUMAN_LEG: tuple[_Link, ...] = (
    ("hip_pitch", _PITCH, 0.05, 1.5, 0.1),
    ("hip_roll", _ROLL, 0.08, 1.6, 0.1),
    ("hip_yaw", _YAW, 0.25, 2.2, 0.25),
    ("knee", _PITCH, 0.3, 2.0, 0.3),
    ("ankle_pitch", _PITCH, 0.02, 0.3, 0.06),
    ("ankle_roll", _ROLL, 0.05, 0.7, 0.15),
)
_WAIST: tuple[_Link, ...] = (
    ("waist_yaw", _YAW, 0.04, 0.6, 0.1),
    ("waist_roll", _ROLL, 0.04, 0.5, 0.1),
    ("waist_pitch", _PITCH, 0.3, 8.0, 0.35),
)
_ARM: tuple[_Link, ...] = (
    ("shoulder_pitch", _PITCH, 0.06, 0.7, 0.08),
    ("shoulder_roll", _ROLL, 0.06, 0.7, 0.08),
    ("shoulder_yaw", _YAW, 0.15, 0.8, 0.15),
    ("elbow", _PITCH, 0.1, 0.6, 0.12),
    ("wrist_roll", _YAW, 0.08, 0.3, 0.08),
    ("wrist_pitch", _PITCH, 0.05, 0.3, 0.08),
    ("wrist_yaw", _ROLL, 0.05, 0.4, 0.12),
)


def quadruped(folder: Path, seed: int) -> Case:
    """49 parameters: armature, damping, friction and zero of 12 joints, and one delay."""
    spec, trunk = _hung()
    for front, x in (("front", 0.2), ("rear", -0.2)):
        for side, y in (("left", 0.1), ("right", -0.1)):
            _chain(trunk, f"{front}_{side}", _LEG, [x, y, 0.0], down=True)
    return _case(spec, folder / "quadruped.xml", ControllerSpec(kind="position", kp=40.0, kv=1.0), seed)


def humanoid(folder: Path, seed: int) -> Case:
    """117 parameters: the same of 29 joints."""
    spec, trunk = _hung()
    for side, y in (("left", 0.1), ("right", -0.1)):
        _chain(trunk, side, _HUMAN_LEG, [0.0, y, -0.05], down=True)
    chest = _chain(trunk, "", _WAIST, [0.0, 0.0, 0.05], down=False)
    for side, y in (("left", 0.12), ("right", -0.12)):
        _chain(chest, side, _ARM, [0.0, y, 0.25], down=True)
    return _case(spec, folder / "humanoid.xml", ControllerSpec(kind="position", kp=100.0, kv=3.0), seed)


def _hung() -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
    """An empty robot; its trunk hangs at a slant, so that no joint turns about the vertical."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = _STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    slant = np.empty(4)
    mujoco.mju_euler2Quat(slant, np.array([0.3, 0.4, 0.0]), "xyz")
    return spec, spec.worldbody.add_body(name="trunk", pos=[0.0, 0.0, 1.5], quat=slant)


def _chain(
    parent: mujoco.MjsBody, prefix: str, links: tuple[_Link, ...], place: list[float], *, down: bool
) -> mujoco.MjsBody:
    sign = -1.0 if down else 1.0
    for name, axis, reach, mass, length in links:
        full = f"{prefix}_{name}".strip("_")
        body = parent.add_body(name=full, pos=place)
        body.explicitinertial = True
        body.mass = mass
        body.ipos = [0.1 * length, 0.0, 0.45 * sign * length]
        across, along = mass * length**2 / 12.0 + 0.0005, 0.1 * mass * length**2 / 12.0 + 0.0004
        body.inertia = [across, across, along]
        body.add_joint(name=full, axis=axis, armature=0.02, damping=[0.5, 0.0, 0.0], frictionloss=0.3)
        parent, place = body, [0.0, 0.0, sign * reach]
    return parent


def _case(spec: mujoco.MjSpec, path: Path, controller: ControllerSpec, seed: int) -> Case:
    path.write_text(spec.to_xml())
    joints = tuple(joint.name for joint in spec.joints)
    robot = RobotSpec(
        path.stem,
        tuple(JointSpec(name) for name in joints),
        path.name,
        controller=controller,
        simulation=SimulationSpec(timestep_s=_STEP_S),
    )
    nominal = Nominal(robot, path)
    rng = np.random.default_rng(seed)
    true = {"delay_s": 0.012}
    for joint in joints:
        true[f"armature[{joint}]"] = rng.uniform(0.01, 0.05)
        true[f"damping[{joint}]"] = rng.uniform(0.2, 1.0)
        true[f"frictionloss[{joint}]"] = rng.uniform(0.1, 0.5)
        true[f"joint_offset[{joint}]"] = rng.uniform(0.02, 0.08) * rng.choice([-1.0, 1.0])
    fit = {"delay_s": {"shared": True}} | dict.fromkeys(("armature", "damping", "frictionloss", "joint_offset"), "all")
    parameters = make_parameters(fit, nominal)
    wrong = {
        name: value * rng.uniform(2.0, 5.0) ** rng.choice([-1.0, 1.0])
        for name, value in true.items()
        if name.startswith(("armature", "damping", "frictionloss"))
    }
    simulator, delays = true_simulator(nominal, parameters, true)
    log = record(
        simulator,
        _chirp(joints, rng),
        rng,
        position=np.zeros(len(joints)),
        noise=_NOISE,
        rate_hz=_RATE_HZ,
        delays=delays,
    )
    return Case(nominal, true, parameters.at(wrong), (log,))


def _chirp(joints: tuple[str, ...], rng: np.random.Generator, *, seconds: float = 20.0, size: float = 0.3):
    """The commands of PACE: every joint through all frequencies, in directions that differ."""
    time_s = np.arange(round(seconds * _RATE_HZ) + 1) / _RATE_HZ
    cycles = _LOW_HZ * time_s + (_HIGH_HZ - _LOW_HZ) * time_s**2 / (2.0 * seconds)
    direction = rng.uniform(0.6, 1.0, len(joints)) * rng.choice([-1.0, 1.0], len(joints))
    return commanded(time_s, joints, "position", size * direction * np.sin(2.0 * np.pi * cycles)[:, None])
