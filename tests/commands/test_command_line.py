"""The command line as a user meets it: exit codes of logs/README.md, errors of one to three lines, JSON on stdout."""

import json
import os
import re
import signal
import subprocess
import sys

import msgspec
import numpy as np
import psutil
import pytest

from station.__main__ import VERBS, main
from station.conventions import TICK_NS
from station.log import metadata, read_rows, write_log
from station.profile import profiles_dir
from station.rows import AlphaEstimate, Code, Event, Sample, Tick


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A short recording of the simulation."""
    path = tmp_path_factory.mktemp("logs") / "flight.mcap"
    argv, sys.argv = sys.argv, ["station", "simulate", "bench", "-o", str(path), "--duration", "30", "--seed", "3"]
    try:
        with pytest.raises(SystemExit) as leaving:
            main()
    finally:
        sys.argv = argv
    assert leaving.value.code == 0
    return path


def test_version_and_help(station):
    assert station("--version")[:2] == (0, "0.1.0\n")
    code, out, _ = station("--help")
    assert code == 0
    for verb in VERBS:
        assert f"  {verb} " in out
        assert station(verb, "--help")[0] == 0


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("station re", {"replay", "recover"}),
        ("station run be", {"bench"}),
        ("station diagnose a.mcap --aircraft twin_", {"twin_otter", "twin_otter_martos"}),
        ("station identify a.mcap --method split", {"split", "split+gust"}),
        ("station campaign chapter5", {"chapter5"}),
        ("station export a.mcap --to pa", {"parquet"}),
    ],
)
def test_a_shell_completes_verbs_and_names(words, offered):
    """As bash asks, by the environment."""
    asked = {"_STATION_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = subprocess.run(
        [sys.executable, "-m", "station"], env={**os.environ, **asked}, capture_output=True, text=True, check=False
    )
    assert set(done.stdout.split()) == offered, done.stderr


def test_help_brings_in_nothing_heavy():
    """A verb's libraries are imported when it is called: numpy alone takes as long as the rest of --help."""
    code = "import sys; from station.__main__ import VERBS, main; sys.argv = ['station', '--help']\ntry: main()\n"
    code += "except SystemExit: pass\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "typer" in loaded
    assert not loaded & {"numpy", "numba", "scipy", "pydantic", "matplotlib", "rerun", "pyarrow"}


