"""Init: a robot.yaml from a model, and from logs of the robot if there are some."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.align import JointMap
from trueup.core.atomic import write_text
from trueup.core.check_result import Finding
from trueup.core.episode import Episode
from trueup.dataset import Dataset, is_dataset
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.headers import DEGREES, Suggestion
from trueup.dataset.importers.stated import UnnamedCommand
from trueup.dataset.importers.table import suggested
from trueup.errors import ConfigError, DataError, OutputExists, TrueupError
from trueup.robots import RobotSpec
from trueup.robots.repair import repaired, unweighed
from trueup.robots.spec import CommandSignal
from trueup.robots.written import robot_yaml
from trueup.stages.importing import plan_import
from trueup.stages.robot_model import model_beside

if TYPE_CHECKING:
    from trueup.draft import RobotDraft
    from trueup.draft.names import Matching

ROBOT_NAME, MAPPING_NAME = "robot.yaml", "mapping.yaml"
# More motions say the same once more; mistakes are found one after the other.
_MOST, _ROUNDS = 40, 4
# Of commanded signals, the one that a robot most likely follows.
_SIGNALS: tuple[CommandSignal, ...] = ("position", "velocity", "torque")
_MOST_NAMES = 6
# A joint that follows its command goes with it so closely, as a correlation.
# Some twenty turns.
_MOST_RAD = 125.0
_ARRAY = "unnamed command columns, matched by motion: {}"
_FOLLOWED, _CLEARLY = 0.9, 0.02  # and so much more closely than any other


@dataclass(frozen=True)
class Drafted:
    """What was written.

    Attributes:
        robot: the description, as `load_robot` reads it.
        text: of its robot.yaml.
        mapping: text of the mapping that the logs were read with, if the names of columns suggested it.
        files: that were written, robot.yaml last; none where nothing was to be written.
        taken: what was taken from where, a line each.
        unsure: what somebody should look at, a line each.
        findings: of the check of the set-up; those that robot.yaml takes account of are in `taken`.
    """

    robot: RobotSpec
    text: str
    mapping: str
    files: tuple[Path, ...]
    taken: tuple[str, ...]
    unsure: tuple[str, ...]
    findings: tuple[Finding, ...] = ()


def _no(_: Finding) -> bool:
    return False


def draft(
    model: Path | str,
    logs: Path | str | None = None,
    *,
    out: Path | str | None = None,
    format: str | None = None,
    options: ImportOptions | None = None,
    calibration: Path | None = None,
    repair: bool = False,
    overwrite: bool = False,
    ask: Callable[[Finding], bool] = _no,
) -> Drafted:
    """A robot.yaml for a robot that is known by its model, and by logs if there are some.

    Joints, limits, base and gains are those of `trueup.draft.draft_robot`. With logs, what they command decides how
    the robot is driven, joints are matched by name, number or order, and what the check of the set-up is certain of
    (signs, units, zeros, swapped joints) is written into robot.yaml.

    Args:
        model: MJCF or URDF.
        logs: of any known format, or a dataset.
        out: folder that robot.yaml is written to; nothing is written if None.
        format: of the logs; detected if None.
        options: mapping file, units, topics.
        calibration: JSON file of LeRobot's calibration of this arm, whose logs are from -100 to 100 or in degrees.
        repair: write a copy of a URDF in which impossible masses and inertias are possible ones, and use it.
        overwrite: replace a robot.yaml that is there.
        ask: whether to write down what the check finds likely, but is not certain of.

    Raises:
        OutputExists: there is a robot.yaml.
        ConfigError: the model cannot be used.
        TrueupError: the logs cannot be read.
    """
    from trueup.draft import draft_robot

    path, folder = Path(model), None if out is None else Path(out)
    target = None if folder is None else folder / ROBOT_NAME
    if target is not None and not overwrite:
        _refuse_there(target)
    files: list[Path] = []
    taken: list[str] = []
    unsure, checked, findings, suggestion = list[str](), list[str](), list[Finding](), None
    name = ""
    if repair and folder is not None:
        text, faults = repaired(path) if path.suffix == ".urdf" else ("", [])
        if not faults:
            raise ConfigError(f"{path}: nothing to repair", expected="a URDF with impossible masses or inertias")
        name, path = path.stem, folder / f"{path.stem}.repaired.urdf"
        write_text(path, text)
        files.append(path)
        taken += [f"repaired: {fault.link} had {fault.wrong}; it has {fault.done}" for fault in faults]
        if light := unweighed(Path(model)):
            unsure.append(
                f"{', '.join(light)} had no mass and got a tiny one: write their real masses into {model}, or gains, "
                "torques and fitted parameters mean nothing"
            )
    if logs is None:
        first = draft_robot(path)
        robot, matching = first.robot, None
    else:
        episodes, suggestion = _some_of(Path(logs), format, options, folder, overwrite=overwrite)
        if suggestion is not None:
            taken += suggestion.taken
            unsure += suggestion.unsure
            files += [folder / MAPPING_NAME] if folder is not None else []
        first, matching = _of_logs(path, episodes)
        if calibration is not None:
            first, told = _calibrated(first, calibration, episodes)
            taken.append(told)
        guessed = calibration is None and suggestion is not None and suggestion.guessed
        robot, mended, findings = _checked(first.robot, episodes, path, ask, guessed=guessed)
        checked += mended
        _refuse_counts(robot, episodes)
        if any(joint.log_unit for joint in robot.joints):
            unsure = [line for line in unsure if line != DEGREES]
    taken += [*first.taken, *_matched(robot, matching), *checked]
    unsure += [*first.unsure, *_unmatched(matching)]
    robot = replace(robot, name=name or robot.name)
    if folder is not None:
        robot = replace(robot, model=model_beside(robot, path, folder), folder=folder.resolve())
    text = _commented(robot, first, path, logs)
    if target is not None:
        write_text(target, text)
        files.append(target)
    mapping = "" if suggestion is None else suggestion.text
    return Drafted(robot, text, mapping, tuple(files), tuple(taken), tuple(unsure), tuple(findings))


def keep_draft(drafted: Drafted, folder: Path) -> None:
    """Write the robot.yaml that was drafted for one command, and the mapping, beside what came of them."""
    robot = drafted.robot
    beside = replace(robot, model=model_beside(robot, Path(robot.model), folder))
    write_text(folder / ROBOT_NAME, robot_yaml(beside))
    if drafted.mapping:
        write_text(folder / MAPPING_NAME, drafted.mapping)


def _some_of(
    logs: Path, format: str | None, options: ImportOptions | None, folder: Path | None, *, overwrite: bool
) -> tuple[list[Episode], Suggestion | None]:
    """Motions spread over the logs, and the mapping that they were read with if the names of columns suggested it."""
    if is_dataset(logs):
        dataset = Dataset(logs)
        rows = np.unique(np.linspace(0, len(dataset) - 1, _MOST).astype(int))
        return [dataset[dataset.ids[row]] for row in rows], None
    options = options or ImportOptions()
    try:
        return _spread(logs, format, options), None
    except UnnamedCommand as error:
        suggestion, format = None if options.mapping else _named_by_motion(logs, format, options, error.count), "rosbag"
        if suggestion is None:
            raise
    except TrueupError:
        suggestion = None if options.mapping or format not in (None, "table") else suggested(logs)
        if suggestion is None:
            raise
        format = "table"
    with tempfile.TemporaryDirectory() as place:
        kept = None if folder is None else folder / MAPPING_NAME
        # One that an earlier call has left, which then failed, is no reason to refuse.
        there = kept is not None and kept.exists() and not overwrite
        mapping = Path(place) / MAPPING_NAME if kept is None or there else kept
        write_text(mapping, suggestion.text)
        episodes = _spread(logs, format, replace(options, mapping=mapping))
        told = episodes[0].command
        if told is not None and set(told.joints).isdisjoint(episodes[0].measured.joints):
            suggestion = _with_command_named(suggestion, episodes)
            write_text(mapping, suggestion.text)
            episodes = _spread(logs, format, replace(options, mapping=mapping))
        if kept is not None and there and kept.read_text() != suggestion.text:
            _refuse_there(kept)
        return episodes, suggestion


def _named_by_motion(logs: Path, format: str | None, options: ImportOptions, count: int) -> Suggestion | None:
    """Names for arrays of commanded positions, by which joint has followed which one; None where that is not sure."""
    names = [f"column {number}" for number in range(1, count + 1)]
    with tempfile.TemporaryDirectory() as place:
        mapping = Path(place) / MAPPING_NAME
        write_text(mapping, Suggestion({"command_joints": names}, (), ()).text)
        found = _followed_by(_spread(logs, format, replace(options, mapping=mapping)))
    if not found:
        return None
    return Suggestion({"command_joints": found}, (_ARRAY.format(", ".join(found)),), ())


def _followed_by(episodes: Sequence[Episode]) -> list[str]:
    """Measured joints in the order of the commanded positions that they have followed; empty where that is not sure."""
    from scipy.optimize import linear_sum_assignment

    joints = episodes[0].measured.joints
    count = len(joints)
    alike = []
    for episode in episodes:
        told, done = episode.command, episode.measured
        if told is None or "position" not in told or len(told.joints) != count or done.joints != joints:
            return []
        at = np.array([np.interp(told.time_s, done.time_s, column) for column in done["position"].T])
        # Where a command stands still it says nothing, whatever has followed it.
        moved = 1.0 * (np.ptp(told["position"], axis=0) > 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            alike.append(np.nan_to_num(abs(np.corrcoef(told["position"].T, at)[:count, count:])) * moved[:, None])
    shared = np.mean(alike, axis=0)
    rows, columns = linear_sum_assignment(-shared)
    own = shared[rows, columns]
    others = np.where(np.eye(count, dtype=bool)[columns], 0.0, shared).max(axis=1)
    if np.min(own) < _FOLLOWED or np.min(own - others) < _CLEARLY:
        return []
    return [joints[column] for column in columns]


def _with_command_named(suggestion: Suggestion, episodes: Sequence[Episode]) -> Suggestion:
    """The mapping with names for commands that are only numbered beside joints that have names.

    Raises:
        DataError: motion does not tell which is which.
    """
    found = _followed_by(episodes)
    if not found:
        told = episodes[0].command
        raise DataError(
            "command columns are numbered, not named, and the motion does not show which joint follows which",
            got=", ".join(told.joints if told else ()),
            expected=", ".join(episodes[0].measured.joints),
            hint="Write the mapping yourself, with `joints` below `command` in the order of its columns.",
        )
    series = dict(suggestion.tree["series"])
    series["command"] = {**series["command"], "joints": found}
    tree = {**suggestion.tree, "series": series}
    return replace(suggestion, tree=tree, taken=(*suggestion.taken, _ARRAY.format(", ".join(found))))


def _refuse_there(path: Path) -> None:
    if path.exists():
        raise OutputExists(f"{path} exists", hint="Give --overwrite, or choose another --out.")


def _spread(logs: Path, format: str | None, options: ImportOptions) -> list[Episode]:
    plan = plan_import(logs, format=format, options=options)
    episodes, refused = [], []
    for row in np.unique(np.linspace(0, len(plan.episodes) - 1, _MOST).astype(int)):
        try:
            episodes.append(plan.episodes[row].load())
        except TrueupError as error:
            refused.append(error)
    if not episodes:
        raise refused[0]
    return episodes


def _of_logs(model: Path, episodes: Sequence[Episode]) -> tuple[RobotDraft, Matching]:
    """The description of a robot that is driven as the logs say, whose joints are those that they know."""
    from trueup.draft import draft_robot, match_names

    commanded = Counter(signal for episode in episodes if episode.command for signal in episode.command.signals)
    # What a few motions command besides is what a controller above the drives has followed.
    signal = max((one for one in _SIGNALS if one in commanded), key=commanded.__getitem__, default=None)
    whole = draft_robot(model, signal=signal)
    names = list(dict.fromkeys(name for episode in episodes for name in episode.measured.joints))
    matching = match_names(names, whole.robot.joint_names)
    if not matching.pairs:
        raise DataError(
            "no joint of the logs is one of the model",
            got=", ".join(names),
            expected=", ".join(whole.robot.joint_names),
            hint="Is it the model of this robot? Else write the names into robot.yaml: "
            f"joints: [{{name: {whole.robot.joint_names[0]}, log: {names[0]}}}, …].",
        )
    there = [name for name in whole.robot.joint_names if name in matching.pairs]
    own = draft_robot(model, signal=signal, joints=there) if matching.missing else whole
    joints = tuple(
        replace(joint, log="" if matching.pairs[joint.name] == joint.name else matching.pairs[joint.name])
        for joint in own.robot.joints
    )
    robot = replace(own.robot, joints=joints, ignore=matching.strangers)
    if signal is None:
        robot = _uncommanded(robot, episodes)
    return replace(own, robot=robot), matching


def _uncommanded(robot: RobotSpec, episodes: Sequence[Episode]) -> RobotSpec:
    """Driven by the torque that was measured, where nothing was commanded."""
    if not all("torque" in episode.measured for episode in episodes):
        raise DataError(
            "the logs hold no command that a simulation could be given",
            got=f"measured {', '.join(episodes[0].measured.signals)}",
            expected="commanded positions, velocities or torques, or measured torques",
            hint="Name the command: a series `command` of the mapping, or --command-topic of a bag.",
        )
    controller = replace(robot.controller, kind="torque", command="", source="measured", per_joint={})
    return replace(robot, controller=controller, replay=replace(robot.replay, window_s=0.5))


def _calibrated(first: RobotDraft, path: Path, episodes: Sequence[Episode]) -> tuple[RobotDraft, str]:
    """The description with what LeRobot's calibration says of units and zeros, and a line about it."""
    from trueup.draft.calibration import calibrated, read_calibration

    motors = read_calibration(path)
    # Shares of a range are within 100 of its middle.
    degrees = any(float(np.nanmax(np.abs(episode.measured["position"]), initial=0.0)) > 101.0 for episode in episodes)
    robot, told = calibrated(first.robot, motors, degrees=degrees)
    if not told:
        raise DataError(
            f"{path} is the calibration of another robot",
            got=", ".join(motors),
            expected=", ".join(joint.log or joint.name for joint in first.robot.joints),
        )
    unit = "degrees" if degrees else "from -100 to 100 of the calibrated range"
    return replace(first, robot=robot), f"{_listed(told)}: {unit}, with the zeros of {path.name}"


