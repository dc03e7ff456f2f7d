"""What a fit leaves for others: a patched model, a robot description, actuator settings for Isaac, samples."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from trueup.core.atomic import replacing, write_text
from trueup.errors import ConfigError
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.drive import Drive
from trueup.identify.identification import Identification
from trueup.identify.problem import Problem
from trueup.identify.uncertainty import rounded
from trueup.robots import JointFriction, JointGains, RobotSpec, load_robot
from trueup.robots.extent import folders_of
from trueup.robots.model import compile_spec, state_files
from trueup.robots.written import robot_yaml
from trueup.sim import MujocoSimulator, friction_of

MODEL_FILE = "model.fitted.xml"
ROBOT_FILE = "robot.fitted.yaml"
ISAAC_FILE = "isaac.actuators.yaml"
SAMPLES_FILE = "fit.samples.npz"
_SAMPLES = 1000
# What three moments may lose together when they are written with six digits, as a share of the largest.
_ROUNDED = 2e-5


def save_identification(found: Identification, folder: Path, *, seed: int = 0) -> None:
    """Write fit.json, the fitted model and robot, Isaac's actuator settings, and samples of the posterior."""
    candidate = found.candidate()
    save_model(candidate, folder / MODEL_FILE)
    write_text(folder / ROBOT_FILE, robot_yaml(fitted_robot(candidate)))
    write_text(folder / ISAAC_FILE, isaac_yaml(candidate))
    save_samples(found, folder / SAMPLES_FILE, seed=seed)
    # The result last: where fit.json is, the rest is too.
    found.result.save(folder / "fit.json")


def rehearse(robot: RobotSpec, model: Path, config: IdentifyConfig | None = None) -> None:
    """Write and read everything once that an identification will write of a model, with the numbers of its start.

    What keeps a fitted model from being written or replayed must not come to light after an hour of search.

    Args:
        robot: its description.
        model: MJCF or URDF.
        config: what will be fitted; the default for the robot's controller if None.

    Raises:
        ConfigError: a fitted model could not be written, or would not move as it was fitted.
        TrueupError: whatever keeps this model from being fitted or simulated.
    """
    nominal = Nominal(robot, model)
    chosen = (config or IdentifyConfig()).resolved(nominal)
    extra = dict.fromkeys((name for names in (chosen.models or {}).values() for name in names), "all")
    parameters = make_parameters({**extra, **chosen.fit}, nominal)
    candidate = Problem(nominal, parameters, ()).candidate({item.name: item.value for item in parameters})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_model(candidate, folder / MODEL_FILE)
        write_text(folder / ROBOT_FILE, robot_yaml(fitted_robot(candidate)))
        isaac_yaml(candidate)
        again = load_robot(folder / ROBOT_FILE)
        simulator = MujocoSimulator.from_robot(again, folder / MODEL_FILE)
    unlike = _unlike(candidate.compile(), simulator.model)
    if again.joint_rules() != robot.joint_rules() or simulator.command_signals != nominal.simulator.command_signals:
        unlike.append("joint map or commands")
    if unlike:
        raise ConfigError(
            f"a model fitted to {model} would not be replayed as it was fitted", got=f"other {', '.join(unlike)}"
        )


def save_model(candidate: Candidate, path: Path) -> None:
    """Write a candidate as MJCF that plain MuJoCo loads.

    What trueup adds for itself (sensors and their sites, no automatic reset) is taken out again. Meshes, textures and
    other files are referred to by their whole paths; those that were missing are left out.

    Raises:
        ConfigError: MuJoCo refuses what was written, or reads another model from it.
    """
    candidate.finish()
    spec = candidate.spec
    state_files(spec, compile_spec(spec, candidate.nominal.path), folders_of(candidate.nominal.path.absolute()))
    # Sensors, and the sites of sensors; bodies that a payload has added are of the model.
    for added in (*spec.sensors, *spec.sites):
        if added.name.startswith("trueup."):
            spec.delete(added)
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    _leave_room_for_rounding(spec, spec.compile())
    model = compile_spec(spec, candidate.nominal.path)
    write_text(path, spec.to_xml())
    _compare(model, path, candidate.nominal.path)


# What moves a robot, in a compiled model: written with six digits, it must come back as it was.
_MOVING = (
    *("body_mass", "body_ipos", "body_inertia", "body_pos", "body_quat", "body_gravcomp", "body_parentid", "qpos0"),
    *("jnt_type", "jnt_axis", "jnt_pos", "jnt_range", "jnt_limited", "jnt_stiffness", "qpos_spring"),
    *("jnt_actfrclimited", "jnt_actfrcrange", "dof_damping", "dof_frictionloss", "dof_armature", "dof_solref"),
    *("actuator_trnid", "actuator_gear", "actuator_dyntype", "actuator_dynprm", "actuator_gaintype"),
    *("actuator_gainprm", "actuator_biastype", "actuator_biasprm", "actuator_ctrllimited", "actuator_ctrlrange"),
    *("actuator_forcelimited", "actuator_forcerange", "jnt_user", "eq_type", "eq_data", "tendon_stiffness"),
)
_OPTIONS = ("timestep", "gravity", "integrator", "wind", "density", "viscosity")
_DIGITS = 1e-4


