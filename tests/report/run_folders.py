"""Run folders as a comparison would write them: a robot with delay and friction, and two simulators of it."""

import itertools
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trueup.core.analysis import Analysis, BinnedCurve, HorizonCurve, Lag
from trueup.core.atomic import write_json
from trueup.core.attribution import Attribution, AttributionCause
from trueup.core.close_result import CloseResult, Step
from trueup.core.episode import Flag
from trueup.core.fit_result import Direction, FitResult, FittedParameter, ModelRow, Whiteness
from trueup.core.model_card import Input, ModelCard, Output
from trueup.core.quality import EpisodeQuality, Quality
from trueup.core.results import Estimate, GapResult, Ladder, MetricResult, PairedDifference, Rung
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.traces import TraceSet

UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
STEP_S = 0.02


@dataclass
class World:
    """What `make_run` writes; tests change a copy of it.

    The first two runs are simulators, further ones come nearer and nearer to the second one's robot.
    """

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
        shares = np.linspace(0.0, 0.6, len(world.runs) - 1)[1:]
        corrected = [fitted + share * (measured - fitted) for share in shares]
        runs = dict(zip(world.runs, (stock, fitted, *corrected), strict=True))
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
    compared = [(label, "command") for label in world.runs] + [(label, world.runs[0]) for label in world.runs[1:]]
    compared += [(label, base) for label in world.runs[2:] if (base := label.rpartition("+")[0]) != world.runs[0]]
    for run, baseline in compared:
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
    """A rung for every run; the last one is chosen."""
    labels = ("command", *world.runs)
    return Ladder(
        [
            Rung(
                label.split("/")[-1].removeprefix("stock+"),
                seconds,
                {split: gap.runs[label][split] for split in ("train", "val", "test")},
                chosen=label == labels[-1],
            )
            for label, seconds in zip(labels, (0.02, 3.1, 186.0, 190.0, 230.0, 260.0, 290.0), strict=False)
        ]
    )


def make_analysis(world):
    bins, lags, horizon = {}, {}, {}
    for label in ("command", *world.runs):
        for column, joint in enumerate(world.joints):
            for against in ("velocity", "position", "load"):
                curve = _binned(world, label, column, against)
                bins.setdefault(label, {}).setdefault("position", {}).setdefault(joint, {})[against] = curve
            seconds = np.linspace(0.02, 0.5, 25)
            growth = {"command": 0.05, world.runs[0]: 0.035}.get(label, 0.012) * np.sqrt(seconds)
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


# quantity -> unit, cause, transform, what the model said, what the robot has, bounds, what would show it
FITTED = {
    "delay_s": ("s", "delay", "linear", 0.0, 0.02, (0.0, 0.2), "let {} start and reverse quickly"),
    "kp": ("Nm/rad", "gains", "log", 60.0, 31.0, (0.12, 30000.0), "load {} by gravity in several poses"),
    "damping": ("Nm s/rad", "friction", "log", 0.4, 0.9, (0.004, 40.0), "let {} pass through its range of speeds"),
    "frictionloss": ("Nm", "friction", "log", 0.05, 0.3, (0.0005, 5.0), "let {} creep, stop and reverse"),
    "load": ("1", "friction", "linear", 0.0, 0.0, (0.0, 5.0), "move {} in poses with small and large load"),
    "torque_offset": ("Nm", "gravity", "linear", 0.0, -0.2, (-50.0, 50.0), "move {} slowly in both directions"),
    "armature": ("kg m2", "inertia", "log", 0.01, 0.02, (0.0001, 1.0), "accelerate {} harder"),
}
_SENTENCES = {
    "yes": "determined by the data",
    "weakly": "weakly determined: {}",
    "no": "not identifiable from these motions: {}",
}


