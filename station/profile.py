"""TOML profiles -> frozen Aircraft, Rig and Card.

A quantity is a string with its unit, `mass = "340 slug"`; it is converted to SI here and nowhere else. Unknown keys,
missing or wrong units, wrong types and wrong ranges are ProfileErrors that name the file, the key and the nearest valid
key.
"""

from __future__ import annotations

import difflib
import itertools
import json
import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import SIGNALS, TICK_HZ, UNIT_ALIASES, UNITS, Stream, to_si, unit_named
from station.rows import ProfileError

_SI = "si"
"""Validation context for profiles that come from a recording: numbers are SI already."""


def _quantity(si: str) -> BeforeValidator:
    def parse(value: object, info: ValidationInfo) -> object:
        if info.context == _SI and isinstance(value, (int, float)):
            return value
        if isinstance(value, bool) or not isinstance(value, (str, int, float)):
            raise PydanticCustomError("quantity", "write a number and its unit, for example {eg}", {"eg": f'"1 {si}"'})
        if not isinstance(value, str):
            raise PydanticCustomError("quantity", "missing unit: write {eg}", {"eg": f'"{value} {_common_units(si)}"'})
        number, _, unit = value.strip().partition(" ")
        known = unit_named(unit) if unit else None
        try:
            magnitude = float(number)
        except ValueError:
            raise PydanticCustomError("quantity", "{text} is not a number and a unit", {"text": repr(value)}) from None
        if not unit:
            raise PydanticCustomError("quantity", "missing unit: write {eg}", {"eg": f'"{number} {_common_units(si)}"'})
        if known is None or known.si != si:
            raise PydanticCustomError(
                "quantity",
                "unit {unit} does not fit here; use one of {units}",
                {"unit": repr(unit), "units": ", ".join(u for u in UNITS if UNITS[u].si == si)},
            )
        return magnitude * known.factor + known.offset

    return BeforeValidator(parse)


def _common_units(si: str) -> str:
    return next(u for u in UNITS if UNITS[u].si == si)


Metres = Annotated[float, _quantity("m")]
SquareMetres = Annotated[float, _quantity("m2")]
MetresPerSecond = Annotated[float, _quantity("m/s")]
Seconds = Annotated[float, _quantity("s")]
Hertz = Annotated[float, _quantity("Hz")]
Radians = Annotated[float, _quantity("rad")]
RadiansPerSecond = Annotated[float, _quantity("rad/s")]
Kilograms = Annotated[float, _quantity("kg")]
KilogramMetres2 = Annotated[float, _quantity("kg m2")]
Newtons = Annotated[float, _quantity("N")]
Bytes = Annotated[float, _quantity("byte")]
Positive = Field(gt=0)


T = TypeVar("T", bound=BaseModel)


