"""ArduPilot's JSON interface against an autopilot of its documentation: packets, lock-step, loss and return."""

from __future__ import annotations

import json
import math
import select
import socket
import struct
import threading
from typing import Any

import numpy as np
import pytest

from drivers.ardupilot_json import ArdupilotJson, state
from drivers.loop_inputs import JsonInput
from drivers.loop_links import listening_socket
from station.profile import LOOP_HZ, JsonLoop, load_card
from station.rows import Code, DeviceError
from station.simulation.outside import Outside
from station.simulation.stepped_flight import SteppedFlight
from tests.drivers.test_closed_loop import events, flying, until
from tests.drivers.test_mavlink_hil import ROW, free_port

PROFILES = load_card("ardupilot_sitl")
S = 1_000_000_000
MAGICS = {16: 18458, 32: 29569}


def loop(**keys: Any) -> JsonLoop:
    made = PROFILES.rig.loop
    assert isinstance(made, JsonLoop)
    return made.model_copy(update=keys)


def packet(count: int, pwm: dict[int, int], outputs: int = 16, magic: int | None = None) -> bytes:
    """A servo packet, by the documentation's layout."""
    values = [pwm.get(i + 1, 1500) for i in range(outputs)]
    return struct.pack(f"<HHI{outputs}H", magic or MAGICS[outputs], 400, count, *values)


class ArduLike:
    """Holds attitude and airspeed by the state that it is sent; reads lines as SIM_JSON does: what stands between line
    feeds, the last whole one."""

    def __init__(self, pitch: float = 0.05, speed: float = 56.59, outputs: int = 16) -> None:
        self.pitch, self.speed, self.outputs = pitch, speed, outputs
        self.frame = 0
        self.states = 0
        self.last: dict[str, Any] = {}
        self._integral, self._time = 0.0, math.nan
        self._pwm = {1: 1500, 2: 1500, 3: 1270, 4: 1500}

    def servos(self) -> bytes:
        return packet(self.frame, self._pwm, self.outputs)

    def hear(self, data: bytes) -> None:
        *_, line, rest = data.split(b"\n")
        assert rest == b""
        self.last = s = json.loads(line)
        dt = s["timestamp"] - self._time if math.isfinite(self._time) else 0.0
        assert dt >= 0.0, "physics time runs back"
        self._time = s["timestamp"]
        roll, pitch, _ = s["attitude"]
        p, q, r = s["imu"]["gyro"]
        error = self.pitch - pitch
        self._integral += dt * error
        wanted = {
            1: 1500 - 500 * roll - 250 * p,
            2: 1500 + 750 * error + 250 * self._integral - 250 * q,
            3: 1270 + 50 * (self.speed - s["airspeed"]),
            4: 1500 - 150 * r,
        }
        self._pwm = {n: max(1000, min(2000, round(v))) for n, v in wanted.items()}
        self.frame += 1
        self.states += 1


def flown(autopilot: ArduLike, seconds: float, gust_sigma: float = 0.0) -> dict[str, np.ndarray]:
    """Aircraft and autopilot in lock-step, datagrams between them, as fast as it goes."""
    flight = PROFILES.card.flight.model_copy(update={"gust_sigma": gust_sigma})
    card = PROFILES.card.model_copy(update={"flight": flight, "manoeuvres": ()})
    session, rows = ArdupilotJson(loop()), []
    aircraft = SteppedFlight(PROFILES.aircraft, card, outside=tuple(loop().commands))
    outside = Outside(dict(aircraft.rest), hold=0.5, fade=2.0)
    for step in range(round(seconds * LOOP_HZ)):
        t = step / LOOP_HZ
        for name, value in session.feed(autopilot.servos(), round(t * S)):
            outside.take(t, name, value)
        assert not session.waits
        rows.append(aircraft.step(outside.at(t)))
        autopilot.hear(session.outgoing(step, dict(zip(aircraft.columns, rows[-1].tolist(), strict=True))))
    assert session.told() == []
    return dict(zip(aircraft.columns, np.array(rows).T, strict=True))


