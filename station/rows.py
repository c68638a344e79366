"""What gets written: rows on the bus and in the log, and the error tree.

Rows are frozen. `t_ns` is station time; a device's own time is `t_device_ns`. Values are SI and radians; NaN is
missing.

    StationError
    +-- ProfileError   before flight: an invalid aircraft, rig or card (exit 2)
    +-- UsageError     a command that cannot be carried out as asked (exit 2)
    +-- DeviceError    in flight: becomes an event and a reconnect
    +-- LogError       a recording or a file to import that cannot be read or written (exit 1)
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Final

import msgspec

MISSED_SHARE: Final = 0.001
"""Of its ticks a flight may miss so many; more is told in the exit code (logs/README.md)."""


class StationError(Exception):
    """What went wrong, where, and how to mend it, in one to three lines."""


class ProfileError(StationError):
    pass


class UsageError(StationError):
    pass


class DeviceError(StationError):
    pass


class LogError(StationError):
    pass


class Quality(IntEnum):
    FRESH = 0
    HELD = 1
    SUSPECT = 2
    MISSING = 3


class Level(IntEnum):
    INFO = 0
    WARNING = 1
    ALARM = 2


class Code(StrEnum):
    """What an event says."""

    START = "START"
    STOP = "STOP"
    CONNECT = "CONNECT"
    DISCONNECT = "DISCONNECT"
    RECONNECT = "RECONNECT"
    CRC = "CRC"
    NOISE = "NOISE"
    GAP = "GAP"
    STALE = "STALE"
    FRESH = "FRESH"
    RANGE = "RANGE"
    JUMP = "JUMP"
    STUCK = "STUCK"
    SLOW = "SLOW"
    LATE = "LATE"
    CLOCK_STEP = "CLOCK_STEP"
    CLOCK_STATE = "CLOCK_STATE"
    SUSPEND = "SUSPEND"
    OVERRUN = "OVERRUN"
    DROPPED = "DROPPED"
    HEARD = "HEARD"
    FOREIGN = "FOREIGN"
    HEALTH = "HEALTH"
    PROTOCOL = "PROTOCOL"
    DISK = "DISK"
    ESTIMATOR = "ESTIMATOR"
    DISAGREE = "DISAGREE"
    AGREE = "AGREE"
    CHANGED = "CHANGED"
    UNCHANGED = "UNCHANGED"
    UNWATCHED = "UNWATCHED"
    WATCHED = "WATCHED"
    VIEW = "VIEW"
    PREPARING = "PREPARING"
    READY = "READY"
    MARK = "MARK"
    POINT_START = "POINT_START"
    POINT_END = "POINT_END"
    STEP = "STEP"
    VERDICT = "VERDICT"
    LIMIT = "LIMIT"


LEVELS: Final = {
    **dict.fromkeys(Code, Level.WARNING),
    **dict.fromkeys(
        (
            Code.START,
            Code.STOP,
            Code.CONNECT,
            Code.RECONNECT,
            Code.HEARD,
            Code.FRESH,
            Code.AGREE,
            Code.UNCHANGED,
            Code.WATCHED,
            Code.CLOCK_STATE,
            Code.PREPARING,
            Code.READY,
            Code.MARK,
            Code.POINT_START,
            Code.POINT_END,
            Code.STEP,
            Code.VERDICT,
        ),
        Level.INFO,
    ),
    **dict.fromkeys((Code.DISCONNECT, Code.DISK, Code.STALE, Code.ESTIMATOR, Code.LIMIT, Code.PROTOCOL), Level.ALARM),
}


class Row(msgspec.Struct, frozen=True, gc=False):
    """Anything with a station time."""

    t_ns: int


class RawBlock(Row, frozen=True, gc=False):
    """Bytes as they came from a device, stamped on arrival. CAN frames are kept as their slcan text line."""

    device: str
    data: bytes


class Sample(Row, frozen=True, gc=False):
    """One message of a stream: `values` in the order of the stream's signals, SI."""

    stream: str
    t_device_ns: int | None
    seq: int | None
    values: tuple[float, ...]
    quality: Quality = Quality.FRESH


