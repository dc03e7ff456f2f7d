"""Training: the same result however it is interrupted, and no result where there can be none."""

import shutil
from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from augment.augment_cases import JOINTS, RUN, make_dataset, motion, robot, write_run
from trueup.augment import Augmentation, AugmentConfig, augmentation, preset
from trueup.augment.checkpoint import digest_of
from trueup.augment.config import CHECKPOINT_NAME, DataConfig, LossConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.pairs import refuse_overlap, write_pairs
from trueup.augment.scaling import summarize
from trueup.augment.trained import Trained
from trueup.augment.windows import Windows, whole_motions
from trueup.cli.augment_train import progress_line
from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.model_card import Channel, ModelCard
from trueup.core.step_times import LATENCY_NAME
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.deploy import Status
from trueup.errors import (
    ConfigError,
    DataError,
    MissingDependency,
    MissingSignal,
    NameMismatch,
    OutputExists,
    TrueupError,
)
from trueup.stages import augment as augment_stage
from trueup.stages.close_networks import Planned, train_each
from trueup.stages.model_folder import SCRATCH_NAME
from trueup.stages.training_data import lowest_rate

SMALL = AugmentConfig(
    network=NetworkConfig("lstm", (12, 8)),
    window=WindowConfig("fixed", samples=40, draws=4),
    optimizer=OptimizerConfig(rate=2e-2, warmup_steps=5),
    batch=4,
    epochs=6,
    stop_after=0,
)


def augment(*args, **kwargs):
    """On one thread: these networks are too small for more, and tests run beside one another."""
    return augment_stage(*args, jobs=1, **kwargs)


def weights(folder):
    return {name: value.numpy() for name, value in Augmentation.load(folder).corrector.state_dict().items()}


def same(left, right):
    return left.keys() == right.keys() and all(np.array_equal(left[name], right[name]) for name in left)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("data") / "arm")


@pytest.mark.long
def test_it_learns_what_the_simulator_has_wrong(data, tmp_path):
    made = augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=40))
    val = made.augmentation.card.metrics["val"]
    for joint in JOINTS:
        assert val["torque"][joint]["corrected"] < 0.4 * val["torque"][joint]["simulated"]
        assert val["position"][joint]["corrected"] < 0.7 * val["position"][joint]["simulated"]


def test_a_signal_that_the_simulator_has_right_is_left_alone(data, tmp_path):
    made = augment([data], tmp_path, run=RUN, config=SMALL)
    card = made.augmentation.card
    off = {(output.signal, output.joint): output.reason for output in card.outputs if output.gate == 0}
    assert all(off.get(("velocity", joint)) == "the simulator is exact on val" for joint in JOINTS)
    assert any("velocity of pan" in note and "switched off" in note for note in made.notes)


def test_nothing_is_ever_worse_than_the_simulator_on_val(data, tmp_path):
    """Even a network that has learned nothing."""
    worst = replace(SMALL, epochs=1, optimizer=OptimizerConfig(rate=1e-9))
    made = augment([data], tmp_path, run=RUN, config=worst)
    for joints in made.augmentation.card.metrics["val"].values():
        assert all(item["corrected"] <= item["simulated"] for item in joints.values())


@pytest.mark.long
def test_the_same_seed_gives_the_same_weights_and_another_seed_others(data, tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        augment([data], tmp_path / name, run=RUN, config=SMALL, seed=seed)
    assert same(weights(tmp_path / "a"), weights(tmp_path / "b"))
    assert not same(weights(tmp_path / "a"), weights(tmp_path / "c"))


class Stop(Exception):
    pass


@pytest.mark.parametrize("config", ["default", "paper"])
def test_interrupted_and_resumed_is_as_if_nothing_had_happened(data, tmp_path, config):
    chosen = SMALL
    if config == "paper":
        chosen = replace(
            preset("realeasy", paper=True), network=NetworkConfig("lstm", (6, 4), bidirectional=True), epochs=5
        )
        chosen = replace(chosen, network=replace(chosen.network, input_dropout=0.1, recurrent_dropout=0.2))
    whole = augment([data], tmp_path / "whole", run=RUN, config=chosen)

    def stop_within_third(progress):
        if progress.number == 3 and progress.batch == 2 and progress.epoch is None:
            raise Stop

    folder = tmp_path / "parts"
    with pytest.raises(Stop):
        augment([data], folder, run=RUN, config=chosen, on_progress=stop_within_third)
    assert (folder / CHECKPOINT_NAME).is_file()
    assert not (folder / "model.json").exists()
    with pytest.raises(OutputExists, match="not empty"):
        augment([data], folder, run=RUN, config=chosen)
    with pytest.raises(OutputExists, match="another configuration"):
        augment([data], folder, run=RUN, config=chosen, seed=5, resume=True)
    seen = []
    resumed = augment([data], folder, run=RUN, config=chosen, resume=True, on_progress=lambda p: seen.append(p.number))
    assert min(seen) == 3
    assert same(weights(tmp_path / "whole"), weights(folder))
    first, second = (made.augmentation.training.history for made in (whole, resumed))
    assert [(e.train, e.val, e.rate) for e in first] == [(e.train, e.val, e.rate) for e in second]
    assert sorted(path.name for path in folder.iterdir()) == ["model.json", "model.onnx", "weights.safetensors"]


def test_what_is_refused_costs_no_training_that_was_interrupted(data, tmp_path):
    """What depends on words alone is refused before anything of what is there goes."""

    def stop(progress):
        if progress.epoch:
            raise Stop

    with pytest.raises(Stop):
        augment([data], tmp_path, run=RUN, config=SMALL, on_progress=stop)
    before = contents(tmp_path)
    assert CHECKPOINT_NAME in before
    heavy = replace(SMALL.loss, weights={"current": 1.0})
    for wrong in (replace(SMALL, precision="mixed"), replace(SMALL, loss=heavy)):
        with pytest.raises(ConfigError):
            augment([data], tmp_path, run=RUN, config=wrong, overwrite=True)
        assert contents(tmp_path) == before


def test_it_is_said_that_training_is_over_and_val_is_looked_at(data, tmp_path):
    """With a recurrent network that takes as long as an epoch, or longer."""
    seen = []
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=2), on_progress=seen.append)
    assert [progress.judging for progress in seen] == [False] * (len(seen) - 1) + [True]
    assert seen[-1].number == 2
    assert "val" in progress_line(seen[-1])


