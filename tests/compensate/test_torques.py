"""Robots that take torques: what their simulator lacks is a torque, and a network finds the one that was taken away."""

from dataclasses import replace

import numpy as np
import pytest

from compensate.arm_cases import CONTROL_S, UNITS, moved
from identify.recovery_cases import JOINTS, TORQUE, arm, wave
from trueup.augment.config import NetworkConfig
from trueup.compensate.closed_loop import closed_loop
from trueup.compensate.compensation import Compensation
from trueup.compensate.config import METHODS, LossConfig, TrainConfig
from trueup.compensate.tracks import Track
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.robots.spec import ReplaySpec
from trueup.sim import MujocoSimulator
from trueup.sim.transitions import Transitions
from trueup.stages import compensate, compensated_replay, prepare, replay

CONFIG = replace(
    METHODS["torques"],
    network=NetworkConfig("mlp", (32,), history=1),
    training=TrainConfig(updates=300, rounds=3, batch=32, horizon=8, rate=1e-2, jolt=0.0),
    loss=LossConfig(torque_nm=0.3),
)


def lost(state, command):
    """Of a torque: a tenth, a constant, and what grows with the speed."""
    return -0.1 * command - 0.2 - 0.15 * state[..., 2:]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("torques")
    robot, path = arm(folder, TORQUE)
    text = path.read_text()
    for own in ("0.3", "0.15"):
        text = text.replace(f'frictionloss="{own}"', "")
    path.write_text(text)
    robot = replace(
        robot,
        simulation=replace(robot.simulation, gravity_compensation=True),
        replay=ReplaySpec(window_s=0.4),
        folder=folder,
    )
    transitions = Transitions(MujocoSimulator.from_robot(robot, path), CONTROL_S)
    with DatasetWriter.create(folder / "data", DatasetInfo(robot=robot.name)) as writer:
        for number in range(6):
            time_s, shape = wave(3.0, 1 / CONTROL_S, number)
            torque = 3.0 * (shape - shape[0])
            done = moved(transitions, torque, lost, np.zeros((1, 4)))
            meta = EpisodeMeta(f"m{number}", split=("train", "train", "train", "train", "val", "test")[number])
            asked = TimeSeries(time_s, JOINTS, {"torque": torque}, same_units({"torque": "Nm"}, JOINTS))
            signals = {"position": done[:, :2], "velocity": done[:, 2:]}
            writer.append(Episode(meta, TimeSeries(time_s, JOINTS, signals, UNITS), asked))
    data = Dataset(folder / "data")
    return robot, path, data, prepare(data, robot, model=path, jobs=1)


@pytest.fixture(scope="module", params=["direct", "delta"])
def trained(request, world, tmp_path_factory):
    robot, _, data, prepared = world
    config = replace(CONFIG, training=replace(CONFIG.training, way=request.param))
    folder = tmp_path_factory.mktemp(request.param)
    return compensate(data, robot, folder, config=config, prepared=prepared, jobs=1), folder


@pytest.mark.long
def test_the_torque_that_was_lost_is_found(world, trained):
    _, _, _, prepared = world
    made, _ = trained
    (error,) = made.errors
    assert error.after < 0.25 * error.before
    track = prepared.val[0].track
    simulated = closed_loop(track.pieces(20), prepared.plants, made.compensation.corrector)
    for run, piece in zip(simulated, track.pieces(20), strict=True):
        true = lost(piece.state.astype(float), piece.command.astype(float))
        # Most of what is added is what was lost.
        assert np.abs(run.delta - true).mean() < 0.4 * np.abs(true).mean()


@pytest.mark.long
def test_its_card_says_torques_and_it_is_read_back(trained):
    made, folder = trained
    card = made.compensation.card
    assert {(o.series, o.signal, o.unit) for o in card.outputs} == {("command", "torque", "Nm")}
    assert ("command", "torque") in {(i.series, i.signal) for i in card.inputs}
    assert not any(channel.relative for channel in card.inputs)
    again = Compensation.load(folder)
    assert again.card == card


@pytest.mark.long
def test_a_replay_goes_back_to_the_robot_as_often_as_a_plain_one(world, trained):
    robot, path, data, _ = world
    _, folder = trained
    replay(data, robot, model=path, overwrite=True)
    summary = compensated_replay(data, robot, folder, model=path, label="mujoco/helped", overwrite=True)
    assert (summary.replayed, dict(summary.failed)) == (6, {})
    off = {}
    for run in ("mujoco/stock", "mujoco/helped"):
        episode = data.episode("m5", runs=[run])
        simulated = episode.run(run)["position"]
        off[run] = np.abs(simulated - episode.measured["position"][: len(simulated)])
    # On a motion of test; each piece begins where the robot was.
    assert off["mujoco/helped"].mean() < 0.4 * off["mujoco/stock"].mean()
    assert off["mujoco/helped"][::20].max() < 1e-6


def test_pieces_make_the_motion_again():
    rng = np.random.default_rng(0)
    state, command, time_s = (rng.normal(size=(53, width)).astype(np.float32) for width in (4, 2, 1))
    track = Track("m", 0.0, state, command, time_s[:, 0].astype(float))
    pieces = track.pieces(20)
    assert [len(piece) for piece in pieces] == [21, 21, 13]
    np.testing.assert_array_equal(np.concatenate([*(p.state[:-1] for p in pieces), pieces[-1].state[-1:]]), state)
    assert [len(piece) for piece in replace(track).pieces(52)] == [53]


def test_what_needs_commands_of_positions_is_refused(world, tmp_path):
    robot, _, data, prepared = world
    for config in (METHODS["operator"], replace(CONFIG, training=replace(CONFIG.training, way="ppo"))):
        with pytest.raises(ConfigError, match="takes torques"):
            compensate(data, robot, tmp_path / "x", config=config, prepared=prepared, jobs=1)
    with pytest.raises(ConfigError, match="takes torques"):
        compensate(data, robot, tmp_path / "x", prepared=prepared, twin=(None, robot), jobs=1)
