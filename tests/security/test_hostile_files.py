"""Files that are made to hurt: each is refused in a line or two, in a few seconds, in little memory."""

import resource
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from benchmarks.networks import real_time
from onnx import TensorProto, helper

from attack.parsers_results import make_gap_file
from dataset.store_cases import INFO, make_episode
from trueup.cli.main import main
from trueup.core.atomic import file_hash, read_json, write_json
from trueup.core.card import sealed
from trueup.core.model_card import CARD_NAME, CARD_SCHEMA, ONNX_NAME
from trueup.dataset import Dataset, DatasetWriter, index, writer
from trueup.errors import DataError
from trueup.robots import load_robot
from trueup.stages import demo_dataset, replay
from trueup.stages.exporting import export_dataset

PATIENCE_S, ROOM_BYTES = 20.0, 3_000_000_000
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join([f'*{before}'] * 9)}]\n" for before, name in zip("abcdefghi", "bcdefghij", strict=True)
)
# Where a text should be, so that the message would show it; and while the file is being read.
KNOWN = "name:\n" + "".join(f"- {line.partition(': ')[2]}\n" for line in BOMB.splitlines())
MERGES = BOMB.replace("[x,x,x,x,x,x,x,x,x]", "{x: x}").replace("[", "{<<: [").replace("]", "]}")
ENTITIES = (
    '<!DOCTYPE mujoco [<!ENTITY a "aaaaaaaaaaaaaaaaaaaa">'
    + "".join(f'<!ENTITY {name} "{f"&{before};" * 20}">' for before, name in zip("abcdef", "bcdefg", strict=True))
    + "]><mujoco model='&g;'><worldbody/></mujoco>"
)
OUTSIDE = '<!DOCTYPE mujoco [<!ENTITY x SYSTEM "file:///etc/passwd">]><mujoco model="&x;"><worldbody/></mujoco>'


def _limits():
    resource.setrlimit(resource.RLIMIT_DATA, (ROOM_BYTES, ROOM_BYTES))


def run(*arguments, folder, limits=_limits):
    """The command in a process of its own, that may not take much; code, output, and seconds."""
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "trueup.cli.main", *map(str, arguments)],
        cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S + 40, preexec_fn=limits, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr, time.monotonic() - began


def refused(*arguments, folder, told=(), limits=_limits):
    code, said, took_s = run(*arguments, folder=folder, limits=limits)
    assert code == 2, said
    assert "Traceback" not in said
    assert "bug in trueup" not in said
    assert took_s < PATIENCE_S, said
    assert len(said) < 5000
    for word in told:
        assert word in said


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("data") / "data")


@pytest.mark.long
@pytest.mark.parametrize(
    "text",
    [
        BOMB,
        KNOWN,
        MERGES,
        "a: &a [*a]\n",
        "[" * 50_000,
        "{a: " * 20_000,
        "!!python/object/apply:os.system [touch /tmp/owned]\n",
        "\0",
    ],
    ids=["aliases", "aliases in a known key", "merges", "itself", "deep list", "deep mapping", "code", "zero byte"],
)
def test_yaml(text, data, tmp_path):
    (tmp_path / "robot.yaml").write_text(text)
    refused("replay", data, "--robot", tmp_path / "robot.yaml", folder=tmp_path)
    (tmp_path / "fit.yaml").write_text(text)
    arguments = ("--robot", "demo_arm", "--config", tmp_path / "fit.yaml", "--out", tmp_path / "out")
    refused("identify", data, *arguments, folder=tmp_path)
    assert not Path("/tmp/owned").exists()


def test_yaml_beside_logs(tmp_path):
    """Nobody has to name it: it is read because it is there."""
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "mapping.yaml").write_text(MERGES)
    (logs / "run.csv").write_text("time,q\n0,0\n0.1,0\n")
    refused("import", logs, "--out", tmp_path / "data", folder=tmp_path, told=["mapping.yaml", "aliases that multiply"])


