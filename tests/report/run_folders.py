"""Run folders as a comparison would write them: a robot with delay and friction, and two simulators of it."""

import itertools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trueup.core.analysis import Analysis, BinnedCurve, HorizonCurve, Lag
from trueup.core.episode import Flag
from trueup.core.quality import EpisodeQuality, Quality
from trueup.core.results import Estimate, GapResult, Ladder, MetricResult, PairedDifference, Rung
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.traces import TraceSet

UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
STEP_S = 0.02


@dataclass
class World:
    """What `make_run` writes; tests change a copy of it."""

    joints: tuple[str, ...] = ("shoulder_pan", "elbow_flex", "gripper")
    scored: tuple[str, ...] = ("shoulder_pan", "elbow_flex")
    runs: tuple[str, ...] = ("mujoco/stock", "mujoco/fitted")
    names: tuple[str, ...] = (
        "chirp_sweep",
        "circular_motion",
        "coupled_joints",
        "gravity_hold",
        "pick_place",
        "random_walk",
        "single_joint_wrist_roll",
        "square_wave",
    )
    splits: tuple[str, ...] = ("train", "train", "train", "val", "val", "test", "test", "test")
    samples: int = 1500
    max_points: int = 600
    series: dict = field(default_factory=dict)


def _lagged(values, delay, droop):
    shifted = np.roll(values, delay, axis=0)
    shifted[:delay] = values[0]
    return shifted - droop * np.tanh(8 * np.gradient(shifted, axis=0) / STEP_S)


def simulate(world):
    """Episode id -> measured, command and simulated series; every number from one seeded generator."""
    rng = np.random.default_rng(11)
    time_s = 5.0 + STEP_S * np.arange(world.samples)
    droops = np.linspace(0.008, 0.034, len(world.joints))
    for name in world.names:
        frequency = rng.uniform(0.04, 0.16, len(world.joints))
        phase = rng.uniform(0, 6, len(world.joints))
        size = rng.uniform(0.3, 1.1, len(world.joints))
        command = size * np.sin(2 * np.pi * frequency * (time_s[:, None] - 5) + phase)
        if name == "square_wave":
            command = np.sign(command) * 0.5
        scale = rng.uniform(0.7, 1.4)
        # standing error and noise of a real servo
        noise = rng.normal(0, 0.012, len(world.joints)) + rng.normal(0, 0.0015, command.shape)
        measured = _lagged(command, 3, droops * scale) + noise
        stock = _lagged(command, 2, droops * 0.1) + rng.normal(0, 0.004, command.shape).cumsum(axis=0) * 0.05
        fitted = _lagged(command, 3, droops * 0.8) + rng.normal(0, 0.0005, command.shape)
        runs = dict(zip(world.runs, (stock, fitted), strict=True))
        world.series[name] = (
            _series(world, time_s, measured),
            TimeSeries(time_s, world.joints, {"position": command}, same_units({"position": "rad"}, world.joints)),
            {label: _series(world, time_s, values) for label, values in runs.items()},
        )
    return world


def _series(world, time_s, position):
    smooth = np.apply_along_axis(lambda column: np.convolve(column, np.ones(5) / 5, "same"), 0, position)
    velocity = np.gradient(smooth, STEP_S, axis=0)
    signals = {"position": position, "velocity": velocity, "torque": 0.8 * np.sin(position) + 0.05 * velocity}
    return TimeSeries(time_s, world.joints, signals, same_units(UNITS, world.joints))


def episode_errors(world):
    """Run -> episode -> signal -> metric -> joint -> value."""
    result = {}
    for name, (measured, command, simulated) in world.series.items():
        for label, series in {"command": command, **simulated}.items():
            for signal in series.signals:
                error = measured[signal] - series[signal]
                metrics = {"rmse": np.sqrt((error**2).mean(axis=0)), "max": np.abs(error).max(axis=0)}
                result.setdefault(label, {}).setdefault(name, {})[signal] = {
                    metric: dict(zip(world.joints, map(float, values), strict=True))
                    for metric, values in metrics.items()
                }
    return result


