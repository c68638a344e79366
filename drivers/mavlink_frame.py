"""MAVLink packets: out of a stream of bytes, and into bytes; sequence numbers and signatures.

pymavlink decodes and packs; finding packets and checking signatures is done here, for two reasons. Its parser believes
the length byte of whatever follows a false start and swallows up to 280 bytes of good packets with it, where this one
looks again from the next byte. And it moves its replay limit before it has checked a signature, so that one forged
packet would lock out the real sender.

Sources: mavlink.io, "Packet Serialization" and "Message Signing".
"""

from __future__ import annotations

import hashlib
import hmac
import re
from typing import Any, Final

from fastcrc import crc16
from pymavlink.dialects.v20 import ardupilotmega as dialect

SILENT_NS: Final = 5_000_000_000
"""A sender is gone: five heartbeats, as MAVLink's "Heartbeat Protocol" has it."""
_STX1: Final = 0xFE
_STX2: Final = 0xFD
_KNOWN: Final = b"".join(re.escape(bytes((n,))) for n in range(256) if n in dialect.mavlink_map)
_START: Final = re.compile(
    rb"\xfe(?=[\s\S]{4}[" + _KNOWN + rb"]|[\s\S]{0,4}\Z)|\xfd(?=[\s\S][\x00\x01]|[\s\S]?\Z)",
)
"""Where a packet may begin that this reader knows; what follows is looked at, not used up: another may begin in it."""
_SIGNED: Final = 0x01
_SIGNATURE_BYTES: Final = 13
_SHORTEST: Final = 8
_OVERTAKEN: Final = 16
"""A packet numbered up to so far behind the newest was sent twice or overtaken on the way."""
_MINUTE: Final = 6_000_000
"""One minute in the unit of signature time, 10 us."""
_SIGNING_EPOCH_NS: Final = 1_420_070_400_000_000_000
"""2015-01-01 UTC in ns since 1970: where signature time starts."""


