"""Whether the corrected angle of attack is as right as it says, on flights of programs that share no formula with the
station. Run by hand.

    uv run python tests/benchmarks/true_alpha.py [--second 48] [--seed 1] [--workers 2]

Each flight is imported as a user would and flown through the live estimator with the shipped profile, from which its
aircraft differs as real ones do: upwash, boom, vane, noise; but for the vane's zero, which a rigging board or a calm
flight tells. After the quiet flight the true angle of attack at the CG is held against it wherever it is valid.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from station.convert import import_file
from station.estimation.methods import Estimator
from station.identification.request import DEFAULT_CARD
from station.identification.table_frames import frames
from station.log import table
from station.profile import load_aircraft
from tests.records import record
from tests.second_simulation.flights import identify_case, write

AIRS = (("calm", -1.0, 0.0), ("to 5 ft/s", 0.0, 5.0), ("above 5 ft/s", 5.0, math.inf))


@dataclass(frozen=True, slots=True)
class Flight:
    """Errors and standard deviations, deg, at the recorder's times."""

    sigma_fps: float
    off: np.ndarray
    sd: np.ndarray

    @property
    def held(self) -> float:
        return float(np.mean(np.abs(self.off) < 2 * self.sd))


def flown(job: tuple[Path, str, dict]) -> Flight:
    """One flight through the estimator."""
    folder, name, answers = job
    profile = load_aircraft("twin_otter")
    assert profile.boom is not None
    zero = answers.get("zeros", {}).get("alpha_vane", 0.0)
    profile = profile.model_copy(update={"boom": profile.boom.model_copy(update={"zero": zero})})
    with tempfile.TemporaryDirectory() as made:
        plain, log = Path(made) / f"{name}.csv", Path(made) / f"{name}.mcap"
        plain.write_bytes(gzip.decompress((folder / f"{name}.csv.gz").read_bytes()))
        import_file(plain, log, profile)
        read = table(log)
    estimator = Estimator(profile, DEFAULT_CARD, methods=("split",), recorded_hz=answers["rate_hz"])
    found = [estimator.step(frame)[0] for frame in frames(read)]
    t = np.array([(a.t_ns - read.t0_ns) * 1e-9 for a in found])
    truth = np.load(folder / f"{name}.truth.npz")
    time, alpha = (truth[next(k for k in truth if k.startswith(what))] for what in ("time", "alpha"))
    # Where the truth is known, the recorder's times: between them slow ones know nothing of gusts.
    at = np.clip(np.searchsorted(t, time), 1, len(t) - 1)
    valid = np.array([a.valid for a in found])
    counted = valid[at] & valid[at - 1] & (time > answers["manoeuvre_from_s"]) & (time <= t[-1])
    off = np.interp(time, t, [a.alpha for a in found]) - alpha
    sd = np.interp(time, t, [a.alpha_sd for a in found])
    return Flight(answers["sigma_fps"], np.degrees(off[counted]), np.degrees(sd[counted]))


def row(words: str, air: str, flights: Sequence[Flight]) -> str:
    off, sd = (np.concatenate([getattr(f, name) for f in flights]) for name in ("off", "sd"))
    held = np.array([f.held for f in flights])
    error = held.std() / math.sqrt(len(held))
    return (
        f"| {words} | {air} | {len(flights)} | {100 * np.mean(np.abs(off) < 2 * sd):.1f} ± {100 * error:.1f} % |"
        f" {100 * held.min():.0f} % | {np.sqrt(np.mean(off**2)):.3f} | {np.sqrt(np.mean(sd**2)):.3f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--second", type=int, default=48, help="flights of tests/second_simulation besides")
    parser.add_argument("--seed", type=int, default=1, help="of the second simulation")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    print("| flights | air | flights | within 2 sd | least of a flight | rms error, deg | rms sd, deg |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as made, ProcessPoolExecutor(given.workers) as pool:
        write([identify_case(given.seed, i) for i in range(given.second)], Path(made))
        for words, folder in (("foreign", record("flights/answers.json").parent), ("second simulation", Path(made))):
            answers = json.loads((folder / "answers.json").read_text())
            names = sorted(n for n in answers if n.startswith("identify_"))
            done = list(pool.map(flown, [(folder, n, answers[n]) for n in names]))
            for air, low, high in AIRS:
                chosen = [f for f in done if low < f.sigma_fps <= high and len(f.off)]
                if chosen:
                    print(row(words, air, chosen), flush=True)
            print(row(words, "all", [f for f in done if len(f.off)]), flush=True)


if __name__ == "__main__":
    main()
