"""Machine code takes the steps of the graph."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from benchmarks.networks import Made, by_signal, card_of, motion, written

from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.networks.sat import SatConfig
from trueup.augment.scaling import Scaling, Stops
from trueup.core.model_card import ANY_JOINT, STEP_NAME, Input, Output, counterparts
from trueup.deploy import Network, Stream, StreamSettings
from trueup.deploy.cell import GraphCell, MachineCell
from trueup.deploy.sat_weights import SatWeights, padded
from trueup.errors import DataError

SMALL = SatConfig(hidden=(24,), heads=2, history=9)
RATE_HZ = 250.0
GRAPH = StreamSettings(compiled=False)


def modular(folder, config=SMALL, *, seed=0, target="residual", gate=1.0, unread=()):
    """A network for any joint, with a command that is read as a distance; all of its numbers are drawn."""
    simulated = [Input(name, ANY_JOINT, "u", low=-2.0, high=2.0) for name in ("position", "velocity", "torque")]
    inputs = (*simulated, Input("position", ANY_JOINT, "u", "command", low=-2.0, high=2.0))
    outputs = tuple(Output(name, ANY_JOINT, "u", base=base) for name, base in (("velocity", 1), ("position", 0)))
    card = card_of(
        joints=(ANY_JOINT,),
        inputs=inputs,
        outputs=outputs,
        modular=True,
        rate_hz=RATE_HZ,
        method="sat",
        warmup_steps=0,
    )
    return kept(folder, card, drawn(card, config, seed, target, gate, unread=unread))


def drawn(card, config, seed=0, target="residual", gate=1.0, stops=None, unread=()):
    """A corrector with weights that are all far from where training begins."""
    rng, width, outputs = np.random.default_rng(seed), len(card.inputs), len(card.outputs)
    scaling = Scaling(
        rng.normal(size=width),
        rng.uniform(0.5, 2, width),
        rng.normal(size=outputs) * (target == "plain"),  # what is added has no origin
        rng.uniform(0.1, 1, outputs),
        np.ones(outputs),
    )
    scaling.center[list(unread)], scaling.scale[list(unread)] = 0.0, np.inf
    stops = stops or Stops.none()
    torch.manual_seed(seed)
    reads = width + stops.edge.size
    network = build_network(config, inputs=reads, base=card.base.tolist(), rate_hz=card.rate_hz)
    with torch.no_grad():
        for values in network.parameters():
            values.add_(0.1 * torch.randn_like(values))
    made = Corrector(network.eval(), scaling, card.base, target=target, relative=counterparts(card.inputs), stops=stops)
    made.set_gate(np.full(outputs, gate))
    return made


def kept(folder, card, corrector):
    card = replace(card, states=corrector.states)
    folder.mkdir(parents=True, exist_ok=True)
    step = corrector.step_weights()
    if step is not None:
        (folder / STEP_NAME).write_bytes(step.to_bytes())
    return replace(written(folder, card, corrector.exported({})), corrector=corrector)


def compared(made: Made, joints, *, steps=60):
    """The answers of both ways to the same samples, and how far they correct."""
    network = Network.load(made.folder)
    streams = [Stream(network, rate_hz=made.card.rate_hz, joints=joints, settings=own) for own in (None, GRAPH)]
    assert [type(stream._cell) for stream in streams] == [MachineCell, GraphCell]
    x = motion(streams[0].card, steps)[:, 0]
    answers = [np.array([stream.step_vector(row).values.copy() for row in x]) for stream in streams]
    return *answers, answers[1] - x[:, streams[0].card.base]


@pytest.mark.parametrize("joints", [1, 2, 5, 6, 7, 12])
def test_its_steps_are_those_of_the_graph(tmp_path, joints):
    """For any number of joints side by side, beyond the length of its memory."""
    machine, graph, correction = compared(modular(tmp_path), [f"joint{number}" for number in range(joints)])
    np.testing.assert_allclose(machine, graph, atol=2e-6)
    assert np.ptp(correction, axis=0).min() > 1e-2


@pytest.mark.parametrize(
    "config",
    [
        replace(SMALL, feedback="zero"),
        replace(SMALL, says=(0.1, 0.5, 0.9)),
        replace(SMALL, hidden=(64,), heads=4, history=32),
        replace(SMALL, hidden=(10,), heads=5, history=1),
    ],
    ids=["zero", "quantiles", "wide", "shortest"],
)
def test_with_all_options(tmp_path, config):
    machine, graph, _ = compared(modular(tmp_path, config), ("a", "b"))
    np.testing.assert_allclose(machine, graph, atol=2e-6)


@pytest.mark.long
@pytest.mark.parametrize(("target", "gate"), [("plain", 1.0), ("plain", 0.3), ("residual", 0.0)])
def test_with_all_that_is_around_the_network(tmp_path, target, gate):
    machine, graph, correction = compared(modular(tmp_path, target=target, gate=gate), ("a", "b", "c"))
    np.testing.assert_allclose(machine, graph, atol=5e-6)
    assert bool(np.abs(correction).max() > 1e-2) == bool(gate)


def test_a_network_of_a_whole_robot_that_feels_its_limits(tmp_path):
    card = card_of(rate_hz=RATE_HZ, method="sat", warmup_steps=0)
    stops = Stops.of(card.inputs, {("position", joint): (-1.5, 1.2) for joint in card.joints[:3]})
    made = kept(tmp_path, card, drawn(card, SMALL, stops=stops))
    machine, graph, _ = compared(made, card.joints)
    np.testing.assert_allclose(machine, graph, atol=5e-5)  # torques are fifty times as large


def test_a_position_that_is_corrected_without_being_read(tmp_path):
    machine, graph, correction = compared(modular(tmp_path, unread=(0,)), ("one", "two"))
    np.testing.assert_allclose(machine, graph, atol=2e-6)
    assert np.ptp(correction, axis=0).min() > 1e-2


def test_a_start_forgets(tmp_path):
    made = modular(tmp_path)
    stream = Stream.load(made.folder, rate_hz=RATE_HZ, joints=("a", "b"))
    x = motion(stream.card, 40)[:, 0]
    answers = []
    for _ in range(2):
        answers.append(np.array([stream.step_vector(row).values.copy() for row in x]))
        stream.reset()
    np.testing.assert_array_equal(*answers)


def test_signals_by_name(tmp_path):
    made = modular(tmp_path)
    by_name, by_vector = (Stream.load(made.folder, rate_hz=RATE_HZ, joints=("a", "b")) for _ in range(2))
    for row in motion(by_name.card, 5)[:, 0]:
        given = (by_signal(by_name.card, row), by_signal(by_name.card, row, "command"))
        np.testing.assert_array_equal(by_name.step(*given).values, by_vector.step_vector(row).values)


def test_ablations_have_the_graph_only(tmp_path):
    made = modular(tmp_path, replace(SMALL, backbone="dense"))
    assert Network.load(made.folder).step is None
    assert isinstance(Stream.load(made.folder, rate_hz=RATE_HZ, joints=("a",))._cell, GraphCell)


def test_the_file_is_the_same_for_the_same_weights(tmp_path):
    first, second = (modular(tmp_path / name) for name in "ab")
    assert (first.folder / STEP_NAME).read_bytes() == (second.folder / STEP_NAME).read_bytes()


def spoiled(made, change):
    """The folder with other weights, for which its card vouches."""
    own = made.corrector.step_weights()
    flat = own.flat.copy()
    sizes = change(own, flat) or own.sizes
    (made.folder / STEP_NAME).write_bytes(SatWeights(sizes, flat).to_bytes())
    made.card.save(made.folder)


def _index(own, flat):
    flat[2 * own.sizes.inputs] = 99  # the first row after center and scale: what is subtracted


def _nan(_, flat):
    flat[1000] = np.nan


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_index, "not there"),
        (_nan, "other weights"),
        (lambda own, _: replace(own.sizes, width=48), "other weights"),
        (lambda own, _: replace(own.sizes, inputs=5), "other weights|another network"),
        (lambda own, _: replace(own.sizes, heads=0), "no weights"),
        (lambda own, _: replace(own.sizes, history=-3), "other weights|another network"),
    ],
)
def test_weights_of_no_such_network_are_refused(tmp_path, change, message):
    made = modular(tmp_path)
    spoiled(made, change)
    with pytest.raises(DataError, match=message):
        Network.load(made.folder)


def test_a_damaged_file_is_refused(tmp_path):
    made = modular(tmp_path)
    path = made.folder / STEP_NAME
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(DataError, match="not the file"):
        Network.load(made.folder)
    made.card.save(made.folder)
    with pytest.raises(DataError, match="no weights"):
        Network.load(made.folder)
    path.unlink()
    with pytest.raises(DataError):
        Network.load(made.folder)


def test_padding_fills_up():
    assert [padded(count) for count in (1, 16, 17, 128)] == [16, 16, 32, 128]


def test_it_is_loaded_where_nothing_can_be_kept(tmp_path):
    # As on a robot's read-only image: numba finds no place for its cache and says so when a function is made.
    code = (
        "from numba.core.caching import CacheImpl\n"
        "CacheImpl._locator_classes = []\n"
        "from trueup.deploy import sat_machine\n"
        "print(callable(sat_machine.advance))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.strip() == "True", done.stderr
