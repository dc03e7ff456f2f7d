"""One network for all joints: it is trained on some, and corrects others, on other robots, in streams and offline alike."""

from dataclasses import replace

import numpy as np
import pytest

from augment.augment_cases import RATE_HZ, RUN, make_dataset
from trueup.augment import Augmentation, AugmentConfig, preset
from trueup.augment.config import DataConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.corrector import Corrector
from trueup.augment.gating import errors_of
from trueup.augment.networks import build_network
from trueup.augment.networks.sat import SatConfig
from trueup.augment.pairs import any_joint, channels_of, write_pairs
from trueup.augment.scaling import Scaling
from trueup.augment.trained import Trained
from trueup.core.model_card import ANY_JOINT, STEP_NAME, ModelCard
from trueup.deploy import Network, Status, Stream, Why
from trueup.errors import ConfigError, MissingSignal, NameMismatch, UnitError
from trueup.stages import augment, evaluate

LSTM = AugmentConfig(
    "modular",
    NetworkConfig("lstm", (16,)),
    data=DataConfig(stops=False, modular=True),
    window=WindowConfig("fixed", samples=60, draws=4),
    optimizer=OptimizerConfig(rate=1e-2),
    epochs=12,
)
SAT = replace(
    LSTM,
    network=SatConfig(hidden=(16,), heads=2, history=12, dropout=0.0),
    epochs=3,
    window=WindowConfig("fixed", 60, 2),
)
THREE = ("left", "right", "lid")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("modular")
    data = make_dataset(folder / "two", counts=(16, 12, 3), noise=0.001)
    models = {}
    for name, config in {"lstm": LSTM, "sat": SAT}.items():
        made = augment([data], folder / name, run=RUN, config=config, name=name, jobs=1)
        models[name] = folder / name, made.augmentation
    return folder, models


@pytest.mark.parametrize("name", ["lstm", "sat"])
def test_the_card_has_the_channels_of_any_joint(trained, name):
    card = ModelCard.load(trained[1][name][0])
    assert (card.modular, card.joints, card.copies) == (True, (ANY_JOINT,), 1)
    assert {channel.joint for channel in (*card.inputs, *card.outputs)} == {ANY_JOINT}
    own = card.of_joints(THREE)
    assert (own.joints, own.copies) == (THREE, 3)
    width = len(card.inputs)
    for output in own.outputs:
        base = own.inputs[output.base]
        assert (base.signal, base.joint) == (output.signal, output.joint)
        assert output.base // width == THREE.index(output.joint)
    assert own.of_joints(("other",)) is own
    assert ModelCard.from_json(card.to_json()) == card


@pytest.mark.long
def test_joints_of_one_motion_are_one_motion(trained, tmp_path):
    """They move together: the bootstrap of the gate and the promise of intervals must not count them twice."""
    _, models = trained
    folder, _ = models["lstm"]
    training = ModelCard.load(folder).provenance["training"]["motions"]
    assert training == {"train": 16, "val": 12}
    few = make_dataset(tmp_path / "few", counts=(4, 5, 1), seed=8)
    card = augment([few], tmp_path / "model", run=RUN, config=replace(LSTM, epochs=1), jobs=1).augmentation.card
    assert card.coverage_note.startswith("5 val motions")


def test_the_errors_of_a_motion_are_those_of_its_joints(tmp_path):
    data = make_dataset(tmp_path / "data", counts=(1, 1, 3))
    episodes = [data.episode(name, runs=[RUN]) for name in data.select(split="test")]
    inputs, outputs = (any_joint(part) for part in channels_of(episodes[0], RUN, signals=["torque"], known=["torque"]))
    written = write_pairs(
        episodes,
        tmp_path / "test.f32",
        run=RUN,
        inputs=inputs,
        outputs=outputs,
        rate_hz=RATE_HZ,
        joints=("pan", "lift"),
    )
    one = np.ones(1)
    network = build_network(NetworkConfig("lstm", (4,)), inputs=1, base=[0], rate_hz=RATE_HZ)
    corrector = Corrector(network, Scaling(one, one, one, one, one), np.array([0]), target="residual")
    corrector.set_gate(np.zeros(1))
    found = errors_of(corrector, written)
    assert (written.episodes, len(written.motions)) == (3, 6)
    assert found.conditions == tuple(episode.meta.condition for episode in episodes)
    for number, episode in enumerate(episodes):
        apart = (episode.measured["torque"] - episode.run(RUN)["torque"]) ** 2
        assert found.rows[number] == apart.size
        assert found.simulated[number, 0] == pytest.approx(apart.sum(), rel=1e-4)


def test_it_helps_on_a_robot_that_it_never_saw(trained):
    folder, models = trained
    path = folder / "three"
    other = make_dataset(path, counts=(1, 1, 12), noise=0.001, joints=THREE, seed=5)
    found = evaluate(other, [models["lstm"][0]], folder / "out", run=RUN)
    for joint in THREE:
        assert found.result.model("lstm").cuts[""]["torque"][joint].factor.low > 2
    assert any("used here on" in line for line in found.warnings) or found.warnings == ()


