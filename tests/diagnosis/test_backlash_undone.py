"""A surface behind backlash, from a noisy sensor on its drive."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from station.diagnosis.corrections import corrected
from station.diagnosis.processing import Setting, bridge_of
from station.profile import Instrument

DT, NOISE, BACKLASH = 0.04, 2.5e-4, 9e-3
TIME = np.arange(1500) * DT


def behind(drive: NDArray[np.float64], backlash: float) -> NDArray[np.float64]:
    """The surface: it moves only while the drive pushes at an end of the backlash, and starts in its middle."""
    out, at = np.empty_like(drive), drive[0]
    for k, x in enumerate(drive):
        if x - at > backlash / 2:
            at = x - backlash / 2
        elif at - x > backlash / 2:
            at = x + backlash / 2
        out[k] = at
    return out


def pilot() -> NDArray[np.float64]:
    """Never at rest: sines of 0.1 to 1.1 Hz, some 2 deg in all."""
    rng = np.random.default_rng(1)
    tones = [np.sin(2 * np.pi * f * TIME + 6 * rng.random()) for f in (0.11, 0.23, 0.37, 0.61, 1.1)]
    return np.asarray(0.012 * np.sum(tones, axis=0))


def doublets() -> NDArray[np.float64]:
    """Held for two seconds each way, through an actuator of 0.1 s."""
    out, asked = np.zeros_like(TIME), 0.06 * np.sign(np.sin(2 * np.pi * TIME / 4)) * (TIME % 12 < 4)
    for k in range(1, len(out)):
        out[k] = out[k - 1] + 0.33 * (asked[k - 1] - out[k - 1])
    return out


@pytest.mark.parametrize("drive", [pilot(), doublets()], ids=["pilot", "doublets"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_surface_turns_when_its_drive_has_crossed_the_backlash(drive: NDArray[np.float64], seed: int) -> None:
    """A drive that never rests is not taken to turn late, and noise on one that does is not taken for motion: what is
    wrong is less than the noise itself, at the frequencies that are judged."""
    s = Setting(DT, len(TIME), bridge_of(DT, len(TIME)), (0,), (0.0, 0.0, 0.0), 0.0, NOISE, False, {})
    shown = drive + NOISE * np.random.default_rng(seed).standard_normal(len(drive))
    error = corrected(shown, Instrument(backlash=BACKLASH), s) - behind(drive, BACKLASH)
    judged = np.fft.irfft(np.fft.rfft(error)[: int(3.0 * len(error) * DT)], len(error))
    assert judged.std() < NOISE, judged.std() / NOISE