def _checked(
    robot: RobotSpec, episodes: Sequence[Episode], model: Path, ask: Callable[[Finding], bool], *, guessed: bool
) -> tuple[RobotSpec, list[str], list[Finding]]:
    """The description with all that the check of the set-up is certain of or somebody agrees to, why, and the rest.

    Where the unit of positions is only a guess, the check sees their bare numbers, and may find another.
    """
    if guessed:
        bare = replace(robot, joints=tuple(replace(joint, log_unit="rad") for joint in robot.joints))
        found = _mended(bare, episodes, model, ask)
        units = {joint.log_unit for joint in found[0].joints}
        if units <= {"deg"}:
            joints = tuple(replace(joint, log_unit=None) for joint in found[0].joints)
            return replace(found[0], joints=joints), found[1], found[2]
        # Nobody logs turns or thousandths that could be degrees, and counts are whole numbers.
        counts = all(np.array_equal(values, np.round(values)) for values in _positions(episodes))
        if units <= {"deg", "%", "1" if counts else "%"}:
            return found
    return _mended(robot, episodes, model, ask)


def _positions(episodes: Sequence[Episode]) -> list[np.ndarray]:
    """Measured positions as they were logged, without missing ones."""
    values = [episode.measured["position"] for episode in episodes]
    return [own[np.isfinite(own)] for own in values]


