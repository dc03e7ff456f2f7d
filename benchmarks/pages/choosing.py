"""The figures in docs/how-to-choose.md, from the stored results; its text is written by hand."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figures import stored
from benchmarks.pages.augment_cells import short
from benchmarks.pages.augment_data import BASELINES, PRECISE, REAL_TIME
from benchmarks.pages.markdown import with_rows
from trueup.core.augment_result import ALL_JOINTS, AugmentResult

ROOT = Path(__file__).resolve().parents[2]
NAME = "how-to-choose.md"
SOLVERS = ("solver", "held out", "CPU s")
CORRECTIONS = ("method", "several joints", "straight lines, never trained", "training [min]")
PAYLOADS = ("0", "3")
COMPENSATION = ("mean error [mrad]", *(f"{kg} kg" for kg in PAYLOADS))
POLICIES = ("algorithm", "median distance [cm], by seed", "min of one core")
ENGINES = ("DART's speed, of MuJoCo's (Panda)", "one motion", "32 at once")
COMPENSATED = {
    "pd": "stock simulator",
    "operator-on-stock": "`operator`, on stock",
    "identified": "identified simulator",
    "operator": "`operator`, on identified",
    "mlp": "`mlp`, on identified",
}
Rows = Iterator[Sequence[str]]


def pages() -> Mapping[str, str]:
    """The page with its figures as the results have them."""
    text = (ROOT / "docs" / NAME).read_text()
    learned = _result("augment")
    for heads, rows in {
        SOLVERS: _solvers(_result("thesis")["robots"][0]["searches"]),
        CORRECTIONS: _corrections(AugmentResult.from_json(learned["lab"]), learned["training"]),
        COMPENSATION: _compensation(_result("compensation")["tables"]),
        POLICIES: _policies(_result("policy_algorithms")["algorithms"]),
        ENGINES: _engines({row["name"]: row["value"] for row in stored()["engines"]["rows"]}),
    }.items():
        text = with_rows(text, heads, rows)
    return {NAME: text}


def _result(name: str) -> Mapping[str, Any]:
    result: Mapping[str, Any] = json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())
    return result


def _solvers(searches: Mapping[str, Any]) -> Rows:
    for name, own in searches.items():
        joints = own["joints"].values()
        solver, _, rest = name.partition(", ")
        yield (
            f"`{solver}`{', ' if rest else ''}{rest}",
            f"{min(joint['held_out_cut_percent'] for joint in joints):.1f} %",
            f"{own['solver']['cpu_seconds']:.0f}",
        )


def _corrections(lab: AugmentResult, training: Mapping[str, Any]) -> Rows:
    for name in (PRECISE, REAL_TIME, *BASELINES):
        cuts = (lab.model(name).cuts[test]["torque"][ALL_JOINTS] for test in ("multi-joint", "cartesian"))
        yield f"`{name}`", *(short(own.factor.value) for own in cuts), f"{training[name]['seconds'] / 60:.0f}"


def _compensation(tables: Mapping[str, Any]) -> Rows:
    for name, title in COMPENSATED.items():
        tests = (tables[name]["test"][kg] for kg in PAYLOADS)
        yield title, *(f"{1e3 * np.mean(own['mae']):.1f}" for own in tests)


def _policies(found: Mapping[str, Any]) -> Rows:
    for name in ("tqc", "sac", "td3", "ddpg"):
        own = found[name]
        yield (
            f"`{name}`",
            f"{100 * own['median']:.1f} ({', '.join(f'{100 * one:.1f}' for one in own['by_seed'])})",
            f"{own['minutes']:.1f}",
        )


def _engines(rows: Mapping[str, float]) -> Rows:
    for name, what in {"no friction": "no friction", "dry friction": "with friction"}.items():
        speeds = (rows[f"panda, {what}, {count} at once, DART / MuJoCo"] for count in (1, 32))
        yield name, *(f"{100 * speed:.0f} %" for speed in speeds)
