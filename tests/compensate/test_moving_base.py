"""Compensation of robots on a base that moves: what its sensor explains is nothing that commands lack."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from compensate.arm_cases import CONTROL_S, UNITS, arm_of
from identify.recovery_cases import JOINTS, wave
from trueup.augment.networks.operator import OperatorConfig
from trueup.compensate.closed_loop import closed_loop
from trueup.compensate.config import CompensateConfig, TrainConfig
from trueup.compensate.correctors import corrector_for
from trueup.compensate.tracks import track_of
from trueup.compensate.training import unrolled
from trueup.compensate.windows import Windows
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, MissingSignal
from trueup.robots import Setup
from trueup.sim import MujocoSimulator
from trueup.sim.moving_base import SPECIFIC_FORCE
from trueup.sim.transitions import Transitions
from trueup.stages import compensate, compensated_replay, prepare, replay

CONFIG = CompensateConfig(
    network=OperatorConfig(hidden=(16,), history=3, features=4, trunk=(8,), sensors=4, predictor=(8,)),
    training=TrainConfig(updates=20, rounds=2, batch=16, horizon=10, rate=1e-2),
)


def shaken(time_s, phase):
    """What pulls on a base that goes to and fro and tilts, (T, 3)."""
    return np.stack([3 * np.sin(9 * time_s + phase), 0 * time_s, -9.8 + 2 * np.cos(13 * time_s - phase)], axis=1)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Logs of an arm that is its simulator, on a base that moves and has a sensor; and the simulator."""
    folder = tmp_path_factory.mktemp("base")
    robot, path = arm_of(folder / "robot", friction=False)
    text = path.read_text().replace("<worldbody>", '<worldbody><body name="pelvis"/>')
    path.write_text(text)
    robot = replace(robot, simulation=replace(robot.simulation, base_sensor="pelvis"))
    transitions = {
        kg: Transitions(MujocoSimulator.from_robot(robot, path, setup=Setup(kg)), CONTROL_S) for kg in (0.0, 1.0)
    }
    with DatasetWriter.create(folder / "data", DatasetInfo(robot=robot.name)) as writer:
        for payload_kg, own in transitions.items():
            for number, split in enumerate(("train", "train", "val", "test")):
                time_s, target = wave(2.4, 1 / CONTROL_S, number)
                # A sensor that is read in the middle of each control step, where simulations ask for it.
                clock = np.sort(np.concatenate([time_s, time_s + 0.5 * CONTROL_S]))
                state, rows = np.concatenate([target[:1], np.zeros((1, 2))], axis=1), []
                for _ in range(100):
                    state = own.next(state, target[:1], target[:1], gravity=shaken(time_s[:1] + 0.01, number))
                before = target[:1]
                for row, wanted in enumerate(target[:, None]):
                    rows.append(state[0])
                    middle = time_s[row : row + 1] + 0.5 * CONTROL_S
                    state, before = own.next(state, before, wanted, gravity=shaken(middle, number)), wanted
                states = np.stack([np.interp(clock, time_s, column) for column in np.array(rows).T], axis=1)
                felt = -shaken(clock, number)[:, None]
                measured = TimeSeries(
                    clock,
                    JOINTS,
                    {"position": states[:, :2], "velocity": states[:, 2:], SPECIFIC_FORCE: felt},
                    {**UNITS, SPECIFIC_FORCE: ("m/s^2",)},
                    ("pelvis",),
                )
                asked = TimeSeries(time_s, JOINTS, {"position": target}, same_units({"position": "rad"}, JOINTS))
                meta = EpisodeMeta(f"m{number}/{payload_kg:g}kg", payload_kg=payload_kg, split=split)
                writer.append(Episode(meta, measured, asked))
    data = Dataset(folder / "data")
    return robot, path, data, prepare(data, robot, model=path, jobs=1), transitions