class Frozen(BaseModel):
    """A table of a profile: no key that is not known, no value changed later."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Derivative(Frozen):
    """A coefficient, per radian (rates normalised), its prior standard deviation in the same unit, and its source."""

    value: float
    sd: float | None = Field(default=None, gt=0)
    source: str = ""


class Geometry(Frozen):
    wing_area: Annotated[SquareMetres, Positive]
    span: Annotated[Metres, Positive]
    chord: Annotated[Metres, Positive]
    """Mean aerodynamic or geometric chord: the reference length of Cm and of q c/2V."""


class Inertia(Frozen):
    mass: Annotated[Kilograms, Positive]
    ixx: Annotated[KilogramMetres2, Positive] | None = None
    iyy: Annotated[KilogramMetres2, Positive] | None = None
    izz: Annotated[KilogramMetres2, Positive] | None = None
    ixz: KilogramMetres2 = 0.0


class Indicial(Frozen):
    """phi(t) = 1 - sum a exp(-b t), t in chords travelled (physics of unsteady lift and upwash)."""

    a: tuple[float, ...]
    b: tuple[float, ...]

    @model_validator(mode="before")
    @classmethod
    def _lists(cls, raw: Any) -> Any:
        return {k: tuple(v) if isinstance(v, list) else v for k, v in raw.items()} if isinstance(raw, dict) else raw

    @model_validator(mode="after")
    def _same_length(self) -> Self:
        if len(self.a) != len(self.b) or not self.a or min(self.b) <= 0:
            raise PydanticCustomError("indicial", "a and b need the same number of terms, every b above 0")
        return self


class Boom(Frozen):
    """The nose boom and its vane. Upwash is split into a body part without memory and a wing part with memory."""

    vane_x: Metres
    """Vane ahead of the CG, positive forward."""
    vane_y: Metres = 0.0
    vane_z: Metres = 0.0
    upwash_body: float = Field(default=0.0, ge=-0.5, le=1.0)
    upwash_wing: float = Field(default=0.0, ge=-0.5, le=1.0)
    zero: Radians = 0.0
    """Vane reading at zero flow angle."""
    vane_frequency: Annotated[Hertz, Positive] = 9.0
    vane_damping: float = Field(default=0.35, gt=0, lt=2)
    flexure: Annotated[float, _quantity("rad s2/m")] = 0.0
    """Vane angle per specific force down: positive where the boom droops when pulled up."""

    @property
    def steady_calibration(self) -> float:
        """Flow angle over vane angle when steady: 1/(1 + k_u0)."""
        return 1.0 / (1.0 + self.upwash_body + self.upwash_wing)


class Unsteady(Frozen):
    """How lift, downwash and upwash lag behind the motion and the gust (thin wing with a tail)."""

    memory: bool = True
    """False: a quasi-steady aircraft."""
    tail_lift_slope: float = Field(default=0.0, ge=0)
    """Tail's share of CL_alpha, per rad, referred to the wing area (a_h)."""
    tail_arm: Metres = 0.0
    tail_penetration: float = Field(default=1.0, ge=0, le=4)
    """How far behind the CG a gust meets the tail, in tail arms: 0 as if the tail were at the CG."""
    downwash: float = Field(default=0.0, ge=0, lt=1)
    """d epsilon / d alpha (e)."""
    downwash_delay: Seconds = 0.0
    """How much later than tail_arm/V the downwash reaches the tail."""
    reference_chord: Annotated[Metres, Positive] | None = None
    """Chord that the times of the indicial responses are counted in; the geometry's if left out."""
    lift_motion: Indicial | None = None
    lift_gust: Indicial | None = None
    upwash_motion: Indicial | None = None
    upwash_gust: Indicial | None = None


class Drag(Frozen):
    """CD = zero_lift + induced CL^2."""

    zero_lift: float = Field(ge=0)
    induced: float = Field(default=0.0, ge=0)


class Actuator(Frozen):
    time_constant: Seconds = 0.08
    rate_limit: RadiansPerSecond = math.radians(60)
    position_limit: Radians = math.radians(20)


class Instrument(Frozen):
    """What a signal's sensor does to it besides its noise, as found in flight; SI of the signal.

    Reported = gain * lagged(signal, latency earlier) + bias; a surface's play lies between sensor and surface.
    """

    latency: Seconds = 0.0
    lag: Seconds = 0.0
    gain: float = Field(default=1.0, gt=0)
    bias: float = 0.0
    backlash: float = Field(default=0.0, ge=0)
    """Width of the play, in the signal's SI unit."""


COEFFICIENTS = ("CL", "CD", "Cm", "CY", "Cl", "Cn")
ARGUMENTS = ("0", "V", "alpha", "alpha2", "alpha3", "q", "de", "beta", "p", "r", "da", "dr", "gust")
DERIVATIVE_NAMES = tuple(f"{c}_{a}" for c in COEFFICIENTS for a in ARGUMENTS)


