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
    form: str = "joint_state",
    out: Path | None = None,
    overwrite: bool = False,
    stop: threading.Event | None = None,
    seconds: float | None = None,
    on_open: Callable[[BridgeTopics, bool], None] = lambda *_: None,
    on_progress: Callable[[BridgeReport], None] = lambda _: None,
    on_warning: Callable[[str, str], None] = lambda *_: None,
) -> Bridged:
    """Let a network answer messages until it is stopped. What it corrects, states or commands, is in its card.

    Args:
        folder: of the network.
        topics: names; those of the robot's side if None.
        network: domain and reach.
        message_hz: messages per second [Hz]; the network's rate if None.
        robot: whose limits no corrected command leaves; needed for commands, and for modular networks.
        payload_kg: what it carries [kg], for compensations that read it.
        form: of corrected commands, `joint_state` or `array`.
        out: folder for `bridge.json`, counts and histograms.
        overwrite: replace one that is there.
        stop: ends it.
        seconds: ends it after so long [s].
        on_open: told when all topics are open: their names, and whether it is a compensation.
        on_progress: told once per second.
        on_warning: told once of each kind of listener that hears nothing, and that nobody listens to commands: what is
            wrong, and what to do.

    Raises:
        OutputExists: `bridge.json` is there.
        ConfigError: topics, rates or a robot that do not fit the network.
        NameMismatch: the robot has other joints than the network.
        DataError: the network cannot be run.
        MissingSignal: the simulator publishes too little.
    """
    from trueup.deploy import Compensator, Network, Stream
    from trueup.deploy.compensator import calls_per_step
    from trueup.ros2 import Augmented, Compensated, JointState, Node, run_bridge
    from trueup.ros2.answers import signals_read
    from trueup.ros2.listeners import Listeners
    from trueup.ros2.robot import FORMS

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
    if payload_kg is not None and not any(item.series == "condition" for item in card.inputs):
        raise ConfigError(
            f"model {card.name!r} reads no payload", got=f"{payload_kg:g} kg", hint="Leave --payload-kg out."
        )
    rate_hz = card.rate_hz if message_hz is None else message_hz
    stream = Stream(opened, rate_hz=rate_hz / calls_per_step(card, rate_hz), joints=joints)
    beside: list[tuple[str, Callable[[Any], None]]] = []
    answer: Augmented | Compensated
    if compensation:
        if robot is None:
            raise ConfigError(
                f"model {card.name!r} corrects commands, and the robot's limits are not known", hint="Give --robot."
            )
        topics = _named(topics, publish="/joint_commands", commands="/joint_targets")
        compensator = Compensator(stream, limits=position_limits(robot), loop_hz=message_hz, payload_kg=payload_kg)
        answer = Compensated(compensator, form=FORMS[form])
        inbox_topic, beside = topics.commands, [(topics.states, answer.states.hear)]
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
            beside.append((topic, heard.hear))
    if topics.publish in {inbox_topic, *(topic for topic, _ in beside)}:
        raise ConfigError("a bridge would answer itself", got=topics.publish, hint="Publish to another topic.")
    with Node(network) as node:
        inbox = node.listen(inbox_topic, JointState)
        others = [(node.listen(topic, JointState), hear) for topic, hear in beside]
        type_ = FORMS[form] if compensation else JointState
        outbox: Outbox[Any] = node.publish(topics.publish, type_, commands=compensation)
        listeners = Listeners(outbox, commands=compensation, tell=on_warning)
        on_open(topics, compensation)

        def progress(report: BridgeReport) -> None:
            listeners.look(report.seconds)
            on_progress(report)

        report = run_bridge(
            node, inbox, outbox, answer, beside=others, stop=stop, seconds=seconds, on_progress=progress
        )
    if file is not None:
        content = {"model": card.name, "rate_hz": card.rate_hz, "message_hz": rate_hz, "topics": vars(topics)}
        write_json(file, {"schema": _SCHEMA, **content, **report.to_json()})
    return Bridged(card, topics, report, compensation, file)


def _named(topics: BridgeTopics, **usual: str) -> BridgeTopics:
    """The topics, with the usual names where none were given."""
    return BridgeTopics(**{name: getattr(topics, name) or usual.get(name, "") for name in vars(topics)})
