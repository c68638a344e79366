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
from scipy import signal

from station.conventions import to_si
from station.diagnosis.backlash import linearised
from station.diagnosis.corrections import instrument_of
from station.diagnosis.measured_record import Record
from station.diagnosis.memo import Memo
from station.diagnosis.noise_levels import THRUST_SHARE, Flights, levels, noisy, stated_noise, true_noise
from station.diagnosis.processing import Setting, bridge_of
from station.diagnosis.residuals import SERIES, Spectra, flow_angle, series, series_spectra, spectra
from station.numerics.differentiation import derivative
from station.profile import Actuator, Aircraft, Flight, Instrument
from station.rows import ProfileError, UsageError
from station.simulation.airframe import constants
from station.simulation.motion import DT
from station.simulation.three_degrees import Simulation

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FLIGHTS: Final = 40
DRAWS: Final = 96
MORE_DRAWS: Final = 6
"""Draws of noise laid over what was measured: each says it at hundreds of frequencies."""
TURBULENT: Final = to_si(5, "ft/s") / to_si(110, "kt")
"""Vertical gust that the flights in turbulence are flown in, rad of flow angle."""
CALM_BELOW: Final = to_si(1, "ft/s") / to_si(110, "kt")
"""The same below which air is calm."""
SMOOTHING: Final = (1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0)
"""Weights of neighbouring frequencies in a covariance."""
_SEED: Final = 7_340_001
"""Of the first gust field: far from the seeds that flights are given."""
_THROUGH: Final = "through the air mass"
LEAST_DRIFT: Final = 0.05
_QUICK_ACTUATOR: Final = Actuator().model_copy(update={"time_constant": 0.02, "rate_limit": 1e3, "position_limit": 1.5})
_INPUT_PASS_HZ: Final = 7.0
_ROUNDING: Final = 1e-9
"""Of time steps, s."""


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

    def with_more_noise(self) -> Reference:
        """The same with draws of its sensors' noise laid over what was measured, (MORE_DRAWS, n)."""
        signals = noisy(self.record.signals, self.noise, self.record.dt, np.random.default_rng(29), MORE_DRAWS)
        return replace(self, record=replace(self.record, signals=signals), memo=Memo())

    def flow_angle(self, aircraft: Aircraft) -> Array:
        """The angle of attack at the CG from an aircraft's vane and the motion, rad, (n,)."""
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
    """Fly a record's elevator at its speed, both as the profile's instruments read them. Raises UsageError where the
    profile cannot be flown like that."""
    plain = bare(loaded(aircraft, record, *(loading or shares(aircraft, record))))
    speed = float(np.mean(_rescaled(record.signals["airspeed"], instrument_of(aircraft, "airspeed"))))
    try:
        trim = constants(plain, speed, record.height)
    except ProfileError as error:
        raise UsageError(f"{record.name}: {error}\nis it another aircraft's profile? use --aircraft") from error
    deflection = _deflection(record, _rescaled(record.signals["elevator"], instrument_of(aircraft, "elevator")))
    nominal = _fly(plain, record, speed, deflection, 0.0, seed)
    sigma = TURBULENT * speed
    gusts = [_fly(plain, record, speed, deflection, sigma, _SEED + seed + k) for k in range(FLIGHTS)]
    turbulent = {name: np.stack([g[name] for g in gusts]) for name in nominal}
    drift = (turbulent.pop(_THROUGH) - turbulent["airspeed"]).mean(-1, keepdims=True)
    del nominal[_THROUGH]
    return Flights(nominal, turbulent, drift, trim.trim_thrust, sigma)


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
    stated = stated_noise(record)

    def setting(gusty: bool, subject: Aircraft, elevator_noise: float) -> Setting:
        return Setting(
            record.dt, record.n, bridge_of(record.dt, record.n), gusty, judged, record.imu, flights.trim_thrust,
            subject, elevator_noise, "v_down" not in record.signals, record.held,
        )  # fmt: skip

    noise, guess = levels(record, flights, stated, plain, setting(True, flown, stated["elevator"]))
    if "thrust" not in record.signals:
        noise["thrust"] = THRUST_SHARE * flights.trim_thrust
        # Nor is known how somebody who holds the speed answers gusts.
        turbulent = {name: x for name, x in turbulent.items() if name != "thrust"}
    gusty = guess > CALM_BELOW * float(np.mean(nominal["airspeed"]))
    own = setting(gusty, plain, noise["elevator"])
    mean = spectra(series(nominal, plain, own), own)
    drift = flights.drift
    gust_part = spectra(series(turbulent, plain, own, drift), own).minus(mean)
    calm, steady_calm = _of_noise(nominal, true_noise(noise, flown), plain, own, mean, seed)
    k = len(judged)
    steady_gust = np.atleast_2d(np.cov(gust_part.steady.T)) * (FLIGHTS - 1) / (FLIGHTS - k - 2)
    return Reference(
        record,
        setting(gusty, flown, noise["elevator"]),
        mean,
        Whitener.of(calm, _covariance(gust_part.bins / flights.sigma)),
        Whitener.of(steady_calm, (steady_gust[None] / flights.sigma**2).astype(complex)),
        nominal,
        noise,
        guess,
        LEAST_DRIFT + float(drift.std()) * guess / flights.sigma,
        own_shares[0],
        own_shares[1],
        flights,
    )


