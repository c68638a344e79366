"""The catalogue against the list of effects that was asked for, and each row against what it says of itself."""

from __future__ import annotations

import string
from dataclasses import replace

import lateral_blind
import numpy as np
import pytest
from blind import SIGMAS, Case, aircraft, fly_case

from station.conventions import from_si, to_si, unit_named
from station.diagnosis import lateral_residuals
from station.diagnosis.axis import ACROSS
from station.diagnosis.diagnosis_report import effects_table
from station.diagnosis.diagnosis_result import Gain, summary
from station.diagnosis.effects import BY_ID, EFFECTS, SIGNAL_EFFECTS, extended, signal_effect
from station.diagnosis.lateral_effects import LATERAL_EFFECTS
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import lateral_record
from station.diagnosis.procedure import diagnose
from station.diagnosis.residuals import SERIES, series
from station.diagnosis.term import Term
from station.profile import Instrument, load_aircraft
from station.profile.profile_changes import gain
from station.rows import UsageError

ASKED = {
    1: "alpha_vane.delay", 2: "alpha_vane.position", 3: "gust.lead", 4: "alpha_vane.scale",
    5: "alpha_vane.upwash_memory", 6: "alpha_vane.dynamics", 7: "boom.flexure", 8: "boom.mode", 9: "alpha_vane.bias",
    11: "accelerometer.position", 12: "accelerometer.bias", 13: "accelerometer.scale", 14: "accelerometer.delay",
    15: "q.delay", 16: "imu.delay", 17: "q.scale", 19: "mass.scale", 20: "inertia.scale", 21: "cg.shift",
    22: "dynamic_pressure.scale", 23: "dynamic_pressure.lag", 24: "elevator.lag", 25: "elevator.scale",
    26: "elevator.nonlinearity", 27: "elevator.backlash", 29: "aero.icing", 30: "aero.downwash_lag",
    31: "gust.tail_penetration", 32: "aero.unsteady_lift", 33: "aero.speed_terms", 34: "aero.alpha_squared",
    35: "aero.separation",
    36: "thrust.moment", 41: "velocity.stale", 42: "velocity.delay", 43: "theta.bias", 44: "stream.dropout",
    46: "elevator.sign", 47: "elevator.unit", 48: "alpha_vane.double_upwash",
}  # fmt: skip
"""Ids by number of the list of effects that flight data can contain and a simulation can miss; the sign and the unit of
any signal, here the elevator's."""
LATERAL_ASKED = {
    *(f"beta_vane.{kind}" for kind in ("delay", "scale", "position")),
    *(f"{s}.{kind}" for s in ("p", "r", "phi") for kind in ("delay", "scale", "bias")), "psi.delay", "psi.scale",
    "ay.scale", "ay.bias", "ay.position", "inertia.roll", "inertia.yaw", "inertia.axes", "gust.fin_penetration",
    *(f"{s}.{kind}" for s in ("aileron", "rudder") for kind in ("lag", "scale", "backlash")), "aero.sidewash_lag",
    "aero.lateral_icing",
}  # fmt: skip
"""Zeros of heading, vane and surfaces, and places beside the plane of symmetry, are left out: lateral_effects.py."""
FURTHER = {
    "elevator.delay", "theta.scale", "q.bias", "aero.Cm_alpha_squared", "aero.CL_q", "aero.CL_de", "gust.vertical",
}  # fmt: skip


def test_every_effect_asked_for_is_a_row():
    rows = {signal_effect(s, k).id for k in SIGNAL_EFFECTS for s in ("velocity", "elevator")} | set(BY_ID)
    assert set(ASKED.values()) <= rows
    assert {t.id for t in EFFECTS if t.id not in ASKED.values()} == FURTHER
    assert len(BY_ID) == len(EFFECTS) + len(LATERAL_EFFECTS)
    assert {t.id for t in LATERAL_EFFECTS} >= LATERAL_ASKED
    assert all(t.lateral for t in LATERAL_EFFECTS)
    assert not any(t.lateral for t in EFFECTS)


def bare(aircraft):
    """Without what says nothing: instruments without errors, derivatives of nought."""
    told = {n: i for n, i in aircraft.instruments.items() if i != Instrument()}
    derivatives = {n: d for n, d in aircraft.derivatives.items() if d.value}
    return aircraft.model_copy(update={"instruments": told, "derivatives": derivatives})


@pytest.mark.parametrize("term", [*EFFECTS, *LATERAL_EFFECTS], ids=lambda t: t.id)
def test_a_row_says_what_it_is(term):
    aircraft = load_aircraft("twin_otter")
    assert unit_named(term.shown) is not None
    assert term.low <= term.null <= term.high
    assert term.low < term.null + term.step <= term.high
    assert bare(extended(aircraft, {term.id: term.null})) == bare(aircraft)
    assert (extended(aircraft, {term.id: term.step}) != aircraft) == bool(term.shows_in)
    assert set(term.shows_in) <= set(lateral_residuals.SERIES if term.lateral else SERIES)
    assert {name for _, name, _, _ in string.Formatter().parse(term.sentence) if name} in ({"value"}, {"size"})
    assert f"{from_si(term.step, term.shown):.3g}" in term.words(term.step)
    assert ("+" in term.words(term.step)) == ("{value}" in term.sentence)
    assert to_si(from_si(term.step, term.shown), term.shown) == pytest.approx(term.step)
    assert term.separate_by


