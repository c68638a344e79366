"""Device clocks: the truth is how the arrivals were made."""

import numpy as np
import pytest

from station.flight.timebase import ClockMap

S = 1_000_000_000


def messages(rate_hz, seconds, offset_s, drift_ppm, jitter, seed, t0_ns=5 * S):
    """True station times, device times and arrivals of one stream."""
    rng = np.random.default_rng(seed)
    true = t0_ns + (np.arange(int(rate_hz * seconds)) * (S / rate_hz)).astype(np.int64)
    device = ((true - t0_ns) * (1 + drift_ppm * 1e-6)).astype(np.int64) + int(offset_s * S)
    arrival = true + (jitter(rng, len(true)) * S).astype(np.int64)
    return true, device, np.maximum.accumulate(arrival)


def skew_rms_ms(rate_hz, offset_s, drift_ppm, jitter, seed, seconds=120.0):
    true, device, arrival = messages(rate_hz, seconds, offset_s, drift_ppm, jitter, seed)
    clock = ClockMap(round(S / rate_hz))
    errors = []
    for t, d, a in zip(true.tolist(), device.tolist(), arrival.tolist(), strict=True):
        mapped = clock.update(d, a)
        if clock.state == "synced":
            errors.append(mapped.t_ns - t)
    assert clock.state == "synced"
    return np.sqrt(np.mean(np.square(errors))) * 1e-6, clock


UNIFORM = lambda rng, n: rng.uniform(0.0, 0.005, n)  # noqa: E731
HALF_NORMAL = lambda rng, n: np.abs(rng.normal(0.0, 0.005, n))  # noqa: E731
EXPONENTIAL = lambda rng, n: rng.exponential(0.005, n)  # noqa: E731


@pytest.mark.parametrize("rate_hz", [5, 50, 200])
@pytest.mark.parametrize("jitter", [UNIFORM, HALF_NORMAL, EXPONENTIAL])
@pytest.mark.parametrize(("offset_s", "drift_ppm"), [(7200.0, 100.0), (-9000.0, -100.0), (0.0, 0.0)])
def test_offset_and_drift_are_found_to_2_ms(rate_hz, jitter, offset_s, drift_ppm):
    rms, clock = skew_rms_ms(rate_hz, offset_s, drift_ppm, jitter, seed=rate_hz)
    assert rms <= 2.0
    if rate_hz >= 50:  # the floor is touched often enough for the drift to be read off it
        assert clock.drift_ppm == pytest.approx(-drift_ppm, abs=25.0)


def test_mapping_is_never_in_the_future():
    _, device, arrival = messages(50, 30.0, 100.0, 80.0, EXPONENTIAL, 3)
    clock = ClockMap(20_000_000)
    for d, a in zip(device.tolist(), arrival.tolist(), strict=True):
        assert clock.update(d, a).t_ns <= a


@pytest.mark.parametrize("step_s", [2.0, -2.0, 0.1, -500.0])
def test_a_step_of_the_device_clock_is_followed_once_messages_agree_on_it(step_s):
    true, device, arrival = messages(200, 20.0, 10.0, 0.0, UNIFORM, 4)
    device[2000:] += int(step_s * S)
    clock = ClockMap(5_000_000)
    mapped = [clock.update(d, a) for d, a in zip(device.tolist(), arrival.tolist(), strict=True)]
    # A third of 0.45 s at 200 Hz; until then the arrival counts, never more than the link's 5 ms late.
    [told] = [i for i, m in enumerate(mapped) if m.jump_ns]
    assert 2030 <= told <= 2032
    errors = np.array([m.t_ns for m in mapped]) - true
    assert np.abs(errors[2000:told]).max() <= 5e6
    assert np.abs(errors[told:]).max() < 1e6
    assert clock.state == "synced"
    assert not any(m.stepped or m.strays for m in mapped)
    assert abs(clock.offset_s - (float(true[-1] - device[-1]) * 1e-9)) < 0.001


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 0.05])
def test_one_wrong_stamp_however_far_moves_no_clock_and_is_told(step_s):
    true, device, arrival = messages(50, 20.0, 10.0, 0.0, UNIFORM, 4)
    device[700] += int(step_s * S)
    clock = ClockMap(20_000_000)
    mapped = [clock.update(d, a) for d, a in zip(device.tolist(), arrival.tolist(), strict=True)]
    assert [(i, m.strays) for i, m in enumerate(mapped) if m.strays] == [(701, 1)]
    assert not any(m.stepped or m.jump_ns for m in mapped)
    assert np.abs(np.array([m.t_ns for m in mapped]) - true)[500:].max() <= 5e6
    before = ClockMap(20_000_000, law=3)
    assert sum(before.update(d, a).stepped for d, a in zip(device.tolist(), arrival.tolist(), strict=True)) >= 1


