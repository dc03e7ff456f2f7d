"""Streams that run undisturbed: equal to the whole motion, and what a step says. The rules are in test_stream_rules."""

import inspect
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.networks import (
    JOINTS,
    REACH,
    bidirectional,
    by_signal,
    changed,
    inputs_of,
    motion,
    outputs_of,
    real_time,
    window,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import numpy_helper

from trueup.core.model_card import Input
from trueup.deploy import Confidence, Network, Predictor, Status, Stream, StreamSettings, Why
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, UnitError

UNIT_LISTS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}


def stream_of(made, **options):
    card = made.card
    return Stream.load(made.folder, **{"rate_hz": card.rate_hz, "joints": card.joints, **options})


def outputs(stream, x, **options):
    return np.array([stream.step_vector(row[0].astype(float), **options).values.copy() for row in x])


@pytest.mark.long
@settings(max_examples=25)
@given(
    make=st.sampled_from([real_time, window]),
    joints=st.integers(1, 4),
    hidden=st.lists(st.integers(1, 24), min_size=1, max_size=2),
    steps=st.integers(1, 60),
    warmup=st.integers(0, 12),
    command=st.booleans(),
    seed=st.integers(0, 2**16),
)
def test_a_stream_equals_the_whole_motion_after_its_warmup(make, joints, hidden, steps, warmup, command, seed):
    names = JOINTS[:joints]
    with tempfile.TemporaryDirectory() as name:
        made = make(
            Path(name),
            hidden=hidden,
            seed=seed,
            joints=names,
            inputs=inputs_of(names, command=command),
            outputs=outputs_of(names),
            warmup_steps=warmup,
        )
        x = motion(made.card, steps, seed=seed)
        whole = Predictor.load(made.folder).run(x)[:, 0]
        stream = stream_of(made)
        reach = np.array([REACH[output.signal] for output in made.card.outputs])
        for t in range(steps):
            given = by_signal(made.card, x[t, 0])
            asked = by_signal(made.card, x[t, 0], "command") if command else None
            step = stream.step(given, asked, time_s=t / made.card.rate_hz)
            assert step.why == Why.NONE
            if t < warmup:
                assert step.status is Status.WARMING
                np.testing.assert_array_equal(step.values, x[t, 0, : 3 * joints])
            else:
                assert step.status is Status.OK
                assert np.abs((step.values - whole[t]) / reach).max() <= 1e-5