def test_a_finished_model_is_not_trained_again(data, tmp_path):
    augment([data], tmp_path, run=RUN, config=SMALL)
    before = (tmp_path / "model.json").read_bytes()
    seen = []
    again = augment([data], tmp_path, run=RUN, config=SMALL, resume=True, on_progress=seen.append)
    assert (tmp_path / "model.json").read_bytes() == before
    assert not seen
    assert "was finished already" in again.notes
    for other in ({"seed": 9}, {"train_motions": 3}, {"name": "another"}, {"drop_flagged": True}):
        with pytest.raises(OutputExists, match="holds a model of other data, or of another run, name"):
            augment([data], tmp_path, run=RUN, config=SMALL, resume=True, **other)


def test_a_model_that_is_replaced_can_be_resumed(data, tmp_path):
    """The old one must not be taken for the new one, nor stand in its way."""
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1))

    def stop(progress):
        if progress.number == 2 and progress.epoch is None:
            raise Stop

    with pytest.raises(Stop):
        augment([data], tmp_path, run=RUN, config=SMALL, overwrite=True, on_progress=stop)
    made = augment([data], tmp_path, run=RUN, config=SMALL, resume=True)
    assert len(made.augmentation.training.history) == SMALL.epochs


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


WILD = OptimizerConfig("rmsprop", 1e30, "plateau", clip=0.0)


@pytest.mark.parametrize(
    "config",
    [
        replace(SMALL, data=DataConfig(rate_hz=400.0)),
        replace(SMALL, optimizer=WILD),
        replace(SMALL, epochs=0),
        replace(SMALL, data=DataConfig(command=("torque",))),
        replace(SMALL, precision="mixed"),
    ],
    ids=["rate", "diverges", "no epoch", "no such command", "mixed precision without a GPU"],
)
def test_what_is_refused_costs_no_model(data, tmp_path, config):
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1))
    before = contents(tmp_path)
    with pytest.raises(TrueupError):
        augment([data], tmp_path, run=RUN, config=config, overwrite=True)
    assert contents(tmp_path) == before
    assert (
        "was finished already" in augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1), resume=True).notes
    )


@pytest.mark.parametrize("epoch", [1, 2])
def test_an_interruption_costs_no_model(data, tmp_path, epoch):
    """Also where the new training asks for the same as the old one: it goes on, and is not taken for finished."""
    augment([data], tmp_path, run=RUN, config=SMALL)
    before = contents(tmp_path)

    def stop(progress):
        if progress.number == epoch and progress.batch == 1:
            raise Stop

    with pytest.raises(Stop):
        augment([data], tmp_path, run=RUN, config=SMALL, overwrite=True, on_progress=stop)
    assert before.items() <= contents(tmp_path).items()
    assert (tmp_path / CHECKPOINT_NAME).is_file() == (epoch > 1)
    with pytest.raises(OutputExists, match="training of another"):
        augment([data], tmp_path, run=RUN, config=SMALL, seed=3, resume=True)
    seen = []
    made = augment([data], tmp_path, run=RUN, config=SMALL, resume=True, on_progress=lambda p: seen.append(p.number))
    assert min(seen) == epoch
    assert "was finished already" not in made.notes
    assert contents(tmp_path).keys() == before.keys()
    assert "was finished already" in augment([data], tmp_path, run=RUN, config=SMALL, resume=True).notes


def test_a_folder_that_only_looks_like_ours_is_left_alone(data, tmp_path):
    mine = tmp_path / "pairs" / "socks.txt"
    mine.parent.mkdir()
    mine.write_text("two")
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1), overwrite=True)
    assert mine.read_text() == "two"


def test_what_a_killed_training_left_behind_is_in_nobodys_way(data, tmp_path):
    """Whether it was killed before its first checkpoint, or when all was written."""

    def litter():
        (tmp_path / SCRATCH_NAME).mkdir()
        (tmp_path / SCRATCH_NAME / "train.f32").write_bytes(b"half")

    litter()
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1))
    before = contents(tmp_path)
    litter()
    (tmp_path / CHECKPOINT_NAME).write_bytes(b"old")
    assert (
        "was finished already" in augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1), resume=True).notes
    )
    assert contents(tmp_path) == before


def test_a_refused_first_try_does_not_block_the_second(data, tmp_path):
    with pytest.raises(DataError, match="fewer samples per second"):
        augment([data], tmp_path, run=RUN, config=replace(SMALL, data=DataConfig(rate_hz=400.0)))
    assert not list(tmp_path.iterdir())
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1))


def test_times_of_the_network_that_is_replaced_go_with_it(data, tmp_path):
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1))
    (tmp_path / LATENCY_NAME).write_text("{}")
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=2), overwrite=True)
    assert not (tmp_path / LATENCY_NAME).exists()


