"""Pinning, priorities, locked memory, and what is seen of a host."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from trueup.cli.main import main
from trueup.deploy.realtime import HostCheck, RealTimeSettings, host_checks
from trueup.errors import ConfigError

GOOD = {
    "sys/kernel/realtime": "1\n",
    "sys/devices/system/cpu/isolated": "2-3\n",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance\n",
    "proc/sys/kernel/sched_rt_runtime_us": "-1\n",
    "proc/swaps": "Filename Type Size Used Priority\n",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc\n",
    "proc/version": "Linux version 6.1\n",
}
BAD = {
    "sys/devices/system/cpu/isolated": "\n",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "powersave\n",
    "proc/sys/kernel/sched_rt_runtime_us": "950000\n",
    "proc/swaps": "Filename Type Size Used Priority\n/dev/sda2 partition 1 0 -2\n",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet\n",
    "proc/version": "Linux version 6.1\n",
}
OF_FILES = ("kernel", "cores kept free", "clock rate of the cores", "share for real-time threads", "swap", "clock")


def host(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return {check.what: check for check in host_checks(folder)}


def test_a_host_that_is_made_for_it(tmp_path):
    checks = host(tmp_path, GOOD)
    assert {name: checks[name].good for name in OF_FILES} == dict.fromkeys(OF_FILES, True)
    assert checks["share for real-time threads"].found == "all"


def test_a_host_that_is_not_and_what_to_do(tmp_path):
    checks = host(tmp_path, BAD)
    assert {name: checks[name].good for name in OF_FILES} == dict.fromkeys(OF_FILES, False)
    assert all(checks[name].hint for name in OF_FILES)
    assert checks["share for real-time threads"].found == "95%"


def test_a_kernel_that_says_it_in_its_version(tmp_path):
    assert host(tmp_path, {"proc/version": "Linux version 6.1.0-rt #1 SMP PREEMPT_RT Debian\n"})["kernel"].good


def test_a_machine_that_says_nothing(tmp_path):
    checks = host(tmp_path, {})
    assert checks["clock"] == HostCheck("clock", "not said", None, checks["clock"].hint)
    assert checks["clock rate of the cores"].good is None
    assert checks["share for real-time threads"].good is None


@pytest.mark.parametrize("settings", [{"priority": 0}, {"priority": 100}, {"cpus": ()}, {"cpus": (10_000,)}])
def test_settings_that_no_system_has(settings):
    with pytest.raises(ConfigError, match="expected"):
        RealTimeSettings(**settings)


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)


def test_a_process_is_pinned():
    core = sorted(os.sched_getaffinity(0))[-1]
    done = run(
        "import os; from trueup.deploy.realtime import RealTimeSettings\n"
        f"RealTimeSettings(cpus=({core},)).apply(); print(os.sched_getaffinity(0))"
    )
    assert done.stdout.strip() == f"{{{core}}}", done.stderr


def test_priority_and_memory_are_had_or_refused_with_what_allows_them():
    done = run(
        "import os, pathlib; from trueup.deploy.realtime import RealTimeSettings\n"
        "RealTimeSettings(priority=70, lock_memory=True).apply()\n"
        "print(os.sched_getscheduler(0) == os.SCHED_FIFO, os.sched_getparam(0).sched_priority)\n"
        "print([line for line in pathlib.Path('/proc/self/status').read_text().splitlines() if 'VmLck' in line])"
    )
    if done.returncode == 0:
        assert done.stdout.startswith("True 70")
        assert " 0 kB" not in done.stdout
    else:
        assert "ulimit" in done.stderr


def test_a_refusal_says_how_to_allow_it(monkeypatch):
    def refused(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    with pytest.raises(ConfigError, match="no real-time priority 80") as error:
        RealTimeSettings(priority=80).apply()
    assert "limits.conf" in error.value.hint


def test_the_python_of_the_page_runs():
    page = (Path(__file__).parent.parent.parent / "docs" / "realtime.md").read_text()
    (body,) = re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S)
    done = run(body + "\nimport os; print(os.sched_getaffinity(0))")
    assert done.stdout.strip() == "{0}", done.stderr


@pytest.mark.long
def test_the_doctor_measures_a_loop(capsys):
    with pytest.raises(SystemExit) as left:
        main(["doctor", "--realtime", "--hz", "50", "--seconds", "0.3"])
    out = capsys.readouterr().out
    assert left.value.code in (0, 3)
    assert "a loop of 50 Hz for 0.3 s (ordinary scheduling): woken late by: 50 % within" in out
    for what in (*OF_FILES, "memory that can be locked", "real-time priorities"):
        assert what in out
