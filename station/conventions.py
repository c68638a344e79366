"""The one place for units, axes, signs, signals and streams.

Axes: body x forward, y right, z down; earth north-east-down (NED). Angle of attack is atan2(w, u), positive nose up.
Pitch rate is positive nose up. The elevator is positive trailing edge down. Specific force is what an accelerometer
feels: level flight reads az = -9.81 m/s2. Everything inside is SI and radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

G0: Final = 9.80665
"""Standard gravity, m/s2 (ISO 80000-3)."""
GAS_CONSTANT: Final = 287.05287
"""Of dry air, J/(kg K)."""
SURFACES: Final = ("elevator", "aileron", "rudder")
"""Control surfaces, each a signal."""
SEA_LEVEL_DENSITY: Final = 1.225
"""Of the standard atmosphere, kg/m3."""

TICK_HZ: Final = 50
TICK_NS: Final = 1_000_000_000 // TICK_HZ
CLOCK_LAW: Final = 6
"""How device clocks are put on the station's (flight/timebase.py); a recording says which law it was flown by. 1: jumps
beyond 20 ms. 2: jumps from 3 ms on, told from messages that were held up, lost or overtaken. 3: of messages in one read
the last tells. 4: a leap is followed once messages agree on it; bursts and stalls do not look like one. 5: a
control surface that keeps still is none that is stuck. 6: two-way exchanges prove a jump, however late messages are."""
FRESH_AGE_S: Final = 0.011
"""A value this much older than its frame, half a tick and some rounding, still counts as measured at its time."""
BRIDGED_S: Final = 0.1
"""A gap up to here is bridged by interpolation: at 0.5 Hz, a slow short period, it is 18 deg of phase."""
MIN_SPEED: Final = 8.0
"""m/s: below it there are no flow angles."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A measured quantity: SI unit, the range outside which a value cannot be true, and what positive means."""

    name: str
    unit: str
    low: float
    high: float
    positive: str
    max_rate: float = math.inf
    """Fastest believable change, unit per second; faster is a jump, not a motion."""


def _signals(*rows: Signal) -> Mapping[str, Signal]:
    return MappingProxyType({row.name: row for row in rows})


_RIGHT_ANGLE = math.pi / 2

SIGNALS: Final = _signals(
    Signal("alpha_vane", "rad", -1.0, 1.0, "nose up 2 deg in still air on a level path reads +0.0349", 12.0),
    Signal("beta_vane", "rad", -1.0, 1.0, "wind in the right ear", 12.0),
    Signal("airspeed", "m/s", 0.0, 400.0, "true airspeed", 120.0),
    Signal("dynamic_pressure", "Pa", -200.0, 100_000.0, "pitot above static", 20_000.0),
    Signal("static_pressure", "Pa", 1_000.0, 120_000.0, "absolute", 20_000.0),
    Signal("air_temperature", "K", 180.0, 340.0, "absolute", 20.0),
    Signal("p", "rad/s", -10.0, 10.0, "right wing down", 200.0),
    Signal("q", "rad/s", -10.0, 10.0, "nose up", 100.0),
    Signal("r", "rad/s", -10.0, 10.0, "nose right", 100.0),
    Signal("ax", "m/s2", -200.0, 200.0, "specific force forward", 2_000.0),
    Signal("ay", "m/s2", -200.0, 200.0, "specific force right", 2_000.0),
    Signal("az", "m/s2", -200.0, 200.0, "specific force down: -9.81 in level flight", 2_000.0),
    Signal("phi", "rad", -math.pi, math.pi, "right wing down"),
    Signal("theta", "rad", -_RIGHT_ANGLE, _RIGHT_ANGLE, "nose up", 12.0),
    Signal("psi", "rad", -2 * math.pi, 2 * math.pi, "clockwise from north seen from above"),
    Signal("v_north", "m/s", -500.0, 500.0, "northward over ground", 200.0),
    Signal("v_east", "m/s", -500.0, 500.0, "eastward over ground", 200.0),
    Signal("v_down", "m/s", -200.0, 200.0, "sinking", 200.0),
    Signal("latitude", "rad", -_RIGHT_ANGLE, _RIGHT_ANGLE, "north"),
    Signal("longitude", "rad", -math.pi, math.pi, "east"),
    Signal("altitude", "m", -500.0, 30_000.0, "above mean sea level", 1_000.0),
    Signal("elevator", "rad", -1.0, 1.0, "trailing edge down (pitches the nose down)", 12.0),
    Signal("aileron", "rad", -1.0, 1.0, "right wing's trailing edge down (rolls left)", 12.0),
    Signal("rudder", "rad", -1.0, 1.0, "trailing edge left (yaws left)", 12.0),
    Signal("thrust", "N", -50_000.0, 500_000.0, "forward"),
    Signal("mass", "kg", 0.1, 500_000.0, "total"),
    Signal("pdot", "rad/s2", -100.0, 100.0, "right wing down"),
    Signal("qdot", "rad/s2", -100.0, 100.0, "nose up"),
    Signal("rdot", "rad/s2", -100.0, 100.0, "nose right"),
    Signal("shaft_power", "W", 0.0, 1e8, "of all engines together"),
    Signal("engine_speed", "1", 0.0, 1.5, "N1, share of rated: 0.9 is 90 %"),
    Signal("fuel_flow", "kg/s", 0.0, 20.0, "of all engines together"),
)

