"""The database of a grid search: Optuna's, in one SQLite file with one writer."""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from trueup.core.atomic import regular, replacing
from trueup.core.config import build
from trueup.errors import DataError, OutputExists, needing
from trueup.policy.grid import Grid, Point
from trueup.policy.training import Round

with needing("searching a grid", "rl"):
    import optuna
    from optuna.samplers import GridSampler
    from optuna.storages import RDBStorage
    from optuna.study import Study
    from optuna.trial import FrozenTrial, TrialState
    from sqlalchemy.exc import SQLAlchemyError
    from sqlalchemy.pool import NullPool


class _Sampler(GridSampler):
    """Points of the grid in an order of its own; trial k of the study has the k-th."""

    def after_trial(self, study: Study, trial: FrozenTrial, state: TrialState, values: Sequence[float] | None) -> None:
        """Nothing: the original ends `Study.optimize`, which nobody runs here."""


class GridStudy:
    """What a grid search knows: which points are taken, and what has become of them.

    Args:
        path: of the database; made if it is not there, whole or not at all.
        asked: hash of what the caller asks for.
        grid: its axes.
        points: of the grid, in its order.

    Raises:
        OutputExists: the database is of another grid.
        DataError: it is broken, or cannot be written.
    """

    def __init__(self, path: Path, asked: str, grid: Grid, points: Sequence[Point]) -> None:
        self._path = path
        self._choices = {axis.title: [_choice(row) for row in axis.rows] for axis in grid.axes}
        self._points = dict(zip(itertools.product(*self._choices.values()), points, strict=True))
        sampler, name = _Sampler(self._choices, seed=0), f"trueup-grid-{asked}"
        with _quiet(), self._usable():
            if not path.is_file():
                with replacing(path) as temporary:
                    storage = _opened(temporary)
                    optuna.create_study(storage=storage, study_name=name, direction="maximize", sampler=sampler)
                    _closed(storage)
            self._storage = _opened(regular(path))
            if optuna.get_all_study_names(self._storage) != [name]:
                _closed(self._storage)
                raise OutputExists(
                    f"{path.parent} holds another grid, or one of another robot, configuration or seed",
                    hint="Give --overwrite to replace it, or choose another --out.",
                )
            self._study = optuna.load_study(storage=self._storage, study_name=name, sampler=sampler)

    def close(self) -> None:
        """Let go of the file."""
        _closed(self._storage)

    def under_way(self) -> list[tuple[int, Point]]:
        """Number and point of each trial that was taken and not told: those of a search that was interrupted."""
        with _quiet(), self._usable():
            running = self._study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
            # One that was killed while it asked has not all its values; asked again, it is given the rest.
            return [self._point(optuna.Trial(self._study, trial._trial_id)) for trial in running]  # noqa: SLF001

    def ask(self) -> tuple[int, Point] | None:
        """Number and point of a new trial; None if each point has one."""
        with _quiet(), self._usable():
            if len(self._study.get_trials(deepcopy=False)) == len(self._points):
                return None
            return self._point(self._study.ask())

    def tell(self, number: int, rounds: Sequence[Round], reason: str = "") -> None:
        """Write down what a trial has come to: the reward of its best round.

        Args:
            number: of the trial.
            rounds: all of them.
            reason: why it failed; nothing if it did not.
        """
        with _quiet(), self._usable():
            (trial,) = [item for item in self._study.get_trials(deepcopy=False) if item.number == number]
            for name, value in (("rounds", [asdict(item) for item in rounds]), ("reason", reason)):
                optuna.Trial(self._study, trial._trial_id).set_user_attr(name, value)  # noqa: SLF001
            if reason:
                self._study.tell(number, state=TrialState.FAIL)
            else:
                self._study.tell(number, max(item.reward for item in rounds))

    def told(self) -> dict[str, tuple[tuple[Round, ...], str]]:
        """Identifier of a point -> its rounds, and why it failed, of all trials that were told."""
        with _quiet(), self._usable():
            ended = self._study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.FAIL))
            return {
                self._points[self._key(trial.params)].id: (
                    tuple(build(Round, item, str(self._path)) for item in trial.user_attrs["rounds"]),
                    trial.user_attrs["reason"],
                )
                for trial in ended
            }

    def _point(self, trial: optuna.Trial) -> tuple[int, Point]:
        values = {name: trial.suggest_categorical(name, choices) for name, choices in self._choices.items()}
        return trial.number, self._points[self._key(values)]

    def _key(self, values: Mapping[str, Any]) -> tuple[Any, ...]:
        return tuple(values[name] for name in self._choices)

    @contextlib.contextmanager
    def _usable(self) -> Iterator[None]:
        try:
            yield
        except (SQLAlchemyError, optuna.exceptions.StorageInternalError, sqlite3.Error, KeyError) as error:
            said = error.__cause__ if isinstance(error.__cause__, SQLAlchemyError) else error
            raise DataError(
                f"cannot use the database {self._path}",
                got=str(getattr(said, "orig", None) or said).split("\n")[0],
                hint="Trials are kept: free space or mend the file, and give the same command with --resume.",
            ) from error


def _choice(row: Sequence[Any]) -> Any:
    """A value that Optuna can store: one that is a list, or several that belong together, as JSON."""
    return (
        row[0] if len(row) == 1 and not isinstance(row[0], list) else json.dumps(list(row) if len(row) > 1 else row[0])
    )


def _opened(path: Path) -> RDBStorage:
    # By a function: a path may have characters that mean something in a URL.
    return RDBStorage("sqlite://", engine_kwargs={"creator": lambda: sqlite3.connect(path), "poolclass": NullPool})


def _closed(storage: RDBStorage) -> None:
    storage.remove_session()
    storage.engine.dispose()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Optuna says on stderr what it is told; here it is the command that says it.

    So does its database, with a traceback, of a connection in whose middle Ctrl-C came: what was being written then is
    asked for again.
    """
    before, pool = optuna.logging.get_verbosity(), logging.getLogger("sqlalchemy.pool")
    level = pool.level
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    pool.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        optuna.logging.set_verbosity(before)
        pool.setLevel(level)
