"""The arrows of docs/architecture.md, read from the imports."""

import ast
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import trueup

PACKAGE = Path(trueup.__file__).parent

# Who may import whom, besides `core` and `errors`, which everybody may. `stages` puts the parts together for Python
# users; `cli` is the only one that imports `report`, and nobody imports `cli`.
ARROWS = {
    "core": set(),
    "dataset": set(),
    "align": set(),
    "measure": set(),
    "robots": set(),
    "sim": {"robots"},
    "lab": {"sim", "robots"},
    "whole_body": {"lab", "measure", "robots", "sim"},
    "record": {"dataset", "robots"},
    "identify": {"align", "measure", "robots", "sim"},
    "deploy": set(),
    "augment": {"dataset", "measure", "deploy"},
    "compensate": {"augment", "deploy", "robots", "sim"},
    "policy": {"augment", "deploy", "identify", "measure", "robots", "sim"},
    "zoo": {"augment"},
    "ros2": {"deploy"},
    "check": {"align", "measure", "robots", "sim"},
    "draft": {"robots", "sim"},
    "report": {"measure"},
    "stages": {
        "dataset",
        "align",
        "measure",
        "robots",
        "sim",
        "lab",
        "record",
        "identify",
        "check",
        "draft",
        "deploy",
        "augment",
        "compensate",
        "policy",
        "ros2",
        "zoo",
    },
    "cli": {
        *(
            "dataset",
            "align",
            "measure",
            "robots",
            "sim",
            "lab",
            "record",
            "identify",
            "check",
            "draft",
            "deploy",
            "augment",
            "compensate",
            "policy",
            "ros2",
            "zoo",
        ),
        *("report", "stages"),
    },
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def imported_parts(file):
    """The parts of trueup that a file imports, wherever in the file the import stands."""
    for node in ast.walk(ast.parse(file.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{file}: relative import"
            names = [node.module] + [f"{node.module}.{alias.name}" for alias in node.names if node.module == "trueup"]
        yield from (name.split(".")[1] for name in names if name.startswith("trueup."))


@pytest.mark.parametrize("file", MODULES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_imports_follow_the_arrows(file):
    part = file.relative_to(PACKAGE).parts[0]
    if part in ("__init__.py", "__main__.py", "errors.py"):
        return
    assert part in ARROWS, f"{part} is not in docs/architecture.md"
    forbidden = set(imported_parts(file)) - ARROWS[part] - {part, "core", "errors"}
    assert not forbidden, f"{part} must not import {forbidden}"


def test_the_arrows_make_no_circle():
    order = []
    while len(order) < len(ARROWS):
        free = [part for part in ARROWS if part not in order and ARROWS[part] <= set(order)]
        assert free, f"circle among {set(ARROWS) - set(order)}"
        order += free


def test_every_part_has_an_arrow_and_stands_in_the_architecture_page():
    folders = {path.name for path in PACKAGE.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert folders == set(ARROWS)
    page = (Path(__file__).parent.parent / "docs" / "architecture.md").read_text()
    assert all(f"`{part}`" in page or f"{part}/" in page for part in ARROWS)


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("trueup", {"torch", "mujoco", "numpy", "pyarrow"}),
        ("trueup.report", {"torch", "mujoco", "pyarrow"}),
        ("trueup.dataset", {"torch", "mujoco"}),
        ("trueup.measure", {"torch", "mujoco"}),
        ("trueup.deploy", {"torch", "mujoco", "onnx", "pyarrow", "scipy"}),
        ("trueup.augment.trained", {"torch", "mujoco", "onnx", "pyarrow", "scipy"}),
        ("trueup.record", {"torch", "mujoco", "ompl", "toppra", "mink", "scipy"}),
        ("trueup.stages", {"torch", "mujoco", "onnx", "scipy.optimize"}),
        ("trueup.cli.main", {"torch", "mujoco", "plotly", "scipy"}),
    ],
)
def test_importing_loads_nothing_heavy(module, unwanted):
    code = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not unwanted & set(loaded)


def public_modules():
    yield trueup
    for info in pkgutil.walk_packages([str(PACKAGE)], "trueup."):
        yield importlib.import_module(info.name)


def test_every_name_in_all_resolves():
    for module in public_modules():
        for name in getattr(module, "__all__", []):
            assert getattr(module, name, None) is not None, f"{module.__name__}.{name}"
