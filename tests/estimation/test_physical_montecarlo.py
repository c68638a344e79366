"""Monte Carlo of `physical` on the simulation's consistent truth, against the tabulated derivatives.

Each record: filters warm for 60 s in the air of the record (the mean wind is an average over that time), then 30 s with
one doublet or multisine, through the estimator that flies. STATION_SEEDS sets the number of records of the slow cases
(default 40); print the table with -s.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

from station.conventions import SIGNALS, TICK_NS
from station.estimation.methods import Estimator
from station.profile import Aircraft, Card, Indicial, load_aircraft
from station.profile.uncertainty import EXACT
from station.rows import Frame
from station.simulation import fly
from station.simulation.sensors import STANDARD

NAMES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
FOUR = [0, 3, 4, 5]
"""What the mean RMSE is over: CL_alpha, Cm_alpha, Cm_q, Cm_de."""
SETS = {"A": "twin_otter_martos", "B": "twin_otter"}
SEEDS = int(os.environ.get("STATION_SEEDS", "40"))
WARM_S = 60.0


def card(sigma: float, kind: str) -> Card:
    doublet = {"kind": "doublet", "start": f"{WARM_S + 2} s", "width": "1.3 s", "amplitude": "3.5 deg"}
    multisine = {"kind": "multisine", "start": f"{WARM_S} s", "duration": "30 s", "amplitude": "2 deg"}
    flight = {"gust_sigma": f"{sigma} ft/s", "speed": "110 kt", "altitude": "2500 ft"}
    given = {"name": "t", "aircraft": "a", "rig": "b", "flight": flight, "warm_up": f"{WARM_S} s"}
    return Card.model_validate({**given, "manoeuvres": [doublet if kind == "doublet" else multisine]})


def scaled(response: Indicial | None, amplitude: float, rate: float) -> Indicial:
    assert response is not None
    return Indicial(a=tuple(amplitude * a for a in response.a), b=tuple(rate * b for b in response.b))


def behind_a_lag(response: Indicial, rate: float) -> Indicial:
    """The response after a first-order lag of that rate, per chord: partial fractions."""
    terms = list(zip(response.a, response.b, strict=True))
    a = [x * rate / (rate - b) for x, b in terms]
    own = 1 - sum(response.a) - sum(x * b / (rate - b) for x, b in terms)
    return Indicial(a=(*a, own), b=(*response.b, rate))


def drawn(aircraft: Aircraft, rng: np.random.Generator) -> tuple[Aircraft, float]:
    """An aircraft all of whose constants differ from the profile's, and its vane's gain (estimator.md 5)."""
    u = rng.uniform
    unsteady, boom = aircraft.unsteady, aircraft.boom
    assert boom is not None
    chord = unsteady.reference_chord or aircraft.geometry.chord
    span_lag = u(0.02, 1.0) * aircraft.geometry.span / 2
    gust = behind_a_lag(scaled(unsteady.lift_gust, 1.0, u(0.6, 1.5)), chord / span_lag)
    wing = boom.upwash_wing * u(0.5, 1.5)
    keys = {
        "tail_lift_slope": unsteady.tail_lift_slope * u(0.7, 1.3),
        "downwash": unsteady.downwash * u(0.7, 1.3),
        "downwash_delay": u(0.0, 0.024),
        "tail_arm": unsteady.tail_arm * u(0.85, 1.15),
        "lift_motion": scaled(unsteady.lift_motion, u(0.6, 1.5), u(0.6, 1.5)),
        "lift_gust": gust,
        "upwash_motion": scaled(unsteady.upwash_motion, 1.0, u(0.6, 1.5)),
        "upwash_gust": scaled(unsteady.upwash_gust, 1.0, u(0.6, 1.5)),
    }
    vane = {
        "vane_x": boom.vane_x * u(0.9, 1.1),
        "upwash_wing": wing,
        "upwash_body": boom.upwash_body + boom.upwash_wing - wing,
        "vane_frequency": u(7.0, 11.0),
        "vane_damping": u(0.25, 0.45),
    }
    real = {"unsteady": unsteady.model_copy(update=keys), "boom": boom.model_copy(update=vane)}
    return aircraft.model_copy(update=real), 1 + u(-0.02, 0.02)


def estimate(aircraft: Aircraft, real: Aircraft, gain: float, c: Card, seed: int) -> np.ndarray:
    """(3, 6): estimates, statistical and total standard errors after the 30 s."""
    shown, _ = fly(real, STANDARD, c, WARM_S + 30.06, seed)
    shown["alpha_vane"] = gain * shown["alpha_vane"]
    n = len(shown["q"])
    rows = np.stack([shown.get(name, np.full(n, math.nan)) for name in SIGNALS], axis=1).tolist()
    ages, quality = (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)
    estimator = Estimator(aircraft, c, methods=("physical",))
    for k, row in enumerate(rows):
        estimator.step(Frame(k * TICK_NS, k, tuple(row), ages, quality))
    assert estimator._physical is not None
    solution = estimator._physical.solution
    assert solution is not None
    return np.stack([solution.theta[:6], solution.stat[:6], solution.total[:6]])


def campaign(which: str, sigma: float, kind: str, count: int, random: bool = False) -> tuple[float, np.ndarray, str]:
    """Mean RMSE of four derivatives in per cent, coverage (2, 6) of the 95 % intervals, statistical and total, and a
    line of the table. The constants are those of the profile, which says that they are exact, or drawn at `random`,
    for a profile with its ordinary uncertainty."""
    aircraft, c = load_aircraft(SETS[which]), card(sigma, kind)
    if not random:
        aircraft = aircraft.model_copy(update={"uncertainty": EXACT})
    found = []
    for i in range(count):
        real, gain = drawn(aircraft, np.random.default_rng([5, i // 2])) if random else (aircraft, 1.0)
        found.append(estimate(aircraft, real, gain, c, 7000 + i))
    estimates = np.array(found)
    truth = np.array([aircraft.value(n) for n in NAMES])
    off = 100 * (estimates[:, 0] - truth) / np.abs(truth)
    rmse = float(np.sqrt(np.mean(off**2, axis=0))[FOUR].mean())
    inside = np.abs(estimates[:, :1] - truth) < 1.96 * estimates[:, 1:]
    coverage = inside.mean(axis=0)
    line = " ".join(f"{m:+.1f}±{s:.1f}" for m, s in zip(off.mean(axis=0), off.std(axis=0), strict=True))
    share = [" ".join(f"{x:.2f}" for x in row) for row in coverage]
    name = f"{which} {sigma:g} {kind}{' drawn' if random else ''}"
    return rmse, coverage, f"| {name} | {line} | {rmse:.2f} | {share[0]} | {share[1]} |"


def test_a_few_records_of_light_turbulence() -> None:
    rmse, coverage, _ = campaign("A", 5.0, "multisine", 6)
    assert rmse < 1.3
    assert coverage[1].mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("which", ["A", "B"])
@pytest.mark.parametrize(
    ("sigma", "kind", "limit", "covered"),
    [
        (0.0, "doublet", 0.6, 0.9),
        (0.0, "multisine", 0.6, 0.9),
        (5.0, "doublet", 0.8, 0.9),
        (5.0, "multisine", 0.6, 0.85),
        (10.0, "doublet", 1.2, 0.6),
    ],
)
def test_constants_as_in_the_profile(which: str, sigma: float, kind: str, limit: float, covered: float) -> None:
    """At sigma 10 ft/s the rest is no noise: gusts times the slow changes of speed, which no constant stands for."""
    rmse, coverage, line = campaign(which, sigma, kind, SEEDS)
    print(f"\n{line}")
    # The limits are for many records: fewer scatter.
    assert rmse < limit * (1 + 1 / math.sqrt(SEEDS))
    assert coverage[1].min() > covered - 0.5 / math.sqrt(SEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["A", "B"])
@pytest.mark.parametrize(
    ("sigma", "kind", "limit"),
    [(0.0, "doublet", 3.0), (5.0, "doublet", 2.2), (5.0, "multisine", 2.2), (10.0, "doublet", 2.8)],
)
def test_every_constant_drawn_at_random(which: str, sigma: float, kind: str, limit: float) -> None:
    rmse, coverage, line = campaign(which, sigma, kind, SEEDS, random=True)
    print(f"\n{line}")
    assert rmse < limit * (1 + 1 / math.sqrt(SEEDS))
    # Two records share their constants: half as many independent draws.
    assert coverage[1].min() > 0.9 - math.sqrt(0.5 / SEEDS)
