"""From nothing to a rig, a card and an aircraft that are accepted: devices on a pseudo-terminal and UDP are heard."""

from __future__ import annotations

import os
import socket
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega

from drivers.serial_gnss import encode_nav_pvt
from station.__main__ import main
from station.profile import Aircraft, Rig, load_card, read_profile

NOWHERE = ("--port", "/dev/nowhere", "--mavlink", "none", "--seconds", "1")
UAV = ("wing_area=0.55 m2", "span=2.1 m", "chord=0.27 m", "mass=4.2 kg", "vane_x=0.45 m")


def station(*words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["station", *words])
    with pytest.raises(SystemExit) as left:
        main()
    return int(left.value.code or 0)


class Sender:
    """Something that sends every 20 ms until it is told to stop."""

    def __init__(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Sender:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.close()

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            self.send()

    def send(self) -> None: ...

    def close(self) -> None: ...


class Line(Sender):
    def __init__(self, message: bytes) -> None:
        super().__init__()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path, self._message = os.ttyname(self._slave), message

    def send(self) -> None:
        try:
            os.write(self._master, self._message)
        except BlockingIOError:
            return

    def close(self) -> None:
        os.close(self._slave)
        os.close(self._master)


class Autopilot(Sender):
    def __init__(self) -> None:
        super().__init__()
        self._link = ardupilotmega.MAVLink(None, srcSystem=7, srcComponent=1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._to = probe.getsockname()
        self.url = f"udpin:127.0.0.1:{self._to[1]}"

    def send(self) -> None:
        m = ardupilotmega
        for message in (
            m.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3),
            m.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0),
            m.MAVLink_raw_imu_message(1_000_000, 40, -10, -1001, 1, -250, 3, 0, 0, 0),
            m.MAVLink_scaled_pressure_message(1000, 1002.5, 1.98, 1400),
            m.MAVLink_servo_output_raw_message(0, 0, 1500, 1400, 1000, 1500, *[0] * 4),
        ):
            self._socket.sendto(message.pack(self._link), self._to)

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def uav(tmp_path: Path) -> Iterator[tuple[Path, str, str, str]]:
    vane, gnss = Line(b"2.51,-0.03\r\n"), Line(encode_nav_pvt(0, 45.0, -75.1, 100_000.0, (50_000.0, 0.0, 0.0)))
    with vane, gnss, Autopilot() as autopilot:
        yield tmp_path, vane.path, gnss.path, autopilot.url


