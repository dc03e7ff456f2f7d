"""State augmentation transformer: the encoder sees what was, with the errors, the decoder what is (SAT, V).

At sample t the decoder reads x_t alone. What it makes of it looks, by attention, at what the encoder has made of the
last `history` samples and of the error after each of them; from that comes what is added to the simulator. The encoder
reads a sample one step later, when its error is known: as the network has predicted it, or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from trueup.augment import components
from trueup.augment.config import (
    AugmentConfig,
    DataConfig,
    LossConfig,
    Method,
    NetworkConfig,
    OptimizerConfig,
    WindowConfig,
)
from trueup.augment.graph import Graph
from trueup.augment.networks.base import Network, States, StepWeights
from trueup.augment.networks.fusion import (
    Attention,
    Gated,
    GatedResidual,
    VariableSelection,
    draw_gemm,
    linear,
    stacked,
    widened,
)
from trueup.augment.networks.lstm_step import draw_step, gates, step_weights_of, stepped
from trueup.core.model_card import State
from trueup.errors import ConfigError

# Samples of the present whose history is looked at together. All pairs of them and of what they may see are scored, so
# that fewer at once waste less: half of the scores with 64 samples and a history of 128.
_PIECE = 64
# Of windows with more samples, what lies between the layers is not kept for the gradients but computed again, piece by
# piece: it is twenty times as much as the layers themselves say.
_WHOLE = 1024
# Samples of all motions together whose variables are selected at a time: what lies between is then still in a cache.
_ROWS = 2048


@dataclass(frozen=True)
class SatConfig(NetworkConfig):
    """The options of a SAT; `hidden` is one width, `history` the samples that attention sees.

    Attributes:
        backbone: of encoder and decoder: `lstm`, two `dense` layers, or `none` (SAT, VI-D).
        attention: whether there is any; without, what is left is the LSTM of Table I.
        feedback: what the encoder is told of past errors: `own` predictions, or nothing.
        forced: share of the training in which true errors are taken away: the encoder is told all of them in the first
            epoch, fewer from epoch to epoch, and only what the network has predicted itself after this share.
        says: quantiles, for the loss of that name, with the median in their middle; none for one number.
        dropout: share of the units that are left out before each gate in training.
    """

    kind: str = "sat"
    hidden: tuple[int, ...] = (64,)
    history: int = 128
    backbone: Literal["lstm", "dense", "none"] = "lstm"
    attention: bool = True
    feedback: Literal["own", "zero"] = "own"
    forced: float = 0.5
    says: tuple[float, ...] = ()
    dropout: float = 0.1

    @property
    def quantiles(self) -> tuple[float, ...]:
        """See `NetworkConfig.quantiles`."""
        return self.says


class Sat(Network):
    """See the module. `taught` is the pass of training, over all samples at once; `run` the steps of a stream."""

    Config = SatConfig
    stepwise = True

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        assert isinstance(config, SatConfig)
        width = config.hidden[0]
        self.width, self.history = width, config.samples(rate_hz)
        self.feedback = config.feedback
        self.one_by_one = config.feedback == "own"
        self.recurrent = config.backbone == "lstm"
        self.select_past = VariableSelection(inputs + self.outputs, width, config.dropout)
        self.select_now = VariableSelection(inputs, width, config.dropout)
        if self.recurrent:
            self.encoder, self.decoder = nn.LSTM(width, width), nn.LSTM(width, width)
            self.after_encoder = Gated(width, width, config.dropout)
            self.after_decoder = Gated(width, width, config.dropout)
        self.dense_past = _dense(width) if config.backbone == "dense" else None
        self.dense_now = _dense(width) if config.backbone == "dense" else None
        self.attention = Attention(width, config.heads, self.history) if config.attention else None
        if config.attention:
            self.after_attention = Gated(width, width, config.dropout)
            self.process = GatedResidual(width, width, dropout=config.dropout)
            self.last = Gated(width, width, config.dropout)
        self.quantiles = max(1, len(config.quantiles))
        self.forced, self.own_share = config.forced, 0.0
        self.dense = nn.Linear(width, self.quantiles * self.outputs)
        nn.init.zeros_(self.dense.weight)  # what is not trained corrects nothing
        nn.init.zeros_(self.dense.bias)

    @classmethod
    def check(cls, config: NetworkConfig) -> None:
        """See `Network.check`."""
        for name in ("input_dropout", "recurrent_dropout"):
            if getattr(config, name):
                raise ConfigError(f"network: {name} of a sat", got=getattr(config, name), expected="dropout instead")
        super().check(config)
        if not isinstance(config, SatConfig):
            raise ConfigError("network: sat", got=type(config).__name__, expected="its own options")
        if config.heads < 1:
            raise ConfigError("network: heads of a sat", got=config.heads, expected="at least 1")
        if len(config.hidden) != 1 or config.hidden[0] % config.heads:
            raise ConfigError(
                "network: hidden of a sat", got=config.hidden, expected=f"one width, a multiple of {config.heads} heads"
            )
        if not config.attention and config.backbone != "lstm":
            raise ConfigError("network: a sat without attention has no memory", got=config.backbone, expected="lstm")
        if not 0 <= config.dropout < 1:
            raise ConfigError("network: dropout", got=config.dropout, expected="a share below 1")
        if config.says and (
            len(config.says) % 2 == 0
            or config.says[len(config.says) // 2] != 0.5
            or not all(0 < low < high < 1 for low, high in pairwise(config.says))
        ):
            raise ConfigError(
                "network: says", got=config.says, expected="increasing quantiles around 0.5, e.g. 0.1, 0.5, 0.9"
            )
        if not 0 <= config.forced <= 1:
            raise ConfigError("network: forced", got=config.forced, expected="a share")
        if config.output_activation != "linear":
            raise ConfigError("network: output_activation of a sat", got=config.output_activation, expected="linear")

    @property
    def states(self) -> tuple[State, ...]:
        """What a stream carries: the last sample and its error, the encoder's state, keys and values of the past."""
        width = self.width
        found = [State("sample", (1, 1, self.inputs)), State("fed", (1, 1, self.outputs))]
        if self.recurrent:
            found += [State("hidden", (1, 1, width)), State("cell", (1, 1, width))]
        if self.attention is not None:
            heads, inner, rows = self.attention.heads, self.attention.inner, self.history - 1
            found += [State("keys", (1, heads, rows, inner), 0), State("values", (1, rows, inner), 0)]
        return tuple(found)

    @property
    def reach(self) -> int:
        """See `Network.reach`."""
        return self.history if self.attention is not None else 0

    def begin(self, epoch: int, epochs: int) -> None:
        """See `Network.begin`."""
        self.own_share = min(1.0, (epoch - 1) / (self.forced * epochs)) if self.forced else 1.0

    def learn(self, x: Tensor, wanted: Tensor, lengths: Tensor | None) -> Tensor:
        """See `Network.learn`: some of the errors that the encoder is told are true, the others predicted (SAT, V).

        What the network would predict of itself from its own predictions is unknown before the pass; it is told what
        it predicts from those true errors. With that, all samples are still seen at once. What the present says does
        not depend on errors, and is worked out once.
        """
        del lengths  # the future, padding or not, is not seen
        now = _selected(self.select_now, x)
        if self.feedback == "zero":
            return self._said(self._taught(x, torch.zeros_like(wanted), now))
        if not self.own_share:
            return self._said(self._taught(x, wanted, now))
        with torch.no_grad():
            own = torch.rand(*x.shape[:2], 1, device=x.device) < self.own_share
            fed = torch.where(own, self._median(self._taught(x, wanted, now)), wanted)
            if self.own_share == 1:
                fed = self._median(self._taught(x, fed, now))
        return self._said(self._taught(x, fed, now))

    def _said(self, out: Tensor) -> Tensor:
        return out if self.quantiles == 1 else out.view(*out.shape[:-1], self.quantiles, self.outputs)

    def _median(self, out: Tensor) -> Tensor:
        return self._said(out)[..., self.quantiles // 2, :] if self.quantiles > 1 else out

    def taught(self, x: Tensor, fed: Tensor) -> Tensor:
        """Outputs (T, B, K) of motions from their starts, where the errors that the encoder reads are given.

        Args:
            x: normalized inputs, (T, B, I).
            fed: normalized errors after each sample, (T, B, K); that of the last sample is not read.
        """
        return self._median(self._taught(x, fed, _selected(self.select_now, x)))

    def _taught(self, x: Tensor, fed: Tensor, now: Tensor) -> Tensor:
        """The same with all quantiles, (T, B, Q K); `now` is what `select_now` makes of x, (T, B, W)."""
        past, now = self._embedded(x, fed, now)
        if self.attention is None:
            return self._ended(now)
        kept = [_after_nothing(values, self.history - 1) for values in self.attention.kept(past)]
        parts = []
        for start in range(0, len(x), _PIECE):
            own = now[start : start + _PIECE]
            rows = slice(start, start + self.history - 1 + len(own))
            parts.append(_remade(self._looked, own, kept[0][rows], kept[1][rows], again=len(x) > _WHOLE))
        return torch.cat(parts)

    def profile(self, x: Tensor, fed: Tensor) -> Tensor:
        """How much each of the last samples counts on average, the oldest first, (history + 1,) (SAT, Fig. 11).

        The last is the present one. Only samples whose whole history is there are counted, T > history.
        """
        assert self.attention is not None
        past, now = self._embedded(x, fed, _selected(self.select_now, x))
        keys, values = self.attention.kept(past)
        total, count = now.new_zeros(self.history + 1), 0
        for start in range(self.history, len(x), _PIECE):
            own = now[start : start + _PIECE]
            rows = slice(start - self.history + 1, start + len(own))
            weights = self.attention(own, (keys[rows], values[rows]))[1]
            total, count = total + weights.sum(dim=(0, 1)), count + weights.shape[0] * weights.shape[1]
        return total / count

    def run(self, x: Tensor, states: States, lengths: Tensor | None) -> tuple[Tensor, States]:
        """See `Network.run`; sample after sample."""
        del lengths  # the future, padding or not, is not seen
        outputs = []
        for now in torch.split(x, 1):
            out, states = self._step(now, states)
            outputs.append(out)
        return torch.cat(outputs), states

    def forward(self, x: Tensor, lengths: Tensor | None = None) -> Tensor:
        """See `Network.forward`. Without feedback, all samples at once."""
        if self.feedback == "zero":
            return self.taught(x, x.new_zeros(*x.shape[:2], self.outputs))
        return super().forward(x, lengths)

    def _embedded(self, x: Tensor, fed: Tensor, now: Tensor) -> tuple[Tensor, Tensor]:
        """What the encoder makes of the sample before each with its error, and the decoder of each, both (T, B, W)."""
        past = _selected(self.select_past, _after_nothing(torch.cat([x, fed], dim=-1)[:-1], 1))
        if self.dense_past is not None and self.dense_now is not None:
            return self.dense_past(past), self.dense_now(now)
        if not self.recurrent:
            return past, now
        hidden, _ = self.encoder(past)
        # torch keeps the last cell only, and the decoder begins at each sample with the encoder's.
        entry, forget, candidate, _ = gates(self.encoder, past, _after_nothing(hidden[:-1], 1))
        cell, cells = torch.zeros_like(hidden[0]), []
        for kept, new in zip(forget, entry * candidate, strict=True):
            cell = kept * cell + new
            cells.append(cell)
        decoded = stepped(self.decoder, now, hidden, torch.stack(cells))[0]
        return self.after_encoder(hidden, past), self.after_decoder(decoded, now)

    def _step(self, x: Tensor, states: States) -> tuple[Tensor, States]:
        """One sample, (1, B, I): first the encoder reads the one before it, then the decoder this one."""
        carried = dict(zip((state.name for state in self.states), states, strict=True))
        past = self.select_past(torch.cat([carried["sample"], carried["fed"]], dim=-1))[0]
        now = self.select_now(x)[0]
        if self.dense_past is not None and self.dense_now is not None:
            past, now = self.dense_past(past), self.dense_now(now)
        if self.recurrent:
            hidden, cell = stepped(self.encoder, past, carried["hidden"], carried["cell"])
            carried |= {"hidden": hidden, "cell": cell}
            now = self.after_decoder(stepped(self.decoder, now, hidden, cell)[0], now)
            past = self.after_encoder(hidden, past)
        if self.attention is None:
            out = self._ended(now)
        else:
            key, value = self.attention.kept(past)
            keys = torch.cat([carried["keys"].permute(2, 0, 1, 3), key])
            values = torch.cat([carried["values"].transpose(0, 1), value])
            out = self._looked(now, keys, values)
            carried |= {"keys": keys[1:].permute(1, 2, 0, 3), "values": values[1:].transpose(0, 1)}
        out = self._median(out)
        carried |= {"sample": x, "fed": out if self.feedback == "own" else torch.zeros_like(out)}
        return out, tuple(carried.values())

    def _looked(self, now: Tensor, keys: Tensor, values: Tensor) -> Tensor:
        """The outputs of N samples, given what they may look at; see `Attention.forward`."""
        assert self.attention is not None
        seen = self.after_attention(self.attention(now, (keys, values))[0], now)
        return self._ended(self.last(self.process(seen), now))

    def _ended(self, x: Tensor) -> Tensor:
        """The last layer, in full precision: the physics-informed loss takes differences of what it says."""
        with torch.autocast(x.device.type, enabled=False):
            out: Tensor = self.dense(x.to(self.dense.weight.dtype))
        return out

    def draw(self, graph: Graph, x: str, states: Sequence[str]) -> tuple[str, tuple[str, ...]]:
        """See `Network.draw`; of one sample, with matrices (B, ...) inside."""
        carried = dict(zip((state.name for state in self.states), states, strict=True))
        flat = graph.integers([0])
        pair = graph.add("Squeeze", graph.add("Concat", carried["sample"], carried["fed"], axis=2), flat)
        past = self.select_past.draw(graph, pair)
        now = self.select_now.draw(graph, graph.add("Squeeze", x, flat))
        if self.dense_past is not None and self.dense_now is not None:
            past, now = (
                _draw_dense(graph, layers, y) for layers, y in ((self.dense_past, past), (self.dense_now, now))
            )
        if self.recurrent:
            hidden, cell = draw_step(graph, self.encoder, past, carried["hidden"], carried["cell"])
            decoded, _ = draw_step(graph, self.decoder, now, hidden, cell)
            carried |= {"hidden": hidden, "cell": cell}
            now = self.after_decoder.draw(graph, graph.add("Squeeze", decoded, flat), now)
            past = self.after_encoder.draw(graph, graph.add("Squeeze", hidden, flat), past)
        if self.attention is None:
            out = self._draw_last(graph, now)
        else:
            seen, carried["keys"], carried["values"] = self.attention.draw(
                graph, now, past, carried["keys"], carried["values"]
            )
            seen = self.process.draw(graph, self.after_attention.draw(graph, seen, now))
            out = self._draw_last(graph, self.last.draw(graph, seen, now))
        out = graph.add("Unsqueeze", out, flat)
        fed = out if self.feedback == "own" else graph.add("Mul", out, graph.floats(0.0))
        carried |= {"sample": x, "fed": fed}
        return out, tuple(carried.values())

    def _draw_last(self, graph: Graph, x: str) -> str:
        """The last layer, of which the medians are drawn only."""
        return draw_gemm(graph, self._median_layer(), x)

    def step_weights(self) -> StepWeights | None:
        """See `Network.step_weights`; the ablations have none."""
        if self.attention is None or not self.recurrent:
            return None
        found = self.attention
        kept, query = (stacked([found.key, found.value]), linear(found.query, found.inner**-0.5))
        parts = {
            **_under("select_past", self.select_past.step_weights()),
            **_under("select_now", self.select_now.step_weights()),
            **_under("encoder", step_weights_of(self.encoder)),
            **_under("decoder", step_weights_of(self.decoder)),
            **_under("after_encoder", self.after_encoder.step_weights()),
            **_under("after_decoder", self.after_decoder.step_weights()),
            **_under("kept", kept),
            **_under("query", query),
            "attention.lag": found.lag,
            **_under("after_attention", self.after_attention.step_weights(found.merge)),
            **_under("first", linear(self.process.first)),
            **_under("process", self.process.gate.step_weights(self.process.second)),
            **_under("last", self.last.step_weights()),
            **_under("dense", {name: widened(part) for name, part in linear(self._median_layer()).items()}),
        }
        sizes = {"width": self.width, "heads": found.heads, "history": self.history, "own": self.feedback == "own"}
        return StepWeights(
            {name: int(size) for name, size in sizes.items()},
            {name: values.detach().double().cpu().numpy() for name, values in parts.items()},
        )

    def _median_layer(self) -> nn.Linear:
        """The last layer, with the medians only."""
        rows = slice(self.quantiles // 2 * self.outputs, (self.quantiles // 2 + 1) * self.outputs)
        made = nn.Linear(self.width, self.outputs)
        made.weight, made.bias = (nn.Parameter(part.detach()[rows]) for part in (self.dense.weight, self.dense.bias))
        return made


def _under(group: str, parts: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{group}.{name}": values for name, values in parts.items()}


def _remade(function: Callable[..., Tensor], *given: Tensor, again: bool) -> Tensor:
    """What a function says; `again` says it once more for the gradients, so that nothing of it is kept till then."""
    if not (again and torch.is_grad_enabled()):
        return function(*given)
    out: Tensor = checkpoint(function, *given, use_reentrant=False)
    return out


def _selected(selection: VariableSelection, x: Tensor) -> Tensor:
    """What the variables of samples (T, B, V) say, (T, B, W)."""
    pieces = torch.split(x, max(1, _ROWS // x.shape[1]))
    return torch.cat([_remade(selection.said, piece, again=len(x) > _WHOLE) for piece in pieces])


def _after_nothing(x: Tensor, rows: int) -> Tensor:
    """As many rows of zeros before the first one."""
    return torch.cat([x.new_zeros(rows, *x.shape[1:]), x])


def _dense(width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())


def _draw_dense(graph: Graph, layers: nn.Sequential, x: str) -> str:
    for layer in layers:
        x = draw_gemm(graph, layer, x) if isinstance(layer, nn.Linear) else graph.add("Relu", x)
    return x


KINDS = {"sat": Sat}


def methods() -> tuple[Method, ...]:
    """What `--method` chooses here."""
    config = AugmentConfig(
        "sat",
        SatConfig(),
        # What a joint that it never saw does not share: where it stands, and which way its errors lean.
        data=DataConfig(
            reads=("velocity", "torque"),
            command=("position",),
            stops=False,
            modular=True,
            blind=("position",),
            mirrored=True,
        ),
        window=WindowConfig("fixed", samples=256, draws=1),
        loss=LossConfig(kind="absolute"),
        optimizer=OptimizerConfig(rate=1e-3),
    )
    bodies = replace(
        config,
        method="sat-bodies",
        data=DataConfig(signals=components.CORRECTED, reads=components.SIGNALS, stops=False, modular=True),
    )
    return (
        Method(config, "one state augmentation transformer for all joints (SAT)"),
        Method(bodies, "one state augmentation transformer for all bodies, positions and rotations (SAT)"),
    )