def _refuse_counts(robot: RobotSpec, episodes: Sequence[Episode]) -> None:
    """Refuse positions that no joint can have, such as encoder counts of which nobody says how many are a turn.

    Raises:
        DataError: there are some.
    """
    joint_map = JointMap.from_dict(robot.joint_rules())
    for episode in episodes:
        measured = joint_map.of_episode(episode).measured
        units = measured.units["position"]
        for joint, unit, values in zip(measured.joints, units, measured["position"].T, strict=True):
            if unit == "rad" and np.isfinite(values).any() and float(np.nanpercentile(np.abs(values), 5)) > _MOST_RAD:
                raise DataError(
                    f"positions of {joint} cannot be angles",
                    got=f"about {float(np.nanmedian(values)):.0f} rad, as they are read",
                    expected="angles in a known unit, or encoder counts with the angle per count",
                    hint="Write `factor` [rad per count], `offset` and `unit: rad` below `position` into a mapping.",
                )


def _mended(
    robot: RobotSpec, episodes: Sequence[Episode], model: Path, ask: Callable[[Finding], bool]
) -> tuple[RobotSpec, list[str], list[Finding]]:
    from trueup.check import check_motions, mended

    why: list[str] = []
    before: tuple[RobotSpec, list[str], list[Finding]] | None = None
    for _ in range(_ROUNDS):
        joint_map = JointMap.from_dict(robot.joint_rules())
        try:
            found, _ = check_motions([joint_map.of_episode(episode) for episode in episodes], robot, model)
        except ConfigError:
            if before is None:
                raise
            return before  # what was likely makes no robot that can be simulated
        findings = [finding for finding in found if finding.severity != "note"]
        mendable = [finding for finding in findings if _mends_robot(finding)]
        own = [finding for finding in mendable if finding.severity == "certain"]
        own = own or [finding for finding in mendable if ask(finding)]
        findings = [finding for finding in findings if finding not in own]
        if not own:
            break
        before = robot, list(why), [*own, *findings]
        for finding in own:
            robot = mended(robot, finding.mends[0].lines)
            why.append(finding.evidence)
    return robot, why, findings


