"""`trueup doctor`."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from importlib import metadata, util
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import answer, out
from trueup.errors import ConfigError

# Extra -> (what it is for, the modules that it brings: distribution name, import name).
EXTRAS = {
    "dynamics": ("inverse dynamics in identification", [("pin", "pinocchio")]),
    "dart": ("a second physics engine", [("dartpy", "dartpy")]),
    "run": ("trained networks beside a robot", [("onnxruntime", "onnxruntime")]),
    "learn": ("training and export of networks", [("torch", "torch"), ("onnx", "onnx"), ("onnxruntime", "onnxruntime"),
                                                   ("safetensors", "safetensors")]),
    "tensorboard": ("curves of trainings in a browser", [("tensorboard", "tensorboard")]),
    "rl": ("policies", [("gymnasium", "gymnasium"), ("stable-baselines3", "stable_baselines3"),
                        ("sb3-contrib", "sb3_contrib"), ("optuna", "optuna")]),
    "plan": ("planning and recording", [("mink", "mink"), ("daqp", "daqp"), ("ompl", "ompl"), ("toppra", "toppra")]),
    "ros2": ("live bridge", [("cyclonedds", "cyclonedds")]),
    "warp": ("MuJoCo on a GPU", [("mujoco-warp", "mujoco_warp"), ("warp-lang", "warp")]),
    "ray": ("work on many machines", [("ray", "ray")]),
    "excel": ("logs in workbooks", [("openpyxl", "openpyxl")]),
    "report-test": ("browser tests", [("selenium", "selenium")]),
}  # fmt: skip
_BASE = ("numpy", "scipy", "pyarrow", "h5py", "rosbags", "mujoco", "pyyaml", "typer", "rich", "jinja2", "plotly")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("doctor")(doctor)


def doctor(
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Also whether this machine can run a loop in time, and how well it does.")
    ] = False,
    hz: Annotated[
        float | None, typer.Option("--hz", min=1.0, help="With --realtime: rate of the loop; 1000 if not given.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.1, help="With --realtime: how long; 5 if not given.")
    ] = None,
    priority: options.Priority = None,
    cpu: options.Cpu = None,
) -> int:
    """Show what is installed, and how to get what is missing.

    Versions, extras, threads and GPU.
    """
    if realtime:
        return _realtime(1000.0 if hz is None else hz, 5.0 if seconds is None else seconds, priority, cpu)
    of_the_loop = {"--hz": hz, "--seconds": seconds, "--priority": priority, "--cpu": cpu}
    if given := [name for name, value in of_the_loop.items() if value is not None]:
        raise ConfigError(f"{', '.join(given)}: of the loop that --realtime runs", hint="Give --realtime, too.")
    out.print(f"trueup {metadata.version('trueup')}, Python {platform.python_version()}, {platform.platform()}")
    out.print(f"threads: {os.cpu_count()}")
    out.print(f"GPU: {_gpu()}")
    for name in ("chromium", "chromedriver"):
        out.print(
            f"{name}: {shutil.which(name) or 'not found (browser tests: apt-get install chromium chromium-driver)'}"
        )
    table = Table()
    for heading in ("extra", "for", "installed", "to get it, in the checkout"):
        table.add_column(heading, overflow="fold")
    missing = [name for name in _BASE if _version(name) is None]
    out.print("base: " + ", ".join(f"{name} {_version(name)}" for name in _BASE if name not in missing))
    extras: dict[str, dict[str, object]] = {}
    for extra, (purpose, modules) in EXTRAS.items():
        there = {name: _version(name) for name, module in modules if util.find_spec(module)}
        complete = len(there) == len(modules)
        extras[extra] = {"installed": there, "complete": complete}
        shown = ", ".join(f"{name} {version}" for name, version in there.items()) or "-"
        table.add_row(extra, purpose, shown, "" if complete else escape(f"pip install '.[{extra}]'"))
    answer(
        {
            "trueup": metadata.version("trueup"),
            "python": platform.python_version(),
            "platform": platform.platform(),
            "threads": os.cpu_count(),
            "gpu": _gpu(),
            "missing": missing,
            "extras": extras,
        }
    )
    out.print(table)
    if missing:
        out.print(f"missing from the base installation: {', '.join(missing)}")
    return 2 if missing else 0


def _realtime(hz: float, seconds: float, priority: int | None, cpu: list[int] | None) -> int:
    """What the machine has, and how late a loop that does nothing is woken."""
    from trueup.deploy import run_loop
    from trueup.deploy.realtime import RealTimeSettings, host_checks

    table = Table(title="this machine")
    for heading in ("", "found", "", "what to do"):
        table.add_column(heading, overflow="fold")
    for check in host_checks():
        mark = {True: "[green]ok[/]", False: "[red]no[/]", None: "?"}[check.good]
        table.add_row(check.what, escape(check.found), mark, "" if check.good else escape(check.hint))
    out.print(table)
    asked = RealTimeSettings(priority, None if cpu is None else tuple(cpu), lock_memory=priority is not None)
    asked.apply()
    how = "ordinary scheduling" if priority is None else f"SCHED_FIFO {priority}, memory locked"
    where = "" if cpu is None else f", on core {', '.join(map(str, cpu))}"
    report = run_loop(lambda _: None, rate_hz=hz, duration_s=seconds)
    late = report.wakeup
    shown = ", ".join(f"{share:g} % within {late.percentile_us(share):.0f} us" for share in (50.0, 99.0, 99.9))
    out.print(f"a loop of {hz:g} Hz for {seconds:g} s ({how}{where}): woken late by: {shown}, all {late.max_us:.0f}")
    answer(
        {
            "checks": [{"what": own.what, "found": own.found, "good": own.good} for own in host_checks()],
            "woken_late_us": {f"{share:g} %": late.percentile_us(share) for share in (50.0, 99.0, 99.9)},
            "longest_us": late.max_us,
            "cycles": report.cycles,
            "overruns": report.overruns,
            "skipped": report.skipped,
        }
    )
    missed = f"{report.overruns} of {report.cycles + report.skipped} cycles missed, {report.skipped} left out"
    out.print(f"period {1e6 / hz:.0f} us: {missed if report.overruns else 'no cycle missed'}")
    return 0 if report.overruns == 0 else 3


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _gpu() -> str:
    """What the NVIDIA driver says; torch is not loaded for this."""
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return "none found (everything here runs on the CPU)"
    try:
        done = subprocess.run(
            [tool, "--query-gpu=name,memory.total", "--format=csv,noheader"],
            capture_output=True, text=True, timeout=10, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError) as error:
        return f"nvidia-smi failed: {error}"
    return done.stdout.strip().replace("\n", "; ") or "none found"
