"""What a fit leaves for others: a patched model, a robot description, actuator settings for Isaac, samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from trueup.core.atomic import replacing, write_text
from trueup.identify.candidate import Candidate
from trueup.identify.drive import Drive
from trueup.identify.identification import Identification
from trueup.identify.uncertainty import rounded
from trueup.robots import JointFriction, JointGains, RobotSpec
from trueup.sim import friction_of

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


def save_model(candidate: Candidate, path: Path) -> None:
    """Write a candidate as MJCF that plain MuJoCo loads.

    What trueup adds for itself (torque sensors, no automatic reset) is taken out again. Meshes are referred to by
    their absolute folder; those that were missing are left out.
    """
    candidate.finish()
    spec = candidate.spec
    for sensor in list(spec.sensors):
        if sensor.name.startswith("trueup."):
            spec.delete(sensor)
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if spec.meshes and spec.meshdir and not Path(spec.meshdir).is_absolute():
        spec.meshdir = str((candidate.nominal.path.parent / spec.meshdir).resolve())
    _leave_room_for_rounding(spec, spec.compile())
    spec.compile()
    write_text(path, spec.to_xml())


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


def robot_yaml(robot: RobotSpec) -> str:
    """A robot description as YAML, without what is default anyway."""
    plain = _without_defaults(robot.to_dict(), RobotSpec(robot.name, robot.joints, robot.model).to_dict())
    joints = [{key: value for key, value in joint.items() if _worth(key, value)} for joint in robot.to_dict()["joints"]]
    controller = {"kind": robot.controller.kind, "command": robot.controller.signal, **plain.pop("controller", {})}
    tree = {
        "schema": robot.schema,
        "name": robot.name,
        "model": robot.model,
        "joints": joints,
        "controller": controller,
    }
    tree |= plain
    return yaml.safe_dump(_lists(tree), sort_keys=False, allow_unicode=True)


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


def _without_defaults(tree: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    kept = {}
    for key, value in tree.items():
        if key in ("joints", "schema", "name", "model") or value == defaults.get(key):
            continue
        if isinstance(value, Mapping) and isinstance(defaults.get(key), Mapping) and defaults[key]:
            value = _without_defaults(value, defaults[key])
        elif isinstance(value, Mapping):
            value = {name: _without_none(own) for name, own in value.items()}
        kept[key] = value
    return kept


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: own for key, own in value.items() if own is not None}
    return value


def _worth(key: str, value: Any) -> bool:
    plain = {"log": "", "sign": 1, "scale": 1.0, "offset": 0.0}
    return value is not None and not (key in plain and value == plain[key])


def _lists(tree: Any) -> Any:
    """Tuples as lists: YAML's safe dumper knows no tuples."""
    if isinstance(tree, Mapping):
        return {str(key): _lists(value) for key, value in tree.items()}
    return [_lists(value) for value in tree] if isinstance(tree, list | tuple) else tree
