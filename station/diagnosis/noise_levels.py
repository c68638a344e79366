"""The noise of a record's sensors: what a rig states, what the record itself shows beside its gusts, draws of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from station.diagnosis.corrections import instrument_of
from station.diagnosis.measured_record import Record
from station.diagnosis.processing import Setting
from station.diagnosis.residuals import VANE, series
from station.numerics.default_noise import DEFAULT_NOISE
from station.profile import Aircraft

Array = NDArray[np.float64]

COLOURED_SHARE: Final = 0.25
"""Part of a sensor's variance that is slow: its spectrum is not known below the motion's, so this much is assumed."""
COLOUR_S: Final = 0.3
THRUST_SHARE: Final = 0.05
THRUST_S: Final = 1.0
"""Where thrust is not recorded: by how much of its trim it changes unseen, and how slowly. A propeller's thrust changes
with the speed by about as much as that, and so do small corrections by hand."""
JUDGED: Final = ("alpha_vane", "q", "theta", "ax", "az", "airspeed", "v_down", "v_along", "elevator")
"""Signals whose noise the residuals hold."""
SMOOTHED: Final = 0.5
_ALIAS: Final = {"v_along": "v_north"}
_BANDS: Final = ((0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.98))
"""Shares of half the sampling rate."""
CLEAR: Final = (10.0, 2.0)
"""Power over that of the motion from which a band shows the noise, tried in turn: the motion is known in part."""


@dataclass(frozen=True, slots=True)
class Flights:
    """A manoeuvre flown by the simulation without noise: signals (n,) in calm air, (FLIGHTS, n) in turbulence."""

    nominal: Mapping[str, Array]
    turbulent: Mapping[str, Array]
    drift: Array
    """(FLIGHTS, 1): speed through the air mass less the mean airspeed, m/s."""
    trim_thrust: float
    sigma: float
    """Standard deviation of the vertical gust in turbulence, m/s."""


def stated_noise(record: Record) -> dict[str, float]:
    """What the record's rig states, or a good installation has."""
    of = {name: _ALIAS.get(name, name) for name in JUDGED}
    return {name: record.stated.get(signal) or DEFAULT_NOISE[signal] for name, signal in of.items()}


def true_noise(noise: Mapping[str, float], aircraft: Aircraft) -> dict[str, float]:
    """Each signal's noise once its instrument's gain is taken out."""
    return {name: sd / _gain(aircraft, name) for name, sd in noise.items()}


def _gain(aircraft: Aircraft, name: str) -> float:
    found = instrument_of(aircraft, name)
    return found.gain if found else 1.0


def noisy(
    signals: Mapping[str, Array], noise: Mapping[str, float], dt: float, rng: np.random.Generator, draws: int
) -> dict[str, Array]:
    """Each signal (n,) with `draws` draws of its sensor's noise, (draws, n); airspeed and pressure share a sensor."""
    n = len(next(iter(signals.values())))
    out: dict[str, Array] = {}
    for name in sorted(signals):
        x = signals[name]
        sd = noise.get(name, 0.0)
        if not sd:
            out[name] = np.broadcast_to(x, (draws, n))
            continue
        share, lag = (1.0, THRUST_S) if name == "thrust" else (COLOURED_SHARE, COLOUR_S)
        decay = math.exp(-dt / lag)
        white = rng.standard_normal((draws, n))
        kicks = rng.standard_normal((draws, n)) * math.sqrt(1 - decay**2)
        kicks[:, 0] /= math.sqrt(1 - decay**2)
        slow = signal.lfilter([1.0], [1.0, -decay], kicks, axis=-1)
        out[name] = x + sd * (math.sqrt(1 - share) * white + math.sqrt(share) * slow)
    speed = signals["airspeed"]
    out["dynamic_pressure"] = signals["dynamic_pressure"] * (out["airspeed"] / speed) ** 2
    return out


