"""A dataset on disk: read, and resumed by a writer; split files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from attack.harness import Parser, Unsound
from dataset.store_cases import INFO, make_episode, make_series, same_episode
from trueup.dataset import Dataset, DatasetWriter, RunWriter, match_splits, read_split
from trueup.dataset.export_csv import export_csv
from trueup.errors import TrueupError

EPISODES = 3


def make_dataset(folder: Path) -> None:
    """Two episodes in shards, one in the journal of a dead writer, and a run of which one is in a journal, too."""
    path = folder / "d"
    with DatasetWriter.create(path, INFO) as writer:
        for number in range(EPISODES - 1):
            writer.append(make_episode(number, samples=6, flagged=True))
    with RunWriter(path, "mujoco/stock", run_info={"x": 1}) as run:
        run.append("e000", make_series(9, 6))
    run = RunWriter(path, "mujoco/stock", run_info={"x": 1}, resume=True)
    run.append("e001", make_series(9, 6))
    run.release()
    writer = DatasetWriter.resume(path)
    writer.append(make_episode(EPISODES - 1, samples=6, flagged=True))
    writer.release()


def _read_all(path: Path) -> Iterator[Exception]:
    dataset = Dataset(path)
    _ = dataset.metas, dataset.hash, dataset.splits, dataset.info.model_path(path)
    for id in dataset.ids:
        try:
            dataset.episode(id)
        except TrueupError as error:
            yield error
    for label in dataset.runs:
        try:
            dataset.run_info(label)
            for id in dataset.run_ids(label):
                dataset.episode(id, runs=[label])
        except TrueupError as error:
            yield error


def read_dataset(folder: Path) -> Iterator[Exception]:
    """Everything, and write it again as CSV."""
    yield from _read_all(folder / "d")
    export_csv(Dataset(folder / "d").episodes(), folder / "exported")


def resume_dataset(folder: Path) -> Iterator[Exception]:
    """Go on writing into what is there, and read it all."""
    path = folder / "d"
    try:
        with DatasetWriter.resume(path, INFO) as writer:
            writer.append(make_episode(10, samples=6))
        with RunWriter(path, "mujoco/stock", run_info={"x": 1}, resume=True) as run:
            run.append("e010", make_series(9, 6))
    except TrueupError as error:
        yield error
    else:
        if not same_episode(Dataset(path)["e010"], make_episode(10, samples=6)):
            raise Unsound("what was written is not what is read")
    yield from _read_all(path)


def overwrite_dataset(folder: Path) -> Iterator[Exception]:
    """Replace what is there."""
    path = folder / "d"
    with DatasetWriter.create(path, INFO, overwrite=True) as writer:
        writer.append(make_episode(10, samples=6))
    if Dataset(path).ids != ("e010",):
        raise Unsound("other episodes than were written")
    yield from ()


def make_split(folder: Path) -> None:
    """Entries of every kind."""
    (folder / "split.json").write_text(
        '{"train": ["one", "session1/two.csv"], "val": ["three (a.csv)"], "test": ["four"]}'
    )


def read_splits(folder: Path) -> Iterator[Exception]:
    """Which episodes are meant."""
    ids = ("one", "session1/two", "three/a", "three/b", "four", "x/four2")
    match = match_splits(read_split(folder / "split.json"), ids)
    if not set(match.splits) <= set(ids) or not set(match.splits.values()) <= {"train", "val", "test"}:
        raise Unsound(f"{match.splits}")
    yield from ()


PARSERS = (
    Parser("dataset, read", make_dataset, read_dataset),
    Parser("dataset, resumed", make_dataset, resume_dataset),
    Parser("dataset, overwritten", make_dataset, overwrite_dataset),
    Parser("split file", make_split, read_splits),
)
