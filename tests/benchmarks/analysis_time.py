"""How long an analysis takes: three manoeuvres of 60 s at 50 Hz diagnosed, one of them identified by every method.

    uv run python tests/benchmarks/analysis_time.py [--cases 4] [--seed 1]

Wall and processor seconds of whole commands, as a user runs them, of flights of tests/second_simulation: calm and in
gusts, with nothing hidden and with one thing. A first run compiles kernels and is not counted.
"""

from __future__ import annotations

import argparse
import gzip
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from tests.second_simulation.flights import diagnose_cases, write

SECONDS, RATE_HZ = 60.0, 50.0
HIDDEN = ((), ("alpha_vane.delay",), (), ("q.scale",))
"""Of the cases, in turn."""
SIGMA = (0.0, 1.5)
"""m/s, in turn."""


def timed(*words: str | Path) -> tuple[float, float]:
    """Wall and processor seconds of a command of the station."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "station", *words], capture_output=True, text=True)
    assert done.returncode in (0, 3), done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - start, cpu


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    found: dict[str, list[tuple[float, float]]] = {"diagnose": [], "identify": []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i in range(given.cases):
            names, sigma = HIDDEN[i % len(HIDDEN)], SIGMA[i % len(SIGMA)]
            cases = diagnose_cases(given.seed, 10 * i, names, sigma)
            write([replace(c, seconds=SECONDS, rate=RATE_HZ, thrust_recorded=True) for c in cases], folder)
            logs = []
            for case in cases:
                text = folder / f"{case.name}.csv"
                text.write_bytes(gzip.decompress((folder / f"{case.name}.csv.gz").read_bytes()))
                logs.append(folder / f"{case.name}.mcap")
                timed("import", text, "-o", logs[-1], "--aircraft", "twin_otter")
            jobs = {"diagnose": (*logs[:2], "--hold-out", logs[2]), "identify": (logs[0],)}
            for verb, words in jobs.items():
                if not i:
                    timed(verb, *words, "--json", folder / "warm.json")
                found[verb].append(timed(verb, *words, "--json", folder / "out.json"))
    for verb, times in found.items():
        wall, cpu = zip(*times, strict=True)
        print(
            f"{verb:9s} wall {min(wall):5.1f} {statistics.median(wall):5.1f} {max(wall):5.1f} s (least, median, most);"
        )
        print(f"{'':9s} cpu  {min(cpu):5.1f} {statistics.median(cpu):5.1f} {max(cpu):5.1f} s")


if __name__ == "__main__":
    main()
