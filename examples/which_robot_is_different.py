"""Which of my robots is not like the others?

Four small arms are recorded, the last of which hears its commands late; each is identified by itself, and compared.
Only delays are fitted, so that they stand for wrong gains and friction, too: the arm's true delay is 24 ms. A joint is
compared over those arms only whose motions determine its delay: here no shoulder, and not the elbow of the last arm.

    python examples/which_robot_is_different.py OUT
"""

import sys
from dataclasses import replace
from pathlib import Path

from trueup.dataset import Dataset, DatasetWriter
from trueup.identify import IdentifyConfig
from trueup.identify.config import SolverChoice
from trueup.robots import load_robot
from trueup.stages import demo_dataset
from trueup.stages.fleet import fleet


def main(out: Path) -> None:
    source = Dataset(demo_dataset(out / "recorded"))
    with DatasetWriter.create(out / "data", source.info) as writer:
        for number, episode in enumerate(source):
            unit = number % 4 + 1
            # The last one's commands arrive late: the example's stand-in for a fault.
            lag_s = 0.05 if unit == 4 else 0.0
            command = replace(episode.command, time_s=episode.command.time_s - lag_s)
            meta = replace(episode.meta, unit=f"arm-{unit}", split="train" if number < 8 else "test")
            writer.append(replace(episode, meta=meta, command=command))
    config = IdentifyConfig(fit={"delay_s": "all"}, solver=SolverChoice("gauss-newton", max_iterations=5))
    found = fleet([out / "data"], load_robot("demo_arm"), out / "fleet", config=config)
    for unit in found.units:
        values = ", ".join(f"{name} {value.value:.3f} s" for name, value in unit.parameters.items())
        print(f"{unit.name}: {values}")
    for row in found.parameters:
        unlike = ", ".join(row.apart) or "-"
        print(f"{row.name}: {row.mean:.4g} [{row.low:.4g}, {row.high:.4g}] {row.unit}, unlike: {unlike}")


if __name__ == "__main__":  # processes are started
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/example-fleet"))
