"""Chapter 10 files: one made by pychapter10 1.1.19 (`pychapter10.ch10`: 20 major frames of two minor ones, unpacked,
and analog), and packets built here bit by bit after IRIG 106 Chapters 4, 9 and 11."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from station.__main__ import app
from station.api import flown_recording
from station.conventions import SIGNALS
from station.convert.ch10 import read_ch10
from station.profile import load_aircraft
from station.rows import LogError
from tests.chapter10 import SETUP, T0, packet, pcm_packets, setup

FOREIGN = Path(__file__).parent / "pychapter10.ch10"
NAMES = {"alpha_vane": "AOA BOOM", "elevator": "elevator pot"}
AIRCRAFT = load_aircraft("twin_otter")
KT, FT = 1852 / 3600, 0.3048


def found(path: Path, names: dict[str, str] | None = None) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
    tracks = read_ch10(path, AIRCRAFT, names).tracks
    return {signal: (t.t_ns, column) for t in tracks for signal, column in t.columns.items()}


def test_measurements_of_a_foreign_file_become_signals() -> None:
    """Minor frame i of 128 bits at 20 kbit/s begins 6.4 ms i after the first; words of 16 bits behind 32 of pattern."""
    made = found(FOREIGN, NAMES)
    i = np.arange(40)
    start = made["elevator"][0][0]  # the analog packet begins with the first frame
    t_ns, alpha = made["alpha_vane"]  # words 2 and 5: 1.5 + 0.001 x counts, 100 i and -100 i - 50
    assert (t_ns[0::2] - start).tolist() == (3_200_000 + 6_400_000 * i).tolist()
    assert (t_ns[1::2] - start).tolist() == (5_600_000 + 6_400_000 * i).tolist()
    assert np.degrees(alpha[0::2]) == pytest.approx(1.5 + 0.1 * i)
    assert np.degrees(alpha[1::2]) == pytest.approx(1.45 - 0.1 * i)
    t_ns, airspeed = made["airspeed"]  # word 3 of the first minor frame, its lower 12 bits: 50 i, by pair sets
    counts = 50.0 * i[0::2]
    assert (t_ns - start).tolist() == (4_000_000 + 12_800_000 * np.arange(20)).tolist()
    assert airspeed / KT == pytest.approx(np.where(counts < 1000, 0.1 * counts, 100 + 0.05 * (counts - 1000)))
    _, altitude = made["altitude"]  # of the second minor frame: 8 bits of word 4, then 16 of word 6
    assert altitude / FT == pytest.approx(-1000 + 0.01 * (65536 * i[1::2] + 7 * i[1::2]))
    t_ns, elevator = made["elevator"]  # offset binary, four packets of 12 at 200 Hz, each from its own time
    assert np.degrees(elevator) == pytest.approx(0.05 * np.arange(48))
    assert (t_ns - start).tolist() == [64_000_000 * b + 5_000_000 * j for b in range(4) for j in range(12)]
    assert np.degrees(made["rudder"][1]) == pytest.approx(0.005 * np.arange(48))


THETA = [0, 1, 2047, -1, -2047, 700]  # sign and magnitude


@pytest.mark.parametrize(
    "mode", ["packed", "packed in words of 32 bits", "packed, bytes not swapped", "unpacked", "throughput"]
)
def test_minor_frames_in_each_packing(tmp_path: Path, mode: str) -> None:
    path = tmp_path / "a.ch10"
    path.write_bytes(setup() + pcm_packets(mode))
    t_ns, theta = found(path)["theta"]
    assert theta.tolist() == [c / 1024 for c in THETA]
    # The sample's last bit is the 48th of a frame: 4 ms. A stream's times are those of its packets, to 100 ns.
    assert t_ns == pytest.approx([T0 * 100 + 5_000_000 * i + 4_000_000 for i in range(6)], abs=200)
    assert "location type MFSF" in read_ch10(path, AIRCRAFT).notes["left_out"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (pcm_packets("packed"), r"no setup record \(TMATS\)"),
        (setup(word=0x200) + pcm_packets("packed"), "is XML"),
        (setup(SETUP.replace("THETA", "PITCH ATT").replace(":Q;", ":RATE;")), "measurements: PITCH ATT, RATE"),
        (setup() + packet(4, 0x19, bytes(8)), "channels of MIL-STD-1553: 1, not read"),
        (setup(SETUP.replace("P-1\\D2:12000; ", "")) + pcm_packets("packed"), r"P-1\\D2: missing"),
        (setup(SETUP.replace("MN3:rad", "MN3:V")) + pcm_packets("packed"), "unit V .* where one of rad is wanted"),
        (setup(SETUP.replace("P-1\\MF1:4;", "P-1\\MF1:4; P-1\\MF2:72;")) + pcm_packets("packed"), "make 60"),
        (b"", "empty"),
        (b"PK\x03\x04 something else" * 9, "no setup record"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "a.ch10"
    path.write_bytes(content)
    with pytest.raises(LogError, match=says) as told:
        read_ch10(path, AIRCRAFT)
    assert str(told.value).startswith(str(path))


def test_import_names_measurements_and_tells_what_is_lost(tmp_path: Path) -> None:
    whole = FOREIGN.read_bytes()
    broken, out = tmp_path / "a.ch10", tmp_path / "a.mcap"
    broken.write_bytes(whole[:-300] + b"\xff" + whole[-299:])
    words = ["import", str(broken), "-o", str(out), "--aircraft", "twin_otter"]
    run = CliRunner().invoke(app, [*words, "--signal", "alpha_vane=AOA BOM"])
    assert "no measurement 'AOA BOM'; did you mean AOA BOOM?" in str(run.exception)
    run = CliRunner().invoke(app, [*words, "--signal", "alpha_vane=AOA BOOM"], standalone_mode=False)
    assert run.return_value == 3
    assert "1 damaged packets" in run.output
    opened = flown_recording.Recording(out)
    assert "alpha_vane" in opened.signals
    assert opened.info.about.notes["program"] == "SHORT PERIOD"


def test_whatever_is_broken_ends_in_a_sentence_or_a_record(tmp_path: Path) -> None:
    """Seeded bytes changed, within the setup record too; the checksums made to fit again."""
    rng = random.Random(4)
    path = tmp_path / "a.ch10"
    read = 0
    for trial in range(200):
        text, body = bytearray(SETUP.encode()), bytearray(pcm_packets(("packed", "throughput")[trial % 2]))
        for _ in range(rng.randrange(1, 6)):
            text[rng.randrange(len(text))] = rng.choice(b"0123456789-:;\\\x00\xff")
        if trial % 3 == 0:
            body[rng.randrange(len(body))] = rng.randrange(256)
        path.write_bytes(setup(text.decode("latin-1")) + body[: rng.choice([len(body), rng.randrange(len(body))])])
        try:
            record = read_ch10(path, AIRCRAFT)
        except LogError:
            continue
        read += 1
        for track in record.tracks:
            assert set(track.columns) <= set(SIGNALS)
            assert np.all(np.diff(track.t_ns) > 0)
    assert 10 < read < 190  # both kinds of end were met
