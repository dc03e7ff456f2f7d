"""The one interface of everything that augments: fit, predict, stream, save, load, export."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from trueup.augment.calibration import far_off, intervals_of, warmup_steps
from trueup.augment.checkpoint import losses
from trueup.augment.config import CHECKPOINT_NAME, AugmentConfig
from trueup.augment.correction import corrected
from trueup.augment.corrector import Corrector
from trueup.augment.gating import Errors, errors_of, gates_of
from trueup.augment.networks import build_network
from trueup.augment.pairs import Pairs
from trueup.augment.scaling import Scaling, Stops, Summary, scaling_of, summarize
from trueup.augment.training import OnProgress, Outcome, Progress, train
from trueup.core.atomic import json_hash, make_folder, remove, write_bytes
from trueup.core.config import build
from trueup.core.episode import Episode
from trueup.core.model_card import (
    CARD_NAME,
    ONNX_NAME,
    STEP_NAME,
    WEIGHTS_NAME,
    Channel,
    Input,
    ModelCard,
    Output,
    counterparts,
)
from trueup.core.provenance import provenance
from trueup.core.step_times import LATENCY_NAME
from trueup.core.time_limit import TimeLimit
from trueup.core.timeseries import TimeSeries
from trueup.deploy import Stream, StreamSettings
from trueup.errors import DataError

_VAL = "val"


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be learned from which data.

    Attributes:
        name: of the model.
        robot: name of the kind of robot.
        joints: its joints.
        run: label of the run that is corrected.
        rate_hz: samples per second.
        train: pairs that are fitted.
        val: pairs that choose.
        limits: (signal, joint) -> lowest and highest value, for normalization and stops; of none where the network is
            modular, and its channels are of any joint.
        data_hash: of the dataset.
        asked: hash of what the caller asked for; kept in the card.
        description: for people.
    """

    name: str
    robot: str
    joints: tuple[str, ...]
    run: str
    rate_hz: float
    train: Pairs
    val: Pairs
    limits: Mapping[tuple[str, str], tuple[float, float]]
    data_hash: str = ""
    asked: str = ""
    description: str = ""


