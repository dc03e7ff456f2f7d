"""What an attacker, a disk or a tired person does to a folder of files; every change is a function of the generator."""

from __future__ import annotations

import functools
import io
import json
import os
import random
import re
import struct
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml

HOSTILE = [
    b"", b"\x00", b"\n", b"\r", b"\r\n\r\n", b",", b'"', b'""', b"'", b"[", b"]", b"[[[[", b"{", b"}", b":", b"- ", b"\t",
    b"nan", b"NaN", b"inf", b"-Infinity", b"null", b"true", b"1e999", b"-1e308", b"1e308", b"9" * 400, b"0x1p3", b"-1",
    b"1_000", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", "é".encode("latin-1"), "٣".encode(), "\u2028\u202e".encode(),
    b"[" * 3000, b'{"a":' * 3000, b"!!python/object/apply:os.getcwd []", b"!!binary x", b"!!int x", b"&a [*a]",
    b"*a", b"<<: 1", b"2001-99-99", b"../../etc/passwd", b"/etc/passwd", b"%s%n", b"{n}", b"(?P<a>", b"(a+)+$", b"\x1b[2J",
    b"A" * 70_000, "\U0001f916".encode() * 50,
    b"&a [x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b]\nd: [*c,*c,*c,*c,*c,*c,*c]",
]  # fmt: skip
NUMBERS = [
    *(
        b"0",
        b"-0.0",
        b"-1",
        b"1",
        b"2",
        b"7",
        b"1e999",
        b"-1e999",
        b"1e308",
        b"-1e308",
        b"5e-324",
        b"nan",
        b"NaN",
        b"inf",
    ),
    *(
        b"9223372036854775808",
        b"4294967296",
        b"1e18",
        b"1000000",
        b"-7",
        b'"1"',
        b"'2'",
        b"0x10",
        b"1_0",
        b"1,5",
        b"true",
    ),
    *(b"", b"null", b"9" * 5000, b"3.0000000001"),
]
VALUES: list[Any] = [
    *(None, True, False, 0, -1, 1, 2, 10**6, 2**31, 2**63, 10**400, -0.0, 0.5, 1e-300, 1e18, 1e308, -1e308),
    *(
        float("nan"),
        float("inf"),
        float("-inf"),
        "",
        "1",
        "nan",
        "e000",
        "é",
        "\x00",
        "\x1b[31m",
        "a\nb",
        "../x",
        "/etc/passwd",
    ),
    *(
        "x" * 20_000,
        "\ud800",
        "\u202e",
        "rad",
        "deg",
        "all",
        [],
        {},
        [[]],
        [None],
        [1, "a"],
        {"": 1},
        {"a": {"b": [1]}},
    ),
    *([0.0] * 3, [1, 2], [1e308] * 7, ["a", "a"], list(range(300)), {str(k): k for k in range(100)}),
]
WORDS = [b"", b"a", b"__class__", b"..", b"\x00", "ü".encode(), b"x" * 500, b"position", b"mass", b"nan", b"on", b"~"]
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*")
Edit = Callable[[bytes, random.Random], bytes]


