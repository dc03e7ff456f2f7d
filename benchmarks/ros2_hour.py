"""A bridge on ROS 2's topics for an hour at 1 kHz: nothing is lost, and its memory does not grow.

Publisher and bridge of `ros2_bridge`, a listener that counts, and a look at the bridge's memory every ten seconds.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.networks import real_time
from benchmarks.ros2_bridge import ANSWERS, DOMAIN, RATE_HZ, REST_S, START_S, STATES
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import write_json
from trueup.core.provenance import provenance
from trueup.ros2 import JointState, Network, Node
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "ros2_hour.json"
SECONDS = 3600.0
# Growth over the hour, from the end of the first minute on.
BAR_MB = 1.0
_EVERY_S, _SETTLED_S = 10.0, 60.0


def run() -> list[Row]:
    """Measure, keep the result, and hold it against the bars."""
    result = measured(SECONDS)
    write_json(RESULT, rounded(result))
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    bridge = result["bridge"]
    return [
        shown("published", result["published"], "messages"),
        at_most("not answered", bridge["received"] - bridge["sent"], 0, "messages"),
        at_most("published and not received by the bridge", result["published"] - bridge["received"], 0, "messages"),
        shown("answers that the listener had", result["answers"], "messages"),
        shown("bridge: from taken to sent, p99", bridge["added"]["p99_us"], "us"),
        shown("bridge: from taken to sent, longest", bridge["added"]["max_us"] / 1e3, "ms"),
        shown("memory after a minute", result["memory_mb"][0], "MB"),
        at_most("memory at the end, beyond that", result["memory_mb"][-1] - result["memory_mb"][0], BAR_MB, "MB"),
    ]


def measured(seconds: float) -> dict[str, Any]:
    """What a publisher, a bridge and a listener say after so long [s]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        real_time(folder / "network", rate_hz=RATE_HZ)
        whole = seconds + START_S + REST_S
        options = ("--domain", DOMAIN, "--localhost", "--seconds", whole, "--out", folder / "out")
        bridge = _started("-m", "trueup.cli.main", "deploy", "ros2", folder / "network", *options)
        listener = _started("-m", "benchmarks.ros2_hour", whole, folder / "answers.json")
        publisher = _started("-m", "benchmarks.ros2_bridge", "publish", seconds)
        began, memory = time.monotonic(), []
        process = psutil.Process(bridge.pid)
        while publisher.poll() is None:
            time.sleep(_EVERY_S)
            if time.monotonic() - began > _SETTLED_S and bridge.poll() is None:
                memory.append(process.memory_info().rss / 1e6)
        for one in (publisher, listener, bridge):
            if one.wait(whole + 60.0) != 0:
                raise RuntimeError(f"{one.args} ended with {one.returncode}")
        own = json.loads((folder / "out" / "bridge.json").read_text())
        answers = json.loads((folder / "answers.json").read_text())
    return {
        "provenance": provenance(config={"machine": {"name": machine_name()}}, seed=0),
        "seconds": seconds,
        "rate_hz": RATE_HZ,
        "published": round(seconds * RATE_HZ),
        "answers": answers,
        "memory_mb": np.array(memory)[np.linspace(0, len(memory) - 1, min(60, len(memory))).astype(int)].tolist(),
        "bridge": {key: own[key] for key in ("received", "sent", "most_waiting", "counts")}
        | {key: {name: own[key][name] for name in own[key] if name != "bins"} for key in ("added", "way")},
    }


def _started(*arguments: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def _count(seconds: float, path: Path) -> None:
    with Node(Network(DOMAIN, localhost=True)) as node:
        inbox, until, came = node.listen(ANSWERS, JointState), time.monotonic() + seconds - REST_S, 0
        states = node.listen(STATES, JointState)  # the publisher waits for two
        while time.monotonic() < until:
            if node.wait():
                came += len(inbox.take())
                states.take()
    path.write_text(json.dumps(came))


if __name__ == "__main__":
    _count(float(sys.argv[1]), Path(sys.argv[2]))
