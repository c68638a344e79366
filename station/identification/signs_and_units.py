"""Wrong signs and units of a record, found by relations between its signals before anything is estimated.

The relations hold for any aircraft: attitude changes with the pitch rate, the vane with the rate less the turning of
the flight path by lift, velocity with the accelerations, az balances the weight, airspeed gives the dynamic pressure;
and the elevator pitches the aircraft as the profile says. Those of the lateral motion are in lateral_signs.py. The
mismatch of a relation is a share (relation_sides.py). A sign or unit is mistaken where undoing it, and nothing else,
makes the relations match.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, SIGNALS, to_si
from station.identification import lateral_signs
from station.identification.relation_sides import mean, moved, rate, share
from station.numerics.atmosphere import air_density
from station.profile import Aircraft

Array = NDArray[np.float64]

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
ENOUGH: Final = 0.9
"""Share of what several signals of the same factor explain, from which one of them leaves nothing to the others."""


def _mixed(si: str, *units: str) -> dict[str, float]:
    """Reported over true, where one unit is taken for the other."""
    sizes = {u: to_si(1.0, u) for u in units}
    return {f"{u} for {si}": 1 / size for u, size in sizes.items()} | {f"{si} for {u}": s for u, s in sizes.items()}


_ANGLE: Final = _mixed("rad", "deg")
_SPEED: Final = _mixed("m/s", "kt", "ft/s", "km/h")
_FORCE: Final = _mixed("m/s2", "g", "ft/s2")
_PRESSURE: Final = _mixed("Pa", "hPa", "psf", "kPa")
_VELOCITY: Final = ("v_north", "v_east", "v_down")
_PITCHED: Final = ("alpha_vane", "theta", "elevator")
_ALL_ANGLES: Final = (*_PITCHED, "q")
_SIDEWAYS: Final = ("beta_vane", "phi", "psi", "aileron", "rudder")
_GYROS: Final = ("p", "q", "r")
_FORCES: Final = ("ax", "ay", "az")
_TOGETHER: Final = (
    (_VELOCITY, _SPEED),
    (("airspeed", *_VELOCITY), _SPEED),
    (("ax", "az"), _FORCE),
    (_FORCES, _FORCE),
    (_ALL_ANGLES, _ANGLE),
    (_PITCHED, _ANGLE),
    (("alpha_vane", "beta_vane"), _ANGLE),
    (_GYROS, _ANGLE),
    (("phi", "theta", "psi"), _ANGLE),
    (("elevator", "aileron", "rudder"), _ANGLE),
    (("aileron", "rudder"), _ANGLE),
    ((*_PITCHED, *_SIDEWAYS), _ANGLE),
    ((*_PITCHED, *_SIDEWAYS, *_GYROS), _ANGLE),
)
"""Signals of one instrument, or of one file, whose unit is mistaken for all of them."""
_ALONE: Final = (
    *((n, _ANGLE) for n in (*_ALL_ANGLES, *_SIDEWAYS, "p", "r")),
    ("airspeed", _SPEED),
    ("v_down", _SPEED),
    *((n, _FORCE) for n in _FORCES),
    ("dynamic_pressure", _PRESSURE),
)
_SIGNED: Final = (*_ALL_ANGLES, "v_down", "az", "ax", *_SIDEWAYS, "p", "r", "ay")
_IN_RANGE: Final = (*_ALL_ANGLES, "beta_vane", "phi", "aileron", "rudder", "p", "r")
"""Signals whose range shows a unit; a heading may have been counted on over any number of turns."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """Which undone makes the signals agree: recorded = `factor` times the truth."""

    signals: tuple[str, ...]
    factor: float
    sentence: str


def _candidates(there: Sequence[str]) -> list[Mistake]:
    made = [Mistake((n,), f, f"{n} in the wrong unit: {words}") for n, us in _ALONE for words, f in us.items()]
    made = [m for m in made if set(m.signals) <= set(there)]
    for together, units in _TOGETHER:
        names = tuple(n for n in together if n in there)
        if len(names) > 1:
            made += [Mistake(names, f, f"{_listed(names)} in the wrong unit: {words}") for words, f in units.items()]
    made += [Mistake((n,), -1.0, f"{n} of the wrong sign") for n in _SIGNED if n in there]
    return list({(m.signals, m.factor): m for m in made}.values())


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
    disagreement = _Disagreement(x, dt, aircraft)
    falls = {c: disagreement.as_recorded - disagreement.without(c) for c in candidates}
    best = max(falls.values(), default=0.0)
    if best < CLEAR:
        return ()
    found = [c for c, fall in falls.items() if fall >= max(TIED * best, CLEAR)]
    found = [c for c in found if not any(_is_part(o, c) and falls[o] >= ENOUGH * falls[c] for o in found)]
    return tuple(sorted(found, key=lambda c: -falls[c]))


def _is_part(fewer: Mistake, more: Mistake) -> bool:
    return fewer.factor == more.factor and set(fewer.signals) < set(more.signals)


def _possible(name: str, column: Array) -> Array:
    """Without impossible values where they are few; where they are many, it may be the unit."""
    beyond = (column < SIGNALS[name].low) | (column > SIGNALS[name].high)
    return np.where(beyond, np.nan, column) if beyond.mean() < FEW else column


class _Disagreement:
    """Sum over the relations of log(share^2), with a mistake undone: those of pitch and path, and the lateral ones."""

    def __init__(self, x: Mapping[str, Array], dt: float, aircraft: Aircraft) -> None:
        self._x, self._dt, self._aircraft = x, dt, aircraft
        self._history = lateral_signs.surface_history(x, dt)
        self._recorded = (self._lengthwise(x), self._sideways(x))
        self.as_recorded = sum(self._recorded)

    def without(self, mistake: Mistake) -> float:
        """What the mistake has no part in stays as recorded."""
        mended = {n: v / mistake.factor if n in mistake.signals else v for n, v in self._x.items()}
        lengthwise, sideways = self._recorded
        if not lateral_signs.ALONE.issuperset(mistake.signals):
            lengthwise = self._lengthwise(mended)
        if not lateral_signs.NEEDED.isdisjoint(mistake.signals):
            sideways = self._sideways(mended)
        return lengthwise + sideways

    def _lengthwise(self, x: Mapping[str, Array]) -> float:
        return _logs(relations(x, self._dt, self._aircraft))

    def _sideways(self, x: Mapping[str, Array]) -> float:
        pressure = x.get("dynamic_pressure")
        if pressure is None and "airspeed" in self._x:
            # As recorded: a speed in knots would excuse another aircraft's profile.
            pressure = 0.5 * _density(self._x, self._aircraft) * self._x["airspeed"] ** 2
        return _logs(lateral_signs.relations(x, self._dt, self._aircraft, pressure, self._history))


def _logs(shares: Mapping[str, float]) -> float:
    return sum(math.log(x**2 + ALIKE**2) for x in shares.values())


def relations(x: Mapping[str, Array], dt: float, aircraft: Aircraft) -> dict[str, float]:
    """Mismatch, 0 to 1, of each relation for which the signals x (SI, no gaps) suffice."""
    shares = {}
    phi = x.get("phi", np.zeros(1))
    theta = np.clip(x["theta"], -1.5, 1.5) if "theta" in x else np.zeros(1)
    for name in _IN_RANGE:
        if name in x:
            shares[f"range of {name}"] = float(np.mean((x[name] < SIGNALS[name].low) | (x[name] > SIGNALS[name].high)))
    if "az" in x:
        shares["weight"] = share(mean(x["az"]), mean(-G0 * np.cos(theta) * np.cos(phi)))
    if {"q", "theta"} <= set(x):
        shares["turning"] = share(rate(x["theta"], dt), moved(x["q"] * np.cos(phi), dt))
    if {"q", "alpha_vane", "az", "airspeed"} <= set(x):
        turn = (x["az"] + G0 * np.cos(theta) * np.cos(phi)) / np.maximum(x["airspeed"], 1.0)
        shares["vane"] = share(rate(x["alpha_vane"], dt), moved(x["q"], dt), moved(turn, dt))
    if {"theta", "alpha_vane", "v_down", "airspeed"} <= set(x):
        path = x["v_down"] / np.maximum(x["airspeed"], 1.0)
        shares["flow"] = share(moved(x["alpha_vane"], dt), moved(x["theta"], dt), moved(path, dt))
    if {"v_down", "az"} <= set(x):
        down = np.cos(theta) * np.cos(phi) * x["az"] - np.sin(theta) * x.get("ax", np.zeros(1))
        shares["sinking"] = share(rate(x["v_down"], dt), moved(down, dt))
    if {"v_north", "v_east", "ax", "az", "theta"} <= set(x):
        # Over the ground: forward acceleration as the pitch lies; without means, which are the zeros' and the trim's.
        speed = np.hypot(x["v_north"], x["v_east"])
        pulls = np.cos(theta) * x["ax"], np.sin(theta) * np.cos(phi) * x["az"]
        shares["gaining"] = share(moved(speed, dt), *(moved(np.cumsum(pull) * dt, dt) for pull in pulls))
    if {"airspeed", "dynamic_pressure"} <= set(x):
        by_pressure = np.sqrt(2 * np.maximum(x["dynamic_pressure"], 0.0) / _density(x, aircraft))
        shares["pressure"] = share(mean(x["airspeed"]), mean(by_pressure))
    if {"airspeed", "v_north", "v_east"} <= set(x):
        shares["ground speed"] = share(mean(x["airspeed"]), mean(np.hypot(x["v_north"], x["v_east"])))
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
        shares["lift"] = share(moved(x["az"], dt), moved(-slope / aircraft.inertia.mass * force * alpha, dt))
    if {"q", "elevator"} <= set(x) and aircraft.value("Cm_de") and aircraft.inertia.iyy:
        turns = force * aircraft.geometry.chord / aircraft.inertia.iyy * aircraft.value("Cm_de")
        # Orthogonal to stiffness and damping, whatever they are.
        free = np.linalg.qr(np.column_stack([moved(alpha, dt), moved(x["q"], dt)]))[0]
        sides = [y - free @ (free.T @ y) for y in (rate(x["q"], dt), moved(turns * x["elevator"], dt))]
        shares["elevator"] = share(*sides)
    return shares


def _filled(x: Array) -> Array:
    good = np.isfinite(x)
    at = np.arange(len(x))
    return np.asarray(x if good.all() else np.interp(at, at[good], x[good]))


def _density(x: Mapping[str, Array], aircraft: Aircraft) -> float:
    """kg/m3; where unknown, that of the middle of the troposphere."""

    def of(name: str, otherwise: float = math.nan) -> float:
        return float(np.mean(x[name])) if name in x else otherwise

    stated = math.nan if aircraft.air_density is None else aircraft.air_density
    return float(air_density(stated, of("static_pressure"), of("air_temperature"), of("altitude", 5000.0)))
