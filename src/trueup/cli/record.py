"""`trueup record`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trueup.cli import options
from trueup.cli.console import note, out, problem, track
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.stages.recording import RecordSummary

_SHOWN = 10


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("record")(record)


def record(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder of the dataset.")],
    robot: options.Robot = "panda",
    hardware: Annotated[str, typer.Option("--hardware", help="lab, an engine (mujoco, dart), or ros2.")] = "lab",
    unit: Annotated[
        list[int] | None,
        typer.Option("--unit", min=0, help="Which individual of the lab's robots, 1 if not given; several take turns."),
    ] = None,
    plan: Annotated[
        str,
        typer.Option(
            "--plan",
            help="A shipped set, a YAML that describes motions, the folder of a plan set, or files of joint angles.",
        ),
    ] = "paper",
    plan_hz: Annotated[float, typer.Option("--plan-hz", help="Rows per second of files of joint angles.")] = 50.0,
    scale: Annotated[float, typer.Option("--scale", help="Share of the motions of each group.")] = 1.0,
    payload_kg: Annotated[
        list[float] | None,
        typer.Option("--payload-kg", help="Payload of the lab's robot [kg], 0 if not given; repeatable."),
    ] = None,
    lab: Annotated[
        str | None,
        typer.Option("--lab", help="Sizes of the lab's effects: xm430 (servos), upper_body, or a YAML file."),
    ] = None,
    base: Annotated[
        list[str] | None,
        typer.Option("--base", help="What the lab's robot stands on: fixed, stance, squat, gait; several take turns."),
    ] = None,
    network: Annotated[
        Path | None,
        typer.Option(
            "--network", help="Network for the robot itself (docs/compensation.md) that corrects its commands."
        ),
    ] = None,
    faults: Annotated[
        float,
        typer.Option("--faults", help="Share of the motions in which the lab's robot stops, stalls or drops out."),
    ] = 0.0,
    truth: Annotated[
        Path | None, typer.Option("--truth", help="File for what is true of the lab's robot; not inside --out.")
    ] = None,
    control_hz: Annotated[float, typer.Option("--control-hz", help="Commands per second.")] = 1000.0,
    record_hz: Annotated[float, typer.Option("--record-hz", help="Rows per second of the recording.")] = 100.0,
    tolerance_rad: Annotated[
        float, typer.Option("--tolerance-rad", help="How far a joint may rest from where it should be [rad or m].")
    ] = 0.05,
    path_tolerance_rad: Annotated[
        float, typer.Option("--path-tolerance-rad", help="How far a joint may be from its command on its way.")
    ] = 0.2,
    servo_hz: Annotated[
        float | None,
        typer.Option(
            "--servo-hz", help="Of a robot that takes torques: natural frequency of the springs that lead it."
        ),
    ] = None,
    states: Annotated[str, typer.Option("--states", help="With ros2: topic of its joint states.")] = "/joint_states",
    commands: Annotated[
        str, typer.Option("--commands", help="With ros2: topic that it listens to.")
    ] = "/joint_commands",
    form: options.Form = "joint_state",
    domain: options.Domain = None,
    localhost: options.Localhost = None,
    reliable: options.Reliable = False,
    model: Annotated[
        Path | None, typer.Option("--model", help="MJCF or URDF; what robot.yaml names if not given.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Seed of all draws; that of the plans if not given.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, help="Processes; the number of cores if not given.")
    ] = None,
    overwrite: options.Overwrite = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on even with a complete dataset: what failed is tried again.")
    ] = False,
) -> int:
    """Plan motions, execute them on a robot and record them.

    The same command goes on after an interruption.
    """
    import itertools
    import os

    from trueup.lab import load_lab
    from trueup.record import PlanSet, RecordSettings
    from trueup.robots import find_model, load_robot
    from trueup.stages import plans_named
    from trueup.stages.recording import record as run
    from trueup.stages.rigs import HARDWARE, CompensatedRig, Rig, make_rig

    if hardware not in (*HARDWARE, "ros2"):
        raise ConfigError(f"there is no hardware {hardware!r}", available=(*HARDWARE, "ros2"))
    spec = load_robot(robot)
    plans = plans_named(plan, scale=scale, seed=seed, robot=spec, model=model, rate_hz=plan_hz)
    if seed is None:  # a stored plan set says nothing of the days on which it is executed
        seed = 0 if isinstance(plans, PlanSet) else plans.seed
    rigs: list[Rig]
    if hardware == "ros2":
        of_the_lab = {"--lab": lab, "--base": base, "--faults": faults, "--truth": truth, "--servo-hz": servo_hz}
        if given := [name for name, value in of_the_lab.items() if value]:
            raise ConfigError("a robot behind ROS 2 has none of the lab's options", got=given, hint="Leave them out.")
        if unit and len(unit) > 1:
            raise ConfigError(
                "one robot behind ROS 2 is recorded at a time",
                got=f"--unit {' --unit '.join(map(str, unit))}",
                hint="Record into several datasets.",
            )
        from trueup.ros2 import Network, RobotTopics
        from trueup.stages.ros2_rig import Ros2Rig

        where = RobotTopics(states, commands, form, network=Network(domain, localhost, reliable))
        rigs = [Ros2Rig(spec.joint_names, where, unit[0] if unit else 1)]
    else:
        rigs = [
            make_rig(
                hardware,
                spec,
                find_model(spec, given=model),
                unit=one,
                seed=seed,
                lab=load_lab(lab, robot=robot) if lab else None,
                fault_share=faults,
                control_hz=max(control_hz, record_hz),
                base=under,
                servo_hz=servo_hz,
            )
            for one, under in itertools.product(unit or (1,), base or (None,))
        ]
    if network is not None:
        rigs = [CompensatedRig.of(rig, spec, network, control_hz=control_hz) for rig in rigs]
    summary = run(
        out_dir,
        spec,
        rigs,
        plans,
        payloads_kg=tuple(payload_kg or (0.0,)),
        settings=RecordSettings(
            control_hz=control_hz,
            record_hz=record_hz,
            tolerance_rad=tolerance_rad,
            path_tolerance_rad=path_tolerance_rad,
        ),
        model=model,
        jobs=jobs or os.cpu_count() or 1,
        overwrite=overwrite,
        resume=resume,
        truth=truth,
        track=track,
    )
    show(summary)
    return 2 if summary.failed else 0


def show(summary: RecordSummary) -> None:
    """What was recorded, what was not, and what is suspicious."""
    for name, why in list(summary.skipped.items())[:_SHOWN]:
        note(f"{name} was not planned: {why}")
    _more(len(summary.skipped))
    for name, kinds in list(summary.flagged.items())[:_SHOWN]:
        note(f"{name}: warning: {', '.join(kinds)}")
    _more(len(summary.flagged))
    for name, error in list(summary.failed.items())[:_SHOWN]:
        problem(f"{name} was not recorded: {error.summary}", error.hint)
    _more(len(summary.failed))
    kept = f", {summary.kept} were there" if summary.kept else ""
    failed = f", {len(summary.failed)} failed" if summary.failed else ""
    out.print(
        f"{summary.recorded} motions recorded{kept}{failed} in {summary.seconds:.1f} s -> {summary.path}", markup=False
    )


def _more(count: int) -> None:
    if count > _SHOWN:
        note(f"and {count - _SHOWN} more of this kind")
