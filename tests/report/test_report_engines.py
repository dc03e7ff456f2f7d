"""The section on engines and payloads."""

import json
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest

from report.run_folders import World, make_gap, simulate
from report.test_report_builder import mutate
from trueup.core.engines import MEASURED, EngineComparison, Envelope, JointPlane, Trend
from trueup.core.results import Estimate, MetricResult
from trueup.errors import TrueupError
from trueup.report import build_report
from trueup.report.chooser import Variant
from trueup.report.engine_figures import envelope_figure, path_figure, payload_figure
from trueup.report.folder import RunFolder
from trueup.report.palette import run_styles
from trueup.report.sections.engines import engines_section

RUNS = ("mujoco/stock", "dart/stock")
PLANE = JointPlane(
    joints=("shoulder_pan", "elbow_flex"),
    unit="rad",
    center=(0.0, 0.1),
    axes=((0.8, 0.6), (-0.6, 0.8)),
    share=(0.7, 0.3),
    envelopes={
        source: {"": Envelope((0.1, 0.0), (4.0, 1.0, 2.0), 900), "0.0": Envelope((0.0, 0.0), (1.0, 0.0, 1.0), 500)}
        for source in (MEASURED, *RUNS)
    },
    paths={"chirp_sweep": {source: [(0.0, 0.0), (1.0, 0.5), (0.2, 0.1)] for source in (MEASURED, *RUNS)}},
    payloads={"chirp_sweep": "0.0"},
)
TREND = Trend(Estimate(0.2, "rad/kg", 0.1, 0.3), 0.05, 8, "grows")


@pytest.fixture(scope="module")
def run():
    world = simulate(World(runs=RUNS))
    gap = make_gap(world)
    # What the figures of the run folder lack: lags, some of them negative.
    for splits in (*gap.runs.values(), *gap.groups["payload_kg"].values()):
        for metrics in splits.values():
            lag = {joint: Estimate(-0.01, "s", -0.02, 0.0) for joint in gap.joints}
            metrics["position"]["phase_lag"] = MetricResult(Estimate(-0.01, "s"), lag, 8)
    trends = {
        label: {"position": {"rmse": {"": TREND, "elbow_flex": replace(TREND, verdict="falls")}}} for label in RUNS
    }
    return RunFolder(gap, engines=EngineComparison(trends, PLANE))


def leaves(tree):
    return [tree] if isinstance(tree, Variant) else [leaf for child in tree.values() for leaf in leaves(child)]


def test_there_is_no_section_without_a_comparison(run, run_folder):
    assert engines_section(replace(run, engines=None)) is None
    assert engines_section(RunFolder.load(run_folder)) is None


def test_every_figure_is_valid_plotly(run):
    section = engines_section(run)
    assert all(section.context.values())
    figures = [
        figure
        for chooser in section.context.values()
        for leaf in leaves(chooser.variants)
        for figure in leaf.figures.values()
    ]
    assert len(figures) > 10
    for figure in figures:
        go.Figure(figure)
        json.dumps(figure, allow_nan=False)


def test_engines_are_compared_joint_by_joint_and_payload_by_payload(run):
    chooser = engines_section(run).context["engines"]
    table = chooser.shown.tables["engines"]
    assert list(table.columns) == ["Joint", *run.simulators]
    assert [row.head for row in table.rows] == [*run.gap.joints, "Mean of scored joints"]
    assert [value for value, _ in chooser.menus[2].options] == ["", "0.0", "0.25"]
    loaded = chooser.variants["position"]["rmse"]["0.25"].tables["engines"]
    result = run.gap.groups["payload_kg"]["0.25"]["dart/stock"]["position"]["rmse"]
    column = run.simulators.index("dart/stock")
    assert loaded.rows[-1].cells[column].text.startswith(f"{result.total.value:.4f}"[:5])
    lags = chooser.variants["position"]["phase_lag"][""].figures["engines"]
    assert "rangemode" not in lags["layout"]["xaxis"]


