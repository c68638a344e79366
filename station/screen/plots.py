"""What the operator's page draws: rows -> named lines in display units. Pure; rerun_page.py hands them to Rerun.

Rows are SI and radians; lines are in the unit that the plot's name carries in brackets. Time is nanoseconds since the
start. NaN breaks a line: a value without status "estimated", or an angle of attack that is not valid, never continues
the line of the valid ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from station.conventions import LONGITUDINAL, SIGNAL_INDEX, TICK_NS, from_si
from station.estimation.method_table import LIVE, METHODS
from station.rows import AlphaEstimate, Code, Event, Frame, Health, Level, MethodEstimate, Row, Status, Tick, Truth
from station.screen.brief import Brief

SLOW_NS: Final = 500_000_000
"""Derivatives, wind and turbulence level change over seconds: two points a second draw them."""

_GREEN, _ORANGE, _BLUE, _PINK, _YELLOW, _GREY = (
    METHODS[m].colour for m in ("split", "II", "V", "split+gust", "III", "I")
)
_RED = 0xFF5050FF
LINK_COLOURS = (
    0x56B4E9FF, 0xE69F00FF, 0x2BD9A5FF, 0xE58AC0FF, 0xF0E442FF, 0xD55E00FF, 0xB0B0FFFF, 0xC0C0C0FF,
    0xFF5A7AFF, 0x9ACD32FF, 0xB5794DFF, 0xFFFFFFFF,
)  # fmt: skip
Path = tuple[str, ...]
BAND: Final = "±2 sd"


DIM: Final = 0.45
"""Share of a faint line's own colour in it; the rest is the viewer's ground."""
_GROUND: Final = 14


def _faint(colour: int) -> int:
    channels = ((colour >> shift & 0xFF) for shift in (24, 16, 8))
    red, green, blue = (round(DIM * c + (1 - DIM) * _GROUND) for c in channels)
    return red << 24 | green << 16 | blue << 8 | 0xFF


@dataclass(frozen=True, slots=True)
class Line:
    """Name in the legend and style. The two edges of a band are two lines of the same name."""

    name: str
    colour: int
    width: float = 1.5


@dataclass(frozen=True, slots=True)
class Plot:
    """One set of axes: `name` carries the unit; `window_s` is how much of the past it shows, None for all."""

    name: str
    lines: tuple[Line, ...]
    window_s: float | None = 30.0
    low: float | None = None
    high: float | None = None
    legend: bool = True
    child: str = ""
    """Lines drawn on the axes of `name`, beside its own."""

    @property
    def path(self) -> Path:
        return (self.name, self.child) if self.child else (self.name,)


def band(colour: int, name: str = BAND) -> tuple[Line, Line]:
    """Two edges: Rerun fills nothing between lines (its issue 8919)."""
    return (Line(name, _faint(colour), 0.75),) * 2


ALPHA: Final = Plot(
    "alpha [deg]",
    (
        Line("vane", _ORANGE, 1.0),
        Line("inertial", _BLUE, 1.25),
        *band(_GREEN),
        Line("corrected", _GREEN, 2.5),
        Line("not valid", _GREY, 1.0),
    ),
)
TRUTH: Final = Plot("alpha [deg]", (Line("truth", _GREY, 1.0),), child="truth")
"""Only where the flight is simulated."""
GUST: Final = Plot("gust part of alpha [deg]", (Line("gust part", _PINK), Line("not valid", _GREY, 1.0)))
CORRECTIONS: Final = Plot(
    "corrections to the vane [deg]",
    (
        Line("instrument", _GREEN),
        Line("zero", _GREY),
        Line("upwash", _ORANGE),
        Line("rate", _BLUE),
        Line("lag", _YELLOW),
        Line("gust", _PINK),
    ),
)
CONTROLS: Final = Plot("elevator [deg], q [deg/s]", (Line("elevator", _ORANGE), Line("q", _BLUE)))
AIRSPEED: Final = Plot("true airspeed [kt]", (Line("airspeed", _BLUE),), legend=False)
TURBULENCE: Final = Plot(
    "turbulence, w in 2-7 Hz [m/s]",
    (
        Line("level", _PINK, 2.0),
        Line("light from", _faint(_GREEN), 1.0),
        Line("moderate from", _faint(_ORANGE), 1.0),
        Line("severe from", _faint(_RED), 1.0),
    ),
    window_s=120.0,
)
WIND: Final = Plot("wind [m/s]", (Line("north", _GREEN), Line("east", _BLUE), Line("down", _ORANGE)), window_s=120.0)
GUST_SPEED: Final = Plot("vertical gust [m/s]", (Line("w gust", _PINK),), window_s=120.0, legend=False)
FIXED: Final = (ALPHA, TRUTH, GUST, CORRECTIONS, CONTROLS, AIRSPEED, TURBULENCE, WIND, GUST_SPEED)

CLASS_WORDS: Final = "green light from, orange moderate from, red severe from"
STATES: Final[Mapping[str, Mapping[str, int]]] = {
    "alpha": {"valid": 0x1E8A68FF, "not valid": 0xB03030FF},
    "turbulence": {
        "unknown": 0x606060FF,
        "calm": 0x2F6F9FFF,
        "light": 0x1E8A68FF,
        "moderate": 0xB07A00FF,
        "severe": 0xB03030FF,
    },
    "derivatives": {"none estimated": 0x606060FF, "some estimated": 0x2F6F9FFF, "all estimated": 0x1E8A68FF},
    "model": {"inside": 0x1E8A68FF, "outside": 0xB03030FF, "not simulated": 0x606060FF},
    "test_point": {},
}


def derivative_plot(name: str, setup: Setup, recommended: str = "split") -> Plot:
    """Axes of one derivative: the recommended method bold with its bounds, the others faint, the profile's value."""
    lines = [Line("profile", _GREY, 1.0)]
    for m in setup.methods:
        colour = METHODS[m].colour
        # The legend hides lines of one name together.
        bounds = (Line(BAND, colour, 0.75),) * 2 if m == recommended else band(colour, f"other {BAND}")
        lines += [*bounds, Line(m, colour, 2.5) if m == recommended else Line(m, _faint(colour), 1.0)]
    return Plot(f"{name} [1/rad]", tuple(lines), window_s=None, legend=False)


