"""Torque: how well gray box and inverse dynamics explain the torques of motions that they were not fitted to."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float64

from trueup.align import JointMap
from trueup.core.atomic import remove
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.graybox_result import GrayboxResult, Score
from trueup.core.provenance import provenance
from trueup.core.quality import left_out
from trueup.core.sole_writer import sole_writer
from trueup.core.torque_result import (
    RIVALS,
    TORQUE_METHODS,
    TORQUE_NAME,
    HeldOut,
    TorqueMethod,
    TorqueResult,
    TorqueSource,
)
from trueup.dataset import Dataset
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import DataError, MissingSignal, NotIdentifiable, OutputExists, TrueupError
from trueup.robots import RobotSpec
from trueup.stages.blocks import thinned
from trueup.stages.importing import dataset_of
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import model_file
from trueup.stages.torque_judging import SCALED, Judged

if TYPE_CHECKING:
    from trueup.identify.regression import InverseDynamicsFit
    from trueup.identify.regression.currents import Factor
    from trueup.identify.regression.torque_models import Learner, TorqueRobot

Folds = Sequence[tuple[set[str], set[str]]]
DYNAMICS_NAME = "dynamics.json"
_MOST_FOLDS = 10
_FEWEST_ROWS = 50


@dataclass(frozen=True)
class Explained:
    """What `torque` made.

    Attributes:
        result: errors on held-out motions.
        graybox: coefficients, fitted to all motions that may be fitted; None if it was not asked for or cannot be.
        dynamics: likewise, base parameters and bodies.
    """

    result: TorqueResult
    graybox: GrayboxResult | None = None
    dynamics: InverseDynamicsFit | None = None

    def save(self, folder: Path) -> None:
        """Write torque.json, graybox.json and dynamics.json; what an earlier call left of them is gone."""
        for name, own in (("graybox.json", self.graybox), (DYNAMICS_NAME, self.dynamics)):
            if own is None:
                remove(folder / name)
            else:
                own.save(folder / name)
        self.result.save(folder / TORQUE_NAME)


@dataclass(frozen=True, eq=False)
class _Asked:
    """The motions, what is judged, and how."""

    episodes: tuple[Episode, ...]
    robot: TorqueRobot
    source: TorqueSource
    held_out: HeldOut
    folds: Folds
    units: Mapping[str, str]
    left_out: Mapping[str, str]
    notes: tuple[str, ...]

    @property
    def fitted(self) -> list[Episode]:
        """Motions that coefficients in files are of: train, or all of them where each is held out in turn."""
        ids = set[str]().union(*(fitted for fitted, _ in self.folds))
        return [item for item in self.episodes if item.meta.id in ids]


def torque(
    source: Path | str,
    robot: RobotSpec,
    out: Path | str,
    *,
    methods: Sequence[TorqueMethod] = TORQUE_METHODS,
    model: Path | None = None,
    drop_flagged: bool | None = None,
    format: str | None = None,
    options: ImportOptions | None = None,
    overwrite: bool = False,
    track: Track = silent,
) -> Explained:
    """Fit joint torques and say how far off they are on motions that were not fitted.

    With splits, train is fitted and test judged (val where there is no test); without, each motion and its repetitions
    are predicted by what was fitted to the others, in ten parts at most. Beside the methods stand simple rivals on the
    same stamps. Writes torque.json, graybox.json and dynamics.json.

    Args:
        source: a dataset, or logs of any known format.
        robot: its description. Factors of currents are `torque_constant_nm_a`.
        out: folder for the results.
        methods: `graybox`, `dynamics`.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        drop_flagged: leave out motions with quality warnings; None leaves out those whose measurement is broken.
        format: of logs; detected if None.
        options: mapping file, units, topics of logs.
        overwrite: replace the results that are in `out`.
        track: shows progress.

    Raises:
        OutputExists: `out` holds results, and `overwrite` is not given.
        MissingSignal: no motion has a torque or a current.
        NotIdentifiable: there is one motion only, all torques are without a sign, or no method can be fitted.
        TrueupError: what an import or a method raises, if it is the only one.
    """
    out = Path(out)
    with sole_writer(out), contextlib.ExitStack() as stack:
        if (out / TORQUE_NAME).exists() and not overwrite:
            raise OutputExists(f"{out / TORQUE_NAME} exists", hint="Give --overwrite, or choose another --out.")
        dataset, notes = dataset_of(Path(source), stack, robot=robot, format=format, options=options, track=track)
        path = model_file(robot, dataset, given=model)
        asked = _asked(dataset, robot, path, methods, tuple(notes), drop_flagged=drop_flagged)
        origin = provenance(config={"methods": list(methods), "robot": robot.to_dict()}, data_hash=dataset.hash, seed=0)
        explained = _explained(asked, robot, tuple(methods), origin, track)
        explained.save(out)
        return explained


def _asked(
    dataset: Dataset,
    robot: RobotSpec,
    path: Path,
    methods: Sequence[TorqueMethod],
    notes: tuple[str, ...],
    *,
    drop_flagged: bool | None,
) -> _Asked:
    from trueup.identify.regression.currents import as_torque
    from trueup.identify.regression.torque_models import TorqueRobot, unsigned_joints
    from trueup.identify.segments import usable
    from trueup.sim import MujocoSimulator

    chosen = thinned(dataset, dataset.metas)
    if len(chosen) < len(dataset.ids):
        notes = (*notes, f"{len(chosen)} of {len(dataset.ids)} motions were used, spread over the dataset")
    readable, refused = _readable(dataset, robot, chosen)
    kept, flagged = usable({"the data": readable}, drop_flagged=drop_flagged)
    episodes = kept.get("the data", [])
    notes = (*notes, *left_out({"the data": refused}), *left_out(flagged))
    source = _source(episodes, robot)
    episodes = [item for item in episodes if source in (item.measured if source != "command" else ("command",))]
    scored, joints = robot.scored_joints, robot.joint_names
    if source == "current":
        factors = {name: own for name in joints if (own := robot.torque_constant_nm_a(name)) is not None}
        episodes = [as_torque(item, "current", factors) for item in episodes]
        currents = tuple(name for name in scored if name not in factors)
    else:
        factors, currents = {}, ()
    if source == "command":
        episodes = [_commanded_as_measured(item) for item in episodes]
    left: dict[str, str] = {
        name: f"no {source} was measured" for name in scored if not any(_measures(item, name) for item in episodes)
    }
    simulator = MujocoSimulator.from_robot(robot, path)
    judged = tuple(name for name in scored if name not in left)
    known = TorqueRobot(simulator.model, joints, judged, tuple(name for name in currents if name in judged))
    with contextlib.suppress(TrueupError):  # of what MuJoCo cannot invert, the gray box looks by itself
        left |= unsigned_joints(episodes, known)
    judged = tuple(name for name in judged if name not in left)
    if not judged:
        raise NotIdentifiable(
            f"no joint has a {source} that can be explained: {next(iter(left.values()), 'no joint is scored')}",
            hint="Log torques or currents with their sign.",
        )
    known = replace(known, judged=judged, currents=tuple(name for name in known.currents if name in judged))
    episodes = [as_torque(item, "torque", {}, unmeasured=known.unmeasured) for item in episodes]
    if "dynamics" in methods:
        episodes, more = _of_one_payload(episodes)
        notes = (*notes, *more)
    held_out, folds = _folds([item.meta for item in episodes])
    inside = set[str]().union(*(fitted | others for fitted, others in folds))
    units = {
        name: "A" if name in known.currents else {"m": "N"}.get(unit, "Nm")
        for name, unit in zip(episodes[0].measured.joints, episodes[0].measured.units["position"], strict=True)
    }
    return _Asked(
        episodes=tuple(item for item in episodes if item.meta.id in inside),
        robot=known,
        source=source,
        held_out=held_out,
        folds=folds,
        units=units,
        left_out=left,
        notes=notes,
    )


def _readable(dataset: Dataset, robot: RobotSpec, ids: Sequence[str]) -> tuple[list[Episode], dict[str, str]]:
    """Episodes in the robot's names, and why others cannot be read."""
    joint_map = JointMap.from_dict(robot.joint_rules())
    found, refused, first = [], {}, None
    for name in ids:
        try:
            found.append(joint_map.of_episode(dataset.episode(name)))
        except TrueupError as error:
            refused[name], first = error.summary, first or error
    if not found:
        raise first or DataError("the dataset has no episode", expected="at least one")
    return found, refused


