"""Forced and gust-only parts apart, each with its own delay, by signals whose delay and gain are known; and what is
said where there is nothing to be seen."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from records import record as published
from scipy.signal import lfilter

from station.convert.fdata import read_fdata
from station.estimation.flight_record import FlightRecord
from station.identification.flown_inputs import DIES_AWAY_S, inputs_of
from station.identification.spectra_pages import spectra_pages
from station.identification.vane_spectra import parts, vane_density
from station.numerics.regression import NotIdentifiable
from station.numerics.thin_aerofoil import sears_magnitude, theodorsen
from station.profile import Aircraft, Boom, Geometry, Inertia, load_aircraft

DT, SPEED, BLOCK_S = 0.02, 60.0, 30.0
LATE_S, SLOPE = 0.085, 4.5
"""Of the lift behind the vane in gusts, and lift by angle."""
UPWASH, ASPECT, FORCE, MASS = 0.1765, 10.05, 2000.0 * 39, 4950.0
BOOM = Boom.model_validate({
    "vane_x": "5.3 m", "upwash_body": UPWASH, "upwash_wing": 0.0, "vane_frequency": "9 Hz", "vane_damping": 0.35,
})  # fmt: skip


def record(seconds: float = 300.0, *, boom: Boom | None = BOOM, elevator: str = "every other block") -> FlightRecord:
    """Lift that follows the vane at once in blocks in which the elevator is flown, and LATE_S later in others."""
    rng = np.random.default_rng(4)
    n = round(seconds / DT)
    t = np.arange(n) * DT
    pole = math.exp(-2 * math.pi * 0.3 * DT)
    angle = 0.02 * math.sqrt(1 - pole**2) * lfilter([1.0], [1.0, -pole], rng.normal(size=n))
    spectrum, f = np.fft.rfft(angle), np.fft.rfftfreq(n, DT)
    late = np.fft.irfft(spectrum * np.exp(-2j * np.pi * f * LATE_S), n)
    flown = (t // BLOCK_S) % 2 == 1
    is_flown = {"every other block": flown, "always": np.full(n, True), "never": np.full(n, False)}[elevator]
    after = np.convolve(is_flown, np.ones(round(DIES_AWAY_S / DT)))[:n] > 0
    lift = 0.6 + SLOPE * np.where(after, angle, late) + 0.002 * rng.normal(size=n)
    scale = 1.0 / (1.0 + UPWASH)
    alpha = angle * scale if boom else angle
    columns = {
        "alpha_vane": angle,
        "airspeed": np.full(n, SPEED),
        "dynamic_pressure": np.full(n, 2000.0),
        "q": np.zeros(n),
        "ax": lift * np.sin(alpha) * FORCE / MASS,
        "az": -lift * np.cos(alpha) * FORCE / MASS,
        "thrust": np.zeros(n),
        "elevator": np.where(is_flown, 0.02 * np.sign(np.sin(2 * np.pi * 0.5 * t)), 0.0) + 1e-5 * rng.normal(size=n),
    }
    aircraft = Aircraft(
        name="t",
        geometry=Geometry.model_validate({"wing_area": "39 m2", "span": f"{math.sqrt(39 * ASPECT)} m", "chord": "2 m"}),
        inertia=Inertia.model_validate({"mass": f"{MASS} kg", "iyy": "33000 kg m2"}),
        boom=boom,
    )
    return FlightRecord.of(t, columns, aircraft)


def text_of(pages: list[str]) -> str:
    return re.sub(r'src="[^"]*"|<[^>]*>', " ", " ".join(pages))


def test_each_part_has_its_own_delay_and_the_response_that_follows() -> None:
    forced, gusts = parts(record())
    assert (forced.name, gusts.name) == ("forced", "gusts alone")
    assert forced.seconds + gusts.seconds == pytest.approx(300.0, abs=0.1)
    ratio = UPWASH * (ASPECT + 2) / ASPECT / (2 * math.pi)
    for part, late in ((forced, 0.0), (gusts, LATE_S)):
        s = part.spectra
        assert s is not None
        band = s.believed & (s.frequencies_hz < 4.0)
        assert band.sum() >= 8
        away = (s.delay_s[band] - late) / np.maximum(s.delay_sd[band], 1e-4)
        # Normal numbers, one a bin: the mean of their squares is below 3 in far more than 999 of 1000.
        assert np.mean(away**2) < 3.0, away
        response = SLOPE * np.exp(-2j * np.pi * s.frequencies_hz * late)
        sears = np.abs(response / (2 * math.pi * (1 - response * ratio)))
        off = (s.sears - sears)[band] / np.maximum(s.sears_sd[band], 2e-3)
        assert np.mean(off**2) < 3.0, off


def test_inputs_are_found_where_the_elevator_was_flown() -> None:
    begins = [i.start_s for i in inputs_of(record())]
    np.testing.assert_allclose(begins, np.arange(BLOCK_S, 300.0, 2 * BLOCK_S), atol=0.1)


def test_published_values_of_theodorsen_and_sears() -> None:
    """C(k) of NACA report 496, table II; S by Sears 1941 at k = 0.109 and 0.547."""
    k = np.array([0.1, 0.5, 1.0])
    assert theodorsen(k) == pytest.approx([0.8320 - 0.1723j, 0.5979 - 0.1507j, 0.5394 - 0.1003j], abs=2e-4)
    assert sears_magnitude(np.array([0.109, 0.547])) == pytest.approx([0.824, 0.508], abs=0.0015)


def test_the_pages_show_both_parts_and_say_how_much_there_was() -> None:
    pages = spectra_pages(record())
    assert sum(p.startswith("<img") for p in pages) == 2
    text = text_of(pages)
    assert re.search(r"Forced: \d+ s, \d+ segments of \d+ s\. Gusts alone: \d+ s, \d+ segments of \d+ s\.", text)
    assert "95 % by chi-squared" in text


@pytest.mark.parametrize(
    ("made", "says", "pictures"),
    [
        ({"seconds": 10.0}, ["too short", "The vane's own spectrum"], 0),
        ({"boom": None}, ["the aircraft profile has no boom"], 1),
        ({"elevator": "never"}, ["Forced: the elevator rests throughout", "Gusts alone: 300 s"], 2),
        ({"elevator": "always"}, ["Gusts alone: the elevator hardly rests: 0 s, 0 of 7", "Forced: 300 s"], 2),
    ],
)
def test_what_cannot_be_seen_is_said(made: dict[str, Any], says: list[str], pictures: int) -> None:
    pages = spectra_pages(record(**made))
    text = text_of(pages).replace("&#x27;", "'")
    for words in says:
        assert words in text
    assert sum(p.startswith("<img") for p in pages) == pictures


def test_calm_air_has_no_coherent_gust_and_says_so() -> None:
    """Vane and lift that are noise, each its own."""
    flown = record(elevator="never")
    rng = np.random.default_rng(9)
    columns = dict(flown.motion)
    columns["alpha_vane"] = 1e-4 * rng.normal(size=len(flown.t_s))
    columns["az"] = -9.4 + 0.05 * rng.normal(size=len(flown.t_s))
    columns["ax"] = np.zeros(len(flown.t_s))
    calm = FlightRecord.of(flown.t_s, columns, flown.aircraft)
    assert "lift and vane are nowhere coherent" in text_of(spectra_pages(calm))


def test_a_short_record_has_no_density() -> None:
    with pytest.raises(NotIdentifiable, match=r"10 s, 3 of 7 whole segments of 5 s: too short"):
        vane_density(record(10.0))


def test_nasa_s_own_record_shows_the_boom_s_mode() -> None:
    """Martos 2013, chapter III: the air data boom of this Twin Otter has its longitudinal mode at approximately 8 Hz,
    too weak to be seen in his own record. In NASA's calm record of 2002 it stands out, narrower than 5 s resolve."""
    flown = read_fdata(published("twin_otter/totter_f1_017_data.mat"), load_aircraft("twin_otter"))
    columns = dict(flown.tracks[0].columns)
    found = vane_density(FlightRecord.of(DT * np.arange(len(columns["q"])), columns, flown.aircraft))
    assert found.mode is not None
    assert 7.5 < found.mode.frequency_hz < 8.5
    assert found.mode.gain > 100
    assert found.mode.damping + 2 * found.mode.damping_sd < 0.05
    assert not found.is_resolved