def without_other_bounds(setup: Setup, recommended: str) -> list[bool]:
    """Which lines of a derivative's plot to show where it is small: all but the bounds of other methods."""
    shown = [(m == recommended, m == recommended, True) for m in setup.methods]
    return [True, *(line for method in shown for line in method)]


def link_plots(setup: Setup) -> tuple[Plot, Plot, Plot, Plot]:
    """Axes of the health of all streams: rate, age, errors, drift."""
    lines = tuple(Line(s, LINK_COLOURS[i % len(LINK_COLOURS)], 2.0) for i, s in enumerate(setup.nominal_hz))
    return (
        Plot("link rate [% of nominal]", lines, 120.0, low=0.0, high=125.0),
        Plot("link age [ms]", lines, 120.0),
        Plot("gaps and bad messages [count]", lines, 120.0),
        Plot("device clock drift [ppm]", lines, 120.0),
    )


class Setup(msgspec.Struct, frozen=True):
    """What the page needs to know before the first row."""

    title: str
    mode: str
    port: int
    web_port: int
    methods: tuple[str, ...] = LIVE
    derivatives: tuple[str, ...] = LONGITUDINAL
    lateral_methods: tuple[str, ...] = ()
    """Methods that give the lateral derivatives, the one to believe last; none where the card does not ask."""
    references: dict[str, float] = {}
    """The aircraft profile's derivatives, drawn for comparison."""
    accuracy: float = 0.0
    """2 sd below this share of a derivative's value is enough; 0 where no card says so."""
    has_steps: bool = False
    """Whether a guide leads through the card."""
    nominal_hz: dict[str, float] = {}
    """Rate of each stream, by the rig."""
    class_limits: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """Turbulence level from which the class is light, moderate, severe; m/s."""
    open_page: bool = False
    signals: tuple[tuple[str, int, str], ...] = ()
    """What the rig declares or derives: name, column in a frame, unit to show."""
    simulated: bytes = b""
    """What the page simulates beside the flight (simulation_beside.given); empty where no profile is known."""
    measured: str = ""
    """The aircraft as JSON, where it has a measured baseline that the flight is held against."""


class Batch(msgspec.Struct, frozen=True):
    """The rows of a few ticks that the page shows, by kind, in time order."""

    start_ns: int
    frames: tuple[Frame, ...] = ()
    alphas: tuple[AlphaEstimate, ...] = ()
    methods: tuple[MethodEstimate, ...] = ()
    healths: tuple[Health, ...] = ()
    events: tuple[Event, ...] = ()
    truths: tuple[Truth, ...] = ()
    brief: Brief | None = None
    """What the station says of itself; of a recording nothing."""
    behind_s: float = 0.0
    """How late the rows before these were taken."""


