"""Predicted errors against fits of simulated answers, and the ranking against what they show."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from station.identification.input_ranking import rank_inputs, short_period
from station.numerics.regression import NotIdentifiable
from station.profile import load_aircraft

AIRCRAFT = load_aircraft("twin_otter")
SPEED, DENSITY = 56.59, 1.138


def test_short_period_is_that_of_the_equations() -> None:
    """Worked out apart from the profile: set B at 110 kt and 2,500 ft has 2.94 rad/s and 0.67."""
    frequency, damping = short_period(AIRCRAFT, SPEED, DENSITY)
    assert frequency == pytest.approx(2.94, abs=0.03)
    assert damping == pytest.approx(0.67, abs=0.01)


def test_ranking_is_by_the_poorest_and_prefers_mixed_widths_and_multisine() -> None:
    for poorest in ("Cm_q", "CL_q", "Cm_de", "CL_de"):
        ranked = rank_inputs(AIRCRAFT, SPEED, DENSITY, poorest)
        errors = [one.std_error[poorest] for one in ranked]
        assert errors == sorted(errors)
        names = [one.name for one in ranked]
        assert len(names) == len(set(names)) >= 7
        # A doublet moves q and elevator together; several widths, 3-2-1-1 or a multisine take them apart.
        widest = {one.name: one.std_error[poorest] for one in ranked}
        short = min(e for name, e in widest.items() if name.startswith("three doublets"))
        assert errors[0] <= short


def test_predicted_errors_are_those_of_repeated_fits() -> None:
    """The winner's error for Cm_q, against least squares on 300 noisy records of the same answer, integrated apart."""
    ranked = rank_inputs(AIRCRAFT, SPEED, DENSITY, "Cm_q", {"Cm": 0.005})
    sine = next(one for one in ranked if one.name.startswith("multisine"))
    harmonics = np.arange(2, 41)
    phases = -np.pi * np.arange(39) * np.arange(1, 40) / 39
    grid = np.arange(0, 20, 0.02)
    peak = np.abs(np.sin(2 * np.pi * np.outer(grid, harmonics) / 20 + phases).sum(axis=1)).max()

    def commanded(t: float) -> float:
        return float(np.radians(2) * np.sin(2 * np.pi * harmonics * t / 20 + phases).sum() / peak)

    s, c, m, iyy = 420 * 0.3048**2, 6.5 * 0.3048, 340 * 14.5939, 24640 * 14.5939 * 0.3048**2
    qbar = 0.5 * DENSITY * SPEED**2

    def answer(t: float, x: np.ndarray) -> list[float]:
        alpha, q, de = x
        qhat = q * c / (2 * SPEED)
        lift = 5.66 * alpha + 19.97 * qhat + 0.608 * de
        moment = -1.31 * alpha - 34.2 * qhat - 1.74 * de
        return [q - qbar * s / (m * SPEED) * lift, qbar * s * c / iyy * moment, (commanded(t) - de) / 0.08]

    found = solve_ivp(answer, (0, 20), [0.0, 0.0, 0.0], t_eval=grid, max_step=0.02, rtol=1e-6)
    alpha, q, de = found.y
    x = np.column_stack([alpha, q * c / (2 * SPEED), de, np.ones(len(grid))])
    rng = np.random.default_rng(1)
    # Noise that stays alike for a quarter of a second.
    blocks = np.repeat(0.005 * rng.standard_normal((300, 81)), 13, axis=1)[:, : len(grid)]
    fits = np.linalg.lstsq(x, blocks.T)[0]
    assert sine.std_error["Cm_q"] == pytest.approx(np.std(fits[1]), rel=0.25)
    assert sine.std_error["Cm_de"] == pytest.approx(np.std(fits[2]), rel=0.25)
    assert sine.relative["Cm_q"] == pytest.approx(2 * sine.std_error["Cm_q"] / 34.2)


def test_unknown_derivatives_and_profiles_without_aerodynamics_are_refused() -> None:
    with pytest.raises(ValueError, match="not a longitudinal"):
        rank_inputs(AIRCRAFT, SPEED, DENSITY, "Cn_beta")
    with pytest.raises(NotIdentifiable, match="no longitudinal derivatives"):
        rank_inputs(load_aircraft("unknown"), SPEED, DENSITY, "Cm_q")
