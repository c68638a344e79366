"""A protocol is one row: what is known of each, a device added as the README adds one, and one that nobody knows."""

from __future__ import annotations

import importlib
import math
import re
import sys
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drivers
from drivers.adapter import check_devices, open_devices
from drivers.codec import Reading
from drivers.emulation import serve
from drivers.faults import FAULTS
from drivers.protocols import GROUP, PROTOCOLS, protocol_named
from station.clock import SystemClock
from station.profile import Card, Fault, Profiles, Rig, load_aircraft, read_profile
from station.rows import ProfileError, RawBlock, Rows, Sample

README = (Path(drivers.__file__).parent / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(python|toml)\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
(_, CODE), (_, ENTRY_POINT), (_, DEVICE) = BLOCKS
SERVED_WITHIN_S = 60.0


def test_every_kind_of_fault_that_a_card_may_name_is_a_row() -> None:
    assert tuple(FAULTS) == Fault.model_fields["kind"].annotation.__args__


finite = st.floats(-2e4, 2e4).map(round)
READINGS = {
    "boombox": st.builds(
        Reading, st.integers(0, 255), st.integers(0, 2**32 - 1).map(lambda us: us * 1000), st.integers(0, 255),
        st.lists(finite, min_size=1, max_size=100).map(lambda v: {f"v{i}": float(x) for i, x in enumerate(v)}),
    ),
    "ubx": st.builds(
        Reading, st.just("NAV-PVT"), st.integers(0, 604_799_999).map(lambda ms: ms * 10**6), st.none(),
        st.fixed_dictionaries({"velN": finite, "velE": finite, "velD": finite}),
    ),
    "nmea": st.builds(
        Reading, st.just("GGA"), st.integers(0, 86_399).map(lambda s: s * 10**9), st.none(),
        st.fixed_dictionaries({"lat": st.integers(-89, 89), "lon": st.integers(-179, 179), "alt": finite}),
    ),
    "lines": st.builds(
        Reading, st.sampled_from(("line", "aoa", "AIN_3")), st.none(), st.none(),
        st.lists(finite, min_size=1, max_size=60).map(lambda v: {f"c{i}": float(x) for i, x in enumerate(v)}),
    ),
    "vectornav": st.builds(
        Reading, st.just("INS"), st.integers(0, 2**63), st.none(),
        st.fixed_dictionaries({"PosLla.latitude": finite, "VelNed.north": finite, "VelNed.down": finite}),
    ),
    "msp": st.builds(
        Reading, st.just("AOA"), st.none(), st.none(),
        st.fixed_dictionaries({"aoa": st.integers(-900, 900).map(lambda n: n / 10), "sideslip": st.just(0.0)}),
    ),
}  # fmt: skip
READINGS["boombox_ascii"] = READINGS["boombox"]


@pytest.mark.parametrize("name", PROTOCOLS)
@given(data=st.data())
def test_the_encoder_of_a_row_is_its_codecs_inverse(name: str, data: st.DataObject) -> None:
    row, sent = protocol_named(name), data.draw(READINGS[name])
    codec = row.codec()
    codec.feed(row.encode(sent))  # of lines without a checksum the first is not trusted
    (read,) = codec.feed(row.encode(sent))
    assert isinstance(read, Reading)
    assert (read.message, read.t_device_ns) == (sent.message, sent.t_device_ns)
    assert sent.seq is None or read.seq == sent.seq
    for field, value in sent.fields.items():
        assert read.fields[field] == pytest.approx(value, abs=1e-6)
    assert set(read.fields) <= set(row.fields[read.message])


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_field_without_a_reading_reads_as_none(name: str) -> None:
    row = protocol_named(name)
    message, fields = next(iter(row.fields.items()))
    sent = Reading(message, 10**9, 0, dict.fromkeys(fields[:3], math.nan))
    for reading in row.codec().feed(2 * row.encode(sent)):
        assert isinstance(reading, Reading)
        assert all(math.isnan(reading.fields.get(field, math.nan)) for field in fields[:3])


@pytest.fixture
def potbox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The README's package, installed as pip would: found by this process and by those it starts."""
    (tmp_path / "potbox.py").write_text(CODE)
    about = tmp_path / "potbox-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: potbox\nVersion: 1.0\n")
    (points,) = tomllib.loads(ENTRY_POINT)["project"]["entry-points"].values()
    lines = "".join(f"{name} = {place}\n" for name, place in points.items())
    (about / "entry_points.txt").write_text(f"[{GROUP}]\n{lines}")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield tmp_path
    sys.modules.pop("potbox", None)


def profiles(folder: Path, device: str = DEVICE) -> Profiles:
    """A rig of the README's device alone, in a file."""
    path = folder / "rig.toml"
    path.write_text(f'name = "pots"\n\n{device}')
    flight = {"source": "recording"}
    card = Card.model_validate(
        {"name": "c", "aircraft": "twin_otter", "rig": "pots", "needs": [], "emulate": True, "flight": flight}
    )
    return Profiles(aircraft=load_aircraft("twin_otter"), rig=read_profile(Rig, path), card=card, rig_file=path)