def test_a_dataset_counts_once(data, tmp_path):
    """Under another name, too."""
    copy = Dataset(shutil.copytree(data.path, tmp_path / "copy"))
    (tmp_path / "link").symlink_to(data.path)
    for twin in (Dataset(data.path), Dataset(tmp_path / "link"), copy):
        with pytest.raises(ConfigError, match="a dataset is given twice"):
            augment([data, twin], tmp_path / "out", run=RUN, config=SMALL)


def test_no_epoch_is_no_training(data, tmp_path):
    with pytest.raises(ConfigError, match="epochs: 0 leaves the network untrained"):
        augment([data], tmp_path / "a", run=RUN, config=replace(SMALL, epochs=0))
    made = augment([data], tmp_path / "b", run=RUN, config=replace(preset("moving-average"), epochs=0))
    assert made.augmentation.card.provenance["training"]["history"] == []


@pytest.mark.parametrize("kind", ["mjcf", "urdf"])
def test_speeds_are_those_of_the_model_that_replay_reads(tmp_path, kind):
    """Also where meshes are missing, and where the model is a URDF."""
    made = make_dataset(tmp_path / "data")
    folder = made.path / "model"
    folder.mkdir()
    if kind == "mjcf":
        bodies = "".join(
            f"<body><inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/><joint name='{name}'/>"
            "<geom type='mesh' mesh='gone'/></body>"
            for name in JOINTS
        )
        text = (
            "<mujoco><asset><mesh name='gone' file='gone.stl'/></asset>"
            f"<custom><numeric name='velocity_limit' data='2 3'/></custom><worldbody>{bodies}</worldbody></mujoco>"
        )
    else:
        inertial = (
            "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>"
            "<visual><geometry><mesh filename='package://gone/gone.stl'/></geometry></visual>"
        )
        links = "".join(f"<link name='{name}'>{inertial}</link>" for name in ("base", "one", "two"))
        joints = "".join(
            f"<joint name='{name}' type='revolute'><parent link='{up}'/><child link='{down}'/><axis xyz='0 0 1'/>"
            f"<limit lower='-3' upper='3' effort='9' velocity='{speed}'/></joint>"
            for name, up, down, speed in zip(JOINTS, ("base", "one"), ("one", "two"), (2, 3), strict=True)
        )
        text = f"<robot name='arm'>{links}{joints}</robot>"
    arm = replace(robot(), model="arm.urdf" if kind == "urdf" else "arm.xml")
    (folder / arm.model).write_text(text)
    config = replace(SMALL, data=DataConfig(normalization="limits"), loss=LossConfig(scale="normalized"), epochs=1)
    made = augment([made], tmp_path / "out", run=RUN, config=config, robot=arm)
    corrector = made.augmentation.corrector
    names = [channel.name for channel in made.augmentation.card.inputs]
    for joint, speed in zip(JOINTS, (2.0, 3.0), strict=True):
        at = names.index(f"simulated.velocity.{joint}")
        assert (corrector.center[at].item(), corrector.scale[at].item()) == (-speed, 2 * speed)
    assert not any("no limits are known" in note for note in made.notes)


def test_motions_that_could_not_be_replayed_are_left_out(tmp_path):
    rng = np.random.default_rng(0)
    episodes = [labelled(k, split, *motion(rng, 60)) for k, split in enumerate(["train", "train", "train", "val"])]
    with DatasetWriter.create(tmp_path / "data", DatasetInfo(robot="arm")) as writer:
        for episode, _ in episodes:
            writer.append(episode)
    write_run(tmp_path / "data", {episode.id: simulated for episode, simulated in episodes[1:]}, robot())
    made = augment([Dataset(tmp_path / "data")], tmp_path / "out", run=RUN, config=replace(SMALL, epochs=1))
    assert made.augmentation.card.provenance["training"]["motions"] == {"train": 2, "val": 1}
    assert any("1 val motions cannot tell help from chance" in note for note in made.notes)


def test_a_broken_checkpoint_is_said(data, tmp_path):
    (tmp_path / CHECKPOINT_NAME).write_bytes(b"not a checkpoint")
    with pytest.raises(DataError, match="is no checkpoint"):
        augment([data], tmp_path, run=RUN, config=SMALL, resume=True)


def test_a_checkpoint_of_another_version_is_said(data, tmp_path):
    """Other layers than today's, under the same hash of the inputs."""

    def interrupt(progress):
        if progress.number == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        augment([data], tmp_path, run=RUN, config=SMALL, on_progress=interrupt)
    path = tmp_path / CHECKPOINT_NAME
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # it has no __iter__
    tensors["network.dense.weight"] = tensors["network.dense.weight"][1:]
    save_file(tensors, path, metadata)
    with pytest.raises(DataError, match=r"was changed after it was written.*\nGive --overwrite"):
        augment([data], tmp_path, run=RUN, config=SMALL, resume=True)
    save_file(tensors, path, {**metadata, "sha256": digest_of(tensors, metadata["state"])})
    with pytest.raises(DataError, match=r"written by another version of trueup or torch.*\nGive --overwrite"):
        augment([data], tmp_path, run=RUN, config=SMALL, resume=True)


def test_a_loss_that_runs_away_stops_training_and_keeps_the_best(data, tmp_path, monkeypatch):
    seen = []

    def poison(progress):
        seen.append(progress.number)
        if progress.number == 3 and progress.epoch is None:  # what a step too far does to the weights
            for parameter in poison.corrector.parameters():
                parameter.data.fill_(float("nan"))

    original = augmentation.train

    def train(corrector, *args, **kwargs):
        poison.corrector = corrector
        return original(corrector, *args, **kwargs)

    monkeypatch.setattr(augmentation, "train", train)
    made = augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=9), on_progress=poison)
    assert made.augmentation.training.status == "diverged"
    assert made.augmentation.training.best in (1, 2)
    assert max(seen) == 3
    assert any("diverged after epoch 2" in note for note in made.notes)
    assert all(np.isfinite(value).all() for value in weights(tmp_path).values())