def fitted_parameter(quantity, target, identified="yes", *, at_bound="", frozen=False, factor=1.0):
    """One parameter as `trueup identify` reports it; its interval grows as the data say less."""
    unit, cause, transform, nominal, value, (low, high), excite = FITTED[quantity]
    wide = {"yes": 0.08, "weakly": 0.7, "no": 3.0}[identified]
    value = {"low": low, "high": high}.get(at_bound, value * factor)
    reach = wide * max(abs(value), 0.05)
    ends = (value * np.exp(-wide), value * np.exp(wide)) if transform == "log" else (value - reach, value + reach)
    sentence = _SENTENCES[identified].format(excite.format(target or "the robot"))
    if at_bound:
        edge = "low" if at_bound == "low" else "high"
        sentence = "fitted as zero: the data show none of it" if value == 0 else f"ended on its {edge} bound: widen it"
    if frozen:
        identified, value, ends, sentence = "no", nominal, (nominal, nominal), "kept at its value, not fitted"
    return FittedParameter(
        name=f"{quantity}[{target}]" if target else quantity,
        value=float(value),
        unit=unit,
        nominal=nominal,
        start=nominal,
        low=low,
        high=high,
        interval=tuple(float(min(max(end, low), high)) for end in ends),
        at_bound=at_bound,
        identified=identified,
        prior_share={"yes": 0.01, "weakly": 0.4, "no": 0.9}[identified],
        sentence=sentence,
        cause=cause,
        transform=transform,
        frozen=frozen,
    )


def fit_parameters(joints, status="ok"):
    """Seven quantities of every joint; how sure they are follows from the status."""
    found = []
    for quantity in FITTED:
        for number, joint in enumerate(joints):
            sure, bound = "yes", "low" if quantity == "load" and number else ""
            if status != "ok" and quantity in ("damping", "armature"):
                sure = "weakly" if number == 0 else "no"
            if status == "at-bound" and quantity == "kp" and number == 0:
                bound = "high"
            frozen = quantity == "torque_offset" and number == len(joints) - 1
            item = fitted_parameter(quantity, joint, sure, at_bound=bound, frozen=frozen, factor=1 + 0.1 * number)
            found.append(item)
    return tuple(found)


_STATEMENTS = {
    "ok": (),
    "not-identifiable": ("4 of 21 parameters are not determined by these motions: {0}; their values are the prior's",),
    "at-bound": ("ended on a bound: kp[{0}] = 3e+04 Nm/rad",),
    "not-converged": ("the fit stopped before it converged (out of iterations): run longer, or with --resume",),
    "no-better": ("the fitted model is no better than the original one on val; is this the log of another robot?",),
}


def make_fit(joints, status="ok", parameters=None):
    """A fit of any status, with two models that were tried and what is left of every joint."""
    parameters = fit_parameters(joints, status) if parameters is None else tuple(parameters)
    names = [item.name for item in parameters if not item.frozen]
    after = 1.1 if status == "no-better" else 0.4
    nominal = {
        split: Estimate(0.04 * size, "rad", 0.02, 0.09) for split, size in (("train", 1), ("val", 1.1), ("test", 1.2))
    }
    # two motions: the interval of a mean reaches below zero
    errors = {
        name: {
            split: Estimate(item.value * after * size, "rad", -0.01 if split == "val" else 0.005, item.value)
            for split, item in nominal.items()
        }
        for name, size in (("base", 1.2), ("load", 1.0))
    }
    models = tuple(
        ModelRow(
            name=name,
            quantities=("delay_s", "kp", "frictionloss") + (("load",) if name == "load" else ()),
            parameters=13 + 8 * number,
            seconds=33.0 - number,
            splits=errors[name],
            per_joint={
                split: {joint: item.value * (0.8 + 0.4 * place) for place, joint in enumerate(joints)}
                for split, item in errors[name].items()
            },
            chosen=name == "load",
        )
        for number, name in enumerate(errors)
    )
    open_ = status != "ok" and len(names) > 1
    pairs = {name: {} for name in names}
    if open_:
        pairs[names[0]][names[1]] = pairs[names[1]][names[0]] = -0.96
    return FitResult(
        status=status,
        statements=tuple(text.format(joints[0]) for text in _STATEMENTS[status]),
        solver={
            "name": "gauss-newton",
            "why": "the robot follows position",
            "stop": "converged",
            "iterations": 8,
            "evaluations": 238,
            "seconds": 31.6,
        },
        parameters=parameters,
        correlation=pairs,
        directions=(Direction(0.0, {names[0]: 1.0}), Direction(4.2, {names[1]: 0.8, names[0]: -0.6})) if open_ else (),
        whiteness={
            joint: Whiteness(
                0.003 * (number + 1),
                0.2 * number,
                number == 0,
                f"{joint}: what is left looks like noise" if number == 0 else f"{joint}: what is left is model error",
            )
            for number, joint in enumerate(joints)
        },
        models=models,
        errors={"nominal": nominal, "fitted": errors["load"]},
        data={
            "episodes": ["chirp", "steps"],
            "seconds": 20.0,
            "window_s": None,
            "samples": 6000,
            "flagged": {"train": {"square_wave": "saturation"}},
            "refused": {},
        },
        provenance={
            "trueup": "0.1.0",
            "seed": 0,
            "config": {"robot": {"name": "so101"}, "identify": {"fit": {"kp": "all"}}},
        },
    )


