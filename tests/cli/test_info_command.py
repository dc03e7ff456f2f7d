"""`trueup info` and `trueup robots`: what is there, for people and for programs."""

import json

import numpy as np
import pytest

from check.arm_logs import arm, logs
from trueup.cli.main import main
from trueup.dataset import DatasetInfo, DatasetWriter
from trueup.robots import load_robot, shipped_robots


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main(list(map(str, arguments)))
    printed = capsys.readouterr()
    return ended.value.code or 0, printed.out, printed.err


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    robot, path = arm(folder, "position")
    episodes = logs(robot, path, np.random.default_rng(1))
    with DatasetWriter.create(folder / "data", DatasetInfo(robot="arm")) as writer:
        for episode in episodes:
            writer.append(episode)
    return folder, episodes


def test_a_dataset(made, capsys):
    folder, episodes = made
    code, said, _ = run(capsys, "info", folder / "data")
    assert code == 0
    assert said.startswith(f"dataset of arm: {len(episodes)} motions, ")
    assert f"{len(episodes[0].measured.joints)} joints: {', '.join(episodes[0].measured.joints)}" in said
    assert "command: position [rad]" in said


def test_the_same_for_programs(made, capsys):
    folder, episodes = made
    code, said, warned = run(capsys, "info", folder / "data", "--json")
    tree = json.loads(said)
    assert (code, warned) == (0, "")
    assert (tree["schema"], tree["kind"], tree["motions"]) == ("trueup.info/1", "dataset", len(episodes))
    assert tree["seconds"] == pytest.approx(sum(item.measured.duration_s for item in episodes), abs=0.1)
    step_s = np.median(np.diff(episodes[0].measured.time_s))
    assert tree["measured"]["rate_hz"] == pytest.approx(1 / step_s, abs=0.01)
    assert tree["measured"]["signals"]["position"] == ["rad"]


def test_logs_are_listed_and_one_motion_is_read(tmp_path, capsys):
    time_s = np.arange(0.0, 2.0, 0.01)
    for name in ("a", "b"):
        arrays = {"joints": np.array(["x", "y"]), "measured.time_s": time_s}
        np.savez(tmp_path / f"{name}.npz", **arrays, **{"measured.position": np.zeros((200, 2))})
    code, said, noted = run(capsys, "info", tmp_path)
    assert code == 0
    assert said.splitlines()[0] == "logs (npz): 2 motions"
    assert "2 joints: x, y" in said
    assert "command: none" in said
    assert noted == ""


@pytest.mark.long
@pytest.mark.parametrize("ending", ["csv", "npz"])
def test_columns_without_a_mapping_are_read_as_their_names_suggest(tmp_path, capsys, ending):
    time_s, angle = np.arange(0.0, 2.0, 0.01), np.sin(np.arange(200) * 0.05)
    (tmp_path / "a.csv").touch()  # cut off at once
    for name in ("b", "c"):
        if ending == "csv":
            rows = np.column_stack([time_s, angle, angle])
            np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="t,q_des_0,q_0", comments="")
        else:
            np.savez(tmp_path / f"{name}.npz", t=time_s, q_des=angle[:, None], q=angle[:, None])
    if ending == "npz":
        (tmp_path / "a.csv").unlink()
    code, said, noted = run(capsys, "info", tmp_path)
    assert code == 0, noted
    assert said.startswith("logs (table): ")
    assert "measured: position [rad], 100 Hz" in said
    assert "columns are read as their names suggest" in noted
    assert not (tmp_path / "mapping.yaml").exists()


def test_what_close_and_identify_made(made, capsys, tmp_path):
    folder, _ = made
    path = next(folder.glob("*.xml"))
    code, *_ = run(capsys, "close", folder / "data", "--model", path, "--out", tmp_path / "run", "--until", "gap")
    assert code == 0
    code, said, _ = run(capsys, "info", tmp_path / "run")
    assert code == 0
    assert said.splitlines()[0] == "results of close --until gap"
    assert any(line.startswith("  gap: done") for line in said.splitlines())


@pytest.mark.parametrize("there", [False, True])
def test_what_is_nothing_of_these_is_said_in_a_line(tmp_path, capsys, there):
    path = tmp_path / "x"
    if there:
        path.write_text("")
    code, _, said = run(capsys, "info", path)
    assert code == 2
    assert said.startswith("error: ")
    assert len(said.splitlines()) <= 3


def test_every_robot_that_is_known_by_name_is_listed(capsys):
    code, said, _ = run(capsys, "robots", "--json")
    found = {item["name"]: item for item in json.loads(said)}
    assert code == 0
    assert {path.stem for path in shipped_robots()} <= set(found)
    assert found["demo_arm"]["model_shipped"] is True
    assert found["ur5e"]["model_shipped"] is False
    for name, item in found.items():
        assert item["joints"] == list(load_robot(name).joint_names)
    code, said, _ = run(capsys, "robots")
    assert code == 0
    assert "so101_lerobot" in said


def test_help_has_a_short_name(capsys):
    for line in (["-h"], ["close", "-h"], ["augment", "train", "-h"]):
        code, said, _ = run(capsys, *line)
        assert code == 0
        assert "Usage: trueup" in said


@pytest.mark.long
def test_a_check_takes_logs_and_leaves_nothing_behind(made, tmp_path, capsys):
    folder, episodes = made
    (tmp_path / "logs").mkdir()
    for number, episode in enumerate(episodes):
        series = {"joints": np.array(episode.measured.joints)}
        for name, own in (("measured", episode.measured), ("command", episode.command)):
            series |= {f"{name}.time_s": own.time_s, f"{name}.position": own["position"]}
        np.savez(tmp_path / "logs" / f"{number}.npz", **series)
    code, said, _ = run(capsys, "check", tmp_path / "logs", "--robot", next(folder.glob("*.xml")))
    assert code == 0
    assert said.splitlines()[-1].endswith(f"in {len(episodes)} motions")
    assert [path.name for path in tmp_path.iterdir()] == ["logs"]
