"""Noise of airspeed and dynamic pressure: what they show alike, and each alone, by the difference between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from station.diagnosis.air_data import NoiseOf, air_share, smoothed, spectrum
from station.diagnosis.corrections import AIR_DATA
from station.diagnosis.measured_record import Record
from station.diagnosis.processing import HIGH_HZ, LOW_HZ, AirShare, slow_spectrum
from station.diagnosis.recorded_noise import FAST_S, SLOW_SHARE, judged_noise, white_noise

Array = NDArray[np.float64]

LEAST_OWN: Final = 0.1
"""Of airspeed's or dynamic pressure's noise, that they have alike, and each alone, at least."""
WEIGHINGS: Final = 3
"""Fits of the noise, each weighed by the one before, the first by the spectrum: by what follows the same lines' chance,
slow noise would come out a fifth too small."""


def air_noise(record: Record) -> dict[str, float]:
    """Standard deviations of what airspeed (m/s) and dynamic pressure (Pa) show of noise alike, and each alone: by the
    fourth differences of their samples where these are fast enough; else as if one sensor showed both."""
    x = record.signals
    slope = _pressure_slope(record)
    white, judged = (
        [of(name, record) / unit for name, unit in zip(AIR_DATA, (1.0, slope), strict=True)]
        for of in (white_noise, judged_noise)
    )
    alike = min(white)
    if record.dt <= FAST_S:
        a, b = (np.diff(x[n], 4) for n in ("airspeed", "dynamic_pressure"))
        # Sheppard 1899: of normal pairs, the correlation by how often their signs agree; outliers do not upset it.
        agreed = math.sin(0.5 * math.pi * float(np.mean(np.sign(a) * np.sign(b))))
        alike = math.sqrt(max(agreed, 0.0) * math.prod(white))
    least = LEAST_OWN * max(judged)
    speed, pressure = (math.sqrt(max(sd**2 - alike**2, least**2)) for sd in judged)
    return {
        "pitot": max(alike, least),
        "airspeed": speed,
        "dynamic_pressure": slope * pressure,
    }


def noise_alone(record: Record, recorded: Record) -> dict[str, NoiseOf]:
    """Of what airspeed (m/s) and dynamic pressure (Pa) of a record each show alone: the spectrum of their difference,
    which has no air in it, is the sum of both, and what one's spectrum has more than the other's is what it has more of
    noise. The white parts are at least as samples show them. Without it, noise of an airspeed that no other series
    shows takes the place of whatever turns the flow. `recorded`: at its own rate.

    Lines of a spectrum have its own square for a variance; what two differ by, where the air moves by more than they
    err, twice the product of the spectra of their mean and of their difference. By that each counts."""
    x, slope = record.signals, _pressure_slope(record)
    pressure = np.maximum(x["dynamic_pressure"], 0.0)
    speed = x["airspeed"].mean() * np.sqrt(pressure / pressure.mean())
    f, own = spectrum(x["airspeed"], record.dt)
    other, apart, mean = (
        spectrum(v, record.dt)[1] for v in (speed, x["airspeed"] - speed, 0.5 * (x["airspeed"] + speed))
    )
    f, own, other, apart, mean = (v[f < HIGH_HZ] for v in (f, own, other, apart, mean))
    units, noise = np.array([1.0, slope]), air_noise(recorded)
    known = (np.array([noise[name] for name in AIR_DATA]) / units) ** 2 * recorded.dt / record.dt
    judged, air, sum_of = f >= LOW_HZ, smoothed(f, mean), smoothed(f, apart)
    shapes = np.stack([np.ones(len(f)), slow_spectrum(f, record.dt)], axis=1)
    rows = np.block([[shapes, shapes], [shapes, -shapes]])
    shown = np.concatenate([apart - known.sum(), own - other - known[0] + known[1]])
    found = np.zeros((2, 2))
    for _ in range(WEIGHINGS):
        counts = 1 / np.maximum(np.concatenate([sum_of, np.sqrt(2 * air * sum_of)]), 1e-30) * np.tile(judged, 2)
        found = optimize.nnls(rows * counts[:, None], shown * counts)[0].reshape(2, 2)
        found[:, 0] += known
        sum_of = shapes @ found.sum(0)
    return {name: NoiseOf(*(unit**2 * v).tolist()) for name, unit, v in zip(AIR_DATA, units, found, strict=True)}


def air_share_of(record: Record, recorded: Record, shown: Mapping[str, Array]) -> AirShare | None:
    """What is taken of air data `shown` (n,), of the airspeed over its mean, beyond the motion; of none, nothing.
    `record` as of `noise_alone`."""
    if not shown:
        return None
    units = {"airspeed": 1.0, "dynamic_pressure": _pressure_slope(record)}
    speed = float(record.signals["airspeed"].mean())
    if len(shown) == len(AIR_DATA):
        white, told = air_noise(recorded)["pitot"] / speed, noise_alone(record, recorded)
        alone = {n: NoiseOf(*(x / (units[n] * speed) ** 2 for x in told[n])) for n in shown}
        alike = NoiseOf(white**2 * recorded.dt / record.dt, SLOW_SHARE * white**2)
        return air_share(shown, record.dt, alike, alone)
    (name,) = shown
    white, judged = (of(name, recorded) / (units[name] * speed) for of in (white_noise, judged_noise))
    alike = NoiseOf(judged**2 * recorded.dt / record.dt, SLOW_SHARE * white**2)
    return air_share(shown, record.dt, alike, {name: NoiseOf(LEAST_OWN**2 * alike.white, 0.0)})


def of_signals(variances: Mapping[str, float], record: Record) -> dict[str, float]:
    """Standard deviation of each recorded signal's noise, from the variances of a trim's sensors."""
    alike = {"airspeed": 1.0, "dynamic_pressure": _pressure_slope(record)}
    return {
        name: math.sqrt(v + alike.get(name, 0.0) ** 2 * variances.get("pitot", 0.0))
        for name, v in variances.items()
        if name in record.signals
    }


def _pressure_slope(record: Record) -> float:
    """d(dynamic pressure)/d(airspeed), Pa by m/s."""
    return 2 * float(record.signals["dynamic_pressure"].mean() / record.signals["airspeed"].mean())