def test_a_loss_that_runs_away_at_once_is_an_error(data, tmp_path):
    with pytest.raises(ConfigError, match="diverged in its first epoch"):
        augment([data], tmp_path, run=RUN, config=replace(SMALL, optimizer=WILD))


def test_training_stops_when_val_no_longer_improves(data, tmp_path):
    still = replace(SMALL, epochs=30, stop_after=3, optimizer=OptimizerConfig(rate=1e-30))
    made = augment([data], tmp_path, run=RUN, config=still)
    assert made.augmentation.training.status == "stopped early"
    assert len(made.augmentation.training.history) < 30


def test_what_cannot_be_trained_on_is_refused(data, tmp_path):
    with pytest.raises(MissingSignal, match="has no run 'dart/stock'"):
        augment([data], tmp_path / "a", run="dart/stock", config=SMALL)
    empty = make_dataset(tmp_path / "empty", counts=(3, 0, 2))
    with pytest.raises(MissingSignal, match="no motion of the run 'mujoco/stock' is in the split 'val'"):
        augment([empty], tmp_path / "b", run=RUN, config=SMALL)
    for name in ("../x", "a b", "x" * 300):
        with pytest.raises(ConfigError, match="--name"):
            augment([data], tmp_path / "n", run=RUN, config=SMALL, name=name)
    with pytest.raises(NameMismatch, match="--robot arm is not the robot of the run"):
        augment([data], tmp_path / "r", run=RUN, config=SMALL, robot=robot(("a", "b")))
    with pytest.raises(DataError, match="fewer samples per second"):
        augment([data], tmp_path / "f", run=RUN, config=replace(SMALL, data=DataConfig(rate_hz=400.0)))
    with pytest.raises(ConfigError, match="no dataset"):
        augment([], tmp_path / "c", run=RUN)
    other = make_dataset(tmp_path / "other", joints=("pan", "tilt"))
    with pytest.raises(NameMismatch, match="tilt"):
        augment([data, other], tmp_path / "d", run=RUN, config=SMALL)
    if not torch.cuda.is_available():
        with pytest.raises(MissingDependency, match="no GPU"):
            augment([data], tmp_path / "e", run=RUN, config=SMALL, device="cuda")


def with_episodes(folder, episodes):
    with DatasetWriter.create(folder, DatasetInfo(robot="arm")) as writer:
        for episode, _ in episodes:
            writer.append(episode)
    write_run(folder, {episode.id: simulated for episode, simulated in episodes}, robot())
    return Dataset(folder)


def labelled(number, split, simulated, measured):
    return Episode(EpisodeMeta(f"{split}{number}", split=split), measured), simulated


def test_nan_is_refused_with_its_place(tmp_path):
    rng = np.random.default_rng(0)
    episodes = [labelled(k, split, *motion(rng, 50)) for k, split in enumerate(["train", "train", "val"])]
    episodes[1][0].measured["torque"][7, 1] = np.nan
    data = with_episodes(tmp_path / "data", episodes)
    with pytest.raises(
        DataError, match=r"'train1' cannot be trained on: got nan in torque of 'lift', sample 7"
    ) as error:
        augment([data], tmp_path / "out", run=RUN, config=SMALL)
    assert "--drop-flagged" in str(error.value)


def test_val_that_overlaps_train_is_refused(tmp_path):
    """A piece of a train motion under another name, moved in time."""
    rng = np.random.default_rng(0)
    simulated, measured = motion(rng, 90)
    rows = slice(31, 71)
    piece = [
        TimeSeries(s.time_s[rows] + 3.0, s.joints, {n: v[rows] for n, v in s.signals.items()}, s.units)
        for s in (simulated, measured)
    ]
    fresh = motion(rng, 60)
    data = with_episodes(
        tmp_path / "data",
        [
            labelled(0, "train", *motion(rng, 70)),
            labelled(1, "train", simulated, measured),
            labelled(2, "val", *fresh),
            labelled(3, "val", *piece),
        ],
    )
    for rate_hz in (None, 50.0):
        config = replace(SMALL, data=DataConfig(rate_hz=rate_hz))
        with pytest.raises(DataError, match="val motion 'val3' holds samples of train motion 'train1'"):
            augment([data], tmp_path / f"out{rate_hz}", run=RUN, config=config)


def test_repeated_commands_read_by_a_coarse_encoder_are_no_overlap(tmp_path):
    """The same motion twice, in ticks of 1.5 mrad with a little noise: two recordings, not one."""
    rng = np.random.default_rng(0)
    clock = np.arange(300) / 100
    episodes = []
    for number, split in enumerate(["train"] * 4 + ["val"] * 2):
        ticks = np.round((np.sin(3 * clock) + 3e-4 * rng.normal(size=300)) / 1.5e-3) * 1.5e-3
        measured = TimeSeries(
            clock, JOINTS, {"position": np.stack([ticks, 0 * ticks], axis=1)}, {"position": ("rad",) * 2}
        )
        simulated = TimeSeries(
            clock, JOINTS, {"position": np.stack([np.sin(3 * clock), 0 * clock], axis=1)}, measured.units
        )
        episodes.append(labelled(number, split, simulated, measured))
    augment([with_episodes(tmp_path / "data", episodes)], tmp_path / "out", run=RUN, config=replace(SMALL, epochs=1))