def _source(episodes: Sequence[Episode], robot: RobotSpec) -> TorqueSource:
    """What stands for the torque: measured torques, else currents, else the torques that were commanded."""
    sources: tuple[Literal["torque", "current"], ...] = ("torque", "current")
    for signal in sources:
        if any(signal in item.measured and np.isfinite(item.measured[signal]).any() for item in episodes):
            return signal
    if robot.controller.signal == "torque" and any(
        item.command is not None and "torque" in item.command for item in episodes
    ):
        return "command"
    raise MissingSignal(
        "no motion has a measured torque or current",
        available=sorted({signal for item in episodes for signal in item.measured.signals}),
        hint="Log one of them, or say in a mapping which column it is.",
    )


def _commanded_as_measured(episode: Episode) -> Episode:
    """Of a robot that follows torques: those that were commanded, held to the measured stamps."""
    from trueup.identify.regression.samples import SampleSettings, gather

    values = gather([episode], SampleSettings(torque="command"), joints=episode.measured.joints).torque
    measured = episode.measured
    units = tuple("N" if unit == "m" else "Nm" for unit in measured.units["position"])
    return replace(
        episode,
        measured=replace(
            measured, signals={**measured.signals, "torque": values}, units={**measured.units, "torque": units}
        ),
    )


def _measures(episode: Episode, joint: str) -> bool:
    values = episode.measured["torque"][:, episode.measured.joints.index(joint)]
    return bool(np.isfinite(values).sum() >= _FEWEST_ROWS and np.nanmin(values) < np.nanmax(values))


