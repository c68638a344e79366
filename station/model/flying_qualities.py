"""What stability and control derivatives make of an aircraft's flying: its modes, margins and elevator per g.

The linear longitudinal motion about level flight, stability axes, of (u/V, alpha, q, theta, height/V): Etkin and Reid,
Dynamics of Flight, 3rd ed., 1996, chapters 4 and 6; Nelson, Flight Stability and Automatic Control, 2nd ed., 1998,
chapters 2 and 4. Beside theirs, the air thins with the height, which quickens a phugoid (of lift alone, omega2 =
2 g2/V2 + g/H), and thrust with it as drag does; and where it leans off the path, thrust carries weight. Where the
profile describes them, lift that follows the angle of attack late and a tail that meets the downwash late are part of
the characteristic equation, as functions of its root. SI; derivatives per radian, rates normalised with q c/2V.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.model.late_lift import INDUCED_DRAG, IYY, MASS, ZERO_LIFT_DRAG, Late, late_of
from station.numerics.indicial import frequency_response
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

DRAWS: Final = 1000
"""Of the derivatives, whose 2.5 and 97.5 per cent points are an interval: known to 0.15 standard deviations."""
MOST_LOST: Final = 0.025
"""Share of the draws without a quantity up to which its interval is that of the others."""
DRAG_SHARE: Final = 0.10
"""Standard deviation of a profile's drag, as diagnosis takes it for a derivative without one; where drag was fitted,
its own counts."""
THRUST_LAWS: Final = (-1.3, 0.1)
"""V dT/dV over T of engines: constant power is -1, a fixed propeller beyond its best speed loses efficiency besides
(McCormick 1995, section 6.2); constant thrust is 0, a jet's ram may add to it."""
_LIGHTEST: Final = 0.1
"""Of mass and inertia: no draw of a normal distribution may be none."""
_GROWING: Final = (0.25, 0.5, 0.75)
_FOLLOWING: Final = 2
"""Shares of the lags on the way to the whole, and steps of Newton's method at each: enough to stay with a root."""
_STEPS: Final = 30
"""Of Newton's method with the whole lags: it needs about five."""
_CLOSE: Final = 1e-9
"""Step, as a share of the root, at which it ends."""
_SETTLED: Final = 1e-4
"""The same from which it counts as settled: no interval is as narrow."""
_SEED: Final = 8785
THRUST_ARM: Final = "thrust arm beyond"
"""m, beside what is drawn of the derivatives."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Level flight: true airspeed (m/s), density (kg/m3), mass (kg), pitch inertia (kg m2), these two a number or (d,),
    angle of attack (rad), and over how many m the density falls by e; infinite: in uniform air."""

    speed: float
    density: float
    mass: Any
    iyy: Any
    alpha: float = 0.0
    scale_height: float = math.inf


@dataclass(frozen=True, slots=True)
class Derived:
    """A quantity with its 95 % interval, or `why` it cannot be known."""

    name: str
    unit: str
    estimate: float = math.nan
    ci95: tuple[float, float] = (math.nan, math.nan)
    why: str = ""
    rests_on: tuple[str, ...] = ()
    """What of the profile it depends on that the flight did not show."""


@dataclass(frozen=True, slots=True)
class Qualities:
    """All that follows from a set of derivatives at a condition."""

    condition: Condition
    quantities: Mapping[str, Derived]
    draws: Mapping[str, Array]
    """Of each quantity, (DRAWS,) or twice that (`mixture`): NaN where that draw has none."""


class Coefficients(NamedTuple):
    """Nondimensional derivatives, each a number or (d,). `_u` is per V/V0, rates and alphadot per c/2V."""

    cl: Any
    cl_u: Any
    cl_alpha: Any
    cl_q: Any
    cl_de: Any
    cd: Any
    cd_u: Any
    cd_alpha: Any
    cm: Any
    """Of the air alone: it balances the thrust's."""
    cm_u: Any
    cm_alpha: Any
    cm_q: Any
    cm_de: Any
    thrust_u: Any
    """V dT/dV over T: 0 for a thrust that does not depend on speed, -1 for constant power."""
    cl_adot: Any = 0.0
    cm_adot: Any = 0.0
    lean: Any = 0.0
    """Tangent of the angle from the path up to the thrust."""


