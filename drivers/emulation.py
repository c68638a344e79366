"""Emulated devices in real time: one process flies, one process per device speaks its bytes.

The flight process runs the simulation, or plays a recording, a little ahead of real time and hands the truth to the
devices' processes; each paces its own messages onto its own link from an absolute schedule. Every process holds a pipe
whose other end only the serving process has, and ends when that closes, however it closed. Processes are forked: what
they need is imported once, and they speak at once. Until a simulation is compiled they show trimmed level flight.
"""

from __future__ import annotations

import itertools
import multiprocessing
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.emulated_device import flown_signals, heed_signals, serve_device
from drivers.emulated_messages import TRUTH_HZ
from drivers.surface_tap import SurfaceTap
from station.clock import Clock, SystemClock
from station.conventions import ANGLES_THAT_WRAP
from station.profile import EMULATED, AlteredAircraft, Leg, MeasuredLoop, Order, Profiles
from station.rows import DeviceError, StationError

Floats = NDArray[np.float64]
Orders = SimpleQueue[Sequence[Order]]
Recording = Mapping[str, Floats]
"""Signals over time, SI: "time" (n,) s increasing and any of SIGNALS (n,), NaN where missing."""

CHUNK = 20
"""Rows of truth handed over at once: 0.1 s."""
AHEAD_S = 0.45
TELL_EVERY_S = 10.0
_START_DELAY_S = 0.05
_POLL_S = 0.02
_FORK = multiprocessing.get_context("fork")


class Source(Protocol):
    """What is flown: a simulation or a recording."""

    def advance(self, n: int) -> Mapping[str, Floats]:
        """The next n rows at TRUTH_HZ by signal; fewer, then none, at the end."""
        ...

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Fly these, too, `start` in seconds of flight; none to fly what was asked no more."""
        ...


class Playback:
    """A recording as a source: cubic between its rows, missing values bridged, its ends held."""

    def __init__(self, recording: Recording) -> None:
        """Raises DeviceError if there is no usable time."""
        time = np.asarray(recording.get("time", ()), dtype=float)
        if len(time) < 2 or not np.all(np.diff(time) > 0):
            raise DeviceError("the recording cannot be flown: its time is missing or does not increase")
        time = time - time[0]
        self.duration_s = float(time[-1])
        self._rows = int(self.duration_s * TRUTH_HZ + 1e-6) + 1
        self._k = 0
        self._curves = {n: _curve(n, time, np.asarray(v, dtype=float)) for n, v in recording.items() if n != "time"}
        self._curves = {n: curve for n, curve in self._curves.items() if curve is not None}

    @property
    def signals(self) -> frozenset[str]:
        """Those with at least two values."""
        return frozenset(self._curves)

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Nothing: a recording is flown as it is."""

    def advance(self, n: int) -> Mapping[str, Floats]:
        t = np.arange(self._k, min(self._k + n, self._rows)) / TRUTH_HZ
        self._k += len(t)
        return {name: curve(t) for name, curve in self._curves.items() if curve is not None}


def _curve(name: str, time: Floats, values: Floats) -> Callable[[Floats], Floats] | None:
    from scipy.interpolate import CubicHermiteSpline

    known = np.isfinite(values)
    if np.count_nonzero(known) < 2:
        return None
    x, y = time[known], values[known]
    if name in ANGLES_THAT_WRAP:
        y = np.unwrap(y)
    spline = CubicHermiteSpline(x, y, np.gradient(y, x))
    return lambda t: np.asarray(spline(np.clip(t, x[0], x[-1])))


def _fly(
    profiles: Profiles,
    recording: Recording | None,
    control: Connection,
    devices: Sequence[tuple[Connection, tuple[str, ...]]],
) -> None:
    """The flight process: truth to each device's pipe, the signals that it asked for, AHEAD_S early."""
    heed_signals()
    clock = SystemClock()
    listening = [(pipe, signals) for pipe, signals in devices if signals]
    try:
        source = _source(profiles, recording)
        rows = source.advance(CHUNK)
        control.send(("ready", None))
        start_ns = control.recv()
        k = 0
        while n := _length(rows):
            for pipe, signals in list(listening):
                try:
                    pipe.send_bytes(np.column_stack([_column(rows, s, n) for s in signals]).tobytes())
                except OSError:  # that device is gone; the others fly on
                    listening.remove((pipe, signals))
            k += n
            rows = source.advance(CHUNK)
            due_ns = start_ns + round((k / TRUTH_HZ - AHEAD_S) * 1e9)
            while control.poll(max(0.0, (due_ns - clock.now_ns()) * 1e-9)):
                source.ask(control.recv())
        for pipe, _ in devices:
            pipe.close()
        if not control.poll(AHEAD_S):
            control.send(("end", k / TRUTH_HZ))
            control.poll(None)
    except StationError as error:
        with suppress(OSError):
            control.send(("error", error))
    except (EOFError, OSError):
        return  # whoever served us is gone