def _mends_robot(finding: Finding) -> bool:
    """Whether lines of robot.yaml mend it; some findings say in words only what to look at there."""
    return bool(finding.mends) and finding.mends[0].where == "robot.yaml" and bool(finding.mends[0].lines)


def _matched(robot: RobotSpec, matching: Matching | None) -> list[str]:
    """How joints and names were brought together."""
    if matching is None:
        return []
    renamed = [f"{joint.name} = {joint.log}" for joint in robot.joints if joint.log and joint.log != joint.name]
    if not renamed:
        return [f"all {len(robot.joints)} joints have the model's names in the logs"]
    return [f"joint = name in the logs: {', '.join(renamed)}"]


def _unmatched(matching: Matching | None) -> list[str]:
    if matching is None:
        return []
    lines = []
    ordered = [joint for joint, how in matching.how.items() if how == "order"]
    if ordered:
        lines.append(f"{_listed(ordered)}: matched with the logs by order alone, since no names match")
    if matching.strangers:
        lines.append(f"{_listed(matching.strangers)}: in the logs, but no joint of the model, so ignored")
    if matching.missing:
        lines.append(f"{_listed(matching.missing)}: joints of the model that the logs do not have, held still")
    return lines


def _commented(robot: RobotSpec, first: RobotDraft, model: Path, logs: Path | str | None) -> str:
    """robot.yaml, with what somebody should look at on top."""
    head = [f"# From {model.name}{f' and {Path(logs).resolve().name}' if logs else ''}, by `trueup init`."]
    if first.invented:
        head.append("# The gains are invented: neither model nor logs state them. `trueup identify` fits them.")
    return "\n".join(head) + "\n" + robot_yaml(robot)


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_MOST_NAMES])
    return shown + (f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else "")
