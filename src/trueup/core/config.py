"""YAML into frozen dataclasses: unknown keys, missing keys and wrong types are errors that say where."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import yaml

from trueup.core.atomic import regular, where_missing, whole_number
from trueup.errors import ConfigError, DataError, FormatError

T = TypeVar("T")
# What PyYAML says -> how that is usually mended.
_YAML_HINTS = {
    "mapping values": "Indent the keys of one level alike, and put text that has a colon in it in quotes.",
    "'\\t'": "Indent with spaces, not with tabs.",
    "expected ':'": "Write `key: value`, with a colon and a space, in this line.",
    "expected ',' or": "Close each `[` and `{`, and put commas between what is in them.",
    "expected <block end>": "Indent the keys of one level alike.",
    "cannot start any token": "Put text that begins with this character in quotes.",
    "end of stream": "Close each `[`, `{` and quote.",
}
_KINDS_OF_YAML: Mapping[type, str] = {list: "a list", str: "a text"}
# By which a file may grow when its aliases are written out; a robot whose joints share their settings has hundreds.
_MOST_REPEATED = 1_000_000
_MOST_BYTES = 4 << 20
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")


class _Loader(yaml.SafeLoader):
    """Numbers as YAML 1.2 has them: `1:30` is a text, not 90, and `010` is ten, not eight."""

    def construct_int(self, node: yaml.ScalarNode) -> int | str:
        digits = node.value.lstrip("+-").replace("_", "")
        if ":" in digits:
            return str(node.value)
        if digits.isdecimal():
            return whole_number(node.value.replace("_", ""))
        return whole_number(str(super().construct_yaml_int(node)))

    def construct_float(self, node: yaml.ScalarNode) -> float | str:
        if ":" in node.value:
            return str(node.value)
        number = super().construct_yaml_float(node)
        if not math.isfinite(number):
            raise ValueError(f"{node.value} in line {node.start_mark.line + 1}, which is no finite number")
        return number


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_int)
_Loader.add_constructor("tag:yaml.org,2002:float", _Loader.construct_float)


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file whose top level is a mapping, by `yaml.safe_load`.

    Raises:
        ConfigError: missing, not UTF-8, not YAML, a tag that would build objects, or no mapping at the top.
    """
    try:
        refuse_large_yaml(path)
        text = regular(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist", hint=where_missing(path)) from None
    except DataError as error:
        found = "a folder" if path.is_dir() else "no regular file"
        raise ConfigError(f"{path} cannot be read", got=found, expected="a YAML file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read", got=error, expected="a YAML file") from error
    tree = parse_yaml(text, str(path))
    if tree is None:
        raise ConfigError(
            f"{path} is empty", expected="lines such as `key: value`", hint="Write them, or leave the file out."
        )
    if not isinstance(tree, dict):
        raise ConfigError(f"{path} must hold a mapping", got=_KINDS_OF_YAML.get(type(tree), "one value"))
    return tree


def refuse_large_yaml(path: Path) -> None:
    """Refuse a file that takes longer to be read than anybody waits: a megabyte takes five seconds.

    Raises:
        ConfigError: it is of many megabytes.
        FileNotFoundError: it is not there.
    """
    if path.is_file() and (size := path.stat().st_size) > _MOST_BYTES:
        raise ConfigError(f"{path} is too large to be written by hand", got=f"{size} bytes", expected=_MOST_BYTES)


def parse_yaml(text: str, where: str) -> Any:
    """What `yaml.safe_load` makes of a text.

    Raises:
        ConfigError: not YAML, a tag that would build objects, or aliases that multiply or refer to themselves.
    """
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        # An alias takes no memory, but whoever merges, shows or saves what it stands for writes it out.
        if node is not None and _length(node, {}) > _MOST_REPEATED + 2 * len(text):
            raise ConfigError(
                f"{where} is not plain YAML",
                got="aliases that multiply",
                expected="each value written where it belongs",
            )
        return None if node is None else loader.construct_document(node)
    # PyYAML lets errors of its constructors through, e.g. for `!!int x` or a date that does not exist.
    except (
        *(yaml.YAMLError, ValueError, TypeError, LookupError),
        *(AttributeError, ArithmeticError, RecursionError, MemoryError),
    ) as error:
        raise _unreadable(where, text, error) from error


def _unreadable(where: str, text: str, error: Exception) -> ConfigError:
    """What is wrong with a text that is not YAML: the line, and how that is usually mended."""
    # What is not closed is noticed where something else comes, and is to be mended where it begins.
    begun = str(getattr(error, "context", None)).startswith(("while scanning a", "while parsing a flow"))
    mark = getattr(error, "context_mark" if begun else "problem_mark", None)
    problem = str(getattr(error, "problem", None) or str(error) or type(error).__name__)
    if mark is None:
        return ConfigError(f"{where} is not plain YAML", got=problem)
    lines = text.splitlines()
    line = lines[mark.line].strip() if mark.line < len(lines) else "the end of the file"
    hint = next((own for part, own in _YAML_HINTS.items() if part in problem), "Look at this line and the one before.")
    return ConfigError(f"{where} is not plain YAML", got=f"{problem}, in line {mark.line + 1}: {line}", hint=hint)


def _length(node: yaml.Node, known: dict[int, float]) -> float:
    """Nodes and letters of a tree whose aliases are written out; infinite where a node is within itself.

    Args:
        node: the root of the tree.
        known: lengths of nodes, by their `id`; a node that is being measured has none yet.
    """
    if id(node) not in known:
        known[id(node)] = math.inf
        length = 1.0
        if isinstance(node, yaml.ScalarNode):
            length += len(node.value)
        else:
            for item in node.value:
                for part in item if isinstance(item, tuple) else (item,):
                    length += _length(part, known)
        known[id(node)] = length
    return known[id(node)]


def build(cls: type[T], data: Any, where: str) -> T:
    """A frozen dataclass from a tree of YAML or JSON values.

    Nested dataclasses, tuples, mappings, Literals and optional values follow the annotations. A class with a static
    method `variant` leaves it to that which class, itself or a subclass, fits the data, and one with a static method
    `of_word` takes one word in place of a mapping.

    Args:
        cls: dataclass type.
        data: mapping from field name to value.
        where: file and key, for messages.

    Raises:
        ConfigError: an unknown or missing key, or a value of the wrong type.
    """
    of_word = getattr(cls, "of_word", None)
    if not isinstance(data, Mapping) and not (of_word and isinstance(data, str)):
        raise ConfigError(f"{where} must be a mapping", got=repr(data))
    try:
        data = of_word(data) if of_word and isinstance(data, str) else data
        cls = getattr(cls, "variant", lambda _: cls)(data)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error.summary}", hint=error.hint) from error
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}  # type: ignore[arg-type]
    unknown = [key for key in data if key not in fields]
    if unknown:
        raise ConfigError(f"{where} has unknown keys {unknown}", available=fields)
    missing = [
        name
        for name, field in fields.items()
        if name not in data and field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise ConfigError(f"{where} lacks {missing}", available=fields)
    hints = _hints(cls)  # type: ignore[arg-type]
    return cls(**{key: _convert(hints[key], value, f"{where}: {key}") for key, value in data.items()})


def build_versioned(cls: type[T], data: Any, where: str, *, schema: str, what: str) -> T:
    """A frozen dataclass from a result file that says what it is in `schema`, and has its fields beside it.

    Raises:
        FormatError: as `read_versioned`.
        DataError: likewise.
    """
    with _versioned(data, where, schema, what):
        return build(cls, {key: value for key, value in data.items() if key != "schema"}, where)


def read_versioned(read: Callable[[Any], T], data: Any, where: str, *, schema: str, what: str) -> T:
    """What `read` makes of a result file whose key `schema` says what it is, every value of the kind it should be.

    Args:
        read: makes a frozen dataclass of the content; it need not look at the kinds of values.
        data: content of the file.
        where: the file, for messages.
        schema: what `schema` must say.
        what: what the file holds, for messages.

    Raises:
        FormatError: something else, or of another version.
        DataError: broken.
    """
    with _versioned(data, where, schema, what):
        made = read(data)
        return build(type(made), vars(made), where)


@contextlib.contextmanager
def _versioned(data: Any, where: str, schema: str, what: str) -> Iterator[None]:
    """Reading of a result file of one version: whatever goes wrong in it, the file is broken."""
    found = data.get("schema") if isinstance(data, Mapping) else type(data).__name__
    if found != schema:
        raise FormatError(f"{where} holds no {what} of this version", got=found, expected=schema)
    try:
        yield
    except ConfigError as error:
        raise DataError(f"{where} is broken", got=error.summary) from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{where} is broken", got=f"{type(error).__name__}: {error}") from error


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, args = get_origin(hint), get_args(hint)
    if dataclasses.is_dataclass(hint):
        return build(hint, vars(value) if isinstance(value, hint) else value, where)  # type: ignore[arg-type]
    if origin in (Union, types.UnionType):
        if value is None and type(None) in args:
            return None
        rest = [arg for arg in args if arg is not type(None)]
        return _convert(rest[0], value, where) if len(rest) == 1 else _one_of(rest, value, where)
    if origin is Literal:
        if value not in args:
            raise ConfigError(f"{where} is not a choice", got=repr(value), available=args)
        return value
    if origin is tuple or (origin is not None and issubclass(origin, Sequence)):
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{where} must be a list", got=repr(value))
        if len(args) == 1 or args[1] is Ellipsis:
            made = [_convert(args[0], item, f"{where}[{index}]") for index, item in enumerate(value)]
            return tuple(made) if origin is tuple else made
        if len(value) != len(args):
            raise ConfigError(f"{where} has the wrong length", got=len(value), expected=len(args))
        return tuple(_convert(arg, item, where) for arg, item in zip(args, value, strict=True))
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where} must be a mapping", got=repr(value))
        if args == (str, float) and all(type(key) is str and type(item) is float for key, item in value.items()):
            return dict(value)  # a large gap.json has a million of them
        return {_convert(args[0], key, where): _convert(args[1], item, f"{where}.{key}") for key, item in value.items()}
    return _scalar(hint, value, where)


def _one_of(hints: Sequence[Any], value: Any, where: str) -> Any:
    """The value as the first of several kinds that it is."""
    for hint in hints:
        with contextlib.suppress(ConfigError):
            return _convert(hint, value, where)
    kinds = " or ".join(
        "a list" if get_origin(hint) is tuple else getattr(hint, "__name__", str(hint)) for hint in hints
    )
    raise ConfigError(f"{where} has the wrong type", got=repr(value), expected=kinds)


def _scalar(hint: Any, value: Any, where: str) -> Any:
    if hint is float and isinstance(value, str):
        value = as_number(value)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise ConfigError(f"{where} is too large for a number", got=value) from None
    if hint is Any or (isinstance(value, hint) and not (hint is int and isinstance(value, bool))):
        return value
    raise ConfigError(f"{where} has the wrong type", got=repr(value), expected=getattr(hint, "__name__", hint))


def as_number(value: str) -> float | str:
    """A number that YAML takes for a text, such as `1e-3` or `1.0e12`; any other text as it is."""
    return float(value) if _EXPONENT.fullmatch(value) and math.isfinite(float(value)) else value
