"""The command line under words that nobody would type: every answer is a line or two, never a traceback."""

import shlex
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.main import get_command

from trueup.cli.main import app, main
from trueup.stages import demo_dataset

# They record, train, serve or look at this machine whatever they are given; their own tests give them bad words.
LONG = ("demo", "doctor", "deploy serve", "deploy ros2", "policy train", "policy grid")
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


COMMANDS = {words: command for words, command in commands_of(get_command(app)) if " ".join(words) not in LONG}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("data") / "data")


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
    return [word for word in line if word != "--help"]


@settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck))
@given(line=lines())
def test_any_line_is_answered(line, data, tmp_path_factory, capsys):
    folder = tmp_path_factory.mktemp("fuzz")
    line = [{"DATA": str(data), "OUT": str(folder / "out")}.get(word, word) for word in line]
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


@pytest.mark.parametrize("words", sorted(COMMANDS), ids=" ".join)
@pytest.mark.parametrize(
    "value",
    ["", "nan", "-1", "/dev/zero", "a" * 5000, "\x1b[2J", "[bold]"],
    ids=["empty", "nan", "minus", "zeros", "long", "escape", "markup"],
)
def test_each_option_alone(words, value, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for parameter in COMMANDS[words].params:
        if parameter.param_type_name == "argument" or getattr(parameter, "is_flag", False):
            continue
        with pytest.raises(SystemExit) as left:
            main([*words, "nothing", parameter.opts[0], value])
        out, err = capsys.readouterr()
        assert left.value.code == 2, f"{words} {parameter.opts[0]} {value!r}\n{out}{err}"
        assert "Traceback" not in out + err
        assert "\x1b[2J" not in out + err
    assert not list(Path().iterdir())