class Augmentation:
    """A trained correction.

    Attributes:
        card: what it says of itself.
        corrector: the network between SI values.
        config: how it was trained.
        training: how training went; None for one that was loaded.
    """

    def __init__(
        self, card: ModelCard, corrector: Corrector, config: AugmentConfig, training: Outcome | None = None
    ) -> None:
        self.card = card
        self.corrector = corrector
        self.config = config
        self.training = training

    @staticmethod
    def fit(
        task: Task,
        config: AugmentConfig,
        *,
        folder: Path,
        seed: int = 0,
        resume: bool = False,
        device: str = "cpu",
        threads: int | None = None,
        on_progress: OnProgress | None = None,
        limit: TimeLimit | None = None,
    ) -> Augmentation:
        """Train, switch off the outputs that do not help on val, and calibrate intervals on val.

        Args:
            task: pairs and their names.
            config: network, loss, optimizer.
            folder: where the checkpoint is kept after each epoch.
            seed: of all draws.
            resume: go on from the checkpoint.
            device: `cpu` or `cuda`.
            threads: of torch; its own choice if None.
            on_progress: called after every batch and epoch, and once training is over.
            limit: when training has to end.

        Raises:
            TrueupError: see `training.train`.
        """
        with _threads(threads):
            return Augmentation._fit(task, config, folder, seed, device, on_progress, limit, resume=resume)

    @staticmethod
    def _fit(
        task: Task,
        config: AugmentConfig,
        folder: Path,
        seed: int,
        device: str,
        on_progress: OnProgress | None,
        limit: TimeLimit | None,
        *,
        resume: bool,
    ) -> Augmentation:
        base = np.array([task.train.inputs.index(channel) for channel in task.train.outputs])
        summary = summarize(task.train, base)
        scaling = scaling_of(
            summary,
            task.train.inputs,
            base,
            normalization=config.data.normalization,
            target=config.loss.target,
            loss_scale=config.loss.scale,
            limits=task.limits,
            blind=config.data.blind,
        )
        stops = Stops.of(task.train.inputs, task.limits if config.data.stops else {})
        corrector = _made(config, task.train.inputs, base, scaling, stops, task.rate_hz, seed)
        trained = train(
            corrector,
            task.train,
            task.val,
            config,
            seed=seed,
            checkpoint=folder / CHECKPOINT_NAME,
            inputs=_digest(task, config, seed),
            resume=resume,
            device=device,
            on_progress=on_progress,
            limit=limit,
        )
        if on_progress:
            on_progress(Progress(config.epochs, len(trained.history), 0, 0, None, None, judging=True))
        errors = errors_of(corrector, task.val)
        blocks = list(dict.fromkeys((channel.quantity, channel.joint) for channel in task.val.outputs))
        groups = [blocks.index((channel.quantity, channel.joint)) for channel in task.val.outputs]
        counted = [config.loss.weights.get(quantity, 1.0) > 0 for quantity, _ in blocks]
        passed, why = gates_of(errors.merged(groups), counted, seed=seed)
        used, reasons = passed[groups], [why[group] for group in groups]
        corrector.set_gate(used.astype(float))
        errors = replace(errors, corrected=np.where(used, errors.corrected, errors.simulated))
        card = _card(task, config, corrector, summary, errors, reasons, trained, seed)
        return Augmentation(card, corrector.cpu(), config, trained)

    def predict(self, episode: Episode, run: str = "") -> TimeSeries:
        """One run of an episode as the robot would have measured it, on the run's clock; the trained one if not named.

        The same as `Trained.predict`, by torch.

        Raises:
            TrueupError: what `correction.corrected` raises.
        """
        run = run or self.card.run
        card = self.card.of_joints(self.card.blocks_of(episode.run(run)))
        return corrected(episode, run, card, self._computed)

    def _computed(self, x: np.ndarray) -> np.ndarray:
        """(N, 1, I) to (N, 1, K); the joints of a modular network go through it side by side."""
        own = np.ascontiguousarray(x).reshape(len(x), -1, len(self.card.inputs))
        with torch.no_grad():
            out: np.ndarray = self.corrector(torch.from_numpy(own)).numpy()
        return out.reshape(len(x), 1, -1)

    def stream(self, *, rate_hz: float, joints: Sequence[str], settings: StreamSettings | None = None) -> Stream:
        """The stateful step for a control loop, by onnxruntime; see `deploy.Stream`."""
        with tempfile.TemporaryDirectory() as folder:
            self.save(Path(folder))
            return Stream.load(folder, rate_hz=rate_hz, joints=joints, settings=settings)

    def save(self, folder: Path) -> ModelCard:
        """Write `model.onnx`, `weights.safetensors`, `step.npz` of a SAT and, last, `model.json`; returns that card.

        What belongs to a model that was there goes: half of it must not be taken for one, nor the times of its steps
        for those of this one.
        """
        make_folder(folder)
        state = {name: value.contiguous() for name, value in self.corrector.state_dict().items()}
        weights, graph = save_tensors(state), self.export()
        step = self.corrector.step_weights()
        for name in (CARD_NAME, LATENCY_NAME, STEP_NAME):
            remove(folder / name)
        write_bytes(folder / WEIGHTS_NAME, weights)
        write_bytes(folder / ONNX_NAME, graph)
        if step is not None:
            write_bytes(folder / STEP_NAME, step.to_bytes())
        self.card = self.card.save(folder)
        return self.card

    def export(self) -> bytes:
        """`model.onnx`: one file, SI in and out, states in and out; see `core.model_card`."""
        self.corrector.eval()
        return self.corrector.exported({"name": self.card.name, "method": self.card.method, "by": "trueup"})

    @staticmethod
    def load(folder: Path) -> Augmentation:
        """Read a model folder back, with the weights in torch.

        Raises:
            DataError: a file is missing, truncated or changed.
            FormatError: of another version.
        """
        card = ModelCard.load(folder)
        path = folder / WEIGHTS_NAME
        try:
            state = load_tensors(card.verified(folder, WEIGHTS_NAME))
            config = build(AugmentConfig, card.provenance.get("config"), f"{folder}: config")
            width = len(card.outputs)
            blank = Scaling(*(np.ones(n) for n in (len(card.inputs), len(card.inputs), width, width, width)))
            stops = Stops.none(len(state["stop_edge"]))
            corrector = _made(config, card.inputs, card.base, blank, stops, card.rate_hz, 0)
            corrector.load_state_dict(state)
        except (SafetensorError, KeyError, TypeError, RuntimeError) as error:  # torch's error for shapes is the last
            raise DataError(f"{path} holds no weights of this network", got=error) from error
        chosen = [value for value in corrector.state_dict().values() if not value.is_floating_point()]
        if any(((value < 0) | (value >= len(card.inputs))).any() for value in chosen):
            raise DataError(f"{path} reads inputs that are not there", expected=f"0 to {len(card.inputs) - 1}")
        corrector.eval()
        return Augmentation(card, corrector, config)


