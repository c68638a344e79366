"""Measured inputs of a simulation: a record's surfaces and thrust as they were, and the vertical gust the vane shows.

The gust is the flow angle that the vane shows less the one that the aircraft's own motion makes there: attitude and
flight path, the boom carried along by pitch rate, the upwash of body and wing behind its lag, the boom's bending.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal
from scipy.interpolate import CubicSpline

from station.conventions import G0
from station.diagnosis.backlash import linearised
from station.diagnosis.corrections import all_corrected
from station.diagnosis.inertial_motion import motion_of
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import Record
from station.numerics.indicial import frequency_response, respond_throughout, response
from station.numerics.second_order import second_order_inverse
from station.profile import NO_BOOM, Aircraft, Instrument
from station.simulation.measured_inputs import Inputs

Array = NDArray[np.float64]

GUST_PASS_HZ: Final = (4.0, 6.0)
"""The gust is passed up to the first and stopped from the second: beyond, a vane shows its own dynamics and noise."""
ALONG_PASS_HZ: Final = 1.0
"""The headwind is passed up to here: beyond, pitot and GPS show their noise."""
SLOW_HZ: Final = 0.1
"""Without vertical velocity, flow that changes more slowly than this is the aircraft's own."""


def undone(x: Array, found: Instrument | None, dt: float) -> Array:
    """A signal (n,) before its instrument's bias, gain, delay, lag and nonlinearity; its end is held."""
    if found is None:
        return x
    x = (x - found.bias) / found.gain
    if found.latency or found.lag:
        t = dt * np.arange(len(x))
        spline = CubicSpline(t, x)
        later = np.clip(t + found.latency, t[0], t[-1])
        x = spline(later) + max(found.lag, 0.0) * spline(later, 1)
        if found.lag < 0:  # it shows what is to come
            twice = -2 * found.lag / dt
            b, a = np.array([1.0, 1.0]) / (1 + twice), np.array([1.0, (1 - twice) / (1 + twice)])
            x = signal.lfilter(b, a, x, zi=signal.lfilter_zi(b, a) * x[0])[0]
    return linearised(x, found.cubic) if found.cubic else np.asarray(x)


def without_errors(record: Record, aircraft: Aircraft) -> dict[str, Array]:
    """The signals (n,) without what the aircraft's `instruments` say that the sensors did to them. A lag undone raises
    noise: that of the air data, whose lags are long, is smoothed about the aircraft's own motion, see air_data."""
    x = {name: undone(v, aircraft.instruments.get(name), record.dt) for name, v in record.signals.items()}
    m = manoeuvre(record, aircraft)
    motion = motion_of(all_corrected(m.record.signals, aircraft, m.setting, m.memo)[1], aircraft, m.setting)
    t, judged = record.dt * np.arange(record.n), m.record.dt * np.arange(m.record.n)
    smoothed = {"airspeed": motion.airspeed, "dynamic_pressure": motion.pressure}
    return x | {name: np.interp(t, judged, v) for name, v in smoothed.items()}


def inputs_of(x: Mapping[str, Array], dt: float, aircraft: Aircraft) -> Inputs:
    """What drove the aircraft, of signals `without_errors`, `dt` s apart."""
    headwind = along_gust(x, dt)
    motion = np.stack([x["airspeed"] - headwind, inertial_angle(x, dt)[0], x["theta"], x["q"]], axis=1)
    return Inputs(dt, x["elevator"], x["airspeed"], vertical_gust(x, aircraft, dt), headwind, motion, x.get("thrust"))


def along_gust(x: Mapping[str, Array], dt: float) -> Array:
    """The headwind's change (n,), m/s: airspeed less ground speed, passed as far as both are the motion's; 0 without
    ground speed along a steady heading."""
    if "v_along" not in x:
        return np.zeros(len(x["airspeed"]))
    made = signal.detrend(x["airspeed"] - np.hypot(x["v_along"], x.get("v_down", 0.0)))
    low = signal.butter(2, ALONG_PASS_HZ, fs=1 / dt, output="sos")
    return np.asarray(signal.sosfiltfilt(low, made))


