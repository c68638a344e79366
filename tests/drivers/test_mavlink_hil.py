"""MAVLink HIL against an autopilot of MAVLink's definitions: handshake, lock-step, guards, loss and return."""

from __future__ import annotations

import math
import os
import pty
import select
import socket
import threading
import tty
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from scipy.spatial.transform import Rotation

from drivers.loop_links import SerialLink, TcpServerLink, open_link
from drivers.mavlink_hil import FIELD_GAUSS, MavlinkHil, hil_gps, hil_sensor, hil_state
from station.clock import SystemClock
from station.profile import LOOP_HZ, MavlinkLoop, load_card
from station.rows import Code, DeviceError
from station.simulation.outside import Outside
from station.simulation.stepped_flight import SteppedFlight
from tests.drivers.px4_like import ARMED, HIL, Px4Like
from tests.drivers.test_closed_loop import events, flying, until

PROFILES = load_card("px4_sitl")
AIRCRAFT = PROFILES.aircraft
S = 1_000_000_000


def loop(**keys: Any) -> MavlinkLoop:
    made = PROFILES.rig.loop
    assert isinstance(made, MavlinkLoop)
    return made.model_copy(update=keys)


def flown(autopilot: Px4Like, seconds: float, gust_sigma: float = 0.0) -> tuple[dict[str, np.ndarray], MavlinkHil]:
    """Aircraft and autopilot in lock-step, bytes between them, as fast as it goes."""
    card = PROFILES.card
    flight = card.flight.model_copy(update={"gust_sigma": gust_sigma})
    card = card.model_copy(update={"flight": flight, "manoeuvres": ()})
    session = MavlinkHil(loop())
    aircraft = SteppedFlight(AIRCRAFT, card, outside=session_moves())
    outside = Outside(dict(aircraft.rest), hold=0.5, fade=2.0)
    rows = []
    data = autopilot.hello()
    for step in range(round(seconds * LOOP_HZ)):
        t = step / LOOP_HZ
        for name, value in session.feed(data, round(t * S)):
            outside.take(t, name, value)
        assert not session.waits  # an answer has come to each HIL_SENSOR
        row = aircraft.step(outside.at(t))
        rows.append(row)
        sent = session.outgoing(step, dict(zip(aircraft.columns, row.tolist(), strict=True)), round(t * S))
        data = autopilot.answer(sent)
    return dict(zip(aircraft.columns, np.array(rows).T, strict=True)), session


def session_moves() -> tuple[str, ...]:
    return tuple(loop().commands)


def test_an_attitude_is_held_in_lock_step() -> None:
    autopilot = Px4Like(pitch=math.radians(5.0))
    seen, session = flown(autopilot, 40.0)
    last = slice(-5 * LOOP_HZ, None)
    assert np.degrees(seen["theta"][last]) == pytest.approx(5.0, abs=0.5)  # its own attitude leans on gravity
    assert np.abs(np.degrees(seen["phi"][last])).max() < 0.5
    assert seen["airspeed"][last] == pytest.approx(56.6, abs=2.0)  # its throttle has no integral
    # 200 Hz, 10 Hz and the 5 ms that it asks for, from the definitions' numbers.
    assert autopilot.count == {
        "HIL_SENSOR": 8000,
        "HIL_GPS": 400,
        "HIL_STATE_QUATERNION": pytest.approx(8000, abs=10),
        "HEARTBEAT": 40,
        "COMMAND_ACK": 1,
    }
    assert session.told() == []


@pytest.mark.slow
def test_an_attitude_is_held_for_ten_minutes_in_turbulence() -> None:
    seen, _ = flown(Px4Like(pitch=math.radians(4.0)), 600.0, gust_sigma=1.524)
    settled = slice(30 * LOOP_HZ, None)
    assert np.degrees(seen["theta"][settled]).mean() == pytest.approx(4.0, abs=0.5)
    assert np.degrees(seen["theta"][settled]).std() < 1.0
    assert np.abs(np.degrees(seen["phi"][settled])).max() < 10.0
    assert np.isfinite(seen["altitude"]).all()


ROW = {
    "p": 0.01,
    "q": -0.02,
    "r": 0.03,
    "ax": 0.5,
    "ay": -0.3,
    "az": -9.7,
    "phi": 0.2,
    "theta": -0.1,
    "psi": 2.5,
    "v_north": -45.0,
    "v_east": 33.75,
    "v_down": 1.5,
    "latitude": 0.72,
    "longitude": -1.43,
    "altitude": 762.0,
    "static_pressure": 92500.0,
    "dynamic_pressure": 1800.0,
    "air_temperature": 283.15,
    "airspeed": 56.3,
}


def read(message: Any) -> Any:
    """Through pymavlink's own packer and parser."""
    packed = message.pack(common.MAVLink(None, srcSystem=9, srcComponent=9))
    (made,) = common.MAVLink(None).parse_buffer(packed)
    return made


