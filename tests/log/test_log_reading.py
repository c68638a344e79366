"""A recording is read however it ends, by this station and by others, and the verdict on it is right."""

from __future__ import annotations

import json
import random
import zlib
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from station.clock import ManualClock
from station.conventions import SIGNALS, Stream
from station.log import (
    About,
    LogWriter,
    describe,
    metadata,
    parts,
    read_rows,
    recover,
    summarise,
    verdict,
    write_log,
)
from station.log.disk import Disk
from station.log.part import CHUNK, RECORD, PartWriter
from station.profile import load_aircraft
from station.rows import Code, Event, Frame, Health, LogError, RawBlock, Rows, Sample, StreamHealth, Tick

STREAM = Stream("boom.vanes", ("alpha_vane", "beta_vane"), 50.0, 0.2, "boom")
ABOUT = About(load_aircraft("twin_otter"), (STREAM,))
CHUNK_HEAD = RECORD.size + CHUNK.size + 4
"""Bytes of a chunk before the name of its compression."""


def flight_rows(ticks: int, noise: random.Random) -> list[Rows]:
    rows: list[Rows] = []
    for k in range(ticks):
        t = 10**9 + k * 20_000_000
        rows.append(RawBlock(t, "boom", noise.randbytes(200)))
        rows.append(Sample(t, "boom.vanes", t, k % 256, (noise.random(), noise.random())))
        rows.append(Tick(t, k, t - 60_000_000))
    return rows


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Rows]]:
    path = tmp_path_factory.mktemp("whole") / "flight.mcap"
    rows = flight_rows(500, random.Random(1))
    write_log(path, ABOUT, rows)
    return path, rows


