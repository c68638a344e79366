"""What of a machine matters to a flight: versions, processor, clock, disk, ports, permissions, terminal, browser."""

from __future__ import annotations

import importlib.metadata
import locale
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

State = Literal["ok", "note", "mend"]

LIBRARIES: Final = ("numpy", "scipy", "numba", "mcap", "pyserial", "python-can", "pymavlink", "rerun-sdk", "xarray")
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "firefox", "microsoft-edge")
GIB: Final = 1024.0**3
BYTES_PER_HOUR: Final = 0.42 * GIB
"""Of the bench's nine streams, recorded: tests/README.md."""
LEAST_HOURS: Final = 2.0
"""Of recording that the disk should have room for."""
LEAST_CORES: Final = 2
"""One for the loop, one for the page."""
PRIORITY: Final = 5
"""Of the system's real-time priorities, 1 to 99: above all ordinary work, below its own."""
LEAST_COLUMNS, LEAST_ROWS = 80, 24
"""Of a terminal that the station's screen fits in."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line: what was looked at, what was found, and where something is to be mended, how."""

    about: str
    found: str
    state: State = "ok"
    mend: str = ""


def examine(folder: Path) -> Iterator[Finding]:
    """Everything, the recordings being kept in `folder`."""
    yield from _versions()
    yield from _processor()
    yield from _priority()
    yield from _clock()
    yield _disk(folder)
    yield from _ports()
    yield from _seen_by()


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"


def _versions() -> Iterator[Finding]:
    yield Finding("station", _version("flight-test-station"))
    yield Finding("python", f"{platform.python_version()} ({platform.python_implementation()}), {sys.platform}")
    yield Finding("system", f"{platform.system()} {platform.release()} {platform.machine()}")
    yield Finding("libraries", ", ".join(f"{name} {_version(name)}" for name in LIBRARIES))
    cache = Path(os.environ.get("NUMBA_CACHE_DIR", ""))
    compiled = sum(1 for _ in cache.rglob("*.nbc")) if cache.is_dir() else 0
    first = "" if compiled else "; the first flight compiles them, some 45 s"
    yield Finding("compiled numerics", f"{compiled} kernels in {_short(cache)}{first}", "ok" if compiled else "note")


def _processor() -> Iterator[Finding]:
    names = re.findall(r"^model name\s*:\s*(.+)$", _text(Path("/proc/cpuinfo")), re.M)
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    few = allowed < LEAST_CORES
    yield Finding(
        "processor", f"{names[0] if names else platform.machine()}, {allowed} of {os.cpu_count()} cores",
        "mend" if few else "ok", "two cores are the least: the page takes one" if few else "",
    )  # fmt: skip
    governor = _text(Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"))
    if governor:
        slow = governor == "powersave" and "intel_pstate" not in _driver()
        yield Finding(
            "frequency",
            governor,
            "note" if slow else "ok",
            "sudo cpupower frequency-set -g performance" if slow else "",
        )
    memory = dict(re.findall(r"^(MemTotal|MemAvailable):\s+(\d+) kB", _text(Path("/proc/meminfo")), re.M))
    if memory:
        total, free = (int(memory.get(n, 0)) * 1024 / GIB for n in ("MemTotal", "MemAvailable"))
        yield Finding("memory", f"{free:.1f} of {total:.1f} GiB free")


def _priority() -> Iterator[Finding]:
    """Whether a flight may go before what else runs."""
    if not hasattr(os, "sched_getscheduler"):
        return
    import resource

    may = os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] >= PRIORITY
    if os.sched_getscheduler(0) in (os.SCHED_RR, os.SCHED_FIFO):
        yield Finding("priority", "real-time")
    elif may:
        yield Finding("priority", f"real-time granted: chrt -r {PRIORITY} station run CARD flies before all else")
    else:
        yield Finding(
            "priority", "real-time not granted", "note",
            f"where others load the machine: ulimit -r {PRIORITY} as root, then chrt -r {PRIORITY} station run CARD",
        )  # fmt: skip


def _driver() -> str:
    return _text(Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_driver"))


def _clock() -> Iterator[Finding]:
    source = _text(Path("/sys/devices/system/clocksource/clocksource0/current_clocksource"))
    if source:
        steady = source in ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page", "xen")
        yield Finding(
            "clock source", source, "ok" if steady else "note",
            "" if steady else "slow to read: tsc or arch_sys_counter is better (see dmesg | grep -i tsc)",
        )  # fmt: skip
    synchronised = Path("/run/systemd/timesync/synchronized").exists() or bool(shutil.which("chronyc"))
    yield Finding(
        "calendar time", "kept by the network" if synchronised else "not known to be synchronised",
        "ok" if synchronised else "note",
        "" if synchronised else "only names and dates of recordings go by it; flights have a clock of their own",
    )  # fmt: skip


def _disk(folder: Path) -> Finding:
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    try:
        free = shutil.disk_usage(there).free
    except OSError as error:
        return Finding("disk", f"{there}: {error.strerror}", "mend", "name another folder: station run --log DIR")
    hours = free / BYTES_PER_HOUR
    words = f"{free / GIB:.0f} GiB free for {_short(folder.absolute())}: {hours:.0f} h of the bench's recording"
    if not os.access(there, os.W_OK):
        return Finding("disk", words, "mend", f"{there} may not be written to: station run --log DIR")
    full = hours < LEAST_HOURS
    return Finding("disk", words, "mend" if full else "ok", "make room, or station run --log DIR" if full else "")


def _ports() -> Iterator[Finding]:
    from drivers.ports_there import can_interfaces, serial_ports

    for kind, found in (("serial port", list(serial_ports())), ("CAN interface", list(can_interfaces()))):
        if not found:
            yield Finding(kind, "none")
        for port in found:
            words = f"{port.name}{f': {port.what}' if port.what else ''}"
            yield Finding(kind, words, "ok" if port.usable else "mend", port.why_not)


def _seen_by() -> Iterator[Finding]:
    size = shutil.get_terminal_size()
    over = "over ssh" if os.environ.get("SSH_CONNECTION") else "local"
    what = f"{size.columns}x{size.lines}, {os.environ.get('TERM') or 'no TERM'}, {locale.getpreferredencoding(False)}"
    small = sys.stdout.isatty() and (size.columns < LEAST_COLUMNS or size.lines < LEAST_ROWS)
    kind = what if sys.stdout.isatty() else "not a terminal"
    wanted = f"the screen wants {LEAST_COLUMNS}x{LEAST_ROWS}; smaller, lines are left out" if small else ""
    yield Finding("terminal", f"{kind}, {over}", "note" if small else "ok", wanted)
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), "")
    desktop = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if browser and desktop:
        yield Finding("page", f"desktop and {browser}: station run opens it")
        return
    lacking = "no desktop" if not desktop else "no browser found"
    yield Finding(
        "page", f"{lacking}{f', {browser}' if browser else ''}", "note",
        "open the address that station run prints; from elsewhere, forward its ports: ssh -L PORT:127.0.0.1:PORT HOST",
    )  # fmt: skip


def _short(path: Path) -> str:
    """Without the user's name: the block is for pasting."""
    with suppress(ValueError, RuntimeError):
        return f"~/{path.relative_to(Path.home())}"
    return str(path)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
