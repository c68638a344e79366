"""The adapter over scripted ports with a hand-moved clock."""

from __future__ import annotations

import functools
import itertools
import math
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers import serial_port
from drivers.adapter import Adapter
from drivers.codec import Codec, Reading, TimeReply
from drivers.emulated_ports import PtyPort
from drivers.gathering import Gathering
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.protocols import protocol_named
from drivers.serial_boombox import BoomboxCodec, encode_packet
from station.clock import ManualClock, SystemClock
from station.profile import MavlinkDevice, SerialDevice
from station.rows import Code, Event, RawBlock, Sample, TimeSync
from tests.drivers.adapter_script import PATIENCE_S, Rowsink, Script, boom, play

pytestmark = pytest.mark.usefixtures("nothing_left_behind")


def test_a_packet_becomes_its_bytes_and_a_sample_in_si_at_the_time_of_the_read() -> None:
    packet = encode_packet(1, 7, 5_000, [300])
    sink, _ = play([(0.0, encode_packet(1, 6, 0, [0])), (0.005, packet[:4]), (0.001, packet[4:])])
    t_ns = 10**12 + 6_000_000
    block, sample = sink.take_all()[-2:]
    assert block == RawBlock(t_ns, "boom", packet[4:])
    assert isinstance(sample, Sample)
    assert (sample.t_ns, sample.stream, sample.t_device_ns, sample.seq) == (t_ns, "boom.vanes", 5_000_000, 7)
    assert sample.values == pytest.approx((math.radians(1.0),))


def test_messages_that_the_rig_does_not_name_are_kept_as_bytes_only() -> None:
    sink, _ = play([(0.0, encode_packet(9, 0, 0, [1]))])
    assert sink.samples() == []
    assert [type(row) for row in sink.rows] == [Event, RawBlock]


def test_device_time_and_sequence_are_continuous_through_their_wraps() -> None:
    start_us, step_us = 2**32 - 10_000, 5_000
    steps = [(0.005, encode_packet(1, 254 + k, start_us + k * step_us, [0])) for k in range(600)]
    samples = play(steps)[0].samples()
    assert [s.seq for s in samples] == list(range(254, 854))
    assert [s.t_device_ns for s in samples] == [1000 * (start_us + k * step_us) for k in range(600)]


def test_a_silence_longer_than_the_wrap_is_counted_in_full() -> None:
    silence_s = 3 * 2**32 * 1e-6 + 100.0
    steps = [(0.0, encode_packet(1, 0, 77, [0])), (silence_s, encode_packet(1, 1, 77 + round(silence_s * 1e6), [0]))]
    first, second = (s.t_device_ns for s in play(steps)[0].samples())
    assert first is not None
    assert second is not None
    assert second - first == pytest.approx(silence_s * 1e9, abs=2_000)


@pytest.mark.parametrize(
    ("protocol", "rate_hz", "apart_ns"),
    [("boombox", 1000, 5_000_000), ("boombox", 200, 1_000_000), ("lines", 1000, 1_000_000)],
)
def test_a_fast_link_that_stamps_its_messages_is_read_every_5_ms(protocol: str, rate_hz: int, apart_ns: int) -> None:
    """One read a message would take the interpreter from the loop; without stamps its time is the message's."""
    message, field = (1, "v0") if protocol == "boombox" else ("line", "c0")
    data = encode_packet(1, 0, 5_000, [300]) if protocol == "boombox" else b"300\n"
    stream = {"name": "vanes", "message": message, "rate": f"{rate_hz} Hz"}
    stream["signals"] = {"alpha_vane": {"field": field, "unit": "deg", "slope": 0.005}}
    device = boom().model_dump() | {"protocol": protocol, "streams": [stream]}
    sink, _ = play([(0.001, data)] * 20, protocol_named(protocol).codec(), SerialDevice.model_validate(device))
    times = [s.t_ns for s in sink.samples()]
    # The first line of a stream may lack its beginning and is passed over.
    assert len(times) == (19 if protocol == "lines" else 20)
    # The first message tells whether it is stamped; it and the second come as they come.
    assert {b - a for a, b in itertools.pairwise(times[1:])} == {apart_ns}


