"""A listener of joint commands that asks for reliable ones: prints the stamps that come, until a certain one."""

import sys
import time

from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from trueup.ros2 import JointState, Network, Node


def listen(domain, last_ns):
    """In that domain, until that stamp."""
    with Node(Network(domain, localhost=True)) as node:
        qos = Qos(Policy.Reliability.Reliable(max_blocking_time=0), Policy.History.KeepLast(10))
        topic = Topic(node._participant, "rt/joint_commands", JointState)
        reader, stamp_ns = DataReader(node._participant, topic, qos=qos), None
        while stamp_ns != last_ns:
            for message in reader.take(N=100):
                stamp_ns = message.header.stamp.ns
                sys.stdout.write(f"{stamp_ns}\n")
            time.sleep(0.01)


if __name__ == "__main__":
    listen(*map(int, sys.argv[1:]))
