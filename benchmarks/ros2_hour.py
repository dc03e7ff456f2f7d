"""A bridge on ROS 2's topics for an hour at 1 kHz: nothing is lost, and its memory does not grow.

Publisher and bridge of `ros2_bridge`, a listener that counts, and a look at the bridge's memory every ten seconds.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from jaxtyping import Float64

from benchmarks.ros2_bridge import DOMAIN, RATE_HZ, START_S, bridge_options, ended, listening, processes, until_quiet
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import write_json
from trueup.core.provenance import provenance
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "ros2_hour.json"
SECONDS = 3600.0
# Growth within the hour, from the end of the first minute on.
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
        at_most("largest memory, beyond that", max(result["memory_mb"]) - result["memory_mb"][0], BAR_MB, "MB"),
        shown("memory at the end, beyond that", result["memory_mb"][-1] - result["memory_mb"][0], "MB"),
    ]


def measured(seconds: float) -> dict[str, Any]:
    """What a publisher, a bridge and a listener say after so long [s]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bridge = ("-m", "trueup.cli.main", *bridge_options(folder, DOMAIN))
        listener = ("-m", "benchmarks.ros2_hour", folder / "answers.json")
        publisher = ("-m", "benchmarks.ros2_bridge", "publish", "states", DOMAIN, seconds)
        with processes(bridge, listener, publisher) as (bridging, counting, publishing):
            memory = _memory_mb(bridging.pid, publishing)
            ended(publishing, within_s=START_S)
            ended(counting, within_s=START_S)
            bridging.send_signal(signal.SIGTERM)
            ended(bridging, within_s=START_S)
        own = json.loads((folder / "out" / "bridge.json").read_text())
        answers = json.loads((folder / "answers.json").read_text())
    return {
        "provenance": provenance(config={"machine": {"name": machine_name()}}, seed=0),
        "seconds": seconds,
        "rate_hz": RATE_HZ,
        "published": round(seconds * RATE_HZ),
        "answers": answers,
        "memory_mb": memory[np.linspace(0, len(memory) - 1, min(60, len(memory))).astype(int)].tolist(),
        "bridge": {key: own[key] for key in ("received", "sent", "most_waiting", "counts")}
        | {key: {name: own[key][name] for name in own[key] if name != "bins"} for key in ("added", "way")},
    }


def _memory_mb(pid: int, publishing: subprocess.Popen[bytes]) -> Float64[np.ndarray, "N"]:
    """Of a bridge, every so often while messages are published, from a minute after the beginning on [MB]."""
    began, memory, process = time.monotonic(), [], psutil.Process(pid)
    while publishing.poll() is None:
        time.sleep(_EVERY_S)
        if time.monotonic() - began > _SETTLED_S:
            memory.append(process.memory_info().rss / 1e6)
    return np.array(memory, np.float64)


def _count(path: Path) -> None:
    """How many answers came."""
    came = 0
    with listening(DOMAIN) as (node, inboxes):
        for _ in until_quiet(node):
            came += len(inboxes["answers"].take())
            inboxes["asked"].take()
    path.write_text(json.dumps(came))


if __name__ == "__main__":
    _count(Path(sys.argv[1]))