def _interval(values, rng):
    if len(values) < 2:
        return {"low": None, "high": None}
    draws = rng.choice(values, (400, len(values))).mean(axis=1)
    return {"low": float(np.quantile(draws, 0.025)), "high": float(np.quantile(draws, 0.975))}


def _metric_result(world, errors, ids, signal, metric, rng):
    rows = np.array([[errors[name][signal][metric][joint] for joint in world.joints] for name in ids])
    scored = rows[:, [world.joints.index(joint) for joint in world.scored]].mean(axis=1)
    unit = UNITS[signal]
    per_joint = {
        joint: Estimate(float(rows[:, column].mean()), unit, **_interval(rows[:, column], rng))
        for column, joint in enumerate(world.joints)
    }
    return MetricResult(Estimate(float(scored.mean()), unit, **_interval(scored, rng)), per_joint, len(ids))


def _metrics(world, errors, ids, rng):
    signals = next(iter(errors.values()))
    return {
        signal: {metric: _metric_result(world, errors, ids, signal, metric, rng) for metric in metrics}
        for signal, metrics in signals.items()
    }


def _pairs(world, errors, ids_of, rng):
    pairs = []
    for run, baseline in [(label, "command") for label in world.runs] + [(world.runs[1], world.runs[0])]:
        for split, ids in ids_of.items():
            means = [
                [np.mean([errors[label][name]["position"]["rmse"][joint] for joint in world.scored]) for name in ids]
                for label in (run, baseline)
            ]
            difference = np.subtract(*means)
            ends = _interval(difference, rng)
            decided = ends["low"] is not None and (ends["low"] > 0 or ends["high"] < 0)
            pairs.append(
                PairedDifference(
                    run=run,
                    baseline=baseline,
                    split=split,
                    signal="position",
                    metric="rmse",
                    difference=Estimate(float(difference.mean()), "rad", **ends),
                    relative=float(difference.mean() / np.mean(means[1])),
                    verdict=("worse" if difference.mean() > 0 else "better") if decided else "undecided",
                )
            )
    return tuple(pairs)


def make_gap(world):
    rng = np.random.default_rng(3)
    errors = episode_errors(world)
    ids_of = {"all": list(world.names)}
    for name, split in zip(world.names, world.splits, strict=True):
        if split:
            ids_of.setdefault(split, []).append(name)
    payloads = {"0.0": list(world.names[:5]), "0.25": list(world.names[5:])}
    return GapResult(
        runs={
            label: {split: _metrics(world, errors[label], ids, rng) for split, ids in ids_of.items()}
            for label in errors
        },
        joints=world.joints,
        scored_joints=world.scored,
        paired=_pairs(world, errors, ids_of, rng),
        groups={
            "payload_kg": {
                value: {label: _metrics(world, errors[label], ids, rng) for label in errors}
                for value, ids in payloads.items()
                if ids
            }
        },
        episodes=errors,
        splits=dict(zip(world.names, world.splits, strict=True)),
        settings={"robot": "SO-101", "dataset": "bench arm, 8 motions", "window_s": None, "draws": 400},
        provenance={
            "trueup": "0.1.0",
            "python": "3.11.9",
            "packages": {"numpy": "2.4.0", "mujoco": "3.17.0", "torch": None},
            "git": "423cae9",
            "seed": 0,
            "data_hash": "9f2c41d0",
            "config": {"robot": "so101.yaml", "runs": list(world.runs)},
            "created": "2026-11-21T10:00:00+00:00",
        },
    )


def make_ladder(world, gap):
    names = dict(zip(("command", *world.runs), ("command", "stock", "fitted"), strict=True))
    rungs = [
        Rung(
            names[label], seconds, {split: gap.runs[label][split] for split in ("train", "val", "test")}, chosen=chosen
        )
        for label, seconds, chosen in zip(names, (0.02, 3.1, 186.0), (False, False, True), strict=True)
    ]
    return Ladder(rungs)


