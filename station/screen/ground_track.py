"""The flight from above, for the page: the track, coloured by test points, with wind barbs. Pure.

A map with tiles would tell a server where the aircraft is, and show nothing without a network: this one is drawn, to
scale, north up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX, from_si
from station.numerics.earth import radii
from station.rows import AlphaEstimate, Code, Event, Frame
from station.screen.drawings import Drawing, Label, Strip

Array = NDArray[np.float64]

EVERY_NS: Final = 5_000_000_000
"""Drawn anew so often, whole, so that all of it is always in sight."""
STEP_NS: Final = 1_000_000_000
"""Between its points; longer flights have fewer."""
MOST_POINTS: Final = 1500
BARB_NS: Final = 30_000_000_000
BARB: Final = 60.0
"""Length, in units of the drawing."""
MOST_BARBS: Final = 24
SIDE: Final = 1000.0
"""Of the drawing, a square."""
_MARGIN: Final = 90.0
PLAIN: Final = 0x8A949EFF
POINT_COLOURS: Final = (0x2BD9A5FF, 0xE69F00FF, 0x56B4E9FF, 0xE58AC0FF, 0xF0E442FF, 0xD55E00FF)
"""Of test points, in turn (after Okabe and Ito 2008)."""
BARB_COLOUR: Final = 0xC8D0D8FF
KNOTS_A_FEATHER: Final = 10
KNOTS_A_PENNANT: Final = 50
_LATITUDE, _LONGITUDE = SIGNAL_INDEX["latitude"], SIGNAL_INDEX["longitude"]


class GroundTrack:
    """Follows frames, estimates and test points."""

    def __init__(self) -> None:
        self._origin: tuple[float, float] | None = None
        self._places: list[tuple[float, float, int]] = []
        """m east and south, and the colour of the line that ends there."""
        self._winds: list[tuple[float, float, float, float]] = []
        """m east and south; m/s as it blows north and east."""
        self._begins: list[tuple[float, float, int]] = []
        """Of test points: m east and south, number."""
        self._colour = PLAIN
        self._every = 1
        self._due_ns = 0
        self._step_ns, self._barb_ns = -STEP_NS, -BARB_NS

    def take(self, frames: Iterable[Frame], alphas: Sequence[AlphaEstimate], events: Iterable[Event]) -> None:
        for event in events:
            if event.code is Code.POINT_START:
                self._colour = POINT_COLOURS[(event.count - 1) % len(POINT_COLOURS)]
                if self._places:
                    self._begins.append((*self._places[-1][:2], event.count))
            elif event.code is Code.POINT_END:
                self._colour = PLAIN
        for frame in frames:
            if frame.t_ns - self._step_ns >= self._every * STEP_NS:
                self._step_ns = frame.t_ns
                self._follow(frame.values[_LATITUDE], frame.values[_LONGITUDE])
        for a in alphas[-1:]:
            if a.t_ns - self._barb_ns >= BARB_NS and self._places and math.isfinite(a.wind_north + a.wind_east):
                self._barb_ns = a.t_ns
                self._winds.append((*self._places[-1][:2], a.wind_north, a.wind_east))

    def _follow(self, latitude: float, longitude: float) -> None:
        if not math.isfinite(latitude + longitude):
            return
        if self._origin is None:
            self._origin = (latitude, longitude)
        meridian, across = radii(self._origin[0])
        turned = math.remainder(longitude - self._origin[1], 2 * math.pi)
        east = across * math.cos(self._origin[0]) * turned
        self._places.append((east, -meridian * (latitude - self._origin[0]), self._colour))
        if len(self._places) > MOST_POINTS:
            self._places, self._every = self._places[::2], 2 * self._every

    def drawing(self, now_ns: int) -> Drawing | None:
        """All of it, fitted into a square; None while there is nothing new to see."""
        if now_ns < self._due_ns or len(self._places) < 2:
            return None
        self._due_ns = now_ns + EVERY_NS
        places = np.array([place[:2] for place in self._places])
        low, high = places.min(axis=0), places.max(axis=0)
        metres = max(float((high - low).max()), 100.0)
        scale, middle = (SIDE - 2 * _MARGIN) / metres, (low + high) / 2

        def fitted(x: float, y: float) -> tuple[float, float]:
            return tuple(SIDE / 2 + scale * (np.array([x, y]) - middle))

        drawn = SIDE / 2 + scale * (places - middle)
        colours = [colour for *_, colour in self._places]
        changes = [0, *(i for i in range(1, len(colours)) if colours[i] != colours[i - 1]), len(colours)]
        strips = [
            Strip(drawn[max(first - 1, 0) : end], colours[first], 2.5)
            for first, end in itertools.pairwise(changes)
            if end - max(first - 1, 0) > 1
        ]
        for x, y, north, east in self._winds[:: math.ceil(len(self._winds) / MOST_BARBS) or 1]:
            strips += barb(*fitted(x, y), north, east, BARB)
        long = 10.0 ** math.floor(math.log10(metres / 2))
        strips.append(Strip(np.array([[0.0, SIDE], [scale * long, SIDE]]), BARB_COLOUR, 2.0))
        labels = [Label(*fitted(x, y), f"{n}", POINT_COLOURS[(n - 1) % len(POINT_COLOURS)]) for x, y, n in self._begins]
        labels += [
            Label(scale * long / 2, SIDE - 40, f"{long:g} m"),
            Label(float(drawn[-1, 0]), float(drawn[-1, 1]), "now", BARB_COLOUR),
        ]
        return Drawing(tuple(strips), tuple(labels))


def barb(x: float, y: float, north: float, east: float, length: float) -> tuple[Strip, ...]:
    """A wind barb at a place, its staff pointing to where the wind comes from; wind in m/s, as it blows.

    A pennant is 50 kt, a long feather 10 kt, a short one 5 kt, on the side of the lower pressure in the northern
    hemisphere. Source: WMO-No. 485, attachment II-4. A calm is a dot.
    """
    knots = 5 * round(from_si(math.hypot(north, east), "kt") / 5)
    if knots == 0:
        return (Strip(np.array([[x, y], [x + 0.05 * length, y]]), BARB_COLOUR, 2.0),)
    from_x, from_y = (-east, north) / np.hypot(north, east)  # y is southward
    staff = np.array([from_x, from_y]) * length
    feather = 0.4 * length * np.array([-from_y, from_x])  # clockwise of the staff, seen from its foot
    foot = np.array([x, y])
    strips = [Strip(np.array([foot, foot + staff]), BARB_COLOUR, 1.0)]
    at = 1.0
    while knots >= KNOTS_A_PENNANT:
        root, tip = foot + at * staff, foot + (at - 0.15) * staff
        strips.append(Strip(np.array([root, root + feather, tip]), BARB_COLOUR, 1.0))
        knots, at = knots - KNOTS_A_PENNANT, at - 0.2
    while knots > 0:
        share = 1.0 if knots >= KNOTS_A_FEATHER else 0.5
        if len(strips) == 1 and share < 1:
            at -= 0.12  # five knots alone: not at the end, where it would be taken for ten
        root = foot + at * staff
        strips.append(Strip(np.array([root, root + share * feather + 0.1 * share * staff]), BARB_COLOUR, 1.0))
        knots, at = knots - KNOTS_A_FEATHER, at - 0.12
    return tuple(strips)
