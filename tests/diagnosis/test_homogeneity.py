"""What is there has one value everywhere; what only acts like it has not."""

from __future__ import annotations

import blind
import pytest

from station.diagnosis.procedure import Diagnosis, diagnose


def flown(one: float, other: float) -> Diagnosis:
    """The gyro's scale off by so much in the first and in the second manoeuvre; held out is as the second."""
    cases = [blind.Case(seed=11, effects={"q.scale": scale}) for scale in (one, other)]
    fit = [blind.records(case)[0][k] for k, case in enumerate(cases)]
    return diagnose(fit, blind.records(cases[1])[1], blind.aircraft())


@pytest.mark.slow
def test_a_gyro_of_another_scale_in_each_manoeuvre_is_told_with_both_values_and_not_named() -> None:
    d = flown(0.05, 0.1)
    assert "q.scale" not in [e.term.id for e in d.effects]
    assert all(e.suspect for e in d.effects)
    assert d.verdict == "unexplained"
    [apart] = d.remaining.inhomogeneous
    # One manoeuvre by itself tells the scale with a standard deviation of 0.2 to 0.25 %.
    assert dict(apart.parts) == pytest.approx({"doublets": 0.05, "3-2-1-1": 0.1}, abs=0.0075)
    told = next(words for words in d.remarks if words.startswith("not named: q.scale is not the same everywhere (+"))
    assert " % by doublets, +" in told


@pytest.mark.slow
def test_a_gyro_that_bends_is_no_scale_error() -> None:
    """Each manoeuvre's amplitude has a scale of its own; forces, of which the model misses nothing, say so."""
    case = blind.Case(
        seed=401008,
        sigma=1.524,
        outside={"q_quadratic": -0.6},
        fit_on=("multisine", "doublets"),
        hold_out=("multisine",),
    )
    d = blind.diagnosed(case)
    assert (d.verdict, d.effects) == ("unexplained", ())
    assert [x.effect for x in d.remaining.inhomogeneous] == ["q.scale"]
