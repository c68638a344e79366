"""An autopilot as PX4's simulator link has one (simulator_mavlink), of pymavlink's own dialect and parser.

Heartbeat and request for HIL_STATE_QUATERNION first, then HIL_ACTUATOR_CONTROLS in answer to each HIL_SENSOR, whose
time is its clock.
"""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import common

ARMED, CUSTOM, HIL = 128, 1, 32
LOCKSTEP = 1


class Px4Like:
    """Holds attitude, heading and airspeed by what HIL_SENSOR says, of which it makes its own attitude."""

    def __init__(self, pitch: float = 0.05, speed: float = 56.59, *, base_mode: int = ARMED, system: int = 1) -> None:
        self._mav = common.MAVLink(None, srcSystem=system, srcComponent=1)
        self._mav.robust_parsing = True
        self.pitch, self.speed, self.base_mode, self.is_armed = pitch, speed, base_mode, True
        self.heard: dict[str, Any] = {}
        self.count: dict[str, int] = {}
        self.theta = self.phi = math.nan
        self._integral = 0.0
        self._time_us = 0

    def hello(self) -> bytes:
        """What it sends when it has connected."""
        beat = common.MAVLink_heartbeat_message(0, common.MAV_AUTOPILOT_PX4, self.base_mode, 0, 0, 3)
        wish = common.MAVLink_command_long_message(
            0, 0, common.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 115, 5000.0, 0, 0, 0, 0, 0
        )
        return beat.pack(self._mav) + wish.pack(self._mav)

    def answer(self, data: bytes) -> bytes:
        """What it says to what it is sent."""
        out = b""
        for message in self._mav.parse_buffer(data) or ():
            kind = message.get_type()
            assert kind != "BAD_DATA", message
            self.heard[kind] = message
            self.count[kind] = self.count.get(kind, 0) + 1
            if kind == "HIL_SENSOR":
                out += self._controls(message)
        return out

    def _controls(self, s: Any) -> bytes:
        assert s.time_usec > self._time_us, "the simulator's time does not increase"
        dt = (s.time_usec - self._time_us) * 1e-6 if self._time_us else 0.0
        self._time_us = s.time_usec
        level_theta = math.atan2(s.xacc, math.hypot(s.yacc, s.zacc))
        level_phi = math.atan2(-s.yacc, -s.zacc)
        if math.isnan(self.theta):
            self.theta, self.phi = level_theta, level_phi
        # Gyros, and gravity in the long run.
        share, turned = dt / 20.0, s.ygyro * math.sin(self.phi) + s.zgyro * math.cos(self.phi)
        self.theta += dt * (s.ygyro * math.cos(self.phi) - s.zgyro * math.sin(self.phi))
        self.theta += share * (level_theta - self.theta)
        self.phi += dt * (s.xgyro + math.tan(self.theta) * turned) + share * (level_phi - self.phi)
        airspeed = math.sqrt(2 * max(0.0, 100 * s.diff_pressure) / 1.1373)
        error = self.pitch - self.theta
        self._integral += dt * error
        up = 1.5 * error + 0.5 * self._integral - 0.5 * s.ygyro
        right = -1.0 * self.phi - 0.5 * s.xgyro
        throttle = 0.27 + 0.05 * (self.speed - airspeed)
        outputs = [right, up, throttle, -0.3 * s.zgyro] + [0.0] * 12
        low = [-1.0, -1.0, 0.0, -1.0] + [-1.0] * 12
        controls = [max(a, min(1.0, v)) for a, v in zip(low, outputs, strict=True)] if self.is_armed else [0.0] * 16
        mode = CUSTOM | (ARMED if self.is_armed else 0)
        return common.MAVLink_hil_actuator_controls_message(s.time_usec, controls, mode, LOCKSTEP).pack(self._mav)
