"""What is seen without a fit, by the rules of identify: signs, units, values left out, repeated values, lost rows; and
records that cannot be judged."""

from __future__ import annotations

import math

import numpy as np
import pytest
from blind import KINDS, SIGMAS, Case, aircraft, fly_case

from station.conventions import to_si
from station.diagnosis.checks import checked, first_seen
from station.diagnosis.measured_record import manoeuvres
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.rows import Quality, UsageError

G0 = 9.80665


@pytest.fixture(scope="module", params=[SIGMAS[0], pytest.param(SIGMAS[2], marks=pytest.mark.slow)])
def records(request):
    return [fly_case(Case(seed=71, sigma=request.param), kind, k) for k, kind in enumerate(KINDS[:2])]


def columns_of(record):
    columns = {n: x for n, x in record.signals.items() if n != "v_along"}
    columns |= {"v_north": record.signals["v_along"], "v_east": 0 * record.signals["v_along"]}
    return record.dt * np.arange(record.n), {**columns, "altitude": np.full(record.n, 762.0)}


def table_of(record, quality=None, **changes):
    """A record as a table, with columns changed."""
    t, columns = columns_of(record)
    columns = {n: changes[n](x.copy()) if n in changes else x for n, x in columns.items()}
    return Table(t, columns, aircraft(), 0, quality or {})


def signals_of(table):
    """What diagnosis compares: the signals of the one manoeuvre, and the same without changes to the table."""
    (record,) = checked("r", table, aircraft()).records(aircraft())
    return record.signals


def test_sound_records_show_nothing(records):
    for record in records:
        found = checked("r", table_of(record), aircraft())
        assert (found.seen, found.remarks) == ((), ())
        (same,) = found.records(aircraft())
        np.testing.assert_array_equal(same.signals["q"], record.signals["q"])
        assert first_seen([same]) == ()


MISTAKES = [
    ("q", np.degrees, "q.unit"),
    ("q", np.negative, "q.sign"),
    ("alpha_vane", np.negative, "alpha_vane.sign"),
    ("alpha_vane", np.degrees, "alpha_vane.unit"),
    ("az", lambda x: x / G0, "az.unit"),
    ("az", np.negative, "az.sign"),
    ("elevator", np.negative, "elevator.sign"),
    ("airspeed", lambda x: x / to_si(1, "kt"), "airspeed.unit"),
]


@pytest.mark.parametrize(("name", "change", "effect"), MISTAKES)
def test_a_mistaken_sign_or_unit_is_named_and_taken_back(records, name, change, effect):
    for record in records:
        wrong = checked("r", table_of(record, **{name: change}), aircraft())
        assert [s.term.id for s in wrong.seen] == [effect]
        (mended,) = wrong.records(aircraft())
        np.testing.assert_allclose(mended.signals[name], record.signals[name], rtol=1e-12)
        assert [s.term.id for s in first_seen([mended])] == [effect]


@pytest.mark.parametrize(("name", "change", "effect"), MISTAKES)
def test_what_identify_refuses_is_named(records, name, change, effect):
    table = table_of(records[1], **{name: change})
    refused = identify(table, aircraft(), Request(("II",))).hint
    found = checked("r", table, aircraft())
    sentence = refused.partition(": no estimate is valid")[0]
    assert name in sentence
    assert any(sentence in remark for remark in found.remarks)


def spike(column):
    column[700] += 0.5
    return column


def stop(column):
    # In the first doublet: when the recorder goes on, the aircraft is elsewhere.
    column[310:330] = column[310]
    return column


def lose_a_bit(column):
    column[700] = 20.0
    return column


STOPPED = dict.fromkeys(("alpha_vane", "q", "theta", "ax", "az", "airspeed", "dynamic_pressure", "elevator"), stop)


