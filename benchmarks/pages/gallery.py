"""docs/gallery.md: what each example asks, prints and shows.

`python -m benchmarks.pages.gallery` runs all examples, a minute each at most, and keeps what they said in
benchmarks/results/gallery.json; `make pages` writes the page and its figures from there.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import floor, log10
from pathlib import Path
from typing import Any

from benchmarks.table import rounded
from trueup.core.atomic import read_json, write_json
from trueup.core.provenance import provenance

ROOT = Path(__file__).resolve().parents[2]
RESULT = ROOT / "benchmarks" / "results" / "gallery.json"
NAME = "gallery.md"
# In the order of the page.
EXAMPLES = (
    "how_large_is_the_gap",
    "what_has_the_model_wrong",
    "correct_in_a_control_loop",
    "train_in_a_corrected_simulator",
    "which_robot_is_different",
    "from_arrays_to_a_dataset",
)
TEXT = """# Gallery

One script for each question, and what it prints on a busy machine. They need
`pip install '.[learn,rl,plan]' 'gymnasium[mujoco]'`.

{sections}
"""
SECTION = """## {question}

{about}

{figure}```text
$ python examples/{name}.py
{printed}
```

<details markdown>
<summary>examples/{name}.py</summary>

```py
--8<-- "examples/{name}.py"
```

</details>
"""
WIDTH, LEFT, ROW, TOP = 460, 190, 26, 40
# Okabe-Ito: told apart without colour vision; the second kind of mark has another form as well.
BLUE, ORANGE = "#0072B2", "#D55E00"
STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#222}.title{font-size:13px;font-weight:600}.name{text-anchor:end}"
    ".tick{text-anchor:middle;font-size:10px}.frame{fill:#fff;stroke:#bbb}.grid{stroke:#e6e6e6}"
    "polyline{fill:none;stroke-width:1.6}"
)


def question(name: str) -> tuple[str, str]:
    """The first line of an example's docstring, which is its question, and the rest without commands."""
    found = ast.get_docstring(ast.parse((ROOT / "examples" / f"{name}.py").read_text()))
    assert found is not None, name
    asks, *paragraphs = found.split("\n\n")
    return asks, "\n\n".join(part for part in paragraphs if not part.startswith("    "))


def pages() -> Mapping[str, str]:
    """The page from what the examples have said, and their figures."""
    result = read_json(RESULT)
    drawn = figures(result)
    sections = []
    for name in EXAMPLES:
        asks, about = question(name)
        file = f"gallery-{name}.svg"
        shown = f"![{result['examples'][name]['figure']['title']}]({file})\n\n" if file in drawn else ""
        printed = result["examples"][name]["printed"]
        sections.append(SECTION.format(question=asks, about=about, figure=shown, name=name, printed=printed))
    page = TEXT.format(sections="\n".join(sections).rstrip())
    return {NAME: page, **drawn}


def figures(result: Mapping[str, Any]) -> dict[str, str]:
    """File in docs/ -> SVG, of the examples that have one."""
    kinds: Mapping[str, Callable[[Mapping[str, Any]], str]] = {"intervals": intervals, "curve": curve}
    return {
        f"gallery-{name}.svg": kinds[own["figure"]["kind"]](own["figure"])
        for name, own in result["examples"].items()
        if own["figure"]
    }


def intervals(figure: Mapping[str, Any]) -> str:
    """A row for each value: its interval as a line, itself as a dot, and where it was before or truly is as a tick."""
    rows: Sequence[Mapping[str, Any]] = figure["rows"]
    last = 1.05 * max(max(row["high"] or 0.0, row["value"], row.get("mark") or 0.0) for row in rows)
    height = ROW * len(rows)
    parts = [*_begin(figure["title"], height), *_axis(last, height, figure["unit"])]
    for number, row in enumerate(rows):
        y = TOP + ROW * (number + 0.5)
        x, low, high = (LEFT + WIDTH * (value or 0.0) / last for value in (row["value"], row["low"], row["high"]))
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" class="name">{row["name"]}</text>')
        if row["high"] is not None:
            parts.append(
                f'<line x1="{low:.1f}" x2="{high:.1f}" y1="{y:.1f}" y2="{y:.1f}" stroke="{BLUE}" stroke-width="2"/>'
            )
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{BLUE}"/>')
        if row.get("mark") is not None:
            at = LEFT + WIDTH * row["mark"] / last
            parts.append(
                f'<path d="M{at:.1f} {y - 8:.1f}l4 8l-4 8l-4-8z" fill="none" stroke="{ORANGE}" stroke-width="2"/>'
            )
    return "\n".join([*parts, *_legend(height, figure["legend"]), "</svg>"]) + "\n"


def curve(figure: Mapping[str, Any]) -> str:
    """One line over time."""
    values, height = figure["values"], 5 * ROW
    high = 1.1 * max(values)
    points = " ".join(
        f"{LEFT + WIDTH * number / (len(values) - 1):.1f},{TOP + height * (1 - value / high):.1f}"
        for number, value in enumerate(values)
    )
    parts = [*_begin(figure["title"], height), *_axis(figure["last_s"], height, "s")]
    for value in _ticks(high):
        y = TOP + height * (1 - value / high)
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" class="name">{value:.3g} {figure["unit"]}</text>')
    parts.append(f'<polyline points="{points}" stroke="{BLUE}"/>')
    return "\n".join([*parts, *_legend(height, figure["legend"]), "</svg>"]) + "\n"


