"""The shipped rigs are served by the shipped codecs, and a rig that is not is refused before flight."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pytest

from drivers.adapter import check_devices
from drivers.can_dbc import load_dbc
from station.conventions import SIGNALS
from station.profile import CanDevice, Card, Rig, from_json, load_rig, profiles_dir
from station.rows import ProfileError

RIGS = profiles_dir() / "rigs"
NAMES = ("bench", "boom_serial", "can_only", "mavlink_only", "mixed", "vectornav", "dronecan", "five_hole")


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_rig_gives_what_a_card_needs_and_its_codecs_know_it(name: str) -> None:
    rig = load_rig(name)
    check_devices(rig, RIGS / f"{name}.toml")
    assert rig.name == name
    given = {signal for stream in rig.streams() for signal in stream.signals}
    assert given >= set(Card.model_fields["needs"].default)


def test_each_kind_of_link_is_in_a_rig_and_bench_has_all_three() -> None:
    assert {d.link for d in load_rig("bench").devices} == {"serial", "can", "mavlink"}
    protocols = {getattr(d, "protocol", d.link) for name in NAMES for d in load_rig(name).devices}
    assert protocols == {"boombox", "boombox_ascii", "ubx", "nmea", "lines", "vectornav", "can", "dronecan", "mavlink"}


def test_vane_and_elevator_of_the_bench_share_a_packet() -> None:
    (stream,) = [s for s in load_rig("bench").streams() if "alpha_vane" in s.signals]
    assert "elevator" in stream.signals


@pytest.mark.parametrize("name", NAMES)
def test_int16_counts_carry_every_value_of_normal_flight(name: str) -> None:
    """Ranges of a Twin Otter's flight test, well inside what a signal can be."""
    flown = {
        **dict.fromkeys(("alpha_vane", "beta_vane", "elevator", "aileron", "rudder"), math.radians(25)),
        **dict.fromkeys(("p", "q", "r"), math.radians(90)),
        **dict.fromkeys(("ax", "ay", "az"), 35.0),
        **dict.fromkeys(("phi", "psi"), math.pi),
        "theta": math.radians(60),
        "airspeed": 150.0,
        "dynamic_pressure": 13_000.0,
        "static_pressure": 108_000.0,
        "air_temperature": 325.0,
    }
    for device in load_rig(name).devices:
        if getattr(device, "protocol", "").startswith("boombox"):
            channels = [(n, c) for s in device.streams for n, c in s.signals.items()]
            for signal, channel in channels:
                for value in (flown[signal], max(SIGNALS[signal].low, -flown[signal])):
                    assert abs(channel.from_si(value)) <= 32767, signal


def test_the_frames_of_the_bench_bus_carry_every_value_of_normal_flight() -> None:
    flown = {"p": 90, "q": 90, "r": 90, "ax": 3.6, "ay": 3.6, "az": 3.6, "alpha": 30, "beta": 30, "elevator": 30}
    for message in load_dbc(RIGS / "bench.dbc").values():
        assert (message.wrap_ns, message.seq_wrap, message.checksum_byte) == (1_638_400_000, 16, 7)
        for signal in message.definition.signals:
            if signal.name in flown:
                assert signal.minimum < -flown[signal.name] < flown[signal.name] < signal.maximum


def altered(name: str, device: int, **changes: Any) -> Rig:
    """A shipped rig with changes to the first stream of one device, or to the device itself."""
    raw = load_rig(name).model_dump()
    target = raw["devices"][device]
    for key, value in changes.items():
        if key in target:
            target[key] = value
        elif key == "message":
            target["streams"][0]["message"] = value
        else:
            next(iter(target["streams"][0]["signals"].values()))[key] = value
    return from_json(Rig, json.dumps(raw))


