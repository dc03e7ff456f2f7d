"""Write every page whose result is stored."""

import json
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAMES = {"thesis": "thesis.md", "real_robots": "real-robots.md", "panda": "panda.md"}


def text(name: str) -> str:
    """The page as the stored result makes it."""
    result = json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())
    page: str = import_module(f"benchmarks.pages.{name}").page(result)
    return page


def main() -> None:
    """Write the pages."""
    for name, file in NAMES.items():
        (ROOT / "docs" / file).write_text(text(name))


if __name__ == "__main__":
    main()
