"""Predictions of torques beside each other, on the same stamps of motions that were held out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64

from trueup.core.episode import Episode
from trueup.core.graybox_result import Score
from trueup.core.torque_result import RIVALS, HeldOut, JointTorque, TorqueMethod, TorqueResult, TorqueSource
from trueup.errors import NotIdentifiable
from trueup.robots import RobotSpec

if TYPE_CHECKING:
    from trueup.identify.regression.currents import Factor

SCALED = (
    "currents without a factor were scaled so that the links weigh what the model says: masses are as wrong as the "
    "model's, and only their ratios are measured"
)


@dataclass(frozen=True, eq=False)
class _Squares:
    """The errors of one joint on E motions.

    Attributes:
        size: stamps at which the torque and all predictions are known, (E,).
        torque: sum of its squares.
        of: name -> sum of the squares of what it misses, (E,).
    """

    size: Float64[np.ndarray, "E"]
    torque: float
    of: Mapping[str, Float64[np.ndarray, "E"]]

    @property
    def rms(self) -> float:
        """Root mean square of the torque."""
        return float(np.sqrt(self.torque / self.size.sum()))

    def share(self, name: str) -> float:
        """RMSE of a prediction, of the torque's RMS."""
        return float(np.sqrt(self.of[name].sum() / self.torque))


@dataclass(frozen=True, eq=False)
class Judged:
    """Predictions of motions.

    Attributes:
        episodes: with the torque that was measured, or what stands for it.
        judged: joints whose torque is judged.
        joints: of the columns of predictions.
        units: joint -> unit of its torque.
        predicted: method or rival -> motion -> torque, (T, J).
    """

    episodes: Sequence[Episode]
    judged: Sequence[str]
    joints: Sequence[str]
    units: Mapping[str, str]
    predicted: Mapping[str, Mapping[str, Float64[np.ndarray, "T J"]]]

    @cached_property
    def held(self) -> list[Episode]:
        """The motions that were predicted."""
        ids = set.intersection(*(set(motions) for motions in self.predicted.values()))
        return [item for item in self.episodes if item.meta.id in ids]

    @cached_property
    def squares(self) -> dict[str, _Squares]:
        """Joint -> errors, of joints of which something is known."""
        found = {}
        for joint in self.judged:
            number = self.joints.index(joint)
            columns = [(item.measured["torque"], item.measured.joints.index(joint)) for item in self.held]
            actual = [np.asarray(values[:, column], np.float64) for values, column in columns]
            parts = {
                name: [motions[item.meta.id][:, number] for item in self.held]
                for name, motions in self.predicted.items()
            }
            parts = {name: own for name, own in parts.items() if any(np.isfinite(part).any() for part in own)}
            there: list[Bool[np.ndarray, "T"]] = [
                np.all([np.isfinite(values), *(np.isfinite(own[at]) for own in parts.values())], axis=0)
                for at, values in enumerate(actual)
            ]
            size = np.array([float(rows.sum()) for rows in there])
            total = sum(float(np.sum(values[rows] ** 2)) for values, rows in zip(actual, there, strict=True))
            if not (parts and total > 0.0):
                continue
            missed = {
                name: np.array([float(np.sum((actual[at] - own[at])[rows] ** 2)) for at, rows in enumerate(there)])
                for name, own in parts.items()
            }
            found[joint] = _Squares(size, total, missed)
        return found

    def rival(self, squares: Mapping[str, _Squares]) -> str:
        """The best simple rival that there is for each joint."""
        everywhere = [name for name in RIVALS if all(name in own.of for own in squares.values())]
        return min(everywhere, key=lambda name: float(np.mean([own.share(name) for own in squares.values()])))

    def score(self, name: str, rival: str, squares: Sequence[_Squares], unit: str) -> Score:
        """The error of a prediction, and how much less it is than the rival's; shares of the RMS in the unit `1`."""
        from trueup.identify.regression.graybox_scores import Sums, score_of

        _, group = np.unique([item.meta.executed for item in self.held], return_inverse=True)
        sums = [
            Sums(own.size, own.of[rival] / scale, own.of[name] / scale)
            for own in squares
            for scale in [own.rms**2 if unit == "1" else 1.0]
        ]
        return score_of(sums, np.ones(len(self.held), dtype=bool), group, unit)

    def result(
        self,
        source: TorqueSource,
        held_out: HeldOut,
        robot: RobotSpec,
        methods: Sequence[TorqueMethod],
        *,
        factors: Mapping[str, Factor],
        left_out: Mapping[str, str],
        notes: Sequence[str],
    ) -> TorqueResult:
        """Everything beside the best rival.

        Args:
            source: what stands for the torque.
            held_out: how motions were held out.
            robot: its description, for factors of currents that are known.
            methods: those that are no rivals.
            factors: joint -> torque per current that the model's masses tell.
            left_out: joint, method or rival -> why.
            notes: what was assumed.

        Raises:
            NotIdentifiable: no method predicts the torque of a joint.
        """
        squares = {joint: own for joint, own in self.squares.items() if set(methods) & set(own.of)}
        lost = {joint: "no method predicts its torque" for joint in self.judged if joint not in squares}
        if not squares:
            raise NotIdentifiable(
                f"no torque can be predicted: {next(iter({**left_out, **lost}.values()))}",
                hint="Record motions in which the joints move and the torques change.",
            )
        rival = self.rival(squares)
        joints = {}
        for joint, own in squares.items():
            given = robot.torque_constant_nm_a(joint) if source == "current" else None
            fitted = factors.get(joint) if given is None else None
            joints[joint] = JointTorque(
                unit=self.units[joint],
                rms=own.rms,
                errors={name: self.score(name, rival, [own], self.units[joint]) for name in own.of},
                factor=given if fitted is None else fitted.value,
                factor_from="model" if fitted is not None else "" if given is None else "robot",
                factor_interval=None if fitted is None else (fitted.low, fitted.high),
            )
        with_it = {name: [own for own in squares.values() if name in own.of] for name in self.predicted}
        total = {name: self.score(name, rival, own, "1") for name, own in with_it.items() if own}
        return TorqueResult(
            source=source,
            follows=robot.controller.signal,
            held_out=held_out,
            methods=tuple(name for name in methods if name in total),
            rival=rival,
            joints=joints,
            total=total,
            motions=len(self.held),
            left_out={**left_out, **lost},
            notes=(*notes, *_notes(source, joints)),
        )


def _notes(source: TorqueSource, joints: Mapping[str, JointTorque]) -> Iterator[str]:
    """What must be known of currents and commands."""
    if source == "command":
        yield "no torque was measured: the commanded one is explained, which the drives may not have brought up"
    unknown = [name for name, own in joints.items() if own.unit == "A"]
    if not unknown:
        return
    yield (
        f"no torque was measured, and no factor is known of the currents of {', '.join(unknown)}: errors, gains and "
        "friction are in amperes, and only ratios within a joint are known (torque_constant_nm_a in robot.yaml)"
    )
    scaled = [name for name in unknown if joints[name].factor is not None]
    if scaled:
        yield f"{SCALED} ({', '.join(scaled)})"
    lost = [name for name in unknown if joints[name].factor is None]
    if lost:
        yield f"these motions and the model's masses do not tell the factor of {', '.join(lost)}"
