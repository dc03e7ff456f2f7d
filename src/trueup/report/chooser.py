"""Tables and figures of which the reader chooses one by menus.

All variants are made here, as plain data; the page shows the default one and its script swaps in the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

# A plotly figure: {"data": [...], "layout": {...}}
Figure = dict[str, Any]


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes:
        text: what is read first.
        note: smaller, below: the interval.
        extra: smaller, beside: degrees.
        tone: `better`, `worse`, `undecided`, or empty.
    """

    text: str
    note: str = ""
    extra: str = ""
    tone: str = ""

    def to_json(self) -> dict[str, str]:
        """Without empty fields, to keep the page small."""
        return {key: value for key, value in vars(self).items() if value}


@dataclass(frozen=True)
class TableRow:
    """One row of a table: its heading, and a cell per column.

    Attributes:
        head: row heading.
        cells: one per column.
        note: smaller, beside the heading.
        strong: whether this is the row of totals, or the chosen one.
    """

    head: str
    cells: Sequence[Cell]
    note: str = ""
    strong: bool = False

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "head": self.head,
            "note": self.note,
            "strong": self.strong,
            "cells": [cell.to_json() for cell in self.cells],
        }


@dataclass(frozen=True)
class Table:
    """A table with row headings.

    Attributes:
        columns: headings; the first is that of the row headings.
        rows: the rows.
        caption: one sentence that says what is shown.
    """

    columns: Sequence[str]
    rows: Sequence[TableRow]
    caption: str = ""

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "columns": list(self.columns),
            "rows": [row.to_json() for row in self.rows],
            "caption": self.caption,
        }


@dataclass(frozen=True)
class Variant:
    """What one choice shows: slots of the page and what goes into them."""

    tables: Mapping[str, Table] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        tables = {slot: table.to_json() for slot, table in self.tables.items()}
        return {"tables": tables, "figures": dict(self.figures)}


@dataclass(frozen=True)
class Menu:
    """One menu.

    Attributes:
        name: what is chosen, e.g. `Split`.
        options: value and text, in order, over all variants.
    """

    name: str
    options: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Chooser:
    """Menus and the variant for every possible choice.

    Attributes:
        id: unique in the page.
        menus: from the outermost to the innermost level of `variants`.
        variants: nested mappings by the values of the menus, with a Variant innermost (without menus, the Variant
            itself); a choice that does not exist is left out.
        default: path of the variant that is shown first.
    """

    id: str
    menus: Sequence[Menu]
    variants: Any
    default: Sequence[str]

    @property
    def shown(self) -> Variant:
        """The variant that is shown first."""
        node: Any = self.variants
        for value in self.default:
            node = node[value]
        assert isinstance(node, Variant)
        return node

    def options_at(self, level: int) -> list[tuple[str, str]]:
        """Options of one menu that exist under the default choice of the menus before it."""
        node: Any = self.variants
        for value in self.default[:level]:
            node = node[value]
        return [(value, text) for value, text in self.menus[level].options if value in node]

    def to_json(self) -> dict[str, Any]:
        """For the script of the page."""
        menus = [{"name": menu.name, "options": [list(option) for option in menu.options]} for menu in self.menus]
        return {"menus": menus, "variants": _json(self.variants), "default": list(self.default)}


def make_chooser(
    id: str,
    menus: Sequence[Menu],
    make: Callable[..., Variant | None],
    *,
    preferred: Sequence[str],
) -> Chooser | None:
    """Make the variants of all choices.

    Args:
        id: unique in the page.
        menus: the menus, outermost first.
        make: called with one value per menu; None for a choice that does not exist.
        preferred: the choice to show first, if it exists; else the first that does.

    Returns:
        The chooser, or None when no choice exists.
    """

    def branch(path: tuple[str, ...]) -> Any:
        if len(path) == len(menus):
            return make(*path)
        children = {value: branch((*path, value)) for value, _ in menus[len(path)].options}
        return {value: child for value, child in children.items() if child} or None

    variants = branch(())
    if variants is None:
        return None
    default: list[str] = []
    node = variants
    for value, menu in zip(preferred, menus, strict=True):
        default.append(value if value in node else next(option for option, _ in menu.options if option in node))
        node = node[default[-1]]
    used = [
        Menu(menu.name, [option for option in menu.options if option[0] in _values_at(variants, level)])
        for level, menu in enumerate(menus)
    ]
    return Chooser(id, used, variants, default)


def _values_at(tree: Mapping[str, Any], level: int) -> set[str]:
    if level == 0:
        return set(tree)
    return {value for child in tree.values() for value in _values_at(child, level - 1)}


def _json(tree: Any) -> Any:
    return tree.to_json() if isinstance(tree, Variant) else {key: _json(child) for key, child in tree.items()}
