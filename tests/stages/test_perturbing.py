"""How far a correction carries: figures against stored runs, what is kept, what is refused, and the page."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from augment.evaluation_cases import card_of, shift_folder
from report.packed import read_json
from trueup.augment.trained import Trained
from trueup.cli.main import main
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.model_card import Input, Output
from trueup.core.robustness_result import CELLS_NAME, Cells, RobustnessResult
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, DataError, FormatError, MissingSignal, NameMismatch, OutputExists
from trueup.measure import ratio_interval
from trueup.report import build_report
from trueup.report.robustness_words import gone_words, lead, sentences, size_words
from trueup.robots import Setup, find_model, load_robot
from trueup.robots.spec import PayloadSpec
from trueup.sim import MujocoSimulator, Perturbation, ReplaySettings, perturbed, replay_episode
from trueup.stages import replay, robustness

BODIES = ("left_shank", "left_foot")
ROBOT = replace(load_robot("kickbot_b"), simulation=replace(load_robot("kickbot_b").simulation, bodies=BODIES))
OFFSET_RAD, OFFSET_M = 0.03, 0.01
# The network knows of half of the offset.
SHIFT = 0.5


def recorded(folder, *, speed=1.0, motions=3, position=True, spoil=None, robot=ROBOT):
    """Motions of a robot whose motors are weaker than its model's, and that reads all positions by an offset."""
    own, spec = perturbed(robot, find_model(robot), Perturbation(resistance=0.3), seed=50)
    simulator = MujocoSimulator.from_spec(spec, own, origin=find_model(robot))
    time_s, rng = np.arange(0, 0.5, 0.01), np.random.default_rng(0)
    units = same_units({"position": "rad"}, robot.joint_names)
    with DatasetWriter.create(folder, DatasetInfo(robot=robot.name)) as writer:
        for number in range(motions):
            swing = np.sin(speed * 5 * time_s[:, None] + rng.uniform(0, 6, 12)) * 0.2
            still = TimeSeries(time_s, robot.joint_names, {"position": swing}, units)
            meta = EpisodeMeta(f"m{number}", split="test")
            run = replay_episode(Episode(meta, still, still), simulator, ReplaySettings())
            signals = {"velocity": run["velocity"], "body.rotation": run["body.rotation"]}
            if position:
                signals["position"] = run["position"] + OFFSET_RAD
                signals["body.position"] = run["body.position"] + OFFSET_M
            if spoil:
                signals = spoil(signals)
            kept = {name: run.units[name] for name in signals}
            measured = TimeSeries(time_s, robot.joint_names, signals, kept, BODIES)
            writer.append(Episode(meta, measured, still))
    return Dataset(folder)


def network(folder, robot=ROBOT, signals=("position",), shift=SHIFT * OFFSET_RAD, **changes):
    card = card_of(joints=robot.joint_names, signals=signals, robot=robot.name, **changes)
    return shift_folder(folder, card, np.full(len(card.inputs), shift))


def body_network(folder):
    channels = [(f"body.position.{axis}", body, "m") for body in BODIES for axis in "xyz"]
    card = replace(
        card_of(joints=BODIES),
        inputs=tuple(Input(*channel) for channel in channels),
        outputs=tuple(Output(*channel, base=number) for number, channel in enumerate(channels)),
    )
    return shift_folder(folder, card, np.full(len(channels), SHIFT * OFFSET_M))


