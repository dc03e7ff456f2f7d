"""What has my model wrong, and how sure is that?

It fits gains and delays of a small arm.

    python examples/what_has_the_model_wrong.py OUT
"""

import sys
from pathlib import Path

from trueup.dataset import Dataset
from trueup.identify import IdentifyConfig
from trueup.robots import load_robot
from trueup.stages import demo_dataset, fit

out = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/example-fit")
data = Dataset(demo_dataset(out / "data"))
# Without `fit`, the default for the robot's controller, which tries richer models, too.
found = fit(data, load_robot("demo_arm"), out / "fit", config=IdentifyConfig(fit={"delay_s": "all", "kp": "all"}))
for parameter in found.fit.parameters:
    low, high = parameter.interval
    print(
        f"{parameter.name}: {parameter.nominal} -> {parameter.value:.4g} [{low:.4g}, {high:.4g}] {parameter.unit}, "
        f"determined: {parameter.identified}"
    )
for rung in found.ladder.rungs:
    print(f"{rung.name}: {rung.splits['test']['position']['rmse'].total.value:.4f} rad on test")
print(f"the fitted model, for plain MuJoCo: {out / 'fit' / 'model.fitted.xml'}")
