"""A corrected simulator is a simulator: one rule for both faces, and what it adds is what the network says."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import torch

from augment.evaluation_cases import RUN, card_of, shift_folder
from augment.test_networks import corrector_of
from sim.arms import episode, series, two_links
from trueup.augment.config import NetworkConfig
from trueup.augment.correction import corrected
from trueup.augment.graph import Graph
from trueup.augment.networks.sat import SatConfig
from trueup.augment.simulator import ResidualSimulator
from trueup.augment.trained import Trained
from trueup.core.model_card import ANY_JOINT, ONNX_NAME, Input, Output
from trueup.core.protocols import RolloutRequest, RolloutResult, Simulator
from trueup.deploy import Network, Predictor
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, UnitError
from trueup.lab.simulated_robot import SimulatedRobot
from trueup.robots import ControllerSpec
from trueup.sim import ReplaySettings, replay_episode

SIGNALS = ("position", "velocity", "torque")
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
SERVO = ControllerSpec(kind="position", kp=40.0, kv=2.0)
# Steps per sample at 100 Hz: 10, 10/3, 1, 4/3.
STEPS_S = [Fraction(1, 1000), Fraction(3, 1000), Fraction(1, 100), Fraction(3, 400)]


class Masses:
    """Masses on rails that a commanded force pulls, apart from each other; and a joint that no network knows."""

    joints = ("c", "b", "a")
    command_signals = ("torque",)

    def __init__(self, timestep_s=0.001):
        self.timestep_s = float(timestep_s)

    def reset(self, position, velocity):
        self.position, self.velocity = position.copy(), velocity.copy()

    def step(self, command):
        self.velocity = self.velocity + self.timestep_s * command["torque"]
        self.position = self.position + self.timestep_s * self.velocity
        return {"position": self.position, "velocity": self.velocity, "torque": command["torque"]}

    def rollout(self, request):
        self.reset(request.position, request.velocity)
        rows = [{"position": request.position, "velocity": request.velocity}]
        rows += [self.step({"torque": force}) for force in np.swapaxes(request.command["torque"], 0, 1)]
        force = request.command["torque"]
        return RolloutResult(
            *(np.stack([row[name] for row in rows], axis=1) for name in ("position", "velocity")),
            torque=np.concatenate([force, force[:, -1:]], axis=1),
        )


def request_of(rng, copies=2, steps=60, joints=3, signals=("torque",)):
    start = rng.normal(size=(2, copies, joints))
    return RolloutRequest(*start, {name: rng.normal(size=(copies, steps, joints)) for name in signals})


def stepped(simulator, request):
    """The same through `reset` and `step`: what each step returns, (B, N, J)."""
    simulator.reset(request.position, request.velocity)
    steps = request.command["torque"].shape[1]
    rows = [simulator.step({name: values[:, k] for name, values in request.command.items()}) for k in range(steps)]
    return {name: np.stack([row[name] for row in rows], axis=1) for name in SIGNALS}


def random_card(**changes):
    """Joints a and b in another order than the simulator's; corrects both torques and a position and a velocity."""
    channels = [(signal, joint, UNITS[signal]) for signal in SIGNALS for joint in ("a", "b")]
    base = (0, 3, 4, 5)
    return replace(
        card_of(),
        inputs=tuple(Input(*channel) for channel in channels),
        outputs=tuple(Output(*channels[number], base=number) for number in base),
        **changes,
    )


def random_network(folder, config, **changes):
    card = random_card(causal=not config.bidirectional, **changes)
    corrector = corrector_of(config, np.random.default_rng(2), base=card.base)
    (folder / ONNX_NAME).write_bytes(corrector.exported({}))
    replace(card, states=corrector.states if card.causal else ()).save(folder)
    return Network.load(folder)


def modular_network(folder, config):
    channels = [(signal, ANY_JOINT, UNITS[signal]) for signal in SIGNALS]
    card = replace(
        card_of(),
        joints=(ANY_JOINT,),
        modular=True,
        inputs=tuple(Input(*channel) for channel in channels),
        outputs=tuple(Output(*channel, base=number) for number, channel in enumerate(channels)),
    )
    corrector = corrector_of(config, np.random.default_rng(2), inputs=len(channels), base=card.base)
    with torch.no_grad():
        for values in corrector.network.parameters():  # what is not trained corrects nothing
            values.add_(0.1 * torch.randn_like(values))
    (folder / ONNX_NAME).write_bytes(corrector.exported({}))
    replace(card, states=corrector.states).save(folder)
    return Network.load(folder)


