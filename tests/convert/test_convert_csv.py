"""CSV and HFB-320 text in and CSV out: same bits back, and every error names its place."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from records import record

from station.conventions import SIGNALS
from station.convert import Importer, Record, Track, export, import_file
from station.convert.delimited import read_csv
from station.convert.tracks import write_record
from station.log import read_rows, summarise, table
from station.profile import Aircraft, load_aircraft, load_rig
from station.rows import LogError, Sample

AIRCRAFT = load_aircraft("twin_otter")

finite = st.floats(allow_nan=False, allow_infinity=False)
cell = st.just(math.nan) | finite


def imported(tmp_path: Path, text: str) -> Path:
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    import_file(tmp_path / "a.csv", tmp_path / "a.mcap", AIRCRAFT)
    return tmp_path / "a.mcap"


def test_units_are_converted(tmp_path: Path) -> None:
    found = table(
        imported(
            tmp_path,
            "# a comment\n\ntime [ms], alpha_vane [deg] ,airspeed[kt],ax [ft/s^2],dynamic_pressure [psf],az [g],"
            "air_temperature [degC]\n"
            "0,1,100,10,1,-1,15\n# another\n20,,nan,NaN,2,-1,15\n",
        )
    )
    assert found.t_s.tolist() == [0.0, 0.02]
    assert found.columns["alpha_vane"][0] == pytest.approx(math.pi / 180)
    assert found.columns["airspeed"][0] == pytest.approx(51.4444444)
    assert found.columns["ax"][0] == pytest.approx(3.048)
    assert found.columns["dynamic_pressure"][0] == pytest.approx(47.88025898)
    assert found.columns["az"][0] == -9.80665
    assert found.columns["air_temperature"][0] == 288.15
    missing = [name for name, column in found.columns.items() if math.isnan(column[1])]
    assert missing == ["alpha_vane", "airspeed", "ax"]


def test_uneven_time_is_kept_as_it_is(tmp_path: Path) -> None:
    path = imported(tmp_path, "time [s],q [rad/s]\n-1.5,0\n-1.47,1\n0.001,2\n7.123456789,3\n")
    samples = [r for r in read_rows(path) if isinstance(r, Sample)]
    assert [s.t_device_ns for s in samples] == [-1_500_000_000, -1_470_000_000, 1_000_000, 7_123_456_789]
    assert [s.t_ns for s in samples] == [0, 30_000_000, 1_501_000_000, 8_623_456_789]
    assert table(path).t_s.tolist() == [0.0, 0.03, 1.501, 8.623456789]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(cell, cell, cell), min_size=1, max_size=5),
    steps=st.lists(st.integers(1, 10**10), min_size=5, max_size=5),
    start=st.integers(-(10**12), 10**12),
)
def test_out_and_in_again_gives_the_same_bits(
    tmp_path: Path, rows: list[tuple[float, float, float]], steps: list[int], start: int
) -> None:
    for old in tmp_path.iterdir():
        old.unlink()
    t_ns = start + np.cumsum([0, *steps[: len(rows) - 1]])
    names = ("q", "az", "alpha_vane")
    columns = {name: np.array([row[i] for row in rows]) for i, name in enumerate(names)}
    if all(np.all(np.isnan(c)) for c in columns.values()):
        return
    write_record(tmp_path / "a.mcap", Record([Track("record", t_ns, columns)], AIRCRAFT, "csv"))
    export(tmp_path / "a.mcap", "csv", tmp_path / "b.csv")
    import_file(tmp_path / "b.csv", tmp_path / "b.mcap", AIRCRAFT)
    first, second = table(tmp_path / "a.mcap"), table(tmp_path / "b.mcap")
    assert first.record_ns is not None
    assert second.record_ns is not None
    assert first.record_ns.tolist() == second.record_ns.tolist() == t_ns.tolist()
    for name in first.columns:
        assert [struct.pack("<d", v) for v in first.columns[name]] == [
            struct.pack("<d", v) for v in second.columns[name]
        ]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ("# only a comment\n", "empty"),
        ("time [s],alfa_vane [deg]\n0,1\n", "line 1, column 2: unknown signal 'alfa_vane'; did you mean alpha_vane?"),
        (
            "\n# c\ntime [s],kkkk [deg]\n0,1\n",
            "line 3, column 2: unknown signal 'kkkk'\nknown, each with its unit as in q [deg/s]: time, alpha_vane",
        ),
        ("time [s],q\n0,1\n", "line 1, column 2: q has no unit: write q [rad/s]"),
        ("time,q [deg/s]\n0,1\n", "line 1, column 1: time has no unit"),
        ("time [s],q [furlong]\n0,1\n", "line 1, column 2: q: unknown unit: 'furlong'"),
        ("time [s],q [ft/s]\n0,1\n", "column 2: q: unit that does not fit: 'ft/s'\nfitting: rad/s, mrad/s, deg/s"),
        ("time [s],q [deg/s],q [rad/s]\n0,1,1\n", "line 1, column 3: q is given twice, first in column 2"),
        ("time [s],q [deg/s] x\n0,1\n", "line 1, column 2: 'q [deg/s] x' is not a name and its unit"),
        ("q [deg/s]\n1\n", "line 1: no column time"),
        ("time [s]\n1\n", "no signal beside time"),
        ("time [s],q [deg/s]\n", "no row of values"),
        ("time [s],q [deg/s]\n0,1\n0.02,1,2\n", "line 3, column 3: 3 columns, but the header has 2"),
        ("time [s],q [deg/s]\n0,1\n0.02\n", "line 3, column 2: 1 columns, but the header has 2"),
        ("time [s],q [deg/s]\n0,1\n0.02,one\n", "line 3, column 2: 'one' is not a number"),
        ("time [s],q [deg/s]\n0,1\n0.02,inf\n", "line 3, column 2: 'inf' is not a number"),
        ("time [s],q [deg/s]\n0,1\n,1\n", "line 3, column 1: time is missing"),
        ("time [s],q [deg/s]\n0,1\n0.02,1\n0.02,1\n", "line 4, column 1: time does not increase: 0.02 after 0.02"),
        ("time [s],q [deg/s]\n0,1\n1e-10,1\n", "time does not increase by a nanosecond"),
        ("time [s],q [deg/s]\n1e300,1\n", "out of range"),
    ],
)
def test_errors_name_the_place_and_the_remedy(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(LogError) as refused:
        imported(tmp_path, text)
    assert says in str(refused.value)
    assert str(tmp_path / "a.csv") in str(refused.value)
    assert len(str(refused.value).splitlines()) <= 3
    assert not (tmp_path / "a.mcap").exists()


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.csv").write_bytes(b"time [s],q [deg/s]\n0,1\n" + content)
    (tmp_path / "a.mcap").unlink(missing_ok=True)
    try:
        import_file(tmp_path / "a.csv", tmp_path / "a.mcap", AIRCRAFT)
    except LogError:
        assert not (tmp_path / "a.mcap").exists()


def test_a_byte_order_mark_and_windows_lines_are_no_trouble(tmp_path: Path) -> None:
    path = imported(tmp_path, "\ufefftime [s],q [deg/s]\r\n0,1\r\n0.02,2\r\n")
    assert len(table(path).t_s) == 2


def test_unknown_kinds_missing_files_and_taken_names(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"cannot import \.txt; known: \.csv, \.mat, \.asc, \.ulg"):
        import_file(tmp_path / "a.txt", tmp_path / "a.mcap", AIRCRAFT)
    with pytest.raises(LogError, match="no such file"):
        import_file(tmp_path / "a.csv", tmp_path / "a.mcap", AIRCRAFT)
    path = imported(tmp_path, "time [s],q [deg/s]\n0,1\n")
    with pytest.raises(LogError, match="exists already"):
        import_file(tmp_path / "a.csv", path, AIRCRAFT)


def test_hfb_columns_by_hand(tmp_path: Path) -> None:
    line = " ".join(str(i) for i in range(1, 21))
    (tmp_path / "a.asc").write_text(f"  0 {line[2:]}\n  0.1 {line[2:]}\n")
    import_file(tmp_path / "a.asc", tmp_path / "a.mcap", load_aircraft("hfb320"))
    found = table(tmp_path / "a.mcap")
    assert {n: c[0] for n, c in found.columns.items()} == {
        "elevator": 2, "dynamic_pressure": 3, "thrust": 4, "airspeed": 5, "alpha_vane": 6, "theta": 7, "q": 8,
        "qdot": 9, "ax": 10, "az": 11, "ay": 12,
    }  # fmt: skip
    assert found.extra["column_20"].tolist() == [20, 20]
    (tmp_path / "b.asc").write_text("0 1 2\n")
    with pytest.raises(LogError, match="line 1: 3 columns, not at least 12"):
        import_file(tmp_path / "b.asc", tmp_path / "b.mcap", load_aircraft("hfb320"))


def test_the_hfb_record_goes_through_csv_with_the_same_bits(tmp_path: Path) -> None:
    path = record("hfb320/hfb320_1_10.asc")
    import_file(path, tmp_path / "a.mcap", load_aircraft("hfb320"))
    first = table(tmp_path / "a.mcap")
    original = np.loadtxt(path)
    assert len(first.t_s) == 601
    assert first.rate_hz == pytest.approx(10.0)
    assert np.array_equal(first.columns["alpha_vane"], original[:, 5])
    assert np.array_equal(first.extra["column_13"], original[:, 12])
    export(tmp_path / "a.mcap", "csv", tmp_path / "b.csv")
    import_file(tmp_path / "b.csv", tmp_path / "b.mcap", load_aircraft("hfb320"))
    second = table(tmp_path / "b.mcap")
    assert np.array_equal(first.t_s, second.t_s)
    assert all(np.array_equal(first.columns[n], second.columns[n]) for n in first.columns)
    assert summarise(tmp_path / "b.mcap").verdict == "complete"


def test_every_signal_can_be_imported_in_every_unit_that_fits(tmp_path: Path) -> None:
    header = ",".join(["time [s]", *(f"{n} [{s.unit}]" for n, s in SIGNALS.items())])
    path = imported(tmp_path, header + "\n" + ",".join("1" for _ in range(len(SIGNALS) + 1)) + "\n")
    assert set(table(path).columns) == set(SIGNALS)


def test_a_kind_of_file_is_one_row(tmp_path: Path) -> None:
    """Pairs of elevator, deg, and pitch rate, rad/s, at 50 Hz; told from other .txt by its first line."""

    def read(path: Path, aircraft: Aircraft) -> Record:
        rows = np.array([[float(cell) for cell in line.split()] for line in path.read_text().splitlines()[1:]])
        t_ns = np.arange(len(rows)) * 20_000_000
        return Record([Track("pairs", t_ns, {"elevator": np.radians(rows[:, 0]), "q": rows[:, 1]})], aircraft, "pairs")

    pairs = Importer(".txt", "pairs", read, lambda path: path.read_text().startswith("PAIRS"))
    never = Importer(".txt", "another", read_csv, lambda _: False)
    (tmp_path / "a.txt").write_text("PAIRS\n1 0.5\n2 0.25\n3 0.125\n")
    assert import_file(tmp_path / "a.txt", tmp_path / "a.mcap", AIRCRAFT, (never, pairs)) == 3
    found = table(tmp_path / "a.mcap")
    assert found.columns["q"].tolist() == [0.5, 0.25, 0.125]
    np.testing.assert_allclose(np.degrees(found.columns["elevator"]), [1, 2, 3])
    with pytest.raises(LogError, match=r"cannot import \.txtt; known: \.txt, \.csv"):
        import_file(tmp_path / "a.txtt", tmp_path / "b.mcap", AIRCRAFT, (pairs,))


DECLARED = "time [s],az_tip [g],torque [lbf ft],propeller_speed [rpm],az [g]\n0,-1.5,1000,2000,-1\n0.1,-1,0,2000,-1\n"


def test_columns_that_a_rig_declares_come_in_and_those_it_derives_are_made(tmp_path: Path) -> None:
    """And what is exported comes in again as it was, the derived columns made anew."""
    rig = load_rig("instrumented")
    (tmp_path / "a.csv").write_text(DECLARED)
    import_file(tmp_path / "a.csv", tmp_path / "a.mcap", AIRCRAFT, rig=rig)
    found = table(tmp_path / "a.mcap")
    assert found.columns["az_tip"].tolist() == [-1.5 * 9.80665, -9.80665]
    assert found.columns["torque"][0] == pytest.approx(1355.817948)
    assert found.columns["propeller_speed"][0] == pytest.approx(2000 * 2 * math.pi / 60)
    assert found.columns["tip_to_cg"] == pytest.approx([-0.5 * 9.80665, 0])
    export(tmp_path / "a.mcap", "csv", tmp_path / "b.csv")
    import_file(tmp_path / "b.csv", tmp_path / "b.mcap", AIRCRAFT, rig=rig)
    export(tmp_path / "b.mcap", "csv", tmp_path / "c.csv")
    assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "c.csv").read_bytes()


def test_a_declared_column_is_known_by_its_rig_only_and_its_unit_must_fit(tmp_path: Path) -> None:
    out, rig = tmp_path / "a.mcap", load_rig("instrumented")
    (tmp_path / "a.csv").write_text(DECLARED)
    with pytest.raises(LogError, match=r"line 1, column 2: unknown signal 'az_tip'.*\n.*--rig"):
        import_file(tmp_path / "a.csv", out, AIRCRAFT)
    (tmp_path / "a.csv").write_text(DECLARED.replace("torque [lbf ft]", "torque [kg]"))
    with pytest.raises(LogError, match=r"column 3: torque: unit that does not fit: 'kg'\nfitting: N m"):
        import_file(tmp_path / "a.csv", out, AIRCRAFT, rig=rig)
    (tmp_path / "a.asc").write_text("0 " * 12 + "\n")
    with pytest.raises(LogError, match="--rig is for a CSV"):
        import_file(tmp_path / "a.asc", out, AIRCRAFT, rig=rig)
