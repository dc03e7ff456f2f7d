"""The section "What each part is worth" of docs/what-compensation-brings.md, from `compensation_ablations`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

NAMES = {
    "no sensors": "no sensors: branch reads the history",
    "true sensors": "true sensors, asked of the simulator",
    "payload not read": "trunk without payload",
    "5 sensors": "5 sensors",
    "60 sensors": "60 sensors",
    "no history": "history of 1 sample",
    "history of 9": "history of 9 samples",
}
TEXT = """## What each part is worth

The operator on the stock simulator (20 sensors, history of 5 samples), changed in one part, {seeds} seeds each: change
of the mean error over all payloads on the held-out individual, mean and standard deviation over seeds.

```sh
python -m benchmarks compensation_ablations
```

{changes}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    tables = result["tables"]
    changes = (f"- {title}: {_against(tables, name)} %" for name, title in NAMES.items() if name in tables)
    return TEXT.format(seeds=len(tables["whole"]["test"]["0"]["mae"]), changes="\n".join(changes))


def _against(tables: Mapping[str, Any], name: str) -> str:
    ratios = 100 * (_seeds(tables[name]) / _seeds(tables["whole"]) - 1)
    return f"{ratios.mean():+.1f} ± {ratios.std(ddof=1):.1f}".replace("-", "\N{MINUS SIGN}")


def _seeds(tests: Mapping[str, Any]) -> Float64[np.ndarray, "S"]:
    """Mean over payloads and motions, of each seed."""
    means = [np.mean(own["mae"], axis=1) for test in tests.values() for own in test.values()]
    return np.asarray(np.mean(means, axis=0), np.float64)
