"""What users get wrong, and what machines do to them: one of its exit codes, one to three lines, no traceback."""

import io
import os
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from station.__main__ import main
from station.commands.process import line_writer, spread
from station.conventions import Stream
from station.flight.emulators import Emulated, streams_flown
from station.log import About, write_log
from station.profile import load_aircraft, load_card, load_rig, profiles_dir
from station.rows import Sample

RIG = (profiles_dir() / "rigs" / "bench.toml").read_text()
CARD = 'name = "mine"\naircraft = "twin_otter"\nrig = "{rig}"\n'


def refused(station, code, expected, *words):
    """Whether the command is refused with that code and words, in one to three lines."""
    got, out, err = station(*words)
    assert (got, out) == (code, ""), err
    assert expected in err
    words = err.partition("station: ")[2]  # before it stands what was done until then
    assert 1 <= len(words.strip().splitlines()) <= 3, err
    assert "Traceback" not in err
    assert "internal error" not in err


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """An imported record: 20 s at 50 Hz of a pitching oscillation, angle of attack at the CG."""
    path = tmp_path_factory.mktemp("logs") / "record.mcap"
    aircraft = load_aircraft("twin_otter")
    t = np.arange(1000) / 50
    stream = load_rig("can_only").streams()
    names = tuple(n for s in stream for n in s.signals)
    steady = {"airspeed": 56.0, "dynamic_pressure": 1700.0, "az": -9.81, "static_pressure": 92_000.0}
    steady["air_temperature"] = 283.0
    about = About(aircraft, (Stream("record", names, 50.0, 0.2),), source="csv", imported=True)
    values = np.column_stack([steady.get(n, 0.0) + 0.01 * np.sin((3 + i) * t) for i, n in enumerate(names)])
    rows = (Sample(k * 20_000_000, "record", k * 20_000_000, None, tuple(v)) for k, v in enumerate(values.tolist()))
    write_log(path, about, rows)
    return path


