"""What of a flight is compiled, made ready beside it: the station records from the first second on.

Compiling takes most of a minute after an update and leaves the compiler's memory in the process that did it. So a
flight loads its kernels from the cache, and at the first that the cache lacks, for whatever card or aircraft, has them
compiled by processes of their own, `python -m station.flight.preparing CARD PART AIRCRAFT`, at a lower priority. When a
part is there, an event on the bus says so, and the loop lets it join at the tick that the event comes with: a replay
does the same.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Final

from station.clock import Clock
from station.conventions import Stream
from station.flight.alignment import Aligner
from station.flight.loop import ESTIMATORS, FRAMES, Chain
from station.profile import Profiles, load_card
from station.rows import Code, Event, Rows

NICE: Final = 10
NICE_FRAMES: Final = 5
"""Frames are the smaller part, and wanted first."""
PARTS: Final = (FRAMES, "signals", "physical")
"""Of what is compiled, a process each."""
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
        children: dict[str, subprocess.Popen[bytes]] = {}
        try:
            for part, make in ((FRAMES, self._frames), (ESTIMATORS, self._estimators)):
                words = self._loaded(make) if not children else None
                if words is None:
                    children = children or {p: self._compiling(p) for p in PARTS if p != FRAMES or part == FRAMES}
                    awaited = [children[FRAMES]] if part == FRAMES else list(children.values())
                    if not all(self._has_ended(child) for child in awaited):
                        return
                    words = make()
                self._say(part, Code.READY, words)
        finally:
            for child in children.values():
                child.kill()
                child.wait()

    @staticmethod
    def _loaded(make: Callable[[], str]) -> str | None:
        """What is made of compiled kernels; None where one of them would have to be compiled."""
        try:
            with refusing_to_compile():
                return make()
        except NotCompiled:
            return None

    def _frames(self) -> str:
        rig = self._profiles.rig
        Aligner(self._streams, rig.noise_si(), further=rig.further).begin()
        return "frames begin"

    def _estimators(self) -> str:
        from station.flight.chain import chain, undone

        profiles = self._profiles
        made = chain(profiles.aircraft, profiles.card, profiles.rig)
        words = undone(profiles.aircraft, made.correct)
        self._chain = made
        return "estimates begin" + (f"; {words}" if words else "")

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


class NotCompiled(Exception):
    """A kernel is not in the cache."""


@contextmanager
def refusing_to_compile() -> Iterator[None]:
    """In this thread kernels are loaded from the cache; one that it lacks raises NotCompiled."""
    from numba.core.event import Listener, install_listener  # not before the first bytes are recorded

    thread = threading.get_ident()

    class Refusal(Listener):
        def on_start(self, event: Any) -> None:
            if threading.get_ident() == thread:
                raise NotCompiled(str(event.data["dispatcher"]))

        def on_end(self, event: Any) -> None:
            """Nothing: what began was refused."""

    with install_listener("numba:compile", Refusal()):
        yield


def compile_part(card: str, part: str, aircraft: str) -> None:
    """Fill the cache with the kernels of one of PARTS. `aircraft`: name or path, as the card
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
