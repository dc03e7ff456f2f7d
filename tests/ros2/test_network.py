"""Who is let into a domain, and what is said to whoever is not."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import pytest
from cyclonedds.idl import IdlStruct
from cyclonedds.idl._xt_builder import XTBuilder
from cyclonedds.idl.types import int32

from ros2.ros2_cases import fresh_domain, wait_for
from trueup.errors import ConfigError
from trueup.ros2 import JointState, Network, Node

NO_SUCH = '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="nosuch0"/></Interfaces></General></Domain></CycloneDDS>'


@pytest.fixture
def unsaid(monkeypatch):
    """An environment that says nothing of ROS."""
    names = ("ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")
    for name in (*names, "CYCLONEDDS_URI"):
        monkeypatch.delenv(name, raising=False)
    return monkeypatch


@pytest.mark.parametrize("settings", [NO_SUCH, "file:///nowhere/dds.xml", "<CycloneDDS><Nothing/></CycloneDDS>"])
def test_what_dds_refuses_is_a_wrong_setting(unsaid, settings):
    number = fresh_domain()
    unsaid.setenv("CYCLONEDDS_URI", settings)
    with pytest.raises(ConfigError, match="DDS lets nobody into domain") as refused:
        Node(Network(number))
    assert settings[:30] in str(refused.value)


@pytest.mark.parametrize(
    ("name", "said"), [("ROS_STATIC_PEERS", "192.168.1.7"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]
)
def test_what_is_not_followed_is_refused_unless_something_else_says_who_is_heard(unsaid, name, said):
    unsaid.setenv(name, said)
    with pytest.raises(ConfigError, match=name) as refused:
        Network()
    assert "--no-localhost" in refused.value.hint
    assert Network(localhost=True).local
    assert not Network(localhost=False).local
    unsaid.setenv("CYCLONEDDS_URI", "file:///etc/dds.xml")
    assert not Network().local


def test_all_of_the_network_is_reached_where_another_has_begun_the_domain(unsaid):
    """A program that speaks DDS itself has its own settings for the domain, which are kept."""
    from cyclonedds.domain import DomainParticipant

    number = fresh_domain()
    other = DomainParticipant(number)
    with Node(Network(number, localhost=False)) as node:
        outbox, inbox = node.publish("/a", JointState), node.listen("/a", JointState)
        wait_for(lambda: outbox.readers and inbox.writers)
    del other


def test_a_type_that_two_threads_need_for_the_first_time_is_described_once(monkeypatch):
    """Cyclone takes a type for described as soon as it has begun to: the second thread would be refused."""

    @dataclass
    class Fresh(IdlStruct, typename="std_msgs::msg::dds_::Fresh_"):
        data: int32 = 0

    process, begun = XTBuilder.process_type, threading.Event()

    def slowly(kind):
        found = process(kind)
        write = found[0].serialize

        def late(**how):
            begun.set()
            time.sleep(0.3)
            return write(**how)

        monkeypatch.setattr(found[0], "serialize", late, raising=False)
        return found

    monkeypatch.setattr(XTBuilder, "process_type", slowly)
    with Node(Network(fresh_domain(), localhost=True)) as node, ThreadPoolExecutor(1) as pool:
        other = pool.submit(node.publish, "/one", Fresh)
        assert begun.wait(5.0)
        node.publish("/other", Fresh)
        other.result()