def test_one_engine_has_no_table_of_engines(run):
    gap = replace(run.gap, runs={label: run.gap.runs[label] for label in ("mujoco/stock", "command")})
    context = engines_section(replace(run, gap=gap)).context
    assert context["engines"] is None
    assert context["payloads"] is not None


def test_the_slope_stands_below_the_payloads(run):
    chooser = engines_section(run).context["payloads"]
    rows = {row.head: row.cells for row in chooser.shown.tables["payloads"].rows}
    assert list(rows) == ["0 kg", "0.25 kg", "Change per kg", "With the payload it"]
    assert [cell.text for cell in rows["With the payload it"]][1:] == ["grows", "grows"]
    flex = chooser.variants["position"]["rmse"]["elbow_flex"].tables["payloads"]
    assert "falls" in {cell.text for cell in flex.rows[-1].cells}
    # A payload that is no number cannot be an axis.
    groups = {"payload_kg": {"heavy": {}, "light": {}}}
    assert engines_section(replace(run, gap=replace(run.gap, groups=groups))).context["payloads"] is None


def test_points_carry_their_whiskers_and_lines_their_slope():
    styles = run_styles(RUNS)
    points = {label: {0.0: Estimate(1.0, "rad", 0.8, 1.3), 2.0: Estimate(2.0, "rad", 1.5, 2.5)} for label in RUNS}
    figure = payload_figure(points, {"dart/stock": replace(TREND, at_zero=1.0)}, styles, title="error")
    marks = [item for item in figure["data"] if item["mode"] == "markers"]
    lines = [item for item in figure["data"] if item["mode"] == "lines"]
    assert [item["customdata"] for item in marks] == [[0.0, 2.0]] * 2
    assert marks[0]["x"] != marks[1]["x"]
    assert marks[0]["error_y"]["array"] == pytest.approx([0.3, 0.5])
    assert [item["y"] for item in lines] == [pytest.approx([1.0, 1.4])]


def test_ellipses_are_two_standard_deviations_wide():
    figure = envelope_figure(PLANE, "", run_styles(RUNS))
    outline = next(item for item in figure["data"] if item["mode"] == "lines")
    points = np.column_stack([outline["x"], outline["y"]]) - [0.1, 0.0]
    distance = np.einsum("ij,jk,ik->i", points, np.linalg.inv([[4.0, 1.0], [1.0, 2.0]]), points)
    np.testing.assert_allclose(distance, 4.0, rtol=1e-3)
    assert not envelope_figure(PLANE, "7", run_styles(RUNS))["data"]


def test_a_path_shows_what_was_measured_below_the_runs():
    figure = path_figure(PLANE, "chirp_sweep", run_styles(RUNS))
    assert figure["data"][0]["name"] == MEASURED
    assert len(figure["data"]) == 3
    assert "70 % of the variance" in figure["layout"]["xaxis"]["title"]["text"]


def test_the_page_is_built_with_it(run, tmp_path):
    run.gap.save(tmp_path / "gap.json")
    run.engines.save(tmp_path / "engines.json")
    html = build_report(tmp_path)
    assert "Engines and payloads" in html
    assert html == build_report(tmp_path)


def test_changed_files_give_a_page_or_a_clear_error(run, tmp_path):
    run.gap.save(tmp_path / "gap.json")
    run.engines.save(tmp_path / "engines.json")
    whole, rng = (tmp_path / "engines.json").read_text(), np.random.default_rng(0)
    errors = []
    for _ in range(40):
        (tmp_path / "engines.json").write_text(json.dumps(mutate(json.loads(whole), rng)))
        try:
            assert build_report(tmp_path).endswith("</html>")
        except TrueupError as error:
            errors.append(str(error))
    assert len(errors) > 5
    assert all("engines" in text for text in errors)
