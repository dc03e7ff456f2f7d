"""A bridge on ROS 2's topics at 1 kHz: what it adds, and whether anything is lost.

A publisher, `trueup deploy ros2`, and a listener to what is asked and what is answered, each a process of its own, on
this computer: joint states that a network of the size of Realeasy's corrects, and targets of a robot that the default
operator corrects by what the robot says, a thousand times a second, too. DDS stamps every message when it is written
(its source timestamp; it keeps no stamp of when a message was received), and the listener looks at the clock at each
message that it takes, one by one. Of each message there are three times:

- direct: from the publisher's stamp until the listener has taken the message itself;
- whole: from the same stamp until it has taken the answer;
- added: from when the message was written to when the answer was. Both have the way to a listener before them then, so
  this is how much later the answer is than the message, for any listener. The way from the publisher to the bridge is
  in it, and all that messages waited there.

How much later this one listener took the answer than the message would be less than that whenever it was busy, or
asleep, while both came: it takes them together then. Its own delays are in direct and whole, which are never too small.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64

from benchmarks.networks import JOINTS, compensation, real_time
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import write_json
from trueup.core.provenance import provenance
from trueup.ros2 import JointState, Network, Node
from trueup.ros2.messages import Header, Time
from trueup.ros2.node import Inbox
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "ros2_bridge.json"
RATE_HZ, SECONDS = 1000.0, 60.0
BAR_MS = 1.0
DOMAIN = 211
STATES = "/joint_states"


@dataclass(frozen=True)
class Way:
    """What a bridge corrects.

    Attributes:
        asked: topic of the messages that it answers.
        answered: topic of its answers.
        network: makes its network in a folder.
        options: of its command besides.
    """

    asked: str
    answered: str
    network: Callable[[Path], object]
    options: tuple[str, ...] = ()


WAYS = {
    "states": Way(STATES, "/joint_states_corrected", lambda folder: real_time(folder, rate_hz=RATE_HZ)),
    # Positions of a wave of 0.5 rad and its targets are within what it has seen; so are the Panda's limits.
    "commands": Way(
        *("/joint_targets", "/joint_commands"),
        lambda folder: compensation(folder, rate_hz=RATE_HZ),
        ("--robot", "panda", "--payload-kg", "1.5"),
    ),
}
# Columns of what the listener writes down of each message.
STAMP, WRITTEN, TAKEN = range(3)
QUANTILES = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
# Processes may take so long to start and find each other; where nothing has come for so long, that was all [s].
START_S, REST_S = 120.0, 5.0


def run() -> list[Row]:
    """Measure, keep the result, and hold it against the bar."""
    load = list(os.getloadavg())
    result = {
        "provenance": provenance(config={"machine": {"name": machine_name(), "load_before": load}}, seed=0),
        "ways": {way: measured(way, SECONDS) for way in WAYS},
    }
    write_json(RESULT, rounded(result))
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    return [replace(row, name=f"{way}: {row.name}") for way, own in result["ways"].items() for row in rows_of(own)]


def rows_of(result: Mapping[str, Any]) -> list[Row]:
    """The figures of one way."""
    added, bridge = result["added_ms"], result["bridge"]
    return [
        shown("published", result["published"], "messages"),
        at_most("delivered by DDS and not answered", result["lost"], 0, "messages"),
        at_most("answers out of order, or twice", result["out_of_order"], 0, "messages"),
        shown("added, p50", added["p50"], "ms"),
        at_most("added, p99", added["p99"], BAR_MS, "ms"),
        shown("added, p99.9", added["p999"], "ms"),
        shown("added, longest", added["max"], "ms"),
        shown("from the publisher to the listener, p50", result["direct_ms"]["p50"], "ms"),
        shown("from the publisher to the listener, p99", result["direct_ms"]["p99"], "ms"),
        shown("from the publisher through the bridge to the listener, p50", result["whole_ms"]["p50"], "ms"),
        shown("from the publisher through the bridge to the listener, p99", result["whole_ms"]["p99"], "ms"),
        shown("bridge: from taken to sent, p50", bridge["added"]["p50_us"], "us"),
        shown("bridge: from taken to sent, p99", bridge["added"]["p99_us"], "us"),
        shown("publisher to bridge, p50", bridge["way"]["p50_us"], "us"),
    ]


def measured(way: str, seconds: float, *, domain: int = DOMAIN) -> dict[str, Any]:
    """What a publisher, a bridge and a listener say after so long [s]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bridge = ("-m", "trueup.cli.main", *bridge_options(folder, domain, way))
        listener = ("-m", "benchmarks.ros2_bridge", "listen", way, domain, folder / "listened.json")
        publisher = ("-m", "benchmarks.ros2_bridge", "publish", way, domain, seconds)
        with processes(bridge, listener, publisher) as (bridging, listening, publishing):
            ended(publishing, within_s=START_S + 2.0 * seconds)
            ended(listening, within_s=START_S)
            bridging.send_signal(signal.SIGTERM)
            ended(bridging, within_s=START_S)
        heard = json.loads((folder / "listened.json").read_text())
        own = json.loads((folder / "out" / "bridge.json").read_text())
    asked, answers = (np.array(heard[name], np.int64).reshape(-1, 3) for name in ("asked", "answers"))
    return {
        "seconds": seconds,
        "rate_hz": RATE_HZ,
        "published": round(seconds * RATE_HZ),
        "delivered": len(asked),
        "answered": len(answers),
        # What the bridge was given and no answer to it arrived; what only the listener was not given is none of its.
        "lost": own["received"] - own["sent"] + len(np.setdiff1d(asked[:, STAMP], answers[:, STAMP])),
        "out_of_order": int((np.diff(answers[:, STAMP]) <= 0).sum()),
        **times_ms(asked, answers),
        "bridge": {key: own[key] for key in ("received", "sent", "most_waiting", "counts")}
        | {key: {name: own[key][name] for name in own[key] if name != "bins"} for key in ("added", "way")},
    }


