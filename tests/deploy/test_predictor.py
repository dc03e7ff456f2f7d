import numpy as np
import pytest
from benchmarks.networks import bidirectional, motion, real_time, window

from trueup.deploy import History, Predictor
from trueup.errors import ConfigError, DataError


@pytest.fixture(params=[real_time, window, bidirectional], ids=["rt", "window", "both ways"])
def predictor(request, tmp_path):
    request.param(tmp_path, hidden=(12,))
    return Predictor.load(tmp_path)


def test_it_corrects_and_keeps_the_shape(predictor):
    x = motion(predictor.card, 40, copies=3)
    y = predictor.run(x)
    assert y.shape == (40, 3, 21)
    assert y.dtype == np.float32
    assert np.abs(y - x[:, :, predictor.card.base]).max() > 0.1


def test_motions_side_by_side_do_not_see_each_other(predictor):
    x = motion(predictor.card, 30, copies=4)
    alone = np.concatenate([predictor.run(x[:, [b]]) for b in range(4)], axis=1)
    np.testing.assert_allclose(predictor.run(x), alone, rtol=1e-5, atol=1e-5)


def test_every_run_begins_at_a_start(predictor):
    x = motion(predictor.card, 30)
    first = predictor.run(x)
    predictor.run(motion(predictor.card, 50, seed=1))
    np.testing.assert_array_equal(predictor.run(x), first)


def test_only_the_causal_ones_ignore_the_future(predictor):
    x = motion(predictor.card, 30)
    changed = x.copy()
    changed[20:] *= 0.5
    same = np.allclose(predictor.run(x)[:20], predictor.run(changed)[:20], rtol=0, atol=1e-5)
    assert same == predictor.card.causal


def test_a_buffer_begins_full_of_the_first_sample(tmp_path):
    """A robot that stands still before the motion: the network's answer is the same from the first sample on."""
    window(tmp_path, past=5)
    predictor = Predictor.load(tmp_path)
    x = np.repeat(motion(predictor.card, 1, copies=2, seed=3), 12, axis=0)
    y = predictor.run(x)
    np.testing.assert_allclose(y, np.broadcast_to(y[0], y.shape), rtol=0, atol=1e-5)


def test_double_precision_is_taken_as_well(predictor):
    x = motion(predictor.card, 10)
    np.testing.assert_array_equal(predictor.run(x.astype(np.float64)), predictor.run(x))


@pytest.mark.parametrize("shape", [(10, 1, 20), (0, 1, 21), (10, 0, 21)])
def test_other_shapes_are_refused(predictor, shape):
    with pytest.raises(DataError, match=r"\(T, B, 21\)"):
        predictor.run(np.zeros(shape, np.float32))


def test_a_nan_is_named(predictor):
    x = motion(predictor.card, 10, copies=2)
    x[7, 1, 15] = np.nan
    with pytest.raises(DataError, match=r"simulated.torque.joint2, sample 7 of motion 1"):
        predictor.run(x)


def test_a_history_is_the_network_over_the_samples_so_far(tmp_path):
    bidirectional(tmp_path)
    predictor = Predictor.load(tmp_path)
    x = motion(predictor.card, 12)
    history = History(predictor, capacity=12)
    for t in range(12):
        history.append(x[t, 0].astype(np.float64))
        assert len(history) == t + 1
        np.testing.assert_array_equal(history.corrected(), predictor.run(x[: t + 1])[:, 0])
    with pytest.raises(DataError, match="full"):
        history.append(x[0, 0])
    history.clear()
    with pytest.raises(DataError, match="shape"):
        history.corrected()
    history.append(x[0, 0])
    np.testing.assert_array_equal(history.corrected(), predictor.run(x[:1])[:, 0])


def test_a_history_refuses_what_it_cannot_keep(tmp_path):
    bidirectional(tmp_path)
    predictor = Predictor.load(tmp_path)
    with pytest.raises(ConfigError, match="capacity"):
        History(predictor, capacity=0)
    with pytest.raises(DataError, match=r"\(21,\)"):
        History(predictor, capacity=2).append(np.zeros(20))
