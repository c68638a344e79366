"""Monte Carlo of `physical` on the simulation's consistent truth, against the tabulated derivatives.

Each record: filters warm for 60 s in the air of the record (the mean wind is an average over that time), then 30 s with
one doublet or multisine, through the campaigns' compiled pass, which gives the numbers of the estimator that flies
(tests/campaign). STATION_SEEDS sets the number of records of the slow cases (default 200); print the table with -s.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

from station.campaign import case
from station.campaign.spec import METHODS, Campaign, Case, Plan
from station.profile import Aircraft, Indicial, load_aircraft
from station.profile.uncertainty import Uncertainty

NAMES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
FOUR = [0, 3, 4, 5]
"""What the mean RMSE is over: CL_alpha, Cm_alpha, Cm_q, Cm_de."""
SETS = {"A": "twin_otter_martos", "B": "twin_otter"}
SEEDS = int(os.environ.get("STATION_SEEDS", "200"))
FIRST = int(os.environ.get("STATION_FIRST_SEED", "7000"))
DOUBLET = {"kind": "doublet", "start": "2 s", "width": "1.3 s", "amplitude": "3.5 deg"}
EXACT = Uncertainty.model_validate(dict.fromkeys(Uncertainty.model_fields, 0.0), context="si")
"""Every constant is right."""
MULTISINE = {"kind": "multisine", "start": "0 s", "duration": "30 s", "amplitude": "2 deg"}


def scaled(response: Indicial | None, amplitude: float, rate: float) -> Indicial:
    assert response is not None
    return Indicial(a=tuple(amplitude * a for a in response.a), b=tuple(rate * b for b in response.b))


def behind_a_lag(response: Indicial, rate: float) -> Indicial:
    """The response after a first-order lag of that rate, per chord: partial fractions."""
    terms = list(zip(response.a, response.b, strict=True))
    a = [x * rate / (rate - b) for x, b in terms]
    own = 1 - sum(response.a) - sum(x * b / (rate - b) for x, b in terms)
    return Indicial(a=(*a, own), b=(*response.b, rate))


def drawn(aircraft: Aircraft, rng: np.random.Generator) -> Aircraft:
    """An aircraft all of whose constants differ from the profile's, its vane's gain by up to 2 %."""
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
    body = boom.upwash_body + boom.upwash_wing - wing
    vane = {"vane_x": boom.vane_x * u(0.9, 1.1), "vane_frequency": u(7.0, 11.0), "vane_damping": u(0.25, 0.45)}
    # The vane reads (1 + body + wing) times the flow angle: a gain is in both.
    gain = 1 + u(-0.02, 0.02)
    vane |= {"upwash_wing": gain * wing, "upwash_body": gain * (1 + body) - 1}
    real = {"unsteady": unsteady.model_copy(update=keys), "boom": boom.model_copy(update=vane)}
    return aircraft.model_copy(update=real)


def flown(known: Aircraft, real: Aircraft, sigma: float, kind: str, seeds: range) -> np.ndarray:
    """(records, 3, 6): estimates, statistical and total standard errors after the 30 s."""
    campaign = Campaign.model_validate(
        {
            "name": "t",
            "runs": len(seeds),
            "methods": ["physical"],
            "warm_up": "60 s",
            "record": "30.06 s",
            "inputs": {"m": [DOUBLET if kind == "doublet" else MULTISINE]},
            "flight": {"turbulence": f"{sigma} ft/s"},
        }
    )
    plan = Plan(campaign, (Case(0, {}, campaign.flight),), "")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(case, "flown_aircraft", lambda *_: real)
        patch.setattr(case, "known_aircraft", lambda *_: known)
        setup = case.prepare(plan, plan.cases[0])
    found = []
    for _, results in case.fly_case(setup, seeds):
        at = METHODS.index("physical")
        value, stat, more = (x[:, at].reshape(-1, 6) for x in (results.estimate, results.error, results.model))
        found.append(np.stack([value, stat, np.hypot(stat, more)], axis=1))
    return np.concatenate(found)


def campaign(which: str, sigma: float, kind: str, count: int, random: bool = False) -> tuple[float, np.ndarray, str]:
    """Mean RMSE of four derivatives in per cent, coverage (2, 6) of the 95 % intervals, statistical and total, and a
    line of the table. The constants are those of the profile, which says that they are exact, or drawn at `random`,
    every two records anew, for a profile with its ordinary uncertainty."""
    aircraft = load_aircraft(SETS[which])
    if random:
        estimates = np.concatenate(
            [
                flown(
                    aircraft, drawn(aircraft, np.random.default_rng([FIRST, i])), sigma, kind, range(first, first + 2)
                )
                for i, first in enumerate(range(FIRST, FIRST + count, 2))
            ]
        )
    else:
        exact = aircraft.model_copy(update={"uncertainty": EXACT})
        estimates = flown(exact, exact, sigma, kind, range(FIRST, FIRST + count))
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


CASES = [(sigma, kind) for sigma in (0.0, 5.0, 10.0) for kind in ("doublet", "multisine")]


def holds(coverage: np.ndarray, independent: int) -> bool:
    """Whether 90 % for each of six and all together is within three standard deviations of a count."""
    sd = float(np.sqrt(0.9 * 0.1 / independent))
    return bool(coverage.min() > 0.9 - 3 * sd and coverage.mean() > 0.9)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["A", "B"])
@pytest.mark.parametrize(("sigma", "kind"), CASES)
def test_constants_as_in_the_profile(which: str, sigma: float, kind: str) -> None:
    rmse, coverage, line = campaign(which, sigma, kind, SEEDS)
    print(f"\n{line}")
    assert rmse < (0.7 if kind == "doublet" else 0.5)
    assert holds(coverage[1], SEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["A", "B"])
@pytest.mark.parametrize(("sigma", "kind"), CASES)
def test_every_constant_drawn_at_random(which: str, sigma: float, kind: str) -> None:
    rmse, coverage, line = campaign(which, sigma, kind, SEEDS, random=True)
    print(f"\n{line}")
    assert rmse < 3.0
    # Two records share their constants: half as many independent draws.
    assert holds(coverage[1], SEEDS // 2)
