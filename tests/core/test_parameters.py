import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.parameters import Parameter, ParameterSet
from trueup.errors import ConfigError, NameMismatch

positive = st.floats(1e-6, 1e6)


def log(name="damping[a]", value=1.0, low=0.1, high=10.0, **options):
    return Parameter(name, value, "Nm s/rad", low, high, "log", **options)


def linear(name="torque_offset[a]", value=0.5, low=-2.0, high=2.0, **options):
    return Parameter(name, value, "Nm", low, high, "linear", scale=0.5, **options)


@given(positive)
def test_z_and_back_is_the_same_value(value):
    for parameter in (log(low=1e-7, high=1e7), linear(low=-1e7, high=1e7)):
        assert parameter.from_z(parameter.to_z(value)) == pytest.approx(value, rel=1e-9)


def test_values_stay_inside_the_bounds_in_spite_of_rounding():
    parameter = log(value=3.0, low=3.0, high=7.0)
    assert parameter.from_z(parameter.to_z(3.0) - 1e-12) == 3.0
    assert parameter.from_z(99.0) == 7.0


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"low": 5.0, "high": 1.0}, "contradict"),
        ({"value": 20.0}, "outside its bounds"),
        ({"low": 0.0}, "positive by nature"),
        ({"value": float("nan")}, "not finite"),
        ({"prior_std": 0.0}, "must be positive"),
    ],
)
def test_contradictions_are_refused_by_name(options, match):
    with pytest.raises(ConfigError, match=match) as caught:
        log(**options)
    assert "damping[a]" in str(caught.value)


def test_a_name_has_a_quantity_and_a_target():
    assert (log().quantity, log().target) == ("damping", "a")
    assert (log("payload_mass").quantity, log("payload_mass").target) == ("payload_mass", "")


def test_solvers_see_only_what_is_free():
    parameters = ParameterSet((log(), linear(frozen=True), log("damping[b]", 2.0)))
    assert parameters.start.tolist() == pytest.approx([0.0, np.log(2.0)])
    assert parameters.values(np.array([np.log(3.0), np.log(4.0)])) == pytest.approx(
        {"damping[a]": 3.0, "torque_offset[a]": 0.5, "damping[b]": 4.0}
    )
    low, high = parameters.bounds
    assert np.exp(low).tolist() == pytest.approx([0.1, 0.1])
    assert np.exp(high).tolist() == pytest.approx([10.0, 10.0])


def test_another_start_keeps_the_prior_where_it_was():
    moved = ParameterSet((log(prior_std=1.0), linear())).at({"damping[a]": 100.0, "unknown": 3.0})
    assert moved["damping[a]"].value == 10.0, "moved onto its bound"
    mean, std = moved.prior
    assert mean.tolist() == [0.0, 1.0]
    assert std.tolist() == [1.0, np.inf]
    assert moved.at({"damping[a]": 2.0}).prior[0].tolist() == [0.0, 1.0]


def test_names_are_unique_and_unknown_ones_listed():
    with pytest.raises(NameMismatch, match="occurs twice"):
        ParameterSet((log(), log()))
    with pytest.raises(NameMismatch, match=r"damping\[a\]"):
        ParameterSet((log(),))["armature[a]"]


def test_what_is_frozen_is_left_as_the_model_has_it():
    parameters = ParameterSet(
        (log(nominal=0.0), linear(nominal=0.2), log("torque_limit[a]"), log("kp[a]", frozen=True))
    )
    left = parameters.freeze(parameters.names)
    assert left["damping[a]"].value == 0.0, "the model may say 0 where a fit cannot"
    assert left["torque_offset[a]"].untouched
    assert left.names == ("damping[a]", "torque_offset[a]", "kp[a]"), "what the model has not stays out"
    assert not left["kp[a]"].untouched, "kept at a value that the user has chosen"
    assert left.at({"damping[a]": 5.0})["damping[a]"].value == 0.0


def test_what_is_held_keeps_its_value():
    held = ParameterSet((log(nominal=0.5), linear())).hold(["damping[a]"])
    assert [parameter.name for parameter in held.free] == ["torque_offset[a]"]
    assert held.at({"damping[a]": 5.0})["damping[a]"].value == 1.0
    assert not held["damping[a]"].untouched
