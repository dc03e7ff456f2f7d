"""HDF5 in GapONet's two layouts: names are never guessed, clocks are merged, damaged and hostile files are refused."""

import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset.importers import hdf5
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.parts import on_one_clock
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch

WALL_S = 1.7e9  # a clock that counts from 1970
DT = 0.02
SIGNALS = {
    "position": "joint_angle_list",
    "velocity": "joint_velocity_list",
    "current": "joint_current_list",
    "temperature": "joint_temperature_list",
}
LEGS = ("hip", "knee", "ankle")
ARMS = tuple(f"{side}{number}" for side in ("l", "r") for number in range(1, 8))


def write_robot(group, time_s, width, seed):
    rng = np.random.default_rng(seed)
    values = {signal: rng.normal(size=(time_s.size, width)) for signal in SIGNALS}
    group["joint_time_list"] = time_s
    for signal, name in SIGNALS.items():
        group[name] = values[signal]
    return values


def write_humanoid(path: Path, rows=50, names=None):
    """Variant 1; returns what was written."""
    with h5py.File(path, "w") as file:
        time_s = WALL_S + np.arange(rows) * DT
        command = np.random.default_rng(9).normal(size=(rows, len(LEGS)))
        file["command_time_list"] = time_s
        file["command_val_list"] = command
        values = write_robot(file.create_group("robot"), time_s + 0.005, len(LEGS), 1)
        file["robot/imu_list"] = np.zeros((rows, 4))
        file["robot/ang_vel_list"] = np.zeros((rows, 3))
        file["motion_name"] = "squat"
        file["current_time"] = "2025-06-01 12:00:00"
        if names is not None:
            file["joint_names"] = list(names)
    return command, values


def write_arms(path: Path, rows=50, late_s=0.013, width=7):
    """Variant 2, the second arm linear in time; returns the clocks and what was written."""
    with h5py.File(path, "w") as file:
        time_s = np.arange(rows) * DT + 5.0
        command = np.random.default_rng(9).normal(size=(rows, 2 * width))
        file["command_time_list"] = time_s
        file["command_val_list"] = command
        values = write_robot(file.create_group("robot1"), time_s, width, 1)
        second = file.create_group("robot2")
        write_robot(second, time_s + late_s, width, 2)
        second["joint_angle_list"][...] = (time_s + late_s)[:, None] * np.arange(1, width + 1)
        file["motion_name"] = np.bytes_("wave")
        file.attrs["slowdown_factor"] = 2.0
        file["slowdown_factor"] = 2.0
    return time_s, command, values


def load(path, **options):
    plan = hdf5.scan(path, ImportOptions(**options))
    assert len(plan.episodes) == 1
    return plan.episodes[0].load()


def mapping(tmp_path, text) -> Path:
    path = tmp_path / "m.yaml"
    path.write_text(text)
    return path


def test_humanoid_is_read_with_stated_names(tmp_path):
    command, values = write_humanoid(tmp_path / "trial.h5")
    options = {"mapping": mapping(tmp_path, "joints: [hip, knee, ankle]\nrobot: h1\npayload_kg: 3\nunit: two\n")}
    assert hdf5.detects(tmp_path)
    plan = hdf5.scan(tmp_path, ImportOptions(**options))
    assert "robot/imu_list" in plan.notes[1] or "robot/ang_vel_list" in plan.notes[1]
    episode = plan.episodes[0].load()
    assert (episode.id, episode.meta.robot, episode.meta.payload_kg, episode.meta.unit) == ("trial", "h1", 3.0, "two")
    assert episode.measured.joints == episode.commanded().joints == LEGS
    for signal, expected in values.items():
        np.testing.assert_array_equal(episode.measured[signal], expected)
    assert {signal: unit[0] for signal, unit in episode.measured.units.items()} == {
        "position": "rad",
        "velocity": "rad/s",
        "current": "A",
        "temperature": "degC",
    }
    np.testing.assert_array_equal(episode.commanded()["position"], command)
    # Both series count from the command's first stamp; a float64 clock since 1970 resolves 0.24 us.
    np.testing.assert_allclose(episode.commanded().time_s, np.arange(50) * DT, atol=5e-7)
    np.testing.assert_allclose(episode.measured.time_s, np.arange(50) * DT + 0.005, atol=5e-7)
    about = next(flag for flag in episode.meta.flags if flag.kind == "about")
    assert about.detail == "motion_name: squat, current_time: 2025-06-01 12:00:00"


