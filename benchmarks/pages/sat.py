"""The section "Servos of robots that it never saw" of docs/building-blocks.md, from `python -m benchmarks sat`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.markdown import table

ROBOTS = {
    "kickbot_a": "KickBotA, held at its pelvis: the robot of the training",
    "kickbot_b": "KickBotB, standing on one foot: never seen",
    "dancebot": "DanceBot, closed chains: never seen",
}
# As the paper has them (Table I, KickBotA).
PAPER = {"simulator": (0.48, 1.10), "lstm": (1.50, 2.80), "attention": (0.26, 0.82), "attention-dense": (0.26, 0.76)}
PAPER_SAT = (0.24, 0.71)
# Asked of the modular SAT on robots that it never saw: least share of the simulator's error that it takes away.
UNSEEN = ("kickbot_b", "dancebot")
BARS = {"mae": 0.50, "max": 0.35}

TEXT = """## Servos of robots that it never saw

Virtual hardware ([lab](virtual-robot.md) `{lab}`) of three robots with twelve servos each. One network for a servo is
trained on {motions} random B-splines of KickBotA; it is tested on animations, 16 motions of each robot: kicks, waves,
marching, knee bends, dance steps. What a network reads was chosen on KickBotA: on its val motions, and in fourfold
gravity (no script of that is kept). KickBotA and KickBotB are the same individual, held elsewhere: never seen are its
loads. DanceBot has other servos: another draw of friction, springs and windings. The 16 motions are four animations,
each at four speeds and sizes.

```sh
python -m benchmarks sat
```

Position of the joints in degrees: mean absolute error, and largest error of each joint and motion, means over joints
and motions; in brackets the share of the simulator's error that is gone, with its paired 95 % interval over the four
animations.

{errors}

{bars}

The architectures are those of Table I of the paper, whose figures for its KickBotA are, mean and largest error in
degrees: {paper}.
{order}

{modular}

The largest shares of attention, in percent: on the present sample, on the ten before it, and on those 20 and more
samples ago (Fig. 11).

{attention}

A network for the current is judged by Lin's concordance with the measured current (Fig. 6; paper, KickBotB: 0.25 to
0.75), mean over joints that move, and motions:

{ccc}

Trained on one core each: {training}.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    training = result["training"]
    return TEXT.format(
        lab=result["lab"],
        motions=result["train_motions"],
        errors=_errors(result),
        bars=_bars(result),
        paper="; ".join(f"{name} {mae:.2f}, {most:.2f}" for name, (mae, most) in {**PAPER, "SAT": PAPER_SAT}.items()),
        order=_order(result),
        modular=_modular(result),
        attention=_attention(result),
        ccc=_ccc(result),
        training=", ".join(f"`{name}` {item['seconds'] / 60:.0f} min" for name, item in training.items()),
    )


def _errors(result: Mapping[str, Any]) -> str:
    rows = []
    names = ["simulator", *(name for name in result["about"] if name != "sat-current")]
    for name in names:
        cells = [f"`{name}`: {result['about'][name]}" if name in result["about"] else "simulator"]
        rows.append([*cells, *(_cell(result, test, name) for test in ROBOTS)])
    return table(["", *ROBOTS.values()], rows)


def _cell(result: Mapping[str, Any], test: str, name: str) -> str:
    own = result["errors"][test].get(name)
    if own is None:
        return "has other joints"
    mae, most = (np.mean(own["position"][metric]) for metric in ("mae", "max"))
    if name == "simulator":
        return f"{mae:.2f}, {most:.2f}"
    cuts = result["cuts"][test][name]["position"]
    return f"{mae:.2f} ({share(cuts['mae'])}), {most:.2f} ({share(cuts['max'])})"


def share(cut: Mapping[str, float]) -> str:
    """What is gone of an error, with its interval."""
    return f"{cut['value']:.0%} [{cut['low']:.0%}, {cut['high']:.0%}]".replace("%", " %")


def _bars(result: Mapping[str, Any]) -> str:
    """What was asked: half of the mean and 35 % of the largest error on both robots that it never saw."""
    missed = [
        f"{metric} on {test}"
        for test in UNSEEN
        for metric, bar in BARS.items()
        if result["cuts"][test]["sat"]["position"][metric]["value"] < bar
    ]
    asked = "Asked of `sat` on both robots that it never saw: 50 % of the mean and 35 % of the largest error"
    return f"{asked}; missed: {', '.join(missed)}." if missed else f"{asked}; both are kept."


def _order(result: Mapping[str, Any]) -> str:
    own = {
        name: np.mean(result["errors"]["kickbot_a"][name]["position"]["mae"])
        for name in ("lstm", "attention", "attention-dense", "sat")
    }
    order = sorted(own, key=lambda name: own[name])
    return f"Here, from best to worst by mean error on KickBotA: {', '.join(f'`{name}`' for name in order)}."


def _modular(result: Mapping[str, Any]) -> str:
    lines = []
    for test, pair in result["modular"].items():
        item = pair["mae"]["difference"]
        lines.append(f"{ROBOTS[test].split(',')[0]} {item['value']:+.3f} [{item['low']:+.3f}, {item['high']:+.3f}]")
    text = (
        "The network of the whole robot reads and corrects all twelve servos at once, and so serves robots with the "
        f"same joints only. Mean error of the modular one minus its, in degrees: {'; '.join(lines)}."
    )
    made = result["training"]["whole"]
    if made["best_epoch"] == made["epochs"]:
        text += " That is no claim: its error on val was still falling when its training ended."
    else:
        text += (
            f" It was trained for {made['epochs']} epochs; after {made['best_epoch']} its error on val did not fall "
            "any further, while that on train did: twelve servos at once are more to learn from the same motions."
        )
    return text


def _attention(result: Mapping[str, Any]) -> str:
    rows = []
    for name, shares in result["attention"].items():
        own = 100 * np.array(shares)
        rows.append([f"`{name}`", f"{own[0]:.1f}", f"{own[1:11].sum():.1f}", f"{own[20:].sum():.1f}"])
    return table(["", "present", "ten before", "20 and more"], rows)


def _ccc(result: Mapping[str, Any]) -> str:
    rows = []
    for test, label in ROBOTS.items():
        cells = [
            f"{np.mean(result['errors'][test][name]['current']['ccc']):.2f}" for name in ("simulator", "sat-current")
        ]
        rows.append([label.split(":")[0], *cells])
    return table(["", "simulator", "`sat-current`"], rows)
