"""What an emulated device sends, from truth and card, without ports, processes or time."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers import emulated_device
from drivers.adapter import open_devices
from drivers.codec import Reading
from drivers.emulated_messages import TRUTH_HZ, DeviceScript, Outgoing, Truth
from drivers.mavlink import MavlinkEncoder
from drivers.protocols import protocol_named
from drivers.serial_boombox import BoomboxCodec
from station.clock import ManualClock
from station.profile import Card, Rig, SerialDevice, load_rig, profiles_dir

RIGS = profiles_dir() / "rigs"
START_NS = 5_000_000_000_000
COUNT = math.radians(0.005)
STEP = 0.1
"""Seconds of truth handed over at once."""


def boom(noise: float = 0.0, latency: str = "0 s") -> SerialDevice:
    channels = {
        name: {"field": f"v{i}", "unit": "deg", "slope": 0.005, "noise": noise}
        for i, name in enumerate(("alpha_vane", "beta_vane", "elevator"))
    }
    pot = {"field": "v0", "unit": "deg", "table": [[0, -20], [1000, 0], [3000, 20]]}
    rig = Rig.model_validate(
        {
            "name": "test",
            "devices": [
                {
                    "name": "boom",
                    "link": "serial",
                    "protocol": "boombox",
                    "port": "emulated",
                    "streams": [
                        {"name": "vanes", "message": 1, "rate": "200 Hz", "latency": latency, "signals": channels},
                        {"name": "pots", "message": 2, "rate": "50 Hz", "signals": {"rudder": pot}},
                    ],
                }
            ],
        }
    )
    device = rig.devices[0]
    assert isinstance(device, SerialDevice)
    return device


def card(*faults: dict[str, Any], **flight: Any) -> Card:
    return Card.model_validate(
        {
            "name": "test",
            "aircraft": "twin_otter",
            "rig": "test",
            "flight": {"device_clock_offset": "3600 s", "device_clock_drift_ppm": 0.0, **flight},
            "faults": [{"device": "boom", **fault} for fault in faults],
        }
    )


def truth_of(signals: tuple[str, ...], seconds: float) -> NDArray[np.float64]:
    """Each signal a sine of its own frequency, rows at TRUTH_HZ."""
    t = np.arange(round(seconds * TRUTH_HZ) + 1) / TRUTH_HZ
    return np.column_stack([0.1 * np.sin(2 * math.pi * (0.3 + 0.2 * i) * t) for i in range(len(signals))])


def alpha(t: float) -> float:
    return 0.1 * math.sin(2 * math.pi * 0.3 * t)


def sent(
    device: SerialDevice, flown: Card, seconds: float = 3.0, index: int = 0, rows: int = 20
) -> list[tuple[float, bytes]]:
    """(flight s when due, bytes) of the whole flight, handed over `rows` at a time."""
    script = DeviceScript(index, device, flown, START_NS, protocol_named(device.protocol).encode)
    truth = truth_of(script.signals, seconds)
    out: list[Outgoing] = []
    for first in range(0, len(truth), rows):
        out += script.extend(truth[first : first + rows])
    return wire_of(script, out)


def wire_of(script: DeviceScript, messages: list[Outgoing]) -> list[tuple[float, bytes]]:
    """(flight s when due, bytes) of what is not lost, as the device's process sends it."""
    in_order = sorted(messages, key=lambda m: m.due_ns)
    return [((m.due_ns - START_NS) * 1e-9, data) for m in in_order if (data := script.encode(m))]


def heard(messages: list[tuple[float, bytes]], message: int = 1) -> list[tuple[float, Reading]]:
    """What the production codec reads, with the time it was sent; in order of arrival."""
    codec = BoomboxCodec()
    out = []
    for due, data in messages:
        out += [(due, r) for r in codec.feed(data) if isinstance(r, Reading) and r.message == message]
    return out


def device_s(reading: Reading) -> float:
    """Device time as flight seconds, for a device an hour ahead."""
    assert reading.t_device_ns is not None
    return ((reading.t_device_ns - START_NS - 3600 * 10**9) % reading.wrap_ns) * 1e-9


