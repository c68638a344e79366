"""ArduPilot's DataFlash .bin logs, read with pymavlink: signals in SI, each message a time base of its own.

ArduPilot's AOA message is calculated from airspeed, wind and velocity and is no vane, so it is left out; so are servo
outputs, which are commands in microseconds. `left_out` says so. Times are the autopilot's, since it booted.
"""

from __future__ import annotations

import math
import mmap
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from pymavlink import DFReader

from station.conventions import GAS_CONSTANT, SEA_LEVEL_DENSITY
from station.rows import LogError

Columns = tuple[str, list[int], dict[str, list[float]]]

_ISA_TEMPERATURE: Final = 288.15
_ISA_PRESSURE: Final = 101_325.0
_ISA_EXPONENT: Final = 0.190263
"""Of the troposphere: T/T0 = (p/p0)^0.190263 (ISO 2533)."""


def _imu(m: Any) -> dict[str, float]:
    return {"p": m.GyrX, "q": m.GyrY, "r": m.GyrZ, "ax": m.AccX, "ay": m.AccY, "az": m.AccZ}


def _attitude(m: Any) -> dict[str, float]:
    return {"phi": math.radians(m.Roll), "theta": math.radians(m.Pitch), "psi": math.radians(m.Yaw)}


def _ekf(m: Any) -> dict[str, float]:
    return {"v_north": m.VN, "v_east": m.VE, "v_down": m.VD}


def _gps(m: Any) -> dict[str, float]:
    course = math.radians(m.GCrs)
    return {
        "latitude": math.radians(m.Lat),
        "longitude": math.radians(m.Lng),
        "altitude": m.Alt,
        "v_north": m.Spd * math.cos(course),
        "v_east": m.Spd * math.sin(course),
        "v_down": m.VZ,
    }


def _airspeed(m: Any) -> dict[str, float]:
    return {"airspeed": m.Airspeed, "dynamic_pressure": m.DiffPress, "air_temperature": m.Temp + 273.15}


def _baro(m: Any) -> dict[str, float]:
    return {"static_pressure": m.Press}


_MESSAGES: Final[Mapping[str, Callable[[Any], dict[str, float]]]] = {
    "IMU": _imu,
    "ATT": _attitude,
    "XKF1": _ekf,
    "NKF1": _ekf,
    "GPS": _gps,
    "ARSP": _airspeed,
    "BARO": _baro,
}
_VELOCITIES: Final = ("XKF1", "NKF1", "GPS")
"""In order of preference: the filter's is faster than the receiver's."""


class _Log(DFReader.DFReader_binary):  # type: ignore[misc]
    """That goes on: at a message which the log describes as without length pymavlink would stand still for ever."""

    def _parse_next(self) -> Any:
        at = self.offset
        made = super()._parse_next()
        if made is not None and self.offset <= at:
            self.close()  # which nobody holds yet
            raise LogError(f"damaged at byte {at}: a message there has no length by the log's own description")
        return made


def read_dataflash(path: Path) -> list[Columns]:
    """(message, times in ns, SI values by signal) of the first instance of each sensor.

    Raises LogError if the file is no DataFlash log or holds no message that is known.
    """
    found: dict[str, tuple[list[int], dict[str, list[float]]]] = {}
    log = None
    # Looked at here because DFReader leaves the file open where it is none.
    with path.open("rb") as file:
        if file.read(2) != b"\xa3\x95":
            raise LogError(f"{path}: not a DataFlash log: it does not begin with a message's head")
    try:
        log = _Log(str(path), zero_time_base=True)
        while (m := log.recv_match(type=list(_MESSAGES))) is not None:
            _add(found, m)
    except LogError as error:
        raise LogError(f"{path}: {error}\ndownload the log anew") from None
    except Exception as error:  # pymavlink raises whatever a broken file makes of it
        raise LogError(f"{path}: not a DataFlash log that can be read: {type(error).__name__}: {error}") from error
    finally:
        if log is not None:
            log.close()
    if not found:
        raise LogError(f"{path}: holds none of the messages that are known: {', '.join(_MESSAGES)}")
    velocities = [name for name in _VELOCITIES if name in found]
    for name in velocities[1:]:
        for signal in ("v_north", "v_east", "v_down"):
            del found[name][1][signal]
    if "ARSP" in found:
        _true_airspeed(found["ARSP"], found.get("BARO"))
    return [(name, *found[name]) for name in _MESSAGES if name in found and found[name][1]]


_LEFT_OUT: Final[Mapping[str, tuple[str, str]]] = {
    "AOA": ("alpha_vane", "AOA is calculated from airspeed, wind and velocity, not measured: not imported as a vane"),
    "RCOU": ("elevator", "RCOU are commands to the servos in microseconds, not positions: not imported as surfaces"),
}


def left_out(path: Path) -> dict[str, str]:
    """Why messages that look like a signal are none, by signal; of those that are in the log. Raises OSError."""
    found = {}
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for name, (signal, why) in _LEFT_OUT.items():
            told = re.search(rb"\xa3\x95\x80(.).%s\0" % name.encode(), data, re.DOTALL)
            if told is not None and data.find(b"\xa3\x95" + told[1], told.end()) >= 0:
                found[signal] = why
    return found


def _add(found: dict[str, tuple[list[int], dict[str, list[float]]]], m: Any) -> None:
    kind = m.get_type()
    fields = m.get_fieldnames()
    if any(getattr(m, instance) for instance in ("I", "C") if instance in fields):
        return
    if kind == "GPS" and m.Status < 3:
        return
    times, columns = found.setdefault(kind, ([], {}))
    t_ns = int(m.TimeUS) * 1000
    if times and t_ns <= times[-1]:
        return
    values = _MESSAGES[kind](m)
    times.append(t_ns)
    for signal, value in values.items():
        columns.setdefault(signal, []).append(float(value))


def _true_airspeed(
    arsp: tuple[list[int], dict[str, list[float]]], baro: tuple[list[int], dict[str, list[float]]] | None
) -> None:
    """ARSP.Airspeed is equivalent airspeed: true is sqrt(rho0/rho) times that.

    Density from BARO's pressure and the pitot's temperature; where that is not measured (0 degC exactly), the standard
    atmosphere's at that pressure. Without BARO there is no true airspeed.
    """
    times, columns = arsp
    if baro is None:
        del columns["airspeed"], columns["air_temperature"]
        return
    pressure = np.interp(times, baro[0], baro[1]["static_pressure"])
    measured = np.array(columns["air_temperature"])
    standard = _ISA_TEMPERATURE * (pressure / _ISA_PRESSURE) ** _ISA_EXPONENT
    unmeasured = (measured == 273.15) | ~np.isfinite(measured)
    temperature = np.where(unmeasured, standard, measured)
    density = pressure / (GAS_CONSTANT * temperature)
    columns["airspeed"] = (np.array(columns["airspeed"]) * np.sqrt(SEA_LEVEL_DENSITY / density)).tolist()
    columns["air_temperature"] = np.where(unmeasured, np.nan, measured).tolist()
    if np.all(unmeasured):
        del columns["air_temperature"]
