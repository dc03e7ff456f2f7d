"""Result files, traces, and the page that is made of them."""

from __future__ import annotations

import contextlib
import functools
import json
import random
import re
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from attack.harness import Parser, Unsound
from attack.mutations import mutate
from report.run_folders import (
    World,
    add_identification,
    make_analysis,
    make_fit,
    make_gap,
    make_ladder,
    make_quality,
    make_traces,
    simulate,
)
from report.test_report_augment import evaluation
from report.test_report_engines import PLANE, TREND
from report.test_report_robustness import RESULT
from trueup.core.analysis import Analysis
from trueup.core.atomic import file_hash
from trueup.core.attribution import Attribution
from trueup.core.augment_result import AugmentResult
from trueup.core.close_result import CLOSE_NAME, STEPS, CloseResult, Step
from trueup.core.design_result import DESIGN_NAME, DesignResult, Foreseen
from trueup.core.engines import EngineComparison
from trueup.core.fit_result import FitResult
from trueup.core.fleet_result import FLEET_NAME, FleetParameter, FleetResult, FleetUnit, UnitValue
from trueup.core.graybox_result import BlockFit, Coefficient, GrayboxResult, JointFit, Score
from trueup.core.quality import Quality
from trueup.core.results import Estimate, GapResult, Ladder
from trueup.core.robustness_result import CELLS_NAME, ROBUSTNESS_NAME, Cell, Cells, RobustnessResult
from trueup.core.step_times import StepTimes
from trueup.core.traces import TraceSet
from trueup.identify.experiments.findings import ExperimentResult, Finding, Rejection
from trueup.identify.regression.inverse_dynamics_result import (
    BaseParameter,
    BodyEstimate,
    InverseDynamicsFit,
    JointTerms,
)
from trueup.report import build_report

TIMES = StepTimes(9, 1.0, 2.0, 3.0, 4.0, ((1.0, 2.0, 4), (2.0, 4.0, 5)), 1000.0, 0, "a machine", "abc")
NUMBER = Estimate(0.1, "Nm", 0.05, 0.2)


@functools.cache
def _world() -> World:
    joints = ("pan", "lift", "grip")
    names, splits = ("a", "b", "c"), ("train", "val", "test")
    return simulate(World(joints=joints, scored=joints[:2], names=names, splits=splits, samples=40, max_points=100))


@functools.cache
def _gap() -> GapResult:
    """Positions alone: a small file is attacked more often in the same time."""
    gap = make_gap(_world())
    runs = {label: {split: _positions(item) for split, item in splits.items()} for label, splits in gap.runs.items()}
    groups = {
        name: {value: {label: _positions(item) for label, item in runs.items()} for value, runs in values.items()}
        for name, values in gap.groups.items()
    }
    episodes = {
        label: {name: _positions(item) for name, item in items.items()} for label, items in gap.episodes.items()
    }
    return replace(gap, runs=runs, groups=groups, episodes=episodes)


def _positions(signals: Any) -> Any:
    return {"position": {"rmse": signals["position"]["rmse"]}}


def make_gap_file(folder: Path) -> None:
    """Three motions."""
    _gap().save(folder / "gap.json")


def make_ladder_file(folder: Path) -> None:
    """Three rungs."""
    make_ladder(_world(), _gap()).save(folder / "ladder.json")


def make_identification(folder: Path) -> None:
    """fit.json, explain.json and graybox.json."""
    add_identification(folder, make_fit(_world().joints, "at-bound"), _world().joints)


def make_augment(folder: Path) -> None:
    """One network, its steps timed."""
    found = evaluation(_world())
    replace(found, models=tuple(replace(item, latency=TIMES) for item in found.models)).save(folder / "augment.json")


def make_robustness(folder: Path) -> None:
    """Two datasets and a perturbation, and a cell that they could be made of."""
    RESULT.save(folder / ROBUSTNESS_NAME)
    Cells("abc", {"walk: as it is": Cell({"a": (0.1, 0.2, 0.05, 0.1)}, {"b": "it diverged"})}).save(folder / CELLS_NAME)


