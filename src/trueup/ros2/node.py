"""Topics of ROS 2 through DDS, without an installation of ROS."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from trueup.errors import ConfigError

Message = TypeVar("Message")

_NS = 1_000_000_000
# Domains of ROS 2 beyond this one have ports that an operating system gives away (DDSI-RTPS, 9.6.1.1).
_LAST_DOMAIN = 232
# A reader keeps this many messages: four seconds of a robot at 1 kHz. ROS keeps five of a sensor, which a loop that is
# late once by 6 ms has lost; how much a reader keeps is its own affair and agrees with every writer.
_KEPT = 4096
# Messages that are Python's at a time: where thousands have had to wait, its memory would grow by all of them at once,
# and stay so.
_AT_A_TIME = 64
# A reliable writer keeps this many commands for readers that have missed some, as ROS does by default: who has missed
# more has no use for the older ones.
_COMMANDS_KEPT = 10
# DDS's numbers of what a reader may ask for and a writer may not offer (DDS 1.4, 2.2.3).
_POLICIES = {
    2: "durability",
    4: "deadlines",
    6: "ownership",
    8: "liveliness",
    11: "reliability",
    23: "another encoding",
}
# Once around in a wait, so that signals are seen [s].
_WAIT_S = 0.1
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_LOCALHOST = """<General><AllowMulticast>false</AllowMulticast>
<Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
<Peers><Peer address="localhost"/></Peers></Discovery>"""

# Domains are of the whole process, and have their settings once.
_domains: dict[int, tuple[bool, Domain | None]] = {}
_lock = threading.Lock()


@dataclass(frozen=True)
class Network:
    """Where the other nodes are.

    Attributes:
        domain: ROS 2's domain, 0 to 232; `ROS_DOMAIN_ID`, or 0, if None.
        localhost: this computer only, as `ROS_LOCALHOST_ONLY=1`; what the environment says if None. Where
            `CYCLONEDDS_URI` is set, its settings count, and this must not be asked for.
        reliable: joint states that are published are offered again to readers that ask for it, and kept for them
            meanwhile; without, as of sensors in ROS 2, a message is sent once. Commands are always reliable.

    Raises:
        ConfigError: there is no such domain, or two settings contradict each other.
    """

    domain: int | None = None
    localhost: bool | None = None
    reliable: bool = False

    def __post_init__(self) -> None:
        """Refuse domains that are none."""
        if not 0 <= self.number <= _LAST_DOMAIN:
            raise ConfigError("a domain of ROS 2", got=self.number, expected=f"0 to {_LAST_DOMAIN}")
        if self.localhost and os.environ.get("CYCLONEDDS_URI"):
            raise ConfigError(
                "this computer only, and CYCLONEDDS_URI",
                got="both",
                hint="Unset CYCLONEDDS_URI, or name the interface lo there.",
            )

    @property
    def number(self) -> int:
        """The domain's number.

        Raises:
            ConfigError: ROS_DOMAIN_ID is no number.
        """
        if self.domain is not None:
            return self.domain
        said = os.environ.get("ROS_DOMAIN_ID") or "0"
        if not said.isascii() or not said.isdigit():
            raise ConfigError("ROS_DOMAIN_ID is no domain", got=said, expected=f"0 to {_LAST_DOMAIN}")
        return int(said)

    @property
    def local(self) -> bool:
        """Whether only this computer is spoken to."""
        if self.localhost is not None:
            return self.localhost
        asked = os.environ.get("ROS_LOCALHOST_ONLY") == "1"
        asked |= os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        return asked and not os.environ.get("CYCLONEDDS_URI")


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
    """

    def __init__(self, participant: DomainParticipant, topic: str, type_: type[Message]) -> None:
        self.topic = topic
        qos = Qos(
            Policy.Reliability.BestEffort,  # hears reliable writers, too
            Policy.Durability.Volatile,
            Policy.History.KeepLast(_KEPT),
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
        return [sample for sample in samples if not isinstance(sample, InvalidSample)]

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
            Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        )
        self._writer = DataWriter(participant, _topic(participant, topic, type_), qos=qos)

    def send(self, message: Message) -> None:
        """Publish."""
        self._writer.write(message)

    @property
    def readers(self) -> int:
        """How many listen there now."""
        return len(self._writer.get_matched_subscriptions())

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
        ConfigError: this process has been in the domain with another reach.
    """

    def __init__(self, network: Network | None = None) -> None:
        self.network = network or Network()
        number, local = self.network.number, self.network.local
        with _lock:
            if number not in _domains:
                _domains[number] = (local, Domain(number, _settings(number)) if local else None)
        if _domains[number][0] != local:
            raise ConfigError(f"domain {number} was begun in this process with another reach", got=f"localhost {local}")
        self._participant = DomainParticipant(number)
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


def _settings(number: int) -> str:
    return f'<CycloneDDS><Domain Id="{number}">{_LOCALHOST}</Domain></CycloneDDS>'


def _topic(participant: DomainParticipant, name: str, type_: type[Any]) -> Topic[Any]:
    return Topic(participant, mangled(name), type_)
