"""The order of values that are numbers written as text, such as payloads, or words, such as conditions."""

from __future__ import annotations


def by_number(value: str) -> tuple[bool, float, str]:
    """A key for sorting: numbers by size, words by alphabet after them."""
    try:
        return False, float(value), value
    except ValueError:
        return True, 0.0, value
