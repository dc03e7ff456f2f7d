"""docs/security.md: behind each of its lines there is a test."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
TEXT = (ROOT / "docs" / "security.md").read_text()
ROWS = [line for line in TEXT.splitlines() if line.startswith("| ") and "---" not in line]


def test_each_line_names_a_test_that_is_there():
    lines = [row for row in ROWS if not row.startswith("| what comes")]
    assert len(lines) > 20
    for row in lines:
        named = re.search(r"`(tests/[\w/]+\.py)(?:::(\w+))?` \|$", row)
        assert named, row
        file, name = ROOT / named.group(1), named.group(2)
        assert file.is_file(), row
        functions = {node.name for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef)}
        assert name is None or name in functions, row
