"""The machine code of an operator says what its graph and torch say, and refuses weights that are not the card's."""

import io
from dataclasses import replace

import numpy as np
import pytest

from deploy.compensation_cases import SMALL, asked, compensation
from trueup.core.model_card import STEP_NAME
from trueup.deploy import Network, Stream, StreamSettings
from trueup.deploy.cell import Cell, GraphCell, OperatorCell
from trueup.deploy.operator_weights import OperatorWeights
from trueup.deploy.step_file import StepFile
from trueup.errors import DataError

JOINTS = ("a", "b", "c")


def motion(samples, seed=0):
    rng = np.random.default_rng(seed)
    position = np.cumsum(0.05 * rng.normal(size=(samples, 3)), axis=0)
    return position, rng.normal(size=(samples, 3)), position + 0.1 * rng.normal(size=(samples, 3))


@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize(
    "network",
    [
        SMALL,
        replace(SMALL, history=1),
        replace(SMALL, senses="none", current=("position",)),
        replace(SMALL, hidden=(33, 16, 70), trunk=(5,), predictor=(20, 9), conditioned=False),
    ],
    ids=["small", "no-history", "no-sensors", "odd"],
)
def test_machine_code_graph_and_torch_agree(tmp_path, network, relative):
    made = compensation(tmp_path, JOINTS, network=network, relative=relative)
    position, velocity, target = motion(30)
    wanted = asked(made, np.concatenate([position, velocity], axis=1), target, 2.0)
    assert np.abs(wanted - target).max() > 0.01
    for compiled, kind in ((True, OperatorCell), (False, GraphCell)):
        settings = StreamSettings(compiled=compiled, margin=10.0)
        stream = Stream.load(tmp_path, rate_hz=50.0, joints=JOINTS, settings=settings)
        assert type(stream._cell) is kind
        for again in range(2):  # what comes after a reset is as after a start
            stream.reset()
            stream.under(payload=2.0)
            rows = zip(position, velocity, target, strict=True)
            out = [stream.step({"position": p, "velocity": v}, {"position": u}).values.copy() for p, v, u in rows]
            np.testing.assert_allclose(out, wanted, atol=2e-6, err_msg=f"{kind} {again}")


def test_a_number_that_is_none_is_seen(tmp_path):
    compensation(tmp_path, JOINTS)
    cell = Cell.of(Network.load(tmp_path), compiled=True)
    cell.rehearse(np.zeros(10, np.float32))
    cell.x[3] = np.nan
    assert not cell.run()
    cell.x[:] = 0.0
    assert not cell.run()  # it is in the history
    cell.start()
    assert cell.run()


@pytest.mark.parametrize(
    "wrong",
    [
        {"branch": (50, 6, 8, 8)},
        {"branch": (50,)},
        {"trunk": (11, 6, 6, 9)},
        {"trunk": (10, 6, -6, 9)},
        {"flat": np.zeros(7, np.float32)},
        {"flat": np.full(3, np.nan, np.float32)},
    ],
)
def test_weights_of_another_network_are_refused(tmp_path, wrong):
    made = compensation(tmp_path, JOINTS)
    weights = OperatorWeights.of_file(StepFile.load(tmp_path, made.card), made.card)
    (tmp_path / STEP_NAME).write_bytes(replace(weights, **wrong).to_bytes())
    made.card.save(tmp_path)
    with pytest.raises(DataError, match=STEP_NAME):
        Network.load(tmp_path)


def test_what_is_no_archive_is_refused(tmp_path):
    made = compensation(tmp_path, JOINTS)
    (tmp_path / STEP_NAME).write_bytes(b"nothing")
    with pytest.raises(DataError, match="is not the file"):
        Network.load(tmp_path)
    made.card.save(tmp_path)
    with pytest.raises(DataError, match="no weights of a step"):
        Network.load(tmp_path)
    content = io.BytesIO()
    np.savez(content, branch=np.array([1]))
    (tmp_path / STEP_NAME).write_bytes(content.getvalue())
    made.card.save(tmp_path)
    with pytest.raises(DataError, match="no weights of a step"):
        Network.load(tmp_path)
