"""DEBUG_VECT, which a rig's declared signals may come by, against pymavlink's packer and parser."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import common

from drivers.codec import Reading
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from station.profile import MavlinkDevice

NAMES = ["DEBUG_VECT:stick", "DEBUG_VECT:0123456789"]


def test_what_pymavlink_sends_is_read_by_its_name() -> None:
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    streams = [
        {"name": f"s{i}", "message": n, "rate": "50 Hz", "signals": {signal: {"field": "x", "unit": "rad"}}}
        for i, (n, signal) in enumerate(zip(NAMES, ("theta", "phi"), strict=True))
    ]
    device = {"link": "mavlink", "name": "ap", "url": "emulated", "streams": streams}
    codec = MavlinkCodec(MavlinkDevice.model_validate(device))
    beat = sender.heartbeat_encode(common.MAV_TYPE_FIXED_WING, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4)
    list(codec.feed(beat.pack(sender)))
    blocks = [
        sender.debug_vect_encode(name, 5_000_000 + k, 1.5 + k, -2.25, 1e-3).pack(sender)
        for k, name in enumerate((b"stick", b"other", b"0123456789"))
    ]
    found = [r for b in blocks for r in codec.feed(b) if isinstance(r, Reading)]
    names = [NAMES[0], "DEBUG_VECT:other", NAMES[1]]
    assert [(r.message, r.t_device_ns) for r in found] == [(n, 5_000_000_000 + 1_000 * k) for k, n in enumerate(names)]
    assert found[0].fields == pytest.approx({"x": 1.5, "y": -2.25, "z": 1e-3}, rel=1e-6)
    assert found[2].fields["x"] == 3.5


@pytest.mark.parametrize("name", NAMES)
def test_what_is_emulated_is_read_by_pymavlink(name: str) -> None:
    packet = MavlinkEncoder().encode(name, {"x": 12.5, "y": -1.0, "z": 0.25}, 7_000_000_000)
    (message,) = common.MAVLink(None).parse_buffer(packet)
    assert message.get_type() == "DEBUG_VECT"
    assert (message.name, message.time_usec) == (name.partition(":")[2], 7_000_000)
    assert (message.x, message.y, message.z) == (12.5, -1.0, 0.25)