def many_parameters(joints=29):
    """117: four of each joint of a humanoid, and a payload."""
    names = [f"joint_{number:02}" for number in range(joints)]
    kinds = ("yes", "yes", "weakly", "no")
    found = [
        fitted_parameter(quantity, name, kinds[number % 4])
        for quantity in ("kp", "damping", "frictionloss", "armature")
        for number, name in enumerate(names)
    ]
    return (*found, fitted_parameter("torque_offset", ""))


def make_attribution(joints):
    """Gravity makes the second joint worse; 8 % stay unexplained."""
    causes = {
        "delay": ("delay", ("delay_s",), 0.19),
        "gains": ("gains", ("kp",), 0.32),
        "friction": ("friction", ("damping", "frictionloss"), 0.3675),
        "gravity": ("gravity or payload", ("torque_offset",), 0.0325),
        "inertia": ("inertia", ("armature",), 0.0116),
    }
    shares = {}
    for place, joint in enumerate(joints):
        own = {cause: share for cause, (*_, share) in causes.items()}
        own["gravity"] -= 0.17 if place == 1 else 0.0
        shares[joint] = {**own, "unexplained": 1.0 - sum(own.values())}
    total = {cause: share for cause, (*_, share) in causes.items()}
    return Attribution(
        split="test",
        unit="rad",
        before=Estimate(0.04, "rad", 0.03, 0.05),
        after=Estimate(0.0112, "rad", 0.0084, 0.014),
        causes=tuple(AttributionCause(name, label, own, 3 * len(own)) for name, (label, own, _) in causes.items()),
        shares=shares,
        shares_total={**total, "unexplained": 1.0 - sum(total.values())},
        statements=("scored on 3 test motions",),
        provenance={"seed": 0},
    )


def make_graybox(joints):
    """graybox.json as the regression writes it: two payloads, one block that could not be fitted on the last joint."""

    def score(value, reduction, motions):
        rmse = {"value": value, "low": 0.9 * value, "high": 1.1 * value, "unit": "Nm"}
        ends = {"low": reduction - 0.01, "high": reduction + 0.01}
        return {
            "rmse": rmse,
            "reduction": {"value": reduction, "unit": "Nm", **ends},
            "motions": motions,
            "samples": 900,
        }

    blocks = []
    for block, value, reduction in (
        ("pd", 0.5, 1.2),
        ("friction", 0.3, 0.2),
        ("payload", 0.31, -0.01),
        ("posture", 0.1, 0.21),
    ):
        payloads = {"0": score(0.8 * value, 0.8 * reduction, 2), "1.5": score(1.2 * value, 1.2 * reduction, 2)}
        blocks.append(
            {
                "block": block,
                "left_out": "",
                "coefficients": {"K_p": {"unit": "Nm/rad", "value": 40.0}},
                "splits": {"train": score(0.9 * value, reduction, 4), "test": score(value, reduction, 4)},
                "payloads": {"train": payloads, "test": payloads},
            }
        )
    short = [{**blocks[0]}, {**blocks[1], "left_out": "the joint never moved", "splits": {}, "payloads": {}}]
    about = {"interval_method": "cluster", "motions": 4, "samples": 900, "notes": []}
    fits = {joint: {"blocks": blocks if joint != joints[-1] else short, **about} for joint in joints}
    return {"schema": "trueup.graybox/1", "joints": fits, "settings": {}, "notes": ["payload not recorded in 1 motion"]}


