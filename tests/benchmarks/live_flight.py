"""The whole station in real time: tick timing, missed ticks, memory. Run by hand; prints, asserts nothing.

    uv run python tests/benchmarks/live_flight.py --minutes 10
    uv run python tests/benchmarks/live_flight.py --minutes 60 --view none    # a soak: the slope of the memory

Emulators and viewer run beside the station. A tick is done when it has been drained, aligned, estimated by all live
methods, logged and handed to the view; counted from its schedule, which is the byte-to-estimate latency beyond the
card's fixed lag.
"""

import argparse
import subprocess
import sys
import tempfile
import time

import numpy as np
import psutil

MIB = 2**20
SETTLED_S = 600.0
"""Before, buffers fill and code is compiled."""


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=10.0)
    options.add_argument("--card", default="bench")
    options.add_argument("--view", default="web")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        words = ["run", chosen.card, "--duration", str(60 * chosen.minutes), "--view", chosen.view, "--log", folder]
        station = subprocess.Popen(
            [sys.executable, "-m", "station", *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        process, sizes = psutil.Process(station.pid), []
        began = time.monotonic()
        while station.poll() is None:
            time.sleep(min(10.0, 6 * chosen.minutes))
            try:
                size = process.memory_info().rss
                if not size:  # ended, and not yet waited for
                    break
                sizes.append((time.monotonic() - began, size / MIB))
                busy = process.cpu_times()
            except psutil.NoSuchProcess:
                break
        assert station.stderr is not None
        told = [line for line in station.stderr.read().splitlines() if line.startswith(("ticks", "recorded"))]
    print(*told, sep="\n")
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
