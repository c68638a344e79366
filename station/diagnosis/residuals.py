"""Seven series in which measured and predicted flight are compared, and their spectra.

Three compare instruments with each other, without aerodynamics: attitude against the integral of the pitch rate,
vertical and horizontal speed against the integrals of the accelerations. One compares the vane with what the inertial
motion would show there; the residual is the gust. Lift, moment and drag compare forces with the aircraft's model, the
gust of the vane included. Integrals, not derivatives: noise that is white in a sensor stays bounded.

An effect is removed from the measured signals (the inverse of what the sensor did) or put into the model; both come
from the aircraft's profile, so a candidate is nothing but another profile. What a candidate scales, it scales
the noise of too (sensor_noise.py): no scale explains by shrinking the noise.

All functions take leading axes: signals of (..., n) give series of (..., 7, n).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.conventions import SEA_LEVEL_DENSITY
from station.diagnosis.air_data import STILL, Unseen
from station.diagnosis.attached_flow import attached_along
from station.diagnosis.corrections import all_corrected
from station.diagnosis.inertial_motion import OF_MOTION, Motion, motion_of
from station.diagnosis.memo import Memo
from station.diagnosis.processing import (
    Places,
    Setting,
    at_places,
    back,
    passed,
    places_of,
    transform,
)
from station.diagnosis.series_spectra import Spectra, spectra
from station.diagnosis.span_lags import span_response
from station.diagnosis.stacked import joined, some, together
from station.model import coefficients
from station.numerics.indicial import frequency_response, response
from station.numerics.second_order import second_order_response
from station.numerics.separation import lift_left, of_wing
from station.profile import NO_BOOM, Aircraft, Boom, Unsteady

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Signals = Mapping[str, Any]

SERIES: Final = ("theta", "v_down", "v_north", "alpha_vane", "lift", "moment", "drag")
THETA, DOWN, NORTH, VANE, LIFT, MOMENT, DRAG = range(7)
GUST_PASS_HZ: Final = (4.0, 6.0)
"""The gust from the vane is passed up to the first and stopped from the second."""
SPEED_SPANS: Final = (10.0, 5.0)
"""Wavelengths of the speed that lift and moment depend on, in spans: as long as the first are passed, of those as short
as the second the share Unsteady.speed_gusts. Of shorter gusts the pitot shows one point: the wing meets their mean over
the span, and what the two differ by, made a coefficient with the pitot's pressure, would be found as a dependence on
speed."""


class _Path(NamedTuple):
    """The inertial flow angle along the path, and what a gust along the path makes of it."""

    v0: Array
    inertial: Array
    there: Places | None
    again: Places | None
    alpha_i: Array
    along: Complex
    lying: Array
    """By how much gusts across the path lie back from square to it, rad."""
    across: Array
    """See Motion."""
    square: Array
    """Of the velocity the part square to gusts across, over the mean speed."""
    moved: Array
    surging: Complex
    """What gusts along the path make of the airspeed, over it."""
    turned_mean: Complex
    """How that turns the flow of the mean angle of attack: at once, for the normal wash and the circulation stay."""
    turned_moving: Complex
    """The same of the motion's part."""


class _Shown(NamedTuple):
    """What the vane shows beyond the inertial motion."""

    vane: Array
    """The difference VANE."""
    gust: Complex
    """At the CG, along the path, over the mean speed: what stays the same from the vane to the tail is a velocity."""
    gust_wing: Complex
    """The same at the wing's leading edge, averaged along the span."""


class _Flow(NamedTuple):
    """The flow angle and the gust at wing and tail, and the vane's difference."""

    v0: Array
    alpha_i: Array
    gust: Array
    wing: Array
    """The flow angle through the wing's indicial response; empty for quasi-steady lift."""
    tail: Array
    vane: Array
    """The difference VANE."""