def test_a_flight_begins_without_what_it_needs_later():
    """First bytes within 2 s: nothing that takes seconds to import comes before the devices speak. numba alone may,
    for the level flight that they speak of."""
    code = """
import sys
import station.commands.run as run
from station.profile import load_card
profiles = load_card("bench")
run.guide_of(profiles, run.Board(profiles, run.SystemClock()), None, None, None, auto=False)
print(*sys.modules)
from drivers.emulation import _source
assert _source(profiles, None)._now.advance(1)  # by itself: advance would begin to compile
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    station, devices = (set(line.split()) for line in done.stdout.splitlines()[-2:])
    assert not station & {"numba", "scipy", "rerun", "pymavlink.dialects", "matplotlib", "pyarrow", "cantools"}
    heavy = ("optimize", "signal", "stats", "interpolate", "integrate")
    assert not devices & {"pymavlink.dialects", *(f"scipy.{name}" for name in heavy)}


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (("fly",), 2, "fly"),
        (("diagonse",), 2, "Did you mean 'diagnose'?"),
        (("run", "--duration", "long"), 2, "--duration"),
        (("run", "bensh", "--view", "none"), 2, "did you mean bench?"),
        (("check", "/nowhere/card.toml"), 2, "no such file"),
        (("info", "/nowhere/log.mcap"), 1, "no such file"),
        (("replay", "/nowhere/log.mcap"), 1, "/nowhere/log.mcap"),
        (("identify", "/nowhere/log.mcap"), 1, "/nowhere/log.mcap"),
        (("simulate", "bench", "-o", "/tmp/x.mcap", "--set", "flight.gust_sgma=3"), 2, "did you mean gust_sigma?"),
        (("simulate", "bench", "-o", "/tmp/x.mcap", "--set", "nothing"), 2, "KEY=VALUE"),
        (("simulate", "bench", "-o", "/tmp/x.mcap", "--set", "name.x.y=3"), 2, "no place for name.x.y"),
    ],
)
def test_errors_are_short_and_say_how_to_mend(station, words, code, expected):
    got, out, err = station(*words)
    assert got == code
    assert expected in err
    assert out == ""
    assert len(err.strip().splitlines()) <= 3
    assert "Traceback" not in err


def test_an_unreadable_recording(station, tmp_path):
    path = tmp_path / "noise.mcap"
    path.write_bytes(bytes(range(256)) * 40)
    for verb in (("info", path), ("replay", path), ("recover", path, "-o", tmp_path / "out.mcap")):
        code, _, err = station(*verb)
        assert code == 1
        assert str(path) in err
        assert len(err.strip().splitlines()) <= 3


def test_info_tells_complete_from_truncated(station, flight, tmp_path):
    code, out, _ = station("info", flight, "--json")
    told = json.loads(out)
    assert (code, told["verdict"]) == (0, "complete")
    assert told["duration_s"] == pytest.approx(30.0, abs=0.05)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flight.read_bytes()[:-5000])
    code, out, _ = station("info", cut, "--json")
    assert (code, json.loads(out)["verdict"]) == (3, "truncated")
    code, _, _ = station("recover", cut, "-o", tmp_path / "mended.mcap")
    assert code == 0
    assert station("info", tmp_path / "mended.mcap")[0] == 0


@pytest.mark.parametrize(
    ("missed", "lost", "code", "why"),
    [
        (1, 0, 0, ""),
        (2, 0, 3, "station: degraded: 2 of 1000 ticks missed"),
        (0, 412, 3, "station: degraded: 412 rows lost in flight"),
        (9, 412, 3, "station: degraded: 9 of 1000 ticks missed; 412 rows lost in flight"),
    ],
)
def test_missed_ticks_and_lost_rows_are_in_the_exit_code(station, flight, tmp_path, missed, lost, code, why):
    rows = [Tick(10**9 + k * TICK_NS, k, k * TICK_NS) for k in range(1000) if not 500 <= k < 500 + missed]
    if lost:
        rows.insert(9, Event(rows[9].t_ns, "log", Code.DROPPED, lost, "rows lost"))
    log = tmp_path / "flown.mcap"
    write_log(log, metadata(flight).about, rows)
    found, out, err = station("info", log, "--json")
    assert found == code
    assert (err.splitlines() or [""])[-1] == why
    assert json.loads(out)["degraded"] == (why.removeprefix("station: degraded: ").split("; ") if why else [])


def test_a_flight_without_its_devices_says_so_in_its_last_line(tmp_path):
    rig = (profiles_dir() / "rigs" / "boom_serial.toml").read_text().replace('"emulated"', '"/dev/nowhere"')
    (tmp_path / "rig.toml").write_text(rig)
    (tmp_path / "card.toml").write_text('name = "card"\naircraft = "twin_otter"\nrig = "rig.toml"\n')
    words = ["run", str(tmp_path / "card.toml"), "--view", "none", "--duration", "0.3", "--log", str(tmp_path / "logs")]
    words += ["--forgetting", "45"]  # which the recording holds, for replays to forget alike
    done = subprocess.run([sys.executable, "-m", "station", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    why = done.stderr.splitlines()[-1]
    assert why.startswith("station: degraded: never all streams at once: ")
    assert "boom.vanes" in why
    (log,) = (tmp_path / "logs").glob("*.mcap")
    assert metadata(log).about.card.forgetting == 45
    assert f"after the flight: station identify {log}" in done.stderr, "that short no estimator gets ready"


def test_recordings_are_never_overwritten(station, flight, tmp_path):
    before = flight.read_bytes()
    for words in (("simulate", "bench", "-o", flight), ("recover", flight, "-o", flight)):
        code, _, err = station(*words)
        assert code == 1
        assert "exists" in err
    assert flight.read_bytes() == before


def test_the_same_seed_flies_the_same_flight(station, flight, tmp_path):
    again = tmp_path / "again.mcap"
    assert station("simulate", "bench", "-o", again, "--duration", 30, "--seed", 3)[0] == 0
    assert list(map(repr, read_rows(again))) == list(map(repr, read_rows(flight)))


def test_an_unstable_aircraft_is_told(station, tmp_path):
    text = (profiles_dir() / "aircraft" / "twin_otter.toml").read_text()
    (tmp_path / "tipsy.toml").write_text(text.replace("Cm_alpha = { value = -1.31", "Cm_alpha = { value = 2.0"))
    card = tmp_path / "card.toml"
    card.write_text('name = "card"\naircraft = "tipsy.toml"\nrig = "bench"\nflight.gust_sigma = "3 ft/s"\n')
    code, _, err = station("simulate", card, "-o", tmp_path / "out.mcap", "--duration", 20)
    assert code == 3
    assert "beyond 34 deg of angle of attack from " in err


def test_a_flight_tells_itself_as_json_and_leaves_nothing_behind(station, tmp_path):
    """It records at once, and says that the estimators are being prepared until they join, however long that takes."""
    words = ["run", "--json", "--view", "none", "--log", str(tmp_path)]
    mark = {"STATION_UNDER_TEST": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-m", "station", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | mark,
    ) as flight:  # fmt: skip
        lines = []
        while not lines or lines[-1]["alpha"] is None or not all(x["alive"] for x in lines[-1]["links"].values()):
            lines.append(json.loads(flight.stdout.readline()))
        flight.send_signal(signal.SIGTERM)
        out, err = flight.communicate(timeout=30)
    lines += [json.loads(line) for line in out.splitlines()]
    # On a busy machine ticks are missed, which is no fault of what is tested here.
    why = err.splitlines()[-1]
    assert flight.returncode == 0 or re.fullmatch(r"station: degraded: \d+ of \d+ ticks missed", why), err
    assert {line["schema"] for line in lines} == {"station.run/1"}
    assert (lines[0]["estimators"], lines[-1]["estimators"]) == ("preparing", "ready")
    assert {line["estimators"] for line in lines if line["alpha"]} == {"ready"}
    assert not [p for p in psutil.process_iter(["environ"]) if mark.items() <= (p.info["environ"] or {}).items()]
    (log,) = tmp_path.glob("*.mcap")
    altered = tmp_path / "altered.mcap"
    rows = list(read_rows(log))
    first = {kind: next(i for i, row in enumerate(rows) if type(row) is kind) for kind in (Sample, AlphaEstimate)}
    ready = [i for i, row in enumerate(rows) if isinstance(row, Event) and row.code is Code.READY]
    assert first[Sample] < ready[0] < ready[1] < first[AlphaEstimate]
    k = next(i for i, row in enumerate(rows) if isinstance(row, AlphaEstimate) and i > len(rows) // 2)
    rows[k] = msgspec.structs.replace(rows[k], vane=np.nextafter(rows[k].vane, 1.0))
    write_log(altered, metadata(log).about, rows)
    assert station("replay", "--verify", log)[0] == 0
    code, out, _ = station("replay", "--verify", altered)
    assert code == 1
    assert "1 different" in out


def test_a_method_s_row_says_what_its_json_says(station, tmp_path):
    log = tmp_path / "calm.mcap"
    assert station("simulate", "bench", "-o", log, "--duration", 60, "--set", "flight.gust_sigma=0 m/s")[0] == 0
    code, out, _ = station("identify", log, "--from", 20, "--method", "I,II,split", "--json", "-")
    assert code == 0
    told = json.loads(out)
    assert told["schema"] == "station.identify/1"
    _, table, _ = station("identify", log, "--from", 20, "--method", "II,split", "--method", "I")
    rows = {line.split()[0]: re.findall(r"(-?[\d.]+)±([\d.]+)", line) for line in table.splitlines() if "±" in line}
    for method in ("I", "II", "split"):
        parameters = told["methods"][method]["parameters"].values()
        assert len(rows[method]) == len(parameters) == 6
        for (value, twice), p in zip(rows[method], parameters, strict=True):
            # Printed to two digits of the error.
            assert float(value) == pytest.approx(p["estimate"], abs=0.06 * float(twice))
            assert float(twice) == pytest.approx(2 * p["std_error"], rel=0.06)


def test_a_simulation_is_not_replayed(station, flight):
    code, _, err = station("replay", flight)
    assert code == 2
    assert "station identify" in err
