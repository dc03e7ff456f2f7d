"""Networks for bodies: trained on some, they correct others; rotations stay rotations; what does not fit is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from augment.augment_cases import RUN, make_dataset
from augment.body_cases import BODIES, make_bodies
from trueup.augment import Augmentation, AugmentConfig
from trueup.augment.components import components, values_of
from trueup.augment.config import DataConfig, LossConfig, NetworkConfig, OptimizerConfig, WindowConfig, preset
from trueup.augment.networks.sat import SatConfig
from trueup.augment.pairs import any_joint
from trueup.augment.trained import Trained
from trueup.core.model_card import ANY_JOINT, Channel, ModelCard
from trueup.deploy import Stream
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch
from trueup.measure.metrics.body import rotation_distance
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.stages import augment, evaluate

READS = ("body.position", "body.rotation", "body.velocity", "body.force", "body.torque")
LSTM = AugmentConfig(
    "bodies",
    NetworkConfig("lstm", (16,)),
    data=DataConfig(signals=("body.position", "body.rotation"), reads=READS, stops=False, modular=True),
    window=WindowConfig("fixed", samples=60, draws=3),
    optimizer=OptimizerConfig(rate=1e-2),
    epochs=16,
)
SAT = replace(
    LSTM,
    network=SatConfig(hidden=(12,), heads=2, history=12, dropout=0.0),
    loss=LossConfig(kind="absolute"),
    epochs=2,
    window=WindowConfig("fixed", 60, 2),
)


def with_data(config, **changes):
    return replace(config, data=replace(config.data, **changes))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bodies")
    data = make_bodies(folder / "data", noise=1e-4)
    cases = {"lstm": LSTM, "sat": SAT, "whole": with_data(replace(LSTM, epochs=4), modular=False)}
    made = {
        name: augment([data], folder / name, run=RUN, config=config, name=name, jobs=1).augmentation
        for name, config in cases.items()
    }
    return folder, data, made


def test_components_are_those_of_the_six_numbers():
    assert components("body.force") == ("body.force.x", "body.force.y", "body.force.z")
    assert components("torque") == ("torque",)
    rotations = Rotation.random(4, rng=0).as_matrix()[:, None]
    read = [values_of(rotations, 0, name, "here") for name in components("body.rotation")]
    np.testing.assert_array_equal(np.stack(read[:3]), rotations[:, 0, :, 0].T)  # first column, then the second
    np.testing.assert_array_equal(np.stack(read[3:]), rotations[:, 0, :, 1].T)
    eye = np.eye(3)[None, None].repeat(4, axis=0)
    np.testing.assert_array_equal(values_of(eye, 0, "body.rotation.4", "here"), np.ones(4))


def test_the_card_has_the_channels_of_any_body(trained):
    folder, _, made = trained
    card = ModelCard.load(folder / "lstm")
    assert card.joints == (ANY_JOINT,)
    assert [output.signal for output in card.outputs] == [
        *components("body.position"),
        *components("body.rotation"),
    ]
    assert {output.quantity for output in card.outputs} == {"body.position", "body.rotation"}
    whole = made["whole"].card
    assert whole.joints == BODIES
    assert len(whole.outputs) == 9 * len(BODIES)


def test_one_scale_for_each_quantity(trained):
    _, _, made = trained
    for name in ("lstm", "whole"):
        corrector, card = made[name].corrector, made[name].card
        for of, values in ((card.inputs, corrector.scale), (card.outputs, corrector.out_scale)):
            for quantity in {channel.quantity for channel in of}:
                own = [float(v) for channel, v in zip(of, values, strict=True) if channel.quantity == quantity]
                assert np.ptp(own) == 0.0
        for channel, center in zip(card.inputs, corrector.center, strict=True):
            assert channel.quantity == "body.position" or center == 0.0


@pytest.mark.long
def test_it_helps_on_bodies_that_it_never_saw(trained):
    folder, _, _ = trained
    other = make_bodies(folder / "other", counts=(1, 1, 12), noise=1e-4, seed=5, bodies=("hand", "head"))
    found = evaluate(other, [folder / "lstm"], folder / "out", run=RUN)
    result = found.result
    cuts = result.model("lstm").cuts[""]
    for signal, unit in (("body.position", "m"), ("body.rotation", "rad")):
        assert result.joints_of("", signal) == ["hand", "head", ""]
        for body in ("hand", "head"):
            assert cuts[signal][body].factor.low > 1.5
        assert result.unit_of("", signal, "rmse") == unit
    gap = found.measurement.gap.runs
    before = gap[RUN]["test"]["body.position"]["position_norm"].total.value
    after = gap[f"{RUN}+lstm"]["test"]["body.position"]["position_norm"].total.value
    assert after < 0.75 * before
    pooled = result.simulated[""]["body.position"][""].rmse.value
    assert pooled == pytest.approx(np.sqrt(3 * 50) * 1e-3, rel=0.25)  # 1 mm per newton, of three waves of 10 N


@pytest.mark.parametrize("name", ["lstm", "sat", "whole"])
def test_corrected_rotations_are_rotations_and_torch_says_the_same(trained, name):
    folder, data, _ = trained
    episode = data.episode("test0", runs=[RUN])
    corrected = Trained.load(folder / name).predict(episode, RUN)
    by_torch = Augmentation.load(folder / name).predict(episode, RUN)
    rotation = corrected["body.rotation"]
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, -1, -2), np.broadcast_to(np.eye(3), rotation.shape), atol=1e-6
    )
    for signal in ("body.position", "body.rotation"):
        np.testing.assert_allclose(corrected[signal], by_torch[signal], atol=1e-4)
        assert not np.array_equal(corrected[signal], episode.run(RUN)[signal])
    for signal in ("position", "body.velocity", "body.force"):
        np.testing.assert_array_equal(corrected[signal], episode.run(RUN)[signal])
    if name == "lstm":
        gaps = [
            rotation_distance(episode.measured["body.rotation"], item["body.rotation"]).mean()
            for item in (episode.run(RUN), corrected)
        ]
        assert gaps[1] < 0.6 * gaps[0]


def test_a_body_is_corrected_as_if_it_were_alone(trained):
    folder, data, _ = trained
    episode = data.episode("test1", runs=[RUN])
    series = episode.run(RUN)
    own = {name: v[:, 1:2] if name.startswith("body.") else v for name, v in series.signals.items()}
    units = {name: v[1:2] if name.startswith("body.") else v for name, v in series.units.items()}
    alone = replace(episode, simulated={RUN: replace(series, signals=own, units=units, bodies=BODIES[1:2])})
    model = Trained.load(folder / "lstm")
    both = model.predict(episode, RUN)["body.rotation"][:, 1], model.predict(alone, RUN)["body.rotation"][:, 0]
    np.testing.assert_allclose(*both, atol=1e-6)


def test_a_stream_of_bodies_is_the_motion_offline(trained):
    folder, data, _ = trained
    episode = data.episode("test0", runs=[RUN])
    series = episode.run(RUN)
    stream = Stream.load(folder / "lstm", rate_hz=100.0, joints=BODIES)
    offline = Trained.load(folder / "lstm").predict(episode, RUN)
    names = dict.fromkeys((channel.signal, channel.quantity) for channel in stream.card.inputs)
    places = range(len(BODIES))
    for row in range(len(series)):
        now = series.rows(slice(row, row + 1))
        given = {
            signal: np.array([values_of(now[quantity], body, signal, "here")[0] for body in places])
            for signal, quantity in names
        }
        step = stream.step(given)
    assert step.status.value == "ok"
    for axis, signal in enumerate(components("body.position")):
        np.testing.assert_allclose(step[signal], offline["body.position"][-1, :, axis], atol=1e-5)


def test_a_correction_of_zero_changes_no_bit(trained):
    folder, data, _ = trained
    made = Augmentation.load(folder / "lstm")
    made.corrector.set_gate(np.zeros(9))
    episode = data.episode("test0", runs=[RUN])
    corrected = made.predict(episode, RUN)
    for name, values in episode.run(RUN).signals.items():
        np.testing.assert_array_equal(corrected[name], values)


def test_components_are_switched_off_together(trained):
    for made in trained[2].values():
        gates = {}
        for output in made.card.outputs:
            gates.setdefault((output.quantity, output.joint), set()).add(output.gate)
        assert all(len(values) == 1 for values in gates.values())


def test_positions_alone_may_be_measured(tmp_path):
    data = make_bodies(tmp_path / "data", counts=(4, 4, 2), drop=("body.rotation",))
    with pytest.raises(MissingSignal, match=r"the measurement of episode 'train0' has no body.rotation"):
        augment([data], tmp_path / "both", run=RUN, config=LSTM)
    config = with_data(replace(LSTM, epochs=1), signals=("body.position",))
    made = augment([data], tmp_path / "one", run=RUN, config=config, jobs=1)
    assert {output.quantity for output in made.augmentation.card.outputs} == {"body.position"}
    assert {channel.quantity for channel in made.augmentation.card.inputs} == set(READS)
    found = evaluate(data, [tmp_path / "one"], tmp_path / "out", run=RUN)
    assert found.result.signals[-1] == "body.position"


@pytest.mark.long
def test_some_bodies_are_trained_on(trained, tmp_path):
    config = with_data(replace(LSTM, epochs=1), bodies=("foot",))
    made = augment([trained[1]], tmp_path / "foot", run=RUN, config=config, jobs=1)
    assert made.augmentation.card.provenance["training"]["motions"]["train"] == 10
    with pytest.raises(NameMismatch, match="tail"):
        augment([trained[1]], tmp_path / "none", run=RUN, config=with_data(config, bodies=("tail",)))


def test_a_rotation_that_is_none_is_refused(tmp_path):
    def stretched(signals):
        return {**signals, "body.rotation": 1.1 * signals["body.rotation"]}

    data = make_bodies(tmp_path / "data", counts=(2, 2, 1), spoil=stretched)
    with pytest.raises(DataError, match="'train0', measured, thigh: a rotation is none"):
        augment([data], tmp_path / "model", run=RUN, config=LSTM)


def test_what_is_no_network_for_bodies_is_refused(trained, tmp_path):
    folder, data, _ = trained
    joints = make_dataset(tmp_path / "joints", counts=(2, 2, 1))
    with pytest.raises(MissingSignal, match=r"has no body.position") as error:
        augment([joints], tmp_path / "none", run=RUN, config=LSTM)
    assert "simulation: {bodies" in str(error.value)
    with pytest.raises(MissingSignal, match="corrects bodies, and the run has none"):
        evaluate(joints, [folder / "lstm"], tmp_path / "out", run=RUN)
    arm = load_robot("demo_arm")
    with pytest.raises(MissingSignal, match="which no simulator has"):
        Trained.load(folder / "lstm").simulator(MujocoSimulator.from_robot(arm, find_model(arm)))
    with pytest.raises(ConfigError, match="blocks of different dimension"):
        augment([data], tmp_path / "mixed", run=RUN, config=with_data(LSTM, reads=("velocity",)))
    with pytest.raises(ConfigError, match="blocks of different dimension"):
        any_joint([Channel("body.position.x", "a", "m"), Channel("position", "b", "rad", "command")])
    with pytest.raises(ConfigError, match="signals"):
        DataConfig(signals=("body.force",))
    with pytest.raises(ConfigError, match="no limits"):
        DataConfig(signals=("body.position",), normalization="limits")
    with pytest.raises(ConfigError, match=r"body\.pose"):
        DataConfig(reads=("body.pose",))


def test_the_method_for_bodies():
    config = preset("sat-bodies")
    assert config.data.modular
    assert config.data.signals == ("body.position", "body.rotation")
    assert set(config.data.reads) >= {"body.force", "body.torque"}