def test_a_schema_knows_all_that_its_messages_hold(tmp_path: Path) -> None:
    """A player offers to plot what the schema names."""
    stream = StreamHealth("boom.vanes", "boom", 199.6, 0.004, "synced", -3600.0, 30.0, 1000, 0, 0, True)
    path = tmp_path / "flight.mcap"
    write_log(path, ABOUT, [Health(1, (stream,)), Tick(2, 0, 1)])
    with path.open("rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            assert schema is not None
            _compare(json.loads(schema.data), json.loads(message.data))


def _compare(schema: dict[str, Any], body: dict[str, Any]) -> None:
    assert set(body) <= set(schema["properties"])
    for name, value in body.items():
        for item in value if isinstance(value, list) else []:
            _compare(schema["properties"][name]["items"], item)


def test_other_readers_read_it(whole: tuple[Path, list[Rows]]) -> None:
    path, rows = whole
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(rows)
        assert sum(summary.statistics.channel_message_counts.values()) == len(rows)
        found = [
            json.loads(message.data) | {"log_time": message.log_time}
            for _, channel, message in reader.iter_messages(topics=["/sample/boom.vanes"])
        ]
        schema = next(s for s in summary.schemas.values() if s.name == "station.Sample.boom.vanes")
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        notes = {m.name: m.metadata for m in reader.iter_metadata()}
    samples = [r for r in rows if isinstance(r, Sample)]
    assert [(f["log_time"], f["t_device_ns"], f["seq"], f["alpha_vane"], f["beta_vane"]) for f in found] == [
        (s.t_ns, s.t_device_ns, s.seq, *s.values) for s in samples
    ]
    assert json.loads(schema.data)["properties"]["alpha_vane"]["unit"] == SIGNALS["alpha_vane"].unit
    assert json.loads(attachments["aircraft.json"])["name"] == "twin_otter"
    assert notes["station"]["source"] == "flight"
    with path.open("rb") as file:
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > len(rows)


def test_events_are_foxglove_log_messages(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap", ABOUT, [Event(1_500_000_000, "boom", Code.STALE, 2, "no data")])
    with (tmp_path / "a.mcap").open("rb") as file:
        ((schema, _, message),) = make_reader(file).iter_messages()
    assert schema is not None
    assert schema.name == "foxglove.Log"
    body = json.loads(message.data)
    assert body["timestamp"] == {"sec": 1, "nsec": 500_000_000}
    assert (body["level"], body["name"], body["message"]) == (4, "boom", "STALE x2 no data")


def test_a_whole_recording_is_complete(whole: tuple[Path, list[Rows]]) -> None:
    path, rows = whole
    summary = summarise(path)
    assert (summary.verdict, summary.seconds_lost, summary.problems) == ("complete", 0.0, [])
    assert (summary.rows, summary.ticks, summary.ticks_missed) == (len(rows), 500, 0)
    assert summary.duration_s == pytest.approx(9.98)
    (stream,) = summary.streams
    assert (stream.samples, stream.gaps, stream.dropouts) == (500, 0, [])
    assert stream.rate_hz == pytest.approx(50.0)
    assert "complete" in describe(summary)


def test_truncation_anywhere_is_read_and_called_truncated(whole: tuple[Path, list[Rows]], tmp_path: Path) -> None:
    path, rows = whole
    data = path.read_bytes()
    start = data.index(b"zstd") - CHUNK_HEAD
    noise = random.Random(2)
    cuts = [*range(8), *noise.sample(range(8, start), 20), *noise.sample(range(start, len(data)), 60)]
    cut, refused = tmp_path / "cut.mcap", []
    for length in [*cuts, *range(len(data) - 40, len(data))]:
        cut.write_bytes(data[:length])
        try:
            summary = summarise(cut)
        except LogError:
            refused.append(length)
            continue
        assert summary.verdict == "truncated", length
        found = list(read_rows(cut))
        assert found == rows[: len(found)]
        # All but the chunk that was cut: 32 KiB of these rows are under 100 ticks.
        assert len(found) >= len(rows) * (length - start) / len(data) - 600
    assert max(refused) < start


@pytest.mark.parametrize("seed", range(40))
def test_a_flipped_byte_is_called_damaged(whole: tuple[Path, list[Rows]], tmp_path: Path, seed: int) -> None:
    path, rows = whole
    data = bytearray(path.read_bytes())
    at = random.Random(seed).randrange(data.index(b"zstd") - CHUNK_HEAD, len(data))
    data[at] ^= 1 << random.Random(seed + 1000).randrange(8)
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    summary = summarise(hurt)
    assert summary.verdict == "damaged", at
    known = set(map(repr, rows))
    found = [repr(r) for r in read_rows(hurt)]
    assert set(found) <= known
    assert len(found) >= len(rows) - 600


@pytest.mark.parametrize("seed", range(40))
def test_a_flipped_byte_in_the_profiles_costs_nothing(
    whole: tuple[Path, list[Rows]], tmp_path: Path, seed: int
) -> None:
    """They stand a second time behind the first chunk."""
    path, rows = whole
    data = bytearray(path.read_bytes())
    at = random.Random(seed).randrange(0, data.index(b"zstd") - CHUNK_HEAD)
    data[at] ^= 1 << random.Random(seed + 1000).randrange(8)
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    assert summarise(hurt).verdict == "damaged", at
    assert list(read_rows(hurt)) == rows
    assert metadata(hurt) == metadata(path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2000))
def test_a_flipped_byte_anywhere_alters_no_row_and_costs_at_most_its_chunk(
    whole: tuple[Path, list[Rows]], tmp_path: Path, seed: int
) -> None:
    path, rows = whole
    data = bytearray(path.read_bytes())
    data[random.Random(seed).randrange(len(data))] ^= 1 << random.Random(seed + 10_000).randrange(8)
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    assert summarise(hurt).verdict == "damaged"
    found = list(read_rows(hurt))
    assert set(map(repr, found)) <= set(map(repr, rows))
    assert len(found) >= len(rows) - 600


@pytest.mark.parametrize("size", [8, 100, 5000])
def test_a_head_that_is_gone_costs_nothing(whole: tuple[Path, list[Rows]], tmp_path: Path, size: int) -> None:
    path, rows = whole
    data = path.read_bytes()
    assert size < data.index(b"zstd") - CHUNK_HEAD
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(bytes(size) + data[size:])
    assert summarise(hurt).verdict == "damaged"
    assert list(read_rows(hurt)) == rows
    assert metadata(hurt) == metadata(path)


def test_the_profiles_stand_twice_for_other_readers_too(whole: tuple[Path, list[Rows]]) -> None:
    with whole[0].open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [a.name for a in reader.iter_attachments()] == ["aircraft.json"] * 2
        found = [(m.name, m.metadata) for m in reader.iter_metadata()]
    assert found[:4] == found[4:8]
    assert [name for name, _ in found[8:]] == ["counts"]
    assert [name for name, _ in found[:4]] == ["station", "clock", "arithmetic", "notes"]


def test_what_cannot_say_what_it_is_of_is_told_from_outside(whole: tuple[Path, list[Rows]], tmp_path: Path) -> None:
    path, rows = whole
    data = bytearray(path.read_bytes())
    for name in (b"aircraft.json", b"station"):
        for at in [i for i in range(len(data)) if data.startswith(name, i)]:
            data[at] ^= 0x40
    hurt, saved = tmp_path / "hurt.mcap", tmp_path / "saved.mcap"
    hurt.write_bytes(data)
    with pytest.raises(LogError, match=r"station recover --aircraft NAME"):
        recover(hurt, saved)
    assert recover(hurt, saved, load_aircraft("twin_otter")).rows == len(rows)
    assert list(read_rows(saved)) == rows
    about = metadata(saved).about
    assert about.aircraft == ABOUT.aircraft
    (stream,) = about.streams
    assert (stream.name, stream.signals, stream.rate_hz, stream.device) == ("boom.vanes", STREAM.signals, 50.0, "boom")
    assert about.notes["aircraft"] == "named when it was recovered"


def test_files_that_are_not_there_are_named(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path, ABOUT, ManualClock(10**9), lambda event: None, "flight", rotate_bytes=30_000)
    for row in flight_rows(1500, random.Random(3)):
        writer.append([row])
    writer.close()
    first, *later = parts(tmp_path / "flight.mcap")
    assert len(later) > 2
    assert summarise(first).degraded == []
    later[1].unlink()
    holed = summarise(first)
    assert holed.degraded[0] == "the recording is truncated"
    assert holed.degraded[-1] == f"not here: {later[1].name}"
    assert holed.seconds_lost == pytest.approx(holed.ticks_missed * 0.02, abs=0.021)
    assert holed.ticks_missed > 50
    assert verdict(first) == "truncated"
    assert summarise(later[0]).degraded == []
    assert "file 1 of a flight: rows of its other files are not counted" in describe(summarise(later[0]))
    start_ns = next(read_rows(first)).t_ns
    later_ns = next(read_rows(later[0])).t_ns
    first.unlink()
    alone = summarise(later[0])
    assert alone.degraded == ["the recording is truncated", "not here: flight.mcap"]
    assert alone.seconds_lost == pytest.approx((later_ns - start_ns) * 1e-9, abs=0.03)
    assert "not here: flight.mcap" in describe(alone)
    recover(later[0], tmp_path / "saved.mcap")
    saved = summarise(tmp_path / "saved.mcap")
    assert (saved.verdict, saved.part) == ("complete", 0)
    assert saved.recovered == f"{later[0].name}, which is truncated, file 1 of a flight alone, not here: flight.mcap"
    assert saved.recovered in describe(saved)
    with pytest.raises(LogError, match=rf"no such file\nlater files of it are: read .*{later[0].name}"):
        summarise(first)
    renamed = later[0].rename(tmp_path / "renamed.mcap")
    assert "not here: what came before renamed.mcap" in summarise(renamed).degraded


def test_a_flight_whose_last_file_is_gone_is_not_complete(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path, ABOUT, ManualClock(), lambda event: None, "flight", rotate_bytes=30_000)
    for row in flight_rows(1500, random.Random(3)):
        writer.append([row])
    writer.close()
    first, *later = parts(tmp_path / "flight.mcap")
    assert (summarise(first).verdict, verdict(first)) == ("complete", "complete")
    later[-1].unlink()
    found = summarise(first)
    assert (found.verdict, verdict(first)) == ("truncated", "truncated")
    assert found.problems == [f"not here: the file after {later[-2].name}"]
    assert found.seconds_lost is None, "nothing says when the flight ended"


def test_after_a_damaged_chunk_reading_goes_on_and_the_loss_is_told(
    whole: tuple[Path, list[Rows]], tmp_path: Path
) -> None:
    path, rows = whole
    data = bytearray(path.read_bytes())
    marks = [i for i in range(len(data)) if data[i : i + 4] == b"zstd"]
    data[marks[1] + 200] ^= 0xFF
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    summary = summarise(hurt)
    assert summary.verdict == "damaged"
    assert summary.seconds_lost == pytest.approx(summary.ticks_missed * 0.02, abs=0.021)
    assert summary.rows + summary.ticks_missed * 3 == pytest.approx(len(rows), abs=3)
    assert "byte" in summary.problems[0]


def test_a_zeroed_stretch_costs_no_more_than_the_chunks_it_touches(
    whole: tuple[Path, list[Rows]], tmp_path: Path
) -> None:
    path, rows = whole
    data = bytearray(path.read_bytes())
    marks = [i for i in range(len(data)) if data[i : i + 4] == b"zstd"]
    data[marks[1] - 20 : marks[1] + 4000] = bytes(4020)
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    found = list(read_rows(hurt))
    assert found[-1] == rows[-1]
    assert summarise(hurt).verdict == "damaged"


def test_recover_writes_what_can_be_read(whole: tuple[Path, list[Rows]], tmp_path: Path) -> None:
    path, rows = whole
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:80_000])
    summary = recover(cut, tmp_path / "saved.mcap")
    assert summary.verdict == "truncated"
    saved = summarise(tmp_path / "saved.mcap")
    assert (saved.verdict, saved.rows) == ("complete", summary.rows)
    assert list(read_rows(tmp_path / "saved.mcap")) == rows[: saved.rows]
    assert metadata(tmp_path / "saved.mcap").about.notes["recovered_from"] == "cut.mcap"
    with pytest.raises(LogError, match="exists already"):
        recover(cut, tmp_path / "saved.mcap")