def test_messages_are_in_the_definitions_units() -> None:
    sensor = read(hil_sensor(5, ROW, np.random.default_rng(1)))
    assert (sensor.abs_pressure, sensor.diff_pressure) == pytest.approx((925.0, 18.0), abs=0.1)
    assert (sensor.temperature, sensor.pressure_alt, sensor.fields_updated) == pytest.approx((10.0, 762.0, 8191))
    assert (sensor.xacc, sensor.yacc, sensor.zacc) == pytest.approx((0.5, -0.3, -9.7), abs=0.1)
    assert (sensor.xgyro, sensor.ygyro, sensor.zgyro) == pytest.approx((0.01, -0.02, 0.03), abs=2.5e-3)
    gps = read(hil_gps(5, ROW))
    assert (gps.lat, gps.lon) == pytest.approx((math.degrees(0.72) * 1e7, math.degrees(-1.43) * 1e7), abs=1)
    assert (gps.alt, gps.vn, gps.ve, gps.vd, gps.vel) == (762_000, -4500, 3375, 150, 5625)
    assert gps.cog == pytest.approx(100 * (90 + math.degrees(math.atan2(45.0, 33.75))), abs=1)
    state = read(hil_state(5, ROW))
    body_to_ned = Rotation.from_euler("ZYX", [ROW["psi"], ROW["theta"], ROW["phi"]])
    x, y, z, w = body_to_ned.as_quat()
    assert state.attitude_quaternion == pytest.approx([w, x, y, z], abs=1e-6)
    field = body_to_ned.inv().apply(FIELD_GAUSS)
    assert [sensor.xmag, sensor.ymag, sensor.zmag] == pytest.approx(field, abs=2.5e-3)
    assert (state.true_airspeed, state.zacc) == (5630, pytest.approx(-989, abs=1))


def test_nothing_is_sent_to_nor_flown_of_who_is_not_in_hil() -> None:
    session, armed = MavlinkHil(loop(simulator=False)), Px4Like(base_mode=ARMED)
    sensor = hil_sensor(2_000_000, ROW, np.random.default_rng(1)).pack(common.MAVLink(None))
    assert session.outgoing(0, ROW, 0) == b""
    assert session.feed(armed.hello() + armed.answer(sensor), 0) == []
    assert session.outgoing(2, ROW, 0) == b""
    ((code, words),) = session.told()
    assert code is Code.FOREIGN
    assert "armed and not in HIL" in words
    in_hil = Px4Like(base_mode=ARMED | HIL)
    asked = dict(session.feed(in_hil.hello() + in_hil.answer(sensor), S))
    assert set(asked) == {"elevator", "aileron", "rudder", "thrust"}
    assert session.outgoing(4, ROW, S) != b""
    assert [code for code, _ in session.told()] == [Code.HEARD]
    assert session.outgoing(6, ROW, 7 * S) == b""  # five heartbeats have not come
    assert session.feed(Px4Like(base_mode=ARMED).hello(), 8 * S) == []
    assert session.outgoing(8, ROW, 8 * S) == b""  # it has left HIL


def test_a_ground_station_s_heartbeat_opens_nothing() -> None:
    session = MavlinkHil(loop(simulator=False))
    mav = common.MAVLink(None, srcSystem=255, srcComponent=190)
    beat = common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, 8, HIL, 0, 0, 3)
    session.feed(beat.pack(mav), 0)
    assert session.outgoing(0, ROW, 0) == b""


def test_disarmed_outputs_are_not_flown_and_time_that_runs_back_is_told() -> None:
    session, autopilot = MavlinkHil(loop()), Px4Like()
    sent = [session.outgoing(step, ROW, 0) for step in range(4)]
    autopilot.is_armed = False
    assert session.feed(autopilot.answer(sent[0]), 0) == []
    autopilot.is_armed = True
    later = autopilot.answer(sent[2])
    assert len(session.feed(later, 0)) == 4
    assert session.told() == []
    again = Px4Like().answer(sent[0])  # started anew
    assert len(session.feed(again, 0)) == 4
    ((code, words),) = session.told()
    assert code is Code.CLOCK_STEP
    assert "0.005 s" in words


def test_damaged_bytes_are_passed_over() -> None:
    session, autopilot = MavlinkHil(loop()), Px4Like()
    good = autopilot.answer(session.outgoing(0, ROW, 0))
    broken = bytearray(good)
    broken[20] ^= 0x55
    assert session.feed(b"\xfd\x00noise" + bytes(broken) + good[:30], 0) == []
    assert len(session.feed(good[30:], 0)) == 4


def test_lock_step_waits_for_an_answer_and_gives_up() -> None:
    session, autopilot = MavlinkHil(loop()), Px4Like()
    first = session.outgoing(0, ROW, 0)
    assert not session.waits  # PX4 starts up without answering
    session.feed(autopilot.answer(first), 0)
    second = session.outgoing(2, ROW, 0)
    assert session.waits
    session.give_up()
    assert not session.waits
    session.feed(autopilot.answer(second), 0)
    session.outgoing(4, ROW, 0)
    assert session.waits
    free = MavlinkHil(loop(lock_step=False))
    free.feed(Px4Like().answer(free.outgoing(0, ROW, 0)), 0)
    free.outgoing(2, ROW, 0)
    assert not free.waits