def make_engines(folder: Path) -> None:
    """Trends and a plane in which a motion was repeated."""
    world = _world()
    plane = replace(
        PLANE,
        joints=world.joints[:2],
        paths=dict.fromkeys(("a", "b"), PLANE.paths["chirp_sweep"]),
        payloads={"a": "0.0", "b": "1.0"},
        conditions={"a": "stand", "b": "walk"},
        executed={"a": "chirp", "b": "chirp"},
    )
    trends = {label: {"position": {"rmse": {"": TREND, "pan": TREND}}} for label in world.runs}
    EngineComparison(trends, plane).save(folder / "engines.json")


def make_report(folder: Path) -> None:
    """All that a page can be made of."""
    make_gap_file(folder)
    make_ladder_file(folder)
    make_identification(folder)
    make_augment(folder)
    make_robustness(folder)
    make_engines(folder)
    make_analysis(_world()).save(folder / "analysis.json")
    make_quality(_world()).save(folder / "quality.json")
    make_traces(_world()).save(folder)


def make_experiment(folder: Path) -> None:
    """One joint, one attempt, one that failed."""
    ExperimentResult(
        "breakaway",
        {"pan": {"positive": Finding(NUMBER, "it breaks away"), "negative": Finding(NUMBER, "not", "censored")}},
        {"pan": ("another joint moved",)},
        ({"episode": "a", "torque": 0.1},),
        (Rejection("b", "pan", "it fell"),),
        {"speed": 0.01},
        {"seed": 0},
    ).save(folder / "experiment.json")


def make_inverse_dynamics(folder: Path) -> None:
    """One parameter, one body, one joint."""
    InverseDynamicsFit(
        base=(BaseParameter(**_filled(BaseParameter)),),
        structural_rank=1,
        rank=1,
        condition=2.0,
        rmse={"pan": 0.1},
        rmse_consistent={"pan": 0.1},
        bodies={"arm": BodyEstimate(**_filled(BodyEstimate))},
        joints={"pan": JointTerms(**_filled(JointTerms))},
        largest_deviation=0.1,
        interval_method="hac",
        samples=10,
        notes=("a note",),
    ).save(folder / "inverse_dynamics.json")


def _filled(kind: type) -> dict[str, Any]:
    """A value for each field that must be given."""
    values = {"str": "x", "float": 0.1}
    return {
        item.name: values.get(str(item.type)) or (0.1,) * str(item.type).count("float")
        for item in fields(kind)
        if item.default is MISSING
    }


def make_graybox(folder: Path) -> None:
    """One joint, one block."""
    score = Score(NUMBER, NUMBER, 3, 100)
    block = BlockFit(
        "pd", "", {"K_p": Coefficient("Nm/rad", 40.0, 30.0, 50.0, 2.0)}, {"train": score}, {"train": {"0": score}}
    )
    result = GrayboxResult({"pan": JointFit((block,), "hac", 3, 100)}, {"delay_s": 0.01}, ("a note",), {"seed": 0})
    result.save(folder / "graybox.json")


def make_latency(folder: Path) -> None:
    """Times of a loop."""
    TIMES.save(folder / "latency.json")


def make_design(folder: Path) -> None:
    rows = (
        Foreseen("kp[elbow]", 31.0, "Nm/rad", "log", 0.4, 0.1, 0.2),
        Foreseen("delay_s", 0.02, "s", "linear", 0.01, 0.001, None),
    )
    DesignResult(rows, {"trueup": "1"}).save(folder / DESIGN_NAME)


def make_close(folder: Path) -> None:
    """One that did all steps, and one of them too late."""
    steps = tuple(Step(name, "done", 1.5, f"{name} was done", "abc") for name in STEPS[:-1])
    last = Step("augment", "cut short", 9.0, "the time was up")
    networks = {"mujoco/fitted+net": "networks/net"}
    CloseResult((*steps, last), "augment", 60.0, networks, {"robot": "abc"}, 2.0, {"trueup": "1"}).save(
        folder / CLOSE_NAME
    )


