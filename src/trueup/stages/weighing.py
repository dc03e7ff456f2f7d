"""Payload: motions without and with something in a robot's hand, and a model, in; its mass and center of mass out."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from trueup.core.atomic import write_text
from trueup.core.episode import Episode
from trueup.core.fit_result import FitResult
from trueup.core.npz import read_arrays
from trueup.core.payload_result import PAYLOAD_NAME, HeldOut, PayloadResult, Way, Weighed
from trueup.core.provenance import provenance
from trueup.core.quality import left_out
from trueup.core.sole_writer import writes_alone
from trueup.dataset import Dataset, is_dataset
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError, DataError, NameMismatch, NotIdentifiable, OutputExists, TrueupError
from trueup.robots import RobotSpec, load_robot
from trueup.robots.written import robot_yaml
from trueup.stages.checking import check_setup, refuse_wrong
from trueup.stages.importing import dataset_of
from trueup.stages.motions import motions_of
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    import mujoco

    from trueup.identify import IdentifyConfig, OnModel
    from trueup.identify.payload import Load

# Folders in that of the results: the fit without the payload, the model with it.
FREE, LOADED = "free", "loaded"
_Z95 = 1.959964
# A mass is determined if half of its interval is at most this share of it, or of the mass of the links that bear it.
_OF_MASS, _OF_LINKS = 0.5, 0.05
# Half of the interval of a center that is determined [m].
_SEEN_M = 0.03
# Motion with the payload that is simulated per candidate [s].
_BUDGET_S = 60.0
# One motion of so many is held out.
_HELD_OUT = 4
# So many times the error that the fit leaves without the payload is more than the payload can be about.
_OTHERWISE = 2.0
_FEWEST_SAMPLES = 100
_UNUSABLE = ("no-better", "not-converged")


@dataclass(frozen=True)
class _Logs:
    """Motions of one kind, in the robot's names, and their dataset."""

    dataset: Dataset
    by_split: dict[str, list[Episode]]
    notes: tuple[str, ...]

    @property
    def all(self) -> list[Episode]:
        return [log for own in self.by_split.values() for log in own]


@dataclass(frozen=True, eq=False)
class _Fitted:
    """The robot without a payload, as it was fitted."""

    result: FitResult
    samples: Mapping[str, np.ndarray]
    robot: RobotSpec
    model: Path

    @staticmethod
    def read(folder: Path) -> _Fitted:
        """What `save_identification` has written."""
        from trueup.identify.export import ROBOT_FILE, SAMPLES_FILE

        robot, fit = load_robot(folder / ROBOT_FILE), FitResult.load(folder / "fit.json")
        samples = read_arrays(folder / SAMPLES_FILE)
        missing = [item.name for item in fit.free if samples.get(item.name, np.empty(0)).ndim != 1]
        missing += [item.name for item in fit.free if samples.get(item.name, np.empty(0)).size < _FEWEST_SAMPLES]
        if missing:
            raise DataError(
                f"{folder / SAMPLES_FILE} lacks numbers of fit.json",
                got=", ".join(dict.fromkeys(missing)),
                hint="Give the folder as `trueup identify` has left it.",
            )
        return _Fitted(fit, samples, robot, folder / robot.model)


