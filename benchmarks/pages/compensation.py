"""The section "In a simulator" of docs/what-compensation-brings.md, from `python -m benchmarks compensation`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from benchmarks.compensation import rows as measured
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
    "mlp-sensed": "MLP, base sensed",
    "transformer-sensed": "transformer, base sensed",
    "operator-sensed": "operator, base sensed",
}
# Row -> a network, and the simulator that it corrects.
PAIRS = (
    (NAMES["operator"], "operator", "identified"),
    ("operator, base sensed", "operator-sensed", "identified, base sensed"),
)
# Payloads of the tables; the others are in the result [kg].
SHOWN = (0.0, 3.0)
# That of the large gaps [kg].
HEAVIEST = "3"
TEXT = """## In a simulator

A network corrects the commands of a simulator, which then simulates each motion from its commands alone. Of three
simulators, the last one uses an accelerometer on the robot's torso. Mean ± standard deviation over {seeds} seeds or,
without a network, the 95 % interval over motions; `benchmarks/results/compensation.json` has all payloads and metrics.

```sh
python -m benchmarks compensation
```

Mean error [mrad] on the held-out individual, and share of errors of {tau:g} rad and more (large gaps):

{mean}

- Identification does nearly everything. The operator changes the mean error of the identified simulator by {least} to
  {most} mrad. By the intervals of all payloads, {helps_alone}; with the base sensed, {helps_sensed}.
- {missed}
- A network knows the individuals of its training better (last two rows below). For others of their kind, keep one robot
  for val to see what is gained.
- Most of what is left with {heaviest} kg is motion of the base. Measure it before you train.
- Untrained payloads: {unseen} times the mean error of the worse trained neighbor, {unseen_sensed} with the base sensed.
- GapONet's operator has 0.1 % (0 kg) and 0.9 % (3 kg) of large gaps, by its threshold of {paper_tau:g} rad; by that,
  {paper} here.

Operator minus simulator alone, mean error [mrad]:

{differences}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    tables = result["tables"]
    return TEXT.format(
        seeds=len(tables["operator"]["test"]["0"]["mae"]),
        tau=result["tau_rad"],
        mean=by_payload(tables),
        heaviest=HEAVIEST,
        missed=_missed(result),
        paper_tau=result["paper_tau_rad"],
        paper=_paper(tables),
        unseen=_unseen(tables, "operator"),
        unseen_sensed=_unseen(tables, "operator-sensed"),
        differences=_differences(result),
        helps_alone=_helps(tables, *PAIRS[0][1:]),
        helps_sensed=_helps(tables, *PAIRS[1][1:]),
        **dict(zip(("least", "most"), _extremes(tables), strict=True)),
    )


def _missed(result: Mapping[str, Any]) -> str:
    """How many bars are missed, by what they are about."""
    rows = [row for row in measured(result) if row.limit is not None]
    missed = [row.name.partition(": ")[2].partition(",")[0] for row in rows if not row.ok]
    kinds = ", ".join(f"{missed.count(kind)} of {kind}" for kind in dict.fromkeys(missed))
    if not missed:
        return f"All {len(rows)} bars are kept."
    return (
        f"Of {len(rows)} bars, most of which ask the operator to beat other networks and the simulator alone, "
        f"{len(missed)} are [missed](benchmarks.md#missed-limits): {kinds}."
    )


def _differences(result: Mapping[str, Any]) -> str:
    """Mean error with an operator minus that of the simulator alone, of an individual never seen and of known ones."""
    tables, training = result["tables"], result["training"]
    payloads = _shown(tables)
    rows = [
        [title, *(_difference(tables, name, alone, test, f"{kg:g}") for kg, test in payloads)]
        for title, name, alone in PAIRS
    ]
    rows += [
        [f"{title}: trained individuals", *(_known(training[name], kg) for kg, _ in payloads)]
        for title, name in (("operator", "operator"), ("operator, base sensed", "operator-sensed"))
    ]
    return table(["", *(f"{kg:g} kg" for kg, _ in payloads)], rows)


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
    """With which payloads the error falls or grows clearly: the whole interval lies on one side of zero."""
    ends = {float(kg): _added(tables, name, alone, test, kg)[1:] for test, own in tables[name].items() for kg in own}
    falls = [f"{kg:g}" for kg, (_, high) in sorted(ends.items()) if high < 0]
    grows = [f"{kg:g}" for kg, (low, _) in sorted(ends.items()) if low > 0]
    helped, harmed = (f"with {listed(own)} kg" if own else "nowhere" for own in (falls, grows))
    return f"it clearly helps {helped} and clearly harms {harmed}"


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


def _shown(tables: Mapping[str, Any]) -> list[tuple[float, str]]:
    """Payloads of the tables, each with its test."""
    tests = {float(kg): test for test, own in tables["pd"].items() for kg in own}
    return [(kg, tests[kg]) for kg in SHOWN]


def by_payload(tables: Mapping[str, Any]) -> str:
    """Mean errors: a row for each way, a column for each payload."""
    payloads = _shown(tables)
    heads = ["", *(f"{kg:g} kg{', untrained' * (test != 'test')}" for kg, test in payloads)]
    heads.append(f"large gaps [%], {HEAVIEST} kg")
    rows = []
    for name, title in NAMES.items():
        if name in tables:
            cells = [cell(1e3 * np.array(tables[name][test][f"{kg:g}"]["mae"]), 1) for kg, test in payloads]
            gaps = cell(100 * np.array(tables[name]["test"][HEAVIEST]["large_gap_ratio"]), 2)
            rows.append([title, *cells, gaps])
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
    return f"no row has more than {shares[most]:.2g} % over all payloads"
