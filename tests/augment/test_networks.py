"""Every network: the same in torch, in ONNX over whole motions, and step by step; padding does not matter."""

import numpy as np
import onnxruntime
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trueup.augment.config import AugmentConfig, DataConfig, NetworkConfig
from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.scaling import Scaling
from trueup.errors import ConfigError

KINDS = [
    NetworkConfig("lstm", (12, 7)),
    NetworkConfig("lstm", (9,), output_activation="tanh"),
    NetworkConfig("lstm", (12, 7, 5), bidirectional=True),
    NetworkConfig("lstm", (8,), bidirectional=True),
    NetworkConfig("gru", (12, 7)),
    NetworkConfig("gru", (6, 5), bidirectional=True),
    NetworkConfig("linear", (), history=1),
    NetworkConfig("linear", (), history=9),
    NetworkConfig("mlp", (10, 8), history=6, output_activation="tanh"),
    NetworkConfig("transformer", (8, 8), history=5, heads=2),
    NetworkConfig("transformer", (8,), history=1, heads=4),
    NetworkConfig("moving-average", (), history=8),
    NetworkConfig("moving-average", (), history=7, bidirectional=True),
]
IDS = [f"{k.kind}-{'-'.join(map(str, k.hidden))}-{k.history}{'-both' if k.bidirectional else ''}" for k in KINDS]
CAUSAL = [kind for kind in KINDS if not kind.bidirectional]


def corrector_of(config, rng, *, inputs=6, base=(0, 1, 2, 4), target="residual", gate=None):
    base = np.array(base)
    torch.manual_seed(int(rng.integers(2**31)))
    scaling = Scaling(
        center=rng.normal(size=inputs),
        scale=rng.uniform(0.5, 2, inputs),
        out_center=rng.normal(size=base.size) * (target == "plain"),
        out_scale=rng.uniform(0.5, 2, base.size),
        loss_scale=rng.uniform(0.5, 2, base.size),
    )
    network = build_network(config, inputs=inputs, base=base.tolist())
    corrector = Corrector(network, scaling, base, target=target)
    corrector.set_gate(np.ones(base.size) if gate is None else np.asarray(gate, float))
    return corrector.eval()


def session_of(corrector):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(corrector.exported({}), options, providers=["CPUExecutionProvider"])


def whole(corrector, session, x):
    """All samples at once; returns the outputs."""
    states = {state.name: state.initial(x[0]) for state in corrector.states}
    return session.run(None, {"x": x, **states})[0]


def stepwise(corrector, session, x):
    """One sample after the other, as a control loop does."""
    states = {state.name: state.initial(x[0]) for state in corrector.states}
    out = []
    for row in x:
        y, *after = session.run(None, {"x": row[None], **states})
        states = {state.name: value for state, value in zip(corrector.states, after, strict=True)}
        out.append(y[0])
    return np.stack(out)


@pytest.mark.parametrize("config", KINDS, ids=IDS)
@pytest.mark.parametrize("target", ["residual", "plain"])
def test_onnx_equals_torch_at_any_length_and_width(config, target):
    rng = np.random.default_rng(3)
    corrector = corrector_of(config, rng, target=target, gate=[1, 0, 1, 1])
    session = session_of(corrector)
    for samples, batch in ((1, 1), (2, 3), (17, 1), (40, 2)):
        x = rng.normal(size=(samples, batch, 6)).astype(np.float32)
        with torch.no_grad():
            expected = corrector(torch.from_numpy(x)).numpy()
        np.testing.assert_allclose(whole(corrector, session, x), expected, atol=1e-5)


@pytest.mark.parametrize("config", CAUSAL, ids=[IDS[KINDS.index(kind)] for kind in CAUSAL])
def test_steps_equal_the_whole(config):
    rng = np.random.default_rng(4)
    corrector = corrector_of(config, rng)
    session = session_of(corrector)
    x = rng.normal(size=(33, 2, 6)).astype(np.float32)
    np.testing.assert_allclose(stepwise(corrector, session, x), whole(corrector, session, x), atol=1e-5)


@pytest.mark.long
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    kind=st.sampled_from(["lstm", "gru"]),
    hidden=st.lists(st.integers(1, 40), min_size=1, max_size=3),
    samples=st.integers(1, 60),
    seed=st.integers(0, 2**31 - 1),
)
def test_random_recurrent_networks_stream_as_they_predict(kind, hidden, samples, seed):
    rng = np.random.default_rng(seed)
    corrector = corrector_of(NetworkConfig(kind, tuple(hidden)), rng)
    session = session_of(corrector)
    x = rng.normal(size=(samples, 1, 6)).astype(np.float32)
    with torch.no_grad():
        expected = corrector(torch.from_numpy(x)).numpy()
    np.testing.assert_allclose(whole(corrector, session, x), expected, atol=1e-5)
    np.testing.assert_allclose(stepwise(corrector, session, x), expected, atol=1e-5)


