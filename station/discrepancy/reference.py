"""What the differences would be without any effect: flights of the station's own simulation, with the same input.

One flight in calm air gives the mean, flights in turbulence and draws of the sensors' noise the covariance of the
seven series together, per frequency. Noise of one sensor enters several series: the cross terms are half the matter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from station.conventions import G0, to_si
from station.discrepancy.corrections import instrument_of, straightened
from station.discrepancy.processing import Setting, bridge_of
from station.discrepancy.record import Record
from station.discrepancy.residuals import SERIES, VANE, Memo, Spectra, flow_angle, series, series_spectra, spectra
from station.profile import Actuator, Aircraft, Flight, Instrument
from station.rows import ProfileError, UsageError
from station.simulation.aircraft import constants
from station.simulation.longitudinal import Simulation
from station.simulation.motion import DT

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SIGMA: Final = to_si(5, "ft/s")
"""Vertical gust that the flights in turbulence are flown in, m/s."""
FLIGHTS: Final = 40
DRAWS: Final = 96
CALM_BELOW: Final = to_si(1, "ft/s")
COLOURED_SHARE: Final = 0.25
"""Part of a sensor's variance that is slow: its spectrum is not known below the motion's, so this is allowed for."""
COLOUR_S: Final = 0.3
SMOOTHING: Final = (1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0)
"""Weights of neighbouring frequencies in a covariance."""
STATED: Final[Mapping[str, float]] = {
    "alpha_vane": to_si(0.05, "deg"),
    "q": to_si(0.03, "deg/s"),
    "theta": to_si(0.03, "deg"),
    "ax": 0.002 * G0,
    "az": 0.004 * G0,
    "airspeed": to_si(0.3, "ft/s"),
    "v_down": to_si(0.1, "ft/s"),
    "v_along": to_si(0.1, "ft/s"),
    "elevator": to_si(0.02, "deg"),
}
"""Noise where a rig states none: a good flight-test installation."""
_SEED: Final = 7_340_001
"""Of the first gust field: far from the seeds that flights are given."""
SMOOTHED: Final = 0.5
_THROUGH: Final = "through the air mass"
LEAST_DRIFT: Final = 0.05
_ALIAS: Final = {"v_along": "v_north"}
_QUICK_ACTUATOR: Final = Actuator().model_copy(update={"time_constant": 0.02, "rate_limit": 1e3, "position_limit": 1.5})
_INPUT_PASS_HZ: Final = 7.0


@dataclass(frozen=True, slots=True)
class Whitener:
    """Covariance calm + s2 turbulent, of one vector per frequency, made diagonal for every s at once.

    rotate (m, k, k): applied to a vector makes its calm covariance 1 and its turbulent one `turbulent` (m, k).
    """

    rotate: Complex
    turbulent: Array

    @classmethod
    def of(cls, calm: Complex, turbulent: Complex) -> Whitener:
        """From Hermitian (m, k, k)."""
        root = np.linalg.cholesky(calm)
        inverse = np.linalg.inv(root)
        values, vectors = np.linalg.eigh(inverse @ turbulent @ np.conj(np.swapaxes(inverse, -1, -2)))
        return cls(np.conj(np.swapaxes(vectors, -1, -2)) @ inverse, np.maximum(values, 0.0))


def spread(whitener: Whitener) -> tuple[Complex, Complex]:
    """The covariances (m, k, k) that it was made from: calm, and turbulent per unit of s2."""
    back = np.linalg.inv(whitener.rotate)
    other = np.conj(np.swapaxes(back, -1, -2))
    return np.asarray(back @ other, dtype=complex), np.asarray((back * whitener.turbulent[:, None, :]) @ other, complex)


@dataclass(frozen=True, slots=True)
class Flights:
    """A manoeuvre flown by the simulation without noise: signals (n,) in calm air, (FLIGHTS, n) in turbulence."""

    nominal: Mapping[str, Array]
    turbulent: Mapping[str, Array]
    drift: Array
    """(FLIGHTS, 1): speed through the air mass less the mean airspeed, m/s."""
    trim_thrust: float


@dataclass(frozen=True, slots=True)
class Reference:
    """One manoeuvre, and what it would look like."""

    record: Record
    setting: Setting
    mean: Spectra
    """Of the noiseless flight in calm air: what processing leaves."""
    bins: Whitener
    steady: Whitener
    nominal: Mapping[str, Array]
    """Signals of that flight."""
    noise: Mapping[str, float]
    """Standard deviations found, SI."""
    gust_guess: float
    """Rough standard deviation of the vertical gust, m/s."""
    drift_sd: float
    """Standard deviation of `drift` of residuals.series, m/s."""
    mass_share: float
    iyy_share: float
    flights: Flights
    memo: Memo = field(default_factory=Memo, repr=False)

    def differences(self, aircraft: Aircraft, drift: float = 0.0) -> Spectra:
        """What was measured less what that aircraft predicts, in the series judged; `drift` as in residuals.series."""
        own = loaded(aircraft, self.record, self.mass_share, self.iyy_share)
        return series_spectra(self.record.signals, own, self.setting, drift, self.memo).minus(self.mean)

    def flow_angle(self, aircraft: Aircraft) -> Array:
        """The angle of attack at the CG that an aircraft's vane and motion tell, rad, (n,)."""
        own = loaded(aircraft, self.record, self.mass_share, self.iyy_share)
        return flow_angle(self.record.signals, own, self.setting, self.memo)


