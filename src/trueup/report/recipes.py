"""Lines to copy: what can be done with a fit."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.core.fit_result import FitResult
from trueup.core.parameters import split_name
from trueup.report.fit_words import listed, shown_value
from trueup.report.folder import RunFolder
from trueup.report.numbers import significant

ROBOT, MODEL, ISAAC, SAMPLES = "robot.fitted.yaml", "model.fitted.xml", "isaac.actuators.yaml", "fit.samples.npz"

_REPLAY = f"""\
trueup replay path/to/other --robot {ROBOT} --label mujoco/fitted
trueup gap path/to/other --robot {ROBOT} --out runs/check"""
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
# Names of Isaac Lab 2.2 and later; a group per joint, since a joint that a dictionary lacks would get zero.
_ISAAC = f"""\
import yaml
from isaaclab.actuators import ImplicitActuatorCfg

with open("{ISAAC}") as file:
    joints = yaml.safe_load(file)["actuators"]

actuators = {{  # ArticulationCfg(..., actuators=actuators)
    joint: ImplicitActuatorCfg(
        joint_names_expr=[joint],
        stiffness=values["stiffness"],
        damping=values["damping"],
        armature=values["armature"],
        friction=values["friction"],
        dynamic_friction=values["dynamic_friction"],
        viscous_friction=values["viscous_friction"],
        effort_limit_sim=values.get("effort_limit"),  # joint_effort_limit from Isaac Lab 3.0 on
    )
    for joint, values in joints.items()
}}"""
_RESULT = """\
from pathlib import Path
from trueup.core.fit_result import FitResult

fit = FitResult.load(Path("fit.json"))
sure = {item.name: item.value for item in fit.parameters if item.identified == "yes"}"""
_STEPPED = f"""\
from pathlib import Path
import numpy as np
{{around}}from trueup.robots import load_robot
from trueup.sim import {{imports}}

robot = load_robot("{ROBOT}")
simulator = make_simulator("mujoco", robot, Path("{MODEL}"))
{{late}}{{network}}
start = np.zeros((8, len(simulator.joints)))  # eight robots side by side, at zero and at rest
simulator.reset(start, np.zeros_like(start))
for _ in range(100):
    command = dict.fromkeys(simulator.command_signals, start)  # what your policy asks of each
    state = simulator.step(command)  # position, velocity and torque, each (8, J)"""
_LATE = "simulator = DelayedSimulator(simulator, robot.delay_s)  # commands act late, as on the robot\n"
_AROUND = "from trueup.augment import ResidualSimulator\nfrom trueup.deploy import Network\n"
_NETWORK = 'simulator = ResidualSimulator(simulator, Network.load("{folder}"))\n'


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


def fit_recipes(run: RunFolder, fit: FitResult, *, stepped: bool = True) -> list[Recipe]:
    """What can be done with the files that are there.

    Args:
        run: the folder.
        fit: its fit.
        stepped: whether lines for a loop of steps are wanted; not where those of a network say more.
    """
    found = []
    delays = delay_words(fit)
    law = run.friction_laws
    if {ROBOT, MODEL} <= set(run.fitted_files):
        found.append(Recipe("On other recordings, with trueup", "Delays and friction laws are in the files.", _REPLAY))
        if stepped:
            found.append(Recipe("In a training loop: the fitted simulator", held_back(fit), stepped_lines(fit)))
    if MODEL in run.fitted_files:
        own = (
            "The model carries friction laws that MuJoCo does not know; trueup adds them by a callback." if law else ""
        )
        late = f"A model file holds no delays: hold the commands back yourself ({delays}). " if delays else ""
        late += moving_on(fit) if delays else ""
        found.append(Recipe("In plain MuJoCo", f"{own} {late}".strip(), _MUJOCO_FRICTION if law else _MUJOCO))
    if ISAAC in run.fitted_files:
        found.append(Recipe("In Isaac Lab", _isaac_words(fit, law=law), _ISAAC))
    if SAMPLES in run.fitted_files:
        text = "As many plausible robots as there are draws, for randomization in training: each is one whole set."
        found.append(Recipe("Randomization", text, _SAMPLES))
    found.append(Recipe("The numbers with their intervals", "", _RESULT))
    return found


def stepped_lines(fit: FitResult, network: str = "") -> str:
    """A loop of steps of the fitted robot, which acts late on its commands where the robot does.

    Args:
        fit: whose delays count.
        network: folder of a network for what is left; empty without one.
    """
    late = bool(delay_words(fit))
    return _STEPPED.format(
        around=_AROUND if network else "",
        imports="DelayedSimulator, make_simulator" if late else "make_simulator",
        late=_LATE if late else "",
        network=_NETWORK.format(folder=network) if network else "",
    )


def held_back(fit: FitResult) -> str:
    """A sentence on what a loop of steps does about delays; empty without one."""
    delays = delay_words(fit)
    return f"Commands act as late as the fit says ({delays}). {moving_on(fit)}".strip() if delays else ""


def moving_on(fit: FitResult) -> str:
    """What delays of commands that move on between their stamps mean for a loop that holds them; else empty."""
    if fit.data.get("command", "held") == "held":
        return ""
    return (
        "These delays are for commands that move on between two stamps of the log: in a loop that holds each one as "
        "long, they are half of that time shorter."
    )


def delay_words(fit: FitResult) -> str:
    """How much later commands act: `yaw 20.8 ms and elbow 10.7 ms`; empty without a delay.

    Where one is below zero, the stamps of the log are late, and all delays are told from the least.
    """
    own = {
        split_name(item.name)[1] or "all joints": shown_value(item)
        for item in fit.parameters
        if split_name(item.name)[0] == "delay_s"
    }
    least = min(0.0, *own.values(), 0.0)
    delays = {joint: delay - least for joint, delay in own.items() if delay > least}
    return listed([f"{joint} {significant(1e3 * delay)}\N{NO-BREAK SPACE}ms" for joint, delay in delays.items()])


def _isaac_words(fit: FitResult, *, law: bool) -> str:
    delays = delay_words(fit)
    words = ["For Isaac Lab 2.2 or later on Isaac Sim 5 or later, where friction is a torque."]
    if law:
        words.append("Isaac does not know the friction laws of this model.")
    if delays:
        words.append(
            f"Its implicit actuators know no delays: hold the targets back yourself ({delays}), or take "
            f"DelayedPDActuatorCfg, whose min_delay and max_delay count physics steps. {moving_on(fit)}"
        )
    return " ".join(words).strip()
