"""Make the networks of the zoo again: `python -m benchmarks.zoo`.

Trains what is missing under runs/augment, measures it on units that it has not seen, and writes the model folder and
its card for people into the package.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import trueup.zoo
from benchmarks.augment_models import FOLDER, GOOD, OTHER_UNITS, ZOO_UNITS, data_of, train
from benchmarks.pages.markdown import table
from trueup.core.atomic import make_folder, write_bytes, write_text
from trueup.core.augment_result import AugmentResult
from trueup.core.model_card import ONNX_NAME, ModelCard
from trueup.stages import evaluate

NAME = "panda-realeasy-rt"
HOME = Path(trueup.zoo.__file__).parent

TEXT = """# {name}

The real-time network of Realeasy for a Franka Panda with an empty hand: from the joint positions, velocities and
torques of the twin `panda` (MuJoCo, PID on effort) at 100 Hz to what a robot would have measured.

```python
import trueup.zoo

model = trueup.zoo.load("{name}")
stream = model.stream(rate_hz=100.0, joints=model.card.joints)  # one sample in, one corrected sample out
corrected = model.predict(episode, "mujoco/stock")  # or a whole motion
```

**Trained on** {motions} motions of the virtual units {units} (`trueup record --hardware lab`), of several joints and of
single ones, filling the workspace, at 20 to 100 % of the speed limits; not on Cartesian lines.

**Measured on** units {others}, which it has not seen: torque MSE in Nm2 over all motions, and how many times
smaller it is than the simulator's, with a 95 % interval over motions.

{torque}

Position and velocity: {motion}.

**Not for** a payload, contact, another controller or another simulator: it corrects what it was trained on. Beyond
the ranges in `model.json` a `Stream` falls back to the simulator and says so. Virtual robots stand for real ones here:
judge it on your own robot with `trueup augment eval`, and train on your own recordings if it does not serve.

**Made by** `python -m benchmarks.zoo`; {warmup} samples of warm-up; intervals cover {coverage:.0%} of the samples of a
new motion on the units of the training.
"""


def main() -> None:
    """Train, measure, write."""
    source = train(NAME)
    card = ModelCard.load(source)
    results = {}
    for unit in OTHER_UNITS:
        out = FOLDER / "evaluated" / f"zoo-unit{unit}"
        results[unit] = evaluate(data_of(unit, 0.1), [source], out, run=GOOD, split="all", overwrite=True).result
    training = {**card.provenance["training"], "history": card.provenance["training"]["history"][-1:]}
    card = replace(
        card,
        description="Realeasy's real-time network for a Franka Panda without payload; see CARD.md.",
        provenance={**card.provenance, "training": training, "units": list(ZOO_UNITS)},
    )
    folder = HOME / NAME
    make_folder(folder)
    write_bytes(folder / ONNX_NAME, (source / ONNX_NAME).read_bytes())
    card.save(folder)
    write_text(folder / "CARD.md", _text(card, results))
    size = sum(path.stat().st_size for path in folder.iterdir())
    print(f"{folder}: {size / 1000:.0f} kB")


def _text(card: ModelCard, results: dict[int, AugmentResult]) -> str:
    joints = card.joints
    rows = []
    for unit, result in results.items():
        cuts = result.model(NAME).cuts[""]["torque"]
        simulated = result.simulated[""]["torque"]
        rows.append([f"unit {unit}: simulator", *(f"{simulated[joint].mse.value:.3g}" for joint in joints)])
        rows.append([f"unit {unit}: corrected", *(f"{cuts[joint].mse.value:.2g}" for joint in joints)])
        factors = (cuts[joint].factor for joint in joints)
        rows.append([f"unit {unit}: times smaller", *(f"{f.value:.3g} [{f.low:.3g}, {f.high:.3g}]" for f in factors)])
    others = [
        f"{min(item.factor.value for item in _joints(result, signal)):.0f} times ({signal}, unit {unit})"
        for unit, result in results.items()
        for signal in ("position", "velocity")
    ]
    motions = card.provenance["training"]["motions"]
    return TEXT.format(
        name=NAME,
        motions=motions["train"],
        units=", ".join(map(str, ZOO_UNITS)),
        others=" and ".join(map(str, OTHER_UNITS)),
        torque=table(["", *(f"joint {number}" for number in range(1, len(joints) + 1))], rows),
        motion="on every joint MSE is smaller by at least " + ", ".join(others),
        warmup=card.warmup_steps,
        coverage=card.coverage,
    )


def _joints(result: AugmentResult, signal: str) -> list:
    cuts = result.model(NAME).cuts[""][signal]
    return [cuts[joint] for joint in result.joints]


if __name__ == "__main__":
    main()
