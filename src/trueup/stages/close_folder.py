"""The folder of a close: which step is done in it, from what, and what it leaves behind."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from trueup.core.atomic import as_read_back, remove, write_text
from trueup.core.augment_result import AUGMENT_NAME
from trueup.core.check_result import CHECK_NAME
from trueup.core.close_result import CLOSE_NAME, STEPS, CloseResult, Step, StepName, StepStatus
from trueup.core.results import Ladder
from trueup.errors import ConfigError, MissingDependency, OutputExists, TrueupError
from trueup.stages.close_asked import refuse_other
from trueup.stages.folder import forget_fit

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig

NETWORKS = "networks"
EXPLAIN_NAME = "explain.json"
EXPLAIN_CONFIG, IDENTIFY_CONFIG = "explain.yaml", "identify.yaml"
LADDER_NAME = "ladder.json"
# Where the new close stands while the results of an earlier one are still there; as close.json.
REPLACING_NAME = ".trueup-replacing.json"
# Steps after which what was measured before is outdated.
_MAKE_RUNS = ("replay", "identify", "augment")


def may_begin(path: Path, *, overwrite: bool, resume: bool) -> None:
    """Refuse a folder that holds results, and options that contradict each other.

    Raises:
        OutputExists: it is not empty, and neither is given.
        ConfigError: both are.
    """
    if overwrite and resume:
        raise ConfigError("--overwrite begins anew and --resume goes on", hint="Give one of them.")
    if any(path.iterdir()) and not (overwrite or resume):
        raise OutputExists(f"{path} is not empty", hint="Give --overwrite or --resume, or choose another --out.")


class StepOutcome:
    """What a step says of itself while it is done.

    Attributes:
        what: what came of it.
        status: of `Step`, or what it was when it was done.
        kept: whether an earlier call has done it.
        made: whether a step that makes runs has made any, so that what was measured before is outdated.
        inputs: of `Step`.
    """

    def __init__(self) -> None:
        self.what, self.inputs = "", ""
        self.status: StepStatus = "done"
        self.kept, self.made = False, True


class CloseFolder:
    """Writes close.json after every step, so that a call that was interrupted can be told from one that ended.

    What an earlier call has noted stays until a step is done again. What is to be replaced stays until `begin_anew`.

    Args:
        path: the folder.
        until: the last step.
        budget_s: of the call.
        overwrite: begin anew.
        provenance: of the result.

    Attributes:
        path: the folder.
        overwrite: whether nothing counts that an earlier close has left: that was asked for, in this call or in one
            that was interrupted before it came to it.
        result: as far as this call went.
    """

    def __init__(
        self, path: Path, *, until: StepName, budget_s: float | None, overwrite: bool, provenance: Mapping[str, Any]
    ) -> None:
        self.path = path
        self._noted = (path / REPLACING_NAME).is_file()
        self.overwrite = overwrite or self._noted
        self._replacing = self.overwrite and any(path.iterdir())
        file = path / (REPLACING_NAME if self._noted else CLOSE_NAME)
        known = CloseResult.load(file) if file.is_file() and not overwrite else CloseResult((), until)
        self._earlier = known
        self._made = False
        self.result = replace(
            known,
            steps=tuple(step.of_earlier_call for step in known.steps),
            until=until,
            budget_s=budget_s,
            provenance=provenance,
        )

    def agree(self, asked: Mapping[str, Any], *, data_hash: str | None = None) -> None:
        """Note what decides about the results; it is written with the next step.

        Args:
            asked: name -> what was asked for, or its hash.
            data_hash: of the dataset, once there is one.

        Raises:
            OutputExists: an earlier call was asked for something else.
        """
        refuse_other(self.path, self._earlier.asked, asked)
        origin = {**self.result.provenance, **({} if data_hash is None else {"data_hash": data_hash})}
        self.result = replace(self.result, asked={**self.result.asked, **asked}, provenance=origin)

    @contextlib.contextmanager
    def replacing(self) -> Iterator[None]:
        """While it is not sure yet that there will be new results in place of those of an earlier close.

        That these are to go is noted first. Without that note, a call that goes on from one that was killed would take
        them for those of the new close. A call that fails before it has made anything takes the note back.
        """
        if self._replacing:
            self._save()
        try:
            yield
        except TrueupError:
            if self._replacing and not self._noted and not self.result.steps:
                remove(self.path / REPLACING_NAME)
            raise

    def begin_anew(self) -> None:
        """Remove what other data, or another configuration, have left: the new close takes its place."""
        forget_fit(self.path)
        for name in (CHECK_NAME, EXPLAIN_NAME, EXPLAIN_CONFIG, IDENTIFY_CONFIG, AUGMENT_NAME, LADDER_NAME, "gap.json"):
            remove(self.path / name)
        shutil.rmtree(self.networks, ignore_errors=True)
        self._replacing = False
        self._save()
        remove(self.path / REPLACING_NAME)

    def earlier(self, name: StepName) -> Step | None:
        """The step as an earlier call has finished it."""
        step = self._earlier.step(name)
        return step if step is not None and step.finished else None

    @contextlib.contextmanager
    def step(self, name: StepName, *, may_fail: bool = False) -> Iterator[StepOutcome]:
        """Do a step, and note how that went.

        Args:
            name: which.
            may_fail: whether the others go on without it; not where the folder holds something else.
        """
        began = time.perf_counter()
        outcome = StepOutcome()
        try:
            yield outcome
        except TrueupError as error:
            if isinstance(error, OutputExists) or not may_fail:
                raise
            outcome.status = "left out" if isinstance(error, MissingDependency) else "failed"
            outcome.what = error.summary + (f" ({' '.join(error.hint.split())})" if error.hint else "")
        done = Step(name, outcome.status, time.perf_counter() - began, outcome.what, outcome.inputs)
        if outcome.kept:
            earlier = self.earlier(name)  # the time that it took when it was done
            seconds = done.seconds if earlier is None else earlier.seconds
            done = replace(done, seconds=seconds).of_earlier_call
        elif done.finished and outcome.made and name in _MAKE_RUNS:
            self._made = True
        self._note(done)

    @property
    def networks(self) -> Path:
        """Where networks are trained."""
        return self.path / NETWORKS

    def holds_more(self, rungs: Collection[str], data_hash: str) -> bool:
        """Whether the folder has a ladder with these rungs and others, which nothing in this call has outdated."""
        file = self.path / LADDER_NAME
        if self._made or self.overwrite or not file.is_file() or not (self.path / "gap.json").is_file():
            return False
        there = Ladder.load(file)
        same_data = there.provenance.get("data_hash") == data_hash
        return same_data and {rung.name for rung in there.rungs} - {"command"} > set(rungs)

    def identify_config(self, make: Callable[[], IdentifyConfig]) -> IdentifyConfig:
        """What is fitted: as an earlier call has chosen for its time, so that its fit is gone on with; else made now.

        It is kept in identify.yaml, for `trueup identify --config`.
        """
        from trueup.identify import IdentifyConfig

        path = self.path / IDENTIFY_CONFIG
        if path.is_file():
            return IdentifyConfig.load(path)
        return self.keep_config(IDENTIFY_CONFIG, make())

    def keep_config(self, name: str, config: IdentifyConfig) -> IdentifyConfig:
        """The configuration, which is written for the command of its step alone."""
        write_text(self.path / name, yaml.safe_dump(as_read_back(config.to_json()), sort_keys=False))
        return config

    def leave_out(self, name: StepName, why: str) -> None:
        """Note a step that is not done."""
        self._note(Step(name, "left out", 0.0, why))

    def add_network(self, label: str, folder: Path) -> None:
        """Note whose corrections a run holds."""
        networks = {**self.result.networks, label: folder.relative_to(self.path).as_posix()}
        self.result = replace(self.result, networks=networks)

    def measured(self, seconds: float) -> None:
        """Note what the last measurement took [s]."""
        self.result = replace(self.result, measuring_s=seconds)
        self._save()

    def _note(self, step: Step) -> None:
        steps = [item for item in self.result.steps if item.name != step.name]
        steps = sorted([*steps, step], key=lambda item: STEPS.index(item.name))
        self.result = replace(self.result, steps=tuple(steps))
        self._save()

    def _save(self) -> None:
        self.result.save(self.path / (REPLACING_NAME if self._replacing else CLOSE_NAME))
