"""Writers that are killed at random moments: what was finished is there, and the same call again completes it.

The process that kills has loaded everything and done nothing, so that a fork of it is a fresh writer without the
seconds of a start; what is checked is checked in forks, too.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from attack.harness import Writer, apart
from attack.parsers_robots import make_robot
from attack.writers_commands import COMMAND_WRITERS
from attack.writers_results import RESULT_WRITERS
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, append, is_dataset
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.detect import find_importer
from trueup.robots import load_robot
from trueup.stages.exporting import export_dataset
from trueup.stages.importing import import_logs
from trueup.stages.replaying import replay

EPISODES = 24
RATE_HZ = 50
IDS = tuple(f"e{number:03d}" for number in range(EPISODES))
FLIPPED = {id: ("train", "test")[number % 2] for number, id in enumerate(IDS)}


def _episode(number: int) -> Episode:
    rng = np.random.default_rng(number)
    time_s = np.arange(40) / RATE_HZ
    names = ("A", "b")
    series = [
        TimeSeries(time_s, names, {"position": 0.1 * rng.normal(size=(40, 2))}, same_units({"position": "rad"}, names))
        for _ in range(2)
    ]
    return Episode(EpisodeMeta(IDS[number], "arm"), series[0], series[1])


def prepare(base: Path) -> None:
    """A dataset, the same as CSV files, and a robot for it."""
    with DatasetWriter.create(base / "data", DatasetInfo(robot="arm")) as writer:
        for number in range(EPISODES):
            writer.append(_episode(number))
    export_dataset(base / "data", base / "csv")
    (base / "robot").mkdir()
    make_robot(base / "robot")
    shutil.copytree(base / "data", base / "out")
    shutil.copytree(base / "data", base / "annotated")


def _same(path: Path, base: Path, *, whole: bool) -> None:
    dataset, original = Dataset(path), Dataset(base / "data")
    assert not whole or dataset.ids == IDS, f"{len(dataset)} episodes"
    for episode in dataset:
        known = original[episode.id]
        for one, other in ((episode.measured, known.measured), (episode.commanded(), known.commanded())):
            assert one.time_s.tobytes() == other.time_s.tobytes(), episode.id
            assert one["position"].tobytes() == other["position"].tobytes(), episode.id


def _clean(path: Path) -> None:
    left = [str(file) for file in path.rglob("*") if file.suffix == ".tmp" or file.name == "journal.bin"]
    assert not left, left


def _import(base: Path) -> None:
    import_logs(base / "csv", base / "imported", resume=True)


def _imported(base: Path) -> None:
    assert Dataset(base / "imported").info.provenance["complete"]
    _same(base / "imported", base, whole=True)
    _clean(base / "imported")


def _imported_part(base: Path) -> None:
    if is_dataset(base / "imported"):
        _same(base / "imported", base, whole=False)
        if Dataset(base / "imported").info.provenance["complete"]:
            _same(base / "imported", base, whole=True)


def _replay(base: Path) -> None:
    robot = load_robot(base / "robot" / "robot.yaml")
    replay(Dataset(base / "out"), robot, label="mujoco/stock", jobs=1, resume=True)


def _replayed_part(base: Path) -> None:
    dataset = Dataset(base / "out")
    if "mujoco/stock" in dataset.runs:
        for id in dataset.run_ids("mujoco/stock"):
            assert np.isfinite(dataset.episode(id, runs=["mujoco/stock"]).simulated["mujoco/stock"]["position"]).all()


def _replayed(base: Path) -> None:
    _replayed_part(base)
    assert set(Dataset(base / "out").run_ids("mujoco/stock")) == set(IDS)
    _same(base / "out", base, whole=True)
    _clean(base / "out")


def _export(format: Literal["csv", "lerobot"]) -> Callable[[Path], None]:
    def export(base: Path) -> None:
        if not (base / f"as {format}" / "x").exists():
            rate_hz = RATE_HZ if format == "lerobot" else None
            export_dataset(base / "data", base / f"as {format}" / "x", format=format, rate_hz=rate_hz)

    return export


def _exported_part(format: str) -> Callable[[Path], None]:
    def check(base: Path) -> None:
        if (base / f"as {format}" / "x").exists():  # whole, or not there
            _exported(format)(base)

    return check


def _exported(format: str) -> Callable[[Path], None]:
    def check(base: Path) -> None:
        logs = base / f"as {format}" / "x"
        episodes = [item.load() for item in find_importer(logs, format).scan(logs, ImportOptions()).episodes]
        assert sorted(episode.id for episode in episodes) == list(IDS)

    return check


def _annotate(base: Path) -> None:
    dataset = Dataset(base / "annotated")
    for _ in range(4):
        dataset.set_splits(dict.fromkeys(IDS, "") if dataset.splits else FLIPPED)
    dataset.set_splits(FLIPPED)


def _annotated_part(base: Path) -> None:
    assert Dataset(base / "annotated").splits in ({}, FLIPPED)
    _same(base / "annotated", base, whole=True)


def _annotated(base: Path) -> None:
    assert Dataset(base / "annotated").splits == FLIPPED
    _same(base / "annotated", base, whole=True)
    _clean(base / "annotated")


_WRITERS = (
    Writer("import", _import, _imported_part, _imported),
    Writer("replay", _replay, _replayed_part, _replayed),
    Writer("export csv", _export("csv"), _exported_part("csv"), _exported("csv")),
    Writer("export lerobot", _export("lerobot"), _exported_part("lerobot"), _exported("lerobot")),
    Writer("annotations", _annotate, _annotated_part, _annotated),
)


WRITERS = {writer.name: writer for writer in (*_WRITERS, *RESULT_WRITERS, *COMMAND_WRITERS)}


def forked(what: Callable[[Path], object], base: Path, *, kill_after_s: float | None = None) -> tuple[str, float]:
    """Do it in a fork: what it complained of, and how long it took [s]; killed after some time if asked for."""
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        try:
            append.MAX_PENDING = 7  # several shards, so that there is something to be killed in between
            what(base)
            os._exit(0)
        except BaseException:
            (base / "complaint").write_text(traceback.format_exc())
            os._exit(1)
    if kill_after_s is not None:
        time.sleep(kill_after_s)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    failed = os.WIFEXITED(status) and os.WEXITSTATUS(status) != 0
    return (base / "complaint").read_text()[-1500:] if failed else "", time.monotonic() - start


def assaulted(name: str, base: Path, kills: int) -> dict[int, str]:
    """Kill a writer so many times, in processes that are free to be forked; what went wrong after which kill."""
    return dict(apart(assault, name, base, kills))


def prepared(writer: Writer, base: Path) -> Path:
    """Make what is there before a writer, in an empty base folder; returns a copy of that."""
    shutil.rmtree(base, ignore_errors=True)
    base.mkdir(parents=True)
    backup = base.with_name("backup")
    complaint, _ = forked(writer.prepare or prepare, base)
    assert not complaint, complaint
    shutil.rmtree(backup, ignore_errors=True)
    shutil.copytree(base, backup)
    return backup


def assault(name: str, base: Path, kills: int) -> dict[int, str]:
    """Kill a writer so many times, now and then going on to the end; what went wrong after which kill."""
    writer, rng = WRITERS[name], random.Random(name)
    wrong: dict[int, str] = {}
    backup = prepared(writer, base)
    complaint, whole_s = forked(writer.write, base)
    for number in range(kills):
        if number == 0 or rng.random() < 0.4:  # else the next call goes on where this one was killed
            complaint = complaint or forked(writer.write, base)[0] or forked(writer.check_whole, base)[0]
            shutil.rmtree(base)
            shutil.copytree(backup, base)
        forked(writer.write, base, kill_after_s=rng.uniform(0, 1.1 * whole_s))
        complaint = complaint or forked(writer.check_part, base)[0]
        if complaint:
            wrong[number], complaint = complaint, ""
    complaint = forked(writer.write, base)[0] or forked(writer.check_whole, base)[0]
    return {**wrong, kills: complaint} if complaint else wrong
