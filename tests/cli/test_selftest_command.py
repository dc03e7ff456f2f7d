"""`trueup selftest` says which numbers would be recovered, and exits with 3 where one is missed."""

import json

import pytest
import yaml

from trueup.cli.console import out
from trueup.cli.main import main
from trueup.cli.selftest import robot_table, robots_table, show, summary, what_to_record
from trueup.core.selftest_result import DrawnNumber, DrawnRobot, SelftestResult

FEW = {"fit": {"kp": "all", "torque_offset": "all"}, "models": {}, "data": {"budget_s": 12.0}}


def call(*words):
    with pytest.raises(SystemExit) as left:
        main(["selftest", *map(str, words)])
    return left.value.code


def number(name, verdict, **own):
    given = {"truth": 1.1, "nominal": 1.0, "value": 1.2, "interval": (1.0, 1.4), "off": 0.5, **own}
    return DrawnNumber(name, "Nm", verdict=verdict, sentence="said: so", excite="move {target} harder", **given)


def printed(table):
    with out.capture() as captured:
        out.print(table)
    return captured.get()


def drawn(*numbers, seed=0):
    return DrawnRobot(seed, 1, numbers, "ok", "base", 3.0)


@pytest.mark.long
def test_the_command_prints_and_writes_and_refuses_to_overwrite(tmp_path, capsys):
    (tmp_path / "fit.yaml").write_text(yaml.safe_dump(FEW))
    options = ("--robot", "demo_arm", "--config", tmp_path / "fit.yaml", "--jobs", 1, "--out", tmp_path / "s.json")
    code = call(*options)
    text = "".join(capsys.readouterr())
    written = json.loads((tmp_path / "s.json").read_text())
    missed = [item for item in written["truths"][0]["numbers"] if item["verdict"] == "missed"]
    assert code == (3 if missed else 0)
    assert "of 6 numbers would be recovered from these motions" in text
    assert "kp[elbow]" in text
    assert call(*options) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--robot", "demo_arm", "--noise", "0"), "noise"),
        (("--robot", "demo_arm", "--budget", "5"), "no unit"),
        (("--robot", "nobody"), "nobody"),
        (("nowhere", "--robot", "demo_arm"), "nowhere"),
    ],
)
def test_bad_input_is_told_in_a_line_or_two(words, said, capsys):
    assert call(*words) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert said in " ".join(lines)
    assert len([line for line in lines if line.startswith(("error", "  next"))]) <= 2


def test_the_summary_counts_and_names(capsys):
    numbers = (
        number("kp[a]", "recovered"),
        number("kv[a]", "open"),
        number("kv[b]", "open"),
        number("mass[c]", "missed"),
    )
    one = SelftestResult((drawn(*numbers),), 3, 12.0, {"a": 3e-4})
    text = summary(one)
    assert text.startswith(
        "1 of 4 numbers would be recovered from these motions; 2 are not determined: kv[a], kv[b]; 1 "
    )
    assert text.endswith("1 are missed: mass[c]")
    show(one)
    assert "1 number is missed" in (said := capsys.readouterr().err)
    assert "of 2 intervals of 95 % about 0.1 miss by chance" in said
    assert what_to_record(one) == ["to determine kv: move a, b harder"]
    assert one.missed == 1
    table = printed(robot_table(one.truths[0]))
    assert "0.5 half intervals from the truth" in table


def test_several_robots_share_a_table():
    first = drawn(number("kp[a]", "recovered"), number("kv[a]", "open", value=None, interval=None, off=None))
    second = drawn(number("kp[a]", "missed"), number("kv[a]", "open"), seed=1)
    table = printed(robots_table((first, second)))
    cells = [line.replace(" ", "").split("│")[1:-1] for line in table.splitlines() if line.startswith("│")]
    rows = {row[0]: row[3:] for row in cells}
    assert rows == {"kp[a]": ["1", "", "1"], "kv[a]": ["", "2", ""]}
    text = summary(SelftestResult((first, second), 3, 12.0, {"a": 3e-4}))
    assert "1 of 4 numbers would be recovered from these motions, in 2 drawn robots" in text