class Event(Row, frozen=True, gc=False):
    """Something happened: `source` is a device, stream or part of the station; `count` of like events together."""

    source: str
    code: Code
    count: int = 1
    detail: str = ""

    @property
    def level(self) -> Level:
        return LEVELS[self.code]

    @property
    def times(self) -> int:
        """How many like events; the count of a test point is its number."""
        return 1 if self.code in (Code.POINT_START, Code.POINT_END) else self.count


class TimeSync(Row, frozen=True, gc=False):
    """A two-way exchange with a device (MAVLink TIMESYNC): station minus device clock, and the round trip."""

    device: str
    offset_ns: int
    round_trip_ns: int


class Tick(Row, frozen=True, gc=False):
    """The loop's heartbeat. All rows logged between two ticks were drained by the later one, in that order."""

    k: int
    frame_t_ns: int
    """The instant the aligned frame stands for: the tick's schedule less the card's fixed lag."""


class Frame(Row, frozen=True, gc=False):
    """All signals aligned at `t_ns`, in the order of SIGNALS.

    `age_s` is 0 where the value was interpolated at `t_ns`, positive where the newest sample is older (held), NaN
    where there is none. `quality` holds Quality numbers.
    """

    k: int
    values: tuple[float, ...]
    age_s: tuple[float, ...]
    quality: tuple[int, ...]


class AlphaEstimate(Row, frozen=True, gc=False):
    """Angle of attack at the CG and how it came about; rad, m/s.

    `instrument`, `zero`, `upwash`, `rate`, `lag` and `gust` are the corrections added in turn to `vane`, which is as
    measured; their sum with it is `alpha`, of standard error `alpha_sd`: a zero that no calibration flight has told is
    not in it. `instrument` is what the profile's errors of the vane come to; `lag` is what
    the vane's dynamics and the wing's memory add; `gust` is what the gust's later arrival at the CG adds. A valid
    estimate with a `why` is degraded: it says what is lacking.
    """

    alpha: float
    alpha_sd: float
    vane: float
    zero: float
    upwash: float
    rate: float
    lag: float
    gust: float
    alpha_inertial: float
    alpha_gust: float
    gust_vertical: float
    turbulence_level: float
    """Standard deviation of the vertical gust in 2-7 Hz, m/s."""
    turbulence: str
    """calm, light, moderate, severe, or unknown before the filter has settled."""
    wind_north: float
    wind_east: float
    wind_down: float
    valid: bool
    why: str
    instrument: float = 0.0


class Status(StrEnum):
    UNESTIMATED = "unestimated"
    ESTIMATED = "estimated"
    INVALID = "invalid"


class ParamEstimate(msgspec.Struct, frozen=True, gc=False):
    """One derivative: per rad, standard error, and whether to believe it."""

    name: str
    value: float
    sd: float
    status: Status
    why: str = ""


class MethodEstimate(Row, frozen=True, gc=False):
    """What one method makes of the flight so far."""

    method: str
    parameters: tuple[ParamEstimate, ...]
    applicable: bool = True
    why: str = ""


class StreamHealth(msgspec.Struct, frozen=True, gc=False):
    """State of one stream as of the health row's time."""

    stream: str
    device: str
    rate_hz: float
    age_s: float
    clock: str
    """none, unsynced, converging, synced, rejected"""
    offset_s: float
    drift_ppm: float
    samples: int
    gaps: int
    bad: int
    alive: bool


class Health(Row, frozen=True, gc=False):
    """State of all streams, published once a second."""

    streams: tuple[StreamHealth, ...]
    dropped: int = 0
    overruns: int = 0


class Truth(Row, frozen=True, gc=False):
    """What the simulation knows and no instrument does; names and values, SI."""

    values: dict[str, float]


class Extra(Row, frozen=True, gc=False):
    """Columns of an imported record that are no signal of the station (inertia, density, coefficients); SI."""

    values: dict[str, float]


Rows = RawBlock | Sample | Event | TimeSync | Tick | Frame | AlphaEstimate | MethodEstimate | Health | Truth | Extra
