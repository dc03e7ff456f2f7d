"""Every example runs, says what it should, and stands in the list."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
# File -> its words on the command line, and what it must say.
SAID = {
    "how_large_is_the_gap.py": (["OUT"], ["mujoco/stock:", "on test", "report:"]),
    "what_has_the_model_wrong.py": (["OUT"], ["kp[", "determined: effective", "fitted:"]),
    "correct_in_a_control_loop.py": ([], ["300 steps", "Nm"]),
    "train_in_a_corrected_simulator.py": (["150"], ["150 steps of training", "ok"]),
    "which_robot_is_different.py": (["OUT"], ["delay_s: ", "unlike: arm-4"]),
    "from_arrays_to_a_dataset.py": (["OUT"], ["motion/00003: 400 samples at 100 Hz"]),
}
MINUTES = {"which_robot_is_different.py", "what_has_the_model_wrong.py"}


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in MINUTES)) for name in SAID])
def test_it_runs(name, tmp_path):
    words, said = SAID[name]
    words = [str(tmp_path / "out") if word == "OUT" else word for word in words]
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *words],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for words in said:
        assert words in done.stdout, done.stdout


def test_all_of_them_stand_in_the_list():
    files = {path.name for path in EXAMPLES.glob("*.py")}
    assert files == set(SAID)
    listed = (EXAMPLES / "README.md").read_text()
    assert all(f"({name})" in listed for name in files)
