"""What is seen without a fit: signs, units, held velocities, and records that cannot be judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blind import KINDS, SIGMAS, Case, aircraft, fly_case

from station.diagnosis.checks import examine
from station.diagnosis.measured_record import manoeuvres
from station.rows import UsageError

G0 = 9.80665


@pytest.fixture(scope="module", params=[SIGMAS[0], SIGMAS[2]])
def records(request):
    return [fly_case(Case(seed=71, sigma=request.param), kind, k) for k, kind in enumerate(KINDS[:2])]


def changed(records, name, change):
    return [replace(r, signals={n: change(x) if n == name else x for n, x in r.signals.items()}) for r in records]


def test_sound_records_show_nothing(records):
    seen, same = examine(records, aircraft())
    assert seen == []
    assert all(np.array_equal(a.signals["q"], b.signals["q"]) for a, b in zip(records, same, strict=True))


@pytest.mark.parametrize(
    ("name", "change", "effect"),
    [
        ("q", np.degrees, "q.unit"),
        ("q", np.negative, "q.sign"),
        ("alpha_vane", np.negative, "alpha_vane.sign"),
        ("alpha_vane", np.degrees, "alpha_vane.unit"),
        ("az", lambda x: x / G0, "az.unit"),
        ("az", np.negative, "az.sign"),
        ("elevator", np.negative, "elevator.sign"),
    ],
)
def test_a_mistaken_sign_or_unit_is_named_and_put_right(records, name, change, effect):
    seen, mended = examine(changed(records, name, change), aircraft())
    assert [s.id for s in seen] == [effect]
    for was, now in zip(records, mended, strict=True):
        np.testing.assert_allclose(now.signals[name], was.signals[name], rtol=1e-12)


def columns_of(record):
    columns = {n: x for n, x in record.signals.items() if n != "v_along"}
    columns |= {"v_north": record.signals["v_along"], "v_east": 0 * record.signals["v_along"]}
    return record.dt * np.arange(record.n), {**columns, "altitude": np.full(record.n, 762.0)}


def test_a_velocity_that_repeats_is_seen_with_its_period(records):
    t, columns = columns_of(records[0])
    held = {n: x[(np.arange(len(x)) // 25) * 25] if n.startswith("v_") else x for n, x in columns.items()}
    found = manoeuvres("held", t, held, aircraft())
    seen, _ = examine(found, aircraft())
    assert [s.id for s in seen] == ["velocity.stale"]
    assert seen[0].value == pytest.approx(0.5, abs=0.02)


def test_lost_rows_are_counted(records):
    t, columns = columns_of(records[0])
    lost = {n: x.copy() for n, x in columns.items()}
    lost["q"][100:1100:10] = np.nan
    seen, _ = examine(manoeuvres("lossy", t, lost, aircraft()), aircraft())
    assert [s.id for s in seen] == ["stream.dropout"]
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
    gap = {n: x.copy() for n, x in columns.items()}
    gap["az"][500:600] = np.nan
    before, after = manoeuvres("x", t, gap, aircraft())
    assert (before.start_s, after.start_s) == (pytest.approx(t[0]), pytest.approx(t[600]))
    assert before.seconds + after.seconds == pytest.approx(t[-1] - t[0] - 101 * before.dt, abs=2.1 * before.dt)
    assert before.gaps == f"x: {101 * before.dt:.1f} s left out, with gaps in what is needed"
    for k in range(100, len(t), 100):
        gap["az"][k : k + 20] = np.nan
    with pytest.raises(UsageError, match="az has a gap"):
        manoeuvres("x", t, gap, aircraft())
