"""The whole page: complete, deterministic, offline, safe against names, and honest about bad input."""

import base64
import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from report.packed import read_json
from report.run_folders import CLOSE_RUNS, World, make_close, make_gap, make_run, simulate
from trueup.core.check_result import CHECK_NAME, CheckResult, Finding, Mend
from trueup.core.results import GapResult
from trueup.errors import DataError, FormatError, TrueupError
from trueup.report import build_report, write_report
from trueup.report.builder import breakable, packed_json
from trueup.report.folder import RunFolder
from trueup.report.sections.traces import hidden_first

SECTIONS = ["verdict", "ladder", "traces", "joints", "groups", "causes", "flags", "episodes", "provenance"]


@pytest.fixture(scope="module")
def page(run_folder):
    return build_report(run_folder)


@pytest.fixture
def copied(run_folder, tmp_path):
    return shutil.copytree(run_folder, tmp_path / "run")


def sections(html):
    return re.findall(r'<section id="([a-z]+)"', html)


def without_plotly(html):
    start = html.index('<script type="text/plain" id="library">')
    return html[:start] + html[html.index("</script>", start) :]


def test_the_library_that_draws_is_packed(page):
    packed = re.search(r'id="library">([A-Za-z0-9+/=]+)</script>', page)[1]
    assert "plotly.js v" in gzip.decompress(base64.b64decode(packed)).decode()[:200]
    assert len(packed) < 2_200_000


def test_all_sections_are_there(page):
    assert sections(page) == SECTIONS
    assert "Sim-to-real gap of SO-101" in page
    assert "the simulator mujoco/fitted misses the measured position by" in page
    assert "stopped_early" in page
    assert "9f2c41d0" in page


def test_tables_show_the_numbers_of_the_result(page, run_folder):
    result = GapResult.load(run_folder / "gap.json").runs["mujoco/stock"]["test"]["position"]["rmse"]
    table = page[page.index('data-table="joints"') : page.index('data-table="pairs"')]
    for estimate in (result.total, *result.per_joint.values()):
        assert f">{estimate.value:#.3g}\N{NO-BREAK SPACE}rad" in table


@pytest.mark.parametrize(
    ("file", "section"),
    [
        ("ladder.json", "ladder"),
        ("traces.json", "traces"),
        ("quality.json", "flags"),
        ("analysis.json", "causes"),
    ],
)
def test_a_missing_file_leaves_its_section_out(copied, file, section):
    (copied / file).unlink()
    assert sections(build_report(copied)) == [name for name in SECTIONS if name != section]


def test_what_the_check_found_stands_below_the_verdict(copied):
    mend = Mend("robot.yaml", "joints:\n- {name: lift, sign: -1}", "lift counts the other way round")
    wrong = Finding("sign", "certain", "lift counts <the other way> round.", ("lift",), (mend,))
    CheckResult((wrong, Finding("idle-joint", "note", "yaw: never moved.", ("yaw",))), 8, ("Whether …",)).save(
        copied / CHECK_NAME
    )
    page = build_report(copied)
    assert sections(page) == [SECTIONS[0], "setup", *SECTIONS[1:]]
    assert "2\N{NO-BREAK SPACE}findings in 8\N{NO-BREAK SPACE}motions" in page
    assert "- {name: lift, sign: -1}" in page
    assert "lift counts &lt;the other way&gt; round." in page
    assert "has to be mended" in page
    # Nothing found, nothing shown.
    CheckResult((), 8).save(copied / CHECK_NAME)
    assert sections(build_report(copied)) == SECTIONS


def test_the_gap_alone_is_a_report(copied):
    for name in ("ladder.json", "traces.json", "traces.npz", "quality.json", "analysis.json"):
        (copied / name).unlink()
    html = build_report(copied)
    assert sections(html) == ["verdict", "joints", "groups", "episodes", "provenance"]
    assert "data-trace-episode" not in html.replace("[data-trace-episode]", "")


def test_a_folder_without_gap_says_what_to_do(tmp_path):
    (tmp_path / "ladder.json").write_text("{}")
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(DataError, match="trueup gap"):
            build_report(folder)


