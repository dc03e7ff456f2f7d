"""A part of docs/whole-body.md, from what `python -m benchmarks whole_body` has measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.augment_cells import MARKS, span
from benchmarks.pages.markdown import table

REFERENCES = {"follows": "The simulated arms follow", "empty": "The simulated arms hang as with empty hands"}
# Metric -> head, factor.
MAIN = {
    "drift_mean": ("drift, mean [cm]", 100.0),
    "drift_end": ("drift, end [cm]", 100.0),
    "tilt_rms": ("tilt, RMS [deg]", 1.0),
    "arms_mae": ("arms [mrad]", 1000.0),
}
BODY_PARTS = ("arms", "base", "tilt")
# Payloads of the tables [kg].
SHOWN = ("0", "2", "3")

TEXT = """## What a payload does

{motions} motions of {seconds:g} s on {bodies} individuals, with a payload in each hand. Means with 95 % intervals over
motions, marked where the paired difference to plain PD may be zero (`~`) or is above it (**worse**). {falls}

```sh
python -m benchmarks whole_body
```

{sections}

### Roughness

[Smoothness](metrics.md) (smaller is smoother) as a multiple of that of plain PD, over all payloads.

{roughness}
"""


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    return TEXT.format(
        motions=len(result["motions"]),
        seconds=result["seconds"],
        bodies=len(result["bodies"]),
        falls=_falls(result),
        sections="\n\n".join(_section(result, reference) for reference in REFERENCES),
        roughness=roughness_table(result),
    )


def main_table(result: Mapping[str, Any], reference: str) -> str:
    """One row per payload and way of commanding the arms."""
    rows = []
    for payload in SHOWN:
        for name, own in _of(result, result["payloads"][payload], reference).items():
            cells = [_cell(own, metric, factor) for metric, (_, factor) in MAIN.items()]
            rows.append([payload, _short(name), *cells])
    return table(["kg", "", *(head for head, _ in MAIN.values())], rows, left=2)


def roughness_table(result: Mapping[str, Any]) -> str:
    """How many times rougher than plain PD each way is, from payload to payload."""
    rows = []
    for name, reference in result["references"].items():
        plain = f"plain PD, {reference}"
        if name != plain:
            ratios = (_ratios(result, name, plain, f"{body_part}_smoothness") for body_part in BODY_PARTS)
            rows.append([_short(name), *map(span, ratios)])
    return table(["", *BODY_PARTS], rows)


def _ratios(result: Mapping[str, Any], name: str, plain: str, key: str) -> list[float]:
    return [
        ways[name]["figures"][key]["value"] / ways[plain]["figures"][key]["value"]
        for ways in result["payloads"].values()
    ]


def _falls(result: Mapping[str, Any]) -> str:
    falls = sum(own["falls"] for ways in result["payloads"].values() for own in ways.values())
    return "No body fell." if not falls else f"Bodies fell {falls} times, and have no figures then."


def _section(result: Mapping[str, Any], reference: str) -> str:
    return f"### {REFERENCES[reference]}\n\n{main_table(result, reference)}"


def _of(result: Mapping[str, Any], ways: Mapping[str, Any], reference: str) -> dict[str, Any]:
    return {name: own for name, own in ways.items() if result["references"][name] == reference}


def _short(name: str) -> str:
    return name.split(",", maxsplit=1)[0]


def _cell(own: Mapping[str, Any], metric: str, factor: float) -> str:
    mark = MARKS[own["differences"][metric]["verdict"]] if own["differences"] else ""
    return f"{_interval(own['figures'][metric], factor)}{mark}"


def _interval(item: Mapping[str, Any], factor: float) -> str:
    values: Sequence[float | None] = [item[key] for key in ("value", "low", "high")]
    if any(value is None for value in values):
        return "-"
    texts = [f"{factor * value:.2f}" for value in values if value is not None]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]"
