"""What emulated devices show until the simulation is compiled is where the simulation begins."""

import pytest

from station.profile import Instrument, load_card
from station.simulation.level_flight import LevelFlight
from station.simulation.sortie import installed


@pytest.mark.parametrize("name", ["bench", "lateral", "boom_serial"])
def test_level_flight_is_the_first_row_of_the_simulation_in_still_air(name):
    profiles = load_card(name)
    errors = {"q": Instrument(bias=0.01), "alpha_vane": Instrument(gain=1.1, bias=-0.02, cubic=0.5)}
    aircraft = profiles.aircraft.model_copy(update={"instruments": errors})
    flight = profiles.card.flight.model_copy(update={"gust_sigma": 0.0, "turbulence": None, "wind_north": 3.0})
    card = profiles.card.model_copy(update={"flight": flight})
    rig = profiles.rig.model_copy(update={"devices": profiles.rig.devices[:1]})  # no drift
    flown = installed(aircraft, rig, card).advance(1)
    held = LevelFlight(aircraft, flight).advance(7)
    assert held.keys() == flown.keys()
    for signal, values in held.items():
        assert len(values) == 7
        assert values == pytest.approx(float(flown[signal][0]), rel=1e-9, abs=1e-9), signal
