"""A network between two topics of ROS 2."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from trueup.deploy.latency import Latency
from trueup.ros2.answers import Answer
from trueup.ros2.messages import JointState
from trueup.ros2.node import Inbox, Node, Outbox

_PROGRESS_S = 1.0
# Clocks of two computers do not agree by themselves: what took longer, or less than nothing, says nothing of the way.
_LONGEST_WAY_NS = 10_000_000_000


@dataclass(eq=False)
class BridgeReport:
    """What went through a bridge.

    Attributes:
        received: messages that came.
        sent: messages that were published.
        added: from the moment at which a message was there to be taken by the bridge to that at which its answer was
            with DDS.
        way: from the publisher to the bridge, by the clocks of both.
        most_waiting: largest number of messages that waited to be taken.
        seconds: how long the bridge was open [s].
        counts: what became of the messages: status of the network's answers, and messages of other joints.
    """

    received: int = 0
    sent: int = 0
    added: Latency = field(default_factory=Latency)
    way: Latency = field(default_factory=Latency)
    most_waiting: int = 0
    seconds: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Numbers for a file."""
        counted = {"received": self.received, "sent": self.sent, "most_waiting": self.most_waiting}
        times = {"added": self.added.to_json(), "way": self.way.to_json()}
        return {**counted, "seconds": self.seconds, "counts": self.counts, **times}


def run_bridge(
    node: Node,
    inbox: Inbox[JointState],
    outbox: Outbox[Any],
    answer: Answer,
    *,
    beside: Sequence[tuple[Inbox[JointState], Callable[[JointState], None]]] = (),
    stop: threading.Event | None = None,
    seconds: float | None = None,
    on_progress: Callable[[BridgeReport], None] = lambda _: None,
) -> BridgeReport:
    """Answer every message of a topic on another, until it is stopped.

    Args:
        node: that all topics are of.
        inbox: what is answered.
        outbox: where the answers go.
        answer: to a message.
        beside: other topics, and who is told what comes on them.
        stop: ends the bridge; within a tenth of a second.
        seconds: ends it after so long [s].
        on_progress: told once per second.

    Raises:
        MissingSignal: see `Augmented.to`.
    """
    report, stop = BridgeReport(), stop or threading.Event()
    began = told = time.monotonic()
    with _young_garbage_only():
        while not stop.is_set():
            came = node.wait()
            now = time.monotonic()
            if came:
                for other, hear in beside:
                    for message in other.coming():
                        hear(message)
                _answer_all(report, inbox, outbox, answer)
            if now - told >= _PROGRESS_S or (seconds is not None and now - began >= seconds):
                told, report.seconds, report.counts = now, now - began, dict(answer.counts)
                on_progress(report)
            if seconds is not None and now - began >= seconds:
                break
    report.seconds, report.counts = time.monotonic() - began, dict(answer.counts)
    return report


def _answer_all(report: BridgeReport, inbox: Inbox[JointState], outbox: Outbox[Any], answer: Answer) -> None:
    taken_ns, taken_at, answered = time.time_ns(), time.perf_counter_ns(), report.received
    for message in inbox.coming():
        way_ns = taken_ns - message.sample_info.source_timestamp  # type: ignore[attr-defined]  # cyclonedds adds it
        if 0 <= way_ns < _LONGEST_WAY_NS:
            report.way.record(way_ns)
        out = answer.to(message)
        report.received += 1
        if out is not None:
            outbox.send(out)
            report.sent += 1
        # From when the first were taken, all of them: the last has waited for those before it.
        report.added.record(time.perf_counter_ns() - taken_at)
    report.most_waiting = max(report.most_waiting, report.received - answered)


@contextmanager
def _young_garbage_only() -> Iterator[None]:
    """What was there before is not looked through again and again while messages wait."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
