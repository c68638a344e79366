"""The estimators of a flight, compiled before it.

Compiling takes half a minute after an update and leaves the compiler's memory, 200 MiB, in the process that did it. So
the first flight of a card has it done by a process of its own, `python -m station.flight.chain CARD`, and loads the
kernels from the cache.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from station.conventions import TICK_HZ
from station.estimation.instrument_errors import Corrector, known
from station.estimation.methods import Estimator
from station.flight.alignment import Aligner
from station.model.disagreement import Disagreement
from station.profile import Aircraft, Profiles, load_card


def estimators(profiles: Profiles) -> tuple[Estimator, Disagreement]:
    """What estimates and what watches in a flight; no tick of it has to compile."""
    rig = profiles.rig
    estimator = Estimator(profiles.aircraft, profiles.card, rig.imu_position, rig.frame_noise_si())
    estimator.warm_up()
    watch = Disagreement(profiles.aircraft, rig.imu_position, rig.frame_noise_si())
    watch.warm_up()
    return estimator, watch


def told_of_instruments(aircraft: Aircraft, correct: Corrector | None) -> Iterator[str]:
    """For the operator, what of the profile's instrument errors is undone in this flight, and what it costs."""
    stated = known(aircraft)
    if stated.words:
        late = f"; estimates come {1000 * correct.ahead // TICK_HZ} ms later" if correct and correct.ahead else ""
        count = f"{len(stated.words)} instrument error{'s' if len(stated.words) > 1 else ''}"
        yield f"{aircraft.name} states {count}, undone: {'; '.join(stated.words)}{late}"
    for words in stated.refused:
        yield f"station: {aircraft.name}: an instrument error stays in: {words}"


def compile_apart(card: str) -> None:
    """Fill the cache of kernels where no flight of `card` has; if that fails, the station compiles them itself."""
    done = Path(os.environ["NUMBA_CACHE_DIR"]) / f"compiled-{card.replace(os.sep, '-')[-100:]}"
    if done.exists():
        return
    child = subprocess.run([sys.executable, "-m", "station.flight.chain", card], check=False, capture_output=True)
    if child.returncode == 0:
        with contextlib.suppress(OSError):
            done.touch()


def main(card: str) -> None:
    profiles = load_card(card)
    estimators(profiles)
    Corrector(profiles.aircraft, {})  # whether or not this aircraft needs it
    Aligner(profiles.rig.streams(), profiles.rig.noise_si())


if __name__ == "__main__":
    main(sys.argv[1])
