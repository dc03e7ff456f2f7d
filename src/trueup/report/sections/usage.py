"""How to use what was fitted: lines to copy."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trueup.core.fit_result import FitResult
from trueup.report.fit_words import listed, shown_value, split_name
from trueup.report.folder import RunFolder
from trueup.report.labels import MAIN_METRIC, main_signal
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
_STREAM = """\
from trueup.deploy import Status, Stream

joints = {joints}
stream = Stream.load("{folder}", rate_hz={rate:g}, joints=joints)
# in every cycle, what the simulator says, signal -> (J,), in SI units:
# answer = stream.step(simulated, time_s=time_s); answer["position"] if answer.status is Status.OK"""
_SIMULATOR = f"""\
from pathlib import Path
from trueup.augment import ResidualSimulator
from trueup.deploy import Network
from trueup.robots import load_robot
from trueup.sim import make_simulator

inner = make_simulator("mujoco", load_robot("{ROBOT}"), Path("{MODEL}"))
simulator = ResidualSimulator(inner, Network.load("{{folder}}"))  # reset, step and rollout, as without it"""
_CORRECT = """\
trueup replay path/to/dataset --robot {robot} --label {run}
trueup augment eval path/to/dataset --model {folder} --run {run} --split all --out runs/corrected"""
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
    """Only where fitted files lie beside fit.json, or networks were trained."""
    found = recipes(run, run.fit) if run.fit is not None and run.fitted_files else []
    found += network_recipes(run)
    return Section("usage", "How to use it: lines to copy", {"recipes": found}) if found else None


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


def network_recipes(run: RunFolder) -> list[Recipe]:
    """What can be done with the networks of a close: the best one for a control loop, and the best one."""
    if run.close is None or not run.networks:
        return []
    order = _by_val(run)
    if not order:  # all of them leave everything as it is
        return []
    found = []
    live = next((label for label in order if run.networks[label].causal), None)
    if live is not None:
        text = f"The network that is best on validation motions of those that need no future. {_worth(run, live)}"
        found.append(Recipe("In a control loop: the corrected simulator's view", text, _stream_lines(run, live)))
        if {ROBOT, MODEL} <= set(run.fitted_files) and live.startswith("mujoco/fitted+"):
            lines = _SIMULATOR.format(folder=run.close.networks[live])
            found.append(Recipe("In a training loop: a simulator that says what the robot would measure", "", lines))
    card = run.networks[order[0]]
    text = f"Any motions of this dataset format, corrected by {card.name}. {_worth(run, order[0])}"
    base = order[0].rpartition("+")[0]
    robot = ROBOT if base.endswith("fitted") else "ROBOT"
    lines = _CORRECT.format(folder=run.close.networks[order[0]], run=base, robot=robot)
    found.append(Recipe("Other motions, corrected", text, lines))
    return found


def _by_val(run: RunFolder) -> list[str]:
    """Labels of runs that are corrected at all, the best on validation motions first; else as they were made."""

    def error(label: str) -> float:
        metrics = run.gap.runs.get(label, {}).get("val", {})
        results = metrics.get(main_signal(metrics), {}) if metrics else {}
        return results[MAIN_METRIC].total.value if MAIN_METRIC in results else math.inf

    used = [label for label, card in run.networks.items() if any(output.gate > 0 for output in card.outputs)]
    return sorted(used, key=error)


def _worth(run: RunFolder, label: str) -> str:
    """What validation motions say of it, against what it corrects."""
    pair = next(
        (
            item
            for item in run.gap.paired
            if (item.run, item.baseline, item.split, item.metric)
            == (label, label.rpartition("+")[0], "val", MAIN_METRIC)
            and item.signal == main_signal(run.gap.runs[label]["val"])
        ),
        None,
    )
    if pair is None:
        return "What it is worth beside the model alone was not measured on validation motions."
    if pair.verdict == "better":
        return "It helps there, by an interval that excludes zero."
    words = "that it helps is not decided there" if pair.verdict == "undecided" else "it makes things worse there"
    return f"But {words}: the model without it may be all that is needed."


def _stream_lines(run: RunFolder, label: str) -> str:
    assert run.close is not None
    card = run.networks[label]
    return _STREAM.format(folder=run.close.networks[label], rate=card.rate_hz, joints=list(card.joints))


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
