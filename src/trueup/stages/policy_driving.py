"""Drive virtual hardware by a policy, in its control loop and within limits, and keep what was done as a dataset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.policy_card import PolicyCard
from trueup.core.provenance import provenance
from trueup.core.sole_writer import writes_alone
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.record.limits import limits_of, stated_rates
from trueup.robots import RobotSpec, find_model

if TYPE_CHECKING:
    import mujoco

    from trueup.deploy.guard import GuardSettings
    from trueup.deploy.policy_loop import PolicyRun

Corner = tuple[float, float, float]
# Goals are others than those on which `judge_policies` judges with the same seed: a simulator that was identified from
# driving to them may not be tested on them.
_GOALS = 23
# They take turns: what was driven can be identified from.
_SPLITS = ("train", "train", "train", "val", "test")


def guard_settings(
    card: PolicyCard,
    robot: RobotSpec,
    model: mujoco.MjModel,
    *,
    workspace_m: tuple[Corner, Corner] | None = None,
    torque_rate: float | None = None,
    offset_nm: Float64[np.ndarray, "J"] | None = None,
) -> GuardSettings:
    """Limits that policy, description and model know of.

    Args:
        card: of the policy, with its largest torques.
        robot: its description, with limits of positions and torques.
        model: compiled, with the numerics `velocity_limit` and `torque_rate_limit`.
        workspace_m: lowest and highest x, y, z of the end of the arm [m]; no limit if None.
        torque_rate: fastest change of a torque [Nm/s]; the model's if None.
        offset_nm: what is added to the policy's torques, (J,) [Nm]: they may be larger by that, as where it was judged.

    Raises:
        ConfigError: a limit is not known.
    """
    from trueup.deploy.guard import GuardSettings

    names = robot.joint_names
    limits = limits_of(robot, model, acceleration=dict.fromkeys(names, 1.0))
    rates = stated_rates(model, [model.joint(row).name for row in range(model.njnt)], "torque_rate")
    if torque_rate is not None:
        rates = dict.fromkeys(names, torque_rate)
    if missing := [name for name in names if name not in rates]:
        raise ConfigError(
            f"joints {missing} have no limit of how fast a torque changes",
            hint="Give --torque-rate, or the numeric torque_rate_limit in the MJCF.",
        )
    most = np.array(card.torque_nm) + (0.0 if offset_nm is None else np.abs(offset_nm))
    torque = [min(own, joint.torque_limit or own) for own, joint in zip(most.tolist(), robot.joints, strict=True)]
    settings = GuardSettings(
        tuple(torque),
        tuple(rates[name] for name in names),
        tuple(limits.low.tolist()),
        tuple(limits.high.tolist()),
        tuple(limits.velocity.tolist()),
    )
    return settings if workspace_m is None else replace(settings, workspace_m=workspace_m)


@writes_alone()
def drive(
    folder: Path | str,
    robot: RobotSpec,
    goals: Float[np.ndarray, "G 3"] | int,
    *,
    unit: int = 1,
    payload_kg: float = 0.0,
    seconds: float = 4.0,
    rate_hz: float = 1000.0,
    real_time: bool = False,
    workspace_m: tuple[Corner, Corner] | None = None,
    torque_rate: float | None = None,
    late_s: float = 0.02,
    model: Path | None = None,
    seed: int = 0,
    out: Path | None = None,
    overwrite: bool = False,
    on_run: Callable[[PolicyRun, int], None] = lambda *_: None,
) -> tuple[PolicyRun, ...]:
    """Go for goals, each from home, on an individual of the virtual hardware that takes torques.

    After a run that had to be stopped no other begins.

    Args:
        folder: of the policy.
        robot: its description.
        goals: places [m], or how many are drawn.
        unit: individual of the virtual hardware.
        payload_kg: what it carries [kg].
        seconds: for each goal [s].
        rate_hz: of the control loop [Hz].
        real_time: the robot takes as long as a real one.
        workspace_m: see `guard_settings`.
        torque_rate: likewise.
        late_s: in real time, a tick that is so much too late stops the arm [s].
        model: MJCF or URDF; looked for in the package if None.
        seed: of goals, noise and jitter.
        out: a dataset of what was measured and sent, an episode for each goal.
        overwrite: replace what is in `out`.
        on_run: told after each run what it did, and how many there are to be.

    Raises:
        OutputExists: `out` is there.
        ConfigError: a goal out of reach, a limit that nobody knows, or rates that do not fit.
        NameMismatch: the policy is of another robot.
        DataError: a file of the policy is broken.
    """
    from trueup.deploy.policy import Policy
    from trueup.deploy.policy_loop import DONE, PolicyLoop
    from trueup.lab import LabSpec, VirtualRobot, draw_truth
    from trueup.lab.spec import Controller
    from trueup.policy.config import task_of
    from trueup.policy.reaching import home_of
    from trueup.policy.thesis_friction import OFFSET
    from trueup.policy.workspace import Chain, Workspace
    from trueup.sim import MujocoSimulator

    if robot.controller.signal != "torque":
        raise ConfigError(f"robot {robot.name!r} takes no torques", got=robot.controller.kind, expected="torque")
    if not 0 < seconds < np.inf:
        raise ConfigError("a run needs some seconds", got=seconds)
    card = PolicyCard.load(Path(folder))
    policy = Policy.load(folder, joints=robot.joint_names, rate_hz=card.rate_hz)
    path = find_model(robot, given=model)
    compiled = MujocoSimulator.from_robot(robot, path).model
    home, asked = home_of(compiled, robot.joint_names), task_of(card)
    task = asked.reach
    space = Workspace(
        Chain(compiled, robot.joint_names, card.site),
        home,
        nearest_m=task.nearest_m,
        farthest_m=task.farthest_m,
        lowest_m=task.lowest_m,
    )
    places = (
        space.draw(np.random.default_rng([seed, _GOALS]), goals) if isinstance(goals, int) else np.asarray(goals, float)
    )
    for place in places:
        space.check(place)
        low, high = workspace_m or ((-np.inf,) * 3, (np.inf,) * 3)
        if not ((place > low) & (place < high)).all():
            raise ConfigError("a goal outside of the workspace", got=place.round(3).tolist(), expected=[low, high])
    offset = np.array(OFFSET) if asked.friction == "thesis" else None
    settings = guard_settings(card, robot, compiled, workspace_m=workspace_m, torque_rate=torque_rate, offset_nm=offset)
    settings = replace(settings, late_s=late_s)
    lab = VirtualRobot(
        draw_truth(replace(LabSpec(), controller=Controller(kind="torque")), unit=unit),
        payload_kg=payload_kg,
        real_time=real_time,
    )
    loop = PolicyLoop(lab, policy, settings, rate_hz=rate_hz, real_time=real_time, offset_nm=offset)
    runs: list[PolicyRun] = []
    info = DatasetInfo(
        robot=robot.name,
        licence="Apache-2.0",
        provenance=provenance(config={"policy": card.provenance.get("asked", ""), "unit": unit}, seed=seed),
    )
    writer = None if out is None else DatasetWriter.create(out, info, overwrite=overwrite)
    try:
        for number, place in enumerate(places):
            lab.restart(position=home, seed=(seed, number))
            runs.append(loop.run(place, seconds))
            if writer is not None:
                writer.append(_episode(runs[-1], robot, number, f"lab-{unit}", payload_kg))
            on_run(runs[-1], len(places))
            if runs[-1].reason != DONE:
                break
    finally:
        if writer is not None:
            writer.close()
    return tuple(runs)


def _episode(run: PolicyRun, robot: RobotSpec, number: int, unit: str, payload_kg: float) -> Episode:
    from trueup.deploy.policy_loop import DONE

    names = robot.joint_names
    units = {"position": "rad", "velocity": "rad/s"}
    measured = TimeSeries(
        run.time_s, names, {"position": run.position, "velocity": run.velocity}, same_units(units, names)
    )
    command = TimeSeries(run.time_s, names, {"torque": run.sent}, same_units({"torque": "Nm"}, names))
    flags: Sequence[Flag] = ()
    if run.reason != DONE:
        flags = (Flag("stopped", detail=run.reason, start_s=float(run.time_s[run.braked_from - 1])),)
    meta = EpisodeMeta(
        f"goal/{number:05d}",
        robot=robot.name,
        unit=unit,
        payload_kg=payload_kg,
        split=_SPLITS[number % len(_SPLITS)],
        source=f"policy/{number:05d}",  # each goes somewhere else: none repeats another
    )
    return Episode(meta, measured, command).with_flags(tuple(flags))
