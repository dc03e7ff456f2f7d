"""Resolve every extra and write `requirements.lock`, the constraints file that every install uses.

    python scripts/lock.py            # resolve again with the newest versions that pyproject.toml allows
    python scripts/lock.py --keep     # keep what is locked, add only what is new

pip does the resolving; this script only turns its report into a constraints file.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "requirements.lock"
# Pinned by hand: mujoco 3.17 is the line that MJX, Warp and the measurements in docs/ are made with; torch as
# an exact version, since an open one pulls several GB of GPU packages.
PINS = ("torch==2.13.0", "mujoco==3.17.0")


def main() -> None:
    """Write the lock."""
    constraints = list(PINS)
    if "--keep" in sys.argv and LOCK.exists():
        constraints += [line for line in LOCK.read_text().splitlines() if "==" in line]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "constraints.txt"
        file.write_text("\n".join(dict.fromkeys(constraints)) + "\n")
        report = Path(folder) / "report.json"
        subprocess.run(
            [
                sys.executable,
                "-m",
                "pip",
                "install",
                "--dry-run",
                "--ignore-installed",
                "--quiet",
                "--report",
                report,
                "-c",
                file,
                f"{ROOT}[all]",
                "hatchling",
                "pip",
            ],
            check=True,
        )
        items = json.loads(report.read_text())["install"]
    pins = {}
    for item in items:
        name = re.sub(r"[-_.]+", "-", item["metadata"]["name"]).lower()
        if name != "trueup":
            pins[name] = item["metadata"]["version"].split("+")[0]  # a local build tag is not on the index
    lines = ["# Constraints for every install; made by scripts/lock.py from pyproject.toml."]
    lines += [f"{name}=={version}" for name, version in sorted(pins.items())]
    LOCK.write_text("\n".join(lines) + "\n")
    sys.stdout.write(f"{LOCK.name}: {len(pins)} packages\n")


if __name__ == "__main__":
    main()
