"""The doctor says what a machine lacks and how to mend it, in words and as JSON, and the shell completes verbs."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import drivers.ports_there
from drivers.ports_there import can_interfaces
from station.commands.common import page_words


def findings(station, *words: str) -> tuple[int, dict[str, dict[str, str]]]:
    code, out, _ = station("doctor", "--json", *words)
    told = json.loads(out)
    assert told["schema"] == "station.doctor/1"
    return code, {f["about"]: f for f in told["findings"]}


@pytest.fixture(autouse=True)
def no_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drivers.ports_there.list_ports, "comports", list)


def test_a_machine_without_faults(station, tmp_path: Path) -> None:
    code, found = findings(station, "--log", str(tmp_path))
    assert code == (3 if any(f["state"] == "mend" for f in found.values()) else 0)
    wanted = (
        "station",
        "python",
        "libraries",
        "processor",
        "priority",
        "disk",
        "serial port",
        "CAN interface",
        "terminal",
        "page",
    )
    assert set(wanted) <= set(found)
    assert "numpy 2." in found["libraries"]["found"]
    assert "missing" not in found["libraries"]["found"]


@pytest.mark.parametrize(
    ("policy", "user", "granted", "found", "state"),
    [
        (os.SCHED_RR, 1000, 0, "real-time", "ok"),
        (os.SCHED_OTHER, 0, 0, "real-time granted: chrt -r 5 station run CARD", "ok"),
        (os.SCHED_OTHER, 1000, 5, "real-time granted: chrt -r 5 station run CARD", "ok"),
        (os.SCHED_OTHER, 1000, 4, "real-time not granted", "note"),
    ],
)
def test_whether_a_flight_may_go_first(
    station,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    policy: int,
    user: int,
    granted: int,
    found: str,
    state: str,
) -> None:
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: policy)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (granted, granted))
    told = findings(station, "--log", str(tmp_path))[1]["priority"]
    assert told["found"].startswith(found)
    assert told["state"] == state


def test_a_port_without_permission_says_how_to_get_it(station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    device = SimpleNamespace(device=str(port), description="FT232R", serial_number="A1")
    monkeypatch.setattr(drivers.ports_there, "_group", lambda _: "dialout")
    monkeypatch.setattr(drivers.ports_there.list_ports, "comports", lambda: [device])
    monkeypatch.setattr(drivers.ports_there.os, "access", lambda path, how: path != str(port) and os.path.exists(path))
    code, found = findings(station, "--log", str(tmp_path))
    assert code == 3
    assert found["serial port"]["found"] == f"{port}: FT232R, serial number A1"
    assert found["serial port"]["mend"].startswith("no permission: sudo usermod -aG ")
    code, out, err = station("doctor", "--log", str(tmp_path))
    assert f"! serial port        {port}" in out
    assert "-> no permission" in out
    assert err.strip().splitlines()[-1].startswith("station: degraded: ")


def test_a_can_interface_that_is_down_says_how_to_bring_it_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As Linux shows them under /sys/class/net."""
    for name, kind, state, flags in (
        ("can0", "280", "down", "0x40080"),
        ("vcan0", "280", "unknown", "0x40081"),
        ("eth0", "1", "up", "0x1003"),
    ):
        folder = tmp_path / name
        folder.mkdir()
        for file, text in (("type", kind), ("operstate", state), ("flags", flags)):
            (folder / file).write_text(f"{text}\n")
    monkeypatch.setattr(drivers.ports_there, "_NETWORK", tmp_path)
    down, up = can_interfaces()
    assert (down.name, down.usable, up.name, up.usable) == ("can0", False, "vcan0", True)
    assert down.why_not == "is down: sudo ip link set can0 up type can bitrate 500000"


def test_a_full_disk_is_told_in_hours(station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0.3 * 2**30))
    code, found = findings(station, "--log", str(tmp_path))
    assert code == 3
    assert found["disk"]["state"] == "mend"
    assert "1 h of the bench's recording" in found["disk"]["found"]


@pytest.mark.parametrize(("words", "expected"), [("station doc", "doctor"), ("station identify --po", "--point")])
def test_the_shell_completes_verbs_and_options(words: str, expected: str) -> None:
    """By the protocol of Typer's scripts for bash."""
    asked = {"_STATION_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = subprocess.run(
        [sys.executable, "-m", "station"], env={**os.environ, **asked}, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == expected


def test_over_ssh_the_page_comes_with_the_command_that_forwards_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    address = "http://127.0.0.1:34647/?url=rerun%2Bhttp://127.0.0.1:53067/proxy"
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    assert page_words(address) == f"viewer: {address}"
    monkeypatch.setenv("SSH_CONNECTION", "192.0.2.7 50000 192.0.2.9 22")
    forward = "ssh -N -L 34647:127.0.0.1:34647 -L 53067:127.0.0.1:53067 192.0.2.9"
    assert page_words(address) == f"viewer: {address}\nyou are here over ssh: first, on your machine: {forward}"