def test_values_stamps_rates_and_numbers_are_the_truth_within_a_count() -> None:
    readings = heard(sent(boom(), card()))
    assert len(readings) == 601
    for k, (due, reading) in enumerate(readings):
        assert due == pytest.approx(k / 200, abs=1e-9)
        assert device_s(reading) == pytest.approx(k / 200, abs=1e-6)
        assert reading.seq == k % 256
        assert math.radians(reading.fields["v0"] * 0.005) == pytest.approx(alpha(k / 200), abs=COUNT / 2 + 1e-6)


def test_a_pot_is_sent_through_the_inverse_of_its_table() -> None:
    device = boom()
    channel = device.streams[1].signals["rudder"]
    readings = heard(sent(device, card()), message=2)
    assert len(readings) == 151
    for k, (_, reading) in enumerate(readings):
        truth = 0.1 * math.sin(2 * math.pi * 0.9 * k / 50)
        assert channel.to_si(reading.fields["v0"]) == pytest.approx(truth, abs=math.radians(0.02))


def test_latency_makes_values_older_than_their_stamp() -> None:
    for _, reading in heard(sent(boom(latency="30 ms"), card()))[10:]:
        value = math.radians(reading.fields["v0"] * 0.005)
        assert value == pytest.approx(alpha(device_s(reading) - 0.03), abs=COUNT / 2 + 1e-5)


def test_noise_is_the_rigs_and_repeats_with_the_seed_however_the_flight_is_cut() -> None:
    device = boom(noise=0.05)
    once = sent(device, card())
    assert sent(device, card(), rows=7) == once
    assert sent(device, card(seed=2)) != once
    noise = [r.fields["v0"] * 0.005 - math.degrees(alpha(k / 200)) for k, (_, r) in enumerate(heard(once))]
    assert float(np.std(noise)) == pytest.approx(0.05, rel=0.1)
    assert abs(float(np.mean(noise))) < 0.01


@pytest.mark.parametrize(("length", "mean"), [("0 s", 1 / 0.8), ("50 ms", 10.0)])
def test_a_link_loses_its_share_of_messages_and_their_numbers(length: str, mean: float) -> None:
    lossy = boom()
    vanes = lossy.streams[0].model_copy(update={"dropout": 0.2, "dropout_length": float(length.split()[0]) / 1000})
    device = lossy.model_copy(update={"streams": (vanes, *lossy.streams[1:])})
    once = sent(device, card(), seconds=60.0)
    assert sent(device, card(), seconds=60.0, rows=33) == once
    numbers = [r.seq or 0 for _, r in heard(once)]
    missing = [(b - a - 1) % 256 for a, b in pairwise(numbers)]
    gaps = [n for n in missing if n]
    # A gap's length and the way to the next are geometric: each mean is known to 1/sqrt(gaps) of itself.
    assert sum(gaps) / len(gaps) == pytest.approx(mean, rel=4 / math.sqrt(len(gaps)))
    assert sum(missing) / 12_001 == pytest.approx(0.2, rel=6 / math.sqrt(len(gaps)))
    assert len(heard(once, message=2)) == 3001


def test_a_recording_gets_no_noise_on_top_of_its_own() -> None:
    assert sent(boom(noise=0.05), card(source="recording")) == sent(boom(), card())


def test_each_device_clock_has_its_own_offset_and_drift() -> None:
    device = boom()
    flown = card(device_clock_drift_ppm=100.0)
    for index, drift in ((0, 100e-6), (1, -200e-6), (2, 300e-6)):
        clock = DeviceScript(index, device, flown, START_NS, protocol_named(device.protocol).encode).clock
        offset_ns = (index + 1) * 3600 * 10**9
        assert clock.at(START_NS) == START_NS + offset_ns
        assert clock.at(START_NS + 10**9) - clock.at(START_NS) == round(1e9 * (1 + drift))


