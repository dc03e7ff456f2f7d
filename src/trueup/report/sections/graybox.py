"""The gray-box regression: what each block of terms is worth."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trueup.core.graybox_result import HELD_OUT, BlockFit, GrayboxResult, Score
from trueup.core.results import Estimate
from trueup.report.chooser import Cell, Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.figures import bars_figure
from trueup.report.folder import RunFolder
from trueup.report.labels import SPLITS, group_order, ordered, split_title
from trueup.report.numbers import NOTHING, interval, percent, pretty_unit, significant, with_unit
from trueup.report.palette import cycled_styles
from trueup.report.sections.base import Section
from trueup.report.sections.cells import estimate_cell

# In place of a payload: all motions of a split together.
ALL_MOTIONS = ""
_MEAN = ""
# Short enough for the figure on a phone, and what is meant.
BLOCKS = {
    "pd": ("PD servo", "position and velocity error, constant torque"),
    "friction": ("+ friction", "viscous and Coulomb"),
    "payload": ("+ payload", "constant torque per kg"),
    "posture": ("+ posture", "sine and cosine of the joint, under payload"),
    "coupling": ("+ coupling", "speed and acceleration, under payload"),
}


def graybox_section(run: RunFolder) -> Section | None:
    """Only where a gray-box regression was made; beside a gap analysis it is a part of that."""
    if run.graybox is None or run.engines is not None:
        return None
    chooser = graybox_chooser(run.graybox, run.gap.joints)
    if chooser is None:
        return None
    return Section("graybox", "Gray box: what each term is worth", {"chooser": chooser, "notes": run.graybox.notes})


def graybox_chooser(graybox: GrayboxResult, joints: Sequence[str]) -> Chooser | None:
    """Figure and table per joint and split."""
    by_joint = {joint: fit.blocks for joint, fit in graybox.joints.items()}
    splits = ordered({s for blocks in by_joint.values() for block in blocks for s in block.splits}, (HELD_OUT, *SPLITS))
    names = ordered(graybox.joints, joints)

    def make(joint: str, split: str) -> Variant | None:
        blocks = by_joint[joint] if joint else graybox.total
        if not any(split in block.splits for block in blocks):
            return None
        bars = payload_bars(blocks, split)
        if not bars:
            return None
        unit = next(item.unit for values in bars.values() for item in values.values())
        title = f"torque RMSE [{pretty_unit(unit)}]"
        rows = [block_title(block.block) for block in blocks if not block.left_out]
        figure = bars_figure(rows, bars, cycled_styles(bars), title=title)
        return Variant(tables={"graybox": reductions_table(blocks, split)}, figures={"graybox": figure})

    menus = [
        Menu("Joint", [*([(_MEAN, "mean of joints")] if graybox.total else []), *((name, name) for name in names)]),
        Menu("Split", [(split, split_title(split)) for split in splits]),
    ]
    best = next((split for split in (HELD_OUT, "test", "val") if split in splits), "")
    preferred = (_MEAN if graybox.total else names[0], best) if names else ("", "")
    return make_chooser("graybox-chooser", menus, make, preferred=preferred)


def scores_of(block: BlockFit, split: str) -> dict[str, Score]:
    """Payload in kg as text, or `ALL_MOTIONS` -> score."""
    total = {ALL_MOTIONS: block.splits[split]} if split in block.splits else {}
    return {**total, **block.payloads.get(split, {})}


def payloads_of(blocks: Sequence[BlockFit], split: str) -> list[str]:
    """All motions, then each payload where there are several."""
    found = {load for block in blocks for load in block.payloads.get(split, {})}
    return [ALL_MOTIONS, *(group_order(found) if len(found) > 1 else [])]


def payload_bars(blocks: Sequence[BlockFit], split: str) -> dict[str, dict[str, Estimate]]:
    """Payload -> block -> RMSE."""
    bars = {
        payload_title(load): {
            block_title(block.block): scores_of(block, split)[load].rmse
            for block in blocks
            if load in scores_of(block, split) and not block.left_out
        }
        for load in payloads_of(blocks, split)
    }
    return {title: values for title, values in bars.items() if values}


def reductions_table(blocks: Sequence[BlockFit], split: str) -> Table:
    """By how much each block lowers the error, per payload."""
    loads = payloads_of(blocks, split)
    rows = []
    for block in blocks:
        scores = scores_of(block, split)
        if block.left_out:
            cells = [Cell(NOTHING) for _ in range(len(loads) + 1)]
        else:
            total = scores.get(ALL_MOTIONS)
            cells = [estimate_cell(total.rmse if total else None)]
            cells += [reduction_cell(scores.get(load)) for load in loads]
        note = f"left out: {block.left_out}" if block.left_out else BLOCKS.get(block.block, ("", ""))[1]
        rows.append(TableRow(block_title(block.block), cells, note=note))
    columns = ["Model up to", "RMSE, all motions", *(f"Lowered by, {payload_title(load)}" for load in loads)]
    caption = (
        f"By how much each block lowers the RMSE of the torque on {split_title(split)}, against the model without it "
        "(the first against a constant torque), with 95 % interval. Better or worse only if the interval excludes zero."
    )
    return Table(columns, rows, caption)


def reduction_cell(score: Score | None) -> Cell:
    """What a block is worth, also as a percentage of the error without it."""
    if score is None:
        return Cell(NOTHING)
    low, high = score.reduction.low, score.reduction.high
    decided = low is not None and high is not None and (low > 0 or high < 0)
    tone = ("better" if score.reduction.value > 0 else "worse") if decided else ""
    sign = {"better": "▼ ", "worse": "▲ "}.get(tone, "")
    before = score.rmse.value + score.reduction.value
    share = percent(score.reduction.value / before, sign=False) if before > 0 else ""
    text = with_unit(significant(score.reduction.value), score.reduction.unit)
    return Cell(
        sign + text if math.isfinite(score.reduction.value) else NOTHING,
        note=interval(score.reduction, sign=True),
        extra=share,
        tone=tone,
    )


def block_title(name: str) -> str:
    """What a block adds."""
    return BLOCKS.get(name, (f"+ {name}", ""))[0]


def payload_title(load: str) -> str:
    """`1.5 kg`."""
    return f"{load}\N{NO-BREAK SPACE}kg" if load else "all motions"
