"""The aircraft as the equations of motion take it: trimmed, its constants in one flat value, its indicial responses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.numerics.atmosphere import atmosphere
from station.profile import Aircraft, Indicial
from station.rows import ProfileError
from station.simulation import stalling

_SUPPORTED: Final = frozenset(
    {f"{c}_{x}" for c in ("CL", "Cm") for x in ("0", "V", "alpha", "alpha2", "alpha3", "q", "de", "gust")}
    | {"CD_0", "CD_V", "CD_alpha"}
)


class Constants(NamedTuple):
    """Everything the equations of motion need, SI; one flat value so that compiled code can take it."""

    mass: float
    iyy: float
    area: float
    chord: float
    cl_trim: float
    cl_v: float
    cl_alpha: float
    cl_alpha2: float
    """Per rad2 of alpha itself, not from trim, and quasi-steady; alpha3 and Cm alike."""
    cl_alpha3: float
    cl_q: float
    cl_de: float
    cl_gust: float
    """Beyond CL_alpha, per rad of the gust's part of alpha at the CG; Cm alike."""
    cm_trim: float
    cm_v: float
    cm_alpha: float
    cm_alpha2: float
    cm_alpha3: float
    cm_q: float
    cm_de: float
    cm_gust: float
    cd_0: float
    cd_v: float
    cd_alpha: float
    cd_induced: float
    reference_speed: float
    fixed_rate_reference: float
    """1: rates are normalised with the reference speed, 0: with the airspeed of the instant."""
    fixed_density: float
    """kg/m3; 0: standard atmosphere at the height flown."""
    thrust_cos: float
    thrust_sin: float
    thrust_arm: float
    unsteady: float
    """1: unsteady lift and a tail that meets the gust late; 0: quasi-steady, everything at the CG."""
    indicial_chord: float
    tail_slope: float
    tail_arm: float
    gust_arm: float
    """How far behind the CG the tail meets a gust, m."""
    gust_edge: float
    """How far ahead of the CG the wing does, m."""
    downwash: float
    downwash_delay: float
    separates: float
    """1: the flow leaves the wing, 0: it stays attached at every angle of attack."""
    alpha_star: float
    no_lift: float
    """alpha_0."""
    sharpness: float
    """a1, per rad."""
    separation_lag: float
    """tau1, chords travelled."""
    return_delay: float
    """tau2, the same."""
    leave_delay: float
    """tau2_rising."""
    cl_separating: float
    """CL per angle of attack of the wing, whose flow leaves."""
    cl_lost_trim: float
    """CL that the separation takes in trim."""
    cd_separated: float
    cm_separated: float
    actuator_lag: float
    actuator_rate: float
    actuator_limit: float
    elevator_backlash: float
    """Half of the backlash between the elevator's drive, where its sensor is, and its surface, rad."""
    trim_alpha: float
    trim_elevator: float
    trim_thrust: float
    trim_speed: float
    wanted_speed: float
    """True airspeed that the pilot holds, m/s."""
    trim_height: float
    hold_speed: float
    """Thrust acceleration per speed error, 1/s."""
    hold_height: float
    """Thrust acceleration per height error, 1/s2."""
    hold_lag: float


@dataclass(frozen=True, slots=True)
class Trim:
    """Steady level flight: rad, N, and the lift coefficient."""

    alpha: float
    elevator: float
    thrust: float
    lift_coefficient: float


# The pilot holds speed and height with thrust alone, through a 3 s engine and hand lag: the elevator stays free for the
# test input, so nothing correlates with alpha or q in the identification band. Speed feedback damps the phugoid
# (0.04 Hz, ratio about 0.4); height feedback brings a climb back within about a minute.
HOLD_SPEED: Final = 0.20
HOLD_HEIGHT: Final = 0.004
HOLD_LAG: Final = 3.0


def _separating(aircraft: Aircraft) -> float:
    """What flow takes with it when it leaves is the wing's lift, not the tail's."""
    tail = aircraft.unsteady
    of_tail = tail.tail_lift_slope * (1.0 - tail.downwash) if tail.memory else 0.0
    return aircraft.value("CL_alpha") - of_tail