@pytest.mark.parametrize(
    ("code", "expected", "words"),
    [
        (2, "--duration", ("run", "--duration", "nan")),
        (2, "inf is not a number of seconds", ("check", "--seconds", "inf")),
        (2, "inf is not a number of seconds", ("simulate", "bench", "-o", "{out}", "--duration", "inf")),
        (2, "--duration", ("run", "--duration", "-5")),
        (2, "--forgetting", ("run", "--forgetting", "5")),
        (2, "--seed", ("simulate", "bench", "-o", "{out}", "--seed", "-1")),
        (2, "--speed: 'nan'", ("replay", "{flight}", "--speed", "nan")),
        (2, "imported record has no ticks", ("replay", "{log}")),
        (2, "no aircraft named cessna", ("identify", "{log}", "--aircraft", "cessna")),
        (2, "no aircraft named cessna", ("import", "{log}", "-o", "{out}", "--aircraft", "cessna")),
        (2, "did you mean split", ("identify", "{log}", "--method", "splt")),
        (2, "no test point 7", ("identify", "{log}", "--point", "7")),
        (2, "no data from nan", ("identify", "{log}", "--from", "nan")),
        (1, "cannot import .mcap", ("import", "{log}", "-o", "{out}", "--aircraft", "twin_otter")),
        (1, "cannot be written", ("identify", "{log}", "--method", "II", "--json", "{file}/x.json")),
        (1, "cannot be written", ("simulate", "bench", "-o", "{file}/x.mcap", "--duration", "1")),
        (1, "cannot be written", ("recover", "{log}", "-o", "{file}/x.mcap")),
        (1, "Not a directory", ("export", "{log}", "--to", "rrd", "-o", "{file}/x.rrd")),
        (1, "cannot be written", ("export", "{log}", "--to", "csv", "-o", "{file}/x.csv")),
        (1, "exists already", ("export", "{log}", "--to", "rrd", "-o", "{file}")),
        (1, "exists already", ("export", "{log}", "--to", "mat", "-o", "{file}")),
        (1, "exists already", ("simulate", "bench", "-o", "{file}")),
        (1, "no such file", ("export", "{out}", "--to", "csv", "-o", "{out}.csv")),
        (1, "no such file", ("diagnose", "{log}", "--hold-out", "{log}", "{out}")),
        (1, "Not a directory", ("run", "{card}", "--view", "none", "--log", "{file}")),
        (1, "device boom is emulated and its", ("run", "{bench}", "--view", "none", "--log", "{out}")),
    ],
)
def test_a_command_that_cannot_be_done(station, log, tmp_path, monkeypatch, code, expected, words):
    file = tmp_path / "file"
    file.write_text("kept")
    card = tmp_path / "card.toml"
    card.write_text(CARD.format(rig=tmp_path / "rig.toml"))
    (tmp_path / "rig.toml").write_text(RIG.replace('"emulated"', '"/nowhere"'))
    (tmp_path / "bench.dbc").write_bytes((profiles_dir() / "rigs" / "bench.dbc").read_bytes())
    bench = tmp_path / "bench.toml"
    bench.write_text(CARD.format(rig="bench"))
    places = {"log": log, "flight": log, "out": tmp_path / "out", "file": file, "card": card, "bench": bench}
    refused(station, code, expected, *(w.format(**places) for w in words))
    assert file.read_text() == "kept"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('rate = "200 Hz"', "rate = 200", 'rate: missing unit: write "200 Hz"'),
        ('rate = "200 Hz"', 'rate = "-3 Hz"', "rate: input should be greater than 0"),
        ('rate = "200 Hz"', 'rate = "nan Hz"', "is not a number and a unit"),
        ('rate = "200 Hz"', 'raet = "200 Hz"', "unknown key; did you mean rate?"),
        ('unit = "deg/s"', 'unit = "degs"', "unknown unit 'degs'; did you mean deg/s?"),
        ('unit = "deg/s"', 'unit = "m"', "signal p is in rad/s: unit 'm' does not fit"),
        ("beta_vane =", "alpha_vain =", "unknown signal alpha_vain; did you mean alpha_vane?"),
        ("aileron =", "elevator =", "signal elevator is claimed by boom.vanes and by can.pots: take it out of one"),
        ('message = "GYRO"', 'message = "GIRO"', "has no message GIRO; did you mean GYRO?"),
        ('field = "p"', 'field = "pp"', "bench.dbc has no signal pp; did you mean p?"),
        ('dbc = "bench.dbc"', 'dbc = "rig.toml"', "rig.toml: not a usable DBC"),
        ('dbc = "bench.dbc"', 'dbc = "none.dbc"', "none.dbc: cannot be read: No such file or directory"),
        ('link = "serial"', 'link = "serail"', "devices[0].link: unknown: serail; did you mean serial?"),
        (
            'link = "serial"',
            'link = "telepathy"',
            "devices[0].link: unknown: telepathy\nknown: serial, can, dronecan, mavlink",
        ),
        (
            'protocol = "boombox"',
            'protocol = "bombox"',
            "device boom, protocol: unknown protocol bombox; did you",
        ),
        ('message = "ATTITUDE"', 'message = "ALTITUDE"', "no message 'ALTITUDE' on this link"),
        ("alpha_vane =", "# alpha_vane =", "needs: no device of rig bench gives alpha_vane; did you mean beta_vane?"),
        ("[[devices]]", "[[devices]", "not valid TOML"),
    ],
)
def test_a_rig_that_cannot_be_right(station, tmp_path, old, new, expected):
    assert old in RIG
    (tmp_path / "rig.toml").write_text(RIG.replace(old, new, 1))
    (tmp_path / "bench.dbc").write_bytes((profiles_dir() / "rigs" / "bench.dbc").read_bytes())
    card = tmp_path / "card.toml"
    card.write_text(CARD.format(rig=tmp_path / "rig.toml"))
    for verb in ("run", "check"):
        refused(station, 2, expected, verb, card)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "empty: the first line must name the columns"),
        ("time [s],alpha_vain [deg]\n0,1\n", "line 1, column 2: unknown signal 'alpha_vain'; did you mean alpha_vane?"),
        ("time [s],q [deg/S]\n0,1\n", "line 1, column 2: q: unknown unit: 'deg/S'"),
        ("time [s],q\n0,1\n", "line 1, column 2: q has no unit: write q [rad/s]"),
        ("time [s],q [rad/s]\n0,1\n0.02\n", "line 3, column 2: 1 columns, but the header has 2"),
        ("time [s],q [rad/s]\n0,1\n0.02,1,5\n", "line 3, column 3: 3 columns, but the header has 2"),
        ("time [s],q [rad/s]\n0.1,1\n0.1,2\n", "line 3, column 1: time does not increase"),
        ("time [s],q [rad/s]\n0,1\n0.02,x\n", "line 3, column 2: 'x' is not a number"),
    ],
)
def test_a_csv_that_cannot_be_right(station, tmp_path, text, expected):
    (tmp_path / "a.csv").write_text(text)
    refused(station, 1, expected, "import", tmp_path / "a.csv", "-o", tmp_path / "out", "--aircraft", "twin_otter")
    assert not (tmp_path / "out").exists()


