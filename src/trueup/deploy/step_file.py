"""`step.npz` beside a graph: what machine code for one step reads, arrays by their names."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trueup.core.model_card import STEP_NAME, ModelCard
from trueup.core.npz import arrays_of
from trueup.errors import DataError


@dataclass(frozen=True, eq=False)
class StepFile:
    """What was read.

    Attributes:
        path: of the file, for messages.
        arrays: name -> array; nothing of them was looked at.
    """

    path: Path
    arrays: Mapping[str, np.ndarray]

    @staticmethod
    def load(folder: Path, card: ModelCard) -> StepFile | None:
        """That of a model folder; None if it has none.

        Raises:
            DataError: it is missing although the card knows it, changed, or no such file.
        """
        if STEP_NAME not in card.files:
            return None
        data, path = card.verified(folder, STEP_NAME), folder / STEP_NAME
        try:
            return StepFile(path, arrays_of(data, path))
        except DataError as error:
            raise DataError(f"{path} holds no weights of a step", got=error.summary) from error


@contextlib.contextmanager
def refusing(path: Path) -> Iterator[None]:
    """Whatever goes wrong in here, the file holds something else."""
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, ZeroDivisionError) as error:
        raise DataError(f"{path} holds no weights of a step", got=error) from error


def packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    """The content of a file; the same for the same arrays."""
    out = io.BytesIO()
    np.savez(out, **arrays)  # type: ignore[arg-type]  # its signature has a flag among the arrays
    return out.getvalue()
