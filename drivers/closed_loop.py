"""The simulated aircraft in real time with something from outside in its loop.

LOOP_HZ steps a second against the machine's clock, each on what has come until then; every other row goes at once to
the devices' processes. A step that comes late is counted, and caught up with.
"""

from __future__ import annotations

import gc
import math
import select
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.emulated_device import heed_signals
from drivers.emulated_messages import TRUTH_HZ
from drivers.loop_inputs import LoopInput, input_of
from drivers.loop_timing import REPORT_EVERY_NS, Overruns, claim_real_time
from drivers.surface_tap import SurfaceTap
from station.clock import SystemClock
from station.profile import LOOP_HZ, Aircraft, CommandedLoop, JoystickLoop, Loop, MeasuredLoop, Order, Profiles
from station.rows import Code, DeviceError, StationError
from station.simulation.outside import Outside
from station.simulation.sortie import stepped

Floats = NDArray[np.float64]
Listening = list[tuple[Connection, tuple[str, ...]]]

_STEP_NS: Final = 1_000_000_000 // LOOP_HZ
_ENDED: Final = "the loop has ended: "
_RUN_AWAY: Final = 1e9
"""SI: no signal of a flight comes near it."""
_EACH: Final = round(LOOP_HZ / TRUTH_HZ)
"""Steps between rows that are handed to the devices."""


def fly_closed(
    profiles: Profiles,
    tap: SurfaceTap | None,
    control: Connection,
    devices: Sequence[tuple[Connection, tuple[str, ...]]],
) -> None:
    """The flight process. Without a `tap` nobody else reads the measured surfaces' devices: it opens them itself."""
    heed_signals()
    try:
        come = input_of(profiles, tap, SystemClock())
        try:
            loop = ClosedLoop(profiles, control, come, [(pipe, signals) for pipe, signals in devices if signals])
            loop.fly()
        finally:
            come.close()
    except EOFError:
        return  # whoever served us is gone
    except Exception as error:  # in flight nothing raises: it is told, and the station flies on
        what = error if isinstance(error, StationError) else DeviceError(f"{_ENDED}{type(error).__name__}: {error}")
        with suppress(OSError):
            control.send(("error", what))


def flyable(row: Floats, airspeed: int) -> Floats:
    """A row of the flight, whose airspeed stands at that place. Raises DeviceError where its equations have run away:
    no message carries such numbers. What else is NaN is a signal that the aircraft lacks."""
    if not math.isfinite(row[airspeed]) or bool((np.abs(row) >= _RUN_AWAY).any()):
        raise DeviceError(f"{_ENDED}the simulated aircraft's motion has run away, to numbers of no flight")
    return row


def travel_of(aircraft: Aircraft, loop: Loop, moved: Collection[str]) -> dict[str, float]:
    """How far each of those moved goes at most: surfaces, rad; thrust, N, by the rig's full output and the aircraft."""
    travel = {n: getattr(aircraft, n).position_limit for n in moved if n != "thrust"}
    if "thrust" in moved:
        stated = loop.farthest("thrust") if isinstance(loop, CommandedLoop) else math.inf
        travel["thrust"] = min(aircraft.most_thrust, stated)
    return travel


class _Newest:
    """The last row, as a source that instruments look at."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._columns = columns
        self.row: Floats = np.empty(len(columns))

    def signals(self) -> dict[str, float]:
        return dict(zip(self._columns, self.row.tolist(), strict=True))

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Nothing: the flight itself is asked."""

    def advance(self, n: int) -> Mapping[str, Floats]:  # noqa: ARG002 - there is one
        return dict(zip(self._columns, self.row[:, None], strict=True))


