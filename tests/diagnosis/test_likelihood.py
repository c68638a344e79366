"""The likelihood by itself: errors in variables, its invariance, and the levels of noise that it estimates."""

from __future__ import annotations

import math
from dataclasses import replace

import another_simulation as flown
import numpy as np
import pytest
from blind import Case, aircraft, fly_case, prepared
from numpy.typing import NDArray
from scipy.optimize import minimize
from test_sensor_noise import level_flight

from station.diagnosis import null_fit, variances
from station.diagnosis.axis import LONGITUDINAL
from station.diagnosis.effects import extended
from station.diagnosis.free_parameters import Free
from station.diagnosis.judge import LEVEL_DOF, _log_p
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import Record, manoeuvres
from station.diagnosis.memo import Memo
from station.diagnosis.variances import INDEPENDENT
from station.profile import Aircraft, load_aircraft
from station.profile.profile_changes import derivative
from station.profile.uncertainty import Uncertainty

SIX = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
NOISY = {**flown.NOISE, "alpha_vane": math.radians(0.8), "q": math.radians(0.5)}
"""A poor vane and a poor gyro: at 0.8 deg the vane's noise is as large as the angle of attack that inputs of 3 deg
make."""
DRAWS = 30
TOO_WIDE = 0.8
"""Scatter over the standard deviation told, at the least."""


@pytest.fixture(scope="module")
def navion(tmp_path_factory: pytest.TempPathFactory) -> Aircraft:
    path = tmp_path_factory.mktemp("navion") / "navion.toml"
    path.write_text(flown.PROFILE)
    return load_aircraft(str(path))


@pytest.fixture(scope="module")
def quiet() -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """A calm flight of another simulation as sensors without noise would show it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flown, "NOISE", dict.fromkeys(flown.NOISE, 0.0))
        return flown.fly(flown.Case(seed=5), 2)


def laid(signals: dict[str, NDArray[np.float64]], noise: dict[str, float], seed: int) -> dict[str, NDArray[np.float64]]:
    rng = np.random.default_rng([61, seed])
    return {n: x + noise[n] * rng.standard_normal(len(x)) for n, x in signals.items()}


@pytest.fixture(scope="module")
def estimates(
    navion: Aircraft, quiet: tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(draws, 6) relative errors of the derivatives and their standard deviations, from one flight under noise drawn
    anew, by a prior that says nothing; the model, the thrust and the speed through the air mass are right here, and
    nothing is allowed for their errors."""
    frees = [Free(n, 2.0, derivative(n, relative=True), 0.02) for n in SIX]
    t, signals = quiet
    values, told = [], []
    still = navion.model_copy(update={"uncertainty": Uncertainty(drift="0 m/s")})
    right = replace(LONGITUDINAL, least_missed=(1e-5,) * len(LONGITUDINAL.missed))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(variances, "THRUST_SHARE", 1e-6)
        for seed in range(DRAWS):
            (record,) = manoeuvres("noisy", t, laid(signals, NOISY, seed), navion)
            found = null_fit.null(Problem([manoeuvre(replace(record, stated=NOISY), still, right)], still, frees))
            values.append(2.0 * found.state.a[: len(SIX)])
            told.append(2.0 * np.sqrt(np.diag(found.solved.covariance))[: len(SIX)])
    return np.array(values), np.array(told)


def test_least_squares_on_the_vane_is_drawn_towards_nought(
    quiet: tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]],
) -> None:
    """That the case is one of errors in variables: equation error loses a fifth of the lift slope."""
    shown = laid(quiet[1], NOISY, 0)
    lift = -flown.MASS * shown["az"] / (shown["dynamic_pressure"] * flown.AREA)
    columns = np.column_stack([shown["alpha_vane"] / 1.08, shown["q"], shown["elevator"], np.ones(len(lift))])
    assert np.linalg.lstsq(columns, lift, rcond=None)[0][0] < 0.85 * flown.NAVION["CL_alpha"]


