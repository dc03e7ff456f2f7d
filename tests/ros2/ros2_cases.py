"""Domains of their own, joint states that move, and nodes that publish and listen, for tests of what is live."""

import itertools
import math
import os
import threading
import time

import numpy as np
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from trueup.ros2 import JointState, Network, Node, run_bridge
from trueup.ros2.messages import Header, Time

JOINTS = ("a", "b")
_numbers, _fresh = itertools.count(), itertools.count()


def network(**options):
    """On this computer only, in a domain that no other test is in: tests run side by side.

    Ports follow from the domain. Those of 102 to 214 are ports that Linux gives to any program that asks for one.
    """
    return Network(4 + 31 * _worker() + next(_numbers) % 31, localhost=True, **options)


def fresh_domain():
    """A domain that nothing in this process has been in, no page's example either: what it was begun with stays."""
    return 215 + 6 * _worker() + next(_fresh)


def _worker():
    return int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 3


def state(time_s, names=JOINTS, *, frame="base", signals=("position", "velocity", "effort"), epoch_s=1_700_000_000):
    """Joint states of a slow wave; those of a joint depend on its name alone."""
    numbers = {
        signal: [math.sin(time_s + sum(map(ord, name)) + place) for name in names]
        for place, signal in enumerate(signals)
    }
    return JointState(Header(Time.of_ns(epoch_s * 10**9 + round(time_s * 1e9)), frame), list(names), **numbers)


def wait_for(what, seconds=10.0):
    """Until it is true."""
    until = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < until, "that took too long"
        time.sleep(0.01)


def send_all(outbox, messages, *, every_s=0.0):
    """One after the other."""
    for message in messages:
        outbox.send(message)
        if every_s:
            time.sleep(every_s)


def asking(node, topic, type_=JointState, *, reliable=True, policies=()):
    """A reader as ROS 2's nodes have them; one with the system's defaults is reliable under rmw_cyclonedds."""
    reliability = Policy.Reliability.Reliable(max_blocking_time=0) if reliable else Policy.Reliability.BestEffort
    participant = node._participant
    return DataReader(
        participant,
        Topic(participant, f"rt{topic}", type_),
        qos=Qos(reliability, Policy.History.KeepLast(10), *policies),
    )


def received(inbox, node, count, seconds=10.0):
    """So many messages, or as many as came in so long."""
    messages, until = [], time.monotonic() + seconds
    while len(messages) < count and time.monotonic() < until:
        node.wait(0.1)
        messages += inbox.take()
    return messages


class InThread:
    """Work that goes on in a thread as long as this is entered; what it raises is raised on leaving.

    `work` is given an event, and ends when it is set.
    """

    def __init__(self, work):
        self._stop, self._error = threading.Event(), None

        def run():
            try:
                work(self._stop)
            except Exception as error:
                self._error = error

        self._thread = threading.Thread(target=run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(10.0)
        assert not self._thread.is_alive()
        if self._error:
            raise self._error


class Publishing(InThread):
    """Joint states on a topic, again and again, as long as it is entered."""

    def __init__(self, node, topic="/joint_states", names=JOINTS, every_s=0.01):
        outbox = node.publish(topic, JointState)

        def speak(stop):
            began = time.monotonic()
            while not stop.wait(every_s):
                outbox.send(state(time.monotonic() - began, names=names))

        super().__init__(speak)


class Bridge(InThread):
    """A bridge in a thread; left, it is stopped, and `report` says what it did."""

    def __init__(self, where, answer, listens="/joint_states", publishes="/corrected", form=JointState, beside=()):
        node = Node(where)
        self.inbox, self.outbox = node.listen(listens, JointState), node.publish(publishes, form)
        others = [(node.listen(topic, JointState), hear) for topic, hear in beside]
        self.report = None

        def run(stop):
            with node:
                self.report = run_bridge(node, self.inbox, self.outbox, answer, beside=others, stop=stop)

        super().__init__(run)


def arrays(messages, field="position"):
    """One field of many messages, (N, J)."""
    return np.array([getattr(message, field) for message in messages])