@writes_alone()
def payload(
    free: Path | str,
    loaded: Path | str,
    robot: RobotSpec,
    *,
    out: Path | None = None,
    at: str = "",
    fit: Path | None = None,
    model: Path | None = None,
    config: IdentifyConfig | None = None,
    format: str | None = None,
    options: ImportOptions | None = None,
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    force: bool = False,
    track: Track = silent,
    on_begin: Callable[[], None] = lambda: None,
    on_progress: OnModel | None = None,
) -> PayloadResult:
    """Weigh what a robot carries.

    The motions without it are fitted as `fit` would, then those with it, with what is known of the robot by then
    (`identify.payload.weigh`). Where all logs hold torques or currents, these are compared with the model's inverse
    dynamics, too. Some motions with the payload are held out whole: those of the split `test`, or every fourth one.

    Args:
        free: motions with nothing in the hand: a dataset, or logs of any known format.
        loaded: motions with the payload.
        robot: its description.
        out: folder for payload.json, the fit without the payload (`free`), and the model with it (`loaded`); nothing
            is kept if None.
        at: body or site of the model that carries it; the site `payload`, or the last body, if empty.
        fit: folder of an earlier fit of the motions without a payload, which is not made again.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        config: what to fit without the payload, and how; the default for the robot's controller if None.
        format: of logs; detected if None.
        options: mapping file, units, topics of logs.
        seed: of all draws.
        jobs: threads; the number of cores if None.
        overwrite: replace what is in `out`.
        force: go on even if the check of the set-up is certain that something is wrong.
        track: shows progress of imports.
        on_begin: called when the search begins.
        on_progress: called after every iteration of the fit.

    Raises:
        OutputExists: `out` holds something.
        ConfigError: both are the same recordings, or nothing that moves is called `at`.
        NameMismatch: the joints of logs, robot and fit do not agree.
        DataError: one of them holds no motion.
        TrueupError: what an import or a fit raises.
    """
    from trueup.identify import IdentifyConfig, Nominal
    from trueup.identify.payload import weigh, within

    free, loaded, jobs = Path(free), Path(loaded), jobs or os.cpu_count() or 1
    if free.resolve() == loaded.resolve():
        raise ConfigError(
            "the recordings without and with the payload are the same",
            got=str(free),
            expected="two folders or files: FREE without anything in the hand, LOADED with it",
        )
    if out is not None and any(out.iterdir()):
        if not overwrite:
            raise OutputExists(f"{out} is not empty", hint="Give --overwrite, or choose another --out.")
        for name in (FREE, LOADED):
            shutil.rmtree(out / name, ignore_errors=True)
    with contextlib.ExitStack() as stack:
        whole = [_logs(path, stack, robot, format, options, track) for path in (free, loaded)]
        empty, full = _without(whole[0], robot), _with(whole[1])
        path = model_file(robot, empty.dataset, given=model)
        _refuse_place(robot, path, at)
        fitted_logs, held = _held_out(full)
        folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="trueup-")))
        if fit is not None:
            known = _read_fit(Path(fit), robot)
        else:
            notes = _checked(empty.dataset, robot, path, force=force)
            empty = replace(empty, notes=(*empty.notes, *notes))
            on_begin()
            known = _fit(empty, robot, path, folder / FREE, config, jobs=jobs, seed=seed, on_progress=on_progress)
        chosen = within(replace(config or IdentifyConfig(), fit={}, models=None), _BUDGET_S)
        load = weigh(
            *(known.result, known.samples, known.robot, known.model, fitted_logs),
            at=at,
            config=chosen,
            jobs=jobs,
            seed=seed,
        )
        nominal = Nominal(known.robot, known.model, hard_friction=False, payload_at=at)
        body, _ = nominal.payload_place
        frame = _Frame.of(nominal.model, body, at)
        most_kg = _OF_LINKS * _bearing_kg(nominal.model, body)
        ways: dict[Way, Weighed] = {"motion": _weighed(load.mass, load.center, load.covariance, frame, most_kg)}
        torque, torque_notes = _by_torque(known, body, empty.all, fitted_logs, frame, most_kg)
        if torque is not None:
            ways["torque"] = torque
        errors = None
        if held:
            without, with_it = load.errors(held, chosen, jobs=jobs, seed=seed)
            errors = HeldOut(tuple(log.id for log in held), without, with_it)
        best = min(ways, key=lambda way: (not ways[way].determined, float(np.ptp(ways[way].interval_kg))))
        doubts, fatal = _doubts(known.result, load, ways, best, errors, whole[1].all)
        result = PayloadResult(
            determined=ways[best].determined and not fatal,
            best=best,
            ways=ways,
            body=body,
            frame=at or body,
            held_out=errors,
            doubts=(*fatal, *doubts),
            notes=(*empty.notes, *full.notes, *torque_notes),
            motions={FREE: len(empty.all), LOADED: len(fitted_logs)},
            provenance=provenance(
                config={
                    "robot": robot.to_dict(),
                    "model": path.name,
                    "at": at,
                    "fit": None if fit is None else str(fit),
                },
                seed=seed,
                data_hash=full.dataset.hash,
            ),
        )
        if out is not None:
            _save_loaded(load, out / LOADED)
            result.save(out / PAYLOAD_NAME)
        return result


