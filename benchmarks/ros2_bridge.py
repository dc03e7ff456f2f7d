"""A bridge on ROS 2's topics at 1 kHz: what it adds, and whether anything is lost.

A publisher of joint states, `trueup deploy ros2` with a network of the size of Realeasy's, and a listener on both
topics, each a process of its own, on this computer. Added is the time from when the listener had the message of the
simulator to when it had the answer.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.networks import JOINTS, real_time
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import write_json
from trueup.core.provenance import provenance
from trueup.ros2 import JointState, Network, Node
from trueup.ros2.messages import Header, Time
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "ros2_bridge.json"
RATE_HZ, SECONDS = 1000.0, 60.0
BAR_MS = 1.0
DOMAIN = 211
STATES, ANSWERS = "/joint_states", "/joint_states_corrected"
# Until processes have found each other, and until the last message is through [s].
START_S, REST_S = 6.0, 3.0


def run() -> list[Row]:
    """Measure, keep the result, and hold it against the bar."""
    result = measured(SECONDS)
    write_json(RESULT, rounded(result))
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    added, bridge = result["added_ms"], result["bridge"]
    return [
        shown("published", result["published"], "messages"),
        at_most("delivered by DDS and not answered", result["lost"], 0, "messages"),
        shown("added, p50", added["p50"], "ms"),
        at_most("added, p99", added["p99"], BAR_MS, "ms"),
        shown("added, p99.9", added["p999"], "ms"),
        shown("added, longest", added["max"], "ms"),
        shown("bridge: from taken to sent, p50", bridge["added"]["p50_us"], "us"),
        shown("bridge: from taken to sent, p99", bridge["added"]["p99_us"], "us"),
        shown("publisher to bridge, p50", bridge["way"]["p50_us"], "us"),
    ]


def measured(seconds: float) -> dict[str, Any]:
    """What a publisher, a bridge and a listener say after so long [s]."""
    load = list(os.getloadavg())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        real_time(folder / "network", rate_hz=RATE_HZ)
        whole = seconds + START_S + REST_S
        options = ("--domain", DOMAIN, "--localhost", "--seconds", whole, "--out", folder / "out")
        bridge = _started("-m", "trueup.cli.main", "deploy", "ros2", folder / "network", *options)
        listener = _started("-m", "benchmarks.ros2_bridge", "listen", whole, folder / "listened.json")
        publisher = _started("-m", "benchmarks.ros2_bridge", "publish", seconds)
        for process in (publisher, listener, bridge):
            if process.wait(whole + 60.0) != 0:
                raise RuntimeError(f"{process.args} ended with {process.returncode}")
        heard = json.loads((folder / "listened.json").read_text())
        own = json.loads((folder / "out" / "bridge.json").read_text())
    states = {int(stamp): came for stamp, came in heard["states"].items()}
    answers = {int(stamp): came for stamp, came in heard["answers"].items()}
    added = np.array([answers[stamp] - states[stamp] for stamp in answers if stamp in states]) / 1e6
    quantiles = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
    return {
        "provenance": provenance(config={"machine": {"name": machine_name(), "load_before": load}}, seed=0),
        "seconds": seconds,
        "rate_hz": RATE_HZ,
        "published": round(seconds * RATE_HZ),
        "delivered": len(states),
        "answered": len(answers),
        # What the bridge was given and no answer to it arrived; what only the listener was not given is none of its.
        "lost": own["received"] - own["sent"] + len(states.keys() - answers.keys()),
        "added_ms": {name: float(np.percentile(added, share)) for name, share in quantiles.items()},
        "bridge": {key: own[key] for key in ("received", "sent", "most_waiting", "counts")}
        | {key: {name: own[key][name] for name in own[key] if name != "bins"} for key in ("added", "way")},
    }


def _started(*arguments: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, *map(str, arguments)], stdout=subprocess.DEVNULL)


def _publish(seconds: float) -> None:
    """Joint states of slow waves, each at its time."""
    with Node(Network(DOMAIN, localhost=True)) as node:
        out = node.publish(STATES, JointState)
        until = time.monotonic() + 30.0
        while out.readers < 2:
            if time.monotonic() > until:
                raise RuntimeError("nobody listens")
            time.sleep(0.05)
        time.sleep(1.0)  # the bridge's own listener is found meanwhile
        names, began = list(JOINTS), time.monotonic()
        for number in range(round(seconds * RATE_HZ)):
            time_s = number / RATE_HZ
            position = [0.5 * math.sin(time_s + joint) for joint in range(len(names))]
            velocity = [0.5 * math.cos(time_s + joint) for joint in range(len(names))]
            left = began + time_s - time.monotonic()
            if left > 0:
                time.sleep(left)
            stamp = Time.of_ns(time.time_ns())
            out.send(JointState(Header(stamp, "base"), names, position, velocity, [10.0 * value for value in position]))
        time.sleep(0.5)


def _listen(seconds: float, path: Path) -> None:
    """When messages and answers came, by their stamps [ns]."""
    heard: dict[str, dict[int, int]] = {"states": {}, "answers": {}}
    with Node(Network(DOMAIN, localhost=True)) as node:
        inboxes = {"states": node.listen(STATES, JointState), "answers": node.listen(ANSWERS, JointState)}
        until = time.monotonic() + seconds - REST_S
        while time.monotonic() < until:
            if node.wait():
                for name, inbox in inboxes.items():
                    messages = inbox.take()
                    now = time.perf_counter_ns()
                    heard[name] |= {message.header.stamp.ns: now for message in messages}
    path.write_text(json.dumps(heard))


if __name__ == "__main__":
    if sys.argv[1] == "publish":
        _publish(float(sys.argv[2]))
    else:
        _listen(float(sys.argv[2]), Path(sys.argv[3]))
