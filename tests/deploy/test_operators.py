"""What a graph may hold: all that is exported here, and nothing that loops or grows with a number."""

import numpy as np
import onnx
import pytest
from benchmarks.networks import real_time
from onnx import TensorProto, helper, numpy_helper

from trueup import zoo
from trueup.core.model_card import ONNX_NAME
from trueup.deploy import trial
from trueup.deploy.network import session_of
from trueup.deploy.operators import PLAIN, SIZED, check_operators
from trueup.errors import DataError


def model_of(*nodes, constants=(), opsets=(), functions=(), sparse=()):
    """`y = x`, and these nodes beside it."""
    tensors = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["T", "B", 3]) for name in "xy"]
    inner = [numpy_helper.from_array(np.asarray(value), name) for name, value in constants]
    graph = helper.make_graph(
        [helper.make_node("Identity", ["x"], ["y"]), *nodes], "beside", tensors[:1], tensors[1:], inner
    )
    graph.sparse_initializer.extend(sparse)
    opsets = [helper.make_opsetid("", 17), *opsets]
    return helper.make_model(graph, opset_imports=opsets, functions=list(functions), ir_version=9)


def refused(model, *words):
    data = model if isinstance(model, bytes) else model.SerializeToString()
    with pytest.raises(DataError) as error:
        session_of(data, "net/model.onnx")
    said = str(error.value)
    assert all(word in said for word in ("net/model.onnx", *words)), said
    assert len(said) < 2000


def body(*nodes):
    value = helper.make_tensor_value_info("go_on", TensorProto.BOOL, [])
    count = helper.make_tensor_value_info("i", TensorProto.INT64, [])
    given = helper.make_tensor_value_info("given", TensorProto.BOOL, [])
    return helper.make_graph(
        [helper.make_node("Identity", ["given"], ["go_on"]), *nodes], "body", [count, given], [value]
    )


def test_what_is_plain_is_run():
    session = session_of(model_of(helper.make_node("Tanh", ["x"], ["unused"])).SerializeToString(), "here")
    x = np.ones((2, 1, 3), np.float32)
    np.testing.assert_array_equal(session.run(None, {"x": x})[0], x)


def test_loops_and_branches_are_refused_wherever_they_are():
    constants = (("trips", np.int64(1 << 60)), ("yes", np.array(1, bool)))
    loop = helper.make_node("Loop", ["trips", "yes"], [], body=body())
    refused(model_of(loop, constants=constants), "Loop", "loops or branches")
    branch = helper.make_node("If", ["yes"], ["unused"], then_branch=body(), else_branch=body())
    refused(model_of(branch, constants=constants), "If")
    hidden = helper.make_node("Identity", ["x"], ["unused"], body=body(loop))
    refused(model_of(hidden, constants=constants), "Identity")


def test_functions_of_its_own_are_refused():
    inner = [helper.make_node("Identity", ["a"], ["b"])]
    function = helper.make_function("", "Tanh", ["a"], ["b"], inner, [helper.make_opsetid("", 17)])
    refused(model_of(helper.make_node("Tanh", ["x"], ["unused"]), functions=[function]), "functions of its own")


@pytest.mark.parametrize("domain", ["evil", "com.microsoft", "ai.onnx.ml"])
def test_operators_of_other_domains_are_refused(domain):
    node = helper.make_node("Gelu", ["x"], ["unused"], domain=domain)
    refused(model_of(node, opsets=[helper.make_opsetid(domain, 1)]), f"{domain}.Gelu")


@pytest.mark.parametrize(
    "nodes",
    [
        [helper.make_node("Range", ["zero", "many", "one"], ["unused"])],
        [helper.make_node("ConstantOfShape", ["shape"], ["unused"])],
        [helper.make_node("Expand", ["x", "shape"], ["unused"])],
        [helper.make_node("Tile", ["x", "shape"], ["unused"])],
        [helper.make_node("Pad", ["x", "shape"], ["unused"])],
        [helper.make_node("OneHot", ["shape", "many", "zero"], ["unused"])],
    ],
    ids=lambda nodes: nodes[0].op_type,
)
def test_nothing_is_as_large_as_a_number_that_comes_in(nodes):
    """All of them are small for the zeros of a trial."""
    made = [
        helper.make_node("Cast", ["x"], ["shape"], to=TensorProto.INT64),
        helper.make_node("ReduceSum", ["shape"], ["many"], keepdims=0),
    ]
    assert nodes[0].op_type in SIZED
    refused(
        model_of(*made, *nodes, constants=(("zero", np.int64(0)), ("one", np.int64(1)))),
        nodes[0].op_type, "as large as its input says",
    )  # fmt: skip


