"""The command line under words that nobody would type: every answer is a line or two, never a traceback."""

import os
import shlex

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.main import get_command

from trueup.cli.main import app, main
from trueup.stages import demo_dataset

# They need no file to begin: what comes last on their lines, and counts, bounds what they do.
BOUNDS = {
    "demo": ("--robot", "demo_arm", "--until", "replay", "--jobs", "1"),
    "doctor": ("--seconds", "0.1"),
    "robots": (),
    "deploy serve": ("--seconds", "0.05", "--localhost", "--domain", "99"),
    "deploy ros2": ("--seconds", "0.05", "--localhost", "--domain", "99"),
    "policy train": ("--config", "SMALL", "--steps", "16", "--jobs", "1", "--out", "made"),
    "policy grid": ("--config", "SMALL", "--grid", "GRID", "--steps", "16", "--jobs", "1", "--out", "made"),
}
SMALL = """
algorithm: sac
learner: {starts: 4, batch: 4, updates: 1, buffer: 100, layers: [4]}
reach: {control_hz: 25.0, episode_s: 0.2}
arms: 2
steps: 16
rounds: 1
"""
HOSTILE = [
    *(
        "",
        " ",
        "-",
        "--",
        "-1",
        "0",
        "1e999",
        "nan",
        "inf",
        "-inf",
        "1_000",
        "0x10",
        "None",
        "null",
        "true",
        "[]",
        "{}",
    ),
    *(
        "../../etc/passwd",
        "/etc/passwd",
        "/dev/null",
        "/dev/zero",
        "/proc/self/mem",
        "/",
        ".",
        "..",
        "~",
        "$HOME",
        "`id`",
    ),
    *(
        "a" * 5000,
        "a/" * 500,
        "é",
        "日本",
        "\u202e",
        "\x1b[2J",
        "\n",
        "\t",
        "a\nb",
        "%s%n",
        "{0}",
        "[bold]",
        "[/]",
        "'",
        '"',
    ),
    *(
        "zoo:",
        "zoo:../x",
        "test",
        "all",
        "position",
        "position.rmse=1",
        "position.rmse=nan",
        "a=b",
        "=",
        "1/2/3",
        "0/0/0",
    ),
    *("9" * 400, "-" + "9" * 400, "1e-400", "mujoco/stock", "mujoco/../x", "panda", "demo_arm", "lab", "warp", "cuda"),
]


def commands_of(group, *names):
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands_of(command, *names, name)
        else:
            yield (*names, name), command


COMMANDS = dict(commands_of(get_command(app)))


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """What words stand for."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "small.yaml").write_text(SMALL)
    (folder / "grid.yaml").write_text("seed: [0]\n")
    words = {"DATA": demo_dataset(folder / "data"), "SMALL": folder / "small.yaml", "GRID": folder / "grid.yaml"}
    return {word: str(path) for word, path in words.items()}


@pytest.fixture(autouse=True)
def cores():
    """A line may ask for some of them: `--cpu 0`."""
    mine = os.sched_getaffinity(0)
    yield
    os.sched_setaffinity(0, mine)


def bounds_of(words):
    return BOUNDS.get(" ".join(words), ())


def test_what_needs_no_file_is_bounded():
    without = {" ".join(words) for words, command in COMMANDS.items() if not any(p.required for p in command.params)}
    assert without <= set(BOUNDS)


@st.composite
def lines(draw):
    """A command with some of its own options, each with some word, and words in between."""
    words = draw(st.sampled_from(sorted(COMMANDS)))
    command = COMMANDS[words]
    value = st.sampled_from(HOSTILE) | st.text(
        st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12
    )
    line = [*words]
    for parameter in command.params:
        if parameter.param_type_name == "argument":
            line += draw(st.lists(value | st.just("DATA"), max_size=2))
        elif draw(st.booleans()):
            line.append(draw(st.sampled_from(parameter.opts)))
            if not getattr(parameter, "is_flag", False):
                line.append(draw(value | st.just("OUT")))
    return [*(word for word in line if word != "--help"), *bounds_of(words)]


@pytest.mark.long
@settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck))
@given(line=lines())
def test_any_line_is_answered(line, there, tmp_path_factory, capsys):
    folder = tmp_path_factory.mktemp("fuzz")
    line = [{**there, "OUT": str(folder / "out")}.get(word, word) for word in line]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        with pytest.raises(SystemExit) as left:
            main(line)
    out, err = capsys.readouterr()
    shown = shlex.join(line)
    assert left.value.code in (0, 2, 3), f"{shown}\n{out}\n{err}"
    assert "Traceback" not in out + err, shown
    if left.value.code == 2:
        assert err.strip() or out.strip(), shown
        assert len(err) < 20_000, shown
    assert "\x1b[2J" not in out + err, shown


@pytest.mark.long
@pytest.mark.parametrize("words", sorted(COMMANDS), ids=" ".join)
@pytest.mark.parametrize(
    "value",
    ["", "nan", "-1", "/dev/zero", "a" * 5000, "\x1b[2J", "[bold]"],
    ids=["empty", "nan", "minus", "zeros", "long", "escape", "markup"],
)
def test_each_option_alone(words, value, there, tmp_path, capsys, monkeypatch):
    """Where no file is missing, a word may be right: `nan` is the name of a policy, and of a folder."""
    bounds = [there.get(word, word) for word in bounds_of(words)]
    reads = any(parameter.param_type_name == "argument" for parameter in COMMANDS[words].params)
    line = [*words, *(["nothing"] if reads or not bounds else []), *bounds]
    for parameter in COMMANDS[words].params:
        option = parameter.opts[0]
        if parameter.param_type_name == "argument" or getattr(parameter, "is_flag", False) or option in bounds:
            continue
        here = tmp_path / parameter.name
        here.mkdir()
        monkeypatch.chdir(here)
        with pytest.raises(SystemExit) as left:
            main([*line, option, value])
        out, err = capsys.readouterr()
        assert left.value.code in ((0, 2) if bounds else (2,)), f"{words} {option} {value!r}\n{out}{err}"
        assert "Traceback" not in out + err
        assert "\x1b[2J" not in out + err
        if left.value.code == 2:
            assert not list(here.iterdir()), f"{words} {option} {value!r}"
