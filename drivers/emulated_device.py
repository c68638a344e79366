"""The process of one emulated device: its port, its encoder, its pace."""

from __future__ import annotations

import heapq
import select
import signal
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

import numpy as np

from drivers.codec import Reading
from drivers.emulated_messages import DeviceScript, Encode, Floats, Outgoing
from drivers.emulated_ports import DevicePort, PtyPort, TcpPort, UdpPort
from drivers.loop_timing import REPORT_EVERY_NS, Latency, claim_real_time
from drivers.protocols import protocol_named
from station.clock import SystemClock, utc_now_ns
from station.profile import CanBus, CanDevice, Device, DronecanDevice, MavlinkDevice, Profiles, SerialDevice
from station.rows import DeviceError, StationError

MULTICAST: Final = "udp_multicast"
"""python-can's CAN bus between the programs of a machine, or of a network."""

Answer = Callable[[bytes, int], bytes]
"""Bytes from the station and the device's time, ns, to what the device replies."""


@dataclass(frozen=True, slots=True)
class Wire:
    """How a device speaks."""

    port: DevicePort
    encode: Encode
    also: Mapping[str, float] = field(default_factory=dict)
    """Messages without signals, and their rates."""
    answer: Answer | None = None


def heed_signals() -> None:
    """In a process of the emulator: leave Ctrl-C to the serving process; clean up when asked to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: sys.exit())


def flown_signals(device: Device, absent: tuple[str, ...]) -> tuple[str, ...]:
    """The signals a device reports of a flight that lacks some, in the order it is handed them."""
    streams = (s for s in device.streams if not set(s.signals) <= set(absent))
    return tuple(dict.fromkeys(name for stream in streams for name in stream.signals))


def wire_of(device: Device, rig_dir: Path, folder: Path) -> Wire:
    """The port and encoder a device of this kind has; its links lie in `folder`. Raises DeviceError or ProfileError."""
    match device:
        case SerialDevice():
            return Wire(PtyPort(folder / device.name), protocol_named(device.protocol).encode)
        case CanDevice():
            return _can_wire(device, rig_dir, folder)
        case DronecanDevice():
            return _dronecan_wire(device, folder)
        case MavlinkDevice():
            return _mavlink_wire(device, rig_dir, folder)


def _can_wire(device: CanDevice, rig_dir: Path, folder: Path) -> Wire:
    # Each process loads only the libraries of its own link.
    from drivers.can_dbc import encode_frame, load_dbc
    from drivers.can_frames import encode_slcan

    port = _can_port(device, folder)
    messages = load_dbc(rig_dir / device.dbc)

    def line(m: Reading) -> bytes:
        return encode_slcan(*encode_frame(messages[str(m.message)], m.fields, m.t_device_ns or 0, m.seq or 0))

    return Wire(port, line)


def _dronecan_wire(device: DronecanDevice, folder: Path) -> Wire:
    from drivers.can_dronecan import NODE_STATUS, DronecanEncoder

    return Wire(_can_port(device, folder), DronecanEncoder(device.node_id or 42).encode, {NODE_STATUS: 1.0})


def _can_port(device: CanBus, folder: Path) -> DevicePort:
    from drivers.slcan_adapter import SlcanAdapter

    if device.interface not in ("slcan", MULTICAST):
        raise DeviceError(
            f"{device.name}: CAN interface {device.interface} is not emulated: only slcan and {MULTICAST} are"
        )
    if device.interface == MULTICAST:
        from drivers.can_port import MulticastPort

        return MulticastPort(device.channel)
    return SlcanAdapter(folder / device.name)


def _mavlink_wire(device: MavlinkDevice, rig_dir: Path, folder: Path) -> Wire:
    from drivers.mavlink import MavlinkEncoder, read_signing_key

    port: DevicePort
    if device.url.startswith("tcp"):
        port = TcpPort()
    elif device.url.startswith("/"):
        port = PtyPort(folder / device.name)
    else:
        port = UdpPort()
    encoder = MavlinkEncoder(device.system_id or 1, key=read_signing_key(device, rig_dir), utc_ns=utc_now_ns())

    def packet(m: Reading) -> bytes:
        return encoder.encode(str(m.message), m.fields, m.t_device_ns or 0)

    return Wire(port, packet, {"HEARTBEAT": 1.0}, encoder.answer)


def serve_device(
    index: int, profiles: Profiles, folder: str, absent: tuple[str, ...], control: Connection, truth: Connection
) -> None:
    """Emulate device number `index` of the rig: say where it is on `control`, wait there for the start, then send what
    the rows from `truth` become until `control` closes."""
    heed_signals()
    device = profiles.rig.devices[index]
    try:
        wire = wire_of(device, profiles.rig_dir, Path(folder))
    except StationError as error:
        control.send(("error", error))
        return
    try:
        wire.port.plug()
        control.send(("ready", {"device": device.name, "link": device.link, "endpoint": wire.port.endpoint}))
        start_ns = control.recv()
        script = DeviceScript(index, device, profiles.card, start_ns, wire.encode, wire.also, absent)
        shows = "alpha_vane" in script.signals
        latency = None
        if profiles.rig.loop is not None:
            latency = Latency()
            claim_real_time()
        _pace(script, wire, start_ns, control, truth, _Timing(latency, control, start_ns, shows))
    except (EOFError, OSError):
        return  # whoever served us is gone
    except Exception as error:  # in flight nothing raises: the other devices speak on, and this one's end is told
        with suppress(OSError):
            control.send(("error", DeviceError(f"the device has ended: {type(error).__name__}: {error}")))
    finally:
        wire.port.close()
        # The last device out removes the folder, should the serving process have been killed.
        with suppress(OSError):
            Path(folder).rmdir()


class _Timing:
    """Of a device in a loop: how late what it sends is; of one that is in none, nothing."""

    def __init__(self, latency: Latency | None, control: Connection, start_ns: int, tells: bool) -> None:
        self._latency, self._control, self._start_ns = latency, control, start_ns
        self._tells = tells
        self.extra = 0 if latency is None else 1
        """Columns of a row beside the device's signals."""
        self._report_ns = start_ns + REPORT_EVERY_NS

    def taken_off(self, rows: Floats) -> Floats:
        """The rows without the times that a loop's have at their end."""
        if self._latency is None:
            return rows
        self._latency.flown(rows[:, -1].tolist())
        return rows[:, :-1]

    def sent(self, now_ns: int) -> None:
        """All that the rows made is on the wire."""
        if self._latency is None or not self._tells:
            return
        self._latency.sent((now_ns - self._start_ns) * 1e-9)
        if now_ns >= self._report_ns:
            self._report_ns += REPORT_EVERY_NS
            self._control.send(("told", {"loop": {"surface_to_vane_ms": self._latency.report()}}))


