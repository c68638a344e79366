"""Every row comes back from a recording as it went in, to the last bit."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from station.conventions import SIGNALS, Stream
from station.log import About, metadata, read_rows, write_log
from station.profile import load_aircraft
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Extra,
    Frame,
    Health,
    MethodEstimate,
    ParamEstimate,
    Quality,
    RawBlock,
    Rows,
    Sample,
    Status,
    StreamHealth,
    Tick,
    TimeSync,
    Truth,
)

STREAM = Stream("boom.vanes", ("alpha_vane", "beta_vane"), 200.0, 0.1, "boom", 0.003)
N = len(SIGNALS)

floats = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
finite = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=20)
times = st.integers(-(10**9), 2**62)
whole = st.integers(0, 2**40)


def bits(value: Any) -> Any:
    """The value with each float as its bits, so that NaN equals NaN and -0.0 differs from 0.0."""
    if isinstance(value, float):
        return "NaN" if math.isnan(value) else struct.pack("<d", value)
    if isinstance(value, msgspec.Struct):
        return (type(value).__name__, *(bits(getattr(value, f)) for f in value.__struct_fields__))
    if isinstance(value, tuple):
        return tuple(bits(v) for v in value)
    if isinstance(value, dict):
        return {k: bits(v) for k, v in value.items()}
    return (type(value).__name__, value)


names = st.sampled_from(["CL_alpha", "Cm_q"])
parameter = st.builds(ParamEstimate, names, floats, floats, st.sampled_from(Status), texts)
stream_health = st.builds(
    StreamHealth, texts, texts, floats, floats, texts, floats, floats, whole, whole, whole, st.booleans()
)
rows = st.one_of(
    st.builds(RawBlock, st.integers(0, 2**62), st.sampled_from(["boom", "can"]), st.binary(max_size=100)),
    st.builds(
        Sample,
        times,
        st.just("boom.vanes"),
        st.none() | st.integers(-(2**62), 2**62),
        st.none() | whole,
        st.tuples(floats, floats),
        st.sampled_from(Quality),
    ),
    st.builds(Sample, times, st.just("boom.vanes"), st.none(), st.none(), st.tuples(floats, floats, floats)),
    st.builds(Event, times, texts, st.sampled_from(Code), whole, texts),
    st.builds(TimeSync, times, texts, times, times),
    st.builds(Tick, times, whole, times),
    st.builds(
        Frame,
        times,
        whole,
        st.tuples(*[floats] * N),
        st.tuples(*[floats] * N),
        st.tuples(*[st.integers(0, 3)] * N),
    ),
    st.builds(AlphaEstimate, times, *[floats] * 12, texts, *[floats] * 3, st.booleans(), texts),
    st.builds(
        MethodEstimate,
        times,
        st.sampled_from(["II", "split+gust"]),
        st.lists(parameter, max_size=2, unique_by=lambda p: p.name).map(tuple),
        st.booleans(),
        texts,
    ),
    st.builds(Health, times, st.lists(stream_health, max_size=2).map(tuple), whole, whole),
    st.builds(Truth, times, st.dictionaries(texts, floats, max_size=3)),
    st.builds(Extra, times, st.dictionaries(texts, floats, max_size=3)),
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(written=st.lists(rows, min_size=1, max_size=8))
def test_rows_come_back_bit_for_bit_and_in_order(tmp_path: Path, written: list[Rows]) -> None:
    path = tmp_path / "flight.mcap"
    path.unlink(missing_ok=True)
    write_log(path, About(load_aircraft("twin_otter"), (STREAM,)), written)
    assert [bits(r) for r in read_rows(path)] == [bits(r) for r in written]


@settings(max_examples=300, deadline=None)
@given(pattern=st.integers(0, 2**64 - 1))
def test_any_bit_pattern_of_a_double_survives(pattern: int) -> None:
    (value,) = struct.unpack("<d", struct.pack("<Q", pattern))
    from station.log.messages import RowWriter, read_row

    topic, data = RowWriter((STREAM,)).message(Sample(1, "boom.vanes", 2, 3, (value, 0.0)))
    back = read_row("Sample", topic.about["key"], 1, data)
    assert bits(back) == bits(Sample(1, "boom.vanes", 2, 3, (value, 0.0)))


def test_numpy_scalars_are_recorded_as_numbers(tmp_path: Path) -> None:
    values = (np.float64(0.1), np.float32(0.5))
    write_log(
        tmp_path / "a.mcap",
        About(load_aircraft("twin_otter"), (STREAM,)),
        [Sample(1, "boom.vanes", None, None, values)],  # type: ignore[arg-type]
    )
    (row,) = read_rows(tmp_path / "a.mcap")
    assert isinstance(row, Sample)
    assert row.values == (0.1, 0.5)


def test_profiles_and_streams_come_back(tmp_path: Path) -> None:
    aircraft = load_aircraft("twin_otter")
    about = About(aircraft, (STREAM,), source="simulation", notes={"seed": "7"}, files={"bench.dbc": b"\x00VERSION"})
    write_log(tmp_path / "a.mcap", about, [Tick(1, 0, 0)], station_ns=5, utc_ns=17)
    info = metadata(tmp_path / "a.mcap")
    assert info.aircraft == aircraft
    assert info.streams == (STREAM,)
    assert info.about.notes == {"seed": "7"}
    assert info.about.files == {"bench.dbc": b"\x00VERSION"}
    assert (info.station_ns, info.utc_ns, info.about.source, info.about.imported) == (5, 17, "simulation", False)
