"""Errors of instruments that the profile states are no difference: what is judged is the flight, not what showed it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from blind import Case, aircraft, fly_case

from station.diagnosis.effects import extended
from station.diagnosis.fit import whitened
from station.diagnosis.measured_record import Record
from station.diagnosis.reference import reference

KNOWN = {"dynamic_pressure.scale": -0.36, "accelerometer.scale": 0.1, "elevator.scale": 0.5, "alpha_vane.scale": 0.2}


def shown(record: Record) -> Record:
    """A record as instruments with KNOWN errors would have shown it."""
    gains = {
        "airspeed": math.sqrt(0.64), "dynamic_pressure": 0.64, "ax": 1.1, "az": 1.1, "elevator": 1.5, "alpha_vane": 1.2,
    }  # fmt: skip
    signals = {n: x * gains.get(n, 1.0) for n, x in record.signals.items()}
    return replace(record, signals=signals, stated={n: sd * gains.get(n, 1.0) for n, sd in record.stated.items()})


def test_a_record_is_judged_alike_through_instruments_whose_scales_are_known():
    record = fly_case(Case(seed=991, fit_on=("doublets",)), "doublets", 0)
    true = reference(record, aircraft())
    known = extended(aircraft(), KNOWN)
    seen = reference(shown(record), known)
    assert seen.nominal["airspeed"].mean() == pytest.approx(true.nominal["airspeed"].mean(), rel=1e-9)
    a, b = whitened(true, true.differences(aircraft())), whitened(seen, seen.differences(known))
    # The sign of an eigenvector is anybody's.
    np.testing.assert_allclose(np.abs(b), np.abs(a), atol=1e-6 * float(np.abs(a).max()))