SHOWN: Final[frozenset[type]] = frozenset((Frame, AlphaEstimate, MethodEstimate, Health, Event, Truth))


def batch(rows: Iterable[Row], start_ns: int, brief: Brief | None = None, behind_s: float = 0.0) -> Batch:
    """The rows that the page shows, sorted by kind; of derivatives those that it draws."""
    kinds: dict[type, list[Row]] = {kind: [] for kind in SHOWN}
    for row in rows:
        kept = kinds.get(type(row))
        if kept is not None and (type(row) is not MethodEstimate or is_slow_point(row)):
            kept.append(row)
    return Batch(
        start_ns,
        frames=tuple(kinds[Frame]),  # type: ignore[arg-type]
        alphas=tuple(kinds[AlphaEstimate]),  # type: ignore[arg-type]
        methods=tuple(kinds[MethodEstimate]),  # type: ignore[arg-type]
        healths=tuple(kinds[Health]),  # type: ignore[arg-type]
        events=tuple(kinds[Event]),  # type: ignore[arg-type]
        truths=tuple(kinds[Truth]),  # type: ignore[arg-type]
        brief=brief,
        behind_s=behind_s,
    )


def start_of(rows: Iterable[Row]) -> int | None:
    """Zero of the page's time, from the first rows of a flight: the first tick, else the first row."""
    first: int | None = None
    for row in rows:
        if type(row) is Tick:
            return row.t_ns
        first = row.t_ns if first is None else first
    return first


@dataclass(frozen=True, slots=True)
class Points:
    """New points of the lines of a plot: `t_ns` (n,) since the start, `values` (n, lines) in display units."""

    path: Path
    t_ns: NDArray[np.int64]
    values: NDArray[np.float64]


def points(rows: Batch, setup: Setup) -> Iterator[Points]:
    """The new points of every plot."""
    if rows.truths:
        alphas = [[row.values.get("alpha", math.nan)] for row in rows.truths]
        yield Points(TRUTH.path, times(rows.truths, rows.start_ns), np.degrees(alphas))
    if rows.alphas:
        yield from _alpha(rows, setup)
    if rows.frames:
        t = times(rows.frames, rows.start_ns)
        picked = [SIGNAL_INDEX[name] for name in ("elevator", "q", "airspeed")]
        values = np.array([[frame.values[i] for i in picked] for frame in rows.frames])
        yield Points(CONTROLS.path, t, np.degrees(values[:, :2]))
        yield Points(AIRSPEED.path, t, from_si(1.0, "kt") * values[:, 2:])
    if rows.methods:
        yield from _derivatives(rows, setup)
    if rows.healths and setup.nominal_hz:
        yield from _links(rows, setup)


def times(rows: Sequence[Row], start_ns: int) -> NDArray[np.int64]:
    return np.array([row.t_ns - start_ns for row in rows], dtype=np.int64)


def _alpha(rows: Batch, setup: Setup) -> Iterator[Points]:
    t = times(rows.alphas, rows.start_ns)
    angles = np.degrees(
        [
            (
                *(a.vane, a.alpha_inertial, a.alpha, a.alpha_sd, a.alpha_gust),
                # No line where the profile states no error of the vane.
                *(a.instrument or math.nan, a.zero, a.upwash, a.rate, a.lag, a.gust),
            )
            for a in rows.alphas
        ]
    )
    vane, inertial, alpha, sd, gust = angles[:, :5].T
    valid = np.array([a.valid for a in rows.alphas])
    believed, doubted = np.where(valid, (alpha, gust), math.nan), np.where(valid, math.nan, (alpha, gust))
    low, high = believed[0] - 2 * sd, believed[0] + 2 * sd
    yield Points(ALPHA.path, t, np.stack((vane, inertial, low, high, believed[0], doubted[0]), axis=1))
    yield Points(GUST.path, t, np.stack((believed[1], doubted[1]), axis=1))
    yield Points(CORRECTIONS.path, t, angles[:, 5:])
    gusts = np.array([a.gust_vertical if a.valid else math.nan for a in rows.alphas])
    yield Points(GUST_SPEED.path, t, gusts[:, None])
    slow = [a for a in rows.alphas if is_slow_point(a)]
    if slow:
        t = times(slow, rows.start_ns)
        yield Points(WIND.path, t, np.array([[a.wind_north, a.wind_east, a.wind_down] for a in slow]))
        levels = [math.nan if a.turbulence == "unknown" else a.turbulence_level for a in slow]
        yield Points(TURBULENCE.path, t, np.array([[level, *setup.class_limits] for level in levels]))


