"""What to train and how: `AugmentConfig`, from YAML or as a method's default or as its paper has it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from trueup.augment import components
from trueup.augment.networks import METHODS, method, network_class
from trueup.core.config import build, read_yaml
from trueup.core.model_card import LARGEST_MARGIN
from trueup.errors import ConfigError

SIGNALS = ("position", "velocity", "torque", "current", "voltage")
CHECKPOINT_NAME = "checkpoint.safetensors"
# From so many val motions on, an output must help beyond chance.
FEWEST_FOR_CHANCE = 10


@dataclass(frozen=True)
class NetworkConfig:
    """The network.

    Attributes:
        kind: of the `KINDS` in the files of `networks/`.
        hidden: units of each layer; (100, 21) in the papers.
        bidirectional: whether the network sees a motion from both ends ("precise"); not for a control loop. Outputs of
            the layers are concatenated, those of the last one summed (Realeasy, IV-C).
        history: samples that a network without a state sees.
        history_s: the same in seconds, whatever the rate; over `history` where it is given.
        heads: of the attention, `transformer` and `sat` only.
        input_dropout: share of the samples that are skipped in training (Realeasy, IV-C).
        recurrent_dropout: share of the state's units that are left out of the recurrence of a batch; `lstm`, `gru`.
        output_activation: `tanh` bounds the output by the range of its joint; with `normalization: limits`.
    """

    kind: str = "lstm"
    hidden: tuple[int, ...] = (100, 21)
    bidirectional: bool = False
    history: int = 50
    history_s: float | None = None
    heads: int = 4
    input_dropout: float = 0.0
    recurrent_dropout: float = 0.0
    output_activation: Literal["linear", "tanh"] = "linear"

    def samples(self, rate_hz: float) -> int:
        """Samples that a network without a state sees."""
        return self.history if self.history_s is None else max(1, round(self.history_s * rate_hz))

    def __post_init__(self) -> None:
        """Refuse what makes no network."""
        if any(size < 1 for size in self.hidden):
            raise ConfigError("network: hidden", got=self.hidden, expected="positive sizes")
        if self.history < 1 or not (self.history_s is None or 0 < self.history_s < math.inf):
            raise ConfigError("network: history", got=(self.history, self.history_s), expected="at least one sample")
        for name in ("input_dropout", "recurrent_dropout"):
            if not 0 <= getattr(self, name) < 1:
                raise ConfigError(f"network: {name}", got=getattr(self, name), expected="a share below 1")
        network_class(self.kind).check(self)

    @property
    def quantiles(self) -> tuple[float, ...]:
        """That are learned besides; the middle one is the output."""
        return ()

    @property
    def trained(self) -> bool:
        """Whether there is anything to train."""
        return network_class(self.kind).trained

    @staticmethod
    def variant(tree: Mapping[str, Any]) -> type[NetworkConfig]:
        """The class with the options of the kind that a tree of YAML or JSON names."""
        return network_class(str(tree.get("kind", NetworkConfig.kind))).Config


@dataclass(frozen=True)
class DataConfig:
    """What the network reads and corrects.

    Attributes:
        signals: those that are corrected; None for all signals of joints that both sides have. `body.position` and
            `body.rotation` make a network for bodies.
        reads: simulated signals that are read besides those that are corrected; here, `load` is one, and
            `body.velocity`, `body.angular_velocity`, `body.force`, `body.torque` are.
        command: commanded signals that are read, as how far they are from the simulated ones; () for none, as in the
            papers.
        measured: signals of the robot that are read one sample late, as how far they are from the simulated ones
            (SAT, V); for networks that run beside a robot with sensors.
        rate_hz: samples per second; None for the rate of the logs.
        joints: those that are trained on and corrected; all that are scored if empty.
        bodies: likewise; all that were measured if empty.
        normalization: `limits` maps the joints' limits to [0, 1] (Realeasy, IV-B); `statistics` takes mean and
            standard deviation of the train split.
        stops: whether the network is also told how near each joint is to its limits: a simulated joint that leans on
            its stop is carried by it, and its torque says little. For joints whose limits are known.
        modular: one network for every joint, which so serves joints and robots that it never saw (SAT, IV); it knows
            nothing of a joint's place or limits. Or one for every body.
        blind: signals that are corrected without being read: the position of a joint that it never saw says something
            else to a modular network than those of the joints that it knows.
        mirrored: a modular network also learns every motion the other way around, so that it prefers no direction:
            what one joint is off by to one side all the time, another one is not. Not for bodies.
    """

    signals: tuple[str, ...] | None = None
    reads: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    rate_hz: float | None = None
    joints: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    normalization: Literal["limits", "statistics"] = "statistics"
    stops: bool = True
    modular: bool = False
    blind: tuple[str, ...] = ()
    mirrored: bool = False

    def __post_init__(self) -> None:
        """Refuse unknown signals, and what no joint could be told from another by."""
        if self.mirrored and not self.modular:
            raise ConfigError(
                "data: mirrored is for modular networks",
                got="modular: false",
                expected="modular: true",
                hint="A whole robot knows up from down.",
            )
        if self.modular and (self.stops or self.normalization != "statistics"):
            raise ConfigError(
                "data: a modular network knows no limits of joints",
                got=f"stops: {self.stops}, normalization: {self.normalization}",
                expected="stops: false, normalization: statistics",
            )
        for name in (*(self.signals or ()), *self.command, *self.measured):
            further = () if name in self.command or name in self.measured else components.CORRECTED
            if name not in (known := (*SIGNALS, *further)):
                raise ConfigError("data: signals", got=name, available=known)
        for name in self.blind:
            if name not in SIGNALS or (self.signals is not None and name not in self.signals):
                raise ConfigError(
                    "data: blind to a signal that is not corrected",
                    got=name,
                    available=self.signals or SIGNALS,
                    hint="Say beside `signals` which of them are not read: `blind: []` for none.",
                )
        if self.mirrored and any("." in name for name in self.signals or ()):
            raise ConfigError("data: mirrored is for joints", got=self.signals, hint="A body knows up from down.")
        for name in self.reads:
            if name not in (known := (*SIGNALS, "load", *components.SIGNALS)):
                raise ConfigError("data: reads", got=name, available=known)
        if self.normalization == "limits" and (bodies := [name for name in self.signals or () if "." in name]):
            raise ConfigError(
                f"data: {', '.join(bodies)} has no limits to normalize by", expected="normalization: statistics"
            )
        if self.signals == ():
            raise ConfigError("data: signals is empty", expected="at least one, or none at all for all")
        if self.rate_hz is not None and not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ConfigError("data: rate_hz", got=self.rate_hz, expected="a positive number")


@dataclass(frozen=True)
class WindowConfig:
    """The pieces of motions that a network is trained on (Realeasy, IV-D; LSTM thesis, 2.7).

    Attributes:
        rule: `half-shortest` takes half the shortest motion of the batch, `draws` times from each motion and epoch;
            `fixed` takes `samples`, as often as is needed to see each sample `draws` times in an epoch.
        samples: length of a fixed window.
        draws: see `rule`.

    The first and last quarter of a fixed window may lie outside of a motion; it is then moved to begin with the motion,
    or ends with it. So pieces from the start are more frequent than others, and networks start there.
    """

    rule: Literal["half-shortest", "fixed"] = "fixed"
    samples: int = 120
    draws: int = 2

    def __post_init__(self) -> None:
        """Refuse empty windows."""
        if self.samples < 2 or self.draws < 1:
            raise ConfigError("window", got=(self.samples, self.draws), expected="samples >= 2, draws >= 1")


@dataclass(frozen=True)
class LossConfig:
    """What is minimized.

    Attributes:
        target: `residual` learns what must be added to the simulator (MSrE; Realeasy, eq. 9 and 10); `plain` learns
            the measured signal itself (the thesis's "Normal").
        scale: `simulator` counts errors in units of the simulator's own error of each output, so that no signal
            drowns another; `normalized` in normalized units, as the papers do.
        weights: signal -> weight; 1 where nothing is said.
        kind: of an error: its square, its absolute value, or how far quantiles are off; these need a network that says
            them (`network: says`, of a `sat`).
        consistency: weight of the physics-informed term of SAT, eq. 3: how far the added velocity is from the slope of
            the added position.
    """

    target: Literal["residual", "plain"] = "residual"
    scale: Literal["simulator", "normalized"] = "simulator"
    weights: Mapping[str, float] = field(default_factory=dict)
    kind: Literal["squares", "absolute", "quantile"] = "squares"
    consistency: float = 0.0

    def __post_init__(self) -> None:
        """Refuse weights that are none."""
        if not (math.isfinite(self.consistency) and self.consistency >= 0):
            raise ConfigError("loss: consistency", got=self.consistency, expected="a number >= 0")
        if self.consistency and self.target != "residual":
            raise ConfigError("loss: consistency is one of what is added", got=self.target, expected="residual")
        for name, value in self.weights.items():
            if name not in (*SIGNALS, *components.CORRECTED):
                raise ConfigError("loss: weights", got=name, available=(*SIGNALS, *components.CORRECTED))
            if not (math.isfinite(value) and value >= 0):
                raise ConfigError(f"loss: weight of {name}", got=value, expected="a number >= 0")


@dataclass(frozen=True)
class OptimizerConfig:
    """How it is minimized.

    Attributes:
        name: optimizer.
        rate: learning rate; the peak where it follows a cosine.
        schedule: `plateau` divides the rate by `1 / factor` when val has not improved for `patience` epochs;
            `cosine` rises over `warmup_steps` and falls to zero at the last epoch.
        factor: see `schedule`.
        patience: epochs, see `schedule`.
        warmup_steps: see `schedule`.
        weight_decay: of `adamw`.
        clip: largest norm of a gradient; 0 for none.
    """

    name: Literal["rmsprop", "adamw"] = "adamw"
    rate: float = 5e-3
    schedule: Literal["plateau", "cosine"] = "cosine"
    factor: float = 0.5
    patience: int = 3
    warmup_steps: int = 100
    weight_decay: float = 1e-3
    clip: float = 1.0

    def __post_init__(self) -> None:
        """Refuse numbers that minimize nothing."""
        for name, expected in (("rate", "above 0"), ("weight_decay", ">= 0"), ("clip", ">= 0")):
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0 or (name == "rate" and value == 0):
                raise ConfigError(f"optimizer: {name}", got=value, expected=expected)
        if not 0 < self.factor < 1:
            raise ConfigError("optimizer: factor", got=self.factor, expected="between 0 and 1")
        if self.patience < 1 or self.warmup_steps < 0:
            raise ConfigError("optimizer: patience, warmup_steps", got=(self.patience, self.warmup_steps))


@dataclass(frozen=True)
class AugmentConfig:
    """Everything about a training run.

    Attributes:
        method: name of the method; becomes part of the run's label.
        network: the network.
        data: what it reads and corrects.
        window: pieces of motions.
        loss: what is minimized.
        optimizer: how.
        batch: windows in a batch.
        epochs: at most this many.
        stop_after: epochs without improvement on val after which training stops; 0 for never.
        margin: share of an input's training range by which a stream's input may leave it.
        coverage: share of samples that the intervals are to cover.
        precision: `mixed` multiplies matrices in bfloat16 in training, which GPUs are several times faster at; CPUs are
            not, and it is refused there. Weights, losses, val and what is exported stay float32.
    """

    method: str = "realeasy-rt"
    network: NetworkConfig = field(default_factory=NetworkConfig)
    data: DataConfig = field(default_factory=DataConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    batch: int = 32
    epochs: int = 40
    stop_after: int = 15
    margin: float = 0.1
    coverage: float = 0.9
    precision: Literal["full", "mixed"] = "full"

    def __post_init__(self) -> None:
        """Refuse numbers that make no training."""
        if self.batch < 1 or self.epochs < 0 or self.stop_after < 0:
            raise ConfigError(
                "batch, epochs, stop_after",
                got=(self.batch, self.epochs, self.stop_after),
                expected="batch >= 1, epochs >= 0, stop_after >= 0",
            )
        if (self.loss.kind == "quantile") != bool(self.network.quantiles):
            raise ConfigError(
                "loss: quantile needs a network that says quantiles, and the other way around",
                got=f"loss: kind: {self.loss.kind}, network: says: {list(self.network.quantiles)}",
                hint="Of a sat, e.g. network: {says: [0.1, 0.5, 0.9]}.",
            )
        if not self.network.trained and (
            self.data.normalization != "limits" or self.data.stops or self.loss.target != "residual"
        ):
            raise ConfigError(
                f"{self.network.kind} is not trained, so that there is nothing to normalize",
                got=f"normalization: {self.data.normalization}, stops: {self.data.stops}, target: {self.loss.target}",
                expected="data: {normalization: limits, stops: false}, loss: {target: residual}",
            )
        if self.network.output_activation == "tanh" and self.data.normalization != "limits":
            raise ConfigError(
                "network: output_activation: tanh would cut the peaks of every correction",
                expected="data: normalization: limits",
                hint="Its bound is the scale of the output: with limits the range of the joint.",
            )
        if self.data.measured and self.network.bidirectional:
            raise ConfigError(
                "data: measured, which is what is known in a control loop",
                got="network: bidirectional: true",
                expected="a network that does not see the future",
            )
        if not self.network.trained and self.data.blind:
            raise ConfigError(f"{self.network.kind} averages what it corrects", got=f"data: blind: {self.data.blind}")
        if not 0 < self.coverage < 1:
            raise ConfigError("coverage", got=self.coverage, expected="a share between 0 and 1")
        if not 0 <= self.margin <= LARGEST_MARGIN:
            raise ConfigError("margin", got=self.margin, expected=f"a share from 0 to {LARGEST_MARGIN:g}")

    def to_json(self) -> dict[str, Any]:
        """JSON types only; `load` reads it back from YAML."""
        return asdict(self)

    @staticmethod
    def load(path: Path) -> AugmentConfig:
        """Read a YAML file; `method` and `base: paper` choose what the rest is laid over.

        Raises:
            ConfigError: no such file, unknown keys, wrong types or numbers.
        """
        tree = read_yaml(path)
        base = tree.pop("base", "default")
        if base not in ("default", "paper"):
            raise ConfigError(f"{path}: base", got=base, available=("default", "paper"))
        start = preset(str(tree.get("method", "realeasy-rt")), paper=base == "paper")
        under, network = asdict(start), tree.get("network")
        if isinstance(network, Mapping) and "kind" in network and network["kind"] != start.network.kind:
            common = {item.name for item in fields(NetworkConfig)}  # another kind has other options of its own
            under["network"] = {key: value for key, value in under["network"].items() if key in common}
        return build(AugmentConfig, _laid_over(under, tree), str(path))


@dataclass(frozen=True)
class Method:
    """What `--method` chooses, by the name in its configuration.

    Attributes:
        config: our default.
        about: what it is, in a few words.
        paper: as its paper has it, where there is one.
    """

    config: AugmentConfig
    about: str
    paper: AugmentConfig | None = None


def preset(name: str, *, paper: bool = False) -> AugmentConfig:
    """The configuration of a method.

    Args:
        name: one of `METHODS`.
        paper: as the papers have it, not our default.

    Raises:
        ConfigError: there is no such method, or no paper about it.
    """
    chosen = method(name)
    if not paper:
        return chosen.config
    if chosen.paper is None:
        known = [other for other in METHODS if method(other).paper]
        raise ConfigError("no paper has a configuration of this method", got=name, available=known)
    return chosen.paper


def _laid_over(base: dict[str, Any], tree: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in tree.items():
        inner = merged.get(key)
        merged[key] = _laid_over(inner, value) if isinstance(inner, dict) and isinstance(value, Mapping) else value
    return merged
