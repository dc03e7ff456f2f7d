"""Bars for continuous integration."""

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.results import Estimate, GapResult, MetricResult
from trueup.errors import ConfigError, MissingSignal, TrueupError
from trueup.measure import Bar, check_bars, parse_bar, refuse_unknown


def entry(value, unit="rad"):
    return MetricResult(Estimate(value, unit), {}, 3)


@pytest.fixture
def result():
    def metrics(value, lag=-0.03):
        return {"position": {"rmse": entry(value), "phase_lag": entry(lag, "s")}}

    return GapResult(
        runs={
            "mujoco/stock": {"all": metrics(0.03), "test": metrics(0.05)},
            "mujoco/fitted": {"all": metrics(0.01), "test": metrics(0.02)},
            "command": {"all": metrics(9.0)},
        },
        joints=("a",),
        scored_joints=("a",),
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("position.rmse=0.02", Bar("position", "rmse", 0.02)),
        ("mujoco/stock:test:position.rmse=2e-2", Bar("position", "rmse", 0.02, "mujoco/stock", "test")),
        (":test:position.rmse=1", Bar("position", "rmse", 1.0, "", "test")),
        ("a=b:c::position.rmse=1", Bar("position", "rmse", 1.0, "a=b:c", "")),
        ("body.position.position_norm=0.01", Bar("body.position", "position_norm", 0.01)),
    ],
)
def test_parse(text, expected):
    assert parse_bar(text) == expected
    assert parse_bar(str(expected)) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a valid bar"),
        ("position.rmse", "not a valid bar"),
        ("position=0.02", "not a valid bar"),
        ("test:position.rmse=0.02", "not a valid bar"),
        (".rmse=0.02", "not a valid bar"),
        ("position.rsme=0.02", r"unknown metric 'rsme'.*available: rmse"),
        ("position.pearson=0.9", "higher pearson is better"),
        ("position.rmse=small", "finite number"),
        ("position.rmse=nan", "finite number"),
        ("position.rmse=inf", "finite number"),
    ],
)
def test_what_is_no_bar(text, message):
    with pytest.raises(ConfigError, match=message):
        parse_bar(text)


@given(st.text(max_size=40))
def test_any_text_is_a_bar_or_an_error(text):
    with contextlib.suppress(TrueupError):
        assert math.isfinite(parse_bar(text).limit)


def failures(result, *texts):
    return [(item.run, item.split) for item in check_bars(result, [parse_bar(text) for text in texts])]


def test_every_run_but_the_command_is_held_to_a_bar(result):
    assert failures(result, "position.rmse=0.02") == [("mujoco/stock", "all")]
    assert failures(result, "position.rmse=0.03") == []  # at the bar is met
    assert failures(result, ":test:position.rmse=0.019") == [("mujoco/stock", "test"), ("mujoco/fitted", "test")]
    assert failures(result, "mujoco/fitted::position.rmse=0.02") == []
    assert failures(result, "command::position.rmse=0.02") == [("command", "all")]


def test_of_a_signed_metric_the_size_counts(result):
    assert failures(result, "mujoco/fitted::position.phase_lag=0.02") == [("mujoco/fitted", "all")]
    assert failures(result, "mujoco/fitted::position.phase_lag=0.04") == []


def test_failure_says_what_and_by_how_much(result):
    (failure,) = check_bars(result, [parse_bar("mujoco/stock:test:position.rmse=0.02")])
    assert str(failure) == "position.rmse of mujoco/stock (test): 0.05 rad, allowed 0.02 rad"


def test_what_is_not_defined_never_passes(result):
    broken = GapResult({"a": {"all": {"position": {"rmse": entry(math.nan)}}}}, ("a",), ("a",))
    (failure,) = check_bars(broken, [parse_bar("position.rmse=1e9")])
    assert "not defined" in str(failure)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("other::position.rmse=1", r"run.*'other'.*available: mujoco/stock"),
        (":val:position.rmse=1", r"split.*'val'.*available: all, test"),
        ("velocity.rmse=1", r"signal.*'velocity'.*available: position"),
        ("position.mae=1", r"metric.*'mae'.*available: rmse"),
    ],
)
def test_a_bar_on_what_was_not_measured_is_an_error(result, text, message):
    with pytest.raises(MissingSignal, match=message):
        check_bars(result, [parse_bar(text)])


def test_a_result_of_the_command_alone_meets_no_bar():
    alone = GapResult({"command": {"all": {"position": {"rmse": entry(0.0)}}}}, ("a",), ("a",))
    with pytest.raises(MissingSignal, match="needs a simulated run"):
        check_bars(alone, [parse_bar("position.rmse=1")])


def test_a_bar_on_what_will_not_be_measured_is_refused_before():
    known = [parse_bar(text) for text in ("position.rmse=1", "a:test:position.rmse=1", ":all:position.rmse=1")]
    refuse_unknown([*known, parse_bar("command::position.rmse=1")], runs=["a"], splits=["test"])
    refuse_unknown(known, runs=["a"])
    with pytest.raises(MissingSignal, match=r"run that is not there: 'b'"):
        refuse_unknown([parse_bar("b::position.rmse=1")], runs=["a"])
    with pytest.raises(MissingSignal, match=r"split that is not there: 'tset'"):
        refuse_unknown([parse_bar(":tset:position.rmse=1")], runs=["a"], splits=["test"])