def test_fast_links_are_read_by_one_thread_and_lose_nothing_when_one_is_unplugged(tmp_path: Path) -> None:
    clock, sink, pause = SystemClock(), Rowsink(), threading.Event()
    gathering = Gathering(clock)
    ports = [PtyPort(tmp_path / f"box{i}") for i in range(3)]
    stream = {"name": "vanes", "message": 1, "rate": "1000 Hz"}
    stream["signals"] = {"alpha_vane": {"field": "v0", "unit": "deg", "slope": 0.005}}
    adapters = []

    def until(done: Callable[[], bool]) -> None:
        for _ in range(round(PATIENCE_S / 0.01)):
            if done():
                return
            pause.wait(0.01)
        raise AssertionError("not within the time")

    def send(numbers: range) -> None:
        for n in numbers:
            for port in ports:
                port.send([encode_packet(1, n, 1000 * n, [n % 100])])
            if n % 20 == 0:
                pause.wait(0.01)

    def newest(box: int) -> int:
        return max((s.seq or 0 for s in sink.samples() if s.stream == f"box{box}.vanes"), default=-1)

    for i, port in enumerate(ports):
        port.plug()
        device = SerialDevice.model_validate(boom().model_dump() | {"name": f"box{i}", "streams": [stream]})
        opener = functools.partial(serial_port.open_port, port.endpoint, 115_200)
        adapters.append(Adapter(device, BoomboxCodec(), opener, clock, sink.put, "", gathering))
        adapters[-1].start()
    try:
        until(lambda: len(sink.events(Code.CONNECT)) == 3)
        send(range(400))
        until(lambda: all(newest(box) == 399 for box in range(3)))
        assert sum(t.name == "gathering" for t in threading.enumerate()) == 1
        ports[1].unplug()
        until(lambda: bool(sink.events(Code.DISCONNECT)))
        ports[1].plug()
        until(lambda: bool(sink.events(Code.RECONNECT)))
        send(range(400, 800))
        until(lambda: all(newest(box) == 799 for box in range(3)))
    finally:
        for adapter in adapters:
            adapter.stop()
        for port in ports:
            port.close()
    for box in range(3):
        assert [s.seq for s in sink.samples() if s.stream == f"box{box}.vanes"] == list(range(800))


@pytest.mark.parametrize("step_s", [-2.0, 2.0])
def test_a_step_of_the_device_clock_is_left_to_see(step_s: float) -> None:
    t0 = 10_000_000
    steps = [(0.0, encode_packet(1, 0, t0, [0])), (0.005, encode_packet(1, 1, t0 + 5_000 + round(step_s * 1e6), [0]))]
    first, second = (s.t_device_ns for s in play(steps)[0].samples())
    assert first is not None
    assert second is not None
    assert second - first == 5_000_000 + round(step_s * 1e9)


def test_bad_messages_are_reported_at_once_then_gathered() -> None:
    good, bad = encode_packet(1, 0, 0, [0]), b"\x05nonsense\x00"
    steps = [(0.01, good)] + [(0.01, bad)] * 100 + [(0.04, b"")] * 10
    sink, _ = play(steps)
    events = sink.events(Code.CRC)
    first_bad_ns = 10**12 + 20_000_000
    assert events[0].t_ns == first_bad_ns
    assert sum(e.count for e in events) == 100
    gaps = [b.t_ns - a.t_ns for a, b in itertools.pairwise(events)]
    assert all(250_000_000 <= gap <= 300_000_000 for gap in gaps)
    assert {e.source for e in events} == {"boom"}


def test_packets_missing_from_a_link_that_numbers_them_are_a_gap() -> None:
    device = MavlinkDevice.model_validate(
        {
            "name": "autopilot",
            "link": "mavlink",
            "url": "udpin:127.0.0.1:0",
            "streams": [
                {
                    "name": "attitude",
                    "message": "ATTITUDE",
                    "rate": "50 Hz",
                    "signals": {"theta": {"field": "pitch", "unit": "rad"}},
                }
            ],
        }
    )
    sender = MavlinkEncoder()
    packets = [sender.encode("ATTITUDE", {"pitch": 0.1}, 20_000_000 * k) for k in range(100)]
    missing = {10, 11, 60}
    sink, _ = play([(0.02, p) for k, p in enumerate(packets) if k not in missing], MavlinkCodec(device))
    gaps = sink.events(Code.GAP)
    assert [(e.source, e.count) for e in gaps] == [("boom", 2), ("boom", 1)]
    assert gaps[0].t_ns == 10**12 + 11 * 20_000_000, "with the first packet after those missing"
    assert sink.events(Code.CRC) == []


