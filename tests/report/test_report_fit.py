"""The sections of an identification: what they say, what they draw, and what they refuse."""

import copy
import html
import itertools
import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest

from report.run_folders import (
    World,
    add_identification,
    fit_parameters,
    fitted_parameter,
    make_attribution,
    make_fit,
    make_graybox,
    make_run,
    many_parameters,
)
from trueup.core.attribution import UNEXPLAINED, Attribution, AttributionCause
from trueup.core.fit_result import Direction, FitResult
from trueup.core.graybox_result import GrayboxResult
from trueup.core.parameters import split_name
from trueup.core.results import Estimate
from trueup.errors import DataError, FormatError, TrueupError
from trueup.report import build_report
from trueup.report.fit_words import (
    KINDS,
    alert_of,
    as_sentence,
    change_words,
    kind_of,
    listed,
    sure_sentence,
)
from trueup.report.folder import RunFolder
from trueup.report.interval_figures import factor_span, factor_ticks, interval_panels, intervals_figure
from trueup.report.numbers import plain
from trueup.report.open_words import direction_rows, direction_words, gain_words, strongest, suggestions
from trueup.report.palette import KIND_STYLES, cause_styles
from trueup.report.recipes import fit_recipes
from trueup.report.sections.attribution import attribution_sentence, stacked
from trueup.report.sections.graybox import ALL_MOTIONS, graybox_chooser, payload_bars, reductions_table, scores_of
from trueup.report.sections.left import above_zero, left_summary, models_chooser, tried_models
from trueup.report.sections.parameters import parameter_groups
from trueup.report.share_figures import share_range, shares_figure
from trueup.robots.friction import MARK

JOINTS = World().joints
STATUSES = ("ok", "not-identifiable", "at-bound", "not-converged", "no-better")
# What stands before the curves, and behind them.
BEFORE, AFTER = ["attribution", "parameters"], ["open", "usage", "left", "graybox"]
NEW = [*BEFORE, *AFTER]


@pytest.fixture(scope="module")
def small_folder(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("small") / "run", World(samples=200))


@pytest.fixture
def copied(small_folder, tmp_path):
    return shutil.copytree(small_folder, tmp_path / "run")


def sections(page):
    return re.findall(r'<section id="([a-z]+)"', page)


def section(page, anchor):
    start = page.index(f'<section id="{anchor}"')
    return page[start : page.index("</section>", start)]


def words(markup):
    """The text that a reader sees: no tags, no data, single spaces."""
    text = re.sub(r"<script.*?</script>|<[^>]+>", " ", markup, flags=re.DOTALL)
    return " ".join(html.unescape(text).replace("\N{NO-BREAK SPACE}", " ").split())


# --- the page ---


@pytest.mark.long
def test_the_sections_stand_after_the_ladder_and_only_with_their_file(copied):
    before = sections(build_report(copied))
    assert not set(NEW) & set(before)
    add_identification(copied, make_fit(JOINTS), JOINTS)
    assert sections(build_report(copied)) == [*before[:2], *BEFORE, *before[2:3], *AFTER, *before[3:]]
    for file, gone in (("explain.json", {"attribution"}), ("graybox.json", {"graybox"})):
        (copied / file).unlink()
        assert not gone & set(sections(build_report(copied)))
    (copied / "fit.json").unlink()
    assert sections(build_report(copied)) == before


def test_a_folder_without_identification_has_nothing_of_it(copied):
    page = build_report(copied)
    ours = page[: page.index('id="library"')]
    for trace in ("alert", "kind-yes", "panels", "of fitted parameters", "Parameters determined"):
        assert trace not in ours
    assert ".alert" in build_report(add_identification(copied, make_fit(JOINTS), JOINTS))


def test_the_attribution_needs_no_fit(copied):
    make_attribution(JOINTS).save(copied / "explain.json")
    found = sections(build_report(copied))
    assert "attribution" in found
    assert "parameters" not in found