def _lost(aircraft: Aircraft, alpha: float) -> float:
    """CL that the separation takes at a lasting `alpha` (rad)."""
    _, left = stalling.steady(aircraft.separation, alpha)
    return _separating(aircraft) * (1.0 - left) * (alpha - aircraft.separation.alpha_0)


def _steady(aircraft: Aircraft, speed: float, alpha: float, de: float, q: float = 0.0) -> tuple[float, float, float]:
    """CL, CD, Cm in steady flight at a pitch rate (rad/s)."""
    v = aircraft.value
    ratio = speed / (aircraft.reference_speed or speed)
    fixed = aircraft.reference_speed if aircraft.rate_reference == "fixed" else None
    qhat = 0.5 * q * aircraft.geometry.chord / (fixed or speed)
    cl = v("CL_0") + v("CL_V") * ratio + v("CL_alpha") * alpha + v("CL_de") * de + v("CL_q") * qhat
    cm = v("Cm_0") + v("Cm_V") * ratio + v("Cm_alpha") * alpha + v("Cm_de") * de + v("Cm_q") * qhat
    cl += v("CL_alpha2") * alpha**2 + v("CL_alpha3") * alpha**3
    cm += v("Cm_alpha2") * alpha**2 + v("Cm_alpha3") * alpha**3
    attached, _ = stalling.steady(aircraft.separation, alpha)
    cl -= _lost(aircraft, alpha)
    cm += aircraft.separation.Cm_X * (1.0 - attached)
    behind = aircraft.separation.CD_X * (1.0 - attached)
    if aircraft.drag is not None:
        return cl, aircraft.drag.zero_lift + aircraft.drag.induced * cl * cl + behind, cm
    return cl, v("CD_0") + v("CD_V") * ratio + v("CD_alpha") * alpha + behind, cm


_TRIMMED: Final = 1e-9
"""Imbalance that a trim may have: forces in weights, and the moment coefficient."""
_LEAST_STEP: Final = 1e-13
"""Imbalance at which Newton's method ends: the rounding of the coefficients."""
_SINGULAR: Final = 1e-12
_LARGEST_ALPHA: Final = 0.4
"""rad: beyond it the profile's derivatives describe nothing."""


def find_trim(aircraft: Aircraft, speed: float, height: float, bank: float = 0.0) -> Trim:
    """Steady level flight at a true airspeed (m/s) and height (m), by Newton's method on (alpha, elevator, thrust).

    With a bank (rad) a coordinated turn, whose load factor is 1/cos(bank) and pitch rate g/V sin(bank) tan(bank).
    Raises ProfileError if there is none.
    """
    load, q = 1.0 / math.cos(bank), G0 / speed * math.sin(bank) * math.tan(bank)
    density = aircraft.air_density or atmosphere(height)[2]
    weight = aircraft.inertia.mass * G0
    scale = 0.5 * density * speed**2 * aircraft.geometry.wing_area

    def imbalance(x: NDArray[np.float64]) -> NDArray[np.float64]:
        alpha, de, thrust = float(x[0]), float(x[1]), float(x[2]) * weight
        cl, cd, cm = _steady(aircraft, speed, alpha, de, q)
        line = alpha + aircraft.thrust_angle
        return np.array(
            [
                (thrust * math.cos(line) - scale * cd) / weight,
                (thrust * math.sin(line) + scale * cl) / weight - load,
                cm + thrust * aircraft.thrust_pitch_arm / (scale * aircraft.geometry.chord),
            ]
        )

    x = np.array([0.05, 0.0, 0.1])
    step = 1e-6
    for _ in range(20):
        f = imbalance(x)
        if np.abs(f).max() < _LEAST_STEP:
            break
        jacobian = np.empty((3, 3))
        for j in range(3):
            d = np.zeros(3)
            d[j] = step
            jacobian[:, j] = (imbalance(x + d) - imbalance(x - d)) / (2 * step)
        if abs(np.linalg.det(jacobian)) < _SINGULAR:
            raise ProfileError(f"aircraft {aircraft.name}: cannot be trimmed: CL_alpha and Cm_de must not be 0")
        x = x - np.linalg.solve(jacobian, f)
    alpha, de, thrust = float(x[0]), float(x[1]), float(x[2]) * weight
    is_sound = np.abs(imbalance(x)).max() < _TRIMMED and abs(alpha) < _LARGEST_ALPHA
    if not is_sound or abs(de) >= aircraft.elevator.position_limit or thrust < -_TRIMMED * weight:
        raise ProfileError(
            f"aircraft {aircraft.name}: no trim at {speed:.1f} m/s, {height:.0f} m "
            f"(alpha {math.degrees(alpha):.1f} deg, elevator {math.degrees(de):.1f} deg, thrust {thrust:.0f} N)"
        )
    return Trim(alpha, de, thrust, _steady(aircraft, speed, alpha, de, q)[0])


