"""What an identification remarks on its record: doubtful columns, gusts, instrument errors, and the band."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS
from station.estimation.flight_record import FlightRecord
from station.estimation.instrument_errors import known
from station.estimation.results import MethodResult
from station.identification.cleaning import MOVING, REPEATING
from station.identification.flown import WITNESSES
from station.identification.input_ranking import short_period
from station.log import Table
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft
from station.rows import Status

APART: Final = 3.0
"""Standard errors by which two methods may differ."""
LEAST_VALUES: Final = 2
MOST_STEPS: Final = 1.5
"""Of a grid, in the middle move of a signal that is rounded and else recorded as it moves: one step."""
PAST_THE_PEAK: Final = 1.3
"""How far beyond the short period the band should reach, for damping and stiffness to be separated."""


def about_columns(table: Table) -> list[str]:
    """Signals with impossible values, which are excluded, and those held between slower samples."""
    remarks = []
    for name, column in table.columns.items():
        there = column[np.isfinite(column)]
        signal = SIGNALS.get(name)
        if signal is None or len(there) < LEAST_VALUES:
            continue
        beyond = int(((there < signal.low) | (there > signal.high)).sum())
        if beyond:
            remarks.append(
                f"{name}: {beyond} of {len(there)} values outside {signal.low:.4g} to {signal.high:.4g} {signal.unit}, "
                "excluded: is its unit right?"
            )
        same = float((np.diff(there) == 0).mean())
        if name in MOVING and REPEATING < same < 1.0:
            why = "held between slower samples it is late, and no estimate corrects for that"
            if step := _rounding(there):
                why = f"it is rounded to steps of {step:.3g} {signal.unit}, and what is finer is not seen"
            remarks.append(f"{name} repeats its last value in {same:.0%} of the rows: {why}")
    return remarks


def _rounding(x: NDArray[np.float64]) -> float:
    """The step to which a signal that repeats its values is rounded; 0 where it moves by more than a step at a time, as
    one that is held between slower samples."""
    moves = np.abs(np.diff(x))
    moves = moves[moves > 0]
    step = float(moves.min())
    return step if float(np.median(moves)) < MOST_STEPS * step else 0.0


def about_gusts(results: Mapping[str, MethodResult], level: str) -> list[str]:
    """That the standard errors omit the gusts, where nothing separates these from the motion."""
    apart = [n for n in reversed(WITNESSES) if n in results]
    if level in ("calm", "unknown") or not apart or any(results[n].status == "ok" for n in apart):
        return []
    return [f"{level} turbulence, and {results[apart[0]].why}: the standard errors do not include the gusts' effect"]


def about_disagreement(results: Mapping[str, MethodResult]) -> list[str]:
    """Output error against filter error where they differ by more than their own errors: both integrate the same
    equations, but output error takes what gusts do for the model's."""
    pair = [results[name] for name in ("oe", "fe") if name in results and results[name].status == "ok"]
    if len(pair) < len(("oe", "fe")):
        return []
    words = []
    for p in pair[0].parameters:
        other = pair[1].parameter(p.name)
        if other is None or Status.INVALID in (p.status, other.status):
            continue
        sds = [of.statistical.get(p.name, one.sd) for of, one in zip(pair, (p, other), strict=True)]
        if abs(p.value - other.value) > APART * math.hypot(*sds):
            words.append(f"{p.name} {p.value:.3g} ± {2 * sds[0]:.2g} and {other.value:.3g} ± {2 * sds[1]:.2g}")
    if not words:
        return []
    return [
        f"oe and fe disagree by more than their errors: {', '.join(words)}; of the two go by fe, which allows for gusts"
    ]


def about_instruments(aircraft: Aircraft) -> list[str]:
    """The instrument errors that the profile states, corrected or not."""
    stated = known(aircraft)
    done = [f"the profile's instrument errors corrected: {'; '.join(stated.words)}"] if stated.words else []
    if aircraft.boom is None and not aircraft.kinematics_only:
        done.append(
            "the profile has no boom: the vane is taken for the angle of attack at the CG, and no standard error "
            "includes the error of that"
        )
    return done + [f"an instrument error is not corrected: {words}" for words in stated.refused]


def about_contradiction(words: str) -> list[str]:
    """Instruments that the others contradict, whose part in the errors the user can take out."""
    if not words:
        return []
    return [
        f"against the other signals {words}: the standard errors hold what that does to derivatives; stated in the "
        "profile under [instruments] (a vane's scale by its upwash, a surface's lag as a negative one), it is undone"
    ]


def about_the_band(record: FlightRecord, band_hz: tuple[float, float]) -> list[str]:
    """Where the band ends below the aircraft's short period."""
    speed = float(np.nanmean(record.motion["airspeed"]))
    try:
        hz = short_period(record.aircraft, speed, record.mean_density)[0] / (2 * math.pi)
    except NotIdentifiable:
        return []
    if hz * PAST_THE_PEAK <= band_hz[1]:
        return []
    return [
        f"the profile's short period is at {hz:.2g} Hz, the band of the estimates ends at {band_hz[1]:g} Hz: "
        f'set high = "{PAST_THE_PEAK * hz:.2g} Hz" or more on the card, and fly inputs that reach there'
    ]
