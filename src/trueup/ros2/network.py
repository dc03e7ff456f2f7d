"""Where the other nodes of ROS 2 are, and the way to them through DDS."""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant

from trueup.errors import ConfigError

# Domains of ROS 2 beyond this one have ports that an operating system gives away (DDSI-RTPS, 9.6.1.1).
_LAST_DOMAIN = 232
# Announcements of others fill Cyclone's buffer for what it receives from its beginning to its end, and each page of it
# is memory once it was written to: with its own 1 MiB a process grows by that much within an hour or two, and falls
# back, again and again.
_SIZES = "<Sizing><ReceiveBufferSize>256 kB</ReceiveBufferSize></Sizing>"
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
        localhost: this computer only, over `lo`; whether `ROS_LOCALHOST_ONLY` or `ROS_AUTOMATIC_DISCOVERY_RANGE` asks
            for that, if None. Where `CYCLONEDDS_URI` is set, its settings count, and this must not be asked for.
        reliable: joint states that are published are offered again to readers that ask for it, and kept for them
            meanwhile; without, as of sensors in ROS 2, a message is sent once. Commands are always reliable.

    Raises:
        ConfigError: there is no such domain, two settings contradict each other, or the environment asks for what there
            is not here.
    """

    domain: int | None = None
    localhost: bool | None = None
    reliable: bool = False

    def __post_init__(self) -> None:
        """Refuse domains that are none, and wishes that would not come true."""
        if not 0 <= self.number <= _LAST_DOMAIN:
            raise ConfigError("a domain of ROS 2", got=self.number, expected=f"0 to {_LAST_DOMAIN}")
        if os.environ.get("CYCLONEDDS_URI"):
            if self.localhost:
                raise ConfigError(
                    "this computer only, and CYCLONEDDS_URI",
                    got="both",
                    hint="Unset CYCLONEDDS_URI, or name the interface lo there.",
                )
        elif self.localhost is None:
            _check_environment()

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
        asked |= _range() == "LOCALHOST"
        return asked and not os.environ.get("CYCLONEDDS_URI")

    def join(self) -> DomainParticipant:
        """Be in the domain.

        Raises:
            ConfigError: this process has been in it with another reach, or DDS lets nobody in: settings that are none,
                an interface that is not there, too many programs on this computer.
        """
        number, local = self.number, self.local
        try:
            with _lock:
                if number not in _domains:
                    _domains[number] = (local, _domain(number, local=local))
            if _domains[number][0] != local:
                raise ConfigError(
                    f"domain {number} was begun in this process with another reach", got=f"localhost {local}"
                )
            return DomainParticipant(number)
        except DDSException as error:
            settings = os.environ.get("CYCLONEDDS_URI")
            raise ConfigError(
                f"DDS lets nobody into domain {number}",
                got=f"{error}{f' CYCLONEDDS_URI is {settings}' if settings else ''}",
                hint="Look at what it has said above, at CYCLONEDDS_URI and the interfaces there, and whether too many "
                "programs on this computer are in the domain.",
            ) from error


def _range() -> str:
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()


def _check_environment() -> None:
    hint = "Give --localhost or --no-localhost, or name interfaces and peers in CYCLONEDDS_URI."
    if peers := os.environ.get("ROS_STATIC_PEERS"):
        raise ConfigError("ROS_STATIC_PEERS is not followed here", got=peers, hint=hint)
    if _range() == "OFF":
        raise ConfigError("ROS_AUTOMATIC_DISCOVERY_RANGE=OFF lets nobody be found", hint=hint)


def _domain(number: int, *, local: bool) -> Domain | None:
    """The domain with our settings; None where it has those of others."""
    if not local and os.environ.get("CYCLONEDDS_URI"):
        return None
    own = f"{_LOCALHOST if local else ''}{_SIZES}"
    try:
        return Domain(number, f'<CycloneDDS><Domain Id="{number}">{own}</Domain></CycloneDDS>')
    except DDSException as error:
        if local or error.code != DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
            raise
        return None  # whoever else speaks DDS in this process is in the domain already
