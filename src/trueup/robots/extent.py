"""How much a model file asks for, read before MuJoCo does what it says.

A line of MJCF can ask for a billion bodies, files that attach each other multiply, and MuJoCo has no limit but the
memory. So elements are counted here as they will be, with copies, included and attached files, and so are numbers that
take memory by being named. Times are not: a model may take as many solver iterations as it likes.

MuJoCo's reader of XML takes much that is none. Whoever reads a file otherwise than MuJoCo does, looks at another model,
so what is read differently by the two is refused: a DOCTYPE, and what does not follow the rules. Two things that people
do write are taken as MuJoCo takes them: letters of another encoding than is said, and dashes in comments.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.parsers import expat

from trueup.errors import ConfigError

_MOST_COPIES = 2e4  # of one element; MuJoCo takes half a minute for them, and for twice as many four times as long
_MOST_ELEMENTS = 1e6
_MOST_NUMBERS = 1e8
_MOST_BYTES = 1e10

# Attributes whose product is how many numbers an element takes: pixels, heights, entries.
_AREAS = (("width", "height"), ("nrow", "ncol"), ("num", "dim"), ("nuserdata",))
# Those that bodies, joints, actuators, sensors may each take once: `<size>` and classes say them for all.
_EACH = re.compile(r"nuser_\w+|nkey|nsample|actdim")
# Of what a ray may say: how far, from and to where, and how; a camera that finds ranges has one for each pixel.
_NUMBERS_OF_RAY = 14
_BYTES_OF_CONTACT, _BYTES_OF_TWO_CONSTRAINTS = 700, 52
_BYTES = {"": 1.0, "K": 2.0**10, "M": 2.0**20, "G": 2.0**30, "T": 2.0**40, "P": 2.0**50, "E": 2.0**60}
_WORDS_OF_COMMENT = re.compile(rb"(?<=<!--)[^<>]*(?=-->)")


def root_tag(path: Path) -> str:
    """The tag of the root of a model file that does not ask for more than a computer has.

    Raises:
        ConfigError: it does, with what it includes and attaches; or one of them is no proper XML.
    """
    return _Files().model(path).tag


def folders_of(path: Path) -> frozenset[Path]:
    """The folders of a model file and of all files that it includes and attaches: where its assets may lie.

    Raises:
        ConfigError: as of `root_tag`.
    """
    files = _Files()
    files.model(path)
    return files.folders


@dataclass
class _Extent:
    """Of a file, with all that it includes.

    Attributes:
        elements: how many there are, with copies.
        copies: of the element that is copied most.
        numbers: that are named as sizes.
        each: numbers that each element may take besides.
        tag: of the root.
        attached: how often a part of another model is attached.
        largest: elements, copies, numbers and each of such a model; the largest of all of them.
        rangefinders: how many.
        pixels: of the largest camera, each of which they may find.
    """

    elements: float = 0.0
    copies: float = 0.0
    numbers: float = 0.0
    each: float = 0.0
    tag: str = ""
    attached: float = 0.0
    largest: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    rangefinders: float = 0.0
    pixels: float = 0.0

    def add(self, part: _Extent, copies: float) -> None:
        """A part of it, so many times."""
        self.elements += copies * part.elements
        self.copies = max(self.copies, copies * part.copies)
        self.numbers += copies * part.numbers
        self.each = max(self.each, part.each)
        self.attached += copies * part.attached
        (a, b, c, d), (e, f, g, h) = self.largest, part.largest
        self.largest = (max(a, e), max(b, f), max(c, g), max(d, h))
        self.rangefinders += copies * part.rangefinders
        self.pixels = max(self.pixels, part.pixels)

    def all_numbers(self) -> float:
        """With what the rangefinders find."""
        return self.numbers + self.rangefinders * self.pixels * _NUMBERS_OF_RAY

    def is_too_much(self) -> bool:
        """More than a computer has."""
        return (
            self.elements > _MOST_ELEMENTS
            or self.copies > _MOST_COPIES
            or max(self.all_numbers(), self.elements * self.each) > _MOST_NUMBERS
        )


class _Files:
    """The files of one model; each is read once, however often it is included."""

    def __init__(self) -> None:
        self._known: dict[tuple[Path, Path], _Extent | None] = {}

    @property
    def folders(self) -> frozenset[Path]:
        """Of all files that were read."""
        return frozenset(path.parent for path, _ in self._known)

    def model(self, path: Path) -> _Extent:
        """Of a model, with all that it attaches."""
        whole = replace(self.part(path, path.parent))
        whole.add(_Extent(*whole.largest), whole.attached)
        if whole.is_too_much():
            raise ConfigError(f"{path} asks for too much", got=f"{whole.attached:g} parts of other models")
        return replace(whole, numbers=whole.all_numbers(), rangefinders=0.0, attached=0.0, largest=_Extent.largest)

    def part(self, path: Path, folder: Path) -> _Extent:
        """Of a file.

        Args:
            path: the file.
            folder: of the model that it is a part of, where MuJoCo looks for what it includes.
        """
        key = (path.resolve(), folder.resolve())
        if key not in self._known:
            self._known[key] = None
            self._known[key] = _Reading(self, path, folder).extent()
        found = self._known[key]
        if found is None:
            raise ConfigError(f"{path} is a part of itself")
        return found


class _Reading:
    """One file, from its first element to its last."""

    def __init__(self, files: _Files, path: Path, folder: Path) -> None:
        self._files, self._path, self._folder = files, path, folder
        self._found = _Extent()
        self._prefixes = {"xacro"}  # of the names of macros
        self._copies = [1.0]  # of the elements around the place that is being read

    def extent(self) -> _Extent:
        parser = expat.ParserCreate("utf-8")  # what the file says of its encoding is nothing to MuJoCo
        parser.StartElementHandler, parser.EndElementHandler = self._begin, self._end
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        try:
            parser.Parse(_text(self._path), True)  # noqa: FBT003 - the parser knows no names
        except OSError as error:
            raise ConfigError(f"{self._path} cannot be read", got=error) from error
        except expat.ExpatError as error:
            raise ConfigError(f"{self._path} is no proper XML", got=error) from error
        return self._found

    def _refuse_doctype(self, *_: object) -> None:
        raise ConfigError(f"{self._path} is not read", got="a DOCTYPE", expected="XML without one")

    def _refuse_xacro(self, tag: str, said: Mapping[str, str]) -> None:
        """A URDF is what xacro makes of its macros; a reader that passes them over finds a part of the robot."""
        self._prefixes |= {name.partition(":")[2] for name, value in said.items() if _is_xacro(name, value)}
        macro = tag.partition(":")[0] in self._prefixes and ":" in tag
        if macro or any(mark in value for value in said.values() for mark in ("${", "$(")):
            words = "".join(f' {name}="{value}"' for name, value in said.items())
            name = self._path.name.removesuffix(".xacro").removesuffix(".urdf")
            raise ConfigError(
                f"{self._path} is xacro that has not been expanded",
                got=f"<{tag}{words}>",
                expected="a URDF",
                hint=f"Expand it where ROS is (xacro {self._path.name} > {name}.expanded.urdf, with its arguments), "
                "and name that file as the model.",
            )

    def _begin(self, tag: str, said: Mapping[str, str]) -> None:
        self._found.tag = self._found.tag or tag
        if self._found.tag == "robot":
            self._refuse_xacro(tag, said)
        copies = self._copies[-1] * _product(said, "count") * _product(said, "cellcount")
        self._copies.append(copies)
        self._found.add(_alone(tag, said), copies)
        name, here = said.get("file", ""), self._path.parent
        if tag == "include" and (file := _first(self._folder / name, here / name)):
            self._found.add(self._files.part(file, self._folder), copies)
        if tag == "model" and (file := _first(here / name)):
            model = self._files.model(file)
            self._found.add(replace(model, largest=(model.elements, model.copies, model.numbers, model.each)), copies)
        if self._found.is_too_much() or (tag == "size" and _memory(said) > _MOST_BYTES):
            raise ConfigError(f"{self._path}: <{tag}> asks for too much", got=dict(said))

    def _end(self, _: str) -> None:
        self._copies.pop()


def _is_xacro(name: str, value: str) -> bool:
    """Whether an attribute declares a prefix of xacro, of which there have been several addresses."""
    return name.startswith("xmlns:") and value.rstrip("/").rpartition("/")[2] == "xacro"


def _first(*paths: Path) -> Path | None:
    """That is a file; MuJoCo looks for them in this order.

    Raises:
        ConfigError: one is a pipe, for which MuJoCo would wait, or a device.
    """
    with contextlib.suppress(OSError):  # a name that no file can have
        for path in paths:
            refuse_pipe(path)
            if path.is_file():
                return path
    return None


def refuse_pipe(path: Path) -> None:
    """Refuse what is there and neither a file nor a folder: whoever opens it waits, or never comes to its end.

    Raises:
        ConfigError: it is a pipe, a socket or a device.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ConfigError(f"{path} cannot be read", got="a pipe or a device", expected="a file")