@pytest.mark.parametrize("silent_s", [30.0, 41.0, 60.0, 600.0])
@pytest.mark.parametrize("drift_ppm", [0.0, 80.0, -80.0])
def test_a_stream_that_comes_back_after_a_silence_is_mapped_as_before(silent_s, drift_ppm):
    """Longer than the window of 40 s it ended the flight with a division by zero."""
    true, device, arrival = messages(50, 60.0 + silent_s, 10.0, drift_ppm, UNIFORM, 6)
    back = 1500 + int(50 * silent_s)
    clock, errors = ClockMap(20_000_000), []
    for k in (*range(1500), *range(back, len(true))):
        errors.append(clock.update(int(device[k]), int(arrival[k])).t_ns - int(true[k]))
    assert clock.state == "synced"
    # At once to the link's 5 ms of jitter, and when the floor is found again to the 2 ms of any stream.
    assert np.abs(errors[1500:]).max() <= 5e6
    assert np.sqrt(np.mean(np.square(errors[1500 + 500 :]))) <= 2e6


def test_late_messages_are_late_not_a_step():
    _, device, arrival = messages(50, 20.0, 10.0, 0.0, UNIFORM, 5)
    arrival[600:700] += 200_000_000
    arrival = np.maximum.accumulate(arrival)
    clock = ClockMap(20_000_000)
    mapped = [clock.update(d, a) for d, a in zip(device.tolist(), arrival.tolist(), strict=True)]
    assert not any(m.stepped for m in mapped)
    assert min(m.late_ns for m in mapped[600:690]) > 150_000_000
    assert max(m.late_ns for m in mapped[300:600]) < 10_000_000


def test_a_clock_that_stands_still_is_rejected_and_arrival_used():
    clock = ClockMap(20_000_000)
    for k in range(10):
        mapped = clock.update(0, k * 20_000_000)
    assert clock.state == "rejected"
    assert mapped.t_ns == 9 * 20_000_000


def test_exchanges_count_again_at_once_after_a_device_has_started_anew():
    """Its journeys happen to be longer than the best one before: 3 ms each way at least, which arrival alone is off."""
    true, device, arrival = messages(50, 30.0, 0.0, 0.0, lambda rng, n: 0.003 + rng.uniform(0.0, 0.001, n), 7)
    device[1000:] = true[1000:] - true[1000] + S
    clock = ClockMap(20_000_000)
    errors = []
    for i, (t, d, a) in enumerate(zip(true.tolist(), device.tolist(), arrival.tolist(), strict=True)):
        errors.append(clock.update(d, a).t_ns - t)
        if i % 13 == 5:
            clock.exchange(t - d, 4_000_000 if i < 1000 else 7_000_000, a)
    assert np.abs(errors[900:1000]).max() < 1e6
    assert np.abs(errors[1020:]).max() < 1e6


def test_an_exchange_takes_the_shortest_journey_out():
    """With a one-way journey of 4 ms at least, arrival alone is 4 ms off; a two-way exchange says by how much."""
    true, device, arrival = messages(50, 20.0, 10.0, 0.0, lambda rng, n: 0.004 + rng.uniform(0, 0.002, n), 6)
    clock = ClockMap(20_000_000)
    for i, (d, a) in enumerate(zip(device.tolist(), arrival.tolist(), strict=True)):
        if i % 50 == 0:
            clock.exchange(int(true[i] - device[i]), 8_000_000, a)
        mapped = clock.update(d, a)
    assert abs(mapped.t_ns - true[-1]) < 500_000