@pytest.mark.parametrize("as_attribute", [True, False])
@pytest.mark.parametrize(("write", "names"), [(write_humanoid, LEGS), (write_arms, ARMS)])
def test_a_file_says_its_own_payload_and_condition(tmp_path, write, names, as_attribute):
    """Both variants, a payload each: what was said by the file is what the episode says."""
    for payload_kg in (0.0, 1.5):
        path = tmp_path / f"{payload_kg}.h5"
        write(path)
        with h5py.File(path, "a") as file:
            holder = file.attrs if as_attribute else file
            holder["payload_kg"], holder["condition"], holder["kp_setting"] = payload_kg, "gait", 200 + payload_kg
    options = {"mapping": mapping(tmp_path, f"joints: [{', '.join(names)}]\n")}
    metas = [source.load().meta for source in hdf5.scan(tmp_path, ImportOptions(**options)).episodes]
    assert [(meta.payload_kg, meta.condition) for meta in metas] == [(0.0, "gait"), (1.5, "gait")]
    assert [meta.kp_setting for meta in metas] == [200.0, 201.5]
    motion = {write_humanoid: "squat", write_arms: "wave"}[write]
    assert all(any(f"motion_name: {motion}" in flag.detail for flag in meta.flags) for meta in metas)
    stated = {"mapping": mapping(tmp_path, f"joints: [{', '.join(names)}]\npayload_kg: 1.5\ncondition: squat\n")}
    first, second = hdf5.scan(tmp_path, ImportOptions(**stated)).episodes
    with pytest.raises(ConfigError, match=r"another payload.*got 0 kg; expected 1.5 kg"):
        first.load()
    assert second.load().meta.condition == "squat"
    stated = {"mapping": mapping(tmp_path, f"joints: [{', '.join(names)}]\nkp_setting: 400\n")}
    with pytest.raises(ConfigError, match=r"another kp_setting.*got 200; expected 400"):
        hdf5.scan(tmp_path, ImportOptions(**stated)).episodes[0].load()


@pytest.mark.parametrize("wrong", [-1.0, np.nan, "heavy", [1.0, 2.0]])
def test_a_payload_that_is_none_is_refused(tmp_path, wrong):
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["payload_kg"] = wrong
    with pytest.raises(DataError, match="payload_kg"):
        load(tmp_path)


def test_without_names_the_error_counts_the_columns_and_shows_what_to_write(tmp_path):
    write_humanoid(tmp_path / "a.h5")
    with pytest.raises(
        ConfigError, match=r"(?s)3 columns in robot.*joints: \[robot_joint1, robot_joint2, robot_joint3"
    ):
        hdf5.scan(tmp_path, ImportOptions())
    (tmp_path / "a.h5").unlink()
    write_arms(tmp_path / "b.h5", width=2)
    with pytest.raises(ConfigError, match=r"(?s)2 columns in robot1 and 2 columns in robot2.*robot2: \[robot2_joint1"):
        hdf5.scan(tmp_path, ImportOptions())
    with pytest.raises(ConfigError, match="another number"):
        hdf5.scan(tmp_path, ImportOptions(mapping=mapping(tmp_path, "joints: [a, b, c]")))
    with pytest.raises(ConfigError, match="another number"):
        hdf5.scan(tmp_path, ImportOptions(mapping=mapping(tmp_path, "joints: {robot1: [a, b], robot2: [c]}")))


@pytest.mark.parametrize("where", ["dataset", "file attribute", "group attribute", "bytes"])
def test_names_in_the_file_are_used_and_must_agree_with_stated_ones(tmp_path, where):
    write_humanoid(tmp_path / "a.h5", names=LEGS if where == "dataset" else None)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        if where == "file attribute":
            file.attrs["joint_names"] = list(LEGS)
        elif where == "group attribute":
            file["robot"].attrs["joint_names"] = list(LEGS)
        elif where == "bytes":
            file["robot/joint_names"] = np.array([name.encode() for name in LEGS])
    assert load(tmp_path).measured.joints == LEGS
    same = mapping(tmp_path, "joints: [hip, knee, ankle]")
    assert load(tmp_path, mapping=same).measured.joints == LEGS
    with pytest.raises(NameMismatch, match=r"stated \[knee, hip, ankle\], the file has \[hip, knee, ankle\]"):
        load(tmp_path, mapping=mapping(tmp_path, "joints: [knee, hip, ankle]"))


