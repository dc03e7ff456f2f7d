"""Paired payload data in the structure of TWINS (GapONet, 3.2), on virtual hardware and replayed in two engines.

Everything is kept under runs/gapo and made once: `python -m benchmarks.gapo_data` makes what is not there,
`python -m benchmarks.gapo_data train test` these two.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from trueup.core.atomic import write_text
from trueup.dataset import Dataset, is_dataset
from trueup.lab import LabSpec, load_lab
from trueup.lab.spec import Base, Inertial
from trueup.record import PlanSetSpec, RecordSettings, load_plans
from trueup.robots import RobotSpec, load_robot
from trueup.robots.spec import PayloadSpec
from trueup.stages import LabRig, record, replay

FOLDER = Path("runs") / "gapo"
READY = FOLDER / "READY"
RUN = "mujoco/stock"
SEEN_KG, UNSEEN_KG = (0.0, 1.0, 2.0, 3.0), (0.5, 1.5, 2.5, 3.5)
TRAINED_UNITS, TEST_UNIT = (1, 2, 3), 4
CONDITIONS = ("stance", "squat", "gait")
# Of the unseen motions, stance, squat and gait are 6 : 3 : 1 (GapONet, 5.1).
TEST_CONDITIONS = ("stance", "squat", "stance", "gait", "stance", "squat", "stance", "stance", "squat", "stance")
# An arm that knows no weight hangs far from where it should be, and no protective stop is wanted for that.
AT_50_HZ = RecordSettings(control_hz=50.0, record_hz=100.0, tolerance_rad=1.0, path_tolerance_rad=2.0)
AT_100_HZ = replace(AT_50_HZ, control_hz=100.0)
AT_200_HZ = replace(AT_50_HZ, control_hz=200.0, record_hz=200.0)


@dataclass(frozen=True)
class Recorded:
    """What a data set is made of.

    Attributes:
        tested: whether its motions are those of split `test`, or all others.
        units: individuals, which take turns with the conditions from motion to motion.
        conditions: of the base.
        payloads_kg: each motion is recorded with all of them [kg].
        settings: rates and tolerances.
        scale: share of the motions of each group.
        robot: name.
        plans: plan set.
        lab: of the virtual hardware; a Panda's if empty.
        base_sensor: body on which an accelerometer is, which simulations listen to; none if empty.
    """

    tested: bool
    units: tuple[int, ...]
    conditions: tuple[str, ...]
    payloads_kg: tuple[float, ...] = SEEN_KG
    settings: RecordSettings = AT_50_HZ
    scale: float = 1.0
    robot: str = "upper_body"
    plans: str = "upper_body"
    lab: str = "upper_body"
    base_sensor: str = ""


_TRAIN = Recorded(tested=False, units=TRAINED_UNITS, conditions=CONDITIONS)
_TEST = Recorded(tested=True, units=(TEST_UNIT,), conditions=TEST_CONDITIONS)
_PANDA = {"conditions": ("fixed",), "settings": RecordSettings(), "robot": "panda", "plans": "paper", "lab": ""}
DATA: Mapping[str, Recorded] = {
    "train": _TRAIN,
    "test": _TEST,
    "test-unseen-payload": replace(_TEST, payloads_kg=UNSEEN_KG),
    # The same recordings, and what an accelerometer on the torso says meanwhile.
    **{
        f"{name}-sensed": replace(made, base_sensor="torso")
        for name, made in (
            ("train", _TRAIN),
            ("test", _TEST),
            ("test-unseen-payload", replace(_TEST, payloads_kg=UNSEEN_KG)),
        )
    },
    # The same motions on each base (GapONet, 3.3).
    **{name: replace(_TEST, conditions=(name,), payloads_kg=(0.0, 3.0)) for name in CONDITIONS},
    "train-100hz": replace(_TRAIN, settings=AT_100_HZ, payloads_kg=(0.0, 3.0)),
    "test-100hz": replace(_TEST, settings=AT_100_HZ, payloads_kg=(0.0, 3.0)),
    "test-200hz": replace(_TEST, settings=AT_200_HZ, payloads_kg=(0.0, 3.0)),
    "panda-train": Recorded(tested=False, units=TRAINED_UNITS, scale=0.02, **_PANDA),  # type: ignore[arg-type]
    "panda-test": Recorded(tested=True, units=(TEST_UNIT,), scale=0.2, **_PANDA),  # type: ignore[arg-type]
}
# What training waits for.
FIRST = ("train", "test", "test-unseen-payload")
_BOTH_ENGINES = ("test", "test-unseen-payload", "test-100hz", "panda-test")


def data_of(name: str, *, jobs: int = 1, engines: Sequence[str] | None = None) -> Dataset:
    """A recording of virtual hardware with its replays, made as far as it is not there.

    MuJoCo replays all of them, DART, which takes longer than all the rest, those of tests; `engines` says otherwise.
    Units, payloads and conditions are in one data set: each episode says its own. What is there is taken as it is:
    delete its folder to make it anew.
    """
    made, folder, robot = DATA[name], FOLDER / name, robot_of(name)
    if not (is_dataset(folder) and Dataset(folder).info.provenance.get("complete")):
        plans, rigs = plans_of(name), rigs_of(name)
        record(folder, robot, rigs, plans, payloads_kg=made.payloads_kg, settings=made.settings, jobs=jobs)
    for engine in engines or (("mujoco", "dart") if name in _BOTH_ENGINES else ("mujoco",)):
        if not _replayed(Dataset(folder), f"{engine}/stock"):
            replay(Dataset(folder), robot, engine=engine, jobs=jobs, resume=True)
    return Dataset(folder)


def robot_of(name: str) -> RobotSpec:
    """The robot of a data set, which holds its payload where the lab's does."""
    made = DATA[name]
    robot = load_robot(made.robot)
    if made.base_sensor:
        robot = replace(robot, simulation=replace(robot.simulation, base_sensor=made.base_sensor))
    return robot if robot.payload else replace(robot, payload=PayloadSpec(sites=("payload",)))


