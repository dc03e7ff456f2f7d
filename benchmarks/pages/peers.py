"""The section "Measured side by side" of docs/elsewhere.md, from what the acceptance measured against other tools."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.pages.markdown import table, with_section

ROOT = Path(__file__).resolve().parents[2]
NAME = "elsewhere.md"

TEXT = """## Measured side by side

The same task, the same data, the same {threads} cores, on {date} (`{commit}`; the commands stand in
[what was asked](acceptance.md)). *Ratio* is trueup over the other: below 1 trueup is quicker, or nearer.

{beside}

In the first rows all three minimize the same residual and end in the same minimum, so that errors are alike. scipy was
given batches of `mujoco.rollout` over two threads, written for this; out of the box it simulates one candidate after
the other. Where a ratio is above 1, the other is better: a bare rollout reads no stamps of a log.

Numbers that others have published are of other machines, robots or motions. They say what is usual, and no ratio is
made of them:

{published}
"""

# What was compared, task, its row.
BESIDE = (
    ("`mujoco.sysid`", "21 numbers of a Panda, 4 x 2 s: time", "time, trueup / mujoco.sysid"),
    ("", "the same: median error of the numbers", "median error, trueup / mujoco.sysid"),
    ("`scipy.optimize.least_squares`", "21 numbers of a Panda, 4 x 2 s: time", "time, trueup / scipy"),
    ("", "the same: median error of the numbers", "median error, trueup / scipy"),
    (
        "bare `mujoco.rollout`",
        "replay of logs: time per simulated step, 1 thread",
        "replay / raw mujoco.rollout, 1 threads",
    ),
    ("", "the same, 2 threads", "replay / raw mujoco.rollout, 2 threads"),
    ("bare pyarrow", "write 1000 episodes of 500 x 21: time", "write, over plain pyarrow"),
    ("", "read them: time", "read, over plain pyarrow by row group"),
    (
        "bare torch loop",
        "an epoch of the precise network: time",
        "realeasy, paper: an epoch over that of a bare torch loop",
    ),
    ("", "of the real-time one: time", "realeasy-rt, paper: an epoch over that of a bare torch loop"),
)
# Rows that are trueup's speed over the other's; all else is its time, or its error.
SPEEDS = {f"replay / raw mujoco.rollout, {threads} threads" for threads in (1, 2)}


def pages() -> Mapping[str, str]:
    """The page with this section as the results have it."""
    return {NAME: with_section((ROOT / "docs" / NAME).read_text(), section())}


def section() -> str:
    """The section as Markdown."""
    found = _result("acceptance")
    rows = {row["name"]: row for line in found["lines"] for row in line["rows"]}
    made = found["provenance"]
    return TEXT.format(
        threads=2,
        date=made["created"][:10],
        commit=made["git"],
        beside=_beside(rows),
        published=_published(rows),
    )


def _result(name: str) -> Mapping[str, Any]:
    result: Mapping[str, Any] = json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())
    return result


def _beside(rows: Mapping[str, Any]) -> str:
    lines = [[other, task, _ratio(rows[name]["value"], name)] for other, task, name in BESIDE]
    mcap = next(row for name, row in rows.items() if name.startswith("import 500000 MCAP"))
    lines.append(["rosbags", "500,000 joint states of an MCAP file: time", f"{mcap['value'] / mcap['limit']:.2f}"])
    return table(["other", "task", "ratio"], lines, left=2)


def _ratio(value: float, row: str) -> str:
    """Of speeds the other way round, so that below 1 trueup is quicker."""
    ratio = 1 / value if row in SPEEDS else value
    return f"{ratio:.3f}" if abs(ratio - 1) < 0.005 else f"{ratio:.2f}"


def _published(rows: Mapping[str, Any]) -> str:
    pace = rows["49 parameters of 12 joints, 20 s, 2 threads"]["value"]
    arm = [rows[f"SO-101, test: {what}"]["value"] for what in ("stock", "position RMSE")]
    step = rows["Stream.step_vector, p50"]["value"]
    in_loop = _result("streaming")["loop"]["step"]["p50_us"]
    thesis = rows["robot 0, auto: error cut, worst joint"]["value"]
    lines = [
        [
            "PACE",
            "49 numbers of 12 joints, chirp of 20 s: 2 h 15 min on an RTX 3080",
            f"{pace:.0f} s on two cores, a simulated robot of the same size",
        ],
        [
            "AnchorBench",
            "SO-101, position RMSE 0.0450 to 0.0156 rad; 42 motions fitted, 8 held out",
            f"{arm[0]:.4f} to {arm[1]:.4f} rad; 43 of these motions: 33 fitted, 4 for the choice, 6 held out",
        ],
        [
            "Realeasy",
            "a step of the real-time network: less than 390 us (V)",
            f"{step:.0f} us in a row of steps, {in_loop:.0f} us (median) in a loop at 1 kHz ([steps](step-times.md))",
        ],
        [
            "ES thesis",
            "error of the worst joint cut by 81.3 % (Table 3.6), a real robot",
            f"by {thesis:.1f} %, a virtual one ([the thesis's experiment](thesis.md))",
        ],
    ]
    return table(["who", "published", "here"], lines, left=3)
