"""docs/good-data.md: its numbers are measured again, its flags exist."""

import re
from pathlib import Path

import numpy as np
import pytest

from docs.test_docs import quality_kinds
from trueup.align.start import _REST_S
from trueup.lab import DemoHardware, demo_arm, record_demo
from trueup.record.profile import ClockSettings

PAGE = (Path(__file__).parent.parent.parent / "docs" / "good-data.md").read_text()


def motions(gain, **different):
    hardware = DemoHardware(kp=38.0 * gain, kv=gain**0.5, velocity_noise=0.0, torque_noise_nm=0.0, **different)
    return [episode.measured["position"] for episode in record_demo(hardware=hardware)]


def apart_mrad(one, other):
    return 1e3 * np.mean([np.sqrt(np.mean((a - b) ** 2)) for a, b in zip(one, other, strict=True)])


@pytest.mark.parametrize("gain", [1, 10])
def test_a_stiff_servo_hides_friction_and_payload_as_much_as_the_page_says(gain, monkeypatch):
    friction, payload = re.findall(rf"`kp` {38 * gain} Nm/rad \| ([\d.]+) mrad \| ([\d.]+) mrad", PAGE)[0]
    as_it_is = motions(gain)
    assert apart_mrad(as_it_is, motions(gain, frictionloss=0.05)) == pytest.approx(float(friction), rel=0.05)
    swapped = tuple((name, split, 0.4 - kg) for name, split, kg in demo_arm._MOTIONS)
    monkeypatch.setattr(demo_arm, "_MOTIONS", swapped)
    assert apart_mrad(as_it_is, motions(gain)) == pytest.approx(float(payload), rel=0.05)


@pytest.mark.long
def test_every_flag_that_is_named_exists():
    rows = re.findall(r"^\|[^|]*\|([^|]*)\|$", PAGE.split("## What spoils data silently")[1], re.M)
    named = {word for row in rows for word in re.findall(r"`([a-z_]+)`", row)}
    recorded = {"goal_missed", "off_path", "late", "stopped", "silent"}
    others = {"gap", "close", "temperature", "whiteness"}  # commands, a signal, a key of fit.json
    assert named - recorded - others <= quality_kinds()
    assert recorded <= named
    # Those of what spoils data; the others are notes about formats.
    assert quality_kinds() - named <= {
        "about",
        "array",
        "cut_file",
        "motors",
        "publishers",
        "sensors",
        "trajectory",
        "jittering_stamps",
    }


def test_rests_are_as_long_as_they_have_to_be():
    assert _REST_S == 0.1
    assert "a rest of 0.1 s, ten samples at least" in PAGE
    assert ClockSettings().rest_s == 0.5