@pytest.mark.parametrize("name", ["lstm", "sat"])
def test_a_stream_of_three_joints_is_the_motion_offline(trained, name):
    folder, models = trained
    path = folder / f"three-{name}"
    other = make_dataset(path, counts=(1, 1, 1), noise=0.0, joints=THREE, seed=6)
    episode = other.episode("test0", runs=[RUN])
    model = Trained.load(models[name][0])
    offline = model.predict(episode, RUN)
    by_torch = Augmentation.load(models[name][0]).predict(episode, RUN)
    simulated = episode.run(RUN)
    signals = {channel.signal for channel in model.card.inputs}
    stream = Stream.load(models[name][0], rate_hz=RATE_HZ, joints=THREE)
    assert stream.card.joints == THREE
    for row in range(len(simulated)):
        step = stream.step({name: simulated[name][row] for name in signals})
        if step.status.value != "ok":
            continue
        for signal in dict.fromkeys(output.signal for output in stream.card.outputs):
            np.testing.assert_allclose(step[signal], offline[signal][row], atol=1e-4, rtol=1e-5)
            np.testing.assert_allclose(by_torch[signal][row], offline[signal][row], atol=1e-4, rtol=1e-5)
    assert step.status.value == "ok"


def test_it_is_the_same_network_for_every_joint(trained):
    """A joint's correction does not depend on the others beside it."""
    folder, models = trained
    other = make_dataset(folder / "alone", counts=(1, 1, 1), joints=THREE, seed=7)
    episode = other.episode("test0", runs=[RUN])
    model = Trained.load(models["lstm"][0])
    whole = model.predict(episode, RUN)
    alone = replace(
        episode,
        measured=episode.measured.select(["lid"]),
        command=episode.command.select(["lid"]),
        simulated={RUN: episode.run(RUN).select(["lid"])},
    )
    np.testing.assert_allclose(model.predict(alone, RUN)["torque"][:, 0], whole["torque"][:, 2], atol=1e-6)


def test_some_joints_are_trained_on(trained, tmp_path):
    folder, _ = trained
    from trueup.dataset import Dataset

    data = Dataset(folder / "two")
    config = replace(LSTM, epochs=1, data=replace(LSTM.data, joints=("lift",)))
    made = augment([data], tmp_path / "one", run=RUN, config=config, jobs=1)
    assert made.augmentation.card.provenance["training"]["motions"]["train"] == 16
    with pytest.raises(NameMismatch, match="elbow"):
        augment(
            [data], tmp_path / "none", run=RUN, config=replace(config, data=replace(config.data, joints=("elbow",)))
        )
    with pytest.raises(MissingSignal, match="load"):
        augment([data], tmp_path / "load", run=RUN, config=replace(config, data=replace(config.data, reads=("load",))))


@pytest.fixture(scope="module")
def upright(tmp_path_factory):
    """A robot with joints that stand elsewhere and turn the other way around than those that were trained on."""
    folder = tmp_path_factory.mktemp("upright")
    data = make_dataset(folder / "data", counts=(16, 4, 3))
    shown = DataConfig(signals=("position",), reads=("velocity",), stops=False, modular=True)
    models = {}
    odd = replace(shown, blind=("position",), mirrored=True)
    for name, config in {"plain": shown, "odd": odd, "told": replace(odd, command=("position",))}.items():
        made = augment([data], folder / name, run=RUN, config=replace(LSTM, data=config, epochs=20), name=name, jobs=1)
        models[name] = made.augmentation
    return folder, data, models


def moved(data, *, by=0.0, turned=1.0):
    episode = data.episode("test0", runs=[RUN])
    run = episode.run(RUN)
    signals = {name: turned * values for name, values in run.signals.items()}
    return replace(episode, simulated={RUN: replace(run, signals={**signals, "position": signals["position"] + by})})


def test_who_does_not_read_a_position_corrects_it_the_same_elsewhere(upright):
    _, data, models = upright

    def added(model, by):
        episode = moved(data, by=by)
        return model.predict(episode)["position"] - episode.run(RUN)["position"]

    here, there = added(models["odd"], 0.0), added(models["odd"], 40.0)
    assert np.abs(here).max() > 0.01
    np.testing.assert_allclose(there, here, atol=1e-5)
    assert np.abs(added(models["plain"], 40.0) - added(models["plain"], 0.0)).max() > 0.01