def _source(profiles: Profiles, recording: Recording | None) -> Source:
    if recording is not None:
        return Playback(recording)

    def simulation() -> Source:
        from station.simulation.sortie import installed

        made = installed(profiles.flown, profiles.rig, profiles.card)
        return _Begun(made, made.advance(CHUNK))

    if profiles.card.flight.source != "simulation":
        return simulation()
    from station.simulation.airframe import constants
    from station.simulation.declared_signals import emulated_signals
    from station.simulation.level_flight import LevelFlight

    flight = profiles.card.flight
    begins = AlteredAircraft(profiles.flown, flight.truth).at(0.0)
    constants(begins, flight.speed, flight.altitude)  # raises for an aircraft that cannot be flown,
    if flight.is_plane:
        from station.simulation.sortie import check_air

        check_air(begins, flight)  # and for one that cannot in this air
    return _Awaited(LevelFlight(begins, flight, emulated_signals(profiles.rig)), simulation)


class _Begun:
    """A source whose first rows have been taken from it."""

    def __init__(self, source: Source, first: Mapping[str, Floats]) -> None:
        self._source, self._first = source, first

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        self._source.ask(manoeuvres)

    def advance(self, n: int) -> Mapping[str, Floats]:
        first, self._first = self._first, {}
        return first or self._source.advance(n)


class _Awaited:
    """One source until another, which takes its time to make, is there. Raises what keeps that from being made."""

    def __init__(self, meanwhile: Source, make: Callable[[], Source]) -> None:
        self._now, self._make = meanwhile, make
        self._made: Source | None = None
        self._failure: StationError | None = None
        self._asked: Sequence[Order] = ()
        self._before, self._taken_over = 0, False
        self._thread = threading.Thread(target=self._prepare, name="simulation", daemon=True)

    def _prepare(self) -> None:
        try:
            self._made = self._make()
        except StationError as error:
            self._failure = error
        except Exception as error:  # else level flight would go on, as if it were what the card flies
            self._failure = DeviceError(f"the simulation cannot be flown: {type(error).__name__}: {error}")

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        self._asked = [*(m for m in self._asked if isinstance(m, Leg)), *manoeuvres]
        # The simulation's time begins when it takes over.
        begun_s = self._before / TRUTH_HZ
        self._now.ask([m.model_copy(update={"start": m.start - begun_s}) for m in manoeuvres])

    def advance(self, n: int) -> Mapping[str, Floats]:
        rows = self._now.advance(n)
        self._before += 0 if self._taken_over else n
        if self._thread.ident is None:  # not before the first rows are out
            self._thread.start()
        elif self._failure is not None:
            raise self._failure
        elif self._made is not None:
            self._now, self._made, self._taken_over = self._made, None, True
            asked, self._asked = self._asked, ()
            self.ask(asked)
        return rows


def _length(rows: Mapping[str, Floats]) -> int:
    return len(next(iter(rows.values()), ()))


def _column(rows: Mapping[str, Floats], name: str, n: int) -> Floats:
    found = rows.get(name)
    return np.full(n, np.nan) if found is None else found


