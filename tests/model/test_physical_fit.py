"""The fit of `physical` and its columns alone: against numpy's least squares, the closed forms of its priors, and wing
and tail written out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from station.model import physical_columns as pc
from station.model import physical_fit as pf
from station.model import physical_posterior as pp
from station.model import physical_signals as ps
from station.model.physical_constants import (
    ARM_LENGTH,
    CL_ALPHA,
    CM_ALPHA,
    FIRST_NUISANCE,
    PARAMETERS,
    SPAN,
    SPAN_MIDDLE,
    TAIL_SPAN,
    TAIL_SPAN_SHARE,
    WASH,
    WIND,
    Constants,
    N,
    constants,
)
from station.model.residual_spectrum import residual_spectrum
from station.profile import load_aircraft
from station.profile.uncertainty import Uncertainty

LINES, SPEED, DENSITY = 48, 57.0, 0.95
OMEGA = 2 * np.pi * (0.1 + 0.04 * np.arange(LINES))
THETA = np.array([5.7, 12.0, 0.6, -1.1, -39.0, -1.8])
EXACT = Uncertainty().model_copy(update=dict.fromkeys(Uncertainty.model_fields, 0.0))


def complex_normal(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def exact() -> Constants:
    """Of an aircraft whose profile is right: nothing but the derivatives is estimated."""
    return constants(load_aircraft("twin_otter").model_copy(update={"uncertainty": EXACT}))


def indicial(a: np.ndarray, b: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Of the step response 1 - sum a e^{-b t}; `s`: per chord travelled."""
    return 1 - sum(x * s / (s + y) for x, y in zip(a, b, strict=True) if y > 0)


