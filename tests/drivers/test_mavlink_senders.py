"""Who speaks on a MAVLink link, and who is heard."""

from __future__ import annotations

import pytest

from drivers.mavlink import MOST_FOREIGN, MavlinkCodec, MavlinkEncoder
from tests.drivers.mavlink_by_hand import SECOND, device, readings


def test_other_vehicles_are_passed_over() -> None:
    codec = MavlinkCodec(device(system_id=None))
    ours, other = MavlinkEncoder(system_id=7), MavlinkEncoder(system_id=8)
    station = MavlinkEncoder(system_id=255).encode("HEARTBEAT", {"type": 6.0, "autopilot": 8.0}, 0)
    data = station + ours.heartbeat() + other.encode("ATTITUDE", {}, 0) + ours.encode("ATTITUDE", {}, SECOND)
    assert [(r.message, r.t_device_ns) for r in readings(codec, data)] == [("HEARTBEAT", None), ("ATTITUDE", SECOND)]


def test_the_rig_names_the_vehicle() -> None:
    codec = MavlinkCodec(device(system_id=8))
    data = MavlinkEncoder(system_id=7).encode("ATTITUDE", {}, 0) + MavlinkEncoder(system_id=8).encode("ATTITUDE", {}, 9)
    assert len(readings(codec, data)) == 1


def told(codec: MavlinkCodec, data: bytes) -> list[float]:
    return [r.fields["pitch"] for r in readings(codec, data) if r.message == "ATTITUDE"]


@pytest.mark.parametrize("named", [1, None], ids=["the rig names the system", "the first autopilot"])
def test_another_component_of_the_vehicle_is_not_mixed_into_its_signals(named: int | None) -> None:
    codec = MavlinkCodec(device(system_id=named))
    ours, other = MavlinkEncoder(), MavlinkEncoder(component_id=191)
    data = other.heartbeat() + ours.heartbeat()
    for _ in range(50):
        data += ours.encode("ATTITUDE", {"pitch": 0.1}, 0) + other.encode("ATTITUDE", {"pitch": -0.4}, 0)
    assert told(codec, data) == [pytest.approx(0.1)] * 50
    assert codec.foreign == {"system 1, component 191": 51}
    assert codec.speaker == "system 1, component 1"


def test_the_rig_names_the_component() -> None:
    codec = MavlinkCodec(device(component_id=191))
    ours, other = MavlinkEncoder(), MavlinkEncoder(component_id=191)
    sent = ours.encode("ATTITUDE", {"pitch": 0.1}, 0) + other.encode("ATTITUDE", {"pitch": -0.4}, 0)
    assert told(codec, sent) == [pytest.approx(-0.4)]


def test_who_speaks_first_does_not_own_the_link() -> None:
    codec = MavlinkCodec(device(system_id=None))
    first, ours = MavlinkEncoder(system_id=9), MavlinkEncoder(system_id=7)
    assert told(codec, first.encode("ATTITUDE", {}, 0) * 3) == [], "no heartbeat"
    codec.feed(ours.heartbeat())
    sent = first.encode("ATTITUDE", {"pitch": -0.4}, 0) + ours.encode("ATTITUDE", {"pitch": 0.1}, 0)
    assert told(codec, sent) == [pytest.approx(0.1)]
    assert codec.foreign == {"system 9, component 1": 1}


def test_a_vehicle_that_is_not_named_and_has_gone_is_given_up() -> None:
    codec = MavlinkCodec(device(system_id=None, timesync=True))
    first, next_one = MavlinkEncoder(system_id=9), MavlinkEncoder(system_id=7)
    codec.feed(first.heartbeat())
    assert codec.outgoing(SECOND)
    codec.feed(next_one.heartbeat())
    assert codec.speaker == "system 9, component 1"
    assert codec.outgoing(5 * SECOND)
    assert codec.outgoing(7 * SECOND) == b"", "nobody is asked"
    codec.feed(next_one.heartbeat())
    assert codec.speaker == "system 7, component 1"


def test_more_others_than_can_be_told_apart_are_counted_together() -> None:
    codec = MavlinkCodec(device())
    for k in range(2, 250):
        codec.feed(MavlinkEncoder(system_id=k).heartbeat())
    assert len(codec.foreign) == MOST_FOREIGN + 1
    assert sum(codec.foreign.values()) == 248
