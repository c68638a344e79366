"""The flight from above, for the page: the track, coloured by test points, with wind barbs. Pure.

A map with tiles would tell a server where the aircraft is, and show nothing without a network: this one is drawn, in
metres east and south of where the flight began.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX, from_si
from station.numerics.earth import radii
from station.rows import AlphaEstimate, Code, Event, Frame
from station.screen.drawings import Drawing, Label, Strip

Array = NDArray[np.float64]

PIECE_NS: Final = 5_000_000_000
"""A piece of track: a page draws some hundreds of them in an hour."""
STEP_NS: Final = 1_000_000_000
"""Between its points."""
BARB_NS: Final = 30_000_000_000
BARB_S: Final = 8.0
"""A barb is as long as is flown in so many seconds."""
PLAIN: Final = 0x8A949EFF
POINT_COLOURS: Final = (0x2BD9A5FF, 0xE69F00FF, 0x56B4E9FF, 0xE58AC0FF, 0xF0E442FF, 0xD55E00FF)
"""Of test points, in turn (after Okabe and Ito 2008)."""
BARB: Final = 0xC8D0D8FF
KNOTS_A_FEATHER: Final = 10
KNOTS_A_PENNANT: Final = 50
_LATITUDE, _LONGITUDE, _SPEED = (SIGNAL_INDEX[n] for n in ("latitude", "longitude", "airspeed"))


class GroundTrack:
    """Follows frames, estimates and test points; hands out pieces as they are complete."""

    def __init__(self) -> None:
        self._origin: tuple[float, float] | None = None
        self._points: list[tuple[float, float]] = []
        self._colour = PLAIN
        self._begun_ns = 0
        self._step_ns, self._barb_ns = -STEP_NS, -BARB_NS
        self._speed = math.nan
        self.here: tuple[float, float] | None = None
        """Newest place, m east and south."""

    def pieces(
        self, frames: Iterable[Frame], alphas: Iterable[AlphaEstimate], events: Iterable[Event]
    ) -> Iterator[tuple[int, Drawing]]:
        """Each with the time (station ns) from which on it is seen."""
        for event in events:
            if event.code in (Code.POINT_START, Code.POINT_END):
                yield from self._end(event.t_ns)
                begins = event.code is Code.POINT_START
                self._colour = POINT_COLOURS[(event.count - 1) % len(POINT_COLOURS)] if begins else PLAIN
                if begins and self.here is not None:
                    yield event.t_ns, Drawing((), (Label(*self.here, f"{event.count}", self._colour),))
        for frame in frames:
            if frame.t_ns - self._step_ns >= STEP_NS:
                self._step_ns = frame.t_ns
                self._follow(frame)
                if self._points and frame.t_ns - self._begun_ns >= PIECE_NS:
                    yield from self._end(frame.t_ns)
        for a in alphas:
            if (
                a.t_ns - self._barb_ns >= BARB_NS
                and self.here is not None
                and math.isfinite(a.wind_north + a.wind_east)
            ):
                self._barb_ns = a.t_ns
                length = BARB_S * self._speed
                if math.isfinite(length):
                    yield a.t_ns, Drawing(barb(*self.here, a.wind_north, a.wind_east, length))

    def _follow(self, frame: Frame) -> None:
        latitude, longitude = frame.values[_LATITUDE], frame.values[_LONGITUDE]
        self._speed = frame.values[_SPEED]
        if not math.isfinite(latitude + longitude):
            return
        if self._origin is None:
            self._origin = (latitude, longitude)
        meridian, across = radii(self._origin[0])
        turned = math.remainder(longitude - self._origin[1], 2 * math.pi)
        self.here = (across * math.cos(self._origin[0]) * turned, -meridian * (latitude - self._origin[0]))
        if not self._points:
            self._begun_ns = frame.t_ns
        self._points.append(self.here)

    def _end(self, t_ns: int) -> Iterator[tuple[int, Drawing]]:
        """The piece so far; the next begins where it ends."""
        if len(self._points) > 1:
            yield t_ns, Drawing((Strip(np.array(self._points), self._colour, 2.5),))
            self._points = self._points[-1:]
            self._begun_ns = t_ns


def barb(x: float, y: float, north: float, east: float, length: float) -> tuple[Strip, ...]:
    """A wind barb at a place, its staff pointing to where the wind comes from; wind in m/s, as it blows.

    A pennant is 50 kt, a long feather 10 kt, a short one 5 kt, on the side of the lower pressure in the northern
    hemisphere. Source: WMO-No. 485, attachment II-4. A calm is a dot.
    """
    knots = 5 * round(from_si(math.hypot(north, east), "kt") / 5)
    if knots == 0:
        return (Strip(np.array([[x, y], [x + 0.05 * length, y]]), BARB, 2.0),)
    from_x, from_y = (-east, north) / np.hypot(north, east)  # y is southward
    staff = np.array([from_x, from_y]) * length
    feather = 0.4 * length * np.array([-from_y, from_x])  # clockwise of the staff, seen from its foot
    foot = np.array([x, y])
    strips = [Strip(np.array([foot, foot + staff]), BARB, 1.0)]
    at = 1.0
    while knots >= KNOTS_A_PENNANT:
        root, tip = foot + at * staff, foot + (at - 0.15) * staff
        strips.append(Strip(np.array([root, root + feather, tip]), BARB, 1.0))
        knots, at = knots - KNOTS_A_PENNANT, at - 0.2
    while knots > 0:
        share = 1.0 if knots >= KNOTS_A_FEATHER else 0.5
        if len(strips) == 1 and share < 1:
            at -= 0.12  # five knots alone: not at the end, where it would be taken for ten
        root = foot + at * staff
        strips.append(Strip(np.array([root, root + share * feather + 0.1 * share * staff]), BARB, 1.0))
        knots, at = knots - KNOTS_A_FEATHER, at - 0.12
    return tuple(strips)
