"""The graph of an operator says what torch says: any weights, lengths and widths, with inputs relative or not."""

import numpy as np
import onnxruntime
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.networks.operator import OperatorConfig
from trueup.augment.scaling import Scaling

SMALL = {"hidden": (9, 8), "features": 3, "trunk": (7, 5), "sensors": 2, "predictor": (6,)}


def corrector_of(config, joints, *, seed=0, relative=True, far=1.0, conditions=1):
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    true = config.sensors * 2 * joints if config.senses == "true" else 0
    inputs, base = 3 * joints + conditions + true, np.arange(2 * joints, 3 * joints)
    scaling = Scaling(
        center=far * rng.normal(size=inputs),
        scale=rng.uniform(0.5, 2.0, inputs),
        out_center=np.zeros(joints),
        out_scale=rng.uniform(0.5, 2.0, joints),
        loss_scale=np.ones(joints),
    )
    other = np.full(inputs, -1)
    if relative:
        other[base] = np.arange(joints)
    network = build_network(config, inputs=inputs, base=base.tolist(), rate_hz=50.0)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.4)
    corrector = Corrector(network, scaling, base, target="residual", relative=other)
    corrector.set_gate(rng.uniform(0.5, 1.0, joints))
    return corrector.eval()


def session_of(corrector):
    return onnxruntime.InferenceSession(corrector.exported({}), providers=["CPUExecutionProvider"])


def run(corrector, session, x):
    """One sample after the other where there is a history, all at once where there is none."""
    states = {state.name: state.initial(x[0]) for state in corrector.states}
    if not states:
        return session.run(None, {"x": x})[0]
    out = []
    for row in x:
        y, *after = session.run(None, {"x": row[None], **states})
        states = {state.name: value for state, value in zip(corrector.states, after, strict=True)}
        out.append(y[0])
    return np.stack(out)


@pytest.mark.long
@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**20),
    samples=st.integers(1, 7),
    batch=st.integers(1, 4),
    joints=st.integers(1, 3),
    history=st.integers(1, 5),
    senses=st.sampled_from(["predicted", "true", "none"]),
    current=st.sampled_from([("position",), ("position", "velocity")]),
    conditioned=st.booleans(),
    relative=st.booleans(),
    far=st.sampled_from([0.0, 1.0, 300.0, 3000.0]),
)
def test_the_graph_is_the_network(seed, samples, batch, joints, history, senses, current, conditioned, relative, far):
    config = OperatorConfig(**SMALL, history=history, senses=senses, current=current, conditioned=conditioned)
    corrector = corrector_of(config, joints, seed=seed, relative=relative, far=far)
    rng = np.random.default_rng(seed)
    x = (corrector.center.numpy() + rng.normal(size=(samples, batch, len(corrector.center)))).astype(np.float32)
    with torch.no_grad():
        wanted = corrector(torch.from_numpy(x)).numpy()
    # Corrections are of size one here; inputs that are far away cost digits of float32.
    np.testing.assert_allclose(run(corrector, session_of(corrector), x), wanted, rtol=1e-4, atol=1e-4 * (1 + far))


def test_differences_of_inputs_go_into_the_weights_where_digits_allow():
    near, far = (corrector_of(OperatorConfig(**SMALL), 2, far=size) for size in (1.0, 3000.0))
    nodes = [len(session.exported({})) for session in (near, far)]
    assert nodes[0] < nodes[1]


@pytest.mark.parametrize("batch", [1, 4096])
def test_one_sample_of_the_default_operator_costs_few_nodes(batch):
    corrector = corrector_of(OperatorConfig(), 10)
    session = session_of(corrector)
    x = np.zeros((1, batch, 31), np.float32)
    states = {state.name: state.initial(x[0]) for state in corrector.states}
    y, past = session.run(None, {"x": x, **states})
    assert y.shape == (1, batch, 10)
    assert past.shape == (4, batch, 31)