class Aircraft(Frozen):
    name: str
    description: str = ""
    sources: tuple[str, ...] = ()
    geometry: Geometry
    inertia: Inertia
    boom: Boom | None = None
    derivatives: dict[str, Derivative] = {}
    rate_reference: Literal["instantaneous", "fixed"] = "instantaneous"
    """Whether rates are normalised with the speed of the instant or with the reference speed."""
    reference_speed: MetresPerSecond | None = None
    air_density: Annotated[float, _quantity("kg/m3")] | None = None
    """Fixed density; the standard atmosphere if left out."""
    thrust_angle: Radians = 0.0
    thrust_pitch_arm: Metres = 0.0
    """Nose-up moment per newton of thrust, m."""
    drag: Drag | None = None
    unsteady: Unsteady = Unsteady(memory=False)
    elevator: Actuator = Actuator()
    kinematics_only: bool = False
    """Geometry and mass are placeholders: instruments can be calibrated with such a profile, derivatives not found."""
    instruments: dict[str, Instrument] = {}
    """Errors of sensors that the rig does not know of, by signal: a diagnosis writes them, the simulation flies them."""
    imu_offset: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """How far from the rig's place the imu is, body axes."""

    @model_validator(mode="before")
    @classmethod
    def _sources(cls, raw: Any) -> Any:
        if isinstance(raw, dict):
            keys = ("sources", "imu_offset")
            raw = {k: tuple(v) if k in keys and isinstance(v, list) else v for k, v in raw.items()}
        return raw

    @model_validator(mode="after")
    def _known_derivatives(self) -> Self:
        for name in self.instruments:
            if name not in SIGNALS:
                raise PydanticCustomError(
                    "signal", "unknown signal {name}{near}", {"name": name, "near": _nearest(name, tuple(SIGNALS))}
                )
        for name in self.derivatives:
            if name not in DERIVATIVE_NAMES:
                raise PydanticCustomError(
                    "derivative",
                    "unknown derivative {name}{near}",
                    {"name": name, "near": nearest(name, DERIVATIVE_NAMES)},
                )
        return self

    def value(self, name: str) -> float:
        """A derivative's value; 0 where the profile has none."""
        found = self.derivatives.get(name)
        return found.value if found else 0.0


class Channel(Frozen):
    """How a field on the wire becomes a signal: unit-value = slope (field - zero), or a table of (field, value)."""

    field: str
    unit: str
    slope: float = 1.0
    zero: float = 0.0
    table: tuple[tuple[float, float], ...] | None = None
    noise: float = Field(default=0.0, ge=0)
    """Standard deviation, in `unit`: what the emulated device adds and what the estimator expects."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("table"), list):
            raw = {**raw, "table": tuple(tuple(float(x) for x in row) for row in raw["table"])}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if unit_named(self.unit) is None:
            raise PydanticCustomError(
                "unit",
                "unknown unit {unit}{near}",
                {"unit": repr(self.unit), "near": nearest(self.unit, tuple(UNITS))},
            )
        if self.slope == 0:
            raise PydanticCustomError("slope", "slope must not be 0")
        if self.table is not None:
            x = [row[0] for row in self.table]
            if len(x) < 2 or any(b <= a for a, b in itertools.pairwise(x)):
                raise PydanticCustomError("table", "table needs at least 2 points with the field's value increasing")
        return self

    def to_si(self, raw: float) -> float:
        """The signal's value in SI; beyond a table's ends its last slope goes on."""
        value = self.slope * (raw - self.zero) if self.table is None else _interpolate(self.table, raw)
        return to_si(value, self.unit)

    def from_si(self, value: float) -> float:
        """The field's value for a signal's value in SI (the inverse of to_si), before rounding to the wire."""
        u = UNITS[UNIT_ALIASES.get(self.unit, self.unit)]
        physical = (value - u.offset) / u.factor
        if self.table is None:
            return physical / self.slope + self.zero
        inverse = sorted((y, x) for x, y in self.table)
        return _interpolate(tuple(inverse), physical)

    def noise_si(self) -> float:
        """The noise's standard deviation in SI."""
        return self.noise * UNITS[UNIT_ALIASES.get(self.unit, self.unit)].factor


def _interpolate(table: tuple[tuple[float, float], ...], x: float) -> float:
    i = 1
    while i < len(table) - 1 and x > table[i][0]:
        i += 1
    (x0, y0), (x1, y1) = table[i - 1], table[i]
    return y0 + (x - x0) * (y1 - y0) / (x1 - x0)


