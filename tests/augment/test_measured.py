"""A network beside a robot reads what its sensors said one sample before: in training, offline and in a stream alike."""

from dataclasses import replace

import numpy as np
import pytest

from augment.augment_cases import RATE_HZ, RUN, make_dataset
from trueup.augment import AugmentConfig
from trueup.augment.channels import gather
from trueup.augment.config import DataConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.simulator import _refuse_other_signals
from trueup.augment.trained import Trained
from trueup.core.model_card import Channel
from trueup.deploy import Network, Stream
from trueup.errors import ConfigError, MissingSignal
from trueup.stages import augment
from trueup.stages.evaluating import evaluate

CONFIG = AugmentConfig(
    "sensed",
    NetworkConfig("lstm", (16,)),
    data=DataConfig(signals=("torque",), measured=("torque",), stops=False, modular=True),
    window=WindowConfig("fixed", samples=60, draws=4),
    optimizer=OptimizerConfig(rate=1e-2),
    epochs=8,
)


@pytest.fixture(scope="module")
def sensed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensed")
    data = make_dataset(folder / "data", counts=(16, 10, 10))
    augment([data], folder / "model", run=RUN, config=CONFIG, name="sensed", jobs=1)
    return folder, data


def test_a_reading_is_that_of_the_sample_before(sensed):
    _, data = sensed
    episode = data.episode("test0", runs=[RUN])
    run = episode.run(RUN)
    read = gather(episode, RUN, [Channel("torque", "lift", "Nm", "measured")], run.time_s)[:, 0]
    np.testing.assert_array_equal(read[1:], episode.measured["torque"][:-1, 1].astype(np.float32))
    assert read[0] == np.float32(run["torque"][0, 1])


def test_of_slow_sensors_it_knows_the_latest_reading_and_not_the_next(sensed):
    _, data = sensed
    episode = data.episode("test0", runs=[RUN])
    run, every = episode.run(RUN), 5
    slow = replace(episode, measured=episode.measured.rows(np.arange(0, len(episode.measured), every)))
    read = gather(slow, RUN, [Channel("torque", "lift", "Nm", "measured")], run.time_s)[:, 0]
    latest = np.arange(len(run) - 1) // every * every
    np.testing.assert_array_equal(read[1:], episode.measured["torque"][latest, 1].astype(np.float32))


def test_it_does_not_see_what_it_must_say(sensed):
    """Other measurements from a sample on change nothing of what is said up to this sample."""
    folder, data = sensed
    episode = data.episode("test0", runs=[RUN])
    torque = episode.measured["torque"].copy()
    torque[30:] += 50.0
    other = replace(episode, measured=replace(episode.measured, signals={**episode.measured.signals, "torque": torque}))
    model = Trained.load(folder / "model")
    first, second = (model.predict(item, RUN)["torque"] for item in (episode, other))
    np.testing.assert_array_equal(first[:31], second[:31])
    assert np.abs(first[31:] - second[31:]).max() > 0.1


@pytest.mark.long
def test_it_is_evaluated_like_any_other(sensed, tmp_path):
    folder, data = sensed
    found = evaluate(data, [folder / "model"], tmp_path / "out", run=RUN)
    assert found.result.model("sensed").cuts[""]["torque"]["lift"].factor.low > 2


@pytest.mark.long
def test_a_stream_that_is_given_the_readings_is_the_motion_offline(sensed):
    folder, data = sensed
    episode = data.episode("test0", runs=[RUN])
    offline = Trained.load(folder / "model").predict(episode, RUN)
    run, readings = episode.run(RUN), episode.measured["torque"]
    stream = Stream.load(folder / "model", rate_hz=RATE_HZ, joints=run.joints)
    answers = []
    for row in range(len(run)):
        simulated = {"torque": run["torque"][row]}
        told = {"torque": readings[row - 1] if row else run["torque"][0]}
        answers.append(np.array(stream.step(simulated, measured=told)["torque"]))
    warm = stream.card.warmup_steps
    np.testing.assert_allclose(answers[warm:], offline["torque"][warm:], atol=1e-4, rtol=1e-5)
    with pytest.raises(MissingSignal, match=r"measured\.torque"):
        stream.step({"torque": run["torque"][0]})


def test_a_simulator_has_no_sensors(sensed):
    folder, _ = sensed
    card = Network.load(folder / "model").card.of_joints(("pan", "lift"))
    with pytest.raises(ConfigError, match="a simulator has none"):
        _refuse_other_signals(card)


def test_who_sees_the_future_needs_no_reading():
    with pytest.raises(ConfigError, match="in a control loop"):
        replace(CONFIG, network=NetworkConfig("lstm", (16,), bidirectional=True))