def test_noise_in_the_slopes_draws_no_derivative(
    estimates: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """The flight was flown with the profile's derivatives: each mean is within three and a half standard errors."""
    values, _ = estimates
    errors = values.mean(0) / (values.std(0, ddof=1) / math.sqrt(DRAWS))
    assert np.abs(errors).max() < 3.5, dict(zip(SIX, errors.round(1), strict=True))
    assert np.abs(values.mean(0)).max() < 0.02


def test_the_covariance_is_the_scatter(estimates: tuple[NDArray[np.float64], NDArray[np.float64]]) -> None:
    values, told = estimates
    ratio = values.std(0, ddof=1) / np.sqrt((told**2).mean(0))
    # The scatter of n draws is known to 1/sqrt(2 n). With 150 draws the intervals of the derivatives by the angle of
    # attack were a seventh and a quarter too wide: the vane's noise is as large here as what it shows.
    error, words = 3 / math.sqrt(2 * DRAWS), dict(zip(SIX, ratio.round(2), strict=True))
    assert np.log(ratio).max() < error, words
    assert np.log(ratio).min() > math.log(TOO_WIDE) - error, words


def test_what_the_model_may_miss_is_not_known_better(
    navion: Aircraft, quiet: tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]],
    estimates: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:  # fmt: skip
    """No linear model is better than a hundredth: that is said of the pitch stiffness, however little the noise."""
    frees = [Free(n, 2.0, derivative(n, relative=True), 0.02) for n in SIX]
    (record,) = manoeuvres("noisy", quiet[0], laid(quiet[1], NOISY, 0), navion)
    found = null_fit.null(Problem([manoeuvre(replace(record, stated=NOISY), navion)], navion, frees))
    told = 2.0 * np.sqrt(np.diag(found.solved.covariance))[SIX.index("Cm_alpha")]
    assert told > 2 * estimates[1][:, SIX.index("Cm_alpha")].mean()


KNOWN = {"dynamic_pressure.scale": -0.36, "accelerometer.scale": 0.1, "elevator.scale": 0.5, "alpha_vane.scale": 0.2}


def seen_through(record: Record) -> Record:
    """A record as instruments with KNOWN errors would have shown it, their noise included."""
    gains = {
        "airspeed": math.sqrt(0.64), "dynamic_pressure": 0.64, "ax": 1.1, "az": 1.1, "elevator": 1.5, "alpha_vane": 1.2,
    }  # fmt: skip
    signals = {n: x * gains.get(n, 1.0) for n, x in record.signals.items()}
    return replace(record, signals=signals, stated={n: sd * gains.get(n, 1.0) for n, sd in record.stated.items()})


def test_scales_that_are_known_change_nothing() -> None:
    """Residuals are weighed by the noise that reaches them: what scales both scales nothing, in no frequency and no
    series."""
    record = fly_case(Case(seed=991, fit_on=("doublets",)), "doublets", 0)
    plain, known = aircraft(), extended(aircraft(), KNOWN)
    one = Problem([manoeuvre(record, plain)], plain)
    other = Problem([manoeuvre(seen_through(record), known)], known)
    sensors = one.manoeuvres[0].trim.sensors
    a = one.of_profile
    here = one.state({}, a)
    # The gust is stated as the vane shows it.
    levels = replace(other.prior, gust=one.prior.gust * 1.2**2)
    there = other.state({}, a, levels)
    at = sensors.index("alpha_vane")
    assert other.prior.noise[0, at] == pytest.approx(1.2**2 * one.prior.noise[0, at])
    np.testing.assert_allclose(there.white[0], here.white[0], atol=2e-3)


def test_no_scale_of_a_sensor_shrinks_what_is_left() -> None:
    """A vane that is said to show five times too much leaves a fifth of its residual, and of its noise."""
    record = fly_case(Case(seed=992, fit_on=("doublets",)), "doublets", 0)
    problem = Problem([manoeuvre(record, aircraft())], aircraft())
    a = problem.of_profile
    q = [problem.state({"alpha_vane.scale": x}, a).q for x in (0.0, 0.5, 1.4)]
    assert q[0] < q[1] < q[2]