def signature_time(utc_ns: int) -> int:
    """UTC, ns since 1970, as signature time: 10 us since 2015, not below 0."""
    return max(0, (utc_ns - _SIGNING_EPOCH_NS) // 10_000)


class Framer:
    """Bytes to checked messages of every system on the link. Feed it bytes cut anywhere; it never raises.

    `bad` counts damaged or refused packets, `resyncs` how often bytes were skipped that belong to no packet, `noise`
    those bytes, `refused` the packets (also in `bad`) whose signature is missing, wrong or too old, `lost` the packets
    missing by the sequence numbers of each sender. With `key` (32 bytes) only signed packets pass; `utc_ns` is the time
    now: no signature of a new sender is accepted that is more than a minute older.
    """

    def __init__(self, key: bytes | None = None, utc_ns: int = 0) -> None:
        self.bad = 0
        self.resyncs = 0
        self.noise = 0
        self.refused = 0
        self.lost = 0
        self._key = key
        self._newest = signature_time(utc_ns)
        self._signed_until: dict[tuple[int, int, int], int] = {}
        self._next_seq: dict[tuple[int, int], int] = {}
        self._decoder = dialect.MAVLink(None)
        self._pending = bytearray()
        self._in_sync = True
        self._quiet = 0
        """So many bytes must wait before anything more can be said of them."""
        self._blamed = 0
        """Where in `_pending` a packet counted as bad would end."""

    def reset(self) -> None:
        """Forget half a packet and where each sender's count stood."""
        self._pending.clear()
        self._next_seq.clear()
        self._in_sync = True
        self._blamed = self._quiet = 0

    def look_at(self, datagram: bytes) -> tuple[list[Any], int]:
        """The messages of a datagram that `feed` would pass, and how many it would refuse; nothing is taken note of."""
        other = Framer(self._key)
        other._newest, other._signed_until = self._newest, dict(self._signed_until)
        return other.feed(datagram), other.refused

    def feed(self, data: bytes) -> list[Any]:
        """The pymavlink messages that `data` completes."""
        self._pending += data
        messages = []
        at, hidden, taken = 0, -1, 0
        while start := _START.search(self._pending, at):
            if start.start() > at:
                self._lose_sync()
                at, self._quiet = start.start(), 0
            size, sound = self._packet(at)
            if sound is None:
                if not self._in_sync and hidden <= at:
                    hidden = self._hidden_packet(at)
                if self._in_sync or hidden <= at:
                    break
            self._quiet = 0
            if sound:
                self._in_sync = True
                message = self._accept(self._pending[at : at + size])
                if message is not None:
                    messages.append(message)
                at, taken = at + size, taken + size
                continue
            if self._blame(at, size):
                self._in_sync = False
            self._lose_sync()
            at += 1
        else:
            if at < len(self._pending):
                self._lose_sync()
            at = len(self._pending)
        del self._pending[:at]
        self._blamed -= at
        self.noise += at - taken
        return messages

    def _blame(self, at: int, size: int) -> bool:
        """Whether a damaged packet, and not a false start inside one, is at `at`; it is counted."""
        if not size or at < self._blamed:
            return False
        self.bad += 1
        self._blamed = at + size
        return True

    def _lose_sync(self) -> None:
        self.resyncs += self._in_sync
        self._in_sync = False

    def _hidden_packet(self, at: int) -> int:
        """Where a sound packet lies behind a start that was found among noise and whose packet is not all here yet; -1
        for nowhere.

        That start is then taken for noise too, rather than let it hold up good packets until it can be proved wrong.
        Nothing is looked at again before the first packet that may begin there can have ended.
        """
        if len(self._pending) - at < self._quiet:
            return -1
        self._quiet = len(self._pending) - at + _SHORTEST
        for start in _START.finditer(self._pending, at + 1):
            size, sound = self._packet(start.start())
            if sound:
                self._quiet = 0
                return start.start()
            if sound is None:
                self._quiet = min(self._quiet, start.start() - at + max(size, _SHORTEST))
        return -1

    def _packet(self, at: int) -> tuple[int, bool | None]:
        """Size of the packet starting at `at` (0: there is none, or not known yet) and whether it is sound.

        None: too little of it is here yet.
        """
        head = self._pending[at : at + 10]
        if head[0] == _STX1:
            if len(head) < 6:
                return 0, None
            size, kind = 8 + head[1], dialect.mavlink_map.get(head[5])
            if kind is None or head[1] > kind.unpacker.size:
                return 0, False
        else:
            if len(head) > 2 and head[2] & ~_SIGNED:
                return 0, False  # flags this reader does not know: the standard says to drop it
            if len(head) < 10:
                return 0, None
            size = 12 + head[1] + _SIGNATURE_BYTES * (head[2] & _SIGNED)
            kind = dialect.mavlink_map.get(int.from_bytes(head[7:10], "little"))
        if kind is None:
            # The checksum of another dialect's message cannot be checked: it must stand right between two packets.
            if not self._in_sync:
                return 0, False
            if len(self._pending) <= at + size:
                return size, None
            return size, self._pending[at + size] in (_STX1, _STX2)
        if len(self._pending) < at + size:
            return size, None
        end = at + size - _SIGNATURE_BYTES * (head[0] == _STX2 and head[2] & _SIGNED)
        checked = bytes(self._pending[at + 1 : end - 2]) + bytes([kind.crc_extra])
        return size, crc16.mcrf4xx(checked) == int.from_bytes(self._pending[end - 2 : end], "little")

    def _accept(self, frame: bytearray) -> Any:
        """The message in a sound packet; None if it is refused or not in the dialect."""
        if self._key is not None and not self._signature_holds(frame, self._key):
            self.refused += 1
            self.bad += 1
            return None
        sender = (frame[3], frame[4]) if frame[0] == _STX1 else (frame[5], frame[6])
        seq = frame[2] if frame[0] == _STX1 else frame[4]
        missing = (seq - self._next_seq.get(sender, seq)) % 256
        if missing < 256 - _OVERTAKEN:
            self.lost += missing if missing < 128 else 0  # further ahead, and the sender has started anew
            self._next_seq[sender] = (seq + 1) % 256
        try:
            message = self._decoder.decode(frame)
        except dialect.MAVError:
            self.bad += 1
            return None
        return None if message.get_msgId() not in dialect.mavlink_map else message

    def _signature_holds(self, frame: bytearray, key: bytes) -> bool:
        """Checks the hash first: only a packet of the key's holder may move what is accepted next."""
        if frame[0] == _STX1 or not frame[2] & _SIGNED:
            return False
        digest = hashlib.sha256(key + frame[:-6]).digest()[:6]
        if not hmac.compare_digest(digest, frame[-6:]):
            return False
        stamp = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[-13], frame[5], frame[6])
        limit = self._signed_until.get(stream, self._newest - _MINUTE - 1)
        if stamp <= limit:
            return False
        self._signed_until[stream] = stamp
        self._newest = max(self._newest, stamp)
        return True


class Packer:
    """Messages to MAVLink 2 packets of one sender, numbered, and signed if there is a `key` (32 bytes).

    `utc_ns` is the time now. Signature time is the time of packing, as the standard has it, and never stands still: a
    vehicle that has its time from GPS takes no packet that is a minute old.
    """

    def __init__(self, system_id: int, component_id: int, key: bytes | None = None, utc_ns: int = 0) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        if key is not None:
            self._mav.signing.secret_key = key
            self._mav.signing.timestamp = signature_time(utc_ns)
            self._mav.signing.sign_outgoing = True

    def pack(self, message: Any, utc_ns: int = 0) -> bytes:
        """The packet for a pymavlink message, sent at `utc_ns`."""
        self._mav.signing.timestamp = max(self._mav.signing.timestamp, signature_time(utc_ns))
        packet: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet
