"""The figures in docs/how-to-choose.md, from the stored results; its text is written by hand."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figures import stored
from benchmarks.pages.augment_cells import cut, factor
from benchmarks.pages.augment_data import BASELINES, PRECISE, REAL_TIME
from benchmarks.pages.compensation import cell
from benchmarks.pages.markdown import with_rows
from benchmarks.policy_going_on import table as tabulated
from trueup.core.augment_result import ALL_JOINTS, AugmentResult
from trueup.measure import bootstrap_interval

ROOT = Path(__file__).resolve().parents[2]
NAME = "how-to-choose.md"
MINUS = "\N{MINUS SIGN}"
SOLVERS = ("solver", "numbers", "fitted", "held out", "evaluations", "CPU s")
FRICTION = ("friction", "parameters", "val [mrad]", "test [mrad]")
CORRECTIONS = (
    "method",
    "several joints, all",
    "least",
    "straight lines, all",
    "least, straight lines",
    "training [min]",
)
ARM = ("on the SO-101", "mean square error, times smaller")
ROBOTS = {"kickbot_a": "KickBotA, trained on", "kickbot_b": "KickBotB, never seen", "dancebot": "DanceBot, never seen"}
SERVOS = ("for servos", *ROBOTS.values())
TRAINED, NEVER = ("0", "3"), ("1.5", "3.5")
PAYLOADS = tuple(sorted((*TRAINED, *NEVER), key=float))
COMPENSATION = ("mean error [mrad]", *(f"{kg} kg{', never trained' if kg in NEVER else ''}" for kg in PAYLOADS))
WAYS = ("operator on stock", "unseen individual [mrad]", "val [mrad]", "processor time [s]")
ROBOT = ("payload", "without [mrad]", "with [mrad]", "difference [mrad]", "roughness")
POLICIES = ("algorithm", "median distance [cm], by seed", "reward", "min of one core", "TQC minus this")
GOING_ON = (
    "went on in",
    "randomized",
    "distance [cm]",
    "difference, over goals",
    "over goals and robots",
    "within 5 cm",
)
ENGINES = ("a Panda", "DART's speed, of MuJoCo's", "largest difference [rad]")
COMPENSATED = {
    "pd": "stock simulator",
    "operator-on-stock": "`operator`, on stock",
    "mlp-on-stock": "`mlp`, on stock",
    "transformer-on-stock": "`transformer`, on stock",
    "identified": "identified simulator",
    "operator": "`operator`, on identified",
    "mlp": "`mlp`, on identified",
    "transformer": "`transformer`, on identified",
    "identified, base sensed": "identified, base sensed",
    "operator-sensed": "`operator`, on that",
}
Rows = Iterator[Sequence[str]]


def pages() -> Mapping[str, str]:
    """The page with its figures as the results have them."""
    text = (ROOT / "docs" / NAME).read_text()
    learned = _result("augment")
    for heads, rows in {
        SOLVERS: _solvers(_result("thesis")["robots"][0]["searches"]),
        FRICTION: _friction(_result("real_robots")["friction"]),
        CORRECTIONS: _corrections(AugmentResult.from_json(learned["lab"]), learned["training"]),
        ARM: _arm(AugmentResult.from_json(learned["so101"])),
        SERVOS: _servos(_result("sat")["cuts"]),
        COMPENSATION: _compensation(_result("compensation")["tables"]),
        WAYS: _ways(_result("compensation_ways")),
        ROBOT: _robot(_result("compensation_robot")),
        POLICIES: _policies(_result("policy_algorithms")["algorithms"]),
        GOING_ON: _going_on(tabulated(_result("policy_going_on")["policies"])),
        ENGINES: _engines({row["name"]: row["value"] for row in stored()["engines"]["rows"]}),
    }.items():
        text = with_rows(text, heads, rows)
    return {NAME: text}


def _result(name: str) -> Mapping[str, Any]:
    result: Mapping[str, Any] = json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())
    return result


def _signed(value: float, digits: int) -> str:
    return f"{value:+.{digits}f}".replace("-", MINUS)


def _difference(ends: Sequence[float], factor: float, digits: int) -> str:
    value, low, high = (_signed(factor * item, digits) for item in ends)
    return f"{value} [{low}, {high}]"


def _solvers(searches: Mapping[str, Any]) -> Rows:
    for name, own in searches.items():
        joints = own["joints"].values()
        solver, _, rest = name.partition(", ")
        yield (
            f"`{solver}`{', ' if rest else ''}{rest}",
            f"{own['parameters']}",
            f"{min(joint['cut_percent'] for joint in joints):.1f} %",
            f"{min(joint['held_out_cut_percent'] for joint in joints):.1f} %",
            f"{own['solver']['evaluations']}",
            f"{own['solver']['cpu_seconds']:.0f}",
        )


def _friction(models: Sequence[Mapping[str, Any]]) -> Rows:
    for own in models:
        val, test = own["splits"]["val"], own["splits"]["test"]
        ends = f"{1e3 * test['value']:.1f} [{1e3 * test['low']:.1f}, {1e3 * test['high']:.1f}]"
        yield own["name"], str(own["parameters"]), f"{1e3 * val['value']:.1f}", ends


def _corrections(lab: AugmentResult, training: Mapping[str, Any]) -> Rows:
    for name in (PRECISE, REAL_TIME, *BASELINES):
        model = lab.model(name)
        cells = []
        for test in ("multi-joint", "cartesian"):
            cuts = model.cuts[test]["torque"]
            least = min(lab.scored_joints, key=lambda joint, cuts=cuts: cuts[joint].factor.value)  # type: ignore[misc]
            said = cut(cuts[least], off=model.is_off("torque", least))
            cells += [factor(cuts[ALL_JOINTS].factor), f"{said} {least}"]
        yield f"`{name}`", *cells, f"{training[name]['seconds'] / 60:.0f}"


def _arm(arm: AugmentResult) -> Rows:
    for model in arm.models:
        item = model.cuts[""]["position"][ALL_JOINTS]
        yield f"`{model.name}`", factor(item.factor, item.verdict)


def _servos(cuts: Mapping[str, Any]) -> Rows:
    about = {"sat": "`sat`", "recurrent": "one LSTM layer for a servo", "whole": "`sat` of the whole robot"}
    for name, title in about.items():
        found = (cuts[robot].get(name) for robot in ROBOTS)
        yield title, *(_percent(own["position"]["mae"]) if own else "has other joints" for own in found)


def _percent(item: Mapping[str, float]) -> str:
    return f"{100 * item['value']:.0f} % [{100 * item['low']:.0f}, {100 * item['high']:.0f}]"


def _compensation(tables: Mapping[str, Any]) -> Rows:
    for name, title in COMPENSATED.items():
        tests = (tables[name]["test-unseen-payload" if kg in NEVER else "test"][kg] for kg in PAYLOADS)
        yield title, *(cell(1e3 * np.array(own["mae"]), 1) for own in tests)


def _ways(result: Mapping[str, Any]) -> Rows:
    yield "not trained", _over_payloads(result["none"]), "", ""
    for way, own in result["ways"].items():
        yield f"`{way}`", _over_payloads(own["tables"]), f"{1e3 * own['val']:.1f}", f"{own['cpu_seconds']:.0f}"


def _over_payloads(tables: Mapping[str, Any]) -> str:
    """Mean over the trained payloads, motion by motion, with the interval over motions."""
    motions = 1e3 * np.mean([own["mae"][0] for own in tables["test"].values()], axis=0)
    low, high = bootstrap_interval(motions[:, None])
    return f"{motions.mean():.1f} [{low[0]:.1f}, {high[0]:.1f}]"


def _robot(result: Mapping[str, Any]) -> Rows:
    tests = next(iter(result["seeds"].values()))["tests"]
    for kg in PAYLOADS:
        own = tests["test-unseen-payload" if kg in NEVER else "test"]["payloads"][kg]["simulator"]
        error, rough = own["mae"], own["smoothness"]
        yield (
            f"{kg} kg{', never trained' if kg in NEVER else ''}",
            f"{1e3 * error['plain']:.1f}",
            f"{1e3 * error['compensated']:.1f}",
            _difference(error["difference"], 1e3, 1),
            f"{rough['compensated'] / rough['plain']:.1f} times",
        )


def _policies(found: Mapping[str, Any]) -> Rows:
    for name in ("tqc", "sac", "td3", "ddpg"):
        own = found[name]
        yield (
            f"`{name}`",
            f"{100 * own['median']:.1f} ({', '.join(f'{100 * one:.1f}' for one in own['by_seed'])})",
            f"{own['reward']:.3f}".replace("-", MINUS),
            f"{own['minutes']:.1f}",
            _difference(own["tqc_minus_seeds"], 1, 3) if "tqc_minus_seeds" in own else "",
        )


def _going_on(found: Mapping[str, Any]) -> Rows:
    simulators = {"stock": "the simulator as it comes", "identified": "the identified one"}
    draws = {"none": "nothing", "thesis": "the thesis's", "posterior": "its posterior"}
    for simulator, by_draws in found.items():
        for drawn, places in by_draws.items():
            own = places["own robot"]
            first = (simulator, drawn) == ("stock", "none")
            yield (
                simulators[simulator],
                draws[drawn],
                f"{100 * own['mean']:.2f}",
                *(
                    ("", "")
                    if first
                    else (_difference(own[key], 100, 2) for key in ("minus_stock", "minus_stock_robots"))
                ),
                f"{100 * own['success']:.1f} %",
            )


def _engines(rows: Mapping[str, float]) -> Rows:
    for what in (
        "no friction, 1 at once",
        "no friction, 32 at once",
        "with friction, 1 at once",
        "with friction, 32 at once",
    ):
        speed, apart = rows[f"panda, {what}, DART / MuJoCo"], rows[f"panda, {what}, largest difference"]
        yield what.replace("with", "dry").replace(", 1 at", ", one motion at"), f"{100 * speed:.0f} %", f"{apart:.1g}"
