"""Air that varies across the span: against isotropic turbulence, MIL-F-8785C, and what a flight shows."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import csd, welch
from scipy.special import gamma, hankel2, jv, kv

from station.profile import Aircraft, Card, Indicial, load_aircraft, load_card
from station.rows import ProfileError
from station.simulation import fly
from station.simulation.gust_plane import Across, PlaneField, across, matrix, response
from station.simulation.gusts import STEP, Dryden, dryden, gust_at, ramp
from station.simulation.isotropic import DRYDEN, VON_KARMAN, cross_spectra
from station.simulation.side_flow import ARGUMENTS
from station.simulation.six_degrees import LateralSimulation
from station.simulation.sortie import check_air, source_of

FT = 0.3048
L, SPAN = 1750 * FT, 65 * FT
AIRCRAFT = load_aircraft("twin_otter")
AIR = Dryden(L, L, L, 1.0, 1.0, 1.0)
TIP = Across(SPAN, 0.0, SPAN / 2, None, 0.0, 2.0, (), ())
"""A wing without a tail, a boom on its tip, quasi-steady."""
U, V, W, U_WING, W_WING, ROLL, YAW, _, _, W_TIP = range(10)
PLANE = load_card("gusty_plane")


def f(kind: str, r: float) -> float:
    """Of Batchelor's f: Dryden's and von Karman's, as the books print them."""
    if kind == "dryden":
        return math.exp(-r / L)
    z = r / (1.339 * L)
    return float(2 ** (2 / 3) / gamma(1 / 3) * z ** (1 / 3) * kv(1 / 3, z))


def correlation(kind: str, pair: str, xi: float, eta: float) -> float:
    r, step = math.hypot(xi, eta), 1e-4
    slope = (f(kind, r + step) - f(kind, r - step)) / (2 * step)
    g = f(kind, r) + 0.5 * r * slope
    along = f(kind, r) - g
    return {
        "uu": g + along * xi**2 / r**2,
        "vv": g + along * eta**2 / r**2,
        "ww": g,
        "uv": along * xi * eta / r**2,
    }[pair]


@pytest.mark.parametrize("kind", ["dryden", "von_karman"])
@pytest.mark.parametrize("eta", [5.0, 60.0])
def test_cross_spectra_are_the_transforms_of_the_correlations(kind: str, eta: float) -> None:
    """By quadrature of the correlation over the separation along the way."""
    kappa = np.array([0.3 / L, 0.02])
    found = cross_spectra(DRYDEN if kind == "dryden" else VON_KARMAN, L, kappa, np.array([eta]))
    for i, k in enumerate(kappa):
        for pair, values in (("uu", found.along), ("vv", found.sideways), ("ww", found.up)):
            wanted = (
                2 * quad(lambda x, p=pair: correlation(kind, p, x, eta), 0, 20 * L, weight="cos", wvar=k, limit=400)[0]
            )
            assert values[i, 0] == pytest.approx(wanted, rel=2e-3, abs=1e-3 * L), pair
        wanted = -2 * quad(lambda x: correlation(kind, "uv", x, eta), 0, 20 * L, weight="sin", wvar=k, limit=400)[0]
        assert found.along_sideways[i, 0] == pytest.approx(wanted, rel=2e-3, abs=1e-3 * L)


@pytest.mark.parametrize("kind", ["dryden", "von_karman"])
def test_on_one_way_they_are_the_specification_s(kind: str) -> None:
    """MIL-F-8785C 3.7.1.1 and 3.7.1.2, one-sided: two-sided over kappa it is pi of it. (1.339 is rounded.)"""
    kappa = np.geomspace(0.01 / L, 3.0, 30)
    found = cross_spectra(DRYDEN if kind == "dryden" else VON_KARMAN, L, kappa, np.zeros(1))
    if kind == "dryden":
        x = (L * kappa) ** 2
        u, w = 2 * L / np.pi / (1 + x), L / np.pi * (1 + 3 * x) / (1 + x) ** 2
    else:
        x = (1.339 * L * kappa) ** 2
        u, w = 2 * L / np.pi / (1 + x) ** (5 / 6), L / np.pi * (1 + 8 / 3 * x) / (1 + x) ** (11 / 6)
    np.testing.assert_allclose(found.along[:, 0], np.pi * u, rtol=5e-5)
    np.testing.assert_allclose(found.sideways[:, 0], np.pi * w, rtol=5e-5)
    np.testing.assert_allclose(found.up[:, 0], np.pi * w, rtol=5e-5)


