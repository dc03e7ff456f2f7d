"""The line under a network: it is found, it goes on beyond the training range, and graph and torch agree on it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from augment.augment_cases import RATE_HZ, RUN, UNITS, make_dataset, robot, write_run
from trueup.augment import Augmentation, AugmentConfig
from trueup.augment.config import DataConfig, LossConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.networks.sat import SatConfig
from trueup.augment.trained import Trained
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.stages import augment

# A SAT adds nothing before it is trained: with next to no training, what is left is the line.
BARE = AugmentConfig(
    "line",
    SatConfig(hidden=(8,), heads=2, history=4),
    data=DataConfig(signals=("position",), reads=("torque",), command=("position",), stops=False, modular=True),
    window=WindowConfig("fixed", 40, 1),
    optimizer=OptimizerConfig(rate=1e-12),
    epochs=1,
    line=True,
)


def law(folder, size, seed=0):
    """Joints that give way by 0.02 rad/Nm and lag by a tenth of how far their command is ahead."""
    rng, arm, runs = np.random.default_rng(seed), robot(), {}
    names = arm.joint_names
    with DatasetWriter.create(folder, DatasetInfo(robot="arm")) as writer:
        for number, split in enumerate(("train",) * 6 + ("val",) * 3 + ("test",) * 2):
            time_s = np.arange(120) / RATE_HZ
            wave = np.cumsum(rng.normal(size=(120, 2)), axis=0) * 0.01
            torque = size * rng.normal(size=(120, 2))
            command = wave + 0.05 * rng.normal(size=(120, 2))
            measured = wave + 0.02 * torque + 0.1 * (command - wave) + 0.003
            series = [
                TimeSeries(time_s, names, signals, same_units({key: UNITS[key] for key in signals}, names))
                for signals in ({"position": wave, "torque": torque}, {"position": measured}, {"position": command})
            ]
            meta = EpisodeMeta(f"m{number}", split=split)
            writer.append(Episode(meta, series[1], series[2]))
            runs[meta.id] = series[0]
    write_run(folder, runs, arm)
    return Dataset(folder)


def test_it_goes_on_where_training_ended(tmp_path):
    made = augment([law(tmp_path / "near", 1.0)], tmp_path / "model", run=RUN, config=BARE, name="line", jobs=1)
    corrector = made.augmentation.corrector
    channels = [channel.name for channel in made.augmentation.card.inputs]
    # In SI: the slope of what is added by what is read.
    slope = (corrector.out_scale * corrector.line_weight[0] / corrector.scale).numpy()
    found = dict(zip(channels, slope, strict=True))
    assert found["simulated.torque.*"] == pytest.approx(0.02, rel=0.01)
    assert found["command.position.*"] == pytest.approx(0.1, rel=0.02)
    far = law(tmp_path / "far", 20.0, seed=1)
    for episode in far.episodes(runs=[RUN]):
        corrected = Trained.load(tmp_path / "model").predict(episode, RUN)
        np.testing.assert_allclose(corrected["position"], episode.measured["position"], atol=0.02)
        off = np.abs(episode.measured["position"] - episode.run(RUN)["position"])
        assert off.max() > 0.5  # what it had to correct


def test_the_network_is_told_the_nearest_input_that_it_knows(tmp_path):
    config = replace(BARE, optimizer=OptimizerConfig(rate=1e-2))
    made = augment([law(tmp_path / "near", 1.0)], tmp_path / "model", run=RUN, config=config, name="line", jobs=1)
    corrector = made.augmentation.corrector
    x = torch.zeros(5, 1, 3)
    x[:, 0, 1] = 100.0
    further = x.clone()
    further[:, 0, 1] = 300.0
    assert torch.equal(corrector.read(x), corrector.read(further))
    slope = (corrector.out_scale * corrector.line_weight[0, 1] / corrector.scale[1]).item()
    with torch.no_grad():
        grown = (corrector(further) - corrector(x)).squeeze()
    np.testing.assert_allclose(grown, 200.0 * slope, rtol=1e-4)


KINDS = {
    "sat": SatConfig(hidden=(8,), heads=2, history=6, dropout=0.0),
    "lstm": NetworkConfig("lstm", (6,)),
    "transformer": NetworkConfig("transformer", (8,), history=6, heads=2),
}


@pytest.fixture(scope="module", params=KINDS)
def lined(request, tmp_path_factory):
    """Trained with commands and stops, not modular: everything that a line may stand beside."""
    folder = tmp_path_factory.mktemp(request.param)
    config = AugmentConfig(
        request.param,
        KINDS[request.param],
        data=DataConfig(command=("position",)),
        window=WindowConfig("fixed", 40, 1),
        epochs=2,
        line=True,
    )
    data = make_dataset(folder / "data", counts=(10, 8, 2), noise=0.001)
    augment([data], folder / "model", run=RUN, config=config, name="line", robot=robot(), jobs=1)
    return folder / "model"


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), size=st.floats(0.1, 30.0))
def test_graph_and_torch_say_the_same_near_and_far(lined, seed, size):
    rng = np.random.default_rng(seed)
    loaded, trained = Augmentation.load(lined), Trained.load(lined)
    names = trained.card.joints
    time_s = np.arange(30) / RATE_HZ
    signals = {name: size * rng.normal(size=(30, len(names))) for name in UNITS}
    series = TimeSeries(time_s, names, signals, same_units(UNITS, names))
    command = TimeSeries(time_s, names, {"position": signals["position"] + 0.1}, same_units({"position": "rad"}, names))
    episode = Episode(EpisodeMeta("one"), series, command, simulated={RUN: series})
    by_torch, by_graph = loaded.predict(episode, RUN), trained.predict(episode, RUN)
    for name in UNITS:
        np.testing.assert_allclose(by_graph[name], by_torch[name], atol=2e-5 * max(1.0, size), rtol=2e-5)


@pytest.mark.parametrize(
    "changed",
    [{"loss": LossConfig(target="plain")}, {"network": NetworkConfig("moving-average", hidden=(), history=5)}],
)
def test_a_line_under_nothing_is_refused(changed):
    with pytest.raises(ConfigError, match="line"):
        replace(AugmentConfig(line=True), **changed)