def _stated(aircraft: Aircraft, speed: float, about: Trim) -> Trim:
    """With the lift that this aircraft has there."""
    return replace(about, lift_coefficient=_steady(aircraft, speed, about.alpha, about.elevator)[0])


def _moment(aircraft: Aircraft, speed: float, trim: Trim) -> float:
    """Cm there, with the flow attached."""
    v, alpha = aircraft.value, trim.alpha
    return (
        v("Cm_0")
        + v("Cm_V") * speed / (aircraft.reference_speed or speed)
        + v("Cm_alpha") * alpha
        + v("Cm_alpha2") * alpha**2
        + v("Cm_alpha3") * alpha**3
        + v("Cm_de") * trim.elevator
    )


def _pitch_inertia(aircraft: Aircraft) -> float:
    """kg m2. Raises ProfileError for an aircraft that cannot be simulated."""
    if aircraft.inertia.iyy is None:
        raise ProfileError(f"aircraft {aircraft.name}: inertia.iyy: missing; the simulation needs it")
    for name, derivative in aircraft.derivatives.items():
        if name[:2] in ("CL", "CD", "Cm") and name not in _SUPPORTED and derivative.value != 0:
            raise ProfileError(f"aircraft {aircraft.name}: derivatives.{name}: the simulation has no such term")
    return aircraft.inertia.iyy


def _of_separation(aircraft: Aircraft, trim_alpha: float) -> dict[str, float]:
    """Those of Constants that say how the flow leaves the wing."""
    leaving = aircraft.separation
    return {
        "separates": float(leaving.alpha_star is not None),
        "alpha_star": leaving.alpha_star or 0.0,
        "no_lift": leaving.alpha_0,
        "sharpness": leaving.a1,
        "separation_lag": leaving.tau1,
        "return_delay": leaving.tau2,
        "leave_delay": leaving.tau2_rising,
        "cl_separating": _separating(aircraft),
        "cl_lost_trim": _lost(aircraft, trim_alpha),
        "cd_separated": leaving.CD_X,
        "cm_separated": leaving.Cm_X,
    }


