import csv as stdlib_csv
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset.export_csv import export_csv
from trueup.dataset.importers import table
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.mapping_file import is_table_mapping, load_mapping, parse_mapping, shipped
from trueup.dataset.importers.stated import read_stated
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch, OutputExists, UnitError

PLAIN = """\
joints: [a, b]
robot: arm
series:
  measured:
    time: {column: t, unit: s}
    signals:
      position: {columns: "q{n}", unit: deg}
      velocity: {columns: [va, vb], unit: [rad/s, 1/s], optional: true}
"""
ROWS = "t,q1,q2\n10.0,1,2\n10.5,3,4\n"


def make(folder, files, mapping=PLAIN):
    for name, text in {**files, "mapping.yaml": mapping}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder


def episodes(path, **options):
    return {source.id: source.load() for source in table.scan(path, ImportOptions(**options)).episodes}


def test_columns_units_and_the_clock_are_what_the_mapping_says(tmp_path):
    make(tmp_path, {"x.csv": ROWS, "deep/y.csv": "t,vb,va,q2,q1,other\n0,6,5,2,1,z\n"})
    found = episodes(tmp_path)
    assert list(found) == ["deep/y", "x"]
    np.testing.assert_array_equal(found["x"].measured.time_s, [0.0, 0.5])
    np.testing.assert_array_equal(found["x"].measured["position"], [[1, 2], [3, 4]])
    assert found["x"].measured.units == {"position": ("deg", "deg")}
    assert found["x"].command is None
    assert found["x"].meta.robot == "arm"
    assert found["x"].meta.source == "x.csv"
    np.testing.assert_array_equal(found["deep/y"].measured["velocity"], [[5, 6]])
    assert found["deep/y"].measured.units["velocity"] == ("rad/s", "1/s")


def test_the_user_overrides_units_and_robot(tmp_path):
    found = episodes(make(tmp_path, {"x.csv": ROWS}), units={"position.b": "1"}, robot="other")
    assert found["x"].measured.units["position"] == ("deg", "1")
    assert found["x"].meta.robot == "other"


def test_a_command_file_has_a_clock_of_its_own_and_groups_fill_the_constants(tmp_path):
    mapping = (
        PLAIN.replace("robot: arm", "")
        + """\
  command:
    file: "{run}/desired_{kg}.csv"
    time: {column: stamp, unit: ms}
    joints: [b]
    signals:
      torque: {columns: [tau], unit: mNm}
episodes: '(?P<run>[^/]+)/seen_(?P<kg>[0-9.]*)\\.csv'
id: "{run}-{kg}"
robot: "{run}"
unit: left
payload_kg: "{kg}"
kp_setting: 400
condition: "carrying {kg}"
"""
    )
    seen = "t,q1,q2\n7.5,1,2\n8.5,3,4\n"
    desired = "stamp,tau\n7000,5\n7001,6\n7500,7\n"
    make(tmp_path, {"w/seen_1.5.csv": seen, "w/desired_1.5.csv": desired, "w/other.csv": "x\n1\n"}, mapping)
    plan = table.scan(tmp_path, ImportOptions())
    assert any("w/other.csv" in note for note in plan.notes)
    assert plan.robot == ""
    episode = plan.episodes[0].load()
    assert episode.id == "w-1.5"
    assert (episode.meta.robot, episode.meta.unit, episode.meta.payload_kg) == ("w", "left", 1.5)
    assert episode.meta.kp_setting == 400
    assert episode.meta.condition == "carrying 1.5"
    np.testing.assert_allclose(episode.command.time_s, [0.0, 0.001, 0.5])
    np.testing.assert_allclose(episode.measured.time_s, [0.5, 1.5])
    assert episode.command.joints == ("b",)
    assert plan.episodes[0].bytes == len(seen) + len(desired)