@pytest.mark.parametrize(("outputs", "seconds"), [(16, 20), (32, 15)])
def test_an_attitude_is_held_in_lock_step(outputs: int, seconds: int) -> None:
    autopilot = ArduLike(pitch=math.radians(5.0), outputs=outputs)
    seen = flown(autopilot, seconds)
    last = slice(-5 * LOOP_HZ, None)
    assert np.degrees(seen["theta"][last]) == pytest.approx(5.0, abs=0.2)
    assert np.abs(np.degrees(seen["phi"][last])).max() < 0.2
    assert seen["airspeed"][last] == pytest.approx(56.6, abs=2.0)  # its throttle has no integral
    assert autopilot.states == seconds * LOOP_HZ


@pytest.mark.slow
def test_an_attitude_is_held_for_ten_minutes_in_turbulence() -> None:
    seen = flown(ArduLike(pitch=math.radians(4.0)), 600.0, gust_sigma=1.524)
    settled = slice(30 * LOOP_HZ, None)
    assert np.degrees(seen["theta"][settled]).mean() == pytest.approx(4.0, abs=0.1)
    assert np.degrees(seen["theta"][settled]).std() < 1.0
    assert np.abs(np.degrees(seen["phi"][settled])).max() < 10.0


def test_the_state_is_as_documented() -> None:
    """Axes and units of the documentation; a nautical mile is a minute of latitude."""
    north = math.radians(1 / 60)
    line = state(2.5, ROW, (ROW["latitude"] - north, ROW["longitude"]), 700.0)
    assert line[:1] == line[-1:] == b"\n"
    seen = json.loads(line)
    assert seen["position"] == pytest.approx([1852.0, 0.0, -62.0], abs=2.0)
    assert seen["imu"] == {"gyro": [0.01, -0.02, 0.03], "accel_body": [0.5, -0.3, -9.7]}
    assert (seen["attitude"], seen["velocity"]) == ([0.2, -0.1, 2.5], [-45.0, 33.75, 1.5])
    assert (seen["timestamp"], seen["airspeed"]) == (2.5, 56.3)


def test_outputs_move_what_the_rig_says() -> None:
    session = ArdupilotJson(loop())
    asked = dict(session.feed(packet(0, {1: 1600, 2: 1459, 3: 1500, 4: 1400}), 0))
    assert asked == {
        "aileron": pytest.approx(math.radians(-3.0)),
        "elevator": 0.0,
        "thrust": 8000.0,
        "rudder": pytest.approx(math.radians(3.0)),
    }
    assert "aileron" not in dict(session.feed(packet(1, {1: 0}), 0))  # an output that is off


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x1a",
        packet(0, {}, magic=18459),
        packet(0, {})[:-1],
        packet(0, {}) + b"\x00",
        packet(0, {}, outputs=32, magic=18458),
        b'{"timestamp":1,"imu":{"gy',
    ],
)
def test_what_is_no_servo_packet_is_passed_over_and_told_once_a_minute(data: bytes) -> None:
    session = ArdupilotJson(loop())
    for t in (0, 30, 59, 61):
        assert session.feed(data, t * S) == []
        assert session.outgoing(0, ROW) == b""
    told = session.told()
    assert [code for code, _ in told] == [Code.FOREIGN] * 2
    assert told[0][1].startswith(f"passed over: {len(data)} bytes of magic ")


def test_what_is_wrong_with_a_packet_is_said() -> None:
    session = ArdupilotJson(loop())
    session.feed(packet(0, {}, magic=12345), 0)
    session.feed(packet(0, {})[:-5], 60 * S)
    session.feed(packet(0, {}, outputs=32)[:-2], 120 * S)
    assert [words for _, words in session.told()] == [
        "passed over: 40 bytes of magic 12345: no servo packet (18458 or 29569)",
        "passed over: 35 bytes of magic 18458: a servo packet of that magic has 16 outputs, 40 bytes",
        "passed over: 70 bytes of magic 29569: a servo packet of that magic has 32 outputs, 72 bytes",
    ]


def test_an_output_that_the_packets_lack_is_told_once() -> None:
    channel = loop().commands["elevator"].model_copy(update={"field": "servo20"})
    session = ArdupilotJson(loop(commands={"elevator": channel}))
    for count in range(3):
        assert session.feed(packet(count, {}), 0) == []
    ((code, words),) = session.told()
    assert code is Code.RANGE
    assert words.startswith("elevator (servo20): the autopilot sends 16 outputs: not flown")
    assert len(session.feed(packet(3, {}, outputs=32), 0)) == 1
    assert session.told() == []