def times_ms(asked: Int64[np.ndarray, "N 3"], answers: Int64[np.ndarray, "M 3"]) -> dict[str, dict[str, float]]:
    """Quantiles of the three times, of messages whose answer the listener had [ms].

    Args:
        asked: of each message the publisher's stamp, DDS's of when it was written, and when the listener took it [ns].
        answers: the same of the answers, whose first stamp is that of their message.
    """
    _, of_asked, of_answers = np.intersect1d(asked[:, STAMP], answers[:, STAMP], return_indices=True)
    asked, answers = asked[of_asked], answers[of_answers]
    times_ns = {
        "added_ms": answers[:, WRITTEN] - asked[:, WRITTEN],
        "direct_ms": asked[:, TAKEN] - asked[:, STAMP],
        "whole_ms": answers[:, TAKEN] - answers[:, STAMP],
    }
    return {
        title: {name: float(np.percentile(taken_ns / 1e6, share)) for name, share in QUANTILES.items()}
        for title, taken_ns in times_ns.items()
    }


def bridge_options(folder: Path, domain: int, way: str = "states") -> tuple[object, ...]:
    """Make a network, and the command of a bridge with it that runs until it is stopped."""
    WAYS[way].network(folder / "network")
    where = ("--domain", domain, "--localhost", "--out", folder / "out")
    return ("deploy", "ros2", folder / "network", *where, *WAYS[way].options)


@contextmanager
def processes(*commands: Sequence[object]) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Pythons side by side; those that have not ended by themselves are ended."""
    with ExitStack() as stack:
        yield [stack.enter_context(_process(command)) for command in commands]


@contextmanager
def _process(command: Sequence[object]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, *map(str, command)], stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def ended(process: subprocess.Popen[bytes], *, within_s: float) -> None:
    """Wait for the good end of a process.

    Raises:
        RuntimeError: it ended with an error.
        TimeoutExpired: it did not end.
    """
    if process.wait(within_s) != 0:
        raise RuntimeError(f"{process.args!r} ended with {process.returncode}")


@contextmanager
def listening(domain: int, way: str = "states") -> Iterator[tuple[Node, dict[str, Inbox[JointState]]]]:
    """A listener to messages and answers; a publisher that sees it may begin, since it hears the answers by then."""
    with Node(Network(domain, localhost=True)) as node:
        answers = node.listen(WAYS[way].answered, JointState)
        wait_for(lambda: answers.writers > 0)
        yield node, {"asked": node.listen(WAYS[way].asked, JointState), "answers": answers}


def wait_for(what: Callable[[], bool]) -> None:
    """Until processes have started and found each other.

    Raises:
        RuntimeError: that takes too long.
    """
    until = time.monotonic() + START_S
    while not what():
        if time.monotonic() > until:
            raise RuntimeError(f"processes did not find each other within {START_S:g} s")
        time.sleep(0.05)


def until_quiet(node: Node) -> Iterator[None]:
    """Whenever something has come, until there has been nothing for a while after the first."""
    wait_for(node.wait)
    last = time.monotonic()
    while time.monotonic() - last < REST_S:
        if node.wait():
            last = time.monotonic()
            yield


def _publish(way: str, domain: int, seconds: float) -> None:
    """Slow waves, each sample at its time; targets after what the robot says of itself."""
    with Node(Network(domain, localhost=True)) as node:
        outs = [node.publish(topic, JointState) for topic in dict.fromkeys((STATES, WAYS[way].asked))]
        wait_for(lambda: outs[0].readers >= 1 and outs[-1].readers >= 2)
        time.sleep(1.0)  # those who listen to the bridge are found by it meanwhile
        names, began = list(JOINTS), time.monotonic()
        for number in range(round(seconds * RATE_HZ)):
            time_s = number / RATE_HZ
            position = [0.5 * math.sin(time_s + joint) for joint in range(len(names))]
            velocity = [0.5 * math.cos(time_s + joint) for joint in range(len(names))]
            left = began + time_s - time.monotonic()
            if left > 0:
                time.sleep(left)
            effort = [10.0 * value for value in position]
            for out in outs:
                out.send(JointState(Header(Time.of_ns(time.time_ns()), "base"), names, position, velocity, effort))
        time.sleep(0.5)


def _listen(way: str, domain: int, path: Path) -> None:
    """Of messages and answers: their stamp, when they were written, and when they were taken [ns]."""
    heard: dict[str, list[tuple[int, int, int]]] = {"asked": [], "answers": []}
    with listening(domain, way) as (node, inboxes):
        for _ in until_quiet(node):
            for name, inbox in inboxes.items():
                while messages := inbox.take(1):
                    now_ns = time.time_ns()
                    written_ns = messages[0].sample_info.source_timestamp  # type: ignore[attr-defined]
                    heard[name].append((messages[0].header.stamp.ns, written_ns, now_ns))
    path.write_text(json.dumps(heard))


if __name__ == "__main__":
    what, way, domain, last = sys.argv[1:]
    if what == "publish":
        _publish(way, int(domain), float(last))
    else:
        _listen(way, int(domain), Path(last))
