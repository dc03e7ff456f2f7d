"""The section "In a simulator" of docs/what-compensation-brings.md, from `python -m benchmarks compensation`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from benchmarks.pages.augment_cells import listed, span
from benchmarks.pages.markdown import table
from trueup.measure import bootstrap_interval

NAMES = {
    "pd": "stock simulator (plain PD)",
    "mlp-on-stock": "MLP, on stock",
    "transformer-on-stock": "transformer, on stock",
    "operator-on-stock": "operator, on stock",
    "identified": "identified simulator",
    "mlp": "MLP, on identified",
    "transformer": "transformer, on identified",
    "operator": "operator, on identified",
    "identified, base sensed": "identified simulator, base sensed",
    "mlp-sensed": "MLP, on that",
    "transformer-sensed": "transformer, on that",
    "operator-sensed": "operator, on that",
}
# Metric -> title, factor, digits.
METRICS = {
    "large_gap_ratio": ("Large gaps [%], errors of {tau:g} rad and more", 100.0, 2),
    "iqr": ("Interquartile range of the error [mrad]", 1000.0, 1),
    "range": ("Range of the error [mrad]", 1000.0, 0),
    "mae": ("Mean error [mrad]", 1000.0, 1),
}
# Word of the text -> name in the tables.
SHORT = {
    "pd": "pd",
    "alone": "identified",
    "operator": "operator",
    "alone_sensed": "identified, base sensed",
    "sensed": "operator-sensed",
}
# Row -> a network, and the simulator that it corrects.
PAIRS = (
    (NAMES["operator"], "operator", "identified"),
    ("operator, base sensed", "operator-sensed", "identified, base sensed"),
)
TEXT = """## In a simulator

