"""Long work shows a bar with the time left on a terminal, nothing elsewhere; after Ctrl-C nothing is half-written."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from station.conventions import SIGNALS, TICK_NS, Stream
from station.log import About, span_ns, write_log
from station.profile import load_aircraft
from station.rows import Frame, Sample

ABOUT = About(load_aircraft("twin_otter"), (Stream("box.vanes", ("alpha_vane", "beta_vane"), 50.0, 0.2),))
FRAMES = 20_000
"""So many that an export still runs when its bar has been seen, on a busy machine too."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "flight.mcap"
    n = len(SIGNALS)
    rows = [
        row
        for k in range(FRAMES)
        for row in (
            Sample(k * TICK_NS, "box.vanes", None, k, (0.1, 0.2)),
            Frame(k * TICK_NS, k, (0.1,) * n, (0.0,) * n, (0,) * n),
        )
    ]
    write_log(path, ABOUT, rows)
    return path


def interruptible() -> None:
    """As a terminal starts a program: a shell starts those in the background with the interrupt ignored, which all that
    they start inherit."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def on_a_terminal(words: list[str], stop_at: str = "") -> tuple[int, str]:
    """Exit code and what a terminal was sent; interrupted when that holds `stop_at`."""
    here, there = pty.openpty()
    kept = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR")}
    child = subprocess.Popen(
        [sys.executable, "-m", "station", *words], stdout=there, stderr=there, stdin=there,
        env={**kept, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"}, start_new_session=True,
        preexec_fn=interruptible,
    )  # fmt: skip
    os.close(there)
    limit = threading.Timer(300.0, child.kill)
    limit.start()
    told, stopped = b"", False
    while True:
        try:
            piece = os.read(here, 4096)
        except OSError:
            break
        if not piece:
            break
        told += piece
        if stop_at and not stopped and stop_at.encode() in told:
            stopped = True
            child.send_signal(signal.SIGINT)
    code = child.wait()
    limit.cancel()
    os.close(here)
    return code, told.decode(errors="replace")


def test_on_a_terminal_there_is_a_bar_with_the_time_left(log: Path, tmp_path: Path) -> None:
    code, told = on_a_terminal(["export", str(log), "--to", "csv", "-o", str(tmp_path / "a.csv")])
    assert code == 0
    assert "exporting flight.mcap" in told
    assert re.search(r"\d:\d\d:\d\d|-:--:--", told)
    assert len((tmp_path / "a.csv").read_text().splitlines()) == FRAMES + 1


def test_an_import_shows_that_it_reads_then_how_much_is_written(tmp_path: Path) -> None:
    source, out = tmp_path / "a.csv", tmp_path / "a.mcap"
    source.write_text("time [s],q [deg/s]\n" + "".join(f"{0.02 * k:.2f},{k % 7}\n" for k in range(FRAMES)))
    words = ["import", str(source), "-o", str(out), "--aircraft", "twin_otter"]
    code, told = on_a_terminal(words)
    assert code == 0
    assert "importing a.csv" in told
    assert re.search(r"importing a\.csv: writing .*\d:\d\d:\d\d", told)
    out.unlink()
    code, told = on_a_terminal(words, "importing")
    assert code == 130
    assert "stopped: nothing was left half-written" in told
    assert list(tmp_path.iterdir()) == [source]


def test_elsewhere_there_is_none(log: Path, tmp_path: Path, station) -> None:
    code, out, err = station("export", log, "--to", "csv", "-o", tmp_path / "a.csv")
    assert (code, out) == (0, "")
    assert err.splitlines() == [str(tmp_path / "a.csv"), str(tmp_path / "a.box.vanes.csv")]


def test_ctrl_c_says_that_nothing_was_left_and_leaves_nothing(log: Path, tmp_path: Path) -> None:
    code, told = on_a_terminal(["export", str(log), "--to", "mcap", "-o", str(tmp_path / "a.mcap")], "exporting")
    assert code == 130
    assert "stopped: nothing was left half-written" in told
    assert list(tmp_path.iterdir()) == []


def test_a_diagnosis_shows_its_steps_and_about_how_long_is_left(tmp_path: Path) -> None:
    """And after Ctrl-C neither profile nor JSON is there."""
    flight, profile, out = tmp_path / "flight.mcap", tmp_path / "new.toml", tmp_path / "a.json"
    assert (
        subprocess.run(
            [sys.executable, "-m", "station", "simulate", "bench", "-o", str(flight), "--duration", "60"]
        ).returncode
        == 0
    )
    words = ["diagnose", str(flight), "--write-profile", str(profile), "--json", str(out)]
    code, told = on_a_terminal(words, "s left")
    assert code == 130
    assert "diagnosing flight.mcap" in told
    assert re.search(r"about \d+ s left", told)
    assert "stopped: nothing was left half-written" in told
    assert list(tmp_path.iterdir()) == [flight]


def test_the_span_is_that_of_the_rows_and_unknown_of_a_file_that_was_cut(log: Path, tmp_path: Path) -> None:
    assert span_ns(log) == (0, (FRAMES - 1) * TICK_NS)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:-100])
    assert span_ns(cut) is None
