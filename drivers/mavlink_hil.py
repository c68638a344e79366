"""An autopilot in the loop over MAVLink: what it asks of the surfaces, and what it is told of its sensors.

HIL_ACTUATOR_CONTROLS in; HIL_SENSOR, HIL_GPS and HIL_STATE_QUATERNION out (MAVLink's common messages; PX4,
simulator_mavlink). Pure: bytes and times in, bytes and values out. `HilGuard` says when anything is sent, and whose
controls are flown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.hil_guard import ARMED, HilGuard, sender_of
from drivers.mavlink import STATION_COMPONENT, STATION_SYSTEM
from drivers.mavlink_frame import Framer, Packer
from station.conventions import G0, SEA_LEVEL_DENSITY
from station.numerics.angles import quaternion
from station.profile import LOOP_HZ, MavlinkLoop
from station.rows import Code

GNSS_HZ: Final = 10
STATE_HZ: Final = 50
"""Unless the autopilot asks for another."""
FIRST_US: Final = 1_000_000
"""Time of the flight's begin: an autopilot takes 0 for none."""
FIELD_GAUSS: Final = (0.19, -0.03, 0.49)
"""Earth's, north, east and down, where simulated flights begin (41.4 N, 81.9 W): inclination 69, declination -8 deg."""
NOISE: Final = {"accel": 0.02, "gyro": 5e-4, "mag": 5e-4, "abs": 0.02, "diff": 0.02}
"""Standard deviations: m/s2, rad/s, gauss, hPa. An autopilot takes a sensor that never changes for a broken one."""
_ALL_UPDATED: Final = 0x1FFF
"""HIL_SENSOR_UPDATED_FLAGS: accelerometers, gyros, magnetometers, both pressures, their altitude, temperature."""
_NO_YAW: Final = 0


