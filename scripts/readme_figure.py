"""Draw docs/before_after.svg, the picture of the README: measured against simulated, before and after.

    python scripts/readme_figure.py

Before: the demo arm's model as it is. After: the same model with the hardware's gains, friction and delay typed in.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from trueup.lab import DemoHardware, record_demo
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode

ROOT = Path(__file__).resolve().parent.parent
EPISODE, JOINT = "multisine_wide", 1
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


def main() -> None:
    """Simulate both and write the picture."""
    robot = load_robot("demo_arm")
    episode = next(item for item in record_demo() if item.id == EPISODE)
    hardware = DemoHardware()
    stock = MujocoSimulator.from_robot(robot, find_model(robot))
    tuned = hardware.simulator(robot, payload_kg=0.0)
    settings = ReplaySettings.of(robot)
    before = replay_episode(episode, stock, settings)
    after = replay_episode(episode, tuned, replace(settings, delay_s=hardware.delay_s))
    rows = slice(100, 700, 2)
    motion = [np.degrees(series["position"][rows, JOINT]) for series in (episode.measured, before, after)]
    time_s = episode.measured.time_s[rows]
    total = LEFT + 2 * WIDTH + GAP + 25
    style = (
        "text{font:12px system-ui,sans-serif;fill:#222}.title{font-size:14px;font-weight:600}"
        ".tick{text-anchor:end;font-size:10px}.label{text-anchor:middle;font-size:11px}"
        ".frame{fill:#fff;stroke:#bbb}polyline{fill:none;stroke-width:1.6}"
    )
    about = "Measured and simulated shoulder angle before and after the model was corrected"
    legend = (
        "black: measured &#160; orange, dashed: simulated &#160; blue: residual; shoulder of the built-in demo arm, 6 s"
    )
    svg = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total} {TOP + 210}" role="img" aria-label="{about}">',
        f'<style>{style}</style><rect width="100%" height="100%" fill="#fff"/>',
        *panel("before (stock model)", time_s, motion[0], motion[1], LEFT),
        *panel("after (gains, friction, delay corrected)", time_s, motion[0], motion[2], LEFT + WIDTH + GAP),
        f'<text x="{LEFT}" y="{TOP + 202}">{legend}</text></svg>',
    ]
    (ROOT / "docs" / "before_after.svg").write_text("\n".join(svg) + "\n")


if __name__ == "__main__":
    main()
