"""Hidden lateral effects must be found, named and valued; nothing must be found where nothing is."""

from __future__ import annotations

import os
import secrets
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from lateral_blind import DETECTABLE, KINDS, SIGMAS, Case, aircraft, diagnosed, planted, records, score

from station.diagnosis.diagnosis_json import as_json
from station.diagnosis.effects import BY_ID
from station.diagnosis.measured_record import Record, lateral_record
from station.diagnosis.procedure import Diagnosis, diagnose

SEED = int(os.environ.get("BLIND_SEED", secrets.randbelow(1 << 24))) * 1000
"""Of the slow matrices: fresh each time, printed with the result; BLIND_SEED repeats one."""
PAIRS = tuple((KINDS[j], KINDS[(j + 1) % 3], KINDS[(j + 2) % 3]) for j in range(3))
"""Two manoeuvres to fit, one held out, in turn."""


def case(seed: int, number: int, **given: object) -> Case:
    one, other, kept = PAIRS[number % 3]
    return replace(Case(seed=seed, fit_on=(one, other), hold_out=(kept,)), **given)


def told(d: Diagnosis) -> list[tuple[str, float, float, tuple[str, ...]]]:
    return [(e.term.id, e.value, e.sd, e.alternatives) for e in d.effects]


def test_nothing_is_named_in_a_clean_flight_and_all_is_written():
    d = diagnosed(Case(seed=3, sigma=SIGMAS[1]))
    assert (d.named, d.lateral is not None) == ((), True)
    made = as_json(d, ())
    assert made["lateral"]["verdict"] == "no_effect"
    assert set(made["lateral"]["residuals"]) == {
        "bank", "heading", "v_across", "beta_vane", "side_force", "roll", "yaw",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "air"), [("r.scale", 0), ("beta_vane.delay", 1)])
def test_a_single_effect_is_named_and_written_into_the_aircraft(name, air):
    planned = Case(seed=71, sigma=SIGMAS[air], effects={name: planted(name, 3.0, SIGMAS[air], 1)})
    d = diagnosed(planned)
    assert score(planned, d) in ("exact", "group"), told(d)
    (effect,) = d.named
    assert effect.value == pytest.approx(planned.effects[name], abs=3 * effect.sd)
    assert d.extended == effect.onto(d.aircraft)
    assert d.gain is not None
    assert d.gain.low > 0


@pytest.mark.parametrize(
    ("name", "value", "seed", "number", "air"),
    [
        pytest.param("aero.lateral_icing", 3.6, 13128969271, 28, 1, marks=pytest.mark.slow),
        ("r.scale", -0.03, 13128969062, 8, 2),
    ],
)
def test_what_gusts_hide_is_named_or_a_rival(name, value, seed, number, air):
    """Ice whose place the derivatives had taken; a rate and an attitude that only the model tells apart. Both had been
    something else, confidently."""
    planned = case(seed, number, sigma=SIGMAS[air], effects={name: value})
    d = diagnosed(planned)
    assert score(planned, d) in ("exact", "group"), told(d)


def test_what_is_lacking_is_said():
    fitted, _ = records(Case(seed=3, fit_on=("doublets",), hold_out=()))
    record = fitted[0]
    assert isinstance(lateral_record(record), Record)
    blind = replace(record, sideways={n: x for n, x in record.sideways.items() if n != "beta_vane"})
    assert lateral_record(blind) == "no beta_vane"
    still = {n: 0 * x if n in ("aileron", "rudder") else x for n, x in record.sideways.items()}
    assert lateral_record(replace(record, sideways=still)) == "neither aileron nor rudder moved"
    d = diagnose([blind], [], aircraft())
    assert d.lateral is None
    assert "lateral motion is not judged: no beta_vane" in d.remarks


def counted(cases: list[Case]) -> list[str]:
    """Scores, printed by case."""
    scores = []
    for c in cases:
        d = diagnosed(c).lateral
        assert d is not None
        scores.append(score(c, d))
        print(c.sigma, dict(c.effects), scores[-1], told(d), d.remaining.missed, d.remaining.strained)
    print(f"seed {SEED // 1000}: {Counter(scores)}")
    return scores


@pytest.mark.slow
def test_matrix_of_clean_lateral_flights():
    scores = counted([case(SEED + i, i // 3, sigma=SIGMAS[i % 3]) for i in range(60)])
    assert scores.count("false") <= 0.02 * len(scores)


@pytest.mark.slow
def test_matrix_of_single_lateral_effects_at_twice_their_detectable_size():
    cases = []
    for j, name in enumerate(DETECTABLE):
        for k, sigma in enumerate(SIGMAS):
            value = planted(name, 2.0, sigma, 1 if (j + k) % 2 else -1)
            if np.isfinite(value):
                given = {"sigma": sigma, "effects": {name: value}}
                cases.append(case(SEED + 100_000 + 10 * j + k, j + k, **given))
    scores = counted(cases)
    assert sum(scores.count(s) for s in ("exact", "group", "suspect")) >= 0.95 * len(scores)
    assert scores.count("wrong") <= 0.02 * len(scores)
    assert all(BY_ID[n].lateral for n in DETECTABLE)