def characteristic(
    c: Coefficients, at: Condition, area: float, chord: float, s: Any = 0.0, late: Late | None = None
) -> Complex:
    """s E - A, (..., 5, 5) of (u/V, alpha, q, theta, height/V), at a root `s`, 1/s; with `late`, its lags there."""
    v, half = at.speed, 0.5 * chord / at.speed
    pressure = 0.5 * at.density * v * v
    lift, moment = pressure * area / (at.mass * v), pressure * area * chord / at.iyy
    cl_alpha, cm_alpha, cl_q, cm_q = c.cl_alpha, c.cm_alpha, c.cl_q, c.cm_q
    if late is not None:
        share, arm = late.tail_slope, late.tail_arm / chord
        wing = 1.0 + late.amplitude * (frequency_response(late.wing, s * late.chord / (v * late.rate)) - 1.0)
        tail = 1.0 - late.downwash * np.exp(-s * (late.tail_arm / v + late.delay)) * wing
        cl_alpha = (cl_alpha - share * (1 - late.downwash)) * wing + share * tail
        cm_alpha = (cm_alpha + share * arm * (1 - late.downwash)) * wing - share * arm * tail
        # The profile's are those of a pitching path without change of incidence and its change together.
        cl_q = cl_q - 2 * share * arm * late.downwash
        cm_q = cm_q + 2 * share * arm * arm * late.downwash
    rows = [
        [s + lift * (2 * c.cd + c.cd_u - c.thrust_u * c.cd), lift * (c.cd_alpha - c.cl), 0.0, G0 / v, 0.0],
        [
            lift * (2 * c.cl + c.cl_u + c.thrust_u * c.cd * c.lean),
            s * (1 + lift * c.cl_adot * half) + lift * (cl_alpha + c.cd),
            lift * cl_q * half - 1.0,
            0.0,
            -lift * (c.cl + c.cd * c.lean) * v / at.scale_height,
        ],
        [
            # At trim the air's moment is less the thrust's, which follows the speed by its own law.
            -moment * (2 * c.cm + c.cm_u - c.thrust_u * c.cm),
            -moment * (s * c.cm_adot * half + cm_alpha),
            s - moment * cm_q * half,
            0.0,
            0.0,
        ],
        [0.0, 0.0, -1.0, s, 0.0],
        [0.0, 1.0, 0.0, -1.0, s],
    ]
    flat = np.broadcast_arrays(*(np.asarray(x, dtype=complex) for row in rows for x in row))
    made = np.stack(flat, axis=-1)
    return np.asarray(made.reshape(*made.shape[:-1], 5, 5), dtype=complex)


def modes(c: Coefficients, at: Condition, area: float, chord: float, late: Late | None = None) -> Complex:
    """The roots (..., 4), 1/s, the largest first: the short period's two, then the phugoid's. The fifth, by which
    heights are left, is far smaller."""
    still = characteristic(c, at, area, chord, 0.0)
    mass = characteristic(c, at, area, chord, 1.0) - still
    roots = np.linalg.eigvals(-np.linalg.solve(mass, still))
    roots = np.take_along_axis(roots, np.argsort(-np.abs(roots), axis=-1), -1)[..., :4]
    if late is None:
        return np.asarray(roots, dtype=complex)
    made: list[Complex] = []
    for k in range(roots.shape[-1]):
        # Two starts of a pair lead to two roots.
        pair = made[k - 1] if k % 2 else None
        made.append(_late_root(c, at, (area, chord), np.asarray(roots[..., k]), late, pair))
    return np.stack(made, axis=-1)


def _late_root(
    c: Coefficients, at: Condition, size: tuple[float, float], start: NDArray[Any], late: Late, other: Complex | None
) -> Complex:
    """What a root becomes as the lags grow: of the characteristic equation, by Newton's method, with `other` divided
    out of it; NaN where it does not settle. Sought with all lags at once it may be another's: the phugoid's, or a
    lag's own."""

    def newton(s: Complex, lags: Late) -> Complex:
        small = 1e-6 * np.abs(s) + 1e-12
        here, ahead, behind = (np.linalg.det(characteristic(c, at, *size, x, lags)) for x in (s, s + small, s - small))
        slope = (ahead - behind) / (2 * small)
        return np.asarray(here / (slope if other is None else slope - here / (s - other)))

    # Where a draw has no such root the steps lead anywhere; it is left out.
    with np.errstate(all="ignore"):
        s = np.array(start, dtype=complex)
        for share in _GROWING:
            for _ in range(_FOLLOWING):
                s = s - newton(s, late.grown(share, at.speed))
        for _ in range(_STEPS):
            step = newton(s, late)
            s = s - step
            if (np.abs(step) < _CLOSE * np.abs(s)).all():
                break
    return np.asarray(np.where(np.abs(step) < _SETTLED * np.abs(s), s, np.nan))