def _logs(
    path: Path,
    stack: contextlib.ExitStack,
    robot: RobotSpec,
    format: str | None,
    options: ImportOptions | None,
    track: Track,
) -> _Logs:
    if not path.exists():
        raise DataError(f"there are no recordings at {path}", expected="a dataset, or logs of any known format")
    plain = is_dataset(path)
    dataset, refused = dataset_of(
        path, stack, robot=robot, format=None if plain else format, options=None if plain else options, track=track
    )
    if not dataset.ids:
        raise DataError(f"{path} holds no motion", expected="at least one", hint="Record or import some first.")
    found = motions_of(dataset, robot)
    from trueup.identify.segments import usable

    logs, flagged = usable(found.by_split, drop_flagged=None)
    if not any(logs.values()):
        raise NotIdentifiable(f"{path} holds no motion that can be used", got="; ".join(left_out(flagged)) or None)
    return _Logs(dataset, logs, (*refused, *left_out(found.refused), *left_out(flagged)))


def _without(logs: _Logs, robot: RobotSpec) -> _Logs:
    """Motions of which nobody says that something is carried, unless the robot's description says where."""
    kept = {
        split: [log for log in own if not log.meta.payload_kg or robot.payload] for split, own in logs.by_split.items()
    }
    count = len(logs.all) - sum(map(len, kept.values()))
    if not kept.get("train"):
        raise DataError(
            f"{logs.dataset.path} holds no motion without a payload to fit",
            got=f"payload_kg above 0 in {count} motions",
            hint="Give the recordings with nothing in the hand first, those with the payload second.",
        )
    note = f"{count} motions of {logs.dataset.path.name} carry a payload, by their payload_kg, and are left out"
    return _kept(logs, kept, note if count else "")


def _kept(logs: _Logs, by_split: Mapping[str, list[Episode]], note: str) -> _Logs:
    by_split = {split: own for split, own in by_split.items() if own}
    return replace(logs, by_split=by_split, notes=(*logs.notes, *filter(None, [note])))


def _with(logs: _Logs) -> _Logs:
    """Motions with something unknown: what was noted of its mass must not be simulated."""
    unknown = {
        split: [replace(log, meta=replace(log.meta, payload_kg=None)) for log in own if log.meta.payload_kg != 0.0]
        for split, own in logs.by_split.items()
    }
    count = len(logs.all) - sum(map(len, unknown.values()))
    if not any(unknown.values()):
        raise DataError(
            f"{logs.dataset.path} holds no motion with a payload",
            got=f"payload_kg 0 in {count} motions",
            hint="Give the recordings with nothing in the hand first, those with the payload second.",
        )
    note = f"{count} motions of {logs.dataset.path.name} carry nothing, by their payload_kg, and are left out"
    return _kept(logs, unknown, note if count else "")


def _held_out(logs: _Logs) -> tuple[list[Episode], list[Episode]]:
    """Motions that are fitted, and those that are not: the split `test`, or every fourth one."""
    test = logs.by_split.get("test", [])
    fitted = [log for split, own in logs.by_split.items() if split != "test" for log in own]
    if test and fitted:
        return fitted, test
    every = logs.all
    rows = range(_HELD_OUT - 1, len(every), _HELD_OUT) if len(every) >= _HELD_OUT else [len(every) - 1]
    held = [every[row] for row in rows] if len(every) > 1 else []
    return [log for log in every if log not in held], held