def series(signals: Signals, aircraft: Aircraft, s: Setting, unseen: Unseen = STILL, memo: Memo | None = None) -> Array:
    """The seven differences (..., 7, n), measured less predicted, for one candidate `aircraft`.

    `unseen`: of the air and of noise, what no instrument shows. Units of the result:
    rad, m/s, m/s, rad, 1, 1, 1; a series that cannot be judged is still filled, from what there is. With a `memo` of
    these signals and this setting, what earlier candidates share is taken from there.
    """
    memo = memo or Memo()
    x, motion, flow, _ = _stages(signals, aircraft, s, unseen, memo)
    return joined([_kinematic(motion, flow), _forces(x, motion, flow, aircraft, s)])


def series_spectra(signals: Signals, aircraft: Aircraft, s: Setting, unseen: Unseen, memo: Memo) -> Spectra:
    """The spectra of `series`, those without aerodynamics from the memo where they are there."""
    x, motion, flow, key = _stages(signals, aircraft, s, unseen, memo)
    return both_spectra(lambda: _kinematic(motion, flow), _forces(x, motion, flow, aircraft, s), s, memo, key)


def both_spectra(kinematic: Callable[[], Array], forces: Array, s: Setting, memo: Memo, key: Hashable) -> Spectra:
    """Of the series judged: the kinematic ones, from the memo where `key` is there, and coefficients (..., 3, n)."""
    count = sum(j < LIFT for j in s.judged)
    first = memo.get("spectra", key, lambda: spectra(kinematic(), s, s.judged[:count]))
    last = spectra(forces, s, tuple(j - LIFT for j in s.judged[count:]), False)
    bins = joined([first.bins, last.bins])
    return Spectra(bins, joined([first.steady, last.steady], -1))


def flow_angle(signals: Signals, aircraft: Aircraft, s: Setting, memo: Memo) -> Array:
    """The angle of attack at the CG (..., n), the gust of the vane included."""
    _, _, flow, _ = _stages(signals, aircraft, s, STILL, memo)
    return np.asarray(flow.alpha_i + flow.gust)


def gust_across(signals: Signals, aircraft: Aircraft, s: Setting) -> Array:
    """How far gusts turn the flow at the CG (n,) by the vane, about their mean, rad."""
    gust = _stages(signals, aircraft, s, STILL, Memo())[2].gust
    return np.asarray(gust - gust.mean(-1, keepdims=True))


def _kinematic(motion: Motion, flow: _Flow) -> Array:
    return joined([motion.differences, flow.vane[..., None, :]])


def _stages(
    signals: Signals, aircraft: Aircraft, s: Setting, unseen: Unseen, memo: Memo
) -> tuple[dict[str, Array], Motion, _Flow, Hashable]:
    """Corrected signals, motion and flow, and what they were made from."""
    found, x = all_corrected(signals, aircraft, s, memo)
    unsteady, chord = aircraft.unsteady, aircraft.geometry.chord
    first = (tuple(found.get(n) for n in OF_MOTION), aircraft.imu_offset, unseen.noise, unseen.up, unsteady.gust_tilt)
    motion = memo.get("motion", first, lambda: motion_of(x, aircraft, s, unseen))
    on_path = (first, unseen.along, unsteady.convection, unsteady.turned_at_once)
    path = memo.get("path", on_path, lambda: _path(motion, unsteady, s, unseen.along))
    spread = (unsteady.gust_span, unsteady.gust_span_shape, unsteady.gust_span_cut, unsteady.gust_speed)
    of_wing = (unsteady.reference_chord, chord, unsteady.upwash_motion, unsteady.upwash_gust, *spread)
    of_air = (aircraft.gust_edge, aircraft.air_density, unseen.up)
    seen = (on_path, found.get("alpha_vane"), aircraft.boom, of_wing, of_air)
    shown = memo.get("shown", seen, lambda: _shown(x, motion, path, aircraft, s, unseen.up, memo))
    key = (seen, unsteady)
    return x, motion, memo.get("flow", key, lambda: _flow(path, shown, aircraft, s, unseen.up)), seen