def test_a_series_in_another_unit_is_no_likelier() -> None:
    """The density of what sensors show knows no unit of a series that is made of them: an inertia, which scales the
    whole moment, neither gains nor loses by that."""
    problem = Problem(
        [manoeuvre(fly_case(Case(seed=992, fit_on=("doublets",)), "doublets", 0), aircraft())], aircraft()
    )
    here = problem.state({}, problem.of_profile)
    units = np.array([1.0, 3.3, 0.3, 57.3, 2.0, 0.01, 1e3])[:, None]
    there = replace(here, responses=tuple(units * r for r in here.responses))
    assert problem.volume(there) == pytest.approx(problem.volume(here), abs=1e-6)


@pytest.mark.parametrize("stated", [0.5, 2.0])
def test_the_levels_are_those_of_the_noise_laid_on(navion: Aircraft, stated: float) -> None:
    """White noise on straight flight, at 25 Hz, where samples do not show it by themselves: what the rig states is off
    by two, the spectra tell."""
    still = level_flight()
    n, true = 1600, {"theta": 2e-3, "q": 1e-3, "az": 0.3, "v_down": 0.1, "v_along": 0.15}
    rng = np.random.default_rng(7)
    signals = {name: x[0] + true.get(name, 0.0) * rng.standard_normal(n) for name, x in still.signals.items()}
    rig = {{"v_along": "v_north"}.get(name, name): stated * sd for name, sd in true.items()}
    record = replace(still, dt=0.04, signals=signals, stated=rig)
    problem = Problem([manoeuvre(record, navion)], navion, [])
    s = problem.state({}, problem.of_profile)
    for _ in range(3):
        s = problem.relevelled(s)
    sensors = problem.manoeuvres[0].trim.sensors
    for name, sd in true.items():
        found = math.sqrt(s.levels.noise[0, sensors.index(name)])
        # Each is the only one in some third of 170 frequencies, or more: known to 0.5/sqrt(60).
        assert found == pytest.approx(sd, rel=0.2), name


@pytest.mark.parametrize("seed", range(6))
def test_the_levels_are_the_likeliest_where_nothing_is_missed(seed: int) -> None:
    """Against scipy's bounded minimum of the density, written with inverse and determinant: the shares missed begin and
    end at their least, and keep no other component from its place."""
    rng = np.random.default_rng([17, seed])
    groups, series, most, sensors, missed = 24, 3, 5, 3, 2
    many = 2 * sensors + 1 + missed
    columns = (rng.standard_normal((groups, series, many, 2)) @ [1, 1j]) * rng.uniform(0.5, 2.0, many)
    true = np.append(rng.choice([0.25, 1.0, 4.0], many - missed), np.zeros(missed))
    shown = rng.standard_normal((groups, many, most, 2)) @ [1, 1j] / math.sqrt(2)
    bins = columns @ (np.sqrt(true)[:, None] * shown)
    prior = variances.Levels(np.ones((1, 2 * sensors)), np.ones(1), np.full(missed, 0.05), np.ones(4))
    stiffness, counts = np.full((1, 2 * sensors), 1 / variances.LEVEL_SD**2), np.full(groups, float(most))
    found = np.log(variances.fitted([bins], [columns], [counts], prior, prior, stiffness).of(0))

    centre = np.log(prior.of(0))
    stiff = np.append(stiffness[0], np.full(1 + missed, variances.LOOSE))

    def deviance(x: NDArray[np.float64]) -> float:
        sigma = (columns * np.exp(x)) @ np.conj(columns.swapaxes(-1, -2))
        fit = np.einsum("gim,gij,gjm->", np.conj(bins), np.linalg.inv(sigma), bins).real
        return float(stiff @ (x - centre) ** 2 + 2 * INDEPENDENT * (fit + most * np.linalg.slogdet(sigma)[1].sum()))

    low = centre - np.append(np.full(many - missed, variances.LOWEST), np.zeros(missed))
    best = minimize(deviance, centre, bounds=[(x, 20.0) for x in low], options={"maxiter": 500, "maxfun": 100_000})
    assert found == pytest.approx(best.x, abs=0.1)
    assert deviance(found) == pytest.approx(best.fun, abs=variances.DONE)


