"""Whether what is published is heard, what keeps listeners from it, and who else speaks to them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trueup.ros2.node import ANOTHER_TYPE, Outbox

# Discovery of nodes and topics takes a second or two: who is not there then is said not to be [s].
_PATIENCE_S = 3.0


def refusal_hint(topic: str, refused: str) -> str:
    """What to do for a listener that asks for what is not offered."""
    if refused == "reliability":
        return "Give --reliable, or let it listen as to a sensor (best effort)."
    if refused == ANOTHER_TYPE:
        return f"`ros2 topic info -v {topic}` shows both types: --form says which is published; or name another topic."
    return f"`ros2 topic info -v {topic}` shows what both sides ask for and offer; let it ask for no {refused}."


def others_hint(topic: str) -> str:
    """What to do where others publish to the same topic."""
    return f"`ros2 topic info -v {topic}` shows who they are; stop them, or let them publish elsewhere."


class Listeners:
    """A look, now and then, at who hears a topic, and who else publishes there; each trouble is told once.

    Args:
        outbox: the topic.
        commands: that it is one of commands, which somebody has to hear.
        tell: what is wrong, and what to do.
    """

    def __init__(self, outbox: Outbox[Any], *, commands: bool, tell: Callable[[str, str], None]) -> None:
        self._outbox, self._commands, self._tell = outbox, commands, tell
        self._told_refused = self._told_nobody = self._told_others = False

    def look(self, seconds: float) -> None:
        """After so long [s]."""
        refused, topic = self._outbox.refused, self._outbox.topic
        if refused and not self._told_refused:
            self._told_refused = True
            self._tell(
                f"a listener to {topic} asks for {refused}, which is not offered: it hears nothing",
                refusal_hint(topic, refused),
            )
        if self._outbox.others and not self._told_others:
            self._told_others = True
            self._tell(f"somebody else publishes to {topic}, too: whoever listens hears a mixture", others_hint(topic))
        nobody = self._commands and not self._outbox.readers and seconds >= _PATIENCE_S
        if nobody and not self._told_refused and not self._told_nobody:
            self._told_nobody = True
            self._tell(
                f"nobody listens to {topic}",
                "Start the robot's controller, or name its topic by --publish and its type by --form.",
            )