def _begin(title: str, height: float) -> Iterator[str]:
    size = f"{LEFT + WIDTH + 30} {TOP + height + 62:g}"
    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" role="img" aria-label="{title}">'
    yield f'<style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>'
    yield f'<text x="20" y="22" class="title">{title}</text>'
    yield f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH}" height="{height:g}" class="frame"/>'


def _axis(last: float, height: float, unit: str) -> Iterator[str]:
    for value in _ticks(last):
        x = LEFT + WIDTH * value / last
        yield f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{TOP + height:g}" class="grid"/>'
        yield f'<text x="{x:.1f}" y="{TOP + height + 16:g}" class="tick">{value:.3g}</text>'
    yield f'<text x="{LEFT + WIDTH / 2:g}" y="{TOP + height + 32:g}" class="tick">{unit}</text>'


def _ticks(last: float) -> list[float]:
    """Three to six round numbers from zero on."""
    size = 10 ** floor(log10(last / 3))
    step = next(size * factor for factor in (5, 2, 1) if size * factor * 3 <= last * (1 + 1e-9))
    return [step * number for number in range(floor(last / step * (1 + 1e-9)) + 1)]


def _legend(height: float, words: str) -> Iterator[str]:
    yield f'<text x="20" y="{TOP + height + 52:g}">{words}</text>'


def _of_gap(folder: Path) -> dict[str, Any]:
    runs = read_json(folder / "gap.json")["runs"]
    rows = []
    for run in ("command", "mujoco/stock"):
        rmse = runs[run]["splits"]["test"]["position"]["rmse"]
        for joint, own in rmse["per_joint"].items():
            ends = {key: _milli(own[key]) for key in ("value", "low", "high")}
            rows.append({"name": f"{run}, {joint}", **ends})
    return {
        "kind": "intervals",
        "title": "Position RMSE on test, by joint",
        "unit": "mrad",
        "rows": rows,
        "legend": "dot: mean over motions; line: 95 % interval",
    }


def _of_fit(folder: Path) -> dict[str, Any]:
    rows = [
        {
            "name": item["name"],
            "value": item["value"],
            "low": item["interval"][0],
            "high": item["interval"][1],
            "mark": item["nominal"],
        }
        for item in read_json(folder / "fit" / "fit.json")["parameters"]
        if item["name"].startswith("kp[")
    ]
    return {
        "kind": "intervals",
        "title": "Gains of the servos, fitted",
        "unit": "Nm/rad",
        "rows": rows,
        "legend": "dot and line: fitted, 95 % interval; diamond: what the model said",
    }


def _of_fleet(folder: Path) -> dict[str, Any]:
    delays = {
        unit["name"]: unit["parameters"]["delay_s"] for unit in read_json(folder / "fleet" / "fleet.json")["units"]
    }
    return {
        "kind": "intervals",
        "title": "Delay of each arm",
        "unit": "ms",
        "rows": [
            {"name": name, **{key: _milli(own[key]) for key in ("value", "low", "high")}}
            for name, own in delays.items()
        ],
        "legend": "dot and line: fitted, 95 % interval",
    }


def _milli(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


_DRAWN: Mapping[str, tuple[str, Callable[[Path], dict[str, Any]]]] = {
    "how_large_is_the_gap": ("runs/example-gap", _of_gap),
    "what_has_the_model_wrong": ("runs/example-fit", _of_fit),
    "which_robot_is_different": ("runs/example-fleet", _of_fleet),
}
# Its numbers lie in no file.
_CHANGED = """
import json, runpy, sys
found = runpy.run_path(sys.argv[1], run_name="__main__")
json.dump([float(item) for item in found["changed"]], open("changed.json", "w"))
"""


def run(name: str, folder: Path) -> dict[str, Any]:
    """What an example prints and shows, run in an empty folder as it is.

    Raises:
        RuntimeError: it failed.
    """
    path = ROOT / "examples" / f"{name}.py"
    looked_into = name == "correct_in_a_control_loop"
    words = ["-c", _CHANGED, str(path)] if looked_into else [str(path)]
    # Small networks: on a busy machine, threads that wait for one another take most of the time.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{path} failed:\n{done.stderr}")
    figure: dict[str, Any] = {}
    if looked_into:
        values = json.loads((folder / "changed.json").read_text())
        figure = {
            "kind": "curve",
            "title": "What the network changes of the torque",
            "unit": "Nm",
            "values": values,
            "last_s": len(values) / 100,
            "legend": "largest change of any joint, sample by sample; nothing while it warms up",
        }
    elif name in _DRAWN:
        place, draw = _DRAWN[name]
        figure = draw(folder / place)
    return {"printed": done.stdout.strip(), "figure": figure}


def main(names: Sequence[str] = EXAMPLES) -> None:
    """Run the examples, or those that are named, keep what they said, and write the page."""
    kept = read_json(RESULT)["examples"] if RESULT.is_file() else {}
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            kept[name] = rounded(run(name, Path(folder)))
        print(f"{name}: {len(kept[name]['printed'].splitlines())} lines", flush=True)
    made = {key: value for key, value in provenance(config={}, seed=0).items() if key in ("git", "created")}
    write_json(RESULT, {"provenance": made, "examples": {name: kept[name] for name in EXAMPLES if name in kept}})
    if set(kept) >= set(EXAMPLES):
        for file, content in pages().items():
            (ROOT / "docs" / file).write_text(content)


if __name__ == "__main__":
    main(sys.argv[1:] or EXAMPLES)
