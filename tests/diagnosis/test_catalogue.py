"""The catalogue against the numbered list of effects that the issue asks for."""

from __future__ import annotations

import pytest

from station.conventions import from_si, to_si, unit_named
from station.diagnosis.effects import BY_ID, EFFECTS, extended
from station.profile import Instrument, load_aircraft

ASKED = {*range(1, 10), *range(11, 18), *range(19, 28), *range(29, 35), 36, *range(41, 45), 46, 47, 48}
TERMS = {
    1: "alpha_vane.delay", 2: "alpha_vane.position", 4: "alpha_vane.scale", 5: "alpha_vane.upwash_memory",
    6: "alpha_vane.dynamics", 7: "boom.flexure", 9: "alpha_vane.bias", 11: "accelerometer.position",
    12: "accelerometer.bias", 13: "accelerometer.scale", 14: "accelerometer.delay", 15: "q.delay", 16: "imu.delay",
    17: "q.scale", 19: "mass.scale", 20: "inertia.scale", 21: "cg.shift", 22: "dynamic_pressure.scale",
    23: "dynamic_pressure.lag", 24: "elevator.lag", 25: "elevator.scale", 27: "elevator.backlash", 29: "aero.icing",
    30: "aero.downwash_lag", 31: "gust.tail_penetration", 32: "aero.unsteady_lift", 33: "aero.speed_terms",
    34: "aero.alpha_squared", 36: "thrust.moment", 42: "velocity.delay", 43: "theta.bias", 3: "gust.lead",
    8: "boom.mode", 26: "elevator.nonlinearity",
}  # fmt: skip
SEEN_AT_ONCE = {41: "velocity.stale", 44: "stream.dropout", 46: "sign", 47: "unit"}
"""Told by the first checks, before any fit."""
BESIDE = {48: "alpha_vane.double_upwash"}
"""Told as a rival of the vane's scale, with which it shares the value."""


def test_every_number_asked_for_is_accounted_for():
    reported = [TERMS, SEEN_AT_ONCE, BESIDE]
    assert sum(len(t) for t in reported) == len(ASKED)
    assert {n for t in reported for n in t} == ASKED
    assert set(TERMS.values()) <= set(BY_ID)


def bare(aircraft):
    """Without what says nothing: instruments without errors, derivatives of nought."""
    reported = {n: i for n, i in aircraft.instruments.items() if i != Instrument()}
    derivatives = {n: d for n, d in aircraft.derivatives.items() if d.value}
    return aircraft.model_copy(update={"instruments": reported, "derivatives": derivatives})


@pytest.mark.parametrize("term", EFFECTS, ids=lambda t: t.id)
def test_a_term_says_what_it_is(term):
    aircraft = load_aircraft("twin_otter")
    assert unit_named(term.shown) is not None
    assert term.low <= term.null <= term.high
    assert term.low < term.null + term.step <= term.high
    assert bare(extended(aircraft, {term.id: term.null})) == bare(aircraft)
    assert extended(aircraft, {term.id: term.step}) != aircraft
    assert f"{from_si(term.step, term.shown):+.3g}" in term.words(term.step)
    assert to_si(from_si(term.step, term.shown), term.shown) == pytest.approx(term.step)
    assert term.separate_by
