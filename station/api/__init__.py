"""The station as a Python library: what the verbs do, as functions whose results plot and tabulate themselves.

    import station

    flight = station.open("logs/FILE.mcap")     # nothing is read yet
    flight.points, flight.events                # pandas
    flight.signals["alpha_vane"]                # xarray, with unit and sign; read when it is looked at
    found = station.identify(flight, point=3)   # a table in a notebook; found.estimates, found.plot()

Times are seconds since the recording's first frame, values SI and radians, as in every machine-readable file.
"""

from station.api.diagnosing import Diagnosed, diagnose
from station.api.flown_recording import Recording, import_file, open, simulate
from station.api.identifying import Identified, identify
from station.api.monte_carlo import Campaigned, campaign

__all__ = [
    "Campaigned",
    "Diagnosed",
    "Identified",
    "Recording",
    "campaign",
    "diagnose",
    "identify",
    "import_file",
    "open",
    "simulate",
]