def refusal(rig: Rig, rig_dir: Path = RIGS) -> str:
    with pytest.raises(ProfileError) as caught:
        check_devices(rig, rig_dir / "rig.toml")
    text = str(caught.value)
    assert text.startswith(f"{rig_dir / 'rig.toml'}: device ")
    assert 1 <= len(text.splitlines()) <= 3
    return text


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (
            altered("can_only", 0, message="VANE"),
            ("bench.dbc", "device can, stream vanes, message:", "VANE", "mean VANES?"),
        ),
        (altered("can_only", 0, field="alfa"), ("bench.dbc", "vanes, alpha_vane:", "VANES", "alfa", "mean alpha?")),
        (altered("can_only", 0, unit="mrad"), ("bench.dbc", "alpha_vane", "in deg, not mrad", "slope")),
        (altered("can_only", 0, dbc="missing.dbc"), ("missing.dbc", "No such file")),
        (altered("bench", 0, message=300), ("device boom, stream vanes, message:", "0 to 255")),
        (altered("bench", 0, message="vanes"), ("device boom, stream vanes, message:", "0 to 255")),
        (altered("bench", 0, field="w0"), ("device boom", "alpha_vane", "w0", "did you mean v0?")),
        (altered("boom_serial", 1, message="NAV-PVTT"), ("device gnss", "NAV-PVTT", "did you mean NAV-PVT?")),
        (altered("boom_serial", 1, field="latt"), ("device gnss", "latitude", "latt", "did you mean lat?")),
        (altered("mixed", 2, message="GSV"), ("device gnss", "GSV", "GGA, RMC, VTG")),
        (altered("mixed", 2, field="speed"), ("device gnss", "v_north", "speed")),
        (altered("bench", 2, message="ATITUDE"), ("device autopilot", "ATITUDE", "did you mean ATTITUDE?")),
        (altered("bench", 2, signing_key_file="missing.key"), ("autopilot", "missing.key", "No such file")),
        (altered("bench", 2, field="rol"), ("device autopilot", "phi", "did you mean roll?")),
    ],
)
def test_what_no_codec_knows_is_refused_with_its_key(rig: Rig, words: tuple[str, ...]) -> None:
    text = refusal(rig)
    for word in words:
        assert word in text


CHECKSUM_ACROSS_BYTES = """VERSION ""
BU_: A
BO_ 1 VANES: 8 A
 SG_ alpha : 0|14@1- (0.005,0) [0|0] "deg" A
 SG_ beta : 14|14@1- (0.005,0) [0|0] "deg" A
 SG_ checksum : 50|8@1+ (1,0) [0|255] "" A
"""
OVERLAP = """VERSION ""
BU_: A
BO_ 1 VANES: 8 A
 SG_ alpha : 0|14@1- (0.005,0) [0|0] "deg" A
 SG_ beta : 4|14@1- (0.005,0) [0|0] "deg" A
"""


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"not a DBC", "not a usable DBC"),
        (bytes(range(256)), "not a usable DBC"),
        (b"", "not a usable DBC"),
        (CHECKSUM_ACROSS_BYTES.encode(), "VANES.checksum: must be one whole byte"),
        (OVERLAP.encode(), "not a usable DBC"),
    ],
    ids=["text", "bytes", "empty", "checksum", "overlap"],
)
def test_a_wrong_dbc_is_refused_by_name(tmp_path: Path, content: bytes, word: str) -> None:
    (tmp_path / "bench.dbc").write_bytes(content)
    text = refusal(load_rig("can_only"), tmp_path)
    assert str(tmp_path / "bench.dbc") in text
    assert word in text


def test_the_dbc_lies_beside_the_rig(tmp_path: Path) -> None:
    shutil.copy(RIGS / "bench.dbc", tmp_path / "mine.dbc")
    device = load_rig("can_only").devices[0]
    assert isinstance(device, CanDevice)
    check_devices(Rig(name="r", devices=(device.model_copy(update={"dbc": "mine.dbc"}),)), tmp_path / "rig.toml")