def _pace(
    script: DeviceScript, wire: Wire, start_ns: int, control: Connection, truth: Connection, timing: _Timing
) -> None:
    clock = SystemClock()
    port = wire.port
    waiting: list[tuple[int, int, Outgoing]] = []
    changes = sorted({round(t * 1e9) + start_ns for span in script.unplugged for t in span})
    made = 0
    flying = True
    while True:
        now_ns = clock.now_ns()
        while changes and changes[0] <= now_ns:
            flight_s = (changes.pop(0) - start_ns) * 1e-9 + 1e-6
            if any(a <= flight_s < b for a, b in script.unplugged):
                port.unplug()
            else:
                port.plug()
        due = []
        while waiting and waiting[0][0] <= now_ns:
            if data := script.encode(heapq.heappop(waiting)[2]):
                due.append(data)
        if due:
            port.send(due)
            timing.sent(clock.now_ns())
        upcoming = [entry for entry in (waiting[0][0] if waiting else None, changes[0] if changes else None) if entry]
        wait_s = max(0.0, (min(upcoming) - clock.now_ns()) * 1e-9) if upcoming else None
        pipes = (control.fileno(), truth.fileno()) if flying else (control.fileno(),)
        ready, _, _ = select.select((*pipes, *port.descriptors()), (), (), wait_s)
        for one in ready:
            if one == pipes[0]:
                control.recv()  # nothing is said after the start: this is the end of the pipe
            elif one in pipes:
                try:
                    values = np.frombuffer(truth.recv_bytes())
                except EOFError:
                    flying = False
                    continue
                rows = values.reshape(-1, len(script.signals) + timing.extra)
                for message in script.extend(timing.taken_off(rows)):
                    heapq.heappush(waiting, (message.due_ns, made, message))
                    made += 1
            else:
                request = port.receive(one)
                if request and wire.answer is not None:
                    reply = wire.answer(request, script.clock.at(clock.now_ns()))
                    if reply:
                        port.send([reply])
