"""The networks that come with the package: small, whole, and as good as their card says on a robot never seen."""

from dataclasses import replace

import numpy as np
import pytest

import trueup.zoo
from trueup.dataset import Dataset
from trueup.deploy import Status
from trueup.errors import MissingSignal, NameMismatch
from trueup.lab import LabSpec
from trueup.record import load_plans
from trueup.robots import load_robot
from trueup.stages import LabRig, record, replay

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
