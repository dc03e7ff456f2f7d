"""`trueup deploy ros2` and `trueup deploy serve`."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import note, out, problem, status_line, warning

if TYPE_CHECKING:
    from trueup.ros2 import BridgeReport
    from trueup.stages.bridging import Bridged, BridgeTopics

# Bars of a histogram.
_WIDTH = 40


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("ros2")(ros2)
    app.command("serve")(serve)


def ros2(
    network: Annotated[Path, typer.Argument(help="Folder of a network, or zoo:NAME.")],
    states: Annotated[
        str, typer.Option("--states", help="Joint states: the simulator's, or, of a compensation, the robot's.")
    ] = "/joint_states",
    publish: Annotated[
        str | None,
        typer.Option("--publish", help="Where the answers go; STATES_corrected or /joint_commands if not given."),
    ] = None,
    commands: Annotated[
        str | None,
        typer.Option("--commands", help="Targets that a compensation corrects (/joint_targets), or what others read."),
    ] = None,
    measured: Annotated[
        str | None, typer.Option("--measured", help="What the robot's sensors say, for networks that read it.")
    ] = None,
    hz: Annotated[
        float | None, typer.Option("--hz", min=0.1, help="Messages per second; the network's rate if not given.")
    ] = None,
    robot: Annotated[
        str | None, typer.Option("--robot", help="Whose limits no corrected command leaves; for compensations.")
    ] = None,
    payload_kg: Annotated[
        float | None, typer.Option("--payload-kg", min=0.0, help="What it carries [kg], for networks that read it.")
    ] = None,
    direction: Annotated[
        Literal["robot", "simulator"],
        typer.Option("--direction", help="Whose commands a compensation corrects: it must have been trained for that."),
    ] = "robot",
    form: options.Form = "joint_state",
    domain: options.Domain = None,
    localhost: options.Localhost = None,
    reliable: options.Reliable = False,
    priority: options.Priority = None,
    cpu: options.Cpu = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.0, help="Stop after so long; Ctrl-C stops at any time.")
    ] = None,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for bridge.json: counts and histograms.")
    ] = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Correct joint states or commands on topics of ROS 2.

    A simulator's joint states, or a robot's commands, while it runs.

    What the network was trained for decides which of the two it is. No installation of ROS is needed.
    """
    import trueup.zoo
    from trueup.deploy.realtime import RealTimeSettings
    from trueup.robots import load_robot
    from trueup.ros2 import Network
    from trueup.stages.bridging import BridgeTopics, bridge

    folder = trueup.zoo.folder_of(network)
    RealTimeSettings(priority, None if cpu is None else tuple(cpu), lock_memory=priority is not None).apply()
    ended: list[Bridged] = []
    try:
        with _asked_to_stop() as stop, status_line() as line:
            bridge(
                folder,
                topics=BridgeTopics(states, publish or "", commands or "", measured or ""),
                network=Network(domain, localhost, reliable),
                message_hz=hz,
                robot=load_robot(robot) if robot else None,
                payload_kg=payload_kg,
                direction=direction,
                form=form,
                out=out_dir,
                overwrite=overwrite,
                stop=stop,
                seconds=seconds,
                on_open=_opened,
                on_progress=lambda report: line(_progress(report)),
                on_end=ended.append,
                on_warning=warning,
            )
    finally:  # what was counted for hours is shown, whatever becomes of its file
        for done in ended:
            _show(done)
    (done,) = ended
    if done.file is not None:
        out.print(f"counts and histograms: {done.file}", markup=False)
    if not done.report.concerned or not done.report.sent:
        answered = done.topics.commands if done.compensation else done.topics.states
        problem(
            f"nothing of joints {list(done.card.joints)} came on {answered}{_untouched(done.report)}",
            "`ros2 topic echo` shows what is published; --domain and --states say where to listen.",
        )
        return 2
    return 0


