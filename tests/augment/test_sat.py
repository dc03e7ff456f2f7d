"""The network of SAT: what it may see, and that its steps are its pass."""

from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
import torch

from trueup.augment.graph import Graph
from trueup.augment.networks.fusion import Attention, VariableSelection
from trueup.augment.networks.sat import Sat, SatConfig
from trueup.errors import ConfigError

T, B, INPUTS, K, HISTORY = 30, 3, 5, 2, 8
SMALL = SatConfig(hidden=(16,), heads=4, history=HISTORY)
ABLATIONS = {
    "sat": SMALL,
    "attention": replace(SMALL, backbone="none"),
    "attention + dense": replace(SMALL, backbone="dense"),
    "lstm": replace(SMALL, attention=False),
}
QUANTILES = replace(SMALL, says=(0.1, 0.5, 0.9))


def made(config, seed=0):
    torch.manual_seed(seed)
    network = Sat(config, INPUTS, range(K), 100.0).double().eval()
    with torch.no_grad():  # the last layer begins with zeros
        network.dense.weight.normal_()
        for name, values in network.named_parameters():
            if name.endswith("lag"):
                values.normal_()
    return network


def data(seed=1, samples=T):
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(samples, B, width, generator=generator, dtype=torch.float64) for width in (INPUTS, K)]


def test_what_is_not_trained_corrects_nothing():
    network = Sat(SMALL, INPUTS, range(K), 100.0).eval()
    assert not network(torch.randn(T, B, INPUTS)).any()


@pytest.mark.parametrize("config", ABLATIONS.values(), ids=ABLATIONS.keys())
def test_the_future_changes_nothing(config):
    network, (x, fed) = made(config), data()
    before = network.taught(x, fed)
    x2, fed2 = x.clone(), fed.clone()
    x2[20:] += 1.0
    fed2[19:] -= 2.0  # of sample 19: known only when 20 comes
    after = network.taught(x2, fed2)
    torch.testing.assert_close(after[:20], before[:20], rtol=0, atol=0)
    assert (after[20:] != before[20:]).any(dim=-1).all()


@pytest.mark.parametrize("config", ABLATIONS.values(), ids=ABLATIONS.keys())
def test_the_past_and_its_errors_change_something(config):
    network, (x, fed) = made(config), data()
    for changed in (0, 1):
        parts = [x.clone(), fed.clone()]
        parts[changed][11] += 1.0
        assert (network.taught(*parts)[12] != network.taught(x, fed)[12]).any()


def test_attention_forgets_after_its_history():
    network, (x, fed) = made(ABLATIONS["attention"]), data()
    other = x.clone()
    other[5] += 3.0
    change = (network.taught(other, fed) - network.taught(x, fed)).abs().amax(dim=(1, 2))
    assert (change[5 : 5 + HISTORY + 1] > 0).all()
    assert not change[5 + HISTORY + 1 :].any()


@pytest.mark.parametrize("feedback", ["own", "zero"])
@pytest.mark.parametrize("config", ABLATIONS.values(), ids=ABLATIONS.keys())
def test_steps_are_the_pass_that_is_fed_with_what_they_made(config, feedback):
    network, (x, _) = made(replace(config, feedback=feedback)), data()
    with torch.no_grad():
        out = network(x)
        fed = out if feedback == "own" else torch.zeros_like(out)
        torch.testing.assert_close(network.taught(x, fed), out, rtol=1e-10, atol=1e-12)
        first, states = network.run(x[:11], network.initial(x[0]), None)
        rest, _ = network.run(x[11:], states, None)
        torch.testing.assert_close(torch.cat([first, rest]), out, rtol=1e-10, atol=1e-12)