@pytest.mark.parametrize("config", KINDS, ids=IDS)
def test_padding_behind_a_motion_changes_nothing_of_it(config):
    rng = np.random.default_rng(5)
    corrector = corrector_of(config, rng)
    lengths = np.array([30, 11, 2])
    x = rng.normal(size=(30, 3, 6)).astype(np.float32)
    with torch.no_grad():
        together = corrector(torch.from_numpy(x), torch.from_numpy(lengths)).numpy()
        for place, rows in enumerate(lengths):
            alone = corrector(torch.from_numpy(x[:rows, place : place + 1])).numpy()[:, 0]
            np.testing.assert_allclose(together[:rows, place], alone, atol=1e-5)


@pytest.mark.parametrize("config", CAUSAL, ids=[IDS[KINDS.index(kind)] for kind in CAUSAL])
def test_a_causal_network_does_not_see_the_future(config):
    rng = np.random.default_rng(6)
    corrector = corrector_of(config, rng)
    x = rng.normal(size=(20, 1, 6)).astype(np.float32)
    other = x.copy()
    other[12:] += 5
    with torch.no_grad():
        first, second = (corrector(torch.from_numpy(item)).numpy() for item in (x, other))
    np.testing.assert_array_equal(first[:12], second[:12])
    assert np.abs(first[12:] - second[12:]).max() > 1e-3


@pytest.mark.parametrize("config", [kind for kind in KINDS if kind.bidirectional and kind.kind == "lstm"])
def test_a_precise_network_sees_both_ends(config):
    rng = np.random.default_rng(7)
    corrector = corrector_of(config, rng)
    x = rng.normal(size=(20, 1, 6)).astype(np.float32)
    for row in (0, 19):
        other = x.copy()
        other[row] += 5
        with torch.no_grad():
            change = np.abs(corrector(torch.from_numpy(other)).numpy() - corrector(torch.from_numpy(x)).numpy())
        assert change[10].max() > 1e-6


def test_a_precise_network_is_two_layers_run_from_both_ends():
    """Outputs of the first layer are concatenated, of the second summed (Realeasy, IV-C), cell by cell in numpy."""
    rng = np.random.default_rng(8)
    corrector = corrector_of(NetworkConfig("lstm", (5, 3), bidirectional=True), rng, inputs=4, base=(0, 1))
    network = corrector.network
    x = rng.normal(size=(9, 4))

    def layer(module, rows):
        weights = {name: value.detach().numpy().astype(float) for name, value in module.named_parameters()}
        size = weights["weight_hh_l0"].shape[1]
        h, c, out = np.zeros(size), np.zeros(size), []
        for row in rows:
            z = (
                weights["weight_ih_l0"] @ row
                + weights["bias_ih_l0"]
                + weights["weight_hh_l0"] @ h
                + weights["bias_hh_l0"]
            )
            i, f, g, o = z.reshape(4, size)
            c = c / (1 + np.exp(-f)) + np.tanh(g) / (1 + np.exp(-i))  # eq. 2 to 6
            h = np.tanh(c) / (1 + np.exp(-o))  # eq. 7
            out.append(h)
        return np.array(out)

    first = np.concatenate([layer(network.forwards[0], x), layer(network.backwards[0], x[::-1])[::-1]], axis=1)
    second = layer(network.forwards[1], first) + layer(network.backwards[1], first[::-1])[::-1]
    expected = second @ network.dense.weight.detach().numpy().T + network.dense.bias.detach().numpy()
    with torch.no_grad():
        found = network(torch.tensor(x[:, None], dtype=torch.float32)).numpy()[:, 0]
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("centered", [False, True])
def test_a_moving_average_is_one(centered):
    rng = np.random.default_rng(9)
    config = NetworkConfig("moving-average", (), history=6, bidirectional=centered)
    corrector = corrector_of(config, rng)
    scaling = Scaling(np.zeros(6), np.ones(6), np.zeros(4), np.ones(4), np.ones(4))
    corrector = Corrector(corrector.network, scaling, np.array([0, 1, 2, 4]), target="residual").eval()
    x = rng.normal(size=(25, 6)).astype(np.float32)
    before, after = (3, 3) if centered else (5, 0)  # six have no middle
    padded = np.concatenate([np.repeat(x[:1], before, axis=0), x, np.repeat(x[-1:], after, axis=0)])
    expected = np.stack([padded[row : row + before + after + 1].mean(axis=0) for row in range(25)])[:, [0, 1, 2, 4]]
    with torch.no_grad():
        found = corrector(torch.from_numpy(x[:, None])).numpy()[:, 0]
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_centered_mean_of_a_ramp_is_the_ramp():
    """No half sample early or late, whatever the number of samples."""
    for history in (4, 5):
        network = build_network(
            NetworkConfig("moving-average", (), history=history, bidirectional=True), inputs=1, base=[0]
        )
        x = torch.arange(30, dtype=torch.float32)[:, None, None]
        np.testing.assert_allclose(network(x, None)[5:-5].numpy(), 0, atol=1e-5)