class StreamProfile(Frozen):
    """One message of a device and the signals in it."""

    name: str
    message: str | int
    rate: Annotated[Hertz, Positive]
    latency: Seconds = 0.0
    """How old the values are when the message is stamped by the device (or arrives, if it carries no time)."""
    stamp_resolution: Seconds = 0.0
    """The step in which the device counts its time."""
    signals: dict[str, Channel]

    @model_validator(mode="after")
    def _known_signals(self) -> Self:
        for name, channel in self.signals.items():
            signal = SIGNALS.get(name)
            if signal is None:
                raise PydanticCustomError(
                    "signal", "unknown signal {name}{near}", {"name": name, "near": nearest(name, tuple(SIGNALS))}
                )
            unit = unit_named(channel.unit)
            if unit is None or unit.si != signal.unit:
                raise PydanticCustomError(
                    "unit",
                    "signal {name} is in {si}: unit {unit} does not fit",
                    {"name": name, "si": signal.unit, "unit": repr(channel.unit)},
                )
        return self


class _Device(Frozen):
    name: str
    streams: tuple[StreamProfile, ...] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("streams"), list):
            raw = {**raw, "streams": tuple(raw["streams"])}
        return raw


class SerialDevice(_Device):
    """A port speaking the boom box's binary packets or text lines, u-blox UBX, or NMEA 0183."""

    link: Literal["serial"]
    protocol: Literal["boombox", "boombox_ascii", "ubx", "nmea"]
    port: str
    """A port's path, or "emulated"."""
    baud: int = Field(default=115_200, gt=0)


class CanDevice(_Device):
    """A CAN bus through any of python-can's interfaces, its messages from a DBC file beside the rig."""

    link: Literal["can"]
    interface: str = "slcan"
    channel: str
    """What python-can's interface calls its channel (for slcan a port's path), or "emulated"."""
    bitrate: int = Field(default=1_000_000, gt=0)
    dbc: str


class MavlinkDevice(_Device):
    """An autopilot or other MAVLink source. Receive-only but for what `timesync` and `request_streams` allow."""

    link: Literal["mavlink"]
    url: str
    """pymavlink's connection string (udpin:HOST:PORT, tcp:HOST:PORT, a serial path), or "emulated"."""
    baud: int = Field(default=115_200, gt=0)
    system_id: int | None = Field(default=None, ge=1, le=255)
    timesync: bool = False
    request_streams: bool = False
    signing_key_file: str | None = None
    """File with the 32-byte key in hexadecimal; with it, unsigned and wrongly signed packets are refused."""


Device = Annotated[SerialDevice | CanDevice | MavlinkDevice, Field(discriminator="link")]


class Rig(Frozen):
    name: str
    description: str = ""
    imu_position: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """IMU from the CG, body axes (forward, right, down)."""
    devices: tuple[Device, ...] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict):
            raw = {
                k: tuple(v) if k in ("devices", "imu_position") and isinstance(v, list) else v for k, v in raw.items()
            }
        return raw

    @model_validator(mode="after")
    def _one_source_per_signal(self) -> Self:
        seen: dict[str, str] = {}
        names: set[str] = set()
        for device in self.devices:
            if device.name in names:
                raise PydanticCustomError("device", "two devices are named {name}", {"name": device.name})
            names.add(device.name)
            for stream in device.streams:
                for signal in stream.signals:
                    other = seen.setdefault(signal, f"{device.name}.{stream.name}")
                    if other != f"{device.name}.{stream.name}":
                        raise PydanticCustomError(
                            "claimed",
                            "signal {signal} is claimed by {one} and by {two}: take it out of one of them",
                            {"signal": signal, "one": other, "two": f"{device.name}.{stream.name}"},
                        )
        return self

    def streams(self) -> Iterator[Stream]:
        """Every stream, named device.stream."""
        for device in self.devices:
            for s in device.streams:
                yield Stream(
                    name=f"{device.name}.{s.name}",
                    signals=tuple(s.signals),
                    rate_hz=s.rate,
                    stale_after_s=min(max(0.2, 2.2 / s.rate), 3.0),
                    device=device.name,
                    latency_s=s.latency,
                    stamp_resolution_s=s.stamp_resolution,
                )

    def without_noise(self) -> Rig:
        """The same rig with every signal's noise unstated."""
        devices = []
        for device in self.devices:
            streams = []
            for s in device.streams:
                silent = {n: c.model_copy(update={"noise": 0.0}) for n, c in s.signals.items()}
                streams.append(s.model_copy(update={"signals": silent}))
            devices.append(device.model_copy(update={"streams": tuple(streams)}))
        return self.model_copy(update={"devices": tuple(devices)})

    def noise_si(self) -> dict[str, float]:
        """Standard deviation of each signal's noise in one sample, SI."""
        return {n: c.noise_si() for d in self.devices for s in d.streams for n, c in s.signals.items()}

    def frame_noise_si(self) -> dict[str, float]:
        """Standard deviation of each signal's noise in a 50 Hz frame, SI: a faster stream's samples are averaged."""
        return {
            n: c.noise_si() / math.sqrt(max(1.0, s.rate / TICK_HZ))
            for d in self.devices
            for s in d.streams
            for n, c in s.signals.items()
        }