def test_a_second_autopilot_is_told_once_and_not_flown() -> None:
    port = free_port()
    come, taken = JsonInput(loop(address=f"127.0.0.1:{port}")), list[tuple[str, float]]()
    first, second = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with first, second:
        for count, sender in enumerate([first, second, second, second]):
            sender.sendto(packet(count, {}), ("127.0.0.1", port))
            assert select.select(come.descriptors(), [], [], 5)[0]
            come.receive(0, count, lambda _, name, value: taken.append((name, value)))
        own, other = first.getsockname()[1], second.getsockname()[1]
    come.close()
    assert len(taken) == 4  # of the first alone
    assert [(code, words) for _, code, words in come.told()] == [
        (Code.CONNECT, f"127.0.0.1:{own}"),
        (Code.FOREIGN, f"127.0.0.1:{other} sends servo packets too: not flown while 127.0.0.1:{own} is in the loop"),
    ]


def test_frames_lost_repeated_and_run_back() -> None:
    session = ArdupilotJson(loop())
    assert len(session.feed(packet(5, {}), 0)) == 4
    assert session.outgoing(0, ROW) != b""
    assert session.outgoing(1, ROW) == b""  # each is answered once
    assert session.feed(packet(5, {}), 0) == []  # asked again: no command anew, but an answer
    assert session.outgoing(2, ROW) != b""
    assert session.told() == []
    session.feed(packet(9, {}), 0)
    assert len(session.feed(packet(0, {}), 0)) == 4
    lost, back = session.told()
    assert lost == (Code.GAP, "3 frames of the autopilot lost")
    assert back[0] is Code.CLOCK_STEP


def test_lock_step_waits_for_the_next_packet_and_gives_up() -> None:
    session = ArdupilotJson(loop())
    assert not session.waits  # nobody is there yet
    session.feed(packet(0, {}), 0)
    session.outgoing(0, ROW)
    assert session.waits
    session.give_up()
    assert not session.waits
    free = ArdupilotJson(loop(lock_step=False))
    free.feed(packet(0, {}), 0)
    free.outgoing(0, ROW)
    assert not free.waits


class Sending(threading.Thread):
    """The autopilot's process: a servo packet, then one for each state that comes; again after a second of silence."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.autopilot, self._port, self._over = ArduLike(pitch=math.radians(5.0)), port, threading.Event()
        self.start()

    def run(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.settimeout(0.2)
            while not self._over.is_set():
                line.sendto(self.autopilot.servos(), ("127.0.0.1", self._port))
                try:
                    self.autopilot.hear(line.recv(4096))
                except TimeoutError:
                    continue

    def end(self) -> None:
        self._over.set()
        self.join()


def test_over_udp_an_autopilot_flies_goes_and_comes_back() -> None:
    port = free_port()
    boom, imu, _ = PROFILES.rig.devices
    rig = PROFILES.rig.model_copy(update={"devices": (boom, imu), "loop": loop(address=f"127.0.0.1:{port}")})
    card = PROFILES.card.model_copy(update={"manoeuvres": ()})
    with flying(PROFILES.model_copy(update={"rig": rig, "card": card})) as (said, heard, _):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"hello", ("127.0.0.1", port))
            until(lambda: any(s.get("event") == "FOREIGN" for s in said))
        first = Sending(port)
        until(lambda: "elevator: flown from outside" in events(said, "HEARD"))
        until(lambda: first.autopilot.states > 400)
        first.end()
        until(lambda: any("fading to trim" in words for words in events(said, "STALE")))
        flies_on = len(heard)
        until(lambda: len(heard) > flies_on + 100)
        second = Sending(port)  # from another port of its own: taken when the first has been silent for 5 s
        until(lambda: any("heard again" in words for words in events(said, "FRESH")))
        until(lambda: sum(s.get("event") == "CONNECT" for s in said) == 2)
        second.end()


def test_an_address_that_is_taken_or_none_is_said() -> None:
    with listening_socket("127.0.0.1:0") as first:
        port = first.getsockname()[1]
        with pytest.raises(DeviceError, match="another program listens there"):
            listening_socket(f"127.0.0.1:{port}")
    with pytest.raises(DeviceError, match="the port must be a number"):
        listening_socket("127.0.0.1")