@pytest.mark.long
def test_a_stream_trusts_it_wherever_a_joint_stands(upright):
    """How far the command is from the joint is read, not where both are."""
    folder, data, models = upright
    told = models["told"].card.inputs
    assert [(np.isinf(channel.high), channel.relative) for channel in told] == [
        (True, False),
        (False, False),
        (False, True),
    ]
    assert told[2].high == -told[2].low < 0.2  # the simulator is off by 20 ms
    run, command = data.episode("test0", runs=[RUN]).run(RUN), data.episode("test0").commanded()
    answers = []
    for by in (0.0, 40.0):
        stream = Stream.load(folder / "told", rate_hz=RATE_HZ, joints=run.joints)
        rows = []
        for row in range(len(run)):
            simulated = {"position": run["position"][row] + by, "velocity": run["velocity"][row]}
            step = stream.step(simulated, {"position": command["position"][row] + by})
            rows.append(step["position"] - simulated["position"])
        assert (step.status, step.flags) == (Status.OK, 0)
        answers.append(rows)
    assert np.abs(answers[0]).max() > 0.01
    np.testing.assert_allclose(answers[1], answers[0], atol=2e-5)  # at 40 rad, float32 has 4e-6 rad
    away = {"position": simulated["position"] - [0.0, 1.0]}
    step = stream.step(simulated, away)
    assert (step.status, step.why, step.channels()) == (
        Status.FALLBACK,
        Why.OUT_OF_RANGE,
        ("command.position.lift",),
    )
    np.testing.assert_array_equal(step["position"], simulated["position"])
    assert stream._cell.x.reshape(2, -1)[1, 2] - simulated["position"][1] == pytest.approx(
        stream._span.low[5], rel=1e-4
    )


@pytest.mark.long
def test_what_was_learned_the_other_way_around_prefers_no_direction(upright):
    _, data, models = upright
    apart = {}
    for name, model in ((name, models[name]) for name in ("plain", "odd")):
        there, back = moved(data), moved(data, turned=-1.0)
        added = [model.predict(item)["position"] - item.run(RUN)["position"] for item in (there, back)]
        apart[name] = np.abs(added[0] + added[1]).mean() / np.abs(added[0]).mean()
    assert models["odd"].corrector.center.abs().max() < 1e-6
    assert apart["odd"] < 0.5


def test_a_graph_leaves_out_what_is_not_read(upright):
    folder, data, models = upright
    episode = moved(data, by=40.0)
    by_torch, by_onnx = models["odd"].predict(episode), Trained.load(folder / "odd").predict(episode, RUN)
    np.testing.assert_allclose(by_onnx["position"], by_torch["position"], atol=1e-4)
    card = models["odd"].card
    assert [np.isinf(channel.high) for channel in card.inputs] == [True, False]
    assert ModelCard.from_json(card.to_json()) == card
    again = Augmentation.load(folder / "odd").predict(episode)
    np.testing.assert_array_equal(again["position"], by_torch["position"])


def test_blind_and_mirrored_where_they_mean_something():
    with pytest.raises(ConfigError, match="not corrected"):
        DataConfig(signals=("position",), blind=("velocity",))
    with pytest.raises(ConfigError, match="modular"):
        DataConfig(mirrored=True)
    average = preset("moving-average")
    with pytest.raises(ConfigError, match="averages"):
        replace(average, data=replace(average.data, blind=("position",)))


def test_hinges_and_slides_are_two_kinds():
    from trueup.core.model_card import Channel

    with pytest.raises(UnitError, match="different kinds"):
        any_joint([Channel("position", "a", "rad"), Channel("position", "b", "m")])


def test_what_slides_is_left_alone(trained):
    card = ModelCard.load(trained[1]["lstm"][0])
    episode = next(make_dataset(trained[0] / "mixed", counts=(1, 1, 1)).episodes(runs=[RUN]))
    run = episode.run(RUN)
    _, *others = run.joints
    units = {name: ("m" if name == "position" else "m/s", *own[1:]) for name, own in run.units.items()}
    assert card.blocks_of(replace(run, units=units)) == tuple(others)
    sliding = replace(run, units={name: ("m",) * len(run.joints) for name in run.units})
    assert card.blocks_of(sliding) == run.joints  # none fits; the error of what reads them names the units


def test_a_modular_network_knows_no_limits():
    with pytest.raises(ConfigError, match="knows no limits"):
        DataConfig(modular=True)
    with pytest.raises(ConfigError, match="knows no limits"):
        DataConfig(modular=True, stops=False, normalization="limits")


def test_a_graph_of_single_steps_says_so(trained):
    _, models = trained
    assert Network.load(models["sat"][0]).stepwise
    assert not Network.load(models["lstm"][0]).stepwise


def test_mixed_precision_is_for_gpus(trained, tmp_path):
    folder, _ = trained
    from trueup.dataset import Dataset

    with pytest.raises(ConfigError, match="for GPUs"):
        augment([Dataset(folder / "two")], tmp_path / "m", run=RUN, config=replace(LSTM, precision="mixed"), jobs=1)


def test_a_folder_holds_the_step_of_a_sat_only(trained, tmp_path):
    _, models = trained
    assert STEP_NAME in ModelCard.load(models["sat"][0]).files
    assert STEP_NAME not in ModelCard.load(models["lstm"][0]).files
    for name in ("sat", "lstm"):  # what belongs to the network before goes with it
        models[name][1].save(tmp_path)
        assert (tmp_path / STEP_NAME).exists() == (name == "sat")