@pytest.mark.parametrize("status", STATUSES)
def test_a_status_that_is_not_ok_stands_beside_the_message(copied, status):
    """Above it where the fit is no result, else below."""
    fit = make_fit(JOINTS, status)
    page = build_report(add_identification(copied, fit, JOINTS))
    verdict = section(page, "verdict")
    if status == "ok":
        assert 'class="alert' not in page
        assert "✓ fit ok" in words(verdict)
        return
    alert = alert_of(fit)
    text = words(verdict)
    places = [text.index(alert.title), text.index(alert.lead), text.index("misses the measured position")]
    if alert.tone == "bad":
        assert text.startswith(f"Verdict {alert.title} {alert.lead}")
        assert places == sorted(places)
    else:
        assert places[2] < places[0] < places[1]
        assert text.index("Position RMSE") < places[0]
    assert all(as_sentence(line) in text for line in fit.statements)
    assert f'class="alert {alert.tone}"' in verdict
    assert f"status in fit.json: {status}" in text
    tone = {"no-better": "bad", "not-converged": "bad"}.get(status, "careful")
    assert alert.tone == tone
    assert alert.title[0] in "▲✕"


def test_a_search_that_the_time_has_ended_is_not_called_a_failure():
    fit = make_fit(JOINTS, "not-converged")
    late = replace(fit, solver={**fit.solver, "stop": "time"})
    assert (alert_of(fit).tone, alert_of(late).tone) == ("bad", "careful")
    assert alert_of(late).title == "▲ Stopped at the time limit"
    assert "--budget" in alert_of(late).advice
    assert alert_of(replace(late, status="no-better")).tone == "bad"
    others = replace(fit, solver={**fit.solver, "stop": "iterations", "short_of_time": ["friction"]})
    apart = replace(late, solver={**late.solver, "agreement": "local-minima"})
    assert (alert_of(others).tone, alert_of(apart).tone) == ("bad", "bad")


def test_fitted_is_compared_with_stock_and_command(copied):
    text = words(section(build_report(add_identification(copied, make_fit(JOINTS), JOINTS)), "verdict"))
    assert "the simulator mujoco/fitted misses" in text
    assert "less than mujoco/stock" in text
    assert "less than taking the command as the motion" in text


def test_every_number_of_every_parameter_is_in_the_table(copied):
    fit = make_fit(JOINTS, "at-bound")
    page = section(build_report(add_identification(copied, fit, JOINTS)), "parameters")
    rows = re.findall(r'<tr class="row-\w+">.*?</tr>', page, re.DOTALL)
    free = [item for item in fit.parameters if not item.frozen]
    assert len(rows) == len(free)
    (row,) = [words(row) for row in rows if ">30000<" in row]
    assert "27693 to 30000" in row
    assert "0.12 to 30000" in row
    assert "▶ on its upper bound" in row
    (row,) = [words(row) for row in rows if "let gripper pass" in row]
    assert row.startswith("gripper 0.4 1.08 0.0538 to 21.7 ×2.70 ✕ not determined Not identifiable from these motions:")
    assert "torque_offset[gripper] = 0 Nm" in words(page)
    assert "square_wave: saturation" in words(page)


@pytest.mark.long
def test_117_parameters_are_folded_and_one_is_not(copied):
    names = [f"joint_{number:02}" for number in range(29)]
    fit = make_fit(names, "not-identifiable", many_parameters())
    assert len(fit.parameters) == 117
    page = section(build_report(add_identification(copied, fit, names)), "parameters")
    assert page.count('<details class="parameters">') == 5
    assert len(re.findall(r'<tr class="row-', page)) == 117
    one = make_fit(JOINTS[:1], "ok", [fitted_parameter("kp", JOINTS[0])])
    page = section(build_report(add_identification(copied, one, JOINTS[:1])), "parameters")
    assert page.count('<details class="parameters" open>') == 1
    assert "These motions determine the parameter that was fitted." in page


def test_nothing_left_open_is_said(copied):
    page = build_report(add_identification(copied, make_fit(JOINTS), JOINTS))
    assert "nothing is left open" in section(page, "open")


