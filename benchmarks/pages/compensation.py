"""The section "In a simulator" of docs/what-compensation-brings.md, from `python -m benchmarks compensation`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

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

At the paper's threshold of {paper_tau:g} rad nobody has large gaps to speak of: {paper}.
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
    )


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
    shares: Sequence[tuple[str, float]] = [
        (name, 100 * float(np.mean([own["test"][kg]["large_gap_ratio_paper"] for kg in own["test"]])))
        for name, own in tables.items()
    ]
    return ", ".join(f"{NAMES[name]} {share:.3g} %" for name, share in shares if name in NAMES)