def test_recover_fails_if_what_it_wrote_does_not_read_back(
    whole: tuple[Path, list[Rows]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = PartWriter._write

    def spoil(self: PartWriter, data: bytes) -> None:
        real(self, data.replace(b"zstd", b"zstx"))

    monkeypatch.setattr(PartWriter, "_write", spoil)
    with pytest.raises(LogError, match="does not read back"):
        recover(whole[0], tmp_path / "saved.mcap")
    assert not (tmp_path / "saved.mcap").exists()


def test_what_is_no_recording_is_a_short_error(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file"):
        metadata(tmp_path / "none.mcap")
    text = tmp_path / "notes.mcap"
    text.write_text("time [s],q [deg/s]\n")
    with pytest.raises(LogError, match="not an MCAP file"):
        summarise(text)
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"")
    with pytest.raises(LogError, match="cut or damaged before its profiles end"):
        summarise(empty)
    with pytest.raises(LogError):
        recover(empty, tmp_path / "out.mcap")
    foreign = tmp_path / "foreign.mcap"
    part = PartWriter(foreign, Disk(ManualClock()), {}, {})
    part.finish()
    with pytest.raises(LogError, match="not of this station"):
        summarise(foreign)


def test_kinds_left_out_are_not_read(whole: tuple[Path, list[Rows]]) -> None:
    path, rows = whole
    assert list(read_rows(path, (Tick,))) == [r for r in rows if isinstance(r, Tick)]
    assert list(read_rows(path, (Frame,))) == []


def test_the_checksum_of_the_data_is_what_the_format_says(whole: tuple[Path, list[Rows]]) -> None:
    data = whole[0].read_bytes()
    footer = len(data) - 8 - 29
    summary_start = int.from_bytes(data[footer + 9 : footer + 17], "little")
    data_end = summary_start - 13
    assert data[data_end] == 0x0F
    assert int.from_bytes(data[data_end + 9 : data_end + 13], "little") == zlib.crc32(data[:data_end])