def test_the_readmes_ten_lines_add_a_device_that_is_emulated_and_read_over_a_terminal(potbox: Path) -> None:
    flown = profiles(potbox)
    check_devices(flown.rig, flown.rig_file)
    time = np.arange(0.0, 30.0, 0.02)
    elevator = 0.1 * np.sin(2 * np.pi * 0.5 * time)
    rows: list[Rows] = []
    told: list[dict[str, object]] = []
    begun, enough, stop = threading.Event(), threading.Event(), threading.Event()

    def announce(line: dict[str, object]) -> None:
        told.append(line)
        if "start_ns" in line:
            begun.set()

    def put(row: Rows) -> None:
        rows.append(row)
        if sum(isinstance(r, Sample) for r in rows) >= 50:
            enough.set()

    record = {"time": time, "elevator": elevator}
    serving = threading.Thread(target=serve, args=(flown, announce, stop, SystemClock(), record))
    serving.start()
    try:
        assert begun.wait(SERVED_WITHIN_S)
        endpoints = {str(line["device"]): str(line["endpoint"]) for line in told if "device" in line}
        (adapter,) = open_devices(flown.rig, endpoints, potbox, SystemClock(), put)
        adapter.start()
        assert enough.wait(SERVED_WITHIN_S)
        adapter.stop()
    finally:
        stop.set()
        serving.join(SERVED_WITHIN_S)
    samples = [row for row in rows if isinstance(row, Sample)]
    assert {s.stream for s in samples} == {"pots.elevator"}
    values = np.array([s.values[0] for s in samples])
    step = math.radians(0.01)  # a count
    # From one message to the next a sine of 0.1 rad and 0.5 Hz moves by less than 0.0032 rad.
    assert np.all(np.abs(np.diff(values)) < 0.1 * 2 * np.pi * 0.5 * 0.01 + step)
    assert np.ptp(values) > 0.01
    assert np.all(np.abs(values) < 0.1 + step)
    raw = b"".join(row.data for row in rows if isinstance(row, RawBlock))
    assert len(re.findall(rb"^elevator \d+$", raw, re.MULTILINE)) >= len(samples)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('protocol = "potbox"', 'protocol = "potbx"', ("protocol: unknown protocol potbx; did you mean potbox?",)),
        ('protocol = "potbox"', 'protocol = "bombox"', ("did you mean boombox?", "known: boombox, boombox_ascii, ubx")),
        ('field = "count"', 'field = "counts"', ("stream elevator, elevator:", "no field counts; did you mean count?")),
        ('message = "elevator"', 'message = "aileron"', ("no message 'aileron'", "use one of elevator")),
    ],
)
def test_what_no_row_knows_is_refused_with_file_and_key(
    potbox: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    assert old in DEVICE
    flown = profiles(potbox, DEVICE.replace(old, new))
    with pytest.raises(ProfileError) as caught:
        check_devices(flown.rig, flown.rig_file)
    text = str(caught.value)
    assert text.startswith(f"{flown.rig_file}: device pots, ")
    assert len(text.splitlines()) <= 3
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("raise OSError('broken')", "cannot be loaded: broken"),
        ("POTBOX = 3", "is no drivers.protocols.Protocol"),
    ],
)
def test_a_package_that_cannot_be_used_is_named(potbox: Path, code: str, why: str) -> None:
    (potbox / "potbox.py").write_text(code)
    with pytest.raises(ProfileError, match=why) as caught:
        protocol_named("potbox")
    assert "potbox:POTBOX" in str(caught.value)


def test_a_package_cannot_take_a_name_of_the_stations_own(potbox: Path) -> None:
    (potbox / "potbox-1.0.dist-info" / "entry_points.txt").write_text(f"[{GROUP}]\nboombox = potbox:POTBOX\n")
    assert "boom box" in protocol_named("boombox").sentence


def test_the_usual_baud_is_the_protocols_and_the_rigs_goes_before_it(
    potbox: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (potbox / "potbox.py").write_text(CODE.replace('["count"]}, encode)', '["count"]}, encode, 9600)'))
    opened: list[int] = []
    tried = threading.Event()

    def open_port(_: str, baud: int) -> None:
        opened.append(baud)
        tried.set()
        raise OSError("not there")

    monkeypatch.setattr("drivers.serial_port.open_port", open_port)
    for device, expected in ((DEVICE, 57_600), (DEVICE.replace("baud = 57600\n", ""), 9_600)):
        opened.clear()
        tried.clear()
        rig = profiles(potbox, device).rig
        (adapter,) = open_devices(rig, {"pots": "nowhere"}, potbox, SystemClock(), lambda row: None)
        adapter.start()
        assert tried.wait(10.0)
        adapter.stop()
        assert set(opened) == {expected}
