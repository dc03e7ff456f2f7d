"""Episodes for the tests of the dataset on disk: random ones for laws, labelled ones for stories."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import DatasetInfo

INFO = DatasetInfo(robot="arm", licence="BSD-3-Clause", provenance={"source": "test"}, notes=("made up",))
JOINTS = ("pan", "lift")
UNITS = {"position": "rad", "torque": "Nm"}


def make_series(number: int, samples: int = 20, joints=JOINTS) -> TimeSeries:
    """Every value says which episode, sample and joint it is, so that any mix-up shows."""
    label = number * 1000 + np.arange(samples)[:, None] + np.arange(len(joints))[None, :] / 10
    signals = {"position": label.astype(np.float32), "torque": -label}
    return TimeSeries(np.arange(samples) * 0.02 + number, joints, signals, same_units(UNITS, joints))


def make_episode(number: int, samples: int = 20, *, id: str = "", flagged: bool = False) -> Episode:
    flags = (Flag("gap", signal="position", joint="pan", detail="0.2 s", start_s=0.1, end_s=0.3),) if flagged else ()
    meta = EpisodeMeta(id or f"e{number:03d}", "arm", "A1", 0.5 * number, "walk", "", f"logs/{number}.csv", "ab", flags)
    meta = replace(meta, kp_setting=100.0 * number if number else None)
    return Episode(meta, make_series(number, samples), make_series(-number - 1, samples + 3))


def same_series(left: TimeSeries, right: TimeSeries) -> bool:
    """Whether two series are the same to the last bit, NaN payloads included."""
    return (
        left.joints == right.joints
        and left.bodies == right.bodies
        and dict(left.units) == dict(right.units)
        and list(left.signals) == list(right.signals)
        and left.time_s.tobytes() == right.time_s.tobytes()
        and all(
            values.dtype == right[name].dtype
            and values.shape == right[name].shape
            and values.tobytes() == right[name].tobytes()
            for name, values in left.signals.items()
        )
    )


def same_episode(left: Episode, right: Episode) -> bool:
    commands = (left.command, right.command)
    return (
        left.meta == right.meta
        and same_series(left.measured, right.measured)
        and (commands == (None, None) or (None not in commands and same_series(*commands)))
        and set(left.simulated) == set(right.simulated)
        and all(same_series(left.simulated[label], right.simulated[label]) for label in left.simulated)
    )


# Names with dots, brackets, any script; no lone surrogates, which are no text.
names = st.text(st.characters(exclude_categories=("Cs",)), max_size=8)


@st.composite
def random_series(draw) -> TimeSeries:
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    samples = draw(st.integers(1, 12))
    joints = tuple(draw(st.lists(names, max_size=4, unique=True)))
    bodies = tuple(draw(st.lists(names, max_size=3, unique=True)))
    chosen = draw(
        st.lists(st.one_of(st.sampled_from(["position", "body.position", "body.rotation"]), names), unique=True)
    )
    signals, units = {}, {}
    for signal in chosen:
        body = signal.startswith("body.")
        tail = draw(st.sampled_from([(3,), (3, 3), (4,), (2, 3)])) if body else ()
        owners = bodies if body else joints
        values = rng.standard_normal((samples, len(owners), *tail)).astype(draw(st.sampled_from(["f4", "f8", ">f4"])))
        values[rng.random(values.shape) < 0.2] = rng.choice([np.nan, -0.0, np.inf, 1e-42])
        if draw(st.booleans()):
            values = np.asfortranarray(values)
        signals[signal] = values
        units[signal] = tuple(draw(st.sampled_from(["rad", "m", "1", "°"])) for _ in owners)
    clock = np.cumsum(rng.random(samples) + 1e-3) + rng.normal() * 1e9
    return TimeSeries(clock, joints, signals, units, bodies)


def write_npz(episode, path):
    """An npz file that the importer reads back exactly, apart from split, source and flags."""
    meta = episode.meta
    arrays = {key: np.array(getattr(meta, key)) for key in ("robot", "unit", "condition")}
    if meta.payload_kg is not None:
        arrays["payload_kg"] = np.array(meta.payload_kg)
    if meta.kp_setting is not None:
        arrays["kp_setting"] = np.array(meta.kp_setting)
    series = {"measured": episode.measured, **{f"simulated/{label}": run for label, run in episode.simulated.items()}}
    if episode.command is not None:
        series["command"] = episode.command
    for label, one in series.items():
        arrays[f"{label}.time_s"] = one.time_s
        arrays[f"{label}.joints"] = np.array(one.joints)
        if one.bodies:
            arrays[f"{label}.bodies"] = np.array(one.bodies)
        for signal, values in one.signals.items():
            arrays[f"{label}.{signal}"] = values
            arrays[f"{label}.{signal}.unit"] = np.array(one.units[signal])
    np.savez_compressed(path, allow_pickle=False, **arrays)
