"""What the lift's memory does to split+gust: against numpy's least squares of the same terms, and in flights."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from station.campaign import case
from station.campaign.spec import METHODS, Campaign, Case, Plan
from station.model import unsteady_lift as lift_memory
from station.profile import Indicial, load_aircraft

DOUBLET = {"kind": "doublet", "start": "2 s", "width": "1.3 s", "amplitude": "3.5 deg"}
MULTISINE = {"kind": "multisine", "start": "0 s", "duration": "30 s", "amplitude": "2 deg"}
SETS = {"A": "twin_otter_martos", "B": "twin_otter"}
SPEED, DENSITY = 56.6, 0.9


def response(fit: Indicial | None, s: np.ndarray, chord: float) -> np.ndarray:
    """1/s of the step response 1 - sum a e^{-b V t/c}, times s."""
    assert fit is not None
    per_chord = s * chord / SPEED
    return 1 - sum(a * per_chord / (per_chord + b) for a, b in zip(fit.a, fit.b, strict=True))


def fitted(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Complex least squares with real parameters."""
    columns, target = np.concatenate([x.real, x.imag], axis=1).T, np.concatenate([z.real, z.imag])
    return np.linalg.lstsq(columns, target)[0]


def test_what_is_left_out_is_what_least_squares_makes_of_wing_and_tail() -> None:
    """Two segments, the first closed; wing and tail written out for motion and gust apart."""
    aircraft = load_aircraft("twin_otter")
    u, g = aircraft.unsteady, aircraft.geometry
    frequencies = np.arange(0.1, 2.0001, 0.04)
    s = 2j * np.pi * frequencies
    rng = np.random.default_rng(3)
    memory = np.zeros((lift_memory.ROWS, len(frequencies)), dtype=complex)
    lift_memory.weights(lift_memory.known(aircraft), SPEED, DENSITY, frequencies, memory)
    theta = np.array([[5.7, 12.0, 0.6], [-1.1, -39.0, -1.8]])
    late = np.exp(-s * u.tail_arm / SPEED)
    wagner = response(u.lift_motion, s, u.reference_chord or g.chord)
    kuessner = response(u.lift_gust, s, u.reference_chord or g.chord) * np.exp(s * g.chord / 4 / SPEED)
    lc, e = u.tail_arm / g.chord, u.downwash

    def left_out(motion: np.ndarray, gust: np.ndarray, qhat: np.ndarray) -> list[np.ndarray]:
        wing = wagner * motion + kuessner * gust
        tail = motion + late * gust - e * late * wing - (1 - e) * wing - 2 * e * lc * qhat
        share = u.tail_lift_slope
        own = wing - motion - gust
        return [theta[0, 0] * own + share * tail, theta[1, 0] * own - share * lc * tail]

    # Short period: (m V/qbar S) d alpha/dt = (m V/qbar S) q - CL, (Iyy/qbar S c) dq/dt = Cm.
    pressure = 0.5 * DENSITY * SPEED**2 * g.wing_area
    heave, pitch = aircraft.inertia.mass * SPEED / pressure, (aircraft.inertia.iyy or 0.0) / (pressure * g.chord)
    per_rate = 2 * SPEED / g.chord
    past = lift_memory.no_sums()
    normal = np.zeros((4, 4))
    regressors, calm, terms, calm_terms = [], [], [], []
    for close in (True, False):
        de, gust, motion, qhat = rng.normal(size=(4, len(frequencies))) + 1j * rng.normal(size=(4, len(frequencies)))
        x = np.array([motion + gust, qhat, de, gust * (1 - late)])
        alone = []
        for k in range(len(frequencies)):
            system = np.array(
                [
                    [heave * s[k] + theta[0, 0], theta[0, 1] - heave * per_rate],
                    [-theta[1, 0], pitch * s[k] * per_rate - theta[1, 1]],
                ]
            )
            alone.append([*np.linalg.solve(system, np.array([-theta[0, 2], theta[1, 2]]) * de[k]), de[k]])
        normal += (x.conj() @ x.T).real
        out = lift_memory.drift(memory, x, theta, np.linalg.inv(normal), past, close)
        regressors.append(x)
        calm.append(np.array(alone).T)
        terms.append(left_out(motion, gust, qhat))
        calm_terms.append(left_out(calm[-1][0], 0 * gust, calm[-1][1]))
    for equation in range(2):
        met = fitted(np.concatenate(regressors, axis=1), np.concatenate([t[equation] for t in terms]))
        still = fitted(np.concatenate(calm, axis=1), np.concatenate([t[equation] for t in calm_terms]))
        assert out[equation] == pytest.approx(met[:3] - still, rel=1e-6)


