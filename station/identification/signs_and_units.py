"""Wrong signs and units of a record, found by relations between its signals before anything is estimated.

The relations hold for any aircraft: attitude changes with the pitch rate, the vane with the rate less the turning of
the flight path by lift, velocity with the accelerations, az balances the weight, airspeed gives the dynamic pressure;
and the elevator pitches the aircraft as the profile says. The mismatch of a relation is a share, 0 where both sides are
equal and 1 where they are opposite or of quite another size. A sign or unit is mistaken where undoing it, and nothing
else, makes the relations match.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, SIGNALS, to_si
from station.numerics.atmosphere import air_density
from station.numerics.differentiation import derivative
from station.profile import Aircraft

Array = NDArray[np.float64]

SMOOTH_S: Final = 0.2
LEAST_S: Final = 5.0
LEAST_ROWS: Final = 10
MOSTLY: Final = 0.5
"""Share of rows that must have a signal."""
ALIKE: Final = 0.15
"""Mismatch below which relations are not distinguished: calibration errors, gusts and noise cause as much."""
CLEAR: Final = 1.5
"""Reduction of the sum of log squared mismatches that shows a mistake."""
FEW: Final = 0.05
"""Share of impossible values below which they are bit errors, not a unit."""
TIED: Final = 0.7
"""Share of the largest reduction from which another mistake is as likely."""


def _mixed(si: str, *units: str) -> dict[str, float]:
    """Reported over true, where one unit is taken for the other."""
    sizes = {u: to_si(1.0, u) for u in units}
    return {f"{u} for {si}": 1 / size for u, size in sizes.items()} | {f"{si} for {u}": s for u, s in sizes.items()}


_ANGLE: Final = _mixed("rad", "deg")
_SPEED: Final = _mixed("m/s", "kt", "ft/s", "km/h")
_FORCE: Final = _mixed("m/s2", "g", "ft/s2")
_PRESSURE: Final = _mixed("Pa", "hPa", "psf", "kPa")
_VELOCITY: Final = ("v_north", "v_east", "v_down")
_ALL_ANGLES: Final = ("alpha_vane", "theta", "elevator", "q")


@dataclass(frozen=True, slots=True)
class Mistake:
    """Which undone makes the signals agree: recorded = `factor` times the truth."""

    signals: tuple[str, ...]
    factor: float
    sentence: str


def _candidates(there: Sequence[str]) -> list[Mistake]:
    made = []
    for names, units in (
        *(((n,), _ANGLE) for n in _ALL_ANGLES),
        (("airspeed",), _SPEED),
        (("v_down",), _SPEED),
        (_VELOCITY, _SPEED),
        (("airspeed", *_VELOCITY), _SPEED),
        (("az",), _FORCE),
        (("ax",), _FORCE),
        (("ax", "az"), _FORCE),
        (("dynamic_pressure",), _PRESSURE),
        (_ALL_ANGLES, _ANGLE),
        (("alpha_vane", "theta", "elevator"), _ANGLE),
    ):
        if set(names) <= set(there):
            made += [Mistake(names, f, f"{_listed(names)} in the wrong unit: {words}") for words, f in units.items()]
    for n in (*_ALL_ANGLES, "v_down", "az", "ax"):
        if n in there:
            made.append(Mistake((n,), -1.0, f"{n} of the wrong sign"))
    return made


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def mistakes(t_s: Array, columns: Mapping[str, Array], aircraft: Aircraft) -> tuple[Mistake, ...]:
    """The sign or unit that is mistaken, or the candidates of which one is; () where there is no evidence of any.

    `columns` as recorded, NaN where missing.
    """
    if len(t_s) < LEAST_ROWS or t_s[-1] - t_s[0] < LEAST_S:
        return ()
    dt = float(np.median(np.diff(t_s)))
    possible = {n: _possible(n, column) for n, column in columns.items() if n in SIGNALS}
    x = {n: _filled(column) for n, column in possible.items() if np.isfinite(column).mean() > MOSTLY}
    candidates = _candidates(tuple(x))
    before = _disagreement(x, dt, aircraft, Mistake((), 1.0, ""))
    falls = [before - _disagreement(x, dt, aircraft, c) for c in candidates]
    best = max(falls, default=0.0)
    if best < CLEAR:
        return ()
    found = [(fall, c) for fall, c in zip(falls, candidates, strict=True) if fall >= max(TIED * best, CLEAR)]
    return tuple(c for _, c in sorted(found, key=lambda f: -f[0]))


def _possible(name: str, column: Array) -> Array:
    """Without impossible values where they are few; where they are many, it may be the unit."""
    beyond = (column < SIGNALS[name].low) | (column > SIGNALS[name].high)
    return np.where(beyond, np.nan, column) if beyond.mean() < FEW else column


def _disagreement(x: Mapping[str, Array], dt: float, aircraft: Aircraft, assumed: Mistake) -> float:
    """Sum over the relations of log(share^2), with a mistake undone."""
    mended = {n: v / assumed.factor if n in assumed.signals else v for n, v in x.items()}
    shares = relations(mended, dt, aircraft).values()
    return sum(math.log(share**2 + ALIKE**2) for share in shares)


def relations(x: Mapping[str, Array], dt: float, aircraft: Aircraft) -> dict[str, float]:
    """Mismatch, 0 to 1, of each relation for which the signals x (SI, no gaps) suffice."""
    shares = {}
    phi = x.get("phi", np.zeros(1))
    theta = np.clip(x["theta"], -1.5, 1.5) if "theta" in x else np.zeros(1)
    for name in _ALL_ANGLES:
        if name in x:
            shares[f"range of {name}"] = float(np.mean((x[name] < SIGNALS[name].low) | (x[name] > SIGNALS[name].high)))
    if "az" in x:
        shares["weight"] = _share(_mean(x["az"]), _mean(-G0 * np.cos(theta) * np.cos(phi)))
    if {"q", "theta"} <= set(x):
        shares["turning"] = _share(_rate(x["theta"], dt), _moved(x["q"] * np.cos(phi), dt))
    if {"q", "alpha_vane", "az", "airspeed"} <= set(x):
        turn = (x["az"] + G0 * np.cos(theta) * np.cos(phi)) / np.maximum(x["airspeed"], 1.0)
        shares["vane"] = _share(_rate(x["alpha_vane"], dt), _moved(x["q"], dt), _moved(turn, dt))
    if {"theta", "alpha_vane", "v_down", "airspeed"} <= set(x):
        path = x["v_down"] / np.maximum(x["airspeed"], 1.0)
        shares["flow"] = _share(_moved(x["alpha_vane"], dt), _moved(x["theta"], dt), _moved(path, dt))
    if {"v_down", "az"} <= set(x):
        down = np.cos(theta) * np.cos(phi) * x["az"] - np.sin(theta) * x.get("ax", np.zeros(1))
        shares["sinking"] = _share(_rate(x["v_down"], dt), _moved(down, dt))
    if {"v_north", "v_east", "ax", "az", "theta"} <= set(x):
        # Over the ground: forward acceleration as the pitch lies; without means, which are the zeros' and the trim's.
        speed = np.hypot(x["v_north"], x["v_east"])
        pulls = np.cos(theta) * x["ax"], np.sin(theta) * np.cos(phi) * x["az"]
        shares["gaining"] = _share(_moved(speed, dt), *(_moved(np.cumsum(pull) * dt, dt) for pull in pulls))
    if {"airspeed", "dynamic_pressure"} <= set(x):
        by_pressure = np.sqrt(2 * np.maximum(x["dynamic_pressure"], 0.0) / _density(x, aircraft))
        shares["pressure"] = _share(_mean(x["airspeed"]), _mean(by_pressure))
    if {"airspeed", "v_north", "v_east"} <= set(x):
        shares["ground speed"] = _share(_mean(x["airspeed"]), _mean(np.hypot(x["v_north"], x["v_east"])))
    return shares | _by_profile(x, dt, aircraft)


def _by_profile(x: Mapping[str, Array], dt: float, aircraft: Aircraft) -> dict[str, float]:
    """The relations of lift and moment, where the profile gives them."""
    shares: dict[str, float] = {}
    if not {"alpha_vane", "az", "dynamic_pressure"} <= set(x):
        return shares
    boom = aircraft.boom
    alpha = x["alpha_vane"] * (boom.steady_calibration if boom else 1.0)
    force = x["dynamic_pressure"] * aircraft.geometry.wing_area
    slope = aircraft.value("CL_alpha")
    if slope:
        shares["lift"] = _share(_moved(x["az"], dt), _moved(-slope / aircraft.inertia.mass * force * alpha, dt))
    if {"q", "elevator"} <= set(x) and aircraft.value("Cm_de") and aircraft.inertia.iyy:
        turns = force * aircraft.geometry.chord / aircraft.inertia.iyy * aircraft.value("Cm_de")
        # Orthogonal to stiffness and damping, whatever they are.
        free = np.linalg.qr(np.column_stack([_moved(alpha, dt), _moved(x["q"], dt)]))[0]
        sides = [y - free @ (free.T @ y) for y in (_rate(x["q"], dt), _moved(turns * x["elevator"], dt))]
        shares["elevator"] = _share(*sides)
    return shares


def _share(one: Array, *others: Array) -> float:
    """Size of `one` - sum(others) over the sum of their sizes."""
    n = min(len(a) for a in (one, *others))
    rest = one[:n] - sum((o[:n] for o in others), np.zeros(n))
    size = math.sqrt(float(one @ one)) + sum(math.sqrt(float(o @ o)) for o in others)
    return math.sqrt(float(rest @ rest)) / size if size > 0 else 0.0


def _mean(x: Array) -> Array:
    return np.atleast_1d(np.mean(x))


def _moved(x: Array, dt: float) -> Array:
    """Smoothed, mean and trend removed."""
    width = max(1, round(SMOOTH_S / dt))
    y = np.convolve(np.broadcast_to(x, x.shape), np.full(width, 1 / width), "valid")
    t = np.linspace(-0.5, 0.5, len(y))
    y = y - y.mean()
    return np.asarray(y - float((y * t).sum() / (t * t).sum()) * t)


def _rate(x: Array, dt: float) -> Array:
    """Smoothed rate of change, mean and trend removed."""
    return _moved(derivative(x, dt), dt)


def _filled(x: Array) -> Array:
    good = np.isfinite(x)
    at = np.arange(len(x))
    return np.asarray(x if good.all() else np.interp(at, at[good], x[good]))


def _density(x: Mapping[str, Array], aircraft: Aircraft) -> float:
    """kg/m3; where unknown, that of the middle of the troposphere."""

    def mean(name: str, otherwise: float = math.nan) -> float:
        return float(np.mean(x[name])) if name in x else otherwise

    stated = math.nan if aircraft.air_density is None else aircraft.air_density
    return float(air_density(stated, mean("static_pressure"), mean("air_temperature"), mean("altitude", 5000.0)))
