"""How well the constants of an aircraft profile are known."""

from __future__ import annotations

import math

from pydantic import Field

from station.conventions import G0
from station.profile.quantity import (
    Frozen,
    MetresPerSecond,
    MetresPerSecond2,
    Radians,
    RadiansPerSecond,
    Seconds,
)


class Uncertainty(Frozen):
    """Prior standard deviations of what the methods take from the profile, relative to the value where no unit is
    named: of mass, inertia, surfaces and dynamic pressure in every method, of the others in `physical`, `split+gust`
    and diagnosis; trims, zeros, thrust and wind in diagnosis. Zero says that a constant is right; the defaults are
    those of a profile put together from drawings, handbook methods and a vortex lattice. Of derivatives each says so
    itself (`sd`)."""

    mass: float = Field(default=0.03, ge=0)
    """Of the mass where it is not recorded: fuel, crew and payload by estimate."""
    recorded_mass: float = Field(default=0.01, ge=0)
    """Of a recorded mass: weighed, less the fuel burnt."""
    inertia: float = Field(default=0.06, ge=0)
    """Of the moments of inertia and of their product, of each by itself: scaled from another loading, or added up from
    components."""
    surface_scale: float = Field(default=0.02, ge=0)
    """Of the scale of what measures elevator, aileron and rudder, of each by itself. No other instrument shows it: a
    pot 20 % short makes the derivatives of its surface 25 % large, and nothing else. The default: installed systems
    are to be within 3 % of the full range (14 CFR 91 appendix E, pitch control position), evenly spread 1.7 %."""

    surface_zero: Radians = math.radians(0.3)
    """Of the zero of what measures a surface: rigged to half a degree, evenly spread. It moves trims alone, and what a
    nonlinear sensor shows."""

    tail_lift_slope: float = Field(default=0.2, ge=0)
    """Of the tail's lift slope."""
    downwash: float = Field(default=0.2, ge=0)
    """Of the downwash at the tail."""
    downwash_delay: Seconds = 0.015
    """Of the downwash's delay."""
    tail_arm: float = Field(default=0.09, ge=0)
    """Of the tail arm."""
    lift_memory: float = Field(default=0.3, ge=0)
    """Of the amplitude of the wing's indicial responses to motion and gusts; that to gusts by half as much besides."""
    lift_rate: float = Field(default=0.27, ge=0)
    """Of the rates of the wing's indicial responses to motion and gusts; of that to gusts by half as much besides."""
    span_lag: float = Field(default=1.0, ge=0)
    """Share of the lag with which a wing of that span would follow a gust, were its lift spread evenly."""
    span_shape: float = Field(default=0.5, ge=0)
    """Of the shape of that lag (`gust_span_shape`), absolute."""
    span_cut: float = Field(default=0.25, ge=0)
    """Of where that lag ends (`gust_span_cut`), absolute: wings do end."""
    turned_at_once: float = Field(default=0.5, ge=0)
    """Of the share of the mean angle of attack that gusts along the path turn at once, absolute."""
    gust_speed: float = Field(default=0.7, ge=0)
    """Of how a gust's angle follows the airspeed, absolute: simulations take it for a velocity, or for an angle."""
    gust_tilt: float = Field(default=0.5, ge=0)
    """Of how gusts across the path lie to it (`gust_tilt`), absolute."""
    tail_speed: float = Field(default=0.7, ge=0)
    """Of how the tail's lift follows the speed of the air there, absolute: the wing's wake is slower."""
    speed_gusts: float = Field(default=0.5, ge=0)
    """Of how `CL_V`, `Cm_V` and `CD_V` follow short gusts (`speed_gusts`), absolute."""
    tail_span_lag: float = Field(default=0.5, ge=0)
    """Of the share of that lag, one half, with which the tail follows."""
    sidewash: float = Field(default=0.1, ge=0)
    """Of the sidewash at the fin, absolute: as much as the empirical formula of DATCOM 5.4.1 gives it for a high wing,
    where a body of another shape may have none."""
    upwash_wing: float = Field(default=0.3, ge=0)
    """Of the wing's upwash at the vane."""
    upwash_rate: float = Field(default=0.27, ge=0)
    """Of the rates of the upwash's indicial responses."""
    vane_x: Seconds = 0.006
    """Of the vane's lead over the CG, position over speed."""
    vane_delay: Seconds = 0.004
    """Of the vane against the inertial data."""
    pressure_delay: Seconds = 0.02
    """Of the air data against the wing: a pitot stands a metre before or behind it, and lift follows a gust along the
    path within a chord (Drischler and Diederich 1957, NACA TN 3956)."""
    dynamic_pressure: float = Field(default=0.0, ge=0)
    """Of the dynamic pressure, airspeed with it: the position error as it is stated. Derivatives of every method are
    uncertain by it, those by rates by half of it, and diagnosis estimates it along."""
    vane_scale: float = Field(default=0.03, ge=0)
    """Of the vane's scale, by the steady upwash of wing and body: two digits of a calibration, or a panel method's."""
    vane_frequency: float = Field(default=0.1, ge=0)
    """Of the vane's natural frequency."""
    vane_damping: float = Field(default=0.15, ge=0)
    """Of the vane's damping ratio."""
    gust_turning: float = Field(default=0.15, ge=0)
    """Of how much air turns where side gusts change, absolute: the ground, and waves, make no isotropic air."""
    convection: float = Field(default=0.5, ge=0)
    """Of how far transit times of gusts and wakes follow a change of speed."""
    handbook: float = Field(default=1.0, ge=0)
    """Share of what handbook methods miss CL_q (a quarter) and CL_de (an eighth) by, beyond a derivative's own sd; not
    of one whose sd is 0."""

    CL_0: float = Field(default=0.3, ge=0)
    """Of the lift coefficient at no angle of attack, absolute: incidence of the wing, flaps, another reference line."""
    CL_V: float = Field(default=0.1, ge=0)
    """Of how lift depends on speed itself, absolute: a tenth of the lift behind a propeller, whose slipstream weakens
    with the cube of the speed, or at Mach 0.3. The phugoid's frequency is uncertain by it where no effect tells it."""
    Cm_0: float = Field(default=0.1, ge=0)
    """Of the pitching moment's, absolute: trim tab, loading."""
    CD_0: float = Field(default=0.02, ge=0)
    """Of the drag at no lift, absolute: half of a clean aircraft's."""
    induced_drag: float = Field(default=0.15, ge=0)
    """Of the drag's part that goes with lift squared."""
    thrust: float = Field(default=0.05, ge=0)
    """Of the thrust, recorded or not: an engine deck's."""
    thrust_arm: float = Field(default=0.05, ge=0)
    """Of the thrust's arm over the CG, in chords: how high a CG lies is computed and not weighed. The phugoid's
    frequency is uncertain by it."""
    alpha_star: Radians = math.radians(2.0)
    """Of the angle of attack at which the flow leaves the wing, where the profile has one."""
    alpha_0: Radians = math.radians(5.0)
    """Of the angle of attack of no lift: the incidence and the camber of a wing."""
    a1: float = Field(default=0.5, ge=0)
    """Of how sharply it does, of the logarithm."""
    tau1: float = Field(default=15.0, ge=0)
    """Of the lag of the separation, chords travelled."""
    tau2: float = Field(default=15.0, ge=0)
    """Of how much later the flow comes back, chords travelled."""
    tau2_rising: float = Field(default=15.0, ge=0)
    """Of how much later it leaves, chords travelled."""
    CD_X: float = Field(default=0.2, ge=0)
    """Of the drag of separated flow."""
    Cm_X: float = Field(default=0.1, ge=0)
    """Of its pitching moment."""
    vane_zero: Radians = math.radians(0.15)
    """Of the vane's zero, rigged with a protractor."""
    theta_zero: Radians = math.radians(0.1)
    """Of the attitude's, levelled on the ground."""
    q_zero: RadiansPerSecond = math.radians(0.05)
    """Of the pitch-rate gyro's, taken at rest."""
    ax_zero: MetresPerSecond2 = 0.003 * G0
    """Of the longitudinal accelerometer's."""
    az_zero: MetresPerSecond2 = 0.005 * G0
    """Of the normal accelerometer's."""
    drift: MetresPerSecond = 0.5
    """By how much the aircraft may move faster through the air mass than its mean airspeed says: a gust along the path
    that lasts as long as the manoeuvre. Where ground speed shows such gusts, their own mean's joins it."""
