"""The folder of a close: which step is done in it, from what, and what it leaves behind."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from trueup.core.atomic import as_read_back, write_text
from trueup.core.close_result import CLOSE_NAME, STEPS, CloseResult, Step, StepName
from trueup.errors import MissingDependency, OutputExists, TrueupError

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig

NETWORKS = "networks"
IDENTIFY_NAME = "identify.yaml"


class StepOutcome:
    """What a step says of itself while it is done.

    Attributes:
        what: what came of it.
        status: of `Step`.
        inputs: of `Step`.
    """

    def __init__(self) -> None:
        self.what, self.inputs = "", ""
        self.status: str = "done"


class CloseFolder:
    """Writes close.json after every step, so that a call that was interrupted can be told from one that ended.

    Args:
        path: the folder.
        until: the last step.
        budget_s: of the call.
        provenance: of the result.
    """

    def __init__(self, path: Path, *, until: StepName, budget_s: float | None, provenance: Mapping[str, Any]) -> None:
        self.path = path
        file = path / CLOSE_NAME
        self._earlier = CloseResult.load(file) if file.is_file() else None
        self.result = CloseResult((), until, budget_s, provenance=provenance)

    def earlier(self, name: StepName) -> Step | None:
        """The step as an earlier call left it."""
        return None if self._earlier is None else self._earlier.step(name)

    def asked(self, name: StepName) -> bool:
        """Whether a step is to be done."""
        return STEPS.index(name) <= STEPS.index(self.result.until)

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
        self._note(Step(name, outcome.status, time.perf_counter() - began, outcome.what, outcome.inputs))  # type: ignore[arg-type]

    @property
    def networks(self) -> Path:
        """Where networks are trained."""
        return self.path / NETWORKS

    def identify_config(self, make: Callable[[], IdentifyConfig], *, anew: bool) -> IdentifyConfig:
        """What is fitted: as an earlier call has chosen for its time, so that its fit is gone on with; else made now.

        It is kept in identify.yaml, for `trueup identify --config`.
        """
        from trueup.identify import IdentifyConfig

        path = self.path / IDENTIFY_NAME
        if path.is_file() and not anew:
            return IdentifyConfig.load(path)
        config = make()
        if self.result.budget_s is not None:
            write_text(path, yaml.safe_dump(as_read_back(config.to_json()), sort_keys=False))
        return config

    def leave_out(self, name: StepName, why: str) -> None:
        """Note a step that is not done."""
        self._note(Step(name, "left out", 0.0, why))

    def add_network(self, label: str, folder: Path) -> None:
        """Note whose corrections a run holds."""
        networks = {**self.result.networks, label: folder.relative_to(self.path).as_posix()}
        self.result = replace(self.result, networks=networks)

    def _note(self, step: Step) -> None:
        kept = self.earlier(step.name)
        if step.status == "kept" and kept is not None:  # the time that it took when it was done
            step = replace(step, seconds=kept.seconds, inputs=step.inputs or kept.inputs)
        self.result = replace(self.result, steps=(*self.result.steps, step))
        self.result.save(self.path / CLOSE_NAME)
