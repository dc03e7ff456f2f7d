"""A correction is what a network adds, at the run's own stamps, and nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest

from augment.evaluation_cases import JOINTS, RUN, card_of, episode_of, series_of
from trueup.augment.channels import Grid
from trueup.augment.correction import corrected, refuse_slower
from trueup.core.model_card import Input, Output
from trueup.deploy.agreement import check_rate
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, UnitError


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def adding(values):
    """A network that adds these values, (K,) or (N, K), to its inputs."""
    return lambda x: (x + np.asarray(values, np.float32)[..., None, :]).astype(np.float32)


def test_a_correction_of_zero_changes_no_bit(rng):
    episode = episode_of(rng)
    out = corrected(episode, RUN, card_of(), adding(np.zeros(4)))
    for name, values in episode.run(RUN).signals.items():
        assert out[name].dtype == np.float64
        assert np.array_equal(out[name], values)


def test_what_is_no_output_stays_and_the_run_itself_is_not_touched(rng):
    episode = episode_of(rng)
    before = {name: values.copy() for name, values in episode.run(RUN).signals.items()}
    card = card_of()
    card = replace(card, outputs=(replace(card.outputs[3], base=3),))  # torque of b
    out = corrected(episode, RUN, card, lambda x: x[..., 3:] + np.float32(0.5))
    assert np.array_equal(out["position"], before["position"])
    assert np.array_equal(out["torque"][:, 0], before["torque"][:, 0])
    assert out["torque"][:, 1] - before["torque"][:, 1] == pytest.approx(0.5, abs=1e-6)
    assert all(np.array_equal(episode.run(RUN)[name], values) for name, values in before.items())


def test_the_order_of_joints_in_the_run_means_nothing(rng):
    episode = episode_of(rng)
    turned = replace(episode, simulated={RUN: episode.run(RUN).select(JOINTS[::-1])})
    network = adding([0.1, 0.2, 0.3, 0.4])
    out, other = corrected(episode, RUN, card_of(), network), corrected(turned, RUN, card_of(), network)
    assert other.joints == JOINTS[::-1]
    for name in ("position", "torque"):
        assert np.array_equal(other.select(JOINTS)[name], out[name])


def test_a_faster_run_is_corrected_between_the_samples_of_the_network(rng):
    episode = episode_of(rng, rate_hz=250.0, samples=501)  # 2 s: 201 samples of the network
    ramp = lambda x: x + np.arange(len(x), dtype=np.float32)[:, None, None]  # noqa: E731
    out = corrected(episode, RUN, card_of(), ramp)
    run = episode.run(RUN)
    added = out["torque"] - run["torque"]
    assert added == pytest.approx(np.repeat(100 * (run.time_s - run.time_s[0])[:, None], 2, axis=1), abs=1e-4)


def test_a_slower_run_is_refused(rng):
    with pytest.raises(DataError, match=r"too few samples per second.*50 Hz.*at least 100 Hz"):
        corrected(episode_of(rng, rate_hz=50.0), RUN, card_of(), adding(np.zeros(4)))


@pytest.mark.parametrize("rate_hz", [98.5, 98.99, 99.01, 100.0, 100.99, 101.01, 101.5])
def test_what_is_taken_as_the_networks_rate_is_so_in_a_control_loop_too(rng, rate_hz):
    episode, card = episode_of(rng, rate_hz=rate_hz), card_of()
    own = Grid.of(episode.run(RUN).time_s, card.rate_hz).own
    if own:
        check_rate(card, rate_hz)
        refuse_slower(episode.run(RUN), card, "it")
        return
    with pytest.raises(ConfigError, match=f"{rate_hz:g} Hz"):
        check_rate(card, rate_hz)
    if rate_hz < card.rate_hz:
        with pytest.raises(DataError, match="too few samples"):
            refuse_slower(episode.run(RUN), card, "it")


def test_a_network_for_other_joints_is_refused_with_both_lists(rng):
    with pytest.raises(NameMismatch, match=r"it needs \[hip, knee\], there are \[a, b\]"):
        corrected(episode_of(rng), RUN, card_of(joints=("hip", "knee")), adding(np.zeros(4)))


def test_other_units_and_missing_signals_are_refused(rng):
    card, episode = card_of(), episode_of(rng)
    inputs = (*card.inputs[:3], replace(card.inputs[3], unit="mNm"))
    with pytest.raises(UnitError, match="got Nm; expected mNm"):
        corrected(episode, RUN, replace(card, inputs=inputs), adding(np.zeros(4)))
    with pytest.raises(MissingSignal, match="mujoco/fitted"):
        corrected(episode, "mujoco/fitted", card, adding(np.zeros(4)))
    inputs = (*card.inputs[:3], Input("velocity", "a", "rad/s"))
    with pytest.raises(MissingSignal, match="velocity"):
        corrected(episode, RUN, replace(card, inputs=inputs), adding(np.zeros(4)))


def test_the_command_is_held_between_its_stamps(rng):
    episode = episode_of(rng)
    stamps = np.array([3.0, 3.5])
    command = series_of(stamps, position=np.array([[1.0, 2.0], [3.0, 4.0]]))
    episode = replace(episode, command=command)
    inputs = (Input("torque", "a", "Nm"), Input("position", "b", "rad", "command"))
    card = replace(card_of(), inputs=inputs, outputs=(Output("torque", "a", "Nm", base=0),))
    out = corrected(episode, RUN, card, lambda x: x[..., :1] + x[..., 1:])
    added = out["torque"][:, 0] - episode.run(RUN)["torque"][:, 0]
    assert added == pytest.approx(np.where(np.arange(200) < 50, 2.0, 4.0), abs=1e-5)


def test_values_that_are_not_finite_are_refused_where_they_enter_and_where_they_leave(rng):
    episode = episode_of(rng)
    run = episode.run(RUN)
    broken = {**run.signals, "torque": run["torque"].copy()}
    broken["torque"][7, 1] = np.nan
    with pytest.raises(DataError, match=r"an input of 'net' is not finite: got simulated.torque.b at 3.070 s"):
        corrected(replace(episode, simulated={RUN: replace(run, signals=broken)}), RUN, card_of(), adding(np.zeros(4)))
    with pytest.raises(DataError, match=r"an output of 'net' is not finite: got simulated.position.a at 3.000 s"):
        corrected(episode, RUN, card_of(), adding([np.inf, 0, 0, 0]))


def test_a_network_of_another_width_than_its_card_is_refused(rng):
    with pytest.raises(DataError, match="another number of values"):
        corrected(episode_of(rng), RUN, card_of(), lambda x: x[..., :3])
