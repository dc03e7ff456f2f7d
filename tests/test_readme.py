"""The example of the README runs, and the README stays short."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parent.parent / "README.md"


@pytest.mark.long
def test_the_python_example_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert len(code.strip().splitlines()) <= 13
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(README), "exec"), {})
    printed = capsys.readouterr().out
    stock, delayed = (float(re.search(rf"mujoco/{name}: ([0-9.]+) \[", printed)[1]) for name in ("stock", "delayed"))
    assert 0 < delayed < stock
    assert (tmp_path / "runs/readme/report.html").stat().st_size > 1e6


def test_the_readme_is_short_and_its_links_lead_somewhere():
    text = README.read_text()
    assert len(text.splitlines()) < 120
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("http") or (README.parent / target).exists(), target
