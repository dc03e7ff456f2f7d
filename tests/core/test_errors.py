from trueup.errors import ConfigError, NameMismatch


def test_a_message_is_one_printable_line_whatever_a_file_said():
    error = NameMismatch("joints", left=["\x1b[2J", "a\nb", "x" * 5000], right=["\ud800"], hint="a:\n  - b")
    assert error.summary == f"joints: got [\\x1b[2J, a b, {'x' * 60}…], expected [\\ud800]"
    assert error.hint == "a:\n  - b"
    assert len(str(ConfigError("wrong", got=b"\x00" * 1000, expected="y" * 9000))) < 2000