class ClosedLoop:
    """One flight: what comes in, the steps, what goes out to the devices."""

    def __init__(self, profiles: Profiles, control: Connection, come: LoopInput, listening: Listening) -> None:
        """Compiles what it needs, then flies from trim. Raises ProfileError for what cannot be flown so."""
        rig, card, aircraft = profiles.rig, profiles.card, profiles.flown
        assert rig.loop is not None
        stepped(aircraft, rig, card, come.moved, come.measured)[0].step({})
        self._flight, make = stepped(aircraft, rig, card, come.moved, come.measured)
        self._newest = _Newest(self._flight.columns)
        self._airspeed = self._flight.columns.index("airspeed")
        self._shown = make(self._newest)
        travel = travel_of(aircraft, rig.loop, come.moved)
        rest = {n: self._flight.rest[n] for n in come.moved}
        jump = rig.loop.jump if isinstance(rig.loop, MeasuredLoop) else math.inf
        self._outside = Outside(rest, rig.loop.hold, rig.loop.fade, jump, travel)
        # A stick in its middle asks for trim.
        self._middle = rest if isinstance(rig.loop, JoystickLoop) else {}
        self._patience_ns = round(rig.loop.hold * 1e9)
        self._come, self._control, self._listening = come, control, listening
        self._clock = SystemClock()
        self._overruns = Overruns(_STEP_NS)
        self._start_ns = 0

    def fly(self) -> None:
        """Until `control` closes: raises EOFError then."""
        self._control.send(("ready", None))
        self._start_ns = self._control.recv()
        # Freezing what the imports leave costs nothing, and a collection would stop the steps.
        gc.freeze()
        gc.disable()
        claim_real_time()
        report_ns = self._start_ns + REPORT_EVERY_NS
        k = 0
        while True:
            due_ns = self._start_ns + k * _STEP_NS
            self._wait(due_ns)
            now_ns = self._clock.now_ns()
            self._overruns.began(due_ns, now_ns)
            if self._come.holds:
                self._outside.still(self._since_start(now_ns))
            self._newest.row = flyable(self._flight.step(self._outside.at(self._since_start(now_ns))), self._airspeed)
            if k % _EACH == 0:
                self._hand_out()
            self._come.answer(k, self._newest.signals(), now_ns)
            self._say()
            if now_ns >= report_ns:
                report_ns += REPORT_EVERY_NS
                self._report()
            k += 1

    def _since_start(self, t_ns: int) -> float:
        return (t_ns - self._start_ns) * 1e-9

    def _wait(self, due_ns: int) -> None:
        """Take what comes until then; what has come already in any case. In lock-step, until an answer has come."""
        while True:
            now_ns = self._clock.now_ns()
            if now_ns >= due_ns + self._patience_ns and self._come.waits:
                self._come.give_up()
            until_ns = due_ns + (self._patience_ns if self._come.waits else 0)
            own = self._control.fileno()
            ready, _, _ = select.select([own, *self._come.descriptors()], (), (), max(0.0, (until_ns - now_ns) * 1e-9))
            for descriptor in ready:
                if descriptor == own:
                    self._flight.ask(self._control.recv())
                else:
                    self._come.receive(descriptor, self._clock.now_ns(), self._take)
            if self._clock.now_ns() >= due_ns and not self._come.waits:
                return

    def _take(self, t_ns: int, name: str, value: float) -> None:
        self._outside.take(self._since_start(t_ns), name, self._middle.get(name, 0.0) + value)

    def _hand_out(self) -> None:
        """The newest row to each device's pipe, with the time of the newest value that it was flown with."""
        shown = self._shown.advance(1)
        came_s = self._outside.newest_s()
        for pipe, signals in list(self._listening):
            values = np.array([*(float(shown[s][0]) if s in shown else np.nan for s in signals), came_s])
            try:
                pipe.send_bytes(values.tobytes())
            except OSError:  # that device is gone; the others fly on
                self._listening.remove((pipe, signals))

    def _say(self) -> None:
        told = [("loop", code, words) for code, words in self._outside.told()] + self._come.told()
        for source, code, words in told:
            self._control.send(("told", {"event": code.value, "source": source, "detail": words}))

    def _report(self) -> None:
        if words := self._overruns.said():
            told = {"event": Code.OVERRUN.value, "source": "loop", "detail": words}
            self._control.send(("told", told))
        self._control.send(("told", {"loop": self._overruns.report()}))