class _Input(Frozen):
    start: Seconds
    surface: Literal["elevator"] = "elevator"
    amplitude: Radians
    repeat: Annotated[Seconds, Positive] | None = None
    """Fly it again each so many seconds, for as long as the flight lasts."""


class Doublet(_Input):
    kind: Literal["doublet"]
    width: Annotated[Seconds, Positive]
    """Of each half."""


class ThreeTwoOneOne(_Input):
    kind: Literal["3-2-1-1"]
    unit: Annotated[Seconds, Positive]
    """Width of a 1."""


class Multisine(_Input):
    kind: Literal["multisine"]
    duration: Annotated[Seconds, Positive]
    low: Annotated[Hertz, Positive] = 0.1
    high: Annotated[Hertz, Positive] = 2.0


class Sweep(_Input):
    kind: Literal["sweep"]
    duration: Annotated[Seconds, Positive]
    low: Annotated[Hertz, Positive] = 0.1
    high: Annotated[Hertz, Positive] = 2.0


class Pulse(_Input):
    kind: Literal["pulse"]
    width: Annotated[Seconds, Positive]


Manoeuvre = Annotated[Doublet | ThreeTwoOneOne | Multisine | Sweep | Pulse, Field(discriminator="kind")]


class Fault(Frozen):
    """What an emulated device does wrong, from `start` for `duration` (seconds of flight)."""

    device: str
    kind: Literal["off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent", "clock_step", "unplug"]
    start: Seconds
    duration: Annotated[Seconds, Positive]
    stream: str | None = None
    """Only this stream of the device; all of them if left out."""
    signal: str | None = None
    """For "wrong": the signal that is offset."""
    value: float = 0.0
    """"wrong": SI offset added; "delayed" and "clock_step": seconds; "slow": divisor of the rate (4 if left out);
    "intermittent" and "garbage": share of messages lost or replaced by random bytes (half if left out)."""


class Flight(Frozen):
    """What the emulated aircraft flies."""

    source: Literal["simulation", "recording"] = "simulation"
    recording: str | None = None
    """A station log, for source = "recording"; its aircraft is flown."""
    lead_in: Seconds = 0.0
    """The recording's first values are held so long before it plays, for filters to settle."""
    speed: MetresPerSecond = 56.59
    altitude: Metres = 762.0
    gust_sigma: MetresPerSecond = 0.0
    gust_start: Seconds = 0.0
    wind_north: MetresPerSecond = 0.0
    wind_east: MetresPerSecond = 0.0
    heading: Radians = 0.0
    seed: int = Field(default=1, ge=0)
    device_clock_offset: Seconds = 3600.0
    """Device clocks start this far from the station's, each a multiple of it."""
    device_clock_drift_ppm: float = 30.0


