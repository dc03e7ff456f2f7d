"""What is suspicious in a comparison, beyond what the quality checks see in a log alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from trueup.align import JointMap, robust_threshold
from trueup.core.episode import Flag
from trueup.core.quality import EpisodeQuality, Quality
from trueup.dataset import Dataset
from trueup.measure import Comparison

_FEWEST_FOR_A_THRESHOLD = 5


class Signs:
    """Finds torques that are measured without their sign: comparing them with signed ones says little."""

    def __init__(self) -> None:
        self._lowest: dict[str, float] = {}
        self._simulated: dict[str, float] = {}

    def add(self, comparison: Comparison) -> None:
        """Take in one episode; its first run counts."""
        series = (
            comparison.measured,
            *(item.select(comparison.measured.joints) for item in comparison.simulated.values()),
        )
        if len(series) < 2 or not all("torque" in item for item in series):
            return
        for number, joint in enumerate(comparison.measured.joints):
            if not np.isfinite(comparison.measured["torque"][:, number]).any():
                continue  # nothing was measured, not even without a sign
            for lowest, item in zip((self._lowest, self._simulated), series, strict=False):
                lowest[joint] = min(lowest.get(joint, 0.0), float(np.nanmin(item["torque"][:, number], initial=0.0)))

    def warnings(self) -> list[str]:
        """One sentence, or none."""
        unsigned = [joint for joint, low in self._lowest.items() if low >= 0.0 > self._simulated[joint]]
        if not unsigned:
            return []
        joints = ", ".join(unsigned)
        return [f"The measured torque of {joints} is unsigned, the simulated one is signed: torque errors mean little."]


def incomplete(dataset: Dataset, covered: Mapping[str, Set[str]], kept: Sequence[str]) -> list[str]:
    """Sentences about work that was begun and not finished."""
    sentences = []
    if dataset.info.provenance.get("complete") is False:
        sentences.append(f"The import of {dataset.path.name} was interrupted: import --resume reads the rest.")
    for label, ids in covered.items():
        missing = [name for name in kept if name not in ids]
        if missing:
            sentences.append(
                f"The run {label} lacks {len(missing)} of {len(kept)} motions ({', '.join(missing[:3])}"
                f"{', …' if len(missing) > 3 else ''}): its results cover only the others."
            )
    return sentences


def outdated(dataset: Dataset, labels: Sequence[str]) -> list[str]:
    """Sentences about corrected runs whose base has been simulated again since."""
    sentences = []
    for label in labels:
        corrects = dataset.run_info(label).get("inputs", {}).get("corrects")
        if not corrects or corrects["run"] not in dataset.runs:
            continue
        base = corrects["run"]
        if dataset.run_info(base).get("provenance", {}).get("created") != corrects.get("created"):
            sentences.append(
                f"The run {label} corrects an earlier version of {base}: it is out of date until trueup augment eval "
                "corrects it again."
            )
    return sentences


def held(dataset: Dataset, labels: Sequence[str]) -> list[str]:
    """Sentences about what of the model is held in these simulations, or swings in them; runs that agree share one."""
    found: dict[str, list[str]] = {}
    for label in labels:
        for note in dataset.run_info(label).get("notes", ()):
            found.setdefault(str(note), []).append(label)
    return [f"{note[:1].upper()}{note[1:]} ({', '.join(those)})." for note, those in found.items()]


def unapplied(joint_map: JointMap | None, log_joints: Sequence[str]) -> list[str]:
    """A sentence if signs, scales or offsets stay unused because the log is in the robot's names already."""
    if joint_map is None or set(joint_map.log_joints) == set(log_joints) or set(joint_map.joints) != set(log_joints):
        return []
    plain = JointMap.identity(joint_map.joints)
    unused = [
        rule.joint
        for rule, other in zip(joint_map.rules, plain.rules, strict=True)
        if replace(rule, log=rule.joint) != other
    ]
    if not unused:
        return []
    what = f"sign, scale and offset of {', '.join(unused)} were not applied"
    return [f"The log has the robot's joint names already: {what}; name the log's in robot.yaml if they should be."]


def far_motions(errors: Mapping[str, float]) -> dict[str, Flag]:
    """Motions that are much further from the simulation than the others are (LSTM thesis, 4.2)."""
    known = {name: value for name, value in errors.items() if np.isfinite(value)}
    if len(known) < _FEWEST_FOR_A_THRESHOLD:
        return {}
    threshold = robust_threshold(list(known.values()))
    return {
        name: Flag(
            kind="far_from_simulation",
            signal="position",
            severity="note",
            detail=f"position MSE against the simulation {value:.3g}, usual here is up to {threshold:.3g}: "
            "executed wrongly, or something that the model does not know",
        )
        for name, value in known.items()
        if value > threshold
    }


def quality_of(
    dataset: Dataset,
    kept: set[str],
    joint_map: JointMap | None,
    failed: Mapping[str, Flag],
    *,
    split: str | None,
) -> Quality:
    """The flags of the episodes that were asked for; those that are not in `kept` were dropped because of them."""
    names = {rule.log: rule.joint for rule in joint_map.rules} if joint_map else {}
    episodes = {}
    for name in dataset.select(split=split):
        meta = dataset.meta(name)
        flags = [replace(flag, joint=names.get(flag.joint, flag.joint)) for flag in meta.flags]
        flags += [failed[name]] if name in failed else []
        episodes[name] = EpisodeQuality(split=meta.split, flags=tuple(flags), dropped=name not in kept)
    return Quality(episodes)