def pairs_of(folder, lengths, *, name="train", seed=0, still=(), label=True):
    """Pairs whose rows say which motion and sample they are."""
    rng = np.random.default_rng(seed)
    inputs = (Channel("position", "pan", "rad"), Channel("torque", "pan", "Nm"))
    episodes = []
    for number, samples in enumerate(lengths):
        place = number + np.arange(samples)[:, None] / 1000 if label else np.zeros((samples, 1))
        value = np.full((samples, 1), 3.0) if number in still else rng.normal(size=(samples, 1))
        clock = np.arange(samples) / 100
        units = {"position": ("rad",), "torque": ("Nm",)}
        series = TimeSeries(clock, ("pan",), {"position": place, "torque": value}, units)
        episodes.append(Episode(EpisodeMeta(f"{name}{number}"), series, simulated={"s": series}))
    path = folder / f"{name}.f32"
    return write_pairs(episodes, path, run="s", inputs=inputs, outputs=inputs, rate_hz=100.0)


def test_motions_that_rest_alike_do_not_overlap(tmp_path):
    """Standing robots measure the same numbers again and again, in train as in val."""
    train, val = (pairs_of(tmp_path, [40, 50], name=name, still=(0, 1), label=False) for name in ("train", "val"))
    refuse_overlap(train, val)
    moving, other, same = (
        pairs_of(tmp_path, [40, 50], name=name, label=False, seed=seed)
        for name, seed in (("moving", 1), ("other", 2), ("same", 1))
    )
    refuse_overlap(moving, other)
    with pytest.raises(DataError, match="val motion 'same0' holds samples of train motion 'moving0'"):
        refuse_overlap(moving, same)


