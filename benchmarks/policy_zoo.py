"""Make the policy of the zoo again: `python -m benchmarks.policy_zoo`.

Drives, identifies and trains what is missing under runs/policies (about forty minutes on two cores if nothing is
there), takes of the policies of three robots the one that does best in its own simulator, judges it, and writes its
folder and its card for people into the package.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import trueup.zoo
from benchmarks.pages.markdown import table
from benchmarks.policy_data import UNITS
from benchmarks.policy_going_on import DRIVEN, GoingOn, began, trained
from benchmarks.policy_transfer import DART_GOALS, GOALS, STRANGERS, places
from trueup.core.atomic import make_folder, write_bytes, write_text
from trueup.core.policy_card import POLICY_GRAPH, PolicyCard
from trueup.deploy.policy import Policy
from trueup.policy.evaluation import Episodes, evaluate
from trueup.robots import find_model, load_robot
from trueup.stages.policy_judging import velocity_limit

NAME = "panda-reach"
HOME = Path(trueup.zoo.__file__).parent
TITLES = {
    "stock": "MuJoCo, `panda_torque` as it comes",
    "identified": "MuJoCo, identified",
    "dart": "DART, identified",
    **{f"lab-{unit}": f"virtual hardware, unit {unit}" for unit in (*UNITS, *STRANGERS)},
}
TEXT = """# {name}

Reaching with a torque-controlled Franka Panda (ES thesis, chapters 2 and 4): from joint positions, velocities and a
goal to torques on top of what carries the arm's weight, {rate:g} times a second.

```sh
trueup policy eval zoo:{name} --on mujoco,dart,lab
trueup deploy run zoo:{name} --goal 0.4 0.2 0.5
```

**Trained** with SAC for {steps} control steps ({minutes:.0f} min on one core) in `panda_torque` as it comes, and then
for as many in what it was identified as from {driven} runs on the virtual unit {unit}, with all identified numbers
drawn from their posterior for each episode.

**Measured** on {goals} goals that are the same everywhere, {near:g} to {far:g} m from the start. Medians with 95 %
intervals over goals (in DART the first {dart}).

{rows}

**Not for** a payload, contact, obstacles, another starting pose than `home`, another rate or another robot. Virtual
robots stand for real ones here: identify yours, and train on that.

**Made by** `python -m benchmarks.policy_zoo`.
"""


def main() -> None:
    """Train, choose, judge, write."""
    for unit in UNITS:
        began(unit)
    cells = [GoingOn("identified", "posterior", unit) for unit in UNITS]
    rewards = [max(point[2] for point in trained(cell)["curve"]) for cell in cells]
    cell = cells[int(np.argmax(rewards))]
    card = PolicyCard.load(cell.folder)
    folder = HOME / NAME
    make_folder(folder)
    write_bytes(folder / POLICY_GRAPH, (cell.folder / POLICY_GRAPH).read_bytes())
    made = replace(
        card,
        name=NAME,
        description="Reaching by torques, trained in the identified simulator of a virtual Panda; see CARD.md.",
    ).save(folder)
    policy = Policy.load(folder, joints=load_robot("panda_torque").joint_names, rate_hz=card.rate_hz)
    found = {}
    robots = {"stock": load_robot("panda_torque"), "identified": cell.robot}
    for place, reaching in places(robots, (*UNITS, *STRANGERS)).items():
        goals = reaching.workspace.draw(np.random.default_rng(21), GOALS)
        found[place] = evaluate(
            policy.act,
            reaching,
            goals[:DART_GOALS] if place == "dart" else goals,
            velocity_limit=velocity_limit(find_model(robots["stock"]), robots["stock"]),
        )
    write_text(folder / "CARD.md", _text(made, found, cell.unit))
    size = sum(path.stat().st_size for path in folder.iterdir())
    print(f"{folder}: {size / 1000:.0f} kB, of robot {cell.unit}")


def _text(card: PolicyCard, found: dict[str, Episodes], unit: int) -> str:
    reach = card.provenance["config"]["reach"]
    history = card.provenance["history"]
    rows = []
    for place, episodes in found.items():
        said = episodes.estimates()
        distance, success = said["distance_median"], said["success"]
        low, high = (100 * (end or 0.0) for end in (distance.low, distance.high))
        rows.append(
            [
                TITLES[place],
                f"{100 * distance.value:.1f} [{low:.1f}, {high:.1f}]",
                f"{100 * success.value:.0f}",
                f"{100 * said['overshoot'].value:.1f}",
            ]
        )
    heads = ["", "distance at the end [cm]", "within 5 cm [%]", "overshoot [cm]"]
    return TEXT.format(
        name=NAME,
        rate=card.rate_hz,
        steps=f"{history[-1]['steps']:,}",
        minutes=history[-1]["cpu_seconds"] / 60,
        driven=DRIVEN,
        unit=unit,
        goals=GOALS,
        dart=DART_GOALS,
        near=reach["nearest_m"],
        far=reach["farthest_m"],
        rows=table(heads, rows),
    )


if __name__ == "__main__":
    main()