class Card(Frozen):
    """A test card: aircraft, rig, what to fly, what to record and when the answers are good enough."""

    name: str
    description: str = ""
    aircraft: str
    rig: str
    emulate: bool = False
    lag: Annotated[Seconds, Field(ge=0.02, le=1.0)] = 0.06
    """How far behind now the aligned frame stands."""
    needs: tuple[str, ...] = ("alpha_vane", "airspeed", "q", "ax", "az", "theta", "v_down", "elevator")
    low: Annotated[Hertz, Positive] = 0.1
    high: Annotated[Hertz, Positive] = 2.0
    step: Annotated[Hertz, Positive] = 0.04
    warm_up: Seconds = 20.0
    """Filters run this long before the transform opens."""
    rotate: Annotated[Bytes, Positive] = 512 * 1024.0**2
    accuracy: float = Field(default=0.1, gt=0)
    """Enough: 2 sd below this share of the value."""
    flight: Flight = Flight()
    manoeuvres: tuple[Manoeuvre, ...] = ()
    faults: tuple[Fault, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict):
            keys = ("needs", "manoeuvres", "faults")
            raw = {k: tuple(v) if k in keys and isinstance(v, list) else v for k, v in raw.items()}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        for name in self.needs:
            if name not in SIGNALS:
                raise PydanticCustomError(
                    "signal", "unknown signal {name}{near}", {"name": name, "near": nearest(name, tuple(SIGNALS))}
                )
        if self.high <= self.low:
            raise PydanticCustomError("band", "high must be above low")
        return self


def nearest(word: str, known: tuple[str, ...]) -> str:
    """Words that suggest the known one most like `word`; "" if none is."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else ""


def profiles_dir() -> Path:
    """Where the shipped profiles are: the checkout's profiles/, or the copy inside an installed wheel."""
    here = Path(__file__).resolve().parent
    checkout = here.parent / "profiles"
    return checkout if (checkout / "cards").is_dir() else here / "profiles"


def find(kind: Literal["aircraft", "rigs", "cards", "campaigns"], name: str, beside: Path | None = None) -> Path:
    """The file of a profile given by name or path. Raises ProfileError listing the known names."""
    given = Path(name)
    if given.suffix == ".toml" or "/" in name:
        places: list[Path] = [given, beside.parent / given] if beside else [given]
        for path in places:
            if path.is_file():
                return path
        raise ProfileError(f"no such file: {name}")
    folders = ((beside.parent.parent / kind,) if beside else ()) + (profiles_dir() / kind,)
    for folder in folders:
        if (folder / f"{name}.toml").is_file():
            return folder / f"{name}.toml"
    known = tuple(sorted({p.stem for f in folders for p in f.glob("*.toml")}))
    raise ProfileError(f"no {kind.rstrip('s')} named {name}{nearest(name, known)}\nknown: {', '.join(known)}")


def load_aircraft(name: str, beside: Path | None = None) -> Aircraft:
    """An aircraft by name or path. Raises ProfileError."""
    return read_profile(Aircraft, find("aircraft", name, beside))


def load_rig(name: str, beside: Path | None = None) -> Rig:
    """A rig by name or path. Raises ProfileError."""
    return read_profile(Rig, find("rigs", name, beside))


class Profiles(Frozen):
    """Everything a flight needs, and the text it was read from (kept in the recording)."""

    aircraft: Aircraft
    rig: Rig
    card: Card
    rig_dir: str
    """Where the rig's file lies: its DBC files are beside it."""