def _span(data: bytes, rng: random.Random) -> tuple[int, int]:
    start = rng.choice(
        (
            rng.randrange(len(data) + 1),
            rng.randrange(max(0, len(data) - 200), len(data) + 1),
            rng.randrange(min(200, len(data) + 1)),
        )
    )
    return start, min(len(data), start + rng.choice((1, 1, 2, 4, 8, 40, 512, 1 << 20)))


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8)) if data else 0):
        changed[min(_span(data, rng)[0], len(data) - 1)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _overwrite(data: bytes, rng: random.Random) -> bytes:
    """Lengths and counts of binary formats, in their favorite sizes."""
    kind = rng.choice("BHIQ")
    top = 1 << 8 * struct.calcsize(kind)
    value = rng.choice((0, 1, top - 1, top >> 1, (top >> 1) - 1, rng.randrange(top), rng.randrange(256)))
    new = struct.pack(rng.choice("<>") + kind, value)
    start = _span(data, rng)[0]
    return data[:start] + new + data[start + len(new) :]


def _insert(data: bytes, rng: random.Random) -> bytes:
    start = _span(data, rng)[0]
    return data[:start] + rng.choice((rng.choice(HOSTILE), rng.randbytes(rng.randrange(20)))) + data[start:]


def _remove(data: bytes, rng: random.Random) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def _repeat(data: bytes, rng: random.Random) -> bytes:
    start, end = _span(data, rng)
    return data[:end] + data[start:end] * rng.choice((1, 1, 3)) + data[end:]


def _blank(data: bytes, rng: random.Random) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + rng.choice((b"\0", b"\xff", b" ")) * (end - start) + data[end:]


def _swap(data: bytes, rng: random.Random) -> bytes:
    (a, b), (c, d) = sorted((_span(data, rng), _span(data, rng)))
    b = min(b, c)
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _whole(data: bytes, rng: random.Random) -> bytes:
    return rng.choice((rng.choice(HOSTILE), rng.randbytes(min(len(data), 4096)), data + data, data + rng.randbytes(20)))


_BYTES: list[Edit] = [
    *(_flip, _flip, _overwrite, _overwrite, _insert, _remove, _repeat, _blank, _swap, _whole),
    lambda data, rng: data[: rng.randrange(len(data) + 1)],
]


def _lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(5)
    if kind == 0:
        lines[k], lines[j] = lines[j], lines[k]
    elif kind == 1:
        lines.insert(j, lines[k])
    elif kind == 2:
        del lines[k]
    elif kind == 3:
        rng.shuffle(lines)
    else:
        lines[k] = lines[k].rstrip(b"\r\n") + rng.choice((b"", b"\r", b"\r\n", b"\n\n", b",\n", b" \n"))
    return b"".join(lines)


def _replace(pattern: re.Pattern[bytes], new: Callable[[bytes, random.Random], bytes]) -> Edit:
    def edit(data: bytes, rng: random.Random) -> bytes:
        found = list(pattern.finditer(data))
        if not found:
            return _insert(data, rng)
        one = rng.choice(found)
        return data[: one.start()] + new(one[0], rng) + data[one.end() :]

    return edit


def _encode(data: bytes, rng: random.Random) -> bytes:
    return data.decode("utf-8", "replace").encode(rng.choice(("utf-16", "utf-8-sig", "utf-32", "cp500")), "replace")


_TEXT: list[Edit] = [
    *(_lines, _lines, _encode),
    *[_replace(_NUMBER, lambda _, rng: rng.choice(NUMBERS))] * 3,
    _replace(_NUMBER, lambda old, rng: old * rng.choice((2, 10)) if rng.random() < 0.5 else b"-" + old),
    _replace(_WORD, lambda old, rng: rng.choice((*WORDS, old.upper(), old + b"2", b"'" + old + b"'"))),
    _replace(re.compile(rb"[,;:\t ]"), lambda _, rng: rng.choice((b",", b";", b"", b"\t", b",,", b" "))),
    _replace(re.compile(rb"[\[\](){}<>\"']"), lambda old, rng: rng.choice((b"", old * 2, b"[", b'"', b"'", b"}"))),
]


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) of a tree."""
    found, todo = [], [tree]
    while todo:
        node = todo.pop()
        own = list(node.items()) if isinstance(node, dict) else list(enumerate(node)) if isinstance(node, list) else []
        found += [(node, key) for key, _ in own]
        todo += [value for _, value in own]
    return found


def edit_tree(tree: Any, rng: random.Random) -> Any:
    """A tree of JSON values with a few changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        places = _places(tree)
        if not places or rng.random() < 0.02:
            return rng.choice((deepcopy(rng.choice(VALUES)), [tree], {"a": tree}))
        node, key = rng.choice(places)
        kind = rng.randrange(10)
        if kind == 0:
            del node[key]
        elif kind == 1 and isinstance(node, dict):
            node[rng.choice((str(key) + "2", str(key).upper(), "", "x", "schema", "\x1b", "y" * 5000))] = node.pop(key)
        elif kind == 2 and isinstance(node, list):
            node.insert(key, deepcopy(node[key]))
        elif kind == 3:
            other, place = rng.choice(places)
            node[key] = deepcopy(other[place])
        elif kind == 4:
            value = node[key]
            as_text = str(value)
            retyped = [as_text, [value], {"a": value}, len(as_text), value == value]
            node[key] = rng.choice(retyped)
        elif kind == 5 and isinstance(node[key], int | float) and not isinstance(node[key], bool):
            scale = rng.choice((-1, 0, 10, 1e6, 1e-9, 1e200))
            node[key] = float(node[key]) * scale if abs(node[key]) < 1e100 else 0
        elif kind == 6 and isinstance(node, dict):
            node[rng.choice(("extra", "nan", "name", "id", "unit"))] = deepcopy(rng.choice(VALUES))
        else:
            node[key] = deepcopy(rng.choice(VALUES))
    return tree