def with_noise_through(r: Reference, aircraft: Aircraft) -> Reference:
    """The same manoeuvre with the sensors' noise as it passes through another aircraft's lift and moment."""
    plain = bare(loaded(aircraft, r.record, r.mass_share, r.iyy_share))
    own = replace(r.setting, nominal=bare(r.setting.nominal))
    middle = spectra(series(r.nominal, plain, own), own)
    calm, steady = _of_noise(r.nominal, true_noise(r.noise, r.setting.nominal), plain, own, middle, 0)
    turbulent, steady_turbulent = spread(r.bins)[1], spread(r.steady)[1]
    return replace(r, bins=Whitener.of(calm, turbulent), steady=Whitener.of(steady, steady_turbulent))


def _of_noise(
    nominal: Mapping[str, Array], noise: Mapping[str, float], aircraft: Aircraft, s: Setting, mean: Spectra, seed: int
) -> tuple[Complex, Complex]:
    """Covariance of what the sensors' noise makes of the series about their `mean`: (m, k, k), and (1, k, k) of the
    steady parts."""
    draws = noisy(nominal, noise, s.dt, np.random.default_rng([seed, 17]), DRAWS)
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
    """A signal with its instrument's bias, gain and nonlinearity taken out, not its delay."""
    if found is None:
        return x
    x = (x - found.bias) / found.gain
    return linearised(x, found.cubic) if found.cubic else x


def _deflection(record: Record, elevator: Array) -> Array:
    """The command (rad from trim, at half steps) that a quick actuator turns into that elevator."""
    share = min(2 * _INPUT_PASS_HZ * record.dt, 0.8)
    smooth = signal.sosfiltfilt(signal.butter(4, share, output="sos"), elevator)
    t = record.dt * np.arange(record.n)
    fine = np.arange(0.0, t[-1] + DT, 0.5 * DT)
    position = np.interp(fine, t, smooth - np.median(smooth))
    command: Array = position + _QUICK_ACTUATOR.time_constant * derivative(position, 0.5 * DT)
    return command


def _fly(
    aircraft: Aircraft, record: Record, speed: float, deflection: Array, sigma: float, seed: int
) -> dict[str, Array]:
    """The record's signals and the thrust, flown without noise."""
    quick = aircraft.model_copy(update={"elevator": _QUICK_ACTUATOR})
    flight = Flight().model_copy(
        update={"speed": speed, "altitude": max(record.height, 0.0), "gust_sigma": sigma, "seed": seed}
    )
    simulation = Simulation(quick, flight, (), record.imu, deflection=deflection)
    truth = simulation.advance(math.ceil(record.n * record.dt / DT) + 1)
    t = record.dt * np.arange(record.n)
    every = round(record.dt / DT)

    def sampled(column: Array) -> Array:
        if abs(every * DT - record.dt) < _ROUNDING:
            return np.array(column[::every][: record.n])
        return np.asarray(np.interp(t, truth["time"], column))

    names = dict.fromkeys((*record.signals, "thrust"))
    out = {name: sampled(truth["v_north" if name == "v_along" else name]) for name in names}
    out[_THROUGH] = np.hypot(sampled(truth["v_north"]), sampled(truth["v_down"]))
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