def energy(k: np.ndarray) -> np.ndarray:
    """Dryden's E(k) of unit variance a component (Hinze 1975, 3-72): 8/pi L (L k)^4 / (1 + (L k)^2)^3."""
    return 8 / np.pi * L * (L * k) ** 4 / (1 + (L * k) ** 2) ** 3


def over_span(kappa: float, component: str, gain: Any) -> float:
    """A span's spectrum after Etkin (1972, 13.3): the three-dimensional one of isotropic turbulence,
    E(k) (delta_ij - k_i k_j/k^2) / 4 pi k^2, integrated over the wavenumbers down and across, these seen through the
    gain of the wing's weights; two-sided over kappa, times 2 pi."""
    edges = np.sinh(np.linspace(0, math.asinh(60 * L), 1201)) / L
    across, down = np.meshgrid(edges[:780], edges, indexing="ij")
    square = kappa**2 + across**2 + down**2
    own = {"u": kappa**2, "w": down**2}[component]
    density = energy(np.sqrt(square)) / (4 * np.pi * square) * (1 - own / square)
    inner = 2 * np.trapezoid(density, edges, axis=1)
    return float(2 * np.trapezoid(inner * np.abs(gain(edges[:780])) ** 2, edges[:780]) * 2 * np.pi)


def mean_gain(across: np.ndarray) -> np.ndarray:
    """Of the elliptic mean: 2 J1(z)/z, z = k_y b/2."""
    z = np.maximum(across * SPAN / 2, 1e-9)
    return 2 * jv(1, z) / z


def gradient_gain(across: np.ndarray) -> np.ndarray:
    """Of the elliptic gradient: 8 J2(z)/z^2 k_y, which goes to k_y."""
    z = np.maximum(across * SPAN / 2, 1e-9)
    return 8 * jv(2, z) / z**2 * across


@pytest.mark.parametrize("kappa", [0.5 / L, 4 / L, 0.04, 0.2])
def test_what_a_span_meets_is_etkin_s_integral(kappa: float) -> None:
    found = matrix(TIP, AIR, "dryden", np.array([kappa]))[0]
    assert found[W_WING, W_WING].real == pytest.approx(over_span(kappa, "w", mean_gain), rel=0.02)
    assert found[U_WING, U_WING].real == pytest.approx(over_span(kappa, "u", mean_gain), rel=0.02)
    assert found[ROLL, ROLL].real == pytest.approx(over_span(kappa, "w", gradient_gain), rel=0.02)
    assert found[YAW, YAW].real == pytest.approx(over_span(kappa, "u", gradient_gain), rel=0.02)


def test_roll_gusts_beside_the_specification_s() -> None:
    """MIL-F-8785C's p_g, 0.8 (pi L/4b)^(1/3) / (L (1 + (4 b kappa/pi)^2)), is one fit for either spectrum: isotropic
    Dryden air has 1.1 to 1.7 of it up to its corner. MIL-HDBK-1797's standard deviation, 1.9 sigma_w / sqrt(L b) (after
    Holley and Bryson 1975), it has within 10 %."""
    corner = math.pi / (4 * SPAN)
    kappa = np.concatenate((np.geomspace(0.1 / L, corner, 40), np.geomspace(1.05 * corner, 60 * corner, 80)))
    found = matrix(TIP, AIR, "dryden", kappa)[:, ROLL, ROLL].real / np.pi
    mil = 0.8 * (math.pi * L / (4 * SPAN)) ** (1 / 3) / L / (1 + (kappa / corner) ** 2)
    ratio = (found / mil)[:40]
    assert ratio.min() > 1.0
    assert ratio.max() < 1.75
    assert np.sqrt(np.trapezoid(found, kappa)) == pytest.approx(1.9 / math.sqrt(L * SPAN), rel=0.1)