def test_a_missing_command_file_is_an_error_unless_it_is_optional(tmp_path):
    command = """\
  command:
    file: "desired.csv"
    time: t
    signals:
      torque: {columns: "tau{n}", unit: Nm}
"""
    make(tmp_path, {"x.csv": ROWS}, PLAIN + command)
    with pytest.raises(DataError, match=r"desired.csv is missing.*command"):
        episodes(tmp_path)
    make(tmp_path, {"x.csv": ROWS}, PLAIN + command + "    optional: true\n")
    assert episodes(tmp_path)["x"].command is None


def test_a_mapping_may_name_files_of_any_ending(tmp_path):
    make(tmp_path, {"x.log": ROWS, "README": "text"}, PLAIN + "episodes: '.*[.]log'")
    assert list(episodes(tmp_path)) == ["x"]


def test_nanoseconds_since_1970_keep_every_digit(tmp_path):
    start = 1_700_000_000_123_456_789
    rows = "".join(f"{start + step},1,2\n" for step in (0, 1, 1_000_000_001))
    make(tmp_path, {"x.csv": "t,q1,q2\n" + rows}, PLAIN.replace("unit: s}", "unit: ns}"))
    np.testing.assert_array_equal(episodes(tmp_path)["x"].measured.time_s, [0.0, 1e-9, 1.000000001])


@pytest.mark.parametrize("pattern", [r"(a|a)*b\.csv", r"(a+)+b\.csv", r"(.*,)*(.*,)*(.*,)*(.*,)*x\.csv"])
def test_a_pattern_of_somebody_else_takes_no_time(tmp_path, pattern):
    """Years, if it were tried as Python tries it."""
    make(tmp_path, {"a" * 60 + "c.csv": ROWS, "," * 200 + "c.csv": ROWS}, PLAIN + f"episodes: '{pattern}'")
    with pytest.raises(FormatError, match=r"no file.*matches `episodes`"):
        episodes(tmp_path)


@pytest.mark.parametrize(
    ("pattern", "id", "names"),
    [
        (r"(?:(?P<folder>.+)/)?x(?P<rest>[^/]*)\.csv", "{folder}-{rest}", ["-1", "deep-2"]),
        (r"(deep/)?x(?P<rest>[(\d]+)\.csv", "{rest}", ["1", "2"]),
        (r"(?P<all>(x|[\](]|deep\/)+\d)[.]csv", "{all}", ["x1", "deep/x2"]),
        (r"(?i).*X(?P<n>\pN)\.(CSV|LOG)", "{n}", ["1", "2"]),
    ],
)
def test_patterns_of_people(tmp_path, pattern, id, names):
    mapping = PLAIN + f"episodes: '{pattern}'\nid: '{id}'\n"
    found = episodes(make(tmp_path, {"x1.csv": ROWS, "deep/x2.csv": ROWS}, mapping))
    assert sorted(found) == sorted(names)


def test_a_line_of_blanks_takes_no_time(tmp_path):
    """A megabyte of them: hours, if each were the beginning of a run of its own."""
    make(tmp_path, {"x.csv": "t q1 q2\n0 1" + " " * 1_000_000 + "2\n"}, PLAIN + "delimiter: whitespace")
    np.testing.assert_array_equal(episodes(tmp_path)["x"].measured["position"], [[1, 2]])


@pytest.mark.parametrize(
    ("keys", "content"),
    [
        ("delimiter: ';'", "t;q1;q2\n10.0;1;2\n10.5;3;4\n"),
        ('delimiter: "\\t"', "t\tq1\tq2\n10.0\t1\t2\n10.5\t3\t4"),
        ("delimiter: whitespace", "# t  q1   q2\n  10.0 1\t2  \n 10.5   3 4 \n"),
        ("skip_lines: 2", "recorded by hand\n\nt,q1,q2\n10.0,1,2\n10.5,3,4\n"),
        ("header: [t, q1, q2]", "10.0,1,2\n10.5,3,4\n"),
        ("delimiter: ','", '"t" , q1 ,q2\r\n 10.0 , 1 ," 2"\r\n10.5,3,4\r\n'),
        ("delimiter: ','", b"\xef\xbb\xbft,q1,q2\n10.0,1,2\n10.5,3,4\n\n"),
        ("keep_origin: true", "t,q1,q2\n0,1,2\n0.5,3,4\n"),
    ],
)
def test_dialects_of_csv(tmp_path, keys, content):
    series = episodes(make(tmp_path, {"x.csv": content}, PLAIN + keys))["x"].measured
    np.testing.assert_array_equal(series.time_s, [0.0, 0.5])
    np.testing.assert_array_equal(series["position"], [[1, 2], [3, 4]])


