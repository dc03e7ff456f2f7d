"""docs/gallery.md: every example is there with its question, what it printed, and its code."""

import re
from pathlib import Path

import pytest
from benchmarks.pages import gallery

from test_examples import EXAMPLES, SAID
from trueup.core.atomic import read_json

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs" / gallery.NAME).read_text()


def test_every_example_has_a_section_and_no_other():
    assert {f"{name}.py" for name in gallery.EXAMPLES} == {path.name for path in EXAMPLES.glob("*.py")}
    asked = [gallery.question(name)[0] for name in gallery.EXAMPLES]
    assert re.findall(r"^## (.*)$", PAGE, re.M) == asked
    listed = (EXAMPLES / "README.md").read_text()
    for name, asks in zip(gallery.EXAMPLES, asked, strict=True):
        assert asks.endswith("?")
        assert f"| {asks} | [{name}.py]({name}.py) |" in listed


@pytest.mark.parametrize("name", gallery.EXAMPLES)
def test_it_shows_what_the_example_says_and_its_code(name):
    printed = read_json(gallery.RESULT)["examples"][name]["printed"]
    for words in SAID[f"{name}.py"][1]:
        # An example is shown as it is; its test takes fewer steps.
        assert words.replace("150 steps", "2000 steps") in printed
    assert f"$ python examples/{name}.py\n{printed}\n" in PAGE
    assert f'--8<-- "examples/{name}.py"' in PAGE


def test_figures_say_what_they_are_and_are_small():
    drawn = gallery.figures(read_json(gallery.RESULT))
    assert len(drawn) >= 4
    for file, content in drawn.items():
        assert f"]({file})" in PAGE
        assert 'role="img" aria-label="' in content
        assert len(content) < 20_000


def test_an_interval_is_drawn_where_its_numbers_are():
    rows = [
        {"name": "a", "value": 2.0, "low": 1.0, "high": 4.0, "mark": 3.0},
        {"name": "b", "value": 1.0, "low": None, "high": None},
    ]
    drawn = gallery.intervals({"title": "T", "unit": "rad", "rows": rows, "legend": "L"})
    last = 1.05 * 4.0
    for value in (1.0, 4.0):
        assert f'"{gallery.LEFT + gallery.WIDTH * value / last:.1f}"' in drawn
    assert drawn.count("<circle") == 2
    assert drawn.count("<path") == 1
    assert drawn.count('stroke-width="2"/>') == 2


@pytest.mark.parametrize("last", [0.9, 3.0, 4.2, 63.0, 110.0, 165.0])
def test_ticks_are_round_and_few(last):
    ticks = gallery._ticks(last)
    assert ticks[0] == 0.0
    assert 4 <= len(ticks) <= 7
    assert last - ticks[-1] < ticks[1]
    assert f"{ticks[1]:g}".strip("0.") in ("1", "2", "5")
