"""The whole station in real time: tick timing, missed ticks, memory. Run by hand; prints, asserts nothing.

    uv run python tests/benchmarks/live_flight.py --minutes 10
    uv run python tests/benchmarks/live_flight.py --minutes 60 --view none    # a soak: the slope of the memory
    sudo chrt -r 5 uv run python tests/benchmarks/live_flight.py --stress     # before others, and one core kept busy

Emulators and viewer run beside the station. A tick is done when it has been drained, aligned, estimated by all live
methods, logged and handed to the view; counted from its schedule, which is the byte-to-estimate latency beyond the
card's fixed lag.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import psutil

from station.log import read_rows
from station.rows import Code, Event

MIB = 2**20
SETTLED_S = 600.0
"""Before, buffers fill and code is compiled."""
BUSY = "import os\nos.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))\nwhile True: pass"
"""A process that wants a core, at the priority of any other."""

STILL_S = 0.02
"""A tick that comes so late is given up."""
TOLD_S = 0.05
"""A tick that was late, and the one after it, are told within this of what made them so."""
WITNESS = f"""
import os, sys, time
os.sched_setaffinity(0, [int(sys.argv[1])])
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_max(os.SCHED_FIFO)))
due = time.monotonic()
while True:
    due = max(due + 0.005, time.monotonic() - {STILL_S})
    time.sleep(max(0.0, due - time.monotonic()))
    if time.monotonic() - due > {STILL_S}:
        print(round(due, 2), round(time.monotonic() - due, 4), flush=True)
"""
"""A process before all others on a core, which sleeps for 5 ms at a time: where each core's wakes late at one time, the
machine itself stood still, as virtual ones do."""


def still(witnesses: list[list[tuple[float, float]]], missed: list[tuple[float, int]] | None = None) -> str:
    """What witnesses saw, each its core: when they should have woken, and how late they did, s; and how many of the
    ticks `missed`, told at so many seconds, were while a core stood still: nothing on the machine comes before a
    witness, so what keeps it from waking is outside."""
    first, *others = witnesses
    together = [late for due, late in first if all(any(abs(due - d) < 0.1 for d, _ in other) for other in others)]
    often = f"{len(together)} times" if len(together) > 1 else "once"
    words = f"stood still {often}, {max(together) * 1e3:.0f} ms at most" if together else "never stood still"
    spans = [span for seen in witnesses for span in seen]
    then = sum(n for t, n in missed or () if any(due - TOLD_S < t < due + late + TOLD_S for due, late in spans))
    return f"the machine itself {words}" + (f"; ticks missed while a core of it did: {then}" if missed else "")


def missed_ticks(first: Path) -> list[tuple[float, int]]:
    """When ticks were given up, s on the station's clock, which is the witnesses', and how many."""
    events = [row for row in read_rows(first, kinds=[Event]) if isinstance(row, Event)]
    return [(e.t_ns * 1e-9, e.count) for e in events if e.source == "loop" and e.code is Code.OVERRUN]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=10.0)
    options.add_argument("--card", default="bench")
    options.add_argument("--view", default="web")
    options.add_argument("--stress", action="store_true", help="keep one core busy beside it")
    chosen = options.parse_args()
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        if chosen.stress:
            stack.callback(subprocess.Popen([sys.executable, "-c", BUSY]).kill)
        may_watch = os.geteuid() == 0 and hasattr(os, "SCHED_FIFO")
        witnesses = [
            subprocess.Popen([sys.executable, "-c", WITNESS, str(n)], stdout=subprocess.PIPE, text=True)
            for n in range(os.cpu_count() or 1)
            if may_watch
        ]
        for witness in witnesses:
            stack.callback(witness.kill)
        words = ["run", chosen.card, "--duration", str(60 * chosen.minutes), "--view", chosen.view, "--log", folder]
        station = subprocess.Popen(
            [sys.executable, "-m", "station", *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        process, sizes, loads = psutil.Process(station.pid), [], []
        began = time.monotonic()
        while station.poll() is None:
            time.sleep(min(10.0, 6 * chosen.minutes))
            try:
                size = process.memory_info().rss
                if not size:  # ended, and not yet waited for
                    break
                sizes.append((time.monotonic() - began, size / MIB))
                busy = process.cpu_times()
                loads.append(os.getloadavg()[0])
            except psutil.NoSuchProcess:
                break
        assert station.stderr is not None
        told = [line for line in station.stderr.read().splitlines() if line.startswith(("ticks", "recorded"))]
        parts, code = len(list(Path(folder).glob("*.mcap"))), station.wait()
        seen = []
        for witness in witnesses:
            witness.kill()
            lines = [line.split() for line in witness.communicate()[0].splitlines()]
            seen.append([(float(line[0]), float(line[1])) for line in lines if len(line) == 2])
        missed = missed_ticks(min(Path(folder).glob("*.mcap")))
    print(*told, sep="\n")
    if seen:
        print(still(seen, missed))
    before_others = "at real-time priority, " if os.sched_getscheduler(0) in (os.SCHED_RR, os.SCHED_FIFO) else ""
    print(f"{before_others}load {np.mean(loads):.1f} on {os.cpu_count()} cores; files: {parts}; exit code: {code}")
    quarter = len(sizes) // 4
    for t, size in (sizes[quarter], sizes[len(sizes) // 2], sizes[-1]):
        print(f"station memory after {t / 60:.1f} min: {size:.0f} MiB")
    late = np.array([x for x in sizes if x[0] > SETTLED_S])
    if len(late) > SETTLED_S / 10:
        slope = np.polyfit(late[:, 0], late[:, 1], 1)[0] * 3600
        spread = np.ptp(late[:, 1])
        print(f"memory from {SETTLED_S / 60:.0f} min on: {slope:+.2f} MiB/h, extremes {spread:.1f} MiB apart")
    print(f"station processor time: {(busy.user + busy.system) / (time.monotonic() - began):.0%} of one core")


if __name__ == "__main__":
    main()
