"""The section on engines and payloads."""

import json
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest

from report.run_folders import World, make_gap, make_graybox, simulate
from report.test_report_builder import mutate
from trueup.core.engines import MEASURED, EngineComparison, Envelope, JointPlane, Shift, Trend
from trueup.core.graybox_result import HELD_OUT, GrayboxResult
from trueup.core.results import Estimate, MetricResult, PairedDifference
from trueup.errors import TrueupError
from trueup.report import build_report
from trueup.report.chooser import Chooser, Variant
from trueup.report.engine_figures import envelope_figure, path_figure, payload_figure, retrace_figure
from trueup.report.folder import RunFolder
from trueup.report.gap_words import findings
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
    paths={
        name: {source: [(0.0, 0.0), (1.0, 0.5), (0.2, 0.1)] for source in (MEASURED, *RUNS)}
        for name in ("chirp_sweep", "chirp_again", "other")
    },
    payloads={"chirp_sweep": "0.0", "chirp_again": "0.0", "other": "0.25"},
    conditions={"chirp_sweep": "stand", "chirp_again": "walk", "other": ""},
    executed={"chirp_sweep": "chirp", "chirp_again": "chirp", "other": "other"},
)
TREND = Trend(Estimate(0.2, "rad/kg", 0.1, 0.3), 0.05, 8, "grows", Estimate(0.02, "rad", 0.01, 0.03), "bends up")
SHIFT = Shift(
    by="condition",
    first="stand",
    second="walk",
    motions=5,
    path=Estimate(0.002, "rad", 0.001, 0.003),
    share=Estimate(0.01, "1", 0.005, 0.02),
    offset=Estimate(0.001, "rad", 0.0005, 0.002),
    lag=Estimate(0.002, "s", -0.001, 0.005),
    gaps={label: {"position.rmse": Estimate(0.001, "rad", -0.001, 0.003)} for label in RUNS},
)
LOADED = replace(SHIFT, by="payload_kg", first="0", second="0.25", share=Estimate(0.3, "1", 0.2, 0.4))
NEARER = PairedDifference(
    "mujoco/stock", "dart/stock", "all", "position", "rmse", Estimate(0.01, "rad", 0.005, 0.02), 0.3, "worse"
)


def graybox_of(joints, reductions):
    """A regression whose blocks lower the held-out error by these amounts, each with its interval."""
    tree, total, left = make_graybox(joints), [], 2.0
    for block, (value, low, high) in reductions.items():
        left -= value
        rmse = {"value": left, "low": 0.9 * left, "high": 1.1 * left, "unit": "Nm"}
        reduction = {"value": value, "low": low, "high": high, "unit": "Nm"}
        score = {"rmse": rmse, "reduction": reduction, "motions": 6, "samples": 900}
        heavy = {**score, "rmse": {"value": 3 * left, "low": 2.7 * left, "high": 3.3 * left, "unit": "Nm"}}
        payloads = {HELD_OUT: {"0": score, "0.25": heavy}}
        item = {"block": block, "left_out": "", "coefficients": {}, "splits": {HELD_OUT: score}, "payloads": payloads}
        total.append(item)
    lacking = {"block": "coupling", "left_out": "nobody moved", "coefficients": {}, "splits": {}, "payloads": {}}
    return {**tree, "total": [*total, lacking]}


GAINS = {
    "pd": (1.0, 0.9, 1.1),
    "friction": (0.3, 0.2, 0.4),
    "payload": (-0.1, -0.2, -0.05),
    "posture": (0.0, -0.1, 0.1),
}


