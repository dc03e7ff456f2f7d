"""Robustness: how far off a simulator, and how different motions may be before a correction no longer helps."""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from trueup.align import JointMap
from trueup.augment.correction import refuse_other_joints
from trueup.augment.robustness import improvements, judged_parts, judged_signal, position_errors, unit_of
from trueup.core.atomic import as_read_back, json_hash, make_folder
from trueup.core.episode import Episode
from trueup.core.model_card import ModelCard
from trueup.core.provenance import provenance
from trueup.core.robustness_result import (
    CELLS_NAME,
    ROBUSTNESS_NAME,
    Cell,
    Cells,
    RobustnessResult,
    RobustnessRow,
)
from trueup.core.sole_writer import writes_alone
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, MissingSignal, OutputExists, TrueupError
from trueup.measure import motion_numbers
from trueup.robots import RobotSpec, Setup, refuse_unknown_gains, setup_of
from trueup.stages.evaluating import EVERY_SPLIT
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    from trueup.augment.trained import Trained
    from trueup.sim import MujocoSimulator, ReplaySettings
    from trueup.sim.perturbation import Perturbation

_TEST = "test"
# Mean and largest error of a motion, then the same after correction.
_Errors = tuple[float, float, float, float]


@dataclass(frozen=True)
class _Motions:
    """The motions of one dataset: its name, and what they are simulated with."""

    name: str
    data: Dataset
    ids: tuple[str, ...]
    model: Path


@dataclass(frozen=True)
class _Judge:
    """Whose errors count, of which correction."""

    trained: Trained
    robot: RobotSpec
    joint_map: JointMap
    settings: ReplaySettings
    signal: str
    parts: tuple[str, ...]
    jobs: int
    track: Track

    def drawn(self, motions: _Motions, size: Perturbation, number: int, what: str) -> Cell:
        """Errors of these motions in a simulator that is drawn around the robot."""
        from trueup.sim import MujocoSimulator
        from trueup.sim.perturbation import perturbed

        def make(setup: Setup) -> MujocoSimulator:
            other, spec = perturbed(self.robot, motions.model, size, seed=number)
            return MujocoSimulator.from_spec(spec, other, origin=motions.model, setup=setup)

        return self.cell(motions, make, what)

    def as_it_is(self, motions: _Motions) -> Cell:
        """The same in the simulator of the robot."""
        from trueup.sim import MujocoSimulator

        def make(setup: Setup) -> MujocoSimulator:
            return MujocoSimulator.from_robot(self.robot, motions.model, setup=setup)

        return self.cell(motions, make, motions.name)

    def cell(self, motions: _Motions, make: Callable[[Setup], MujocoSimulator], what: str) -> Cell:
        """Before and after correction, in simulators that are as the robot is in the motions; no run is stored."""
        free: dict[Setup, SimpleQueue[MujocoSimulator]] = {}
        errors: dict[str, _Errors] = {}
        failed: dict[str, str] = {}
        waiting: deque[tuple[str, Future[_Errors]]] = deque()
        workers = min(self.jobs, len(motions.ids))

        def take() -> None:
            name, found = waiting.popleft()
            try:
                errors[name] = found.result()
            except TrueupError as error:  # one bad motion must not hide the others
                failed[name] = error.summary

        with ThreadPoolExecutor(workers) as pool:
            for name in self.track(motions.ids, what, len(motions.ids)):
                try:
                    episode = self.joint_map.of_episode(motions.data.episode(name))
                except TrueupError as error:
                    failed[name] = error.summary
                    continue
                setup = setup_of(self.robot, episode.meta)
                if setup not in free:
                    free[setup] = _clones(make(setup), workers)
                waiting.append((name, pool.submit(self._errors, episode, free[setup])))
                if len(waiting) > workers:
                    take()
            while waiting:
                take()
        return Cell(errors, failed)

    def _errors(self, episode: Episode, free: SimpleQueue[MujocoSimulator]) -> _Errors:
        from trueup.sim import replay_episode

        simulator = free.get()
        try:
            series = replay_episode(episode, simulator, self.settings)
        finally:
            free.put(simulator)
        run = self.trained.card.run
        corrected = self.trained.predict(replace(episode, simulated={run: series}), run)
        before, after = (
            position_errors(episode.measured, item, self.signal, self.parts) for item in (series, corrected)
        )
        return float(before[0]), float(before[1]), float(after[0]), float(after[1])