@pytest.mark.long
@pytest.mark.parametrize("text", [ENTITIES, OUTSIDE, "<a>" * 100_000], ids=["entities", "other files", "deep"])
def test_xml(text, data, tmp_path):
    (tmp_path / "model.xml").write_text(text)
    code, said, took_s = run("replay", data, "--robot", "demo_arm", "--model", tmp_path / "model.xml", folder=tmp_path)
    assert code == 2, said
    assert took_s < PATIENCE_S
    assert "root:" not in said
    assert "Traceback" not in said


def network(folder, node, *, initializer=None, opsets=()):
    """A model folder whose graph has a node more, its card in order."""
    real_time(folder, hidden=(8, 5), rate_hz=100.0)
    model = onnx.load(folder / ONNX_NAME)
    model.graph.node.append(node)
    model.graph.initializer.extend([] if initializer is None else [initializer])
    model.opset_import.extend(opsets)
    (folder / ONNX_NAME).write_bytes(model.SerializeToString())
    tree = read_json(folder / CARD_NAME)
    tree["files"][ONNX_NAME] = file_hash(folder / ONNX_NAME)
    content = {key: value for key, value in tree.items() if key not in ("schema", "sha256")}
    write_json(folder / CARD_NAME, sealed(CARD_SCHEMA, content))


def test_a_network_that_reads_other_files(tmp_path, data):
    outside = helper.make_tensor("w", TensorProto.FLOAT, [4], np.zeros(4, np.float32).tobytes(), raw=True)
    outside.ClearField("raw_data")
    outside.data_location = TensorProto.EXTERNAL
    for key, value in (("location", "../../../etc/passwd"), ("offset", "0"), ("length", "16")):
        entry = outside.external_data.add()
        entry.key, entry.value = key, value
    network(tmp_path / "net", helper.make_node("Identity", ["w"], ["unused"]), initializer=outside)
    arguments = ("augment", "time", tmp_path / "net", "--seconds", 0.1, "--out", tmp_path / "out")
    refused(*arguments, folder=tmp_path, told=["weights are not within it", "other files"])


def test_a_network_with_operators_of_its_own(tmp_path):
    node = helper.make_node("Launch", ["x"], ["unused"], domain="evil")
    network(tmp_path / "net", node, opsets=[helper.make_opsetid("evil", 1)])
    arguments = ("augment", "time", tmp_path / "net", "--seconds", 0.1, "--out", tmp_path / "out")
    refused(*arguments, folder=tmp_path, told=["operators of its own", "evil.Launch"])


def test_a_network_that_never_ends(tmp_path):
    """2^60 rounds, all of them before the first sample."""
    names = {"count": TensorProto.INT64, "given": TensorProto.BOOL, "go_on": TensorProto.BOOL}
    count, given, go_on = (helper.make_tensor_value_info(name, kind, []) for name, kind in names.items())
    body = helper.make_graph([helper.make_node("Identity", ["given"], ["go_on"])], "body", [count, given], [go_on])
    loop = helper.make_node("Loop", ["trips", ""], [], body=body)
    trips = helper.make_tensor("trips", TensorProto.INT64, [], [1 << 60])
    network(tmp_path / "net", loop, initializer=trips)
    arguments = ("augment", "time", tmp_path / "net", "--seconds", 0.1, "--out", tmp_path / "out")
    refused(*arguments, folder=tmp_path, told=["Loop", "loops or branches"])


@pytest.mark.parametrize("bounded", [True, False], ids=["little memory", "all memory"])
def test_a_network_that_fills_the_memory(bounded, tmp_path):
    """Said by trueup itself, whether the system would give the memory or not."""
    size = helper.make_tensor("size", TensorProto.INT64, [1], [10**11])
    network(tmp_path / "net", helper.make_node("ConstantOfShape", ["size"], ["unused"]), initializer=size)
    arguments = ("augment", "time", tmp_path / "net", "--seconds", 0.1, "--out", tmp_path / "out")
    refused(*arguments, folder=tmp_path, told=["too much memory", "512 MB"], limits=_limits if bounded else None)