def _path(motion: Motion, unsteady: Unsteady, s: Setting, drift: float) -> _Path:
    # What lags behind by a distance is filtered along the path, on a grid of equal distances: a gust that comes while
    # the aircraft is slow takes longer from the boom to the tail. A gust along the path turns the flow by as much as
    # the aircraft's own incidence is then: such turns do not travel from boom to tail, and are a few per cent of gusts.
    v0 = motion.mean_speed + drift
    inertial = motion.base + v0
    if motion.over_ground:
        level = inertial - (np.hypot(inertial, motion.down) - v0).mean(-1, keepdims=True)
        inertial = np.hypot(level, motion.down)
    there, again = places_of(v0 + unsteady.convection * (inertial - v0), v0, s)
    alpha_i = motion.theta + np.arcsin(np.clip(motion.down / inertial, -1, 1))
    moved = at_places(alpha_i, there)
    along = transform(moved, s)
    mean = moved.mean(-1, keepdims=True)
    lying, across = unsteady.gust_tilt * moved, at_places(motion.across, there)
    moving, mean = moved - mean, unsteady.turned_at_once * mean
    surge = at_places((motion.airspeed - inertial * motion.faster) / motion.airspeed, there)
    turned = (transform(-x * surge, s) for x in (mean, moving))
    square = np.cos(lying) * at_places(inertial / v0, there)
    moved, surging = moving + mean, transform(surge, s)
    return _Path(v0, inertial, there, again, alpha_i, along, lying, across, square, moved, surging, *turned)


def _shown(
    x: Mapping[str, Array], motion: Motion, path: _Path, aircraft: Aircraft, s: Setting, up: float, memo: Memo
) -> _Shown:
    w, v0, there, again = s.omega, path.v0, path.there, path.again
    unsteady = aircraft.unsteady
    boom = aircraft.boom or NO_BOOM
    steps = 1j * w * (unsteady.reference_chord or aircraft.geometry.chord) / v0
    vane_response = _vane_response(boom, w)
    gust_upwash = frequency_response(response(unsteady.upwash_gust), steps)
    square = np.cos(path.alpha_i)  # the share of the boom's motion that is square to the path, and turns the flow
    sinking = motion.q * boom.vane_x * square
    at_boom = path.moved - (dropped := at_places(sinking / path.inertial, there))
    before = np.exp(1j * w * boom.gust_x / v0)
    surge, across = back(path.surging * before, s), back(transform(path.across, s) * before, s)
    turned_boom = at_places(-at_boom * surge, again)
    upwash_spectrum = frequency_response(response(unsteady.upwash_motion), steps) * path.along
    upwash = at_places(back(upwash_spectrum + path.turned_mean + gust_upwash * path.turned_moving, s), again)
    if some(boom.vane_y) and "p" in x:
        sinking = sinking - x["p"] * boom.vane_y * square
    inside = (1 + boom.upwash_body) * (path.alpha_i - sinking / path.inertial + turned_boom) + boom.upwash_wing * upwash
    shown = transform(inside, s)
    given: float | Complex = 1.0
    if some(boom.flexure) or some(boom.tip_load):
        bend, load = _bending(boom, w, v0), motion.az
        if boom.mode_frequency is not None:
            load = load - motion.qdot * boom.vane_x
        given = 1 + bend * (boom.tip_load / 1000 * 0.5 * (aircraft.air_density or SEA_LEVEL_DENSITY) * v0**2)
        shown = shown * given + transform(boom.flexure * load, s) * bend
    vane = x["alpha_vane"] - back(shown * vane_response, s) - boom.zero
    ahead = np.exp(1j * w * aircraft.gust_edge / v0)
    span, slow = (unsteady.gust_span, unsteady.gust_span_shape, unsteady.gust_span_cut), w < 2 * np.pi * GUST_PASS_HZ[1]
    passing = memo.get("span", (span, v0.tobytes()), lambda: span_response(*span, (w / v0)[..., slow]))
    averaged = np.zeros((*passing.shape[:-1], len(w)), dtype=complex)
    averaged[..., slow] = passing  # no faster than is passed
    met = (1 + boom.upwash_body) * np.exp(1j * w * boom.gust_x / v0)
    met = (met + boom.upwash_wing * gust_upwash * ahead * averaged) * given
    told = 1.0 if s.gust_share is None else s.gust_share.at(w / (2 * np.pi))
    quick = back(transform(vane, s) / vane_response * passed(w, GUST_PASS_HZ) * told, s)
    slower = _slower(path.square, path.lying - unsteady.gust_tilt * dropped, across, surge, unsteady.gust_speed)
    lasting = up / v0 * met[..., :1].real
    gust = transform(_swinging(at_places(quick, there), 1 / slower, lasting), s) / met
    return _Shown(vane, gust, ahead * averaged * gust)