def _clones(simulator: MujocoSimulator, count: int) -> SimpleQueue[MujocoSimulator]:
    free: SimpleQueue[MujocoSimulator] = SimpleQueue()
    for _ in range(count):
        free.put(simulator.clone())
    return free


@writes_alone()
def robustness(
    datasets: Sequence[Dataset],
    robot: RobotSpec,
    network: Path | str,
    out: Path | str,
    *,
    perturbations: Mapping[str, Perturbation] | None = None,
    shares: Sequence[float] = (0.5, 1.0),
    draws: int = 3,
    split: str = _TEST,
    motions: int | None = None,
    drop_flagged: bool = False,
    jobs: int | None = None,
    bootstrap_draws: int = 2000,
    seed: int = 0,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
) -> RobustnessResult:
    """Say how much of the position error a correction takes away where its simulator, or the motions, are different.

    Every dataset is simulated with the robot as it is; the first one also with robots that are drawn around it. Runs
    stay in memory: datasets are only read. Writes robustness.json, and robustness.cells.json with the errors of every
    motion in every simulator, which `resume` goes on from, also with further perturbations, shares and draws.

    Args:
        datasets: recordings of the robot; e.g. the same motions at several speeds.
        robot: whose simulator was corrected in training.
        network: folder of a trained network that corrects positions of joints or of bodies.
        out: folder for the results.
        perturbations: name -> how far off simulators are drawn, at their largest.
        shares: of these sizes.
        draws: simulators per perturbation and share; those of seed s are the draws s, s + 1, ...
        split: motions to look at; `all` for every motion.
        motions: at most so many of each dataset, the first ones; all if None.
        drop_flagged: leave out motions with warnings.
        jobs: threads; the number of cores if None.
        bootstrap_draws: resamples of the intervals.
        seed: of the first draw, and of the intervals.
        overwrite: replace the results that are in `out`.
        resume: keep what an interrupted call with the same inputs has left.
        track: shows progress.

    Raises:
        OutputExists: `out` holds results, and neither `overwrite` nor a matching `resume` applies.
        ConfigError: no dataset, one twice, a share or number that is none, a network that corrects no position, or a
            perturbation that the robot cannot have.
        MissingSignal: a split has no motions, or positions were not measured.
        NameMismatch: robot, logs and network do not have the same joints; both lists are printed.
        DataError: of a simulator no motion could be judged; why the first could not.
        MissingDependency: onnxruntime is not installed.
    """
    from trueup.augment.trained import Trained
    from trueup.sim import MujocoSimulator, ReplaySettings

    perturbations = dict(perturbations or {})
    _refuse_numbers(shares, draws, motions)
    for name, size in perturbations.items():
        size.refuse_without_effect(robot)
        if not any(vars(size).values()):
            raise ConfigError(f"perturbation {name!r} changes nothing", got=vars(size), expected="a size above 0")
    trained = Trained.load(network)
    signal = judged_signal(trained.card)
    named = [
        _motions(name, data, robot, split, motions, drop_flagged=drop_flagged)
        for name, data in _named(datasets).items()
    ]
    refuse_unknown_gains(robot, (item.data.meta(id) for item in named for id in item.ids))
    first, joint_map = named[0], JointMap.from_dict(robot.joint_rules())
    measured = joint_map.of_episode(first.data.episode(first.ids[0])).measured
    card = _card_of(trained.card, robot)
    parts = judged_parts(card, measured, robot.scored_joints)
    unit = unit_of(measured, signal, parts)
    settings = ReplaySettings.of(robot)
    judge = _Judge(trained, robot, joint_map, settings, signal, parts, jobs or os.cpu_count() or 1, track)
    simulators = {item.model: MujocoSimulator.from_robot(robot, item.model) for item in named}
    inputs = json_hash(
        {
            "network": trained.card.to_json()["sha256"],
            "robot": robot.to_dict(),
            "settings": asdict(settings),
            "datasets": {
                item.name: [item.data.hash, list(item.ids), simulators[item.model].fingerprint] for item in named
            },
        }
    )
    out = Path(out)
    cells = _Store(out, inputs, overwrite=overwrite, resume=resume)

    def row(item: _Motions, own: Sequence[Cell], what: str) -> RobustnessRow:
        return _row(item, own, unit, bootstrap_draws, seed, what=what)

    rows = []
    for item in named:
        make = partial(judge.as_it_is, item)
        rows.append(row(item, [cells.get(f"{item.name}: as it is", make)], "the robot as it is"))
    for (name, largest), share in itertools.product(perturbations.items(), shares):
        size, what, own = largest.times(share), f"{name} x {share:g}", []
        sizes = ", ".join(f"{key} {value:.9g}" for key, value in vars(size).items())
        for number in range(seed, seed + draws):
            make = partial(judge.drawn, first, size, number, what)
            own.append(cells.get(f"{first.name}: {sizes}, draw {number}", make))
        rows.append(replace(row(first, own, what), perturbation=name, share=share, size=vars(size)))
    held = dict.fromkeys(note for simulator in simulators.values() for note in simulator.holding.notes)
    result = RobustnessResult(
        network=trained.card.name,
        method=trained.card.method,
        robot=robot.name,
        signal=signal,
        parts=parts,
        split=split,
        rows=tuple(rows),
        notes=(*_off(card, signal, parts), *_foreign(card, first, simulators[first.model]), *cells.notes(), *held),
        settings={"shares": list(shares), "draws": draws, "seed": seed, "bootstrap_draws": bootstrap_draws},
        provenance=as_read_back(
            provenance(
                config={
                    "datasets": {item.name: {"path": str(item.data.path), "hash": item.data.hash} for item in named},
                    "network": trained.card.to_json()["sha256"],
                    "robot": robot.to_dict(),
                    "perturbations": {name: asdict(size) for name, size in perturbations.items()},
                    "motions": motions,
                    "drop_flagged": drop_flagged,
                },
                seed=seed,
                data_hash=first.data.hash,
            )
        ),
    )
    result.save(out / ROBUSTNESS_NAME)
    return result


