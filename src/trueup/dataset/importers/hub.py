"""Datasets of the Hugging Face Hub by their names, through the package huggingface_hub where it is installed."""

from __future__ import annotations

import re
from pathlib import Path

from trueup.errors import DataError

# A path takes one of two slashes away.
_ID = re.compile(r"(?P<asked>hf:/)?(?P<name>[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*)")
# What a LeRobot dataset has besides its videos.
_WANTED = ["meta/**", "data/**", "model/**", "LICENSE*", "*.json", "*.yaml"]


def local_copy(source: Path) -> Path:
    """Where a dataset of the Hub lies on this computer.

    `hf://USER/NAME` is fetched, or, without a connection, taken as it was fetched before. `USER/NAME` alone is only
    taken where it was fetched before: a mistyped path is nobody else's business.

    Returns:
        `source` itself where it is no such name.

    Raises:
        DataError: huggingface_hub is missing, or there is no such dataset.
    """
    found = _ID.fullmatch(source.as_posix())
    if found is None or (not found["asked"] and (source.exists() or source.parent.is_dir())):
        return source
    name, asked = found["name"], bool(found["asked"])
    missing = f"{name} does not exist" if not asked else f"{name} cannot be fetched from the Hugging Face Hub"
    hint = "pip install huggingface_hub." if asked else f"A dataset of the Hugging Face Hub is fetched as hf://{name}."
    try:
        from huggingface_hub import snapshot_download
    except ImportError as error:
        raise DataError(missing, got=error if asked else None, hint=hint) from None
    try:
        return Path(snapshot_download(name, repo_type="dataset", allow_patterns=_WANTED, local_files_only=not asked))
    except Exception as error:  # a package of its own, with errors of many kinds
        lines = str(error).strip().splitlines() or [type(error).__name__]
        raise DataError(
            missing,
            got=lines[0] if asked else None,
            hint="Is it a dataset that everybody may read, or are you logged in (hf auth login)?" if asked else hint,
        ) from error