class _Child:
    """A process and the pipe that keeps it alive."""

    def __init__(
        self,
        target: Callable[..., None],
        name: str,
        *before: Any,
        after: Sequence[Any] = (),
        foreign: Sequence[Connection] = (),
    ) -> None:
        """Starts `target(*before, control, *after)`; ends of pipes that are `foreign` to it are closed in it."""
        self.name = name
        self.control, theirs = _FORK.Pipe()
        words = ((*foreign, self.control), target, *before, theirs, *after)
        self.process: BaseProcess = _FORK.Process(target=_alone, args=words, name=name, daemon=True)
        self.process.start()
        theirs.close()

    def heard(self, timeout_s: float) -> tuple[str, Any] | None:
        """What it says, if it says something in time. A process that has died says "error"."""
        try:
            if self.control.poll(timeout_s):
                word, detail = self.control.recv()
                return str(word), detail
        except (EOFError, OSError):
            self.process.join(1.0)
            return "error", DeviceError(f"{self.name}: the process ended with exit status {self.process.exitcode}")
        return None

    def end(self) -> None:
        self.control.close()
        self.process.join(2.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.process.close()


def _alone(foreign: Sequence[Connection], target: Callable[..., None], *words: Any) -> None:
    for end in foreign:
        end.close()
    target(*words)


def serve(
    profiles: Profiles,
    announce: Callable[[dict[str, Any]], None],
    stop: threading.Event,
    clock: Clock,
    recording: Recording | None = None,
    start_ns: int | None = None,
    orders: Orders | None = None,
    tap: SurfaceTap | None = None,
) -> None:
    """Emulate every device of the rig until `stop` is set, then leave no process, link or file behind.

    A rig with a loop is emulated where it says "emulated"; `tap` brings what its other devices measure, and without one
    those that measure surfaces are opened here. `orders`: what the flight is asked to fly beside what its card says, as
    it comes, manoeuvres from flight time 0.

    Announces, as dictionaries fit for JSON: {"device", "link", "endpoint"} for each device when it can be opened, then
    {"preparing", "seconds"} each TELL_EVERY_S while a process is not ready (compiling takes minutes on a busy machine);
    {"start_ns"} with the station time of flight time 0 (`start_ns`, or as soon as all are ready), with "absent", the
    rig's signals that a recording lacks. In flight {"end_s"} when a recording is over and the devices fall silent, and
    {"process", "error"} if a process fails; of a loop {"loop"}, how it keeps time, each 5 s, and {"event", "source",
    "detail"}. Raises StationError for what keeps the flight from starting.
    """
    flight = profiles.card.flight
    if flight.source == "recording" and recording is None:
        raise DeviceError(
            f"card {profiles.card.name} flies a recording and there is none: name one in flight.recording"
        )
    flown = recording if flight.source == "recording" else None
    wanted = {signal for device in profiles.rig.devices for stream in device.streams for signal in stream.signals}
    absent = tuple(sorted(wanted - Playback(flown).signals)) if flown is not None else ()
    with (
        tempfile.TemporaryDirectory(prefix="station-", ignore_cleanup_errors=True) as folder,
        _processes(profiles, flown, absent, Path(folder), tap) as children,
    ):
        for child in children:
            word, detail = _first_word(child, announce, stop)
            if word == "stop":
                return
            if word == "error":
                raise detail
            if detail is not None:
                announce(detail)
        began_ns = clock.now_ns() + round(_START_DELAY_S * 1e9) if start_ns is None else start_ns
        for child in children:
            child.control.send(began_ns)
        announce({"start_ns": began_ns, "absent": list(absent)})
        _watch(children, announce, stop, orders)


@contextmanager
def _processes(
    profiles: Profiles, recording: Recording | None, absent: tuple[str, ...], folder: Path, tap: SurfaceTap | None
) -> Iterator[list[_Child]]:
    """The flight's and the devices' processes, running; ended afterwards."""
    children: list[_Child] = []
    truth: list[tuple[Connection, tuple[str, ...]]] = []
    try:
        for index, device in enumerate(profiles.rig.devices):
            if isinstance(profiles.rig.loop, MeasuredLoop) and device.address != EMULATED:
                continue
            theirs, ours = _FORK.Pipe(duplex=False)
            truth.append((ours, flown_signals(device, absent)))
            foreign = [*(child.control for child in children), *(pipe for pipe, _ in truth)]
            words = (index, profiles, str(folder), absent)
            children.append(_Child(serve_device, device.name, *words, after=(theirs,), foreign=foreign))
            theirs.close()
        foreign = [child.control for child in children]
        if profiles.rig.loop is None:
            children.append(_Child(_fly, "flight", profiles, recording, after=(truth,), foreign=foreign))
        else:
            from drivers.closed_loop import fly_closed

            children.append(_Child(fly_closed, "flight", profiles, tap, after=(truth,), foreign=foreign))
        for ours, _ in truth:
            ours.close()
        yield children
    finally:
        for child in children:
            child.control.close()
        for child in children:
            child.end()
        for ours, _ in truth:
            ours.close()


def _first_word(child: _Child, announce: Callable[[dict[str, Any]], None], stop: threading.Event) -> tuple[str, Any]:
    """Waits for as long as the process lives, and says what for."""
    for looked in itertools.count(1):
        if stop.is_set():
            break
        if word := child.heard(_POLL_S):
            return word
        if looked % round(TELL_EVERY_S / _POLL_S) == 0:
            announce({"preparing": child.name, "seconds": round(looked * _POLL_S)})
    return "stop", None


def _watch(
    children: Sequence[_Child],
    announce: Callable[[dict[str, Any]], None],
    stop: threading.Event,
    orders: Orders | None,
) -> None:
    alive = list(children)
    while not stop.wait(_POLL_S):
        while orders is not None and not orders.empty():
            with suppress(OSError):
                children[-1].control.send(orders.get())  # the flight's
        for child in list(alive):
            if (word_and_detail := child.heard(0.0)) is None:
                continue
            word, detail = word_and_detail
            if word == "end":
                announce({"end_s": detail})
            elif word == "told":
                announce(detail)
            else:
                announce({"process": child.name, "error": str(detail)})
                alive.remove(child)
