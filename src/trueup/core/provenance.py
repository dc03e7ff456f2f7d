"""Where a result comes from: versions, git hash, seed, data hash, configuration."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any


def version() -> str:
    """The version of trueup that is installed."""
    return metadata.version("trueup")


def provenance(*, config: Mapping[str, Any], seed: int | None = None, data_hash: str | None = None) -> dict[str, Any]:
    """What every result file carries.

    Args:
        config: the resolved configuration, JSON types only.
        seed: the seed of all draws.
        data_hash: hash of the dataset that was read.
    """
    packages = ("numpy", "scipy", "mujoco", "pyarrow")
    return {
        "trueup": version(),
        "python": platform.python_version(),
        "packages": {name: _installed(name) for name in packages},
        "git": _git_hash(Path(__file__).parent.parent),
        "seed": seed,
        "data_hash": data_hash,
        "config": dict(config),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def other_versions(origin: object) -> dict[str, str]:
    """What simulates, and has another version now: name -> the version that a result was made with.

    Args:
        origin: the provenance of the result. What it does not say counts as the same.
    """
    said = origin if isinstance(origin, Mapping) else {}
    packages = said.get("packages")
    then = {"trueup": said.get("trueup"), "mujoco": packages.get("mujoco") if isinstance(packages, Mapping) else None}
    now = {"trueup": version(), "mujoco": _installed("mujoco")}
    return {name: str(then[name]) for name in now if then[name] not in (None, now[name])}


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _git_hash(folder: Path) -> str | None:
    """Commit that this code runs from, `-dirty` if the package differs from it; None for an installed wheel."""
    if not any((parent / "pyproject.toml").is_file() for parent in folder.parents):
        return None
    try:
        commit, changed = (
            _git(folder, "rev-parse", "--short=10", "HEAD"),
            _git(folder, "status", "--porcelain", "--", "."),
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}-dirty" if changed else commit


def _git(folder: Path, *command: str) -> str:
    done = subprocess.run(["git", "-C", str(folder), *command], capture_output=True, text=True, timeout=5, check=True)
    return done.stdout.strip()