CUT = {
    "NonZero": [helper.make_node("NonZero", ["x"], ["part"])],
    "Compress": [
        helper.make_node("Cast", ["flat"], ["mask"], to=TensorProto.BOOL),
        helper.make_node("Compress", ["flat", "mask"], ["part"]),
    ],
    "Slice": [helper.make_node("Slice", ["many", "zero", "count"], ["part"])],
    "TopK": [helper.make_node("TopK", ["many", "count"], ["part", "places"], axis=0)],
    "Reshape": [helper.make_node("Reshape", ["many", "count"], ["part"])],
    "through others": [helper.make_node("NonZero", ["x"], ["places"]), helper.make_node("Neg", ["places"], ["part"])],
}


@pytest.mark.parametrize("kind", CUT)
def test_nothing_is_as_large_as_what_numbers_that_come_in_have_cut(kind):
    """The shape of such a value is a number that comes in, too."""
    constants = (("zero", np.array([0])), ("minus", np.array([-1])), ("many", np.zeros(1000, np.float32)))
    made = [
        helper.make_node("Reshape", ["x", "minus"], ["flat"]),
        helper.make_node("Cast", ["flat"], ["whole"], to=TensorProto.INT64),
        helper.make_node("ReduceMax", ["whole"], ["count"], keepdims=1),
    ]
    size = [helper.make_node("Shape", ["part"], ["size"]), helper.make_node("ConstantOfShape", ["size"], ["unused"])]
    refused(model_of(*made, *CUT[kind], *size, constants=constants), "ConstantOfShape", "as large as its input says")


def test_what_constants_cut_is_run():
    constants = (("zero", np.array([0])), ("two", np.array([2])), ("many", np.zeros(9, np.float32)))
    nodes = (
        helper.make_node("Slice", ["many", "zero", "two"], ["part"]),
        helper.make_node("Shape", ["part"], ["size"]),
        helper.make_node("ConstantOfShape", ["size"], ["unused"]),
    )
    session_of(model_of(*nodes, constants=constants).SerializeToString(), "here")


def test_sizes_from_shapes_are_run():
    nodes = (helper.make_node("Shape", ["x"], ["shape"]), helper.make_node("ConstantOfShape", ["shape"], ["unused"]))
    session_of(model_of(*nodes).SerializeToString(), "here")


DOUBLED = [helper.make_node("Concat", [f"v{i}" if i else "x"] * 2, [f"v{i + 1}"], axis=0) for i in range(40)]


@pytest.mark.parametrize(
    ("nodes", "constants"),
    [
        ([helper.make_node("ConstantOfShape", ["size"], ["unused"])], [("size", np.array([10**11]))]),
        ([helper.make_node("Expand", ["x", "size"], ["unused"])], [("size", np.array([10**11, 1, 3]))]),
        ([helper.make_node("Tile", ["x", "size"], ["unused"])], [("size", np.array([10**11, 1, 1]))]),
        (
            [helper.make_node("Range", ["zero", "size", "one"], ["unused"])],
            [("size", np.int64(10**11)), ("zero", np.int64(0)), ("one", np.int64(1))],
        ),
        (
            [helper.make_node("MatMul", ["column", "row"], ["unused"])],
            [("column", np.ones((30_000, 1), np.float32)), ("row", np.ones((1, 30_000), np.float32))],
        ),
        (DOUBLED, []),
    ],
    ids=["ConstantOfShape", "Expand", "Tile", "Range", "column times row", "doubled"],
)
def test_what_fills_the_memory_is_refused_before_it_does(nodes, constants):
    refused(model_of(*nodes, constants=constants), "too much memory", "512 MB")


@pytest.mark.long
def test_what_takes_too_long_is_ended(monkeypatch):
    monkeypatch.setattr(trial, "MOST_SECONDS", 0.2)
    square = np.full((1500, 1500), 1e-3, np.float32)
    nodes = [helper.make_node("MatMul", [f"v{i}" if i else "a", "a"], [f"v{i + 1}"]) for i in range(200)]
    refused(model_of(*nodes, constants=[("a", square)]), "takes too long", "0.2 s")


