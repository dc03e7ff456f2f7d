"""The networks of a close: which corrections are tried, and training them into folders beside each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.core.close_result import STEPS, StepName
from trueup.core.model_card import CARD_NAME
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset
from trueup.errors import MissingDependency, OutputExists, TrueupError
from trueup.robots import RobotSpec
from trueup.stages.augmenting import augment
from trueup.stages.correcting import correct_unless_same
from trueup.stages.identifying import FITTED
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import STOCK
from trueup.stages.training_data import lowest_rate

if TYPE_CHECKING:
    from trueup.augment import AugmentConfig, Progress

# The baseline of the papers, and both their networks: for a control loop, and for whole motions.
METHODS = ("moving-average", "realeasy-rt", "realeasy")
# What is also tried without an identification: does the model need one at all?
_BASELINE = "moving-average"
_RUNS = {"stock": STOCK, "fitted": FITTED}


@dataclass(frozen=True)
class Planned:
    """A network to train.

    Attributes:
        base: rung that it corrects, `stock` or `fitted`.
        method: of `augment`.
    """

    base: str
    method: str

    @property
    def run(self) -> str:
        """Label of the run that it corrects."""
        return _RUNS[self.base]

    @property
    def rung(self) -> str:
        """Its name in the ladder."""
        return self.method if (self.base, self.method) == ("stock", _BASELINE) else f"{self.base}+{self.method}"

    def folder_in(self, networks: Path) -> Path:
        """Where it is trained."""
        return networks / self.base / self.method

    def is_there(self, networks: Path) -> bool:
        """Whether it is trained already."""
        return (self.folder_in(networks) / CARD_NAME).is_file()


@dataclass(frozen=True)
class Trained:
    """A network that was trained, or was there.

    Attributes:
        base: rung that it corrects.
        rung: its own.
        run: label of the run that it corrects.
        label: of the corrected run.
        folder: of the network.
        seconds: of training and correction [s].
        kept: whether it was there.
        cut_short: whether the time limit ended its training.
        words: how training went.
    """

    base: str
    rung: str
    run: str
    label: str
    folder: Path
    seconds: float
    kept: bool
    cut_short: bool
    words: str


def plan_of(methods: Sequence[str], *, fitted: bool) -> list[Planned]:
    """What is trained: all methods on the best model that there is, the baseline on the model as it came, too."""
    first = [Planned("stock", _BASELINE)] if fitted and _BASELINE in methods else []
    return first + [Planned("fitted" if fitted else "stock", method) for method in methods]


def possible_runs(until: StepName, methods: Sequence[str]) -> list[str]:
    """The labels of all runs that a close may make and measure."""
    if STEPS.index(until) < STEPS.index("gap"):
        return []
    runs = [STOCK] + [FITTED] * (STEPS.index(until) >= STEPS.index("identify"))
    return runs + [f"{run}+{method}" for run in runs for method in methods if until == "augment"]


def train_each(
    plan: Sequence[Planned],
    dataset: Dataset,
    robot: RobotSpec,
    folder: Path,
    *,
    drop_flagged: bool | None,
    seed: int,
    jobs: int | None,
    overwrite: bool,
    limit: TimeLimit | None,
    failed: dict[str, TrueupError],
    track: Track = silent,
    on_training: Callable[[str, Progress], None] | None = None,
) -> Iterator[Trained]:
    """Train networks one after the other; each has its share of what is left of the time.

    Where motions of train and val have different rates, a network sees as many samples per second as the slowest has.

    Args:
        plan: which.
        dataset: with the runs.
        robot: for its limits.
        folder: gets `BASE/METHOD` for each.
        drop_flagged: as of `augment`.
        seed: of all draws.
        jobs: threads of torch.
        overwrite: train anew.
        limit: when all have to end.
        failed: gets rung -> why, of those that could not be trained.
        track: shows progress.
        on_training: told of every batch.

    Raises:
        MissingDependency: torch is not installed.
        OutputExists: a folder holds the network of other inputs.
    """
    from trueup.augment.config import preset

    for number, item in enumerate(plan):
        share = None if limit is None else limit.share(1.0 / (len(plan) - number))
        slowest_hz = lowest_rate(dataset, item.run, drop_flagged=drop_flagged)
        told = None if on_training is None else _named(on_training, item.rung)
        try:
            made = augment(
                [dataset],
                item.folder_in(folder),
                run=item.run,
                config=_at_rate(preset(item.method), slowest_hz),
                robot=robot,
                drop_flagged=drop_flagged,
                seed=seed,
                jobs=jobs,
                overwrite=overwrite,
                resume=not overwrite,
                track=track,
                on_progress=told,
                limit=share,
            )
        except (MissingDependency, OutputExists):
            raise
        except TrueupError as error:  # one method that does not fit these motions must not hide the others
            failed[item.rung] = error
            continue
        training = made.augmentation.card.provenance["training"]
        epochs, status = len(training["history"]), training["status"]
        outputs = made.augmentation.card.outputs
        used = sum(output.gate > 0 for output in outputs)
        yield Trained(
            base=item.base,
            rung=item.rung,
            run=item.run,
            label=f"{item.run}+{item.method}",
            folder=made.folder,
            seconds=float(training["seconds"]),
            kept="was finished already" in made.notes,
            cut_short=status == "out of time",
            words=f"{item.rung}: {used} of {len(outputs)} corrections help on val"
            + (f", {status} after {epochs} epochs" if epochs else "")
            + (f", at the {slowest_hz:g} samples per second of the slowest motion" if slowest_hz else ""),
        )


def _at_rate(config: AugmentConfig, rate_hz: float | None) -> AugmentConfig:
    return config if rate_hz is None else replace(config, data=replace(config.data, rate_hz=rate_hz))


def corrected_everywhere(network: Trained, dataset: Dataset, *, track: Track = silent) -> Trained:
    """The network's run, on the motions of all splits."""
    from trueup.deploy import Predictor

    predictor = Predictor.load(network.folder)
    ids = dataset.run_ids(network.run)
    first = dataset.episode(ids[0], runs=[network.run]).run(network.run)
    predictor = predictor.of_joints(predictor.card.blocks_of(first))
    summary = correct_unless_same(dataset, predictor, run=network.run, ids=ids, track=track)
    return replace(network, label=summary.label, seconds=network.seconds + summary.seconds)


def _named(on_training: Callable[[str, Progress], None], name: str) -> Callable[[Progress], None]:
    return lambda progress: on_training(name, progress)
