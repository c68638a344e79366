"""However a flight is ended, it ends cleanly: a complete recording, the right exit code, no process left."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from station.convert import import_file
from station.log import summarise
from station.profile import load_aircraft
from station.rows import Code

pytestmark = pytest.mark.slow
WORDS = [sys.executable, "-m", "station", "run", "--view", "none", "--log"]


def family(process):
    return psutil.Process(process.pid).children(recursive=True)


def ended(process, group):
    """Exit code and words on stderr, when all of the group are gone."""
    code = process.wait(30)
    left = psutil.wait_procs(group, 10)[1]
    assert not left, left
    return code, process.stderr.read()


@pytest.fixture
def flight(tmp_path):
    """A flight that tells itself as JSON, all its links alive."""
    process = subprocess.Popen(
        [*WORDS, str(tmp_path), "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    links = {}
    while not links or not all(link["alive"] for link in links.values()):
        links = json.loads(process.stdout.readline())["links"]
    yield process
    process.kill()
    process.wait()
    process.stdout.close()
    process.stderr.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_flight_cleanly(flight, tmp_path, number):
    group = family(flight)
    flight.send_signal(number)
    code, words = ended(flight, group)
    assert code == 0, words
    assert "Traceback" not in words
    (log,) = tmp_path.glob("*.mcap")
    assert summarise(log).verdict == "complete"


def test_a_flight_goes_on_when_its_reader_dies(flight, tmp_path):
    group = family(flight)
    flight.stdout.close()
    time.sleep(3.0)
    assert flight.poll() is None
    flight.send_signal(signal.SIGINT)
    code, words = ended(flight, group)
    assert code == 0
    assert words.count("nobody reads standard output") == 1
    (log,) = tmp_path.glob("*.mcap")
    assert summarise(log).duration_s > 4.0


def test_a_killed_station_leaves_no_device_behind(flight, tmp_path):
    group = family(flight)
    flight.kill()
    code, _ = ended(flight, group)
    assert code == -signal.SIGKILL
    (log,) = tmp_path.glob("*.mcap")
    assert summarise(log).verdict == "truncated"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_flight_that_has_not_begun_is_left_at_once(tmp_path, number, code):
    process = subprocess.Popen([*WORDS, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with process:
        assert "card bench" in process.stderr.readline()
        group = family(process)
        process.send_signal(number)
        got, words = ended(process, group)
        assert got == code
        assert "Traceback" not in words


def test_a_flown_recording_neither_waits_for_what_it_lacks_nor_hides_its_end(tmp_path):
    csv, log, card = (tmp_path / name for name in ("short.csv", "short.mcap", "card.toml"))
    steady = {"alpha_vane": 0.05, "airspeed": 56.0, "q": 0.0, "ax": 0.5, "az": -9.8, "theta": 0.05, "elevator": 0.0}
    units = ("rad", "m/s", "rad/s", "m/s2", "m/s2", "rad", "rad")
    lines = [",".join(["time [s]", *(f"{n} [{u}]" for n, u in zip(steady, units, strict=True))])]
    for k in range(200):
        wave = 0.01 * np.sin(0.1 * k * np.arange(1, 8))
        lines.append(",".join(map(repr, [k / 50, *(wave + list(steady.values())).tolist()])))
    csv.write_text("\n".join(lines) + "\n")
    import_file(csv, log, load_aircraft("twin_otter"))
    text = 'name = "again"\naircraft = "twin_otter"\nrig = "bench"\nemulate = true\n'
    text += f'needs = ["alpha_vane"]\n[flight]\nsource = "recording"\nrecording = "{log}"\n'
    card.write_text(text)
    words = [*WORDS[:3], "run", str(card), "--duration", "8", "--view", "none", "--log", str(tmp_path / "logs")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    (flown,) = (tmp_path / "logs").glob("*.mcap")
    events = summarise(flown).events
    (over,) = [e for e in events if e.source == "emulator"]
    assert over.code == Code.STOP
    assert 3.5 < over.t_s < 6.0
    assert not [e for e in events if e.code == Code.STALE and e.t_s < over.t_s]
    lacking = {"can.static", "autopilot.velocity", "autopilot.position"}
    assert not [e for e in events if e.source in lacking]
    assert all(name in done.stderr for name in lacking)
