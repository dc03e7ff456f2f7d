"""A network between topics of ROS 2: what a simulator says is corrected, or what a robot is commanded."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueup.core.atomic import write_json
from trueup.core.model_card import ModelCard
from trueup.core.sole_writer import writes_alone
from trueup.errors import ConfigError, OutputExists
from trueup.stages.rigs import position_limits

if TYPE_CHECKING:
    from trueup.robots import RobotSpec
    from trueup.ros2 import BridgeReport, Network
    from trueup.ros2.answers import Heard
    from trueup.ros2.node import Outbox

BRIDGE_NAME = "bridge.json"
_SCHEMA = "trueup.bridge/1"


@dataclass(frozen=True)
class BridgeTopics:
    """Names of topics; each is of `sensor_msgs/JointState` unless it is said otherwise.

    Attributes:
        states: of a simulator that is corrected; in compensation, what the robot's sensors say.
        publish: corrected joint states; in compensation, corrected commands, in the form that is asked for.
        commands: in compensation, the targets; else what is commanded, for networks that read it.
        measured: what the robot's sensors say, for networks that read it.
    """

    states: str = "/joint_states"
    publish: str = ""
    commands: str = ""
    measured: str = ""


@dataclass(frozen=True)
class Bridged:
    """What a bridge did.

    Attributes:
        card: of its network.
        topics: with their names as they were.
        report: counts and times.
        compensation: whether commands were corrected.
        file: where that is written; None if nowhere.
    """

    card: ModelCard
    topics: BridgeTopics
    report: BridgeReport
    compensation: bool
    file: Path | None = field(default=None)


@writes_alone()
def bridge(
    folder: Path,
    *,
    topics: BridgeTopics | None = None,
    network: Network | None = None,
    message_hz: float | None = None,
    robot: RobotSpec | None = None,
    payload_kg: float | None = None,
    direction: str = "robot",
    form: str = "joint_state",
    out: Path | None = None,
    overwrite: bool = False,
    stop: threading.Event | None = None,
    seconds: float | None = None,
    on_open: Callable[[BridgeTopics, bool], None] = lambda *_: None,
    on_progress: Callable[[BridgeReport], None] = lambda _: None,
    on_end: Callable[[Bridged], None] = lambda _: None,
    on_warning: Callable[[str, str], None] = lambda *_: None,
) -> Bridged:
    """Let a network answer messages until it is stopped. What it corrects, states or commands, is in its card.

    Args:
        folder: of the network.
        topics: names; those of the robot's side if None.
        network: domain and reach.
        message_hz: messages per second [Hz]; the network's rate if None.
        robot: whose limits no corrected command leaves; needed for commands, and for modular networks.
        payload_kg: what it carries [kg], for networks that read it.
        direction: whose commands a compensation corrects, `robot` or `simulator`: what it was trained for.
        form: of corrected commands, `joint_state` or `array`.
        out: folder for `bridge.json`, counts and histograms.
        overwrite: replace one that is there.
        stop: ends it.
        seconds: ends it after so long [s].
        on_open: told when all topics are open: their names, and whether it is a compensation.
        on_progress: told once per second.
        on_end: told what was done, before that is written.
        on_warning: told once of each kind of listener that hears nothing, that nobody listens to commands, that
            somebody else publishes, too, that what comes is of other joints, and why nothing is corrected: what is
            wrong, and what to do.

    Raises:
        OutputExists: `bridge.json` is there.
        ConfigError: topics, rates, a robot or a direction that do not fit the network, or a payload that it reads and
            nobody has said.
        NameMismatch: the robot has other joints than the network.
        DataError: the network cannot be run.
        MissingSignal: the simulator publishes too little.
    """
    from trueup.deploy import Compensator, Network, Stream
    from trueup.deploy.compensated_robot import check_direction
    from trueup.deploy.compensator import calls_per_step
    from trueup.ros2 import Augmented, Compensated, JointState, Node, run_bridge
    from trueup.ros2.answers import signals_read
    from trueup.ros2.listeners import Listeners
    from trueup.ros2.robot import FORMS
    from trueup.ros2.speakers import Speakers

    topics = topics or BridgeTopics()
    file = None if out is None else Path(out) / BRIDGE_NAME
    if file is not None and file.exists() and not overwrite:
        raise OutputExists(f"{file} is there", hint="Give --overwrite, or another folder.")
    if form not in FORMS:
        raise ConfigError(f"there is no form of commands {form!r}", available=FORMS)
    opened = Network.load(folder)
    joints = robot.joint_names if robot else opened.card.joints
    opened = opened.of_joints(joints)
    card = opened.card
    compensation = all(output.series == "command" for output in card.outputs)
    _check_payload(card, payload_kg)
    rate_hz = card.rate_hz if message_hz is None else message_hz
    stream = Stream(opened, rate_hz=rate_hz / calls_per_step(card, rate_hz), joints=joints)
    beside: list[tuple[str, Heard]] = []
    answer: Augmented | Compensated
    if compensation:
        if robot is None:
            raise ConfigError(
                f"model {card.name!r} corrects commands, and the robot's limits are not known", hint="Give --robot."
            )
        topics = _named(topics, publish="/joint_commands", commands="/joint_targets")
        compensator = Compensator(stream, limits=position_limits(robot), loop_hz=message_hz, payload_kg=payload_kg)
        check_direction(compensator, direction)
        answer = Compensated(compensator, form=FORMS[form])
        inbox_topic, beside = topics.commands, [(topics.states, answer.states)]
    else:
        if payload_kg is not None:
            stream.under(payload=payload_kg)
        topics = _named(topics, publish=f"{topics.states}_corrected")
        answer = Augmented(stream, message_hz=message_hz)
        inbox_topic = topics.states
        for series, topic, heard in (
            ("command", topics.commands, answer.command),
            ("measured", topics.measured, answer.measured),
        ):
            if not (reads := signals_read(stream, series)):
                continue
            if not topic:
                option = "--commands" if series == "command" else "--measured"
                raise ConfigError(
                    f"model {card.name!r} reads {series} {', '.join(reads)}", hint=f"Name its topic by {option}."
                )
            beside.append((topic, heard))
    if topics.publish in {inbox_topic, *(topic for topic, _ in beside)}:
        raise ConfigError("a bridge would answer itself", got=topics.publish, hint="Publish to another topic.")
    with Node(network) as node:
        inbox = node.listen(inbox_topic, JointState)
        others = [(node.listen(topic, JointState), heard) for topic, heard in beside]
        type_ = FORMS[form] if compensation else JointState
        outbox: Outbox[Any] = node.publish(topics.publish, type_, commands=compensation)
        listeners = Listeners(outbox, commands=compensation, tell=on_warning)
        speakers = Speakers(inbox, others, answer, stream, message_hz=rate_hz, tell=on_warning)
        on_open(topics, compensation)

        def progress(report: BridgeReport) -> None:
            listeners.look(report.seconds)
            speakers.look(report)
            on_progress(report)

        hearing = [(other, heard.hear) for other, heard in others]
        report = run_bridge(
            node, inbox, outbox, answer, beside=hearing, stop=stop, seconds=seconds, on_progress=progress
        )
    done = Bridged(card, topics, report, compensation, file)
    on_end(done)
    if file is not None:
        content = {"model": card.name, "rate_hz": card.rate_hz, "message_hz": rate_hz, "topics": vars(topics)}
        heard_beside = {topic: {"heard": heard.heard, "of others": heard.ignored} for topic, heard in beside}
        write_json(file, {"schema": _SCHEMA, **content, **report.to_json(), "beside": heard_beside})
    return done


def _named(topics: BridgeTopics, **usual: str) -> BridgeTopics:
    """The topics, with the usual names where none were given."""
    return BridgeTopics(**{name: getattr(topics, name) or usual.get(name, "") for name in vars(topics)})


def _check_payload(card: ModelCard, payload_kg: float | None) -> None:
    """A network knows what the robot carries if, and only if, it reads it: else all that it says is NaN, or nothing."""
    reads = any(item.series == "condition" for item in card.inputs)
    if reads and payload_kg is None:
        raise ConfigError(
            f"model {card.name!r} reads what the robot carries",
            hint="Give it by --payload-kg; 0 if it carries nothing.",
        )
    if not reads and payload_kg is not None:
        raise ConfigError(
            f"model {card.name!r} reads no payload", got=f"{payload_kg:g} kg", hint="Leave --payload-kg out."
        )