ENGINE_SIGNALS: Final = ("shaft_power", "engine_speed", "fuel_flow")
"""What a profile's [engine] tells thrust by; the last of SIGNALS."""

SIGNAL_INDEX: Final[Mapping[str, int]] = MappingProxyType({name: i for i, name in enumerate(SIGNALS)})
"""Column of each signal in a frame."""

ANGLES_THAT_WRAP: Final = frozenset({"phi", "psi", "longitude"})


@dataclass(frozen=True, slots=True)
class Stream:
    """Signals that one message of a device carries together.

    `latency_s` is how much earlier the values were true than the message's device time (or arrival, without one).
    `stamp_resolution_s` is the step that the device's time is counted in.
    """

    name: str
    signals: tuple[str, ...]
    rate_hz: float
    stale_after_s: float
    device: str = ""
    latency_s: float = 0.0
    stamp_resolution_s: float = 0.0


def _streams(*rows: tuple[str, str, float]) -> Mapping[str, Stream]:
    return MappingProxyType({n: Stream(n, tuple(s.split()), hz, max(0.2, 10 / hz)) for n, s, hz in rows})


MAX_AGE_S: Final[Mapping[str, float]] = MappingProxyType(
    {
        **dict.fromkeys(SIGNALS, 0.2),
        # Integrated between their measurements, which are compared with the past.
        **dict.fromkeys(("phi", "theta", "psi", "v_north", "v_east", "v_down"), 1.0),
        # They change slowly.
        **dict.fromkeys(("static_pressure", "air_temperature", "altitude", "thrust", "mass"), 5.0),
        **dict.fromkeys(("shaft_power", "engine_speed", "fuel_flow"), 5.0),
    }
)
"""How old a value may be and still be used, live as in a record: filters run on over it; then it is missing."""

STREAMS: Final = _streams(
    ("vanes", "alpha_vane beta_vane", 200.0),
    ("air", "airspeed dynamic_pressure static_pressure air_temperature", 50.0),
    ("imu", "p q r ax ay az", 200.0),
    ("attitude", "phi theta psi", 50.0),
    ("velocity", "v_north v_east v_down", 50.0),
    ("position", "latitude longitude altitude", 10.0),
    ("surfaces", "elevator aileron rudder", 100.0),
    ("propulsion", "thrust mass shaft_power engine_speed fuel_flow", 10.0),
    ("angular_acceleration", "pdot qdot rdot", 50.0),
)
"""How signals are grouped where no rig says otherwise: imported records and the simulation."""


@dataclass(frozen=True, slots=True)
class Unit:
    """value_SI = value * factor + offset."""

    si: str
    factor: float
    offset: float = 0.0


_FT = 0.3048
_LBF = 4.4482216152605
_SLUG = _LBF / _FT
_DEG = math.pi / 180

