"""A model's folder while a network is trained into it: what may be there, what is under way, what is left behind."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueup.augment.config import CHECKPOINT_NAME
from trueup.core.atomic import file_hash, left_behind, make_folder, read_json, remove, write_json
from trueup.core.model_card import CARD_NAME, ONNX_NAME, STEP_NAME, WEIGHTS_NAME, ModelCard
from trueup.core.policy_card import POLICY_CARD, POLICY_GRAPH, POLICY_LEARNER, PolicyCard
from trueup.errors import DataError, OutputExists, TrueupError

# Names that nobody else gives: what is called so is deleted.
SCRATCH_NAME = ".trueup-pairs"
_REPLACING = ".trueup-replacing.json"


@dataclass(frozen=True)
class Kind:
    """What is trained into a folder.

    Attributes:
        card: the file that is written last.
        files: the others.
        provenance: what the card in a folder says of where it comes from.
        differs: that another one was asked for, in words.
    """

    card: str
    files: tuple[str, ...]
    provenance: Callable[[Path], Mapping[str, Any]]
    differs: str


NETWORK = Kind(
    CARD_NAME,
    (ONNX_NAME, WEIGHTS_NAME, STEP_NAME),
    lambda path: ModelCard.load(path).provenance,
    "a model of other data, or of another run, name, configuration or seed",
)
POLICY = Kind(
    POLICY_CARD,
    (POLICY_GRAPH, POLICY_LEARNER),
    lambda path: PolicyCard.load(path).provenance,
    "a policy of another robot, configuration or seed",
)


class ModelFolder:
    """A folder that gets a model, once; one that is there already stays until the new one takes its place.

    Args:
        path: the folder.
        asked: hash of what the caller asks for.
        kind: of model.

    Attributes:
        path: the folder.
        checkpoint: where a training keeps what it has.
    """

    def __init__(self, path: Path, asked: str, kind: Kind = NETWORK) -> None:
        self.path = path
        self._asked, self._kind = asked, kind
        self._card = path / kind.card
        self.checkpoint = path / CHECKPOINT_NAME
        self._replacing = path / _REPLACING

    @staticmethod
    def refuse_full(path: Path) -> None:
        """Refuse a folder with something in it; what a training that was killed has left behind is nothing.

        Raises:
            OutputExists: it is not empty.
        """
        if any(file.name != SCRATCH_NAME for file in path.iterdir()):
            raise OutputExists(f"{path} is not empty", hint="Give --overwrite or --resume, or choose another --out.")

    def is_finished(self) -> bool:
        """Whether the model that was asked for is there; not so where it is an old one that is being replaced.

        Raises:
            OutputExists: there is another model, or the training of one.
            DataError: a file of it is broken.
        """
        if not self._card.is_file():
            return False
        if self._replacing.is_file():
            under_way = read_json(self._replacing)
            if not isinstance(under_way, dict) or under_way.keys() != {"asked", "card"}:
                raise DataError(f"{self._replacing} is broken", hint="Give --overwrite to begin anew.")
            if under_way["card"] == file_hash(self._card):
                if under_way["asked"] != self._asked:
                    raise OutputExists(
                        f"{self.path} holds the training of another configuration, seed or data",
                        hint="Give --overwrite to begin anew, or choose another --out.",
                    )
                return False
        if self._kind.provenance(self.path).get("asked") != self._asked:
            raise OutputExists(
                f"{self.path} holds {self._kind.differs}",
                hint="Give --overwrite to replace it, or choose another --out.",
            )
        return True

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """An empty folder for what only training needs; gone when training ends, however it ends."""
        scratch = self.path / SCRATCH_NAME
        shutil.rmtree(scratch, ignore_errors=True)
        make_folder(scratch)
        try:
            yield scratch
        except TrueupError:
            if not self.checkpoint.is_file():  # nothing is there that one could go on with
                remove(self._replacing)
            raise
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def begin_anew(self) -> None:
        """Forget an earlier training that did not end, and note which model is about to be replaced.

        Without that note `resume` would take the old model for the new one.
        """
        remove(self.checkpoint)
        if self._card.is_file():
            write_json(self._replacing, {"asked": self._asked, "card": file_hash(self._card)})

    def clean(self) -> None:
        """Leave nothing but the model."""
        remove(self._replacing)
        remove(self.checkpoint)
        shutil.rmtree(self.path / SCRATCH_NAME, ignore_errors=True)
        for name in (CHECKPOINT_NAME, self._kind.card, *self._kind.files, _REPLACING):
            for left in left_behind(self.path / name):
                left.unlink(missing_ok=True)