def inertial_angle(x: Mapping[str, Array], dt: float) -> tuple[Array, bool]:
    """Angle of attack of the motion (n,), rad, from attitude and vertical velocity; where there is none, from that
    which the accelerations make, whose slow part is not known (True)."""
    theta, bank = x["theta"], x.get("phi", np.zeros(len(x["theta"])))
    down, slow = x.get("v_down"), False
    if down is None:
        rate = x["az"] * np.cos(theta) * np.cos(bank) - x["ax"] * np.sin(theta) + G0
        down = signal.detrend(np.concatenate([[0.0], np.cumsum(0.5 * dt * (rate[1:] + rate[:-1]))]))
        slow = True
    # v_down/V = sin(alpha) cos(theta) cos(phi) - cos(alpha) sin(theta), without sideslip.
    across = np.cos(theta) * np.cos(bank)
    size = np.hypot(np.sin(theta), across)
    climb = np.clip(down / (x["airspeed"] * size), -1.0, 1.0)
    return np.asarray(np.arctan2(np.sin(theta), across) + np.arcsin(climb)), slow


def vertical_gust(x: Mapping[str, Array], aircraft: Aircraft, dt: float) -> Array:
    """The vertical gust (n,) at the vane, m/s, upwards positive, without mean and trend: those are zeros and trim."""
    boom = aircraft.boom or NO_BOOM
    alpha, slow = inertial_angle(x, dt)
    v, u = x["airspeed"], aircraft.unsteady
    chord = u.reference_chord or aircraft.geometry.chord
    of_motion = respond_throughout(response(u.upwash_motion), v * dt / chord, np.ascontiguousarray(alpha))
    here = (1 + boom.upwash_body) * (alpha - x["q"] * boom.vane_x / v) + boom.upwash_wing * of_motion
    tip = boom.mode_turn * boom.tip_load / 1000.0 * x["dynamic_pressure"]
    bent = boom.mode_turn * boom.flexure * x["az"]

    n = len(alpha)
    mean = float(v.mean())
    s = 2j * math.pi * fft.rfftfreq(2 * n, dt)
    before = second_order_inverse(boom.vane_frequency, boom.vane_damping, s) * _passed(np.abs(s))
    flow = _through(x["alpha_vane"] - boom.zero, before) - _through(bent + here * (1 + tip), _passed(np.abs(s)))
    # What a gust makes of the vane: at once where it meets it, and by the wing's upwash once it is there.
    late = np.exp(-s * (boom.gust_x - aircraft.gust_edge) / mean)
    wing = frequency_response(response(u.upwash_gust), s * chord / mean)
    per_gust = (1 + float(tip.mean())) * (1 + boom.upwash_body + boom.upwash_wing * wing * late)
    gust = signal.detrend(_through(flow, 1 / per_gust)) * v
    if slow:
        high = signal.butter(2, SLOW_HZ, "highpass", fs=1 / dt, output="sos")
        gust = signal.sosfiltfilt(high, gust)
    return np.asarray(gust)


def as_the_gust(x: Array, dt: float) -> Array:
    """A series (n,) passed as the gust is."""
    return _through(x, _passed(2 * math.pi * fft.rfftfreq(2 * len(x), dt)))


def _passed(omega: Array) -> Array:
    part = np.clip((omega / (2 * math.pi) - GUST_PASS_HZ[0]) / (GUST_PASS_HZ[1] - GUST_PASS_HZ[0]), 0, 1)
    return np.asarray(0.5 + 0.5 * np.cos(math.pi * part))


def _through(x: Array, h: NDArray[np.complex128] | Array) -> Array:
    """A series through a response given for twice its length, over which it comes back as it went."""
    made: Array = fft.irfft(fft.rfft(np.concatenate([x, x[::-1]])) * h, 2 * len(x))[: len(x)]
    return made
