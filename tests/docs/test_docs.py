"""The pages in docs/: their examples run, nothing that the code offers is missing, links lead somewhere.

An HTML comment before a fenced block says what is done with it here: `<!-- run -->` runs it, `<!-- run: exit 3 -->`
expects this exit code of its last command, `<!-- file: NAME -->` writes it to a file. The blocks of a page run in
order in one folder, in which `runs/arm` is what `trueup demo --robot demo_arm --until gap` made. All other `trueup ...` lines are only parsed.
"""

import ast
import re
import shlex
import shutil
from dataclasses import dataclass, fields
from pathlib import Path
from typing import get_args

import pytest
from typer.main import get_command

from trueup.align.quality import KINDS
from trueup.cli.main import app, main
from trueup.core.episode import BROKEN_MEASUREMENT
from trueup.dataset.importers import stated
from trueup.dataset.importers.mapping import ClockColumn, SeriesColumns, SignalColumns, TableMapping
from trueup.robots import ControllerSpec, JointSpec, MotorSpec, ReplaySpec, RobotSpec, SimulationSpec, shipped_robots
from trueup.robots.spec import ControllerKind

ROOT = Path(__file__).parent.parent.parent
PAGES = sorted((ROOT / "docs").glob("*.md"))
NAMES = [page.stem for page in PAGES]
TEXT = {page.stem: page.read_text() for page in PAGES}
BLOCK = re.compile(
    r"(?:^<!-- (?P<what>run|file)(?:: (?P<value>[^>]+?))? -->\n)?^```(?P<kind>\w*)\n(?P<body>.*?)^```$", re.M | re.S
)


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and what the comment before it asks for."""

    kind: str
    body: str
    what: str = ""
    value: str = ""


def blocks(name):
    return [
        Block(*(found[key] or "" for key in ("kind", "body", "what", "value"))) for found in BLOCK.finditer(TEXT[name])
    ]


def command_lines(block):
    """The `trueup ...` lines of a shell or console block, as lists of arguments."""
    if block.kind not in ("sh", "console"):
        return []
    lines = [line.removeprefix("$ ") for line in block.body.splitlines() if block.kind == "sh" or line.startswith("$ ")]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("trueup ")]


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    with pytest.raises(SystemExit) as left:
        main(["demo", "--robot", "demo_arm", "--until", "gap", "--out", str(folder / "arm")])
    assert left.value.code == 0
    return folder / "arm"


# `make test` runs those of one page, for `trueup experiment`.
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.long] * (name != "experiments"))
        for name in NAMES
        if any(block.what == "run" for block in blocks(name))
    ],
)
def test_the_blocks_of_a_page_run_in_order(name, demo, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(demo, "runs/arm")
    for block in blocks(name):
        if block.what == "file":
            Path(block.value).write_text(block.body)
        elif block.what == "run" and block.kind == "python":
            exec(compile(block.body, f"{name}.md", "exec"), {})
        elif block.what == "run":
            lines = command_lines(block)
            assert len(lines) == len(block.body.splitlines()), f"not only `trueup` commands:\n{block.body}"
            for number, line in enumerate(lines, start=1):
                with pytest.raises(SystemExit) as left:
                    main(line)
                expected = int(block.value.removeprefix("exit ") or 0) if number == len(lines) else 0
                assert left.value.code == expected, f"{line}\n{capsys.readouterr()}"


@pytest.mark.parametrize("name", NAMES)
def test_no_block_is_overlooked(name):
    assert len(re.findall(r"^ *```", TEXT[name], re.M)) == 2 * len(blocks(name))
    assert TEXT[name].count("<!--") == len([block for block in blocks(name) if block.what])


def commands_of(group, *names):
    """Every command by its words: `gap`, `augment eval`."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands_of(command, *names, name)
        else:
            yield " ".join((*names, name)), command


COMMANDS = dict(commands_of(get_command(app)))


@pytest.mark.parametrize("name", NAMES)
def test_every_command_line_has_a_command_and_options_that_exist(name):
    for block in blocks(name):
        for line in command_lines(block):
            command = next(COMMANDS[words] for words in (line[0], " ".join(line[:2])) if words in COMMANDS)
            known = {opt for parameter in command.params for opt in parameter.opts} | {
                "--help",
                "--debug",
                "--quiet",
                "--json",
                "--verbose",
            }
            assert {part for part in line if part.startswith("--")} <= known, line


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_and_option_is_explained(command):
    everything = "\n".join(TEXT.values())
    assert f"`trueup {command}" in everything or f"trueup {command} " in everything
    options = {opt for parameter in COMMANDS[command].params for opt in parameter.opts if opt.startswith("--")}
    missing = {option for option in options if not re.search(rf"`[^`\n]*{option}(?![\w-])", everything)}
    assert not missing - {"--help"}


