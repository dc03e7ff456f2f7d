"""How long work says where it is, without knowing of terminals."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Protocol, TypeVar, runtime_checkable

T = TypeVar("T")


@runtime_checkable
class Track(Protocol):
    """Passes items on and shows how many of them are done."""

    def __call__(self, items: Iterable[T], what: str, total: int | None = None) -> Generator[T]:
        """Yield the items; `what` is one word for people, `total` their number if known."""
        ...


def silent(items: Iterable[T], what: str, total: int | None = None) -> Generator[T]:  # noqa: ARG001 - a Track
    """Shows nothing."""
    yield from items