SIZES = {
    "masses": Perturbation(mass=0.5),
    "resistance": Perturbation(resistance=0.5),
}


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robustness")
    data = [recorded(folder / "slow"), recorded(folder / "fast", speed=4.0)]
    net = network(folder / "net")
    before = {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    result = robustness(
        data, ROBOT, net, folder / "out", perturbations=SIZES, draws=2, jobs=1, bootstrap_draws=300, seed=3
    )
    return folder, data, net, result, before


def by_hand(data, net, label, signal="position", away=None):
    """Errors of stored runs, motion by motion, before and after correction."""
    trained, rows = Trained.load(net), []
    away = away or (lambda truth, said: np.abs(truth - said))
    for name in data.ids:
        episode = data.episode(name, runs=[label])
        run = episode.run(label)
        errors = [away(episode.measured[signal], item[signal]) for item in (run, trained.predict(episode, label))]
        rows.append([value for error in errors for value in (error.mean(), error.max(axis=0).mean())])
    return np.array(rows)


def agrees(row, table):
    for at, kind in enumerate(("mae", "max")):
        item = row.errors[kind]
        assert item.simulated.value == pytest.approx(table[:, at].mean(), rel=1e-5)
        assert item.corrected.value == pytest.approx(table[:, 2 + at].mean(), rel=1e-5)
        value, low, high = (
            float(end[0]) for end in ratio_interval(table[:, [2 + at]], table[:, [at]], draws=300, seed=3)
        )
        assert item.gone.value == pytest.approx(1 - value, abs=1e-5)
        assert item.gone.low == pytest.approx(1 - high, abs=1e-4)
        assert item.gone.high == pytest.approx(min(1 - low, 1.0), abs=1e-4)


@pytest.mark.long
def test_figures_are_those_of_runs_that_are_stored(world, tmp_path):
    _, _, net, result, _ = world
    assert [row.dataset for row in result.datasets] == ["slow", "fast"]
    label = "mujoco/stock"
    for row, speed in zip(result.datasets, (1.0, 4.0), strict=True):
        own = recorded(tmp_path / row.dataset, speed=speed)
        replay(own, ROBOT, label=label, jobs=1)
        agrees(row, by_hand(Dataset(own.path), net, label))
    tables = []
    for number in (3, 4):
        own, spec = perturbed(ROBOT, find_model(ROBOT), Perturbation(mass=0.5), seed=number)
        spec.compile()
        path = tmp_path / f"{number}.xml"
        path.write_text(spec.to_xml())
        slow = recorded(tmp_path / f"again{number}")
        replay(slow, own, model=path, label=label, jobs=1)
        tables.append(by_hand(Dataset(slow.path), net, label))
    half, whole = result.perturbed["masses"]
    assert (half.share, whole.share, whole.draws, whole.size["mass"]) == (0.5, 1.0, 2, 0.5)
    assert whole.errors["mae"].corrected.value == pytest.approx(np.mean(tables, axis=0)[:, 2].mean(), rel=1e-3)
    least = min(1 - table[:, 2].sum() / table[:, 0].sum() for table in tables)
    assert whole.least == pytest.approx(least, abs=1e-3)
    assert whole.least <= whole.errors["mae"].gone.value + 1e-9


def test_half_of_an_offset_that_is_known_is_gone(world):
    item = world[3].datasets[0].errors["mae"]
    assert 0.3 < item.gone.value < SHIFT  # the rest is not an offset
    assert item.verdict == "better"
    assert item.simulated.unit == "rad"


def test_repetitions_of_a_motion_are_no_further_evidence(tmp_path):
    once = recorded(tmp_path / "once")
    with DatasetWriter.create(tmp_path / "twice", DatasetInfo(robot=ROBOT.name)) as writer:
        for name in once.ids:
            for again in "ab":
                episode = once.episode(name)
                meta = replace(episode.meta, id=f"{name}{again}", source=f"plans/{name}")
                writer.append(replace(episode, meta=meta))
    data, net = [once, Dataset(tmp_path / "twice")], network(tmp_path / "net")
    result = robustness(data, ROBOT, net, tmp_path / "out", jobs=1, bootstrap_draws=300)
    first, second = (row.errors["mae"] for row in result.datasets)
    for part in ("simulated", "corrected", "gone"):
        found, expected = getattr(second, part), getattr(first, part)
        assert (found.value, found.low, found.high) == pytest.approx((expected.value, expected.low, expected.high))


def test_a_simulator_that_is_farther_off_gains_less(world):
    gone = [row.errors["mae"].gone.value for row in (world[3].datasets[0], *world[3].perturbed["resistance"])]
    errors = [row.errors["mae"].simulated.value for row in (world[3].datasets[0], *world[3].perturbed["resistance"])]
    assert errors[2] > errors[0]
    assert gone[2] < gone[0]


def test_datasets_are_only_read(world):
    folder, *_, before = world
    assert {path: path.read_bytes() for path in before} == before
    assert Dataset(folder / "slow").runs == ()


def test_the_file_is_read_back_by_the_strict_reader(world):
    folder, *_ = world
    path = folder / "out" / "robustness.json"
    assert RobustnessResult.load(path) == world[3]
    tree = json.loads(path.read_text())
    for change in (
        {"schema": "trueup.robustness/2"},
        {"rows": [{**tree["rows"][0], "motions": "3"}]},
        {"rows": [{**tree["rows"][0], "unknown": 1}]},
    ):
        with pytest.raises((DataError, FormatError)):
            RobustnessResult.from_json({**tree, **change})


def test_bodies_are_judged_by_their_distance(world, tmp_path):
    _, (data, _), *_ = world
    result = robustness([data], ROBOT, body_network(tmp_path / "net"), tmp_path / "out", jobs=2, bootstrap_draws=300)
    assert (result.signal, result.parts) == ("body.position", BODIES)
    own = recorded(tmp_path / "again")
    replay(own, ROBOT, jobs=1)
    away = lambda truth, said: np.linalg.norm(truth - said, axis=2)  # noqa: E731
    table = by_hand(Dataset(own.path), tmp_path / "net", "mujoco/stock", "body.position", away)
    found = [
        getattr(result.rows[0].errors[kind], of).value for of in ("simulated", "corrected") for kind in ("mae", "max")
    ]
    assert found == pytest.approx(table.mean(axis=0).tolist(), rel=1e-5)
    page = build_report(tmp_path / "out")
    assert "mm" in page
    assert "Simulators that are off" not in page


def test_what_is_there_is_kept_and_added_to(world, tmp_path, monkeypatch):
    _, (data, _), net, *_ = world
    ask = {"jobs": 1, "bootstrap_draws": 50}
    mass = {"masses": SIZES["masses"]}
    first = robustness([data], ROBOT, net, tmp_path, perturbations=mass, shares=[1.0], draws=1, **ask)
    with pytest.raises(OutputExists, match="holds robustness"):
        robustness([data], ROBOT, net, tmp_path, **ask)
    drawn = []
    monkeypatch.setattr(
        "trueup.sim.perturbation.perturbed", lambda *a, **k: drawn.append(k["seed"]) or perturbed(*a, **k)
    )
    again = robustness([data], ROBOT, net, tmp_path, perturbations=mass, shares=[1.0], draws=2, resume=True, **ask)
    assert drawn == [1]
    assert again.datasets == first.datasets
    with pytest.raises(OutputExists, match="other datasets, motions"):
        robustness([data], ROBOT, net, tmp_path, motions=2, resume=True, **ask)
    robustness([data], ROBOT, net, tmp_path, motions=2, overwrite=True, **ask)
    assert len(Cells.load(tmp_path / CELLS_NAME).cells) == 1


def test_simulators_carry_what_the_motions_do(tmp_path):
    # Without settling, a replay begins where it is said to have begun.
    robot = replace(ROBOT, payload=PayloadSpec(("left_hand",)), replay=replace(ROBOT.replay, settle_s=0.0))
    time_s = np.arange(0, 0.5, 0.01)
    later = time_s[:, None] > 0
    units = same_units({"position": "rad"}, robot.joint_names)
    still = TimeSeries(time_s, robot.joint_names, {"position": np.zeros((50, 12))}, units)
    with DatasetWriter.create(tmp_path / "data", DatasetInfo(robot=robot.name)) as writer:
        for payload_kg in (0.0, 1.5):
            simulator = MujocoSimulator.from_robot(robot, find_model(robot), setup=Setup(payload_kg))
            meta = EpisodeMeta(f"{payload_kg}kg", payload_kg=payload_kg, split="test")
            run = replay_episode(Episode(meta, still, still), simulator, ReplaySettings.of(robot))
            read = replace(run, signals={**run.signals, "position": run["position"] + OFFSET_RAD * later})
            writer.append(Episode(meta, read, still))
    result = robustness(
        [Dataset(tmp_path / "data")],
        robot,
        network(tmp_path / "net", robot=robot),
        tmp_path / "out",
        perturbations={"nothing": Perturbation(mass=1e-12)},
        shares=[1.0],
        draws=1,
        jobs=1,
        bootstrap_draws=50,
    )
    for row in result.rows:
        assert row.motions == 2
        assert row.errors["max"].simulated.value == pytest.approx(OFFSET_RAD, rel=1e-6), row.perturbation


def test_a_motion_that_cannot_be_judged_is_left_out_and_said(world, tmp_path):
    _, _, net, *_ = world
    factors = iter([1.0, np.nan, 1.0])
    data = recorded(
        tmp_path / "data", spoil=lambda signals: {**signals, "position": next(factors) * signals["position"]}
    )
    result = robustness([data], ROBOT, net, tmp_path / "out", jobs=1, bootstrap_draws=50)
    assert result.rows[0].motions == 2
    assert result.notes[0].startswith("data: as it is: 1 motions were left out, m1 because")
    assert "m1 because" in build_report(tmp_path / "out")
    never = recorded(tmp_path / "never", spoil=lambda signals: {**signals, "position": np.nan * signals["position"]})
    with pytest.raises(DataError, match="no motion could be simulated and corrected") as error:
        robustness([never], ROBOT, net, tmp_path / "none", jobs=1)
    assert "not finite" in str(error.value)


def test_a_perturbation_of_which_nothing_can_be_simulated_is_named(world, tmp_path, monkeypatch):
    _, (data, _), net, *_ = world
    sizes = {"far": Perturbation(mass=0.1)}

    def wild(robot, model, size, *, seed):
        own, spec = perturbed(robot, model, size, seed=seed)
        spec.option.gravity = (0.0, 0.0, -1e13)
        return own, spec

    monkeypatch.setattr("trueup.sim.perturbation.perturbed", wild)
    with pytest.raises(DataError, match="far x 1: no motion could be simulated") as error:
        robustness([data], ROBOT, net, tmp_path, perturbations=sizes, shares=[1.0], draws=2, motions=1, jobs=1)
    assert "diverged" in str(error.value)
    assert "smaller size" in error.value.hint
    assert not (tmp_path / "robustness.json").exists()


def test_what_makes_no_sense_is_refused_before_anything_is_simulated(world, tmp_path):
    folder, (data, _), net, *_ = world

    def refused(kind, match, *, datasets=(data,), robot=ROBOT, model=net, **changes):
        with pytest.raises(kind, match=match):
            robustness(datasets, robot, model, tmp_path / "out", jobs=1, **changes)
        assert not (tmp_path / "out").exists()

    refused(ConfigError, "corrects no position", model=network(tmp_path / "torque", signals=("torque",)))
    refused(ConfigError, "the resistance of its motors", robot=load_robot("demo_arm"), perturbations=SIZES)
    refused(ConfigError, "names none", robot=load_robot("kickbot_b"), model=body_network(tmp_path / "bodies"))
    refused(ConfigError, "changes nothing", perturbations={"nothing": Perturbation()})
    refused(ConfigError, "no dataset", datasets=())
    refused(ConfigError, "twice", datasets=(data, Dataset(folder / "slow")))
    refused(ConfigError, "shares", shares=[0.5, -1.0])
    refused(ConfigError, "draws", draws=0)
    refused(MissingSignal, "no split 'val'", split="val")
    refused(NameMismatch, "for other joints", model=network(tmp_path / "arm", load_robot("demo_arm")))
    refused(
        NameMismatch,
        "no joint of the log is one of the robot's",
        robot=load_robot("demo_arm"),
        model=network(tmp_path / "arm", load_robot("demo_arm")),
    )
    refused(MissingSignal, "was not measured", datasets=(recorded(tmp_path / "blind", motions=1, position=False),))


@pytest.mark.long
def test_the_page_says_what_the_file_says(world):
    folder, _, _, result, _ = world
    page = build_report(folder / "out")
    assert page == build_report(folder / "out")
    assert "<title>Robustness of net on kickbot_b</title>" in page
    data = {
        name: read_json(re.search(rf'id="{name}">.*?class="chooser-data">(.*?)</script>', page, re.S).group(1))
        for name in ("robustness-datasets", "robustness-sizes")
    }
    shown = data["robustness-sizes"]["variants"]["max"]
    lines = {item["name"]: item for item in shown["figures"]["sizes"]["data"]}
    assert set(lines) == {"masses", "resistance"}
    for name, line in lines.items():
        own = [result.datasets[0], *result.perturbed[name]]
        assert line["y"] == pytest.approx([100 * row.errors["max"].gone.value for row in own], rel=1e-4)
        assert line["customdata"] == [0, 50, 100]
        high = [100 * (row.errors["max"].gone.high - row.errors["max"].gone.value) for row in own]
        assert line["error_y"]["array"] == pytest.approx(high, rel=1e-4)
    table = shown["tables"]["sizes"]["rows"]
    assert [row["head"] for row in table] == ["as it is", "masses", "masses", "resistance", "resistance"]
    assert table[2]["note"] == "masses by 50 %"
    bars = data["robustness-datasets"]["variants"]["mae"]["figures"]["errors"]["data"]
    degrees = [np.degrees(row.errors["mae"].simulated.value) for row in result.datasets]
    assert bars[0]["x"] == pytest.approx(degrees, rel=1e-4)
    points = data["robustness-datasets"]["variants"]["mae"]["figures"]["datasets"]
    assert points["layout"]["xaxis"]["ticktext"] == ["slow", "fast"]


def test_words_name_the_smallest_size_at_which_nothing_is_certain(world):
    result = world[3]
    assert lead(result).startswith("net takes ")
    assert len(sentences(result)) == 2

    def with_verdict(verdict, result=result, **of):
        def changed(row):
            if all(getattr(row, key) == value for key, value in of.items()):
                return replace(row, errors={**row.errors, "mae": replace(row.errors["mae"], verdict=verdict)})
            return row

        return replace(result, rows=tuple(changed(row) for row in result.rows))

    every = with_verdict("better")
    assert sentences(every)[0].startswith("On every dataset it helps: least on ")
    assert sentences(every)[1].startswith("It helps with every simulator that is off: least with one off in ")
    unsure = with_verdict("undecided", result=every, perturbation="resistance", share=1.0)
    assert (
        sentences(unsure)[1] == "It does not help for sure where the simulator is off in resistance by 50 %, or more."
    )
    assert sentences(with_verdict("worse", dataset="fast"))[0] == "It does not help for sure on fast."
    assert "does not help" in lead(with_verdict("worse", dataset="slow"))
    assert "not decided" in lead(with_verdict("undecided", dataset="slow"))


def test_sizes_in_words():
    assert size_words(vars(Perturbation(mass=0.5, com_m=0.01, joint_m=0.002))) == (
        "masses by 50 %, centers of mass by 10 mm, joint positions by 2 mm"
    )
    assert size_words(vars(Perturbation())) == ""


def test_the_command(world, tmp_path, capsys, monkeypatch):
    folder, _, net, *_ = world
    monkeypatch.chdir(tmp_path)
    line = ["augment", "robustness", str(folder / "slow"), "--model", str(net), "--robot", "kickbot_b", "--jobs", "1"]
    line += ["--out", "out", "--motions", "1"]
    with pytest.raises(SystemExit) as left:
        main([*line, "--mass", "0.5", "--com", "0.01", "--shares", "1", "--draws", "1"])
    said = capsys.readouterr().out
    assert left.value.code == 0
    assert "position error [deg]" in said
    assert "masses by 50 %, centers of mass by 10 mm" in said
    assert list(RobustnessResult.load(tmp_path / "out" / "robustness.json").perturbed) == [
        "masses",
        "centers of mass",
        "all of these",
    ]
    assert (tmp_path / "out" / "report.html").is_file()
    for wrong, words in ((["--shares", "half"], "--shares"), (["--mass", "-1"], "perturbation: mass")):
        with pytest.raises(SystemExit) as left:
            main([*line, "--overwrite", *wrong])
        assert left.value.code == 2
        assert words in capsys.readouterr().err


def test_what_the_training_has_switched_off_is_said(world, tmp_path):
    joint = ROBOT.joint_names[2]
    net = network(tmp_path / "net", outputs={("position", joint): {"gate": 0.0, "reason": "no better on val"}})
    result = robustness([world[1][0]], ROBOT, net, tmp_path / "out", motions=1, jobs=1, bootstrap_draws=50)
    assert result.notes == (f"net leaves the position of {joint} as simulated",)


def test_a_robot_that_is_not_the_one_of_the_training_is_said(world, tmp_path):
    own = recorded(tmp_path / "own", motions=1)
    replay(own, ROBOT, jobs=1)
    own, net = Dataset(own.path), world[2]
    other = replace(ROBOT, simulation=replace(ROBOT.simulation, timestep_s=0.002))
    same, foreign = (
        robustness([own], robot, net, tmp_path / name, jobs=1, bootstrap_draws=50).notes
        for name, robot in (("same", ROBOT), ("other", other))
    )
    assert same == ()
    assert "with another simulator" in foreign[0]


def test_one_motion_has_no_interval(world):
    assert gone_words(replace(world[3].rows[0].errors["mae"].gone, low=None, high=None)).endswith("%")