def drawn(parts: Across, metres: float, seed: int = 1, model: Dryden = AIR, start_s: float = 0.0) -> PlaneField:
    made = PlaneField(parts, model, "dryden", ramp(56.6, start_s), 10.0, np.random.SeedSequence(seed))
    made.cover(-10.0, metres)
    return made


@pytest.fixture(scope="module")
def long() -> np.ndarray:
    """600 km with a boom on the tip: the CG's way and the tip's, which are two vanes."""
    return drawn(TIP, 6e5).now.values


def test_series_have_their_spectra(long: np.ndarray) -> None:
    """In bands, within four standard errors of as many periodograms as there are (Hann, half overlapped)."""
    n = 2**15
    freq, power = welch(long, fs=1 / STEP, nperseg=n, axis=0, detrend=False)
    kappa = 2 * np.pi * freq
    for low, high in itertools.pairwise([3 / L, 8 / L, 0.03, 0.1, 0.3, 1.0]):
        band = (kappa >= low) & (kappa < high)
        wanted = np.einsum("kii->ki", matrix(TIP, AIR, "dryden", kappa[band])).real
        ratio = (power[band] / (2 * wanted)).mean(axis=0)
        error = math.sqrt(1.9 * n / len(long) / band.sum())
        assert np.abs(ratio - 1).max() < 4 * error + 0.01, (low, ratio)


def test_two_vanes_are_as_coherent_as_isotropic_air(long: np.ndarray) -> None:
    """Half a span apart: coherence of w by Batchelor's correlation, transformed by quadrature."""
    n = 2**15
    freq, one = welch(long[:, W], fs=1 / STEP, nperseg=n, detrend=False)
    _, other = welch(long[:, W_TIP], fs=1 / STEP, nperseg=n, detrend=False)
    _, crossed = csd(long[:, W], long[:, W_TIP], fs=1 / STEP, nperseg=n, detrend=False)
    kappa = 2 * np.pi * freq
    for low, high, loose in ((4 / L, 8 / L, 0.02), (0.04, 0.06, 0.05), (0.1, 0.14, 0.05), (0.3, 0.4, 0.05)):
        band = (kappa >= low) & (kappa < high)
        found = np.abs(crossed[band].sum()) ** 2 / (one[band].sum() * other[band].sum())
        k = kappa[band].mean()
        across = quad(
            lambda x, w=k: correlation("dryden", "ww", x, SPAN / 2), 0, 20 * L, weight="cos", wvar=k, limit=400
        )
        same = quad(lambda x, w=k: correlation("dryden", "ww", x, 1e-3), 0, 20 * L, weight="cos", wvar=k, limit=400)
        assert found == pytest.approx((across[0] / same[0]) ** 2, abs=loose), k


def pitch_gust(parts: Across, arm: float, kappa: np.ndarray) -> np.ndarray:
    """Spectrum of the wing's mean less the tail's, which meets it later by the arm, over the arm; one-sided."""
    spectra, tail = matrix(parts, AIR, "dryden", kappa), 8
    crossed = (spectra[:, W_WING, tail] * np.exp(1j * kappa * arm)).real
    return (spectra[:, W_WING, W_WING] + spectra[:, tail, tail]).real / arm**2 / np.pi - 2 * crossed / arm**2 / np.pi


