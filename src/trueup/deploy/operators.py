"""What a graph of a model folder may do, read from its bytes before onnxruntime sees them.

A robot has onnxruntime and not the package `onnx`, so the few fields that matter are read here: nodes, their operators
and attributes. What is no such message to the letter is refused: nothing means one thing here and another there.

Operators are those of a list, not all but those of another list: each version of onnxruntime brings some that run a
graph of their own (beam search, say), and what is not known can be bounded by nobody. None of these calls a graph, and
how large their results are follows from the shapes of the inputs alone, or is no more than an input was cut to: so what
`trial` finds out once bounds all that follows.

Tensors are within the graph. Of one that says that its numbers are in another file, or at an address in memory, which
onnxruntime knows, too, it depends on onnxruntime's version what is read: here, none is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from trueup.errors import DataError

# Results that grow with numbers, not with shapes only, and from which input on the numbers are.
SIZED = {"ConstantOfShape": 0, "Expand": 1, "OneHot": 1, "Pad": 1, "Range": 0, "Tile": 1}
# Results whose size is within that of an input, but follows from numbers, from which input on.
_CUT = {
    "NonZero": 0,
    "Compress": 1,
    "Reshape": 1,
    "Slice": 1,
    "Split": 1,
    "Squeeze": 1,
    "TopK": 1,
    "Unsqueeze": 1,
    **dict.fromkeys(
        ("ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp", "ReduceMax", "ReduceMean", "ReduceMin"), 1
    ),
    **dict.fromkeys(("ReduceProd", "ReduceSum", "ReduceSumSquare"), 1),
}
_NAMES = """
    Abs Acos Acosh Add And ArgMax ArgMin Asin Asinh Atan Atanh Attention AveragePool BatchNormalization BitShift
    BitwiseAnd BitwiseNot BitwiseOr BitwiseXor Cast CastLike Ceil Celu Clip Compress Concat Constant Conv ConvInteger
    ConvTranspose Cos Cosh CumProd CumSum DepthToSpace DequantizeLinear Det Div Dropout DynamicQuantizeLinear Einsum
    Elu Equal Erf Exp EyeLike Flatten Floor GRU Gather GatherElements GatherND Gelu Gemm GlobalAveragePool
    GlobalLpPool GlobalMaxPool Greater GreaterOrEqual GridSample GroupNormalization HardSigmoid HardSwish Hardmax
    Identity InstanceNormalization IsInf IsNaN LRN LSTM LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax
    LpNormalization LpPool MatMul MatMulInteger Max MaxPool Mean MeanVarianceNormalization Min Mish Mod Mul Neg
    NonZero Not Or PRelu Pow QLinearConv QLinearMatMul QuantizeLinear RMSNormalization RNN Reciprocal ReduceL1
    ReduceL2 ReduceLogSum ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu
    Reshape ReverseSequence RotaryEmbedding Round ScatterElements ScatterND Selu Shape Shrink Sigmoid Sign Sin Sinh
    Size Slice Softmax Softplus Softsign SpaceToDepth Split Sqrt Squeeze Sub Sum Swish Tan Tanh ThresholdedRelu TopK
    Transpose Trilu Unsqueeze Where Xor