def test_missing_samples_are_nan(tmp_path):
    make(tmp_path, {"x.csv": "t,q1,q2\n0,,nan\n1,NaN,NA\n2,1,2\n"})
    position = episodes(tmp_path)["x"].measured["position"]
    np.testing.assert_array_equal(position, [[np.nan, np.nan], [np.nan, np.nan], [1, 2]])


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        (b"", DataError, r"x.csv is empty"),
        (b"t,q1,q2\n", DataError, "no rows"),
        (b"t,q1,q2\n1,2,3\n2,3\n", DataError, "wrong length in line 3.*got 2 fields; expected 3"),
        (b"t,q1,q2\n\n1,2,3\n\n2,3\n", DataError, "wrong length in line 5"),
        (b"t,q1,q2\n1,2,3\n2,x,3\n", DataError, "line 3, column 'q1'.*'x'"),
        (b"t,q1,q2\n1,2,3\n2,inf,3\n", DataError, "line 3, column 'q1'.*finite"),
        (b"t,q1,q2\n1,2,3\n2,1e400,3\n", DataError, "line 3, column 'q1'"),
        (b"t,q1,q2\n1,2,3\n,2,3\n", DataError, "x.csv.*not finite.*row 2"),
        (b"t,q1,q2\n1,2,3\n0,2,3\n", DataError, "x.csv runs backwards"),
        (b"t,q1,q2\n1,2,\xff\n", DataError, "x.csv is not UTF-8.*line 2"),
        (b"t,q1,\xff\n1,2,3\n", DataError, "header of .*x.csv"),
        (b"t,q1,q1\n1,2,3\n", DataError, "same name.*q1"),
        (b"t,q1,q2\n1,2,\x003\n", DataError, "line 2, column 'q2'"),
        (b"t,q1,p2\n1,2,3\n", NameMismatch, "no column q2.*needed \\[t, q1, q2\\], the file has \\[t, q1, p2\\]"),
        (b"t,q1,q2,va\n1,2,3,4\n", NameMismatch, "no column vb"),
        (b't,q1,q2,note\n1,2,3,"x\n2,2,3,y\n3,2,3,z"\n', DataError, "x.csv.*over a line end"),
    ],
)
def test_damaged_files_are_named_with_the_line(tmp_path, content, error, words):
    make(tmp_path, {"x.csv": content})
    with pytest.raises(error, match="(?s)" + words):
        episodes(tmp_path)


def changed(old, new):
    assert old in PLAIN
    return PLAIN.replace(old, new)