@pytest.mark.parametrize("per_group", [True, False])
def test_two_arms_come_onto_the_first_arms_clock_without_extrapolation(tmp_path, per_group):
    time_s, command, values = write_arms(tmp_path / "a.hdf5")
    left, right = ", ".join(ARMS[:7]), ", ".join(ARMS[7:])
    text = f"joints: {{robot1: [{left}], robot2: [{right}]}}" if per_group else f"joints: [{left}, {right}]"
    episode = load(tmp_path, mapping=mapping(tmp_path, text))
    measured = episode.measured
    assert measured.joints == ARMS
    # The second arm starts 13 ms after the first: the first sample has no counterpart.
    np.testing.assert_allclose(measured.time_s, time_s[1:] - 5.0, atol=1e-12)
    np.testing.assert_array_equal(measured["position"][:, :7], values["position"][1:])
    np.testing.assert_allclose(measured["position"][:, 7:], time_s[1:, None] * np.arange(1, 8), rtol=1e-12)
    np.testing.assert_array_equal(episode.commanded()["position"], command)
    assert episode.commanded().joints == ARMS
    flags = {flag.kind: flag.detail for flag in episode.meta.flags}
    assert "1 of 50" in flags["merged_clocks"]
    assert flags["about"] == "motion_name: wave, slowdown_factor: 2"


def test_arms_that_were_never_logged_together_are_refused(tmp_path):
    write_arms(tmp_path / "a.h5", late_s=10.0, width=1)
    with pytest.raises(DataError, match=r"do not overlap.*a…: .*b…"):
        load(tmp_path, mapping=mapping(tmp_path, "joints: [a, b]"))


def test_a_command_of_other_joints_needs_their_names(tmp_path):
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        values = file["command_val_list"][:, :2]
        del file["command_val_list"]
        file["command_val_list"] = values
    with pytest.raises(ConfigError, match=r"(?s)2 columns; expected 3.*command_joints"):
        load(tmp_path)
    text = "command_joints: [ankle, hip]\ncommand_signal: torque\nunits: {torque.ankle: mNm}"
    command = load(tmp_path, mapping=mapping(tmp_path, text)).commanded()
    assert (command.joints, command.units) == (("ankle", "hip"), {"torque": ("mNm", "Nm")})


def test_clocks_in_other_units_and_repeated_stamps(tmp_path):
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        for name in ("command_time_list", "robot/joint_time_list"):
            ticks = np.round((file[name][...] - WALL_S) * 1000).astype(np.int64)
            ticks[7] = ticks[6]
            del file[name]
            file[name] = ticks
    episode = load(tmp_path, mapping=mapping(tmp_path, "time_unit: ms"))
    np.testing.assert_allclose(np.delete(np.arange(50) * DT, 7), episode.commanded().time_s, atol=1e-9)
    assert [flag.series for flag in episode.meta.flags if flag.kind == "repeated_stamps"] == ["measured", "command"]


def edit(path, name, values, **options):
    with h5py.File(path, "r+") as file:
        if name in file:
            del file[name]
        if values is not None:
            file.create_dataset(name, data=values, **options)


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("command_val_list", None, "no command_val_list"),
        ("command_val_list", np.zeros((49, 3)), "differ in length.*49 rows; expected 50"),
        ("command_val_list", np.zeros(50), "no table of joints"),
        ("command_time_list", None, "no clock"),
        ("command_time_list", np.zeros((10, 5)), "no clock"),
        ("command_time_list", np.zeros(0), "differ in length"),
        ("command_time_list", np.arange(50)[::-1] * 0.1, "runs backwards"),
        ("command_time_list", np.full(50, np.nan), "not finite"),
        ("command_time_list", np.arange(50) * DT, "do not overlap"),
        ("command_time_list", (WALL_S + np.arange(50)).astype(np.float32), "float32, too coarse.*steps of 128 s"),
        ("robot/joint_time_list", ["a"] * 50, "no numbers"),
        ("robot/joint_angle_list", None, "no table of joints.*got nothing"),
        ("robot/joint_angle_list", np.zeros((50, 0)), "no table of joints"),
        ("robot/joint_velocity_list", np.zeros((50, 2)), r"expected \(samples, 3\)"),
        ("robot/joint_velocity_list", np.zeros((50, 3), dtype=complex), "no numbers"),
        ("robot", np.zeros(3), "no table of joints"),
    ],
)
def test_content_that_makes_no_sense_is_refused(tmp_path, name, values, text):
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    edit(tmp_path / "a.h5", name, values)
    with pytest.raises(DataError, match=f"(?s){text}"):
        load(tmp_path)


def test_other_layouts_and_empty_folders_are_refused(tmp_path):
    assert not hdf5.detects(tmp_path)
    with pytest.raises(FormatError, match="no HDF5"):
        hdf5.scan(tmp_path, ImportOptions())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["images"] = np.zeros(3)
    with pytest.raises(FormatError, match=r"neither variant.*available: images"):
        load(tmp_path)


