"""Whatever a file from elsewhere does to its reader, the user gets a LogError or a recording."""

from __future__ import annotations

import os
import random
import resource
import signal
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from scipy.io import savemat

from drivers.dataflash import read_dataflash
from station.convert import Record, import_file
from station.convert.confined import confined
from station.convert.ulog import read_ulog
from station.convert.umn import read_umn
from station.log import About, read_rows, summarise, write_log
from station.profile import load_aircraft
from station.rows import LogError, ProfileError, RawBlock, Tick
from tests.reliability.foreign import AIRCRAFT, DATAFLASH, dataflash, mat, ulog, umn
from tests.reliability.hurting import mutated

MIB = 2**20


def for_ever() -> Record:
    while True:
        pass


def crash() -> Record:
    os.write(2, b"a parser's chatter\n")
    os.kill(os.getpid(), signal.SIGSEGV)
    raise AssertionError


def all_there_is() -> Record:
    return [bytearray(MIB) for _ in range(100_000)]  # type: ignore[return-value]


def end() -> Record:
    os._exit(9)


def raise_one() -> Record:
    raise OverflowError("Python int too large to convert to C long")


@pytest.mark.parametrize(
    ("read", "says"),
    [
        (for_ever, "it took more than 1 s of processor time"),
        (crash, r"the parser crashed \(SIGSEGV\)"),
        (all_there_is, "it would take more than 64 MiB"),
        (end, r"the parser ended by itself \(exit status 9\)"),
        (raise_one, "OverflowError: Python int too large"),
    ],
)
def test_what_a_parser_may_do_is_an_error_of_the_file(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], read: Callable[[], Record], says: str
) -> None:
    path = tmp_path / "a.mat"
    path.write_bytes(b"")
    with pytest.raises(LogError, match=says) as error:
        confined(path, read, seconds=1, memory=64 * MIB)
    assert str(error.value).startswith(f"{path}: cannot be read: ")
    assert len(str(error.value).splitlines()) == 2
    assert capfd.readouterr() == ("", "")
    assert resource.getrlimit(resource.RLIMIT_DATA)[0] == resource.RLIM_INFINITY, "the station's own limits are not set"


@pytest.mark.parametrize("kind", ["mat", "mat compressed", "bin", "ulg"])
@pytest.mark.parametrize("inputs", [15, pytest.param(2000, marks=pytest.mark.slow)])
def test_damaged_files_end_in_an_error_or_a_recording(tmp_path: Path, kind: str, inputs: int) -> None:
    data = {
        "mat": lambda: mat(tmp_path / "made.mat", False),
        "mat compressed": lambda: mat(tmp_path / "made.mat", True),
        "bin": lambda: dataflash([1_000_000 + k * 20_000 for k in range(100)]),
        "ulg": ulog,
    }[kind]()
    noise = random.Random(zlib.crc32(kind.encode()))
    path, out = tmp_path / f"a.{kind.split()[0]}", tmp_path / "a.mcap"
    path.write_bytes(data)
    assert import_file(path, out, AIRCRAFT, (DATAFLASH,)) > 0
    assert summarise(out).verdict == "complete"
    for _ in range(inputs):
        out.unlink(missing_ok=True)
        path.write_bytes(mutated(data, noise))
        try:
            import_file(path, out, AIRCRAFT, (DATAFLASH,))
        except LogError:
            assert not out.exists()
        else:
            assert summarise(out).verdict == "complete"


def test_an_aircraft_that_cannot_be_makes_no_recording(tmp_path: Path) -> None:
    """SIDPAC's fdata carries inertia in slug ft2; nobody could read a recording of an aircraft without any."""
    fdata = np.zeros((200, 90))
    fdata[:, 0] = np.arange(200) * 0.02
    fdata[:, 1] = 100.0
    fdata[:, 48] = [-1.0] * 200
    savemat(tmp_path / "a.mat", {"fdata": fdata})
    with pytest.raises(LogError, match=r"inertia\.ixx: input should be greater than 0"):
        import_file(tmp_path / "a.mat", tmp_path / "a.mcap", AIRCRAFT)
    assert not (tmp_path / "a.mcap").exists()


def test_a_time_beyond_64_bits_is_an_error_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(dataflash([1_000_000, 2**63 - 1, 2**64 - 1]))
    with pytest.raises(LogError, match="cannot be read"):
        import_file(path, tmp_path / "a.mcap", AIRCRAFT, (DATAFLASH,))


@pytest.mark.parametrize("name", [b"ATT\0", b"A,T\xff"])
def test_a_message_without_a_length_is_told_at_once(tmp_path: Path, name: bytes) -> None:
    """pymavlink stands still at it, for the 60 s that a parser may take: by its description it has neither a head nor
    fields."""
    data = dataflash([1_000_000, 1_020_000])
    path = tmp_path / "a.bin"
    path.write_bytes(data[:93] + b"\0" + name + bytes(80) + data[178:])
    with pytest.raises(LogError, match="damaged at byte 178: a message there has no length"):
        read_dataflash(path)


def test_a_struct_of_more_elements_than_bytes_is_refused_before_there_is_room_for_it(tmp_path: Path) -> None:
    """4 kB took 400 MiB: the second of the two dimensions of the first variable (*MAT-File Format*, array header)."""
    path = tmp_path / "a.mat"
    data = bytearray(umn(path))
    assert struct.unpack_from("<4i", data, 152) == (5, 8, 1, 1)
    struct.pack_into("<i", data, 164, 2**25)
    path.write_bytes(data)
    with pytest.raises(LogError, match="a structure of 33554432 elements, not of one"):
        read_umn(path, AIRCRAFT)


def test_a_definition_that_the_end_cuts_is_told_at_once(tmp_path: Path) -> None:
    """pyulog goes round at it, for the 60 s that a parser may take: 58 bytes of a millionfold mutated log did."""
    path = tmp_path / "a.ulg"
    path.write_bytes(ulog()[:16] + struct.pack("<HB", 0, 0) + bytes(30) + struct.pack("<HB", 40, 0) + bytes(3))
    with pytest.raises(LogError, match="damaged at byte 48: a message runs past the end of the file"):
        read_ulog(path, AIRCRAFT)


def test_a_profile_of_5000_letters_is_a_short_error() -> None:
    with pytest.raises(ProfileError, match="more than 200 letters") as error:
        load_aircraft("a" * 5000)
    assert len(str(error.value)) < 200


def test_a_chunk_that_claims_little_and_unpacks_to_much_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """56 kB of zstd are 512 MiB of noughts; what the chunk says of itself is 100 bytes."""
    path = tmp_path / "a.mcap"
    write_log(path, About(AIRCRAFT, ()), [RawBlock(1, "boom", b"x" * 50), Tick(1, 0, 0)])
    data = path.read_bytes()
    at = data.index(b"\x04\0\0\0zstd") + 8
    bomb = zstandard.ZstdCompressor(level=19).compress(bytes(512 * MIB))
    assert len(bomb) < 60_000
    start = at - 8 - 28 - 9
    head = b"\x06" + struct.pack("<Q", at - start - 9 + 8 + len(bomb))
    hurt = data[:start] + head + data[start + 9 : at] + struct.pack("<Q", len(bomb)) + bomb
    hurt += data[at + 8 + struct.unpack_from("<Q", data, at)[0] :]
    path.write_bytes(hurt)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert list(read_rows(path)) == []
    assert summarise(path).verdict == "damaged"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 * 1024
