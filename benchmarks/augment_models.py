"""The models that `python -m benchmarks augment` compares: what each is trained on, and training them.

    python -m benchmarks.augment_models                    # all that are missing, one process per core
    python -m benchmarks.augment_models realeasy gru       # these, one after the other

Everything is kept under runs/augment, so that an interrupted call goes on where it was.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from trueup.augment import AugmentConfig, preset
from trueup.augment.config import DataConfig, LossConfig, NetworkConfig, WindowConfig
from trueup.core.workers import in_processes
from trueup.dataset import Dataset, is_dataset
from trueup.lab import LabSpec
from trueup.record import load_plans
from trueup.robots import load_robot
from trueup.stages import FITTED, STOCK, LabRig, augment, fit, import_logs, record, replay

FOLDER = Path("runs") / "augment"
JOBS = os.cpu_count() or 1
GOOD, ROUGH = STOCK, "mujoco/rough"
TRAIN_UNIT = 1
# Realeasy's "another robot": motions of other seeds, none of which is trained on.
OTHER_UNITS = (2, 3)
# The zoo's model must serve robots that nobody has recorded yet.
ZOO_UNITS = (1, 4, 6, 7)
AMOUNTS = (86, 344)


@dataclass(frozen=True)
class Model:
    """One model.

    Attributes:
        config: how it is trained.
        run: what it corrects.
        units: whose motions it is trained on.
        train_motions: how many of them; all if None.
    """

    config: AugmentConfig
    run: str = GOOD
    units: tuple[int, ...] = (TRAIN_UNIT,)
    train_motions: int | None = None


def _amount(count: int | None, target: str) -> Model:
    """As many steps whatever the amount, so that only the data differ (LSTM thesis, Fig. 12)."""
    config = preset("realeasy-rt")
    draws = round(2 * 1376 / (count or 1376))
    # In normalized units, as the thesis has it: in those of the simulator, positions would be all that counts to a
    # network that must make them anew.
    loss = LossConfig("residual" if target == "residual" else "plain", "normalized")
    return Model(replace(config, loss=loss, epochs=20, window=WindowConfig("fixed", draws=draws)), train_motions=count)


def _arm(method: str) -> Model:
    """Few motions of one arm: few units, few steps; chosen by leaving out quarters of the train motions."""
    config = preset(method)
    return Model(
        replace(
            config,
            network=NetworkConfig("lstm", (32,), bidirectional=method == "realeasy"),
            data=DataConfig(signals=("position",), reads=("velocity",), command=("position",)),
            window=WindowConfig("fixed", samples=150, draws=1),
            epochs=10,
            stop_after=0,
        ),
        run=FITTED,
        units=(),
    )


MODELS: Mapping[str, Model] = {
    "realeasy": Model(preset("realeasy")),
    "realeasy-rt": Model(preset("realeasy-rt")),
    "paper": Model(preset("realeasy", paper=True)),
    "paper-rt": Model(preset("realeasy-rt", paper=True)),
    **{name: Model(preset(name)) for name in ("gru", "mlp", "linear", "transformer")},
    **{name: Model(preset(name)) for name in ("moving-average", "moving-average-rt")},
    "rough": Model(preset("realeasy"), ROUGH),
    "rough-rt": Model(preset("realeasy-rt"), ROUGH),
    "panda-realeasy-rt": Model(preset("realeasy-rt"), units=ZOO_UNITS),
    **{f"amount-{count}-{target}": _amount(count, target) for count in AMOUNTS for target in ("residual", "plain")},
    **{f"amount-1376-{target}": _amount(None, target) for target in ("residual", "plain")},
}
ARM_MODELS: Mapping[str, Model] = {"so101-precise": _arm("realeasy"), "so101-rt": _arm("realeasy-rt")}


def data_of(unit: int, scale: float = 1.0, seed: int | None = None) -> Dataset:
    """The papers' motions on one unit, with both runs; recorded if they are not there. Seeds differ between units."""
    folder = FOLDER / "data" / f"unit{unit}-{scale:g}"
    if not is_dataset(folder):
        plans = replace(load_plans("paper"), seed=unit if seed is None else seed).scaled(scale)
        record(folder, load_robot("panda"), LabRig(LabSpec(), number=unit, seed=unit), plans, jobs=JOBS, resume=True)
    data = Dataset(folder)
    for robot, run in (("panda", GOOD), ("panda_rough", ROUGH)):
        replay(data, load_robot(robot), label=run, jobs=JOBS, resume=True)
    return data


def train(name: str) -> Path:
    """Train a model on its data, or find it trained; returns its folder."""
    model = {**MODELS, **ARM_MODELS}[name]
    arm = so101() if name in ARM_MODELS else None
    data = [data_of(unit, _scale(model)) for unit in model.units] if arm is None else [arm]
    return _train(name, [item.path for item in data])


def _train(name: str, data: Sequence[Path]) -> Path:
    """`train` on datasets that are there; several of these may run at once."""
    model = {**MODELS, **ARM_MODELS}[name]
    folder = FOLDER / "models" / name
    augment(
        [Dataset(path) for path in data],
        folder,
        run=model.run,
        config=model.config,
        robot=load_robot("so101" if name in ARM_MODELS else "panda"),
        name=name,
        train_motions=model.train_motions,
        jobs=1,
        resume=True,
    )
    return folder


def so101() -> Dataset | None:
    """The recorded arm with the run of its identified simulator; None where the recordings are not there."""
    logs = Path(os.environ.get("TRUEUP_SHARED", "../shared")) / "data" / "so101_sage"
    folder = FOLDER / "data" / "so101"
    if not logs.is_dir():
        return None
    robot = load_robot("so101")
    if not is_dataset(folder):
        import_logs(logs, folder, format="sage", robot=robot, resume=True)
    if FITTED not in Dataset(folder).runs:
        fit(Dataset(folder), robot, FOLDER / "so101_fit", resume=True)
    return Dataset(folder)


def train_all() -> None:
    """Train every model that is missing, one process per core."""
    wanted = {(unit, _scale(model)) for model in MODELS.values() for unit in model.units}
    made = {key: data_of(*key).path for key in sorted(wanted)}
    tasks = [(name, [made[unit, _scale(model)] for unit in model.units]) for name, model in MODELS.items()]
    arm = so101()
    if arm is not None:
        tasks += [(name, [arm.path]) for name in ARM_MODELS]
    for folder in in_processes(_train_task, tasks, jobs=JOBS, begin=_ready):
        print(folder, flush=True)


def _train_task(task: tuple[str, list[Path]]) -> Path:
    return _train(*task)


def _scale(model: Model) -> float:
    return 1.0 if model.units == (TRAIN_UNIT,) else 0.4


def _ready() -> None:
    """Nothing to prepare in a process."""


def main() -> None:
    """Train the named models, or all of them."""
    names = sys.argv[1:]
    if names:
        for name in names:
            print(train(name))
        return
    train_all()


if __name__ == "__main__":
    main()