def _powers(x: Array) -> Array:
    """Power (..., bands) of a series per _BANDS: the variance of the white series that has as much there."""
    n = x.shape[-1]
    window = signal.windows.hann(n)
    spectrum = np.abs(fft.rfft(signal.detrend(x, axis=-1) * window, axis=-1)) ** 2 / float((window**2).sum())
    share = np.arange(spectrum.shape[-1]) / (0.5 * n)
    out = np.stack([spectrum[..., (share >= a) & (share < b)].mean(-1) for a, b in _BANDS], axis=-1)
    return np.asarray(out)


def levels(
    record: Record, flights: Flights, stated: Mapping[str, float], aircraft: Aircraft, s: Setting
) -> tuple[dict[str, float], float]:
    """Noise by signal, and the gust's standard deviation: each allows for the other."""
    measured = series(record.signals, s.nominal, s)[VANE]
    model = series(flights.turbulent, aircraft, replace(s, nominal=aircraft), flights.drift)[:, VANE]
    n = record.n
    f = fft.rfftfreq(n, record.dt)
    band = (f >= 1.0) & (f <= min(5.0, 0.4 / record.dt))
    window = signal.windows.hann(n)

    def power(x: Array) -> float:
        return float((np.abs(fft.rfft(signal.detrend(x) * window)) ** 2)[..., band].mean() / (window**2).sum())

    mine, theirs = power(measured), power(model) / flights.sigma**2
    noise = dict(stated)
    guess, speed = 0.0, float(np.mean(flights.nominal["airspeed"]))
    powers = {name: _signal_powers(name, record, flights, s.nominal) for name in stated if name in record.signals}
    for _ in range(3):
        true = true_noise(noise, s.nominal)
        # The flow angle that the motion shows has noise, too: the slower the aircraft, the more of it.
        climbing = 0.0 if s.rebuilt else true["v_down"] / speed
        white = true["alpha_vane"] ** 2 + true["theta"] ** 2 + climbing**2
        guess = math.sqrt(max(mine - 1.3 * white, 0.0) / theirs)
        for name, sd in stated.items():
            if name in record.signals:
                # Below that a record has been smoothed, and its noise above the motion's band says nothing.
                least = sd * (SMOOTHED if record.stated.get(_ALIAS.get(name, name)) else 1.0)
                noise[name] = max(_level(name, sd, record, powers[name], guess / flights.sigma), least)
    return {n: v for n, v in noise.items() if n in record.signals}, guess


def _signal_powers(name: str, record: Record, flights: Flights, aircraft: Aircraft) -> tuple[Array, Array, Array]:
    """Power per band of what was measured, of the motion, and of the answer to the gusts flown, as the aircraft's
    instrument shows them."""
    shown = _gain(aircraft, name) ** 2
    motion, gusts = _powers(flights.nominal[name]), _powers(flights.turbulent[name]).mean(0)
    return _powers(record.signals[name]), shown * motion, shown * gusts


def _level(name: str, stated: float, record: Record, powers: tuple[Array, Array, Array], gust: float) -> float:
    """Noise of one signal: the power where neither the motion nor the gust (over that flown) reaches."""
    if name in record.held:
        return stated
    if name == "elevator":
        return _between_steps(record.signals[name]) / math.sqrt(1 - COLOURED_SHARE)
    mine, motion, gusts = powers
    expected = motion + gusts * gust**2
    clear = next((bands for much in CLEAR if len(bands := np.flatnonzero(mine > much * expected))), None)
    if clear is None:
        return min(stated, math.sqrt(float(mine.min())))
    # The lowest clear band is the nearest to what is judged: interpolation between samples takes noise from the others.
    return math.sqrt(float((mine - expected)[clear[0]]) / (1 - COLOURED_SHARE))


def _between_steps(x: Array) -> float:
    """White noise of an input that moves in steps: from the median of its fourth differences."""
    return float(np.median(np.abs(np.diff(x, 4)))) / 0.6745 / math.sqrt(70.0)
