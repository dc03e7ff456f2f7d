"""Every command of every page is run, in less time; every block is, here or by the test that a table names.

The lines that no comment marks are taken from the text of a page, in order, and run in one folder, in which `laid_out`
has put what the text takes to be there. `smaller` says what sizes are changed, and why. Where a page shows what is
printed, it is printed, other numbers aside.
"""

import importlib.util
import itertools
import json
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
import torch
import yaml
from benchmarks.__main__ import NAMES
from typer.main import get_command

from augment.augment_cases import make_dataset
from augment.body_cases import make_bodies
from docs import blocks, laid_out, smaller
from docs.command_lines import PAGES, ROOT, SHELL, TEXT, blocks_of, lines, lines_of
from trueup.cli.main import app, main
from trueup.core.episode import EpisodeMeta
from trueup.core.protocols import RobotIO
from trueup.dataset import Dataset
from trueup.robots import load_robot, setup_of, with_kp_factor

RUN = [page for page in PAGES if page not in blocks.COMMANDS_ELSEWHERE and lines(page, "trueup")]
# Pages that take minutes.
SLOW = ("building-blocks", "compensation", "policies", "real-robots")
# Commands whose report is written without an option that asks for it.
REPORTS = ("close", "demo", "identify", "augment eval", "augment robustness")
# Imports two motions, then is killed.
KILLED = """
import os, signal, sys
from trueup.cli.main import main
from trueup.dataset import DatasetWriter

append, left = DatasetWriter.append, [2]

def counted(self, *arguments, **options):
    append(self, *arguments, **options)
    left[0] -= 1
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)

DatasetWriter.append = counted
main(sys.argv[1:])
"""


@pytest.fixture(scope="session")
def shelf(tmp_path_factory, request):
    return laid_out.Shelf(tmp_path_factory.mktemp("shelf"), request.getfixturevalue)


@pytest.fixture(autouse=True)
def _one_thread():
    """Threads wait for one another where other tests run beside this one."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def run(capsys):
    """Run a command, and look at what it prints and leaves."""

    def call(line):
        words = smaller.smaller(line)
        place = f"{line}\nrun as: trueup {' '.join(words)}"
        if line.killed:
            done = subprocess.run([sys.executable, "-c", KILLED, *words], capture_output=True, text=True, check=False)
            assert done.returncode == -9, f"{place}\n{done.stdout}{done.stderr}"
            return done.stderr
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main(words)
        out, err = capsys.readouterr()
        place = f"{place}\n{out}{err}"
        # In the little time that a test has, a close may have none for a step that was asked for, and says so.
        short = "no time was left" in err and words != list(line.words[1:])
        assert left.value.code in blocks.codes(line) or (short and left.value.code == 3), place
        assert "Traceback" not in out + err, place
        if left.value.code != 2:
            look_at(line, out, place)
        compare(line, out + err, place)
        return err

    return call


def look_at(line, out, place):
    """What the command was to leave is there."""
    if made := line.option("--out"):
        assert Path(made).exists() == ("--dry-run" not in line.words), place
        if Path(made).is_dir():
            assert any(Path(made).iterdir()), place
    reports = [Path(path) for path in re.findall(r"^report: (.+)$", out, re.M)]
    assert all(report.stat().st_size > 10_000 for report in reports), place
    text = " ".join(line.words[1:])
    if text.startswith(REPORTS) or (text.startswith("gap ") and made):
        assert reports, place


def masked(text):
    """Words, for numbers and verdicts are those of other data."""
    text = re.sub(r"\b(better|worse|undecided)\b", "VERDICT", re.sub(r"\b(less|more)\b", "LESS", text))
    return " ".join(re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "0", text).split())


def compare(line, printed, place):
    """What the page shows is printed."""
    said = {masked(text) for text in printed.splitlines()}
    for shown in line.shown:
        drawn = set(shown) & set("│┃━─…") or shown == "..."
        if not drawn and not any(re.match(known, shown) for known in blocks.OTHER_DATA.get(line.page, ())):
            assert masked(shown) in said, f"the page shows: {shown}\n{place}"


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.slow if page in SLOW else pytest.mark.long) for page in RUN],
)
def test_the_commands_of_a_page_run_in_order(page, shelf, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    laid_out.lay(shelf, page)
    for line in lines(page, "trueup"):
        for prepare in laid_out.before(line):
            prepare(shelf, monkeypatch)
        run(line)
    for path in blocks.CONTRACTS.get(page, ()):
        check_contract(json.loads(Path(path).read_text()), path)


def check_contract(made, path):
    """The page's example of such a file has the keys that it has."""
    examples = [
        (block, json.loads(block.body))
        for page in PAGES
        for block in blocks_of(page)
        if (block.kind, block.what) == ("json", "") and json.loads(block.body)["schema"] == made["schema"]
    ]
    assert examples, f"no page has an example of {path}"
    for block, example in examples:
        check_keys(example, made, f"{block}: {path}")


