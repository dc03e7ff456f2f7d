"""Lines to copy: what can be done with the networks of a close."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from trueup.core.fit_result import STOCK_ROBOT
from trueup.core.model_card import Channel, ModelCard
from trueup.report.folder import RunFolder
from trueup.report.labels import MAIN_METRIC, SIGNALS, main_signal, ordered
from trueup.report.recipes import MODEL, ROBOT, Recipe, held_back, stepped_lines

_STREAM = """\
import numpy as np
from trueup.deploy import RealTimeClock, Status, Stream

joints = {joints}
stream = Stream.load("{folder}", rate_hz={rate!r}, joints=joints)
{under}

{readers}


clock = RealTimeClock()
for cycle in range(200):  # for as long as your loop runs
    clock.wait_until_s(cycle / {rate!r})
    answer = stream.step({given}, time_s=clock.now_s())
    if answer.status is Status.OK:
        corrected = answer["{signal}"]  # what the robot would measure, (J,)"""
_READER = '''\
def {name}():
    """{words}"""
    return {{{values}}}'''
_READERS = {
    "simulated": "What your simulator says now, in the order of the joints, SI.",
    "command": "What it was asked for.",
    "measured": "What the sensors said in the cycle before.",
}
_CORRECT = """\
trueup replay path/to/other --robot {robot} --label {run}
trueup augment eval path/to/other --run {run} --split all \\
  --model {folder} --out runs/corrected"""


def network_recipes(run: RunFolder) -> list[Recipe]:
    """The best network for a control loop, the same in a training loop, and the best one for other motions."""
    if run.close is None:
        return []
    order = by_val(run)
    if not order:  # there is none, or all of them leave everything as it is
        return []
    found = []
    live = live_label(run)
    if live:
        folder = run.close.networks[live]
        text = f"The network that is best on validation motions of those that need no future. {_worth(run, live)}"
        lines = stream_lines(own_card(run, live), folder)
        found.append(Recipe("In a control loop: the corrected simulator's view", text, lines))
        if run.fit is not None and in_training_loop(run):
            title = "In a training loop: a simulator that says what the robot would measure"
            found.append(Recipe(title, held_back(run.fit), stepped_lines(run.fit, folder)))
    card = run.networks[order[0]]
    text = f"Any motions of this dataset format, corrected by {card.name}. {_worth(run, order[0])}"
    base = order[0].rpartition("+")[0]
    stock = STOCK_ROBOT if STOCK_ROBOT in run.given_files else "ROBOT"
    robot = ROBOT if base.endswith("fitted") else stock
    lines = _CORRECT.format(folder=run.close.networks[order[0]], run=base, robot=robot)
    found.append(Recipe("Other motions, corrected", text, lines))
    return found


def live_label(run: RunFolder) -> str:
    """The run of the best network that goes step by step; empty without one."""
    return next((label for label in by_val(run) if run.networks[label].causal), "")


def in_training_loop(run: RunFolder) -> bool:
    """Whether a network goes around the fitted simulator, step by step."""
    return {ROBOT, MODEL} <= set(run.fitted_files) and live_label(run).startswith("mujoco/fitted+")


def by_val(run: RunFolder, signal: str = "") -> list[str]:
    """Labels of runs that are corrected at all, the best on validation motions first; else as they were made.

    Args:
        run: the folder.
        signal: that counts; the main one if not given.
    """

    def error(label: str) -> float:
        metrics = run.gap.runs.get(label, {}).get("val", {})
        results = metrics.get(signal or main_signal(metrics), {}) if metrics else {}
        return results[MAIN_METRIC].total.value if MAIN_METRIC in results else math.inf

    used = [label for label, card in run.networks.items() if any(output.gate > 0 for output in card.outputs)]
    return sorted(used, key=error)


def own_card(run: RunFolder, label: str) -> ModelCard:
    """The card of a network on this robot: of a modular one, for the joints whose unit it knows."""
    card = run.networks[label]
    output = card.outputs[0]
    if output.of_body:  # of which the results have other names
        return card
    result = run.gap.runs.get(label, {}).get("all", {}).get(output.signal, {}).get(MAIN_METRIC)
    units = {} if result is None else {joint: item.unit for joint, item in result.per_joint.items()}
    joints = [joint for joint in run.gap.joints if units.get(joint, output.unit) == output.unit]
    return card.of_joints(joints or run.gap.joints)


def stream_lines(card: ModelCard, folder: str) -> str:
    """A loop that asks the network in every cycle; what it reads stands there as functions to fill."""
    series = [name for name in _READERS if any(channel.series == name for channel in card.inputs)]
    readers = []
    for name in series:
        signals = _signals([channel for channel in card.inputs if channel.series == name])
        values = ", ".join(f'"{signal}": np.zeros({len(card.joints)})' for signal in signals)
        readers.append(_READER.format(name=name, words=_READERS[name], values=values))
    under = _signals([channel for channel in card.inputs if channel.series == "condition"])
    given = [f"{name}()" if name == "simulated" else f"{name}={name}()" for name in series]
    return _STREAM.format(
        joints=json.dumps(list(card.joints), ensure_ascii=False),
        folder=folder,
        rate=float(card.rate_hz),
        under="".join(f"stream.under({name}=0.0)  # as it is, until it is another\n" for name in under),
        readers="\n\n\n".join(readers),
        given=", ".join(given),
        signal=_signals([output for output in card.outputs if output.gate > 0])[0],
    )


def _signals(channels: Sequence[Channel]) -> list[str]:
    return ordered({channel.quantity for channel in channels}, SIGNALS)


def _worth(run: RunFolder, label: str) -> str:
    """What validation motions say of it, against what it corrects."""
    pair = next(
        (
            item
            for item in run.gap.paired
            if (item.run, item.baseline, item.split, item.metric)
            == (label, label.rpartition("+")[0], "val", MAIN_METRIC)
            and item.signal == main_signal(run.gap.runs[label]["val"])
        ),
        None,
    )
    if pair is None:
        return "What it is worth beside the model alone was not measured on validation motions."
    if pair.verdict == "better":
        return "It helps there, by an interval that excludes zero."
    words = "that it helps is not decided there" if pair.verdict == "undecided" else "it makes things worse there"
    return f"But {words}: the model without it may be all that is needed."