@pytest.mark.parametrize(
    "options",
    [
        {"kind": "linear", "hidden": (10,)},
        {"kind": "moving-average", "hidden": (10,)},
        {"kind": "mlp", "recurrent_dropout": 0.1},
        {"kind": "moving-average", "hidden": (), "input_dropout": 0.1},
        {"kind": "moving-average", "hidden": (), "output_activation": "tanh"},
    ],
    ids=str,
)
def test_what_a_kind_of_network_cannot_use_is_refused(options):
    with pytest.raises(ConfigError, match=f"network: .*{options['kind']}"):
        NetworkConfig(**options)


def test_tanh_needs_a_bound_that_holds():
    network = NetworkConfig("lstm", (5,), output_activation="tanh")
    with pytest.raises(ConfigError, match=r"cut the peaks.*expected data: normalization: limits"):
        AugmentConfig(network=network)
    AugmentConfig(network=network, data=DataConfig(normalization="limits"))


@pytest.mark.parametrize("far", [0.0, 10.0, 1000.0])
def test_inputs_far_from_zero_are_exported_without_loss(far):
    """A joint that hardly moved in training: its mean is a thousand deviations away from zero."""
    rng = np.random.default_rng(12)
    corrector = corrector_of(NetworkConfig("lstm", (9, 4)), rng)
    corrector.center.copy_(far * corrector.scale)
    x = (far + rng.normal(size=(40, 2, 6))).astype(np.float32) * corrector.scale.numpy()
    expected = corrector(torch.from_numpy(x)).detach().numpy()
    scale = np.abs(expected - x[..., [0, 1, 2, 4]]).max(axis=(0, 1))
    np.testing.assert_allclose(whole(corrector, session_of(corrector), x) / scale, expected / scale, atol=2e-5)


def test_a_gate_of_zero_leaves_the_simulator_as_it_is():
    rng = np.random.default_rng(10)
    for target in ("residual", "plain"):
        corrector = corrector_of(NetworkConfig("lstm", (5,)), rng, target=target, gate=[0, 1, 0, 1])
        x = rng.normal(size=(12, 1, 6)).astype(np.float32)
        for y in (whole(corrector, session_of(corrector), x), corrector(torch.from_numpy(x)).detach().numpy()):
            np.testing.assert_allclose(y[..., [0, 2]], x[..., [0, 2]], atol=1e-6)
            assert np.abs(y[..., [1, 3]] - x[..., [1, 4]]).max() > 1e-3


def test_the_loss_is_the_mean_squared_residual_error():
    """Eq. 9 and 10 of Realeasy, in units of the loss, from the corrected signals themselves."""
    rng = np.random.default_rng(11)
    for target in ("residual", "plain"):
        corrector = corrector_of(NetworkConfig("lstm", (5,)), rng, target=target)
        x = torch.tensor(rng.normal(size=(12, 3, 6)), dtype=torch.float32)
        y = torch.tensor(rng.normal(size=(12, 3, 4)), dtype=torch.float32)
        expected = ((y - corrector(x)) / corrector.loss_scale) ** 2
        out, wanted = corrector.outputs(x, y, None)
        found = ((out - wanted) * corrector.out_scale / corrector.loss_scale) ** 2
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


def test_recurrent_dropout_leaves_prediction_alone_and_changes_training():
    rng = np.random.default_rng(12)
    config = NetworkConfig("lstm", (16,), recurrent_dropout=0.5)
    corrector = corrector_of(config, rng)
    x = torch.tensor(rng.normal(size=(12, 3, 6)), dtype=torch.float32)
    torch.testing.assert_close(corrector(x), corrector(x))
    corrector.train()
    first, second = corrector(x), corrector(x)
    assert not torch.allclose(first, second)
    first.sum().backward()
    assert all(item.grad.abs().sum() > 0 for item in corrector.network.forwards.parameters())


def test_long_motions_go_piece_by_piece_to_the_same_end(tmp_path):
    """Longer than what a network without a state works on at a time, in torch and in the runtime."""
    rng = np.random.default_rng(13)
    for config in (NetworkConfig("transformer", (8, 8), history=5, heads=2), NetworkConfig("mlp", (6,), history=9)):
        corrector = corrector_of(config, rng)
        x = rng.normal(size=(1100, 1, 6)).astype(np.float32)
        with torch.no_grad():
            pieces = corrector(torch.from_numpy(x)).numpy()
        np.testing.assert_allclose(whole(corrector, session_of(corrector), x), pieces, atol=1e-5)