def _json(data: bytes, rng: random.Random) -> bytes:
    return json.dumps(edit_tree(json.loads(data), rng)).encode("utf-8", "surrogatepass")


def _yaml(data: bytes, rng: random.Random) -> bytes:
    return yaml.safe_dump(edit_tree(yaml.safe_load(data), rng), allow_unicode=True, sort_keys=False).encode(
        "utf-8", "surrogatepass"
    )


_ENTITIES = '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb">' + "".join(
    f'<!ENTITY {name} "{8 * f"&{before};"}">' for before, name in zip("bcde", "cdef", strict=True)
)
_XML = [
    f"{_ENTITIES}]>\n<a>&f;&f;&f;&f;&f;&f;&f;&f;</a>",
    '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n<robot name="&x;"/>',
    "<mujoco>" * 2000,
]
_XML_PIECES = [
    '<include file="/etc/passwd"/>', '<include file="../outside/sentinel"/>', '<mesh name="m" file="/etc/passwd"/>',
    '<mesh file="../../../../../../etc/shadow"/>', '<texture name="t" type="2d" builtin="flat" width="60000" height="60000"/>',
    '<hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/>', '<size memory="200G"/>', '<size njmax="2000000000"/>',
    '<replicate count="100000000"><body><geom size="1" mass="1"/></body></replicate>', '<option timestep="1e-12"/>',
    '<composite type="cable" prefix="c" count="2000000 1 1" size="1"/>', '<body><freejoint/></body>', '<option timestep="-1"/>',
    '<flexcomp name="f" type="grid" count="3000 3000 3000" spacing=".1 .1 .1"/>', '<plugin plugin="x"/>', '<geom type="mesh" mesh="no"/>',
    '<compiler meshdir="/etc" autolimits="false"/>', '<inertial pos="0 0 0" mass="-1" diaginertia="1 1 -9"/>', '<keyframe><key qpos="nan"/></keyframe>',
    '<joint name="dup" type="hinge" axis="0 0 0"/>', '<user_data size="1e10"/>', '<numeric name="n" size="2000000000"/>',
]  # fmt: skip


