"""Who flies over a MAVLink link, and whether anything may be sent on it.

All who are on a link hear what is sent on it. So nothing is sent unless an autopilot there says in its heartbeats that
it is in HIL, and none that is armed says that it is not; what is flown is that one's. A link that the rig declares to
be a simulator's is open, and flown by the first who sends controls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.mavlink_frame import SILENT_NS
from station.rows import Code

ARMED: Final = dialect.MAV_MODE_FLAG_SAFETY_ARMED
IN_HIL: Final = dialect.MAV_MODE_FLAG_HIL_ENABLED
Sender = tuple[int, int]
"""System and component."""


def sender_of(message: Any) -> Sender:
    return message.get_srcSystem(), message.get_srcComponent()


def is_autopilot(heartbeat: Any) -> bool:
    """Gimbals, onboard computers and ground stations are none: their `autopilot` is MAV_AUTOPILOT_INVALID, "for
    components that are not flight controllers" (common.xml); some ground stations fill it in all the same."""
    return bool(heartbeat.autopilot != dialect.MAV_AUTOPILOT_INVALID and heartbeat.type != dialect.MAV_TYPE_GCS)


@dataclass(frozen=True, slots=True)
class _Beat:
    t_ns: int
    in_hil: bool
    armed: bool

    @property
    def says(self) -> tuple[bool, bool]:
        return self.in_hil, self.armed

    def is_there(self, now_ns: int) -> bool:
        return now_ns - self.t_ns <= SILENT_NS


class HilGuard:
    """One link. Tell it of heartbeats; ask it before anything is sent or flown."""

    def __init__(self, simulator: bool) -> None:
        self._simulator = simulator
        self._beats: dict[Sender, _Beat] = {}
        self._flown: Sender | None = None
        self._was_open = False
        self._last_controls_ns = 0
        self._strangers: set[Sender] = set()
        """Whose controls were passed over, which has been told."""
        self._told: list[tuple[Code, str]] = []

    def begin(self) -> None:
        """The link has been opened, perhaps to another autopilot."""
        self._beats.clear()
        self._strangers.clear()
        self._flown, self._was_open = None, False

    def heartbeat(self, message: Any, now_ns: int) -> None:
        if self._simulator or not is_autopilot(message):
            return
        sender = sender_of(message)
        before = self._beats.get(sender)
        beat = _Beat(now_ns, bool(message.base_mode & IN_HIL), bool(message.base_mode & ARMED))
        is_news = before is None or not before.is_there(now_ns) or before.says != beat.says
        self._beats[sender] = beat
        if sender == self._flown and not beat.in_hil:
            self._flown, self._was_open = None, False
        if beat.in_hil and not self._is_there(self._flown, now_ns):
            self._flown = sender
        is_open = self.is_open(now_ns)
        if is_news and not (is_open and sender == self._flown):
            self._tell_of(sender, beat, now_ns)

    def is_open(self, now_ns: int) -> bool:
        """Whether whoever is at the other end moves nothing real."""
        if self._simulator:
            return True
        flown, is_open = self._flown, self._is_there(self._flown, now_ns) and not self._real(now_ns)
        if flown is not None and is_open != self._was_open:
            if is_open:
                self._told.append((Code.HEARD, f"{_named(flown)} is in HIL: it is told of the simulated sensors"))
            elif not self._is_there(flown, now_ns):
                words = f"{_named(flown)} has sent no heartbeat for 5 s: nothing is sent to it, nor flown of it"
                self._told.append((Code.FOREIGN, words))
        self._was_open = is_open
        return is_open

    def may_fly(self, sender: Sender, now_ns: int) -> bool:
        """Whether this sender's controls are flown; whose are passed over is told once."""
        if self._simulator and (self._flown is None or now_ns - self._last_controls_ns > SILENT_NS):
            self._flown = sender
        if sender == self._flown:
            self._last_controls_ns = now_ns
            return self.is_open(now_ns)
        # What its heartbeats say has been told with those.
        if sender not in self._beats and sender not in self._strangers:
            self._strangers.add(sender)
            why = f"{_named(self._flown)} flies" if self._flown is not None else "no heartbeat of it says HIL"
            self._told.append((Code.FOREIGN, f"{_named(sender)} sends controls, which are not flown: {why}"))
        return False

    def may_ask(self, sender: Sender) -> bool:
        """Whether this sender's commands are heeded."""
        return sender == self._flown or (self._simulator and self._flown is None)

    def _is_there(self, sender: Sender | None, now_ns: int) -> bool:
        return sender is not None and self._beats[sender].is_there(now_ns)

    def _real(self, now_ns: int) -> list[Sender]:
        """Who is armed and not in HIL."""
        return [s for s, b in self._beats.items() if b.armed and not b.in_hil and b.is_there(now_ns)]

    def _tell_of(self, sender: Sender, beat: _Beat, now_ns: int) -> None:
        who = _named(sender)
        if beat.in_hil and self._flown is not None and sender != self._flown:
            words = f"{who} is in HIL too: nothing is flown of it while {_named(self._flown)} is there"
        elif beat.in_hil:
            real = ", ".join(map(_named, self._real(now_ns)))
            words = f"{who} is in HIL: nothing is sent to it while {real} is on the link, armed and not in HIL"
        elif beat.armed:
            words = f"{who} is armed and not in HIL: nothing is sent on this link, nor flown, while it is there"
        else:
            words = f"{who} is not in HIL: nothing is sent for it, nor flown of it"
        self._told.append((Code.FOREIGN, words))

    def told(self) -> list[tuple[Code, str]]:
        """What has happened since this was last asked."""
        said, self._told = self._told, []
        return said


def _named(sender: Sender) -> str:
    system, component = sender
    own = component == dialect.MAV_COMP_ID_AUTOPILOT1
    return f"system {system}" if own else f"component {component} of system {system}"
