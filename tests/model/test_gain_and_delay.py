"""A rate against its angle where there is little motion or none: numbers drawn here, of a known gain."""

import numpy as np
import pytest

from station.model.gain_and_delay import beside, compare

HZ = 50
PER_MEAN = 5
MEANS = 1200
RATE_NOISE = 2.7e-4
"""rad/s; of the bench's gyro at 50 Hz."""
ANGLE_NOISE = 4e-4
"""rad."""


def matched(rng, motion, rate_noise, angle_noise, gain=1.0):
    """An angle against its rate's integral; the rate moves by `motion`, rad/s, below 0.4 Hz."""
    n = MEANS * PER_MEAN
    slow = np.fft.irfft(np.fft.rfft(rng.normal(size=n)) / (1 + 1j * np.fft.rfftfreq(n, 1 / HZ) / 0.4), n)
    rate = motion * slow / np.std(slow)
    shown = gain * rate + rate_noise * rng.normal(size=n)
    angle = np.cumsum(rate) / HZ + angle_noise * rng.normal(size=n)
    integral = (np.cumsum(shown) - 0.5 * shown) / HZ
    y, x = angle.reshape(-1, PER_MEAN).mean(axis=1), integral.reshape(-1, PER_MEAN).mean(axis=1)
    return compare(y, x, beside(x), 0.0)


@pytest.mark.parametrize("angle_noise", [1e-6, ANGLE_NOISE, 1e-2])
def test_of_noise_alone_nothing_is_told(angle_noise):
    rng = np.random.default_rng(1)
    found = [matched(rng, 0.0, RATE_NOISE, angle_noise) for _ in range(100)]
    # Four standard deviations: one of 100 would already be a fault of the limit.
    assert all(np.isnan(f.gain) for f in found)


@pytest.mark.parametrize("gain", [1.0, 0.8, -1.0])
def test_noise_as_large_as_the_motion_does_not_make_the_gain_small(gain):
    """Taken for motion, it would halve it."""
    rng = np.random.default_rng(2)
    found = [matched(rng, 5e-3, 5e-3, ANGLE_NOISE, gain) for _ in range(60)]
    told = np.array([(f.gain, f.gain_sd) for f in found if np.isfinite(f.gain)])
    assert len(told) > 30
    error = told[:, 0] - 1 / gain
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(len(error))
    assert np.mean(np.abs(error) < 2 * told[:, 1]) > 0.84  # 95 % of 60 less four standard deviations
