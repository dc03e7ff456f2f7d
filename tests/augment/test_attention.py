"""Where a SAT looks: what is known of its attention is what is said of it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from augment.evaluation_cases import JOINTS, RUN, episode_of
from augment.sat_cases import HEADS, SAMPLES, sat_of
from trueup.augment.attention import attention_profile
from trueup.core.episode import EpisodeMeta
from trueup.errors import DataError


def motions(count=3, samples=40):
    rng = np.random.default_rng(0)
    return [recording(episode_of(rng, samples=samples + number), number) for number in range(count)]


def recording(episode, motion, again=""):
    return replace(episode, meta=EpisodeMeta(f"m{motion}{again}", source=f"plans/{motion}"))


def softmax(scores):
    return np.exp(scores) / np.exp(scores).sum(axis=-1, keepdims=True)


def test_attention_that_knows_the_lag_alone_is_its_own_profile():
    lags = np.random.default_rng(1).normal(size=(HEADS, SAMPLES + 1))
    found = attention_profile(sat_of(JOINTS, lags=lags), motions(), RUN)
    expected = softmax(lags).mean(axis=0)[::-1]
    for shares in (found.mean, found.low, found.high):  # every motion has the same
        np.testing.assert_allclose(shares, expected, atol=1e-6)
    assert (found.motions, found.rate_hz, found.span_s) == (3, 100.0, SAMPLES / 100.0)
    assert found.oldest.value == pytest.approx(expected[-2:].sum(), abs=1e-6)
    reached = np.cumsum(expected)
    lag = np.flatnonzero(reached >= 0.5)[0]
    part = (0.5 - reached[lag - 1]) / (reached[lag] - reached[lag - 1])
    assert found.half_s.value == pytest.approx((lag - 1 + part) / 100.0, abs=1e-6)
    assert found.half_s.low == pytest.approx(found.half_s.high)


def test_a_network_that_looks_at_one_sample_has_half_of_its_attention_there():
    lags = np.full((HEADS, SAMPLES + 1), -40.0)
    lags[:, -1] = 0.0  # the present one
    found = attention_profile(sat_of(JOINTS, lags=lags), motions(1), RUN)
    assert (found.half_s.value, found.half_s.low) == (0.0, None)
    assert found.mean[0] == pytest.approx(1.0)
    lags = lags[:, ::-1].copy()
    found = attention_profile(sat_of(JOINTS, lags=lags), motions(2), RUN)
    assert found.oldest.value == pytest.approx(1.0)


def test_repetitions_of_a_motion_are_drawn_together():
    made, once = sat_of(JOINTS), motions(4)
    twice = [recording(episode, number, again) for number, episode in enumerate(once) for again in "ab"]
    expected, found = (attention_profile(made, episodes, RUN).half_s for episodes in (once, twice))
    assert expected.low < expected.high
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


@pytest.mark.parametrize("feedback", ["own", "zero"])
def test_the_encoder_is_told_what_it_is_told_when_it_runs(feedback):
    made, (episode,) = sat_of(JOINTS, feedback=feedback), motions(1)
    network = made.corrector.network
    with torch.no_grad():  # errors that matter
        network.dense.weight.normal_()
    x = torch.from_numpy(np.asarray(episode.run(RUN)["position"], np.float32))[:, None]
    with torch.no_grad():
        said = network(x)
        told = said if feedback == "own" else torch.zeros_like(said)
        expected = network.profile(x, told).numpy()[::-1]
        other = network.profile(x, torch.zeros_like(said) if feedback == "own" else said).numpy()[::-1]
    found = attention_profile(made, [episode], RUN)
    np.testing.assert_allclose(found.mean, expected, atol=1e-6)
    assert np.abs(expected - other).max() > 1e-4


def test_motions_differ_and_the_band_says_how_far():
    found = attention_profile(sat_of(JOINTS), motions(12), RUN)
    low, mean, high = (np.array(shares) for shares in (found.low, found.mean, found.high))
    assert ((low < mean) & (mean < high)).all()
    assert found.half_s.low < found.half_s.value < found.half_s.high
    assert sum(found.mean) == pytest.approx(1.0)


def test_motions_without_a_whole_history_do_not_count():
    made = sat_of(JOINTS)
    long, short = motions(1, 40)[0], motions(1, SAMPLES)[0]
    assert attention_profile(made, [short, long], RUN) == attention_profile(made, [long], RUN)
    with pytest.raises(DataError, match=r"no motion is longer than the history.*more than 8 samples"):
        attention_profile(made, [short], RUN)


def test_a_network_without_attention_has_no_profile():
    assert attention_profile(sat_of(JOINTS, attention=False), motions(1), RUN) is None
