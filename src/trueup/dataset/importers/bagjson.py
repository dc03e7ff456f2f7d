"""Messages of ROS that a bag holds as JSON, as bridges to the web and Foxglove's writers make them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Connection, Nodetype
from rosbags.typesys.store import Typestore

from trueup.errors import DataError

FORMAT = "json"
_NUMPY = {"octet": "uint8", "byte": "uint8", "char": "uint8"}


def named_in_full(connection: Connection, kinds: Mapping[str, str]) -> Connection:
    """A connection of JSON under the full name of its type: schemas are called `JointState` as often.

    Args:
        connection: of the bag.
        kinds: the last part of a type's name -> the name in full.
    """
    if getattr(connection.ext, "serialization_format", "") != FORMAT:
        return connection
    last = connection.msgtype.replace(".", "/").rpartition("/")[2]
    return connection._replace(msgtype=kinds.get(last, connection.msgtype))


def message(raw: bytes, kind: str, store: Typestore) -> Any:
    """A message of a type, whose fields may be missing: they are then empty, or 0.

    Raises:
        DataError: it is no JSON, or a field is of another kind.
    """
    try:
        return _object(json.loads(raw), kind, store)
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise DataError(f"a message is no {kind.replace('/msg/', '/')} in JSON", got=error) from error


def _object(tree: Mapping[str, Any], kind: str, store: Typestore) -> Any:
    fields = dict(store.fielddefs[kind][1])
    return store.types[kind](**{name: _field(tree.get(name), node, store) for name, node in fields.items()})


def _field(value: Any, node: Any, store: Typestore) -> Any:
    what, about = node
    if what == Nodetype.NAME:
        # Foxglove's schemas have stamps in `sec` and `nsec`.
        tree = {} if value is None else {**value, **({"nanosec": value["nsec"]} if "nsec" in value else {})}
        return _object(tree, about, store)
    if what == Nodetype.BASE:
        if about[0].endswith("string"):
            return "" if value is None else str(value)
        return 0 if value is None else float(value) if about[0].startswith("float") else int(value)
    (own, length) = about
    items = [] if value is None else list(value)
    if own[0] == Nodetype.BASE and not own[1][0].endswith("string"):
        return np.array(items if value is not None else [0] * (length or 0), dtype=_NUMPY.get(own[1][0], own[1][0]))
    return [_field(item, own, store) for item in items]
