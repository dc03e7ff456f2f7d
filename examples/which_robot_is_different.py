"""Which of my robots is not like the others?

The last of four arms gets its commands 50 ms late. Only arms whose motions determine a number are compared.

    python examples/which_robot_is_different.py OUT
"""

import sys
from dataclasses import replace
from pathlib import Path

from trueup.dataset import Dataset, DatasetWriter
from trueup.identify import IdentifyConfig
from trueup.identify.config import DataChoice, SolverChoice
from trueup.robots import load_robot
from trueup.stages import demo_dataset
from trueup.stages.fleet import fleet

MOTIONS = ("reach_a", "chirp", "multisine_wide")
FIT = {"delay_s": {"shared": True}, "kp": "all", "damping": "all", "frictionloss": "all"}


def main(out: Path) -> None:
    arms = [Dataset(demo_dataset(out / "recorded" / f"arm-{number}", seed=number)) for number in range(1, 5)]
    with DatasetWriter.create(out / "data", arms[0].info) as writer:
        for number, arm in enumerate(arms, 1):
            for episode in (arm[name] for name in MOTIONS):
                # The last one's commands arrive late: the example's stand-in for a fault.
                lag_s = 0.05 if number == 4 else 0.0
                command = replace(episode.command, time_s=episode.command.time_s - lag_s)
                meta = replace(episode.meta, id=f"arm-{number}/{episode.id}", unit=f"arm-{number}")
                writer.append(replace(episode, meta=meta, command=command))
    # Four seconds of each motion are enough for these numbers.
    config = IdentifyConfig(
        fit=FIT, models={}, data=DataChoice(budget_s=12.0), solver=SolverChoice("gauss-newton", max_iterations=10)
    )
    found = fleet([out / "data"], load_robot("demo_arm"), out / "fleet", config=config)
    for unit in found.units:
        print(f"{unit.name}: delay {unit.parameters['delay_s'].value:.3f} s")
    for row in found.parameters[:4]:  # the delay and the gains
        unlike = ", ".join(row.apart) or "-"
        print(f"{row.name}: {row.mean:.4g} [{row.low:.4g}, {row.high:.4g}] {row.unit}, unlike: {unlike}")


if __name__ == "__main__":  # processes are started
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/example-fleet"))
