"""Noise of sensors as a record shows it, its rig states it, or rounding makes it; and gusts that last."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import to_si
from station.diagnosis.measured_record import Record
from station.diagnosis.processing import HIGH_HZ, LOW_HZ
from station.numerics.default_noise import DEFAULT_NOISE
from station.profile import NO_BOOM, Aircraft

Array = NDArray[np.float64]

FAST_S: Final = 0.025
"""Time step up to which fourth differences of the samples show a sensor's noise and no motion."""
SLOW_SHARE: Final = 0.25
"""Variance of a sensor's slow noise over that of its white noise, where nothing is known."""
REPEATED: Final = 0.2
"""Share of samples that repeat the one before, from which a signal is rounded coarsely."""
ROUNDED: Final = 1e-6
"""Of a signal's range: smaller steps are a file's rounding, or the grid's."""
FEWEST: Final = 4
"""Steps of rounding in a signal's range: of fewer, what it does is not seen, or it is a test input of few levels."""
LINES: Final = 40
"""Of a saw's tooth that are counted: what lies beyond is 2 % of its variance."""
RECORDED_THRUST: Final = 0.005
"""Of the mean thrust: noise of a recorded one."""
GUST_SCALE_M: Final = to_si(1750, "ft")
"""Of the gust's spectrum (MIL-F-8785C, above 2,000 ft). Its shape decides nothing: lift is fed with the gust shown."""


def lasting_updraught(record: Record, aircraft: Aircraft) -> float:
    """m/s, standard deviation of the mean of gusts across the path as strong as those that the vane shows beyond the
    motion (Dryden's spectrum across it: a correlation of exp(-x/L) (1 - x/2L), L = GUST_SCALE_M); 0 where the vertical
    speed is not recorded."""
    x = record.signals
    if "v_down" not in x:
        return 0.0
    v, boom = x["airspeed"], aircraft.boom or NO_BOOM
    angle = boom.steady_calibration * x["alpha_vane"] + x["q"] * boom.vane_x / v - x["theta"] - x["v_down"] / v
    long = float(v.mean()) * record.seconds / GUST_SCALE_M
    lasting = -math.expm1(-long) / long
    return float(np.std(v * angle)) * math.sqrt(lasting / (1 - lasting))


def lasting_gust(record: Record) -> float:
    """m/s, standard deviation of the mean of gusts along the path as strong as those of the record, where ground speed
    shows them (Dryden's spectrum along the path: a correlation of exp(-x/GUST_SCALE_M)); else 0."""
    x = record.signals
    along = x.get("v_along", x.get("v_ahead"))
    if along is None:
        return 0.0
    long = float(x["airspeed"].mean()) * record.seconds / GUST_SCALE_M
    lasting = 2 / long * (1 + math.expm1(-long) / long)
    noise = white_noise("airspeed", record) ** 2 + stated_noise("v_along", record) ** 2
    moving = max(float(np.var(x["airspeed"] - along)) - noise, 0.0)
    return math.sqrt(moving * lasting / (1 - lasting))


def white_noise(name: str, record: Record) -> float:
    """Noise of one sensor as the record shows it, sample against sample, where it is fast enough; else as stated."""
    if not _shows_noise(name, record):
        return stated_noise(name, record)
    x = record.signals[name]
    size, step = np.abs(np.diff(x, 4)), quantum(x)
    # Outliers do not move the median; but of rounded ones that is a whole number of steps, which the mean is not.
    sd = float(size.mean()) * math.sqrt(0.5 * math.pi) if step else float(np.median(size)) / 0.6745
    return max(sd / math.sqrt(70.0), step / math.sqrt(12.0), 0.1 * stated_noise(name, record))


def judged_noise(name: str, record: Record) -> float:
    """Standard deviation, SI, of white noise at the record's rate that has between LOW_HZ and HIGH_HZ the density of a
    sensor's noise. Where rounding repeats a value for long, its error lies at low frequencies, and that is more than
    `white_noise`, which has it spread to half of the rate."""
    white = white_noise(name, record)
    if not _shows_noise(name, record):
        return white
    return max(white, math.sqrt(_rounding_density(record.signals[name], record.dt) / (2 * record.dt)))


def _shows_noise(name: str, record: Record) -> bool:
    """Whether the samples of a signal follow each other so fast that they do."""
    return record.dt <= FAST_S and name not in record.held


def _rounding_density(x: Array, dt: float) -> float:
    """Of the error of rounding, its variance per Hz between LOW_HZ and HIGH_HZ: while a signal takes T for a step q,
    the error is a saw's tooth with lines of variance q2 / (2 pi2 k2) at k/T, and each T counts by its share of the time
    (Bennett 1948, Spectra of Quantized Signals, and Woodward's theorem on frequency modulation)."""
    if not (step := quantum(x)):
        return 0.0
    ends = np.flatnonzero(np.abs(np.diff(x)) > ROUNDED * float(np.ptp(x)))
    lasts = np.diff(np.concatenate([[-1], ends, [len(x) - 1]])) * dt
    k = np.arange(1, LINES + 1)[:, None]
    judged = (k / lasts > LOW_HZ) & (k / lasts < HIGH_HZ)
    power = float((0.5 * (step / (np.pi * k)) ** 2 * judged * lasts).sum() / lasts.sum())
    return power / (HIGH_HZ - LOW_HZ)


def quantum(x: Array) -> float:
    """The step of a signal that a recorder has rounded so far that values repeat, where the middle of its differences
    says nothing of its noise; else 0. By the values that repeat: those between are of the grid that it was put on. What
    stands still and glides from one value to the next, as a surface that is simulated, is not rounded."""
    least = ROUNDED * float(np.ptp(x))
    moves = np.diff(x)
    still = np.abs(moves) <= least
    level = np.sort(x[1:][still])
    steps = np.diff(level)
    steps = steps[steps > least]
    if not len(steps) or len(level) <= REPEATED * len(x):
        return 0.0
    step = float(np.median(steps))
    return 0.0 if np.ptp(x) < FEWEST * step or _glides(moves, ~still, least) else step


def _glides(moves: Array, going: NDArray[np.bool_], least: float) -> bool:
    """Whether most ways from one value that repeats to the next are smooth: to one side, by steps that differ. Of one
    that a grid has split, the steps between its first and its last are alike."""
    edges = np.diff(np.concatenate([[0], going, [0]]))
    ways = [moves[a + 1 : b - 1] for a, b in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True)]
    smooth = [bool(len(w) > 1 and np.ptp(w) > least and (w * w[0] > 0).all()) for w in ways]
    return 2 * sum(smooth) > len(ways)


def stated_noise(name: str, record: Record) -> float:
    """Noise of one sensor that the rig states, or a good installation has."""
    signal = {"v_along": "v_north", "v_across": "v_east"}.get(name, name)
    if name == "thrust":
        return RECORDED_THRUST * max(float(np.mean(record.signals["thrust"])), 1.0)
    return float(record.stated.get(signal) or DEFAULT_NOISE[signal])
