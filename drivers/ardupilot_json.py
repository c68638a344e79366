"""An ArduPilot in the loop over its JSON interface: servo packets in, the aircraft's state as a line of JSON out.

A servo packet is little-endian: uint16 magic, uint16 frame_rate, uint32 frame_count, uint16 pwm[] in microseconds; of
magic 18458 it has 16 outputs, of 29569 32 (ArduPilot, "JSON Simulation Format", libraries/SITL/examples/JSON). Each
packet is answered once, after the next step. Pure: datagrams and times in, datagrams and values out.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Final

from station.numerics.earth import radii
from station.profile import LOOP_HZ, JsonLoop
from station.rows import Code

OUTPUTS: Final = {18458: 16, 29569: 32}
"""Of the magics that a packet may begin with."""
_HEAD: Final = struct.Struct("<HHI")
_FOREIGN_EVERY_NS: Final = 60_000_000_000
_MOST_PWM: Final = 2500
"""us: no servo's; an output that is off says 0, and a surface is then left where it is."""
_LEAST_PWM: Final = 500


class ArdupilotJson:
    """One link. Feed it datagrams; ask it what to fly and what to answer."""

    def __init__(self, loop: JsonLoop) -> None:
        self._loop = loop
        self._newest: int | None = None
        self._due = self._answers = self._lacks_told = False
        self._told: list[tuple[Code, str]] = []
        self._last_foreign_ns: int | None = None
        self._origin: tuple[float, float] | None = None

    def begin(self) -> None:
        """Another autopilot has the link."""
        self._newest = None
        self._due = self._answers = self._lacks_told = False

    def feed(self, datagram: bytes, now_ns: int) -> list[tuple[str, float]]:
        """What a datagram asks for: surfaces, rad, and thrust, N; nothing if it is no servo packet."""
        if not self.is_servo_packet(datagram, now_ns):
            return []
        _, _, count = _HEAD.unpack_from(datagram)
        self._tell_of_lacking((len(datagram) - _HEAD.size) // 2)
        pwm = struct.unpack_from(f"<{(len(datagram) - _HEAD.size) // 2}H", datagram, _HEAD.size)
        repeated = count == self._newest
        if self._newest is not None and count < self._newest:
            words = (
                f"the autopilot's frames run back from {self._newest} to {count}: it has started anew, and is flown on"
            )
            self._told.append((Code.CLOCK_STEP, words))
        elif self._newest is not None and count > self._newest + 1:
            self._told.append((Code.GAP, f"{count - self._newest - 1} frames of the autopilot lost"))
        self._newest = count
        self._due = self._answers = True
        if repeated:  # it has had no answer, and asks again
            return []
        believed = [v if _LEAST_PWM <= v <= _MOST_PWM else math.nan for v in pwm]
        return [(n, v) for n, v in self._loop.moved_by(believed).items() if not math.isnan(v)]

    def _tell_of_lacking(self, outputs: int) -> None:
        """What packets of so few outputs cannot move, once for each autopilot."""
        wanted = {n: int(c.field.removeprefix(self._loop.output_prefix())) for n, c in self._loop.commands.items()}
        lacking = [f"{n} (servo{at})" for n, at in wanted.items() if at > outputs]
        if lacking and not self._lacks_told:
            self._lacks_told = True
            words = f"{', '.join(lacking)}: the autopilot sends {outputs} outputs: not flown; 32 with SERVO_32_ENABLE 1"
            self._told.append((Code.RANGE, words))

    def is_servo_packet(self, datagram: bytes, now_ns: int) -> bool:
        """Whether it is one; what else comes is told once a minute."""
        magic = int.from_bytes(datagram[:2], "little")
        outputs = OUTPUTS.get(magic)
        if outputs is not None and len(datagram) == _HEAD.size + 2 * outputs:
            return True
        if self._last_foreign_ns is None or now_ns - self._last_foreign_ns >= _FOREIGN_EVERY_NS:
            self._last_foreign_ns = now_ns
            if outputs is None:
                why = f"no servo packet ({' or '.join(str(m) for m in OUTPUTS)})"
            else:
                why = f"a servo packet of that magic has {outputs} outputs, {_HEAD.size + 2 * outputs} bytes"
            self._told.append((Code.FOREIGN, f"passed over: {len(datagram)} bytes of magic {magic}: {why}"))
        return False

    @property
    def waits(self) -> bool:
        """Whether, in lock-step, the packet that follows the last answer is still to come."""
        return self._loop.lock_step and self._answers and not self._due

    def give_up(self) -> None:
        """Wait no longer; again when it has sent something."""
        self._answers = False

    def outgoing(self, step: int, row: Mapping[str, float]) -> bytes:
        """The answer that is due, after a step of LOOP_HZ that gave this row of signals; empty if none is."""
        if self._origin is None:
            self._origin = row["latitude"], row["longitude"]
        if not self._due or step % round(LOOP_HZ / self._loop.rate) != 0:
            return b""
        self._due = False
        return state(step / LOOP_HZ, row, self._origin, self._loop.ground)

    def told(self) -> list[tuple[Code, str]]:
        """What has happened since this was last asked."""
        said, self._told = self._told, []
        return said


def state(time_s: float, row: Mapping[str, float], origin: tuple[float, float], ground: float) -> bytes:
    """The line that ArduPilot reads: from `origin` (latitude and longitude, rad), down from the height `ground`, m."""
    latitude, longitude = origin
    along, across = radii(latitude)
    north = (row["latitude"] - latitude) * along
    east = (row["longitude"] - longitude) * across * math.cos(latitude)
    words = {
        "timestamp": time_s,
        "imu": {"gyro": [row["p"], row["q"], row["r"]], "accel_body": [row["ax"], row["ay"], row["az"]]},
        "position": [north, east, ground - row["altitude"]],
        "attitude": [row["phi"], row["theta"], row["psi"]],
        "velocity": [row["v_north"], row["v_east"], row["v_down"]],
        "airspeed": row["airspeed"],
    }
    # Line feeds on both sides: what is cut short is then known by what follows.
    return b"\n" + json.dumps(words, separators=(",", ":")).encode("ascii") + b"\n"