def test_equal_inputs_give_equal_bytes(copied, tmp_path):
    add_identification(copied, make_fit(JOINTS, "at-bound"), JOINTS)
    page = build_report(copied)
    assert build_report(shutil.copytree(copied, tmp_path / "elsewhere" / "run")) == page


HOSTILE = ("</script><script>window.hacked=1</script>", "<img src=x onerror='1'>", '__proto__]["{{ 7*7 }}: a')


def test_names_cannot_become_markup(tmp_path):
    world = World(joints=HOSTILE, scored=HOSTILE[:2], samples=120)
    folder = make_run(tmp_path / "run", world)
    fit = make_fit(HOSTILE, "not-identifiable")
    fit = replace(fit, statements=("<b>bold</b>",), models=(*fit.models, replace(fit.models[0], name="<i>model</i>")))
    page = build_report(add_identification(folder, fit, HOSTILE))
    for text in ("<script>window", "<img src=x", "<b>bold", "<i>model"):
        assert text not in page
    for text in re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.DOTALL):
        json.loads(text)
    assert "49: a" not in page


# --- broken files ---


@pytest.mark.parametrize("file", ["fit.json", "explain.json", "graybox.json"])
@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"", DataError),
        (b"\xff\xfe\x00", DataError),
        (b'{"schema": "trueup.fit/1"', DataError),
        (b"[1, 2]", FormatError),
        (b'{"schema": "somebody.else/7"}', FormatError),
    ],
)
def test_broken_and_foreign_files_are_named(copied, file, content, error):
    (copied / file).write_bytes(content)
    with pytest.raises(error, match=re.escape(file)):
        build_report(copied)


@pytest.mark.parametrize(
    "change",
    [
        {"status": "splendid"},
        {"statements": [3]},
        {"solver": []},
        {"parameters": [{"name": "kp[a]"}]},
        {"correlation": {"a": {"b": "strong"}}},
        {"directions": [{"gain": "low", "weights": {}}]},
        {"whiteness": {"a": {"rms": None, "correlation_s": 0, "white": True, "sentence": ""}}},
        {"models": [{"name": 3}]},
        {"errors": {"fitted": {"test": {"value": 1, "unit": None}}}},
        {"data": None},
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_broken_fit_is_a_clear_error(copied, change):
    fit = make_fit(JOINTS).to_json()
    (copied / "fit.json").write_text(json.dumps({**fit, **change}))
    with pytest.raises(DataError, match=r"fit\.json"):
        build_report(copied)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("value", "three"),
        ("value", math.inf),
        ("interval", [1.0]),
        ("identified", "maybe"),
        ("at_bound", "both"),
        ("unit", None),
        ("frozen", 1),
        ("nominal", "none"),
    ],
)
def test_a_broken_parameter_is_a_clear_error(copied, key, value):
    fit = make_fit(JOINTS).to_json()
    fit["parameters"][2][key] = value
    (copied / "fit.json").write_text(json.dumps(fit))
    with pytest.raises(DataError, match=r"fit\.json"):
        build_report(copied)


def test_a_number_that_the_model_does_not_have_is_shown_as_added(copied):
    fit = make_fit(JOINTS).to_json()
    name = fit["parameters"][0]["name"]
    fit["parameters"][0] |= {"nominal": None, "transform": "log", "at_bound": "", "frozen": False}
    (copied / "fit.json").write_text(json.dumps(fit))
    page = build_report(copied)
    item = FitResult.load(copied / "fit.json")[name]
    assert change_words(item) == "added"
    assert not any(panel.factors for panel in interval_panels([item]))
    assert '<td class="nominal">none</td>' in section(page, "parameters")


def test_a_parameter_that_stands_twice_is_refused(copied):
    fit = make_fit(JOINTS).to_json()
    fit["parameters"].append(fit["parameters"][0])
    (copied / "fit.json").write_text(json.dumps(fit))
    with pytest.raises(DataError, match="twice"):
        build_report(copied)


