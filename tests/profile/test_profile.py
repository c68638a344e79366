"""Profiles: what is shipped loads; what is wrong is said with file, key and the nearest valid key."""

import math

import pytest

from station.profile import (
    Aircraft,
    Card,
    Channel,
    Rig,
    from_json,
    load_aircraft,
    load_card,
    load_rig,
    profiles_dir,
    to_json,
)
from station.rows import ProfileError

SHIPPED = profiles_dir()


@pytest.mark.parametrize("path", sorted((SHIPPED / "cards").glob("*.toml")), ids=lambda p: p.stem)
def test_every_shipped_card_loads(path):
    profiles = load_card(path.stem)
    assert profiles.card.name == path.stem


@pytest.mark.parametrize("path", sorted((SHIPPED / "aircraft").glob("*.toml")), ids=lambda p: p.stem)
def test_an_aircraft_survives_the_recording(path):
    aircraft = load_aircraft(path.stem)
    assert from_json(Aircraft, to_json(aircraft)) == aircraft


@pytest.mark.parametrize("path", sorted((SHIPPED / "rigs").glob("*.toml")), ids=lambda p: p.stem)
def test_a_rig_survives_the_recording(path):
    rig = load_rig(path.stem)
    assert from_json(Rig, to_json(rig)) == rig


def test_a_card_survives_the_recording():
    card = load_card("bench").card
    assert from_json(Card, to_json(card)) == card


def test_twin_otter_in_si():
    """340 slug, 24,640 slug ft2, 420 ft2 (Martos 2013; conversions of NIST SP 811)."""
    aircraft = load_aircraft("twin_otter")
    assert aircraft.inertia.mass == pytest.approx(4961.93, abs=0.01)
    assert aircraft.inertia.iyy == pytest.approx(33407.4, abs=0.5)
    assert aircraft.geometry.wing_area == pytest.approx(39.0193, abs=1e-4)
    assert aircraft.boom is not None
    assert aircraft.boom.steady_calibration == pytest.approx(0.85, abs=5e-4)


def test_calibration_there_and_back():
    linear = Channel(field="v0", unit="deg", slope=0.005, zero=12.0)
    assert linear.to_si(2012.0) == pytest.approx(math.radians(10.0))
    assert linear.from_si(math.radians(10.0)) == pytest.approx(2012.0)
    pot = Channel(field="v1", unit="deg", table=((0.0, -20.0), (500.0, 0.0), (900.0, 25.0)))
    assert pot.to_si(700.0) == pytest.approx(math.radians(12.5))
    assert pot.to_si(1000.0) == pytest.approx(math.radians(31.25))  # the last slope goes on
    assert pot.from_si(math.radians(12.5)) == pytest.approx(700.0)
    falling = Channel(field="v1", unit="deg", table=((0.0, 20.0), (1000.0, -20.0)))
    assert falling.from_si(falling.to_si(250.0)) == pytest.approx(250.0)


AIRCRAFT = (SHIPPED / "aircraft" / "twin_otter.toml").read_text()
RIG = """
name = "r"
[[devices]]
name = "boom"
link = "serial"
protocol = "boombox"
port = "/dev/null"
  [[devices.streams]]
  name = "vanes"
  message = 1
  rate = "200 Hz"
  signals.alpha_vane = { field = "v0", unit = "deg", slope = 0.005 }
"""


