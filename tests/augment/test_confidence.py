"""Gates and intervals: what val says is what new motions keep."""

import numpy as np
import pytest
import torch

from trueup.augment.calibration import far_off, intervals_of, warmup_steps
from trueup.augment.config import NetworkConfig
from trueup.augment.corrector import Corrector
from trueup.augment.gating import Errors, errors_of, gates_of
from trueup.augment.networks import build_network
from trueup.augment.networks.base import Network
from trueup.augment.pairs import write_pairs
from trueup.augment.scaling import Scaling
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.model_card import Channel
from trueup.core.timeseries import TimeSeries

CHANNEL = Channel("torque", "pan", "Nm")


class Half(Network):
    """Corrects by half of the input."""

    @property
    def states(self):
        return ()

    def run(self, x, states, lengths):
        del states, lengths
        return 0.5 * x, ()

    def draw(self, graph, x, states):
        del states
        return graph.add("Mul", x, graph.floats(0.5)), ()


def even(size):
    return lambda x: np.full_like(x, size)


def corrector_of(network):
    one = np.ones(1)
    return Corrector(network, Scaling(0 * one, one, 0 * one, one, one), np.array([0]), target="residual").eval()


def pairs_of(folder, name, motions, rng, *, error, spread=0.3):
    """Motions whose robot is the corrected simulator plus an error that differs from motion to motion."""
    episodes = []
    for number in range(motions):
        samples = int(rng.integers(50, 150))
        x = np.sin(rng.uniform(0.01, 0.1) * np.arange(samples) + rng.uniform(0, 6))[:, None] * rng.uniform(1, 4)
        level = np.exp(spread * rng.normal())
        y = 1.5 * x + level * error(x) * rng.normal(size=x.shape)
        clock = np.arange(samples) / 100
        series = [TimeSeries(clock, ("pan",), {"torque": values}, {"torque": ("Nm",)}) for values in (x, y)]
        meta = EpisodeMeta(f"{name}{number}", condition=("a", "b")[number % 2])
        episodes.append(Episode(meta, series[1], simulated={"s": series[0]}))
    path = folder / f"{name}.f32"
    return write_pairs(episodes, path, run="s", inputs=(CHANNEL,), outputs=(CHANNEL,), rate_hz=100.0)


def covered(corrector, pairs, intervals):
    """Share of samples within the interval, motion by motion."""
    shares = []
    for _, x, y in pairs:
        with torch.no_grad():
            corrected = corrector(torch.from_numpy(x[:, None].copy()))[:, 0].numpy()
        width = intervals.base[0] + intervals.slope[0] * np.abs(corrected - x)
        shares.append((np.abs(y - corrected) <= width).mean())
    return np.array(shares)


def test_intervals_cover_new_motions_as_promised(tmp_path):
    """Averaged over many draws of val, coverage is at least the promise, and not by much more."""
    rng = np.random.default_rng(0)
    corrector = corrector_of(Half(NetworkConfig(), 1, [0], 100.0))
    new = pairs_of(tmp_path, "new", 200, rng, error=lambda x: 0.1 + 0.2 * np.abs(x))
    shares = []
    for draw in range(20):
        val = pairs_of(tmp_path, f"val{draw}", 30, rng, error=lambda x: 0.1 + 0.2 * np.abs(x))
        intervals = intervals_of(corrector, val, 0.9)
        assert intervals.note == ""
        shares.append(covered(corrector, new, intervals).mean())
    assert 0.895 <= np.mean(shares) <= 0.95


def test_intervals_are_wider_where_errors_are(tmp_path):
    rng = np.random.default_rng(1)
    corrector = corrector_of(Half(NetworkConfig(), 1, [0], 100.0))
    growing = intervals_of(corrector, pairs_of(tmp_path, "a", 60, rng, error=lambda x: 0.01 + 0.3 * np.abs(x)), 0.9)
    steady = intervals_of(corrector, pairs_of(tmp_path, "b", 60, rng, error=lambda x: 0.3 + 0 * x), 0.9)
    assert growing.slope[0] > 5 * steady.slope[0]


def test_too_few_motions_promise_nothing(tmp_path):
    rng = np.random.default_rng(2)
    corrector = corrector_of(Half(NetworkConfig(), 1, [0], 100.0))
    few = intervals_of(corrector, pairs_of(tmp_path, "few", 8, rng, error=even(0.1)), 0.9)
    assert few.note == "8 val motions; 9 are needed to promise 90 % coverage"
    assert intervals_of(corrector, pairs_of(tmp_path, "more", 9, rng, error=even(0.1)), 0.9).note == ""


def test_the_probability_of_far_off_is_how_often_it_is(tmp_path):
    """Predicted probabilities against frequencies on new motions."""
    rng = np.random.default_rng(3)
    corrector = corrector_of(Half(NetworkConfig(), 1, [0], 100.0))
    val, new = (pairs_of(tmp_path, name, 150, rng, error=even(0.4), spread=0) for name in ("val", "new"))
    rms = float(np.sqrt(np.mean(np.concatenate([(y - x) ** 2 for _, x, y in val]))))
    found = far_off(corrector, val, np.array([rms]))
    assert found.threshold[0] == pytest.approx(2 * rms)
    probability = np.array(found.probability[0])
    assert (np.diff(probability) >= 0).all()
    assert (np.diff(found.correction[0]) > 0).all()
    assert probability[0] < 0.02
    assert probability[-1] > 0.3
    x, y = (np.concatenate(parts) for parts in zip(*((x, y) for _, x, y in new), strict=True))
    predicted = np.interp(np.abs(0.5 * x), found.correction[0], probability)
    far = np.abs(y - x) > found.threshold[0]
    for low, high in ((0, 0.05), (0.05, 0.3), (0.3, 1)):
        chosen = (predicted >= low) & (predicted < high)
        assert far[chosen].mean() == pytest.approx(predicted[chosen].mean(), abs=0.06)