class MavlinkHil:
    """One link. Feed it what has come; ask it what to fly and what to send."""

    def __init__(self, loop: MavlinkLoop, seed: int = 0) -> None:
        self._loop = loop
        self._framer = Framer()
        self._packer = Packer(STATION_SYSTEM, STATION_COMPONENT)
        self._rng = np.random.default_rng([seed, 5])
        self._state_every = LOOP_HZ // STATE_HZ
        self._guard = HilGuard(loop.simulator)
        self._newest_us = 0
        self._answers = self._owed = False
        self._to_acknowledge: list[Any] = []
        self._told: list[tuple[Code, str]] = []

    def begin(self) -> None:
        """The link has been opened, perhaps to another autopilot."""
        self._framer.reset()
        self._guard.begin()
        self._answers = self._owed = False
        self._newest_us = 0

    def feed(self, data: bytes, now_ns: int) -> list[tuple[str, float]]:
        """What the bytes ask for: surfaces, rad, and thrust, N."""
        asked: list[tuple[str, float]] = []
        for message in self._framer.feed(data):
            match message.get_type():
                case "HEARTBEAT":
                    self._guard.heartbeat(message, now_ns)
                case "HIL_ACTUATOR_CONTROLS":
                    asked += self._controls(message, now_ns)
                case "COMMAND_LONG" if self._guard.may_ask(sender_of(message)):
                    self._command(message)
        return asked

    def _controls(self, message: Any, now_ns: int) -> list[tuple[str, float]]:
        if not self._guard.may_fly(sender_of(message), now_ns):
            return []
        if message.time_usec < self._newest_us:
            back_s = (self._newest_us - message.time_usec) * 1e-6
            self._told.append((Code.CLOCK_STEP, f"the autopilot's time runs back by {back_s:.3f} s: it is flown on"))
        self._newest_us = message.time_usec
        self._answers, self._owed = True, False
        if not message.mode & ARMED:  # its outputs stand at 0, which is no trim
            return []
        return list(self._loop.moved_by(message.controls).items())

    def _command(self, message: Any) -> None:
        wanted = message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL
        if wanted and int(message.param1) == dialect.MAVLINK_MSG_ID_HIL_STATE_QUATERNION and message.param2 > 0:
            self._state_every = max(1, round(LOOP_HZ * message.param2 * 1e-6))
        result = dialect.MAV_RESULT_ACCEPTED if wanted else dialect.MAV_RESULT_UNSUPPORTED
        self._to_acknowledge.append(dialect.MAVLink_command_ack_message(message.command, result))

    @property
    def waits(self) -> bool:
        """Whether, in lock-step, an answer to what was sent last is still to come."""
        return self._loop.lock_step and self._answers and self._owed

    def give_up(self) -> None:
        """Wait no longer; again when it has answered."""
        self._answers = False

    def outgoing(self, step: int, row: Mapping[str, float], now_ns: int) -> bytes:
        """What the autopilot is to be sent after a step of LOOP_HZ that gave this row of signals."""
        if not self._guard.is_open(now_ns):
            return b""
        time_us = FIRST_US + step * 1_000_000 // LOOP_HZ
        out = [self._packer.pack(m) for m in self._to_acknowledge]
        self._to_acknowledge.clear()
        if step % LOOP_HZ == 0:
            out.append(self._packer.pack(self._own_heartbeat()))
        if step % (LOOP_HZ // GNSS_HZ) == 0:
            out.append(self._packer.pack(hil_gps(time_us, row)))
        if step % self._state_every == 0:
            out.append(self._packer.pack(hil_state(time_us, row)))
        if step % round(LOOP_HZ / self._loop.rate) == 0:
            # The last: in lock-step it is what the autopilot answers.
            out.append(self._packer.pack(hil_sensor(time_us, row, self._rng)))
            self._owed = True
        return b"".join(out)

    @staticmethod
    def _own_heartbeat() -> Any:
        kind, none = dialect.MAV_TYPE_GENERIC, dialect.MAV_AUTOPILOT_INVALID
        return dialect.MAVLink_heartbeat_message(kind, none, 0, 0, dialect.MAV_STATE_ACTIVE, 3)

    def told(self) -> list[tuple[Code, str]]:
        """What has happened since this was last asked."""
        said, self._told = self._guard.told() + self._told, []
        return said


def hil_sensor(time_us: int, row: Mapping[str, float], rng: np.random.Generator) -> Any:
    """IMU, magnetometer and pressures, with noise."""
    noise = rng.standard_normal(11).tolist()
    accel = [row[n] + NOISE["accel"] * e for n, e in zip(("ax", "ay", "az"), noise[:3], strict=True)]
    gyro = [row[n] + NOISE["gyro"] * e for n, e in zip(("p", "q", "r"), noise[3:6], strict=True)]
    mag = [b + NOISE["mag"] * e for b, e in zip(body_field(row), noise[6:9], strict=True)]
    static = row["static_pressure"] / 100.0 + NOISE["abs"] * noise[9]
    pitot = row["dynamic_pressure"] / 100.0 + NOISE["diff"] * noise[10]
    temperature = row["air_temperature"] - 273.15
    return dialect.MAVLink_hil_sensor_message(
        time_us, *accel, *gyro, *mag, static, pitot, row["altitude"], temperature, _ALL_UPDATED
    )


def body_field(row: Mapping[str, float]) -> tuple[float, float, float]:
    """Earth's magnetic field in body axes, gauss."""
    n, e, d = FIELD_GAUSS
    sin_h, cos_h = math.sin(row["psi"]), math.cos(row["psi"])
    sin_t, cos_t = math.sin(row["theta"]), math.cos(row["theta"])
    sin_b, cos_b = math.sin(row["phi"]), math.cos(row["phi"])
    ahead, right = n * cos_h + e * sin_h, e * cos_h - n * sin_h
    forward, below = ahead * cos_t - d * sin_t, ahead * sin_t + d * cos_t
    return forward, right * cos_b + below * sin_b, below * cos_b - right * sin_b


def _position(row: Mapping[str, float]) -> tuple[int, int, int]:
    """Degrees in 1e-7, and mm."""
    latitude, longitude = (round(math.degrees(row[n]) * 1e7) for n in ("latitude", "longitude"))
    return latitude, longitude, round(1e3 * row["altitude"])


def _velocity(row: Mapping[str, float]) -> tuple[int, int, int]:
    """cm/s, within what the field holds."""
    north, east, down = (max(-32767, min(32767, round(100 * row[n]))) for n in ("v_north", "v_east", "v_down"))
    return north, east, down


def hil_gps(time_us: int, row: Mapping[str, float]) -> Any:
    """A receiver with a fix."""
    north, east, down = _velocity(row)
    over_ground = min(65534, round(math.hypot(north, east)))
    course = round(math.degrees(math.atan2(east, north)) * 100) % 36000
    return dialect.MAVLink_hil_gps_message(
        time_us,
        dialect.GPS_FIX_TYPE_3D_FIX,
        *_position(row),
        90,  # cm: a receiver's of today
        130,
        over_ground,
        north,
        east,
        down,
        course,
        12,
        0,
        _NO_YAW,
    )


def hil_state(time_us: int, row: Mapping[str, float]) -> Any:
    """The truth, for the autopilot's log."""
    indicated = math.sqrt(2 * row["dynamic_pressure"] / SEA_LEVEL_DENSITY)
    return dialect.MAVLink_hil_state_quaternion_message(
        time_us,
        quaternion(row["phi"], row["theta"], row["psi"]),
        *(row[n] for n in ("p", "q", "r")),
        *_position(row),
        *_velocity(row),
        *(min(65535, round(100 * speed)) for speed in (indicated, row["airspeed"])),
        *(max(-32767, min(32767, round(1000 * row[n] / G0))) for n in ("ax", "ay", "az")),
    )
