"""Start detection on recordings of the virtual robot, whose true starts are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.table import Row, at_least, shown
from trueup.align import align_starts, detect_motion_start
from trueup.core.episode import Episode, EpisodeMeta
from trueup.lab import Execution, LabSpec, VirtualRobot
from trueup.record import Recorder, load_plans
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode
from trueup.stages.rigs import LabRig

_UNIT = 3
_STEP_S = 0.01  # of the recordings
# A joint has left its rest when its true angle is this far from it: one and a half steps of its encoder.
_LEFT_RAD = 1.5 * 2 * np.pi / 2**17


def run() -> list[Row]:
    """A tenth of the papers' motions: share of starts that are found within one sample; about half a minute."""
    robot = load_robot("panda")
    spec = load_plans("paper").scaled(0.1)
    scene, ways = spec.scene(robot), replace(spec, clearance_m=spec.clearance_m / 2).scene(robot)
    simulator, settings = MujocoSimulator.from_robot(robot, find_model(robot)), ReplaySettings.of(robot)
    rig, rng = LabRig(LabSpec(), _UNIT), np.random.default_rng(0)
    off: dict[str, list[float]] = {"start of a motion": [], "shift by a cut": [], "shift, simulated": []}
    for number in range(len(spec)):
        plan = spec.plan(scene, number)
        witness = _Witness(rig.session(number, 0.0))
        done = Recorder(witness, ways).record(plan)
        found = detect_motion_start(done.measured).row
        off["start of a motion"].append(
            np.inf if found is None else found - np.ceil(witness.start_s() / _STEP_S - 1e-6)
        )
        # Another past for the detection; the clock is kept, so that the true shift is nothing.
        cut = done.measured.rows(slice(int(rng.integers(1, 35)), None))
        simulated = replay_episode(Episode(EpisodeMeta(plan.id), done.measured, done.command), simulator, settings)
        off["shift by a cut"].append(align_starts(cut, done.measured) / _STEP_S)
        off["shift, simulated"].append(align_starts(cut, simulated) / _STEP_S)
    rows = [
        at_least(f"{name}: within one sample", 100 * float(np.mean(np.abs(values) < 1.5)), 99.0, "%")
        for name, values in off.items()
    ]
    return [*rows, shown("motions", len(spec), "")]


class _Witness:
    """The robot, and what is true of the trajectory that it followed last."""

    def __init__(self, robot: VirtualRobot) -> None:
        self._robot = robot
        self._last: Execution | None = None

    def __getattr__(self, name: str):
        return getattr(self._robot, name)

    def execute(self, command, *, every: int = 1) -> Execution:
        done = self._robot.execute(command)
        self._last = done
        return replace(done, measured=done.measured.rows(slice(None, None, every)))

    def start_s(self) -> float:
        """When the first joint truly left its rest [s]."""
        position = self._last.truth["position"]
        away = np.abs(position - position[:450].mean(axis=0)).max(axis=1)
        return float(np.argmax(away > _LEFT_RAD) * 1e-3)