def test_pitch_gusts_beside_the_specification_s() -> None:
    """MIL-F-8785C's q_g = dw_g/dx, kappa^2 Phi_w / (1 + (4 b kappa/pi)^2): a small aircraft's, over its arm, is a
    difference quotient's; the Twin Otter's has 1.1 to 1.4 of MIL's, for the wing averages more than the tail does."""
    arm, kappa = 24.5 * FT, np.geomspace(3 / L, 0.02, 12)
    phi = L / np.pi * (1 + 3 * (L * kappa) ** 2) / (1 + (L * kappa) ** 2) ** 2
    quotient = np.sinc(kappa * arm / (2 * np.pi)) ** 2
    small = pitch_gust(Across(0.2, 0.1, 0.0, None, 0.0, 2.0, (), ()), arm, kappa)
    np.testing.assert_allclose(small, kappa**2 * phi * quotient, rtol=0.02)
    ratio = pitch_gust(TIP._replace(tail=6.3), arm, kappa) / phi * (1 + (4 * SPAN * kappa / np.pi) ** 2) / kappa**2
    assert ratio.min() > 1.1
    assert ratio.max() < 1.4


def test_yaw_gusts_beside_the_specification_s(long: np.ndarray) -> None:
    """MIL-F-8785C's r_g = dv_g/dx, kappa^2 Phi_v / (1 + (3 b kappa/pi)^2), is what a fin makes of the side gust that it
    meets later by its arm: of a series, its difference quotient. The specification's span averages, a fin does not:
    1.0 to 1.2 of it up to 0.02/m, within four standard errors of as many periodograms."""
    n, steps = 2**15, round(26 * FT / STEP)
    arm = steps * STEP
    rate = (long[steps:, V] - long[:-steps, V]) / arm
    freq, power = welch(rate, fs=1 / STEP, nperseg=n, detrend=False)
    kappa = 2 * np.pi * freq
    phi = L / np.pi * (1 + 3 * (L * kappa) ** 2) / (1 + (L * kappa) ** 2) ** 2
    mil = kappa**2 * phi / (1 + (3 * SPAN * kappa / np.pi) ** 2)
    for low, high in itertools.pairwise([3 / L, 8 / L, 0.03]):
        band = (kappa >= low) & (kappa < high)
        error = math.sqrt(1.9 * n / len(long) / band.sum())
        found = power[band] / (2 * np.pi)
        quotient = np.sinc(kappa[band] * arm / (2 * np.pi)) ** 2
        assert (found / (kappa[band] ** 2 * phi[band] * quotient)).mean() == pytest.approx(1.0, abs=4 * error + 0.01)
        assert 1.0 - 4 * error < (found / mil[band]).mean() < 1.2 + 4 * error


def test_a_strip_follows_a_gust_as_sears_found() -> None:
    """With Kuessner's function as Bisplinghoff, Ashley and Halfman print it (1955, 5-383), 1 - 0.236 e^(-0.058 s)
    - 0.513 e^(-0.364 s) - 0.171 e^(-2.42 s), s in half chords, the response of what rolls the wing is Sears' function,
    its gust told at the leading edge."""
    chord = 2.0
    parts = TIP._replace(chord=chord, amplitudes=(0.236, 0.513, 0.171), rates=(0.116, 0.728, 4.84))
    k = np.linspace(0.01, 1.0, 30)
    h0, h1 = hankel2(0, k), hankel2(1, k)
    theodorsen = h1 / (h1 + 1j * h0)
    sears = ((jv(0, k) - 1j * jv(1, k)) * theodorsen + 1j * jv(1, k)) * np.exp(-1j * k)
    assert np.abs(response(parts, 2 * k / chord) - sears).max() < 0.03


def test_the_same_field_in_any_pieces_and_flat_memory() -> None:
    whole, pieces, most = drawn(TIP, 30_000.0), drawn(TIP, 0.0), 0
    for s in np.arange(0.0, 29_000.0, 577.3):
        pieces.cover(s - 10.0, s + 600.0)
        most = max(most, len(pieces.now.values))
        for column in (U, V, ROLL, W_TIP):
            assert gust_at(pieces.now, s, column) == gust_at(whole.now, s, column)
    assert most < 12_000


def test_turbulence_that_begins_in_flight_and_calm_air() -> None:
    late = drawn(TIP, 3000.0, start_s=16.0)
    place = (late.now.first + np.arange(len(late.now.values))) * STEP
    assert not late.now.values[place < 16 * 56.6].any()
    np.testing.assert_array_equal(late.now.values[place > 17 * 56.6], drawn(TIP, 3000.0).now.values[place > 17 * 56.6])
    assert not drawn(TIP, 100.0, model=dryden(762.0, 0.0)).now.values.any()