class _Store:
    """The cells in the folder for the results; each is written when it is known."""

    def __init__(self, out: Path, inputs: str, *, overwrite: bool, resume: bool) -> None:
        make_folder(out)
        self._path = out / CELLS_NAME
        there = [name for name in (ROBUSTNESS_NAME, CELLS_NAME) if (out / name).exists()]
        if there and not (overwrite or resume):
            raise OutputExists(
                f"{out} holds {there[0]}", hint="Give --resume to go on, --overwrite to replace it, or another --out."
            )
        self._cells = Cells(inputs)
        if resume and not overwrite and self._path.exists():
            self._cells = Cells.load(self._path)
            if self._cells.inputs != inputs:
                raise OutputExists(
                    f"{self._path} was made from other datasets, motions, robots, or another network",
                    hint="Give --overwrite to replace it, or another --out.",
                )
        self._used: dict[str, Cell] = {}

    def get(self, name: str, make: Callable[[], Cell]) -> Cell:
        """A cell that is there, or is made and kept."""
        cell = self._cells.cells.get(name)
        if cell is None:
            cell = make()
            self._cells = replace(self._cells, cells={**self._cells.cells, name: cell})
            self._cells.save(self._path)
        self._used[name] = cell
        return cell

    def notes(self) -> Iterable[str]:
        """What was left out."""
        for name, cell in self._used.items():
            if cell.failed:
                motion, why = next(iter(cell.failed.items()))
                yield f"{name}: {len(cell.failed)} motions were left out, {motion} because {why}"


def _refuse_numbers(shares: Sequence[float], draws: int, motions: int | None) -> None:
    if not shares or not all(0.0 < share < float("inf") for share in shares):
        raise ConfigError("shares of the sizes", got=list(shares), expected="positive numbers, e.g. 0.5 and 1")
    for name, value in (("draws", draws), ("motions", motions)):
        if value is not None and value < 1:
            raise ConfigError(name, got=value, expected="at least 1")


