"""One sample through a state augmentation transformer, as machine code; compiled by numba and kept on disk.

A graph's runtime pays for every node, and the step of this network has a hundred of them, most of which work on a few
numbers. Here, it is one call. The weights are those of `STEP_NAME` in the model's folder (`sat_weights.py`), where
layers that follow one another are merged already. Rows are joints side by side, so that a weight is read once for
all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from trueup.deploy.machine_code import machine_code

_f = np.float32
_EPSILON = _f(1e-5)  # of torch's normalization of layers
# NaN must stay NaN, so that an output that is none is seen.
_RULES: dict[str, Any] = {"fastmath": {"reassoc", "contract", "arcp", "nsz"}, "error_model": "numpy", "nogil": True}


_LANES = 8  # floats in a register
_FUSED = ("contract",)  # a product and a sum may be one operation


def _machine(function: Callable[..., Any]) -> Any:
    """With the rules of sums."""
    return machine_code(function, **_RULES)


def _tile(rows: int, registers: int) -> Any:
    """Code for y[:rows, :N] += x[:rows, :deep] w[:deep, :N], N = 8 registers: addresses, and floats between rows.

    All sums stay in registers, of which a CPU of today has 16: rows x registers + registers + 1 of them are needed.
    """

    def tile(_: Any, x: Any, x_row: Any, w: Any, w_row: Any, y: Any, y_row: Any, deep: Any) -> Any:  # noqa: ARG001
        return types.void(*[types.int64] * 7), _drawn

    def _drawn(context: Any, builder: Any, __: Any, given: Any) -> Any:
        x, x_row, w, w_row, y, y_row, deep = given
        scalar, lanes, whole = ir.FloatType(), ir.VectorType(ir.FloatType(), _LANES), ir.IntType(64)
        index, four, nothing = ir.IntType(32), ir.Constant(whole, 4), ir.Constant(lanes, ir.Undefined)

        def load(base: Any, place: Any, kind: Any) -> Any:
            address = builder.add(base, builder.mul(place, four))
            return builder.load(builder.inttoptr(address, kind.as_pointer()), align=4)

        places = [
            (row, builder.add(builder.mul(y_row, ir.Constant(whole, row)), ir.Constant(whole, _LANES * part)))
            for row in range(rows)
            for part in range(registers)
        ]
        sums = [cgutils.alloca_once_value(builder, load(y, place, lanes)) for _, place in places]
        with cgutils.for_range(builder, deep) as loop:
            start = builder.mul(loop.index, w_row)
            parts = [load(w, builder.add(start, ir.Constant(whole, _LANES * part)), lanes) for part in range(registers)]
            for row in range(rows):
                place = builder.add(builder.mul(x_row, ir.Constant(whole, row)), loop.index)
                one = builder.insert_element(nothing, load(x, place, scalar), index(0))
                spread = builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(index, _LANES), [0] * _LANES))
                for part in range(registers):
                    held = sums[registers * row + part]
                    product = builder.fmul(spread, parts[part], flags=_FUSED)
                    builder.store(builder.fadd(product, builder.load(held), flags=_FUSED), held)
        for (_row, place), held in zip(places, sums, strict=True):
            address = builder.add(y, builder.mul(place, four))
            builder.store(builder.load(held), builder.inttoptr(address, lanes.as_pointer()), align=4)
        return context.get_dummy_value()

    return intrinsic(tile)


def _noinline(_: Any) -> Any:
    def mark(context: Any, builder: Any, __: Any, ___: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), mark


# What it stands in is not copied to where it is called, which would take a minute to compile.
_apart: Any = intrinsic(_noinline)

_tile_6x16, _tile_2x32, _tile_1x64, _tile_1x16 = _tile(6, 2), _tile(2, 4), _tile(1, 8), _tile(1, 2)


def _ordered(function: Callable[..., Any]) -> Any:
    """Compiled for numbers none of which is NaN, so that the largest of many is found eight at a time."""
    return machine_code(function, fastmath=True, nogil=True)


@_ordered
def _largest(x: Any) -> Any:
    top = x[0]
    for j in range(x.size):
        top = max(top, x[j])
    return top


@_machine
def _exp(x: Any) -> Any:
    """The exponential function to float32's precision (Cephes), without a branch, so that loops of it are vectors."""
    x = min(max(x, _f(-87.0)), _f(88.0))
    n = np.floor(x * _f(1.44269504088896341) + _f(0.5))
    x = x - n * _f(0.693359375)
    x = x + n * _f(2.12194440e-4)
    y = _f(1.9875691500e-4)
    y = y * x + _f(1.3981999507e-3)
    y = y * x + _f(8.3334519073e-3)
    y = y * x + _f(4.1665795894e-2)
    y = y * x + _f(1.6666665459e-1)
    y = y * x + _f(5.0000001201e-1)
    y = y * x * x + x + _f(1.0)
    return y * np.int32((np.int32(n) + np.int32(127)) << np.int32(23)).view(np.float32)