def _flow(path: _Path, shown: _Shown, aircraft: Aircraft, s: Setting, up: float) -> _Flow:
    w, v0, unsteady = s.omega, path.v0, aircraft.unsteady
    lasting = up / v0
    wing_series = tail_series = np.empty(0)
    slower = _slower(path.square, path.lying, path.across, back(path.surging, s), unsteady.gust_speed)
    if unsteady.memory:
        steps = 1j * w * (unsteady.reference_chord or aircraft.geometry.chord) / v0
        late = np.exp(-1j * w * (unsteady.tail_arm / v0 + unsteady.downwash_delay))
        gust_lift = frequency_response(response(unsteady.lift_gust), steps)
        met = transform(_swinging(back(gust_lift * shown.gust_wing, s), slower, lasting), s)
        wing = frequency_response(response(unsteady.lift_motion), steps) * path.along + path.turned_mean
        wing = wing + (gust_lift * path.turned_moving + met)
        # Wing and tail average gusts along their span, and follow them that much later.
        gust_tail = shown.gust / (1 + 1j * w * unsteady.gust_span_tail / v0)
        turned_tail = transform(-path.moved * back(path.surging * np.exp(-1j * w * unsteady.tail_arm / v0), s), s)
        behind = np.exp(-1j * w * unsteady.tail_arm * unsteady.tail_penetration / v0)
        # The tail's pressure is that of the air there, which may be faster than at the CG.
        faster = back(path.surging * (np.exp(-1j * w * unsteady.tail_arm / v0) - 1), s)
        faster = slower * (1 + (unsteady.tail_speed - unsteady.gust_speed) * faster)
        tail = path.along + turned_tail + transform(_swinging(back(behind * gust_tail, s), faster, lasting), s)
        tail_series = at_places(back(tail - unsteady.downwash * late * wing, s), path.again)
        wing_series = at_places(back(wing, s), path.again)
    gust = _swinging(back(shown.gust, s), slower, lasting) + back(path.turned_mean + path.turned_moving, s)
    return _Flow(v0, path.alpha_i, at_places(gust, path.again), wing_series, tail_series, shown.vane)


def _slower(square: Array, lying: Array, across: Array, surge: Array, followed: float) -> Array:
    """How far a gust across turns the flow, over its velocity by the mean speed. By g = V (tan(L + phi) - tan L), V the
    part of the velocity that is square to the gust, which leaves it as it is, L = `lying`; to second order in phi.
    `followed`: see Unsteady.gust_speed."""
    return np.asarray(1 - followed * (1 - (1 - surge) * np.cos(lying + 0.5 * across) ** 2 / square))


def _swinging(gust: Array, by: Array, lasting: Array) -> Array:
    """A gust's angle times a factor, but for what its mean is beyond the `lasting` updraught's: that is the vane's
    zero, and a zero does not follow the airspeed."""
    mean = gust.mean(-1, keepdims=True) - lasting
    return np.asarray(mean + (gust - mean) * by)