def test_angles_are_interpolated_the_short_way_round() -> None:
    truth = Truth(("psi", "theta"), keep_s=1.0)
    truth.append(np.array([[math.pi - 0.01, 0.0], [-math.pi + 0.01, 0.2]]))
    column = np.array([0, 1])
    (psi, theta), (late, _) = truth.at(np.array([0.5, 0.75]) / TRUTH_HZ, column)
    assert abs(psi) == pytest.approx(math.pi)
    assert theta == pytest.approx(0.1)
    assert late == pytest.approx(-math.pi + 0.005)


def test_signals_the_flight_lacks_are_sent_as_no_reading_or_not_at_all() -> None:
    device = boom()
    absent = ("beta_vane", "rudder")
    script = DeviceScript(0, device, card(), START_NS, protocol_named(device.protocol).encode, absent=absent)
    assert script.signals == ("alpha_vane", "beta_vane", "elevator")
    truth = truth_of(script.signals, 0.2)
    truth[:, 1] = math.nan
    messages = wire_of(script, script.extend(truth))
    assert heard(messages, message=2) == []
    assert all(math.isnan(r.fields["v1"]) and not math.isnan(r.fields["v2"]) for _, r in heard(messages))


@pytest.mark.parametrize(
    ("rig", "device", "message", "absent", "there"),
    [
        ("bench", 1, "GYRO", "r", ("p", "q")),
        ("bench", 1, "AIR", "airspeed", ("dynamic_pressure",)),
        ("bench", 2, "ATTITUDE", "psi", ("phi", "theta")),
        ("bench", 2, "GLOBAL_POSITION_INT", "altitude", ("latitude", "longitude")),
        ("boom_serial", 1, "NAV-PVT", "latitude", ("v_north", "v_east", "v_down")),
    ],
)
def test_a_signal_that_shares_a_message_and_is_absent_is_no_zero(
    rig: str, device: int, message: str, absent: str, there: tuple[str, ...], tmp_path: Path
) -> None:
    own = load_rig(rig).devices[device]
    wire = emulated_device.wire_of(own, RIGS, tmp_path)
    wire.port.close()
    endpoints = {d.name: "nowhere" for d in load_rig(rig).devices}
    codec = open_devices(load_rig(rig), endpoints, RIGS, ManualClock(), lambda row: None)[device].codec
    channels = {n: c for s in own.streams if s.message == message for n, c in s.signals.items()}
    fields = {c.field: math.nan if n == absent else c.from_si(1.0) for n, c in channels.items()}
    if own.link == "mavlink":
        codec.feed(MavlinkEncoder().heartbeat())  # who it is
    (reading,) = codec.feed(wire.encode(Reading(message, 0, 0, fields)))
    assert isinstance(reading, Reading)
    assert math.isnan(reading.fields.get(channels[absent].field, math.nan))
    for name in there:
        assert channels[name].to_si(reading.fields[channels[name].field]) == pytest.approx(1.0, rel=0.02)


def during(readings: list[tuple[float, Reading]], start: float = 1.0, end: float = 2.0) -> list[Reading]:
    return [r for due, r in readings if start <= due < end]


def outside(readings: list[tuple[float, Reading]], start: float = 1.0, end: float = 2.0) -> list[Reading]:
    return [r for due, r in readings if not start <= due < end]


def fault(kind: str, **more: Any) -> dict[str, Any]:
    return {"kind": kind, "start": "1 s", "duration": "1 s", **more}


@pytest.fixture
def healthy() -> list[tuple[float, Reading]]:
    return heard(sent(boom(), card()))


def test_off_is_silence_without_missing_numbers() -> None:
    readings = heard(sent(boom(), card(fault("off"))))
    assert during(readings) == []
    assert all((b.seq or 0) == ((a.seq or 0) + 1) % 256 for (_, a), (_, b) in pairwise(readings))


def test_a_stream_fault_leaves_the_other_streams_alone() -> None:
    messages = sent(boom(), card(fault("off", stream="vanes")))
    assert during(heard(messages)) == []
    assert heard(messages, message=2) == heard(sent(boom(), card()), message=2)