def add_identification(folder: Path, fit, joints) -> Path:
    """What `trueup identify`, `trueup gap --explain` and the gray-box regression leave in a run folder."""
    fit.save(folder / "fit.json")
    make_attribution(joints).save(folder / "explain.json")
    write_json(folder / "graybox.json", make_graybox(joints))
    (folder / "robot.fitted.yaml").write_text("schema: trueup.robot/1\n")
    entry = {
        "stiffness": 31.0,
        "damping": 1.5,
        "armature": 0.02,
        "friction": 0.3,
        "dynamic_friction": 0.3,
        "viscous_friction": 0.9,
        "effort_limit": 12.0,
        "delay_s": 0.02,
    }
    # A YAML file too.
    (folder / "isaac.actuators.yaml").write_text(json.dumps({"actuators": dict.fromkeys(joints, entry)}))
    (folder / "model.fitted.xml").write_text("<mujoco><worldbody/></mujoco>")
    np.savez(folder / "fit.samples.npz", **{item.name: np.zeros(3) for item in fit.parameters})
    return folder


# What a close with all networks leaves: many rungs, with long names.
CLOSE_RUNS = (
    "mujoco/stock",
    "mujoco/fitted",
    "mujoco/stock+moving-average",
    "mujoco/fitted+moving-average",
    "mujoco/fitted+realeasy-rt",
    "mujoco/fitted+realeasy",
)
STEPS = (
    Step("import", "done", 1.2, "8 motions"),
    Step("replay", "kept", 3.1, "8 motions simulated with the original model"),
    Step("gap", "done", 2.0, "position rmse 0.0407 rad on test"),
    Step("explain", "failed", 0.4, "nothing was moved that could be fitted"),
    Step("identify", "cut short", 186.0, "17 of 21 parameters determined, status ok, model 'load'"),
    Step("augment", "done", 90.0, "fitted+realeasy-rt: 6 of 9 corrections help on val"),
)


def make_card(name, joints, *, causal=True):
    """A network that reads positions and velocities and corrects positions; nothing of it but its card."""
    signals = (("position", "rad"), ("velocity", "rad/s"))
    inputs = tuple(Input(signal, joint, unit, low=-2.0, high=2.0) for signal, unit in signals for joint in joints)
    outputs = tuple(Output("position", joint, "rad", base=place) for place, joint in enumerate(joints))
    return ModelCard(name, name, "SO-101", tuple(joints), CLOSE_RUNS[1], 50.0, causal, inputs, outputs)


def make_close(folder: Path, status="not-identifiable") -> Path:
    """A folder as `trueup close` leaves it, after all its steps."""
    world = World(runs=CLOSE_RUNS, samples=600)
    make_run(folder, world)
    add_identification(folder, make_fit(world.joints, status), world.joints)
    networks = {label: f"networks/{label.split('/')[1].replace('+', '/')}" for label in CLOSE_RUNS[2:]}
    for label, name in networks.items():
        (folder / name).mkdir(parents=True)
        make_card(label.rpartition("+")[2], world.joints, causal=label.endswith("rt")).save(folder / name)
    CloseResult(STEPS, "augment", budget_s=900.0, networks=networks).save(folder / "close.json")
    return folder
