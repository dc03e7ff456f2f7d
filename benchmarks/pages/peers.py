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

Same task, data and {threads} cores, on {date} (`{commit}`, [details](acceptance.md)). Time of trueup over that of the
other, or error where it says so: below 1, trueup is better.

{beside}

The three fits end in the same minimum. scipy got batches of `mujoco.rollout`, written for this. A bare rollout reads no
time stamps.

Published numbers come from other machines, robots or motions, so there is no ratio:

{published}
"""

# What was compared, task, its row.
BESIDE = (
    ("`mujoco.sysid`", "identify 21 parameters, 4 x 2 s", "time, trueup / mujoco.sysid"),
    ("`mujoco.sysid`", "the same, median error", "median error, trueup / mujoco.sysid"),
    ("`scipy.optimize.least_squares`", "the same", "time, trueup / scipy"),
    ("`scipy.optimize.least_squares`", "the same, median error", "median error, trueup / scipy"),
    ("`mujoco.rollout`", "replay, 1 thread", "replay / raw mujoco.rollout, 1 threads"),
    ("`mujoco.rollout`", "replay, 2 threads", "replay / raw mujoco.rollout, 2 threads"),
    ("pyarrow", "write 1000 episodes", "write, over plain pyarrow"),
    ("pyarrow", "read them", "read, over plain pyarrow by row group"),
    ("torch", "epoch of `realeasy`", "realeasy, paper: an epoch over that of a bare torch loop"),
    ("torch", "epoch of `realeasy-rt`", "realeasy-rt, paper: an epoch over that of a bare torch loop"),
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
    lines.append(["rosbags", "500,000 MCAP joint states", f"{mcap['value'] / mcap['limit']:.2f}"])
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
    lines = [
        [
            "PACE",
            "49 parameters, 20 s chirp: 2 h 15 min on an RTX 3080",
            f"{pace:.0f} s on two cores, simulated robot",
        ],
        [
            "AnchorBench",
            "SO-101, RMSE 0.0450 to 0.0156 rad; 42 motions fitted, 8 held out",
            f"{arm[0]:.4f} to {arm[1]:.4f} rad; [33 fitted, 6 held out](real-robots.md)",
        ],
        [
            "Realeasy",
            "real-time step: less than 390 us (V)",
            f"{step:.0f} us in a row, {in_loop:.0f} us in a 1 kHz loop ([note](step-times.md))",
        ],
    ]
    return table(["who", "published", "here"], lines, left=3)
