"""How soon the station records, shows and estimates after its command. Run by hand; prints, asserts nothing.

    uv run python tests/benchmarks/start.py

Cold: the cache of compiled kernels is empty. Warm: the same flight again. Then both where Python may write no bytecode
beside its sources and finds none. Seconds since the command; processor time is that of the station and its devices
until the first estimate. On a machine with more, it is held to two cores.
"""

import argparse
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil

from station.log import read_rows
from station.rows import AlphaEstimate, Code, Event, RawBlock, Tick

CHUNK = 6
"""MCAP's opcode of a chunk: before the first there are the profiles only."""
RECORD = struct.Struct("<BQ")
MAGIC_BYTES = 8
COLUMNS = ("--help", "bytes heard", "recorded", "shown", "frames", "estimates", "CPU s", "ticks missed")


def has_rows(path: Path) -> bool:
    """Whether a chunk of rows has been written."""
    with path.open("rb") as file:
        at = MAGIC_BYTES
        while True:
            file.seek(at)
            head = file.read(RECORD.size)
            if len(head) < RECORD.size:
                return False
            opcode, length = RECORD.unpack(head)
            if opcode == CHUNK:
                return True
            at += RECORD.size + length


def first_recorded_s(folder: Path, began: float) -> float:
    while True:
        if any(has_rows(log) for log in folder.glob("*.mcap")):
            return time.monotonic() - began
        time.sleep(0.005)


def processor_s(pid: int) -> float:
    """Of a process and all its children, ended ones too where their parent lives."""
    total, process = 0.0, psutil.Process(pid)
    for one in (process, *process.children(recursive=True)):
        try:
            times = one.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total += times.user + times.system + times.children_user + times.children_system
    return total


def start(card: str, view: str, environment: dict[str, str]) -> list[float]:
    """One start of the station, ended two seconds after its first estimate; the COLUMNS."""
    station = [sys.executable, "-m", "station"]
    began = time.monotonic()
    subprocess.run([*station, "--help"], check=True, capture_output=True, env=environment)
    found = [time.monotonic() - began]
    with tempfile.TemporaryDirectory() as folder:
        began = time.monotonic()
        words = [*station, "run", card, "--json", "--view", view, "--log", folder]
        flight = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
        recorded: list[float] = []
        watch = threading.Thread(target=lambda: recorded.append(first_recorded_s(Path(folder), began)), daemon=True)
        watch.start()
        shown, cpu = 0.0, 0.0
        assert flight.stdout is not None
        for line in flight.stdout:
            shown = shown or time.monotonic() - began
            told = json.loads(line)
            if told["alpha"] is not None and not cpu:
                cpu = processor_s(flight.pid)
                flight.send_signal(signal.SIGINT)
        flight.wait()
        watch.join(1.0)
        (log,) = Path(folder).glob("*.mcap")
        rows = list(read_rows(log))
    heard = next(r.t_ns for r in rows if isinstance(r, RawBlock))
    frames = next(r.t_ns for r in rows if isinstance(r, Event) and r.code is Code.READY)
    at = next(i for i, r in enumerate(rows) if isinstance(r, AlphaEstimate))
    estimated = [r.t_ns for r in rows[:at] if isinstance(r, Tick)][-1]
    missed = sum(r.count for r in rows if isinstance(r, Event) and r.code is Code.OVERRUN)
    times = [1e-9 * t - began for t in (heard, frames, estimated)]
    return [*found, times[0], *recorded, shown, *times[1:], cpu, missed]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--card", default="bench")
    options.add_argument("--view", default="web")
    chosen = options.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    print(f"{'':24}" + "".join(f"{name:>14}" for name in COLUMNS))
    for bytecode in (True, False):
        with tempfile.TemporaryDirectory() as cache:
            kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "PYTHONDONTWRITE"))}
            environment = {**kept, "XDG_CACHE_HOME": cache}
            if bytecode:
                subprocess.run([sys.executable, "-m", "compileall", "-q", "station", "drivers"], check=True)
            else:
                environment |= {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONPYCACHEPREFIX": f"{cache}/none"}
            for name in ("cold", "warm"):
                found = start(chosen.card, chosen.view, environment)
                words = f"{name}{'' if bytecode else ', no bytecode'}"
                print(f"{words:24}" + "".join(f"{x:14.1f}" for x in found), flush=True)


if __name__ == "__main__":
    main()