@pytest.fixture(scope="module")
def flight():
    """A manoeuvre in gusts, and its series with the profile as it is; the air data as they are, without the little that
    accelerations say of them."""
    made = manoeuvre(fly_case(Case(seed=3, sigma=SIGMAS[2]), "doublets", 0), aircraft())
    own = replace(made.setting, air_share=None, gust_share=None, gust_across=None)
    made = replace(made, setting=own)
    return made, series(made.record.signals, aircraft(), made.setting)


@pytest.mark.parametrize("term", [t for t in EFFECTS if t.shows_in], ids=lambda t: t.id)
def test_an_effect_changes_the_series_that_its_row_says(term, flight):
    made, before = flight
    inside = slice(made.setting.cut, -made.setting.cut)
    after = series(made.record.signals, extended(aircraft(), {term.id: term.step}), made.setting)
    change = np.abs(after - before)[:, inside].max(-1) / before[:, inside].std(-1)
    # Whatever acts on a series at all does so by far more than rounding.
    assert {n for n, c in zip(SERIES, change, strict=True) if c > 1e-7} == set(term.shows_in)
    assert all(c < 1e-10 for n, c in zip(SERIES, change, strict=True) if n not in term.shows_in)


@pytest.fixture(scope="module")
def lateral_flight():
    """A lateral manoeuvre in gusts, and its series with the profile as it is."""
    flown = lateral_blind.fly_case(lateral_blind.Case(seed=3, sigma=5.0), "doublets", 0)
    record = lateral_record(replace(flown, imu=(0.5, 0.0, 0.1)))
    assert not isinstance(record, str)
    made = manoeuvre(record, aircraft(), ACROSS)
    return made, lateral_residuals.lateral_series(made.record.signals, aircraft(), made.setting)


@pytest.mark.parametrize("term", LATERAL_EFFECTS, ids=lambda t: t.id)
def test_a_lateral_effect_changes_the_series_that_its_row_says(term, lateral_flight):
    made, before = lateral_flight
    inside = slice(made.setting.cut, -made.setting.cut)
    there = extended(aircraft(), {term.id: term.step})
    after = lateral_residuals.lateral_series(made.record.signals, there, made.setting)
    change = np.abs(after - before)[:, inside].max(-1) / before[:, inside].std(-1)
    assert {n for n, c in zip(lateral_residuals.SERIES, change, strict=True) if c > 1e-7} == set(term.shows_in)


def test_an_unknown_effect_names_the_nearest():
    with pytest.raises(UsageError, match=r"no effect named alpha_vane\.delai: did you mean alpha_vane\.delay\?"):
        extended(aircraft(), {"alpha_vane.delai": 0.01})


@pytest.mark.slow
def test_a_new_row_is_all_that_a_new_effect_takes(monkeypatch):
    """An effect that the catalogue does not have: the vertical velocity has a scale error."""
    words = "The vertical velocity has a scale error of {value}."
    new = Term("v_down.scale", "v_down", "1", "%", -0.6, 1.0, 0.05, words, "a climb at a known rate", gain("v_down"))
    made = []
    for k, kind in enumerate(("doublets", "doublets")):
        record = fly_case(Case(seed=77), kind, k)
        record.signals["v_down"][:] *= 1.3
        made.append(record)
    monkeypatch.setitem(BY_ID, new.id, new)
    found = diagnose(made[:1], made[1:], aircraft())
    (effect,) = found.effects
    assert effect.term is new
    assert effect.value == pytest.approx(0.3, abs=3 * effect.sd)
    assert any(effect.sentence in line for line in summary(found))
    assert "v_down.scale" in effects_table(found.named)


@pytest.mark.slow
def test_what_explains_more_only_beyond_its_range_is_told_and_leaves_the_rest_unexplained(monkeypatch):
    """A sensor twice as cubic as the catalogue would have it: the next best, backlash or a lag, is not it."""
    name = "elevator.nonlinearity"
    made = [fly_case(Case(seed=79, effects={name: 0.8}), kind, k) for k, kind in enumerate(("doublets", "3-2-1-1"))]
    monkeypatch.setitem(BY_ID, name, replace(BY_ID[name], high=0.4))
    found = diagnose(made, [], aircraft())
    assert found.found.beyond == ((name, 0.4),)
    assert found.verdict == "unexplained"
    assert all(e.suspect for e in found.effects)
    (told,) = (words for words in found.remarks if name in words and "at an end of what is physical" in words)
    assert "+40 %" in told


@pytest.mark.slow
def test_what_held_out_data_do_not_confirm_is_neither_named_nor_left_in_the_aircraft(monkeypatch):
    """Gyro and attitude contradict each other whatever is held out; an elevator's lag rests on the aircraft's model."""
    case = Case(seed=78, effects={"q.delay": 0.02, "elevator.lag": 0.06})
    made = [fly_case(case, kind, k) for k, kind in enumerate(("doublets", "3-2-1-1"))]
    monkeypatch.setattr("station.diagnosis.judge.gain", lambda *_: Gain(1.0, 1.1, -0.1, -0.2, 0.0))
    found = diagnose(made, [], aircraft())
    assert {e.term.id for e in found.effects} == set(found.found.accepted.state.values) == {"q.delay"}
    assert "elevator.lag" in {e.term.id for e in found.not_named}
    assert set(found.extended.instruments) == {"q"}
    assert "elevator" not in found.after.instruments