How far simulated motions are from those of a robot that no training has seen, {motions} unseen motions for each
payload: a network corrects the commands of the simulator, which then simulates every motion from its commands alone.
{seeds} networks of each kind, with the same data, updates, batches and windows, from other seeds; three simulators that
they correct, of which the last one hears an accelerometer on the robot's torso
([how](robots.md#every-key)). Mean and standard deviation over seeds; in brackets the 95 % interval over motions of what
has no seed. Mean over motions and joints.

```sh
python -m benchmarks compensation
```

{tables}

With the paper's threshold of {paper_tau:g} rad, {paper}.

### What it says

- The threshold is chosen so that plain PD has about 12 % of large gaps without a payload, as in GapONet's Table 1. The
  operator on the identified simulator has {operator_0} % there and {operator_3} % with 3 kg; where the simulator also
  hears the base, {sensed_0} % and {sensed_3} %. The paper's has 0.1 % and 0.9 %. Payloads that were never trained are
  hardly worse: {unseen} times the mean error of the worse of the trained neighbors, {unseen_sensed} times with the
  base.
- Nearly all of it is identification. This table has what the operator adds to the mean error of the identified
  simulator, with the 95 % interval over motions: on an individual that it has never seen, {least} to {most} mrad.
  Without the sensor, of these payloads, {helps_alone}.
  Where the base is sensed, {helps_sensed}.
  The last rows are other motions of the individuals that it was trained on, most of which it knows better: if you
  have several robots and want a network for others of their kind, keep the motions of one of them for val, and look
  whether anything is left.

{differences}

- On the stock simulator, which knows nothing of friction and delays, the networks do most of the work, and stay far
  behind identification all the same.
- What is left at 3 kg without the sensor is the motion of the base: with it, large gaps fall from {alone_3} to
  {alone_sensed_3} % before any network is trained. Measure what carries your robot before you learn.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    tables = result["tables"]
    return TEXT.format(
        motions=len(tables["pd"]["test"]["0"]["mae"][0]),
        seeds=len(tables["operator"]["test"]["0"]["mae"]),
        tables="\n\n".join(
            f"**{title.format(tau=result['tau_rad'])}**, by payload; those with a half were never trained:\n\n"
            f"{by_payload(tables, metric, factor, digits)}"
            for metric, (title, factor, digits) in METRICS.items()
        ),
        paper_tau=result["paper_tau_rad"],
        paper=_paper(tables),
        unseen=_unseen(tables, "operator"),
        unseen_sensed=_unseen(tables, "operator-sensed"),
        differences=_differences(result),
        helps_alone=_helps(tables, *PAIRS[0][1:]),
        helps_sensed=_helps(tables, *PAIRS[1][1:]),
        **dict(zip(("least", "most"), _extremes(tables), strict=True)),
        **{
            f"{short}_{kg}": f"{100 * _mean(tables, name, kg, 'large_gap_ratio'):.2f}"
            for short, name in SHORT.items()
            for kg in ("0", "3")
        },
    )


def _differences(result: Mapping[str, Any]) -> str:
    """Mean error with an operator minus that of the simulator alone, of an individual never seen and of known ones."""
    tables, training = result["tables"], result["training"]
    payloads = sorted({(float(kg), test) for test, own in tables["pd"].items() for kg in own})
    rows = [
        [title, *(_difference(tables, name, alone, test, f"{kg:g}") for kg, test in payloads)]
        for title, name, alone in PAIRS
    ]
    rows += [
        [f"{title}: individuals of the training", *(_known(training[name], kg) for kg, _ in payloads)]
        for title, name in (("operator", "operator"), ("operator, base sensed", "operator-sensed"))
    ]
    return table(["mean error [mrad]", *(f"{kg:g} kg" for kg, _ in payloads)], rows)


def _difference(tables: Mapping[str, Any], name: str, alone: str, test: str, kg: str) -> str:
    """By whole motion, with its interval."""
    value, low, high = _added(tables, name, alone, test, kg)
    return f"{value:+.2f} [{low:+.2f}, {high:+.2f}]".replace("-", "\N{MINUS SIGN}")


def _added(tables: Mapping[str, Any], name: str, alone: str, test: str, kg: str) -> tuple[float, float, float]:
    """Mean error with a network minus that without [mrad], and the ends of its interval over motions."""
    own, base = (1e3 * np.array(tables[key][test][kg]["mae"]).mean(axis=0) for key in (name, alone))
    low, high = bootstrap_interval((own - base)[:, None])
    return float((own - base).mean()), float(low[0]), float(high[0])


def _extremes(tables: Mapping[str, Any]) -> list[str]:
    """The smallest and the largest difference of all payloads, in both simulators."""
    values = [
        _added(tables, name, alone, test, kg)[0]
        for _, name, alone in PAIRS
        for test, own in tables[name].items()
        for kg in own
    ]
    return [f"{end(values):+.2f}".replace("-", "\N{MINUS SIGN}") for end in (min, max)]


def _helps(tables: Mapping[str, Any], name: str, alone: str) -> str:
    """With which payloads the error falls or grows for sure: the whole interval lies on one side of zero."""
    ends = {float(kg): _added(tables, name, alone, test, kg)[1:] for test, own in tables[name].items() for kg in own}
    falls = [f"{kg:g}" for kg, (_, high) in sorted(ends.items()) if high < 0]
    grows = [f"{kg:g}" for kg, (low, _) in sorted(ends.items()) if low > 0]
    helped = f"it helps for sure with {listed(falls)} kg" if falls else "it helps for sure with none of them"
    harmed = f"makes the error larger for sure with {listed(grows)} kg" if grows else "harms for sure with none"
    return f"{helped}, and {harmed}"


def _known(trainings: Sequence[Mapping[str, Any]], kg: float) -> str:
    """On val, mean over seeds; nothing where the payload was never trained."""
    found = [val["after"] - val["before"] for own in trainings for val in own["val"] if val["payload_kg"] == kg]
    return f"{1e3 * float(np.mean(found)):+.2f}".replace("-", "\N{MINUS SIGN}") if found else ""


def _unseen(tables: Mapping[str, Any], name: str) -> str:
    seen, unseen = (
        {float(kg): float(np.mean(own["mae"])) for kg, own in tables[name][test].items()}
        for test in ("test", "test-unseen-payload")
    )
    return span(over_neighbors(seen, unseen))


def over_neighbors(seen: Mapping[float, float], unseen: Mapping[float, float]) -> list[float]:
    """Errors with payloads that were never trained, over that of the worse of the trained neighbors [kg]."""
    return [error / max(seen[other] for other in seen if abs(other - kg) < 1.0) for kg, error in unseen.items()]


def _mean(tables: Mapping[str, Any], name: str, kg: str, metric: str) -> float:
    return float(np.mean(tables[name]["test"][kg][metric]))


def by_payload(tables: Mapping[str, Any], metric: str, factor: float, digits: int) -> str:
    """A row for each way, a column for each payload."""
    payloads = sorted({(float(kg), test) for own in tables.values() for test in own for kg in own[test]})
    heads = ["", *(f"{kg:g} kg" for kg, _ in payloads)]
    rows = []
    for name, title in NAMES.items():
        if name in tables:
            cells = [cell(factor * np.array(tables[name][test][f"{kg:g}"][metric]), digits) for kg, test in payloads]
            rows.append([title, *cells])
    return table(heads, rows)


def cell(values: Float64[np.ndarray, "S M"], digits: int) -> str:
    """Mean over motions: with its spread over seeds, or, of a single one, the interval over motions."""
    if len(values) > 1:
        seeds = values.mean(axis=1)
        return f"{seeds.mean():.{digits}f} ± {seeds.std(ddof=1):.{digits}f}"
    low, high = bootstrap_interval(values[0][:, None])
    return f"{values.mean():.{digits}f} [{low[0]:.{digits}f}, {high[0]:.{digits}f}]"


def _paper(tables: Mapping[str, Any]) -> str:
    """Where most of the samples are large gaps by the paper's threshold, over all payloads."""
    shares = {
        name: 100 * float(np.mean([row["large_gap_ratio_paper"] for test in own.values() for row in test.values()]))
        for name, own in tables.items()
        if name in NAMES
    }
    most = max(shares, key=lambda name: shares[name])
    return f"over all payloads, no row has more large gaps than {shares[most]:.2g} % ({NAMES[most]})"
