"""Where MuJoCo keeps its arrays: byte offsets of struct fields, for callbacks that are compiled."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from mujoco.introspect import ast_nodes, structs

_SCALARS: dict[str, Any] = {
    "bool": ctypes.c_bool,
    "char": ctypes.c_char,
    "double": ctypes.c_double,
    "float": ctypes.c_float,
    "int": ctypes.c_int,
    "mjtBool": ctypes.c_bool,
    "mjtByte": ctypes.c_ubyte,
    "mjtNum": ctypes.c_double,
    "mjtSize": ctypes.c_int64,
    "size_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "uintptr_t": ctypes.c_size_t,
    "unsigned char": ctypes.c_ubyte,
    "unsigned int": ctypes.c_uint,
}


def offset(struct: str, *fields: str) -> int:
    """Byte offset of a field, e.g. `offset("mjModel", "opt", "timestep")`.

    The layout follows from the description of its headers that MuJoCo ships, so it fits the installed version.
    """
    place, layout = 0, _struct(struct)
    for field in fields:
        descriptor = getattr(layout, field)
        place += descriptor.offset
        layout = dict(layout._fields_)[field]
    return place


@cache
def _struct(name: str) -> Any:
    return _layout(structs.STRUCTS[name].fields)


def _layout(fields: Any) -> Any:
    # An anonymous union or struct has no name of its own.
    named = [(field.name or f"anonymous{index}", _ctype(field.type)) for index, field in enumerate(fields)]
    return type("Layout", (ctypes.Structure,), {"_fields_": named})


def _ctype(node: Any) -> Any:
    if isinstance(node, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(node, ast_nodes.ArrayType):
        inner = _ctype(node.inner_type)
        for extent in reversed(node.extents):
            inner = inner * extent
        return inner
    if isinstance(node, ast_nodes.ValueType):
        if node.name in _SCALARS:
            return _SCALARS[node.name]
        # What is neither a scalar nor a struct is an enumeration.
        return _struct(node.name) if node.name in structs.STRUCTS else ctypes.c_int
    return _layout(node.fields)