def is_slow_point(row: Row) -> bool:
    """One tick in `SLOW_NS`, whichever batch it falls in."""
    return row.t_ns % SLOW_NS < TICK_NS


def _derivatives(rows: Batch, setup: Setup) -> Iterator[Points]:
    slots: dict[int, dict[str, MethodEstimate]] = {}
    for row in rows.methods:
        slots.setdefault(row.t_ns, {})[row.method] = row
    t = np.array([t_ns - rows.start_ns for t_ns in slots], dtype=np.int64)
    for name in setup.derivatives:
        reference = setup.references.get(name, math.nan)
        values = []
        for slot in slots.values():
            lines = [reference]
            for m in setup.methods:
                value, sd = estimated(slot[m], name) if m in slot else (math.nan, math.nan)
                lines += [value - 2 * sd, value + 2 * sd, value]
            values.append(lines)
        if slots and not np.all(np.isnan(np.array(values)[:, 1:])):
            yield Points((f"{name} [1/rad]",), t, np.array(values))


def estimated(row: MethodEstimate, name: str) -> tuple[float, float]:
    """Value and sd of a derivative, NaN unless it may be believed."""
    if row.applicable:
        for p in row.parameters:
            if p.name == name and p.status is Status.ESTIMATED:
                return p.value, p.sd
    return math.nan, math.nan


def _links(rows: Batch, setup: Setup) -> Iterator[Points]:
    t = times(rows.healths, rows.start_ns)
    tables = np.full((4, len(t), len(setup.nominal_hz)), math.nan)
    column = {stream: i for i, stream in enumerate(setup.nominal_hz)}
    for k, row in enumerate(rows.healths):
        for s in row.streams:
            if s.stream in column:
                drift = s.drift_ppm if s.clock in ("converging", "synced") else math.nan
                rate = 100 * s.rate_hz / setup.nominal_hz[s.stream]
                tables[:, k, column[s.stream]] = rate, 1000 * s.age_s, s.gaps + s.bad, drift
    for plot, table in zip(link_plots(setup), tables, strict=True):
        yield Points(plot.path, t, table)


def states(rows: Batch, setup: Setup, recommended: str) -> Iterator[tuple[str, int, str]]:
    """What holds from when on: (which of STATES, ns since the start, state)."""
    for event in rows.events:
        if event.code in (Code.POINT_START, Code.POINT_END):
            state = event.detail if event.code is Code.POINT_START else ""
            yield "test_point", event.t_ns - rows.start_ns, state
    for a in rows.alphas[-1:]:
        yield "alpha", a.t_ns - rows.start_ns, "valid" if a.valid else "not valid"
        yield "turbulence", a.t_ns - rows.start_ns, a.turbulence
    for row in [row for row in rows.methods if row.method == recommended][-1:]:
        known = sum(not math.isnan(estimated(row, name)[0]) for name in setup.derivatives)
        share = "none" if known == 0 else "all" if known == len(setup.derivatives) else "some"
        yield "derivatives", row.t_ns - rows.start_ns, f"{share} estimated"


LEVEL_NAMES: Final[Mapping[Level, str]] = {Level.INFO: "INFO", Level.WARNING: "WARN", Level.ALARM: "ERROR"}
LEVEL_COLOURS: Final[Mapping[Level, int]] = {
    Level.INFO: 0x9FD0F0FF,
    Level.WARNING: 0xE6B800FF,
    Level.ALARM: 0xFF5050FF,
}


def is_routine(event: Event) -> bool:
    """A clock on its way to synced: every stream says so at the start, and the links show it."""
    return event.code is Code.CLOCK_STATE and event.detail != "rejected"


def event_text(event: Event) -> str:
    """An event in one line, without its time, for the page and the terminal."""
    times = f" x{event.times}" if event.times > 1 else ""
    return f"{event.source} {event.code}{times}" + (f": {event.detail}" if event.detail else "")
