"""Curves in the page stay within their budget and come back as they were."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from report.packed import unpacked
from trueup.core.traces import EpisodeTraces, Trace
from trueup.report.embed import BUDGET_BYTES, MIN_POINTS, fit_to_budget, pack


def noise(rng, time_s):
    return rng.normal(size=time_s.size)


def sines(rng, time_s):
    """A motion as robots make them, and what an encoder of 0.3 mrad adds."""
    turns, phase, size = rng.uniform(0.05, 0.5, 5), rng.uniform(0, 6.3, 5), rng.uniform(0.05, 0.4, 5)
    return np.sin(6.28 * np.outer(time_s, turns) + phase) @ size + rng.normal(0, 3e-4, time_s.size)


def episode(name, rows, joints=6, runs=1, seed=0, draw=noise):
    rng = np.random.default_rng(seed)
    time_s = np.linspace(0, 30, rows, dtype=np.float32)
    labels = ["measured", "command", *(f"run{number}" for number in range(runs))]
    traces = [
        Trace(
            signal,
            f"joint{joint}",
            "rad",
            rows,
            time_s,
            {key: draw(rng, time_s).astype(np.float32) for key in labels},
        )
        for signal in ("position", "velocity", "torque", "current")
        for joint in range(joints)
    ]
    return EpisodeTraces(name, "test", 0.0, tuple(traces))


def read(packed):
    """What the page's script makes of it, written apart from it: episode -> curves of each trace, clock first."""
    planes = np.frombuffer(unpacked(packed.text), np.uint8).astype(np.int64)
    folded = planes[: planes.size // 2] + 256 * planes[planes.size // 2 :]
    changes = np.where(folded % 2, -(folded + 1) // 2, folded // 2)
    place, found = 0, []
    for about in packed.index:
        found.append([])
        for item in about["traces"]:
            blocks = []
            for middle, step in item["codes"]:
                codes = np.cumsum(changes[place : place + item["rows"]]).astype(np.int16)
                place += item["rows"]
                blocks.append(np.where(codes == -32768, np.nan, middle + step * codes))
            number = item["curves"].index("measured")
            base = np.where(np.isnan(blocks[1 + number]), item["codes"][1 + number][0], blocks[1 + number])
            curves = [
                own if label == "measured" else own + base
                for label, own in zip(item["curves"], blocks[1:], strict=True)
            ]
            found[-1].append([blocks[0], *curves])
    assert place == changes.size
    return found


def size(embedded):
    return len(pack(embedded.episodes).text)


def test_43_motions_of_six_joints_fit_and_stay_readable():
    episodes = [episode(str(number), 1000, seed=number, draw=sines) for number in range(43)]
    embedded = fit_to_budget(episodes)
    assert embedded.left_out == 0
    assert embedded.thinned
    assert embedded.max_points >= 350
    assert 0.8 * BUDGET_BYTES < size(embedded) <= BUDGET_BYTES


def test_small_runs_are_not_thinned():
    embedded = fit_to_budget([episode("one", 500)])
    assert not embedded.thinned
    assert embedded.left_out == 0


def test_too_many_motions_drop_the_last():
    episodes = [episode(str(number), 600, joints=1, seed=number) for number in range(12)]
    embedded = fit_to_budget(episodes, budget_bytes=80_000)
    assert embedded.max_points == MIN_POINTS
    assert 0 < len(embedded.episodes) < 12
    assert [item.id for item in embedded.episodes] == [str(number) for number in range(len(embedded.episodes))]
    assert embedded.left_out == 12 - len(embedded.episodes)
    assert size(embedded) <= 80_000


def test_no_room_for_any_motion_leaves_all_out():
    embedded = fit_to_budget([episode("one", 600)], budget_bytes=1_000)
    assert (list(embedded.episodes), embedded.left_out) == ([], 1)


@given(st.data())
def test_curves_come_back_within_a_step_of_their_codes(data):
    rows = data.draw(st.integers(1, 40))
    values = arrays(np.float32, rows, elements=st.floats(-1e6, 1e6, width=32) | st.just(np.nan))
    time_s = np.sort(data.draw(arrays(np.float32, rows, elements=st.floats(0, 1e4, width=32))))
    drawn = {label: data.draw(values) for label in ("measured", "command", "run")}
    traces = tuple(Trace("position", joint, "rad", rows, time_s, drawn) for joint in ("a", "b"))
    (found,) = read(pack([EpisodeTraces("one", "test", 0.0, traces)]))
    for clock, *curves in found:
        assert np.all(np.diff(clock) >= 0)
        assert clock == pytest.approx(time_s, abs=_step(time_s))
        measured, rest = curves[0], curves[1:]
        np.testing.assert_allclose(measured, drawn["measured"], rtol=0, atol=_step(drawn["measured"]))
        for own, label in zip(rest, ("command", "run"), strict=True):
            # Values are there where the robot's are missing, too.
            np.testing.assert_array_equal(np.isnan(own), np.isnan(drawn[label]))
            coded, base = drawn[label] - _filled(drawn["measured"]), _filled(drawn["measured"], measured)
            np.testing.assert_allclose(own - base, coded, rtol=0, atol=_step(coded))


def _filled(values, seen=None):
    """Curves, as they were or as they are seen, with the middle where there is no value."""
    known = np.asarray(values, np.float64)[np.isfinite(values)]
    middle = 0.5 * known.min() + 0.5 * known.max() if known.size else 0.0
    return np.where(np.isfinite(values), np.asarray(values if seen is None else seen, np.float64), middle)


def _step(values):
    known = np.asarray(values, np.float64)[np.isfinite(values)]
    return (np.ptp(known) / 16_000 if known.size else 0.0) + 1e-9