@pytest.mark.parametrize("samples", [200, 20])
def test_an_overlap_is_found_in_a_log_that_holds_its_samples(tmp_path, samples):
    """Every value twice, as from a bus at half the rate of the log; of a short motion there is one run only."""

    def pairs(name, seeds):
        episodes = []
        for seed in seeds:
            rng = np.random.default_rng(seed)
            value = np.repeat(rng.normal(size=(samples // 2, 1)), 2, axis=0)
            series = TimeSeries(np.arange(samples) / 100, ("pan",), {"position": value}, {"position": ("rad",)})
            episodes.append(Episode(EpisodeMeta(f"{name}{seed}"), series, simulated={"s": series}))
        channels = (Channel("position", "pan", "rad"),)
        return write_pairs(
            episodes, tmp_path / f"{name}.f32", run="s", inputs=channels, outputs=channels, rate_hz=100.0
        )

    train, fresh, again = pairs("train", (1, 2, 3)), pairs("val", (4, 5)), pairs("again", (6, 3))
    refuse_overlap(train, fresh)
    with pytest.raises(DataError, match="val motion 'again3' holds samples of train motion 'train3'"):
        refuse_overlap(train, again)


def test_an_overlap_is_found_where_bodies_alone_were_measured(tmp_path):
    def pairs(name, seeds):
        episodes = []
        for seed in seeds:
            place = np.random.default_rng(seed).normal(size=(100, 2, 3))
            units = {"body.position": ("m",) * 2}
            series = TimeSeries(np.arange(100) / 100, (), {"body.position": place}, units, ("hand", "foot"))
            episodes.append(Episode(EpisodeMeta(f"{name}{seed}"), series, simulated={"s": series}))
        channels = tuple(Channel(f"body.position.{axis}", "foot", "m") for axis in "xyz")
        return write_pairs(
            episodes, tmp_path / f"{name}.f32", run="s", inputs=channels, outputs=channels, rate_hz=100.0
        )

    train = pairs("train", (1, 2, 3))
    refuse_overlap(train, pairs("val", (4, 5)))
    with pytest.raises(DataError, match="val motion 'again3' holds samples of train motion 'train3'"):
        refuse_overlap(train, pairs("again", (6, 3)))


def test_a_run_at_another_time_than_its_measurement_is_refused(tmp_path):
    series, later = (
        TimeSeries(np.arange(50) / 100 + start, ("pan",), {"position": np.ones((50, 1))}, {"position": ("rad",)})
        for start in (0.0, 5.0)
    )
    channels = (Channel("position", "pan", "rad"),)
    options = {"run": "s", "inputs": channels, "outputs": channels, "rate_hz": 100.0}
    with pytest.raises(DataError, match=r"'e': s and the measurement share no time.*got 5 to 5.49 s and 0 to 0.49 s"):
        write_pairs([Episode(EpisodeMeta("e"), series, simulated={"s": later})], tmp_path / "x.f32", **options)
    with pytest.raises(DataError, match="episode 'e' is too short for the network"):
        write_pairs(
            [Episode(EpisodeMeta("e"), series, simulated={"s": series})],
            tmp_path / "x.f32",
            **{**options, "rate_hz": 1.0},
        )


def test_a_signal_without_weight_is_left_as_simulated(data, tmp_path):
    """Nothing was learned of it, so that what the network says of it is a matter of luck."""
    config = replace(SMALL, epochs=1, loss=LossConfig(weights={"position": 0.0}))
    card = augment([data], tmp_path / "a", run=RUN, config=config).augmentation.card
    off = {output.name: output.reason for output in card.outputs if output.signal == "position"}
    assert set(off.values()) == {"its weight in the loss is 0"}
    for unknown in ({"velocity": 2.0}, {"torque": 1.0, "velocity": 0.0}):
        config = replace(SMALL, data=DataConfig(signals=("torque",)), loss=LossConfig(weights=unknown))
        with pytest.raises(ConfigError, match="weights of velocity, which is not corrected"):
            augment([data], tmp_path / f"b{len(unknown)}", run=RUN, config=config)


def test_many_reasons_are_one_line(data, tmp_path, monkeypatch):
    """What one epoch at no learning rate leaves."""
    monkeypatch.setattr("trueup.stages.augmenting._MOST_REASONS", 1)
    still = replace(SMALL, epochs=1, optimizer=OptimizerConfig(rate=1e-30))
    made = augment([data], tmp_path, run=RUN, config=still)
    off = [output for output in made.augmentation.card.outputs if output.gate == 0]
    count = len({output.reason for output in off})
    assert count > 1
    (line,) = [note for note in made.notes if "switched off" in note]
    for signal in {output.signal for output in off}:
        assert f"{signal} of {', '.join(output.joint for output in off if output.signal == signal)}" in line
    assert f"{count - 1} other reasons are in model.json" in line


def test_the_random_numbers_of_the_caller_are_left_alone(data, tmp_path):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    augment([data], tmp_path, run=RUN, config=replace(SMALL, epochs=1))
    assert torch.equal(torch.rand(4), expected)


@pytest.mark.parametrize("rule", ["fixed", "half-shortest"])
def test_windows_are_pieces_of_motions(tmp_path, rule):
    lengths = [30, 55, 80, 33, 41]
    pairs = pairs_of(tmp_path, lengths)
    windows = Windows(pairs, WindowConfig(rule, samples=24, draws=6), 3)
    batches = list(windows.epoch(np.random.default_rng(0)))
    assert len(batches) == len(windows)
    seen = np.zeros(len(lengths), int)
    for batch in batches:
        labels = batch.x[..., 0]
        for place, rows in enumerate(batch.lengths):
            number = int(labels[0, place] + 1e-6)
            steps = np.round((labels[:rows, place] - number) * 1000).astype(int)
            assert np.array_equal(steps, np.arange(steps[0], steps[0] + rows))
            assert steps[-1] < lengths[number]
            assert not batch.x[rows:, place].any()
            np.testing.assert_array_equal(batch.y[:rows, place, 0], labels[:rows, place])
            seen[number] += 1
        if rule == "half-shortest":
            chosen = [int(labels[0, place] + 1e-6) for place in range(labels.shape[1])]
            assert len(set(chosen)) == len(chosen)
            assert set(batch.lengths) == {min(lengths[k] for k in chosen) // 2}
    assert (seen == 6).all() if rule == "half-shortest" else (seen > 0).all()


def test_windows_lie_anywhere(tmp_path):
    pairs = pairs_of(tmp_path, [50])
    for rule in ("fixed", "half-shortest"):
        windows = Windows(pairs, WindowConfig(rule, samples=20, draws=400), 4)
        covered, first = np.zeros(50), 0
        for batch in windows.epoch(np.random.default_rng(1)):
            for place, rows in enumerate(batch.lengths):
                start = round(float(batch.x[0, place, 0]) * 1000)
                covered[start : start + rows] += 1
                first += start == 0
        assert (covered > 0).all()
        assert first > 0


@pytest.mark.parametrize(("one_by_one", "batches"), [(False, 3), (True, 1)])
def test_whole_motions_come_once_each(tmp_path, one_by_one, batches):
    lengths = [30, 55, 80, 33, 41]
    pairs = pairs_of(tmp_path, lengths)
    parts = list(whole_motions(pairs, 2, one_by_one=one_by_one))
    found = {}
    for numbers, batch in parts:
        found.update(zip(numbers.tolist(), batch.lengths.tolist(), strict=True))
    assert found == dict(enumerate(lengths))
    assert len(parts) == batches


def test_moments_are_those_of_all_rows(tmp_path):
    pairs = pairs_of(tmp_path, [30, 55, 80])
    rows = np.concatenate([x for _, x, _ in pairs]).astype(float)
    summary = summarize(pairs, np.array([0, 1]))
    np.testing.assert_allclose(summary.mean, rows.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(summary.deviation, rows.std(axis=0), rtol=1e-6)
    np.testing.assert_allclose(summary.low, rows.min(axis=0))
    np.testing.assert_allclose(summary.high, rows.max(axis=0))
    assert summary.simulator_rms.max() == 0


def test_other_rates_are_refused_unless_a_rate_is_given(tmp_path):
    rng = np.random.default_rng(0)
    episodes = [labelled(k, split, *motion(rng, 80)) for k, split in enumerate(["train", "train", "val"])]
    slow = [TimeSeries(s.time_s * 2, s.joints, s.signals, s.units) for s in (episodes[1][1], episodes[1][0].measured)]
    episodes[1] = labelled(1, "train", *slow)
    data = with_episodes(tmp_path / "data", episodes)
    with pytest.raises(DataError, match="another rate"):
        augment([data], tmp_path / "a", run=RUN, config=SMALL)
    made = augment([data], tmp_path / "b", run=RUN, config=replace(SMALL, data=DataConfig(rate_hz=50.0)))
    assert made.augmentation.card.rate_hz == 50.0


def test_a_close_trains_on_motions_of_different_rates_at_the_lowest(tmp_path):
    rng = np.random.default_rng(0)
    episodes = [labelled(k, split, *motion(rng, 80)) for k, split in enumerate(["train", "train", "val"])]
    slow = [TimeSeries(s.time_s * 2, s.joints, s.signals, s.units) for s in (episodes[1][1], episodes[1][0].measured)]
    one_rate = with_episodes(tmp_path / "one", episodes)
    mixed = with_episodes(tmp_path / "mixed", [episodes[0], labelled(1, "train", *slow), episodes[2]])
    assert (lowest_rate(one_rate, RUN, drop_flagged=False), lowest_rate(mixed, RUN, drop_flagged=False)) == (None, 50.0)
    only_test = with_episodes(tmp_path / "test", [*episodes, labelled(3, "test", *slow)])
    assert lowest_rate(only_test, RUN, drop_flagged=False) is None  # test decides nothing
    moment = [s.rows(slice(0, 1)) for s in (episodes[0][1], episodes[0][0].measured)]
    with_moment = with_episodes(tmp_path / "moment", [*episodes, labelled(4, "train", *moment)])
    assert lowest_rate(with_moment, RUN, drop_flagged=False) is None
    flagged = labelled(1, "train", *slow)
    flagged = flagged[0].with_flags((Flag("late", severity="warning"),)), flagged[1]
    with_flagged = with_episodes(tmp_path / "flagged", [episodes[0], flagged, episodes[2]])
    assert [lowest_rate(with_flagged, RUN, drop_flagged=drop) for drop in (False, True)] == [50.0, None]
    ask = {"drop_flagged": False, "seed": 0, "jobs": 1, "overwrite": False, "limit": None}
    for data, rate_hz in ((one_rate, 100.0), (mixed, 50.0)):
        failed = {}
        plan = [Planned("stock", "moving-average")]
        (made,) = train_each(plan, data, robot(), data.path / "networks", failed=failed, **ask)
        assert not failed
        assert ModelCard.load(made.folder).rate_hz == rate_hz
        assert ("at the 50 samples per second of the slowest motion" in made.words) == (rate_hz == 50.0)


def test_a_rate_that_a_control_loop_refuses_is_not_trained_as_the_networks(tmp_path):
    """98.5 Hz is not 100 Hz."""
    rng = np.random.default_rng(0)
    episodes = [labelled(k, split, *motion(rng, 80)) for k, split in enumerate(["train", "train", "val"])]
    slow = [
        TimeSeries(s.time_s / 0.985, s.joints, s.signals, s.units) for s in (episodes[1][1], episodes[1][0].measured)
    ]
    episodes[1] = labelled(1, "train", *slow)
    data = with_episodes(tmp_path / "data", episodes)
    for config, words in ((SMALL, "another rate"), (replace(SMALL, data=DataConfig(rate_hz=100.0)), "fewer samples")):
        with pytest.raises(DataError, match=words):
            augment([data], tmp_path / words, run=RUN, config=config)


def test_paper_normalization_maps_limits_to_the_unit_interval(data, tmp_path):
    config = replace(SMALL, data=DataConfig(normalization="limits"), loss=LossConfig(scale="normalized"), epochs=1)
    made = augment([data], tmp_path, run=RUN, config=config)
    corrector = made.augmentation.corrector
    names = [channel.name for channel in made.augmentation.card.inputs]
    at = names.index("simulated.position.pan")
    assert (corrector.center[at].item(), corrector.scale[at].item()) == (-3.0, 6.0)
    at = names.index("simulated.torque.pan")
    assert (corrector.center[at].item(), corrector.scale[at].item()) == (-20.0, 40.0)
    assert any("no limits are known for velocity of lift, velocity of pan" in note for note in made.notes)


def test_several_units_train_one_network(data, tmp_path):
    other = make_dataset(tmp_path / "other", seed=5)
    made = augment([data, other], tmp_path / "out", run=RUN, config=SMALL)
    assert made.augmentation.card.provenance["training"]["motions"] == {"train": 16, "val": 8}


def test_the_folder_holds_a_card_that_can_be_loaded(data, tmp_path):
    made = augment([data], tmp_path, run=RUN, config=SMALL, name="arm-rt")
    card = ModelCard.load(tmp_path)
    assert card == made.augmentation.card
    assert (card.name, card.run, card.rate_hz, card.joints) == ("arm-rt", RUN, 100.0, JOINTS)
    assert card.provenance["training"]["val_conditions"] == ["fast", "slow"]
    assert card.causal
    assert [state.name for state in card.states] == ["h0", "c0", "h1", "c1"]
    for name in ("model.onnx", "weights.safetensors"):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-5])
    with pytest.raises(DataError, match=r"is not the file that model\.json describes"):
        Augmentation.load(tmp_path)
    text = (tmp_path / "model.json").read_text()
    (tmp_path / "model.json").write_text(text.replace('"rate_hz": 100.0', '"rate_hz": 200.0'))
    with pytest.raises(DataError, match="changed after it was written"):
        ModelCard.load(tmp_path)


@pytest.mark.parametrize("method", ["moving-average", "moving-average-rt"])
def test_a_moving_average_of_the_simulator_is_one(data, tmp_path, method):
    """Errors on val against those of numpy's own mean over half a second."""
    card = augment([data], tmp_path, run=RUN, config=preset(method)).augmentation.card
    before, after = (25, 25) if method == "moving-average" else (49, 0)
    squares, count = np.zeros(2), 0
    for episode in data.episodes(data.select(split="val"), runs=[RUN]):
        x = episode.run(RUN)["torque"]
        padded = np.concatenate([np.repeat(x[:1], before, axis=0), x, np.repeat(x[-1:], after, axis=0)])
        mean = np.stack([padded[row : row + before + after + 1].mean(axis=0) for row in range(len(x))])
        squares += ((episode.measured["torque"] - mean) ** 2).sum(axis=0)
        count += len(x)
    used = {output.joint: output.gate for output in card.outputs if output.signal == "torque"}
    assert any(used.values()) or method.endswith("rt")  # a late mean may be worse than none
    for number, joint in enumerate(JOINTS):
        found = card.metrics["val"]["torque"][joint]
        expected = np.sqrt(squares[number] / count) if used[joint] else found["simulated"]
        assert found["corrected"] == pytest.approx(expected, rel=1e-4)


@pytest.mark.long
def test_networks_feel_the_stops_of_joints(tmp_path):
    """What a stop carries is told by how deep the simulated joint leans into it, and by nothing else."""
    rng = np.random.default_rng(0)
    episodes = []
    for number, split in enumerate(["train"] * 24 + ["val"] * 6):
        simulated, measured = motion(rng, 80, perfect=("position", "velocity", "torque"))
        depth = rng.uniform(0, 0.004) * (number % 2)
        simulated["position"][:] = 3.0 + depth if number % 2 else rng.uniform(-2.5, 2.5)
        simulated["torque"][:] = measured["torque"] - 500 * depth
        episodes.append(labelled(number, split, simulated, measured))
    data = with_episodes(tmp_path / "data", episodes)
    left = {}
    for stops in (True, False):
        config = replace(SMALL, data=DataConfig(signals=("position", "torque"), stops=stops), epochs=25)
        made = augment([data], tmp_path / str(stops), run=RUN, config=config)
        metrics = made.augmentation.card.metrics["val"]["torque"]["pan"]
        left[stops] = metrics["corrected"] / metrics["simulated"]
        again = Augmentation.load(tmp_path / str(stops))
        assert len(again.corrector.stop_edge) == (8 if stops else 0)
        x = np.array([[[3.001, -1.0, 1.0, 1.0]], [[0.0, -2.9999, 1.0, 1.0]]], np.float32)
        session = onnxruntime.InferenceSession((tmp_path / str(stops) / "model.onnx").read_bytes())
        states = {state.name: state.initial(x[0]) for state in again.card.states}
        with torch.no_grad():
            expected = again.corrector(torch.from_numpy(x)).numpy()
        np.testing.assert_allclose(session.run(["y"], {"x": x, **states})[0], expected, atol=1e-5)
    assert left[True] < 0.6 * left[False]


@pytest.mark.long
def test_commands_are_read_as_how_far_they_are_from_the_simulator(tmp_path):
    """The robot stops short of its command by a share of the servo's error, which is small beside the motion."""
    rng = np.random.default_rng(0)
    episodes, runs = [], {}
    for number, split in enumerate(["train"] * 12 + ["val"] * 4):
        simulated, measured = motion(rng, 100, perfect=("position", "velocity", "torque"))
        error = 0.02 * rng.normal(size=(100, 2))
        position = simulated["position"] + 0.5 * error
        measured = TimeSeries(measured.time_s, JOINTS, {"position": position}, {"position": ("rad", "rad")})
        command = TimeSeries(measured.time_s, JOINTS, {"position": simulated["position"] + error}, measured.units)
        episodes.append(Episode(EpisodeMeta(f"{split}{number}", split=split), measured, command))
        runs[f"{split}{number}"] = simulated
    with DatasetWriter.create(tmp_path / "data", DatasetInfo(robot="arm")) as writer:
        for episode in episodes:
            writer.append(episode)
    write_run(tmp_path / "data", runs, robot())
    config = replace(SMALL, data=DataConfig(reads=("velocity",), command=("position",)), epochs=30)
    made = augment([Dataset(tmp_path / "data")], tmp_path / "out", run=RUN, config=config)
    card = made.augmentation.card
    names = [channel.name for channel in card.inputs]
    assert names[::2] == ["simulated.position.pan", "simulated.velocity.pan", "command.position.pan"]
    assert [output.name for output in card.outputs] == ["simulated.position.pan", "simulated.position.lift"]
    for item in card.metrics["val"]["position"].values():
        assert item["corrected"] < 0.4 * item["simulated"]
    corrector = Augmentation.load(tmp_path / "out").corrector
    x = rng.normal(size=(30, 2, 6)).astype(np.float32)
    session = onnxruntime.InferenceSession((tmp_path / "out" / "model.onnx").read_bytes())
    states = {state.name: state.initial(x[0]) for state in card.states}
    with torch.no_grad():
        expected = corrector(torch.from_numpy(x)).numpy()
    np.testing.assert_allclose(session.run(["y"], {"x": x, **states})[0], expected, atol=1e-5)
    wrong = replace(config, data=DataConfig(command=("torque",)))
    with pytest.raises(MissingSignal, match="no commanded torque"):
        augment([Dataset(tmp_path / "data")], tmp_path / "no", run=RUN, config=wrong)


@pytest.mark.parametrize("method", ["realeasy", "realeasy-rt", "mlp"])
def test_every_way_to_predict_gives_the_same(data, tmp_path, method):
    """Torch, the model folder, and, where there is no look ahead, a stream after its warm-up."""
    made = augment([data], tmp_path / "m", run=RUN, config=replace(preset(method), epochs=2))
    episode = next(data.episodes(data.select(split="test"), runs=[RUN]))
    trained = Trained.load(tmp_path / "m")
    first, second = made.augmentation.predict(episode), trained.predict(episode, RUN)
    for signal in ("position", "velocity", "torque"):
        np.testing.assert_allclose(first[signal], second[signal], atol=1e-5)
    if method == "realeasy":
        with pytest.raises(ConfigError, match="looks into the future"):
            made.augmentation.stream(rate_hz=100.0, joints=JOINTS)
        return
    series = episode.run(RUN)
    for stream in (
        made.augmentation.stream(rate_hz=100.0, joints=JOINTS),
        trained.stream(rate_hz=100.0, joints=JOINTS),
    ):
        for row in range(len(series)):
            step = stream.step({name: series[name][row] for name in ("position", "velocity", "torque")})
            expected = np.concatenate([second[name][row] for name in ("position", "velocity", "torque")])
            if step.status is Status.OK:
                np.testing.assert_allclose(step.values, expected, atol=1e-5)
        assert row > stream.card.warmup_steps
        assert step.status is Status.OK