def _forces(x: Mapping[str, Array], motion: Motion, flow: _Flow, aircraft: Aircraft, s: Setting) -> Array:
    """Lift, moment and drag (..., 3, n): the coefficients measured less those of the model."""
    q, ax, az, de, v, qbar = motion.q, motion.ax, motion.az, x["elevator"], motion.airspeed, motion.pressure
    value, unsteady = aircraft.value, aircraft.unsteady
    area, chord = aircraft.geometry.wing_area, aircraft.geometry.chord
    mass, inertia = aircraft.inertia.mass, 1.0 if aircraft.inertia.iyy is None else aircraft.inertia.iyy
    thrust = x.get("thrust", s.thrust)
    alpha = flow.alpha_i + flow.gust
    force = qbar * area
    cx, cz = coefficients.force_coefficients((mass * ax, mass * az), (thrust, aircraft.thrust_angle), force)
    cl, cd = coefficients.lift_and_drag(cx, cz, np.sin(alpha), np.cos(alpha))
    turning = inertia * motion.qdot
    own = aircraft.inertia
    if "p" in x and "r" in x and own.ixx is not None and own.izz is not None:
        turning = coefficients.pitching_moment((inertia, own.ixz, own.ixx - own.izz), motion.qdot, x["p"], x["r"])
    cm = (turning - thrust * aircraft.thrust_pitch_arm) / (force * chord)

    reference = aircraft.reference_speed or motion.mean_speed
    qhat = 0.5 * q * chord / (reference if aircraft.rate_reference == "fixed" else v)
    faster: float | Array = 0.0
    if any(some(value(name)) for name in ("CL_V", "Cm_V", "CD_V")):
        spans = motion.mean_speed / aircraft.geometry.span
        passing = passed(s.omega, (spans / SPEED_SPANS[0], spans / SPEED_SPANS[1]))
        passing = passing + unsteady.speed_gusts * (1 - passing)
        faster = back(transform(v, s) * passing, s) / reference
    cl_model = value("CL_0") + value("CL_V") * faster + value("CL_de") * de
    cm_model = value("Cm_0") + value("Cm_V") * faster + value("Cm_de") * de
    if some(value("CL_gust")) or some(value("Cm_gust")):
        cl_model = cl_model + value("CL_gust") * flow.gust
        cm_model = cm_model + value("Cm_gust") * flow.gust
    cl_slope, cm_slope, cl_q, cm_q = value("CL_alpha"), value("Cm_alpha"), value("CL_q"), value("Cm_q")
    if unsteady.memory:
        share, arm, e = unsteady.tail_lift_slope, unsteady.tail_arm / chord, unsteady.downwash
        tail = share * (flow.tail + q * unsteady.tail_arm / v)
        cl_model = cl_model + (cl_slope - share * (1 - e)) * flow.wing + tail
        cm_model = cm_model + (cm_slope + share * arm * (1 - e)) * flow.wing - arm * tail
        cl_q = cl_q - 2 * share * arm * (1 + e)
        cm_q = cm_q + 2 * share * arm**2 * (1 + e)
    else:
        cl_model = cl_model + cl_slope * alpha
        cm_model = cm_model + cm_slope * alpha
    cl_model = cl_model + cl_q * qhat
    cm_model = cm_model + cm_q * qhat
    for power in (2, 3):
        for_lift, for_moment = value(f"CL_alpha{power}"), value(f"Cm_alpha{power}")
        if some(for_lift) or some(for_moment):
            cl_model, cm_model = cl_model + for_lift * alpha**power, cm_model + for_moment * alpha**power
    if aircraft.drag is not None:
        cd_model = aircraft.drag.zero_lift + aircraft.drag.induced * cl * cl
    else:
        cd_model = value("CD_0") + value("CD_V") * faster + value("CD_alpha") * alpha
    if (leaving := aircraft.separation).alpha_star is not None:
        along = attached_along(alpha, leaving, leaving.alpha_star, chord / motion.mean_speed, s)
        lifting = flow.wing if unsteady.memory else alpha
        cl_model = cl_model - of_wing(aircraft) * (1 - lift_left(along)) * (lifting - leaving.alpha_0)
        cm_model = cm_model + leaving.Cm_X * (1 - along)
        cd_model = cd_model + leaving.CD_X * (1 - along)

    return together([cl - cl_model, cm - cm_model, cd - cd_model])


def _vane_response(boom: Boom, omega: Array) -> Complex:
    return np.asarray(second_order_response(boom.vane_frequency, boom.vane_damping, 1j * omega))


def _bending(boom: Boom, omega: Array, speed: Array) -> Complex:
    """The vane's response to a load that would flex the boom by an angle of 1: the mode also moves the tip."""
    if boom.mode_frequency is None:
        return np.asarray(boom.mode_turn * np.ones(len(omega), dtype=complex))
    bent = second_order_response(boom.mode_frequency, boom.mode_damping, 1j * omega)
    return np.asarray(bent * (boom.mode_turn - 1j * omega * boom.mode_length / speed), dtype=complex)