def message(tmp_path, load, text):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ProfileError) as caught:
        load(str(path))
    words = str(caught.value)
    assert str(path) in words
    assert len(words.splitlines()) <= 3
    return words


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('chord = "6.5 ft"', 'chrod = "6.5 ft"', "did you mean chord?"),
        ('chord = "6.5 ft"', "chord = 6.5", 'missing unit: write "6.5 m"'),
        ('chord = "6.5 ft"', 'chord = "6.5"', "missing unit"),
        ("CL_alpha = { value = 5.66, sd = 0.57 }", "CL_alpha = 5.66", "write { value = 5.66 }"),
        ('chord = "6.5 ft"', 'chord = "6.5 kg"', "does not fit here"),
        ('chord = "6.5 ft"', 'chord = "long"', "not a number"),
        ('chord = "6.5 ft"', 'chord = "-6.5 ft"', "greater than 0"),
        ('chord = "6.5 ft"', "chord = true", "a number and its unit"),
        ('chord = "6.5 ft"', "", "geometry.chord: missing key"),
        ("CL_alpha = {", "CL_alhpa = {", "did you mean CL_alpha?"),
        ("CL_alpha = {", "Cm_alphadot = { value = -5.2 }\nCL_alpha = {", "[unsteady] describes the tail"),
        ("upwash_body = 0.070", "upwash_body = 7.0", "upwash_body"),
        ('time_constant = "0.08 s"', 'time_constant = "0 s"', "elevator.time_constant: input should be greater than 0"),
        *(
            (
                "memory = true",
                f"memory = true\n{share} = -0.5",
                f"unsteady.{share}: input should be greater than or equal",
            )
            for share in ("turned_at_once", "gust_speed", "tail_speed", "speed_gusts", "convection")
        ),
        ("[geometry]", "[geometry", "not valid TOML"),
        ('name = "twin_otter"', "name = 3", "name"),
    ],
)
def test_a_bad_aircraft_is_told_plainly(tmp_path, old, new, expected):
    assert old in AIRCRAFT
    assert expected in message(tmp_path, load_aircraft, AIRCRAFT.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('link = "serial"', 'link = "smoke"', "link"),
        ("signals.alpha_vane", "signals.alpha_vain", "did you mean alpha_vane?"),
        ('unit = "deg"', 'unit = "kt"', "does not fit"),
        ('unit = "deg"', 'unit = "dge"', "did you mean deg?"),
        ("slope = 0.005", "slope = 0", "slope must not be 0"),
        ('protocol = "boombox"', "protocol = 3", "protocol: input should be a valid string"),
    ],
)
def test_a_bad_rig_is_told_plainly(tmp_path, old, new, expected):
    assert old in RIG
    assert expected in message(tmp_path, load_rig, RIG.replace(old, new, 1))


def test_two_devices_claiming_one_signal(tmp_path):
    second = RIG.split("[[devices]]")[1].replace('"boom"', '"other"')
    words = message(tmp_path, load_rig, RIG + "[[devices]]" + second)
    assert "alpha_vane is claimed by boom.vanes and by other.vanes" in words


def test_a_card_naming_a_signal_that_no_device_gives(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    words = message(
        tmp_path, load_card, 'name = "c"\naircraft = "twin_otter"\nrig = "rig.toml"\nneeds = ["alpha_vane", "q"]\n'
    )
    assert "no device of rig r gives q" in words


def test_unknown_card_lists_the_known_ones():
    with pytest.raises(ProfileError, match=r"no card named bensh; did you mean bench\?\nknown: .*bench"):
        load_card("bensh")


def test_a_fault_of_an_unknown_device(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    text = 'name = "c"\naircraft = "twin_otter"\nrig = "rig.toml"\nneeds = []\n[[faults]]\ndevice = "bom"\n'
    text += 'kind = "off"\nstart = "1 s"\nduration = "1 s"\n'
    assert "did you mean boom?" in message(tmp_path, load_card, text)


@pytest.mark.parametrize(
    ("signal", "expected"), [('signal = "alpha_van"\n', "did you mean alpha_vane?"), ("", "which signal")]
)
def test_a_wrong_value_of_a_signal_that_the_device_does_not_give(tmp_path, signal, expected):
    (tmp_path / "rig.toml").write_text(RIG)
    text = 'name = "c"\naircraft = "twin_otter"\nrig = "rig.toml"\nneeds = []\n[[faults]]\ndevice = "boom"\n'
    text += f'kind = "wrong"\nstart = "1 s"\nduration = "1 s"\nvalue = 0.1\n{signal}'
    words = message(tmp_path, load_card, text)
    assert "faults[0].signal" in words
    assert expected in words