def _of_one_payload(episodes: Sequence[Episode]) -> tuple[list[Episode], list[str]]:
    """The motions that carry what most of them carry: bodies of several weights are no one mechanism."""
    loads = [float(item.meta.payload_kg or 0.0) for item in episodes]
    most = max(sorted(set(loads)), key=loads.count)
    kept = [item for item, load in zip(episodes, loads, strict=True) if load == most]
    if len(kept) == len(episodes):
        return kept, []
    note = (
        f"only the {len(kept)} of {len(episodes)} motions with a payload of {most:g} kg are used, since inverse "
        "dynamics are of one mechanism; --method graybox takes all"
    )
    return kept, [note]


def _folds(metas: Sequence[EpisodeMeta]) -> tuple[HeldOut, Folds]:
    """What is fitted and what is predicted by it.

    Raises:
        NotIdentifiable: nothing can be held out, or nothing is left to fit.
    """
    of = {split: {meta.id for meta in metas if meta.split == split} for split in ("train", "val", "test")}
    judges: tuple[Literal["test", "val"], ...] = ("test", "val")
    for name in judges:
        if of["train"] and of[name]:
            return name, [(of["train"], of[name])]
    if (of["val"] or of["test"]) and not of["train"]:
        raise NotIdentifiable("no motion of train can be used, and nothing can be fitted", got=len(metas))
    own = [meta for meta in metas if meta.split == "train" or not of["train"]]
    executed = list(dict.fromkeys(meta.executed for meta in own))
    if len(executed) < 2:
        raise NotIdentifiable(
            "no motion can be held out: there is only one, or repetitions of one",
            got=f"{len(own)} recordings",
            expected="at least two different motions",
            hint="Record more motions, or take a long one apart with `split` in a mapping.",
        )
    groups = [executed[number::_MOST_FOLDS] for number in range(min(_MOST_FOLDS, len(executed)))]
    every = {meta.id for meta in own}
    held = [{meta.id for meta in own if meta.executed in group} for group in groups]
    return "folds", [(every - others, others) for others in held]


