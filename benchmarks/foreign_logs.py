"""Eighty logs as other programs write them: tries until they are imported, and whether their numbers are those written.

One motion of a UR5e (`foreign_robots`, plain MuJoCo) is written by the libraries that people log with: pandas, polars,
pyarrow, openpyxl, XlsxWriter, scipy, h5py, hdf5storage, PyTables, mcap and rosbags. The importers were changed
until most of these were read, so that the share says nothing of other logs. Of two sets that others wrote without
knowing the importers, 60 and 40 logs of as many kinds, 6 and 19 were read at the first try before the importers were
changed for those, too (30 November 2026). The first try is what a newcomer does:
`trueup init MODEL LOG --yes`, and the import through what that wrote. A second try may give options that the message
or the notes of the first name. What was imported is compared with the arrays that the writer was given.

    python -m pip install pandas polars fastparquet XlsxWriter hdf5storage tables mcap-ros2-support zstandard
    python -m benchmarks foreign_logs
"""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.foreign import BY_NAME
from benchmarks.foreign_bags import BAGS
from benchmarks.foreign_tables import TABLES
from benchmarks.foreign_truth import make
from benchmarks.recorded import Kind, Recorded
from benchmarks.table import Row, at_least, at_most, shown
from trueup.align import JointMap
from trueup.core.atomic import write_json
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import TrueupError
from trueup.stages import draft, plan_import

RESULT = Path(__file__).parent / "results" / "foreign_logs.json"
ROBOT = "ur5e"
KINDS: Mapping[str, Kind] = {**TABLES, **BAGS}
_TRIES = 2


def recorded(folder: Path) -> tuple[Path, Recorded]:
    """Model and motion that every log is of."""
    case = BY_NAME[ROBOT]
    make(replace(case, motions=1), 0, folder)
    with np.load(next((folder / "logs").glob("*.npz"))) as file:
        time_s, done = file["measured.time_s"], file["measured.position"]
        told_s, told = file["command.time_s"], file["command.position"]
    rows = np.maximum(np.searchsorted(told_s, time_s + 1e-9, side="right") - 1, 0)
    return folder / "model.xml", Recorded(case.joints, time_s - time_s[0], done, told[rows])


def tried(kind: Kind, model: Path, logs: Path, truth: Recorded, folder: Path) -> dict[str, Any]:
    """How many tries an import took, what the messages were, and what is wrong with the numbers."""
    said: list[str] = []
    for number in range(_TRIES):
        if number and not (kind.second and kind.named_in(" ".join(said))):
            break
        options = kind.second if number else {}
        out = folder / f"{number}"
        try:
            first = ImportOptions(**{name: value for name, value in options.items() if name != "mapping"})
            if "mapping" in options:
                own = folder / "own.yaml"
                own.write_text(options["mapping"])
                first = replace(first, mapping=own)
            found = draft(model, logs, out=out, options=first, ask=lambda _: True)
            mapping = first.mapping or (out / "mapping.yaml" if (out / "mapping.yaml").exists() else None)
            plan = plan_import(logs, options=replace(first, mapping=mapping))
            episodes = [source.load() for source in plan.episodes]
        except TrueupError as error:
            said.append(str(error).replace(f"{folder}/", ""))
            continue
        said += [*found.unsure, *plan.notes]
        read = [JointMap.from_dict(found.robot.joint_rules()).of_episode(episode) for episode in episodes]
        wrong = _wrong_of(kind, truth, [(one.measured, one.command) for one in read])
        if not wrong or not kind.second:
            return {"tries": number + 1, "wrong": wrong, "said": said}
    return {"tries": None, "wrong": "", "said": said}


def _wrong_of(kind: Kind, truth: Recorded, episodes: Sequence[tuple[TimeSeries, TimeSeries | None]]) -> str:
    """What is wrong with what was read; empty if nothing is."""
    if len(episodes) != kind.motions:
        return f"{len(episodes)} motions for {kind.motions}"
    for number, (measured, command) in enumerate(episodes):
        rows = kind.rows(truth, number)
        for side, series, want in (("measured", measured, truth.done[rows]), ("command", command, truth.told[rows])):
            if side == "command" and not kind.told:
                continue
            if series is None or "position" not in series or tuple(series.joints) != truth.joints:
                return f"{side}: {'not read' if series is None else series.joints}"
            every = kind.told_every if side == "command" else 1
            want, at_s = want[::every], truth.time_s[rows][::every]
            if abs(len(series.time_s) - len(want)) > kind.lost:
                return f"{side}: {len(series.time_s)} samples for {len(want)}"
            count = min(len(series.time_s), len(want))
            away = float(np.abs(series["position"][:count] - want[:count]).max())
            if not away <= kind.precision:
                return f"{side}: {away:.2g} rad away"
            own_s = series.time_s[:count] - series.time_s[0]
            if not np.abs(own_s - (at_s[:count] - at_s[0])).max() <= kind.precision_s:
                return f"{side}: stamps are {np.abs(own_s - (at_s[:count] - at_s[0])).max():.2g} s away"
    return ""


def measured(only: str) -> dict[str, Any]:
    """Each log whose name holds a text."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as place:
        model, truth = recorded(Path(place) / "robot")
        for number, (name, kind) in enumerate(KINDS.items()):
            if only not in name:
                continue
            folder = Path(place) / f"{number}"
            (folder / "logs").mkdir(parents=True)
            kind.write(folder / "logs", truth)
            item = found[name] = tried(kind, model, folder / "logs", truth, folder)
            print(f"{name}: {item['tries'] or 'not imported'} {item['wrong']}", flush=True)
            if item["wrong"] or item["tries"] != 1:
                print(*(f"    {line}" for line in item["said"]), sep="\n", flush=True)
    return found


def rows(result: Mapping[str, Any]) -> list[Row]:
    """Figures of what is kept."""
    logs = result["logs"].values()
    soon = 100 * sum(map(_soon, logs)) / len(logs)
    return [
        at_least(f"{len(logs)} foreign logs: imported at the first or second try", soon, 90.0, "%"),
        shown("foreign logs: imported at the first try", 100 * sum(_first(item) for item in logs) / len(logs), "%"),
        at_most("foreign logs: imported without a word, with other numbers", sum(map(_bad, logs)), 0.0, ""),
    ]


def _first(item: Mapping[str, Any]) -> bool:
    return item["tries"] == 1 and not item["wrong"]


def _soon(item: Mapping[str, Any]) -> bool:
    return item["tries"] is not None and not item["wrong"]


def _bad(item: Mapping[str, Any]) -> bool:
    return item["tries"] is not None and bool(item["wrong"])


def run() -> list[Row]:
    """Measure all, and keep it."""
    result = {"schema": "trueup.foreign_logs/1", "logs": measured(""), "provenance": provenance(config={}, seed=0)}
    write_json(RESULT, result)
    return rows(result)


def run_with(arguments: Sequence[str]) -> list[Row]:
    """Measure some, and keep nothing."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks foreign_logs")
    parser.add_argument("--only", default="", metavar="TEXT", help="logs whose name holds it")
    measured(parser.parse_args(arguments).only)
    return []