def shifting(folder, shift, **changes):
    """A network that adds constants to the inputs of `card_of`: positions and torques of a and b."""
    return Network.load(shift_folder(folder, card_of(**changes), shift))


LSTM, MLP = NetworkConfig("lstm", (9, 5)), NetworkConfig("mlp", (8,), history=4)
PRECISE = NetworkConfig("lstm", (8,), bidirectional=True)


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def test_it_is_a_simulator(tmp_path):
    simulator = ResidualSimulator(Masses(), shifting(tmp_path, np.zeros(4)))
    assert isinstance(simulator, Simulator)
    assert isinstance(ResidualSimulator(simulator, shifting(tmp_path, np.zeros(4))), Simulator)
    assert (simulator.joints, simulator.timestep_s, simulator.command_signals) == (Masses.joints, 0.001, ("torque",))


@pytest.mark.parametrize("config", [LSTM, MLP], ids=["lstm", "mlp"])
@pytest.mark.parametrize("step_s", STEPS_S, ids=str)
@pytest.mark.parametrize("warmup", [False, True])
def test_both_faces_say_the_same(tmp_path, rng, config, step_s, warmup):
    network = random_network(tmp_path, config, warmup_steps=2)
    simulator = ResidualSimulator(Masses(step_s), network, warmup=warmup)
    request = request_of(rng)
    plain, result = Masses(step_s).rollout(request), simulator.rollout(request)
    steps = stepped(simulator, request)
    np.testing.assert_allclose(steps["position"], result.position[:, 1:], atol=1e-5)
    np.testing.assert_allclose(steps["velocity"], result.velocity[:, 1:], atol=1e-5)
    np.testing.assert_allclose(steps["torque"], result.torque[:, :-1], atol=1e-5)
    np.testing.assert_array_equal(result.torque[:, -1], result.torque[:, -2])
    assert np.abs(result.torque - plain.torque)[..., 1:].max() > 0.1  # the network says something


def added_by_hand(network, plain, step_s, *, end=False):
    """Stamps of the samples of motion 0 before its end (or up to it), and the corrections there, (T, K)."""
    steps = plain.position.shape[1] - 1
    stamps = [Fraction(n, 100) for n in range(1000) if Fraction(n, 100) < steps * step_s]
    stamps += [steps * step_s] if end and (steps * step_s * 100).denominator == 1 else []
    rows = []
    for stamp in stamps:
        row = min(int(stamp / step_s), steps - 1)
        share = float(stamp / step_s - row)
        state = [
            (1 - share) * values[0, row] + share * values[0, row + 1] for values in (plain.position, plain.velocity)
        ]
        joints = [Masses.joints.index(joint) for joint in ("a", "b")]
        rows.append([values[joint] for values in (*state, plain.torque[0, row]) for joint in joints])
    x = np.array(rows, np.float32)[:, None]
    return stamps, (Predictor(network).run(x) - x[..., network.card.base])[:, 0]


@pytest.mark.parametrize("step_s", STEPS_S, ids=str)
def test_the_rule_by_hand(tmp_path, rng, step_s):
    """What a step returns has the correction of the latest sample before its end; samples in exact arithmetic."""
    network = random_network(tmp_path, LSTM)
    request = request_of(rng, copies=1)
    plain, result = (s.rollout(request) for s in (Masses(step_s), ResidualSimulator(Masses(step_s), network)))
    stamps, added = added_by_hand(network, plain, step_s)
    for k in range(60):
        latest = max(n for n, stamp in enumerate(stamps) if stamp < (k + 1) * step_s)
        position_a, velocity_b, torque_a, torque_b = added[latest]
        assert result.position[0, k + 1] - plain.position[0, k + 1] == pytest.approx([0, 0, position_a], abs=1e-5)
        assert result.velocity[0, k + 1] - plain.velocity[0, k + 1] == pytest.approx([0, velocity_b, 0], abs=1e-5)
        assert result.torque[0, k] - plain.torque[0, k] == pytest.approx([0, torque_b, torque_a], abs=1e-5)
    assert result.position[0, 0] - plain.position[0, 0] == pytest.approx([0, 0, added[0, 0]], abs=1e-5)


