"""What a SAT owes to its training: to its seed, to its loss (SAT, Fig. 12), and to being taught on its own predictions.

Records and trains what is missing under runs/sat (an hour on one core beside the data of `benchmarks.sat`) and writes
`benchmarks/results/sat_training.json`, from which a part of docs/building-blocks.md is made.

    python -m benchmarks sat_training
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.torch import load_file

from benchmarks.pages.sat import BARS, UNSEEN
from benchmarks.sat import apart, cuts_of, errors_of
from benchmarks.sat_models import FOLDER, LONG, MODELS, RUN, TESTS, data_of, folder_of, train
from benchmarks.table import Row, at_least, at_most, rounded, shown
from trueup.augment import Augmentation, AugmentConfig, Progress
from trueup.augment.config import LossConfig
from trueup.augment.trained import Trained
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance
from trueup.measure import bootstrap_interval
from trueup.stages import augment

RESULT = Path(__file__).parent / "results" / "sat_training.json"
SAT = MODELS["sat"]
SEEDS = (0, 1, 2)
# The objectives of Fig. 12, on fewer motions and for more epochs than `sat`.
LOSSES: Mapping[str, AugmentConfig] = {
    name: replace(SAT, network=replace(SAT.network, says=says), loss=loss, epochs=6)  # type: ignore[call-arg]
    for name, says, loss in (
        ("quantile", (0.1, 0.5, 0.9), LossConfig(kind="quantile")),
        ("L1", (), LossConfig(kind="absolute")),
        ("PL1", (), SAT.loss),
    )
}
LOSS_MOTIONS = 12
WATCHED = "kickbot_a"
# What the encoder is told of past errors, in small networks: nothing; true ones, then more and more of its own
# predictions.
_SMALL = replace(SAT, network=replace(SAT.network, hidden=(16,), history=32), epochs=4)  # type: ignore[call-arg]
_OWN = replace(_SMALL, network=replace(_SMALL.network, feedback="own", forced=0.5))  # type: ignore[call-arg]
FEEDBACK: Mapping[str, AugmentConfig] = {
    "zero": _SMALL,
    "switched": _OWN,
}
FEEDBACK_MOTIONS = 10
LONG_S, PIECE_S = 30.0, 5.0


def run() -> list[Row]:
    """Train what is missing, evaluate, write the result file."""
    seeds = {str(seed): _seed(seed) for seed in SEEDS}
    losses = {name: _epochs(name) for name in LOSSES}
    long = {"simulator": _pieces(None), "sat": _pieces(folder_of("sat"))}
    long |= {name: _pieces(_trained(f"told-{name}", own, FEEDBACK_MOTIONS)) for name, own in FEEDBACK.items()}
    result = {
        "schema": "trueup.sat_training/1",
        "seeds": seeds,
        "losses": losses,
        "loss_motions": LOSS_MOTIONS,
        "watched": WATCHED,
        "long": long,
        "long_motions": FEEDBACK_MOTIONS,
        "long_s": LONG_S,
        "piece_s": PIECE_S,
        "provenance": provenance(
            config={name: config.to_json() for name, config in {**LOSSES, **FEEDBACK}.items()},
            seed=0,
            data_hash=data_of("train").hash,
        ),
    }
    make_folder(RESULT.parent)
    write_json(RESULT, rounded(result))
    return rows(result)


def _seed(seed: int) -> dict[str, Any]:
    """Test -> position metric -> share of the simulator's error that a training with this seed takes away."""
    folder = train("sat", seed=seed)
    found = {}
    for test in TESTS:
        errors = errors_of(data_of(test), {"sat": folder})
        found[test] = cuts_of(errors["simulator"], errors["sat"])["position"]
    return found


def _trained(name: str, config: AugmentConfig, motions: int, kept: Path | None = None) -> Path:
    """The folder of a network that is trained if it is not there; `kept` gets its weights after each epoch."""
    folder = folder_of(name)

    def keep(progress: Progress) -> None:
        if kept is not None and progress.epoch is not None:
            make_folder(kept)
            shutil.copyfile(folder / "checkpoint.safetensors", kept / f"{progress.number}.safetensors")

    data = [data_of("train")]
    augment(
        data, folder, run=RUN, config=config, name=name, train_motions=motions, jobs=1, resume=True, on_progress=keep
    )
    return folder


def _epochs(name: str) -> list[dict[str, float]]:
    """After each epoch, the mean errors on animations that nobody trained on: position [deg], velocity [rad/s]."""
    kept = FOLDER / "models" / f"{name}-epochs"
    made = Augmentation.load(_trained(f"loss-{name}", LOSSES[name], LOSS_MOTIONS, kept))
    made.corrector.gate.fill_(1.0)  # all that it says, whether it helps or not
    found = []
    for number in range(1, LOSSES[name].epochs + 1):
        state = load_file(kept / f"{number}.safetensors")
        network = {key.removeprefix("network."): own for key, own in state.items() if key.startswith("network.")}
        made.corrector.network.load_state_dict(network)
        errors: dict[str, list[float]] = {"position": [], "velocity": []}
        for episode in data_of(WATCHED).episodes(runs=[RUN]):
            said = made.predict(episode, RUN)
            for signal, own in errors.items():
                own.append(float(np.abs(apart(episode.measured, said, signal)[0]).mean()))
        position, velocity = (float(np.mean(own)) for own in errors.values())
        found.append({"position": float(np.degrees(position)), "velocity": velocity})
    return found


def _pieces(folder: Path | None) -> dict[str, Any]:
    """Mean absolute error of the position in each piece of long motions, mean over joints and motions [deg]."""
    model = None if folder is None else Trained.load(folder)
    rows = []
    for episode in data_of(LONG).episodes(runs=[RUN]):
        simulated = episode.run(RUN)
        said = simulated if model is None else model.predict(episode, RUN)
        error = np.degrees(np.abs(apart(episode.measured, said, "position")[0]))
        count = round(PIECE_S * simulated.rate_hz)
        pieces = error[: round(LONG_S * simulated.rate_hz)]
        rows.append([pieces[start : start + count].mean() for start in range(0, len(pieces) - count // 2, count)])
    values = np.array(rows)
    low, high = bootstrap_interval(values)
    return {"value": values.mean(axis=0).tolist(), "low": low.tolist(), "high": high.tolist(), "motions": len(rows)}


def rows(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for test in UNSEEN:
        for metric, bar in BARS.items():
            least = min(own[test][metric]["value"] for own in result["seeds"].values())
            rows.append(at_least(f"{test}: position {metric}, least of {len(SEEDS)} seeds", least, bar, ""))
    for name, own in result["losses"].items():
        rows.append(shown(f"{name}: position MAE after the last epoch", own[-1]["position"], "deg"))
    long = result["long"]
    for name in FEEDBACK:
        own = np.array(long[name]["value"]) / np.array(long["simulator"]["value"])
        rows.append(shown(f"{name}: last 5 s of 30 s over the first", own[-1] / own[0], "x"))
    kept = np.array(long["switched"]["value"]) / np.array(long["simulator"]["value"])
    rows.append(at_most("switched: share of the simulator's error left in the last 5 s of 30 s", kept[-1], 1.0, ""))
    return rows
