import pytest

from trueup.errors import ConfigError, NameMismatch


def test_a_message_is_one_printable_line_whatever_a_file_said():
    error = NameMismatch("joints", left=["\x1b[2J", "a\nb", "x" * 5000], right=["\ud800"], hint="a:\n  - b")
    assert error.summary == f"joints: got [\\x1b[2J, a b, {'x' * 60}…], expected [\\ud800]"
    assert error.hint == "a:\n  - b"
    assert len(str(ConfigError("wrong", got=b"\x00" * 1000, expected="y" * 9000))) < 2000


@pytest.mark.parametrize(
    ("what", "got", "meant"),
    [
        ("'so11' is no shipped robot", None, "so101"),
        ("robot.yaml has unknown keys ['modle']", None, "model"),
        ("there is no format", "tabel", "table"),
        ("joints: unknown keys ['Panda']", None, "panda"),
        ("'so101' is there", None, ""),
        ("there is no robot 'xyz'", None, ""),
    ],
)
def test_a_name_that_is_nearly_right_is_asked_for(what, got, meant):
    error = ConfigError(what, got=got, available=iter(["so101", "model", "table", "panda"]))
    asked = f"did you mean '{meant}'?" if meant else "did you mean"
    assert (asked in str(error)) is bool(meant)
    assert "available: so101, model, table, panda" in str(error)
