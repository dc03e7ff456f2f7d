"""Real recordings, where they are at hand."""

from __future__ import annotations

import os
from pathlib import Path


def recording(name: str) -> Path | None:
    """A folder of TRUEUP_SHARED/data, or of `shared/data` beside the project."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("TRUEUP_SHARED", beside)) / "data" / name
    return folder if folder.is_dir() else None