@pytest.fixture(scope="module")
def run():
    world = simulate(World(runs=RUNS))
    gap = make_gap(world)
    # What the figures of the run folder lack: lags, some of them negative.
    for splits in (*gap.runs.values(), *gap.groups["payload_kg"].values()):
        for metrics in splits.values():
            lag = {joint: Estimate(-0.01, "s", -0.02, 0.0) for joint in gap.joints}
            metrics["position"]["phase_lag"] = MetricResult(Estimate(-0.01, "s"), lag, 8)
            limit = {joint: Estimate(0.02, "1", 0.01, 0.03) for joint in gap.joints}
            for metric in ("saturation_measured", "saturation_simulated"):
                metrics.setdefault("torque", {})[metric] = MetricResult(Estimate(0.02, "1", 0.01, 0.03), limit, 8)
    lag = replace(TREND, slope=Estimate(0.004, "s/kg", 0.002, 0.006), bend=None)
    trends = {
        label: {
            "position": {
                "rmse": {"": TREND, "elbow_flex": replace(TREND, verdict="falls")},
                "phase_lag": {"": lag},
            }
        }
        for label in RUNS
    }
    return RunFolder(
        gap,
        engines=EngineComparison(
            trends,
            PLANE,
            shifts=(SHIFT, LOADED),
            inside={"stand": Estimate(0.9, "1", 0.8, 1.0), "walk": Estimate(0.8, "1", 0.7, 0.9)},
            nearer={"": (NEARER,), "0.25": (NEARER, replace(NEARER, metric="max", verdict="undecided"))},
        ),
        graybox=GrayboxResult.from_json(graybox_of(gap.joints, GAINS)),
    )


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
        if isinstance(chooser, Chooser)
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
    assert list(rows) == ["0 kg", "0.25 kg", "Change per kg", "With the payload it", "Bend in the middle"]
    assert [cell.text for cell in rows["With the payload it"]][1:] == ["grows", "grows"]
    flex = chooser.variants["position"]["rmse"]["elbow_flex"].tables["payloads"]
    assert "falls" in {cell.text for cell in flex.rows[-2].cells}
    assert "bends up" in {cell.extra for cell in flex.rows[-1].cells}
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
    assert "Gap analysis" in html
    assert html == build_report(tmp_path)
    assert 'id="graybox"' not in html  # it is a part of the analysis, and said once


def test_each_part_begins_with_what_was_found(run):
    words = {part: " ".join(lines).replace("\N{NO-BREAK SPACE}", " ") for part, lines in findings(run).items()}
    assert "grows by 0.200 rad (0.100 to 0.300) with each kilogram" in words["payload"]
    assert "the last kilogram counts for more than the first" in words["payload"]
    assert "Each kilogram adds +4.00 ms (+2.00 to +6.00)" in words["lag"]
    assert "2.0 % (1.0 to 3.0) of the samples with 0.25 kg" in words["saturation"]
    assert "Under walk instead of stand, 5 motions with the same command and payload are nearly" in words["conditions"]
    assert (
        "A payload moves the same motions by 30 % (20 to 40) of their size (0.25 kg against 0 kg)"
        in words["conditions"]
    )
    assert "dart/stock is nearer to the robot than mujoco/stock" in words["engines"]
    assert "0.0100 rad (0.0050 to 0.0200), 30 % with 0.25 kg" in words["engines"]
    assert "Adding friction lowers it by 0.300 Nm (0.200 to 0.400), 30 %" in words["blocks"]
    assert "Adding a constant torque per kilogram raises it by 0.100 Nm (0.050 to 0.200)" in words["blocks"]
    assert "nothing that is sure: sine and cosine" in words["blocks"]
    assert "Left out: speed and acceleration under payload (nobody moved)." in words["blocks"]
    assert "holds less well under the payload" in words["blocks"]


def test_a_trend_is_called_what_it_is(run):
    def said(item):
        trends = {label: {"position": {"rmse": {"": item}}} for label in RUNS}
        return " ".join(findings(replace(run, engines=EngineComparison(trends)))["payload"])

    nothing = Estimate(0.0, "rad", -0.001, 0.001)
    assert "That is a straight line" in said(replace(TREND, bend=nothing, shape="straight"))
    assert "Whether it bends cannot be told" in said(replace(TREND, bend=nothing, shape="undecided"))
    down = replace(TREND, bend=Estimate(-0.02, "rad", -0.03, -0.01), shape="bends down")
    assert "0.0200 rad (0.0100 to 0.0300) above one" in said(down).replace("\N{NO-BREAK SPACE}", " ")
    assert "cannot be told" in said(replace(TREND, verdict="undecided"))


def test_what_is_missing_is_said_in_its_place(run):
    missing = {"conditions": "No condition.", "blocks": "No torque."}
    words = findings(replace(run, engines=EngineComparison({}, missing=missing), graybox=None))
    assert (words["conditions"], words["blocks"]) == (["No condition."], ["No torque."])


def test_repetitions_are_drawn_over_each_other():
    figure = retrace_figure(PLANE, "chirp")
    assert [item["name"] for item in figure["data"]] == ["all motions", "stand, 0.0 kg", "walk, 0.0 kg"]
    assert len({item["line"]["dash"] for item in figure["data"][1:]}) == 2
    assert len({item["line"]["color"] for item in figure["data"][1:]}) == 1


@pytest.mark.long
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
