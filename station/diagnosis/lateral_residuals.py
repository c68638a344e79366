"""The lateral sisters of the seven series: bank, heading, speed across, sideslip vane, side force, roll, yaw.

Bank and heading are compared with the integrals of the rates, the speed across the mean heading with that of the
accelerations, the vane with the inertial sideslip at its place; the residual there is the side gust. Side force and
moments are compared with the profile's derivatives, the gust included, and where the profile has a fin, by how much
later that meets gusts and sidewash (station/estimation/side_gust.py). A steady wind across is unknown: nothing rests
on the mean sideslip. Where a side gust changes along the path, air turns along the span, by continuity: S(v, r_g) is
3/8 j w S(v)/V in the inertial range of isotropic turbulence. The rest of what rolls and yaws the air there is noise
(gust_answer.py).

Signals of (..., n) give series of (..., 7, n), measured less predicted: rad, rad, m/s, rad, 1, 1, 1. Moments about the
CG, body axes. Source: Klein and Morelli 2006, chapter 3 and equation 10.6.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.air_data import STILL, Unseen
from station.diagnosis.corrections import all_corrected
from station.diagnosis.memo import Memo
from station.diagnosis.processing import (
    Places,
    Setting,
    at_places,
    back,
    between_fresh,
    integral,
    passed,
    places_of,
    rate,
    transform,
    without_line,
)
from station.diagnosis.residuals import GUST_PASS_HZ, Signals, both_spectra
from station.diagnosis.series_spectra import Spectra
from station.diagnosis.stacked import joined, together
from station.model import coefficients
from station.numerics.second_order import second_order_response
from station.profile import NO_BOOM, Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SERIES: Final = ("bank", "heading", "v_across", "beta_vane", "side_force", "roll", "yaw")
"""In the order of residuals.SERIES: three integrals, the vane, three coefficients."""
COEFFICIENTS: Final = ("CY", "Cl", "Cn")
SPAN_LAG: Final = 0.72
"""Spans over the speed, in which a span follows how the air turns along it: of an isotropic field with an elliptic
loading the ratio of cross-spectrum to spectrum, 3 % off up to 3 Hz at 57 m/s and 20 m."""


class _Motion(NamedTuple):
    """What attitude, rates, acceleration and velocity say, without aerodynamics; each (..., n)."""

    differences: Array
    """(..., 3, n): bank, heading, speed across."""
    beta: Array
    """Inertial sideslip but for its mean, rad."""
    speed: Array
    """(..., 1) mean, m/s."""
    there: Places | None
    again: Places | None
    """See processing.places_of: what comes after a distance is filtered along the path."""
    pdot: Array
    rdot: Array
    ay: Array
    """At the CG."""


class _Flow(NamedTuple):
    """The vane's difference, and the sideslip at the CG with the gust, rad; and how much later the fin's is."""

    vane: Array
    beta: Array
    late: Array
    turning: Array
    """Of the air about the vertical along the span, as far as the side gust tells it, rad/s."""


_OF_MOTION: Final = (
    "theta", "phi", "psi", "p", "q", "r", "ax", "ay", "az", "airspeed", "v_across", "v_ahead", "v_down", "beta_vane",
)  # fmt: skip


def lateral_series(
    signals: Signals, aircraft: Aircraft, s: Setting, unseen: Unseen = STILL, memo: Memo | None = None
) -> Array:
    """The seven differences (..., 7, n) for one candidate; `unseen` and `memo` as residuals.series has them."""
    x, motion, flow, _ = _stages(signals, aircraft, s, unseen, memo or Memo())
    return joined([_kinematic(motion, flow), _forces(x, motion, flow, aircraft)])


def lateral_spectra(signals: Signals, aircraft: Aircraft, s: Setting, unseen: Unseen, memo: Memo) -> Spectra:
    """The spectra of `lateral_series`, those without aerodynamics from the memo where they are there."""
    x, motion, flow, key = _stages(signals, aircraft, s, unseen, memo)
    return both_spectra(lambda: _kinematic(motion, flow), _forces(x, motion, flow, aircraft), s, memo, key)


def _kinematic(motion: _Motion, flow: _Flow) -> Array:
    return joined([motion.differences, flow.vane[..., None, :]])


def _stages(
    signals: Signals, aircraft: Aircraft, s: Setting, unseen: Unseen, memo: Memo
) -> tuple[dict[str, Array], _Motion, _Flow, Hashable]:
    """Corrected signals, motion and flow, and what the kinematic series were made from."""
    found, x = all_corrected(signals, aircraft, s, memo)
    first = (tuple(found.get(n) for n in _OF_MOTION), aircraft.imu_offset, aircraft.unsteady.convection, unseen.along)
    motion = memo.get("motion", first, lambda: _motion(x, aircraft, s, unseen.along))
    seen = (first, aircraft.boom)
    key = (seen, aircraft.fin, aircraft.unsteady.gust_turning)
    return x, motion, memo.get("flow", key, lambda: _flow(x, motion, aircraft, s)), seen


def _motion(x: Mapping[str, Array], aircraft: Aircraft, s: Setting, drift: float) -> _Motion:
    theta, phi, p, q, r = (x[n] for n in ("theta", "phi", "p", "q", "r"))
    pdot, qdot, rdot = rate(p, s), rate(q, s), rate(r, s)
    ax, ay, az = coefficients.specific_force_at_cg(
        (x["ax"], x["ay"], x["az"]), (p, q, r), (pdot, qdot, rdot), aircraft.imu_at(s.imu)
    )
    sin, cos, sin_b, cos_b = np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi)
    turning = (q * sin_b + r * cos_b) / cos
    turned = integral(turning, s)
    heading = x.get("psi", turned)
    off = heading - heading.mean(-1, keepdims=True)
    forward = ax * cos + (ay * sin_b + az * cos_b) * sin
    sideways = ay * cos_b - az * sin_b
    pushed = integral(forward * np.sin(off) + sideways * np.cos(off), s)
    driven = integral(forward * np.cos(off) - sideways * np.sin(off), s)
    if "v_across" in x:
        across = between_fresh(x["v_across"], pushed, s.held.get("v_across"))
        drifted = across - pushed
    else:
        across, drifted = without_line(pushed), np.zeros_like(pushed)
    out = together([phi - integral(p + turning * sin, s), heading - turned, drifted])
    across = across - across.mean(-1, keepdims=True)
    along = between_fresh(x["v_ahead"], driven, s.held.get("v_ahead")) if "v_ahead" in x else without_line(driven)
    speed = x["airspeed"].mean(-1, keepdims=True)
    speed = speed + drift
    along = along - along.mean(-1, keepdims=True) + speed
    # Components of the way through the air in body axes: of the speeds along and across the mean heading, with the
    # angle by which the nose is off it; what sinks shows in the body's side where that is banked.
    ahead, aside = along * np.cos(off) + across * np.sin(off), across * np.cos(off) - along * np.sin(off)
    body = ahead * sin * sin_b + aside * cos_b
    if "v_down" in x:
        body = body + x["v_down"] * cos * sin_b
    # The wind across is what makes the mean sideslip that of the vane.
    body = body - body.mean(-1, keepdims=True) + speed * x["beta_vane"].mean(-1, keepdims=True)
    beta = np.arcsin(np.clip(body / x["airspeed"], -1, 1))
    there, again = places_of(speed + aircraft.unsteady.convection * (along - speed), speed, s)
    return _Motion(out, beta - beta.mean(-1, keepdims=True), speed, there, again, pdot, rdot, ay)


def _flow(x: Mapping[str, Array], motion: _Motion, aircraft: Aircraft, s: Setting) -> _Flow:
    w, v0, boom = s.omega, motion.speed, aircraft.boom or NO_BOOM
    vane_response = second_order_response(boom.vane_frequency, boom.vane_damping, 1j * w)
    at_vane = motion.beta + (x["r"] * boom.vane_x - x["p"] * boom.vane_z) / x["airspeed"]
    vane = x["beta_vane"] - back(transform(at_vane, s) * vane_response, s)
    quick = transform(vane, s) / vane_response * passed(w, GUST_PASS_HZ)
    # A gust travels as a velocity: its angle falls where the airspeed rises.
    slower = v0 / x["airspeed"]
    gust = transform(at_places(back(quick, s) / slower, motion.there), s) * np.exp(-1j * w * boom.gust_x / v0)
    beta = motion.beta + at_places(back(gust, s), motion.again) * slower
    unsteady, fin = aircraft.unsteady, aircraft.fin
    averaged = np.sqrt(1 + (SPAN_LAG * w * aircraft.geometry.span / v0) ** 2)
    turning = at_places(back(gust * 1j * w * unsteady.gust_turning / averaged, s), motion.again)
    if fin is None:
        return _Flow(vane, beta, np.zeros_like(beta), turning)
    arm = fin.arm / v0
    later = at_places(back(gust * (np.exp(-1j * w * arm * fin.penetration) - 1), s), motion.again) * slower
    wash = transform(at_places(beta, motion.there), s) * (np.exp(-1j * w * (arm + fin.sidewash_delay)) - 1)
    late = later - fin.sidewash * (at_places(back(wash, s), motion.again) - x["r"] * arm)
    # Along the span: the fin meets no such turning.
    return _Flow(vane, beta, late + turning * arm * (1 + fin.sidewash), turning)


def _forces(x: Mapping[str, Array], motion: _Motion, flow: _Flow, aircraft: Aircraft) -> Array:
    """Side force, roll and yaw (..., 3, n): the coefficients measured less those of the model."""
    own, span = aircraft.inertia, aircraft.geometry.span
    p, q, r = x["p"], x["q"], x["r"]
    force = x["dynamic_pressure"] * aircraft.geometry.wing_area
    ixx, iyy, izz = (1.0 if i is None else i for i in (own.ixx, own.iyy, own.izz))
    inertia = (ixx, iyy, izz, own.ixz)
    roll, yaw = coefficients.roll_and_yaw_moment(inertia, (p, q, r), motion.pdot, motion.rdot)
    shown = (own.mass * motion.ay / force, roll / (force * span), yaw / (force * span))
    reference = aircraft.reference_speed or motion.speed
    half = 0.5 * span / (reference if aircraft.rate_reference == "fixed" else x["airspeed"])
    by = {"beta": flow.beta, "p": p * half, "r": (r + flow.turning) * half, "da": x["aileron"], "dr": x["rudder"]}
    fin = aircraft.fin
    apart = (0.0, 0.0, 0.0)
    if fin is not None:
        apart = (-fin.lift_slope, -fin.lift_slope * fin.height / span, fin.lift_slope * fin.arm / span)
    made = [
        sum((aircraft.value(f"{c}_{name}") * y for name, y in by.items()), aircraft.value(f"{c}_0") + share * flow.late)
        for c, share in zip(COEFFICIENTS, apart, strict=True)
    ]
    return together([a - b for a, b in zip(shown, made, strict=True)])
