"""What training minimizes, against the formulas."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from trueup.augment.components import components
from trueup.augment.config import AugmentConfig, LossConfig, NetworkConfig
from trueup.augment.corrector import Corrector
from trueup.augment.loss import Loss
from trueup.augment.networks.base import Network
from trueup.augment.scaling import Scaling
from trueup.augment.windows import Batch
from trueup.core.model_card import Channel
from trueup.errors import ConfigError

RATE_HZ = 50.0
OUTPUTS = tuple(
    Channel(signal, joint, unit)
    for signal, unit in (("position", "rad"), ("velocity", "rad/s"))
    for joint in ("a", "b")
)

BODY_OUTPUTS = tuple(
    (component, unit)
    for name, unit in (("body.position", "m"), ("body.rotation", "1"))
    for component in components(name)
)


class Said(Network):
    """Says what it was told to."""

    def __init__(self, out):
        super().__init__(NetworkConfig(), 4, range(4), RATE_HZ)
        self.out = out

    states = ()

    def run(self, *_):
        return self.out, ()

    def learn(self, *_):
        return self.out

    def draw(self, graph, x, states):
        raise NotImplementedError


def corrector(out, seed=0):
    rng = np.random.default_rng(seed)
    one, positive = np.ones(4), lambda: rng.uniform(0.5, 2.0, 4)
    scaling = Scaling(0 * one, one, 0 * one, positive(), positive())
    return Corrector(Said(torch.tensor(out, dtype=torch.float32)), scaling, np.arange(4), target="residual").eval()


def batch(seed=1, samples=9, lengths=(9, 6, 9)):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, samples, len(lengths), 4)).astype(np.float32)
    return Batch(x, y, np.array(lengths))


def errors(model, data):
    """Of the corrected signals, in units of the loss, valid samples only, (N, 4)."""
    corrected = data.x + model.out_scale.numpy() * model.network.out.numpy()
    error = (corrected - data.y) / model.loss_scale.numpy()
    return np.concatenate([error[:length, place] for place, length in enumerate(data.lengths)])


@pytest.mark.parametrize(("kind", "of"), [("squares", np.square), ("absolute", np.abs)])
def test_it_is_the_weighted_mean_over_valid_samples(kind, of):
    data, out = batch(), np.random.default_rng(2).normal(size=(9, 3, 4))
    model = corrector(out)
    found = Loss(LossConfig(kind=kind, weights={"velocity": 3.0}), OUTPUTS, RATE_HZ).of(model, data)
    expected = (of(errors(model, data)) @ [1, 1, 3, 3]).mean() / 8
    assert float(found) == pytest.approx(expected, rel=1e-5)


def test_quantiles_are_counted_by_the_side_on_which_they_are_off():
    shares = (0.1, 0.5, 0.9)
    data, out = batch(lengths=(9, 9, 9)), np.random.default_rng(3).normal(size=(9, 3, 3, 4))
    model = corrector(out).train()
    found = Loss(LossConfig(kind="quantile"), OUTPUTS, RATE_HZ, shares).of(model, data)
    total = 0.0
    for number, share in enumerate(shares):
        said = data.x + model.out_scale.numpy() * out[:, :, number]
        short = (data.y - said) / model.loss_scale.numpy()
        total += np.where(short > 0, share * short, (share - 1) * short).mean()
    assert float(found.detach()) == pytest.approx(total, rel=1e-5)


def _with_consistency(out, data):
    model = corrector(out)
    plain, both = (
        float(Loss(LossConfig(consistency=weight), OUTPUTS, RATE_HZ).of(model, data)) for weight in (0.0, 2.0)
    )
    return (both - plain) / 2


@given(st.integers(0, 2**31), st.floats(-3, 3))
def test_position_that_is_the_integral_of_velocity_costs_nothing(seed, start):
    """SAT, eq. 3: its second term is zero for consistent pairs, whatever they are."""
    rng = np.random.default_rng(seed)
    data, out = batch(lengths=(9, 9, 9)), np.zeros((9, 3, 4))
    model = corrector(out)
    velocity = rng.normal(size=(9, 3, 2))
    steps = 0.5 * (velocity[1:] + velocity[:-1]) / RATE_HZ
    position = start + np.concatenate([np.zeros((1, 3, 2)), np.cumsum(steps, axis=0)])
    out = np.concatenate([position, velocity], axis=-1) / model.out_scale.numpy()
    assert _with_consistency(out, data) == pytest.approx(0.0, abs=2e-4)


def test_other_pairs_cost_how_far_they_are_from_one_another():
    data, out = batch(), np.random.default_rng(4).normal(size=(9, 3, 4))
    model = corrector(out)
    added = out * model.out_scale.numpy()
    slope = np.diff(added[..., :2], axis=0) * RATE_HZ
    off = np.abs(slope - 0.5 * (added[1:, :, 2:] + added[:-1, :, 2:])) / model.loss_scale.numpy()[2:]
    expected = np.concatenate([off[: length - 1, place] for place, length in enumerate(data.lengths)]).mean()
    assert _with_consistency(out, data) == pytest.approx(expected, rel=1e-3)


def test_of_quantiles_the_median_must_be_consistent():
    """In training a network says quantiles, (T, B, Q, K): what is added is the one in the middle."""
    shares = (0.1, 0.5, 0.9)
    data, out = batch(lengths=(9, 9, 9)), np.random.default_rng(5).normal(size=(9, 3, 3, 4))
    plain, both = (
        float(
            Loss(LossConfig(kind="quantile", consistency=weight), OUTPUTS, RATE_HZ, shares)
            .of(corrector(out).train(), data)
            .detach()
        )
        for weight in (0.0, 1.0)
    )
    assert both - plain == pytest.approx(_with_consistency(out[:, :, 1], data), rel=1e-3)


def test_the_components_of_a_body_share_the_weight_of_one_number():
    """A position is three numbers and a rotation six, and each counts as much as the other."""
    channels = [Channel(name, "", unit) for name, unit in BODY_OUTPUTS]
    out, data = np.random.default_rng(6).normal(size=(5, 2, 9)), np.zeros((5, 2, 9), np.float32)
    one = np.ones(9)
    said = torch.tensor(out, dtype=torch.float32)
    model = Corrector(Said(said), Scaling(0 * one, one, 0 * one, one, one), np.arange(9), target="residual").eval()
    found = Loss(LossConfig(kind="absolute"), channels, RATE_HZ).of(model, Batch(data, data, np.array([5, 5])))
    expected = 0.5 * np.abs(out[..., :3]).mean() + 0.5 * np.abs(out[..., 3:]).mean()
    assert float(found) == pytest.approx(expected, rel=1e-5)


def test_what_cannot_be_minimized_is_refused():
    with pytest.raises(ConfigError, match="between position and velocity"):
        Loss(LossConfig(consistency=1.0), OUTPUTS[:2], RATE_HZ)
    with pytest.raises(ConfigError, match="nothing to learn"):
        Loss(LossConfig(weights={"position": 0.0, "velocity": 0.0}), OUTPUTS, RATE_HZ)
    with pytest.raises(ConfigError, match="torque, which is not corrected"):
        Loss(LossConfig(weights={"torque": 1.0}), OUTPUTS, RATE_HZ)
    with pytest.raises(ConfigError, match="loss: consistency"):
        LossConfig(consistency=-1.0)
    with pytest.raises(ConfigError, match="residual"):
        LossConfig(consistency=1.0, target="plain")
    with pytest.raises(ConfigError, match="says quantiles"):
        replace(AugmentConfig(), loss=LossConfig(kind="quantile"))
