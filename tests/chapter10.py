"""Chapter 10 files built bit by bit after IRIG 106 Chapters 4, 9 and 11."""

from __future__ import annotations

import struct
from typing import Final

T0: Final = 5_000_000_000
"""Of the relative time counter, 100 ns."""
SYNC = "111110101111001100100000"  # 24 bits: FAF320 (Chapter 4, table A-1)
SETUP = rf"""G\106:17; R-1\ID:A; R-1\TK1-1:3; R-1\CDT-1:PCMIN; R-1\CDLN-1:x;
P-1\DLN:X; P-1\D2:12000; P-1\F1:12; P-1\F2:M; P-1\MF\N:1; P-1\MF1:4; P-1\MF5:{SYNC};
D-1\DLN:X; D-1\MN-1-1:THETA; D-1\MML\N-1-1:1; D-1\WP-1-1-1-1:2; D-1\WFM-1-1-1-1:FW;
D-1\MN-1-2:Q; D-1\LT-1-2:MFSF; D-1\WP-1-2-1-1:1;
C-1\DCN:THETA; C-1\MN3:rad; C-1\BFM:SIG; C-1\DCT:COE; C-1\CO\N:1; C-1\CO:0; C-1\CO-1:0.0009765625;
C-2\DCN:Q; C-2\MN3:deg/s; C-2\BFM:TWO; C-2\DCT:NON;"""
COUNTS = [0, 1, 2047, 0x801, 0xFFF, 700]


def packet(channel: int, kind: int, body: bytes, ticks: int = T0, checksum: bool = True) -> bytes:
    """With a 32-bit sum behind it, or none."""
    filled = body + bytes(-len(body) % 4)
    if checksum:
        filled += struct.pack("<I", sum(struct.unpack(f"<{len(filled) // 4}I", filled)) & 0xFFFFFFFF)
    head = struct.pack("<HHIIBBBB", 0xEB25, channel, 24 + len(filled), len(body), 6, 0, 3 * checksum, kind)
    head += ticks.to_bytes(6, "little")
    return head + struct.pack("<H", sum(struct.unpack("<11H", head)) & 0xFFFF) + filled


def setup(text: str = SETUP, word: int = 12) -> bytes:
    return packet(0, 0x01, struct.pack("<I", word) + text.encode("latin-1"))


def frame(count: int) -> str:
    """60 bits: the pattern, 0xABC, the measurement, 0x123."""
    return SYNC + format(0xABC, "012b") + format(count, "012b") + format(0x123, "012b")


def in_words(bits: str, unit: int = 16) -> bytes:
    """The first bit is the most significant of the first little-endian word; filled with 0."""
    bits += "0" * (-len(bits) % unit)
    return b"".join(int(bits[i : i + unit], 2).to_bytes(unit // 8, "little") for i in range(0, len(bits), unit))


def stamped(data: list[bytes], wide: bool = False) -> bytes:
    """Each frame behind its time and its status word; frames are 5 ms apart (60 bits at 12 kbit/s)."""
    status = struct.pack("<I" if wide else "<H", 0xF000)
    return b"".join((T0 + 50_000 * i).to_bytes(8, "little") + status + d for i, d in enumerate(data))


def pcm_packets(mode: str) -> bytes:
    frames = [frame(c) for c in COUNTS]
    if mode == "packed":
        return packet(3, 0x09, struct.pack("<I", 1 << 19) + stamped([in_words(f) for f in frames]))
    if mode == "packed in words of 32 bits":
        body = stamped([in_words(f, 32) for f in frames], wide=True)
        return packet(3, 0x09, struct.pack("<I", 1 << 19 | 1 << 21) + body, checksum=False)
    if mode == "packed, bytes not swapped":
        body = stamped([int(f + "0000", 2).to_bytes(8, "big") for f in frames])
        return packet(3, 0x09, struct.pack("<I", 1 << 19) + body)
    if mode == "unpacked":  # of the pattern 16 bits, then the rest; each in a word of its own
        cut = [[f[0:16], f[16:24], f[24:36], f[36:48], f[48:60]] for f in frames]
        body = stamped([b"".join(in_words(w.rjust(16, "0")) for w in f) for f in cut])
        return packet(3, 0x09, struct.pack("<I", 1 << 18) + body)
    # Throughput: a stream of bits without marks, cut anywhere; the pattern is searched.
    stream = "1010011" + "".join(frames)
    stream += "0" * (-len(stream) % 16)
    body = in_words(stream)
    word = struct.pack("<I", 1 << 20)
    later = T0 - 5833 + round(96 / 12000 * 1e7)
    first = packet(3, 0x09, word + body[:12], T0 - 5833)  # 7 bits before the first frame: 0.5833 ms
    return first + packet(3, 0x09, word + body[12:], later)
