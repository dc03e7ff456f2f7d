"""Write every page whose result is stored, and the tables of what there is."""

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.pages import choosing, everything, gallery, kinds, laws, llms, options, peers
from benchmarks.pages.markdown import with_section

ROOT = Path(__file__).resolve().parents[2]
NAMES = {
    "thesis": "thesis.md",
    "real_robots": "real-robots.md",
    "panda": "panda.md",
    "augment": "learned-corrections.md",
    "streaming": "step-times.md",
    "acceptance": "acceptance.md",
    "foreign": "verdict-worth.md",
}
# Results that make a section of a page that is otherwise written by hand.
PARTS = {
    **dict.fromkeys(
        ("sat", "sat_bodies", "sat_robustness", "sat_so101", "sat_training", "sat_speed"), "building-blocks.md"
    ),
    **dict.fromkeys(
        ("compensation", "compensation_robot", "compensation_ways", "compensation_ablations"),
        "what-compensation-brings.md",
    ),
    "whole_body": "whole-body.md",
    **dict.fromkeys(("ros2_bridge", "ros2_hour"), "ros2.md"),
    "fleet": "fleet.md",
    "close": "close.md",
    **dict.fromkeys(("policy_transfer", "policy_going_on", "policy_algorithms", "policy_grid"), "policy-transfer.md"),
}


def from_several() -> dict[str, str]:
    """Page -> its text with what is made from the code or from several results: tables, sections, the whole page."""
    return {
        name: text
        for module in (kinds, laws, options, peers, choosing, gallery, everything, llms)
        for name, text in module.pages().items()
    }


def is_stored(name: str) -> bool:
    """Whether there is a result to make the page from."""
    return _path(name).is_file()


def text(name: str) -> str:
    """The page as the stored result makes it."""
    page: str = import_module(f"benchmarks.pages.{name}").page(_result(name))
    return page


def figures(name: str) -> dict[str, str]:
    """Figures of a page or a section, file in docs/ -> SVG; most have none."""
    module = import_module(f"benchmarks.pages.{name}")
    found: dict[str, str] = module.figures(_result(name)) if hasattr(module, "figures") else {}
    return found


def with_parts(file: str) -> str:
    """A page with the parts that stored results make in it."""
    found = (ROOT / "docs" / file).read_text()
    for name, page in PARTS.items():
        if page == file and is_stored(name):
            found = with_section(found, import_module(f"benchmarks.pages.{name}").part(_result(name)))
    return found


def _path(name: str) -> Path:
    return ROOT / "benchmarks" / "results" / f"{name}.json"


def _result(name: str) -> Mapping[str, Any]:
    result: Mapping[str, Any] = json.loads(_path(name).read_text())
    return result


def main() -> None:
    """Write the pages, and the tables in pages that are otherwise written by hand."""
    for name, file in NAMES.items():
        if is_stored(name):
            for path, content in {file: text(name), **figures(name)}.items():
                (ROOT / "docs" / path).write_text(content)
        else:
            print(f"docs/{file} is left as it is: benchmarks/results/{name}.json is not there yet")
    for file in dict.fromkeys(PARTS.values()):
        (ROOT / "docs" / file).write_text(with_parts(file))
    for name in filter(is_stored, PARTS):
        for path, content in figures(name).items():
            (ROOT / "docs" / path).write_text(content)
    for file, content in from_several().items():
        (ROOT / "docs" / file).write_text(content)


if __name__ == "__main__":
    main()
