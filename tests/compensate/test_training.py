"""Training: the window that is differentiated is the simulator's own way, and what it learns is what was wrong."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from compensate.arm_cases import CONTROL_S, arm_of, recorded, transitions_of
from trueup.augment.networks.operator import OperatorConfig
from trueup.compensate.closed_loop import closed_loop
from trueup.compensate.compensation import Compensation
from trueup.compensate.config import CompensateConfig, LossConfig, TrainConfig
from trueup.compensate.correctors import blank, corrector_for, scale
from trueup.compensate.linear import linear_of
from trueup.compensate.plants import Plants
from trueup.compensate.ppo_config import PpoConfig
from trueup.compensate.sensors import Sensors, responses
from trueup.compensate.tracks import track_of
from trueup.compensate.training import loss_of, unrolled
from trueup.compensate.windows import Windows
from trueup.errors import ConfigError, DataError, MissingSignal, OutputExists
from trueup.stages import compensate, compensated_replay, prepare

TOY = OperatorConfig(hidden=(16,), history=3, features=4, trunk=(8,), sensors=4, predictor=(8,))
CONFIG = CompensateConfig(
    network=TOY,
    training=TrainConfig(updates=120, rounds=4, batch=32, horizon=10, rate=1e-2),
    loss=LossConfig(sensors=0.01),
)


def sags(state, command, payload_kg):
    """Commands come out lower, the lower the heavier what is held, and a little short of where they point."""
    return -0.03 - 0.04 * payload_kg + 0.1 * (state[..., :2] - command)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compensate")
    robot, path = arm_of(folder / "robot", friction=False)
    data = recorded(folder / "data", robot, path, offset=sags)
    return robot, path, data, prepare(data, robot, model=path, jobs=1)


@pytest.fixture(scope="module")
def direct(world, tmp_path_factory):
    """A network for the simulator."""
    robot, _, data, prepared = world
    return compensate(data, robot, tmp_path_factory.mktemp("direct"), config=CONFIG, prepared=prepared, jobs=1)


def windows_of(prepared, past=2):
    return Windows(prepared.train, past)


def untrained(windows, config=CONFIG, seed=0):
    torch.manual_seed(seed)
    return corrector_for(config, windows, rate_hz=1 / CONTROL_S, size=0.5)


def test_a_window_is_the_way_that_the_simulator_goes(world):
    """Two programs for one thing: `unrolled` in torch, window by window, and `closed_loop` over whole motions."""
    robot, path, _, prepared = world
    windows = windows_of(prepared)
    corrector = untrained(windows)
    track = prepared.train[0].track
    steps = 20
    batch = Windows(prepared.train[:1], 2).batch(torch.tensor([2]), steps)
    with torch.no_grad():
        errors, deltas = unrolled(corrector, batch, torch.zeros(1, 4), simulate=prepared.plants.simulate)
    transitions = transitions_of(robot, path, payload_kg=track.payload_kg)
    state, before = track.state[2:3].astype(float), track.command[1:2].astype(float)
    for step in range(steps):
        sent = track.command[2 + step][None] + deltas[step].numpy()
        state = transitions.next(state, before, sent)
        before = sent
        assert errors[step].numpy() == pytest.approx(state - track.state[3 + step], abs=1e-5)


def test_the_linear_model_is_near_and_its_derivative_is_right(world):
    _, _, _, prepared = world
    windows = windows_of(prepared)
    corrector = untrained(windows)
    batch = windows.batch(windows.starts(10)[::37], 10)
    start = torch.zeros(batch.state.shape[1], 4)
    linear, deltas = unrolled(corrector, batch, start)
    exact, _ = unrolled(corrector, batch, start, simulate=prepared.plants.simulate)
    moved = batch.error.abs().mean()
    assert float((linear - exact).detach()[..., :2].abs().mean()) < 0.05 * float(exact.detach()[..., :2].abs().mean())
    assert moved > 0
    # Where the simulator itself says where it goes, the derivative is still that of the linear model.
    parameters = list(corrector.parameters())
    by_linear, by_exact = (
        torch.autograd.grad(own[..., :2].sum(), parameters, retain_graph=True) for own in (linear, exact)
    )
    together = [torch.cat([part.flatten() for part in own]) for own in (by_linear, by_exact)]
    assert float(torch.nn.functional.cosine_similarity(*together, dim=0)) > 0.99
    assert deltas.shape == (10, len(start), 2)


def test_sensors_are_what_the_simulator_does_under_fixed_commands(world):
    robot, path, _, prepared = world
    windows = windows_of(prepared)
    batch = windows.batch(windows.starts(1)[::50], 1)
    offsets = torch.tensor([[0.1, 0.0], [-0.05, 0.08]])
    state = batch.state[2]
    said = responses(batch, 0, state, torch.zeros_like(state), offsets).numpy().reshape(-1, 2, 4)
    for row in range(0, len(said), 5):
        transitions = transitions_of(robot, path, payload_kg=float(batch.payload[row, 0]))
        here = np.repeat(state[row : row + 1].numpy().astype(float), 2, axis=0)
        command = here[:, :2] + offsets.numpy()
        true = transitions.next(here, command, command) - here
        assert said[row] == pytest.approx(true, abs=0.02 * np.abs(true).max())
    sensors = Sensors.of(windows, 3, 2)
    scaled = sensors.values(batch, 0, state, torch.zeros_like(state))
    assert scaled.shape == (len(state), 3 * 4)
    assert 0.3 < float(scaled.std()) < 3.0
    own = batch.payload[:, 0] == batch.payload[0, 0]
    asked = sensors.simulated(
        transitions_of(robot, path, payload_kg=float(batch.payload[0, 0])),
        state[own].double().numpy(),
        batch.command[1][own].double().numpy(),
    )
    assert asked == pytest.approx(scaled[own].numpy(), abs=0.05)


def test_an_operator_may_be_told_what_sensors_say(world):
    """Windows of the linear model and motions of the simulator show it the same, but for what the model leaves out."""
    robot, path, _, prepared = world
    windows, track = windows_of(prepared), prepared.train[0].track
    config = replace(CONFIG, network=replace(TOY, senses="true"))
    sensors = Sensors.of(windows, TOY.sensors, 2)
    corrector = blank(config, 2, 1 / CONTROL_S, sensed=sensors.center.numel())
    scale(corrector, config, windows)
    batch = Windows(prepared.train[:1], 2).batch(torch.tensor([2]), 10)
    plants = Plants(robot, path, CONTROL_S)
    at_rest = torch.cat([torch.zeros(1, 2), -batch.state[2][:, 2:]], dim=1)
    with torch.no_grad():
        _, deltas = unrolled(corrector, batch, at_rest, simulate=plants.simulate, sensors=sensors)
    cut = replace(track, state=track.state[2:], command=track.command[2:], time_s=track.time_s[2:])
    (run,) = closed_loop([cut], plants, corrector, sensors=sensors, settle_s=0.0)
    largest = np.abs(run.delta[:10]).max()
    assert run.delta[:10] == pytest.approx(deltas[:, 0].numpy(), abs=0.05 * largest)
    assert largest > 1e-4
    with pytest.raises(ConfigError, match="no simulator to ask"):
        compensate(world[2], robot, path.parent / "told", config=config, prepared=prepared)


def test_losses_by_hand():
    """Squares near zero, straight lines far away, changes and sizes of delta actions on top."""
    config = LossConfig(position_rad=0.01, velocity_rad_s=1.0, linear_from=4.0, smoothness=0.5, size=0.1)
    small = torch.tensor([[[1e-4, 1e-2]]])
    none = torch.zeros(1, 1, 1)
    assert float(loss_of(small, none, config)) == pytest.approx(1e-4, rel=1e-3)
    far = torch.tensor([[[1.0, 0.0]]])
    assert float(loss_of(far, none, config)) == pytest.approx((2 * 4.0 * 100 - 2 * 16) / 2, rel=2e-2)
    deltas = torch.tensor([[[0.0]], [[0.02]]])
    assert float(loss_of(torch.zeros(2, 1, 2), deltas, config)) == pytest.approx(0.5 * 4.0 + 0.1 * 2.0)


@pytest.mark.long
def test_delta_actions_one_by_one_teach_it_too(world, tmp_path):
    robot, _, data, prepared = world
    config = replace(CONFIG, training=replace(CONFIG.training, way="delta"))
    made = compensate(data, robot, tmp_path / "net", config=config, prepared=prepared, jobs=1)
    for item in made.errors:
        assert item.after < 0.25 * item.before, item


@pytest.mark.long
def test_what_was_wrong_is_learned_and_kept(world, direct):
    robot, path, data, prepared = world
    made, folder = direct, direct.folder
    for item in made.errors:
        assert item.after < 0.25 * item.before, item
    again = Compensation.load(folder)
    assert again.direction == "simulator"
    assert again.card.name == "operator"
    motions = [part.track for part in prepared.val]
    ours, theirs = (closed_loop(motions, prepared.plants, own.corrector) for own in (made.compensation, again))
    assert all(np.array_equal(a.state, b.state) for a, b in zip(ours, theirs, strict=True))
    # What a test motion is simulated like, as a run of the dataset.
    before = compensated_replay(data, robot, folder, model=path, label="mujoco/helped", jobs=1)
    assert before.replayed == len(data.ids)
    for name in data.select(split="test"):
        episode = data.episode(name, runs=("mujoco/helped",))
        gap = np.abs(episode.run("mujoco/helped")["position"] - episode.measured["position"])
        assert gap.mean() < 0.015
    with pytest.raises(OutputExists):
        compensate(data, robot, folder, config=CONFIG, prepared=prepared, jobs=1)
    finished = compensate(data, robot, folder, config=CONFIG, prepared=prepared, jobs=1, resume=True)
    assert finished.notes == ("was finished already",)
    assert finished.errors == made.errors


@pytest.mark.long
def test_the_robot_is_made_to_move_like_its_simulator(world, direct, tmp_path):
    """A network for the robot, trained on the twin that a first network has made, works on the robot itself."""
    robot, path, data, prepared = world
    made = compensate(
        data,
        robot,
        tmp_path / "net",
        config=CONFIG,
        prepared=prepared,
        model=path,
        twin=(direct.folder, robot),
        jobs=1,
    )
    assert made.compensation.direction == "robot"
    for item in made.errors:
        assert item.after < 0.4 * item.before, item
    # The robot: the simulator whose commands sag. Its own network reads its own state.
    for payload_kg in (0.0, 1.0):
        transitions = transitions_of(robot, path, payload_kg=payload_kg)
        track = next(part.track for part in prepared.val if part.track.payload_kg == payload_kg)
        wanted = closed_loop([track], prepared.plants, None)[0].state[:, :2]
        gaps = []
        for helped in (False, True):
            state, rows, seen = np.array([[*wanted[0], 0.0, 0.0]]), [], []
            for command in track.command[:, None].astype(float):
                sample = torch.tensor(np.concatenate([state, command, [[payload_kg]]], axis=1), dtype=torch.float32)
                seen = [*(seen or [sample] * 2), sample][-3:]
                with torch.no_grad():
                    delta = made.compensation.corrector(torch.stack(seen))[-1].numpy() - command
                sent = command + delta * helped
                sent = sent + sags(state, sent, payload_kg)
                rows.append(state[0, :2])
                state = transitions.next(state, sent, sent)
            gaps.append(np.abs(np.array(rows) - wanted).mean())
        assert gaps[1] < 0.5 * gaps[0]


@pytest.mark.long
def test_an_interrupted_training_ends_with_the_same_weights(world, tmp_path, monkeypatch):
    robot, _, data, prepared = world
    config = replace(CONFIG, training=replace(CONFIG.training, updates=8, rounds=4))
    whole = compensate(data, robot, tmp_path / "whole", config=config, prepared=prepared, jobs=1)

    def stop(done, _):
        if done.number == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compensate(data, robot, tmp_path / "parts", config=config, prepared=prepared, jobs=1, on_round=stop)
    rounds = []
    parts = compensate(
        data,
        robot,
        tmp_path / "parts",
        config=config,
        prepared=prepared,
        jobs=1,
        resume=True,
        on_round=lambda done, _: rounds.append(done.number),
    )
    assert rounds[0] == 3
    for name, value in whole.compensation.corrector.state_dict().items():
        assert torch.equal(value, parts.compensation.corrector.state_dict()[name]), name
    short = replace(config, training=replace(config.training, updates=1, rounds=1))
    one, other = (
        compensate(data, robot, tmp_path / f"{seed}", config=short, prepared=prepared, jobs=1, seed=seed)
        for seed in (0, 1)
    )
    assert not torch.equal(
        one.compensation.corrector.network.window.weight, other.compensation.corrector.network.window.weight
    )
    with pytest.raises(OutputExists):
        compensate(data, robot, tmp_path / "whole", config=CONFIG, prepared=prepared, jobs=1, resume=True)


def test_data_that_say_nothing_of_commands_are_refused(world, tmp_path):
    robot, path, data, prepared = world
    with pytest.raises(DataError, match=r"come at another rate.*50 Hz.*100 Hz"):
        prepare(data, robot, model=path, control_hz=100.0)
    bare = recorded(tmp_path / "bare", robot, path, offset=sags, payloads=(0.0,), command=False)
    with pytest.raises((MissingSignal, DataError), match="command"):
        prepare(bare, robot, model=path, jobs=1)
    episode = data.episode(data.ids[0])
    with pytest.raises(DataError, match="another rate"):
        track_of(episode, robot.joint_names, 0.01)
    with pytest.raises(ConfigError, match="corrects commands of the robot"):
        compensate(
            data, robot, tmp_path / "net", config=CONFIG, prepared=prepared, twin=(_robot_side(world, tmp_path), robot)
        )


def _robot_side(world, folder):
    """A model folder whose card says that it is for the robot."""
    robot, _, _, prepared = world
    windows = windows_of(prepared)
    made = Compensation.of(
        untrained(windows),
        CONFIG,
        windows,
        name="x",
        robot=robot.name,
        joints=robot.joint_names,
        units=("rad",) * 2,
        run="mujoco/stock",
        rate_hz=50.0,
        direction="robot",
        provenance_of={},
    )
    return made.save(folder / "robot-side") and folder / "robot-side"


def test_linear_models_between_are_interpolated(world):
    robot, path, _, prepared = world
    track = prepared.train[0].track
    transitions = Plants(robot, path, CONTROL_S)(track.payload_kg)
    every, sparse = (linear_of(track, transitions, every=own) for own in (1, 10))
    assert np.array_equal(every.error, sparse.error)
    assert sparse.command == pytest.approx(every.command, abs=0.05 * float(np.abs(every.command).max()))
    assert np.array_equal(every.command[::10], sparse.command[::10])


@pytest.mark.long
def test_a_network_that_blows_the_simulation_up_costs_a_round_and_no_training(world, tmp_path, monkeypatch):
    robot, _, data, prepared = world
    config = replace(CONFIG, training=replace(CONFIG.training, updates=4, rounds=2))
    calls, whole = [], prepared.plants.simulate

    def simulate(*given):
        calls.append(1)
        if len(calls) == 1:
            raise DataError("the simulation diverged")
        return whole(*given)

    monkeypatch.setattr(prepared.plants, "simulate", simulate)
    judged = []
    real = closed_loop

    def looped(*given, **options):
        judged.append(1)
        if len(judged) == 2:  # of the second round
            raise DataError("the simulation diverged")
        return real(*given, **options)

    monkeypatch.setattr("trueup.compensate.closed_loop.closed_loop", looped)
    made = compensate(data, robot, tmp_path / "net", config=config, prepared=prepared, jobs=1)
    history = made.compensation.card.provenance["training"]["history"]
    assert [item["val"] > 1e6 for item in history] == [False, True]
    assert made.compensation.card.provenance["training"]["best_round"] > 0


def test_reinforcement_is_a_way_of_the_stage(world, tmp_path):
    robot, path, data, prepared = world
    config = replace(
        CONFIG,
        training=replace(CONFIG.training, way="ppo"),
        ppo=PpoConfig(samples=512, robots=8, steps=32, batch=128, critic=(8,)),
    )
    made = compensate(data, robot, tmp_path / "net", config=config, prepared=prepared, jobs=1)
    assert made.compensation.card.provenance["training"]["cpu_seconds"] > 0
    assert Compensation.load(tmp_path / "net").config.training.way == "ppo"
    with pytest.raises(ConfigError, match="reinforcement corrects simulators"):
        compensate(data, robot, tmp_path / "other", config=config, prepared=prepared, model=path, twin=(None, robot))
