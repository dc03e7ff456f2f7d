"""Figures: what they hold, and that plotly takes them."""

import json
import math

import plotly.graph_objects as go
import pytest

from trueup.core.analysis import BinnedCurve, Lag
from trueup.core.results import Estimate
from trueup.report.chooser import Menu, Variant, make_chooser
from trueup.report.figures import bars_figure, bins_figure, lag_figure, rounded, whiskers
from trueup.report.folder import RunFolder
from trueup.report.labels import group_order
from trueup.report.palette import run_styles, split_styles
from trueup.report.sections.causes import causes_section
from trueup.report.sections.groups import groups_section
from trueup.report.sections.joints import joints_section
from trueup.report.sections.ladder import ladder_section

STYLES = run_styles(["command", "x/stock"])


def leaves(tree):
    return [tree] if isinstance(tree, Variant) else [leaf for child in tree.values() for leaf in leaves(child)]


def test_every_figure_of_a_run_is_valid_plotly(run_folder):
    run = RunFolder.load(run_folder)
    sections = [make(run) for make in (ladder_section, joints_section, groups_section, causes_section)]
    choosers = [item for section in sections for item in section.context.values() if item is not None]
    figures = [figure for chooser in choosers for leaf in leaves(chooser.variants) for figure in leaf.figures.values()]
    assert len(figures) > 30
    for figure in figures:
        go.Figure(figure)
        json.dumps(figure, allow_nan=False)


def test_bars_hold_values_and_both_whiskers():
    bars = {"x/stock": {"a": Estimate(0.5, "rad", 0.4, 0.7), "b": Estimate(math.nan, "rad"), "c": Estimate(0.2, "rad")}}
    bar = bars_figure(["a", "b", "c"], bars, STYLES, title="error")["data"][0]
    assert bar["y"] == ["a", "c"]
    assert bar["x"] == [0.5, 0.2]
    assert bar["error_x"]["array"] == pytest.approx([0.2, 0.0])
    assert bar["error_x"]["arrayminus"] == pytest.approx([0.1, 0.0])


def test_an_interval_that_dwarfs_the_bars_is_cut_at_the_edge():
    bars = {"x/stock": {"a": Estimate(0.04, "rad", 0.0, 0.4), "b": Estimate(0.02, "rad", 0.01, 0.03)}}
    axis = bars_figure(["a", "b"], bars, STYLES, title="error")["layout"]["xaxis"]
    assert axis["range"] == [0, 0.1]
    assert "cut at the edge" in axis["title"]["text"]
    bars["x/stock"]["a"] = Estimate(0.04, "rad", 0.03, 0.05)
    assert "range" not in bars_figure(["a", "b"], bars, STYLES, title="error")["layout"]["xaxis"]
    # correlations may be negative: their axis is left alone
    bars["x/stock"]["a"] = Estimate(0.04, "1", -0.9, 0.9)
    assert "range" not in bars_figure(["a", "b"], bars, STYLES, title="error")["layout"]["xaxis"]


def test_empty_bins_leave_no_points():
    curve = BinnedCurve(
        (1.0, 2.0, 3.0), (0.1, math.nan, 0.3), (0.0, math.nan, 0.2), (0.2, math.nan, 0.4), (5, 0, 9), "rad/s", "rad"
    )
    band, line = bins_figure({"x/stock": curve}, STYLES, against="velocity", signal="position")["data"]
    assert line["x"] == [1.0, 3.0]
    assert line["y"] == [0.1, 0.3]
    assert band["x"] == [1.0, 3.0, 3.0, 1.0]
    assert band["y"] == [0.2, 0.4, 0.2, 0.0]


def test_lags_are_milliseconds_and_undefined_ones_are_left_out():
    figure = lag_figure(["a", "b"], {"command": {"a": Lag(0.08, 0.07, 0.1), "b": Lag(math.nan)}}, STYLES)
    (dots,) = figure["data"]
    assert dots["x"] == [80.0]
    assert dots["error_x"]["array"] == pytest.approx([20.0])


def test_names_are_no_markup_for_plotly():
    bars = {"x/stock": {"<b>a</b>": Estimate(0.5, "rad")}}
    figure = bars_figure(["<b>a</b>"], bars, STYLES, title="error")
    assert figure["data"][0]["y"] == ["&lt;b&gt;a&lt;/b&gt;"]


def test_styles_differ_in_more_than_color():
    styles = run_styles([f"run{number}" for number in range(6)])
    for attribute in ("color", "symbol", "pattern"):
        assert len({getattr(style, attribute) for style in styles.values()}) == 7
    assert len({style.dash for style in styles.values()}) >= 5
    assert len({style.pattern for style in split_styles(["train", "val", "test", "all", "extra"]).values()}) == 5


def test_a_run_keeps_its_style_in_any_order():
    assert run_styles(["b", "a", "x/stock"]) == run_styles(["x/stock", "b", "a"])


def test_rounding():
    assert rounded(0.123456789) == 0.123457
    assert rounded(math.inf) is None
    assert rounded(None) is None
    assert whiskers([Estimate(1.0, "rad")])["array"] == [0.0]


def test_groups_are_sorted_as_numbers():
    assert group_order(["10.0", "2.5", "heavy", "0.0"]) == ["0.0", "2.5", "10.0", "heavy"]


def test_a_chooser_has_only_choices_that_exist():
    exists = {("one", "x"), ("one", "y"), ("two", "y")}
    menus = [Menu("A", [("zero", ""), ("one", ""), ("two", "")]), Menu("B", [("x", ""), ("y", ""), ("z", "")])]
    chooser = make_chooser("id", menus, lambda a, b: Variant() if (a, b) in exists else None, preferred=("two", "x"))
    assert [option for option, _ in chooser.menus[0].options] == ["one", "two"]
    assert [option for option, _ in chooser.menus[1].options] == ["x", "y"]
    assert list(chooser.default) == ["two", "y"]
    assert chooser.options_at(1) == [("y", "")]
    assert make_chooser("id", menus, lambda *_: None, preferred=("", "")) is None
