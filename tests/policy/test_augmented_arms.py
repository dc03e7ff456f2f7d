"""Arms with a network: the same as a corrected simulator around each, and as a compensated one."""

from dataclasses import replace

import numpy as np
import pytest

from augment.test_networks import corrector_of
from trueup.augment.config import NetworkConfig
from trueup.augment.simulator import ResidualSimulator
from trueup.compensate.closed_loop import closed_loop
from trueup.compensate.compensation import Compensation, channels
from trueup.compensate.config import METHODS
from trueup.compensate.correctors import blank
from trueup.compensate.tracks import Track
from trueup.core.model_card import ONNX_NAME, Input, ModelCard, Output
from trueup.deploy import Network
from trueup.errors import ConfigError, NameMismatch
from trueup.policy.arms import Arms, EngineArm, MujocoArms
from trueup.policy.augmented_arms import AugmentedArms
from trueup.policy.config import PolicyConfig
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching
from trueup.policy.simulated import simulated
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.sim.transitions import Transitions

PANDA = load_robot("panda_torque")
SIMULATOR = MujocoSimulator.from_robot(PANDA, find_model(PANDA))
JOINTS = PANDA.joint_names
HOME = SIMULATOR.model.key("home").qpos[SIMULATOR.places[0]]
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
RATE_HZ, CONTROL_S = 100.0, 0.04
LSTM = NetworkConfig("lstm", (9,))


def card_of(inputs, outputs, **changes):
    said = {"name": "net", "method": "lstm", "robot": PANDA.name, "run": "mujoco/stock", "rate_hz": RATE_HZ}
    return ModelCard(**{**said, "joints": JOINTS, "causal": True, "inputs": inputs, "outputs": outputs, **changes})


def reader(folder, config=LSTM):
    """A network that corrects what is read, with random weights and small corrections."""
    listed = [(signal, joint, unit) for signal, unit in UNITS.items() for joint in JOINTS]
    base = tuple(range(14))
    card = card_of(
        tuple(Input(*one) for one in listed),
        tuple(Output(*listed[n], base=n) for n in base),
        causal=not config.bidirectional,
    )
    corrector = corrector_of(config, np.random.default_rng(2), inputs=len(listed), base=base)
    corrector.out_scale.mul_(0.05)
    folder.mkdir(exist_ok=True)
    (folder / ONNX_NAME).write_bytes(corrector.exported({}))
    replace(card, states=corrector.states if card.causal else ()).save(folder)
    return Network.load(folder)


def actor(folder):
    """A network that corrects torques, with random weights."""
    config = replace(METHODS["torques"], network=NetworkConfig("mlp", (12,), history=3))
    corrector = blank(config, 7, RATE_HZ, seed=5)
    corrector.out_scale.fill_(2.0)
    for values in corrector.network.parameters():
        values.data.add_(0.2)
    inputs = channels(JOINTS, ["rad"] * 7, "torque", ["Nm"] * 7)
    outputs = tuple(Output("torque", joint, "Nm", "command", base=14 + n) for n, joint in enumerate(JOINTS))
    card = card_of(inputs, outputs, states=corrector.states, provenance={"direction": "simulator"})
    return Compensation(card, corrector, config).save(folder)


def arms_of(network, count=3, control_s=CONTROL_S):
    return AugmentedArms(MujocoArms(SIMULATOR, count, 1.0 / RATE_HZ), network, control_s)


def torques(steps, count, seed=0):
    return np.random.default_rng(seed).uniform(-2, 2, (steps, count, 7))


def driven(arms, torque):
    """Positions and velocities after each control step, (T, N, 14)."""
    arms.begin(np.arange(arms.count), np.tile(HOME, (arms.count, 1)), np.random.default_rng(0))
    rows = []
    for own in torque:
        arms.step(own)
        rows.append(np.concatenate([arms.position, arms.velocity], axis=1))
    return np.array(rows)


def test_a_network_on_what_is_read_is_a_corrected_simulator_around_each_arm(tmp_path):
    network = reader(tmp_path / "net")
    torque = torques(12, 3)
    together = driven(arms_of(network), torque)
    assert isinstance(arms_of(network), Arms)
    for number in range(3):
        alone = driven(EngineArm(ResidualSimulator(SIMULATOR.clone(), network), CONTROL_S), torque[:, [number]])
        np.testing.assert_allclose(together[:, [number]], alone, atol=1e-6)
    plain = driven(MujocoArms(SIMULATOR, 3, CONTROL_S), torque)
    assert np.abs(together - plain).max() > 0.01


def test_a_network_on_torques_is_a_compensated_simulator(tmp_path):
    made = actor(tmp_path / "net")
    arms = arms_of(Network.load(tmp_path / "net"), control_s=1.0 / RATE_HZ)
    torque = torques(30, 3, seed=1)
    together = driven(arms, torque)
    transitions = Transitions(SIMULATOR, 1.0 / RATE_HZ)
    for number in range(3):
        state = np.tile(np.concatenate([HOME, np.zeros(7)]), (31, 1)).astype(np.float32)
        asked = np.concatenate([torque[:, number], torque[-1:, number]]).astype(np.float32)
        track = Track("m", 0.0, state, asked, np.arange(31) / RATE_HZ)
        (run,) = closed_loop([track], lambda _: transitions, made.corrector)
        np.testing.assert_allclose(together[:, number], run.state[1:], atol=1e-4)
    plain = driven(MujocoArms(SIMULATOR, 3, 1.0 / RATE_HZ), torque)
    assert np.abs(together - plain).max() > 0.01


