"""Corrected bodies and the joints that should hold them together: how far they are apart, and the nearest robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.core.augment_result import ALL_JOINTS, AugmentResult, JointGap
from trueup.core.config import build
from trueup.core.episode import Episode
from trueup.core.model_card import ModelCard
from trueup.core.results import Estimate
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.dataset import Dataset
from trueup.errors import ConfigError, TrueupError
from trueup.measure import bootstrap_interval, motion_numbers
from trueup.robots import RobotSpec
from trueup.stages.correcting import CorrectionSummary, in_run_names, make_unless_same
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    import mujoco

_PROJECTED = "-projected"
_MEASURED = ""  # no run is called so
_POSES = (f"{BODY_PREFIX}position", f"{BODY_PREFIX}rotation")
_UNITS = {"apart": "m", "apart_max": "m", "turned": "rad", "turned_max": "rad"}


def corrects_bodies(card: ModelCard) -> bool:
    """Whether a network corrects bodies, which then may come apart."""
    return any(output.of_body for output in card.outputs)


def projected_card(card: ModelCard) -> ModelCard:
    """What is said of the projection of a network's corrections."""
    return replace(card, name=f"{card.name}{_PROJECTED}")


def model_of(dataset: Dataset, run: str) -> mujoco.MjModel:
    """The model that a run was simulated with.

    Raises:
        ConfigError: it is not found, or has changed since.
    """
    from trueup.sim import MujocoSimulator

    info = dataset.run_info(run)
    inputs = info.get("inputs", {})
    if "robot" not in inputs:
        raise ConfigError(f"the run {run!r} does not say which robot it is of")
    robot = build(RobotSpec, inputs["robot"], f"the robot of {run}")
    path = model_file(robot, dataset)
    simulator = MujocoSimulator.from_robot(robot, Path(path))
    if info.get("engine") == "mujoco" and simulator.fingerprint != inputs.get("model_sha256"):
        raise ConfigError(
            f"the model of {robot.name!r} is not the one that {run!r} was simulated with",
            hint="Replay again: trueup replay DATASET --robot ROBOT --overwrite.",
        )
    return simulator.model


def project_unless_same(
    dataset: Dataset, corrected: str, *, ids: Sequence[str], track: Track = silent
) -> CorrectionSummary:
    """The robot that is nearest to each sample of a corrected run, stored as a run beside it; kept if nothing changed.

    Args:
        dataset: with the corrected run in it.
        corrected: its label.
        ids: motions.
        track: shows progress.

    Raises:
        ConfigError: the model of the run is not found, or has changed.
        TrueupError: no motion could be projected; what is wrong with the first.
    """
    from trueup.sim.projection import Projection

    model, base = model_of(dataset, corrected), dataset.run_info(corrected)
    known: dict[tuple[str, ...], Projection] = {}

    def nearest(episode: Episode) -> TimeSeries:
        series = episode.run(corrected)
        if series.bodies not in known:
            known[series.bodies] = Projection(model, series.joints, series.bodies)
        return known[series.bodies].nearest(series)

    projects = {"run": corrected, "created": base.get("provenance", {}).get("created")}
    inputs = {**base.get("inputs", {}), "projects": projects}
    return make_unless_same(dataset, f"{corrected}{_PROJECTED}", corrected, inputs, nearest, ids=ids, track=track)


@dataclass
class GapTally:
    """Takes the runs of motions one by one, and keeps how far their bodies are apart at each joint.

    Samples in which a body is not known do not count.

    Args:
        model: that the runs are of.
    """

    model: mujoco.MjModel
    _rows: dict[str, list[dict[str, np.ndarray]]] = field(default_factory=dict)
    _joints: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _executed: dict[str, list[str]] = field(default_factory=dict)

    def add(self, runs: Mapping[str, TimeSeries], executed: str) -> None:
        """One recording: run -> its series; repetitions of a motion executed the same."""
        from trueup.sim.projection import JointGaps

        for label, series in runs.items():
            known = np.all([np.isfinite(series[name].reshape(len(series), -1)).all(axis=1) for name in _POSES], axis=0)
            if not known.any():  # cameras may lose sight of a marker
                continue
            found = JointGaps(self.model, series.bodies).of(series.rows(np.flatnonzero(known)))
            if not found.joints:
                continue
            self._joints[label] = found.joints
            kinds = {"apart": found.apart_m, "turned": found.turned_rad}
            row = {name: values.mean(axis=0) for name, values in kinds.items()}
            row |= {f"{name}_max": values.max(axis=0) for name, values in kinds.items()}
            self._rows.setdefault(label, []).append(row)
            self._executed.setdefault(label, []).append(executed)

    def of(self, label: str, *, draws: int, seed: int) -> dict[str, JointGap]:
        """Joint -> how far its bodies are apart, mean over motions, and over joints; nothing if none is joined."""
        rows = self._rows.get(label, [])
        if not rows:
            return {}
        motions = motion_numbers(self._executed[label])
        found: dict[str, dict[str, Estimate]] = {name: {} for name in (*self._joints[label], ALL_JOINTS)}
        for kind, unit in _UNITS.items():
            table = np.array([row[kind] for row in rows])
            whole = table.max(axis=1) if kind.endswith("_max") else table.mean(axis=1)
            table = np.column_stack([table, whole])
            ends = bootstrap_interval(table, motions=motions, draws=draws, seed=seed)
            for name, value, low, high in zip(found, table.mean(axis=0), *ends, strict=True):
                known = (None, None) if np.isnan(low) else (max(float(low), 0.0), float(high))
                found[name][kind] = Estimate(float(value), unit, *known)
        return {name: JointGap(**kinds) for name, kinds in found.items()}


def with_gaps(
    result: AugmentResult, dataset: Dataset, ids: Sequence[str], *, draws: int, seed: int, track: Track = silent
) -> tuple[AugmentResult, list[str]]:
    """The result with how far bodies are apart, before and after each network that corrects bodies; and what hindered.

    Args:
        result: of these motions.
        dataset: with the runs in it.
        ids: motions.
        draws: of the bootstrap.
        seed: of the bootstrap.
        track: shows progress.
    """
    labels = [
        result.run,
        *(model.run for model in result.models if any(name.startswith(BODY_PREFIX) for name in model.signals)),
    ]
    if len(labels) == 1:
        return result, []
    try:
        tally, info = GapTally(model_of(dataset, result.run)), dataset.run_info(result.run)
        for name in track(ids, "joints", len(ids)):
            episode = dataset.episode(name, runs=labels)
            runs = {label: series for label, series in episode.simulated.items() if label in labels}
            if all(signal in episode.measured for signal in _POSES):
                runs[_MEASURED] = in_run_names(episode, info).measured
            tally.add(runs, episode.meta.executed)
    except TrueupError as error:
        return result, [f"how far corrected bodies are apart at their joints is not known: {error.summary}"]
    gaps = {label: tally.of(label, draws=draws, seed=seed) for label in (*labels, _MEASURED)}
    models = tuple(replace(model, gaps=gaps.get(model.run, {})) for model in result.models)
    return replace(result, gaps=gaps[result.run], measured_gaps=gaps[_MEASURED], models=models), []
