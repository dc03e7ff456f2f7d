"""What a section is: a template and what it shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Section:
    """One section of the page.

    Attributes:
        anchor: id in the page, also the name of its template, if `kind` is empty.
        title: heading.
        context: what its template shows, under the name `c`.
        kind: name of its template, where several sections have the same one.
    """

    anchor: str
    title: str
    context: Mapping[str, Any] = field(default_factory=dict)
    kind: str = ""

    @property
    def template(self) -> str:
        """File name of the template."""
        return f"{self.kind or self.anchor}.html.j2"
