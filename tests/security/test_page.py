"""docs/security.md: behind each of its lines there are tests, and its figures are those that were measured."""

import ast
import json
import re
from pathlib import Path

from attack.harness import all_parsers
from attack.kill import WRITERS

ROOT = Path(__file__).parent.parent.parent
TEXT = (ROOT / "docs" / "security.md").read_text()
ROWS = [line for line in TEXT.splitlines() if line.startswith("| ") and "---" not in line]
RESULTS = json.loads((ROOT / "benchmarks" / "results" / "attack.json").read_text())
TESTS = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")


def test_each_line_names_tests_that_are_there():
    lines = [row for row in ROWS if not row.startswith("| what comes")]
    assert len(lines) > 30
    for row in lines:
        last = row.rstrip(" |").rpartition(" | ")[2]
        assert TESTS.sub("", last).strip(", ") == "", row
        named = TESTS.findall(last)
        assert named, row
        for file, name in named:
            assert (ROOT / file).is_file(), row
            tree = ast.parse((ROOT / file).read_text())
            functions = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
            assert not name or name in functions, row


def figures_of(names, known):
    """How many of how many were attacked, how often at least, and how many defects came of it."""
    own = [RESULTS[name] for name in names if name in RESULTS]
    return len(own), known, min(one["mutations"] for one in own), sum(len(one["defects"]) for one in own)


def said(pattern):
    found = re.findall(pattern, TEXT)
    assert len(found) == 1, found
    return tuple(int(number.replace(",", "")) for number in found[0])


def test_the_figures_of_kills_are_those_of_the_results():
    names = [f"kill {name}" for name in WRITERS]
    expected = figures_of(names, len(names))
    assert said(r"(\d+) of (\d+) writers killed ([\d,]+) times each, (\d+) defects") == expected


def test_the_hour_lost_nothing_as_the_page_says():
    hour = json.loads((ROOT / "benchmarks" / "results" / "ros2_hour.json").read_text())
    (row,) = [row for row in ROWS if row.startswith("| an hour at 1 kHz")]
    assert "every message answered, none lost" in row
    assert hour["published"] == hour["bridge"]["received"] == hour["bridge"]["sent"]


def test_the_figures_of_damaged_files_are_those_of_the_results():
    parsers = all_parsers()
    expected = figures_of(parsers, len(parsers))
    assert said(r"(\d+) of (\d+) kinds of files damaged ([\d,]+) times each, (\d+) defects") == expected
