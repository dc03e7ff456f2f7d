"""A part of docs/whole-body.md, from what `python -m benchmarks whole_body` has measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.augment_cells import MARKS
from benchmarks.pages.markdown import table

REFERENCES = {"follows": "The simulated arms follow", "empty": "The simulated arms hang as with empty hands"}
# Metric -> head, factor.
MAIN = {
    "drift_mean": ("drift, mean [cm]", 100.0),
    "drift_end": ("drift, end [cm]", 100.0),
    "tilt_rms": ("tilt, RMS [deg]", 1.0),
    "tilt_max": ("tilt, largest [deg]", 1.0),
    "arms_mae": ("arms [mrad]", 1000.0),
}
TABLE_2 = {"trajectory_consistency": "consistency", "smoothness": "smoothness"}
PARTS = {"arms": "arms [rad]", "base": "base [m]", "tilt": "tilt [rad]"}

TEXT = """## What a payload does

{motions} motions of {seconds:g} s, each on {bodies} individuals that nothing was designed on, with a payload in each
hand: {names}.

```sh
python -m benchmarks whole_body
```

Means with 95 % intervals over whole motions, individuals averaged. `~`: the paired interval of the difference to
plain PD holds zero; **worse**: it lies above.

{sections}

### Table 2's three figures

Trajectory consistency and smoothness, both differences of accelerations, per second squared; means over motions. The
third, robustness, is the noise that it adds, and says nothing of a body ([why](metrics.md)): it is {robustness}
everywhere, in rad and in m.

{table_2}
"""


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    return TEXT.format(
        motions=len(result["motions"]),
        seconds=result["seconds"],
        names=", ".join(result["motions"]),
        bodies=len(result["bodies"]),
        sections="\n\n".join(_section(result, reference) for reference in REFERENCES),
        table_2=table_2(result),
        robustness=_robustness(result),
    )


def main_table(result: Mapping[str, Any], reference: str) -> str:
    """One row per payload and way of commanding the arms."""
    rows = []
    for payload, ways in result["payloads"].items():
        for name, own in _of(result, ways, reference).items():
            cells = [_cell(own, metric, factor) for metric, (_, factor) in MAIN.items()]
            rows.append([payload, _short(name), *cells, f"{own['falls']}"])
    return table(["kg", "", *(head for head, _ in MAIN.values()), "falls"], rows, left=2)


def difference_table(result: Mapping[str, Any], reference: str) -> str:
    """What each way changes against plain PD; empty where there is none."""
    rows = []
    for payload, ways in result["payloads"].items():
        for name, own in _of(result, ways, reference).items():
            if own["differences"]:
                found = [
                    _interval(own["differences"][metric]["difference"], factor, sign=True)
                    for metric, (_, factor) in MAIN.items()
                ]
                rows.append([payload, _short(name), *found])
    return table(["kg", "", *(head for head, _ in MAIN.values())], rows, left=2) if rows else ""


def table_2(result: Mapping[str, Any]) -> str:
    """The two figures that depend on the body, of each part."""
    heads = ["kg", "", *(f"{short}, {part_name}" for part_name in PARTS.values() for short in TABLE_2.values())]
    rows = []
    for payload, ways in result["payloads"].items():
        for name, own in ways.items():
            cells = []
            for part_name in PARTS:
                for metric in TABLE_2:
                    key = f"{part_name}_{metric}"
                    found = own["differences"].get(key)
                    mark = MARKS[found["verdict"]] if found else ""
                    cells.append(f"{_text(own['figures'][key]['value'])}{mark}")
            rows.append([payload, name, *cells])
    return table(heads, rows, left=2)


def _robustness(result: Mapping[str, Any]) -> str:
    found = {
        _text(own["figures"][f"{part_name}_robustness"]["value"])
        for ways in result["payloads"].values()
        for own in ways.values()
        for part_name in PARTS
    }
    return " to ".join(sorted(found))


def _section(result: Mapping[str, Any], reference: str) -> str:
    pieces = [f"### {REFERENCES[reference]}", main_table(result, reference)]
    if differences := difference_table(result, reference):
        pieces += ["Difference to plain PD:", differences]
    return "\n\n".join(pieces)


def _of(result: Mapping[str, Any], ways: Mapping[str, Any], reference: str) -> dict[str, Any]:
    return {name: own for name, own in ways.items() if result["references"][name] == reference}


def _short(name: str) -> str:
    return name.split(",", maxsplit=1)[0]


def _cell(own: Mapping[str, Any], metric: str, factor: float) -> str:
    mark = MARKS[own["differences"][metric]["verdict"]] if own["differences"] else ""
    return f"{_interval(own['figures'][metric], factor)}{mark}"


def _interval(item: Mapping[str, Any], factor: float, *, sign: bool = False) -> str:
    values: Sequence[float | None] = [item[key] for key in ("value", "low", "high")]
    if any(value is None for value in values):
        return "-"
    texts = [format(factor * value, "+.2f" if sign else ".2f") for value in values if value is not None]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]".replace("-", "\N{MINUS SIGN}")


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
