import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import pytest

from trueup.core import config
from trueup.core.config import build, parse_yaml, read_yaml
from trueup.errors import ConfigError


@dataclass(frozen=True)
class Leaf:
    size: float
    kind: Literal["round", "flat"] = "round"


@dataclass(frozen=True)
class Tree:
    leaves: tuple[Leaf, ...] = ()
    height_m: float | None = None
    counts: Mapping[str, int] = field(default_factory=dict)


def test_nested_values_follow_the_annotations():
    tree = build(Tree, {"leaves": [{"size": 1}, {"size": 2.5, "kind": "flat"}], "counts": {"a": 3}}, "tree.yaml")
    assert tree == Tree((Leaf(1.0), Leaf(2.5, "flat")), None, {"a": 3})
    assert isinstance(tree.leaves[0].size, float)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"leafs": []}, r"unknown keys \['leafs'\].*available: leaves, height_m, counts"),
        ({"leaves": [{}]}, r"leaves\[0\] lacks \['size'\]"),
        ({"leaves": [{"size": "big"}]}, r"leaves\[0\]: size has the wrong type: got 'big'; expected float"),
        ({"leaves": [{"size": True}]}, "wrong type"),
        ({"leaves": [{"size": 1, "kind": "oval"}]}, r"kind is not a choice.*round, flat"),
        ({"leaves": 3}, "must be a list"),
        ({"counts": [1]}, "must be a mapping"),
        ([], "must be a mapping"),
    ],
)
def test_a_wrong_tree_is_refused_with_the_place(data, message):
    with pytest.raises(ConfigError, match=message):
        build(Tree, data, "tree.yaml")


@pytest.mark.parametrize("text", ["- 1", "a: !!python/object/apply:os.system [ls]", "a: [", "\x00", "a: &a [*a", ""])
def test_yaml_that_is_no_plain_mapping_is_refused(tmp_path, text):
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"robot\.yaml"):
        read_yaml(path)


def nine_times(form):
    """Seven levels, each of which has the one before nine times: five million."""
    return "".join(
        f"{name}: &{name} {form.format(','.join([f'*{before}'] * 9))}\n"
        for before, name in zip("abcdefg", "bcdefgh", strict=True)
    )


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [x]\n" + nine_times("[{}]"),
        "a: &a {x: 1}\n" + nine_times("{{<<: [{}]}}"),
        f"a: &a {'x' * 10_000}\nb: [{','.join(['*a'] * 200)}]",
        "a: &a {b: [*a]}",
    ],
    ids=["lists", "merges", "a long text", "itself"],
)
def test_aliases_that_multiply_are_refused(text):
    """Also where nothing is wrong with any key: the tree is small until somebody merges, shows or saves it."""
    with pytest.raises(ConfigError, match=r"robot\.yaml is not plain YAML: got aliases that multiply"):
        parse_yaml(text, "robot.yaml")


@pytest.mark.parametrize(
    ("text", "line", "hint"),
    [
        ("name: a\n  model: x.xml\n", "in line 2: model: x.xml", "Indent the keys"),
        ("joints:\n- name: b\n\tlog: c\n", "in line 3: log: c", "not with tabs"),
        ("fit:\n  kp: all\n  kv all\nx: 1\n", "in line 3: kv all", "a colon and a space"),
        ("joints: [a, b\nname: c\n", "in line 1: joints: [a, b", "Close each"),
        ('a: 1\nname: "b\nc: 1\n', 'in line 2: name: "b', "Close each"),
        ("name: @a\n", "in line 1: name: @a", "in quotes"),
    ],
)
def test_a_slip_in_yaml_is_shown_with_its_line_and_how_to_mend_it(text, line, hint):
    with pytest.raises(ConfigError) as raised:
        parse_yaml(text, "robot.yaml")
    assert line in str(raised.value)
    assert hint in raised.value.hint


def test_aliases_and_merges_that_say_things_once_are_read():
    text = "usual: &usual {kp: 10, limits: &limits [-1, 1]}\njoints: [{<<: *usual, kp: 5}, *usual]\nfar: *limits"
    usual = {"kp": 10, "limits": [-1, 1]}
    assert parse_yaml(text, "here") == {"usual": usual, "joints": [{**usual, "kp": 5}, usual], "far": [-1, 1]}
    many = "a: &a [0, 1, 2, 3, 4]\nb: [" + ", ".join(["*a"] * 1000) + "]"
    assert parse_yaml(many, "here")["b"] == [[0, 1, 2, 3, 4]] * 1000


def test_a_file_without_aliases_may_be_as_long_as_it_likes(monkeypatch):
    monkeypatch.setattr(config, "_MOST_REPEATED", 0)
    assert len(parse_yaml("a: [" + "[x], {y}, -1, " * 1000 + "]", "here")["a"]) == 3000


def test_a_file_of_many_megabytes_is_refused_unread(tmp_path):
    path = tmp_path / "robot.yaml"
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(ConfigError, match="too large to be written by hand: got 1099511627776 bytes"):
        read_yaml(path)


def test_what_yaml_is_instead_of_a_mapping_is_said_in_words(tmp_path):
    path = tmp_path / "robot.yaml"
    for text, said in (("", "is empty"), ("# nothing\n", "is empty"), ("- 1", "got a list"), ("5", "got one value")):
        path.write_text(text)
        with pytest.raises(ConfigError, match=said):
            read_yaml(path)
    with pytest.raises(ConfigError, match="cannot be read: got a folder; expected a YAML file"):
        read_yaml(tmp_path)


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="does not exist") as error:
        read_yaml(tmp_path / "nothing.yaml")
    assert error.value.hint == f"Check the path: there is no nothing.yaml in {tmp_path}."
    with pytest.raises(ConfigError, match="does not exist") as error:
        read_yaml(tmp_path / "no" / "such" / "nothing.yaml")
    assert error.value.hint == f"Check the path: there is no folder {tmp_path / 'no'}."
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_yaml(tmp_path / "binary.yaml")


@dataclass(frozen=True)
class Gain:
    """One number."""

    kp: float


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("1e-3", 1e-3),
        ("1.0e12", 1e12),
        ("-2E+4", -2e4),
        (".5e1", 5.0),
        ("1_000", 1000.0),
        ("010", 10.0),
        ("0x1f", 31.0),
    ],
)
def test_numbers_as_people_write_them(text, number):
    assert build(Gain, parse_yaml(f"kp: {text}", "r.yaml"), "r.yaml").kp == number


@pytest.mark.parametrize("text", ["1:30", "190:20:30", "1:30.5", "1e", "e3", "1e400"])
def test_texts_are_no_numbers(text):
    with pytest.raises(ConfigError, match=re.escape(text)):
        build(Gain, parse_yaml(f"kp: {text}", "r.yaml"), "r.yaml")
