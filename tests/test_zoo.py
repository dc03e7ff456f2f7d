"""The networks that come with the package: small, whole, and as good as their card says on a robot never seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import trueup.zoo
from trueup.cli.main import main
from trueup.core.augment_result import AugmentResult
from trueup.core.step_times import StepTimes
from trueup.dataset import Dataset
from trueup.deploy import Status
from trueup.errors import MissingSignal, NameMismatch
from trueup.lab import LabSpec
from trueup.record import load_plans
from trueup.robots import load_robot
from trueup.stages import LabRig, record, replay
from trueup.stages.policy_judging import judge_policies

RUN = "mujoco/stock"


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    """Seventeen motions of a unit that no network was trained on."""
    folder = tmp_path_factory.mktemp("zoo") / "panda"
    plans = replace(load_plans("paper"), seed=99).scaled(0.01)
    record(folder, load_robot("panda"), LabRig(LabSpec(), number=12, seed=99), plans, jobs=1)
    data = Dataset(folder)
    replay(data, load_robot("panda"), label=RUN, jobs=1)
    return data


@pytest.mark.parametrize("name", trueup.zoo.names())
def test_a_network_is_small_and_has_a_card(name):
    folder = trueup.zoo.folder(name)
    assert sum(path.stat().st_size for path in folder.iterdir()) < 500_000
    assert {path.name for path in folder.iterdir()} == {"model.json", "model.onnx", "CARD.md"}
    card = trueup.zoo.load(name).card
    assert card.name == name
    assert name in (folder / "CARD.md").read_text()


def test_unknown_names_list_the_known_ones():
    with pytest.raises(MissingSignal, match="panda-realeasy-rt"):
        trueup.zoo.load("no-such-network")


@pytest.mark.parametrize("kind", [str, Path])
def test_a_network_of_the_zoo_is_named_where_a_folder_is(kind):
    home = trueup.zoo.folder("panda-realeasy-rt")
    assert trueup.zoo.folder_of(kind("zoo:panda-realeasy-rt")) == home
    for path in ("models/panda-rt", "panda-realeasy-rt", "./zoo:panda-realeasy-rt", str(home)):
        assert str(trueup.zoo.folder_of(path)) == str(Path(path))
    for unknown in ("zoo:panda", "zoo:", "zoo:../zoo/panda-realeasy-rt"):
        with pytest.raises(MissingSignal, match="available: panda-realeasy-rt"):
            trueup.zoo.folder_of(kind(unknown))


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["augment", *(str(argument) for argument in arguments)])
        printed = capsys.readouterr()
        return end.value.code, " ".join(printed.out.split()), " ".join(printed.err.split())

    return call


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.long
def test_its_steps_are_timed_and_the_package_is_left_as_it_is(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    home = trueup.zoo.folder("panda-realeasy-rt")
    before = contents(home)
    code, out, err = run("time", "zoo:panda-realeasy-rt", "--seconds", 0.05)
    assert code == 0
    assert "one step of panda-realeasy-rt, in a loop at 1000 Hz" in out
    assert "are not saved" in err
    assert "--out" in err
    assert "times:" not in out
    assert contents(home) == before
    assert list(tmp_path.iterdir()) == []
    code, out, err = run("time", "zoo:panda-realeasy-rt", "--seconds", 0.05, "--out", "times")
    assert code == 0
    assert "are not saved" not in err
    assert StepTimes.load(tmp_path / "times" / "latency.json").period_us == pytest.approx(1000.0)
    assert contents(home) == before


@pytest.mark.parametrize("command", [("time",), ("eval", "data", "--out", "out", "--model")])
def test_an_unknown_name_is_refused_by_the_commands(run, command, tmp_path, monkeypatch, panda):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").symlink_to(panda.path)
    code, _, err = run(*command, "zoo:panda-realtime")
    assert code == 2
    assert "no 'panda-realtime': available: panda-realeasy-rt" in err
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


@pytest.mark.long
def test_it_is_evaluated_like_a_network_of_ones_own(run, panda, tmp_path):
    code, out, _ = run(
        *("eval", panda.path, "--model", "zoo:panda-realeasy-rt", "--split", "all", "--out", tmp_path / "out")
    )
    assert code == 0
    assert "panda-realeasy-rt" in out
    result = AugmentResult.load(tmp_path / "out" / "augment.json")
    assert [model.name for model in result.models] == ["panda-realeasy-rt"]


@pytest.mark.long
def test_plug_and_play_on_a_new_unit(panda):
    """Realeasy, V: 53 % less torque MSE on another robot; no signal is worse."""
    model = trueup.zoo.load("panda-realeasy-rt")
    sums = {}
    for episode in panda.episodes(runs=[RUN]):
        corrected = model.predict(episode, RUN)
        for signal in ("position", "velocity", "torque"):
            for series, errors in ((episode.run(RUN), 0), (corrected, 1)):
                square = ((episode.measured[signal] - series[signal]) ** 2).sum(axis=0)
                sums.setdefault(signal, np.zeros((2, 7)))[errors] += square
    assert (sums["torque"][0] > 2.2 * sums["torque"][1]).all()
    assert (sums["position"][0] > sums["position"][1]).all()
    assert (sums["velocity"][0] > sums["velocity"][1]).all()


def test_it_runs_in_a_loop_and_refuses_another_robot(panda):
    model = trueup.zoo.load("panda-realeasy-rt")
    stream = model.stream(rate_hz=100.0, joints=panda.episode(panda.ids[0]).measured.joints)
    episode = panda.episode(panda.ids[0], runs=[RUN])
    series, whole = episode.run(RUN), model.predict(episode, RUN)
    for row in range(len(series)):
        step = stream.step({name: series[name][row] for name in ("position", "velocity", "torque")})
        if step.status is Status.OK:
            expected = np.concatenate([whole[name][row] for name in ("position", "velocity", "torque")])
            np.testing.assert_allclose(step.values, expected, atol=1e-5)
    assert step.status is Status.OK
    with pytest.raises(NameMismatch, match="pan"):
        model.stream(rate_hz=100.0, joints=["pan", "lift"])


@pytest.mark.long
@pytest.mark.parametrize("name", trueup.zoo.policies())
def test_a_policy_is_small_has_a_card_and_comes_near_in_a_simulator_and_on_a_robot_never_seen(name):
    folder = trueup.zoo.folder(name)
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1_000_000
    assert {path.name for path in folder.iterdir()} == {"policy.json", "policy.onnx", "CARD.md"}
    found = judge_policies(
        [folder], load_robot("panda_torque"), places=("mujoco", "lab"), goals=24, units=(12,), seed=77, jobs=1
    )
    (own,) = found.evaluation.policies
    for place in ("mujoco", "lab-12"):
        assert own.places[place].estimates["distance_median"].value < 0.05, place


def test_policies_are_found_by_their_name():
    assert trueup.zoo.policies() == ("panda-reach",)
    assert trueup.zoo.folder_of("zoo:panda-reach") == trueup.zoo.folder("panda-reach")
    with pytest.raises(MissingSignal, match="no 'panda-throw'"):
        trueup.zoo.folder_of("zoo:panda-throw")
