"""The serial ports and CAN interfaces of this machine, and whether this user may open them."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from serial.tools import list_ports

_NETWORK: Final = Path("/sys/class/net")
_CAN_TYPE: Final = "280"
"""ARPHRD_CAN of Linux's if_arp.h."""


@dataclass(frozen=True, slots=True)
class PortThere:
    """A port as the system names it, and what is known of it."""

    name: str
    what: str
    usable: bool
    why_not: str = ""
    """In words, with how to mend it."""


def serial_ports() -> Iterator[PortThere]:
    """Those that the system lists; a motherboard's ports without a device on them too."""
    for port in sorted(list_ports.comports()):
        words = [port.description or "", f"serial number {port.serial_number}" if port.serial_number else ""]
        what = ", ".join(w for w in words if w and w != "n/a")
        usable = os.access(port.device, os.R_OK | os.W_OK)
        mend = "" if usable else permission_lacking(port.device)
        yield PortThere(port.device, what, usable, mend)


def permission_lacking(device: str) -> str:
    """Said of a port that this user may not open. To join a group helps where the group may, and is not root's."""
    group = _group(device)
    if group is None:
        return f"no permission, and no group has it: sudo setfacl -m u:$USER:rw {device}; a udev rule makes it last"
    return f"no permission: sudo usermod -aG {group} $USER, then log in again"


def _group(device: str) -> str | None:
    """Who may open a device, none where only its owner or the system's own may; Debian's group for serial ports where
    the system does not say."""
    try:
        told = Path(device).stat()
        may = told.st_mode & stat.S_IRGRP and told.st_mode & stat.S_IWGRP and told.st_gid != 0
        return Path(device).group() if may else None
    except (OSError, KeyError, NotImplementedError):
        return "dialout"


def can_interfaces() -> Iterator[PortThere]:
    """SocketCAN's, real and virtual, whether they are up."""
    for folder in sorted(_NETWORK.glob("*")):
        if _text(folder / "type") != _CAN_TYPE:
            continue
        name = folder.name
        # A virtual interface that is up is of unknown state.
        up = _text(folder / "operstate") in ("up", "unknown") and int(_text(folder / "flags") or "0", 16) & 1 == 1
        rate = "" if name.startswith("v") else " type can bitrate 500000"
        mend = "" if up else f"is down: sudo ip link set {name} up{rate}"
        yield PortThere(name, "SocketCAN", up, mend)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