def _made(
    config: AugmentConfig,
    inputs: Sequence[Channel],
    base: np.ndarray,
    scaling: Scaling,
    stops: Stops,
    rate_hz: float,
    seed: int,
) -> Corrector:
    before = torch.get_rng_state()
    torch.manual_seed(seed)
    network = build_network(config.network, inputs=len(inputs) + stops.edge.size, base=base.tolist(), rate_hz=rate_hz)
    torch.set_rng_state(before)
    return Corrector(network, scaling, base, target=config.loss.target, relative=counterparts(inputs), stops=stops)


@contextlib.contextmanager
def _threads(count: int | None) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _digest(task: Task, config: AugmentConfig, seed: int) -> str:
    """Hash of everything that decides about a training."""
    parts = {
        "config": config.to_json(),
        "seed": seed,
        "data": task.data_hash,
        "run": task.run,
        "rate_hz": task.rate_hz,
        "asked": task.asked,
        "limits": sorted([*key, *value] for key, value in task.limits.items()),
        "motions": [[[motion.id, motion.rows] for motion in pairs.motions] for pairs in (task.train, task.val)],
        "inputs": [channel.name for channel in task.train.inputs],
        "outputs": [channel.name for channel in task.train.outputs],
    }
    return json_hash(parts)


def _card(
    task: Task,
    config: AugmentConfig,
    corrector: Corrector,
    summary: Summary,
    errors: Errors,
    reasons: Iterable[str],
    trained: Outcome,
    seed: int,
) -> ModelCard:
    pairs = task.val
    intervals = intervals_of(corrector, pairs, config.coverage)
    far = far_off(corrector, pairs, summary.simulator_rms)
    base, gate = corrector.base.cpu().numpy(), corrector.gate.cpu().numpy()
    unread, relative = np.isinf(corrector.scale.cpu().numpy()), counterparts(pairs.inputs)
    # Where a joint stands is then not read, nor is where its command is: only how far the two are apart.
    apart = unread[relative] & (relative >= 0)
    low, high = np.where(apart, [summary.read_low, summary.read_high], [summary.low, summary.high])
    inputs = tuple(
        Input(channel.signal, channel.joint, channel.unit, channel.series)
        if unread[row]
        else Input(
            channel.signal,
            channel.joint,
            channel.unit,
            channel.series,
            low=float(low[row]),
            high=float(high[row]),
            relative=bool(apart[row]),
        )
        for row, channel in enumerate(pairs.inputs)
    )
    outputs = tuple(
        Output(
            channel.signal,
            channel.joint,
            channel.unit,
            channel.series,
            base=int(base[number]),
            gate=float(gate[number]),
            reason=reason,
            interval=(intervals.base[number], intervals.slope[number]),
            far=far.threshold[number],
            far_correction=far.correction[number],
            far_probability=far.probability[number],
        )
        for number, (channel, reason) in enumerate(zip(pairs.outputs, reasons, strict=True))
    )
    made = provenance(config=config.to_json(), seed=seed, data_hash=task.data_hash)
    made["asked"] = task.asked
    made["training"] = {
        "status": trained.status,
        "best_epoch": trained.best,
        "seconds": trained.seconds,
        "history": losses(trained.history),
        "motions": {"train": task.train.episodes, "val": task.val.episodes},
        "val_conditions": sorted({motion.condition for motion in task.val.motions}),
        "rows": {"train": task.train.rows, "val": task.val.rows},
    }
    return ModelCard(
        name=task.name,
        method=config.method,
        robot=task.robot,
        joints=task.joints,
        run=task.run,
        rate_hz=task.rate_hz,
        causal=corrector.network.causal,
        inputs=inputs,
        outputs=outputs,
        states=corrector.states,
        modular=config.data.modular,
        warmup_steps=warmup_steps(corrector, pairs, task.rate_hz),
        margin=config.margin,
        coverage=config.coverage,
        coverage_note=intervals.note,
        metrics={_VAL: _metrics(pairs, errors)},
        description=task.description,
        provenance=made,
    )


def _metrics(pairs: Pairs, errors: Errors) -> dict[str, Any]:
    simulated, corrected = errors.rmse(errors.simulated), errors.rmse(errors.corrected)
    metrics: dict[str, Any] = {}
    for channel, before, after in zip(pairs.outputs, simulated, corrected, strict=True):
        numbers = {"simulated": float(before), "corrected": float(after)}
        metrics.setdefault(channel.signal, {})[channel.joint] = numbers
    return metrics