FUZZ = """
import copy, json, sys
from pathlib import Path
import numpy as np
from trueup.errors import TrueupError
from trueup.report import build_report

folder, count = Path(sys.argv[1]), int(sys.argv[2])
rng = np.random.default_rng(int(sys.argv[3]))
for file in ("fit.json", "explain.json", "graybox.json"):
    text = (folder / file).read_text()
    pages = errors = 0
    for _ in range(count):
        tree = json.loads(text)
        node, path = tree, []
        while isinstance(node, dict | list) and node and (not path or rng.random() < 0.9):
            key = rng.choice(sorted(node)) if isinstance(node, dict) else int(rng.integers(len(node)))
            path.append((node, key))
            node = node[key]
        parent, key = path[-1]
        values = [None, True, 3, -1, "text", [], {}, {"a": 1}, [None], 1e300, ""]
        if rng.random() < 0.25:
            del parent[key]
        else:
            parent[key] = values[rng.integers(len(values))]
        (folder / file).write_text(json.dumps(tree))
        try:
            build_report(folder)
            pages += 1
        except TrueupError:
            errors += 1
        except Exception:
            print(file, path[-1][1], parent, file=sys.stderr)
            raise
    (folder / file).write_text(text)
    print(pages, errors)
"""


@pytest.mark.long
def test_changed_files_give_a_page_or_a_clear_error(tmp_path):
    """In another process: there, types are not checked at run time, as in real life."""
    world = World(names=("a", "b", "c"), splits=("train", "val", "test"), samples=60)
    folder = make_run(tmp_path / "run", world)
    for extra in ("ladder.json", "traces.json", "traces.npz", "quality.json", "analysis.json"):
        (folder / extra).unlink()
    add_identification(folder, make_fit(JOINTS, "not-identifiable"), JOINTS)
    command = [sys.executable, "-c", FUZZ, str(folder), "40", "7"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    counts = [int(number) for number in done.stdout.split()]
    assert len(counts) == 6
    assert min(counts) > 0, "each file gives both pages and errors"


# --- words ---


def test_names_are_split_and_kinds_told():
    assert split_name("damping[elbow[2]]") == ("damping", "elbow[2]")
    assert split_name("payload_mass") == ("payload_mass", "")
    assert kind_of(fitted_parameter("kp", "a")) == "yes"
    assert kind_of(fitted_parameter("kp", "a", "no")) == "no"
    assert kind_of(fitted_parameter("kp", "a", "yes", at_bound="high")) == "bound"
    assert kind_of(fitted_parameter("load", "a", "no", at_bound="low")) == "zero"
    assert kind_of(fitted_parameter("kp", "a", frozen=True)) == "frozen"


def test_changes_are_factors_or_differences():
    assert change_words(fitted_parameter("kp", "a")) == "×0.517"
    assert change_words(fitted_parameter("torque_offset", "a")) == "−0.200"
    almost = replace(fitted_parameter("load", "a", at_bound="low"), value=8e-11)
    assert change_words(almost) == "unchanged"
    # a positive quantity that the model does not have has no factor
    assert change_words(replace(fitted_parameter("frictionloss", "a"), nominal=0.0)) == "+0.300"


def test_how_many_are_sure_is_counted():
    assert sure_sentence(make_fit(JOINTS, "ok", fit_parameters(JOINTS)[:3])) == (
        "These motions determine all 3\N{NO-BREAK SPACE}parameters."
    )
    text = sure_sentence(make_fit(JOINTS, "at-bound"))
    assert "14 of 20\N{NO-BREAK SPACE}parameters, 2 weakly and 4 not at all." in text
    assert "1 ended on a bound. 2 ended on zero: the data show none of that." in text
    frozen = [fitted_parameter("kp", "a", frozen=True)]
    assert sure_sentence(make_fit(JOINTS, "ok", frozen)) == "No parameter was fitted."


def test_each_piece_of_advice_is_given_once():
    parameters = [
        fitted_parameter("damping", "a", "no"),
        fitted_parameter("damping", "bb", "weakly"),
        fitted_parameter("damping", "c"),
        fitted_parameter("load", "a", "no", at_bound="low"),
        fitted_parameter("kp", "", "no"),
    ]
    assert suggestions(parameters) == [
        ("Let a and bb pass through their range of speeds.", "damping"),
        ("Load the robot by gravity in several poses.", "kp"),
    ]
    # "a" inside another word is no joint
    assert suggestions(parameters[:1]) == [("Let a pass through its range of speeds.", "damping")]


def test_directions_in_words():
    assert direction_words(Direction(0.0, {"a": 0.99, "b": 0.1})) == "a on its own"
    together = direction_words(Direction(0.0, {"a": 0.8, "b": 0.6}))
    assert together == "raise a (64\N{NO-BREAK SPACE}%) and b (36\N{NO-BREAK SPACE}%)"
    # the sign of a direction is free: the larger part is raised
    against = direction_words(Direction(0.0, {"a": -0.8, "b": 0.6}))
    assert against == "raise a (64\N{NO-BREAK SPACE}%) while lowering b (36\N{NO-BREAK SPACE}%)"
    assert gain_words(0.0) == "nothing"
    assert gain_words(0.45) == "less than the prior (0.45 of it)"
    assert gain_words(5.3) == "little (5.3 times the prior)"
    rows = direction_rows([Direction(0.0, {"a": 1.0}), Direction(0.0, {"b": 1.0}), Direction(0.5, {"c": 1.0})])
    assert rows == [("a and b, each on its own", "nothing"), ("c on its own", gain_words(0.5))]


def test_correlations_are_paired_once_and_sorted():
    table = {"a": {"b": 0.98, "c": -0.8}, "b": {"a": 0.98}, "c": {"a": -0.8, "d": 0.99}, "d": {"c": 0.99}}
    assert strongest(table) == [("c", "d", 0.99), ("a", "b", 0.98), ("a", "c", -0.8)]
    assert strongest(table, above=0.985) == [("c", "d", 0.99)]


def test_lists_and_sentences():
    assert listed([]) == ""
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(list("abcdefgh")) == "a, b, c, d, e, f and 2 more"
    assert as_sentence("ended on a bound: kp") == "Ended on a bound: kp."
    assert as_sentence("kp[a] is 3") == "kp[a] is 3."
    assert as_sentence("is it?") == "Is it?"
    assert [plain(value) for value in (60.0, 0.12, 30000.0, 0.0, 1e-9, -2.5)] == [
        "60",
        "0.12",
        "30000",
        "0",
        "1e−9",
        "−2.5",
    ]


# --- figures ---


def test_intervals_are_relative_to_the_model():
    panels = {panel.quantity: panel for panel in interval_panels(fit_parameters(JOINTS, "not-identifiable"))}
    kp = panels["kp"]
    assert kp.factors
    assert kp.rows[0].value == pytest.approx(31.0 / 60.0)
    assert kp.rows[0].low == pytest.approx(31.0 / 60.0 * np.exp(-0.08))
    delay = panels["delay_s"]
    assert not delay.factors
    assert delay.rows[0].value == pytest.approx(0.02)
    assert len(panels["torque_offset"].rows) == len(JOINTS) - 1, "frozen parameters are not drawn"
    mixed = [fitted_parameter("kp", "a"), replace(fitted_parameter("kp", "b"), nominal=0.0)]
    assert not interval_panels(mixed)[0].factors


def test_kinds_differ_in_color_dash_or_symbol():
    parameters = [
        fitted_parameter("kp", "a"),
        fitted_parameter("kp", "b", "weakly"),
        fitted_parameter("kp", "c", "no"),
        fitted_parameter("kp", "d", at_bound="low"),
        fitted_parameter("kp", "e", at_bound="high"),
    ]
    (panel,) = interval_panels(parameters)
    figure = intervals_figure(panel, factor_span([panel]))
    go.Figure(figure)
    lines, dots = figure["data"][::2], figure["data"][1::2]
    assert [dot["name"] for dot in dots] == [KINDS[kind][1] for kind in ("yes", "weakly", "no", "bound")]
    symbols = [symbol for dot in dots for symbol in dot["marker"]["symbol"]]
    assert len(set(symbols)) == 5
    assert symbols[-2:] == ["triangle-left", "triangle-right"]
    assert [line["line"]["dash"] for line in lines[:3]] == ["solid", "dash", "dot"]
    assert len({line["line"]["color"] for line in lines}) == 4
    assert figure["layout"]["xaxis"]["type"] == "log"
    assert figure["layout"]["shapes"][0]["x0"] == 1.0
    assert set(KIND_STYLES) | {"frozen"} == set(KINDS)


def test_factors_share_a_span_that_holds_one_and_all_values():
    panels = interval_panels(fit_parameters(JOINTS, "not-identifiable"))
    low, high = factor_span(panels)
    rows = [row for panel in panels if panel.factors for row in panel.rows]
    assert low < min(row.low for row in rows) < 1.0 < max(row.high for row in rows) < high
    far = replace(fitted_parameter("kp", "a"), interval=(1e-9, 1e12))
    span = factor_span(interval_panels([far]))
    assert span == pytest.approx((1e-3, 1e3), rel=1.0)
    (panel,) = interval_panels([replace(far, value=1e9)])
    line, dot = intervals_figure(panel, span)["data"]
    assert dot["x"] == pytest.approx([span[1]], rel=1e-5), "drawn at the edge, not beyond it"
    assert line["x"][:2] == pytest.approx(span, rel=1e-5)


@pytest.mark.parametrize("low", [0.9, 0.5, 0.1, 0.01, 0.001])
@pytest.mark.parametrize("high", [1.02, 1.7, 3.0, 12.0, 900.0])
def test_ticks_are_a_handful_inside_the_span(low, high):
    ticks = factor_ticks(low, high)
    assert 2 <= len(ticks) <= 8
    assert all(low <= tick <= high for tick in ticks)
    assert all(a < b for a, b in itertools.pairwise(ticks))
    assert 1.0 in ticks


def test_a_negative_share_is_drawn_to_the_left_and_fits_the_axis():
    attribution = make_attribution(JOINTS)
    shares, titles = stacked(attribution, JOINTS), attribution.labels
    figure = shares_figure(shares, titles, cause_styles(titles))
    go.Figure(figure)
    json.dumps(figure, allow_nan=False)
    assert figure["layout"]["barmode"] == "relative"
    bars = {bar["name"]: dict(zip(bar["y"], bar["x"], strict=True)) for bar in figure["data"]}
    assert list(bars) == ["delay", "gains", "friction", "gravity or payload", "inertia", "unexplained"]
    worse = bars["gravity or payload"][JOINTS[1]]
    assert worse == pytest.approx(100 * (0.0325 - 0.17), rel=1e-5)
    low, high = figure["layout"]["xaxis"]["range"]
    assert low < worse
    assert high > 100.0 - worse
    assert len({(bar["marker"]["color"], str(bar["marker"].get("pattern"))) for bar in figure["data"]}) == 6
    assert share_range([{"a": 0.4, "b": 0.6}]) == [0.0, 102.0]


def test_an_attribution_in_words(copied):
    attribution = make_attribution(JOINTS)
    text = attribution_sentence(attribution).replace("\N{NO-BREAK SPACE}", " ")
    assert (
        text
        == "37 % of the squared error comes from friction, 32 % from gains and 19 % from delay; 7.8 % stays unexplained."
    )
    attribution.save(copied / "explain.json")
    page = section(build_report(copied), "attribution")
    assert "made it worse" in page
    assert "to the left of zero" in page


def test_no_error_has_no_shares(copied):
    nothing = dict.fromkeys(("delay", UNEXPLAINED), math.nan)
    cause, none = AttributionCause("delay", "delay", ("delay_s",), 1), Estimate(0.0, "rad")
    attribution = Attribution("test", "rad", none, none, (cause,), {"a": nothing}, nothing)
    attribution.save(copied / "explain.json")
    assert json.loads((copied / "explain.json").read_text())["shares_total"] == {"delay": None, UNEXPLAINED: None}
    assert "There is no error to attribute." in build_report(copied)


def test_an_attribution_survives_its_file_and_refuses_nonsense(tmp_path):
    attribution = make_attribution(JOINTS)
    attribution.save(tmp_path / "explain.json")
    assert Attribution.load(tmp_path / "explain.json") == attribution
    assert list(attribution.labels) == ["delay", "gains", "friction", "gravity", "inertia", UNEXPLAINED]
    first, second = attribution.causes[:2]
    for causes in ([first, first], [replace(first, cause=""), second]):
        with pytest.raises(DataError, match="cause"):
            replace(attribution, causes=tuple(causes))
    for shares, total in (({"x": {"delay": -1e308}}, {}), ({}, {"delay": math.inf})):
        with pytest.raises(DataError, match="a share of an attribution"):
            replace(attribution, shares=shares, shares_total=total)


def test_a_fit_that_does_not_say_why_it_ended_did_not_end_by_time():
    fit = replace(make_fit(JOINTS), solver={"name": "gauss-newton"})
    assert not fit.ended_by_time
    assert not fit.short_of_time


def test_models_stand_beside_the_model_as_it_came():
    fit = make_fit(JOINTS)
    rows = tried_models(fit)
    assert [row.name for row in rows] == ["model as it came", "base", "load"]
    chooser = models_chooser(fit, JOINTS)
    shown = chooser.shown
    assert list(chooser.default) == ["test"]
    names = [bar["name"] for bar in shown.figures["models"]["data"]]
    assert names == ["model as it came", "base", "★ load"]
    overview = shown.tables["models"]
    assert [row.strong for row in overview.rows] == [False, False, True]
    assert overview.rows[2].note == "+ load"
    val = overview.columns.index("Validation") - 1
    assert overview.rows[1].cells[val].note.startswith("0.0"), "no RMSE lies below zero"
    assert [row.head for row in shown.tables["model-joints"].rows] == ["mean of scored joints", *JOINTS]
    for variant in chooser.variants.values():
        go.Figure(variant.figures["models"])
    again = replace(fit, models=(*fit.models, fit.models[0]))
    assert [row.name for row in tried_models(again)][-1] == "base (2)"
    single = replace(fit, models=())
    assert [row.name for row in tried_models(single)] == ["model as it came", "fitted"]


def test_intervals_of_errors_end_at_zero():
    assert above_zero(Estimate(1.0, "rad", -0.5, 2.0)) == Estimate(1.0, "rad", 0.0, 2.0)
    assert above_zero(Estimate(1.0, "rad")) == Estimate(1.0, "rad")


def test_what_is_left_is_told_joint_by_joint(copied):
    page = section(build_report(add_identification(copied, make_fit(JOINTS), JOINTS)), "left")
    text = words(page)
    assert "The remaining error is noise on 1 of 3 joints" in text
    assert f"{JOINTS[0]} 0.00300 rad none ✓ noise What is left looks like noise." in text
    assert f"{JOINTS[1]} 0.00600 rad 0.20 s ▲ model error What is left is model error." in text
    assert left_summary([]) == ""


def test_groups_follow_the_causes():
    names = [group.quantity for group in parameter_groups(fit_parameters(JOINTS), JOINTS)]
    assert names == ["delay_s", "kp", "damping", "frictionloss", "load", "torque_offset", "armature"]
    (group,) = parameter_groups([fitted_parameter("torque_offset", "")], JOINTS)
    assert group.rows[0].head == "torque_offset"


def test_the_gray_box_shows_payloads_and_what_a_block_is_worth(tmp_path):
    (tmp_path / "graybox.json").write_text(json.dumps(make_graybox(JOINTS)))
    graybox = GrayboxResult.load(tmp_path / "graybox.json")
    blocks = graybox.joints[JOINTS[0]].blocks
    assert [block.block for block in blocks] == ["pd", "friction", "payload", "posture"]
    assert scores_of(blocks[1], "test")[ALL_MOTIONS].reduction.value == 0.2
    bars = payload_bars(blocks, "test")
    assert [title.replace("\N{NO-BREAK SPACE}", " ") for title in bars] == ["all motions", "0 kg", "1.5 kg"]
    table = reductions_table(blocks, "test")
    assert [row.cells[1].tone for row in table.rows] == ["better", "better", "", "better"]
    assert table.rows[2].cells[1].text.startswith("−0.0100")
    assert table.rows[1].cells[1].extra.startswith("40")
    last = reductions_table(graybox.joints[JOINTS[-1]].blocks, "test")
    assert last.rows[1].note == "left out: the joint never moved"
    chooser = graybox_chooser(graybox, JOINTS)
    assert list(chooser.default) == [JOINTS[0], "test"]
    go.Figure(chooser.shown.figures["graybox"])
    assert graybox_chooser(GrayboxResult({}, {}), JOINTS) is None


# --- lines to copy ---


def test_the_lines_to_copy_suit_the_files_that_are_there(copied):
    fit = make_fit(JOINTS)
    run = RunFolder.load(add_identification(copied, fit, JOINTS))
    found = {recipe.title: recipe for recipe in fit_recipes(run, fit)}
    assert len(found) == 6
    plain_mujoco = found["In plain MuJoCo"]
    assert "install_friction" not in plain_mujoco.lines
    assert "shoulder_pan 20.0\N{NO-BREAK SPACE}ms" in plain_mujoco.text
    for recipe in found.values():
        if "import" in recipe.lines:
            compile(recipe.lines, recipe.title, "exec")
    law = f'<mujoco><worldbody><body><joint name="a" user="{MARK:g} 0 0.1 0.2"/></body></worldbody></mujoco>'
    (copied / "model.fitted.xml").write_text(law)
    run = RunFolder.load(copied)
    assert run.friction_laws
    assert "install_friction()" in next(r for r in fit_recipes(run, fit) if r.title == "In plain MuJoCo").lines
    for name in run.fitted_files:
        (copied / name).unlink()
    assert "usage" not in sections(build_report(copied))


def test_a_model_of_tags_that_never_end_takes_no_time(copied):
    """Hours, if each of them were looked through to the end of the file."""
    (copied / "model.fitted.xml").write_text("<joint " * 300_000 + "<numeric " * 300_000)
    run = RunFolder.load(copied)
    assert not run.friction_laws
    assert run.stated_limits == ()


def test_the_samples_are_read_as_the_page_says(copied, monkeypatch):
    fit = make_fit(JOINTS)
    run = RunFolder.load(add_identification(copied, fit, JOINTS))
    monkeypatch.chdir(copied)
    names = {}
    for recipe in fit_recipes(run, fit):
        if recipe.title in ("Randomization", "The numbers with their intervals"):
            exec(compile(recipe.lines, recipe.title, "exec"), names)
    assert set(names["draw"]) == set(fit.values)
    assert names["sure"]["kp[shoulder_pan]"] == pytest.approx(31.0)


def test_provenance_of_the_fit_is_kept(copied):
    page = build_report(add_identification(copied, make_fit(JOINTS), JOINTS))
    assert "Provenance of the fit" in page
    assert "Provenance of the attribution" in page


def test_the_fit_itself_survives_its_file(tmp_path):
    fit = make_fit(JOINTS, "at-bound")
    fit.save(tmp_path / "fit.json")
    again = FitResult.load(tmp_path / "fit.json")
    assert again.to_json() == fit.to_json()
    broken = copy.deepcopy(fit.to_json())
    del broken["parameters"][0]["unit"]
    with pytest.raises(TrueupError):
        FitResult.from_json(broken)