def make_fleet(folder: Path) -> None:
    """A unit that was fitted, one that failed, and a parameter."""
    units = (
        FleetUnit("one", "one", "ok", 3, 1.5, "", {"stock": {"test": 0.1}}, {"damping[a]": UnitValue(1.0, 0.9, 1.1, "yes")}),
        FleetUnit("other", "other", "failed", reason="no motion"),
    )  # fmt: skip
    parameter = FleetParameter("damping[a]", "Nm s/rad", "damping", True, 1, 1.0, 0.9, 1.1, None, 0.1, 0.05, ("one",))
    FleetResult(units, (parameter,), "position [rad]", "identify", {"trueup": "1"}).save(folder / FLEET_NAME)


def reader(kind: Any, name: str) -> Callable[[Path], Iterator[Exception]]:
    """What was read can be written again and says the same."""

    def read(folder: Path) -> Iterator[Exception]:
        found = kind.load(folder / name)
        if hasattr(found, "save"):
            found.save(folder / "again.json")
            again = kind.load(folder / "again.json")
            again.save(folder / "once-more.json")
            if (folder / "again.json").read_bytes() != (folder / "once-more.json").read_bytes():
                raise Unsound("what was written again is not what was read")
        yield from ()

    return read


def read_traces(folder: Path) -> Iterator[Exception]:
    """There and back."""
    found = TraceSet.load(folder)
    found.save(folder / "again")
    again = TraceSet.load(folder / "again")
    for name, episode in found.episodes.items():
        for left, right in zip(episode.traces, again.episodes[name].traces, strict=True):
            for label, curve in left.curves.items():
                if not np.array_equal(curve, right.curves[label], equal_nan=True):
                    raise Unsound(f"{label} of {name} is not what was read")
    yield from ()


def change_traces(folder: Path, rng: random.Random) -> str:
    """What lies behind the hash."""
    said = mutate(folder, rng)
    index, curves = folder / "traces.json", folder / "traces.npz"
    with contextlib.suppress(ValueError, RecursionError):
        if index.is_file() and curves.is_file():
            tree = json.loads(index.read_bytes())
            if isinstance(tree, dict):
                index.write_text(json.dumps({**tree, "curves": file_hash(curves)}))
    return f"{said}, hash made anew"