UNITS: Final[Mapping[str, Unit]] = MappingProxyType(
    {
        "1": Unit("1", 1.0),
        "%": Unit("1", 0.01),
        "rad": Unit("rad", 1.0),
        "mrad": Unit("rad", 1e-3),
        "deg": Unit("rad", _DEG),
        "1/rad": Unit("1", 1.0),
        "1/deg": Unit("1", 1 / _DEG),
        "rad/m": Unit("rad/m", 1.0),
        "deg/m": Unit("rad/m", _DEG),
        "deg/ft": Unit("rad/m", _DEG / _FT),
        "rad/(m/s)": Unit("rad/(m/s)", 1.0),
        "deg/(m/s)": Unit("rad/(m/s)", _DEG),
        "deg/kt": Unit("rad/(m/s)", _DEG / (1852 / 3600)),
        "rad/s": Unit("rad/s", 1.0),
        "rad/s2": Unit("rad/s2", 1.0),
        "deg/s2": Unit("rad/s2", _DEG),
        "mrad/s": Unit("rad/s", 1e-3),
        "deg/s": Unit("rad/s", _DEG),
        "rpm": Unit("rad/s", 2 * math.pi / 60),
        "m": Unit("m", 1.0),
        "mm": Unit("m", 1e-3),
        "um": Unit("m", 1e-6),
        "cm": Unit("m", 1e-2),
        "km": Unit("m", 1e3),
        "ft": Unit("m", _FT),
        "in": Unit("m", _FT / 12),
        "nmi": Unit("m", 1852.0),
        "m2": Unit("m2", 1.0),
        "ft2": Unit("m2", _FT**2),
        "m/s": Unit("m/s", 1.0),
        "cm/s": Unit("m/s", 0.01),
        "mm/s": Unit("m/s", 0.001),
        "km/h": Unit("m/s", 1 / 3.6),
        "ft/s": Unit("m/s", _FT),
        "ft/min": Unit("m/s", _FT / 60),
        "kt": Unit("m/s", 1852 / 3600),
        "mph": Unit("m/s", 1609.344 / 3600),
        "m/s2": Unit("m/s2", 1.0),
        "ft/s2": Unit("m/s2", _FT),
        "g": Unit("m/s2", G0),
        "mg": Unit("m/s2", G0 / 1000),
        "Pa": Unit("Pa", 1.0),
        "hPa": Unit("Pa", 100.0),
        "mbar": Unit("Pa", 100.0),
        "kPa": Unit("Pa", 1000.0),
        "psi": Unit("Pa", _LBF / (_FT / 12) ** 2),
        "psf": Unit("Pa", _LBF / _FT**2),
        "inHg": Unit("Pa", 3386.389),
        "bar": Unit("Pa", 1e5),
        "K": Unit("K", 1.0),
        "degC": Unit("K", 1.0, 273.15),
        "cdegC": Unit("K", 0.01, 273.15),
        "degF": Unit("K", 5 / 9, 273.15 - 32 * 5 / 9),
        "N": Unit("N", 1.0),
        "kN": Unit("N", 1000.0),
        "lbf": Unit("N", _LBF),
        "N m": Unit("N m", 1.0),
        "lbf ft": Unit("N m", _LBF * _FT),
        "lbf in": Unit("N m", _LBF * _FT / 12),
        "W": Unit("W", 1.0),
        "kW": Unit("W", 1000.0),
        "hp": Unit("W", 550 * _FT * _LBF),
        "kg/s": Unit("kg/s", 1.0),
        "kg/h": Unit("kg/s", 1 / 3600),
        "lb/h": Unit("kg/s", 0.45359237 / 3600),
        "kg": Unit("kg", 1.0),
        "lb": Unit("kg", 0.45359237),
        "slug": Unit("kg", _SLUG),
        "kg m2": Unit("kg m2", 1.0),
        "slug ft2": Unit("kg m2", _SLUG * _FT**2),
        "kg/m3": Unit("kg/m3", 1.0),
        "g/m3": Unit("kg/m3", 1e-3),
        "slug/ft3": Unit("kg/m3", _SLUG / _FT**3),
        "s": Unit("s", 1.0),
        "ms": Unit("s", 1e-3),
        "us": Unit("s", 1e-6),
        "ns": Unit("s", 1e-9),
        "min": Unit("s", 60.0),
        "h": Unit("s", 3600.0),
        "Hz": Unit("Hz", 1.0),
        "kHz": Unit("Hz", 1000.0),
        "ppm": Unit("1", 1e-6),
        "V": Unit("V", 1.0),
        "mV": Unit("V", 1e-3),
        "A": Unit("A", 1.0),
        "mA": Unit("A", 1e-3),
        "MiB": Unit("byte", 1024.0**2),
        "GiB": Unit("byte", 1024.0**3),
        "deg/g": Unit("rad s2/m", _DEG / G0),
    }
)
"""Every unit a profile, a CSV header or a device may use, with its way to SI."""