def _explained(
    asked: _Asked, robot: RobotSpec, methods: Sequence[TorqueMethod], origin: Mapping[str, Any], track: Track
) -> Explained:
    from trueup.identify.regression import torque_models as models
    from trueup.identify.regression.graybox import GrayboxSettings
    from trueup.identify.regression.inverse_dynamics import InverseDynamicsSettings

    own, left = asked.robot, dict(asked.left_out)
    limits = {joint.name: joint.torque_limit for joint in robot.joints if joint.torque_limit is not None}
    settings = GrayboxSettings(
        torque_limits={name: limit for name, limit in limits.items() if name not in own.currents},
        kp_setting=robot.controller.kp_setting,
        follows=robot.controller.signal,
    )
    dynamics_settings = InverseDynamicsSettings(epsilon=own.epsilon)
    learners: dict[str, Learner] = {
        "mean": models.learn_mean(own),
        "simple": models.learn_simple(own),
        "model": models.learn_model(own),
        "graybox": models.learn_graybox(own, settings),
        "dynamics": models.learn_dynamics(own, dynamics_settings),
    }
    if asked.source == "command":
        left["graybox"] = "no torque was measured, and the commanded one is what it would be explained by"
        methods = [name for name in methods if name != "graybox"]
    predicted: dict[str, dict[str, Float64[np.ndarray, "T J"]]] = {}
    errors: list[TrueupError] = []
    for name in track([*RIVALS, *methods], "fitting", len(RIVALS) + len(methods)):
        try:
            predicted[name] = models.held_out_predictions(asked.episodes, asked.folds, learners[name])
        except TrueupError as error:
            left[name] = error.what
            if name in methods:
                errors.append(error)
    done = tuple(name for name in methods if name in predicted)
    if not done:
        raise errors[0] if errors else NotIdentifiable(f"nothing can be fitted: {left['graybox']}")
    factors: Mapping[str, Factor] = {}
    graybox = fitted = None
    if "graybox" in done:
        graybox, _ = models.graybox_of(asked.fitted, own, settings)
        graybox = replace(_in_amperes(graybox, own.currents, robot.controller.signal), provenance=origin)
    if "dynamics" in done:
        fitted, _, factors = models.dynamics_of(asked.fitted, own, dynamics_settings)
    elif own.currents and "model" in predicted:
        _, factors = models.in_torque(own, asked.fitted)
    judged = Judged(asked.episodes, own.judged, own.joints, asked.units, predicted)
    result = judged.result(asked.source, asked.held_out, robot, done, factors=factors, left_out=left, notes=asked.notes)
    if fitted is not None and own.currents:
        fitted = replace(fitted, notes=(*fitted.notes, SCALED))
    return Explained(replace(result, provenance=origin), graybox, fitted)


def _in_amperes(graybox: GrayboxResult, currents: Sequence[str], follows: str) -> GrayboxResult:
    """The same with the units of what was a current."""

    def unit(text: str) -> str:
        if text == "1" and follows == "torque":
            return "A/Nm"
        head, slash, rest = text.partition("/")
        return ("A" + head.removeprefix("Nm").removeprefix("N")) + slash + rest

    def block(item: Any) -> Any:
        coefficients = {name: replace(own, unit=unit(own.unit)) for name, own in item.coefficients.items()}
        return replace(
            item,
            coefficients=coefficients,
            splits={split: score(own) for split, own in item.splits.items()},
            payloads={
                split: {load: score(own) for load, own in loads.items()} for split, loads in item.payloads.items()
            },
        )

    def score(item: Score) -> Score:
        return replace(item, rmse=replace(item.rmse, unit="A"), reduction=replace(item.reduction, unit="A"))

    if not currents:
        return graybox
    joints = {
        name: replace(joint, blocks=tuple(map(block, joint.blocks))) if name in currents else joint
        for name, joint in graybox.joints.items()
    }
    total = tuple(map(block, graybox.total)) if set(currents) == set(graybox.joints) else ()
    return replace(graybox, joints=joints, total=total)