class Calling(threading.Thread):
    """The autopilot's process: connects, answers, hangs up when told."""

    def __init__(self, port: int, autopilot: Px4Like | None = None) -> None:
        super().__init__(daemon=True)
        self.autopilot, self._port = autopilot or Px4Like(pitch=math.radians(5.0)), port
        self._over = threading.Event()
        self.start()

    def run(self) -> None:
        with socket.create_connection(("127.0.0.1", self._port)) as line:
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            line.sendall(self.autopilot.hello())
            while not self._over.is_set():
                if select.select([line], [], [], 0.1)[0]:
                    data = line.recv(65536)
                    if not data:
                        return
                    line.sendall(self.autopilot.answer(data))

    def hang_up(self) -> None:
        self._over.set()
        self.join()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_over_tcp_an_autopilot_flies_goes_and_comes_back() -> None:
    port = free_port()
    boom, imu, _ = PROFILES.rig.devices
    rig = PROFILES.rig.model_copy(update={"devices": (boom, imu), "loop": loop(url=f"tcpin:127.0.0.1:{port}")})
    card = PROFILES.card.model_copy(update={"manoeuvres": ()})
    with flying(PROFILES.model_copy(update={"rig": rig, "card": card})) as (said, heard, _):
        assert {s["device"] for s in said if "device" in s} == {"boom", "can"}
        first = Calling(port)
        until(lambda: "elevator: flown from outside" in events(said, "HEARD"))
        until(lambda: first.autopilot.count.get("HIL_SENSOR", 0) > 300)
        assert first.autopilot.count["HIL_GPS"] > 10
        other = socket.create_connection(("127.0.0.1", port))
        until(lambda: any(s.get("event") == "FOREIGN" for s in said))
        assert other.recv(1) == b""
        other.close()
        first.hang_up()
        until(lambda: any("fading to trim" in words for words in events(said, "STALE")))
        until(lambda: any(s.get("event") == "DISCONNECT" for s in said))  # told by another thread
        assert sum(s.get("event") == "DISCONNECT" for s in said) == 1
        flies_on = len(heard)
        until(lambda: len(heard) > flies_on + 100)
        second = Calling(port)
        until(lambda: any("heard again" in words for words in events(said, "FRESH")))
        second.hang_up()
    assert said[-1] is not None


def test_over_a_serial_line_hardware_in_hil_is_heard_and_told() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = open_link(os.ttyname(slave), 921_600, SystemClock())
    assert isinstance(link, SerialLink)
    session, autopilot = MavlinkHil(loop(simulator=False)), Px4Like(base_mode=ARMED | HIL)
    assert [code for code, _ in link.told()] == [Code.CONNECT]
    os.write(master, autopilot.hello())
    (port,) = link.descriptors()
    assert select.select([port], [], [], 5)[0]
    session.feed(link.receive(port), 0)
    link.send(session.outgoing(0, ROW, 0))
    assert select.select([master], [], [], 5)[0]
    os.write(master, autopilot.answer(os.read(master, 4096)))
    assert select.select([port], [], [], 5)[0]
    assert dict(session.feed(link.receive(port), 0)).keys() == {"elevator", "aileron", "rudder", "thrust"}
    os.close(master)
    link.receive(port)
    assert [code for code, _ in link.told()] == [Code.DISCONNECT]
    assert link.descriptors() == []
    link.close()
    os.close(slave)


def test_a_port_that_is_taken_and_a_wrong_url_are_said() -> None:
    link = TcpServerLink("127.0.0.1", 0)
    port = link._listener.getsockname()[1]
    with pytest.raises(DeviceError, match="another program listens there"):
        open_link(f"tcpin:127.0.0.1:{port}", 1, SystemClock())
    link.close()
    for url in ("udp:127.0.0.1:1", "tcpin:127.0.0.1:x", "tcpin:127.0.0.1:99999"):
        with pytest.raises(DeviceError, match="loop:"):
            open_link(url, 1, SystemClock())


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"commands": {"flaps": {"field": "controls1", "unit": "deg"}}}, "nothing from outside moves flaps"),
        ({"commands": {"elevator": {"field": "controls1", "unit": "N"}}}, "does not fit"),
        ({"commands": {"elevator": {"field": "controls17", "unit": "deg"}}}, "controls1 to controls16"),
        (
            {"commands": {"elevator": {"field": "controls1", "unit": "deg"}}, "rate": "150 Hz"},
            "no whole part of 400 Hz",
        ),
    ],
)
def test_a_loop_that_cannot_be_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MavlinkLoop.model_validate({"kind": "mavlink_hil", **keys})