def serve(
    robot: options.Robot = "panda",
    hardware: Annotated[str, typer.Option("--hardware", help="lab, or an engine: mujoco, dart.")] = "lab",
    unit: Annotated[int, typer.Option("--unit", min=0, help="Which individual of the lab's robots.")] = 1,
    payload_kg: Annotated[
        float, typer.Option("--payload-kg", min=0.0, help="What the lab's robot carries [kg].")
    ] = 0.0,
    lab: Annotated[
        str | None, typer.Option("--lab", help="Sizes of the lab's effects: xm430, upper_body, or a YAML file.")
    ] = None,
    hz: Annotated[float, typer.Option("--hz", min=0.1, help="Joint states per second.")] = 1000.0,
    states: Annotated[str, typer.Option("--states", help="Topic of its joint states.")] = "/joint_states",
    commands: Annotated[str, typer.Option("--commands", help="Topic that it listens to.")] = "/joint_commands",
    form: options.Form = "joint_state",
    domain: options.Domain = None,
    localhost: options.Localhost = None,
    reliable: options.Reliable = False,
    model: options.Model = None,
    seed: options.Seed = 0,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.0, help="Stop after so long; Ctrl-C stops at any time.")
    ] = None,
) -> int:
    """Put virtual hardware behind topics of ROS 2.

    Or a simulation, to try things out before there is a robot.
    """
    from trueup.lab import load_lab
    from trueup.robots import find_model, load_robot
    from trueup.ros2 import Network, RobotTopics
    from trueup.ros2 import serve as run
    from trueup.stages.rigs import ServoedRig, make_rig

    spec = load_robot(robot)
    rig = make_rig(
        hardware,
        spec,
        find_model(spec, given=model),
        unit=unit,
        seed=seed,
        lab=load_lab(lab, robot=robot) if lab else None,
        control_hz=hz,
    )
    own = (spec.controller.signal,)
    topics = RobotTopics(states, commands, form, signals=own, network=Network(domain, localhost, reliable))
    hardware_of = rig.inner if isinstance(rig, ServoedRig) else rig  # a robot that takes torques is given torques
    device = hardware_of.session(0, payload_kg)
    note(f"{spec.name} on {states}, {hz:g} Hz; it follows {own[0]} on {commands}; Ctrl-C stops")
    with _asked_to_stop() as stop, status_line() as line:
        done = run(
            device,
            topics,
            rate_hz=hz,
            stop=stop,
            seconds=seconds,
            on_progress=lambda served: line(f"{served.published} joint states, {served.commands} commands"),
        )
    out.print(
        f"{done.published} joint states in {done.seconds:.1f} s, {done.late} late; "
        f"{done.commands} commands followed, {done.refused} refused",
        markup=False,
    )
    return 0


@contextmanager
def _asked_to_stop() -> Iterator[threading.Event]:
    """An event that Ctrl-C and the end of a container set, so that topics are left properly and figures are shown."""
    stop = threading.Event()

    def asked(*_: object) -> None:
        if stop.is_set():  # again: what goes on has not looked yet, as while a network is loaded
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, asked) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _opened(topics: BridgeTopics, compensation: bool) -> None:
    way = (
        f"{topics.commands} -> {topics.publish}, by {topics.states}"
        if compensation
        else f"{topics.states} -> {topics.publish}"
    )
    what = "commands are corrected" if compensation else "joint states are corrected"
    note(f"{what}: {way}; Ctrl-C stops")


def _progress(report: BridgeReport) -> str:
    if not report.received:
        return f"waiting for messages, {report.seconds:.0f} s"
    shares = ", ".join(f"{name} {100 * count / report.received:.0f} %" for name, count in report.counts.items())
    shares += "".join(f", {name} in {count}" for name, count in report.reasons.items())
    p99 = report.added.percentile_us(99.0)
    return f"{report.received} messages, {shares}; 99 % answered within {p99:.0f} us"


def _show(done: Bridged) -> None:
    report = done.report
    counts = ", ".join(f"{name} {count}" for name, count in report.counts.items())
    if report.reasons:
        counts += "; " + ", ".join(f"{name} in {count}" for name, count in report.reasons.items())
    out.print(
        f"{report.received} messages in {report.seconds:.1f} s, {report.sent} answered ({counts or 'none'}); "
        f"at most {report.most_waiting} waited",
        markup=False,
    )
    if report.dropped:
        warning(f"{report.dropped} messages were not answered: they had waited for too long, and newer ones were there")
    if report.received:
        out.print(_histogram(report))


def _untouched(report: BridgeReport) -> str:
    """What came instead."""
    if not report.received:
        return ""
    if report.concerned:
        return f" that could be answered; {report.concerned} messages came"
    if not report.others:
        return f"; {report.received} messages said nothing of theirs"
    return f"; {report.received} messages were of other joints, such as {list(report.others)}"


def _histogram(report: BridgeReport) -> Table:
    """How long answers took, in doublings."""
    added = report.added
    title = (
        f"from message to answer: 50 % within {added.percentile_us(50.0):.0f} us, "
        f"99 % {added.percentile_us(99.0):.0f}, all {added.max_us:.0f}"
    )
    table = Table(title=title)
    table.add_column("up to [us]", justify="right")
    table.add_column("messages", justify="right")
    table.add_column("")
    bins: dict[int, int] = {}
    for _, to_us, count in added.to_json()["bins"]:
        doubling = max(int(to_us), 1).bit_length()
        bins[doubling] = bins.get(doubling, 0) + count
    most = max(bins.values())
    for doubling, count in sorted(bins.items()):
        table.add_row(str(2**doubling), str(count), "█" * max(1, round(_WIDTH * count / most)))
    return table