def _alone(tag: str, said: Mapping[str, str]) -> _Extent:
    """Of an element without what is in it."""
    elements, numbers = 1.0, max(_product(said, *names) for names in _AREAS)
    if tag == "numeric":
        numbers = _product(said, "size")
    if tag == "mesh" and "builtin" in said:  # as many corners as the square of its resolution
        elements = max(_sizes(said.get("params", "")), default=1.0) ** 2
    each = max((_product(said, name) for name in said if _EACH.fullmatch(name)), default=1.0)
    return _Extent(
        *(elements, 1.0, numbers, each),
        attached=float(tag == "attach"),
        rangefinders=float(tag == "rangefinder"),
        pixels=_product(said, "resolution"),
    )


def _text(path: Path) -> bytes:
    """The file as MuJoCo takes it.

    Dashes within comments are made blanks, where no element can be among them: those that are in an attribute or a
    CDATA section, and no comment, stay within it, too.
    """
    text = path.read_bytes().decode("utf-8", "replace").encode().lstrip()
    return _WORDS_OF_COMMENT.sub(lambda found: found[0].replace(b"-", b" "), text)


def _product(said: Mapping[str, str], *names: str) -> float:
    """Of all numbers in these attributes."""
    return math.prod((size for name in names for size in _sizes(said.get(name, ""))), start=1.0)


def _sizes(text: str) -> list[float]:
    """Its numbers, at least 1 each; none where it has a word that is none, which MuJoCo refuses."""
    try:
        return [max(1.0, float(word)) for word in text.split()]
    except ValueError:
        return []


def _memory(said: Mapping[str, str]) -> float:
    """Bytes that `<size>` asks for, once for each robot that is simulated."""
    text = said.get("memory", "").strip().upper()
    unit = text[-1:] if text[-1:] in _BYTES else ""
    asked = math.prod(_sizes(text.removesuffix(unit)), start=1.0) * _BYTES[unit]
    contacts = _BYTES_OF_CONTACT * _product(said, "nconmax") + _BYTES_OF_TWO_CONSTRAINTS * _product(said, "njmax") ** 2
    return max(asked, 8 * _product(said, "nstack"), contacts)
