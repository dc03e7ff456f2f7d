"""Whether what comes can be corrected, and what keeps it from that."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from trueup.deploy import Status, Stream
from trueup.errors import NameMismatch
from trueup.ros2.answers import STALE_S, Answer, Heard
from trueup.ros2.bridge import BridgeReport
from trueup.ros2.messages import JointState
from trueup.ros2.node import Inbox

# What is wrong in every look for so long is told [s].
_PATIENCE_S = 2.0
# Names of channels in a line.
_SHOWN = 6
# `Why` that keep a network from correcting anything.
_WORDS = {
    "NAN": "what it reads is no number",
    "OFF_RATE": "messages come at another rate",
    "OUT_OF_RANGE": "what it reads is out of its training range",
    "STALLED": "stamps, or what moves, stand still",
    "MISSED": "messages are missing",
    "DIVERGED": "what it says itself is no number",
}


class Speakers:
    """A look, now and then, at what comes; each trouble is told once.

    Args:
        inbox: of the messages that are answered.
        beside: of what else the network reads, and what was heard there.
        answer: to a message.
        stream: of the network.
        message_hz: how often messages are to come [Hz].
        tell: what is wrong, and what to do.
    """

    def __init__(
        self,
        inbox: Inbox[JointState],
        beside: Sequence[tuple[Inbox[JointState], Heard]],
        answer: Answer,
        stream: Stream,
        *,
        message_hz: float,
        tell: Callable[[str, str], None],
    ) -> None:
        self._inbox, self._beside, self._answer, self._stream = inbox, beside, answer, stream
        self._message_hz, self._tell = message_hz, tell
        self._since: dict[str, float] = {}
        self._told: set[str] = set()
        self._counts: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()

    def look(self, report: BridgeReport) -> None:
        """At what has come until now."""
        seconds = report.seconds
        if self._lasts(self._inbox.topic, seconds, wrong=bool(report.received) and not report.concerned):
            self._tell_names(self._inbox.topic, report.others)
        for inbox, heard in self._beside:
            if self._lasts(inbox.topic, seconds, wrong=bool(heard.ignored) and not heard.heard):
                self._tell_names(inbox.topic, heard.others)
        new, reasons = Counter(report.counts) - self._counts, Counter(report.reasons) - self._reasons
        self._counts, self._reasons = Counter(report.counts), Counter(report.reasons)
        useless = bool(new[Status.HELD.value] or new[Status.FALLBACK.value]) and not new[Status.OK.value]
        if self._lasts("", seconds, wrong=useless):
            why = max(_WORDS, key=lambda name: reasons[name])
            message, hint = self._because(why)
            self._tell(f"nothing is corrected ({why}): {message}", hint)

    def _lasts(self, what: str, seconds: float, *, wrong: bool) -> bool:
        """Whether it has been wrong for long enough and was not told yet."""
        if not wrong:
            self._since.pop(what, None)
            return False
        if seconds - self._since.setdefault(what, seconds) < _PATIENCE_S or what in self._told:
            return False
        self._told.add(what)
        return True

    def _tell_names(self, topic: str, others: Sequence[str]) -> None:
        if not others:
            self._tell(
                f"messages on {topic} say nothing of their joints",
                f"`ros2 topic echo {topic}` shows them: each array is empty, or as long as the names.",
            )
            return
        own = self._stream.card.joints
        names = NameMismatch(
            f"messages on {topic} are of other joints",
            left=own,
            right=others,
            left_name="the network needs",
            right_name="published are",
        )
        self._tell(names.summary, "Name the topic of these joints, or publish them under these names.")

    def _because(self, why: str) -> tuple[str, str]:
        """What is wrong in detail, and what to do."""
        words, hint = _WORDS[why], "docs/runtime.md says what each of these words means."
        if why == "OFF_RATE":
            rate_hz = self._answer.rate_hz
            words = f"messages come at {rate_hz:.4g} Hz by their stamps, not at {self._message_hz:g} Hz"
            return words, "Say by --hz how often they come, a whole multiple of the network's rate, or publish them so."
        if why in ("NAN", "OUT_OF_RANGE"):
            channels = self._stream.latest.channels()
            more = f" and {len(channels) - _SHOWN} more" if len(channels) > _SHOWN else ""
            words += f": {', '.join(channels[:_SHOWN])}{more}" if channels else ""
        if why == "NAN" and (silent := [text for inbox, heard in self._beside if (text := _silence(inbox, heard))]):
            words += f"; {', '.join(silent)}"
            hint = "`ros2 topic list` shows what there is; --states, --commands and --measured name topics."
        return words, hint


def _silence(inbox: Inbox[JointState], heard: Heard) -> str:
    """Why nothing is known from a topic; empty where something is."""
    if not inbox.writers:
        return f"nobody publishes {inbox.topic}"
    if not heard.heard:
        return f"nothing of these joints came on {inbox.topic}"
    if all(np.isnan(values).all() for values in heard.values.values()):
        return f"what came on {inbox.topic} is older than {STALE_S:g} s"
    return ""