def loaded(aircraft: Aircraft, record: Record, mass_share: float, iyy_share: float) -> Aircraft:
    """An aircraft in a record's air and with its loading, as shares of the profile's mass and inertia."""
    inertia = aircraft.inertia.model_copy(
        update={"mass": aircraft.inertia.mass * mass_share, "iyy": (aircraft.inertia.iyy or 1.0) * iyy_share}
    )
    return aircraft.model_copy(update={"air_density": record.density, "inertia": inertia})


def shares(aircraft: Aircraft, record: Record) -> tuple[float, float]:
    """The record's own mass and inertia over the profile's; 1 where it has none."""
    mass = (record.mass or aircraft.inertia.mass) / aircraft.inertia.mass
    iyy = aircraft.inertia.iyy
    return mass, 1.0 if iyy is None or record.iyy is None else record.iyy / iyy


def bare(aircraft: Aircraft) -> Aircraft:
    """The aircraft without the instrument errors that its profile has."""
    return aircraft.model_copy(update={"instruments": {}, "imu_offset": (0.0, 0.0, 0.0)})


def fly(record: Record, aircraft: Aircraft, seed: int = 0, loading: tuple[float, float] | None = None) -> Flights:
    """Fly a record's elevator at its speed, both as the profile's instruments tell them. Raises UsageError where the
    profile cannot be flown like that."""
    plain = bare(loaded(aircraft, record, *(loading or shares(aircraft, record))))
    speed = float(np.mean(_rescaled(record.signals["airspeed"], instrument_of(aircraft, "airspeed"))))
    try:
        trim = constants(plain, speed, record.height)
    except ProfileError as error:
        raise UsageError(f"{record.name}: {error}\nis it another aircraft's profile? use --aircraft") from error
    deflection = _deflection(record, _rescaled(record.signals["elevator"], instrument_of(aircraft, "elevator")))
    nominal = _fly(plain, record, speed, deflection, 0.0, seed)
    gusts = [_fly(plain, record, speed, deflection, SIGMA, _SEED + seed + k) for k in range(FLIGHTS)]
    turbulent = {name: np.stack([g[name] for g in gusts]) for name in nominal}
    drift = (turbulent.pop(_THROUGH) - turbulent["airspeed"]).mean(-1, keepdims=True)
    del nominal[_THROUGH]
    return Flights(nominal, turbulent, drift, trim.trim_thrust)


def reference(
    record: Record, aircraft: Aircraft, seed: int = 0, flights: Flights | None = None,
    loading: tuple[float, float] | None = None,
) -> Reference:  # fmt: skip
    """What a manoeuvre would look like without effects; `flights` are those of `fly`, where they are made already."""
    own_shares = loading or shares(aircraft, record)
    flown = loaded(aircraft, record, *own_shares)
    plain = bare(flown)
    flights = flights or fly(record, aircraft, seed, loading)
    nominal, turbulent = flights.nominal, flights.turbulent
    judged = tuple(j for j, name in enumerate(SERIES) if not _unjudged(name, record, plain))
    stated = {name: record.stated.get(_ALIAS.get(name, name)) or STATED[name] for name in STATED}

    def setting(gusty: bool, subject: Aircraft, elevator_noise: float) -> Setting:
        return Setting(
            record.dt, record.n, bridge_of(record.dt, record.n), gusty, judged, record.imu, flights.trim_thrust,
            subject, elevator_noise, "v_down" not in record.signals, record.held,
        )  # fmt: skip

    noise, guess = _levels(record, flights, stated, plain, setting(True, flown, stated["elevator"]))
    gusty = guess > CALM_BELOW
    own = setting(gusty, plain, noise["elevator"])
    mean = spectra(series(nominal, plain, own), own)
    drift = flights.drift
    gust_part = spectra(series(turbulent, plain, own, drift), own).minus(mean)
    calm, steady_calm = _of_noise(nominal, _true(noise, flown), plain, own, mean, seed)
    k = len(judged)
    steady_gust = np.atleast_2d(np.cov(gust_part.steady.T)) * (FLIGHTS - 1) / (FLIGHTS - k - 2)
    return Reference(
        record,
        setting(gusty, flown, noise["elevator"]),
        mean,
        Whitener.of(calm, _covariance(gust_part.bins / SIGMA)),
        Whitener.of(steady_calm, (steady_gust[None] / SIGMA**2).astype(complex)),
        nominal,
        noise,
        guess,
        LEAST_DRIFT + float(drift.std()) * guess / SIGMA,
        own_shares[0],
        own_shares[1],
        flights,
    )