def check_keys(example, made, where):
    """Keys of an example are in what was made, all the way down; names of joints, motions, runs may be others."""
    if isinstance(example, dict) and isinstance(made, dict) and example and made:
        if example.keys() & made.keys():
            assert example.keys() <= made.keys(), f"{where}: {sorted(example.keys() - made.keys())} are not there"
            for key, value in example.items():
                check_keys(value, made[key], f"{where}, {key}")
        else:
            check_keys(next(iter(example.values())), next(iter(made.values())), f"{where}, {next(iter(made))}")
    elif isinstance(example, list) and isinstance(made, list) and example and made:
        check_keys(example[0], made[0], where)


def test_sizes_are_changed_and_nothing_else():
    everything = [line for page in PAGES for line in lines(page, "trueup")]
    for rule in smaller.TABLE:
        assert rule.give.keys() <= smaller.SIZES | smaller.UNSURE, rule
        assert any(rule.fits(line) for line in everything), f"no line is meant: {rule}"
    for page, words in laid_out.BEFORE:
        assert any(line.page == page and line.begins(words) for line in everything), (
            f"no line is meant: {page}, {words}"
        )


def test_every_example_of_a_file_is_compared_with_one():
    schemas = {
        json.loads(block.body)["schema"]
        for page in PAGES
        for block in blocks_of(page)
        if (block.kind, block.what) == ("json", "") and "[json]" not in blocks.ELSEWHERE.get(page, {})
    }
    stems = [Path(path).stem for paths in blocks.CONTRACTS.values() for path in paths]
    assert schemas == {f"trueup.{stem}/{blocks.VERSIONS.get(stem, 1)}" for stem in stems}
    assert set(blocks.CONTRACTS) <= set(RUN)


@pytest.mark.long
def test_every_benchmark_shows_what_was_measured():
    """Measuring takes a day; without a name it is all of them."""
    command = [sys.executable, "-m", "benchmarks", "--table"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    for line in (line for page in PAGES for line in lines(page, "python")):
        assert line.words[1] == "-m", line
        for name in itertools.takewhile(lambda word: not word.startswith("--"), line.words[3:]):
            assert re.search(rf"^\W*{name}\b", done.stdout, re.M), f"{line}: nothing is known of it"


@pytest.mark.parametrize("page", PAGES)
def test_benchmarks_that_are_named_exist(page):
    for name in re.findall(r"python -m benchmarks\s+([a-z]\w*)", TEXT[page]):
        assert name in NAMES, f"{PAGES[page].name}: python -m benchmarks {name}"
    for name in re.findall(r"python -m (benchmarks\.\w+)", TEXT[page]):
        found = importlib.util.find_spec(name)
        assert found, f"{PAGES[page].name}: python -m {name}"
        entry = (
            Path(found.origin)
            if found.submodule_search_locations is None
            else Path(found.origin).parent / "__main__.py"
        )
        assert '__name__ == "__main__"' in entry.read_text(), f"{PAGES[page].name}: python -m {name} does nothing"


@pytest.mark.parametrize("page", PAGES)
def test_what_is_made_can_be_made(page):
    targets = {line.words[1] for line in lines(page, "make")} | set(re.findall(r"`make ([\w-]+)`", TEXT[page]))
    for target in targets:
        done = subprocess.run(["make", "-n", target], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{PAGES[page].name}: make {target}\n{done.stderr}"


@pytest.mark.parametrize("page", PAGES)
def test_what_is_installed_has_these_extras(page):
    known = set(metadata.metadata("trueup").get_all("Provides-Extra"))
    assert known == set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    assert all(line.words[:2] == ("pip", "install") for line in lines(page, "pip"))
    assert not re.search(r"pip install ['\"]?trueup", TEXT[page]), f"{PAGES[page].name}: there is no release yet"
    for extras in re.findall(r"'\.\[([^\]]+)\]'", TEXT[page]):
        assert set(extras.split(",")) <= known, f"{PAGES[page].name}: .[{extras}]"


def test_the_container_is_tested_and_what_runs_in_it_is_a_command():
    found = lines("realtime", "docker")
    assert [line.words[1] for line in found] == ["build", "run"]
    assert "def test_every_step_runs_in_a_clean_folder" in (ROOT / "tests" / "test_dockerfile.py").read_text()
    words = found[1].words[found[1].words.index("trueup") + 1 :]
    command = get_command(app).commands["deploy"].commands["ros2"]
    assert words[:2] == ("deploy", "ros2")
    command.make_context("ros2", list(words[2:]))


# Snippets that only stand for a part of something.


def the_block(page, first):
    (found,) = [block for block in blocks_of(page) if block.first == first]
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("first", "make"),
    [("method: realeasy-rt", make_dataset), ("method: sat-bodies", make_bodies)],
    ids=["motions", "bodies"],
)
def test_a_configuration_of_a_network_is_trained_with(first, make, tmp_path, capsys):
    tree = yaml.safe_load(the_block("augmentation", first).body)
    own = {"bodies": tuple(tree["data"]["bodies"])} if "bodies" in tree["data"] else {}
    make(tmp_path / "data", counts=(2, 1, 1), **own)
    options = ("augment", "train", tmp_path / "data", "--config", tmp_path / "own.yaml", "--epochs", 1, "--jobs", 1)
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(tree))
    laid_out.run(*options, "--out", tmp_path / "model")
    card = json.loads((tmp_path / "model" / "model.json").read_text())
    assert card["method"] == tree["method"]
    assert {item["signal"].rpartition(".")[0] or item["signal"] for item in card["outputs"]} == set(
        tree["data"]["signals"]
    )