@pytest.mark.parametrize("kind", [reader, actor])
def test_a_network_that_says_what_is_no_number_ends_the_episode(tmp_path, kind, monkeypatch):
    kind(tmp_path / "net")
    network = Network.load(tmp_path / "net")
    arms = arms_of(network, 3, control_s=1.0 / RATE_HZ)
    reaching = Reaching(arms, SIMULATOR.model, ReachConfig(control_hz=RATE_HZ))
    rng = np.random.default_rng(0)
    reaching.begin(np.arange(3), rng)
    reaching.step(np.zeros((3, 7)), rng)
    run = arms._network.session.run

    class Broken:
        def run(self, names, feeds):
            y, *after = run(names, feeds)
            y = y.copy()
            y[0, 1] = np.nan
            return [y, *after]

    monkeypatch.setattr(type(arms._network), "session", property(lambda _: Broken()), raising=False)
    done = reaching.step(np.zeros((3, 7)), rng)
    assert done.lost.tolist() == [False, True, False]
    assert reaching.lost_episodes == 1
    assert np.isfinite(done.observation).all()
    assert np.isfinite(done.reward).all()


@pytest.mark.parametrize("kind", [reader, actor])
def test_an_arm_that_begins_anew_forgets_and_the_others_do_not(tmp_path, kind):
    kind(tmp_path / "net")
    network = Network.load(tmp_path / "net")
    torque = torques(10, 2, seed=3)
    undisturbed = driven(arms_of(network, 2), torque)
    arms = arms_of(network, 2)
    arms.begin(np.arange(2), np.tile(HOME, (2, 1)), np.random.default_rng(0))
    for own in torque[:5]:
        arms.step(own)
    arms.begin(np.array([1]), HOME[None], np.random.default_rng(0))
    np.testing.assert_array_equal(arms.position[1], HOME)
    rows = []
    for own in torque[5:]:
        arms.step(np.stack([own[0], torque[len(rows)][1]]))
        rows.append(np.concatenate([arms.position, arms.velocity], axis=1))
    rows = np.array(rows)
    np.testing.assert_allclose(rows[:, 0], undisturbed[5:, 0], atol=1e-9)
    np.testing.assert_allclose(rows[:, 1], undisturbed[:5, 1], atol=1e-9)


def test_a_training_asks_for_it_by_its_folder(tmp_path):
    actor(tmp_path / "net")
    config = PolicyConfig(network=str(tmp_path / "net"), reach=ReachConfig(control_hz=25.0), arms=2, steps=40, rounds=1)
    reaching = simulated(config, PANDA, find_model(PANDA))
    assert isinstance(reaching.arms, AugmentedArms)
    with pytest.raises(ConfigError, match="no whole number of samples"):
        simulated(replace(config, reach=ReachConfig(control_hz=60.0)), PANDA, find_model(PANDA))


def test_networks_of_other_robots_of_the_future_and_of_other_signals_are_refused(tmp_path):
    network = reader(tmp_path / "a")
    inputs = tuple(replace(channel, joint=f"other{k % 7}") for k, channel in enumerate(network.card.inputs))
    outputs = tuple(replace(channel, joint=f"other{k % 7}") for k, channel in enumerate(network.card.outputs))
    names = tuple(f"other{n}" for n in range(7))
    replace(network.card, joints=names, inputs=inputs, outputs=outputs).save(tmp_path / "a")
    with pytest.raises(NameMismatch, match="another robot"):
        arms_of(Network.load(tmp_path / "a"))
    future = reader(tmp_path / "b", NetworkConfig("lstm", (8,), bidirectional=True))
    with pytest.raises(ConfigError, match="looks into the future"):
        arms_of(future)
    network = reader(tmp_path / "c")
    corrector = corrector_of(LSTM, np.random.default_rng(2), inputs=21, base=tuple(range(14, 21)))
    (tmp_path / "c" / ONNX_NAME).write_bytes(corrector.exported({}))
    outputs = tuple(Output("torque", joint, "Nm", base=14 + n) for n, joint in enumerate(JOINTS))
    replace(network.card, outputs=outputs, states=corrector.states).save(tmp_path / "c")
    with pytest.raises(ConfigError, match="is not one for arms that take torques"):
        arms_of(Network.load(tmp_path / "c"))


@pytest.mark.parametrize("delay_s", [0.004, 0.01, 0.0137, 0.027])
def test_torques_may_be_late_by_more_than_a_period_of_the_network(tmp_path, delay_s):
    """What is read is corrected; what acts, and when, is not."""
    torque = torques(10, 2)
    inner = MujocoArms(SIMULATOR, 2, 1.0 / RATE_HZ, delay_s=delay_s)
    driven(AugmentedArms(inner, reader(tmp_path / "net"), CONTROL_S), torque)
    plain = driven(MujocoArms(SIMULATOR, 2, CONTROL_S, delay_s=delay_s), torque)
    np.testing.assert_allclose(np.concatenate([inner.position, inner.velocity], axis=1), plain[-1], atol=1e-9)