def test_joining_in_the_middle_of_a_message_is_no_error_but_noise_alone_is() -> None:
    packet = encode_packet(1, 0, 0, [0])
    assert play([(0.0, packet[5:]), (0.005, packet), (0.005, packet)])[0].events(Code.CRC) == []
    assert play([(0.0, packet[5:] + packet)])[0].events(Code.CRC) == []
    assert sum(e.count for e in play([(0.005, packet[5:])] * 8)[0].events(Code.CRC)) >= 1


def test_values_that_are_no_numbers_are_missing_and_none_at_all_is_no_sample() -> None:
    sink, _ = play([(0.0, encode_packet(1, 0, 0, [math.nan])), (0.0, encode_packet(1, 1, 0, []))])
    assert sink.samples() == []
    clock, two = ManualClock(), Rowsink()
    port = Script(clock, [(0.0, encode_packet(1, 0, 0, [100, math.nan]))])
    device = boom(beta_vane={"field": "v1", "unit": "deg"})
    adapter = Adapter(device, BoomboxCodec(), lambda: port, clock, two.put)
    adapter.start()
    assert port.played.wait(PATIENCE_S)
    adapter.stop()
    (sample,) = two.samples()
    assert sample.values[0] == 0.0
    assert math.isnan(sample.values[1])


class Asking(Codec):
    """Asks the time once; every byte is an answer that the device gave at 5 s on its clock."""

    def __init__(self) -> None:
        self.bad = self.resyncs = 0
        self.asked = False

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        return [TimeReply(sent_ns=10**12, device_ns=5 * 10**9) for _ in data]

    def reset(self) -> None:
        self.asked = False

    def outgoing(self, now_ns: int) -> bytes:
        request, self.asked = (b"" if self.asked else b"time?"), True
        return request


def test_time_requests_are_sent_and_answers_become_time_syncs() -> None:
    sink, port = play([(0.0, b""), (0.004, b"!")], Asking())
    assert port.written == [b"time?"]
    (sync,) = [row for row in sink.take_all() if isinstance(row, TimeSync)]
    assert sync == TimeSync(10**12 + 4_000_000, "boom", 10**12 + 2_000_000 - 5 * 10**9, 4_000_000)


class Faulty(Asking):
    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        raise ZeroDivisionError("a mistake of ours")


def test_a_drivers_own_fault_is_an_event_and_the_link_is_tried_again() -> None:
    clock, sink = ManualClock(), Rowsink()
    ports = [Script(clock, [(0.0, b"x")]), Script(clock, [])]
    left = iter(ports)
    adapter = Adapter(boom(), Faulty(), lambda: next(left), clock, sink.put)
    adapter.start()
    assert "driver fault: ZeroDivisionError" in sink.wait_for_event(Code.DISCONNECT).detail
    sink.wait_for_event(Code.RECONNECT)
    adapter.stop()
    assert all(port.closed for port in ports)


def test_a_link_that_stays_away_is_reported_once_however_often_it_is_tried() -> None:
    tries, sink = threading.Semaphore(0), Rowsink()

    def never() -> Script:
        tries.release()
        raise OSError("nobody there")

    adapter = Adapter(boom(), BoomboxCodec(), never, ManualClock(), sink.put)
    adapter.start()
    for _ in range(3):
        assert tries.acquire(timeout=PATIENCE_S)
    assert not adapter.connected
    adapter.stop()
    adapter.stop()
    assert [e.detail for e in sink.events(Code.DISCONNECT)] == ["nobody there"]


def test_an_adapter_that_was_never_started_can_be_stopped() -> None:
    Adapter(boom(), BoomboxCodec(), lambda: Script(ManualClock(), []), ManualClock(), Rowsink().put).stop()
