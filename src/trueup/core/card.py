"""Cards: JSON that says what a folder of files is, with a schema and a hash over all the rest."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trueup.core.atomic import as_read_back, json_hash, regular, without_nan
from trueup.errors import DataError, FormatError

_HASH = "sha256"
# What a folder is that has a file of this name.
_MARKS = {
    "model.json": "a network",
    "policy.json": "a policy",
    "dataset.json": "a dataset",
    "model.onnx": "a network without its model.json",
    "policy.onnx": "a policy without its policy.json",
    "checkpoint.safetensors": "a training that has not ended",
}
_RESULTS = "gap.json"


def sealed(schema: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a card's file."""
    plain = as_read_back({"schema": schema, **without_nan(dict(content))})
    return {**plain, _HASH: json_hash(plain)}


def unsealed(data: Any, where: str, *, schema: str, what: str) -> dict[str, Any]:
    """What `sealed` was given.

    Args:
        data: the content of a file.
        where: its name, for messages.
        schema: that is expected.
        what: for messages, e.g. `network`.

    Raises:
        FormatError: no such card, or one of another version.
        DataError: it was changed after it was written.
    """
    found = data.get("schema") if isinstance(data, Mapping) else type(data).__name__
    if found != schema:
        raise FormatError(f"{where} describes no {what} of this version", got=found, expected=schema)
    content = {key: value for key, value in data.items() if key != _HASH}
    if data.get(_HASH) != json_hash(content):
        raise DataError(
            f"{where} was changed after it was written (its hash differs)",
            hint="Export the model again, or fetch it again.",
        )
    del content["schema"]
    return content


def what_is(folder: Path) -> str:
    """What there is instead of the folder of a card, for messages."""
    if not folder.is_dir():
        return "a file" if folder.exists() else "no such folder"
    for name, what in _MARKS.items():
        if (folder / name).is_file():
            return what
    cards = [path for below in ("*", "*/*") for path in folder.glob(f"{below}/model.json")]
    below = sorted(path.parent.relative_to(folder).as_posix() for path in cards)
    if below:
        return f"networks in {', '.join(below[:4])}{', …' if len(below) > 4 else ''}"
    names = sorted(path.name for path in folder.iterdir())
    if not names:
        return "an empty folder"
    return "results" if _RESULTS in names else f"a folder with {names[0]}{' and more' if len(names) > 1 else ''}"


def verified(folder: Path, name: str, files: Mapping[str, str], card: str) -> bytes:
    """The bytes of a file beside a card, after a look at its hash.

    Args:
        folder: of both.
        name: of the file.
        files: name -> SHA-256, as the card says.
        card: the card's name.

    Raises:
        DataError: it is missing, truncated or changed, or the card does not know it.
    """
    if name not in files:
        raise DataError(f"{folder / card} knows no {name}", available=files)
    try:
        data = regular(folder / name).read_bytes()
    except OSError as error:
        raise DataError(f"cannot read {folder / name}", got=error.strerror or str(error)) from error
    found = hashlib.sha256(data).hexdigest()
    if found != files[name]:
        raise DataError(
            f"{folder / name} is not the file that {card} describes",
            got=f"{len(data)} bytes, SHA-256 {found[:12]}…",
            expected=f"{files[name][:12]}…",
            hint="It is truncated or was replaced: export the model again, or fetch it again.",
        )
    return data