def errors(simulated, corrected, conditions=None, executed=()):
    simulated, corrected = (np.asarray(part, float).reshape(-1, 1) for part in (simulated, corrected))
    conditions = tuple(conditions or ["a"] * len(simulated))
    return Errors(np.full(len(simulated), 10.0), simulated, corrected, conditions, tuple(executed))


def test_an_output_that_helps_is_used():
    rng = np.random.default_rng(4)
    used, reasons = gates_of(errors(rng.uniform(1, 2, 20), rng.uniform(0.1, 0.5, 20)))
    assert used.tolist() == [True]
    assert reasons == ("",)


@pytest.mark.parametrize(
    ("simulated", "corrected", "conditions", "reason"),
    [
        ([1.0] * 12, [4.0] * 12, None, "error on val larger than the simulator's, by 100 %"),
        ([1.0] * 12, [1.004] * 12, None, "error on val larger than the simulator's, by less than 1 %"),
        (
            [1.0] * 12,
            [11.9 if k == 0 else 0.0 for k in range(12)],
            None,
            "no better than the simulator on val beyond chance",
        ),
        ([1.0] * 12, [1.05, 0.1] * 6, ["slow", "fast"] * 6, "error on val larger than the simulator's in slow motions"),
        ([0.0] * 12, [0.0] * 12, None, "the simulator is exact on val"),
    ],
)
def test_an_output_that_does_not_help_is_switched_off_and_says_why(simulated, corrected, conditions, reason):
    used, reasons = gates_of(errors(simulated, corrected, conditions))
    assert used.tolist() == [False]
    assert reasons == (reason,)


def test_chance_opens_few_gates():
    """A correction that changes nothing on average passes no more often than the interval allows."""
    rng = np.random.default_rng(5)
    opened = 0
    for _ in range(200):
        simulated = rng.uniform(1, 2, 30)
        opened += bool(gates_of(errors(simulated, simulated + rng.normal(0, 0.3, 30)), draws=300)[0][0])
    assert opened <= 14


def test_repetitions_of_a_motion_are_no_further_evidence():
    """One motion of ten speaks for the correction, and loudly; recorded six times, it is still one of ten."""
    rng = np.random.default_rng(9)
    simulated = np.ones(15)
    corrected = np.where(np.arange(15) < 6, 0.1, 1.0 + rng.normal(0, 0.05, 15))
    executed = [f"m{max(0, number - 5)}" for number in range(15)]
    assert gates_of(errors(simulated, corrected))[0].tolist() == [True]
    used, reasons = gates_of(errors(simulated, corrected, executed=executed))
    assert (used.tolist(), reasons) == ([False], ("no better than the simulator on val beyond chance",))
    plain = errors(simulated, corrected, executed=[f"m{number}" for number in range(15)])
    assert plain.motions.tolist() == errors(simulated, corrected).motions.tolist() == list(range(15))


def test_errors_are_sums_over_each_motion(tmp_path):
    rng = np.random.default_rng(6)
    pairs = pairs_of(tmp_path, "val", 7, rng, error=even(0.2))
    found = errors_of(corrector_of(Half(NetworkConfig(), 1, [0], 100.0)), pairs)
    for number, (_, x, y) in enumerate(pairs):
        assert found.rows[number] == len(x)
        assert found.simulated[number, 0] == pytest.approx(float(((y - x) ** 2).sum()), rel=1e-4)
        assert found.corrected[number, 0] == pytest.approx(float(((y - 1.5 * x) ** 2).sum()), rel=1e-4)
    assert found.conditions == ("a", "b", "a", "b", "a", "b", "a")


def test_a_window_is_warm_when_it_is_full(tmp_path):
    """A mean over the past 40 samples knows what it should after 39 of them, and not much earlier."""
    rng = np.random.default_rng(7)
    network = build_network(NetworkConfig("moving-average", (), history=40), inputs=1, base=[0])
    episodes = []
    for number in range(60):
        x = rng.normal(size=(200, 1))
        mean = np.stack(
            [np.concatenate([np.repeat(x[:1], 39, axis=0), x])[k : k + 40].mean(axis=0) for k in range(200)]
        )
        series = [TimeSeries(np.arange(200) / 100, ("pan",), {"torque": v}, {"torque": ("Nm",)}) for v in (x, mean)]
        episodes.append(Episode(EpisodeMeta(f"m{number}"), series[1], simulated={"s": series[0]}))
    pairs = write_pairs(episodes, tmp_path / "p.f32", run="s", inputs=(CHANNEL,), outputs=(CHANNEL,), rate_hz=100.0)
    assert 35 <= warmup_steps(corrector_of(network), pairs, 100.0) <= 39
    assert warmup_steps(corrector_of(Half(NetworkConfig(), 1, [0], 100.0)), pairs, 100.0) == 0