@_machine
def _sigmoid(x: Any) -> Any:
    return _f(1.0) / (_f(1.0) + _exp(-x))


@_machine
def _elu(x: Any) -> Any:
    return x if x > _f(0.0) else _exp(x) - _f(1.0)


@_machine
def _bend(x: Any) -> Any:
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] = _elu(x[i, j])


@_machine
def _add_rest(x: Any, w: Any, y: Any, row: Any, j: Any) -> Any:
    """The same for one row from a column on."""
    _apart()
    deep, wide = w.shape
    from_x, from_y = x.ctypes.data + 4 * row * deep, y.ctypes.data + 4 * row * wide
    while j + 16 <= wide:
        _tile_1x16(from_x, deep, w.ctypes.data + 4 * j, wide, from_y + 4 * j, wide, deep)
        j += 16
    if j < wide:
        for k in range(deep):
            for column in range(j, wide):
                y[row, column] += x[row, k] * w[k, column]


@_machine
def _add_product(x: Any, w: Any, y: Any) -> Any:
    """Y += x w."""
    _apart()
    rows, deep = x.shape
    wide = w.shape[1]
    from_x, from_w, from_y = x.ctypes.data, w.ctypes.data, y.ctypes.data
    i = 0
    while i < rows:
        j = 0
        here_x, here_y = from_x + 4 * i * deep, from_y + 4 * i * wide
        if rows - i >= 6:
            step = 6
            while j + 16 <= wide:
                _tile_6x16(here_x, deep, from_w + 4 * j, wide, here_y + 4 * j, wide, deep)
                j += 16
        elif rows - i >= 2:
            step = 2
            while j + 32 <= wide:
                _tile_2x32(here_x, deep, from_w + 4 * j, wide, here_y + 4 * j, wide, deep)
                j += 32
        else:
            step = 1
            while j + 64 <= wide:
                _tile_1x64(here_x, deep, from_w + 4 * j, wide, here_y + 4 * j, wide, deep)
                j += 64
        if j < wide:
            for row in range(i, i + step):
                _add_rest(x, w, y, row, j)
        i += step


@_machine
def _dense(x: Any, w: Any, b: Any, y: Any) -> Any:
    """Y = x w + b."""
    for i in range(x.shape[0]):
        for j in range(b.size):
            y[i, j] = b[j]
    _add_product(x, w, y)


@_machine
def _gated(both: Any, skipped: Any, scale: Any, shift: Any, y: Any) -> Any:
    """What is led around, and the half of `both` that its other half lets pass, normalized."""
    _apart()
    wide, half = y.shape[1], both.shape[1] // 2
    share = _f(1.0) / _f(wide)
    for i in range(y.shape[0]):
        mean, square = _f(0.0), _f(0.0)
        for j in range(wide):
            value = skipped[i, j] + both[i, j] * _sigmoid(both[i, half + j])
            y[i, j] = value
            mean += value
        mean *= share
        for j in range(wide):
            square += (y[i, j] - mean) * (y[i, j] - mean)
        factor = _f(1.0) / np.sqrt(square * share + _EPSILON)
        for j in range(wide):
            y[i, j] = (y[i, j] - mean) * factor * scale[j] + shift[j]


@_machine
def _softmax(x: Any) -> Any:
    """A row, in place."""
    _apart()
    top = _largest(x)
    total = _f(0.0)
    for j in range(x.size):
        x[j] = _exp(x[j] - top)
        total += x[j]
    share = _f(1.0) / total
    for j in range(x.size):
        x[j] *= share


@_machine
def _taken(flat: Any, at: Any, rows: Any, columns: Any) -> Any:
    """The next matrix of the weights, and where it ends."""
    end = at + rows * columns
    return flat[at:end].reshape(rows, columns), end


@_machine
def _layer(x: Any, flat: Any, at: Any, y: Any) -> Any:
    """A dense layer, into y; returns where its weights end."""
    _apart()
    weight, at = _taken(flat, at, x.shape[1], y.shape[1])
    bias, at = _taken(flat, at, 1, y.shape[1])
    _dense(x, weight, bias[0], y)
    return at


