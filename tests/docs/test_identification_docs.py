"""docs/identification.md, its reference and docs/experiments.md say what the code does: keys, defaults, statuses."""

import re
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import get_args

import pytest

from trueup.cli.identify import UNUSABLE
from trueup.core.fit_result import FitStatus
from trueup.identify import QUANTITIES, IdentifyConfig, Nominal
from trueup.identify.config import _CHOICE_KEYS, DataChoice, SolverChoice
from trueup.identify.experiments import PulsePlan, RampPlan, RunSettings, SlideSettings
from trueup.identify.experiments.findings import Status
from trueup.identify.export import ISAAC_FILE, MODEL_FILE, ROBOT_FILE, SAMPLES_FILE
from trueup.identify.regression.graybox_terms import BLOCKS
from trueup.identify.solution import SolverName
from trueup.report import recipes
from trueup.robots import ControllerSpec, find_model, load_robot
from trueup.robots.friction import NUMBERS

DOCS = Path(__file__).parent.parent.parent / "docs"
TABLE = re.compile(r"(?:^\|.*\n)+", re.M)
REFERENCE = "identification-reference"
PAGES = {name: (DOCS / f"{name}.md").read_text() for name in ("identification", REFERENCE, "experiments")}


def table(has, page="identification"):
    """The rows of cells of the table in which this begins a row, without its header."""
    (found,) = (text for text in TABLE.findall(PAGES[page]) if f"\n| {has} |" in text)
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in found.splitlines()[2:]]


def code(*cells):
    """What stands in backticks."""
    return [word for cell in cells for word in re.findall(r"`([^`]+)`", cell)]


def by_key(has, page="identification"):
    """Key -> default, where a row may have several of both."""
    found = {}
    for row in table(has, page):
        names, defaults = code(row[0]), row[1].split(", ")
        found |= dict(zip(names, defaults if len(defaults) == len(names) else defaults * len(names), strict=True))
    return found


def written(default):
    """A default as the pages write it."""
    if isinstance(default, bool):
        return str(default).lower()
    return f"`{default}`" if isinstance(default, str) else str(default)


def check_defaults(kind, said):
    assert set(said) == {item.name for item in fields(kind)}
    for item in fields(kind):
        if item.default is None:
            assert not re.match(r"[\d`]", said[item.name]), f"{item.name} has no default but a rule"
        elif item.default is not MISSING:
            assert said[item.name] == written(item.default), item.name


def test_every_quantity_is_in_the_catalogue_as_it_is():
    found = [
        (name, [unit, *row[1:]])
        for row in table("`delay_s` [s]", REFERENCE)
        for name, unit in re.findall(r"`(\w+)` \[([^\]]+)\]", row[0])
    ]
    assert len(found) == len(QUANTITIES)
    assert dict(found) == {
        name: [item.unit, item.of, item.search.transform, item.cause] for name, item in QUANTITIES.items()
    }


def test_every_number_of_a_friction_law_is_in_the_tables():
    text = (DOCS / "friction.md").read_text()
    assert all(f"| `{number.name}` |" in text for number in NUMBERS if number.excite)
    catalogue = code(*(row[0] for row in table("`delay_s` [s]", REFERENCE)))
    assert {number.name for number in NUMBERS if number.excite} <= set(catalogue)


def test_every_key_of_the_configuration_is_explained():
    assert set(by_key("`fit`", REFERENCE)) == {item.name for item in fields(IdentifyConfig)}
    assert set(by_key("`targets`", REFERENCE)) == set(_CHOICE_KEYS)
    check_defaults(DataChoice, by_key("`window_s`", REFERENCE))
    check_defaults(SolverChoice, by_key("`name`", REFERENCE))
    assert {f"`{name}`" for name in get_args(SolverName)} == {row[0] for row in table("`gauss-newton`", REFERENCE)}


@pytest.mark.parametrize(
    ("follows", "controller"),
    [
        ("position", None),
        ("position", ControllerSpec(kind="velocity-integrator", kp=60.0, kv=1.0)),
        ("PID", ControllerSpec(kind="pid", kp=60.0, kv=1.0, ki=5.0)),
        ("velocity", ControllerSpec(kind="velocity", kv=5.0)),
        ("torque", ControllerSpec(kind="torque")),
    ],
)
def test_the_defaults_are_those_of_the_page(follows, controller):
    robot = load_robot("demo_arm")
    if controller is not None:
        joints = tuple(replace(joint, torque_limit=10.0) for joint in robot.joints)
        robot = replace(robot, controller=controller, joints=joints)
    resolved = IdentifyConfig().resolved(Nominal(robot, find_model(robot)))
    (row,) = (row for row in table("torque", REFERENCE) if row[0].startswith(follows))
    assert code(row[1]) == list(resolved.fit)
    (said,) = re.findall(r"^Models: (.*)$", PAGES[REFERENCE], re.M)
    models = {name: tuple(extra) for name, *extra in map(code, said.split("; "))}
    assert [(name, models[name]) for name in code(row[2])] == list(resolved.models.items())
    assert resolved.data.window_s == (0.5 if follows == "torque" else None)


def test_the_lines_for_isaac_lab_are_those_of_the_report():
    """Those of the report are run by tests/report/test_report_recipes.py."""
    (block,) = re.findall(r"^```python\n(import yaml\n.*?)\n```$", PAGES["identification"], re.M | re.S)
    assert block.replace("runs/mine/", "") == recipes._ISAAC


def test_every_status_has_its_exit_code():
    found = {code(row[0])[0]: row[2] for row in table("`no-better`")}
    assert found == {status: "3" if status in UNUSABLE else "0" for status in get_args(FitStatus)}


def test_every_file_and_every_block_of_the_torque_model_is_named():
    files = set(code(*(row[0] for row in table("`fit.json`"))))
    assert {MODEL_FILE, ROBOT_FILE, ISAAC_FILE, SAMPLES_FILE, "graybox.json"} <= files
    assert code(*(row[0] for row in table("`pd`", REFERENCE))) == list(BLOCKS)


def test_every_status_and_setting_of_an_experiment_is_explained():
    assert code(*(row[0] for row in table("`censored`", "experiments"))) == list(get_args(Status))
    rows, said = table("`RampPlan`", "experiments"), {}
    for row in rows:
        owner = code(row[0])[0] if code(row[0]) else list(said)[-1]
        names, defaults = code(row[1]), row[2].split(", ")
        values = defaults if len(defaults) == len(names) else defaults * len(names)
        said.setdefault(owner, {}).update(zip(names, values, strict=True))
    for kind in (RampPlan, PulsePlan, RunSettings, SlideSettings):
        check_defaults(kind, said[kind.__name__])