def test_mat_files_without_fdata(station, tmp_path):
    words = ("-o", tmp_path / "out", "--aircraft", "twin_otter")
    savemat(tmp_path / "a.mat", {"x": np.eye(3), "y": 1.0})
    refused(station, 1, "holds no variable fdata (SIDPAC's matrix), but x, y", "import", tmp_path / "a.mat", *words)
    (tmp_path / "b.mat").write_bytes(b"MATLAB 5.0" + bytes(300))
    refused(station, 1, "b.mat: not a MATLAB file that can be read", "import", tmp_path / "b.mat", *words)


def test_a_recording_that_ends_early_is_exported_and_identified_but_said_to(station, log, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:-20_000])
    for words in (("export", cut, "--to", "csv", "-o", tmp_path / "x.csv"), ("identify", cut, "--method", "II")):
        code, _, err = station(*words)
        assert code == 3
        assert "cut.mcap is truncated: station info tells what is missing" in err
    assert (tmp_path / "x.csv").read_text().startswith("time [s],alpha_vane [rad]")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("diagnose a b --hold-out c d --json -", "diagnose a b --hold-out c --hold-out d --json -"),
        ("diagnose a --hold-out c --hold-out d", "diagnose a --hold-out c --hold-out d"),
        ("identify x.mcap --method I split --to 3", "identify x.mcap --method I --method split --to 3"),
        ("identify --method I II x.mcap", "identify --method I --method II x.mcap"),
        ("identify x.mcap --method", "identify x.mcap --method"),
        ("replay --method I II", "replay --method I II"),
        ("", ""),
    ],
)
def test_options_that_take_several_words(words, expected):
    assert spread(words.split()) == expected.split()


def test_streams_that_a_flown_recording_lacks_are_not_waited_for(capsys):
    rig = load_card("bench").rig
    absent = {"v_north", "v_east", "v_down", "latitude", "longitude", "altitude", "beta_vane"}
    kept = streams_flown(rig, Emulated(absent=frozenset(absent)))
    lacking = {s.name for s in rig.streams()} - {s.name for s in kept}
    assert lacking == {"autopilot.velocity", "autopilot.position"}  # the vanes still send the other angle
    assert "autopilot.velocity, autopilot.position" in capsys.readouterr().err
    assert streams_flown(rig, Emulated()) == tuple(rig.streams())


@contextmanager
def unread(monkeypatch):
    """Standard output goes into a pipe that nobody reads any more."""
    reader, writer = os.pipe()
    os.close(reader)
    with suppress(BrokenPipeError), open(writer, "w") as pipe, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", pipe)
        yield


def test_a_reader_that_has_enough_is_no_error_to_talk_about(log, monkeypatch, capsys):
    for words in (["info", str(log)], ["info", str(log), "--json"], ["identify", "--help"]):
        monkeypatch.setattr(sys, "argv", ["station", *words])
        with unread(monkeypatch), pytest.raises(SystemExit) as leaving:
            main()
        assert leaving.value.code == 1
    assert capsys.readouterr().err == ""


def test_a_flight_goes_on_when_nobody_reads_its_lines(monkeypatch, capsys):
    with unread(monkeypatch):
        write = line_writer()
        write("one")
        write("two")
    err = capsys.readouterr().err
    assert err.count("nobody reads standard output any more") == 1


def test_a_terminal_without_greek_letters_gets_the_numbers(log, monkeypatch):
    shown = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", shown)
    monkeypatch.setattr(sys, "argv", ["station", "identify", str(log), "--method", "II"])
    with pytest.raises(SystemExit):
        main()
    text = shown.buffer.getvalue().decode("ascii")
    assert "Estimate ? 2 standard errors" in text


def test_compiled_code_finds_a_place_without_a_home(tmp_path):
    environment = {k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    words = [sys.executable, "-c", "import station, os; print(os.environ['NUMBA_CACHE_DIR'])"]
    environment |= {"HOME": "/dev/null", "TMPDIR": str(tmp_path), "PYTHONPATH": str(Path(__file__).parents[2])}
    told = subprocess.run(words, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert told.startswith(str(tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == [f"flight-test-station-{os.getuid()}"]
