"""The Python of docs/augmentation.md runs."""

import re
from pathlib import Path

import numpy as np
from benchmarks.networks import real_time

from trueup.core.protocols import Simulator

TEXT = (Path(__file__).parent.parent.parent / "docs" / "augmentation.md").read_text()


def test_the_python_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    real_time(Path("models/panda-rt"), hidden=(8, 5), rate_hz=100.0)
    (block,) = re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S)
    names = {}
    exec(compile(block, "augmentation.md", "exec"), names)
    assert isinstance(names["corrected"], Simulator)
    assert names["reading"]["torque"].shape == (64, 7)
    inside = names["simulator"].step({"position": names["pose"]})  # one step on, at rest
    assert np.abs(names["reading"]["position"] - inside["position"]).max() > 0.01
