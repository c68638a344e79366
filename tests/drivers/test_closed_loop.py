"""The loop closed through wires: another program moves a pot on a CAN bus, and vane and accelerometers answer."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

from drivers.adapter import open_devices
from drivers.emulation import serve
from drivers.loop_timing import Latency, Overruns
from drivers.surface_tap import SurfaceTap
from station.clock import SystemClock
from station.profile import Profiles, Rig, load_card, profiles_dir
from station.rows import Rows, Sample
from station.simulation.stepped_flight import SteppedFlight

DBC = profiles_dir() / "rigs" / "pots.dbc"
TRIM = math.degrees(SteppedFlight(load_card("by_hand").aircraft, load_card("by_hand").card).rest["elevator"])

QUICKEST = 60.0
"""deg/s"""


class Hand:
    """A pot box of its own: the DBC read by cantools, frames sent by python-can, nothing of the station's."""

    def __init__(self, channel: str, angle_deg: float) -> None:
        self.angle_deg = angle_deg
        self.sent: list[tuple[float, float]] = []
        """When, s, and which angle, deg."""
        self._message = cantools.database.load_file(DBC).get_message_by_name("SURFACES")
        self._bus = can.Bus(interface="udp_multicast", channel=channel, ignore_config=True)
        self._stop, self.silent = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def _send(self) -> None:
        k, begin, noise, at = 0, time.monotonic(), np.random.default_rng(1), self.angle_deg
        while not self._stop.wait(max(0.0, begin + 0.005 * k - time.monotonic())):
            k += 1
            if self.silent.is_set():
                continue
            # No hand moves it at once, and a pot is never quite still: the station believes neither.
            at += max(-QUICKEST * 0.005, min(QUICKEST * 0.005, self.wanted(time.monotonic()) - at))
            shown = at + noise.normal(scale=0.02)
            self.sent.append((time.monotonic(), shown))
            fields = {"elevator": shown, "stamp": (0.005 * k) % 6.5536, "counter": k % 256}
            data = self._message.encode(fields)
            self._bus.send(can.Message(arbitration_id=self._message.frame_id, data=data, is_extended_id=False))

    def wanted(self, now_s: float) -> float:
        """Where it goes now, deg."""
        return self.angle_deg

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.shutdown()


def calm(channel: str) -> Profiles:
    """The card by_hand without gusts, boom and imu only, its pot on a bus of its own."""
    profiles = load_card("by_hand")
    pots, boom, imu, _ = profiles.rig.devices
    rig = profiles.rig.model_copy(update={"devices": (pots.model_copy(update={"channel": channel}), boom, imu)})
    flight = profiles.card.flight.model_copy(update={"gust_sigma": 0.0})
    return profiles.model_copy(update={"rig": rig, "card": profiles.card.model_copy(update={"flight": flight})})


@contextmanager
def flying(profiles: Profiles) -> Iterator[tuple[list[dict[str, Any]], list[Sample], threading.Event]]:
    """What the emulator says, and what the emulated devices are read to send."""
    said: list[dict[str, Any]] = []
    heard: list[Sample] = []
    started, stop = threading.Event(), threading.Event()

    def announce(words: dict[str, Any]) -> None:
        said.append(words)
        if "start_ns" in words:
            started.set()

    def put(row: Rows) -> None:
        if isinstance(row, Sample):
            heard.append(row)

    serving = threading.Thread(target=serve, args=(profiles, announce, stop, SystemClock()))
    serving.start()
    adapters = []
    try:
        assert started.wait(60), said
        endpoints = {s["device"]: s["endpoint"] for s in said if "device" in s}
        emulated = tuple(d for d in profiles.rig.devices if d.name in endpoints)
        own = profiles.rig.model_copy(update={"devices": emulated, "loop": None})
        adapters = open_devices(own, endpoints, profiles.rig_dir, SystemClock(), put)
        for adapter in adapters:
            adapter.start()
        yield said, heard, stop
    finally:
        for adapter in adapters:
            adapter.stop()
        stop.set()
        serving.join()


def values(heard: list[Sample], stream: str, column: int, last: int) -> np.ndarray:
    return np.array([s.values[column] for s in list(heard) if s.stream == stream][-last:])


def events(said: list[dict[str, Any]], code: str) -> list[str]:
    return [s["detail"] for s in list(said) if s.get("event") == code and s["source"] == "loop"]


def until(done: Any, seconds: float = 20.0) -> None:
    waiting = threading.Event()
    for _ in range(round(seconds / 0.05)):
        if done():
            return
        waiting.wait(0.05)
    raise AssertionError("not within the time")


def test_a_pot_on_a_can_bus_flies_the_aircraft_and_its_silence_is_told() -> None:
    channel = "239.74.163.77"
    hand = Hand(channel, TRIM)
    try:
        with flying(calm(channel)) as (said, heard, _):
            assert {s["device"] for s in said if "device" in s} == {"boom", "can"}  # the pot is not emulated
            until(lambda: events(said, "HEARD") and len(values(heard, "boom.vanes", 0, 200)) == 200)
            level = np.mean(values(heard, "boom.vanes", 0, 100))
            hand.angle_deg = TRIM - 3.0
            until(lambda: np.mean(values(heard, "boom.vanes", 0, 10)) > level + math.radians(2.0))
            assert np.min(values(heard, "can.accel", 2, 200)) < -9.81 - 1.0  # it pulls up
            hand.angle_deg = 60.0  # no position of an elevator
            until(lambda: events(said, "RANGE"))
            hand.angle_deg = TRIM
            until(lambda: np.mean(values(heard, "boom.vanes", 0, 10)) < level + math.radians(1.0))
            hand.silent.set()
            until(lambda: events(said, "STALE"))
            assert "fading to trim" in events(said, "STALE")[-1]
            hand.silent.clear()
            until(lambda: events(said, "FRESH"))
    finally:
        hand.close()


