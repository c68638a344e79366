"""What an instrument did to its signal, undone: against an instrument flown step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from station.diagnosis.corrections import corrected
from station.diagnosis.processing import Setting, bridge_of
from station.diagnosis.vane_gust import undone
from station.profile import Instrument

DT, SECONDS, LAG = 0.02, 40.0, 0.085


def command_and_surface() -> tuple[np.ndarray, np.ndarray]:
    """Steps of a second, smoothed over a fifth, and a first-order actuator that follows, of steps that are short."""
    fine = 20
    t = np.arange(round(SECONDS / DT) * fine) * DT / fine
    steps = np.where((t > 10) & (t < 25), np.sign(np.sin(math.pi * t)), 0.0)
    command = np.convolve(steps, np.hanning(10 * fine) / np.hanning(10 * fine).sum(), mode="same")
    keep = math.exp(-DT / fine / LAG)
    return command[::fine], lfilter([1 - keep], [1, -keep], command)[::fine]


@pytest.mark.parametrize("late", [True, False])
def test_a_first_order_lag_is_undone_whichever_side_of_the_surface_the_sensor_is(late: bool) -> None:
    """An actuator's command shows what is to come: undone, it is less at high frequencies. It had been raised, by 85 ms
    to 1.9 times at 3 Hz, where the surface has half of it left."""
    command, surface = command_and_surface()
    shown, true = (surface, command) if late else (command, surface)
    stated = Instrument().model_copy(update={"lag": LAG if late else -LAG})
    n = len(shown)
    setting = Setting(DT, n, bridge_of(DT, n), (0,), (0.0, 0.0, 0.0), 0.0, 1e-4, False, {})
    size = np.ptp(true)
    # Sampling and steps of half a millisecond leave a fiftieth of what the lag moves.
    moved = np.abs(shown - true).max()
    assert moved > 0.3 * size
    for made in (corrected(shown, stated, setting), undone(shown, stated, DT)):
        inside = slice(100, -100)
        assert np.abs(made - true)[inside].max() < 0.05 * moved
