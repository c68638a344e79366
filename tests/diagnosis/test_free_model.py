"""What is allowed for where the aircraft's model is in doubt: curves, where they are taken as straight, and noise."""

from __future__ import annotations

import numpy as np
import pytest
from blind import DEG, Case, aircraft, prepared

from station.diagnosis.effects import EFFECTS, extended
from station.diagnosis.fit import Problem, whitened
from station.diagnosis.model_error import structures
from station.diagnosis.model_error_search import with_model_error
from station.diagnosis.nonlinearity import Nonlinear, nonlinear_priors
from station.diagnosis.nuisances import moved_by, nuisance_priors
from station.diagnosis.profile_changes import derivative
from station.diagnosis.reference import spread, with_noise_through
from station.diagnosis.residuals import LIFT


@pytest.fixture(scope="module")
def manoeuvre():
    return prepared(Case(seed=981, fit_on=("doublets",)))[0][0]


def test_curves_follow_a_table_that_no_cubic_follows():
    # A lift table as JSBSim's DHC6 has it: its slope falls from 4.9 to 1.7 per rad at 4 deg and rises again at 6.
    alpha = np.linspace(1, 7.5, 800) * DEG
    table = np.interp(alpha / DEG, [0, 2, 4, 6, 8], [0.44, 0.58, 0.75, 0.81, 0.95])
    cubic = np.vander(alpha / DEG - 4, 4)
    columns = []
    for a in nonlinear_priors(aircraft(), [alpha], [0.1 * alpha]):
        moved = a.extend(aircraft(), a.sd)
        assert isinstance(moved, Nonlinear)
        if moved.lift:
            columns.append(moved.more_lift(alpha))

    def left(*beside):
        m = np.column_stack([cubic, *beside])
        return float(np.std(table - m @ np.linalg.lstsq(m, table, rcond=None)[0]))

    assert left(*columns) < 0.2 * left()
    assert len(columns) < 15


def test_straight_lines_touch_what_is_moved_where_they_are_taken(manoeuvre):
    nuisances = nuisance_priors(aircraft())
    moved = np.linspace(-1.5, 1.5, len(nuisances))
    problem = Problem([manoeuvre], aircraft(), nuisances, moved)
    shift = extended(moved_by(aircraft(), nuisances, moved), {"alpha_vane.delay": 0.02})
    there = whitened(manoeuvre, manoeuvre.differences(shift))
    values = {"alpha_vane.delay": 0.02}
    columns = problem.nuisance_columns(values, problem.at(values))[0][: len(nuisances)]
    np.testing.assert_allclose(problem.at(values)[0] + moved @ columns, there, atol=1e-6 * np.abs(there).max())
    # And the line has the slope that the curve has there, for what multiplies too.
    k = next(i for i, a in enumerate(nuisances) if a.name == "CL_alpha")
    step = 1e-3 * np.eye(len(nuisances))[k]
    ahead = whitened(manoeuvre, manoeuvre.differences(moved_by(aircraft(), nuisances, moved + step)))
    here = whitened(manoeuvre, manoeuvre.differences(moved_by(aircraft(), nuisances, moved)))
    slope = problem.nuisance_columns({}, problem.at({}))[0][k]
    np.testing.assert_allclose(slope, (ahead - here) / 1e-3, atol=1e-3 * np.abs(slope).max())


def test_noise_passes_through_the_lift_that_is_found(manoeuvre):
    row = manoeuvre.setting.judged.index(LIFT)

    def lift(r):
        return float(spread(r.bins)[0][:, row, row].real.sum())

    assert lift(with_noise_through(manoeuvre, aircraft())) == pytest.approx(lift(manoeuvre), rel=1e-6)
    flat = derivative("CL_alpha", relative=True)(aircraft(), -0.9)
    assert lift(with_noise_through(manoeuvre, flat)) < 0.9 * lift(manoeuvre)


def test_the_classical_structure_has_the_same_steady_lift():
    own, classical = structures(aircraft())
    assert own.unsteady.memory
    assert not classical.unsteady.memory
    assert classical.derivatives == own.derivatives
    assert structures(classical) == (classical,)


def test_the_noise_of_the_airspeed_is_no_dependence_of_lift_on_speed():
    references, _ = prepared(Case(seed=983))
    found = with_model_error(references, aircraft(), [t for t in EFFECTS if t.searched], lambda _: None)
    assert [p.term.id for p in found.parts] == []
