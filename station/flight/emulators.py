"""The emulated devices of a flight: `station emulate CARD` in a process of its own, beside the station."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from station.clock import Clock
from station.console import say
from station.conventions import Stream
from station.flight.bus import Bus
from station.profile import Rig
from station.rows import Code, DeviceError, Event

ENDPOINTS_WITHIN_S = 120.0
"""The first flight on a machine compiles the simulation."""


@dataclass(frozen=True, slots=True)
class Emulated:
    """What the emulated devices said of themselves."""

    endpoints: Mapping[str, str] = field(default_factory=dict)
    absent: frozenset[str] = frozenset()
    """Signals that the recording they fly lacks."""


def streams_flown(rig: Rig, emulated: Emulated) -> tuple[Stream, ...]:
    """The rig's streams but those that the flown recording has nothing of: nobody is to be alarmed by their silence."""
    streams = tuple(rig.streams())
    lacking = [s.name for s in streams if emulated.absent.issuperset(s.signals)]
    if lacking:
        say(f"not in the recording that is flown: {', '.join(lacking)}")
    return tuple(s for s in streams if s.name not in lacking)


@contextmanager
def emulators(card: str, wanted: set[str], bus: Bus, clock: Clock) -> Iterator[Emulated]:
    """Run `station emulate CARD` beside the station. Entered when each device `wanted` is there; what it says in flight
    becomes events. Raises DeviceError."""
    child = subprocess.Popen(
        [sys.executable, "-m", "station", "emulate", card, "--attached"],
        stdin=subprocess.PIPE,  # closes when this process ends, however it ends
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for the station, which then ends the devices
    )
    listener = threading.Thread(target=_hear, args=(child, bus, clock), name="emulators", daemon=True)
    try:
        emulated = _started(child, wanted)
        listener.start()
        yield emulated
    finally:
        child.terminate()
        try:
            child.wait(timeout=5)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        if listener.is_alive():
            listener.join(timeout=5)
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()


def _started(child: subprocess.Popen[str], wanted: set[str]) -> Emulated:
    endpoints: dict[str, str] = {}
    watchdog = threading.Timer(ENDPOINTS_WITHIN_S, child.kill)
    watchdog.start()
    try:
        assert child.stdout is not None
        for line in child.stdout:
            told = json.loads(line)
            if "device" in told:
                endpoints[told["device"]] = told["endpoint"]
            if "start_ns" in told and wanted <= endpoints.keys():
                return Emulated(endpoints, frozenset(told["absent"]))
    finally:
        watchdog.cancel()
    missing = ", ".join(sorted(wanted - endpoints.keys()))
    raise DeviceError(f"the emulated devices did not start: no endpoint for {missing}\nsee: station emulate")


def _hear(child: subprocess.Popen[str], bus: Bus, clock: Clock) -> None:
    """The emulators' words in flight, until they end."""
    assert child.stdout is not None
    with contextlib.suppress(ValueError):  # its last line may be cut
        for line in child.stdout:
            told = json.loads(line)
            now = clock.now_ns()
            if "end_s" in told:
                bus.put(Event(now, "emulator", Code.STOP, 1, "the recording is flown: the devices fall silent"))
            elif "error" in told:
                bus.put(Event(now, "emulator", Code.DISCONNECT, 1, f"{told['process']}: {told['error']}"))
