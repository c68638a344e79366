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

MIB = 2**20
SETTLED_S = 600.0
"""Before, buffers fill and code is compiled."""
BUSY = "import os\nos.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))\nwhile True: pass"
"""A process that wants a core, at the priority of any other."""


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
    print(*told, sep="\n")
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
