"""How late a surface may seem by its samples alone: a free parameter of records whose samples are slow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import signal

from station.diagnosis.free_parameters import Free
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.recorded_noise import stated_noise
from station.diagnosis.series_spectra import TAPER
from station.profile.profile_changes import delay

NEAR_HALF: Final = 0.8
"""Of half the sampling rate, from which a spectrum is that there: a few dozen frequencies."""
SOONEST: Final = 1e-4
"""s: no delay is told to as little."""


def of_sampling(manoeuvres: Sequence[Manoeuvre]) -> list[Free]:
    """How late the surfaces seem by their samples alone: nothing, where these are fast."""
    found = []
    for name in manoeuvres[0].axis.surfaces:
        sd = math.sqrt(float(np.mean([late_by_sampling(name, m) ** 2 for m in manoeuvres])))
        if sd > SOONEST:
            found.append(Free(f"{name} sampling", sd, delay(name)))
    return found


def late_by_sampling(surface: str, m: Manoeuvre) -> float:
    """Standard deviation of how late a surface may seem, s: its samples show as slow what it does faster than half
    their rate. Steps behind an actuator of time constant tau are dt2/(12 tau) late where they come with a sample and
    dt2/(24 tau) early between two, over all dt2/(27 tau) (Euler and Maclaurin's sum of the samples less its integral);
    of a flight that is timed they may all be alike."""
    half, own = 0.5 / m.recorded.dt, m.setting.frequencies
    f, power = signal.periodogram(m.recorded.signals[surface], 2 * half, ("tukey", TAPER), detrend="linear")
    power = power * half  # white noise of variance 1 is 1
    there = float(power[f > NEAR_HALF * half].mean()) - stated_noise(surface, m.recorded) ** 2
    # Half of what is seen there is folded itself. Beyond, the spectrum of a step falls with the second power, behind a
    # slow actuator with the fourth.
    folded = 0.5 * max(there, 0.0) * (half / (2 * half - own)) ** 3
    moves = np.interp(own, f, power) * (2 * np.pi * own) ** 2
    return math.sqrt(0.5 * float(folded.sum() / max(moves.sum(), 1e-30)))
