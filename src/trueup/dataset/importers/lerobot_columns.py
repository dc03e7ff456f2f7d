"""Which columns of a LeRobot dataset hold which signal of which joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from jaxtyping import Float64

from trueup.core.timeseries import TimeSeries
from trueup.core.units import SI_UNIT
from trueup.dataset.importers.base import ASSUMED
from trueup.dataset.importers.lerobot_info import Feature, LeRobotInfo
from trueup.dataset.importers.lerobot_rows import vectors
from trueup.dataset.importers.stated import Stated
from trueup.errors import ConfigError, DataError, MissingSignal

STATE = "observation.state"
ACTION = "action"
# Features beside the state that hold one value per joint.
SIGNAL_FEATURES = {
    "observation.velocity": "velocity",
    "observation.acceleration": "acceleration",
    "observation.effort": "torque",
    "observation.torque": "torque",
    "observation.current": "current",
    "observation.voltage": "voltage",
    "observation.temperature": "temperature",
}
ENDINGS = {
    "pos": "position",
    "vel": "velocity",
    "acc": "acceleration",
    "torque": "torque",
    "effort": "torque",
    "current": "current",
    "voltage": "voltage",
    "temperature": "temperature",
    "temp": "temperature",
}


@dataclass(frozen=True)
class Columns:
    """Which values of which features become a series.

    Attributes:
        joints: names of the joints.
        places: signal -> joint -> feature and number of the value in it.
        features: the features that are needed.
        units: signal -> joint -> unit, where the dataset states it.
        assumed: signals whose unit nobody stated.
        notes: what a person should know.
    """

    joints: tuple[str, ...]
    places: Mapping[str, Mapping[str, tuple[str, int]]]
    features: Mapping[str, Feature]
    units: Mapping[str, Mapping[str, str]]
    assumed: tuple[str, ...]
    notes: tuple[str, ...]

    @staticmethod
    def of(info: LeRobotInfo, series: str, stated: Stated) -> Columns:
        """The columns of `measured` or `command`.

        Raises:
            MissingSignal: there is no `observation.state`.
            ConfigError: a feature has no names and none are stated.
            DataError: a signal of a joint is there twice.
        """
        main = STATE if series == "measured" else ACTION
        if main not in info.features and series == "measured":
            raise MissingSignal(f"the dataset has no {STATE}", available=info.features)
        wanted = {main: "", **(SIGNAL_FEATURES if series == "measured" else {})}
        features = {name: info.features[name] for name in wanted if name in info.features}
        places: dict[str, dict[str, tuple[str, int]]] = {}
        units: dict[str, dict[str, str]] = {}
        notes = [f"there is no {ACTION}: episodes have no command"] if not features else []
        for name, feature in features.items():
            joints = _names(feature, main, stated)
            if not joints:
                notes.append(f"{name} names no joints and is left out")
            for number, label in enumerate(joints):
                signal, joint = _signal_and_joint(label, wanted[name])
                if signal in places and joint in places[signal]:
                    raise DataError(f"{signal} of joint {joint!r} is in the dataset twice", got=f"{name}: {label}")
                places.setdefault(signal, {})[joint] = (name, number)
                if feature.units:
                    units.setdefault(signal, {})[joint] = feature.units[number]
        leading = next((signal for signal in SI_UNIT if signal in places), None)
        joints = tuple(places[leading]) if leading else ()
        extra = sorted({joint for signal in places.values() for joint in signal if joint not in joints})
        if extra:
            notes.append(f"left out of {series}, since they have no {leading}: {', '.join(extra)}")
        places = {signal: found for signal, found in places.items() if set(found) & set(joints)}
        used = {name for found in places.values() for name, _ in found.values()}
        assumed = tuple(
            signal
            for signal, found in places.items()
            if not set(found) <= set(units.get(signal, {}))
            and not any(key.partition(".")[0] == signal for key in stated.units)
        )
        if assumed:
            said = ", ".join(f"{signal} in {SI_UNIT[signal]}" for signal in assumed)
            notes.append(
                f"{ASSUMED}, the dataset states none for {series}: {said}. LeRobot's robots log degrees or "
                "-100 to 100: state the unit, e.g. position=deg or position=%"
            )
        needed = {name: feature for name, feature in features.items() if name in used}
        return Columns(joints, places, needed, units, assumed, tuple(notes))

    def series(self, table: pa.Table, time_s: Float64[np.ndarray, "T"], source: str) -> TimeSeries:
        """The frames of an episode as a time series; a signal that a joint does not have is NaN."""
        arrays = {name: vectors(table, name, feature.width, source) for name, feature in self.features.items()}
        signals = {}
        for signal, found in self.places.items():
            none = np.full(len(time_s), np.nan, dtype=np.float32)
            columns = [arrays[found[j][0]][:, found[j][1]] if j in found else none for j in self.joints]
            signals[signal] = np.stack(columns, axis=1)
        units = {
            signal: tuple(self.units.get(signal, {}).get(joint, SI_UNIT[signal]) for joint in self.joints)
            for signal in self.places
        }
        return TimeSeries(time_s=time_s, joints=self.joints, signals=signals, units=units)


def _names(feature: Feature, main: str, stated: Stated) -> tuple[str, ...]:
    """The labels of a feature's values: its own, or those that the user states."""
    if feature.names:
        return feature.names
    joints = stated.joints.get("", ())
    if main == ACTION:
        joints = stated.command_joints or joints
    if len(joints) == feature.width:
        return joints
    if feature.name != main:
        return ()
    example = ", ".join(f"joint{number + 1}" for number in range(feature.width))
    key = "command_joints" if main == ACTION and joints else "joints"
    raise ConfigError(
        f"{feature.name} does not name its joints",
        got=f"{feature.width} values" + (f", stated names {list(joints)}" if joints else ""),
        hint=f"State them with --mapping FILE, in the dataset's order:\n{key}: [{example}]",
    )


def _signal_and_joint(label: str, signal: str) -> tuple[str, str]:
    """What a label such as `elbow.pos` stands for; the feature's own signal wins over the ending."""
    stem, _, ending = label.rpartition(".")
    if stem and ending in ENDINGS:
        return signal or ENDINGS[ending], stem
    return signal or "position", label