def test_the_simulator_goes_where_the_robot_went(world):
    robot, path, data, prepared, _ = world
    assert prepared.train[0].track.gravity.shape == (len(prepared.train[0].track), 3)
    assert max(np.abs(part.error).max() for part in prepared.train) < 1e-5
    blind = replace(robot, simulation=replace(robot.simulation, base_sensor=""))
    at_rest = prepare(data, blind, model=path, jobs=1)
    assert at_rest.train[0].track.gravity is None
    assert max(np.abs(part.error).max() for part in at_rest.train) > 0.01
    tracks = [part.track for part in prepared.val]
    # They begin at rest, where the robot had hardly come to rest.
    gaps = [
        max(np.abs(run.state - track.state)[60:, :2].max() for run, track in zip(own, tracks, strict=True))
        for own in (
            closed_loop(tracks, prepared.plants, None),
            closed_loop([replace(track, gravity=None) for track in tracks], prepared.plants, None),
        )
    ]
    assert gaps[0] < 0.1 * gaps[1]
    assert gaps[1] > 0.05


def test_a_window_is_the_way_that_the_simulator_goes(world):
    _, _, _, prepared, transitions = world
    track = prepared.train[0].track
    batch = Windows(prepared.train[:1], 2).batch(torch.tensor([2]), 20)
    corrector = corrector_for(CONFIG, Windows(prepared.train, 2), rate_hz=1 / CONTROL_S, size=0.5)
    with torch.no_grad():
        errors, deltas = unrolled(corrector, batch, torch.zeros(1, 4), simulate=prepared.plants.simulate)
    state, before = track.state[2:3].astype(float), track.command[1:2].astype(float)
    for step in range(20):
        sent = track.command[2 + step][None] + deltas[step].numpy()
        pull = track.gravity[2 + step][None].astype(float)
        state, before = transitions[track.payload_kg].next(state, before, sent, gravity=pull), sent
        assert errors[step].numpy() == pytest.approx(state - track.state[3 + step], abs=1e-5)


def test_slopes_are_those_on_the_base(world):
    _, _, _, prepared, transitions = world
    track = prepared.train[0].track
    state, command, pull = (values[5:8].astype(float) for values in (track.state, track.command, track.gravity))
    own = transitions[track.payload_kg]
    slopes = own.slopes(state, command, command, gravity=pull)
    push = np.array([[1e-4, -2e-4]])
    moved = own.next(state, command, command + push, gravity=pull) - own.next(state, command, command, gravity=pull)
    np.testing.assert_allclose(moved, np.einsum("bsj,bj->bs", slopes.command, np.repeat(push, 3, axis=0)), atol=1e-7)


@pytest.mark.long
def test_networks_train_and_replay_on_it(world, tmp_path):
    robot, path, data, prepared, _ = world
    made = compensate(data, robot, tmp_path / "net", config=CONFIG, prepared=prepared, jobs=1)
    replay(data, robot, model=path, jobs=1)
    compensated_replay(data, robot, made.folder, model=path, label="helped", jobs=1)
    name = data.ids[0]
    measured, runs = data.episode(name).measured, data.episode(name, runs=["mujoco/stock", "helped"]).simulated
    for own in runs.values():
        assert np.abs(own["position"][-50:] - measured["position"][-50:]).max() < 0.05
    ppo = replace(CONFIG, training=replace(CONFIG.training, way="ppo"))
    with pytest.raises(ConfigError, match="no base that moves"):
        compensate(data, robot, tmp_path / "ppo", config=ppo, prepared=prepared, jobs=1)


def test_logs_without_the_sensor_are_refused(world):
    robot, _, data, _, _ = world
    episode = data.episode(data.ids[0])
    bare = {name: values for name, values in episode.measured.signals.items() if name != SPECIFIC_FORCE}
    units = {name: episode.measured.units[name] for name in bare}
    silent = replace(episode, measured=replace(episode.measured, signals=bare, units=units, bodies=()))
    with pytest.raises(MissingSignal, match="how its base moved"):
        track_of(silent, robot.joint_names, CONTROL_S, base_sensor="pelvis")
