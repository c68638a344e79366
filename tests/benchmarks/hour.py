"""How long an hour's bench recording takes to be opened, identified and exported, and in how much memory.

    uv run python tests/benchmarks/hour.py [--flight LOG] [--only WORD]

Run by hand; prints, asserts nothing. The bench is flown for two minutes; its last 60 s, repeated with their clocks
moved on, are the hour, with a test point a minute. Each command is a process of its own: seconds since its start, of
processor time (which others on the machine do not lengthen), and its largest resident memory.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from station.log import metadata, read_rows, write_log
from station.rows import Code, Event, Frame, Row, Sample, Tick

PERIOD_S = 60
PERIOD_NS = PERIOD_S * 10**9
TICKS = PERIOD_S * 50
POINT_S = (5, 55)
"""Of the minute."""
POINT_CODES = (Code.POINT_START, Code.POINT_END)
HOUR = 60


def bench(folder: Path) -> Path:
    words = [sys.executable, "-m", "station", "run", "bench", "--view", "none", "--duration", "120", "--log", folder]
    if (done := subprocess.run(words, capture_output=True)).returncode not in (0, 3):  # 3: ticks missed, busy machine
        raise SystemExit(done.stderr.decode())
    (log,) = folder.glob("*.mcap")
    return log


def hour(flight: Path, minutes: int) -> Iterator[Any]:
    """The rows of the last period, moved on minute by minute."""
    rows = [r for r in read_rows(flight) if not (isinstance(r, Event) and r.code.startswith("POINT"))]
    frames = [r.t_ns for r in rows if isinstance(r, Frame)]
    begin = frames[-1] - PERIOD_NS
    first = next(i for i, r in enumerate(rows) if isinstance(r, Frame) and r.t_ns > begin)
    last = next(i for i in range(len(rows) - 1, -1, -1) if isinstance(rows[i], Frame)) + 1
    piece = rows[first:last]
    counts: dict[str, int] = {}
    for row in piece:
        if isinstance(row, Sample):
            counts[row.stream] = counts.get(row.stream, 0) + 1
    for minute in range(minutes):
        on = minute * PERIOD_NS
        marks = [(begin + on + s * 10**9, code) for s, code in zip(POINT_S, POINT_CODES, strict=True)]
        for row in piece:
            while marks and row.t_ns + on >= marks[0][0]:
                yield Event(*(marks[0][0], "operator", marks[0][1], minute + 1, ""))
                del marks[0]
            yield moved(row, on, minute, counts)


def moved(row: Any, on: int, minute: int, counts: dict[str, int]) -> Row:
    more: dict[str, Any] = {"t_ns": row.t_ns + on}
    if isinstance(row, Sample):
        if row.t_device_ns is not None:
            more["t_device_ns"] = row.t_device_ns + on
        if row.seq is not None:
            more["seq"] = row.seq + minute * counts[row.stream]
    elif isinstance(row, Tick):
        more |= {"k": row.k + minute * TICKS, "frame_t_ns": row.frame_t_ns + on}
    elif isinstance(row, Frame):
        more["k"] = row.k + minute * TICKS
    return msgspec.structs.replace(row, **more)


def measured(words: list[str], folder: Path) -> tuple[float, float, float, int]:
    """Seconds, those of processor time, MiB and exit code of a command."""
    began = time.monotonic()
    with (folder / "told").open("w") as told:
        child = subprocess.Popen([sys.executable, "-m", "station", *words], stdout=told, stderr=told)
        _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    return time.monotonic() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, child.returncode


def commands(log: Path, folder: Path) -> list[tuple[str, list[str]]]:
    made = [
        ("info", ["info", str(log)]),
        ("identify --point 30", ["identify", str(log), "--point", "30"]),
    ]
    formats = ("csv", "parquet", "mat", "mdf4", "ulog", "tlog", "mcap", "rrd")
    return made + [
        (f"export {form}", ["export", str(log), "--to", form, "-o", f"{folder}/{form}/out.{form}"]) for form in formats
    ]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--flight", type=Path, help="a bench recording of more than 70 s; flown if left out")
    options.add_argument("--hour", type=Path, help="where the hour is kept, or is already")
    options.add_argument("--minutes", type=int, default=HOUR)
    options.add_argument("--only", default="", help="commands whose name has this word")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = chosen.hour or folder / "hour.mcap"
        if not log.exists():
            flight = chosen.flight or bench(folder / "bench")
            write_log(log, metadata(flight).about, hour(flight, chosen.minutes))
        size = log.stat().st_size
        print(f"{chosen.minutes} min, {size / 2**20:.0f} MiB, {len(os.sched_getaffinity(0))} cores")
        print(f"{'':24}{'s':>8}{'cpu s':>8}{'MiB':>8}", flush=True)
        measured(["identify", str(log), "--point", "1"], folder)  # compiles the numerics where they are not yet
        for title, words in commands(log, folder):
            if chosen.only in title:
                seconds, busy, memory, code = measured(words, folder)
                end = "" if code in (0, 3) else f"  exit {code}: {(folder / 'told').read_text().strip()[-200:]}"
                print(f"{title:24}{seconds:8.1f}{busy:8.1f}{memory:8.0f}{end}", flush=True)


if __name__ == "__main__":
    main()