def heard_through(r: Reference, aircraft: Aircraft) -> Reference:
    """The same manoeuvre with the sensors' noise as it passes through another aircraft's lift and moment."""
    plain = bare(loaded(aircraft, r.record, r.mass_share, r.iyy_share))
    own = replace(r.setting, nominal=bare(r.setting.nominal))
    middle = spectra(series(r.nominal, plain, own), own)
    calm, steady = _of_noise(r.nominal, _true(r.noise, r.setting.nominal), plain, own, middle, 0)
    turbulent, steady_turbulent = spread(r.bins)[1], spread(r.steady)[1]
    return replace(r, bins=Whitener.of(calm, turbulent), steady=Whitener.of(steady, steady_turbulent))


def _true(noise: Mapping[str, float], aircraft: Aircraft) -> dict[str, float]:
    """What is left of each signal's noise once its instrument's gain is taken out."""
    return {name: sd / _gain(aircraft, name) for name, sd in noise.items()}


def _gain(aircraft: Aircraft, name: str) -> float:
    found = instrument_of(aircraft, name)
    return found.gain if found else 1.0


def _of_noise(
    nominal: Mapping[str, Array], noise: Mapping[str, float], aircraft: Aircraft, s: Setting, mean: Spectra, seed: int
) -> tuple[Complex, Complex]:
    """Covariance of what the sensors' noise makes of the series about their `mean`: (m, k, k), and (1, k, k) of the
    steady parts."""
    draws = _noisy(nominal, noise, s.dt, np.random.default_rng([seed, 17]), DRAWS)
    part = spectra(series(draws, aircraft, s), s).minus(mean)
    steady = np.atleast_2d(np.cov(part.steady.T)) * (DRAWS - 1) / (DRAWS - len(s.judged) - 2)
    return _covariance(part.bins), np.asarray(steady[None].astype(complex))


def _unjudged(name: str, record: Record, aircraft: Aircraft) -> bool:
    if name == "v_down":
        return "v_down" not in record.signals
    if name == "v_north":
        return "v_along" not in record.signals
    if name == "drag":
        return aircraft.drag is None and not aircraft.value("CD_0")
    if name == "moment":
        return aircraft.inertia.iyy is None
    return False


def _rescaled(x: Array, found: Instrument | None) -> Array:
    """A signal with its instrument's bias, gain and bend taken out, its lateness left."""
    if found is None:
        return x
    x = (x - found.bias) / found.gain
    return straightened(x, found.cubic) if found.cubic else x


def _deflection(record: Record, elevator: Array) -> Array:
    """The command (rad from trim, at half steps) that a quick actuator turns into that elevator."""
    share = min(2 * _INPUT_PASS_HZ * record.dt, 0.8)
    smooth = signal.sosfiltfilt(signal.butter(4, share, output="sos"), elevator)
    t = record.dt * np.arange(record.n)
    fine = np.arange(0.0, t[-1] + DT, 0.5 * DT)
    position = np.interp(fine, t, smooth - np.median(smooth))
    command: Array = position + _QUICK_ACTUATOR.time_constant * np.gradient(position, 0.5 * DT)
    return command


def _fly(
    aircraft: Aircraft, record: Record, speed: float, deflection: Array, sigma: float, seed: int
) -> dict[str, Array]:
    """The record's signals, flown without noise."""
    quick = aircraft.model_copy(update={"elevator": _QUICK_ACTUATOR})
    flight = Flight().model_copy(
        update={"speed": speed, "altitude": max(record.height, 0.0), "gust_sigma": sigma, "seed": seed}
    )
    simulation = Simulation(quick, flight, (), record.imu, deflection=deflection)
    truth = simulation.advance(math.ceil(record.n * record.dt / DT) + 1)
    t = record.dt * np.arange(record.n)
    every = round(record.dt / DT)

    def sampled(column: Array) -> Array:
        if abs(every * DT - record.dt) < 1e-9:
            return np.array(column[::every][: record.n])
        return np.asarray(np.interp(t, truth["time"], column))

    out = {name: sampled(truth["v_north" if name == "v_along" else name]) for name in record.signals}
    out[_THROUGH] = np.hypot(sampled(truth["v_north"]), sampled(truth["v_down"]))
    return out


