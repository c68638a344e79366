"""The station as a Python library: what the verbs do, as functions whose results plot and tabulate themselves.

    import station

    flight = station.open("logs/FILE.mcap")     # nothing is read yet
    flight.points, flight.events                # pandas
    flight.signals["alpha_vane"]                # xarray, with unit and sign; read when it is looked at
    found = station.identify(flight, point=3)   # a table in a notebook; found.estimates, found.plot()

Its names are those of `station`, which imports each when it is first used. Times are seconds since the recording's
first frame, values SI and radians, as in every machine-readable file.
"""
