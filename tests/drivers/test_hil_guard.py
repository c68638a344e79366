"""Who flies over a MAVLink HIL link, and when anything is sent on it: heartbeats and controls packed by pymavlink."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import common

from drivers.mavlink_hil import MavlinkHil
from station.rows import Code
from tests.drivers.px4_like import ARMED, HIL
from tests.drivers.test_mavlink_hil import ROW, S, loop

AUTOPILOT, GIMBAL, COMPUTER = 1, 154, 191
PX4, INVALID = 12, 8
"""MAV_AUTOPILOT, as numbers."""


def beat(system: int, base_mode: int, component: int = AUTOPILOT, kind: int = 1, autopilot: int = PX4) -> bytes:
    message = common.MAVLink_heartbeat_message(kind, autopilot, base_mode, 0, 4, 3)
    return bytes(message.pack(common.MAVLink(None, srcSystem=system, srcComponent=component)))


def controls(system: int, time_us: int = 1000, component: int = AUTOPILOT) -> bytes:
    message = common.MAVLink_hil_actuator_controls_message(time_us, [0.1, 0.2, 0.3, 0.4] + 12 * [0.0], ARMED, 0)
    return bytes(message.pack(common.MAVLink(None, srcSystem=system, srcComponent=component)))


def hardware() -> MavlinkHil:
    """A link whose system 1 is in HIL."""
    session = MavlinkHil(loop(simulator=False))
    session.feed(beat(1, HIL | ARMED), 0)
    assert [code for code, _ in session.told()] == [Code.HEARD]
    assert session.outgoing(0, ROW, 0)
    return session


def test_controls_of_another_than_who_is_in_hil_are_not_flown_and_told_once() -> None:
    session = hardware()
    for k in range(3):
        assert session.feed(controls(7, 1000 + k), k) == []
        assert session.feed(controls(1, 1000 + k, component=2), k) == []
    first, second = session.told()
    assert first == (Code.FOREIGN, "system 7 sends controls, which are not flown: system 1 flies")
    assert second[1].startswith("component 2 of system 1 sends controls")
    assert len(session.feed(controls(1), 3)) == 4


@pytest.mark.parametrize("ends", ["silent", "disarmed", "in HIL"])
def test_an_armed_aircraft_without_hil_keeps_the_link_closed_until_it_is_none(ends: str) -> None:
    session = hardware()
    session.feed(beat(7, ARMED), S // 2)
    ((code, words),) = session.told()
    assert code is Code.FOREIGN
    assert "system 7 is armed and not in HIL" in words
    for k in range(1, 5):  # heartbeats of who is in HIL open nothing while it is there
        session.feed(beat(1, HIL | ARMED), k * S)
        assert session.outgoing(400 * k, ROW, k * S) == b""
        assert session.feed(controls(1, 1000 * k), k * S) == []
    assert session.told() == []
    if ends != "silent":
        session.feed(beat(7, 0 if ends == "disarmed" else HIL | ARMED), 4 * S)
    session.feed(beat(1, HIL | ARMED), 5 * S)
    assert bool(session.outgoing(2000, ROW, 5 * S)) == (ends != "silent")
    assert session.outgoing(2400, ROW, 6 * S) != b""  # 5.5 s after its last heartbeat
    assert len(session.feed(controls(1, 10_000), 6 * S)) == 4
    assert session.feed(controls(7, 10_000), 6 * S) == []
    assert [code for code, _ in session.told()].count(Code.HEARD) == 1


def test_who_comes_to_an_armed_aircraft_s_link_is_told_why_nothing_is_sent() -> None:
    session = MavlinkHil(loop(simulator=False))
    session.feed(beat(7, ARMED) + beat(1, HIL), 0)
    assert session.outgoing(0, ROW, 0) == b""
    assert session.told()[-1][1] == (
        "system 1 is in HIL: nothing is sent to it while system 7 is on the link, armed and not in HIL"
    )


def test_a_gimbal_of_the_vehicle_in_hil_closes_nothing() -> None:
    session = hardware()
    for k in range(1, 10):
        session.feed(beat(1, HIL | ARMED), k * S)
        session.feed(beat(1, 0, GIMBAL, common.MAV_TYPE_GIMBAL, INVALID), k * S + S // 2)
        assert session.outgoing(400 * k + 200, ROW, k * S + S // 2)
    assert session.told() == []


def test_an_onboard_computer_s_hil_flag_opens_nothing() -> None:
    session = MavlinkHil(loop(simulator=False))
    session.feed(beat(1, HIL, COMPUTER, common.MAV_TYPE_ONBOARD_CONTROLLER, INVALID), 0)
    assert session.outgoing(0, ROW, 0) == b""
    assert session.feed(controls(1, component=COMPUTER), 0) == []
    assert session.told() == [
        (
            Code.FOREIGN,
            "component 191 of system 1 sends controls, which are not flown: no heartbeat of it says HIL",
        )
    ]


def test_silence_is_told_and_another_in_hil_flies_then() -> None:
    session = hardware()
    session.feed(beat(7, HIL | ARMED), S)
    assert session.feed(controls(7), S) == []
    ((_, words),) = session.told()
    assert words == "system 7 is in HIL too: nothing is flown of it while system 1 is there"
    assert session.outgoing(2400, ROW, 5 * S + 1) == b""
    ((_, words),) = session.told()
    assert words == "system 1 has sent no heartbeat for 5 s: nothing is sent to it, nor flown of it"
    session.feed(beat(7, HIL | ARMED), 6 * S)
    assert [code for code, _ in session.told()] == [Code.HEARD]
    assert len(session.feed(controls(7), 6 * S)) == 4


def test_a_simulator_s_link_is_flown_by_the_first_until_it_is_gone() -> None:
    session = MavlinkHil(loop())
    assert len(session.feed(controls(3), 0)) == 4
    assert session.feed(controls(7) + controls(7, 2000), S) == []
    assert session.told() == [(Code.FOREIGN, "system 7 sends controls, which are not flown: system 3 flies")]
    assert len(session.feed(controls(7, 3000), 6 * S)) == 4