def _xml(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.03:
        return rng.choice(_XML).encode()
    root = ET.fromstring(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        parents = [node for node in root.iter() if len(node)] or [root]
        node, parent = rng.choice(list(root.iter())), rng.choice(parents)
        kind = rng.randrange(8)
        if kind == 0 and len(parent):
            parent.remove(rng.choice(list(parent)))
        elif kind == 1 and len(parent):
            parent.append(rng.choice(list(parent)))
        elif kind == 2:
            piece = ET.fromstring(rng.choice(_XML_PIECES))
            if rng.random() < 0.7:  # where it belongs
                section = ET.Element("asset") if piece.tag in ("mesh", "texture", "hfield") else None
                home = "body" if piece.tag in ("replicate", "composite", "flexcomp", "body", "joint") else root.tag
                parent = next(iter(root.iter(home)), root)
                if section is not None:
                    section.append(piece)
                    piece = section
            parent.insert(rng.randrange(len(parent) + 1), piece)
        elif kind == 3:
            node.tag = rng.choice(("body", "geom", "link", "joint", "x", node.tag + "2", "mujoco", "robot", "default"))
        elif kind == 4 and node.attrib:
            del node.attrib[rng.choice(list(node.attrib))]
        elif node.attrib:
            name = rng.choice(list(node.attrib))
            words = node.attrib[name].split()
            new = rng.choice(
                (*NUMBERS, b"1 2", b"-1 -1 -1", b"0 0 0", b"../x", b"/etc/passwd", b"a" * 3000, b"\xc3\xa9", b"world")
            ).decode()
            if words and rng.random() < 0.6:
                words[rng.randrange(len(words))] = new
            node.attrib[name] = " ".join(words) if words and rng.random() < 0.8 else new
    return ET.tostring(root)


@functools.cache
def _zip_bomb(kind: int) -> bytes:
    """1.5 GB of zeros in 1.5 MB; honest, or as a stream that claims less."""
    packed = io.BytesIO()
    with (
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("measured.time_s.npy", "w") as file,
    ):
        size = 1_500_000_000
        text = str(
            {"descr": "|u1" if kind else "<f8", "fortran_order": False, "shape": (size if kind else size // 8,)}
        ).encode()
        file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + 1) + text + b"\n")
        block = bytes(10_000_000)
        for _ in range(size // len(block)):
            file.write(block)
    return packed.getvalue()


def _npz(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.001:
        return _zip_bomb(rng.randrange(2))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice(list(entries))
        kind = rng.randrange(6)
        if kind == 0:
            del entries[name]
        elif kind == 1:
            entries[rng.choice((name.upper(), "../" + name, "/tmp/x.npy", "joints.npy", "a" * 300, "", "x"))] = entries[
                name
            ]
        elif kind == 2:
            other = rng.choice(list(entries))
            entries[name], entries[other] = entries[other], entries[name]
        elif kind == 3:
            head = rng.choice(
                (b"(1000000000000,)", b"(-1,)", b"(0,)", b"()", b"(12, 2, 1)", b"(2**70,)", b"[" * 500, b"(3,)")
            )
            entries[name] = re.sub(rb"\((?:\d+,?)* ?(?:\d+)?\)", lambda _, head=head: head, entries[name], count=1)
        elif kind == 4:
            new = rng.choice(
                (
                    b"'|O'",
                    b"'<f2'",
                    b"'<c16'",
                    b"'|S3'",
                    b"'<M8[s]'",
                    b"[('a','<f8')]",
                    b"'<U99999999'",
                    b"'>f8'",
                    b"'|b1'",
                    b"''",
                )
            )
            entries[name] = re.sub(rb"'[<>|=][a-zA-Z]\d+'", lambda _, new=new: new, entries[name], count=1)
        else:
            entries[name] = rng.choice(_BYTES)(entries[name], rng)
        if not entries:
            break
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return packed.getvalue()


@functools.cache
def _parquet_bomb(schema: Any, width: int, kind: str) -> bytes:
    """Much that costs nothing on disk: 1.6 GB of zeros in some kB, one text for 10 GB of rows, or lists without end."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows, groups = {"rows": (1_000_000, 200 // width + 1), "texts": (100_000, 1), "lists": (1, 20)}[kind]
    long = 20_000_000

    def column(field: Any) -> Any:
        if pa.types.is_integer(field.type) or pa.types.is_floating(field.type):
            return pa.array(np.zeros(rows, field.type.to_pandas_dtype()))
        if kind == "texts" and pa.types.is_string(field.type):
            return pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), ["x" * 100_000])
        if kind == "lists" and pa.types.is_list(field.type) and pa.types.is_floating(field.type.value_type):
            return pa.ListArray.from_arrays([0, long], np.zeros(long, field.type.value_type.to_pandas_dtype()))
        return pa.nulls(rows, field.type)

    table = pa.table([column(field) for field in schema], names=schema.names).replace_schema_metadata(schema.metadata)
    out = io.BytesIO()
    with pq.ParquetWriter(out, table.schema, compression="zstd", store_schema=False) as writer:
        for _ in range(groups):
            writer.write_table(table)
        writer.add_key_value_metadata(schema.metadata or {})
    return out.getvalue()


def _parquet(data: bytes, rng: random.Random) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    metadata = pq.ParquetFile(io.BytesIO(data)).metadata
    groups = [metadata.row_group(k) for k in range(min(1, metadata.num_row_groups))]
    if any(group.column(k).num_values >= 100_000 for group in groups for k in range(group.num_columns)):
        return data  # a bomb already: it takes minutes to make another of it
    table = pq.read_table(io.BytesIO(data))
    if rng.random() < 0.001:
        return _parquet_bomb(table.schema, len(table.schema), rng.choice(("rows", "texts", "lists")))
    metadata = table.schema.metadata
    for _ in range(rng.choice((1, 1, 2))):
        k = rng.randrange(table.num_columns)
        field = table.schema.field(k)
        values = table.column(k).to_pylist()
        kind = rng.randrange(7)
        if kind == 0 and table.num_columns > 1:
            table = table.remove_column(k)
        elif kind == 1:
            table = table.set_column(k, rng.choice((field.name + "2", "id", "")), table.column(k))
        elif kind == 2:
            order = [rng.randrange(len(table)) for _ in range(rng.randrange(len(table) + 2))] if len(table) else []
            table = table.take(pa.array(order, pa.int64()))
        elif kind == 3 and metadata:
            key = rng.choice(list(metadata))
            new = rng.choice((*_BYTES, *_TEXT))(metadata[key], rng)
            if metadata[key][:1] == b"{" and rng.random() < 0.7:
                new = _json(metadata[key], rng)
            metadata = rng.choice(({**metadata, key: new}, {**metadata, key: new}, {}))
            table = table.replace_schema_metadata(metadata)
        elif kind == 4:
            new_type = rng.choice(
                (pa.string(), pa.float64(), pa.int8(), pa.float16(), pa.list_(pa.float64()), pa.binary(), pa.null())
            )
            try:
                column = table.column(k).cast(new_type, safe=False)
            except pa.ArrowException:
                column = pa.nulls(len(table), new_type)
            table = table.set_column(k, field.name, column)
        elif values:
            row = rng.randrange(len(values))
            new = edit_tree({"a": values[row]}, rng)
            values[row] = new.get("a") if isinstance(new, dict) else None
            try:
                table = table.set_column(k, pa.field(field.name, field.type), pa.array(values, field.type))
            except (pa.ArrowException, TypeError, ValueError, OverflowError):
                values[row] = None
                table = table.set_column(k, pa.field(field.name, field.type), pa.array(values, field.type))
    out = io.BytesIO()
    pq.write_table(
        table, out, row_group_size=rng.choice((None, 1, 3)), compression=rng.choice(("zstd", "none", "gzip"))
    )
    return out.getvalue()


@functools.cache
def _deflated_zeros() -> bytes:
    """1.5 GB of them in 1.5 MB."""
    packer = zlib.compressobj(9)
    block = bytes(10_000_000)
    return b"".join([*(packer.compress(block) for _ in range(150)), packer.flush()])


def _hdf5(data: bytes, rng: random.Random) -> bytes:
    import h5py
    import numpy as np

    stream = io.BytesIO(data)
    with h5py.File(stream, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        for _ in range(rng.choice((1, 1, 2))):
            name = rng.choice(names)
            if name not in file or not isinstance(file.get(name), h5py.Dataset):
                continue
            old = file[name][()]
            kind = rng.randrange(9)
            if kind == 5:
                file[rng.choice(("x", "robot3", "robot/y", "joint_names2"))] = h5py.SoftLink(
                    rng.choice(("/", name, "/no", "/x"))
                )
                continue
            if kind == 6:
                file.attrs[rng.choice(("joint_names", "units", "x"))] = rng.choice(
                    ("a", 1.0, np.array([1, 2]), np.bytes_(b"\xff"), "x" * 9000)
                )
                continue
            del file[name]
            if kind == 0:
                continue
            if kind == 1 and rng.random() < 0.01:
                table = file.create_dataset(name, (12, 3), "f8", chunks=(12, 3), compression="gzip")
                table.id.write_direct_chunk((0, 0), _deflated_zeros())
            elif kind == 1:
                shape = rng.choice(((10**12,), (10**9, 3), (10**6, 10**6), (0,), (0, 3), ()))
                file.create_dataset(name, shape, "f8", chunks=True if np.prod(shape, dtype=float) > 10**6 else None)
            elif kind == 2:
                file[name] = rng.choice(
                    ("text", b"\xff", 1.0, np.nan, [["a", "b"]], np.zeros((2, 2, 2)), np.array([1 + 1j]))
                )
            elif kind == 3 and isinstance(old, np.ndarray) and old.dtype.kind == "f" and old.size:
                old.flat[rng.randrange(old.size)] = rng.choice(
                    (np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, 1e18, 5e-324)
                )
                file[name] = old
            elif kind == 4 and isinstance(old, np.ndarray) and old.ndim:
                file[name] = rng.choice((old[:-1], old[::-1], old.T, old[:1], np.concatenate([old, old])))
            elif kind == 7:
                file[name] = h5py.ExternalLink(
                    rng.choice(("/etc/passwd", "../outside/x.h5", "a.h5")), rng.choice(("/", name))
                )
            else:
                file[name] = (
                    np.asarray(old).astype(rng.choice(("f4", "f2", "i8", "u1", "S5", ">f8")), casting="unsafe")
                    if isinstance(old, np.ndarray) and old.dtype.kind == "f"
                    else 3
                )
    return stream.getvalue()


def _journal(data: bytes, rng: random.Random) -> bytes:
    """Frames with other content and checksums that are right."""
    frames, at = [], 8
    while at + 20 <= len(data):
        size = int.from_bytes(data[at + 4 : at + 12], "little")
        frames.append(data[at + 20 : at + 20 + size])
        at += 20 + size
    if not frames:
        return _flip(data, rng)
    k = rng.randrange(len(frames))
    size = int.from_bytes(frames[k][:4], "little")
    if rng.random() < 0.5 and frames[k][4 : 4 + size][:1] == b"{":
        row = _json(frames[k][4 : 4 + size], rng)
        frames[k] = struct.pack("<I", len(row)) + row + frames[k][4 + size :]
    elif rng.random() < 0.3:
        frames.insert(rng.randrange(len(frames) + 1), frames[k])
    else:
        frames[k] = rng.choice(_BYTES)(frames[k], rng)
    out = data[:8]
    for frame in frames:
        head = struct.pack("<4sQI", b"\xabEPI", len(frame), zlib.crc32(frame))
        out += head + struct.pack("<I", zlib.crc32(head)) + frame
    return out


STRUCTURED: dict[str, Edit] = {
    ".json": _json,
    ".yaml": _yaml,
    ".yml": _yaml,
    ".xml": _xml,
    ".urdf": _xml,
    ".npz": _npz,
    ".parquet": _parquet,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".bin": _journal,
}
TEXTUAL = {".json", ".yaml", ".yml", ".xml", ".urdf", ".csv", ".txt", ".md"}


def change(data: bytes, suffix: str, rng: random.Random) -> bytes:
    """Other content for a file of this kind."""
    if suffix in STRUCTURED and rng.random() < 0.6:
        try:
            return STRUCTURED[suffix](data, rng)
        except Exception:  # what a change before this one has broken cannot be taken apart
            return rng.choice(_BYTES)(data, rng)
    if suffix in TEXTUAL and rng.random() < 0.7:
        return rng.choice(_TEXT)(data, rng)
    return rng.choice(_BYTES)(data, rng)


def _displace(folder: Path, file: Path, rng: random.Random) -> str:
    """What is there is something else, or elsewhere."""
    kind = rng.choice(
        (
            "gone",
            "folder",
            "empty",
            "pipe",
            "loop",
            "nowhere",
            "sentinel",
            "zero",
            "outside",
            "moved",
            "copied",
            "swapped",
        )
    )
    others = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink() and path != file]
    content = file.read_bytes()
    file.unlink()
    if kind == "folder":
        file.mkdir()
    elif kind == "empty":
        file.touch()
    elif kind == "pipe":
        os.mkfifo(file)
    elif kind in ("loop", "nowhere", "sentinel", "zero"):
        file.symlink_to(
            {
                "loop": file.name,
                "nowhere": "no",
                "sentinel": str(folder.parent / "outside" / "sentinel"),
                "zero": "/dev/zero",
            }[kind]
        )
    elif kind == "outside":
        parent = file.parent
        if parent.parent in (folder, folder.parent) or rng.random() < 0.5:  # a dataset may be a link itself
            (folder.parent / "outside" / "kept").write_bytes(content)
            file.symlink_to(folder.parent / "outside" / "kept")
        else:  # the folder that it is in lies elsewhere
            file.write_bytes(content)
            target = folder.parent / "outside" / "moved"
            parent.rename(target)
            parent.symlink_to(target)
    elif kind == "moved":
        (
            file.parent
            / rng.choice(
                (
                    "x" + file.suffix,
                    "é" + file.name,
                    "." + file.name,
                    "a\nb" + file.suffix,
                    "\x1b[2J" + file.suffix,
                    "\udcff" + file.suffix,
                )
            )
        ).write_bytes(content)
    elif kind == "copied" or (kind == "swapped" and not others):
        file.write_bytes(content)
        (file.parent / ("b" + file.name)).write_bytes(content)
    elif kind == "swapped":
        other = rng.choice(others)
        file.write_bytes(other.read_bytes())
        other.write_bytes(content)
    return f"{kind} {file.name}"


def mutate(folder: Path, rng: random.Random) -> str:
    """Change one to three files of a folder; says which and how."""
    said = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
        if not files:
            break
        file = rng.choice(files)
        if rng.random() < 0.05:
            said.append(_displace(folder, file, rng))
            continue
        data = file.read_bytes()
        for _ in range(rng.choice((1, 1, 1, 2))):
            data = change(data, file.suffix, rng)
        file.write_bytes(data)
        said.append(f"changed {file.name}")
    return ", ".join(said)
