"""docs/thesis.md, from what `python -m benchmarks thesis` has measured."""

from statistics import median
from typing import Any

from benchmarks.pages.markdown import table

# ES thesis, Table 3.6: initial and final error of each joint, sampled at an interval that it does not give.
THESIS = (
    (188.8488, 3.0121),
    (31.5475, 1.7076),
    (96.0152, 3.1312),
    (77.5024, 2.1821),
    (258.6358, 10.8730),
    (156.5996, 15.6212),
    (288.9131, 54.1302),
)
DEFAULT = "auto"
HEADS = ("solver", *(f"j{number}" for number in range(1, 8)), "held out", "evaluations", "CPU s")
NAMES = {
    "auto": "`auto`: Gauss-Newton",
    "gauss-newton, six elements, joint by joint": "`gauss-newton`, six elements per inertia",
    "evolution": "`evolution`: the thesis's",
    "cma-es": "`cma-es`",
    "cma-es, joint by joint": "`cma-es`, joint by joint",
}
OFF = {
    "level_percent": "level [%]",
    "slope_percent": "slope [%]",
    "shift_rad_s": "shift [rad/s]",
    "friction_torque_percent": "friction torque [%]",
    "joint_inertia_percent": "inertia at the joint [%]",
    "link_inertia_percent": "link inertia tensor [%]",
}

TEXT = """# The thesis's experiment

A master's thesis on reinforcement learning for a torque-controlled Panda (the *ES thesis*) fits friction and inertia to
28 trajectories with an evolution strategy. This note repeats the experiment on a simulated robot with known parameters,
so that fitted values can be compared with true ones. {verdict}

```sh
python -m benchmarks thesis
```

## Setup

- **Motions** (thesis, 3.2 and Table 3.3): one joint at a time gets a constant torque for 1500 steps and none for 500,
  at 1 kHz, with gravity compensation. 28 trajectories are fitted, {held_out} with other torques are held out.
- **Model**: a Panda with published inertias and the thesis's initial friction (Table 2.3), three
  [sigmoid parameters](friction.md) per joint.
- **Hidden robot**: friction (10 % in level, 20 % in slope) and inertia vary around the values that the thesis found
  (Tables 3.4, 3.5). The model lacks some of its effects: armatures up to 10 % off, 0.02 to 0.04 Nm of dry and 0.01 to
  0.05 Nm s/rad of viscous friction, up to 0.01 Nm of error in the gravity compensation, half the time step, a 17-bit
  encoder with 0.03 mrad of noise.
- **Fit**: whole trajectories at {step_ms:g} ms; 21 friction parameters and one factor per link inertia, as in the
  thesis.
- **Error**: absolute position difference of the moved joint, summed over every millisecond. The thesis does not state
  its sampling interval, so only relative reductions can be compared.

## Error reduction

Reduction of each joint's error in percent; *held out* is the worst joint on torques that were not fitted. One
evaluation simulates all 28 trajectories. Robot 0, {threads} threads.

{solvers}

`evolution` and `cma-es` stop at {evaluations} evaluations. The evolution strategy uses the thesis's settings: each
joint accepts its own parameters by its own error. CMA-ES has one cost for all joints; *joint by joint* it searches 4
parameters at a time, in two rounds of {per_joint} evaluations. Fits of six inertia elements go joint by joint, too.

{robots}

## Parameter error

Median absolute error over the joints of robot 0. *Friction torque* includes the hidden robot's other friction. *Inertia
at the joint* is that of arm and armature about its axis, in the home pose.

{truth}

Gauss-Newton finds friction and the inertia at each joint. It does not find the inertia tensors of single links: motions
of one joint at a time show only the sum of link inertias and armature. The thesis's new inertias (Table 3.5) come from
such motions. For tensors, excite several joints at once; `trueup identify` reports
[how certain](identification.md) each parameter is.
"""


def page(result: dict[str, Any]) -> str:
    """The page that belongs to a result."""
    config, robots = result["provenance"]["config"], result["robots"]
    first = robots[0]["searches"]
    return TEXT.format(
        held_out=sum(map(len, config["held_out_nm"].values())),
        step_ms=1e3 * config["fit_step_s"],
        threads=config["threads"],
        evaluations=config["max_evaluations"],
        per_joint=config["max_evaluations_per_joint_and_round"],
        solvers=solver_table(first),
        robots=robot_words(robots),
        verdict=verdict(robots),
        truth=truth_table(first),
    )


def solver_table(searches: dict[str, Any]) -> str:
    """One row per solver, and the thesis."""
    rows = [[NAMES[name], *cut_cells(own)] for name, own in searches.items()]
    thesis = [f"{100 * (1 - after / before):.1f}" for before, after in THESIS]
    return table(HEADS, [*rows, ["the thesis, real robot", *thesis, "", "", ""]])


def robot_words(robots: list[dict[str, Any]]) -> str:
    """The default solver on the other robots, by their worst joint."""
    told = []
    for robot in robots:
        joints = robot["searches"][DEFAULT]["joints"].values()
        fitted, held_out = (min(own[key] for own in joints) for key in ("cut_percent", "held_out_cut_percent"))
        told.append(f"robot {robot['seed']}: {fitted:.2f} %, held out {held_out:.2f} %")
    return f"Worst joint of each robot, `{DEFAULT}`: {'; '.join(told)}."


def cut_cells(own: dict[str, Any]) -> list[str]:
    """What is gone of each joint's error, and what it took."""
    joints, solver = own["joints"].values(), own["solver"]
    worst = min(joint["held_out_cut_percent"] for joint in joints)
    cells = [f"{joint['cut_percent']:.2f}" for joint in joints]
    return [*cells, f"{worst:.2f}", str(solver["evaluations"]), f"{solver['cpu_seconds']:.0f}"]


def verdict(robots: list[dict[str, Any]]) -> str:
    """The bar, and whether it is met."""
    worst = min(joint["cut_percent"] for robot in robots for joint in robot["searches"][DEFAULT]["joints"].values())
    met = "is met" if worst >= 98.0 else "is missed"
    return f"The bar, a reduction of 98 % on every joint of every robot, {met}: the worst is {worst:.2f} %."


def truth_table(searches: dict[str, Any]) -> str:
    """How far from the truth each solver ended."""
    rows = []
    for name, own in searches.items():
        middles = {key: median(abs(joint[key]) for joint in own["off"].values()) for key in OFF}
        rows.append(
            [NAMES[name], *(f"{value:.4f}" if "rad" in key else f"{value:.1f}" for key, value in middles.items())]
        )
    return table(["solver", *OFF.values()], rows)