def card(aircraft: Aircraft = AIRCRAFT, **keys: Any) -> Card:
    flight = {"field": "plane", "speed": "110 kt", "altitude": "2500 ft", **keys}
    return Card.model_validate({"name": "t", "aircraft": "a", "rig": "r", "flight": flight})


def flown(card: Card, seconds: float, aircraft: Aircraft = AIRCRAFT) -> dict[str, np.ndarray]:
    manoeuvres = PLANE.card.manoeuvres
    return LateralSimulation(aircraft, card.flight, manoeuvres).advance(round(200 * seconds))


def with_fin(**keys: float) -> Aircraft:
    assert AIRCRAFT.fin is not None
    return AIRCRAFT.model_copy(update={"fin": AIRCRAFT.fin.model_copy(update=keys)})


def test_in_calm_air_a_fin_without_sidewash_makes_the_profile_s_derivatives() -> None:
    """Share in, share out: the flight on a line is the same but for arcsines of less than 0.1 rad."""
    plane, line = flown(card(), 50, with_fin(sidewash=0.0)), flown(card(field="line"), 50)
    for name in ("p", "r", "beta", "phi", "ay", "beta_vane"):
        np.testing.assert_allclose(plane[name], line[name], atol=4e-3 * np.abs(line[name]).max(), err_msg=name)


def test_the_fin_meets_gust_and_sidewash_later_by_its_arm() -> None:
    aircraft = with_fin(sidewash=0.3)
    assert aircraft.fin is not None
    f = flown(card(gust_sigma="5 ft/s"), 60, aircraft)
    late = aircraft.fin.arm / f["airspeed"].mean()
    t = f["time"]
    gust, beta = (np.interp(t - late, t, f[n]) for n in ("v_gust", "beta"))
    moved = f["beta"] - f["v_gust"] / f["airspeed"]
    turned = (aircraft.fin.height * f["p"] - aircraft.fin.arm * f["r"] + gust) / f["airspeed"]
    wanted = moved + turned - 0.3 * beta
    later = t > 1
    # The way is flown at the speed of the instant, not the mean one: 3 % of 0.13 s.
    assert np.std((f["beta_fin"] - wanted)[later]) < 0.02 * np.std(f["beta_fin"])
    together = moved + (gust * 0 + f["v_gust"]) / f["airspeed"]
    assert np.std((together - f["beta"])[later]) < 1e-3  # the sum above is built of what was flown


def test_gradients_act_as_rates_and_the_fin_by_itself() -> None:
    """Least squares on the truth: what is left without the fin multiplies p + p_g and r + r_g."""
    f = flown(card(gust_sigma="10 ft/s"), 60)
    fin, span = AIRCRAFT.fin, AIRCRAFT.geometry.span
    assert fin is not None
    hat = span / (2 * f["airspeed"])
    columns = [f["beta"], (f["p"] + f["p_gust"]) * hat, (f["r"] + f["r_gust"]) * hat, f["aileron"], f["rudder"]]
    x = np.stack([*columns, f["beta_fin"]], axis=1)
    arms = {"CY": 1.0, "Cl": fin.height / span, "Cn": -fin.arm / span}
    for name, arm in arms.items():
        found = np.linalg.lstsq(x, f[name], rcond=None)[0]
        assert found[5] == pytest.approx(-fin.lift_slope * arm)
        by_beta, by_p, by_r = 1 - fin.sidewash, 2 * fin.height / span, -2 * fin.arm / span * (1 + fin.sidewash)
        share = -fin.lift_slope * arm * np.array([by_beta, by_p, by_r, 0.0, 0.0])
        wanted = np.array([AIRCRAFT.value(f"{name}_{a}") for a in ARGUMENTS]) - share
        np.testing.assert_allclose(found[:5], wanted, atol=1e-9)