def test_sparse_tensors_are_refused():
    """Three numbers that claim to be a hundred billion."""
    values = helper.make_tensor("w", TensorProto.FLOAT, [1], [1.0])
    places = helper.make_tensor("i", TensorProto.INT64, [1], [0])
    sparse = helper.make_sparse_tensor(values, places, [10**11])
    refused(model_of(sparse=[sparse]), "sparse")
    refused(model_of(helper.make_node("Constant", [], ["unused"], sparse_value=sparse)), "sparse")


def kept_elsewhere(place, **said):
    """A tensor of four numbers that are somewhere else."""
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[4], **said)
    entries = {} if place is None else {"location": place, "offset": "0", "length": "16"}
    for key, value in entries.items():
        tensor.external_data.add(key=key, value=value)
    return tensor


def in_an_initializer(tensor):
    model = model_of(helper.make_node("Identity", ["w"], ["unused"]))
    model.graph.initializer.append(tensor)
    return model


def in_an_attribute(tensor):
    return model_of(helper.make_node("Constant", [], ["unused"], value=tensor))


def in_a_list_of_them(tensor):
    return model_of(helper.make_node("Identity", ["x"], ["unused"], values=[tensor]))


@pytest.mark.parametrize("within", [in_an_initializer, in_an_attribute, in_a_list_of_them])
@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("beside", TensorProto.EXTERNAL),
        ("../outside", TensorProto.EXTERNAL),
        ("/etc/passwd", TensorProto.EXTERNAL),
        ("*/_ORT_MEM_ADDR_/*", TensorProto.EXTERNAL),
        ("beside", TensorProto.DEFAULT),
        ("beside", None),
        (None, TensorProto.EXTERNAL),
    ],
)
def test_weights_elsewhere_are_refused_before_onnxruntime_sees_them(within, place, said, tmp_path, monkeypatch):
    """A file in the current folder, which some versions read; and onnxruntime's name for an address in memory."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "beside").write_bytes(bytes(16))
    model = within(kept_elsewhere(place, **({} if said is None else {"data_location": said})))
    with pytest.raises(DataError, match="weights are not within it"):
        check_operators(model.SerializeToString(), "net/model.onnx")


@pytest.mark.parametrize("within", [in_an_initializer, in_an_attribute])
def test_a_tensor_may_say_that_its_numbers_are_within(within):
    """As writers do that have brought them back from another file."""
    tensor = kept_elsewhere(None, raw_data=bytes(16), data_location=TensorProto.DEFAULT)
    assert tensor.HasField("data_location")
    session_of(within(tensor).SerializeToString(), "here")


def test_a_graph_in_two_pieces_is_read_whole():
    """Protobuf joins the two; whoever reads the first or the last only would miss the loop."""
    constants = (("trips", np.int64(1 << 60)), ("yes", np.array(1, bool)))
    loop = model_of(helper.make_node("Loop", ["trips", "yes"], [], body=body()), constants=constants)
    more = onnx.ModelProto()
    more.graph.name = "more"
    for data in (
        loop.SerializeToString() + more.SerializeToString(),
        more.SerializeToString() + loop.SerializeToString(),
    ):
        refused(data, "Loop")


@pytest.mark.parametrize(
    "data", [b"\x00", b"\x3a\x7f", b"\x3b", b"\x80" * 11, b"\x3a\x04\x0a\x02\x22\xff", b"ORTM" * 9]
)
def test_what_is_no_message_is_refused(data):
    refused(data, "cannot run")


def test_the_operators_are_those_that_onnx_reads(tmp_path):
    """The fields by their numbers, beside the package that knows their names."""
    data = (real_time(tmp_path, hidden=(8, 5)).folder / ONNX_NAME).read_bytes()
    check_operators(data, "here")
    assert {node.op_type for node in onnx.load_from_string(data).graph.node} <= PLAIN
    for name in zoo.names():
        for path in zoo.folder(name).glob("*.onnx"):
            check_operators(path.read_bytes(), str(path))


def test_every_plain_operator_is_one():
    known = {schema.name for schema in onnx.defs.get_all_schemas() if schema.domain == ""}
    assert known >= PLAIN
    with_graphs = {
        schema.name
        for schema in onnx.defs.get_all_schemas_with_history()
        if any(str(attribute.type).endswith(("GRAPH", "GRAPHS")) for attribute in schema.attributes.values())
    }
    assert with_graphs >= {"Loop", "If", "Scan"}
    assert not with_graphs & PLAIN