def test_a_rig_whose_loop_nobody_is_in_is_refused() -> None:
    rig = load_card("bench").rig
    with pytest.raises(ValueError, match="nothing moves them"):
        Rig.model_validate(rig.model_dump() | {"loop": {"kind": "measured"}}, context="si")


def test_what_is_flown_late_is_in_the_surface_s_latency() -> None:
    late = {s.name: s.latency_s for s in load_card("by_hand").rig.streams()}
    assert late["pots.surfaces"] == pytest.approx(-(0.5 / 200 + 0.5 / 400))
    assert all(v == 0.0 for n, v in late.items() if n != "pots.surfaces")


def test_readings_of_surfaces_alone_go_into_the_loop() -> None:
    tap, passed = SurfaceTap(load_card("by_hand").rig), list[Rows]()
    put = tap.putting(passed.append)
    rows = [Sample(7, "pots.surfaces", None, None, (0.25,)), Sample(8, "boom.vanes", None, None, (0.1, 0.2))]
    for row in rows:
        put(row)
    assert passed == rows
    assert list(tap.take()) == [(7, "elevator", 0.25)]
    for _ in range(100_000):  # nobody takes them: nobody is held up
        put(rows[0])
    assert 0 < len(list(tap.take())) < 100_000
    tap.close()


def test_late_steps_are_counted_and_told() -> None:
    overruns = Overruns(2_500_000)
    for k, late_ns in enumerate([0, 1_000_000, 2_400_000, 4_000_000, 0, 9_000_000]):
        overruns.began(k * 2_500_000, k * 2_500_000 + late_ns)
    assert overruns.report() == {"steps": 6, "late": 2, "worst_late_ms": 9.0}
    assert overruns.said() == "2 steps late, by 9.0 ms at most"
    assert overruns.said() == ""


def test_latency_is_from_a_value_s_arrival_to_the_first_bytes_made_with_it() -> None:
    latency = Latency()
    assert latency.report() == {}
    latency.flown([math.nan, 1.000, 1.000])
    latency.sent(1.004)
    latency.flown([1.000, 1.010, 1.012])
    latency.sent(1.018)
    latency.sent(1.030)
    assert latency.report() == {"p50": 6.0, "p99": 7.96, "jitter": 1.63, "worst": 8.0, "values": 3}


FLYING = """
import sys
from tests.drivers.test_closed_loop import Hand, TRIM
import time
hand = Hand(sys.argv[1], TRIM)
begin = time.monotonic()
moves = [(0, 3.0, 0.6), (7, 3.0, 1.2), (14, -3.0, 0.6), (21, 3.0, 0.9)]
while (t := (time.monotonic() - begin) % 28) >= 0:
    hand.angle_deg = TRIM + sum(a * ((s <= t < s + w) - (s + w <= t < s + 2 * w)) for s, a, w in moves)
    time.sleep(0.002)
"""


def one_link_and_a_pot(channel: str) -> str:
    """A rig: loop and pot of by_hand, everything else from an emulated autopilot."""
    rigs = profiles_dir() / "rigs"
    loop, pots, *_ = re.split(r"(?m)^(?=\[\[devices\]\])", (rigs / "by_hand.toml").read_text())
    head, *streams = re.split(r"(?m)^(?=\[\[devices.streams\]\])", (rigs / "mavlink_only.toml").read_text())
    autopilot = head[head.index("[[devices]]") :] + "".join(s for s in streams if 'name = "elevator"' not in s)
    return (loop + pots).replace("239.74.163.2", channel) + autopilot


@pytest.mark.slow
def test_doublets_by_hand_give_derivatives_within_their_intervals(tmp_path: Path, station: Any) -> None:
    """Two processes: one moves the pot, the other is the station with everything else emulated."""
    here = Path(__file__).parents[2]
    channel = "239.74.163.78"
    (tmp_path / "rig.toml").write_text(one_link_and_a_pot(channel))
    (tmp_path / "pots.dbc").write_text(DBC.read_text())
    card = (profiles_dir() / "cards" / "by_hand.toml").read_text()
    (tmp_path / "card.toml").write_text(card.replace('rig = "by_hand"', 'rig = "rig.toml"'))
    environment = {**os.environ, "PYTHONPATH": f"{here}:{here / 'tests'}"}
    hand = subprocess.Popen([sys.executable, "-c", FLYING, channel], cwd=here, env=environment)
    words = ["run", str(tmp_path / "card.toml"), "--duration", "56", "--view", "none"]
    told = subprocess.run(
        [sys.executable, "-m", "station", *words, "--log", str(tmp_path)],
        cwd=here,
        env=environment,
        capture_output=True,
    )
    hand.kill()
    hand.wait()
    match = re.search(rb"surface in to vane out: .* ([\d.]+) ms \(p99\)", told.stderr)
    assert match, told.stderr
    (log,) = tmp_path.glob("*.mcap")
    code, out, err = station("identify", log, "--method", "physical", "--json", "-")
    assert code in (0, 3), err
    found = json.loads(out)
    best = found["methods"][found["recommended"]]["parameters"]
    truth = load_card("by_hand").aircraft
    estimated = {n: p for n, p in best.items() if p["status"] == "estimated"}
    assert len(estimated) >= 4
    for name, p in estimated.items():
        assert p["ci95"][0] <= truth.value(name) <= p["ci95"][1], (name, p, told.stderr[-600:])
