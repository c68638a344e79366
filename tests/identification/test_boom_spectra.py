"""The boom's bending mode, from an accelerometer at its tip, against the mode that the simulation was given."""

from __future__ import annotations

import numpy as np
import pytest

from station.estimation.flight_record import FlightRecord
from station.identification.boom_page import boom_page
from station.identification.boom_spectra import BoomSpectra, boom_spectra
from station.profile import load_card
from station.simulation.sortie import fly

PLACE = {"az_tip": (5.3, 0.0, 0.0)}


def found(drop: bool = False) -> BoomSpectra:
    """Of 120 s of the card `instrumented`, with its noise and the IMU where the rig has it."""
    p = load_card("instrumented")
    card = p.card.model_copy(update={"flight": p.card.flight.model_copy(update={"truth": {}})}) if drop else p.card
    shown, truth = fly(p.aircraft, p.rig, card, 120.0)
    record = FlightRecord.of(
        truth["time"],
        {n: x for n, x in shown.items() if n != "az_tip"},
        p.aircraft,
        imu_position=p.rig.imu_position,
        noise=p.rig.noise_si(),
    )
    (made,) = boom_spectra(record, truth["time"], shown, PLACE)
    return made


def test_the_mode_is_found_through_the_noise_where_the_simulation_has_it() -> None:
    made = found()
    assert made.mode is not None, made.why
    m = made.mode
    assert abs(m.frequency_hz - 8.0) < 3 * m.frequency_sd
    assert abs(m.damping - 0.03) < 3 * m.damping_sd
    assert m.frequency_sd < 0.1
    # The tip's own acceleration for a load: length x flexure x (2 pi f)^2 of the card's boom.
    assert m.gain == pytest.approx(3.5 * np.radians(0.05) / 9.80665 * (2 * np.pi * 8.0) ** 2, rel=0.15)
    page = "".join(boom_page((made,), load_card("instrumented").aircraft))
    assert "bending mode at 8." in page


def test_a_rigid_boom_has_none() -> None:
    made = found(drop=True)
    assert made.mode is None
    assert "as good as rigid" in made.why
    assert boom_page((), load_card("instrumented").aircraft) == []
