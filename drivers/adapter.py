"""The thread that owns a device's port: reads, stamps, decodes, converts, counts, reconnects.

One class serves every link; what differs is a codec and a way to open the port. Whatever happens on the link, the
thread says so with an event and tries again: nothing raises into the station.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drivers.codec import Codec, Port, TimeReply
from drivers.gathering import Gathering
from drivers.protocols import protocol_named
from drivers.sampling import Sampler
from drivers.shedding import Shedding
from drivers.signatures import unread
from station.clock import Clock, SystemClock, utc_now_ns
from station.profile import (
    EMULATED,
    CanBus,
    CanDevice,
    Device,
    DronecanDevice,
    MavlinkDevice,
    Rig,
    SerialDevice,
    nearest,
    nearest_or_all,
)
from station.rows import Code, DeviceError, Event, ProfileError, RawBlock, Rows, TimeSync

READ_TIMEOUT_S: Final = 0.04
REPORT_EVERY_NS: Final = 250_000_000
"""Bad messages are reported at once, then at most so often; with the read's timeout, never later than 0.3 s."""
FOREIGN_EVERY_NS: Final = 60_000_000_000
"""Who else speaks on a link is told at once, then how much once a minute: a gimbal or a ground station may well."""
PAUSE_S: Final = 0.005
"""What comes too fast to be read is passed over in larger pieces: each call of the system costs some 10 us."""
GATHERED_FROM_HZ: Final = 800.0
"""A serial link that brings more messages than this, stamped by the device, is read together with others."""
SILENT_READS: Final = 8
"""One that then brings nothing so often is waited for by its own thread again."""
FIRST_BACKOFF_S: Final = 0.1
LAST_BACKOFF_S: Final = 2.0

Opener = Callable[[], Port]
"""Opens the link or raises OSError or DeviceError saying why not."""


@dataclass(slots=True)
class _Reported:
    """How many of a link's faults have been reported, and when last."""

    count: int = 0
    t_ns: int | None = None