@pytest.mark.parametrize("kind", ["soft", "external", "virtual", "external storage"])
def test_nothing_outside_the_file_is_read(tmp_path, kind):
    inner = tmp_path / "logs"
    inner.mkdir()
    write_humanoid(inner / "a.h5", names=LEGS)
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = np.zeros((50, 3))
    with h5py.File(inner / "a.h5", "r+") as file:
        name = "robot/joint_velocity_list"
        del file[name]
        if kind == "soft":
            file[name] = h5py.SoftLink("/robot/joint_angle_list")
        elif kind == "external":
            file[name] = h5py.ExternalLink("../secret.h5", "/x")
        elif kind == "virtual":
            layout = h5py.VirtualLayout(shape=(50, 3), dtype=np.float64)
            layout[...] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "x", shape=(50, 3))
            file.create_virtual_dataset(name, layout)
        else:
            raw = tmp_path / "secret.bin"
            raw.write_bytes(bytes(50 * 3 * 8))
            file.create_dataset(name, shape=(50, 3), dtype=np.float64, external=[(str(raw), 0, 1200)])
    with pytest.raises(
        DataError, match="is a link" if "link" in kind or kind in ("soft", "external") else "other files"
    ):
        load(inner)


@pytest.mark.parametrize("chunks", [None, (100, 3)])
def test_huge_claims_are_refused_before_memory_is_taken(tmp_path, chunks):
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["robot/joint_velocity_list"]
        file.create_dataset("robot/joint_velocity_list", shape=(10**13, 3), dtype=np.float64, chunks=chunks)
    with pytest.raises(DataError, match="claims more data"):
        load(tmp_path)


def test_compressed_data_are_read(tmp_path):
    _, values = write_humanoid(tmp_path / "a.h5", names=LEGS)
    edit(tmp_path / "a.h5", "robot/joint_velocity_list", np.zeros((50, 3)), compression="gzip", chunks=(50, 3))
    edit(tmp_path / "a.h5", "robot/joint_angle_list", values["position"], compression="lzf", shuffle=True)
    measured = load(tmp_path).measured
    assert not measured["velocity"].any()
    np.testing.assert_array_equal(measured["position"], values["position"])


def test_truncated_files_do_not_stop_the_others(tmp_path):
    write_humanoid(tmp_path / "b.h5", names=LEGS)
    data = (tmp_path / "b.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(data[: len(data) // 2])
    (tmp_path / "c.h5").write_bytes(b"")
    plan = hdf5.scan(tmp_path, ImportOptions())
    assert [source.id for source in plan.episodes] == ["a", "b", "c"]
    assert plan.episodes[1].load().measured.joints == LEGS
    for number in (0, 2):
        with pytest.raises(DataError, match="cannot be read as HDF5"):
            plan.episodes[number].load()


@given(st.data())
def test_merged_parts_agree_with_numpy_on_every_column(data):
    count = data.draw(st.integers(1, 3))
    parts = []
    for number in range(count):
        steps = data.draw(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=8))
        time_s = data.draw(st.floats(-2, 2)) + np.cumsum(steps)
        joints = tuple(f"{number}-{k}" for k in range(data.draw(st.integers(1, 2))))
        signals = {"position": np.random.default_rng(number).normal(size=(time_s.size, len(joints)))}
        if data.draw(st.booleans()):
            signals["velocity"] = signals["position"] * 2.0
        units = same_units({"position": "rad", "velocity": "rad/s"}, joints)
        parts.append(TimeSeries(time_s, joints, signals, {name: units[name] for name in signals}))
    inside = [t for t in parts[0].time_s if all(p.time_s[0] <= t <= p.time_s[-1] for p in parts)]
    if not inside:
        with pytest.raises(DataError):
            on_one_clock(parts)
        return
    merged = on_one_clock(parts)
    np.testing.assert_array_equal(merged.time_s, inside)
    assert merged.joints == tuple(joint for part in parts for joint in part.joints)
    for part in parts:
        own = merged.select(part.joints)
        for signal in merged.signals:
            expected = (
                np.stack([np.interp(inside, part.time_s, column) for column in part[signal].T], axis=1)
                if signal in part
                else np.full(own[signal].shape, np.nan)
            )
            np.testing.assert_allclose(own[signal], expected, atol=1e-12)


def test_parts_that_share_joints_are_refused():
    part = TimeSeries(np.arange(3.0), ("a",), {"position": np.zeros((3, 1))}, {"position": ("rad",)})
    with pytest.raises(NameMismatch):
        on_one_clock([part, part])


