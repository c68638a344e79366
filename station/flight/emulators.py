"""The emulated devices of a flight: a process of its own beside the station."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any, Final

from station.clock import Clock
from station.console import say
from station.conventions import Stream
from station.flight.bus import Bus
from station.profile import LOOP_HZ, Order, Rig
from station.rows import Code, DeviceError, Event, StationError

_LOOK_S: Final = 0.5
Orders = SimpleQueue[Sequence[Order]]
Serve = Callable[[Callable[[dict[str, Any]], None], threading.Event, Orders], None]
"""Serves the devices until the event is set, announces what drivers.emulation.serve says, and flies what is ordered."""
_FORK: Final = multiprocessing.get_context("fork")


@dataclass(frozen=True, slots=True)
class Emulated:
    """What the emulated devices said of themselves."""

    endpoints: Mapping[str, str] = field(default_factory=dict)
    absent: frozenset[str] = frozenset()
    """Signals that the recording they fly lacks."""
    start_ns: int = 0
    """Station time of flight time 0."""
    pipe: Connection | None = None
    loop: dict[str, Any] = field(default_factory=dict)
    """How a loop keeps time, as it says itself: steps, late, worst_late_ms, surface_to_vane_ms."""

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Have the emulated aircraft fly these, too, `start` in station time, s; none to fly what was asked no more.
        Nothing where none is emulated: the pilot flies."""
        if self.pipe is None:
            return
        begun_s = self.start_ns * 1e-9
        with contextlib.suppress(OSError):
            self.pipe.send([m.model_copy(update={"start": m.start - begun_s}) for m in manoeuvres])


def streams_flown(rig: Rig, emulated: Emulated) -> tuple[Stream, ...]:
    """The rig's streams but those that the flown recording has nothing of: nobody is to be alarmed by their silence."""
    streams = tuple(rig.streams())
    lacking = [s.name for s in streams if emulated.absent.issuperset(s.signals)]
    if lacking:
        say(f"not in the recording that is flown: {', '.join(lacking)}")
    return tuple(s for s in streams if s.name not in lacking)


@contextmanager
def emulators(serve: Serve, bus: Bus, clock: Clock) -> Iterator[Emulated]:
    """Run `serve` beside the station. Entered when the flight of the devices begins; what they say in flight becomes
    events. To be entered before this process has threads. Raises StationError for what keeps them from starting."""
    ours, theirs = _FORK.Pipe()
    child = _FORK.Process(target=_served, args=(serve, ours, theirs), name="emulators")
    child.start()
    theirs.close()
    listener: threading.Thread | None = None
    try:
        emulated = _started(ours, child)
        listener = threading.Thread(target=_hear, args=(ours, bus, clock, emulated.loop), name="emulators", daemon=True)
        listener.start()
        yield emulated
    finally:
        child.terminate()
        child.join(5)
        if child.is_alive() and child.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.join()
        child.close()
        if listener is not None:
            listener.join(timeout=5)
        ours.close()


def _served(serve: Serve, foreign: Connection, pipe: Connection) -> None:
    """The devices' process: ends when the station's end of the pipe closes, however it closes."""
    foreign.close()
    # Standard output is the station's, for what was asked of it: a library's stray line must not stand amid JSON.
    os.dup2(2, 1)
    os.setsid()  # Ctrl-C is for the station, which then ends the devices
    stop, orders = threading.Event(), Orders()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())

    def obey_to_the_end() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                orders.put(pipe.recv())
        stop.set()

    def announce(said: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):
            pipe.send(said)

    def watch(said: dict[str, Any]) -> None:
        announce(said)
        # No thread before the devices' own processes are forked.
        if "start_ns" in said:
            threading.Thread(target=obey_to_the_end, daemon=True).start()

    try:
        serve(watch, stop, orders)
    except StationError as error:
        announce({"refused": error})


def _started(pipe: Connection, child: BaseProcess) -> Emulated:
    """Waits for as long as the devices' process lives: a first start compiles, on a busy machine for minutes."""
    endpoints: dict[str, str] = {}
    while True:
        try:
            if not pipe.poll(_LOOK_S):
                if child.is_alive() or pipe.poll():
                    continue
                break
            said = pipe.recv()
        except (EOFError, OSError):
            break
        if "preparing" in said:
            say(f"waiting for the emulated devices: {said['preparing']}, {said['seconds']} s so far; Ctrl-C gives up")
        if "refused" in said:
            raise said["refused"]
        if "device" in said:
            endpoints[said["device"]] = said["endpoint"]
        if "start_ns" in said:
            return Emulated(endpoints, frozenset(said["absent"]), said["start_ns"], pipe)
    child.join(_LOOK_S)
    how = "" if child.exitcode is None else f" (exit status {child.exitcode})"
    raise DeviceError(f"the emulated devices ended before they had started{how}\nsee: station emulate")


def _hear(pipe: Connection, bus: Bus, clock: Clock, loop: dict[str, Any]) -> None:
    """The emulators' words in flight, until they end; what they say of a loop goes into `loop`."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            said = pipe.recv()
            now = clock.now_ns()
            if "end_s" in said:
                bus.put(Event(now, "emulator", Code.STOP, 1, "the recording is flown: the devices fall silent"))
            elif "event" in said:
                bus.put(Event(now, said["source"], Code(said["event"]), 1, said["detail"]))
            elif "loop" in said:
                loop.update(said["loop"])
            elif "error" in said:
                bus.put(Event(now, "emulator", Code.DISCONNECT, 1, f"{said['process']}: {said['error']}"))


def loop_words(loop: Mapping[str, Any]) -> list[str]:
    """How a loop has kept time; nothing where there was none."""
    if "steps" not in loop:
        return []
    late = f"{loop['late']} late, by {loop['worst_late_ms']:.1f} ms at most" if loop["late"] else "none late"
    words = [f"loop: {loop['steps']} steps at {LOOP_HZ} Hz, {late}"]
    if ms := loop.get("surface_to_vane_ms"):
        words.append(
            f"surface in to vane out: {ms['p50']:.1f} ms (median), {ms['p99']:.1f} ms (p99), {ms['worst']:.1f} ms "
            f"(worst), jitter {ms['jitter']:.1f} ms, {ms['values']} values"
        )
    return words
