"""Relations between the lateral signals of a record, in which wrong signs and units show (signs_and_units.py).

Kinematics hold for any aircraft: attitude changes with the rates, the path over ground turns by the side acceleration,
the wind turns as the aircraft yaws. So do the signs of four derivatives, by the conventions of axes and surfaces:
sideslip and rudder push the aircraft aside, the aileron rolls it, the rudder yaws it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.identification.by_input import HISTORY_S, ROWS, STEP_S, spanned
from station.identification.relation_sides import agreement, moved, proportional, rate
from station.profile import Aircraft

Array = NDArray[np.float64]

SURFACES: Final = ("aileron", "rudder")
SIDEWAYS: Final = ("beta_vane", "p", "r", *SURFACES)
"""What side force and the moments of roll and yaw come of."""
NEEDED: Final = frozenset(
    {*SIDEWAYS, "ay", "phi", "psi", "theta", "alpha_vane", "q", "az", "v_north", "v_east", "airspeed"}
) | {"dynamic_pressure"}
"""Signals of these relations."""
ALONE: Final = frozenset({*SURFACES, "psi", "ay"})
"""Signals of no relation but these."""
WITHIN: Final = 4.0
"""Of aircraft of one size, derivatives over their inertia differ less than this, and a profile's from the aircraft's;
the square root of 57, degrees for radians, is more."""
FASTEST_HZ: Final = 25.0
"""Rate of the rows that derivatives are seen in: the motion has nothing beyond half of it."""


class _Effect(NamedTuple):
    """Of `cause` on `response`, by a derivative that is `typical` (per rad) of aircraft whose profile has none."""

    response: str
    cause: str
    typical: float


EFFECTS: Final = {
    "CY_beta": _Effect("ay", "beta_vane", -0.6),
    "CY_dr": _Effect("ay", "rudder", 0.2),
    "Cl_da": _Effect("p", "aileron", -0.1),
    "Cn_dr": _Effect("r", "rudder", -0.1),
}


def relations(
    x: Mapping[str, Array], dt: float, aircraft: Aircraft, pressure: Array | None, history: Array | None
) -> dict[str, float]:
    """Mismatch, 0 to 1, of each relation for which the signals x (SI, no gaps) suffice. `history`: that of the
    surfaces."""
    return {**_kinematic(x, dt), **_wind(x, dt, aircraft), **_aerodynamic(x, dt, aircraft, pressure, history)}


def _kinematic(x: Mapping[str, Array], dt: float) -> dict[str, float]:
    """Of attitude and of the path over ground."""
    there, none = set(x), np.zeros(1)
    phi, q, r = (x.get(n, none) for n in ("phi", "q", "r"))
    theta = np.clip(x.get("theta", none), -1.5, 1.5)
    yawing = q * np.sin(phi) + r * np.cos(phi)
    shares = {}
    if {"p", "phi"} <= there:
        shares["rolling"] = agreement(rate(np.unwrap(phi), dt), moved(x["p"] + np.tan(theta) * yawing, dt))
    if {"r", "phi", "psi"} <= there:
        shares["yawing"] = agreement(rate(np.unwrap(x["psi"]), dt), moved(yawing / np.cos(theta), dt))
    if {"v_north", "v_east", "phi", "az", "ay"} <= there:
        track = np.unwrap(np.arctan2(x["v_east"], x["v_north"]))
        turning = float(np.mean(np.hypot(x["v_north"], x["v_east"]))) * rate(track, dt)
        banked, aside = moved(-x["az"] * np.sin(phi), dt), moved(x["ay"] * np.cos(phi), dt)
        shares["path"] = agreement(turning, banked + aside)
        # Of the two the bank is by far the larger: the side acceleration shows in what it leaves.
        shares["path aside"] = agreement(turning - banked, aside)
    return shares


def _wind(x: Mapping[str, Array], dt: float, aircraft: Aircraft) -> dict[str, float]:
    """Of sideslip, which yaw and the acceleration aside change."""
    if not {"beta_vane", "r", "ay", "airspeed", "phi"} <= set(x):
        return {}
    none, speed = np.zeros(1), np.maximum(x["airspeed"], 1.0)
    theta, alpha = x.get("theta", none), x.get("alpha_vane", none)
    # The vane on its boom moves aside as the aircraft yaws.
    at_cg = x["beta_vane"] - (aircraft.boom.vane_x if aircraft.boom else 0.0) * x["r"] / speed
    turned = x.get("p", none) * np.sin(alpha) - x["r"] * np.cos(alpha)
    pulled = (x["ay"] + G0 * np.sin(x["phi"]) * np.cos(theta)) / speed
    return {"wind": agreement(rate(at_cg, dt), moved(pulled + turned, dt))}


def _aerodynamic(
    x: Mapping[str, Array], dt: float, aircraft: Aircraft, pressure: Array | None, history: Array | None
) -> dict[str, float]:
    """Of the derivatives of EFFECTS, each beside all else that moves its force or moment. By dynamic `pressure`
    (Pa) and the profile their size counts, too, and else the sign alone."""
    every = _rows_apart(dt)
    columns = {n: moved(x[n], dt)[::every] for n in SIDEWAYS if n in x}
    columns = {n: c if history is None else history.T @ c for n, c in columns.items() if c.any()}
    shares = {}
    for name, (response, cause, _) in EFFECTS.items():
        if response not in x or cause not in columns:
            continue
        measured = (moved if response == "ay" else rate)(x[response], dt)[::every]
        answer, own = measured if history is None else history.T @ measured, columns[cause]
        others = [c for n, c in columns.items() if n != cause]
        if others:
            free = np.linalg.qr(np.column_stack(others))[0]
            answer, own = (y - free @ (free.T @ y) for y in (answer, own))
        expected = _expected(name, aircraft, pressure)
        # Where a size is not known, any will do: it is the sign that counts.
        shares[name] = proportional(answer, own, expected or EFFECTS[name].typical, WITHIN if expected else math.inf)
    return shares


def _expected(name: str, aircraft: Aircraft, pressure: Array | None) -> float | None:
    """What a radian of the cause adds to the response, or to its rate; None where the profile does not say."""
    response, geometry, inertia = EFFECTS[name].response, aircraft.geometry, aircraft.inertia
    lever = 1.0 if response == "ay" else geometry.span
    resists = {"ay": inertia.mass, "p": inertia.ixx, "r": inertia.izz}[response]
    if aircraft.kinematics_only or pressure is None or not lever or not resists:
        return None
    typical = EFFECTS[name].typical
    derivative = abs(aircraft.value(name) or typical)
    return float(np.copysign(derivative, typical) * np.mean(pressure) * geometry.wing_area * lever / resists)


def _rows_apart(dt: float) -> int:
    return max(1, round(1 / (FASTEST_HZ * dt)))


def surface_history(x: Mapping[str, Array], dt: float) -> Array | None:
    """An orthonormal basis (rows, columns) of the surfaces' past, which gusts have no part in (by_input.py); the same
    whatever their signs and units. None where rows are too few."""
    every = _rows_apart(dt)
    late = np.arange(0.0, HISTORY_S, max(STEP_S, dt))
    made = []
    for name in SURFACES:
        if name in x and np.ptp(x[name]) > 0:
            t = np.arange(len(x[name])) * dt
            made += [moved(np.interp(t - s, t, x[name] / np.ptp(x[name])), dt)[::every] for s in late]
    if not made or len(made[0]) < ROWS * len(made):
        return None
    return spanned(np.column_stack(made))