@pytest.mark.parametrize("step_s", STEPS_S, ids=str)
def test_a_network_that_sees_the_future_is_interpolated_between_its_samples(tmp_path, rng, step_s):
    network = random_network(tmp_path, PRECISE)
    request = request_of(rng, copies=1)
    plain, result = (s.rollout(request) for s in (Masses(step_s), ResidualSimulator(Masses(step_s), network)))
    stamps, added = added_by_hand(network, plain, step_s, end=True)
    ticks = np.arange(61) * float(step_s)
    position_a, velocity_b, torque_a, torque_b = (np.interp(ticks, np.array(stamps, float), one) for one in added.T)
    for name, joint, expected in (
        ("position", 2, position_a),
        ("velocity", 1, velocity_b),
        ("torque", 2, np.append(torque_a[:-1], torque_a[-2])),  # its last row repeats the one before
        ("torque", 1, np.append(torque_b[:-1], torque_b[-2])),
    ):
        found = (getattr(result, name) - getattr(plain, name))[0, :, joint]
        np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("rate_hz", [100.0, 300.0])
def test_a_correction_of_zero_changes_no_bit_in_an_engine(tmp_path, rng, rate_hz):
    simulator = ResidualSimulator(two_links(tmp_path, SERVO), shifting(tmp_path, np.zeros(4), rate_hz=rate_hz))
    request = request_of(rng, joints=2, signals=("position", "torque"))
    plain, result = two_links(tmp_path, SERVO).rollout(request), simulator.rollout(request)
    alone, steps = stepped(two_links(tmp_path, SERVO), request), stepped(simulator, request)
    for name in SIGNALS:
        assert np.array_equal(getattr(result, name), getattr(plain, name))
        assert np.array_equal(steps[name], alone[name])


@pytest.mark.parametrize("causal", [True, False])
def test_a_constant_correction_is_added_everywhere_and_the_physics_goes_on_without_it(tmp_path, rng, causal):
    shift = [0.5, -0.25, 2.0, 4.0]  # of position and torque of a and b
    simulator = ResidualSimulator(Masses(0.003), shifting(tmp_path, shift, causal=causal))
    request = request_of(rng)
    plain, result = Masses(0.003).rollout(request), simulator.rollout(request)
    for name, expected in (("position", [0, -0.25, 0.5]), ("velocity", [0, 0, 0]), ("torque", [0, 4, 2])):
        added = getattr(result, name) - getattr(plain, name)
        np.testing.assert_allclose(added, np.broadcast_to(expected, added.shape), atol=1e-5)


def test_the_arrays_of_the_simulator_inside_stay_as_they_are(tmp_path, rng):
    inner = Masses()
    simulator = ResidualSimulator(inner, shifting(tmp_path, np.ones(4)))
    simulator.reset(np.zeros((1, 3)), np.zeros((1, 3)))
    force = np.ones((1, 3))
    simulator.step({"torque": force})
    np.testing.assert_array_equal(inner.position, np.full((1, 3), 1e-6))
    np.testing.assert_array_equal(force, 1)


def test_copies_are_independent_and_a_reset_forgets(tmp_path, rng):
    simulator = ResidualSimulator(Masses(0.003), random_network(tmp_path, LSTM))
    request = request_of(rng, copies=3)
    together = stepped(simulator, request)
    for copy in (2, 0, 1):
        one = RolloutRequest(
            request.position[[copy]], request.velocity[[copy]], {"torque": request.command["torque"][[copy]]}
        )
        alone = stepped(simulator, one)
        for name in SIGNALS:
            np.testing.assert_allclose(alone[name][0], together[name][copy], atol=1e-5)