def test_equal_inputs_give_equal_bytes(page, copied):
    assert build_report(copied) == page


@pytest.mark.long
@pytest.mark.parametrize("seed", ["0", "4242"])
def test_another_process_gives_the_same_bytes(page, run_folder, seed):
    code = (
        "import hashlib, sys, pathlib; from trueup.report import build_report; "
        "print(hashlib.sha256(build_report(pathlib.Path(sys.argv[1])).encode()).hexdigest())"
    )
    environment = {**os.environ, "PYTHONHASHSEED": seed, "TZ": "Asia/Tokyo", "LC_ALL": "C"}
    done = subprocess.run(
        [sys.executable, "-c", code, str(run_folder)], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout.strip() == hashlib.sha256(page.encode()).hexdigest()


@pytest.mark.long
def test_a_report_loads_neither_simulator_nor_torch(run_folder):
    code = (
        "import sys, pathlib; from trueup.report import build_report; build_report(pathlib.Path(sys.argv[1])); "
        "print({'mujoco', 'torch', 'pyarrow', 'trueup.dataset'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(run_folder)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_file_is_written_atomically_and_where_asked(copied, page):
    assert write_report(copied) == copied / "report.html"
    assert (copied / "report.html").read_text(encoding="utf-8") == page
    other = write_report(copied, copied / "deep" / "page.html")
    assert other.read_bytes() == (copied / "report.html").read_bytes()
    assert not list(copied.glob(".*.tmp"))


class Links(HTMLParser):
    """Everything in a page that could load something."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if name in ("src", "href", "data", "action", "srcset", "poster"):
                self.found.append((tag, value))


def test_nothing_is_loaded_from_anywhere(page):
    links = Links()
    links.feed(without_plotly(page))
    assert links.found
    assert all(value.startswith(("#", "data:")) for _, value in links.found)
    rest = without_plotly(page)
    assert "@import" not in rest
    assert "url(" not in rest
    assert "http://" not in rest
    assert "https://" not in rest
    assert "default-src 'none'" in page


HOSTILE = (
    '</script><script>window.hacked="1"</script>',
    "<img src=x onerror='window.hacked=\"2\"'>",
    '"><b>bold</b> & \u2028 {{ 7 * 7 }} __proto__',
)


@pytest.fixture(scope="module")
def hostile_folder(tmp_path_factory):
    runs = ('mujoco/<i onmouseover="x">stock', "<!-- fitted")
    world = World(joints=HOSTILE, scored=HOSTILE[:2], runs=runs, samples=300)
    world.names = tuple(f"{name} {HOSTILE[number % 3]}" for number, name in enumerate(world.names))
    return make_run(tmp_path_factory.mktemp("hostile") / "run", world)


def test_names_cannot_become_markup(hostile_folder):
    html = without_plotly(build_report(hostile_folder))
    assert "<script>window" not in html
    assert "<img src=x" not in html
    assert "<b>bold" not in html
    assert "<i onmouseover" not in html
    assert "<!-- fitted" not in html
    assert "&lt;img src=x" in html
    assert "7 * 7" in html
    held = re.findall(r'<script type="text/plain" (?:class="chooser|id="trace)-data">(.*?)</script>', html)
    assert held
    for text in held:
        read_json(text)
    # two scripts of ours, and data that is not run, of which one is the library that draws
    assert len(re.findall(r"<script>", html)) == 2


def test_packed_json_cannot_end_its_element():
    value = {"</script><!--": ["<script>", "&amp;", "\u2028"]}
    text = packed_json(value)
    assert not set("<>&\u2028") & set(text)
    assert read_json(text) == value
    with pytest.raises(ValueError, match="JSON"):
        packed_json(float("nan"))


@pytest.mark.long
def test_43_motions_of_six_joints_stay_below_5_megabytes(tmp_path):
    joints = tuple(f"joint_{number}" for number in range(6))
    world = World(joints=joints, scored=joints[:5], samples=1200, max_points=1000)
    world.names = tuple(f"motion_{number:02}" for number in range(43))
    world.splits = ("train",) * 33 + ("val",) * 4 + ("test",) * 6
    path = write_report(make_run(tmp_path / "run", world))
    assert 4e6 < path.stat().st_size < 5e6
    assert "Long curves are thinned to at most" in path.read_text(encoding="utf-8")


def test_a_single_motion_without_split_has_no_intervals(tmp_path):
    world = simulate(World(names=("only",), splits=("",), samples=200))
    tmp_path.joinpath("run").mkdir()
    make_gap(world).save(tmp_path / "run" / "gap.json")
    html = build_report(tmp_path / "run")
    assert "a single motion does not show how much motions differ" in html
    assert "decides nothing" in html
    assert "clearly" not in html
    assert sections(html) == ["verdict", "joints", "episodes", "provenance"]


@pytest.mark.parametrize("file", ["gap.json", "ladder.json", "traces.json", "quality.json", "analysis.json"])
@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"", DataError),
        (b"\xff\xfe\x00", DataError),
        (b'{"schema": "trueup.gap/1"', DataError),
        (b"[1, 2]", FormatError),
        (b'{"schema": "somebody.else/7"}', FormatError),
    ],
)
def test_broken_and_foreign_files_are_named(copied, file, content, error):
    (copied / file).write_bytes(content)
    with pytest.raises(error, match=re.escape(file)):
        build_report(copied)


@pytest.fixture(scope="module")
def small_folder(tmp_path_factory):
    world = World(names=("a", "b", "c"), splits=("train", "val", "test"), samples=60)
    return make_run(tmp_path_factory.mktemp("small") / "run", world)


def mutate(tree, rng):
    """Change, drop or replace one random node."""
    node, path = tree, []
    while isinstance(node, dict | list) and node and (not path or rng.random() < 0.85):
        key = rng.choice(sorted(node)) if isinstance(node, dict) else int(rng.integers(len(node)))
        path.append((node, key))
        node = node[key]
    parent, key = path[-1]
    if rng.random() < 0.25:
        del parent[key]
    else:
        values = [None, True, 3, -1, "text", [], {}, {"a": 1}, [None], 1e300, ""]
        parent[key] = values[rng.integers(len(values))]
    return tree


@pytest.mark.long
@pytest.mark.parametrize("file", ["gap.json", "ladder.json", "traces.json", "quality.json", "analysis.json"])
def test_changed_files_give_a_page_or_a_clear_error(small_folder, tmp_path, file):
    copied = shutil.copytree(small_folder, tmp_path / "run")
    rng = np.random.default_rng(len(file))
    whole = (copied / file).read_text()
    pages = errors = 0
    for _ in range(15):
        (copied / file).write_text(json.dumps(mutate(json.loads(whole), rng)))
        try:
            assert build_report(copied).endswith("</html>")
            pages += 1
        except TrueupError:
            errors += 1
    assert errors > 0
    assert pages + errors == 15


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("mujoco/fitted+net", "mujoco/<wbr>fitted+<wbr>net"),
        ("kp[elbow]", "kp<wbr>[elbow]"),
        ("a<b>/&c", "a&lt;b&gt;/<wbr>&amp;c"),
        ("plain", "plain"),
    ],
)
def test_long_names_may_break_where_their_parts_meet(text, shown):
    assert breakable(text) == shown


@pytest.mark.long
def test_a_close_is_told_in_the_order_of_the_questions_and_the_same_each_time(tmp_path):
    folder = make_close(tmp_path / "run")
    html = build_report(folder)
    first = ["verdict", "ladder", "attribution", "parameters", "traces", "open", "usage"]
    assert sections(html)[: len(first)] == first
    assert "Against the model as it came" in html
    assert build_report(folder) == html
    elsewhere = shutil.copytree(folder, tmp_path / "other" / "place")
    assert build_report(elsewhere) == html


def test_of_many_runs_the_first_and_the_judged_one_are_drawn(tmp_path, run_folder):
    run = RunFolder.load(make_close(tmp_path / "run"))
    assert set(CLOSE_RUNS) - set(hidden_first(run)) == {CLOSE_RUNS[0], CLOSE_RUNS[-1]}
    assert hidden_first(RunFolder.load(run_folder)) == []