def constants(
    aircraft: Aircraft,
    speed: float,
    height: float,
    hold: bool = True,
    backlash: float = 0.0,
    about: Trim | None = None,
    wanted: float | None = None,
) -> Constants:
    """The equations' constants for an aircraft trimmed at that true airspeed (m/s) and height (m).

    `hold` lets the pilot hold both with thrust; `backlash` is the elevator's (whole, rad); `about`: angle of attack and
    elevator that the equations are stated about, and the thrust that the pilot holds from, where they are another
    aircraft's trim; `wanted`: the speed that he holds where it is another, m/s. Raises ProfileError for an aircraft
    that cannot be simulated.
    """
    iyy = _pitch_inertia(aircraft)
    trim = _stated(aircraft, speed, about) if about else find_trim(aircraft, speed, height)
    v, unsteady, drag = aircraft.value, aircraft.unsteady, aircraft.drag
    return Constants(
        mass=aircraft.inertia.mass,
        iyy=iyy,
        area=aircraft.geometry.wing_area,
        chord=aircraft.geometry.chord,
        cl_trim=trim.lift_coefficient,
        cl_v=v("CL_V"),
        cl_alpha=v("CL_alpha"),
        cl_alpha2=v("CL_alpha2"),
        cl_alpha3=v("CL_alpha3"),
        cl_q=v("CL_q"),
        cl_de=v("CL_de"),
        cl_gust=v("CL_gust"),
        cm_trim=_moment(aircraft, speed, trim),
        cm_v=v("Cm_V"),
        cm_alpha=v("Cm_alpha"),
        cm_alpha2=v("Cm_alpha2"),
        cm_alpha3=v("Cm_alpha3"),
        cm_q=v("Cm_q"),
        cm_de=v("Cm_de"),
        cm_gust=v("Cm_gust"),
        cd_0=drag.zero_lift if drag else v("CD_0"),
        cd_v=0.0 if drag else v("CD_V"),
        cd_alpha=0.0 if drag else v("CD_alpha"),
        cd_induced=drag.induced if drag else 0.0,
        reference_speed=aircraft.reference_speed or speed,
        fixed_rate_reference=float(aircraft.rate_reference == "fixed"),
        fixed_density=aircraft.air_density or 0.0,
        thrust_cos=math.cos(aircraft.thrust_angle),
        thrust_sin=math.sin(aircraft.thrust_angle),
        thrust_arm=aircraft.thrust_pitch_arm,
        unsteady=float(unsteady.memory),
        indicial_chord=unsteady.reference_chord or aircraft.geometry.chord,
        tail_slope=unsteady.tail_lift_slope,
        tail_arm=unsteady.tail_arm,
        gust_arm=unsteady.tail_arm * unsteady.tail_penetration,
        gust_edge=aircraft.gust_edge,
        downwash=unsteady.downwash,
        downwash_delay=unsteady.downwash_delay,
        **_of_separation(aircraft, trim.alpha),
        actuator_lag=aircraft.elevator.time_constant,
        actuator_rate=aircraft.elevator.rate_limit,
        actuator_limit=aircraft.elevator.position_limit,
        elevator_backlash=0.5 * backlash,
        trim_alpha=trim.alpha,
        trim_elevator=trim.elevator,
        trim_thrust=trim.thrust,
        trim_speed=speed,
        wanted_speed=wanted or speed,
        trim_height=height,
        hold_speed=HOLD_SPEED if hold else 0.0,
        hold_height=HOLD_HEIGHT if hold else 0.0,
        hold_lag=HOLD_LAG,
    )


class Tables(NamedTuple):
    """Indicial responses, each (2, n): amplitudes, and exponents per chord travelled."""

    lift_motion: NDArray[np.float64]
    lift_gust: NDArray[np.float64]
    upwash_motion: NDArray[np.float64]
    upwash_gust: NDArray[np.float64]


def indicial_tables(aircraft: Aircraft, averaged: bool = False) -> Tables:
    """The aircraft's four indicial responses; those to gusts, of lift and so of upwash, behind the wing's averaging of
    them along its span, unless they are `averaged` already."""
    u = aircraft.unsteady
    responses = (u.lift_motion, u.lift_gust, u.upwash_motion, u.upwash_gust)
    tables = Tables(*(indicial_table(response) for response in responses))
    if averaged:
        return tables
    span = u.gust_span / (u.reference_chord or aircraft.geometry.chord)
    return tables._replace(
        lift_gust=span_averaged(tables.lift_gust, span), upwash_gust=span_averaged(tables.upwash_gust, span)
    )


def indicial_table(indicial: Indicial | None) -> NDArray[np.float64]:
    """(2, n): amplitudes, and exponents per chord travelled; n = 0 for a quasi-steady response."""
    return np.array([indicial.a, indicial.b]) if indicial else np.zeros((2, 0))


def span_averaged(table: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """A response to gusts, (2, n), behind a first-order lag of `length` chords travelled, (2, n + 1).

    The wing meets the mean of the gusts along its span. That of a sum of exponentials behind the lag is again one:
    1 - sum a b'/(b' - b) exp(-b t) - (1 - sum a b'/(b' - b)) exp(-b' t), b' = 1/length.
    """
    if length <= 0:
        return table
    b = 1.0 / length
    own = np.where(np.abs(b - table[1]) < 1e-6 * b, table[1] * (1 + 2e-6), table[1])
    a = table[0] * b / (b - own)
    return np.array([[*a, 1.0 - a.sum()], [*own, b]])