def frequency_and_damping(one: Complex, other: Complex) -> tuple[Array, Array]:
    """Undamped frequency (rad/s) and damping ratio of two roots; NaN unless they are a pair, or both real and of one
    sign: two real roots of a stable aircraft have a ratio above 1."""
    product, total = one * other, one + other
    good = np.isfinite(product) & (np.abs(product.imag) < 1e-6 * np.abs(product)) & (product.real > 0)
    omega = np.sqrt(np.where(good, product.real, np.nan))
    return omega, -0.5 * total.real / omega


class Pull(NamedTuple):
    """A steady pull-up at constant speed, per radian of elevator: angle of attack, and load factor, g."""

    alpha: Any
    load: Any


def pull_up(c: Coefficients, at: Condition, area: float, chord: float, late: Late | None = None) -> Pull:
    """The rows of lift and moment at rest, solved for alpha and q."""
    still = characteristic(c, at, area, chord, 0.0, late)[..., 1:3, 1:3].real
    pressure = 0.5 * at.density * at.speed**2
    forced = [
        -pressure * area / (at.mass * at.speed) * np.asarray(c.cl_de),
        pressure * area * chord / at.iyy * np.asarray(c.cm_de),
    ]
    right = np.stack(np.broadcast_arrays(*forced), axis=-1)[..., None]
    alpha, q = np.moveaxis(np.linalg.solve(still, np.broadcast_to(right, (*still.shape[:-1], 1)))[..., 0], -1, 0)
    return Pull(alpha, at.speed * q / G0)


def coefficients(aircraft: Aircraft, at: Condition, drawn: Mapping[str, Any], drag: Any, thrust_u: Any) -> Coefficients:
    """With the derivatives `drawn` in place of the profile's, slopes at the condition's angle of attack, and its drag
    times `drag`; those of CZ count as body axes, whose Z force is that of lift and drag."""

    def of(name: str) -> Any:
        return drawn.get(name, aircraft.value(name))

    area, v = aircraft.geometry.wing_area, at.speed
    weight = at.mass * G0 / (0.5 * at.density * v * v * area)
    per_speed = v / (aircraft.reference_speed or v)
    lean = math.tan(at.alpha + aircraft.thrust_angle)
    in_body = "CZ_alpha" in drawn
    lift = {x: -of(f"CZ_{x}") if in_body else of(f"CL_{x}") for x in ("alpha", "q", "de")}
    if aircraft.drag is not None:
        zero = np.maximum(aircraft.drag.zero_lift + drawn.get(ZERO_LIFT_DRAG, 0.0), 0.0)
        induced = aircraft.drag.induced * np.maximum(drawn.get(INDUCED_DRAG, 1.0), 0.0)
        # The thrust's part of the weight is small: once over is enough.
        cl = weight - drag * (zero + induced * weight * weight) * lean
        cd, cd_u, along = drag * (zero + induced * cl * cl), 0.0, 2 * induced * cl
    else:
        cd_u = drag * of("CD_V") * per_speed
        cd, along = drag * (of("CD_0") + of("CD_alpha") * at.alpha) + cd_u, 0.0
        cl = weight - cd * lean
    slope = lift["alpha"] - cd if in_body else lift["alpha"]
    balance = -cd * (aircraft.thrust_pitch_arm + drawn.get(THRUST_ARM, 0.0)) / aircraft.geometry.chord
    return Coefficients(
        cl=cl,
        cl_u=of("CL_V") * per_speed,
        cl_alpha=slope,
        cl_q=lift["q"],
        cl_de=lift["de"],
        cd=cd,
        cd_u=cd_u,
        cd_alpha=drag * along * slope if aircraft.drag is not None else drag * of("CD_alpha"),
        cm=balance,
        cm_u=of("Cm_V") * per_speed,
        cm_alpha=of("Cm_alpha"),
        cm_q=of("Cm_q"),
        cm_de=of("Cm_de"),
        thrust_u=thrust_u,
        lean=lean,
    )