def test_from_nothing_to_a_card_that_check_takes(
    uav: tuple[Path, str, str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, vane, gnss, url = uav
    into = ("--folder", str(folder))
    sets = [word for value in UAV for word in ("--set", value)]
    assert station("aircraft", "new", "uav", *into, *sets, monkeypatch=monkeypatch) == 0
    listen = ("--port", vane, "--port", gnss, "--mavlink", url, "--seconds", "1", "--can", "none")
    maps = ("--map", "c0=alpha_vane:deg:1:1.5", "--map", "servo2_raw=elevator:deg:0.05:1500")
    assert station("rig", "new", "uav", *into, *listen, *maps, "--yes", monkeypatch=monkeypatch) == 0
    profiles = load_card(str(folder / "cards" / "uav.toml"))
    signals = {n: c for d in profiles.rig.devices for s in d.streams for n, c in s.signals.items()}
    assert signals["alpha_vane"].to_si(2.51) == pytest.approx(0.017628, abs=1e-6)  # 1.01 deg
    assert signals["elevator"].to_si(1400) == pytest.approx(-0.087266, abs=1e-6)  # -5 deg
    assert {"phi", "theta", "psi", "p", "q", "r", "v_north", "latitude"} <= signals.keys()
    # ArduPilot's RAW_IMU is in mg and mrad/s; a level aircraft's az is -1 g. Rates come of ATTITUDE already.
    assert signals["az"].to_si(-1001) == pytest.approx(-9.81646, abs=1e-4)
    assert signals["dynamic_pressure"].to_si(1.98) == pytest.approx(198.0)
    assert "airspeed" not in profiles.card.needs
    assert profiles.aircraft.name == "uav"
    assert profiles.aircraft.inertia.iyy is None
    assert profiles.aircraft.uncertainty.vane_scale == pytest.approx(0.1), "nobody has told the upwash"
    said = capsys.readouterr().err
    assert "u-blox UBX: NAV-PVT 50 Hz" in said
    assert "system 7, component 1" in said
    assert station("rig", "new", "uav", *into, "--yes", monkeypatch=monkeypatch) == 2, "nothing is written over"


def test_answers_of_a_terminal_are_taken_and_asked_again_where_they_do_not_fit(
    uav: tuple[Path, str, str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, vane, _, _ = uav
    answers = iter(("y", "alfa_vane", "alpha_vane", "alpha_vane:m", "alpha_vane:deg:0.5", "alpha_vane:deg", ""))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    words = ("--folder", str(folder), "--port", vane, "--mavlink", "none", "--can", "none", "--seconds", "1")
    assert station("rig", "new", "mine", *words, monkeypatch=monkeypatch) == 0
    rig = read_profile(Rig, folder / "rigs" / "mine.toml")
    ((stream,),) = [device.streams for device in rig.devices]
    assert {n: (c.field, c.slope) for n, c in stream.signals.items()} == {"alpha_vane": ("c0", 0.5)}
    assert next(answers, None) is None
    said = capsys.readouterr().err
    assert "alpha_vane: in which unit? like alpha_vane:rad; fitting: rad, mrad, deg" in said
    assert "alpha_vane is c0 already" in said


def test_outputs_of_an_autopilot_are_asked_for_where_they_are_connected(
    uav: tuple[Path, str, str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, *_, url = uav
    place = ("0.1 m, 0 m", "0.1 m, 0, 0 m", "0.1 m, 0 m, -2 cm")
    answers = iter(("y", "", "elevator:deg:0.05:1500", "", "rudder:deg:-0.05:1500", *place))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    words = ("--folder", str(folder), "--port", "none", "--mavlink", url, "--can", "none", "--seconds", "1")
    assert station("rig", "new", "mine", *words, monkeypatch=monkeypatch) == 0
    assert next(answers, None) is None, "those at 0 are not asked for"
    said = capsys.readouterr().err
    assert "servo2_raw: 1400 to 1400, now 1400. Which surface does it move?" in said
    assert "SLOPE x (value - ZERO)" in said
    rig = read_profile(Rig, folder / "rigs" / "mine.toml")
    assert rig.imu_position == pytest.approx((0.1, 0.0, -0.02))
    assert "accelerometers of autopilot: where from the centre of gravity?" in said
    (device,) = rig.devices
    (outputs,) = [s.signals for s in device.streams if s.message == "SERVO_OUTPUT_RAW"]
    assert outputs["rudder"].to_si(1600) == pytest.approx(-0.087266, abs=1e-6)  # -5 deg


def test_area_span_and_chord_that_do_not_belong_together_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sets = [w for v in (*UAV, "chord=0.27 ft") for w in ("--set", v)]
    assert station("aircraft", "new", "uav", "--folder", str(tmp_path), *sets, monkeypatch=monkeypatch) == 0
    # 2.1 m x 0.0823 m / 0.55 m2
    assert "span x chord is 0.31 times the wing area" in capsys.readouterr().err


def test_an_aircraft_is_asked_for_and_may_be_left_out_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An answer without its unit, of another kind or below zero is refused at once, and asked for again."""
    area = ("", "420", "420 ft", "-420 ft2", "420 ft2")
    answers = iter(
        (
            *area,
            "65 ft",
            "6.5 ft",
            "340 slug",
            "24640 slug ft2",
            "",
            "",
            "",
            "",
            "",
            "",
            "24.5 ft",
            "0.04",
            "high",
            "0.05",
        )
    )
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    assert station("aircraft", "new", "otter", "--folder", str(tmp_path), monkeypatch=monkeypatch) == 0
    said = capsys.readouterr().err
    assert "420: missing unit: write" in said
    assert "420 ft: unit 'ft' does not fit here" in said
    assert "-420 ft2: Input should be greater than 0" in said
    assert "high: Input should be a valid number" in said
    assert "is one of the units wrong" not in said
    found = read_profile(Aircraft, tmp_path / "aircraft" / "otter.toml")
    assert found.inertia.mass == pytest.approx(4961.9, abs=0.1)
    assert found.boom is None
    assert found.unsteady.tail_arm == pytest.approx(7.4676)
    assert not found.unsteady.memory
    assert found.drag is not None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("rig", "new", "uav"), "not a terminal"),
        (("rig", "new", "u-v", "--yes"), "letters, digits"),
        (("rig", "new", "u", "--yes", "--can", "can0", *NOWHERE), "INTERFACE:CHANNEL"),
        (("rig", "new", "u", "--yes", "--can", "virtual:x", *NOWHERE), "nothing was heard"),
        (("rig", "new", "u", "--yes", "--port", "/dev/x@fast", "--mavlink", "none"), "PATH@BAUD"),
        (("aircraft", "new", "uav"), 'needed: wing_area, span, chord, mass'),
        (("aircraft", "new", "uav", "--set", "wingarea=1 m2"), "KEY one of wing_area"),
        (("aircraft", "new", "uav", *(w for v in UAV for w in ("--set", v)), "--set", "mass=4.2 m"), "mass"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_said_and_nothing_written(
    words: tuple[str, ...],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert station(*words, "--folder", str(tmp_path), monkeypatch=monkeypatch) in (1, 2)
    assert said in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.toml"))


def test_a_map_that_fits_nothing_names_what_was_heard(
    uav: tuple[Path, str, str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, vane, _, _ = uav
    words = (
        "--port",
        vane,
        "--mavlink",
        "none",
        "--can",
        "virtual:x",
        "--seconds",
        "1",
        "--yes",
        "--map",
        "v0=q:deg/s",
    )
    assert station("rig", "new", "u", "--folder", str(folder), *words, monkeypatch=monkeypatch) == 2
    assert "no field v0 was heard" in capsys.readouterr().err
