"""The operator network: bilinear in its two feature vectors, blind to what it shall not read, the sizes of the paper."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from trueup.augment.networks import build_network
from trueup.augment.networks.operator import Operator, OperatorConfig
from trueup.compensate.config import METHODS
from trueup.errors import ConfigError

SMALL = OperatorConfig(hidden=(8, 8), history=3, features=5, trunk=(7,), sensors=4, predictor=(6,))
J = 2


def network(config=SMALL, seed=0) -> Operator:
    torch.manual_seed(seed)
    made = build_network(config, inputs=3 * J + 1, base=range(2 * J, 3 * J), rate_hz=50.0)
    assert isinstance(made, Operator)
    return made


def samples(count, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(count, 3, 3 * J + 1)).astype(np.float32))


def test_the_output_is_exactly_bilinear_in_branch_and_trunk():
    own = network().double()
    rng = torch.Generator().manual_seed(1)
    a, b, c = (torch.randn(4, 3, J * 5, generator=rng, dtype=torch.float64) for _ in range(3))
    x, y = 1.7, -0.3
    with torch.no_grad():
        assert torch.allclose(own.fused(x * a + y * b, c), x * own.fused(a, c) + y * own.fused(b, c), rtol=1e-12)
        assert torch.allclose(own.fused(c, x * a + y * b), x * own.fused(c, a) + y * own.fused(c, b), rtol=1e-12)
        # Features of one joint are no business of another.
        b = a.clone()
        b[..., 5:] = 0.0
        assert torch.equal(own.fused(b, c)[..., 0], own.fused(a, c)[..., 0])
        assert not own.fused(b, c)[..., 1].any()


def test_the_whole_network_is_that_product():
    own, x = network(), samples(6)
    with torch.no_grad():
        by_parts = own.fused(own.branch_features(own.sensors(x)), own.trunk_features(x[own.past :]))
        assert torch.allclose(own.inner(x), by_parts)
        # Independent of the class: eq. 5 with numpy.
        branch = own.branch_features(own.sensors(x)).numpy().reshape(4, 3, J, 5)
        trunk = own.trunk_features(x[own.past :]).numpy().reshape(4, 3, J, 5)
        assert own.inner(x).numpy() == pytest.approx(np.einsum("tbjp,tbjp->tbj", branch, trunk) / 5**0.5, abs=1e-6)


@pytest.mark.parametrize("senses", ["predicted", "none"])
@pytest.mark.parametrize("current", [("position",), ("position", "velocity")])
def test_what_branch_and_trunk_read(senses, current):
    """The branch reads the past and the current state, the trunk the current command and the payload."""
    own, x = network(replace(SMALL, senses=senses, current=current)), samples(3)
    past, now = own.past, x[-1:]
    with torch.no_grad():
        before, query = own.inner(x), own.trunk_features(now)
        for channel in range(3 * J + 1):
            other = x.clone()
            other[-1, :, channel] += 1.0
            in_trunk = channel >= 2 * J
            in_branch = channel < J * len(current)
            assert torch.equal(own.trunk_features(other[-1:]), query) != in_trunk
            assert torch.equal(own._seen(other), own._seen(x)) != in_branch
            assert torch.equal(own.inner(other), before) != (in_trunk or in_branch)
            other = x.clone()
            other[0, :, channel] += 1.0
            assert torch.equal(own._seen(other), own._seen(x)) == (channel == 3 * J), "payload is no history"
    assert past == 2


def test_an_operator_without_condition_does_not_know_the_payload():
    own, x = network(replace(SMALL, conditioned=False)), samples(3)
    other = x.clone()
    other[..., -1] += 1.0
    with torch.no_grad():
        assert torch.equal(own.inner(other), own.inner(x))


def test_true_sensors_are_read_in_place_of_the_history():
    torch.manual_seed(0)
    own = build_network(
        replace(SMALL, senses="true", history=1), inputs=3 * J + 1 + 16, base=range(2 * J, 3 * J), rate_hz=50.0
    )
    x = torch.randn(1, 3, 3 * J + 17)
    for channel, matters in ((0, False), (2 * J, True), (3 * J, True), (3 * J + 1, True), (3 * J + 16, True)):
        other = x.clone()
        other[..., channel] += 1.0
        with torch.no_grad():
            assert torch.equal(own.run(other, (), None)[0], own.run(x, (), None)[0]) != matters


def test_the_sizes_of_the_paper():
    """GapONet, A.7: 130 numbers for the sensor predictor, 400 for the branch, 11 for the trunk, p = 160 per joint."""
    config = METHODS["operator-paper"].network
    own = build_network(config, inputs=31, base=range(20, 30), rate_hz=50.0)
    assert isinstance(own, Operator)
    assert int(own.reads_branch.sum()) == 130
    assert own.responses == 400
    assert int(own.reads_trunk.sum()) == 11
    assert own.branch[-1].out_features == own.trunk[-1].out_features == 10 * 160
    assert [layer.out_features for layer in own.branch[:-1]] == [256, 256, 256]


@pytest.mark.parametrize(
    "wrong", [{"features": 0}, {"trunk": ()}, {"sensors": -1}, {"current": ("torque",)}, {"predictor": (0,)}]
)
def test_sizes_that_make_no_operator_are_refused(wrong):
    with pytest.raises(ConfigError):
        replace(SMALL, **wrong)


def test_inputs_that_are_too_few_are_refused():
    with pytest.raises(ConfigError, match="reads position, velocity and command"):
        build_network(SMALL, inputs=5, base=range(2), rate_hz=50.0)
