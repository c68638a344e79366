"""What an identification gives: every method's estimates, and all that the record says of its instruments and input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from station.estimation.flight_record import FlightRecord
from station.estimation.results import Axes, MethodResult
from station.identification.advice import NextInput, SiftedMethod
from station.identification.angle_consistency import Consistency
from station.identification.boom_spectra import BoomSpectra
from station.identification.flown import Flown
from station.identification.instrument_table import InstrumentTable
from station.identification.kinematics import Kinematics
from station.identification.model_structure import Comparison
from station.profile import Aircraft


@dataclass(frozen=True, slots=True)
class Identification:
    """Of one interval of a recording. A part that cannot be had is the reason in words; one not asked for is None."""

    log: str
    aircraft: Aircraft
    interval_s: tuple[float, float]
    axes: Axes
    turbulence: str
    """calm, light, moderate, severe or unknown."""
    gust_sd: float
    """Standard deviation of the vertical gust in 2-7 Hz, m/s; NaN where unknown."""
    remarks: tuple[str, ...]
    hint: str
    """What contradicts the profile or the recorded signs and units; "" if nothing."""
    methods: Mapping[str, MethodResult]
    recommended: str | None
    consistency: Consistency | None
    instruments: InstrumentTable | str | None
    kinematics: Kinematics | None
    structures: Mapping[str, Comparison] | str | None
    """By equation."""
    sifted: Mapping[str, SiftedMethod] | str | None
    """By method."""
    next_input: NextInput | str | None
    boom: tuple[BoomSpectra, ...] | str
    """Of the accelerometers that the rig declares on it; empty without any."""
    record: FlightRecord
    """What the methods were given."""
    flown: Flown | None
    """What the live estimator made of it."""