@pytest.mark.parametrize(
    ("mapping", "error", "words"),
    [
        ("", ConfigError, "not a YAML mapping"),
        ("[1, 2]", ConfigError, "not a YAML mapping"),
        ("joints: [a, b]", ConfigError, "series missing"),
        ("a: [", ConfigError, "not plain YAML"),
        (PLAIN + "colour: red", ConfigError, "unknown keys.*colour.*available: joints, series"),
        (
            changed("{column: t, unit: s}", "{colum: t}"),
            ConfigError,
            "measured.time: unknown keys.*colum.*column, unit",
        ),
        (changed("unit: deg}", "unit: deg, scale: 2}"), ConfigError, "position: unknown keys.*scale"),
        (changed("measured:", "observed:"), ConfigError, "no series `measured`"),
        (changed("position:", "pose:"), ConfigError, "unknown signal.*pose.*position"),
        (changed("unit: deg", "unit: degrees"), UnitError, "degrees.*available.*deg"),
        (changed("unit: s}", "unit: rad}"), UnitError, "rad"),
        (changed("unit: s}", "unit: years}"), UnitError, "years"),
        (changed("q{n}", "q{m}"), ConfigError, r"\{m\}.*available: joint, n, i"),
        (changed("q{n}", "q"), NameMismatch, "no column q"),
        (changed("[va, vb]", "[va]"), ConfigError, "one column each for a, b"),
        (changed("[rad/s, 1/s]", "[rad/s]"), ConfigError, "one unit.*a, b"),
        (changed("[a, b]", "[a, a]"), ConfigError, "named twice"),
        (changed("[a, b]", "a"), ConfigError, "a list of names"),
        (changed("[a, b]", "[on, off]"), ConfigError, "quotes"),
        (PLAIN + "delimiter: '::'", ConfigError, "delimiter"),
        (PLAIN + "skip_lines: -1", ConfigError, "skip_lines"),
        (PLAIN + "keep_origin: 1", ConfigError, "keep_origin"),
        (PLAIN + "episodes: '('", ConfigError, "regular expression"),
        (PLAIN + "episodes: 'x)|(y'", ConfigError, "regular expression"),
        (PLAIN + "episodes: '(?P<a>x).*(?P=a)'", ConfigError, "regular expression.*no back-references"),
        (PLAIN + f"episodes: '{'a' * 1001}'", ConfigError, "too long.*characters"),
        (PLAIN + "id: '{run}'", ConfigError, r"\{run\}"),
        (PLAIN + "episodes: 'nothing'", FormatError, "no file.*nothing.*x.csv"),
        (PLAIN + "payload_kg: heavy", DataError, "payload.*heavy"),
        (
            PLAIN + "kp_setting: stiff",
            DataError,
            "kp_setting of .* is no setting of a gain: got 'stiff'; expected a finite",
        ),
        (PLAIN + "kp_setting: 0", DataError, "got '0'; expected a finite number above 0"),
        (PLAIN + "kp_setting: inf", DataError, "got .inf.; expected a finite"),
        (PLAIN + "id: '..'", DataError, "no episode id"),
        (PLAIN + "metadata: ../../secret.csv", DataError, "leads out of the folder"),
        (
            changed("series:", "robots: !!python/object/apply:os.system ['true']\nseries:"),
            ConfigError,
            "not plain YAML",
        ),
        (changed("arm", "!!python/name:os.system"), ConfigError, "not plain YAML"),
        ("[" * 10_000, ConfigError, "not plain YAML"),
        ("x" * 1_000_000, ConfigError, "too large"),
        (changed("arm", "!!timestamp x"), ConfigError, "not plain YAML"),
    ],
)
def test_a_wrong_mapping_says_what_is_wrong(tmp_path, mapping, error, words):
    make(tmp_path, {"x.csv": ROWS}, mapping)
    with pytest.raises(error, match="(?s)" + words):
        episodes(tmp_path)