"""
PLAIN = frozenset(_NAMES.split()) | frozenset(SIZED)

# Numbers of the fields in onnx.proto, which never change.
_MODEL_GRAPH, _MODEL_FUNCTIONS = 7, 25
_GRAPH_NODE, _GRAPH_INITIALIZER, _GRAPH_SPARSE, _TENSOR_NAME = 1, 5, 15, 8
_NODE_INPUT, _NODE_OUTPUT, _NODE_OPERATOR, _NODE_ATTRIBUTE, _NODE_DOMAIN = 1, 2, 4, 5, 7
_ATTRIBUTE_GRAPHS = (6, 11)
# A sparse tensor of three numbers may claim any size, and is made dense when it is read.
_ATTRIBUTE_SPARSE = (22, 23)
_ATTRIBUTE_TENSORS = (5, 10)
# Where a tensor is whose numbers are not within: in another file, or at an address of this process.
_TENSOR_PLACE, _TENSOR_IS_ELSEWHERE = 13, 14
_VARINT, _EIGHT_BYTES, _TEXT, _FOUR_BYTES = 0, 1, 2, 5
_MOST_TAG = 1 << 32


@dataclass(frozen=True)
class _Node:
    operator: str
    domain: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    graphs: bool
    sparse: bool
    elsewhere: bool


def check_operators(data: bytes, where: str) -> None:
    """Refuse a graph that could do more than a network needs.

    Args:
        data: of an ONNX model.
        where: for messages.

    Raises:
        DataError: it is no such model; it has functions or graphs within, operators that are not of the list, sparse
            tensors, tensors that are kept elsewhere, or results as large as a number that comes in.
    """
    try:
        parts = _Parts.of(data)
    except (ValueError, IndexError) as error:
        raise DataError(f"onnxruntime cannot run {where}", got=error, expected="an ONNX model") from error
    strange = Counter(
        f"{node.domain}.{node.operator}" if node.domain else node.operator
        for node in parts.nodes
        if node.domain not in ("", "ai.onnx") or node.operator not in PLAIN or node.graphs
    )
    if parts.functions:
        strange["functions of its own"] = parts.functions
    if strange:
        raise DataError(
            f"{where} is not run: a network may not have operators of its own, loops or branches",
            got=sorted(strange),
            expected="plain operators of ONNX",
            hint="trueup.deploy.operators.PLAIN lists them. Export the network without the others.",
        )
    if parts.sparse or any(node.sparse for node in parts.nodes):
        raise DataError(f"{where} is not run", got="sparse tensors", expected="dense ones")
    if parts.elsewhere or any(node.elsewhere for node in parts.nodes):
        raise DataError(
            f"{where} is not run: its weights are not within it",
            got="tensors in other files",
            expected="all numbers in the graph, whose hash stands in the card",
            hint="Export it without external data.",
        )
    _check_sizes(parts, where)


def _check_sizes(parts: _Parts, where: str) -> None:
    """No result is as large as a number that depends on what comes in, nor as the shape of one that was cut by it."""
    known = {"", *parts.constants}
    loose: set[str] = set()  # values whose shapes follow from numbers that come in
    for node in parts.nodes:  # in an order in which each can be computed, or onnxruntime refuses them
        if not (known - {""}).isdisjoint(node.outputs):
            raise DataError(f"onnxruntime cannot run {where}", got=f"two values named {node.outputs}")
        first, cut = SIZED.get(node.operator), _CUT.get(node.operator)
        if first is not None and not known.issuperset(node.inputs[first:]):
            raise DataError(
                f"{where} is not run: {node.operator} makes something as large as its input says",
                got=[name for name in node.inputs[first:] if name not in known],
                expected="sizes from constants and shapes",
            )
        if known.issuperset(node.inputs):
            known.update(node.outputs)
        elif not loose.isdisjoint(node.inputs) or (cut is not None and not known.issuperset(node.inputs[cut:])):
            loose.update(node.outputs)
        elif node.operator in ("Shape", "Size"):
            known.update(node.outputs)


@dataclass(frozen=True)
class _Parts:
    """Of a model; fields that come several times are read each time, as protobuf merges them."""

    nodes: tuple[_Node, ...]
    constants: frozenset[str]
    functions: int
    sparse: int
    elsewhere: bool

    @staticmethod
    def of(data: bytes) -> _Parts:
        view = memoryview(data)
        models = list(_fields(view))
        graphs = [item for number, graph in models if number == _MODEL_GRAPH for item in _fields(graph)]
        tensors = [part for number, part in graphs if number == _GRAPH_INITIALIZER]
        return _Parts(
            nodes=tuple(_node(part) for number, part in graphs if number == _GRAPH_NODE),
            constants=frozenset(
                _text(value) for part in tensors for field, value in _fields(part) if field == _TENSOR_NAME
            ),
            functions=sum(number == _MODEL_FUNCTIONS for number, _ in models),
            sparse=sum(number == _GRAPH_SPARSE for number, _ in graphs),
            elsewhere=any(map(_is_elsewhere, tensors)),
        )


def _node(data: memoryview) -> _Node:
    fields = list(_fields(data))

    def texts(wanted: int) -> tuple[str, ...]:
        return tuple(_text(value) for number, value in fields if number == wanted)

    attributes = [item for number, value in fields if number == _NODE_ATTRIBUTE for item in _fields(value)]
    inner = {field for field, _ in attributes}
    return _Node(
        operator=(texts(_NODE_OPERATOR) or ("",))[-1],
        domain=(texts(_NODE_DOMAIN) or ("",))[-1],
        inputs=texts(_NODE_INPUT),
        outputs=texts(_NODE_OUTPUT),
        graphs=not inner.isdisjoint(_ATTRIBUTE_GRAPHS),
        sparse=not inner.isdisjoint(_ATTRIBUTE_SPARSE),
        elsewhere=any(_is_elsewhere(value) for field, value in attributes if field in _ATTRIBUTE_TENSORS),
    )


def _is_elsewhere(tensor: memoryview) -> bool:
    """Whether a tensor names another place for its numbers; writers of ONNX may say that it does not."""
    return any(
        number == _TENSOR_PLACE or (number == _TENSOR_IS_ELSEWHERE and any(byte & 0x7F for byte in value))
        for number, _, value in _all_fields(tensor)
    )


def _text(data: memoryview) -> str:
    return bytes(data).decode()


def _fields(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Number and content of each field with a length in a protobuf message; numbers are passed over."""
    return ((number, value) for number, kind, value in _all_fields(data) if kind == _TEXT)


def _all_fields(data: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Number, kind and content of each field of a protobuf message; of a number, the bytes that it is written in."""
    place = 0
    while place < len(data):
        tag, place = _varint(data, place)
        number, kind = tag >> 3, tag & 7
        if number == 0 or tag >= _MOST_TAG:
            raise ValueError("no protobuf message")
        begin = place
        if kind == _VARINT:
            _, place = _varint(data, place)
        elif kind == _TEXT:
            size, place = _varint(data, place)
            if size > len(data) - place:
                raise ValueError("cut short")
            begin, place = place, place + size
        elif kind in (_EIGHT_BYTES, _FOUR_BYTES):
            place += 8 if kind == _EIGHT_BYTES else 4
        else:
            raise ValueError("groups, which ONNX does not have")
        yield number, kind, data[begin:place]


def _varint(data: memoryview, place: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
    raise ValueError("a number of more than ten bytes")
