"""Draw docs/before_after.svg, the picture of the README: measured against simulated, before and after a fit.

    python scripts/readme_figure.py

Before: the demo arm's model as it is. After: what `trueup identify`, without any configuration, makes of it. Takes a
minute or two.
"""

import tempfile
from pathlib import Path

import numpy as np

import trueup
from trueup.dataset import Dataset

ROOT = Path(__file__).resolve().parent.parent
EPISODE, JOINT = "multisine_wide", 1  # of test: the fit has not seen it
WIDTH, LEFT, GAP, TOP = 420, 52, 62, 34
# Okabe-Ito: told apart without colour vision; the simulation is dashed as well.
COLORS = {"measured": "#000000", "simulated": "#D55E00", "residual": "#0072B2"}


def panel(title: str, time_s: np.ndarray, measured: np.ndarray, simulated: np.ndarray, x0: int) -> list[str]:
    """One axes pair: the motions above, the residual below, in degrees."""
    residual = measured - simulated
    rmse = np.sqrt(np.mean(residual**2))
    parts = [f'<text x="{x0}" y="20" class="title">{title}: RMSE {rmse:.2f}°</text>']
    for label, curves, top, height, low, high in (
        ("position [°]", {"measured": measured, "simulated": simulated}, TOP, 120, -60.0, 0.0),
        ("residual [°]", {"residual": residual}, TOP + 135, 45, -6.0, 6.0),
    ):
        parts.append(f'<rect x="{x0}" y="{top}" width="{WIDTH}" height="{height}" class="frame"/>')
        parts.append(
            f'<text transform="translate({x0 - 36},{top + height / 2}) rotate(-90)" class="label">{label}</text>'
        )
        for tick in (low, (low + high) / 2, high):
            y = top + height * (high - tick) / (high - low)
            parts.append(f'<text x="{x0 - 5}" y="{y + 4:.1f}" class="tick">{tick:g}</text>')
        for name, values in curves.items():
            x = x0 + WIDTH * (time_s - time_s[0]) / (time_s[-1] - time_s[0])
            y = top + height * (high - values) / (high - low)
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
            dash = ' stroke-dasharray="5 3"' if name == "simulated" else ""
            parts.append(f'<polyline points="{points}" stroke="{COLORS[name]}"{dash}/>')
    return parts


def picture(data: Dataset) -> str:
    """The SVG of a dataset with the runs `mujoco/stock` and `mujoco/fitted`."""
    runs = ("mujoco/stock", "mujoco/fitted")
    episode = data.episode(EPISODE, runs=runs)
    rows = slice(100, 700, 2)
    series = (episode.measured, *(episode.run(label) for label in runs))
    motion = [np.degrees(item["position"][rows, JOINT]) for item in series]
    time_s = episode.measured.time_s[rows]
    total = LEFT + 2 * WIDTH + GAP + 25
    style = (
        "text{font:12px system-ui,sans-serif;fill:#222}.title{font-size:14px;font-weight:600}"
        ".tick{text-anchor:end;font-size:10px}.label{text-anchor:middle;font-size:11px}"
        ".frame{fill:#fff;stroke:#bbb}polyline{fill:none;stroke-width:1.6}"
    )
    about = "Measured and simulated shoulder angle before and after trueup identify"
    legend = "black: measured &#160; orange, dashed: simulated &#160; blue: residual"
    what = "shoulder of the built-in demo arm, 6 s of a test motion"
    svg = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total} {TOP + 210}" role="img" aria-label="{about}">',
        f'<style>{style}</style><rect width="100%" height="100%" fill="#fff"/>',
        *panel("before (stock model)", time_s, motion[0], motion[1], LEFT),
        *panel("after trueup identify", time_s, motion[0], motion[2], LEFT + WIDTH + GAP),
        f'<text x="{LEFT}" y="{TOP + 202}">{legend}; {what}</text></svg>',
    ]
    return "\n".join(svg) + "\n"


def main() -> None:
    """Record the demo arm, identify it and write the picture."""
    with tempfile.TemporaryDirectory() as folder:
        data = Dataset(trueup.demo_dataset(Path(folder) / "data"))
        trueup.fit(data, trueup.load_robot("demo_arm"), Path(folder) / "fit", seed=0)
        (ROOT / "docs" / "before_after.svg").write_text(picture(data))


if __name__ == "__main__":
    main()
