"""Files of other programs, small, made by other writers than those that the station reads them with."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

import numpy as np
from scipy.io import savemat

from drivers.dataflash import read_dataflash
from station.convert import Importer, reader_of
from station.profile import load_aircraft

AIRCRAFT: Final = load_aircraft("twin_otter")
DATAFLASH: Final = Importer(".bin", "DataFlash", reader_of("dataflash", read_dataflash))


def mat(path: Path, compressed: bool, rows: int = 200) -> bytes:
    """SIDPAC's matrix, written by scipy."""
    fdata = np.zeros((rows, 90))
    fdata[:, 0] = np.arange(rows) * 0.02
    fdata[:, 1] = 100.0
    savemat(path, {"fdata": fdata}, do_compression=compressed)
    return path.read_bytes()


def umn(path: Path, rows: int = 12) -> bytes:
    """The University of Minnesota's structure, written by scipy."""
    names = "aoa aos p q r ax ay az phi theta psi navvn navve navvd navlat navlon navalt de dr da_r da_l Ps ias"
    data = {name: np.full(rows, 1.5) for name in names.split()}
    savemat(path, {"flight_data": {**data, "time": np.arange(rows) * 0.02}})
    return path.read_bytes()


def onspeed(rows: int = 6) -> bytes:
    """Its header, and what the reader uses of it."""
    names = "timeStamp PStatic OAT TAS boomAlpha boomBeta boomAge vnAngularRateRoll vnAngularRatePitch vnAngularRateYaw"
    names += " vnVelNedNorth vnVelNedEast vnVelNedDown vnAccelFwd vnAccelLat vnAccelVert vnYaw vnPitch vnRoll vnGnssLat"
    names += " vnGnssLon vnDataAge Altitude"
    lines = [names.replace(" ", ",")]
    rest = "43.96,-89.08,16,6044"
    for k in range(rows):
        lines.append(f"{2860003 + 20 * k},811.96,14.38,81.65,3659,4021,29,{'0.01,' * 10}0.18,6.89,{rest}")
    return "\n".join(lines).encode()


def dataflash(times_us: list[int]) -> bytes:
    """ATT messages, packed by hand after ArduPilot's FMT."""
    kinds = [
        (128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
        (131, 17, b"ATT", b"Qccc", b"TimeUS,Roll,Pitch,Yaw"),
    ]
    out = b"".join(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *kind) for kind in kinds)
    return out + b"".join(b"\xa3\x95\x83" + struct.pack("<Qhhh", t, 100, 200, 300) for t in times_us)


def ulog(rows: int = 100) -> bytes:
    """A topic of PX4, packed by hand after its specification."""

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<H", len(content)) + kind + content

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000) + message(b"B", bytes(40))
    out += message(b"F", b"airspeed_validated:uint64_t timestamp;float true_airspeed_m_s;")
    out += message(b"A", struct.pack("<BH", 0, 0) + b"airspeed_validated")
    return out + b"".join(message(b"D", struct.pack("<HQf", 0, 1_000_000 + k * 20_000, 50.0)) for k in range(rows))