@_machine
def _gate(x: Any, skipped: Any, flat: Any, at: Any, both: Any, y: Any) -> Any:
    """A gated layer around which `skipped` is led, into y; returns where its weights end."""
    _apart()
    at = _layer(x, flat, at, both)
    norm, at = _taken(flat, at, 2, y.shape[1])
    _gated(both, skipped, norm[0], norm[1], y)
    return at


@_machine
def _selected(x: Any, flat: Any, at: Any, width: Any, y: Any) -> Any:
    """Variable selection, into y; returns where its weights end. See `sat_weights`."""
    _apart()
    rows, variables = x.shape
    padded = 16 * ((variables + 15) // 16)
    said, both = np.empty((rows, width), np.float32), np.empty((rows, 2 * width), np.float32)
    at = _layer(x, flat, at, said)
    _bend(said)
    shares = np.empty((rows, variables), np.float32)
    at = _gate(said, x, flat, at, np.empty((rows, 2 * padded), np.float32), shares)
    spread, at = _taken(flat, at, variables, width)
    offset, at = _taken(flat, at, variables, width)
    inner, at = _taken(flat, at, variables * width, 2 * width)
    inner_bias, at = _taken(flat, at, variables, 2 * width)
    own, at = _taken(flat, at, 2, width)
    made = np.empty((rows, width), np.float32)
    for i in range(rows):
        _softmax(shares[i])
        for j in range(width):
            y[i, j] = _f(0.0)
    for v in range(variables):
        for i in range(rows):
            for j in range(width):
                said[i, j] = _elu(x[i, v] * spread[v, j] + offset[v, j])
        _dense(said, inner[v * width : (v + 1) * width], inner_bias[v], both)
        _gated(both, said, own[0], own[1], made)
        for i in range(rows):
            share = shares[i, v]
            for j in range(width):
                y[i, j] += share * made[i, j]
    return at


@_machine
def _remembered(x: Any, hidden: Any, cell: Any, flat: Any, at: Any, after: Any, kept: Any) -> Any:
    """One step of an LSTM from `hidden` and `cell` into `after` and `kept`; returns where its weights end."""
    _apart()
    rows, width = x.shape
    given, at = _taken(flat, at, width, 4 * width)
    again, at = _taken(flat, at, width, 4 * width)
    bias, at = _taken(flat, at, 1, 4 * width)
    gates = np.empty((rows, 4 * width), np.float32)
    _dense(x, given, bias[0], gates)
    _add_product(hidden, again, gates)
    two = _f(2.0)
    for i in range(rows):
        for j in range(width):
            candidate = two * _sigmoid(two * gates[i, 2 * width + j]) - _f(1.0)
            value = _sigmoid(gates[i, width + j]) * cell[i, j] + _sigmoid(gates[i, j]) * candidate
            kept[i, j] = value
            after[i, j] = _sigmoid(gates[i, 3 * width + j]) * (two * _sigmoid(two * value) - _f(1.0))
    return at


@_machine
def _seen(query: Any, key: Any, value: Any, keys: Any, values: Any, lag: Any, history: Any, oldest: Any, y: Any) -> Any:
    """What one row sees of its history and of itself: the mean of the heads' weights over values that they share.

    Args:
        query: scaled, (heads, W / heads).
        key: of the present sample, (heads, W / heads).
        value: likewise, (W / heads,).
        keys: of the history, (heads, W / heads, places), in which `oldest` is the place of the oldest.
        values: likewise, (places, W / heads).
        lag: a bias for each head and age, the oldest first, (heads, history + 1).
        history: how many of the places are used.
        oldest: see `keys`.
        y: what is seen, (1, W / heads).
    """
    _apart()
    heads, inner = query.shape
    places = values.shape[0]
    total, found = np.zeros((1, places), np.float32), np.zeros((1, places), np.float32)
    scores, counted = found[0], total[0]
    after, total_own = history - oldest, _f(0.0)
    for head in range(heads):
        for s in range(oldest):
            scores[s] = lag[head, after + s]
        for s in range(after):
            scores[oldest + s] = lag[head, s]
        _add_product(query[head : head + 1], keys[head], found)
        own = lag[head, history]
        for j in range(inner):
            own += query[head, j] * key[head, j]
        top = max(_largest(scores[:history]), own)
        own = _exp(own - top)
        summed = own
        for s in range(history):
            scores[s] = _exp(scores[s] - top)
            summed += scores[s]
        share = _f(1.0) / (summed * _f(heads))
        for s in range(history):
            counted[s] += share * scores[s]
        total_own += share * own
    for j in range(inner):
        y[0, j] = total_own * value[j]
    _add_product(total, values, y)


@_machine
def _read(raw: Any, flat: Any, at: Any, stops: Any, x: Any) -> Any:
    """Samples as the network reads them: normalized, and how near they are to their limits; see `Corrector.read`."""
    rows, channels = raw.shape
    scaling, at = _taken(flat, at, 3, channels)
    near, at = _taken(flat, at, 3, stops)
    for i in range(rows):
        for j in range(channels):
            other = int(scaling[2, j])
            value = raw[i, j] - raw[i, other] if other >= 0 else raw[i, j]
            x[i, j] = (value - scaling[0, j]) * scaling[1, j]
        for j in range(stops):
            value = (raw[i, int(near[0, j])] - near[1, j]) * near[2, j]
            x[i, channels + j] = min(max(value, _f(0.0)), _f(2.0))
    return at


@_machine
def advance(
    raw: Any,
    corrected: Any,
    flat: Any,
    sizes: Any,
    place: Any,
    fed: Any,
    before: Any,
    memory: Any,
    keys: Any,
    values: Any,
) -> Any:
    """One sample; the encoder reads the one before it, then the decoder this one.

    Args:
        raw: inputs, SI, (B, I).
        corrected: outputs, SI, (B, K).
        flat: all weights after one another; see `sat_weights.Sizes.shapes`.
        sizes: (I, stops, K, W, heads, history, whether the encoder is told predictions).
        place: of the oldest sample in the rings, which is overwritten.
        fed: what the encoder is told of the error after the sample before, (B, K); overwritten by the next.
        before: what the network read of the sample before, (B, I + stops); overwritten by this one.
        memory: hidden state and cell of the encoder, (2, B, W); overwritten.
        keys: rings of the history, (B, heads, W / heads, places), of whose places `history` are used.
        values: likewise, (B, places, W / heads).
    """
    inputs, stops, outputs, width, heads, history, own = sizes
    rows, inner = raw.shape[0], width // heads
    x = np.empty((rows, inputs + stops), np.float32)
    at = _read(raw, flat, 0, stops, x)
    inputs += stops
    pair = np.empty((rows, inputs + outputs), np.float32)
    for i in range(rows):
        for j in range(inputs):
            pair[i, j] = before[i, j]
            before[i, j] = x[i, j]
        for j in range(outputs):
            pair[i, inputs + j] = fed[i, j]
    past, now = np.empty((rows, width), np.float32), np.empty((rows, width), np.float32)
    at = _selected(pair, flat, at, width, past)
    at = _selected(x, flat, at, width, now)
    both, made = np.empty((rows, 2 * width), np.float32), np.empty((rows, width), np.float32)
    decoded, kept = np.empty((rows, width), np.float32), np.empty((rows, width), np.float32)
    at = _remembered(past, memory[0], memory[1], flat, at, made, kept)
    for i in range(rows):
        for j in range(width):
            memory[0, i, j], memory[1, i, j] = made[i, j], kept[i, j]
    at = _remembered(now, memory[0], memory[1], flat, at, decoded, kept)
    at = _gate(memory[0], past, flat, at, both, past)
    at = _gate(decoded, now, flat, at, both, now)
    kept_past, kept_now = np.empty((rows, width + inner), np.float32), np.empty((rows, width + inner), np.float32)
    _layer(past, flat, at, kept_past)
    at = _layer(now, flat, at, kept_now)
    at = _layer(now, flat, at, made)
    lag, at = _taken(flat, at, heads, history + 1)
    seen = np.empty((rows, inner), np.float32)
    oldest = place + 1 if place + 1 < history else 0
    for i in range(rows):
        for head in range(heads):
            for j in range(inner):
                keys[i, head, j, place] = kept_past[i, head * inner + j]
        for j in range(inner):
            values[i, place, j] = kept_past[i, width + j]
        _seen(
            made[i].reshape(heads, inner),
            kept_now[i, :width].reshape(heads, inner),
            kept_now[i, width:],
            keys[i],
            values[i],
            lag,
            history,
            oldest,
            seen[i : i + 1],
        )
    at = _gate(seen, now, flat, at, both, past)
    at = _layer(past, flat, at, made)
    _bend(made)
    at = _gate(made, past, flat, at, both, decoded)
    at = _gate(decoded, now, flat, at, both, past)
    y = np.empty((rows, 16 * ((outputs + 15) // 16)), np.float32)
    at = _layer(past, flat, at, y)
    added, at = _taken(flat, at, 4, outputs)
    for i in range(rows):
        for j in range(outputs):
            fed[i, j] = y[i, j] if own else _f(0.0)
            corrected[i, j] = raw[i, int(added[0, j])] * added[1, j] + added[2, j] + added[3, j] * y[i, j]
    return at