def _noisy(
    signals: Mapping[str, Array], noise: Mapping[str, float], dt: float, rng: np.random.Generator, draws: int
) -> dict[str, Array]:
    """Each signal (n,) with `draws` draws of its sensor's noise, (draws, n); airspeed and pressure share a sensor."""
    n = len(next(iter(signals.values())))
    decay = math.exp(-dt / COLOUR_S)
    out: dict[str, Array] = {}
    for name in sorted(signals):
        x = signals[name]
        sd = noise.get(name, 0.0)
        if not sd:
            out[name] = np.broadcast_to(x, (draws, n))
            continue
        white = rng.standard_normal((draws, n))
        kicks = rng.standard_normal((draws, n)) * math.sqrt(1 - decay**2)
        kicks[:, 0] /= math.sqrt(1 - decay**2)
        slow = signal.lfilter([1.0], [1.0, -decay], kicks, axis=-1)
        out[name] = x + sd * (math.sqrt(1 - COLOURED_SHARE) * white + math.sqrt(COLOURED_SHARE) * slow)
    speed = signals["airspeed"]
    out["dynamic_pressure"] = signals["dynamic_pressure"] * (out["airspeed"] / speed) ** 2
    return out


def _covariance(z: Complex) -> Complex:
    """(flights, k, m) -> (m, k, k), smoothed over frequency."""
    raw: Complex = np.einsum("fim,fjm->mij", z, np.conj(z)) / len(z)
    half = len(SMOOTHING) // 2
    m = len(raw)
    out: Complex = np.zeros_like(raw)
    total = np.zeros(m)
    for offset, weight in zip(range(-half, half + 1), SMOOTHING, strict=True):
        a, b = max(0, -offset), min(m, m - offset)
        if a < b:
            out[a:b] += weight * raw[a + offset : b + offset]
            total[a:b] += weight
    return np.asarray(out / total[:, None, None], dtype=complex)


# --- the sensors' noise, from the record itself

_BANDS: Final = ((0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.98))
"""Shares of half the sampling rate."""


def _powers(x: Array) -> Array:
    """Power (..., bands) of a series per _BANDS: the variance of the white series that has as much there."""
    n = x.shape[-1]
    window = signal.windows.hann(n)
    spectrum = np.abs(fft.rfft(signal.detrend(x, axis=-1) * window, axis=-1)) ** 2 / float((window**2).sum())
    share = np.arange(spectrum.shape[-1]) / (0.5 * n)
    out = np.stack([spectrum[..., (share >= a) & (share < b)].mean(-1) for a, b in _BANDS], axis=-1)
    return np.asarray(out)


def _levels(
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

    mine, theirs = power(measured), power(model) / SIGMA**2
    noise = dict(stated)
    guess = 0.0
    powers = {name: _signal_powers(name, record, flights, s.nominal) for name in stated if name in record.signals}
    for _ in range(3):
        white = (noise["alpha_vane"] / _gain(s.nominal, "alpha_vane")) ** 2
        guess = math.sqrt(max(mine - 1.3 * white, 0.0) / theirs)
        for name, sd in stated.items():
            if name in record.signals:
                # Below that a record has been smoothed, and its noise above the motion's band says nothing.
                least = sd * (SMOOTHED if record.stated.get(_ALIAS.get(name, name)) else 1.0)
                noise[name] = max(_level(name, sd, record, powers[name], guess), least)
    return {n: v for n, v in noise.items() if n in record.signals}, guess


def _signal_powers(name: str, record: Record, flights: Flights, aircraft: Aircraft) -> tuple[Array, Array, Array]:
    """Power per band of what was measured, of the motion, and of the answer to gusts of SIGMA, as the aircraft's
    instrument shows them."""
    shown = _gain(aircraft, name) ** 2
    motion, gusts = _powers(flights.nominal[name]), _powers(flights.turbulent[name]).mean(0)
    return _powers(record.signals[name]), shown * motion, shown * gusts


def _level(name: str, stated: float, record: Record, powers: tuple[Array, Array, Array], gust: float) -> float:
    """Noise of one signal: the power where neither the motion nor the gust reaches."""
    if name in record.held:
        return stated
    if name == "elevator":
        return _between_steps(record.signals[name]) / math.sqrt(1 - COLOURED_SHARE)
    mine, motion, gusts = powers
    expected = motion + gusts * (gust / SIGMA) ** 2
    clear = np.flatnonzero(mine > 2 * expected)
    if not len(clear):
        return min(stated, math.sqrt(float(mine.min())))
    # The lowest clear band is the nearest to what is judged: interpolation between samples takes noise from the others.
    return math.sqrt(float((mine - expected)[clear[0]]) / (1 - COLOURED_SHARE))


def _between_steps(x: Array) -> float:
    """White noise of an input that moves in steps: from the median of its fourth differences."""
    return float(np.median(np.abs(np.diff(x, 4)))) / 0.6745 / math.sqrt(70.0)