def test_pieces_of_long_motions_are_the_whole(monkeypatch):
    network, (x, fed) = made(SMALL), data()
    whole = network.taught(x, fed)
    monkeypatch.setattr("trueup.augment.networks.sat._PIECE", 7)
    torch.testing.assert_close(network.taught(x, fed), whole, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("config", ABLATIONS.values(), ids=ABLATIONS.keys())
def test_long_windows_have_the_gradients_of_short_ones(config, monkeypatch):
    """Attention in pieces, and what is computed again instead of kept, change nothing but memory."""
    (x, fed), found = data(), []
    for sizes in ({"_PIECE": 1000}, {"_PIECE": 7, "_WHOLE": 8, "_ROWS": 5 * B}):
        network = made(config)
        for name, size in sizes.items():
            monkeypatch.setattr(f"trueup.augment.networks.sat.{name}", size)
        ((network.taught(x, fed) - fed) ** 2).mean().backward()
        found.append({name: values.grad for name, values in network.named_parameters()})
    for name, gradient in found[0].items():
        torch.testing.assert_close(found[1][name], gradient, rtol=1e-9, atol=1e-12)
        assert gradient is None or gradient.any() or config.attention is False


def test_what_is_computed_again_is_not_kept(monkeypatch):
    """A window of twice the length keeps less for its gradients than one that is just not computed again."""
    network = made(replace(SMALL, hidden=(32,))).float()
    monkeypatch.setattr("trueup.augment.networks.sat._WHOLE", 100)
    monkeypatch.setattr("trueup.augment.networks.sat._ROWS", 50 * B)

    def kept(samples):
        sizes = []

        def count(values):
            sizes.append(values.numel())
            return values

        x, fed = (part.float() for part in data(samples=samples))
        with torch.autograd.graph.saved_tensors_hooks(count, lambda values: values):
            network.taught(x, fed)
        return sum(sizes)

    assert kept(200) < kept(100)


@pytest.mark.long
@pytest.mark.parametrize("config", ABLATIONS.values(), ids=ABLATIONS.keys())
def test_mixed_precision_says_and_learns_about_the_same(config):
    x, wanted = (part.float() for part in data())
    losses = []
    for mixed in (False, True):
        network = made(replace(config, dropout=0.0)).float().train()
        network.begin(2, 4)
        optimizer = torch.optim.AdamW(network.parameters(), 1e-2)
        torch.manual_seed(4)
        for _ in range(12):
            with torch.autocast("cpu", torch.bfloat16, enabled=mixed):
                out = network.learn(x, wanted, None)
            assert out.dtype == torch.float32
            loss = (out - wanted).abs().mean()
            losses.append(float(loss.detach()))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    full, rough = np.array(losses).reshape(2, -1)
    assert (rough != full).all()
    np.testing.assert_allclose(rough[0], full[0], rtol=0.02)
    np.testing.assert_allclose(rough[-1], full[-1], rtol=0.1)
    assert full[-1] < 0.8 * full[0]


def test_the_encoder_is_told_true_errors_first_then_its_own():
    """SAT, V: teacher forcing, less of it from epoch to epoch, and none after the share that is forced."""
    network, (x, wanted) = made(replace(SMALL, dropout=0.0, forced=0.5)).train(), data()
    with torch.no_grad():
        told = network.taught(x, wanted)
        for epoch, fed in ((1, wanted), (5, network.taught(x, told)), (8, network.taught(x, told))):
            network.begin(epoch, 8)
            torch.testing.assert_close(network.learn(x, wanted, None), network.taught(x, fed))
        network.begin(3, 8)  # halfway
        torch.manual_seed(3)
        found = network.learn(x, wanted, None)
        torch.manual_seed(3)
        own = torch.rand(T, B, 1) < 0.5
        assert own.any()
        assert not own.all()
        torch.testing.assert_close(found, network.taught(x, torch.where(own, told, wanted)))


def test_without_feedback_the_encoder_is_told_nothing():
    network, (x, wanted) = made(replace(SMALL, dropout=0.0, feedback="zero")).train(), data()
    network.begin(1, 4)
    nothing = network.taught(x, torch.zeros_like(wanted))
    torch.testing.assert_close(network.learn(x, wanted, None), nothing)


def test_of_quantiles_the_one_in_the_middle_is_added_and_told():
    network, (x, wanted) = made(replace(QUANTILES, dropout=0.0)).train(), data()
    network.begin(1, 4)
    said = network.learn(x, wanted, None)
    assert said.shape == (T, B, 3, K)
    torch.testing.assert_close(network.taught(x, wanted), said[:, :, 1])
    network.begin(4, 4)
    told = network.taught(x, network.taught(x, wanted))
    torch.testing.assert_close(network.learn(x, wanted, None)[:, :, 1], network.taught(x, told))


def test_attention_is_that_of_the_formula():
    """TFT, eq. 13 to 16, head by head and sample by sample."""
    torch.manual_seed(2)
    attention = Attention(12, 3, 4).double()
    attention.lag.data.normal_()
    now, past = torch.randn(5, 1, 12, dtype=torch.float64), torch.randn(8, 1, 12, dtype=torch.float64)
    found, weights = attention(now, attention.kept(past))
    for t in range(5):
        rows = [*past[t : t + 4, 0], now[t, 0]]
        value = torch.stack([attention.value(row) for row in rows])
        total = torch.zeros(5, dtype=torch.float64)
        for head in range(3):
            part = slice(4 * head, 4 * head + 4)
            query = attention.query(now[t, 0])[part]
            score = torch.stack([query @ attention.key(row)[part] for row in rows]) / 2 + attention.lag[head]
            total += torch.softmax(score, 0) / 3
        torch.testing.assert_close(weights[t, 0], total)
        torch.testing.assert_close(found[t, 0], attention.merge(total @ value))


@pytest.mark.parametrize("feedback", ["own", "zero"])
@pytest.mark.parametrize("config", [*ABLATIONS.values(), QUANTILES], ids=[*ABLATIONS.keys(), "quantiles"])
def test_the_graph_takes_the_same_steps(config, feedback):
    network, (x, _) = made(replace(config, feedback=feedback)).float(), data()
    graph = Graph()
    names = [graph.input("x", [1, "B", INPUTS])]
    for state in network.states:
        shape = ["B" if axis == state.batch_axis else size for axis, size in enumerate(state.shape)]
        names.append(graph.input(state.name, shape))
    out, after = network.draw(graph, names[0], names[1:])
    graph.output(out, "y", [1, "B", K])
    for state, value in zip(network.states, after, strict=True):
        shape = ["B" if axis == state.batch_axis else size for axis, size in enumerate(state.shape)]
        graph.output(value, f"{state.name}_out", shape)
    session = onnxruntime.InferenceSession(graph.serialized({}), providers=["CPUExecutionProvider"])
    with torch.no_grad():
        expected = network(x.float())
    states = {state.name: state.initial(x[0].numpy()) for state in network.states}
    for t in range(T):
        y, *new = session.run(None, {"x": x[t : t + 1].float().numpy(), **states})
        states = dict(zip(states, new, strict=True))
        np.testing.assert_allclose(y[0], expected[t], atol=2e-5)


def test_selection_is_that_of_the_formula():
    """TFT, eq. 6 to 8, number by number; shares add up to one."""
    torch.manual_seed(3)
    selection = VariableSelection(3, 6).double()
    x = torch.randn(4, 3, dtype=torch.float64)
    out, shares = selection(x)
    torch.testing.assert_close(shares.sum(dim=-1), torch.ones(4, dtype=torch.float64))
    expected = 0
    for v in range(3):
        said = torch.nn.functional.elu(x[:, v : v + 1] * selection.spread[v] + selection.offset[v])
        both = said @ selection.inner[v] + selection.inner_offset[v]
        expected = expected + shares[:, v : v + 1] * selection.norm(said + both[:, :6] * torch.sigmoid(both[:, 6:]))
    torch.testing.assert_close(out, expected)


def test_the_profile_adds_up_to_one():
    network, (x, fed) = made(SMALL), data()
    profile = network.profile(x, fed)
    assert profile.shape == (HISTORY + 1,)
    assert float(profile.detach().sum()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hidden": (64, 64)}, "one width"),
        ({"hidden": (30,)}, "multiple of 4 heads"),
        ({"attention": False, "backbone": "dense"}, "no memory"),
        ({"dropout": 1.0}, "dropout"),
        ({"input_dropout": 0.1}, "input_dropout of a sat"),
        ({"recurrent_dropout": 0.1}, "recurrent_dropout of a sat"),
        ({"bidirectional": True}, "one direction"),
        ({"output_activation": "tanh"}, "output_activation"),
    ],
)
def test_what_makes_no_network_is_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        Sat.check(replace(SMALL, **change))