@pytest.mark.parametrize("count", [5, 20, 100])
def test_leftovers_are_as_unlikely_as_told_with_an_estimated_level(count: int) -> None:
    rng = np.random.default_rng(count)
    shape = count * INDEPENDENT
    level = rng.chisquare(LEVEL_DOF, 20000) / LEVEL_DOF
    totals = rng.gamma(shape, 1 / INDEPENDENT, 20000) / level
    reported = np.exp([_log_p(float(t), count) for t in totals])
    for chance in (0.5, 0.01):
        assert np.mean(reported < chance) == pytest.approx(chance, abs=4 * np.sqrt(chance / 20000))


def test_what_the_data_do_not_tell_moves_the_cost_of_a_candidate_by_its_prior_alone():
    """Or half a standard deviation of what no residual shows would outweigh what is asked of an effect, and the same
    candidate cost more by one way than by another."""
    problem = Problem(prepared(Case(seed=961)), aircraft())
    null = null_fit.null(problem)
    alone = np.diag(np.linalg.inv(null.solved.covariance)) ** -0.5
    here, unknown = problem.cost(null.state), [i for i, sd in enumerate(alone[: len(problem.frees)]) if sd > 0.85]
    # In calm air the vane shows the wing no gust: how it would follow one is not known by the vane's noise.
    assert {"gust lift amplitude", "gust lift rate", "gust upwash rate"} < {problem.frees[i].name for i in unknown}
    for i in unknown:
        a = null.state.a.copy()
        a[i] += 0.5 if a[i] < problem.ends[1, i] - 0.5 else -0.5
        told = problem.cost(problem.state({}, a, null.state.levels)) - here
        assert told == pytest.approx(a[i] ** 2 - null.state.a[i] ** 2, abs=2.0), problem.frees[i].name


def test_which_share_of_the_gust_the_forces_are_told_makes_no_candidate_likelier() -> None:
    """The series are combined anew, and their noise with them: a change of variables. Where a record ends, another
    filter makes something else of it: some hundredths."""
    told = prepared(Case(seed=961))
    assert all(m.setting.gust_share is not None for m in told)
    whole = []
    for m in told:
        here, straight = (replace(s, gust_share=None) for s in (m.setting, m.trim.setting))
        whole.append(replace(m, setting=here, trim=replace(m.trim, setting=straight), memo=Memo()))
    costs = []
    for fed in (told, whole):
        problem = Problem(fed, aircraft())
        costs.append([problem.cost(problem.state(v, problem.of_profile)) for v in ({}, {"alpha_vane.scale": 0.05})])
    assert np.diff(costs[0]) == pytest.approx(np.diff(costs[1]), rel=0.05)
    assert costs[0] == pytest.approx(costs[1], abs=10.0)


def test_an_effect_costs_what_the_constant_does_that_it_is_like():
    """One aircraft has one density, by whatever names it is told: a constant that takes an effect's place in the fit
    without effects is not counted beside it."""
    problem = Problem(prepared(Case(seed=961)), aircraft())
    null = null_fit.null(problem)
    at = next(i for i, f in enumerate(problem.frees) if f.name == "vane scale")
    none, moved = null.state.a.copy(), null.state.a.copy()
    none[at], moved[at] = 0.0, -3.0
    by_effect = problem.state({"alpha_vane.scale": -3.0 * problem.frees[at].sd}, none, null.state.levels)
    assert problem.volume(by_effect) == pytest.approx(
        problem.volume(problem.state({}, moved, null.state.levels)), abs=1e-6
    )


def test_no_long_step_of_a_fit_raises_the_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Far from the best the weighted squares alone fall with the noise that a candidate would have."""
    problem = Problem(prepared(Case(seed=66, sigma=1.524, effects={"aero.unsteady_lift": 3.0})), aircraft())
    rises = []
    advance = Problem.advance

    def watched(self, s, solved, terms, far):
        there = advance(self, s, solved, terms, far)
        assert far or solved.gained <= 10.0
        if there is not None and far:
            rises.append(self.cost(there) - self.cost(s))
        return there

    monkeypatch.setattr(Problem, "advance", watched)
    null_fit.null(problem)
    assert len(rises) > 5
    assert max(rises) < 0