def make_analysis(world):
    bins, lags, horizon = {}, {}, {}
    for label in ("command", *world.runs):
        for column, joint in enumerate(world.joints):
            for against in ("velocity", "position", "load"):
                curve = _binned(world, label, column, against)
                bins.setdefault(label, {}).setdefault("position", {}).setdefault(joint, {})[against] = curve
            seconds = np.linspace(0.02, 0.5, 25)
            growth = {"command": 0.05, world.runs[0]: 0.035, world.runs[1]: 0.012}[label] * np.sqrt(seconds)
            curve = HorizonCurve(tuple(seconds), tuple(growth * (1 + column / 4)), "rad")
            horizon.setdefault(label, {}).setdefault("position", {})[joint] = curve
    for column, joint in enumerate(world.joints):
        lags.setdefault("command", {})[joint] = Lag(0.08 + 0.004 * column, 0.071 + 0.004 * column, 0.09)
        lags.setdefault(world.runs[0], {})[joint] = Lag(0.04, 0.036, 0.045)
        lags.setdefault(world.runs[1], {})[joint] = Lag(0.001 * column, -0.002, 0.004) if column < 2 else Lag(np.nan)
    return Analysis(bins, lags, horizon)


def _binned(world, label, column, against):
    columns = [[], []]
    for measured, command, simulated in world.series.values():
        series = command if label == "command" else simulated[label]
        columns[0].append(measured[{"load": "torque"}.get(against, against)][:, column])
        columns[1].append(np.abs(measured["position"][:, column] - series["position"][:, column]))
    x, error = (np.concatenate(parts) for parts in columns)
    edges = np.linspace(*np.quantile(x, [0.01, 0.99]), 13)
    rows = [error[(x >= low) & (x < high)] for low, high in itertools.pairwise(edges)]
    quartiles = np.array([np.quantile(row, [0.5, 0.25, 0.75]) if row.size else [np.nan] * 3 for row in rows])
    unit = {"velocity": "rad/s", "position": "rad", "load": "Nm"}[against]
    centers = tuple((edges[:-1] + edges[1:]) / 2)
    return BinnedCurve(centers, *(tuple(part) for part in quartiles.T), tuple(row.size for row in rows), unit, "rad")


def make_quality(world):
    flags = {
        world.names[0]: (Flag("repeated_stamps", detail="3 stamps occur twice.", severity="note"),),
        world.names[-2]: (
            Flag(
                "saturation",
                "measured",
                "torque",
                world.joints[1],
                "torque stays at 10.0 Nm for 1.4 s.",
                "warning",
                9.1,
                10.5,
            ),
            Flag(
                "frozen",
                "measured",
                "position",
                world.joints[2],
                "position does not move while it is commanded to.",
                "warning",
                12.0,
                14.0,
            ),
        ),
    }
    episodes = {
        name: EpisodeQuality(split, flags.get(name, ())) for name, split in zip(world.names, world.splits, strict=True)
    }
    dropped = EpisodeQuality("train", (Flag("failed", detail="the robot stopped after 0.4 s."),), dropped=True)
    return Quality({**episodes, "stopped_early": dropped})


def make_traces(world):
    traces = TraceSet(max_points=world.max_points)
    for (name, (measured, command, simulated)), split in zip(world.series.items(), world.splits, strict=True):
        traces.add(name, split, measured, command, simulated)
    return traces


def make_run(folder: Path, world: World | None = None) -> Path:
    """A run folder with every file that a report can show."""
    world = simulate(world or World())
    folder.mkdir(parents=True, exist_ok=True)
    gap = make_gap(world)
    gap.save(folder / "gap.json")
    make_ladder(world, gap).save(folder / "ladder.json")
    make_analysis(world).save(folder / "analysis.json")
    make_quality(world).save(folder / "quality.json")
    make_traces(world).save(folder)
    return folder