def test_gusts_alone_roll_an_aircraft_in_a_plane_only() -> None:
    """With neither dihedral nor yaw's roll, side gusts cannot; gradients of w do: without inputs p follows -p_g."""
    keep = {n: d for n, d in AIRCRAFT.derivatives.items() if n[:2] != "Cl" or n == "Cl_p"}
    level = AIRCRAFT.inertia.model_copy(update={"ixz": 0.0})
    aircraft = AIRCRAFT.model_copy(update={"derivatives": keep, "inertia": level, "fin": with_fin(height=0.0).fin})
    made = LateralSimulation(aircraft, card(gust_sigma="5 ft/s").flight, hold=False).advance(20_000)
    assert np.corrcoef(made["p"], made["p_gust"])[0, 1] < -0.5
    line = LateralSimulation(aircraft, card(gust_sigma="5 ft/s", field="line").flight, hold=False).advance(4000)
    assert np.abs(line["p"]).max() < 1e-2 * made["p"].std()  # of pitching and yawing at once


def test_a_beta_vane_in_sidewash_and_at_its_boom_s_place() -> None:
    assert AIRCRAFT.boom is not None
    boom = AIRCRAFT.boom.model_copy(update={"sidewash": 0.2})
    f, more = (flown(card(gust_sigma="5 ft/s"), 10, a) for a in (AIRCRAFT, AIRCRAFT.model_copy(update={"boom": boom})))
    np.testing.assert_allclose(more["beta_vane"], 1.2 * f["beta_vane"], atol=1e-12)
    aside = AIRCRAFT.boom.model_copy(update={"vane_y": 5.0})
    g = flown(card(gust_sigma="5 ft/s"), 10, AIRCRAFT.model_copy(update={"boom": aside}))
    assert np.std(g["beta_vane"] - f["beta_vane"]) > 0.1 * np.std(f["beta_vane"])


@pytest.mark.parametrize(
    ("change", "flight", "message"),
    [
        ({"fin": None}, {}, r"fin: missing.*\[fin\] lift_slope and arm"),
        ({"unsteady": AIRCRAFT.unsteady.model_copy(update={"memory": False})}, {}, "memory: false"),
        ({"unsteady": AIRCRAFT.unsteady.model_copy(update={"tail_arm": 0.0})}, {}, "tail_arm: missing"),
        ({"unsteady": AIRCRAFT.unsteady.model_copy(update={"tail_span": 30.0})}, {}, "wider than the wing"),
    ],
)
def test_a_profile_without_geometry_is_refused(change: dict[str, Any], flight: dict[str, Any], message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        check_air(AIRCRAFT.model_copy(update=change), card(**flight).flight)
    with pytest.raises(ProfileError, match=message):
        fly(AIRCRAFT.model_copy(update=change), {}, card(**flight), 1.0)


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        ({"gust_length": "1 m"}, "gust_length"),
        ({"gust_length": "40 km"}, "gust_length"),
        ({"field": "cube"}, "field"),
        ({"field": "line", "spectrum": "von_karman"}, "a line has Dryden"),
        ({"source": "jsbsim"}, "only the simulation flies in a plane"),
    ],
)
def test_air_that_cannot_be_is_refused(flight: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        card(**flight)


def test_three_degrees_of_freedom_without_lateral_derivatives() -> None:
    """Then wings stay level; wing and tail still meet their means."""
    lateral = {n: d for n, d in AIRCRAFT.derivatives.items() if n[:2] in ("CL", "CD", "Cm")}
    aircraft = AIRCRAFT.model_copy(update={"derivatives": lateral, "fin": None})
    rows = source_of(aircraft, card(gust_sigma="5 ft/s")).advance(400)
    assert "p_gust" not in rows
    assert np.std(rows["alpha_gust"]) > 0


def test_across_says_what_meets_another_gust() -> None:
    found = across(AIRCRAFT)
    assert found.wing == pytest.approx(SPAN)
    assert found.tail == pytest.approx(20.7 * FT)
    assert isinstance(AIRCRAFT.unsteady.lift_gust, Indicial)
    assert found.amplitudes == AIRCRAFT.unsteady.lift_gust.a