def test_friction_is_read_from_the_description_of_a_robot(tmp_path):
    tree = yaml.safe_load(the_block("friction", "friction:").body)
    robot = described("so101", tmp_path, **tree)
    assert {name: law.load for name, law in robot.friction.items()} == {"shoulder_lift": 0.12, "elbow_flex": 0.1}


def test_the_jaw_of_the_so101_is_described_as_its_robot_has_it():
    (joint,) = yaml.safe_load(
        next(block.body for block in blocks_of("robot-yaml") if block.first.startswith("- {name: gri"))
    )
    (shipped,) = [item for item in load_robot("so101").to_dict()["joints"] if item["name"] == "gripper"]
    assert joint.items() <= shipped.items()


def test_a_robot_that_takes_torques_is_described_so(tmp_path):
    tree = yaml.safe_load(the_block("robot-yaml", "controller: {kind: torque}").body)
    robot = described("demo_arm", tmp_path, **tree)
    assert (robot.controller.kind, robot.replay.window_s) == ("torque", 0.5)


def test_a_gain_that_differs_from_motion_to_motion_is_described_so(tmp_path):
    tree = yaml.safe_load(
        the_block("robot-yaml", "controller: {kind: position, kp: 0.7, kv: 0.02, kp_setting: 400}").body
    )
    robot = described("demo_arm", tmp_path, **tree)
    quarter = setup_of(robot, EpisodeMeta("one", kp_setting=100.0))
    assert with_kp_factor(robot, quarter.kp_factor).controller.kp == pytest.approx(0.7 / 4)


@pytest.mark.parametrize("first", ["base: held", "unlisted: lock"])
def test_the_ways_to_hold_a_base_and_other_joints_are_read(first, tmp_path):
    """Each line is one way to write the same key."""
    (block,) = [block for block in blocks_of("robot-yaml") if block.first.startswith(first)]
    for line in block.body.splitlines():
        (entry,) = yaml.safe_load(line).items()
        robot = described("demo_arm", tmp_path, **dict([entry]))
        assert getattr(robot, entry[0]) is not None, line


def test_the_description_that_is_shown_is_read(tmp_path):
    (tmp_path / "robot.yaml").write_text(the_block("robot-yaml", "schema: trueup.robot/1").body)
    assert load_robot(tmp_path / "robot.yaml").joint_names == ("shoulder", "elbow")


