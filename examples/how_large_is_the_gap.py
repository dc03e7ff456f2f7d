"""How large is the gap of my robot, and where?

A virtual arm. With your own logs, use `import_logs(...)` instead of `demo_dataset`.

    python examples/how_large_is_the_gap.py OUT
"""

import sys
from pathlib import Path

import trueup
from trueup.dataset import Dataset
from trueup.robots import load_robot
from trueup.stages import demo_dataset, gap, replay

out = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/example-gap")
data = Dataset(demo_dataset(out / "data"))
replay(data, load_robot("demo_arm"))
measured = gap(data, seed=0)
measured.save(out)
for label, splits in measured.gap.runs.items():
    rmse = splits["test"]["position"]["rmse"]
    print(f"{label}: {rmse.total.value:.4f} rad [{rmse.total.low:.4f}, {rmse.total.high:.4f}] on test")
    for joint, own in rmse.per_joint.items():
        print(f"  {joint}: {own.value:.4f} rad")
print(f"report: {trueup.write_report(out)}")