def _refuse_place(robot: RobotSpec, model: Path, at: str) -> None:
    """Before the fit: an hour of it would not make the name right."""
    from trueup.identify import Nominal

    _ = Nominal(robot, model, payload_at=at).payload_place


def _checked(dataset: Dataset, robot: RobotSpec, model: Path, *, force: bool) -> list[str]:
    if force:
        return []
    checked = check_setup(dataset, robot, model=model)
    refuse_wrong(checked)
    return [f"{item.severity}: {item.evidence}" for item in checked.findings if item.severity == "likely"]


def _read_fit(folder: Path, robot: RobotSpec) -> _Fitted:
    if not (folder / "fit.json").is_file():
        raise ConfigError(f"{folder} holds no fit", expected="the folder that `trueup identify` has written (--out)")
    found = _Fitted.read(folder)
    if found.robot.joint_names != robot.joint_names:
        raise NameMismatch(
            "the fit is of another robot",
            left=found.robot.joint_names,
            right=robot.joint_names,
            left_name="fit of",
            right_name="robot",
        )
    return found


def _fit(
    logs: _Logs,
    robot: RobotSpec,
    model: Path,
    folder: Path,
    config: IdentifyConfig | None,
    *,
    jobs: int,
    seed: int,
    on_progress: OnModel | None,
) -> _Fitted:
    from trueup.identify import identify, judged, rehearse, save_identification

    robot = judged(robot, config)
    rehearse(robot, model, config)
    found = identify(
        logs.by_split,
        robot,
        model,
        config=config,
        jobs=jobs,
        seed=seed,
        data_hash=logs.dataset.hash,
        on_progress=on_progress,
    )
    folder.mkdir(parents=True, exist_ok=True)
    save_identification(found, folder, seed=seed)
    return _Fitted.read(folder)


@dataclass(frozen=True, eq=False)
class _Frame:
    """Where the center is seen from, in the frame of the body: an origin, (3,) [m], and axes in columns, (3, 3)."""

    origin: Float64[np.ndarray, "3"]
    axes: Float64[np.ndarray, "3 3"]

    @staticmethod
    def of(model: mujoco.MjModel, body: str, at: str) -> _Frame:
        if at in ("", body):
            return _Frame(np.zeros(3), np.eye(3))
        site, axes = model.site(at), np.empty(9)
        import mujoco

        mujoco.mju_quat2Mat(axes, site.quat)
        return _Frame(np.array(site.pos), axes.reshape(3, 3))


def _bearing_kg(model: mujoco.MjModel, body: str) -> float:
    """Mass of the moving links from the base to the body that carries [kg]."""
    number, total = int(model.body(body).id), 0.0
    while number:
        total += float(model.body_mass[number]) * (model.body_weldid[number] > 0)
        number = int(model.body_parentid[number])
    return total


def _weighed(
    mass: float,
    center: Float64[np.ndarray, "3"],
    covariance: Float64[np.ndarray, "4 4"],
    frame: _Frame,
    most_kg: float,
    notes: tuple[str, ...] = (),
) -> Weighed:
    """Intervals of an estimate of mass and center in the frame of the body."""
    reach = _Z95 * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    seen_from = frame.axes.T @ (center - frame.origin)
    wide = _Z95 * np.sqrt(np.maximum(np.diag(frame.axes.T @ covariance[1:, 1:] @ frame.axes), 0.0))
    low, high = max(0.0, mass - float(reach[0])), max(0.0, mass + float(reach[0]))
    x, y, z = map(float, seen_from)
    a, b, c = (bool(own <= _SEEN_M) and low > 0.0 for own in wide)
    return Weighed(
        mass_kg=max(0.0, mass),
        interval_kg=(low, high),
        determined=bool(reach[0] <= max(_OF_MASS * mass, most_kg)),
        center_m=(x, y, z),
        center_interval_m=tuple((float(at - own), float(at + own)) for at, own in zip(seen_from, wide, strict=True)),
        center_seen=(a, b, c),
        notes=(*notes, *(("it came out below zero",) if mass + reach[0] < 0.0 else ())),
    )


