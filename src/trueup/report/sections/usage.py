"""How to use what was fitted: lines to copy."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.core.fit_result import FitResult
from trueup.report.fit_words import listed, shown_value, split_name
from trueup.report.folder import RunFolder
from trueup.report.numbers import significant
from trueup.report.sections.base import Section

ROBOT, MODEL, ISAAC, SAMPLES = "robot.fitted.yaml", "model.fitted.xml", "isaac.actuators.yaml", "fit.samples.npz"

_REPLAY = f"""\
trueup replay path/to/dataset --robot {ROBOT} --label mujoco/fitted
trueup gap path/to/dataset --robot {ROBOT} --out runs/check"""
_MUJOCO = f"""\
import mujoco

model = mujoco.MjModel.from_xml_path("{MODEL}")"""
_MUJOCO_FRICTION = f"""\
import mujoco
from trueup.sim import install_friction

install_friction()  # once per process
model = mujoco.MjModel.from_xml_path("{MODEL}")"""
_SAMPLES = f"""\
import numpy as np

samples = np.load("{SAMPLES}")  # parameter -> array of draws
draw = {{name: float(samples[name][0]) for name in samples.files}}"""
_ISAAC = f"""\
import yaml

with open("{ISAAC}") as file:
    actuators = yaml.safe_load(file)["actuators"]  # joint -> stiffness, damping, armature, friction, ..."""
_RESULT = """\
from pathlib import Path
from trueup.core.fit_result import FitResult

fit = FitResult.load(Path("fit.json"))
sure = {item.name: item.value for item in fit.parameters if item.identified == "yes"}"""


@dataclass(frozen=True)
class Recipe:
    """Lines for one purpose.

    Attributes:
        title: the purpose.
        text: what to know before, or empty.
        lines: to copy.
    """

    title: str
    text: str
    lines: str


def usage_section(run: RunFolder) -> Section | None:
    """Only where fitted files lie beside fit.json."""
    if run.fit is None or not run.fitted_files:
        return None
    return Section("usage", "How to use it: lines to copy", {"recipes": recipes(run, run.fit)})


def recipes(run: RunFolder, fit: FitResult) -> list[Recipe]:
    """What can be done with the files that are there."""
    found = []
    delays = delay_words(fit)
    if {ROBOT, MODEL} <= set(run.fitted_files):
        found.append(Recipe("On other recordings, with trueup", "Delays and friction laws are in the files.", _REPLAY))
    if MODEL in run.fitted_files:
        law = "The model carries friction laws that MuJoCo does not know; trueup adds them by a callback. "
        text = (law if run.friction_laws else "") + delays
        found.append(Recipe("In plain MuJoCo", text.strip(), _MUJOCO_FRICTION if run.friction_laws else _MUJOCO))
    if ISAAC in run.fitted_files:
        law = "Isaac does not know the friction laws of this model. " if run.friction_laws else ""
        held = "Delays stand there in seconds; Isaac counts physics steps." if delays else ""
        found.append(Recipe("In Isaac Lab", (law + held).strip(), _ISAAC))
    if SAMPLES in run.fitted_files:
        text = "As many plausible robots as there are draws, for randomization in training: each is one whole set."
        found.append(Recipe("Randomization", text, _SAMPLES))
    found.append(Recipe("The numbers with their intervals", "", _RESULT))
    return found


def delay_words(fit: FitResult) -> str:
    """Which delays a model file cannot hold; empty without one."""
    delays = {
        split_name(item.name)[1] or "all joints": shown_value(item)
        for item in fit.parameters
        if split_name(item.name)[0] == "delay_s" and shown_value(item) > 0
    }
    if not delays:
        return ""
    words = [f"{joint} {significant(1e3 * delay)}\N{NO-BREAK SPACE}ms" for joint, delay in delays.items()]
    return f"A model file holds no delays: hold the commands back yourself ({listed(words)})."
