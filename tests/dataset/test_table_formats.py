"""One mapping reads tables of any format, as other programs write them."""

import itertools
import json
import struct
import zipfile
import zlib

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import torch

from trueup.dataset.importers import table
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.detect import find_importer
from trueup.errors import ConfigError, DataError, NameMismatch
from trueup.stages import plan_import

JOINTS = ("yaw", "shoulder", "elbow")
# As cases/logs/gencsv.py of the shared folder makes them.
T = np.arange(0, 8, 0.01)
Q = np.column_stack([0.5 * np.sin((1 + 0.5 * i) * T + i) for i in range(3)])
U = np.column_stack([0.5 * np.sin((1 + 0.5 * i) * (T + 0.03) + i) for i in range(3)])
EPOCH_NS = 1691406519400223701
STAMPS_NS = EPOCH_NS + np.round(T * 1e9).astype(np.int64)

WIDE = """
joints: [yaw, shoulder, elbow]
series:
  measured:
    time: {time}
    signals:
      position: {{columns: "{measured}", unit: rad}}
  command:
    time: {time}
    signals:
      position: {{columns: "{command}", unit: rad}}
"""


def mapping(time="t", measured="{joint}", command="{joint}_cmd", more=""):
    return WIDE.format(time=time, measured=measured, command=command) + more


def loaded(folder, text, **options):
    path = folder / "m.yaml"
    path.write_text(text)
    plan = plan_import(folder / "logs", options=ImportOptions(mapping=path, **options))
    assert plan.format == "table"
    return [source.load() for source in plan.episodes]


def assert_read(episode, *, time_s=T, atol=1e-12):
    np.testing.assert_allclose(episode.measured.time_s, time_s, atol=1e-9)
    np.testing.assert_allclose(episode.measured["position"], Q[: len(time_s)], atol=atol)
    np.testing.assert_allclose(episode.command["position"], U[: len(time_s)], atol=atol)
    assert episode.measured.joints == JOINTS


def columns(**first):
    both = {name: values for i, joint in enumerate(JOINTS) for name, values in ((joint, Q[:, i]),)}
    return {**first, **both, **{f"{joint}_cmd": U[:, i] for i, joint in enumerate(JOINTS)}}


def text_of(table_columns, delimiter=",", number=repr):
    rows = zip(*table_columns.values(), strict=True)
    lines = [delimiter.join(table_columns), *(delimiter.join(number(float(x)) for x in row) for row in rows)]
    return "\n".join(lines) + "\n"


def write_parquet(path):
    pq.write_table(pa.table(columns(t=T)), path)


def write_parquet_vectors(path):
    pq.write_table(pa.table({"t": T, "q": list(Q), "q_des": list(U)}), path)


def write_mat(path):
    scipy.io.savemat(path, {"t": T, "q": Q, "q_des": U})


def write_xlsx(path):
    book = openpyxl.Workbook()
    book.active.append(list(columns(t=T)))
    for row in zip(*columns(t=T).values(), strict=True):
        book.active.append([float(value) for value in row])
    book.create_sheet("notes").append(["nothing of this is read"])
    book.save(path)


def write_mat_struct(path):
    scipy.io.savemat(path, {"log": {"t": T[:, None], "q": Q, "q_des": U}})


def write_mat_of_columns(path):
    """A sample in each column."""
    scipy.io.savemat(path, {"t": T[None], "q": Q.T, "q_des": U.T})


