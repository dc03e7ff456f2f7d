"""robustness.json on a page of its own, and beside a measurement; broken files are refused."""

import shutil
from dataclasses import replace

import pytest

from trueup.core.results import Estimate
from trueup.core.robustness_result import Improvement, RobustnessResult, RobustnessRow
from trueup.errors import DataError
from trueup.report import build_report
from trueup.report.body_units import robustness_for_people
from trueup.report.palette import cycled_styles
from trueup.report.robustness_figures import datasets_figure, sizes_figure
from trueup.report.robustness_words import gone_words, sentences
from trueup.report.sections.robustness import section_of


def gone(value, half=0.1):
    return Estimate(value, "1", value - half, value + half)


def row(value, dataset="walk", verdict="better", **of):
    item = Improvement(Estimate(0.02, "rad", 0.01, 0.03), Estimate(0.01, "rad"), gone(value), verdict)
    return RobustnessRow(dataset, 4, {"mae": item, "max": item}, **of)


RESULT = RobustnessResult(
    network="<net>",
    method="sat",
    robot="dancebot",
    signal="position",
    parts=("hip",),
    split="test",
    rows=(
        row(0.6),
        row(0.5, "run"),
        # Not in order: the file says what was asked for.
        row(0.1, perturbation="masses", share=1.0, size={"mass": 0.5}, draws=3, least=0.05),
        row(0.4, perturbation="masses", share=0.5, size={"mass": 0.25}, draws=3, least=0.3),
    ),
    notes=("mind <this>",),
)


@pytest.fixture
def folder(tmp_path):
    RESULT.save(tmp_path / "robustness.json")
    return tmp_path


def test_it_has_a_page_of_its_own_and_a_section_beside_a_measurement(folder, run_folder, tmp_path):
    page = build_report(folder)
    assert page == build_report(folder)
    for words in ("&lt;net&gt; on dancebot", "mind &lt;this&gt;", 'href="#robustness"', "Simulators that are off"):
        assert words in page
    assert "<net>" not in page
    both = shutil.copytree(run_folder, tmp_path / "both")
    assert '<section id="robustness"' not in build_report(both)
    RESULT.save(both / "robustness.json")
    page = build_report(both)
    assert '<section id="verdict"' in page
    assert '<section id="robustness"' in page


def test_rows_come_by_growing_size():
    shown = section_of(RESULT).context["sizes"].shown
    heads = [(item.head, item.cells[0].text, item.note) for item in shown.tables["sizes"].rows]
    assert heads == [
        ("as it is", "–", ""),
        ("masses", "50\N{NO-BREAK SPACE}%", "masses by 25 %"),
        ("masses", "100\N{NO-BREAK SPACE}%", "masses by 50 %"),
    ]
    (line,) = shown.figures["sizes"]["data"]
    assert line["y"] == [60.0, 40.0, 10.0]
    assert line["error_y"]["array"] == pytest.approx([10.0] * 3)


def test_a_whisker_without_end_does_not_dwarf_the_figure():
    lines = {"masses": {1.0: Estimate(0.2, "1", -30.0, 1.0)}}
    figure = sizes_figure(gone(0.6), lines, cycled_styles(["", "masses"]))
    assert figure["layout"]["yaxis"]["range"] == [-54.0, 102]
    harm = datasets_figure({"run": Estimate(-2.0, "1")}, cycled_styles(["", "x"])["x"])
    assert harm["layout"]["yaxis"]["range"] == [-204.0, 102]
    assert harm["data"][0]["text"] == [gone_words(Estimate(-2.0, "1"))]


def test_people_are_told_degrees_and_millimeters():
    item = robustness_for_people(RESULT).rows[0].errors["mae"]
    assert item.simulated.unit == "deg"
    assert item.simulated.value == pytest.approx(1.1459, abs=1e-4)
    bodies = replace(
        RESULT,
        signal="body.position",
        rows=(
            replace(
                RESULT.rows[0],
                errors={
                    kind: replace(own, simulated=Estimate(0.002, "m", 0.001, 0.003))
                    for kind, own in RESULT.rows[0].errors.items()
                },
            ),
        ),
    )
    assert robustness_for_people(bodies).rows[0].errors["max"].simulated == Estimate(2.0, "mm", 1.0, 3.0)
    slides = replace(bodies, signal="position")
    assert robustness_for_people(slides).rows[0].errors["max"].simulated.unit == "m"


def test_one_dataset_needs_no_sentence():
    assert sentences(replace(RESULT, rows=RESULT.rows[:1])) == []


def test_what_makes_no_sense_is_refused_by_name(folder):
    for broken, words in (
        (replace(RESULT, rows=RESULT.rows[2:]), "no row with the simulator as it is"),
        (
            replace(RESULT, rows=(replace(RESULT.rows[0], errors={"mae": RESULT.rows[0].errors["mae"]}),)),
            "errors on walk",
        ),
    ):
        broken.save(folder / "robustness.json")
        with pytest.raises(DataError, match=words) as error:
            build_report(folder)
        assert "robustness.json" in str(error.value)
    (folder / "robustness.json").write_text('{"schema": "trueup.robustness/1", "rows": 3}')
    with pytest.raises(DataError, match="broken"):
        build_report(folder)