def quality_kinds():
    """Every kind of flag that is set anywhere: the strings in the `kind` of a `Flag(...)`."""
    kinds = set(KINDS)
    for file in sorted((ROOT / "src").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Flag":
                given = [keyword.value for keyword in node.keywords if keyword.arg == "kind"]
                strings = [item.value for value in given for item in ast.walk(value) if isinstance(item, ast.Constant)]
                assert all(isinstance(item, str) for item in strings)
                kinds |= set(strings)
    return kinds


def in_a_table(page, words):
    """Those that begin no row of a table, alone or in a list: `a`, `b`."""
    firsts = re.findall(r"^\| ([^|]+) \|", TEXT[page], re.M)
    known = {word for first in firsts for word in re.findall(r"`([^`]+)`", first)}
    return sorted(set(words) - known)


def names_of(*kinds):
    return {item.name for kind in kinds for item in fields(kind)}


@pytest.mark.long
def test_every_quality_flag_is_explained():
    assert len(quality_kinds()) > len(KINDS)
    assert not in_a_table("log-formats", quality_kinds())


def test_no_quality_flag_is_explained_that_does_not_exist():
    table = TEXT["log-formats"].split("| kind | what it means")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.M)) == quality_kinds()


def test_the_kinds_that_keep_a_motion_from_a_fit_are_marked():
    table = TEXT["log-formats"].split("| kind | what it means")[1].split("\n\n")[0]
    marked = set(re.findall(r"^\| `(\w+)` \|.*\| yes[^|]*\|$", table, re.M))
    assert marked == BROKEN_MEASUREMENT - {"silent"}  # that one is in docs/recording.md


def test_every_key_of_a_mapping_is_explained():
    assert not in_a_table(
        "log-formats",
        names_of(TableMapping, SeriesColumns, SignalColumns) - {"name", "joint_pattern"} | set(stated._KEYS),
    )
    page = TEXT["log-formats"]
    assert all(f"{{{key}" in page or f"{key}:" in page for key in names_of(ClockColumn))


def test_every_key_of_a_robot_and_every_controller_is_explained():
    keys = names_of(RobotSpec, JointSpec, ControllerSpec, MotorSpec, SimulationSpec, ReplaySpec) - {"folder"}
    assert not in_a_table("robot-yaml", keys)
    assert not in_a_table("robot-yaml", get_args(ControllerKind))
    (said,) = re.findall(r"^These come with trueup: (.*?)\.", TEXT["robots"], re.M | re.S)
    assert set(re.findall(r"`(\w+)`", said)) <= {file.stem for file in shipped_robots()}


def test_defaults_of_a_robot_are_those_that_the_page_states():
    for kind in (JointSpec, ControllerSpec, SimulationSpec):
        for item in fields(kind):
            if isinstance(item.default, bool | int | float):
                (row,) = re.findall(rf"^\| `{item.name}` \|.*$", TEXT["robot-yaml"], re.M)
                assert row.split("|")[2].strip() == str(item.default).lower(), row


def slug(heading):
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


@pytest.mark.parametrize("name", NAMES)
def test_relative_links_resolve(name):
    text = re.sub(r"^```.*?^```$", "", TEXT[name], flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("http"):
            continue
        file, _, anchor = target.partition("#")
        page = ROOT / "docs" / (file or f"{name}.md")
        assert page.is_file(), target
        if anchor:
            headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S), re.M)
            assert anchor in {slug(heading) for heading in headings}, target


def test_every_page_is_in_the_navigation_and_names_no_machine():
    navigation = (ROOT / "mkdocs.yml").read_text()
    for page in PAGES:
        assert page.name in navigation
        assert not re.search(r"(?<![\w.])/(work|tmp|home|root)\b", page.read_text()), page


def test_pages_for_users_are_few_and_short():
    """Fifteen that a user reads, in the first two sections; the other pages are looked up."""
    navigation = (ROOT / "mkdocs.yml").read_text().partition("nav:")[2]
    first = navigation[navigation.index("- Start:") : navigation.index("- Topics:")]
    pages = re.findall(r"([\w-]+)\.md", first)
    assert len(pages) <= 15
    assert all(len(TEXT[page].split()) <= 1500 for page in pages)
    assert sum(len(text.split()) for text in TEXT.values()) <= 60_000