def write_mat_73(path):
    """As MATLAB writes version 7.3: HDF5 behind a head of its own, the last axis first."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"], file["q"], file["q_des"] = T[None], Q.T, U.T
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + bytes((0, 2)) + b"IM")


def structured():
    """Rows with a field for each column."""
    made = np.zeros(T.size, [("t", "f8"), *((name, "f8") for joint in JOINTS for name in (joint, f"{joint}_cmd"))])
    made["t"] = T
    for number, joint in enumerate(JOINTS):
        made[joint], made[f"{joint}_cmd"] = Q[:, number], U[:, number]
    return made


def write_h5_structured(path):
    with h5py.File(path, "w") as file:
        file["log"] = structured()


def write_npz(path):
    np.savez(path, dof_pos=Q.astype(np.float32), dof_vel=0 * Q, dof_pos_target=U, dt=0.01)


def write_h5(path):
    with h5py.File(path, "w") as file:
        file["obs/qpos"], file["action"], file["obs/time"] = np.hstack([Q, Q]), np.hstack([U, U]), T
        file["images/cam"] = np.zeros((len(T), 2, 2, 3), np.uint8)


def write_records(path):
    path.write_text(
        json.dumps(
            [
                {"t": t, "state": {"q": list(q)}, "q_des": list(u)}
                for t, q, u in zip(T.tolist(), Q.tolist(), U.tolist(), strict=True)
            ]
        )
    )


def write_lines(path):
    lines = [
        json.dumps({"t": t, "state": {"q": list(q)}, "q_des": list(u)})
        for t, q, u in zip(T.tolist(), Q.tolist(), U.tolist(), strict=True)
    ]
    path.write_text("\n".join(lines))


def write_lists(path):
    path.write_text(json.dumps({"t": T.tolist(), "q": Q.tolist(), "q_des": U.tolist()}))


@pytest.mark.parametrize(
    ("name", "write", "text", "atol"),
    [
        ("run.parquet", write_parquet, mapping(), 0),
        ("run.parquet", write_parquet_vectors, mapping("t", "q", "q_des"), 0),
        ("run.xlsx", write_xlsx, mapping(), 1e-15),
        ("run.mat", write_mat, mapping("t", "q", "q_des"), 0),
        ("run.mat", write_mat_struct, mapping("log.t", "log.q", "log.q_des"), 0),
        ("run.mat", write_mat_of_columns, mapping("t", "q", "q_des"), 0),
        ("run.mat", write_mat_73, mapping("t", "q", "q_des"), 0),
        ("run.npy", lambda path: np.save(path, structured()), mapping(), 0),
        (
            "run.npz",
            lambda path: np.savez(path, log=structured()),
            mapping("log.t", "log.{joint}", "log.{joint}_cmd"),
            0,
        ),
        ("run.hdf5", write_h5_structured, mapping("log.t", "log.{joint}", "log.{joint}_cmd"), 0),
        ("run.npz", write_npz, mapping("{rate_hz: 100}", "dof_pos", "dof_pos_target"), 1e-7),
        ("run.npz", write_npz, mapping("{period: dt}", "dof_pos[{i}]", "dof_pos_target[{i}]"), 1e-7),
        ("run.hdf5", write_h5, mapping("obs/time", "obs/qpos[{i}]", "action[{i}]"), 0),
        ("run.json", write_records, mapping("t", "state.q", "q_des"), 0),
        ("run.jsonl", write_lines, mapping("t", "state.q[{i}]", "q_des[{i}]"), 0),
        ("run.json", write_lists, mapping("t", "q", "q_des"), 0),
    ],
)
def test_arrays_of_other_programs(tmp_path, name, write, text, atol):
    (tmp_path / "logs").mkdir()
    write(tmp_path / "logs" / name)
    (episode,) = loaded(tmp_path, text)
    assert episode.id == "run"
    assert_read(episode, atol=atol)


def semicolons(table_columns):
    return text_of(table_columns, ";", lambda x: f"{x:.12f}".replace(".", ","))


VECTORS = "t,q,q_des\n" + "".join(
    f'{t!r},"{[float(x) for x in q]}","{[float(x) for x in u]}"\n'
    for t, q, u in zip(T.tolist(), Q.tolist(), U.tolist(), strict=True)
)
LONG = "time,joint,position,command\n" + "".join(
    f"{float(T[k])!r},{joint},{float(Q[k, i])!r},{float(U[k, i])!r}\n"
    for k in range(len(T))
    for i, joint in enumerate(JOINTS)
)
LONG_MAPPING = mapping("time", "position", "command").replace("    signals:", "    joint_column: joint\n    signals:")
DATES = [str(stamp).replace("T", " ") for stamp in STAMPS_NS.astype("datetime64[ns]")]


def with_stamps(*names_and_words):
    """Text of a table whose first columns are words."""
    names = [name for name, _ in names_and_words]
    lines = [",".join([*names, *columns()])]
    for k in range(len(T)):
        lines.append(
            ",".join([*(words[k] for _, words in names_and_words), *(repr(float(c[k])) for c in columns().values())])
        )
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (text_of(columns(t=T)), mapping()),
        (text_of(columns(t=T), "\t"), mapping()),
        (text_of(columns(t=T), "|"), mapping()),
        (text_of(columns(t=T), "  "), mapping()),
        (semicolons(columns(t=T)), mapping()),
        (semicolons(columns(t=T)).encode("utf-16"), mapping()),
        (b"\xef\xbb\xbf" + semicolons(columns(t=T)).replace("\n", "\r\n").encode(), mapping()),
        (text_of(columns(t=T)).replace("\n", "\ns,rad,rad,rad,rad,rad,rad\n", 1), mapping(more="units_row: true")),
        (
            text_of(columns(t=T)).partition("\n")[2],
            mapping("'0'", "'{n}'", "'{n}'", "header: none").replace("'{n}'", "{n}"),
        ),
        (VECTORS, mapping("t", "q", "q_des")),
        (VECTORS, mapping("t", "q[{i}]", "q_des[{i}]")),
        (LONG, LONG_MAPPING),
        (
            with_stamps(("sec", (STAMPS_NS // 10**9).astype(str)), ("nanosec", (STAMPS_NS % 10**9).astype(str))),
            mapping("{columns: [sec, nanosec]}"),
        ),
        (with_stamps(("time", DATES)), mapping("time")),
        (with_stamps(("time", [f"{date.replace(' ', 'T')}+02:00" for date in DATES])), mapping("time")),
        (text_of(columns(t=T)) + "8.0,1.0,2", mapping()),
        (text_of(columns(t=T)).replace("\n3.0,", "\nbroken\n3.0,", 1), mapping(more="skip_bad_rows: true")),
    ],
)
def test_text_as_people_have_it(tmp_path, content, text):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "run.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    if "header: none" in text:
        text = text.replace('columns: "{n}"', "columns: ['1', '2', '3']", 1).replace(
            'columns: "{n}"', "columns: ['4', '5', '6']"
        )
    (episode,) = loaded(tmp_path, text)
    assert_read(episode, atol=1e-11)


def test_what_was_left_out_is_flagged(tmp_path):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "run.csv").write_text(text_of(columns(t=T)) + "8.0,1.0,2")
    (episode,) = loaded(tmp_path, mapping())
    assert ["last line" in flag.detail for flag in episode.meta.flags] == [True]
    damaged = text_of(columns(t=T)).replace("\n3.0,", "\nbroken\n3.0,", 1).replace("\n4.0,", "\n4.0x,", 1)
    (tmp_path / "logs" / "run.csv").write_text(damaged)
    (episode,) = loaded(tmp_path, mapping(more="skip_bad_rows: true"))
    assert ["2 rows" in flag.detail for flag in episode.meta.flags if flag.kind == "cut_file"] == [True]
    assert len(episode.measured) == len(T) - 1
    with pytest.raises(DataError, match="wrong length"):
        loaded(tmp_path, mapping())


def test_series_of_different_rates_share_a_table(tmp_path):
    """An outer merge, as PlotJuggler exports it: rows without a value are no samples of that series."""
    (tmp_path / "logs").mkdir()
    late = T[::4] + 0.003
    rows = [(t, *map(repr, map(float, q)), "", "", "") for t, q in zip(T, Q, strict=True)]
    rows += [(t, "", "", "", *map(repr, map(float, u))) for t, u in zip(late, U[::4], strict=True)]
    header = "__time," + ",".join(
        [f"/joint_states/{name}/position" for name in JOINTS] + [f"/cmd/{name}" for name in JOINTS]
    )
    lines = [",".join(map(str, row)) for row in sorted(rows)]
    (tmp_path / "logs" / "pj.csv").write_text("\n".join([header, *lines]) + "\n")
    (episode,) = loaded(tmp_path, mapping("__time", "/joint_states/{joint}/position", "/cmd/{joint}"))
    np.testing.assert_allclose(episode.measured.time_s, T, atol=1e-9)
    np.testing.assert_allclose(episode.command.time_s, late, atol=1e-9)
    np.testing.assert_array_equal(episode.command["position"], U[::4])


def test_vectors_in_cells_share_a_table_too(tmp_path):
    (tmp_path / "logs").mkdir()
    rows = [(t, "", f'"{u}"') for t, u in zip((T[::4] - 0.003).tolist(), U[::4].tolist(), strict=True)]
    rows += [(t, f'"{q}"', "") for t, q in zip(T.tolist(), Q.tolist(), strict=True)]
    lines = [",".join(map(str, row)) for row in sorted(rows)]
    (tmp_path / "logs" / "run.csv").write_text("t,q,q_des\n" + "\n".join(lines) + "\n")
    (episode,) = loaded(tmp_path, mapping("t", "q", "q_des"))
    np.testing.assert_array_equal(episode.measured["position"], Q)
    np.testing.assert_array_equal(episode.command["position"], U[::4])


def test_ticks_factors_and_offsets(tmp_path):
    (tmp_path / "logs").mkdir()
    ticks = {f"present_position_{i + 1}": np.round(2048 + Q[:, i] * 2048 / np.pi) for i in range(3)}
    amperes = {f"present_current_{i + 1}": 2.0 * Q[:, i] for i in range(3)}
    (tmp_path / "logs" / "run.csv").write_text(text_of({"t": T, **ticks, **amperes}))
    text = """