def rigs_of(name: str) -> list[LabRig]:
    """Every unit on every base, in the order in which they take turns."""
    made = DATA[name]
    lab = load_lab(made.lab) if made.lab else LabSpec(robot=made.robot)
    if made.base_sensor:
        lab = replace(lab, inertial=Inertial(made.base_sensor))
    return [
        LabRig(replace(lab, base=Base(condition=condition)), unit, load_plans(made.plans).seed)  # type: ignore[arg-type]
        for unit, condition in itertools.product(made.units, made.conditions)
    ]


def plans_of(name: str) -> PlanSetSpec:
    """The motions of a data set: those made by hand, or all others."""
    made = DATA[name]
    plans = load_plans(made.plans)
    groups = tuple(group for group in plans.groups if (group.split == "test") == made.tested)
    fractions = {name: share for name, share in plans.fractions.items() if name != "test"}
    whole = sum(fractions.values())
    chosen = replace(plans, groups=groups, fractions={name: share / whole for name, share in fractions.items()})
    return chosen.scaled(made.scale)


def main(names: Sequence[str], *, jobs: int = 2) -> None:
    """Make these data sets, or all; say what each holds, and when those that training needs are there."""
    for name in names or DATA:
        begun = time.perf_counter()
        data = data_of(name, jobs=jobs, engines=("mujoco",))
        warned = sum(meta.warned for meta in data.metas)
        seconds = time.perf_counter() - begun
        print(f"{name}: {len(data)} episodes, {warned} with a warning, in {seconds:.0f} s", flush=True)
        there = [FOLDER / first for first in FIRST]
        if not READY.exists() and all(is_dataset(folder) and _replayed(Dataset(folder), RUN) for folder in there):
            write_text(READY, f"{', '.join(FIRST)} are complete\n")
    for name in names or DATA:
        begun = time.perf_counter()
        runs = data_of(name, jobs=jobs).runs
        print(f"{name}: {', '.join(runs)}, in {time.perf_counter() - begun:.0f} s", flush=True)


def _replayed(data: Dataset, run: str) -> bool:
    return run in data.runs and len(data.run_ids(run)) == len(data)


if __name__ == "__main__":
    main(sys.argv[1:])