def _compare(model: mujoco.MjModel, path: Path, origin: Path) -> None:
    """Raise ConfigError unless plain MuJoCo reads from a file the model that was written."""
    try:
        found = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise ConfigError(f"the fitted model of {origin} cannot be written: MuJoCo refuses it", got=error) from error
    unlike = _unlike(model, found)
    if unlike:
        raise ConfigError(
            f"the fitted model of {origin} cannot be written: MuJoCo's MJCF of it is another model",
            got=f"other {', '.join(unlike)}",
            hint="Convert the model to plain MJCF (mujoco.MjSpec.from_file, compile, to_xml), and compare the two.",
        )


def _unlike(one: mujoco.MjModel, other: mujoco.MjModel) -> list[str]:
    """What differs in how two models move."""
    unlike = [name for name in _MOVING if not _alike(_moved(one, name), _moved(other, name))]
    return unlike + [name for name in _OPTIONS if not _alike(getattr(one.opt, name), getattr(other.opt, name))]


def _moved(model: mujoco.MjModel, name: str) -> np.ndarray:
    """A field of what moves: the world does not."""
    values = np.asarray(getattr(model, name))
    return values[1:] if name.startswith("body_") else values


def _alike(one: Any, other: Any) -> bool:
    """Whether arrays are alike but for the digits with which a file holds them, and quaternions but for their sign."""
    one, other = np.asarray(one, np.float64), np.asarray(other, np.float64)
    size = np.abs(one).max(initial=0.0)
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=_DIGITS, atol=_DIGITS * min(size, 1.0)))


def _leave_room_for_rounding(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Thicken flat bodies so little that MuJoCo still takes their inertia after it was written with six digits.

    Of a flat body one moment is the sum of the other two, and after rounding may be more than that.
    """
    for body in spec.bodies[1:]:
        small, middle, large = np.sort(model.body(body.name).inertia)
        if not body.explicitinertial or small + middle - large >= _ROUNDED * large:
            continue
        if np.isnan(body.fullinertia[0]):
            body.inertia = body.inertia + _ROUNDED * large
        else:
            body.fullinertia = body.fullinertia + _ROUNDED * large * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


def fitted_robot(candidate: Candidate) -> RobotSpec:
    """The robot's description for the fitted model: everything is in the model, except for the delays.

    A torque limit of the description would win over the model's, so it follows the fitted one. Of delays below zero,
    the stamps of the command are late, which is a property of the log: `replay.command_shift_s`.
    """
    robot, model = candidate.nominal.robot, candidate.compile()
    limits = {joint: candidate.drive(joint, model).torque_limit for joint in robot.joint_names}
    shift = rounded(max(0.0, -min(candidate.delay_s.values())))
    later = {joint: max(0.0, rounded(delay + shift)) for joint, delay in candidate.delay_s.items()}
    delays = {joint: JointGains(delay_s=delay) for joint, delay in later.items() if delay}
    return replace(
        robot,
        joints=tuple(
            joint if joint.torque_limit is None else replace(joint, torque_limit=rounded(limits[joint.name] or 0.0))
            for joint in robot.joints
        ),
        model=MODEL_FILE,
        controller=replace(robot.controller, delay_s=0.0, per_joint=delays),
        replay=replace(robot.replay, command_shift_s=shift),
        description=f"{robot.description or robot.name}, identified by trueup",
        folder=None,
    )


def isaac_yaml(candidate: Candidate) -> str:
    """Actuator settings in the names of Isaac Lab: stiffness, damping, armature, friction, effort limits.

    All are those of the joint, whatever the gear. `kp` is `stiffness`, the servo's `kv` is `damping`, the joint's
    `damping` is `viscous_friction`, its `frictionloss` is `dynamic_friction`, and `friction` (the static one) adds the
    Stribeck excess; delays are in seconds, since Isaac counts physics steps.
    """
    model = candidate.compile()
    actuators = {}
    for joint in candidate.nominal.robot.joint_names:
        drive = candidate.drive(joint, model)
        dof = int(model.jnt_dofadr[model.joint(joint).id])
        law = friction_of(candidate.spec, joint)
        entry: dict[str, Any] = {
            "stiffness": rounded(drive.kp or 0.0),
            "damping": rounded(drive.kv or 0.0),
            "armature": rounded(model.dof_armature[dof]),
            "friction": rounded(model.dof_frictionloss[dof] + law.stribeck),
            "dynamic_friction": rounded(model.dof_frictionloss[dof]),
            "viscous_friction": rounded(model.dof_damping[dof]),
        }
        if drive.torque_limit is not None:
            entry["effort_limit"] = rounded(drive.torque_limit)
        entry["delay_s"] = rounded(max(0.0, candidate.delay_s[joint]))
        notes = _unknown_to_isaac(drive, law)
        if notes:
            entry["note"] = f"{' and '.join(notes)}: Isaac does not know this; see model.fitted.xml"
        actuators[joint] = entry
    head = "# Actuator settings identified by trueup, in Isaac Lab's names. SI units.\n"
    return head + yaml.safe_dump({"actuators": actuators}, sort_keys=False, allow_unicode=True)


def _unknown_to_isaac(drive: Drive, law: JointFriction) -> list[str]:
    plain = JointFriction()
    notes = []
    if drive.ki is not None:
        notes.append(f"an integral gain of {rounded(drive.ki)}")
    if drive.torque_offset:
        notes.append(f"a constant torque of {rounded(drive.torque_offset)}")
    if replace(law, stribeck=0.0, stribeck_velocity=plain.stribeck_velocity) != plain:
        notes.append("parts of the friction law")
    return notes


def save_samples(found: Identification, path: Path, *, seed: int) -> None:
    """Write samples of the posterior: one array per parameter name, for randomization in training."""
    drawn = found.posterior.draw(_SAMPLES, np.random.default_rng(seed))
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **drawn)