def test_a_copy_that_diverged_leaves_the_others_alone(tmp_path, rng):
    simulator = ResidualSimulator(Masses(0.003), random_network(tmp_path, LSTM))
    request = request_of(rng)
    expected = stepped(simulator, request)
    request.command["torque"][1, 20:] = np.inf
    found = stepped(simulator, request)
    for name in SIGNALS:
        np.testing.assert_allclose(found[name][0], expected[name][0], atol=1e-5)
        assert not np.isfinite(found[name][1, -1]).any()
    with pytest.raises(DataError, match="not finite"):
        simulator.rollout(request)


def test_warming_up_leaves_the_first_samples_as_they_were(tmp_path, rng):
    network = shifting(tmp_path, np.ones(4), warmup_steps=3)
    request = request_of(rng)
    plain = Masses(0.003).rollout(request)
    result = ResidualSimulator(Masses(0.003), network, warmup=True).rollout(request)
    # Sample 3, at 30 ms, is the first that counts: for the torque from row 10 on, for the position from row 11 on.
    for name, first in (("torque", 10), ("position", 11)):
        added = (getattr(result, name) - getattr(plain, name))[..., 2]
        assert not added[:, :first].any()
        assert added[:, first:] == pytest.approx(1, abs=1e-6)


def commanded(folder):
    """Adds the commanded velocity of b to the torque of a."""
    inputs = (Input("torque", "a", "Nm"), Input("velocity", "b", "rad/s", "command"))
    card = replace(card_of(), inputs=inputs, outputs=(Output("torque", "a", "Nm", base=0),))
    graph = Graph()
    x = graph.input("x", ["T", "B", 2])
    torque, velocity = (graph.add("Gather", x, graph.integers([number]), axis=2) for number in (0, 1))
    graph.output(graph.add("Add", torque, velocity), "y", ["T", "B", 1])
    (folder / ONNX_NAME).write_bytes(graph.serialized({}))
    card.save(folder)
    return Network.load(folder)


def test_a_network_may_read_commands_that_the_controller_does_not_follow(tmp_path, rng):
    simulator = ResidualSimulator(Masses(), commanded(tmp_path))
    assert simulator.command_signals == ("torque", "velocity")
    request = request_of(rng, signals=("torque", "velocity"))
    added = simulator.rollout(request).torque[:, :-1] - request.command["torque"]
    samples = request.command["velocity"][:, ::10, 1]
    np.testing.assert_allclose(added[..., 2], np.repeat(samples, 10, axis=1), atol=1e-5)
    np.testing.assert_allclose(stepped(simulator, request)["torque"], added + request.command["torque"], atol=1e-5)
    del request.command["velocity"]
    for face in (simulator.rollout, lambda given: stepped(simulator, given)):
        with pytest.raises(MissingSignal, match=r"reads the command 'velocity', which is not given.*available: torque"):
            face(request)


def log_of(simulator, rng):
    time_s = np.arange(0, 1.5, 0.01)
    target = 0.4 * np.sin(2 * np.pi * rng.uniform(0.3, 1.0, 2) * time_s[:, None])
    return episode(series(time_s, position=0 * target), series(time_s, position=target))


@pytest.mark.parametrize("config", [LSTM, PRECISE], ids=["causal", "precise"])
def test_a_replay_through_it_is_the_corrected_replay(tmp_path, rng, config):
    """To 1e-5, but for the last torque, and position and velocity of a causal network, which are a sample behind."""
    inner, network = two_links(tmp_path, SERVO), random_network(tmp_path, config)
    log = log_of(inner, rng)
    plain = replay_episode(log, inner, ReplaySettings())
    expected = corrected(replace(log, simulated={RUN: plain}), RUN, network.card, Predictor(network).run)
    found = replay_episode(log, Trained(network).simulator(inner), ReplaySettings())
    # The last stamp is the end of the last step; no step begins there, whose torque it could be.
    np.testing.assert_allclose(found["torque"][:-1], expected["torque"][:-1], atol=1e-5)
    for name in ("position", "velocity"):
        added = expected[name] - plain[name]
        if network.card.causal:
            added = np.concatenate([added[:1], added[:-1]])
        np.testing.assert_allclose(found[name], plain[name] + added, atol=1e-5)
    assert np.abs(np.diff(expected["torque"] - plain["torque"], axis=0)).max() > 1e-2


