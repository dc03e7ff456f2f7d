"""The same motion again: what is told of conditions and payloads whose effect is known."""

from dataclasses import replace

import numpy as np
import pytest

from trueup.core.episode import EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.measure import Comparison, PlaneBuilder, RepeatBuilder, conditions_repeat, measure_gap

JOINTS = ("a", "b", "c")
STEP_S = 0.01


def motion(number, time_s):
    """A smooth path of three joints, another one for each number."""
    rng = np.random.default_rng(number)
    frequency, phase = rng.uniform(0.3, 0.9, 3), rng.uniform(0, 6, 3)
    return 0.6 * np.sin(2 * np.pi * frequency * time_s[:, None] + phase)


def episode(number, *, condition="stand", payload=0.0, delay_s=0.0, offset=0.0, source=None, wrong=0.0):
    time_s = STEP_S * np.arange(500)

    def series(values):
        return TimeSeries(time_s, JOINTS, {"position": values}, same_units({"position": "rad"}, JOINTS))

    name = f"{condition}/{number}/{payload}"
    meta = EpisodeMeta(name, payload_kg=payload, condition=condition, source=f"m{number}" if source is None else source)
    measured = motion(number, time_s - delay_s) + offset
    simulated = {"mujoco/stock": series(motion(number, time_s) + wrong)}
    return Comparison(meta, series(measured), simulated, series(motion(number, time_s)))


def shifts_of(episodes):
    builder = RepeatBuilder()
    for item in episodes:
        builder.add(item)
    gap = measure_gap(episodes, episode_metrics=("rmse", "nrmse", "phase_lag"))
    return builder.shifts(gap)


def test_a_motion_that_only_comes_later_is_retraced_and_its_lag_is_the_delay():
    """Relative to the size of the motion the path is the same; what differs is when it is passed."""
    early = [episode(k, delay_s=0.02) for k in range(8)]
    late = [episode(k, condition="walk", delay_s=0.05) for k in range(8)]
    (found,) = shifts_of([*early, *late])
    assert (found.by, found.first, found.second, found.motions) == ("condition", "stand", "walk", 8)
    assert found.lag.value == pytest.approx(0.03, abs=5e-4)
    assert found.lag.low <= 0.03 + 5e-4
    assert found.share.high < 0.02  # what remains are the ends, which only one of them reaches
    gaps = found.gaps["mujoco/stock"]
    assert gaps["position.phase_lag"].value == pytest.approx(0.03, abs=5e-4)
    assert gaps["position.rmse"].low > 0.0


def test_a_path_that_is_sampled_at_other_times_is_the_same_path():
    """A robot whose samples come in between moves no further away than the path bends between them."""
    (found,) = shifts_of([episode(k, condition=c, delay_s=d) for k in range(4) for c, d in (("a", 0.0), ("b", 0.005))])
    assert found.share.value < 2e-3  # the ends, which only one of them reaches


def test_an_offset_is_found_as_it_is_and_says_nothing_of_the_lag():
    episodes = [episode(k, condition=c, offset=o) for k in range(6) for c, o in (("stand", 0.0), ("walk", 0.05))]
    (found,) = shifts_of(episodes)
    assert found.offset.value == pytest.approx(0.05, rel=1e-5)
    assert found.offset.low <= found.offset.value <= found.offset.high
    assert found.lag.value == pytest.approx(0.0, abs=1e-6)
    # Nowhere is another posture of the path nearer than the offset is long.
    assert 0.0 < found.path.value <= 0.05


def test_motions_of_other_gains_are_no_repetitions():
    first, second = (episode(0, condition=condition) for condition in ("stand", "walk"))
    stiffer = replace(second, meta=replace(second.meta, kp_setting=800.0))
    assert shifts_of([first, second])
    assert not shifts_of([first, stiffer])


def test_payloads_are_compared_with_the_lightest():
    episodes = [episode(k, payload=p, offset=0.02 * p) for k in range(4) for p in (0.5, 1.0, 2.0)]
    found = shifts_of(episodes)
    assert [(item.by, item.first, item.second) for item in found] == [("payload_kg", "0.5", other) for other in "12"]
    assert [item.offset.value for item in found] == pytest.approx([0.01, 0.03], rel=1e-5)


def test_only_one_thing_may_differ_and_a_name_alone_makes_no_repetition():
    both = [episode(k, condition=c, payload=p) for k in range(3) for c, p in (("stand", 0.0), ("walk", 1.0))]
    assert shifts_of(both) == ()
    # All motions of a file have the same source, and are not the same motion.
    for source in ("all.h5", "folder"):
        assert shifts_of([episode(k, condition=c, source=source) for k, c in enumerate(("stand", "walk"))]) == ()
    assert not conditions_repeat(item.meta for item in (episode(1), episode(2, condition="walk")))
    assert conditions_repeat(item.meta for item in (episode(1), episode(1, condition="walk")))


def test_a_single_repetition_has_no_interval():
    (found,) = shifts_of([episode(0), episode(0, condition="walk", offset=0.1)])
    assert found.motions == 1
    assert found.offset.low is None


def test_the_share_inside_the_ellipse_of_all_falls_for_a_condition_that_leaves_it():
    episodes = [episode(k, condition=c, offset=o) for k in range(12) for c, o in (("stand", 0.0), ("reach", 1.5))]
    plane, builder = PlaneBuilder(), RepeatBuilder()
    for item in episodes[::2] * 5 + episodes[1:4:2]:
        plane.add(item)
    for item in episodes:
        builder.add(item)
    inside = builder.inside(plane.result())
    assert set(inside) == {"stand", "reach"}
    assert inside["stand"].value > 0.85
    assert inside["reach"].high < inside["stand"].low
    assert inside["reach"].low >= 0.0