def bend(aircraft: Aircraft, coefficient: str, alpha: float) -> float:
    """By how much the slope of CL or Cm over the angle of attack (rad) is more there than at zero."""
    square, cube = (aircraft.value(f"{coefficient}_alpha{k}") for k in (2, 3))
    return 2 * square * alpha + 3 * cube * alpha**2


_LOADING: Final = "iyy over mass"
_BY_SENSOR: Final = "elevator scale"
_ASKED: Final[Mapping[str, tuple[str, tuple[str, ...], tuple[str, ...]]]] = {
    "short_period_frequency": ("rad/s", ("alpha", "q"), ()),
    "short_period_damping": ("1", ("alpha", "q"), ()),
    "phugoid_frequency": ("rad/s", ("alpha", "q"), ("drag", "thrust", "speed derivatives")),
    "phugoid_damping": ("1", ("alpha", "q"), ("drag", "thrust", "speed derivatives")),
    "n_per_alpha": ("1/rad", ("alpha", "q", "de"), ()),
    "control_anticipation": ("1/s2", ("alpha", "q", "de"), ()),
    "static_margin": ("1", ("alpha",), (_LOADING,)),
    "neutral_point": ("m", ("alpha",), (_LOADING,)),
    "manoeuvre_margin": ("1", ("alpha", "q"), (_LOADING,)),
    "elevator_per_g": ("rad", ("alpha", "q", "de"), (_BY_SENSOR,)),
}
"""Unit of each quantity, the derivatives it is made of, and what of the profile it rests on. Mass and inertia cancel
where the derivatives were found with the same ones. The neutral point is behind the CG; margins are in chords. A wrong
scale of the elevator's sensor and control derivatives that are wrong by as much cannot be told apart."""


# Drawn derivatives may leave a pull-up without load or angle: what follows is then infinite, and unestimated.
@np.errstate(divide="ignore", invalid="ignore")
def _quantities(c: Coefficients, at: Condition, area: float, chord: float, late: Late | None) -> dict[str, Array]:
    roots = modes(c, at, area, chord, late)
    (omega, zeta), (slow, slow_zeta) = (frequency_and_damping(roots[..., k], roots[..., k + 1]) for k in (0, 2))
    pulled = pull_up(c, at, area, chord, late)
    n_alpha = pulled.load / pulled.alpha
    margin = -c.cm_alpha / c.cl_alpha
    cm_q, cl_q = c.cm_q, c.cl_q
    if late is not None:
        cm_q = cm_q + 2 * late.tail_slope * (late.tail_arm / chord) ** 2 * late.downwash
        cl_q = cl_q - 2 * late.tail_slope * late.tail_arm / chord * late.downwash
    # Relative density of a steady pull-up: Etkin and Reid, section 3.1.
    density = 4 * at.mass / (at.density * area * chord)
    return {
        "short_period_frequency": omega,
        "short_period_damping": zeta,
        "phugoid_frequency": slow,
        "phugoid_damping": slow_zeta,
        "n_per_alpha": n_alpha,
        "control_anticipation": omega**2 / n_alpha,
        "static_margin": margin,
        "neutral_point": margin * chord,
        "manoeuvre_margin": margin - cm_q / (density - cl_q),
        "elevator_per_g": 1.0 / pulled.load,
    }