def load_card(name: str, overrides: Mapping[str, Any] | None = None) -> Profiles:
    """A card with its aircraft and rig, checked against each other. Raises ProfileError.

    `overrides` replace the card's values by dotted key, {"flight.gust_sigma": "5 ft/s"}.
    """
    path = find("cards", name)
    card = read_profile(Card, path, overrides)
    aircraft = load_aircraft(card.aircraft, path)
    rig_path = find("rigs", card.rig, path)
    rig = read_profile(Rig, rig_path)
    given = {signal for stream in rig.streams() for signal in stream.signals}
    for signal in card.needs:
        if signal not in given:
            near = nearest(signal, tuple(given))
            raise ProfileError(f"{path}: needs: no device of rig {rig.name} gives {signal}{near}")
    devices = {d.name: d for d in rig.devices}
    for i, fault in enumerate(card.faults):
        if fault.device not in devices:
            raise ProfileError(
                f"{path}: faults[{i}].device: rig {rig.name} has no device {fault.device}"
                f"{nearest(fault.device, tuple(devices))}"
            )
        streams = tuple(s.name for s in devices[fault.device].streams)
        if fault.stream is not None and fault.stream not in streams:
            near = nearest(fault.stream, streams)
            raise ProfileError(f"{path}: faults[{i}].stream: {fault.device} has no stream {fault.stream}{near}")
        signals = tuple(n for s in devices[fault.device].streams if fault.stream in (None, s.name) for n in s.signals)
        if fault.signal is not None and fault.signal not in signals:
            near = nearest(fault.signal, signals)
            raise ProfileError(f"{path}: faults[{i}].signal: {fault.device} does not give {fault.signal} there{near}")
        if fault.kind == "wrong" and fault.signal is None:
            raise ProfileError(f"{path}: faults[{i}].signal: missing: which signal is to be wrong?")
    return Profiles(aircraft=aircraft, rig=rig, card=card, rig_dir=str(rig_path.parent))


def read_profile(kind: type[T], path: Path, overrides: Mapping[str, Any] | None = None) -> T:
    """A profile file of that kind, its values replaced by dotted key. Raises ProfileError."""
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ProfileError(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise ProfileError(f"{path}: not valid TOML: {error}") from error
    for key, value in (overrides or {}).items():
        _override(raw, key, value)
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        raise ProfileError(explain(path, kind, error)) from None


def to_json(profile: BaseModel) -> str:
    """A profile as JSON in SI, for keeping in a recording; `from_json` reads it back the same."""
    return profile.model_dump_json(exclude_none=True)


def from_json(kind: type[T], text: str) -> T:
    """A profile kept in a recording. Raises ProfileError."""
    try:
        return kind.model_validate_json(text, context=_SI)
    except ValidationError as error:
        raise ProfileError(explain(Path("recording"), kind, error)) from None


def _override(raw: dict[str, Any], key: str, value: Any) -> None:
    *folders, last = key.split(".")
    place: Any = raw
    try:
        for folder in folders:
            place = place[int(folder)] if isinstance(place, list) else place.setdefault(folder, {})
        place[int(last) if isinstance(place, list) else last] = value
    except (AttributeError, IndexError, TypeError, ValueError):
        raise ProfileError(f"no place for {key} in the card: write section.key or list.number.key") from None


def explain(path: Path, kind: type[BaseModel], error: ValidationError) -> str:
    """The first problem, with its key, what is wrong and the nearest valid key."""
    problems = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")  # misspelt first
    first = problems[0]
    key = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in first["loc"]).lstrip(".")
    if first["type"] == "extra_forbidden":
        word = str(first["loc"][-1])
        message = f"unknown key{nearest(word, _keys(kind))}"
    elif first["type"] == "missing":
        message = "missing key"
    elif first["type"] in ("union_tag_not_found", "union_tag_invalid"):
        message = first["msg"]
    else:
        message = first["msg"][:1].lower() + first["msg"][1:]
        if first["type"] not in ("quantity", "derivative", "signal", "unit", "claimed"):
            message += f" (it is {first['input']!r:.60})"
    more = f"\nand {len(problems) - 1} more" if len(problems) > 1 else ""
    return f"{path}: {key or kind.__name__}: {message}{more}"


def _keys(kind: type[BaseModel]) -> tuple[str, ...]:
    """Every key that may occur anywhere below a profile type."""
    names: set[str] = set()

    def walk(schema: Any) -> None:
        if isinstance(schema, dict):
            names.update(schema.get("properties", {}))
            for value in schema.values():
                walk(value)
        elif isinstance(schema, list):
            for value in schema:
                walk(value)

    walk(json.loads(json.dumps(kind.model_json_schema())))
    return tuple(sorted(names))