def flown(rng: np.random.Generator, con: Constants, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spectra of all channels, A and D, of an aircraft with the derivatives THETA: the wing, tail and downwash of the
    module's equations written out for random motion and gust."""
    s = 1j * OMEGA
    x, gust, qhat, de = complex_normal(rng, 4, LINES) * np.array([[1], [1], [0.02], [1]])
    chords = s * con.reference_chord / SPEED
    late = np.exp(-s * con.tail_arm / SPEED)
    washed = late * np.exp(-s * con.downwash_delay)
    w = indicial(con.lift_motion.a, con.lift_motion.b, chords) * x
    k = indicial(con.lift_gust.a, con.lift_gust.b, chords) * np.exp(s * con.gust_edge / SPEED) * gust
    a = w + k
    e, lc = con.downwash, con.arm
    d = x + late * gust - e * washed * (w + k) - (1 - e) * a - 2 * e * lc * qhat
    f = np.zeros((pc.CHANNELS, LINES), dtype=complex)
    f[ps.X], f[ps.WX], f[ps.KG], f[ps.GC], f[ps.GT] = x, w, k, gust, late * gust
    f[ps.DW], f[ps.DK], f[ps.DX] = washed * w, washed * k, washed * x
    f[pc.QH], f[pc.DE] = qhat, de
    f[pc.CL] = THETA[:3] @ [a, qhat, de] + con.tail_share * d + noise * complex_normal(rng, LINES)
    f[pc.CM] = THETA[3:] @ [a, qhat, de] - con.tail_share * lc * d + 0.3 * noise * complex_normal(rng, LINES)
    return f, a, d


def segment(f: np.ndarray, vane_noise: float = 1e-12, wind_sd: float = 0.0) -> pc.Segment:
    return pc.Segment(f, OMEGA, np.ones(LINES), 1.0, vane_noise, SPEED, DENSITY, wind_sd)


def fitted(of: pc.Segment, con: Constants, past: pp.Sums | None = None, close: bool = False) -> pp.Found:
    found = pp.nothing_found(LINES)
    assert pf.fit(of, con, past or pp.no_sums(), close, found)
    return found


def test_columns_are_wing_and_tail_written_out() -> None:
    con = exact()
    f, a, d = flown(np.random.default_rng(1), con)
    _, wing, spans, tails, freed, nuisances = (part[0] for part in pc.no_columns(1, LINES))
    made = pc.Columns(f, wing, spans, tails, freed, nuisances, 1)
    pc.columns(segment(f), con, np.ones(LINES), made)
    np.testing.assert_allclose(made.wing[pc.A], a, rtol=1e-12)
    np.testing.assert_allclose(made.wing[pc.P] - con.downwash * made.wing[pc.Q], d, atol=1e-12)


def test_without_noise_the_derivatives_are_those_flown() -> None:
    con = exact()
    found = fitted(segment(flown(np.random.default_rng(2), con)[0]), con)
    np.testing.assert_allclose(found.theta[:FIRST_NUISANCE], THETA, rtol=1e-6)


def test_equals_generalised_least_squares_of_both_equations() -> None:
    """With exact constants the derivatives are the minimum of the whitened residuals, whose spectra and coherence are
    those of the fit before the last pass: numpy's least squares, as often, with the spectra fitted by scipy."""
    con = exact()
    f, a, d = flown(np.random.default_rng(3), con, noise=0.5)
    found = fitted(segment(f), con)
    x = np.array([a, f[pc.QH], f[pc.DE]])
    z = np.array([f[pc.CL] - con.tail_share * d, f[pc.CM] + con.tail_share * con.arm * d])
    u = np.log(OMEGA / np.pi)
    basis = np.array([np.ones(LINES), u, u * u])

    def spectrum(residual: np.ndarray) -> np.ndarray:
        """Log-quadratic, of greatest likelihood."""
        power = np.abs(residual) ** 2
        start = np.linalg.lstsq(basis.T, np.log(power) + 0.5772156649)[0]
        best = minimize(lambda b: np.sum(b @ basis + power / np.exp(b @ basis)), start, tol=1e-10)
        return np.exp(best.x @ basis)

    weights, coherence = np.array([np.ones(LINES), np.full(LINES, 0.1)]), 0.0j
    for _ in range(pf.PASSES):
        rows, target = [], []
        for i in range(LINES):
            cross = coherence * np.sqrt(weights[0, i] * weights[1, i])
            covariance = np.array([[weights[0, i], cross], [np.conj(cross), weights[1, i]]])
            root = np.linalg.inv(np.linalg.cholesky(covariance))
            block = np.zeros((2, 6), dtype=complex)
            block[0, :3], block[1, 3:] = x[:, i], x[:, i]
            rows.append(root @ block)
            target.append(root @ z[:, i])
        design, wanted = np.concatenate(rows), np.concatenate(target)
        stacked = np.concatenate([design.real, design.imag])
        theta = np.linalg.lstsq(stacked, np.concatenate([wanted.real, wanted.imag]))[0]
        residual = z - np.array([theta[:3] @ x, theta[3:] @ x])
        weights = np.array([spectrum(r) for r in residual]) * LINES / (LINES - 3.5)
        coherence = np.mean(residual[0] * residual[1].conj() / np.sqrt(weights[0] * weights[1]))
    # Five scorings leave the spectra within a thousandth of their likelihood's maximum.
    error = found.statistical[:FIRST_NUISANCE]
    np.testing.assert_allclose(found.theta[:FIRST_NUISANCE], theta, atol=1e-2 * error.min(), rtol=1e-3)
    np.testing.assert_allclose(found.theta[FIRST_NUISANCE:], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.residual, np.sum(np.abs(residual) ** 2, axis=1), rtol=1e-4)
    np.testing.assert_allclose(found.signal, np.sum(np.abs(f[[pc.CL, pc.CM]]) ** 2, axis=1), rtol=1e-12)


def test_two_segments_know_more_than_one() -> None:
    """Of equal records the second halves the variances, but for what the residuals of either are by chance."""
    con, rng = exact(), np.random.default_rng(4)
    past = pp.no_sums()
    one = fitted(segment(flown(rng, con, noise=0.3)[0]), con, past, close=True)
    both = fitted(segment(flown(rng, con, noise=0.3)[0]), con, past)
    assert past.normal.any()
    ratio = both.statistical[:FIRST_NUISANCE] / one.statistical[:FIRST_NUISANCE]
    assert np.median(ratio) == pytest.approx(np.sqrt(0.5), abs=0.15)


def test_intervals_cover_the_truth() -> None:
    """200 records with constants that are known: between 90 and 99.5 % within two standard errors."""
    con, rng = exact(), np.random.default_rng(5)
    hits = np.zeros(FIRST_NUISANCE)
    for _ in range(200):
        found = fitted(segment(flown(rng, con, noise=0.5)[0]), con)
        hits += np.abs(found.theta[:FIRST_NUISANCE] - THETA) < 2 * found.total[:FIRST_NUISANCE]
    assert (hits / 200 > 0.90).all(), hits / 200
    assert (hits / 200 < 0.995).all(), hits / 200


def test_a_constant_that_the_data_do_not_tell_keeps_its_prior() -> None:
    """In calm air without pitching nothing tells the mean wind: its standard error is the prior's, the estimate 0."""
    con = exact()
    found = fitted(segment(flown(np.random.default_rng(6), con, noise=0.5)[0], wind_sd=0.03), con)
    at = FIRST_NUISANCE + WIND
    assert abs(found.theta[at]) < 1e-12
    assert found.total[at] == pytest.approx(pp.SMALL_RECORD * 0.03, rel=1e-6)


def test_what_turbulence_may_not_move_is_considered() -> None:
    """A downwash known to 0.1 moves in calm air; where the gust stands out of the vane's noise it only widens."""
    aircraft = load_aircraft("twin_otter").model_copy(update={"uncertainty": EXACT})
    doubtful = aircraft.model_copy(update={"uncertainty": EXACT.model_copy(update={"downwash": 0.2})})
    con = constants(doubtful)
    f = flown(np.random.default_rng(7), exact(), noise=0.3)[0]
    calm, rough = fitted(segment(f, vane_noise=1e9), con), fitted(segment(f), con)
    assert calm.summary[pf.GUST] == 0.0
    assert rough.summary[pf.GUST] == pytest.approx(1.0)
    assert abs(rough.theta[FIRST_NUISANCE + WASH]) < 1e-6
    known = fitted(segment(f), constants(aircraft))
    np.testing.assert_allclose(rough.theta[:FIRST_NUISANCE], known.theta[:FIRST_NUISANCE], rtol=1e-6)
    assert rough.total[CM_ALPHA] > 1.2 * known.total[CM_ALPHA]
    assert rough.total[CL_ALPHA] > known.total[CL_ALPHA]


def test_silence_has_no_solution() -> None:
    found = pp.nothing_found(LINES)
    assert not pf.fit(segment(np.zeros((pc.CHANNELS, LINES), dtype=complex)), exact(), pp.no_sums(), False, found)


def test_parameters_are_in_one_order() -> None:
    assert PARAMETERS == FIRST_NUISANCE + N
    assert WIND == N - 1
    assert constants(load_aircraft("twin_otter")).prior[ARM_LENGTH] > 0.0


def test_a_log_quadratic_spectrum_is_found_again() -> None:
    """Exactly, where the residual's energy is such at every line; else as scipy's maximum of the likelihood."""
    u = np.log(OMEGA / np.pi)
    wanted = np.exp(0.3 - 1.2 * u + 0.4 * u * u)
    smooth = np.empty(LINES)
    residual_spectrum(np.sqrt(wanted).astype(complex), OMEGA, smooth)
    np.testing.assert_allclose(smooth, wanted, rtol=1e-6)
    residual = np.sqrt(wanted / 2) * complex_normal(np.random.default_rng(8), LINES)
    residual_spectrum(residual, OMEGA, smooth)
    power, basis = np.abs(residual) ** 2, np.array([np.ones(LINES), u, u * u])
    best = minimize(lambda b: np.sum(b @ basis + power / np.exp(b @ basis)), np.zeros(3), tol=1e-10)
    np.testing.assert_allclose(smooth, np.exp(best.x @ basis), rtol=0.02)


def test_a_tail_that_shares_the_span_s_lag_is_in_the_equations() -> None:
    """Wing and tail follow gusts with a first-order lag of half a span: the residual is zero where both nuisances say
    so, and its slopes by them are the difference quotients."""
    con, rng = exact(), np.random.default_rng(8)
    s = 1j * OMEGA
    lag = 1.0 / (1.0 + s * con.span / (ps.SPAN_SLOW * SPEED))
    x, gust, qhat, de = (complex_normal(rng, LINES) for _ in range(4))
    w, k = 0.9 * x, 0.8 * gust
    late = np.exp(-s * con.tail_arm / SPEED)
    f = np.zeros((pc.CHANNELS, LINES), dtype=complex)
    f[ps.X], f[ps.WX], f[ps.KG], f[ps.GC], f[ps.GT] = x, w, k, gust, late * gust
    f[ps.DW], f[ps.DK], f[ps.DX] = late * w, late * k, late * x
    f[ps.KL], f[ps.DKL], f[ps.GTL] = lag * k, lag * late * k, lag * late * gust
    f[pc.QH], f[pc.DE] = qhat, de
    a = w + lag * k
    d = x + lag * late * gust - con.downwash * late * a - (1 - con.downwash) * a - 2 * con.downwash * con.arm * qhat
    f[pc.CL] = THETA[:3] @ [a, qhat, de] + con.tail_share * d
    f[pc.CM] = THETA[3:] @ [a, qhat, de] - con.tail_share * con.arm * d
    made = pc.Columns(f, *(part[0] for part in pc.no_columns(1, LINES)[1:]), 1)
    pc.columns(segment(f), con, np.ones(LINES), made)
    theta = np.zeros(PARAMETERS)
    theta[:FIRST_NUISANCE] = THETA
    theta[FIRST_NUISANCE + SPAN], theta[FIRST_NUISANCE + TAIL_SPAN] = 1.0, 1.0 - TAIL_SPAN_SHARE
    g, rest = np.empty((2, PARAMETERS), dtype=complex), np.empty(2, dtype=complex)
    for i in range(LINES):
        pc.design(made, i, 1.0, con, theta, g, rest)
        assert np.abs(rest).max() < 1e-10
        slopes = g.copy()
        for j in (SPAN, SPAN_MIDDLE, TAIL_SPAN):
            moved = theta.copy()
            moved[FIRST_NUISANCE + j] += 1e-6
            pc.design(made, i, 1.0, con, moved, g, rest)
            np.testing.assert_allclose(-rest / 1e-6, slopes[:, FIRST_NUISANCE + j], rtol=1e-4, atol=1e-6)