class Adapter:
    """Serves one device. `start` returns at once; `stop` joins the thread and closes the port.

    Puts RawBlock, Sample, TimeSync and Event rows (CONNECT, DISCONNECT, RECONNECT, CRC, GAP, their source the device's
    name). `put` is called from the adapter's thread and must not block.
    """

    def __init__(
        self,
        device: Device,
        codec: Codec,
        opener: Opener,
        clock: Clock,
        put: Callable[[Rows], None],
        address: str = "",
        gathering: Gathering | None = None,
    ) -> None:
        """`gathering`: who reads the fast links of a station."""
        self.device = device
        self.address = address
        self.codec = codec
        self._opener = opener
        self._clock = clock
        self._put = put
        self._sampler = Sampler(device, lambda why: self._say(Code.RANGE, detail=why))
        rate = sum(stream.rate for stream in device.streams)
        self._shedding = Shedding(rate)
        self._is_fast = rate > GATHERED_FROM_HZ and isinstance(device, SerialDevice)
        self._gathering = gathering or Gathering(clock)
        self._silent = 0
        self._reported = {code: _Reported() for code in (Code.CRC, Code.GAP, Code.NOISE, Code.DROPPED)}
        self._unread = unread(device)
        self._doubted = False
        self._speaker = ""
        self._foreign: dict[str, _Reported] = {}
        self._may_excuse = False
        self._ever_connected = False
        self._lost = False
        self._heard = False
        self._stopping = threading.Event()
        self._connected = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"adapter-{device.name}", daemon=True)

    @property
    def connected(self) -> bool:
        """Whether the port is open. A silent device on an open port is connected; its streams go stale."""
        return self._connected.is_set()

    @property
    def blocks_lost(self) -> int:
        """Pieces of what came that were neither read nor recorded, as there was too much of it."""
        return self._shedding.blocks

    def start(self) -> None:
        """Begin; a device that cannot be opened is an event, and is tried again."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the port. May be called twice, or without `start`."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        backoff_s = FIRST_BACKOFF_S
        while not self._stopping.is_set():
            self._heard = False
            try:
                port = self._opener()
                try:
                    self._begin()
                    self._serve(port)
                finally:
                    self._connected.clear()
                    port.close()
            except (OSError, DeviceError) as error:
                self._lose(str(error))
            except Exception as error:  # a driver's own fault must not take the station down either
                self._lose(f"driver fault: {type(error).__name__}: {error}")
            if self._heard:
                backoff_s = FIRST_BACKOFF_S
            self._stopping.wait(backoff_s)
            backoff_s = min(2 * backoff_s, LAST_BACKOFF_S)

    def _begin(self) -> None:
        self.codec.reset()
        self._unread = unread(self.device)
        # A link is nearly always joined in the middle of a message: the first unreadable one is no fault.
        self._may_excuse = True
        self._say(Code.RECONNECT if self._ever_connected else Code.CONNECT, detail=self.address)
        self._ever_connected, self._lost = True, False
        self._connected.set()

    def _lose(self, why: str) -> None:
        if not self._lost and not self._stopping.is_set():
            self._say(Code.DISCONNECT, detail=why)
        self._lost = True

    def _say(self, code: Code, count: int = 1, detail: str = "") -> None:
        self._put(Event(self._clock.now_ns(), self.device.name, code, count, detail))

    def _serve(self, port: Port) -> None:
        while not self._stopping.is_set():
            if self._is_fast and self._sampler.is_stamped:
                self._silent = 0
                self._gathering.serve(lambda: self._gather(port))
            if not self.take(port.read(READ_TIMEOUT_S)):
                self._stopping.wait(PAUSE_S)
            request = self.codec.outgoing(self._clock.now_ns())
            if request:
                port.write(request)

    def _gather(self, port: Port) -> bool:
        """What is there; whether more is to be expected."""
        block = port.read(0.0)
        self.take(block)
        self._silent = 0 if block else self._silent + 1
        return self._silent < SILENT_READS and self._sampler.is_stamped and not self._stopping.is_set()

    def take(self, block: bytes) -> bool:
        """What has come in now, and what is in it; whether it was not too much."""
        t_ns = self._clock.now_ns()
        is_taken = not block or self._shedding.takes(len(block), t_ns)
        if block and is_taken:
            self._put(RawBlock(t_ns, self.device.name, block))
            before, readings = self.codec.noise, self.codec.feed(block)
            self._shedding.heard_noise(self.codec.noise - before)
            for reading in readings:
                self._heard = True
                if isinstance(reading, TimeReply):
                    self._sync(t_ns, reading)
            for sample in self._sampler.samples(t_ns, readings):
                self._put(sample)
            self._doubt(block)
        self._report(t_ns)
        return is_taken

    def _doubt(self, block: bytes) -> None:
        """Say what the bytes look like where none of them could be read."""
        if self._heard:
            if self._doubted:
                self._say(Code.FRESH, detail=f"{Code.PROTOCOL} over: messages are read")
            self._doubted, self._unread = False, None
        elif self._unread is not None and (words := self._unread.take(block)):
            self._doubted = True
            self._say(Code.PROTOCOL, detail=words)

    def _sync(self, t_ns: int, reply: TimeReply) -> None:
        offset_ns = (reply.sent_ns + t_ns) // 2 - reply.device_ns
        self._put(TimeSync(t_ns, self.device.name, offset_ns, t_ns - reply.sent_ns))

    def _report(self, t_ns: int) -> None:
        bad = self.codec.bad + self.codec.resyncs
        if self._may_excuse and bad > self._reported[Code.CRC].count:
            self._may_excuse = False
            self._reported[Code.CRC].count += 1
        if self._heard:
            self._may_excuse = False
        signed = f", {self.codec.refused} so far for their signature" if self.codec.refused else ""
        self._report_one(t_ns, Code.CRC, bad, f"unreadable messages{signed}")
        self._report_one(t_ns, Code.GAP, self.codec.lost, "messages lost by the link's count")
        shed = self._shedding
        self._report_one(t_ns, Code.NOISE, shed.noise_bytes, shed.noise_words)
        self._report_one(t_ns, Code.DROPPED, shed.blocks, shed.words)
        if self.codec.speaker != self._speaker:
            self._speaker = self.codec.speaker
            self._say(Code.HEARD, detail=f"taking the messages of {self._speaker}")
        for code, words in self.codec.news():
            self._say(code, detail=words)
        for who, count in self.codec.foreign.items():
            last = self._foreign.setdefault(who, _Reported())
            self._report_one(t_ns, Code.FOREIGN, count, f"passed over: {who}", last, FOREIGN_EVERY_NS)

    def _report_one(
        self,
        t_ns: int,
        code: Code,
        count: int,
        detail: str,
        last: _Reported | None = None,
        every_ns: int = REPORT_EVERY_NS,
    ) -> None:
        """At once, then at most one event in `every_ns`."""
        last = last or self._reported[code]
        if count > last.count and (last.t_ns is None or t_ns - last.t_ns >= every_ns):
            self._put(Event(t_ns, self.device.name, code, count - last.count, detail))
            last.count, last.t_ns = count, t_ns


def open_devices(
    rig: Rig, endpoints: Mapping[str, str], rig_dir: Path, clock: Clock, put: Callable[[Rows], None]
) -> list[Adapter]:
    """An adapter for each device of the rig, not started yet.

    `endpoints[device.name]` stands in for the rig's port, channel or url. Raises ProfileError for a rig its codecs
    cannot serve (an unknown protocol, a message that is not in the DBC, a field that no message has) and DeviceError
    for a device that is to be emulated and has no endpoint.
    """
    adapters, gathering = [], Gathering(clock)
    for device in rig.devices:
        codec = _codec(device, rig_dir, f"rig {rig.name}", clock)
        address = _address(device, endpoints)
        opener = _opener(device, address, codec, clock, is_emulated=device.name in endpoints)
        adapters.append(Adapter(device, codec, opener, clock, put, address, gathering))
    return adapters


def what_is_sent(device: Device) -> str:
    """What the station sends to a device, in words."""
    match device:
        case SerialDevice():
            return "nothing"
        case CanBus():
            from drivers.can_port import part_in_bus

            return part_in_bus(device)
        case MavlinkDevice():
            from drivers.mavlink import belief, requests

            return "; ".join(words for words in (requests(device), belief(device)) if words)


def check_devices(rig: Rig, rig_file: Path) -> None:
    """Whether there are codecs for what the rig names: protocols, messages and fields. Raises ProfileError with file,
    device and key."""
    for device in rig.devices:
        _codec(device, rig_file.parent, str(rig_file), SystemClock())


def _codec(device: Device, rig_dir: Path, rig: str, clock: Clock) -> Codec:
    """Raises ProfileError that says in which `rig`, device and key."""
    try:
        return _codec_of(device.on_the_wire(), rig_dir, clock)
    except ProfileError as error:
        raise ProfileError(f"{rig}: device {device.name}, {error}") from error


def _codec_of(device: Device, rig_dir: Path, clock: Clock) -> Codec:
    # Each link's library is loaded only where the rig has such a link: some take seconds.
    match device:
        case SerialDevice():
            protocol = protocol_named(device.protocol)
            _check_streams(device, protocol.fields, protocol.named_messages())
            return protocol.codec()
        case CanDevice():
            from drivers.can_dbc import CanCodec

            return CanCodec(device, rig_dir)
        case DronecanDevice():
            from drivers.can_dronecan import USUAL, DronecanCodec, fields_of

            wanted = (*USUAL, *(str(stream.message) for stream in device.streams))
            found: dict[str | int, Sequence[str]] = {n: known for n in wanted if (known := fields_of(n))}
            _check_streams(device, found, f"one of {', '.join(USUAL)}, or another of DroneCAN's messages")
            return DronecanCodec(device)
        case MavlinkDevice():
            from drivers.mavlink import MavlinkCodec, read_signing_key
            from drivers.mavlink_messages import TABLE, fields_known

            names = (*TABLE, *(str(stream.message) for stream in device.streams))
            fields: dict[str | int, Sequence[str]] = {n: known for n in names if (known := fields_known(n))}
            _check_streams(device, fields, f"one of {', '.join(TABLE)}")
            return MavlinkCodec(device, read_signing_key(device, rig_dir), utc_now_ns(), clock.now_ns())


def _check_streams(device: Device, fields: Mapping[str | int, Sequence[str]], messages: str) -> None:
    """Whether each stream's message has the fields that it maps; `messages` says what there is."""
    for stream in device.streams:
        known = tuple(fields.get(stream.message, ()))
        if not known:
            near = nearest(str(stream.message), [m for m in fields if isinstance(m, str)]) or f"; use {messages}"
            raise ProfileError(f"stream {stream.name}, message: no message {stream.message!r} on this link{near}")
        for signal, channel in stream.signals.items():
            if channel.field not in known:
                near = nearest_or_all(channel.field, known)
                raise ProfileError(
                    f"stream {stream.name}, {signal}: {stream.message} has no field {channel.field}{near}"
                )


def _address(device: Device, endpoints: Mapping[str, str]) -> str:
    address = endpoints.get(device.name, device.address)
    if address == EMULATED:
        raise DeviceError(
            f"device {device.name} is emulated and its emulator is not running\n"
            "use a card with emulate = true, or write the real port into the rig"
        )
    return address


def _opener(device: Device, address: str, codec: Codec, clock: Clock, is_emulated: bool) -> Opener:
    # Imported here, before flight, and not by the thread in flight: python-can takes seconds.
    match device:
        case SerialDevice():
            from drivers import serial_port

            baud = device.baud or protocol_named(device.protocol).baud
            return lambda: serial_port.open_port(address, baud)
        case CanBus():
            from drivers import can_port

            return lambda: can_port.open_port(device, address, is_emulated)
        case MavlinkDevice():
            from drivers import mavlink_port
            from drivers.mavlink import MavlinkCodec

            assert isinstance(codec, MavlinkCodec)
            return lambda: mavlink_port.open_port(device, address, codec, clock)
