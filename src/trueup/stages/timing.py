"""How long the steps of a network take on this machine, in a loop as a robot runs it."""

from __future__ import annotations

import itertools
import os
import platform
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from trueup.core.model_card import ONNX_NAME, ModelCard, counterparts
from trueup.core.step_times import StepTimes
from trueup.deploy import LoopReport, Stream, run_loop
from trueup.deploy.network import Network
from trueup.errors import ConfigError

# Samples of the motion that goes round and round.
_SAMPLES = 5000
# The part of a channel's range that the motion uses, and where a channel that has no range goes to.
_SHARE, _NO_RANGE = 0.9, 1.0
# A period times its rate is not always 1.
_ROUNDING = 1e-9


def time_steps(folder: Path | str, *, rate_hz: float = 1000.0, seconds: float = 10.0) -> tuple[StepTimes, LoopReport]:
    """Correct a made-up motion in a loop at a fixed rate.

    The motion stays inside of the training range, and its stamps are those of the network's own rate: how long a step
    takes does not depend on what the numbers mean. Nothing is shown meanwhile; a display would take part in the loop.

    Args:
        folder: a model folder with a causal network.
        rate_hz: of the loop [Hz]; any, whatever rate the network was trained at.
        seconds: how long; at least one cycle.

    Returns:
        What `latency.json` holds, and the whole report of the loop.

    Raises:
        ConfigError: the network looks into the future, rate or duration is not positive, or there would be no cycle.
        DataError: a file is missing, truncated or changed.
    """
    if 0 < seconds * rate_hz < 1 - _ROUNDING:
        raise ConfigError(
            "there is no cycle in so short a time",
            got=f"{seconds:g} s at {rate_hz:g} Hz",
            expected=f"at least {1 / rate_hz:g} s",
        )
    network = Network.load(folder)
    card = network.card
    stream = Stream(network, rate_hz=card.rate_hz, joints=card.joints)
    motion = _motion(card)
    count = itertools.count()

    def step(_: float) -> None:
        number = next(count)
        stream.step_vector(motion[number % _SAMPLES], time_s=number / card.rate_hz)

    report = run_loop(step, rate_hz=rate_hz, duration_s=seconds)
    return StepTimes.of_loop(report.to_json(), machine=machine_name(), network=card.files[ONNX_NAME]), report


def _motion(card: ModelCard) -> Float64[np.ndarray, "T I"]:
    """Every channel up and down in its range, each at a pace of its own."""
    ends = np.array([(channel.low, channel.high) for channel in card.inputs])
    low, high = np.where(np.isfinite(ends), ends, [-_NO_RANGE, _NO_RANGE]).T
    turns = 10 + np.arange(len(card.inputs))  # whole ones: the end goes over into the beginning
    phase = 2 * np.pi * np.outer(np.arange(_SAMPLES) / _SAMPLES, turns)
    motion: Float64[np.ndarray, "T I"] = (low + high) / 2 + _SHARE * (high - low) / 2 * np.sin(phase)
    relative = [row for row, channel in enumerate(card.inputs) if channel.relative]
    motion[:, relative] += motion[:, counterparts(card.inputs)[relative]]
    return motion


def machine_name() -> str:
    """What this runs on, for people."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    name = next((line.split(": ", 1)[1] for line in lines if line.startswith("model name")), platform.processor())
    return f"{name or platform.machine()}, {os.cpu_count()} cores, {platform.system()}"