def qualities(
    aircraft: Aircraft, at: Condition, found: Mapping[str, float], covariance: NDArray[Any], late: bool = True,
    loading: tuple[float, float] = (0.0, 0.0), apart: Mapping[str, float] = {},
) -> Qualities:  # fmt: skip
    """All quantities of `found` derivatives, CL or CZ and Cm, in whose order `covariance` (n, n) is; `late`: whether
    they are those of an unsteady aircraft, with the profile's lags apart. Not in the covariance: `loading`, relative
    standard errors of mass and inertia, and `apart`, those of THRUST_ARM (m) and CL_V, left out the profile's. What is
    missing among the derivatives is not known."""
    rng = np.random.default_rng(_SEED)
    names, size = tuple(found), (aircraft.geometry.wing_area, aircraft.geometry.chord)
    own = late_of(aircraft) if late else None
    mean = np.array([found[n] for n in names])
    # A covariance from a fit is positive but for its rounding.
    even = 0.5 * (covariance + covariance.T)
    moved = rng.multivariate_normal(0.0 * mean, even, DRAWS, check_valid="ignore", method="eigh") if names else mean
    cloud = np.vstack([mean, mean + moved])
    unknown = 0.0 if ZERO_LIFT_DRAG in found else DRAG_SHARE
    drag = np.concatenate([[1.0], np.maximum(1.0 + unknown * rng.standard_normal(DRAWS), 0.0)])
    thrust = np.concatenate([[np.mean(THRUST_LAWS)], rng.uniform(*THRUST_LAWS, DRAWS)])
    # Forces were found as mass times acceleration, moments as inertia times angular acceleration: the motion is the
    # same whatever both are, the ratio of moment to lift is not.
    share = np.exp(np.asarray(loading)[:, None] * rng.standard_normal((2, DRAWS)))
    unsure = {_LOADING: np.append(1.0, share[1] / share[0])}
    unsure[_BY_SENSOR] = np.exp(aircraft.uncertainty.surface_scale * np.append(0.0, rng.standard_normal(DRAWS)))
    force = "CZ" if "CZ_alpha" in found else "CL"
    made: dict[str, Array] = {}
    if {f"{force}_alpha", "Cm_alpha"} <= found.keys():
        drawn = {n: cloud[:, k] for k, n in enumerate(names)}
        doubt = {THRUST_ARM: aircraft.uncertainty.thrust_arm * size[1], "CL_V": aircraft.uncertainty.CL_V, **apart}
        for what, middle in ((THRUST_ARM, 0.0), ("CL_V", aircraft.value("CL_V"))):
            drawn[what] = middle + doubt[what] * np.append(0.0, rng.standard_normal(DRAWS))
        mass, iyy = (np.maximum(drawn.get(n, 1.0), _LIGHTEST) for n in (MASS, IYY))
        there = replace(at, mass=mass * at.mass, iyy=iyy * at.iyy)
        own = own.drawn(drawn) if own is not None else None
        made = _quantities(coefficients(aircraft, there, drawn, drag, thrust), there, *size, own)
    no_drag = aircraft.drag is None and not aircraft.value("CD_0") and not aircraft.value("CD_V")
    out, draws = {}, {}
    for name, (unit, needs, rests) in _ASKED.items():
        # CL_q is next to nothing beside 4m/(rho S c): where it is not found, it is the profile's.
        lacking = [
            f"{c}_{x}" for x in needs for c in (force, "Cm") if (c, x) != (force, "q") and f"{c}_{x}" not in found
        ]
        if lacking:
            out[name] = Derived(name, unit, why=f"{', '.join(lacking)} not estimated")
        elif no_drag and "drag" in rests:
            out[name] = Derived(name, unit, why="the profile gives no drag")
        else:
            values = np.asarray(made[name] * math.prod(unsure.get(x, 1.0) for x in rests))
            draws[name] = values[1:]
            out[name] = _judged(name, unit, values, rests)
    return Qualities(at, out, draws)


def mixture(one: Qualities, other: Qualities) -> Qualities:
    """Of an aircraft that is one of two, each as likely, at the same speed: the estimates and the condition of the
    first, the draws of both, and intervals from these."""
    draws = {n: np.concatenate([x, other.draws.get(n, x)]) for n, x in one.draws.items()}
    told = {
        n: _judged(n, d.unit, np.concatenate([[d.estimate], draws[n]]), d.rests_on) if n in draws else d
        for n, d in one.quantities.items()
    }
    return replace(one, quantities=told, draws=draws)


def _judged(name: str, unit: str, x: Array, rests: Sequence[str]) -> Derived:
    """From the estimate, first, and its draws."""
    lost = float(np.mean(~np.isfinite(x[1:])))
    if not np.isfinite(x[0]):
        return Derived(name, unit, why="it does not oscillate: its roots are real, or one of them is unstable")
    if lost > MOST_LOST:
        return Derived(name, unit, why=f"for {100 * lost:.0f} % of what the data allow it does not oscillate")
    low, high = np.nanpercentile(x[1:], (2.5, 97.5))
    return Derived(name, unit, float(x[0]), (float(low), float(high)), "", tuple(rests))