def test_a_command_file_outside_the_folder_is_refused(tmp_path):
    (tmp_path / "secret.csv").write_text(ROWS)
    mapping = PLAIN + "  command: {file: ../secret.csv, time: t, signals: {torque: {columns: 'q{n}', unit: Nm}}}\n"
    make(tmp_path / "logs", {"x.csv": ROWS}, mapping)
    with pytest.raises(DataError, match="leads out of the folder"):
        episodes(tmp_path / "logs")
    make(tmp_path / "logs", {"x.csv": ROWS})
    (tmp_path / "logs" / "y.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(DataError, match="leads out of the folder"):
        episodes(tmp_path / "logs")


def test_an_interrupted_export_leaves_nothing(tmp_path):
    def broken():
        yield episodes(make(tmp_path / "in", {"x.csv": ROWS}, PLAIN))["x"]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_csv(broken(), tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_two_files_with_one_id_are_refused(tmp_path):
    make(tmp_path, {"a b.csv": ROWS, "a_b.csv": ROWS})
    with pytest.raises(DataError, match=r"called 'a_b'.*a b.csv and a_b.csv"):
        episodes(tmp_path)


def test_a_mapping_is_a_file_a_shipped_name_or_beside_the_data(tmp_path):
    make(tmp_path, {"x.csv": ROWS})
    elsewhere = tmp_path.parent / f"{tmp_path.name}.yaml"
    elsewhere.write_text(PLAIN.replace("robot: arm", "robot: leg"))
    assert episodes(tmp_path)["x"].meta.robot == "arm"
    assert episodes(tmp_path, mapping=elsewhere)["x"].meta.robot == "leg"
    assert episodes(tmp_path / "x.csv", mapping=elsewhere)["x"].meta.robot == "leg"
    with pytest.raises(NameMismatch, match="pos_meas1"):
        episodes(tmp_path, mapping=Path("dfki_double_pendulum"))
    with pytest.raises(
        ConfigError, match=r"nowhere.yaml.*available: bam, dfki_double_pendulum, dfki_simple_pendulum, dynamixel"
    ):
        episodes(tmp_path, mapping=Path("nowhere.yaml"))


def test_a_mapping_of_terabytes_is_refused_unread(tmp_path):
    path = tmp_path / "mapping.yaml"
    path.touch()
    os.truncate(path, 1 << 40)
    assert is_table_mapping(path)
    with pytest.raises(ConfigError, match="too large for a mapping: got 1099511627776 bytes"):
        load_mapping(path)
    with pytest.raises(ConfigError, match="too large"):
        read_stated(ImportOptions(mapping=path))


def test_unknown_columns_are_printed_with_where_a_mapping_to_start_from_is(tmp_path):
    (tmp_path / "x.csv").write_text("when,mode,flag\n1,a,b\n2,a,b\n")
    with pytest.raises(FormatError, match=r"x.csv with columns when, mode, flag") as caught:
        episodes(tmp_path)
    assert len(str(caught.value).splitlines()) == 2
    page = (Path(__file__).parents[2] / "docs" / "logs.md").read_text()
    assert "docs/logs.md#tables" in caught.value.hint
    _, _, section = page.partition("\n## Tables\n")
    mapping = section.partition("```yaml\n")[2].partition("```")[0]
    assert parse_mapping(mapping, name="page").columns("measured", "position")


def test_shipped_mappings_are_recognized_when_they_fit_every_file(tmp_path):
    header = "time,position,velocity,torque\n0,1,2,3\n"
    for name in ("swing/data_measured.csv", "swing/data_desired.csv", "data_measured_2.csv", "data_desired_2.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(header)
    plan = table.scan(tmp_path, ImportOptions())
    assert [source.id for source in plan.episodes] == ["_2", "swing"]
    assert any("dfki_simple_pendulum" in note for note in plan.notes)
    # A recording that was cut off at once is refused by its own name, and no other for its sake.
    (tmp_path / "data_measured_1.csv").touch()
    (tmp_path / "data_desired_1.csv").touch()
    found = {source.id: source for source in table.scan(tmp_path, ImportOptions()).episodes}
    assert len(found["_2"].load().measured) == 1
    with pytest.raises(DataError, match=r"_1\.csv is empty"):
        found["_1"].load()
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FormatError, match="no mapping says"):
        table.scan(tmp_path, ImportOptions())


def test_shipped_mappings_are_valid():
    assert set(shipped()) == {
        *("bam", "dfki_double_pendulum", "dfki_simple_pendulum", "dynamixel", "franka", "kuka_rsi", "ur_rtde")
    }
    for mapping in shipped().values():
        assert {"measured", "command"} == set(mapping.series)


NUMBERS = st.floats(allow_nan=True, allow_infinity=False, width=64)
NAMES = st.text("abcXYZ09_{}.,;\"' é#-", min_size=1, max_size=6).filter(lambda name: name == name.strip())
TEXTS = st.text(st.characters(exclude_categories=["C"]), max_size=8)


@st.composite
def clocks(draw, size):
    start = draw(st.floats(-1e6, 1.8e9))
    steps = draw(arrays(np.float64, size, elements=st.floats(1e-4, 1e3)))
    return start + np.cumsum(steps)


@st.composite
def series(draw, joints, signals, bodies=()):
    size = draw(st.integers(1, 4))
    values = {
        name: draw(
            arrays(
                dtype,
                (size, len(joints)),
                elements=st.floats(width=32 if dtype is np.float32 else 64, allow_infinity=False),
            )
        )
        for name, dtype in signals.items()
    }
    units = same_units({"position": "rad", "torque": "Nm", "current": "mA"}, joints)
    units = {name: units[name] for name in signals}
    if bodies:
        values["body.rotation"] = draw(arrays(np.float64, (size, len(bodies), 3, 3), elements=NUMBERS))
        units["body.rotation"] = ("1",) * len(bodies)
    return TimeSeries(time_s=draw(clocks(size)), joints=joints, signals=values, units=units, bodies=bodies)


@st.composite
def datasets(draw):
    joints = tuple(draw(st.lists(NAMES, min_size=1, max_size=3, unique=True)))
    bodies = tuple(draw(st.lists(NAMES, max_size=2, unique=True)))
    single = draw(st.booleans())
    made = []
    for number in range(draw(st.integers(1, 3))):
        signals = {"position": np.float32 if single else np.float64}
        if draw(st.booleans()):
            signals["current"] = np.float64
        meta = EpisodeMeta(
            id=f"run {number}".replace(" ", draw(st.sampled_from(["_", "/", "."]))),
            robot=draw(TEXTS),
            unit=draw(TEXTS),
            condition=draw(TEXTS),
            payload_kg=draw(st.none() | st.floats(0, 1e6)),
            kp_setting=draw(st.none() | st.floats(1e-3, 1e6)),
            split=draw(st.sampled_from(["", "train", "val", "test"])),
        )
        command = draw(series(joints[::-1], {"torque": np.float64})) if draw(st.booleans()) else None
        runs = {"mujoco/stock": draw(series(joints, {"position": np.float64}))} if draw(st.booleans()) else {}
        made.append(Episode(meta, draw(series(joints, signals, bodies)), command, runs))
    return made


def assert_same(left, right):
    assert (left is None) == (right is None)
    if left is None or right is None:
        return
    np.testing.assert_array_equal(left.time_s, right.time_s)
    assert (left.joints, left.bodies, dict(left.units)) == (right.joints, right.bodies, dict(right.units))
    for signal, values in left.signals.items():
        assert values.dtype == right[signal].dtype
        np.testing.assert_array_equal(values, right[signal])


@pytest.mark.long
@settings(max_examples=15)  # every file is synced to disk
@given(datasets())
def test_export_and_import_give_the_same_episodes(made):
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "out"
        assert export_csv(made, target) == len(made)
        back = episodes(target)
        splits = table.scan(target, ImportOptions()).splits
    assert set(back) == {episode.id for episode in made}
    for episode in made:
        again = back[episode.id]
        assert_same(episode.measured, again.measured)
        assert_same(episode.command, again.command)
        assert set(episode.simulated) == set(again.simulated)
        for label, run in episode.simulated.items():
            assert_same(run, again.run(label))
        for key in ("robot", "unit", "payload_kg", "kp_setting", "condition"):
            assert getattr(episode.meta, key) == getattr(again.meta, key)
        assert splits.get(episode.id, "") == episode.meta.split


def simple(id, unit="rad"):
    return Episode(
        EpisodeMeta(id=id),
        TimeSeries(
            time_s=np.arange(2.0), joints=("a",), signals={"position": np.zeros((2, 1))}, units={"position": (unit,)}
        ),
    )


def test_export_refuses_what_one_mapping_cannot_say(tmp_path):
    with pytest.raises(NameMismatch, match=r"units|unit.*deg.*rad"):
        export_csv([simple("x"), simple("y", "deg")], tmp_path / "a")
    assert not (tmp_path / "a" / "mapping.yaml").exists()
    with pytest.raises(DataError, match="no episode"):
        export_csv([], tmp_path / "b")
    export_csv([simple("x")], tmp_path / "c")
    with pytest.raises(OutputExists):
        export_csv([simple("y")], tmp_path / "c")


def test_export_writes_nothing_outside_its_folder(tmp_path):
    """Whoever made the episodes: this is the second fence, behind the ids that a dataset takes."""
    series = TimeSeries(np.arange(2.0), ("a",), {"position": np.zeros((2, 1))}, {"position": ("rad",)})
    for id in ("../../x", str(tmp_path / "x")):
        with pytest.raises(DataError, match="outside the folder"):
            export_csv([Episode(EpisodeMeta(id), series)], tmp_path / "a" / "out")
    assert not list(tmp_path.rglob("*.csv"))
    assert not list(tmp_path.rglob("*out*"))


def test_exported_files_are_plain_csv(tmp_path):
    export_csv([simple("x")], tmp_path)
    with (tmp_path / "x" / "measured.csv").open(newline="") as file:
        assert list(stdlib_csv.reader(file)) == [["time_s", "position.a"], ["0", "0"], ["1", "0"]]


def column(path, name):
    with path.open(newline="") as file:
        return np.array([float(row[name]) for row in stdlib_csv.DictReader(file)])


def test_the_double_pendulum(double_pendulum_logs):
    plan = table.scan(double_pendulum_logs, ImportOptions())
    assert any("dfki_double_pendulum" in note for note in plan.notes)
    assert [source.id for source in plan.episodes] == [f"trajectory_{n:02d}" for n in (0, 1, 2, 3, 11, 12, 13)]
    counts = {split: list(plan.splits.values()).count(split) for split in ("train", "val", "test")}
    assert counts == {"train": 4, "val": 1, "test": 2}
    assert plan.splits["trajectory_13"] == "val"
    assert plan.licence == "BSD 3-Clause License"
    assert plan.model_dir == double_pendulum_logs / "model"
    assert plan.robot == "double_pendulum"
    loaded = {source.id: source.load() for source in plan.episodes}
    closed, opened = loaded["trajectory_11"], loaded["trajectory_00"]
    assert set(closed.command.signals) == {"torque", "position", "velocity"}
    assert set(opened.command.signals) == {"torque"}
    path = double_pendulum_logs / "trajectory_11.csv"
    for name, values in (
        ("pos_meas2", closed.measured["position"][:, 1]),
        ("vel_meas1", closed.measured["velocity"][:, 0]),
        ("tau_meas2", closed.measured["torque"][:, 1]),
        ("tau_con1", closed.command["torque"][:, 0]),
        ("pos_des2", closed.command["position"][:, 1]),
        ("time", closed.measured.time_s),
    ):
        np.testing.assert_array_equal(column(path, name), values)
    assert opened.measured.joints == ("joint1", "joint2")


def test_the_simple_pendulum(simple_pendulum_logs):
    plan = table.scan(simple_pendulum_logs, ImportOptions())
    assert any("dfki_simple_pendulum" in note for note in plan.notes)
    assert plan.splits == {
        "control_method_pd/system_identification": "train",
        "control_method_energy_shaping": "train",
        "control_method_gravity_compensation": "val",
        "control_method_ddp": "test",
        "control_method_direct_collocation": "test",
        "control_method_energy_shaping_1kg": "test",
    }
    loaded = {source.id: source.load() for source in plan.episodes}
    assert set(loaded) == set(plan.splits)
    collocation = loaded["control_method_direct_collocation"]
    assert collocation.measured.duration_s == pytest.approx(3.51, abs=0.01)
    assert collocation.command.duration_s == pytest.approx(3.90, abs=0.01)
    assert len(collocation.measured) == len(collocation.command) == 1170
    folder = simple_pendulum_logs / "control_method_ddp"
    ddp = loaded["control_method_ddp"]
    np.testing.assert_array_equal(ddp.command["torque"][:, 0], column(folder / "data_desired.csv", "torque"))
    np.testing.assert_array_equal(ddp.measured["torque"][:, 0], column(folder / "data_measured.csv", "torque"))
    assert ddp.measured.joints == ("joint",)