class _Page(HTMLParser):
    """What a browser would act upon."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.wrong: list[str] = []
        self.data: list[str] = []
        self._kind = ""

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._kind = dict(attributes).get("type") or "" if tag == "script" else ""
        for name, value in attributes:
            if name.startswith("on") or (name in ("src", "href") and not (value or "").startswith(("#", "data:"))):
                self.wrong.append(f"<{tag} {name}={value!r}>")

    def handle_data(self, data: str) -> None:
        if self._kind == "application/json" and data.strip():
            json.loads(data)
        self._kind = ""


_ALLOWED = {
    "html",
    "wbr",
    "head",
    "meta",
    "title",
    "style",
    "script",
    "body",
    "header",
    "nav",
    "a",
    "main",
    "section",
    "h1",
    "h2",
    "h3",
    "h4",
    "p",
    "div",
    "span",
    "table",
    "thead",
    "tbody",
    "tr",
    "th",
    "td",
    "ul",
    "ol",
    "li",
    "button",
    "select",
    "option",
    "label",
    "details",
    "summary",
    "pre",
    "code",
    "footer",
    "strong",
    "em",
    "small",
    "dl",
    "dt",
    "dd",
    "figure",
    "figcaption",
    "input",
    "svg",
    "path",
    "line",
    "rect",
    "circle",
    "g",
    "text",
    "caption",
    "b",
    "i",
    "sub",
    "sup",
    "abbr",
    "br",
    "hr",
    "colgroup",
    "col",
    "noscript",
    "fieldset",
    "legend",
    "optgroup",
    "link",
}


def read_report(folder: Path) -> Iterator[Exception]:
    """A page that is whole, and on which no name is markup."""
    page = build_report(folder)
    if not page.rstrip().endswith("</html>"):
        raise Unsound("the page is not whole")
    page.encode()
    start = page.index('id="library"')
    page = page[:start] + page[page.index("</script>", start) :]
    seen = _Page()
    seen.feed(page)
    strange = set(seen.tags) - _ALLOWED
    if seen.wrong or strange or "<script>alert" in page:
        raise Unsound(f"names became markup: {seen.wrong[:3]} {sorted(strange)}")
    yield from ()


_MARKUP = (
    "</script><script>alert(1)</script>", "<script>alert(1)</script>", "<img src=x onerror=alert(1)>", '"><b onclick=x>',
    "' onmouseover='alert(1)", "{{ 7 * 7 }}", "<!--", "]]>", "</style>", "</title><script>alert(1)</script>",
    "javascript:alert(1)", "&lt;script&gt;", "\u2028", "__proto__", "constructor", "</td>", "<svg/onload=alert(1)>", "%3Cscript%3E",
)  # fmt: skip


def rename(folder: Path, rng: random.Random) -> str:
    """Names, units and notes that are markup, the same one everywhere that it stands, or a change of one file only."""
    if rng.random() < 0.3:
        return mutate(folder, rng)
    texts = {path: path.read_text() for path in sorted(folder.glob("*.json"))}
    words = sorted({word for text in texts.values() for word in re.findall(r'"((?:[^"\\]|\\.)+)"', text)})
    said = []
    for _ in range(rng.choice((1, 1, 2, 4))):
        old, new = rng.choice(words), rng.choice(_MARKUP)
        quoted = json.dumps(rng.choice((new, old + new, new + old)), ensure_ascii=False)
        for path, text in texts.items():
            texts[path] = text.replace(f'"{old}"', quoted)
        said.append(f"{old} is {quoted}")
    for path, text in texts.items():
        path.write_text(text)
    return ", ".join(said)


PARSERS = [
    Parser("gap.json", make_gap_file, reader(GapResult, "gap.json")),
    Parser("ladder.json", make_ladder_file, reader(Ladder, "ladder.json")),
    Parser(
        "fit.json",
        lambda folder: make_fit(_world().joints, "at-bound").save(folder / "fit.json"),
        reader(FitResult, "fit.json"),
    ),
    Parser(
        "explain.json",
        lambda folder: _only(make_identification, folder, "explain.json"),
        reader(Attribution, "explain.json"),
    ),
    Parser(
        "graybox.json of a report",
        lambda folder: _only(make_identification, folder, "graybox.json"),
        reader(GrayboxResult, "graybox.json"),
    ),
    Parser("graybox.json", make_graybox, reader(GrayboxResult, "graybox.json")),
    Parser("inverse dynamics", make_inverse_dynamics, reader(InverseDynamicsFit, "inverse_dynamics.json")),
    Parser("experiment", make_experiment, reader(ExperimentResult, "experiment.json")),
    Parser(
        "quality.json",
        lambda folder: make_quality(_world()).save(folder / "quality.json"),
        reader(Quality, "quality.json"),
    ),
    Parser(
        "analysis.json",
        lambda folder: make_analysis(_world()).save(folder / "analysis.json"),
        reader(Analysis, "analysis.json"),
    ),
    Parser("engines.json", make_engines, reader(EngineComparison, "engines.json")),
    Parser("augment.json", make_augment, reader(AugmentResult, "augment.json")),
    Parser(
        ROBUSTNESS_NAME,
        lambda folder: _only(make_robustness, folder, ROBUSTNESS_NAME),
        reader(RobustnessResult, ROBUSTNESS_NAME),
    ),
    Parser(CELLS_NAME, lambda folder: _only(make_robustness, folder, CELLS_NAME), reader(Cells, CELLS_NAME)),
    Parser(CLOSE_NAME, make_close, reader(CloseResult, CLOSE_NAME)),
    Parser(DESIGN_NAME, make_design, reader(DesignResult, DESIGN_NAME)),
    Parser(FLEET_NAME, make_fleet, reader(FleetResult, FLEET_NAME)),
    Parser("latency.json", make_latency, reader(StepTimes, "latency.json")),
    Parser("traces", lambda folder: make_traces(_world()).save(folder), read_traces, change_traces),
    Parser("report", make_report, read_report, rename),
]


def _only(make: Callable[[Path], None], folder: Path, name: str) -> None:
    """One of the files that `make` writes."""
    make(folder)
    for path in folder.iterdir():
        if path.name != name:
            path.unlink()
