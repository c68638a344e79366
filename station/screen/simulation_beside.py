"""The page's picture of model against measured: the last seconds as measured, the profile's aircraft simulated from
the measured inputs over them, and the tolerance between two thin lines.

A simulation takes some 0.2 s of a processor, its libraries several to load: live, a thread of the page's own process
does it, at a lower priority than everything else.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import threading
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, SIGNALS, TICK_HZ
from station.estimation.method_table import METHODS
from station.rows import Frame
from station.screen.answers import hms
from station.screen.drawings import AXIS, WIDE, Drawing, Label, Strip, unbroken

if TYPE_CHECKING:
    from station.diagnosis.recent_flight import Beside
    from station.profile import Profiles

Array = NDArray[np.float64]

LIVE_EVERY_NS: Final = 2_000_000_000
SECONDS: Final = 20.0
"""As recent_flight.SECONDS, which brings numba: not for the page's start."""
PANEL: Final = 120.0
GAP: Final = 34.0
PANELS: Final = (
    ("alpha_vane", "alpha vane [deg]", math.degrees(1.0)),
    ("q", "q [deg/s]", math.degrees(1.0)),
    ("theta", "theta [deg]", math.degrees(1.0)),
    ("az", "az [g]", 1.0 / G0),
)
HIGH: Final = len(PANELS) * PANEL + (len(PANELS) - 1) * GAP
MEASURED, SIMULATED, TOLERANCE = (METHODS[m].colour for m in ("II", "split", "V"))
MOST_TICKS: Final = 4
"""Of a panel's axis."""
_GOOD, _BAD, _NONE = 0x2BD9A5FF, 0xFF5050FF, 0xC8D0D8FF
_NICE: Final = 10
"""The lowest but some: no tick waits for it."""


def given(profiles: Profiles) -> bytes:
    """What `SimulationBeside` needs of a flight's profiles."""
    return pickle.dumps((profiles.aircraft, profiles.rig.imu_position))


class SimulationBeside:
    """Follows the frames; a drawing and a state ("inside", "outside", "not simulated") once there are new ones."""

    def __init__(self, simulated: bytes, *, waits: bool) -> None:
        """`simulated` is what `given` made, or empty; `waits`: for each simulation, as a file's may, one a window."""
        self._profiles = pickle.loads(simulated) if simulated else None
        self._waits = waits
        self._every_ns = round(1e9 * SECONDS) if waits else LIVE_EVERY_NS
        self._frames: deque[Frame] = deque(maxlen=round(SECONDS * TICK_HZ))
        self._start_ns = 0
        self._due_ns = 0
        self._pool: ThreadPoolExecutor | None = None
        self._running: Future[Beside] | None = None

    def take(self, frames: Iterable[Frame], start_ns: int) -> None:
        self._start_ns = start_ns
        if self._profiles is not None:
            self._frames.extend(frames)

    def drawing(self) -> tuple[Drawing, str] | None:
        """What has been simulated since the last; None where there is nothing new."""
        if len(self._frames) == self._frames.maxlen and self._frames[-1].t_ns >= self._due_ns and self._running is None:
            self._due_ns = self._frames[-1].t_ns + self._every_ns
            if self._pool is None:
                self._pool = ThreadPoolExecutor(1, "simulation", _step_back)
            self._running = self._pool.submit(self._simulate, tuple(self._frames))
        running = self._running
        if running is None or not (self._waits or running.done()):
            return None
        self._running = None
        found = running.result()
        return beside_drawing(found), "not simulated" if found.why else "inside" if found.inside else "outside"

    def _simulate(self, frames: tuple[Frame, ...]) -> Beside:
        from station.diagnosis.recent_flight import beside

        assert self._profiles is not None
        aircraft, imu = self._profiles
        t_s = np.array([(f.t_ns - self._start_ns) * 1e-9 for f in frames])
        n = len(SIGNALS)
        values = np.array([f.values[:n] for f in frames])
        quality = np.array([f.quality[:n] for f in frames], dtype=np.uint8)
        return beside(t_s, values, quality, aircraft, imu)


def _step_back() -> None:
    with contextlib.suppress(OSError, AttributeError):  # a system without priorities of threads
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)


def beside_drawing(found: Beside) -> Drawing:
    """A panel a signal, time to the right; what it comes to above."""
    title = f"the {SECONDS:.0f} s to {hms(float(found.t_s[-1]))}, {_verdict(found)}"
    colour = _NONE if found.why else _GOOD if found.inside else _BAD
    labels = [Label(WIDE / 2, -84.0, title, colour)]
    if found.why:
        return Drawing((), tuple(labels))
    labels += [
        Label(WIDE * 0.15, -54.0, "measured", MEASURED),
        Label(WIDE * 0.5, -54.0, "simulated from measured inputs", SIMULATED),
        Label(WIDE * 0.85, -54.0, "tolerance", TOLERANCE),
    ]
    strips: list[Strip] = []
    x = np.asarray(WIDE * (found.t_s - found.t_s[0]) / (found.t_s[-1] - found.t_s[0]))
    for i, (name, words, scale) in enumerate(PANELS):
        top = i * (PANEL + GAP)
        more, named = _panel(found, name, scale, x, top)
        strips += more
        labels += named
        labels.append(Label(WIDE / 2, top - 28, f"{words}: worst {found.worst[name]:.2f} of the tolerance"))
    first, last = (hms(float(t)) for t in (found.t_s[0], found.t_s[-1]))
    labels += [Label(20.0, HIGH + 4, first), Label(WIDE - 20, HIGH + 4, last)]
    return Drawing(tuple(strips), tuple(labels))


def _verdict(found: Beside) -> str:
    if found.why:
        return f"not simulated: {found.why}"
    outcome = "INSIDE" if found.inside else "OUTSIDE"
    return f"{outcome} 14 CFR 60's short period: worst {found.overall:.2f} of the tolerance"


def _panel(found: Beside, name: str, scale: float, x: Array, top: float) -> tuple[list[Strip], list[Label]]:
    from station.diagnosis.recent_flight import TOLERANCES

    about, by = found.middle[name], TOLERANCES[name]
    lines = (
        (about - by, TOLERANCE, 0.75),
        (about + by, TOLERANCE, 0.75),
        (found.measured[name], MEASURED, 1.25),
        (found.simulated[name], SIMULATED, 2.0),
    )
    shown = np.concatenate([about - 1.2 * by, about + 1.2 * by, found.measured[name]])
    low, high = scale * float(shown.min()), scale * float(shown.max())
    step = _nice(high - low)
    ticks = np.array([step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)])

    def down(value: Array) -> Array:
        return np.asarray(top + PANEL * np.clip((high - value) / (high - low), 0, 1))

    strips = [Strip(np.array([[0.0, y], [WIDE, y]]), AXIS, 0.5) for y in down(ticks)]
    labels = [Label(-40.0, float(y) - 12, f"{v:.6g}") for v, y in zip(ticks, down(ticks), strict=True)]
    for values, colour, width in lines:
        strips += [Strip(part, colour, width) for part in unbroken(x, down(scale * values))]
    return strips, labels


def _nice(span: float) -> float:
    """1, 2 or 5 tens, so that at most MOST_TICKS of it make the span."""
    least = max(span, 1e-9) / MOST_TICKS
    ten = 10.0 ** math.floor(math.log10(least))
    return next(ten * k for k in (1.0, 2.0, 5.0, 10.0) if ten * k >= least)