def test_corrections_can_come_before_the_warmup_is_over(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    x = motion(made.card, 12)
    stream = stream_of(made, settings=StreamSettings(correct_while_warming=True))
    found = outputs(stream, x)
    np.testing.assert_allclose(found, Predictor.load(tmp_path).run(x)[:, 0], rtol=1e-5, atol=1e-5)
    assert stream_of(made, settings=StreamSettings(warmup_steps=0)).step_vector(x[0, 0]).status is Status.OK
    late = stream_of(made, settings=StreamSettings(warmup_steps=11))
    assert [late.step_vector(row[0]).status for row in x] == [Status.WARMING] * 11 + [Status.OK]


@pytest.mark.parametrize("make", [real_time, window])
def test_a_reset_stream_is_a_new_one(tmp_path, make):
    made = make(tmp_path, hidden=(8, 5))
    stream = stream_of(made)
    first = outputs(stream, motion(made.card, 20))
    stream.step_vector(motion(made.card, 1)[0, 0])  # an odd number, for the two sets of states
    stream.step_vector(np.full(21, np.nan))
    stream.reset()
    assert stream.latest.status is Status.HELD
    assert np.isnan(stream.latest.values).all()
    np.testing.assert_array_equal(outputs(stream, motion(made.card, 20)), first)
    fresh = stream_of(made)
    np.testing.assert_array_equal(outputs(fresh, motion(made.card, 20)), first)


def test_two_streams_of_one_network_do_not_meet(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    network = Network.load(tmp_path)
    a, b = (Stream(network, rate_hz=1000.0, joints=JOINTS) for _ in range(2))
    x, y = motion(made.card, 20), motion(made.card, 20, seed=1)
    alone = outputs(stream_of(made), x)
    mixed = []
    for t in range(20):
        mixed.append(a.step_vector(x[t, 0]).values.copy())
        b.step_vector(y[t, 0])
    np.testing.assert_array_equal(mixed, alone)


def test_channels_may_stand_in_any_order_and_leave_joints_out(tmp_path):
    """The network reads joints backwards, joint by joint, without the last joint's torque; the loop does not care."""
    ordinary = inputs_of(JOINTS[:3])
    order = [8, 2, 5, 1, 4, 7, 0, 3]
    inputs = tuple(ordinary[number] for number in order)
    bases = [k for k, channel in enumerate(inputs) if channel.signal == "torque"]
    rows = [replace(output, base=base) for base in bases for output in outputs_of(JOINTS[:3])
            if (output.signal, output.joint) == (inputs[base].signal, inputs[base].joint)]  # fmt: skip
    made = real_time(tmp_path, hidden=(8, 5), joints=JOINTS[:3], inputs=inputs, outputs=tuple(rows), warmup_steps=0)
    stream = stream_of(made)
    given = {
        "position": np.array([0.1, 0.2, 0.3]),
        "velocity": np.array([0.4, 0.5, 0.6]),
        "torque": np.array([7.0, 8.0, 9.0]),
    }
    step = stream.step(given)
    x = np.array([[[9.0, 0.3, 0.6, 0.2, 0.5, 8.0, 0.1, 0.4]]], np.float32)
    whole = Predictor.load(tmp_path).run(x)[0, 0]
    np.testing.assert_allclose(step.values, whole, atol=1e-5)
    # Outputs are torque of joint3, joint2; a signal's values come in the robot's order.
    np.testing.assert_array_equal(step["torque"], step.values[::-1])


def test_channels_may_go_joint_by_joint(tmp_path):
    ordinary = inputs_of(JOINTS[:3])
    inputs = tuple(ordinary[3 * signal + joint] for joint in range(3) for signal in range(3))
    outputs = tuple(replace(outputs_of(JOINTS[:3])[3 * (k % 3) + k // 3], base=k) for k in range(9))
    made = real_time(tmp_path, hidden=(8, 5), joints=JOINTS[:3], inputs=inputs, outputs=outputs)
    x = motion(made.card, 10)
    stream = stream_of(made)
    for t in range(10):
        step = stream.step(by_signal(made.card, x[t, 0]))
    np.testing.assert_allclose(step.values, Predictor.load(tmp_path).run(x)[-1, 0], atol=1e-4)
    np.testing.assert_array_equal(step["velocity"], step.values[[1, 4, 7]])
    assert np.shares_memory(step["velocity"], step.values)


def test_the_signals_of_a_step_are_views_of_its_values(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    stream = stream_of(made)
    for row in motion(made.card, 10):
        step = stream.step_vector(row[0])
    np.testing.assert_array_equal(step["velocity"], step.values[7:14])
    assert np.shares_memory(step["velocity"], step.values)
    assert step is stream.latest
    with pytest.raises(MissingSignal, match="position, velocity, torque"):
        step["current"]
    with pytest.raises(ValueError, match="read-only"):
        step.values[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        step["torque"][0] = 0.0


def test_intervals_and_warnings_are_for_corrected_values_only(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    x = motion(made.card, 40)
    stream, confidence = stream_of(made), Confidence(made.card)
    warned = 0
    for t in range(40):
        step = stream.step_vector(x[t, 0])
        if t < 5:
            assert np.isinf(step.interval()).all()
            assert np.isnan(step.far_probability()).all()
            assert not step.far_off
            continue
        correction = step.values - x[t, 0]
        expected = 0.1 + 0.01 * np.arange(21) + 0.5 * np.abs(correction)
        np.testing.assert_allclose(step.interval(), expected, rtol=1e-6)
        probability = np.interp(np.abs(correction), [0.0, 0.5, 2.0], [0.0, 0.2, 1.0])
        np.testing.assert_allclose(step.far_probability(), probability, atol=1e-6)
        assert step.far_off == bool((probability > 0.5).any())
        np.testing.assert_allclose(confidence.half_width(correction), step.interval())
        warned += step.far_off
    assert warned > 0
    stream.step_vector(np.full(21, np.nan))
    assert np.isinf(stream.latest.interval()).all()


def test_latencies_are_kept_unless_switched_off(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    stream = stream_of(made)
    outputs(stream, motion(made.card, 30))
    stream.step(by_signal(made.card, motion(made.card, 1)[0, 0]))
    assert len(stream.latency) == 31
    assert 1.0 < stream.latency.percentile_us(50.0) < 1e5
    silent = stream_of(made, settings=StreamSettings(measure=False))
    outputs(silent, motion(made.card, 30))
    assert len(silent.latency) == 0


def refused(made, error, *words, **options):
    with pytest.raises(error) as caught:
        stream_of(made, **options)
    text = str(caught.value)
    assert len(text.splitlines()) <= 2
    assert all(word in text for word in words), text


def test_what_does_not_fit_is_refused(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    refused(made, ConfigError, "100 Hz", "1000 Hz", rate_hz=100.0)
    refused(made, ConfigError, "1011 Hz", rate_hz=1011.0)
    refused(made, ConfigError, "nan Hz", rate_hz=float("nan"))
    stream_of(made, rate_hz=1009.0)
    swapped = (JOINTS[1], JOINTS[0], *JOINTS[2:])
    refused(made, NameMismatch, "another order", ", ".join(swapped), ", ".join(JOINTS), joints=swapped)
    refused(made, NameMismatch, "others", "elbow", ", ".join(JOINTS), joints=(*JOINTS[:6], "elbow"))
    refused(made, NameMismatch, "others", joints=JOINTS[:6])
    refused(made, UnitError, "deg", "rad", units={**UNIT_LISTS, "position": "deg"})
    refused(made, UnitError, "'joint3'", "got N;", "Nm", units={**UNIT_LISTS, "torque": ["Nm", "Nm", "N", *["Nm"] * 4]})
    refused(made, UnitError, "'joint7'", units={**UNIT_LISTS, "torque": ["Nm"] * 6})
    refused(made, UnitError, "'torque'", units={"position": "rad", "velocity": "rad/s"})
    stream_of(made, units={**UNIT_LISTS, "torque": ["Nm"] * 7, "current": "A"})


def test_a_network_that_needs_the_future_is_refused_with_what_to_use(tmp_path):
    made = bidirectional(tmp_path)
    refused(made, ConfigError, "future", "realeasy-rt", "History", "Predictor")


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"torque": None}, MissingSignal, "simulated.torque"),
        ({"torque": np.zeros(6)}, DataError, r"simulated.torque.*\(6,\).*7 joints"),
        ({"torque": np.zeros((7, 1))}, DataError, r"\(7, 1\)"),
        ({"velocity": np.zeros(1)}, DataError, r"simulated.velocity.*\(1,\)"),
        ({"velocity": np.array(["1 rad/s"] * 7)}, DataError, r"simulated.velocity: got .*1 rad/s.*7 joints"),
        ({"torque": [0.0, [1.0, 2.0], *[0.0] * 5]}, DataError, r"simulated.torque: got .*7 joints"),
    ],
)
def test_samples_of_another_shape_are_programming_errors(tmp_path, changes, error, words):
    made = real_time(tmp_path, hidden=(8, 5))
    stream = stream_of(made)
    sample = {**by_signal(made.card, motion(made.card, 1)[0, 0]), **changes}
    sample = {name: values for name, values in sample.items() if values is not None}
    with pytest.raises(error, match=words):
        stream.step(sample)
    with pytest.raises(DataError, match="20 channels; expected 21"):
        stream.step_vector(np.zeros(20))


@pytest.mark.parametrize("x", [np.array(["north"] * 21), [{}] * 21, np.zeros((21, 1))], ids=["str", "dict", "2-D"])
def test_a_vector_that_holds_no_numbers_is_a_programming_error(tmp_path, x):
    made = real_time(tmp_path, hidden=(8, 5))
    stream = stream_of(made)
    with pytest.raises(DataError, match=r"input of model 'random-rt': got .*; expected 21 numbers"):
        inspect.unwrap(Stream.step_vector)(stream, x)  # as outside of the tests: types are not checked
    outputs(stream, motion(made.card, 12))
    assert (stream.latest.status, stream.latest.why) == (Status.OK, Why.NONE)


def test_a_network_that_reads_commands_needs_them(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5), inputs=inputs_of(command=True))
    stream = stream_of(made)
    sample = by_signal(made.card, motion(made.card, 1)[0, 0])
    with pytest.raises(MissingSignal, match=r"command.position"):
        stream.step(sample)
    with pytest.raises(MissingSignal, match=r"command.position.*available: velocity"):
        stream.step(sample, {"velocity": np.zeros(7)})
    assert stream.step(sample, {"position": np.zeros(7)}).status is Status.WARMING


@pytest.mark.parametrize(
    "changes",
    [
        {"warmup_steps": -1},
        {"missed_periods": 1.0},
        {"missed_periods": float("nan")},
        {"gap_periods": 1.2},
        {"gap_periods": float("inf")},
        {"stalled_steps": 0},
        {"moving_speed": 0.0},
        {"rate_tolerance": 1.0},
        {"margin": -0.1},
        {"margin": float("nan")},
    ],
    ids=str,
)
def test_senseless_settings_are_refused(changes):
    with pytest.raises(ConfigError, match=next(iter(changes))):
        StreamSettings(**changes)


def test_a_network_whose_output_is_not_finite_is_refused(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))

    def spoil(graph):
        bias = next(
            node.input[1] for node in graph.node if node.op_type == "Add" and node.input[1].startswith("constant")
        )
        weights = next(tensor for tensor in graph.initializer if tensor.name == bias)
        weights.CopyFrom(numpy_helper.from_array(np.full(21, np.nan, np.float32), bias))

    changed(made, spoil)
    with pytest.raises(DataError, match="not finite"):
        stream_of(made)


def test_channels_without_a_range_take_anything_that_float32_can_hold(tmp_path):
    free = tuple(Input(channel.signal, channel.joint, channel.unit) for channel in inputs_of())
    assert free[0].high == np.inf
    made = real_time(tmp_path, hidden=(8, 5))
    replace(made.card, inputs=free, warmup_steps=0).save(tmp_path)
    stream = stream_of(made)
    assert stream.step_vector(np.full(21, 100.0)).status is Status.OK
    assert stream.step_vector(np.full(21, 1e300)).status is Status.FALLBACK


def test_one_end_of_a_range_may_be_open(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    replace(made.card, inputs=(replace(made.card.inputs[0], low=-np.inf, high=2.0), *made.card.inputs[1:])).save(
        tmp_path
    )
    stream = stream_of(made)
    for position, good in ((2.0, True), (2.01, False), (-1e6, True)):
        stream.reset()
        status = stream.step_vector(np.array([position, *[0.0] * 20])).status
        assert status is (Status.WARMING if good else Status.FALLBACK)


GROWTH = """
import gc, sys, tracemalloc
import numpy as np
from trueup.deploy import Stream

folder, count = sys.argv[1], 7
stream = Stream.load(folder, rate_hz=1000.0, joints=[f"joint{number + 1}" for number in range(count)])
rng = np.random.default_rng(0)
samples = [{name: 0.1 * rng.standard_normal(count) for name in ("position", "velocity", "torque")} for _ in range(50)]

def steps(start, number):
    for k in range(start, start + number):
        answer = stream.step(samples[k % 50], time_s=1e-3 * k)
    return answer.status.value

print(steps(0, 2000))
gc.collect()
gc.disable()
tracemalloc.start()
steps(2000, 1000)  # lists of free objects fill up
before, _ = tracemalloc.get_traced_memory()
tracemalloc.reset_peak()
print(steps(3000, 1000))
after, peak = tracemalloc.get_traced_memory()
print(after - before, peak - before)
"""


def test_a_step_leaves_nothing_behind(tmp_path):
    """A thousand steps, without the checks of types that these tests add: only a few small objects come and go."""
    real_time(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", GROWTH, str(tmp_path)], capture_output=True, text=True, check=True, timeout=120
    )
    first, second, grown, peak = done.stdout.split()
    assert first == second == "ok"
    assert int(grown) <= 256
    assert int(peak) <= 2048
