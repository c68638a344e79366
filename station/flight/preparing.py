"""What of a flight is compiled, made ready beside it: the station records from the first second on.

Compiling takes most of a minute after an update and leaves the compiler's memory in the process that did it. So the
first flight of a card has it done by processes of their own, `python -m station.flight.preparing CARD PART AIRCRAFT`,
at a lower priority, and loads the kernels from the cache. When a part is there, an event on the bus says so, and the
loop lets it join at the tick that the event comes with: a replay does the same.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from station.clock import Clock
from station.conventions import Stream
from station.flight.alignment import Aligner
from station.flight.loop import ESTIMATORS, FRAMES, Chain
from station.profile import Aircraft, Profiles, load_card
from station.rows import Code, Event, Rows

NICE: Final = 10
NICE_FRAMES: Final = 5
"""Frames are the smaller part, and wanted first."""
GIVEN_UP_S: Final = 1.0
"""In so long what is not amid a kernel is given up."""
SETTLE_S: Final = 0.3
"""The first rows are to be recorded and shown before anything else wants the processor."""


class Preparation:
    """Makes frames and estimators ready in a thread of its own; `chain` is for when the ESTIMATORS are READY."""

    def __init__(
        self, card: str, profiles: Profiles, streams: Iterable[Stream], clock: Clock, put: Callable[[Rows], None]
    ) -> None:
        """Says at once what is being prepared: to be made before any device puts a row. `card`: its name or path."""
        self._card, self._profiles, self._streams = card, profiles, tuple(streams)
        self._clock, self._put = clock, put
        self._chain: Chain | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="preparation", daemon=True)
        for part in (FRAMES, ESTIMATORS):
            self._say(part, Code.PREPARING, f"the {part} are being prepared; what the devices send is recorded")

    def start(self) -> None:
        self._thread.start()

    def stop(self, say: Callable[[str], None] = lambda _: None) -> None:
        """Give up what is not ready yet; a kernel that is being compiled is compiled to its end, which is said."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(GIVEN_UP_S)
        if self._thread.is_alive():
            say("ending the compilation that has begun, for the next flight; the recording is closed")
            self._thread.join()

    def is_under_way(self) -> bool:
        """Whether the estimators are still to join."""
        return self._chain is None

    def chain(self) -> Chain:
        assert self._chain is not None
        return self._chain

    def _run(self) -> None:
        # Collecting garbage amid a hundred thousand new objects stops the loop for several ticks.
        gc.disable()
        children_fly_behind()
        try:
            self._prepare()
        except Exception as error:
            why = f"could not be prepared: {type(error).__name__}: {error}; the recording goes on without them"
            self._say(ESTIMATORS, Code.ESTIMATOR, why)
        finally:
            gc.freeze()
            gc.enable()

    def _prepare(self) -> None:
        if self._stopping.wait(SETTLE_S):
            return
        profiles = self._profiles
        done = _mark(self._card, profiles.aircraft)
        children = {} if done.exists() else {part: self._compiling(part) for part in (FRAMES, "signals", "physical")}
        try:
            if not self._has_ended(children.get(FRAMES)):
                return
            Aligner(self._streams, profiles.rig.noise_si(), further=profiles.rig.further).begin()
            self._say(FRAMES, Code.READY, "frames begin")
            if not all(self._has_ended(child) for child in children.values()):
                return
        finally:
            for child in children.values():
                child.kill()
                child.wait()
        if all(child.returncode == 0 for child in children.values()):
            with contextlib.suppress(OSError):
                done.touch()
        from station.flight.chain import chain, undone

        self._chain = chain(profiles.aircraft, profiles.card, profiles.rig)
        words = undone(profiles.aircraft, self._chain.correct)
        self._say(ESTIMATORS, Code.READY, "estimates begin" + (f"; {words}" if words else ""))

    def _compiling(self, part: str) -> subprocess.Popen[bytes]:
        """A process that fills the cache with a part's kernels; where it fails, this one compiles them."""
        aircraft = self._profiles.card.aircraft
        words = [sys.executable, "-m", "station.flight.preparing", self._card, part, aircraft]
        quiet = subprocess.DEVNULL
        return subprocess.Popen(words, stdin=quiet, stdout=quiet, stderr=quiet)

    def _has_ended(self, child: subprocess.Popen[bytes] | None) -> bool:
        """Wait for a process; False where this preparation is to stop."""
        while child is not None and child.poll() is None:
            if self._stopping.wait(0.05):
                return False
        return not self._stopping.is_set()

    def _say(self, part: str, code: Code, detail: str) -> None:
        self._put(Event(self._clock.now_ns(), part, code, 1, detail))


def children_fly_behind() -> None:
    """What this thread starts has an ordinary priority, also where the station flies at a real-time one (`chrt`), which
    is handed down and which niceness does not lower: three compilers on two cores kept the loop waiting for 0.6 s."""
    with contextlib.suppress(AttributeError, OSError):
        policy = os.sched_getscheduler(0)
        if policy in (os.SCHED_RR, os.SCHED_FIFO):
            os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))


def _mark(card: str, aircraft: Aircraft) -> Path:
    """The file that says that a flight of this card has filled the cache; an aircraft whose instrument errors are
    undone needs more kernels than one without."""
    more = "-corrected" if aircraft.instruments or aircraft.bends else ""
    return Path(os.environ["NUMBA_CACHE_DIR"]) / f"compiled-{card.replace(os.sep, '-')[-100:]}{more}"


def compile_part(card: str, part: str, aircraft: str) -> None:
    """Fill the cache with the kernels of a part: FRAMES, "signals" or "physical". `aircraft`: name or path, as the card
    that is flown has it."""
    os.nice(NICE_FRAMES if part == FRAMES else NICE)
    gc.set_threshold(100_000, *gc.get_threshold()[1:])  # compiling makes objects that last: a tenth of its time
    profiles = load_card(card, {"aircraft": aircraft})
    if part == FRAMES:
        Aligner(profiles.rig.streams(), profiles.rig.noise_si(), further=profiles.rig.further).begin()
        return
    from station.flight.chain import compile_kernels

    compile_kernels(profiles, part)


if __name__ == "__main__":
    compile_part(*sys.argv[1:])
