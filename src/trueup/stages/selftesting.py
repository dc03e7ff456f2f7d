"""Self-test: a robot in; which of its numbers a fit would recover from given motions, or from designed ones, out."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.core.episode import Episode
from trueup.core.provenance import provenance
from trueup.core.quality import left_out
from trueup.core.selftest_result import DrawnRobot, SelftestResult
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError, DataError, NotIdentifiable, TrueupError
from trueup.record import Springs
from trueup.robots import RobotSpec, find_model, refuse_unknown_gains
from trueup.stages.importing import dataset_of
from trueup.stages.motions import motions_of
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import model_file
from trueup.stages.selftest_motions import MOST_S, designed_motions

if TYPE_CHECKING:
    from trueup.core.parameters import ParameterSet
    from trueup.identify import IdentifyConfig, Nominal, OnModel
    from trueup.identify.selftest import DrawnSimulator, Sensors

# Noise of encoders where no log shows it [rad or m].
NOISE = 3e-4
# Draws before it is said that robots like this cannot be simulated.
_DRAWS = 5
# Share of the time that the motions are cut for: the rest is for fits that take longer than most.
_SEARCH = 0.4
# Logs of train are simulated up to so many times what is fitted of them; those of val, up to as much as is fitted.
_LOGGED = 4.0
# How quick the springs are that lead a torque-driven robot: slow enough for commands that are late [Hz].
_LEAD_HZ = 1.5


@dataclass(frozen=True)
class _Asked:
    """What robots are drawn around and what is fitted to them."""

    robot: RobotSpec
    path: Path
    nominal: Nominal
    config: IdentifyConfig
    parameters: ParameterSet
    episodes: Mapping[str, Sequence[Episode]]
    sensors: Sensors
    jobs: int
    budget_s: float | None
    notes: tuple[str, ...]


def selftest(
    robot: RobotSpec,
    source: Path | str | None = None,
    *,
    model: Path | None = None,
    config: IdentifyConfig | None = None,
    noise: float | None = None,
    budget_s: float | None = 60.0,
    seeds: int = 1,
    format: str | None = None,
    options: ImportOptions | None = None,
    seed: int = 0,
    jobs: int | None = None,
    track: Track = silent,
    on_progress: OnModel | None = None,
) -> SelftestResult:
    """Draw robots around a model, move each by given commands, and fit it as `fit` would, from the model as it came.

    So it is known what the fit should find, and seen what these motions can tell about such a robot. Nothing of the
    motions but their commands is taken (of robots that follow velocity or torque, the way that they went, too).

    Args:
        robot: its description.
        source: a dataset, or logs of any known format; motions are designed if None.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        config: what to fit, and how; the default for the robot's controller if None.
        noise: standard deviation of a measured position [rad or m]; what the logs show, or 3e-4, if None.
        budget_s: time for each drawn robot [s]: motions are shortened, and searches ended, accordingly. None fits all
            motion that `fit` would, to the end.
        seeds: number of robots to draw.
        format: of logs; detected if None.
        options: mapping file, units, topics of logs.
        seed: of the first draw, and of the fits.
        jobs: threads; the number of cores if None.
        track: shows progress of the simulations.
        on_progress: called after every iteration of every model.

    Raises:
        ConfigError: no robot to draw, a noise or a time that is not positive, or a configuration that does not fit the
            robot.
        NotIdentifiable: there is nothing to learn from these motions.
        DataError: none of several drawn robots could be simulated.
        TrueupError: what an import or a fit raises.
    """
    from trueup.identify import IdentifyConfig

    if seeds < 1:
        raise ConfigError("there is no robot to draw", got=seeds, expected="seeds of at least 1")
    for name, value in (("noise", noise), ("budget_s", budget_s)):
        if value is not None and not 0 < value < float("inf"):
            raise ConfigError(f"{name} of a self-test must be positive", got=value)
    with contextlib.ExitStack() as stack:
        dataset: Dataset | None = None
        notes: list[str] = []
        if source is not None:
            dataset, notes = dataset_of(Path(source), stack, robot=robot, format=format, options=options, track=track)
        elif format is not None or (options or ImportOptions()) != ImportOptions():
            raise ConfigError("options of an import are given, and there are no logs", hint="Give the logs, too.")
        path = find_model(robot, given=model) if dataset is None else model_file(robot, dataset, given=model)
        asked = _asked(
            *(robot, path, dataset, config or IdentifyConfig()),
            noise=noise,
            budget_s=budget_s,
            seed=seed,
            jobs=jobs or os.cpu_count() or 1,
        )
        tried = [_try(asked, number, track, on_progress) for number in range(seed, seed + seeds)]
    truths = tuple(truth for truth, _ in tried)
    motions, motion_s = tried[0][1]
    ended = [str(truth.seed) for truth in truths if truth.cut]
    if ended:
        notes.append(
            f"the time has ended a search (seed {', '.join(ended)}): what it says is less sure than its intervals; "
            "give a longer --budget"
        )
    return SelftestResult(
        truths=truths,
        motions=motions,
        motion_s=motion_s,
        noise=dict(zip(robot.joint_names, map(float, asked.sensors.noise["position"]), strict=True)),
        notes=(*notes, *asked.notes),
        provenance=provenance(
            config={
                "robot": asked.robot.to_dict(),
                "model": path.name,
                "identify": asked.config.to_json(),
                "budget_s": budget_s,
                "seeds": seeds,
            },
            seed=seed,
            data_hash=None if dataset is None else dataset.hash,
        ),
    )


def _asked(
    robot: RobotSpec,
    path: Path,
    dataset: Dataset | None,
    config: IdentifyConfig,
    *,
    noise: float | None,
    budget_s: float | None,
    seed: int,
    jobs: int,
) -> _Asked:
    """The motions, as much of them as there is time for, and what is fitted to them."""
    from trueup.identify import Nominal
    from trueup.identify.config import make_parameters
    from trueup.identify.segments import usable
    from trueup.identify.selftest import Sensors, motion_within

    notes: list[str] = []
    if dataset is None and robot.simulation.base_sensor:
        robot = replace(robot, simulation=replace(robot.simulation, base_sensor=""))
        notes.append("the base of the designed motions is at rest")
    if robot.simulation.base_sensor and robot.controller.signal != "position":
        raise ConfigError(
            f"robot {robot.name!r}: on a base that moves, only position servos are tested",
            got=f"simulation: {{base_sensor: {robot.simulation.base_sensor}}}, controller of {robot.controller.signal}",
            hint="Leave base_sensor out of robot.yaml for a base at rest.",
        )
    nominal = Nominal(robot, path)
    fit = config.resolved(nominal).fit
    motion_s = config.data.budget_s
    if budget_s is not None:
        motion_s = min(motion_s, motion_within(_SEARCH * budget_s, make_parameters(fit, nominal), nominal, jobs=jobs))
    if dataset is None:
        episodes = designed_motions(nominal, path, min(motion_s, MOST_S), seed=seed)
        sensors = Sensors.flat(len(robot.joints), noise or NOISE, moving=robot.controller.signal == "torque")
    else:
        found = motions_of(dataset, robot)
        logs, flagged = usable(found.by_split, drop_flagged=config.data.drop)
        refuse_unknown_gains(robot, (log.meta for own in logs.values() for log in own))
        logs, refused = _playable({split: logs[split] for split in ("train", "val") if logs.get(split)}, nominal)
        for reasons in (found.refused, flagged, refused):
            notes += left_out({split: reasons[split] for split in ("train", "val") if split in reasons})
        if not logs.get("train"):
            raise NotIdentifiable("there is no motion to fit", got="; ".join(notes) or "an empty train split")
        sensors = Sensors.of_logs(logs["train"], robot.joint_names, position=noise)
        recorded_s = sum(log.measured.duration_s for log in logs["train"])
        episodes = {
            split: _heads(logs[split], most_s)
            for split, most_s in (("train", _LOGGED * motion_s), ("val", motion_s))
            if logs.get(split)
        }
        if recorded_s > _LOGGED * motion_s:
            notes.append(f"motions were cut to their beginnings: {_LOGGED * motion_s:.0f} of {recorded_s:.0f} s")
        whole_s = min(recorded_s, config.data.budget_s)
        if motion_s < whole_s:
            notes.append(
                f"fitted to {motion_s:.0f} s of motion, of {whole_s:.0f} s that `trueup identify` would fit: that may "
                "determine more (--budget)"
            )
    names = [log.id for own in episodes.values() for log in own]
    config = replace(config, data=replace(config.data, budget_s=motion_s))
    parameters = make_parameters(fit, nominal, names)
    return _Asked(robot, path, nominal, config, parameters, episodes, sensors, jobs, budget_s, tuple(notes))


def _playable(
    logs: Mapping[str, Sequence[Episode]], nominal: Nominal
) -> tuple[dict[str, list[Episode]], dict[str, dict[str, str]]]:
    """The motions whose commands can be simulated, and why others cannot."""
    from trueup.sim import ReplayPlan, ReplaySettings

    settings = ReplaySettings(base_sensor=nominal.robot.simulation.base_sensor)
    kept: dict[str, list[Episode]] = {split: [] for split in logs}
    refused: dict[str, dict[str, str]] = {split: {} for split in logs}
    for split, own in logs.items():
        for log in own:
            try:
                plan = ReplayPlan(log, nominal.simulator, settings)
            except TrueupError as error:
                refused[split][log.id] = error.summary
                continue
            if len(plan.measured) > 1:
                kept[split].append(log)
            else:
                refused[split][log.id] = "it has a single sample"
    return {split: own for split, own in kept.items() if own}, refused


def _heads(logs: Sequence[Episode], most_s: float) -> list[Episode]:
    """The beginnings of motions, all as long or whole, together no longer than this [s]."""
    whole = [log.measured.duration_s for log in logs]
    if sum(whole) <= most_s:
        return list(logs)
    low, high = 0.0, max(whole)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if sum(min(own, middle) for own in whole) < most_s else (low, middle)
    ends = [int(np.searchsorted(log.measured.time_s, log.measured.time_s[0] + low, side="right")) for log in logs]
    return [replace(log, measured=log.measured.rows(slice(0, end))) for log, end in zip(logs, ends, strict=True)]


def _try(asked: _Asked, seed: int, track: Track, on_progress: OnModel | None) -> tuple[DrawnRobot, tuple[int, float]]:
    """One drawn robot, and of how many motions, and how much of them, was fitted."""
    from trueup.identify import identify
    from trueup.identify.selftest import verdicts

    began = time.perf_counter()
    limit = None if asked.budget_s is None else TimeLimit.after(asked.budget_s)
    values, episodes, draws = _drawn(asked, seed, track)
    found = identify(
        episodes,
        asked.robot,
        asked.path,
        config=asked.config,
        jobs=asked.jobs,
        seed=seed,
        on_progress=on_progress,
        limit=limit,
    ).result
    chosen = next((row.name for row in found.models if row.chosen), "base")
    seconds = round(time.perf_counter() - began, 2)
    numbers = verdicts(found, asked.parameters, values)
    truth = DrawnRobot(seed, draws, numbers, found.status, chosen, seconds, found.short_of_time)
    return truth, (len(found.data["episodes"]), float(found.data["seconds"]))


def _drawn(asked: _Asked, seed: int, track: Track) -> tuple[dict[str, float], dict[str, list[Episode]], int]:
    """True values of a robot that can be simulated, its logs, and how many robots were drawn."""
    from trueup.identify.selftest import DrawnSimulator, draw_truth

    robot = asked.robot
    last: TrueupError | None = None
    for draw in range(_DRAWS):
        rng = np.random.default_rng([seed, draw])
        values = draw_truth(asked.parameters, asked.nominal, rng)
        try:
            simulator = DrawnSimulator(robot, asked.path, asked.parameters, values, leader=_leader(asked.nominal))
            return values, _logs(asked, simulator, seed, track), draw + 1
        except (ConfigError, DataError) as error:
            last = error
    raise DataError(
        f"robots like {robot.name!r} cannot be simulated: {_DRAWS} were drawn around its model, and each diverged",
        got=last.summary if last else None,
        hint="Give a smaller simulation: {timestep_s: …} in robot.yaml, or lower gains.",
    ) from last


def _leader(nominal: Nominal) -> Springs | None:
    """What leads a robot that takes torques."""
    if nominal.robot.controller.signal != "torque":
        return None
    limits = nominal.commanded_limits
    most = np.array([limits.get(name, np.inf) for name in nominal.robot.joint_names])
    return Springs(nominal.model, nominal.robot.joint_names, most, frequency_hz=_LEAD_HZ)


def _logs(asked: _Asked, simulator: DrawnSimulator, seed: int, track: Track) -> dict[str, list[Episode]]:
    """What a drawn robot leaves of all motions, by split."""
    motions = [(split, log) for split, own in asked.episodes.items() for log in own]
    simulator.prepare(log.meta for _, log in motions)
    # What leads a robot has a state of its own, and works in Python's.
    with ThreadPoolExecutor(asked.jobs if asked.robot.controller.signal == "position" else 1) as pool:
        made = [
            pool.submit(simulator.log, log, asked.sensors, np.random.default_rng([seed, number, 7]))
            for number, (_, log) in enumerate(motions)
        ]
        try:
            logs = [one.result() for one in track(made, "simulate", len(made))]
        except TrueupError:
            pool.shutdown(cancel_futures=True)
            raise
    found: dict[str, list[Episode]] = {split: [] for split in asked.episodes}
    for (split, _), log in zip(motions, logs, strict=True):
        found[split].append(log)
    return found