@pytest.mark.long
def test_units_whose_names_lead_elsewhere(tmp_path, data):
    """A fleet makes a folder for each unit, below its own and nowhere else."""
    source = Dataset(data)
    with DatasetWriter.create(tmp_path / "hostile", source.info) as writer:
        for number, name in enumerate(("../../outside", "/etc/x", "..", ".hidden")):
            episode = source.episode(source.ids[number])
            writer.append(replace(episode, meta=replace(episode.meta, unit=name)))
    before = {path.name for path in tmp_path.iterdir()}
    code, said, _ = run(
        *("fleet", tmp_path / "hostile", "--robot", "demo_arm", "--until", "gap", "--jobs", 1, "--out", tmp_path / "o"),
        folder=tmp_path,
    )
    assert code in (0, 2), said
    assert "Traceback" not in said
    assert {path.name for path in tmp_path.iterdir()} - before <= {"o"}
    assert not (tmp_path.parent / "outside").exists()
    assert all(not path.name.startswith(".") for path in (tmp_path / "o").iterdir())


@pytest.mark.parametrize("closed", [True, False], ids=["in the index", "in the journal"])
@pytest.mark.parametrize("name", ["../../owned", "ABSOLUTE"])
def test_a_dataset_whose_ids_lead_elsewhere(name, closed, tmp_path, monkeypatch):
    """Written by somebody who knows the format; an export would make files of them."""
    name = name.replace("ABSOLUTE", str(tmp_path / "owned"))
    with monkeypatch.context() as patch:
        patch.setattr(writer, "is_id", lambda _: True)
        patch.setattr(index, "_refuse_ids", lambda *_: None)
        hostile = DatasetWriter.create(tmp_path / "in" / "hostile", INFO)
        hostile.append(make_episode(0, id=name))
        hostile.close() if closed else hostile.release()
    with pytest.raises(DataError, match="a row of the index has the id"):
        export_dataset(tmp_path / "in" / "hostile", tmp_path / "in" / "out")
    assert not list(tmp_path.rglob("owned*"))
    assert not (tmp_path / "in" / "out").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        "import CSV",
        "gap DATA",
        "close DATA --robot demo_arm --until gap",
        "identify DATA --robot demo_arm",
        "fleet DATA --robot demo_arm --until gap",
        "demo --robot demo_arm",
        "export DATA --format csv",
        "design --robot panda --count 1",
        "record --robot panda --scale 0.001",
        "report RESULTS",
        "augment train DATA --method moving-average",
        "augment sweep REPLAYED --method moving-average --seeds 1",
        "augment eval DATA --model zoo:panda-realeasy-rt",
        "augment robustness DATA --robot demo_arm --model zoo:panda-realeasy-rt",
        "augment time zoo:panda-realeasy-rt",
        "compensate train DATA --robot demo_arm",
        "policy train",
        "policy grid",
        "policy eval zoo:panda-reach",
        "policy curves zoo:panda-reach",
        "deploy run zoo:panda-reach",
        "deploy ros2 zoo:panda-realeasy-rt --localhost --domain 99",
    ],
)
def test_a_folder_that_cannot_be_written_to(words, data, tmp_path, capsys, monkeypatch):
    """Below /proc nobody makes folders, root neither; that is what is said, and not after hours of work."""
    monkeypatch.chdir(tmp_path)
    known = {"DATA": data, "CSV": tmp_path / "csv", "RESULTS": tmp_path}
    make_gap_file(tmp_path)
    if "CSV" in words:
        export_dataset(data, known["CSV"])
    if "REPLAYED" in words:
        known["REPLAYED"] = shutil.copytree(data, tmp_path / "replayed")
        replay(Dataset(known["REPLAYED"]), load_robot("demo_arm"), jobs=1)
    before, began = sorted(tmp_path.rglob("*")), time.process_time()
    with pytest.raises(SystemExit) as left:
        main([*(str(known.get(word, word)) for word in words.split()), "--out", "/proc/trueup/out"])
    out, err = capsys.readouterr()
    assert left.value.code == 2, out + err
    assert "/proc/trueup" in err
    assert "Traceback" not in out + err
    assert "bug in trueup" not in err
    assert len(err) < 2000
    assert time.process_time() - began < PATIENCE_S
    assert sorted(tmp_path.rglob("*")) == before
