"""Topics of ROS 2 through DDS, without an installation of ROS."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from typing import Any, Generic, TypeVar
from uuid import UUID

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from trueup.errors import ConfigError
from trueup.ros2.messages import TYPE_HASHES, Unreadable
from trueup.ros2.network import Network

Message = TypeVar("Message")

_NS = 1_000_000_000
# A reader keeps this many messages: four seconds of a robot at 1 kHz. ROS keeps five of a sensor, which a loop that is
# late once by 6 ms has lost; how much a reader keeps is its own affair and agrees with every writer.
_KEPT = 4096
# Messages that are Python's at a time: where thousands have had to wait, its memory would grow by all of them at once,
# and stay so.
_AT_A_TIME = 64
# A reliable writer keeps this many commands for readers that have missed some, as ROS does by default: who has missed
# more has no use for the older ones.
_COMMANDS_KEPT = 10
# What a listener has asked for that speaks of other messages under the same name: Cyclone says so by a number of
# its own (24), or by none (0) where it does not know how the other type is made.
ANOTHER_TYPE = "another type"
# DDS's numbers of what a reader may ask for and a writer may not offer (DDS 1.4, 2.2.3).
_POLICIES = {
    0: ANOTHER_TYPE,
    2: "durability",
    4: "deadlines",
    6: "ownership",
    8: "liveliness",
    11: "reliability",
    23: "another encoding",
    24: ANOTHER_TYPE,
}
_DESCRIBING = threading.Lock()
# Once around in a wait, so that signals are seen [s].
_WAIT_S = 0.1
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


def mangled(topic: str) -> str:
    """The DDS name of a topic of ROS 2: `rt` before its full name.

    Args:
        topic: with all namespaces; a leading slash is added where there is none.

    Raises:
        ConfigError: ROS 2 allows no such name.
    """
    full = topic if topic.startswith("/") else f"/{topic}"
    if not _NAME.fullmatch(full):
        raise ConfigError(
            "no name of a topic", got=topic, expected="/name or /namespace/name of letters, digits and underscores"
        )
    return f"rt{full}"


class Inbox(Generic[Message]):
    """A topic that is listened to; what has come is taken from it, in order.

    Attributes:
        topic: its name in ROS 2.
        unreadable: messages whose texts are not UTF-8; they are not given to anybody.
    """

    def __init__(self, participant: DomainParticipant, topic: str, type_: type[Message]) -> None:
        self.topic, self.unreadable = topic, 0
        qos = Qos(
            Policy.Reliability.BestEffort,  # hears reliable writers, too
            Policy.Durability.Volatile,
            Policy.History.KeepLast(_KEPT),
            *_type_hash(type_),
            Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        )
        self._reader = DataReader(participant, _topic(participant, topic, type_), qos=qos)
        self._unread = ReadCondition(self._reader, SampleState.NotRead | ViewState.Any | InstanceState.Any)

    @property
    def condition(self) -> ReadCondition:
        """Something has come."""
        return self._unread

    def take(self, most: int = _KEPT) -> list[Message]:
        """What has come since it was asked last, all of it or so much; writers that came or went are no messages."""
        samples: list[Any] = self._reader.take(N=most)
        self.unreadable += sum(isinstance(sample, Unreadable) for sample in samples)
        return [sample for sample in samples if not isinstance(sample, InvalidSample | Unreadable)]

    def coming(self) -> Iterator[Message]:
        """What has come since it was asked last, and comes meanwhile, taken a few at a time; at some point it ends."""
        for _ in range(_KEPT // _AT_A_TIME):
            messages = self.take(_AT_A_TIME)
            yield from messages
            if len(messages) < _AT_A_TIME:
                return

    @property
    def writers(self) -> int:
        """How many publish there now."""
        return len(self._reader.get_matched_publications())


class Outbox(Generic[Message]):
    """A topic that is published to.

    A reader never holds up whoever sends: the last messages are kept for readers that ask for reliable ones, newer
    messages take the place of older ones, and nobody is waited for.

    Attributes:
        topic: its name in ROS 2.
    """

    def __init__(
        self, participant: DomainParticipant, topic: str, type_: type[Message], *, reliable: bool, kept: int
    ) -> None:
        self.topic = topic
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=0) if reliable else Policy.Reliability.BestEffort,
            Policy.Durability.Volatile,
            Policy.History.KeepLast(kept if reliable else 1),
            *_type_hash(type_),
            Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        )
        offered = _topic(participant, topic, type_)
        self._writer = DataWriter(participant, offered, qos=qos)
        self._participant, self._named = participant, (offered.name, offered.typename)
        self._announced: BuiltinDataReader | None = None  # one that nobody asks would keep all that it was told
        self._others: set[UUID] = set()

    def send(self, message: Message) -> None:
        """Publish."""
        self._writer.write(message)

    @property
    def readers(self) -> int:
        """How many listen there now."""
        return len(self._writer.get_matched_subscriptions())

    @property
    def others(self) -> int:
        """How many others publish messages of this type there now, as far as they have been discovered."""
        if self._announced is None:
            self._announced = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        own = self._participant.guid
        while seen := self._announced.take(N=_AT_A_TIME):
            for writer in seen:
                if not writer.sample_info.valid_data:  # it has left
                    self._others.discard(writer.key)
                elif (writer.topic_name, writer.type_name) == self._named and writer.participant_key != own:
                    self._others.add(writer.key)
        return len(self._others)

    @property
    def refused(self) -> str | None:
        """What a listener has asked for that is not offered, so that it hears nothing; None if nobody has."""
        writer: Any = self._writer  # cyclonedds gives its status no type
        status = writer.get_offered_incompatible_qos_status()
        return _POLICIES.get(status.last_policy_id, "something else") if status.total_count else None


class Node:
    """Someone in a domain of ROS 2, who listens and publishes.

    Args:
        network: where the others are.

    Raises:
        ConfigError: see `Network.join`.
    """

    def __init__(self, network: Network | None = None) -> None:
        self.network = network or Network()
        self._participant = self.network.join()
        self._waiting = WaitSet(self._participant)
        self._watched: list[ReadCondition] = []

    def listen(self, topic: str, type_: type[Message]) -> Inbox[Message]:
        """Subscribe, as to a sensor: best effort, nothing of what came before.

        Raises:
            ConfigError: no name of a topic.
        """
        inbox = Inbox(self._participant, topic, type_)
        self._waiting.attach(inbox.condition)
        self._watched.append(inbox.condition)
        return inbox

    def publish(self, topic: str, type_: type[Message], *, commands: bool = False) -> Outbox[Message]:
        """Offer a topic.

        Args:
            topic: its name.
            type_: of its messages.
            commands: that a robot follows. Its controllers may ask for reliable ones, as those of ros2_control do, and
                they are offered so; listeners that do not ask hear them, too. Joint states are as the network says.

        Raises:
            ConfigError: no name of a topic.
        """
        reliable, kept = commands or self.network.reliable, _COMMANDS_KEPT if commands else _KEPT
        return Outbox(self._participant, topic, type_, reliable=reliable, kept=kept)

    def wait(self, seconds: float = _WAIT_S) -> bool:
        """Until something has come to one of the inboxes, at most so long [s]; whether it has."""
        return bool(self._waiting.wait(max(0, round(seconds * _NS))))

    def close(self) -> None:
        """Leave the domain; others see it at once."""
        for condition in self._watched:
            self._waiting.detach(condition)
        self._watched.clear()
        participant: Any = self._participant
        participant._delete(participant._ref)  # noqa: SLF001 - its finalizer comes too late, when someone still holds it

    def __enter__(self) -> Node:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave."""
        self.close()


def _type_hash(type_: type[Any]) -> list[Policy.Userdata]:
    """The hash of a type, as rmw_dds_common's `encode_type_hash_for_user_data_qos` writes it."""
    found = TYPE_HASHES.get(type_.__idl_typename__)
    return [] if found is None else [Policy.Userdata(f"typehash={found};".encode())]


def _topic(participant: DomainParticipant, name: str, type_: type[Any]) -> Topic[Any]:
    # Cyclone describes a type at its first use, and takes it for described before it is: threads have to take turns.
    with _DESCRIBING:
        return Topic(participant, mangled(name), type_)