def test_an_aircraft_without_memory_leaves_nothing_out() -> None:
    aircraft = load_aircraft("twin_otter")
    for unsteady, inertia in (({"memory": False}, {}), ({"tail_arm": 0.0}, {}), ({}, {"iyy": None})):
        other = aircraft.model_copy(
            update={
                "unsteady": aircraft.unsteady.model_copy(update=unsteady),
                "inertia": aircraft.inertia.model_copy(update=inertia),
            }
        )
        assert lift_memory.known(other).heave == 0


def flights(
    which: str, sigma: float, kind: str, count: int, **flight: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of split+gust, (runs, 6): errors from what the manoeuvre gives in calm air, statistical and model errors."""
    campaign = Campaign.model_validate(
        {
            "name": "t",
            "runs": count,
            "methods": ["II", "split", "split+gust"],
            "reference": "calm",
            "warm_up": "60 s",
            "record": "30 s",
            "inputs": {"m": [DOUBLET if kind == "doublet" else MULTISINE]},
            "flight": {"aircraft": SETS[which], "turbulence": f"{sigma} ft/s", **flight},
        }
    )
    plan = Plan(campaign, (Case(0, {}, campaign.flight),), "")
    setup = case.prepare(plan, plan.cases[0])
    at = METHODS.index("split+gust")
    wanted = case.reference(plan, setup)[at].ravel()
    made = [results for _, results in case.fly_case(setup, range(400, 400 + count))]
    value, error, model = (
        np.concatenate([getattr(r, name)[:, at].reshape(-1, 6) for r in made])
        for name in ("estimate", "error", "model")
    )
    return value - wanted, error, model


def test_cm_q_of_a_doublet_in_light_turbulence_is_within_its_error() -> None:
    """The estimates are 4 % too small in size there, of which the error must tell."""
    off, error, model = flights("A", 5.0, "doublet", 24)
    assert off[:, 4].mean() > 0.02 * 50
    # 24 flights: 0.83 is three standard deviations of a count below 0.96.
    assert np.mean(np.abs(off[:, 4]) < 2 * np.hypot(error, model)[:, 4]) > 0.83
    assert np.mean(np.abs(off[:, 4]) < 2 * error[:, 4]) < 0.8


def test_at_altitude_the_error_knows_how_thin_the_air_is() -> None:
    """At 40,000 ft Cm_alpha of calm air is nearly the quasi-steady one, and the estimate 0.6 % off it; reckoned with
    the density near the ground it would be 12 %."""
    off, _, model = flights("B", 10.0, "doublet", 8, speed="200 kt", altitude="40000 ft")
    wanted = abs(off[:, 3].mean())
    assert 0.003 * 1.1 < wanted < 0.012 * 1.1
    # The other errors of the model add to it, most of all the vane's scale, 3 % of Cm_alpha (-1.31).
    assert 0.5 * wanted < np.median(model[:, 3]) < np.hypot(4 * wanted, 0.03 * 1.31)


@pytest.mark.slow
def test_two_standard_errors_cover_calm_air_s_values_at_every_level() -> None:
    """60 flights a case: 0.8 is three standard deviations of a count below 0.92."""
    shares = []
    for which, kind, sigma in itertools.product("AB", ("doublet", "multisine"), (0.0, 2.5, 5.0, 10.0)):
        off, error, model = flights(which, sigma, kind, 60)
        shares.append((np.abs(off) < 2 * np.hypot(error, model)).mean(axis=0))
        print(which, kind, sigma, shares[-1].round(2))
        if sigma == 0:
            # No drift, only what the sensors' noise takes off: a third of a standard error of CL_alpha.
            assert np.all(np.median(model, axis=0) < 0.5 * np.median(error, axis=0))
    found = np.array(shares)
    assert found.mean() > 0.94
    assert found.min() > 0.8
