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
NAMES = {
    "auto": "`auto`: Gauss-Newton",
    "gauss-newton, six elements, joint by joint": "`gauss-newton`, six elements per link, joint by joint",
    "evolution": "`evolution`: the thesis's strategy",
    "cma-es": "`cma-es`",
    "cma-es, joint by joint": "`cma-es`, joint by joint",
}
OFF = {
    "level_percent": "level phi_1 [%]",
    "slope_percent": "slope phi_2 [%]",
    "shift_rad_s": "shift phi_3 [rad/s]",
    "friction_torque_percent": "friction torque [%]",
    "joint_inertia_percent": "inertia felt by the joint [%]",
    "link_inertia_percent": "inertia tensor of the link [%]",
}

TEXT = """# The thesis's experiment

A master's thesis on reinforcement learning for a torque-controlled Panda (the *ES thesis* of these pages) fits friction
and inertia to 28 trajectories with an evolution strategy, and reports the error of each joint before and after (its
3.2). Here the same is done on a Panda whose truth is hidden, so that fitted numbers can be held against true ones. This
page is made from what `python -m benchmarks thesis` measures (`make pages` writes it).

## What is done

- **Motions** (3.2, Table 3.3): one joint at a time gets a constant torque for 1500 steps and none for 500, at 1 kHz,
  from a home pose; the arm's weight is compensated. 28 trajectories are fitted, {held_out} with other torques are held
  out.
- **Model**: our Panda with the friction of Table 2.3 (eq. 2.1, the three [sigmoid numbers](friction.md) per joint) and
  published inertias; no other friction. The thesis starts there as well.
- **Hidden robot**: friction drawn about what the thesis found (Table 3.4: 10 % in level, 20 % in slope), inertias about
  Table 3.5 (a factor per link, and 3 % of deformation). It also has what the model cannot say: armatures that are off
  by up to 10 %, 0.02 to 0.04 Nm of dry and 0.01 to 0.05 Nm s/rad of viscous friction, up to 0.01 Nm of error in the
  gravity compensation, half the time step, an encoder with 17 bits and 0.03 mrad of noise. The offsets of Table 3.1
  are left out: the thesis takes them away by hand before it records.
- **Fit**: whole trajectories, 21 friction numbers and one factor per link inertia, simulated at {step_ms:g} ms.
  (Table 3.5 changes all six elements of a link by one factor, so that is what the thesis's search did; one row below
  has all six.)
- **Error** (3.2.1): absolute difference between simulated and measured position of the moved joint, summed over every
  millisecond of all its trajectories, simulated at 1 ms. The thesis does not give its interval, so its
  sums cannot be compared with these; how much of them is left can.

## Three solvers, same data

How much of each joint's error is gone, in percent. *Held out* is the worst joint on torques that were not fitted. One
evaluation simulates all 28 trajectories once. Robot 0, {threads} threads; *CPU s* does not depend on what else the
machine did.

{solvers}

The default solver on all robots:

{robots}

{verdict}

`evolution` and `cma-es` have {evaluations} evaluations. The evolution strategy has its paper's settings: each joint
accepts its own numbers by its own error, and the sign of the error says whether friction must rise or fall.
CMA-ES sees one cost for all joints; *joint by joint* it searches 4 numbers at a time from the hand to the
base, in two rounds of {per_joint} evaluations.

## Errors, joint by joint

Robot 0, default solver, sums in rad.

{errors}

## Is it the truth?

Median over the joints of robot 0, sign left out. *Friction torque* compares all that brakes the joint, the hidden
robot's other friction included, over the speeds that it had; *inertia felt by the joint* is that of the arm about its
axis with the armature, in the home pose.

{truth}

Friction is found, and so is the inertia that a joint feels. The tensors of single links are not: one joint at a time
about one axis shows a sum of link inertias and armature, and any division of the sum moves the arm in nearly the same
way. The thesis's new inertias (Table 3.5) rest on motions of this kind. Whoever needs them must excite several joints
at once; `trueup identify` says of each number [how sure it is](identification.md).
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
        robots=robot_table(robots),
        verdict=verdict(robots),
        errors=error_table(first[DEFAULT]["joints"]),
        truth=truth_table(first),
    )


def solver_table(searches: dict[str, Any]) -> str:
    """One row per solver, and the thesis."""
    heads = ["solver", *(f"j{number}" for number in range(1, 8)), "held out", "evaluations", "s", "CPU s", "ended"]
    rows = [[NAMES[name], *cut_cells(own)] for name, own in searches.items()]
    thesis = [f"{100 * (1 - after / before):.1f}" for before, after in THESIS]
    return table(heads, [*rows, ["the thesis, on its robot", *thesis, "", "", "", "", ""]])


def robot_table(robots: list[dict[str, Any]]) -> str:
    """The default solver, one row per hidden robot."""
    heads = ["robot", *(f"j{number}" for number in range(1, 8)), "held out", "evaluations", "s", "CPU s", "ended"]
    return table(heads, [[str(robot["seed"]), *cut_cells(robot["searches"][DEFAULT])] for robot in robots])


def cut_cells(own: dict[str, Any]) -> list[str]:
    """What is gone of each joint's error, and what it took."""
    joints, solver = own["joints"].values(), own["solver"]
    worst = min(joint["held_out_cut_percent"] for joint in joints)
    cells = [f"{joint['cut_percent']:.2f}" for joint in joints]
    times = (f"{solver[key]:.0f}" for key in ("seconds", "cpu_seconds"))
    return [*cells, f"{worst:.2f}", str(solver["evaluations"]), *times, solver["stop"]]


def verdict(robots: list[dict[str, Any]]) -> str:
    """The bar, and whether it is met."""
    worst = min(joint["cut_percent"] for robot in robots for joint in robot["searches"][DEFAULT]["joints"].values())
    met = "is met" if worst >= 98.0 else "is missed"
    return f"The bar, 98 % on every joint of every robot, {met}: the worst is {worst:.2f} %."


def error_table(joints: dict[str, Any]) -> str:
    """Initial and final error per joint, beside the thesis's."""
    heads = ["joint", "before", "after", "gone [%]", "held out: before", "after", "gone [%]", "thesis: gone [%]"]
    rows = [
        [
            joint.removeprefix("joint"),
            *(f"{own[key]:.1f}" for key in ("initial_rad", "final_rad")),
            f"{own['cut_percent']:.2f}",
            *(f"{own[key]:.1f}" for key in ("held_out_initial_rad", "held_out_final_rad")),
            f"{own['held_out_cut_percent']:.2f}",
            f"{100 * (1 - after / before):.1f}",
        ]
        for (joint, own), (before, after) in zip(joints.items(), THESIS, strict=True)
    ]
    return table(heads, rows)


def truth_table(searches: dict[str, Any]) -> str:
    """How far from the truth each solver ended."""
    rows = []
    for name, own in searches.items():
        middles = {key: median(abs(joint[key]) for joint in own["off"].values()) for key in OFF}
        rows.append(
            [NAMES[name], *(f"{value:.4f}" if "rad" in key else f"{value:.1f}" for key, value in middles.items())]
        )
    return table(["solver", *OFF.values()], rows)
