"""What policies do with goals: `evaluation.json`, and `episodes.npz` with their control steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from trueup.core.atomic import as_read_back, read_json, replacing, write_json
from trueup.core.config import build, read_versioned
from trueup.core.npz import read_arrays
from trueup.core.results import Estimate, PairedDifference
from trueup.errors import DataError

EVALUATION_SCHEMA = "trueup.policy-evaluation/2"
EVALUATION_NAME = "evaluation.json"
EPISODES_NAME = "episodes.npz"
CURVES = ("distance_m", "reward")


@dataclass(frozen=True)
class PlaceResult:
    """One policy in one place.

    Attributes:
        goals: where it was to go, (E, 3) [m].
        lost: arms that were lost.
        values: metric -> of each episode, (E,).
        estimates: metric -> mean over goals with a 95 % interval; `distance_median` is the median.
    """

    goals: tuple[tuple[float, ...], ...]
    lost: int
    values: Mapping[str, tuple[float, ...]]
    estimates: Mapping[str, Estimate]


@dataclass(frozen=True)
class JudgedPolicy:
    """One policy.

    Attributes:
        label: unique in the file.
        name: what it calls itself.
        seed: of its training.
        places: `mujoco`, `dart`, `lab-1` -> what it did there.
    """

    label: str
    name: str
    seed: int
    places: Mapping[str, PlaceResult]


@dataclass(frozen=True)
class JudgedGroup:
    """Policies that share everything but their seed.

    Attributes:
        label: unique in the file.
        policies: their labels.
        places: place -> metric -> mean over goals and seeds, interval over both; `distance_median` is the mean over
            seeds of the median over goals.
    """

    label: str
    policies: tuple[str, ...]
    places: Mapping[str, Mapping[str, Estimate]]


@dataclass(frozen=True)
class PolicyEvaluation:
    """The content of evaluation.json.

    Attributes:
        policies: in the order given.
        groups: each policy is in one, alone or with those that have other seeds.
        differences: each group minus the first one, on the same goals: `run` and `baseline` are groups, `split` is the
            place.
        start_m: where the end of the arm is at the start, (3,) [m].
        control_s: length of a control step [s].
        near_m: nearer than this, a goal is reached [m].
        settings: goals, places.
        provenance: versions, seed, and what each policy was made from.
    """

    policies: tuple[JudgedPolicy, ...]
    groups: tuple[JudgedGroup, ...]
    differences: tuple[PairedDifference, ...]
    start_m: tuple[float, ...]
    control_s: float
    near_m: float
    settings: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def places(self) -> tuple[str, ...]:
        """Where they were judged."""
        return tuple(self.policies[0].places)

    def policy(self, label: str) -> JudgedPolicy:
        """The policy with this label."""
        return next(item for item in self.policies if item.label == label)

    def to_json(self) -> dict[str, Any]:
        """The content of evaluation.json."""
        content = {name: value for name, value in asdict(self).items() if name != "differences"}
        differences = [item.to_json() for item in self.differences]
        return {"schema": EVALUATION_SCHEMA, **as_read_back(content), "differences": differences}

    @staticmethod
    def from_json(data: Any, where: str = EVALUATION_NAME) -> PolicyEvaluation:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: something else, or of another version.
            DataError: broken.
        """
        return read_versioned(
            PolicyEvaluation._read, data, where, schema=EVALUATION_SCHEMA, what="evaluation of policies"
        )

    @staticmethod
    def _read(data: Mapping[str, Any]) -> PolicyEvaluation:
        content = {key: value for key, value in data.items() if key not in ("schema", "differences")}
        differences = tuple(PairedDifference.from_json(item) for item in data["differences"])
        return replace(
            build(PolicyEvaluation, {**content, "differences": ()}, EVALUATION_NAME), differences=differences
        )

    def save(self, path: Path) -> None:
        """Write evaluation.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> PolicyEvaluation:
        """Read evaluation.json.

        Raises:
            FormatError: something else, or of another version.
            DataError: broken, or policies were not judged in the same places on the same goals.
        """
        found = PolicyEvaluation.from_json(read_json(path), str(path))
        labels = [item.label for item in found.policies]
        asked = {(tuple(item.places), *(place.goals for place in item.places.values())) for item in found.policies}
        sizes = {
            len(values) - len(place.goals)
            for item in found.policies
            for place in item.places.values()
            for values in place.values.values()
        }
        members = [label for group in found.groups for label in group.policies]
        if len(asked) != 1 or not found.places or sizes != {0} or sorted(members) != sorted(set(labels)):
            raise DataError(f"{path} is broken: policies, groups, places or goals do not fit together", got=labels)
        return found


# Policy and place -> `distance_m` and `reward` of each control step, (E, T); NaN from where an arm is lost.
Curves = Mapping[tuple[str, str], Mapping[str, Float32[np.ndarray, "E T"]]]


def save_curves(path: Path, curves: Curves, labels: Sequence[str]) -> None:
    """Write episodes.npz: `0.mujoco.reward` is of the first of the policies."""
    arrays = {
        f"{labels.index(label)}.{place}.{name}": values
        for (label, place), own in curves.items()
        for name, values in own.items()
    }
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_curves(path: Path, evaluation: PolicyEvaluation) -> Curves:
    """Read the episodes.npz that belongs to an evaluation.

    Raises:
        DataError: it is missing or broken, or of another evaluation.
    """
    try:
        stored = read_arrays(path)
        found = {
            (item.label, place): {name: stored[f"{number}.{place}.{name}"] for name in CURVES}
            for number, item in enumerate(evaluation.policies)
            for place in item.places
        }
    except (DataError, KeyError) as error:
        raise DataError(f"{path} is missing or broken", got=error) from error
    goals = len(next(iter(evaluation.policies[0].places.values())).goals)
    for own in found.values():
        if any(values.ndim != 2 or len(values) != goals or values.dtype != np.float32 for values in own.values()):
            raise DataError(f"{path} is of another evaluation", expected=f"{goals} episodes of numbers")
    return found