@pytest.mark.parametrize("size", [0, 2**64 - 16, 2**64 - 24])
def test_a_heap_of_texts_that_never_ends_is_refused(tmp_path, size):
    """The library itself would loop for ever on these."""
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    data = bytearray((tmp_path / "a.h5").read_bytes())
    at = data.index(b"GCOL") + 16
    while int.from_bytes(data[at : at + 2], "little"):
        at += 16 + (int.from_bytes(data[at + 8 : at + 16], "little") + 7) // 8 * 8
    data[at + 8 : at + 16] = size.to_bytes(8, "little")
    (tmp_path / "a.h5").write_bytes(data)
    with pytest.raises(DataError, match="damaged heap"):
        load(tmp_path)


VELOCITY = "robot/joint_velocity_list"


def chunked(path, rows, *, packed=None, filters=("deflate",), name=VELOCITY, kind=h5py.h5t.IEEE_F64LE):
    """A table of one chunk with these filters: zeros, or these bytes as they are."""
    with h5py.File(path, "r+") as file:
        if name in file:
            del file[name]
        plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plan.set_chunk((rows, 3))
        for one in filters:
            getattr(plan, f"set_{one}")(*{"deflate": (4,), "scaleoffset": (h5py.h5z.SO_INT, 0)}.get(one, ()))
        space = h5py.h5s.create_simple((rows, 3))
        table = h5py.Dataset(h5py.h5d.create(file.id, name.encode(), kind, space, plan))
        if packed is None:
            table[...] = np.zeros((rows, 3))
        else:
            table.id.write_direct_chunk((0, 0), packed)


@pytest.mark.parametrize("rows", [50, 5000])
@pytest.mark.parametrize("name", [VELOCITY, "command_val_list"])
def test_a_chunk_that_unpacks_to_more_than_it_says(tmp_path, monkeypatch, rows, name):
    """Larger than its table already as it is packed, or only when it is unpacked."""
    monkeypatch.setattr("trueup.core.unpacking.FEW_BYTES", 1 << 20)
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    chunked(tmp_path / "a.h5", rows, packed=zlib.compress(bytes(20_000_000), 9), name=name)
    with pytest.raises(DataError, match="unpacks to more than it says"):
        load(tmp_path)


def test_chunks_that_are_what_they_say_are_read_whatever_their_size(tmp_path, monkeypatch):
    monkeypatch.setattr("trueup.core.unpacking.FEW_BYTES", 1000)
    _, values = write_humanoid(tmp_path / "a.h5", names=LEGS)
    kept = {"compression": "gzip", "fletcher32": True, "shuffle": True, "maxshape": (None, 3)}
    edit(tmp_path / "a.h5", "robot/joint_angle_list", values["position"], chunks=(50, 3), **kept)
    np.testing.assert_array_equal(load(tmp_path).measured["position"], values["position"])


def test_a_single_number_in_a_chunk_that_bursts(tmp_path):
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        for name in ("payload_kg", "condition"):
            table = file.create_dataset(name, (1,), "f8", chunks=(1,), compression="gzip")
            table.id.write_direct_chunk((0,), zlib.compress(bytes(1_000_000), 9))
            with pytest.raises(DataError, match="unpacks to more than it says"):
                load(tmp_path)
            del file[name]


@pytest.mark.parametrize(
    ("filters", "kind"),
    [
        (("deflate", "deflate"), h5py.h5t.IEEE_F64LE),
        (("shuffle", "deflate", "shuffle"), h5py.h5t.IEEE_F64LE),
        (("scaleoffset",), h5py.h5t.STD_I32LE),
    ],
)
def test_data_that_are_packed_in_unusual_ways(tmp_path, filters, kind):
    """Twice: a million to one. Others unpack to what they say themselves."""
    write_humanoid(tmp_path / "a.h5", names=LEGS)
    chunked(tmp_path / "a.h5", 50, filters=filters, kind=kind)
    with pytest.raises(DataError, match=r"unusual way.*gzip or lzf, once"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("texts", "as_attribute"),
    [(["x" * 40_000, *LEGS] * 20, True), (["x" * 40_000, *LEGS] * 20, False), (["x"] * 20_000, False)],
)
def test_texts_that_fill_the_memory(tmp_path, monkeypatch, texts, as_attribute):
    """Each of them may refer to the longest in the file."""
    monkeypatch.setattr("trueup.core.unpacking.FEW_BYTES", 1 << 20)
    write_humanoid(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        holder = file["robot"].attrs if as_attribute else file["robot"]
        holder["joint_names"] = texts
    with pytest.raises(DataError, match="claims more text than names can have"):
        load(tmp_path)
