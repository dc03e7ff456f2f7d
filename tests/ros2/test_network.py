"""Who is let into a domain, and what is said to whoever is not."""

import pytest

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
