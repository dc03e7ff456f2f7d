"""A network between two topics of ROS 2."""

from __future__ import annotations

import gc
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from trueup.deploy.latency import Latency
from trueup.deploy.step import Why
from trueup.ros2.answers import UNTOUCHED, Answer
from trueup.ros2.messages import JointState
from trueup.ros2.node import Inbox, Node, Outbox

_PROGRESS_S = 1.0
# Clocks of two computers do not agree by themselves: what took longer, or less than nothing, says nothing of the way.
_LONGEST_WAY_NS = 10_000_000_000
# Where messages may have waited for longer than this [s], the newest are answered and the others are not.
_LONGEST_WAIT_S = 1.0
# Messages that are taken at a time, and answered before something else is looked at.
_AT_A_TIME, _MOST_AT_ONCE = 64, 4096


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
        dropped: messages that were not answered, since they had waited for too long and newer ones were there.
        seconds: how long the bridge was open [s].
        counts: what became of the messages: status of the network's answers, and messages of other joints.
        reasons: what was wrong, by the names of `Why` -> messages; one with several counts for each of them.
        others: joints of the last message that was of others.
        unreadable: messages besides whose texts are none; they are not passed on.
    """

    received: int = 0
    sent: int = 0
    added: Latency = field(default_factory=Latency)
    way: Latency = field(default_factory=Latency)
    most_waiting: int = 0
    dropped: int = 0
    seconds: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    reasons: dict[str, int] = field(default_factory=dict)
    others: tuple[str, ...] = ()
    unreadable: int = 0

    @property
    def concerned(self) -> int:
        """Messages of the network's joints."""
        return self.received - self.counts.get(UNTOUCHED, 0)

    def note(self, seconds: float, answer: Answer, inbox: Inbox[JointState]) -> None:
        """What they say after so long [s]."""
        self.seconds, self.counts, self.others = seconds, dict(answer.counts), answer.others
        reasons: Counter[str] = Counter()
        for flags, count in answer.flags.items():
            reasons.update({str(why.name): count for why in Why(flags)})
        self.reasons, self.unreadable = dict(reasons), inbox.unreadable

    def to_json(self) -> dict[str, Any]:
        """Numbers for a file."""
        counted = {name: getattr(self, name) for name in ("received", "sent", "most_waiting", "dropped", "unreadable")}
        times = {"added": self.added.to_json(), "way": self.way.to_json()}
        what = {"counts": self.counts, "reasons": self.reasons, "others": list(self.others)}
        return {**counted, "seconds": self.seconds, **what, **times}


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
    with _young_garbage_only():
        began = told = empty_at = time.monotonic()  # after the collection, which takes seconds in a large process
        while not stop.is_set():
            came = node.wait()
            now = time.monotonic()
            if not came:
                empty_at = now
            else:
                for other, hear in beside:
                    for message in other.coming():
                        hear(message)
                empty_at = _answer_all(report, inbox, outbox, answer, empty_at)
            if now - told >= _PROGRESS_S or (seconds is not None and now - began >= seconds):
                told = now
                report.note(now - began, answer, inbox)
                on_progress(report)
            if seconds is not None and now - began >= seconds:
                break
    report.note(time.monotonic() - began, answer, inbox)
    return report


def _answer_all(
    report: BridgeReport, inbox: Inbox[JointState], outbox: Outbox[Any], answer: Answer, empty_at: float
) -> float:
    """Answer what waits, a few at a time; returns when nothing waited last, by the monotonic clock [s].

    Args:
        report: counts it.
        inbox: where it waits.
        outbox: where answers go.
        answer: to a message.
        empty_at: when nothing waited last: no message is older than that.
    """
    taken_ns, taken_at, before = time.time_ns(), time.perf_counter_ns(), report.received + report.dropped
    while True:
        messages = inbox.take(_AT_A_TIME)
        if time.monotonic() - empty_at > _LONGEST_WAIT_S:
            while len(messages) == _AT_A_TIME and (newer := inbox.take(_AT_A_TIME)):
                report.dropped += len(newer)
                messages = [*messages, *newer][-_AT_A_TIME:]
            empty_at = time.monotonic()
        for message in messages:
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
        if len(messages) < _AT_A_TIME:
            empty_at = time.monotonic()
            break
        if report.received + report.dropped - before >= _MOST_AT_ONCE:
            break
    report.most_waiting = max(report.most_waiting, report.received + report.dropped - before)
    return empty_at


@contextmanager
def _young_garbage_only() -> Iterator[None]:
    """What was there before is not looked through again and again while messages wait."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