joints: [yaw, shoulder, elbow]
series:
  measured:
    time: t
    signals:
      position: {columns: "present_position_{n}", unit: rad, factor: 0.0015339807878856412, offset: -3.141592653589793}
      torque: {columns: "present_current_{n}", unit: Nm, factor: [0.5, 1.0, 2.0]}
"""
    (episode,) = loaded(tmp_path, text)
    np.testing.assert_allclose(episode.measured["position"], Q, atol=0.0008)
    np.testing.assert_allclose(episode.measured["torque"], 2.0 * Q * [0.5, 1.0, 2.0])


@pytest.mark.parametrize(
    ("rule", "counts"),
    [
        ("split: {back: true}", [400, 400]),
        ("split: {column: trial}", [300, 500]),
        ("split: {gap_s: 0.5}", [200, 600]),
        ("split: {every_s: 3.0}", [300, 300, 200]),
        ("split: {rest_s: 0.4}", [201, 550]),
    ],
)
def test_a_long_file_is_taken_apart(tmp_path, rule, counts):
    (tmp_path / "logs").mkdir()
    stamps, position = T.copy(), Q.copy()
    if "back" in rule:
        stamps = np.where(T < 4.0 - 1e-9, T, T - 4.0)
    if "gap" in rule:
        stamps = np.where(T < 2.0 - 1e-9, T, T + 1.0)
    if "rest" in rule:
        position[200:250] = position[200]
    own = {joint: position[:, i] for i, joint in enumerate(JOINTS)}
    table_columns = {"t": stamps, **columns(), **own, "trial": np.where(T < 3.0 - 1e-9, 1, 2)}
    (tmp_path / "logs" / "run.csv").write_text(text_of(table_columns))
    found = loaded(tmp_path, mapping(more=rule))
    assert [len(episode.measured) for episode in found] == counts
    assert len({episode.id for episode in found}) == len(counts)
    np.testing.assert_array_equal(found[0].measured["position"], position[: counts[0]])
    assert found[1].measured.time_s[0] == 0.0


def test_groups_of_a_file_are_a_motion_each(tmp_path):
    """As robomimic has its demonstrations."""
    (tmp_path / "logs").mkdir()
    with h5py.File(tmp_path / "logs" / "demos.hdf5", "w") as file:
        for number in (10, 2):
            demo = file.create_group(f"data/demo_{number}")
            demo["actions"], demo["obs/robot0_joint_pos"] = U[: 100 * number], Q[: 100 * number]
        file["mask/train"] = np.array([b"demo_2"])
    text = mapping("{rate_hz: 100}", "obs/robot0_joint_pos", "actions", more=r"group: 'data/demo_\d+'")
    first, second = loaded(tmp_path, text)
    assert (first.id, second.id) == ("demos/data/demo_2", "demos/data/demo_10")
    assert_read(first, time_s=T[:200], atol=0)
    assert len(second.measured) == 800
    with pytest.raises(DataError, match="no group"):
        loaded(tmp_path, mapping("{rate_hz: 100}", "a", "b", more="group: episode"))


def test_a_clock_that_stands_still_is_an_error_that_says_why(tmp_path):
    (tmp_path / "logs").mkdir()
    content = with_stamps(("sec", (STAMPS_NS // 10**9).astype(str)), ("nanosec", (STAMPS_NS % 10**9).astype(str)))
    (tmp_path / "logs" / "run.csv").write_text(content)
    with pytest.raises(DataError, match="9 stamps in 800 rows") as caught:
        loaded(tmp_path, mapping("sec"))
    assert "columns: [sec, nanosec]" in caught.value.hint
    np.savez(tmp_path / "logs" / "run.npz", t=(STAMPS_NS / 1e9).astype(np.float32), q=Q, q_des=U)
    (tmp_path / "logs" / "run.csv").unlink()
    with pytest.raises(DataError, match="nearly all samples"):
        loaded(tmp_path, mapping("t", "q", "q_des"))


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        (mapping("{column: t, rate_hz: 100}"), ConfigError, "one of column"),
        (mapping("{columns: [a]}"), ConfigError, "one of column"),
        (mapping("{rate_hz: -1}"), DataError, "time between two samples"),
        (mapping(more="split: {}"), ConfigError, "not a YAML mapping"),
        (mapping(more="split: {gap_s: 1, back: true}"), ConfigError, "split"),
        (mapping(more="decimal: ';'"), ConfigError, "decimal"),
        (mapping("t", "q", "q_des"), NameMismatch, "no column q"),
        (mapping(more="encoding: klingon"), DataError, "klingon"),
    ],
)
def test_what_a_mapping_may_not_say(tmp_path, text, error, words):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "run.csv").write_text(text_of(columns(t=T)))
    with pytest.raises(error, match=words):
        loaded(tmp_path, text)


def test_vectors_of_another_length_say_how_to_name_components(tmp_path):
    (tmp_path / "logs").mkdir()
    np.savez(tmp_path / "logs" / "run.npz", t=T, q=np.hstack([Q, Q]), q_des=U)
    with pytest.raises(DataError, match="got 6 a row; expected 3") as caught:
        loaded(tmp_path, mapping("t", "q", "q_des"))
    assert "q[0]" in caught.value.hint


@pytest.mark.parametrize("name", ["run.parquet", "run.mat", "run.npz", "run.hdf5", "run.json", "run.jsonl", "run.xlsx"])
def test_damaged_files_are_one_line(tmp_path, name):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / name).write_bytes(b"PAR1\x00MATLAB 5.0\xff\xfe{]" * 20)
    with pytest.raises(DataError) as caught:
        loaded(tmp_path, mapping())
    assert name in str(caught.value)


@pytest.mark.parametrize("with_mapping", [True, False])
@pytest.mark.parametrize("whole", [True, False])
def test_a_pickle_is_not_opened_and_the_way_round_it_is_said(tmp_path, with_mapping, whole):
    logs = tmp_path / "logs"
    logs.mkdir()
    torch.save({"time": torch.tensor(T), "dof_pos": torch.tensor(Q), "des_dof_pos": torch.tensor(U)}, logs / "chirp.pt")
    (tmp_path / "m.yaml").write_text(mapping("{rate_hz: 100}", "dof_pos", "des_dof_pos"))
    options = ImportOptions(mapping=tmp_path / "m.yaml" if with_mapping else None)

    def read(path):
        return [source.load() for source in plan_import(path, options=options).episodes]

    with pytest.raises(DataError, match="may run code") as caught:
        read(logs if whole else logs / "chirp.pt")
    line = (
        caught.value.hint.partition(": ")[2]
        .replace("FILE", repr(str(logs / "chirp.pt")))
        .replace("chirp.npz", str(logs / "x.npz"))
    )
    exec(line, {"torch": torch, "numpy": np})  # what somebody who trusts the file does
    (logs / "chirp.pt").unlink()
    if with_mapping:
        assert_read(read(logs)[0])


@pytest.mark.long
def test_a_mat_file_that_unpacks_to_gigabytes_is_refused(tmp_path):
    (tmp_path / "logs").mkdir()
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(300)) + packer.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (tmp_path / "logs" / "run.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(DataError, match="unpacks to more"):
        loaded(tmp_path, mapping())


def names_of_their_own(path):
    path.write_text("".join(f'{{"k{number}": 1}}\n' for number in range(20_000)))


def one_long_vector(path):
    path.write_text('{"t": 0, "a": [' + ",".join(["1"] * 200_000) + "]}\n" + '{"t": 1}\n' * 10_000)


def one_long_text(path):
    path.write_text(json.dumps({"t": ["x" * 1_000_000, *["x"] * 100_000]}))


def groups_that_lead_to_each_other(path):
    with h5py.File(path, "w") as file:
        groups = [file.create_group(f"g{number}") for number in range(16)]
        for here, there in itertools.pairwise(groups):
            for number in range(60):
                here[f"link{number}"] = there


def workbook(path, rows, claimed):
    openpyxl = pytest.importorskip("openpyxl")
    path.with_suffix(".plain").write_bytes(b"")
    openpyxl.Workbook().save(path.with_suffix(".plain"))
    sheet = (
        '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main">'
        f'<dimension ref="{claimed}"/><sheetData>{rows}</sheetData></worksheet>'
    )
    with zipfile.ZipFile(path.with_suffix(".plain")) as plain, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as own:
        for name in plain.namelist():
            own.writestr(name, sheet if name.endswith("sheet1.xml") else plain.read(name))
    path.with_suffix(".plain").unlink()


def last_cells(path):
    row = '<row r="{0}"><c r="XFD{0}"><v>1</v></c></row>'
    workbook(path, "".join(row.format(number) for number in range(1, 20_000)), "A1:A1")


def a_row_far_below(path):
    workbook(path, '<row r="1"><c r="A1"><v>1</v></c></row><row r="99999999999"/>', "A1:A1")


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("x.jsonl", names_of_their_own),
        ("x.jsonl", one_long_vector),
        ("x.json", one_long_text),
        ("x.h5", groups_that_lead_to_each_other),
        ("x.xlsx", last_cells),
        ("x.xlsx", a_row_far_below),
    ],
)
def test_small_files_whose_table_is_huge(tmp_path, name, write):
    """What a table lacks is filled in: some kB are then gigabytes, or take hours."""
    (tmp_path / "logs").mkdir()
    write(tmp_path / "logs" / name)
    with pytest.raises((DataError, NameMismatch)):
        loaded(tmp_path, mapping())


def test_a_claim_of_a_sheet_is_not_filled_in(tmp_path):
    cells = [["t", *JOINTS, *(f"{joint}_cmd" for joint in JOINTS)], *np.column_stack([T, Q, U]).tolist()]
    rows = "".join(
        f'<row r="{row}">'
        + "".join(
            f'<c r="{"ABCDEFG"[place]}{row}" t="inlineStr"><is><t>{cell}</t></is></c>'
            if row == 1
            else f'<c r="{"ABCDEFG"[place]}{row}"><v>{cell!r}</v></c>'
            for place, cell in enumerate(line)
        )
        + "</row>"
        for row, line in enumerate(cells, start=1)
    )
    (tmp_path / "logs").mkdir()
    workbook(tmp_path / "logs" / "x.xlsx", rows, "A1:XFD1048576")
    (episode,) = loaded(tmp_path, mapping())
    assert_read(episode)


def test_a_mapping_beside_the_logs_reads_arrays_that_have_a_format_of_their_own(tmp_path):
    (tmp_path / "logs").mkdir()
    write_npz(tmp_path / "logs" / "run.npz")
    assert find_importer(tmp_path / "logs").NAME == "npz"
    (tmp_path / "logs" / "mapping.yaml").write_text(mapping("{period: dt}", "dof_pos", "dof_pos_target"))
    assert find_importer(tmp_path / "logs").NAME == "table"
    (source,) = table.scan(tmp_path / "logs", ImportOptions()).episodes
    assert_read(source.load(), atol=1e-7)


@pytest.mark.parametrize(
    ("name", "change", "count"),
    [
        ("excel_de", ("", ""), 800),
        ("partial", ("", ""), 800),
        ("datetime", ("", ""), 800),
        ("plotjuggler", ("", ""), 800),
        ("sec_nsec", ('{column: "sec", unit: s}', "{columns: [sec, nanosec]}"), 800),
    ],
)
def test_cases_of_strangers(tmp_path, log_cases, name, change, count):
    logs, text = log_cases / "csv" / name, (log_cases / "map" / f"{name}.yaml").read_text().replace(*change)
    path = tmp_path / "m.yaml"
    path.write_text(text)
    (source,) = plan_import(logs, options=ImportOptions(mapping=path)).episodes
    episode = source.load()
    assert len(episode.measured) == count
    unit = np.deg2rad(1.0) if "deg" in episode.measured.units["position"] else 1.0
    np.testing.assert_allclose(unit * episode.measured["position"], Q, atol=1e-6)


@pytest.mark.parametrize("folders", [("",), ("run_1", "run_2")])
def test_a_file_for_each_array_of_a_recording(tmp_path, folders):
    """Each folder is a motion; what differs in any file is another recording."""
    for number, folder in enumerate(folders):
        where = tmp_path / "logs" / folder
        where.mkdir(parents=True)
        for name, array in {"t": T, "q": Q, "q_cmd": U + 0.001 * number}.items():
            np.save(where / f"{name}.npy", array)
    suggestion = table.suggested(tmp_path / "logs")
    (tmp_path / "found.yaml").write_text(suggestion.text)
    plan = plan_import(tmp_path / "logs", options=ImportOptions(mapping=tmp_path / "found.yaml"))
    episodes = [source.load() for source in plan.episodes]
    assert [episode.id for episode in episodes] == (list(folders) if folders[0] else ["q"])
    for number, episode in enumerate(episodes):
        np.testing.assert_array_equal(episode.measured["position"], Q)
        np.testing.assert_array_equal(episode.command["position"], U + 0.001 * number)
    assert len({episode.meta.source_hash for episode in episodes}) == len(episodes)
