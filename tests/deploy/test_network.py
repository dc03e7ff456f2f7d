import pickle
import sys
from dataclasses import replace

import onnx
import pytest
from benchmarks.networks import JOINTS, bidirectional, card_of, inputs_of, real_time, spoiled_card, window, written
from onnx import TensorProto, helper

from augment.test_simulator import LSTM, modular_network
from trueup.core.model_card import CARD_NAME, ONNX_NAME, State
from trueup.deploy import Network
from trueup.errors import DataError, FormatError, MissingDependency


@pytest.mark.parametrize("make", [real_time, window, bidirectional])
def test_a_folder_opens_with_its_card(tmp_path, make):
    made = make(tmp_path, hidden=(8, 5))
    network = Network.load(str(tmp_path))
    assert network.card == made.card
    assert network.card.files.keys() == {ONNX_NAME}
    assert network.session.get_session_options().intra_op_num_threads == 1


def says(error, *words):
    """The message names these things, and is short enough for a terminal."""
    text = str(error.value)
    assert len(text.splitlines()) <= 2
    assert all(word in text for word in words), text


def test_missing_and_empty_folders(tmp_path):
    with pytest.raises(DataError) as error:
        Network.load(tmp_path / "nowhere")
    says(error, "nowhere", CARD_NAME, "no such folder", "trueup augment train")
    (tmp_path / CARD_NAME).write_text("")
    with pytest.raises(DataError) as error:
        Network.load(tmp_path)
    says(error, "not readable JSON")


def test_a_missing_graph(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    (made.folder / ONNX_NAME).unlink()
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, ONNX_NAME, "No such file")


@pytest.mark.parametrize("keep", [0, 1, 1000, -1])
def test_a_truncated_graph(tmp_path, keep):
    made = real_time(tmp_path, hidden=(8, 5))
    path = made.folder / ONNX_NAME
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, ONNX_NAME, "bytes", "truncated")


def test_one_changed_byte_of_the_graph(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    path = made.folder / ONNX_NAME
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, ONNX_NAME, "SHA-256")


def test_the_graph_of_another_model(tmp_path):
    made, other = real_time(tmp_path / "a", hidden=(8, 5)), real_time(tmp_path / "b", hidden=(8, 5), seed=1)
    (made.folder / ONNX_NAME).write_bytes((other.folder / ONNX_NAME).read_bytes())
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, "not the file that model.json describes")


def test_an_edited_card(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    spoiled_card(made, '"rate_hz": 1000.0', '"rate_hz": 100.0')
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, "was changed after it was written")


def test_a_card_of_another_version(tmp_path):
    made = real_time(tmp_path, hidden=(8, 5))
    spoiled_card(made, "trueup.model/1", "trueup.model/9")
    with pytest.raises(FormatError) as error:
        Network.load(made.folder)
    says(error, "trueup.model/9")


def test_what_is_no_network_although_its_hash_is_right(tmp_path):
    (tmp_path / ONNX_NAME).write_bytes(b"no protobuf")
    card_of().save(tmp_path)
    with pytest.raises(DataError) as error:
        Network.load(tmp_path)
    says(error, "onnxruntime", "cannot run", ONNX_NAME)


def test_an_empty_graph_although_its_hash_is_right(tmp_path):
    (tmp_path / ONNX_NAME).write_bytes(b"")
    card_of().save(tmp_path)
    with pytest.raises(DataError) as error:
        Network.load(tmp_path)
    says(error, ONNX_NAME)


def recard(made, **changes):
    """Another card for the same graph, with good hashes."""
    replace(made.card, **changes).save(made.folder)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"inputs": inputs_of(command=True)}, ["'x'", "21", "28"]),
        ({"states": ()}, ["inputs are not those", "h0"]),
        ({"states": tuple(State(name, (1, 1, 9)) for name in ("h0", "c0", "h1", "c1"))}, ["'h0'", "8", "9"]),
        ({"states": tuple(State(name, (8, 1, 1), 0) for name in ("h0", "c0", "h1", "c1"))}, ["'h0'"]),
        ({"causal": False}, ["looks into the future has no states"]),
        ({"joints": JOINTS[:6]}, ["lacks the joints", "torque.joint7"]),
    ],
    ids=["inputs", "no states", "size", "axis", "future", "joints"],
)
def test_a_card_that_does_not_fit_the_graph(tmp_path, changes, words):
    made = real_time(tmp_path, hidden=(8, 5))
    recard(made, **changes)
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, *words)


def test_a_graph_that_takes_one_sample_only(tmp_path):
    """The contract is any T and B: a graph that was exported for one sample cannot correct motions."""
    tensors = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, 21]) for name in "xy"]
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "fixed", tensors[:1], tensors[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    written(tmp_path, card_of(), model.SerializeToString())
    with pytest.raises(DataError) as error:
        Network.load(tmp_path)
    says(error, "[1, 1, 21]", "any")


def test_a_graph_in_double_precision(tmp_path):
    tensors = [helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["T", "B", 21]) for name in "xy"]
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "double", tensors[:1], tensors[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    written(tmp_path, card_of(), model.SerializeToString())
    with pytest.raises(DataError) as error:
        Network.load(tmp_path)
    says(error, "tensor(double)", "tensor(float)")


def test_weights_outside_of_the_file_are_not_read(tmp_path):
    """A graph may name another file for its weights; that file has no hash, so it must not count."""
    made = real_time(tmp_path, hidden=(8, 5))
    path = made.folder / ONNX_NAME
    model = onnx.load_from_string(path.read_bytes())
    onnx.save_model(model, str(path), save_as_external_data=True, location="elsewhere", size_threshold=0)
    assert (made.folder / "elsewhere").is_file()
    made.card.save(made.folder)
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, "weights are not within it", "external data")


@pytest.mark.parametrize("table", [((0.0, 1.0), (0.5,)), ((1.0, 1.0), (0.1, 0.5)), ((1.0, 0.5), (0.1, 0.5))])
def test_probabilities_that_cannot_be_looked_up(tmp_path, table):
    made = real_time(tmp_path, hidden=(8, 5))
    broken = replace(made.card.outputs[3], far_correction=table[0], far_probability=table[1])
    recard(made, outputs=(*made.card.outputs[:3], broken, *made.card.outputs[4:]))
    with pytest.raises(DataError) as error:
        Network.load(made.folder)
    says(error, made.card.outputs[3].name)


def test_without_onnxruntime_it_says_what_to_install(tmp_path, monkeypatch):
    made = real_time(tmp_path, hidden=(8, 5))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingDependency) as error:
        Network.load(made.folder)
    says(error, "onnxruntime", "pip install '.[run]'")


def test_a_network_goes_to_another_process_by_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    real_time(tmp_path / "net", hidden=(8, 5))
    network = Network.load("net")
    sent = pickle.dumps(network)
    monkeypatch.chdir(tmp_path / "net")  # a process may work elsewhere
    again = pickle.loads(sent)
    assert again.card == network.card
    assert [tensor.name for tensor in again.session.get_inputs()] == [
        tensor.name for tensor in network.session.get_inputs()
    ]
    real_time(tmp_path / "net", hidden=(8, 5), seed=1)
    with pytest.raises(DataError) as error:
        pickle.loads(sent)
    says(error, "another network", "into another one")


def test_a_modular_network_goes_with_the_joints_that_it_was_given(tmp_path):
    folder = tmp_path / "net"
    folder.mkdir()
    network = modular_network(folder, LSTM).of_joints(("a", "b"))
    assert pickle.loads(pickle.dumps(network)).card.joints == ("a", "b")
