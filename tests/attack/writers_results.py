"""Writers of results, models, plans and fits, to be killed; what they leave is the old, the new, or refused."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from attack.harness import Writer
from attack.parsers_fits import _plans
from attack.parsers_models import _trained, make_corrected, read_corrected
from attack.parsers_results import TIMES, make_report
from augment.augment_cases import RUN, make_dataset
from identify.recovery_cases import SERVO, Truth, arm, nominal_of
from stages.test_identifying import CONFIG, logs_of, stored
from stages.test_recording import IDS as RECORDED
from stages.test_recording import contents, recorded
from trueup.augment import Augmentation
from trueup.augment.config import AugmentConfig, NetworkConfig, WindowConfig
from trueup.core.fit_result import FitResult
from trueup.core.model_card import CARD_NAME, ModelCard
from trueup.core.results import GapResult, Ladder
from trueup.core.step_times import StepTimes
from trueup.core.traces import TraceSet
from trueup.dataset import Dataset
from trueup.deploy import Predictor
from trueup.errors import DataError, TrueupError
from trueup.record import PlanSet, store_plans
from trueup.report import write_report
from trueup.stages import augment
from trueup.stages.identifying import fit

ROUNDS = 6
PLANS = [f"motion/{number:05d}" for number in range(40)]
TRAINING = AugmentConfig(
    network=NetworkConfig("lstm", (4, 3)), window=WindowConfig("fixed", samples=20, draws=1), batch=4, epochs=4
)


def _refused(read: Callable[[], object], *words: str) -> None:
    """It is read, or refused in one of these words."""
    try:
        read()
    except DataError as error:
        if not any(word in str(error) for word in words):
            raise


# --- results: the same files again and again, now these, now those


def _prepare_results(base: Path) -> None:
    (base / "run").mkdir()
    make_report(base / "run")


def _write_results(base: Path) -> None:
    """The second name of the robot, or the first."""
    run = base / "run"
    gap, ladder, fit = (
        GapResult.load(run / "gap.json"),
        Ladder.load(run / "ladder.json"),
        FitResult.load(run / "fit.json"),
    )
    for number in range(ROUNDS):
        name = f"robot {number % 2}"
        replace(gap, settings={**gap.settings, "robot": name}).save(run / "gap.json")
        replace(ladder, provenance={"robot": name}).save(run / "ladder.json")
        replace(fit, provenance={"robot": name}).save(run / "fit.json")
        replace(TIMES, machine=name).save(run / "latency.json")
        _traces(float(number % 2)).save(run / "curves")
        write_report(run)


def _traces(value: float) -> TraceSet:
    from attack.parsers_results import _world
    from report.run_folders import make_traces

    traces = make_traces(_world())
    for name, episode in traces.episodes.items():
        changed = tuple(
            replace(trace, curves={label: np.full_like(curve, value) for label, curve in trace.curves.items()})
            for trace in episode.traces
        )
        traces.episodes[name] = replace(episode, traces=changed)
    traces.provenance = {"value": value}
    return traces


def _results_part(base: Path) -> None:
    run = base / "run"
    GapResult.load(run / "gap.json"), Ladder.load(run / "ladder.json"), FitResult.load(run / "fit.json")
    if (run / "latency.json").exists():
        assert StepTimes.load(run / "latency.json").machine.startswith("robot")
    if (run / "report.html").exists():
        assert (run / "report.html").read_text().rstrip().endswith("</html>")
    if (run / "curves" / "traces.json").exists():
        _refused(lambda: _one_value(run / "curves"), "is not the file that traces.json describes")


def _one_value(folder: Path) -> None:
    """The curves are those of their index."""
    value = json.loads((folder / "traces.json").read_text())["provenance"]["value"]
    for episode in TraceSet.load(folder).episodes.values():
        assert all(np.all(curve == value) for trace in episode.traces for curve in trace.curves.values())


def _results(base: Path) -> None:
    _results_part(base)
    run = base / "run"
    last = f"robot {(ROUNDS - 1) % 2}"
    assert GapResult.load(run / "gap.json").settings["robot"] == last
    assert last in (run / "report.html").read_text()
    TraceSet.load(run / "curves")


# --- a model in the place of another


def _nothing(_: Path) -> None:
    """What is there before the first model."""


def _models(base: Path) -> None:
    model = _trained()
    for number in range(ROUNDS):
        model.card = replace(model.card, name=f"net-{number % 2}")
        model.save(base / "model")


def _model_part(base: Path) -> None:
    if (base / "model" / CARD_NAME).is_file():  # then all of it is there
        assert Augmentation.load(base / "model").card.name.startswith("net-")
        Predictor.load(base / "model")


def _model(base: Path) -> None:
    _model_part(base)
    assert ModelCard.load(base / "model").name == f"net-{(ROUNDS - 1) % 2}"


# --- a training that goes on


def _prepare_training(base: Path) -> None:
    make_dataset(base / "data", counts=(4, 2, 2), samples=(40, 50))
    _train(base, "expected")


def _train(base: Path, name: str = "model") -> None:
    augment([Dataset(base / "data")], base / name, run=RUN, config=TRAINING, jobs=1, resume=True)


def _training_part(base: Path) -> None:
    if (base / "model" / CARD_NAME).is_file():
        Predictor.load(base / "model")


def _training(base: Path) -> None:
    names = {path.name for path in (base / "model").iterdir()}
    assert names == {"model.json", "model.onnx", "weights.safetensors"}, names
    for name in ("model.onnx", "weights.safetensors"):
        assert (base / "model" / name).read_bytes() == (base / "expected" / name).read_bytes(), name


# --- plans


def _store(base: Path, name: str = "plans") -> None:
    robot, model = arm(base)
    store_plans(lambda made: _plans(len(made)), PLANS, robot, base / name, origin={"by": "attack"}, model=model)


def _plans_part(base: Path) -> None:
    with contextlib.suppress(DataError):  # killed before there was a description
        plans = PlanSet(base / "plans")
        assert [plan.id for plan in plans.there()] == PLANS[: len(list(plans.there()))]


def _planned(base: Path) -> None:
    for path in (base / "expected" / "blocks").iterdir():
        assert path.read_bytes() == (base / "plans" / "blocks" / path.name).read_bytes(), path.name
    left = [path.name for path in (base / "plans").rglob(".*")]
    assert not left, left
    assert PlanSet(base / "plans").complete


# --- corrected runs


def _correct(base: Path) -> None:
    assert not list(read_corrected(base))


def _corrected_part(base: Path) -> None:
    dataset = Dataset(base / "data")
    for label in dataset.runs:
        for id in dataset.run_ids(label):
            assert np.isfinite(dataset.episode(id, runs=[label]).simulated[label]["position"]).all()


def _corrected(base: Path) -> None:
    _corrected_part(base)
    dataset = Dataset(base / "data")
    for id in dataset.ids:
        episode = dataset.episode(id, runs=[RUN, f"{RUN}+net"])
        difference = episode.simulated[f"{RUN}+net"]["position"] - episode.simulated[RUN]["position"]
        np.testing.assert_allclose(difference, np.broadcast_to([0.1, 0.2], difference.shape), atol=1e-6)


# --- a fit that goes on


def _prepare_fit(base: Path) -> None:
    truth = _truth(base)
    stored(base / "data", logs_of(truth, seconds=2.0))
    _fit(base, "expected")


def _truth(base: Path) -> Truth:
    robot, nominal = nominal_of(base, SERVO)
    return Truth(robot, nominal, {"damping[shoulder]": 0.9, "damping[elbow]": 0.5})


def _fit(base: Path, name: str = "fit") -> None:
    fit(Dataset(base / "data"), arm(base)[0], base / name, model=base / "arm.xml", config=CONFIG, jobs=1, resume=True)


def _fit_part(base: Path) -> None:
    for name, kind in (("fit.json", FitResult), ("gap.json", GapResult), ("ladder.json", Ladder)):
        if (base / "fit" / name).exists():
            kind.load(base / "fit" / name)


def _fitted(base: Path) -> None:
    _fit_part(base)
    found, expected = (FitResult.load(base / name / "fit.json").values for name in ("fit", "expected"))
    assert found == expected
    assert not (base / "fit" / "checkpoints").exists()
    for name in ("robot.fitted.yaml", "model.fitted.xml", "gap.json", "ladder.json"):
        assert (base / "fit" / name).is_file(), name


# --- a recording that goes on


def _prepare_recording(base: Path) -> None:
    recorded(base / "expected")


def _record(base: Path) -> None:
    recorded(base / "recording", resume=True)


def _recording_part(base: Path) -> None:
    with contextlib.suppress(TrueupError):
        dataset = Dataset(base / "recording")
        assert list(dataset.ids) == RECORDED[: len(dataset)]


def _recording(base: Path) -> None:
    left, right = contents(base / "recording"), contents(base / "expected")
    assert left.keys() == right.keys()
    assert [name for name in left if left[name] != right[name]] == []


RESULT_WRITERS = (
    Writer("results and report", _write_results, _results_part, _results, _prepare_results, slow=True),
    Writer("model folder", _models, _model_part, _model, _nothing),
    Writer("training", _train, _training_part, _training, _prepare_training, slow=True),
    Writer("plan set", _store, _plans_part, _planned, lambda base: _store(base, "expected")),
    Writer("corrected run", _correct, _corrected_part, _corrected, make_corrected),
    Writer("fit", _fit, _fit_part, _fitted, _prepare_fit, slow=True),
    Writer("recording", _record, _recording_part, _recording, _prepare_recording, slow=True),
)