def _by_torque(
    known: _Fitted, body: str, free: Sequence[Episode], loaded: Sequence[Episode], frame: _Frame, most_kg: float
) -> tuple[Weighed | None, tuple[str, ...]]:
    """By what the logs hold of torques; why not, where they do not."""
    import mujoco

    from trueup.identify.regression.payload_torques import torque_signal, weigh_by_torque

    robot = known.robot
    try:
        signal = torque_signal([*free, *loaded], torque_driven=robot.controller.signal == "torque")
        found = weigh_by_torque(
            mujoco.MjModel.from_xml_path(str(known.model)),
            body,
            free,
            loaded,
            signal=signal,
            joints=robot.scored_joints,
            delay_s=float(np.median(robot.replay_delay_s)),
        )
    except TrueupError as error:
        return None, (f"torques were not compared: {error.summary}",)
    notes = []
    if signal == "current":
        said = ", ".join(f"{joint} {factor:.3g}" for joint, factor in found.factors.items())
        notes.append(f"torque per ampere, by the motions without the payload: {said} [Nm/A or N/A]")
    if found.left_out:
        notes.append(f"the model does not explain the {signal} of {', '.join(found.left_out)}, which is left out")
    return _weighed(found.mass, found.center, found.covariance, frame, most_kg, tuple(notes)), ()


def _doubts(
    fit: FitResult,
    load: Load,
    ways: dict[Way, Weighed],
    best: Way,
    errors: HeldOut | None,
    given: Sequence[Episode],
) -> tuple[list[str], list[str]]:
    """What speaks against a result, and what speaks so much against it that its mass is not determined."""
    doubts, fatal, found = [], [], ways[best]
    if fit.status in _UNUSABLE:
        fatal.append(f"the fit of the motions without the payload is {fit.status}: its numbers are none to build on")
    if any(own.notes and own.notes[-1] == "it came out below zero" for own in ways.values()):
        fatal.append("the motions with the payload carry less than those without: are the two exchanged?")
    if errors is not None and found.carries and not errors.with_it < errors.without:
        fatal.append("motions that were held out are not simulated better with the payload than without it")
    before = float(np.sqrt(np.mean([item.rms**2 for item in fit.whiteness.values()]))) if fit.whiteness else np.inf
    if load.rms > _OTHERWISE * before:
        doubts.append(
            f"the model leaves {load.rms / before:.1f} times as much of the motions with the payload as of those "
            "without: more than a rigid payload differs"
        )
    if len(ways) == 2:
        one, other = ways["motion"], ways["torque"]
        apart = abs(one.mass_kg - other.mass_kg)
        if apart > 0.5 * float(np.hypot(np.ptp(one.interval_kg), np.ptp(other.interval_kg))):
            doubts.append(f"motion and torques disagree by {apart:.3g} kg, more than their intervals allow")
    said = {log.meta.payload_kg for log in given if log.meta.payload_kg}
    low, high = found.interval_kg
    strange = [f"{kg:g}" for kg in sorted(said) if not low <= kg <= high]
    if strange:
        doubts.append(f"the recordings say payload_kg {', '.join(strange)}, which is outside of the interval")
    return doubts, fatal


def _save_loaded(load: Load, folder: Path) -> None:
    """The model that carries the payload, and its robot.yaml."""
    from trueup.identify import Problem
    from trueup.identify.export import MODEL_FILE, ROBOT_FILE, fitted_robot, save_model
    from trueup.identify.quantities import quantity

    own = type(load.parameters)(tuple(item for item in load.parameters if quantity(item.quantity).of != "motion"))
    values = {**load.values, "payload_mass": max(0.0, load.mass)}
    candidate = Problem(load.nominal, own, ()).candidate(values)
    folder.mkdir(exist_ok=True)
    save_model(candidate, folder / MODEL_FILE)
    write_text(folder / ROBOT_FILE, robot_yaml(fitted_robot(candidate)))