def test_a_robot_that_is_read_through_it_reports_corrected_signals(tmp_path):
    robots = [
        SimulatedRobot(simulator, position=np.array([0.4, -0.2]), steps_per_control=4)
        for simulator in (
            two_links(tmp_path, SERVO),
            Trained(shifting(tmp_path, [0.5, 0.0, 0.0, 2.0])).simulator(two_links(tmp_path, SERVO)),
        )
    ]
    for robot in robots:
        robot.wait_until_s(0.1)
    plain, read = (robot.read() for robot in robots)
    assert read["position"] - plain["position"] == pytest.approx([0.5, 0], abs=1e-6)
    assert read["torque"] - plain["torque"] == pytest.approx([0, 2], abs=1e-6)


def test_a_network_that_sees_the_future_goes_no_steps(tmp_path):
    simulator = ResidualSimulator(Masses(), random_network(tmp_path, PRECISE))
    with pytest.raises(ConfigError, match=r"looks into the future and cannot go step by step\nrollout corrects"):
        simulator.reset(np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(ConfigError, match="looks into the future"):
        simulator.step({"torque": np.zeros((1, 3))})


def test_what_does_not_fit_is_refused(tmp_path):
    def refused(error, match, *, step_s=0.001, **changes):
        network = replace(shifting(tmp_path, np.zeros(4)), card=card_of(**changes))
        with pytest.raises(error, match=match):
            ResidualSimulator(Masses(step_s), network)

    refused(NameMismatch, r"it needs \[hip, a\], there are \[c, b, a\]", joints=("hip", "a"))
    refused(ConfigError, r"too few steps per second.*got 50 steps of 0.02 s; expected at least 100", step_s=0.02)
    inputs = card_of().inputs
    current = (replace(inputs[0], signal="current", unit="A"), *inputs[1:])
    refused(MissingSignal, "needs 'current', which no simulator has: available: position, velo", inputs=current)
    degrees = (replace(inputs[0], unit="deg"), *inputs[1:])
    refused(UnitError, "simulated.position.a: got deg; expected rad or m", inputs=degrees)


def test_it_says_what_comes_first(tmp_path, rng):
    simulator = ResidualSimulator(Masses(), shifting(tmp_path, np.zeros(4)))
    with pytest.raises(DataError, match="step before reset"):
        simulator.step({"torque": np.zeros((1, 3))})


def test_an_output_that_is_not_finite_is_refused(tmp_path, rng):
    simulator = ResidualSimulator(Masses(), shifting(tmp_path, [0, 0, 0, np.inf]))
    with pytest.raises(DataError, match=r"not finite: got simulated.torque.b at 0.000 s of motion 0"):
        simulator.rollout(request_of(rng))


@pytest.mark.parametrize("config", [LSTM, SatConfig(hidden=(8,), heads=2, history=5)], ids=["lstm", "sat"])
def test_a_network_for_any_joint_steps_all_joints_of_all_copies(tmp_path, rng, config):
    network = modular_network(tmp_path, config)
    simulator = ResidualSimulator(Masses(), network)
    request = request_of(rng, copies=3)
    rolled, steps = simulator.rollout(request), stepped(simulator, request)
    plain = Masses().rollout(request)
    for name in SIGNALS:
        rows = slice(None, -1) if name == "torque" else slice(1, None)
        np.testing.assert_allclose(getattr(rolled, name)[:, rows], steps[name], atol=1e-5)
        assert np.ptp(getattr(rolled, name) - getattr(plain, name), axis=(0, 1)).min() > 1e-3


def test_what_it_does_not_correct_is_still_said(tmp_path, rng):
    class Loaded(Masses):
        def rollout(self, request):
            plain = super().rollout(request)
            return replace(
                plain,
                further={"load": 2.0 * plain.torque},
                bodies={"body.position": np.ones((2, 61, 1, 3))},
                body_names=("hand",),
            )

    request = request_of(rng)
    said = ResidualSimulator(Loaded(), shifting(tmp_path, [1.0, 1.0, 3.0, 3.0])).rollout(request)
    np.testing.assert_array_equal(said.further["load"], 2.0 * Masses().rollout(request).torque)
    assert said.body_names == ("hand",)
    assert set(said.bodies) == {"body.position"}