def test_stuck_freezes_the_values_while_stamps_and_numbers_go_on(healthy: list[tuple[float, Reading]]) -> None:
    readings = heard(sent(boom(noise=0.05), card(fault("stuck"))))
    frozen = during(readings)
    assert len({tuple(r.fields.values()) for r in frozen}) == 1
    assert tuple(frozen[0].fields.values()) == tuple(readings[199][1].fields.values())
    assert [(r.seq, r.t_device_ns) for r in frozen] == [(r.seq, r.t_device_ns) for r in during(healthy)]
    assert len({r.fields["v0"] for r in outside(readings)}) > 100


def test_wrong_adds_to_one_signal_only(healthy: list[tuple[float, Reading]]) -> None:
    readings = heard(sent(boom(), card(fault("wrong", signal="beta_vane", value=0.05))))
    for bad, good in zip(during(readings), during(healthy), strict=True):
        assert (bad.fields["v1"] - good.fields["v1"]) * COUNT == pytest.approx(0.05, abs=1.01 * COUNT)
        assert bad.fields["v0"] == good.fields["v0"]
    assert outside(readings) == outside(healthy)


def test_slow_divides_the_rate_without_missing_numbers() -> None:
    readings = heard(sent(boom(), card(fault("slow", value=8.0))))
    assert len(during(readings)) == 25
    assert len(outside(readings)) == 401
    assert all((b.seq or 0) == ((a.seq or 0) + 1) % 256 for (_, a), (_, b) in pairwise(readings))


def test_delayed_messages_arrive_late_in_order_with_their_old_stamps(healthy: list[tuple[float, Reading]]) -> None:
    readings = heard(sent(boom(), card(fault("delayed", value=0.3))))
    late = [(due - device_s(r)) for due, r in readings]
    assert [r for _, r in readings] == [r for _, r in healthy]
    stamps = [device_s(r) for _, r in readings]
    assert all(
        lag == pytest.approx(0.3, abs=1e-6) for t, lag in zip(stamps, late, strict=True) if 1.0 <= t + 1e-9 < 2.0
    )
    assert all(lag < 1e-5 for t, lag in zip(stamps, late, strict=True) if t < 0.999 or t > 2.301)


def test_intermittent_loses_its_share_and_the_numbers_show_it(healthy: list[tuple[float, Reading]]) -> None:
    readings = heard(sent(boom(), card(fault("intermittent", value=0.3))))
    kept = during(readings)
    assert len(kept) == pytest.approx(140, abs=25)
    assert all(r in during(healthy) for r in kept)
    assert outside(readings) == outside(healthy)


def test_garbage_is_refused_by_the_codec_and_what_is_between_is_kept(healthy: list[tuple[float, Reading]]) -> None:
    messages = sent(boom(), card(fault("garbage", value=0.5)))
    codec = BoomboxCodec()
    readings = [(due, r) for due, data in messages for r in codec.feed(data) if isinstance(r, Reading)]
    mine = [(due, r) for due, r in readings if r.message == 1]
    assert codec.bad > 30
    assert 20 < len(during(mine)) < 100
    assert all(r in during(healthy) for r in during(mine))
    assert len(outside(mine)) >= len(outside(healthy)) - 1
    assert sent(boom(), card(fault("garbage", value=0.5))) == messages


def test_a_clock_step_moves_the_stamps_and_back(healthy: list[tuple[float, Reading]]) -> None:
    readings = heard(sent(boom(), card(fault("clock_step", value=0.25))))
    for (due, stepped), (_, good) in zip(readings, healthy, strict=True):
        jump = device_s(stepped) - device_s(good)
        assert jump == pytest.approx(0.25 if 1.0 <= due < 2.0 else 0.0, abs=1e-6)
        assert stepped.fields == good.fields


def test_unplugging_is_told_as_spans_of_flight_time() -> None:
    device = boom()
    script = DeviceScript(0, device, card(fault("unplug")), START_NS, protocol_named(device.protocol).encode)
    assert script.unplugged == ((1.0, 2.0),)
    assert DeviceScript(0, device, card(), START_NS, protocol_named(device.protocol).encode).unplugged == ()