def _named(datasets: Sequence[Dataset]) -> dict[str, Dataset]:
    """By the names of their folders, or by their paths where names are the same."""
    if not datasets:
        raise ConfigError("there is no dataset to look at")
    names = [data.path.resolve().name for data in datasets]
    paths = [str(data.path) for data in datasets]
    if len({data.path.resolve() for data in datasets}) < len(datasets):
        raise ConfigError("a dataset was given twice", got=", ".join(paths))
    return dict(zip(names if len(set(names)) == len(names) else paths, datasets, strict=True))


def _motions(
    name: str, data: Dataset, robot: RobotSpec, split: str, most: int | None, *, drop_flagged: bool
) -> _Motions:
    present = sorted(set(data.splits.values()))
    if split != EVERY_SPLIT and split not in present:
        raise MissingSignal(
            f"{data.path} has no split {split!r}",
            available=[*present, EVERY_SPLIT],
            hint="Give --split, or assign splits when importing.",
        )
    ids = data.select(split=None if split == EVERY_SPLIT else split, drop_flagged=drop_flagged)[:most]
    if not ids:
        raise MissingSignal(f"{data.path} has no motions to look at", hint="Give another --split.")
    model = model_file(robot, data)
    return _Motions(name, data, ids, model)


def _card_of(card: ModelCard, robot: RobotSpec) -> ModelCard:
    """The network on the joints or bodies of a robot; names that do not fit are refused at once."""
    bodies = robot.simulation.bodies
    if card.outputs[0].of_body and not bodies:
        raise ConfigError(
            f"the network {card.name!r} corrects bodies, and robot {robot.name!r} names none",
            hint="Name them in robot.yaml, `simulation: {bodies: [...]}`.",
        )
    own = card.of_joints(bodies if card.outputs[0].of_body else robot.joint_names)
    refuse_other_joints((*robot.joint_names, *bodies), own, f"robot {robot.name!r}")
    return own


def _row(recorded: _Motions, cells: Sequence[Cell], unit: str, draws: int, seed: int, *, what: str) -> RobustnessRow:
    """One simulator: each motion counts with its mean over the draws that it survived."""
    motions = list(dict.fromkeys(name for cell in cells for name in cell.errors))
    if not motions:
        reasons = [why for cell in cells for why in cell.failed.values()]
        raise DataError(
            f"{recorded.name}, {what}: no motion could be simulated and corrected",
            got=reasons[0] if reasons else None,
            hint="A smaller size may leave a robot that can be simulated." if len(cells) > 1 else None,
        )
    table = np.array([_mean([cell.errors[name] for cell in cells if name in cell.errors]) for name in motions])
    executed = {meta.id: meta.executed for meta in recorded.data.metas}
    sums = [np.array(list(cell.errors.values())).sum(axis=0) for cell in cells if cell.errors]
    return RobustnessRow(
        dataset=recorded.name,
        motions=len(motions),
        errors=improvements(
            table[:, :2],
            table[:, 2:],
            unit,
            motions=motion_numbers(executed[name] for name in motions),
            draws=draws,
            seed=seed,
        ),
        draws=len(sums),
        least=min(float(1.0 - total[2] / total[0]) for total in sums) if len(cells) > 1 else None,
    )


def _mean(errors: Sequence[Sequence[float]]) -> Float64[np.ndarray, "4"]:
    return np.asarray(np.mean(errors, axis=0))


def _off(card: ModelCard, signal: str, parts: Sequence[str]) -> list[str]:
    """What the training of the network has switched off, so that nothing is gone of its error."""
    of = [output for output in card.outputs if output.quantity == signal]
    off = dict.fromkeys(output.joint for output in of if output.joint in parts and output.gate == 0.0)
    return [f"{card.name} leaves the {signal} of {', '.join(off)} as simulated"] if off else []


def _foreign(card: ModelCard, motions: _Motions, simulator: MujocoSimulator) -> list[str]:
    """Whether the robot is the one whose simulator the network was trained to correct, as far as the dataset tells."""
    if card.run not in motions.data.runs:
        return []
    made = motions.data.run_info(card.run)
    if made.get("engine") == "mujoco" and made.get("inputs", {}).get("model_sha256") == simulator.fingerprint:
        return []
    line = (
        f"{card.name} was trained to correct {card.run}, which in {motions.name} was made with another simulator than "
        "the one that is looked at here"
    )
    return [line]