UNIT_ALIASES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "": "1",
        "-": "1",
        "degree": "deg",
        "degrees": "deg",
        "°": "deg",
        "°/s": "deg/s",
        "dps": "deg/s",
        "radians": "rad",
        "m/s^2": "m/s2",
        "m/s²": "m/s2",
        "mps2": "m/s2",
        "ft/s^2": "ft/s2",
        "ft/s²": "ft/s2",
        "mps": "m/s",
        "fps": "ft/s",
        "knot": "kt",
        "knots": "kt",
        "kts": "kt",
        "kn": "kt",
        "fpm": "ft/min",
        "kph": "km/h",
        "lbf/ft2": "psf",
        "lbf/ft^2": "psf",
        "lb/ft2": "psf",
        "C": "degC",
        "°C": "degC",
        "F": "degF",
        "°F": "degF",
        "N*m": "N m",
        "Nm": "N m",
        "ft lbf": "lbf ft",
        "ft-lb": "lbf ft",
        "in-lb": "lbf in",
        "g/m^3": "g/m3",
        "µm": "um",
        "volt": "V",
        "lbs": "lb",
        "shp": "hp",
        "pph": "lb/h",
        "lbm": "lb",
        "kg/m^3": "kg/m3",
        "slug/ft^3": "slug/ft3",
        "kg m^2": "kg m2",
        "kg*m2": "kg m2",
        "slug*ft2": "slug ft2",
        "slug ft^2": "slug ft2",
        "ft^2": "ft2",
        "m^2": "m2",
        "sec": "s",
        "µs": "us",
        "per rad": "1/rad",
        "/rad": "1/rad",
    }
)


def unit_named(name: str) -> Unit | None:
    """The unit with that name or a usual other spelling of it; None if there is none."""
    name = name.strip()
    return UNITS.get(UNIT_ALIASES.get(name, name))


def to_si(value: float, unit: str) -> float:
    """A value in `unit`, in SI. Raises KeyError for an unknown unit."""
    u = UNITS[UNIT_ALIASES.get(unit, unit)]
    return value * u.factor + u.offset


def from_si(value: float, unit: str) -> float:
    """An SI value, in `unit`. Raises KeyError for an unknown unit."""
    u = UNITS[UNIT_ALIASES.get(unit, unit)]
    return (value - u.offset) / u.factor


def ned_from_body(
    phi: float | NDArray[np.float64], theta: float | NDArray[np.float64], psi: float | NDArray[np.float64]
) -> NDArray[np.float64]:
    """Direction-cosine matrix R_ned_from_body, 3x3, for Euler angles in rad (order 3-2-1: yaw, pitch, roll); (n, 3, 3)
    for angles (n,).

    Source: Klein and Morelli 2006, eq. 3.29 (transposed).
    """
    cph, sph = np.cos(phi), np.sin(phi)
    cth, sth = np.cos(theta), np.sin(theta)
    cps, sps = np.cos(psi), np.sin(psi)
    rows = [
        [cth * cps, sph * sth * cps - cph * sps, cph * sth * cps + sph * sps],
        [cth * sps, sph * sth * sps + cph * cps, cph * sth * sps - sph * cps],
        [-sth, sph * cth, cph * cth],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


LONGITUDINAL: Final = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
LONGITUDINAL_BODY: Final = ("CZ_alpha", "CZ_q", "CZ_de", "Cm_alpha", "Cm_q", "Cm_de")
LATERAL: Final = tuple(f"{c}_{x}" for c in ("CY", "Cl", "Cn") for x in ("beta", "p", "r", "da", "dr"))
"""Derivatives, per radian; rates normalised as q c/2V, p b/2V, r b/2V with the true airspeed of the instant."""
DRAG: Final = "drag"
"""Source of events on the watch of drag alone; "aircraft" is that of all that is watched against a baseline."""