@pytest.mark.long
def test_init_writes_the_description_that_is_shown(shelf, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    laid_out.lay(shelf, "robots")
    run(next(line for line in lines("robots", "trueup") if line.begins("init")))
    written = Path("described/robot.yaml").read_text()
    shown = the_block("robots", "schema: trueup.robot/1").body
    assert masked(shown) == masked(re.sub(r"^#.*\n", "", written, flags=re.M))
    assert yaml.safe_load(shown)["joints"] == yaml.safe_load(written)["joints"]


def test_the_files_of_the_cheat_sheet_are_read(tmp_path):
    description, mapping = (block.body for block in blocks_of("cheat-sheet") if block.kind == "yaml")
    (tmp_path / "robot.yaml").write_text(description)
    assert [joint.log_unit for joint in load_robot(tmp_path / "robot.yaml").joints] == ["deg", "deg"]
    rows = "\n".join(f"{20 * k},{k},{-k},{k + 1},{-k - 1}" for k in range(50))
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "one.csv").write_text(f"t_ms,q1,q2,q1_cmd,q2_cmd\n{rows}\n")
    (tmp_path / "logs" / "mapping.yaml").write_text(mapping)
    laid_out.run("import", tmp_path / "logs", "--out", tmp_path / "data")
    (episode,) = Dataset(tmp_path / "data")
    assert episode.measured.units["position"] == ("deg", "deg")
    assert episode.command["position"][3].tolist() == [4.0, -4.0]


def described(name, folder, **changes):
    """A shipped robot with other entries in its description."""
    (folder / "robot.yaml").write_text(yaml.safe_dump({**load_robot(name).to_dict(), **changes}))
    return load_robot(folder / "robot.yaml")


def test_a_robot_of_ones_own_has_what_an_experiment_needs():
    names = {}
    exec(compile(the_block("experiments", "class MyRobot:").body, "experiments.md", "exec"), names)
    robot, sent = names["MyRobot"](), []
    robot.driver = type("Driver", (), {"send": staticmethod(sent.append)})
    assert isinstance(robot, RobotIO)
    robot.write({"torque": [0.5]})
    assert sent == [[0.5]]
    assert "position" in robot.read()


def test_what_is_imported_can_be():
    exec(
        compile(
            the_block("compensation", "from trueup.stages import compensate, compensated_replay, prepare").body,
            "",
            "exec",
        ),
        {},
    )


def test_a_dataset_has_these_files(shelf):
    head, *rows = the_block("dataset", "data/arm/").body.splitlines()
    assert head.strip() == "data/arm/"
    folders = []
    for row in rows:
        depth, (name, *said) = (len(row) - len(row.lstrip())) // 2, row.split(None, 1)
        folders = [*folders[: depth - 1], name]
        if not any(word in " ".join(said) for word in ("only while", "if it lay")):
            assert (shelf.demo / "".join(folders[:-1]) / folders[-1]).exists(), row


def test_the_states_of_a_network_are_named_as_in_cpp(tmp_path):
    import onnx
    from benchmarks.networks import real_time

    (body,) = [block.body for block in blocks_of("runtime") if block.kind == "cpp"]
    real_time(tmp_path, hidden=(8, 5))
    graph = onnx.load(str(tmp_path / "model.onnx")).graph
    bound = {kind: set(re.findall(rf'Bind{kind}put\("(\w+)"', body)) for kind in ("In", "Out")}
    assert bound["In"] <= {item.name for item in graph.input} == {"x", "h0", "c0", "h1", "c1"}
    assert bound["Out"] <= {item.name for item in graph.output}


# Nothing is left over.


@pytest.mark.parametrize("page", PAGES)
def test_every_block_is_run(page):
    assert len(re.findall(r"^ *```", TEXT[page], re.M)) == 2 * len(blocks_of(page))
    known = {**blocks.ELSEWHERE.get(page, {}), **blocks.HERE.get(page, {}), **blocks.SHOWN.get(page, {})}
    used = set()
    for block in blocks_of(page):
        if block.what:
            continue
        if block.kind in SHELL:
            found = {line.words[0] for line in lines_of(block)}
            assert found <= {"trueup", "make", "pip", "docker", "python"}, f"{block} has other commands"
            if found - ({"trueup"} if page in blocks.COMMANDS_ELSEWHERE else set()):
                continue
        names = [name for name in known if name == f"[{block.kind}]" or block.first.startswith(name)]
        assert names, f"{block} is not run by any test: {block.first}"
        used |= set(names)
    assert used == set(known), f"{page}: no such blocks"


def test_the_tests_that_run_blocks_elsewhere_exist():
    own = Path(__file__).read_text()
    for page, tests in blocks.ELSEWHERE.items():
        for name in {*tests.values()}:
            file, _, test = name.partition("::")
            text = (ROOT / file).read_text()
            assert f"def {test}(" in text, name
            assert PAGES[page].name in text or (page == "README" and "README" in text), f"{file} does not read {page}"
    for page, tests in blocks.HERE.items():
        for test in tests.values():
            assert f"def {test}(" in own, f"{page}: {test}"
