"""Bad inputs by the million: what each codec and each reader of files makes of sound messages and files, mutated.

    uv run python -m tests.reliability.mutations [--inputs 1000000] [--seconds 600] [--only ubx,mat] [--seed 1]

Each goes on until it has had so many inputs or taken so much processor time. A codec must never raise, must give only
numbers, and must read a sound message after a reset. A reader must end in a LogError or in what can be read; files from
elsewhere are read in a child (station/convert/confined.py), a hundred inputs each, and one that ends its child is tried
again as a user's import would. No input may take longer than LONGEST_S, or memory beyond GROWTH_MIB. The table's inputs
add up over its calls, each with a seed of its own, for as long as the code that reads them is the same.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import random
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from drivers.can_dbc import CanCodec
from drivers.can_dronecan import DronecanCodec, DronecanEncoder
from drivers.can_frames import encode_slcan
from drivers.codec import Codec, Reading
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.mavlink_messages import TABLE
from drivers.serial_boombox import BoomboxAsciiCodec, BoomboxCodec, encode_line, encode_packet
from drivers.serial_gnss import NmeaCodec, UbxCodec, encode_nav_pvt, encode_sentence
from drivers.serial_lines import LinesCodec
from drivers.serial_msp import MspCodec
from drivers.serial_msp import encode as encode_msp
from drivers.serial_vectornav import VECTORNAV, VectorNavCodec
from station.convert import IMPORTERS, import_file
from station.convert.confined import confined
from station.log import read_rows, summarise, write_log
from station.profile import CanDevice, DronecanDevice, MavlinkDevice, Rig, load_rig, profiles_dir
from station.rows import LogError, Rows
from tests.reliability.endings import about, tick_rows
from tests.reliability.test_foreign_files import AIRCRAFT, DATAFLASH, dataflash, mat, mutated, ulog

BATCH_S: Final = 20
"""Of processor time for a hundred such files, which take a second or two: one that hangs is not waited for twice."""
LONGEST_S: Final = 2.0
"""Of processor time for one input of some kilobytes: a hang, and not a machine that is slow."""
FOREIGN_S: Final = 65.0
"""Of a file from elsewhere: its parser is ended after 60 s of processor time."""
GROWTH_MIB: Final = 200.0
LINKS: Final = (
    "boombox", "boombox_ascii", "ubx", "nmea", "vectornav", "lines", "msp", "can", "dronecan", "mavlink",
    "mavlink signed",
)  # fmt: skip
FOREIGN: Final = ("csv", "asc", "mat", "mat compressed", "bin", "ulg")
NAMES: Final = (*LINKS, "mcap", *FOREIGN)
KEY: Final = bytes(range(32))
BATCH: Final = 100
"""Files that one child reads: a child of its own for each would take longer than reading it."""


ASKED: Final = 1_000_000
"""Inputs of each."""


@dataclass(slots=True)
class Flown:
    """What has been tried, and what came of it."""

    name: str
    inputs: int = 0
    read: int = 0
    """Of them, those in which something sound was found."""
    raised: int = 0
    longest_s: float = 0.0
    took_s: float = 0.0
    growth_mib: float = 0.0
    first: str = ""
    """The first fault."""

    @property
    def is_sound(self) -> bool:
        limit_s = FOREIGN_S if self.name in FOREIGN else LONGEST_S
        return not self.raised and self.longest_s <= limit_s and self.growth_mib <= GROWTH_MIB

    def add(self, more: Flown) -> None:
        """Those of another call."""
        self.inputs, self.read = self.inputs + more.inputs, self.read + more.read
        self.raised, self.first = self.raised + more.raised, self.first or more.first
        self.longest_s = max(self.longest_s, more.longest_s)
        self.growth_mib = max(self.growth_mib, more.growth_mib)
        self.took_s += more.took_s

    def fault(self, seed: str, what: str) -> None:
        self.raised += 1
        self.first = self.first or f"{seed}: {what}"

    def words(self) -> str:
        slowest = f"{self.longest_s * 1e3:.0f} ms"
        told = f"{self.inputs} inputs, {self.raised} faults, {self.read} read; {slowest} and {self.growth_mib:.0f} MiB"
        return f"{self.name}: {told}{'; ' + self.first if self.first else ''}"


class Link(NamedTuple):
    """A codec and sound messages of its link."""

    codec: Callable[[], Codec]
    sound: Sequence[bytes]


@cache
def rig_of(name: str) -> Rig:
    return load_rig(name)


def can_codec() -> CanCodec:
    device = rig_of("can_only").devices[0]
    assert isinstance(device, CanDevice)
    return CanCodec(device, profiles_dir() / "rigs")


def dronecan_codec() -> DronecanCodec:
    device = rig_of("dronecan").devices[0]
    assert isinstance(device, DronecanDevice)
    return DronecanCodec(device)


def dronecan_transfers() -> list[bytes]:
    """Of all that the rig reads, in turn; most take several frames."""
    node, streams = DronecanEncoder(42), rig_of("dronecan").devices[0].streams
    return [
        node.encode(Reading(s.message, k * 10**7, None, {c.field: 0.1 for c in s.signals.values()}))
        for k in range(4)
        for s in streams
    ]


def mavlink_codec(key: bytes | None = None) -> MavlinkCodec:
    device = rig_of("mavlink_only").devices[0]
    assert isinstance(device, MavlinkDevice)
    return MavlinkCodec(device, key)


def links() -> dict[str, Link]:
    turns = range(20)
    vehicle, signing = MavlinkEncoder(), MavlinkEncoder(key=KEY)

    def said(by: MavlinkEncoder) -> list[bytes]:
        return [by.heartbeat(), *(by.encode(name, {}, k * 10**9) for k, name in enumerate(TABLE))]

    return {
        "boombox": Link(BoomboxCodec, [encode_packet(k % 3, k, 5000 * k, (k, -k, 77)) for k in turns]),
        "boombox_ascii": Link(BoomboxAsciiCodec, [encode_line(k % 3, k, 5000 * k, (k, -k, 77)) for k in turns]),
        "ubx": Link(UbxCodec, [encode_nav_pvt(k * 10**8, 50.0, 10.0, 1e5, (1e3, k, -k)) for k in turns]),
        "nmea": Link(NmeaCodec, [
            *(encode_sentence("VTG", 0, v_north=k, v_east=2.0) for k in turns),
            *(encode_sentence("GGA", k * 10**9, lat=47.1, lon=8.2, alt=545.4) for k in turns),
            *(encode_sentence("RMC", k * 10**9, lat=47.1, lon=8.2, spd=22.4, cog=84.4) for k in turns),
        ]),
        "vectornav": Link(VectorNavCodec, [
            VECTORNAV.encode(Reading("IMU", k * 10**7, None, dict.fromkeys(VECTORNAV.fields["IMU"], 0.1 * k)))
            for k in turns
        ]),
        "lines": Link(LinesCodec, [f"aoa {k}.25,{-k}e-3,7\r\n".encode() for k in turns]),
        "msp": Link(MspCodec, [
            encode_msp(Reading("AOA", None, None, {"aoa": 0.1 * k, "sideslip": -0.1 * k})) for k in turns
        ]),
        "can": Link(can_codec, [
            b"t10082800F6070069525F\r",
            *(encode_slcan(m.definition.frame_id, m.frame[1], bytes([k] * m.definition.length))
              for k, m in enumerate(can_codec().messages.values())),
        ]),
        "dronecan": Link(dronecan_codec, dronecan_transfers()),
        "mavlink": Link(mavlink_codec, said(vehicle)),
        "mavlink signed": Link(lambda: mavlink_codec(KEY), said(signing)),
    }  # fmt: skip


def fly_link(name: str, link: Link, flown: Flown, seed: int) -> Iterator[None]:
    """One input after another: sound messages, some of their bytes hurt, cut anywhere, and then a sound one."""
    noise, codec = random.Random(f"{seed} {name}"), link.codec()
    proof = link.codec()
    whole = [m for m in link.sound if _numbers(proof, m, flown, "sound")]
    assert whole, f"{name}: no sound message"
    while True:
        picked = sorted(noise.choices(range(len(link.sound)), k=noise.randrange(1, 8)))
        data = mutated(link.sound[0] + b"".join(link.sound[n] for n in picked), noise)
        if "signed" in name:  # what is signed is taken once, and in order
            codec = link.codec()
        if noise.random() < 0.1:
            data += noise.randbytes(noise.randrange(400))
        found, began = 0, time.process_time()
        at = 0
        while at < len(data):
            size = noise.choice((1, 7, 64, 1000))
            found += _numbers(codec, data[at : at + size], flown, f"{flown.inputs}")
            at += size
        codec.reset()
        flown.longest_s = max(flown.longest_s, time.process_time() - began)
        flown.read += bool(found)
        # A signed message counts once, and a link that has lost sync may first have to hear the vehicle's heartbeat.
        if "signed" not in name and not _numbers(codec, link.sound[0] + noise.choice(whole), flown, f"{flown.inputs}"):
            flown.fault(f"{flown.inputs}", "a sound message after a reset is not read")
        codec.reset()
        yield


def _numbers(codec: Codec, data: bytes, flown: Flown, seed: str) -> int:
    """How many readings are in it, all of whose fields are numbers."""
    try:
        found = codec.feed(data)
    except Exception as error:
        flown.fault(seed, f"{type(error).__name__}: {error}")
        return 0
    for reading in found:
        if isinstance(reading, Reading) and not all(type(v) in (float, int) for v in reading.fields.values()):
            flown.fault(seed, f"no number: {reading}")
    return len(found)


def files(work: Path) -> dict[str, bytes]:
    """A sound file of each kind, some kilobytes."""
    rows, noise = list[Rows](), random.Random(1)
    for k in range(20):
        rows += tick_rows(k, 10**9 + k * 20_000_000, noise)
    write_log(work / "made.mcap", about(), rows)
    table = [f"{0.02 * k:.2f},{0.1 + 0.001 * k},{0.01 * k},100" for k in range(100)]
    return {
        "mcap": (work / "made.mcap").read_bytes(),
        "csv": "\n".join(["time [s],alpha_vane [rad],q [deg/s],airspeed [kt]", *table]).encode(),
        "asc": "\n".join(" ".join(f"{x:.4f}" for x in [0.1 * k, *[1.5] * 14]) for k in range(100)).encode(),
        "mat": mat(work / "made.mat", False),
        "mat compressed": mat(work / "made.mat", True),
        "bin": dataflash([1_000_000 + k * 20_000 for k in range(100)]),
        "ulg": ulog(),
    }


def fly_recording(data: bytes, flown: Flown, seed: int, work: Path) -> Iterator[None]:
    """Recordings of our own, hurt, as `info` reads them."""
    noise, path = random.Random(f"{seed} mcap"), work / "a.mcap"
    while True:
        path.write_bytes(mutated(data, noise))
        began = time.process_time()
        try:
            flown.read += bool(list(read_rows(path)))
            summarise(path)
        except LogError:
            pass
        except Exception as error:
            flown.fault(f"{flown.inputs}", f"{type(error).__name__}: {error}")
        flown.longest_s = max(flown.longest_s, time.process_time() - began)
        yield


def fly_files(kind: str, data: bytes, flown: Flown, seed: int, work: Path) -> Iterator[None]:
    """Files from elsewhere, hurt."""
    suffix, noise = kind.split(maxsplit=1)[0], random.Random(f"{seed} {kind}")
    path, out = work / f"a.{suffix}", work / "out.mcap"
    fitting = [row for row in (DATAFLASH, *IMPORTERS) if row.suffix == f".{suffix}"]

    def one(content: bytes) -> tuple[bool, float]:
        path.write_bytes(content)
        row = next((row for row in fitting if row.is_it(path)), fitting[-1])
        began = time.process_time()
        try:
            row.read(path, AIRCRAFT)
        except MemoryError:
            raise
        except Exception:  # what `confined` makes a LogError of
            return False, time.process_time() - began
        return True, time.process_time() - began

    path.write_bytes(data)
    while True:
        batch = [mutated(data, noise) for _ in range(BATCH)]
        try:
            found = confined(path, lambda batch=batch: [one(content) for content in batch], BATCH_S)  # type: ignore[misc]
        except LogError:
            found = []
        # Did one of them end the child? Then each in a child of its own, as a user's import.
        for is_read, took in found or (_imported(path, out, content, flown) for content in batch):
            flown.read += is_read
            flown.longest_s = max(flown.longest_s, took)
            yield


def _imported(path: Path, out: Path, content: bytes, flown: Flown) -> tuple[bool, float]:
    """Whether it made a recording, and how long that took."""
    path.write_bytes(content)
    out.unlink(missing_ok=True)
    began = _spent_s()
    try:
        import_file(path, out, AIRCRAFT, (DATAFLASH,))
        summarise(out)
    except LogError as error:
        if out.exists():
            flown.fault(f"{flown.inputs}", f"left a recording that cannot be read: {error}")
        return False, _spent_s() - began
    return True, _spent_s() - began


def code_of(name: str) -> str:
    """A digest of the code that reads `name`: its module and what of the same wing that imports, in turn."""
    root = Path(__file__).parents[2]
    codec = type(links()[name].codec()).__module__ if name in LINKS else "station.convert"
    wings = (
        ("drivers",) if name in LINKS else ("station.log",) if name == "mcap" else ("station.convert", "station.log")
    )
    waiting, seen = [*wings[:1], codec] if name in LINKS else list(wings), set[Path]()
    digest = hashlib.sha256()
    while waiting:
        module = root / waiting.pop().replace(".", "/")
        path = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        if path in seen or not path.exists():
            continue
        seen.add(path)
        tree = ast.parse(path.read_text())
        imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
        within = [node for node in imported if str(node.module).startswith(wings)]
        waiting += [str(node.module) for node in within]
        waiting += [f"{node.module}.{alias.name}" for node in within for alias in node.names]
    for path in sorted(seen):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def added(name: str, inputs: int, seconds: float, kept: Path | None) -> Flown:
    """Those of earlier calls in `kept`, of the same code, and more of them up to `inputs`."""
    if kept is None:
        return fly(name, inputs, seconds)
    before = _read(kept)
    code, flown = code_of(name), Flown(name)
    if (row := before.get(name)) is not None and row["code"] == code:
        flown = Flown(**{field: value for field, value in row.items() if field != "code"})
    if flown.inputs < inputs:
        # A seed of its own: the inputs of a call are not those of one before.
        flown.add(fly(name, inputs - flown.inputs, seconds, seed=flown.inputs + 1))
        kept.write_text(json.dumps(_read(kept) | {name: asdict(flown) | {"code": code}}, indent=1) + "\n")
    return flown


def is_short(name: str, kept: Path) -> bool:
    """Whether there are inputs still to be tried of `name`."""
    row = _read(kept).get(name)
    return row is None or row["inputs"] < ASKED or row["code"] != code_of(name)


def _read(kept: Path) -> dict[str, Any]:
    """Raises SystemExit for a file that holds something else."""
    try:
        found: dict[str, Any] = json.loads(kept.read_text())
        if all(set(row) == {*Flown.__slots__, "code"} for row in found.values()):
            return found
    except FileNotFoundError:
        return {}
    except (ValueError, AttributeError, TypeError):
        pass
    raise SystemExit(f"{kept}: no counts of inputs; remove it")


def _memory_mib() -> float:
    own, children = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return max(own, children) / 1024


def fly(name: str, inputs: int, seconds: float, seed: int = 1) -> Flown:
    """`name`: of `links()`, or a kind of file."""
    flown, all_links = Flown(name), links()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        if name in all_links:
            flight = fly_link(name, all_links[name], flown, seed)
        elif name == "mcap":
            flight = fly_recording(files(work)[name], flown, seed, work)
        else:
            flight = fly_files(name, files(work)[name], flown, seed, work)
        next(flight)
        flown.inputs, before, began = 1, _memory_mib(), _spent_s()
        for _ in range(inputs - 1):
            next(flight)
            flown.inputs += 1
            if flown.inputs % BATCH == 0 and _spent_s() - began > seconds:
                break
        flown.took_s, flown.growth_mib = _spent_s() - began, _memory_mib() - before
    return flown


def _spent_s() -> float:
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--inputs", type=int, default=ASKED, help="of each")
    options.add_argument("--seconds", type=float, default=600.0, help="of processor time for each, at most")
    options.add_argument("--only", default=",".join(NAMES), help="some of them, with commas between")
    options.add_argument("--seed", type=int, default=1)
    chosen = options.parse_args()
    names = chosen.only.split(",")
    if unknown := set(names) - set(NAMES):
        raise SystemExit(f"--only: no {', '.join(sorted(unknown))}; known: {', '.join(NAMES)}")
    holds = True
    for name in names:
        flown = fly(name, chosen.inputs, chosen.seconds, chosen.seed)
        holds &= flown.is_sound
        print(f"{flown.words()}; {flown.took_s:.0f} s", flush=True)
    sys.exit(not holds)


if __name__ == "__main__":
    main()