@pytest.mark.parametrize("changes", [{"q": spike}, {"alpha_vane": lose_a_bit}, STOPPED], ids=["spike", "bit", "stop"])
def test_what_identify_leaves_out_is_left_out(records, changes):
    table = table_of(records[0], **changes)
    remarks = identify(table, aircraft(), Request(("II",))).remarks
    sound = identify(table_of(records[0]), aircraft(), Request(("II",))).remarks
    own = [f"r: {r}" for r in remarks if r not in sound]
    assert own
    assert list(checked("r", table, aircraft()).remarks) == own
    if changes is STOPPED:
        # A gap too long to be bridged: judged before and after it.
        before, after = checked("r", table, aircraft()).records(aircraft())
        assert before.start_s + before.seconds == pytest.approx(table.t_s[311])
        assert after.start_s == pytest.approx(table.t_s[330])
    else:
        (name,) = changes
        now, around = signals_of(table)[name], records[0].signals[name][690:710]
        assert around.min() - 1e-3 < now[700] < around.max() + 1e-3


@pytest.mark.parametrize("mark", [Quality.HELD, Quality.SUSPECT])
def test_values_marked_in_flight_are_not_compared(records, mark):
    marks = np.zeros(records[0].n, dtype=np.uint8)
    marks[700:703] = mark

    def wrong(column):
        column[700:703] += 0.3
        return column

    before = signals_of(table_of(records[0]))["elevator"]
    after = signals_of(table_of(records[0], {"elevator": marks}, elevator=wrong))["elevator"]
    np.testing.assert_array_equal(np.delete(after, range(700, 703)), np.delete(before, range(700, 703)))
    assert np.abs(after - before).max() < 0.05


def test_a_velocity_that_repeats_is_seen_with_its_period(records):
    t, columns = columns_of(records[0])
    held = {n: x[(np.arange(len(x)) // 25) * 25] if n.startswith("v_") else x for n, x in columns.items()}
    found = manoeuvres("held", t, held, aircraft())
    seen = first_seen(found)
    assert [s.term.id for s in seen] == ["velocity.stale"]
    assert seen[0].value == pytest.approx(0.5, abs=0.02)


def test_five_hertz_are_enough_however_times_are_rounded(records):
    _, columns = columns_of(records[0])
    slow = {n: x[::10] for n, x in columns.items()}
    t = 20.0 + np.arange(len(slow["q"])) * 0.2
    assert np.median(np.diff(t)) > 0.2
    assert manoeuvres("slow", t, slow, aircraft())[0].dt == pytest.approx(0.2)


def test_lost_rows_are_counted(records):
    t, columns = columns_of(records[0])
    lost = {n: x.copy() for n, x in columns.items()}
    lost["q"][100:1100:10] = np.nan
    seen = first_seen(manoeuvres("lossy", t, lost, aircraft()))
    assert [s.term.id for s in seen] == ["stream.dropout"]
    assert seen[0].value == pytest.approx(100 / len(t), rel=1e-6)


def test_a_record_that_cannot_be_judged_says_why(records):
    t, columns = columns_of(records[0])
    with pytest.raises(UsageError, match="it has no theta"):
        manoeuvres("x", t, {n: x for n, x in columns.items() if n != "theta"}, aircraft())
    with pytest.raises(UsageError, match="too short"):
        manoeuvres("x", t[:100], {n: x[:100] for n, x in columns.items()}, aircraft())
    still = {**columns, "elevator": 0 * t, "alpha_vane": 0 * t + 0.02}
    with pytest.raises(UsageError, match="nothing can be judged without an input"):
        manoeuvres("x", t, still, aircraft())
    # A multisine of 0.25 deg is ten times its sensor's noise.
    small = still | {"elevator": math.radians(0.25) * math.sqrt(2) * np.sin(2 * math.pi * 0.7 * t)}
    assert manoeuvres("x", t, small, aircraft())[0].n > 0
    gap = {n: x.copy() for n, x in columns.items()}
    gap["az"][500:600] = np.nan
    before, after = manoeuvres("x", t, gap, aircraft())
    assert (before.start_s, after.start_s) == (pytest.approx(t[0]), pytest.approx(t[600]))
    assert before.seconds + after.seconds == pytest.approx(t[-1] - t[0] - 101 * before.dt, abs=2.1 * before.dt)
    assert before.remarks == (f"x: {101 * before.dt:.1f} s left out, with gaps in what is needed",)
    for k in range(100, len(t), 100):
        gap["az"][k : k + 20] = np.nan
    with pytest.raises(UsageError, match="az has a gap"):
        manoeuvres("x", t, gap, aircraft())
