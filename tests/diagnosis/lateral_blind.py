"""Flights with hidden lateral effects, and the score of a diagnosis.

The station's simulation flies the effect as the extended profile has it, on an aircraft whose lateral derivatives,
inertias, sidewash and fin are not quite the profile's, with the zeros that instruments have; in turbulence the air
varies across the span, and the fin meets it late. The engine sees records and the profile.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from station.conventions import LATERAL
from station.diagnosis.axis import ACROSS
from station.diagnosis.effects import BY_ID, extended
from station.diagnosis.manoeuvre import Manoeuvre, manoeuvre
from station.diagnosis.measured_record import Record, lateral_record, manoeuvres
from station.diagnosis.procedure import Diagnosis, diagnose
from station.profile import Aircraft, Card, Doublet, Flight, Multisine, load_aircraft
from station.profile import Manoeuvre as Input
from station.profile.profile_changes import bias, boom, derivative, gain, inertia, principal_axes
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

KINDS = ("doublets", "multisine", "steps")
SIGMAS = (0.0, 5.0, 10.0)
"""ft/s."""
QUIET_S, SECONDS = 10.0, 55.0
MOVING = math.radians(0.05)
"""rad/s: of a surface that moves."""
ZEROS = {"phi": 0.1, "p": 0.05, "r": 0.05, "beta_vane": 0.3, "aileron": 0.3, "rudder": 0.3}
"""deg(/s)."""


DETECTABLE = {
    "beta_vane.delay": (0.025, 0.026, 0.03),
    "beta_vane.scale": (0.29, 0.32, 0.34),
    "beta_vane.position": (1.8, 1.8, 2),
    "p.delay": (0.0018, 0.0018, 0.0018),
    "p.scale": (0.0074, 0.0074, 0.0077),
    "r.delay": (0.003, 0.003, 0.003),
    "r.scale": (0.016, 0.016, 0.015),
    "phi.delay": (0.0077, 0.0081, 0.0083),
    "phi.scale": (0.014, 0.014, 0.013),
    "phi.bias": (0.14, 0.017, 0.011),
    "psi.delay": (0.0085, 0.0093, 0.01),
    "psi.scale": (0.016, 0.016, 0.016),
    "imu_lateral.delay": (0.0019, 0.0028, 0.0041),
    "ay.scale": (0.019, 0.018, 0.018),
    "ay.bias": (2.5, 0.24, 0.19),
    "ay.delay": (0.0045, 0.0051, 0.0055),
    "ay.position": (0.07, 0.066, 0.062),
    "ay.height": (0.037, 0.036, 0.035),
    "aileron.lag": (0.002, 0.0087, 0.015),
    "aileron.scale": (0.62, 0.59, 0.6),
    "aileron.backlash": (0.0012, 0.004, 0.0065),
    "rudder.lag": (0.0032, 0.0037, 0.0056),
    "rudder.scale": (0.5, 0.5, 0.51),
    "rudder.backlash": (0.0019, 0.0021, 0.0032),
    "inertia.roll": (0.46, 0.38, 0.4),
    "inertia.yaw": (0.6, 0.4, 0.4),
    "inertia.axes": (0.18, 0.18, 0.18),
    "aero.lateral_icing": (1.9, 1.8, 1.9),
    "gust.fin_penetration": (math.inf, 0.38, 0.4),
    "aero.sidewash_lag": (0.35, 0.4, math.inf),
}  # fmt: skip
"""Size found nine times in ten with doublets and a multisine, SI, by SIGMAS (detectable_sizes of one flight)."""
ONE_SIGN = ("aileron.backlash", "rudder.backlash", "aero.lateral_icing", "aero.sidewash_lag")


def planted(name: str, times: float, sigma: float, sign: int) -> float:
    """An effect's value at so many times its detectable size; not a number where that is not physical."""
    term, x = BY_ID[name], times * DETECTABLE[name][SIGMAS.index(sigma)]
    x = x if name in ONE_SIGN else sign * x
    return x if 0.9 * term.low <= x <= 0.9 * term.high else math.nan


def inputs(kind: str) -> tuple[Input, ...]:
    """Aileron and rudder of a manoeuvre, in turn or together."""
    if kind == "multisine":
        return tuple(
            Multisine.model_validate({
                "kind": "multisine", "surface": s, "start": "12 s", "duration": "40 s", "high": "1.8 Hz",
                "amplitude": "4 deg",
            })
            for s in ("aileron", "rudder")
        )  # fmt: skip
    rows = (
        (("rudder", 12, 5, 1.0), ("aileron", 20, 5, 0.8), ("rudder", 30, -4, 0.6), ("aileron", 38, -4, 1.2))
        if kind == "doublets"
        else (("aileron", 12, 4, 0.5), ("aileron", 18, -6, 0.7), ("rudder", 26, 6, 0.8), ("rudder", 36, 3, 1.4))
    )
    return tuple(
        Doublet.model_validate({
            "kind": "doublet", "surface": s, "start": f"{at} s", "amplitude": f"{deg} deg", "width": f"{w} s",
        })
        for s, at, deg, w in rows
    )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One hidden truth: planted effects (SI) by id, air, seed."""

    seed: int
    sigma: float = 0.0
    """ft/s."""
    effects: Mapping[str, float] = field(default_factory=dict)
    fit_on: tuple[str, ...] = KINDS[:2]
    hold_out: tuple[str, ...] = KINDS[2:]
    off: float = 1.0
    """How far the aircraft is off its profile, times what profiles are."""


def aircraft() -> Aircraft:
    """The profile that the engine is given."""
    return load_aircraft("twin_otter")


def true_aircraft(case: Case) -> Aircraft:
    """What is flown: off the profile, then with the effects."""
    rng, made, off = np.random.default_rng([case.seed, 5]), aircraft(), case.off
    for name in LATERAL:
        stated = made.derivatives[name]
        sd = math.hypot(stated.sd or 0.0, 0.07 * stated.value)
        made = derivative(name)(made, off * sd * rng.standard_normal())
    for name, sd in (("mass", 0.02), ("ixx", 0.05), ("izz", 0.05)):
        made = inertia(name)(made, off * sd * rng.standard_normal())
    made = principal_axes(made, off * math.radians(1.5) * rng.standard_normal())
    made = boom("vane_x")(made, off * 0.2 * rng.standard_normal())
    made = gain("beta_vane")(made, off * 0.03 * rng.standard_normal())
    for name, sd in ZEROS.items():
        made = bias(name)(made, off * math.radians(sd) * rng.standard_normal())
    made = bias("ay")(made, off * 0.02 * rng.standard_normal())
    assert made.fin is not None
    fin = made.fin.model_copy(update={"sidewash": 0.1 + 0.07 * off * float(rng.uniform(-1, 1))})
    flown = {name: x for name, x in case.effects.items() if not name.endswith("backlash")}
    return extended(made.model_copy(update={"fin": fin}), flown)


def fly_case(case: Case, kind: str, k: int) -> Record:
    """The record of one manoeuvre of a case."""
    seed = int(np.random.default_rng([case.seed, 11, k]).integers(1 << 30))
    air = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{case.sigma} ft/s", "field": "plane", "seed": seed}
    flown = true_aircraft(case)
    card = Card(
        name="t", aircraft="twin_otter", rig="", lateral=True, manoeuvres=inputs(kind),
        flight=Flight.model_validate(air),
    )  # fmt: skip
    shown, truth = fly(flown, STANDARD, card, SECONDS, seed)
    begin = round(QUIET_S * 50)
    for name in ("aileron", "rudder"):
        shown[name] = shown[name] + 0.5 * case.effects.get(f"{name}.backlash", 0.0) * _lead(truth[name])
    columns = {name: x[begin:] for name, x in shown.items()}
    (made,) = manoeuvres(kind, truth["time"][begin:], columns, aircraft())
    return made


def _lead(surface: np.ndarray) -> np.ndarray:
    """By how much of half the backlash a pot leads the surface that it drives: on the side to which that moved last, in
    the middle before."""
    rate = np.gradient(surface, 0.02)
    last = np.maximum.accumulate(np.where(np.abs(rate) > MOVING, np.arange(len(rate)), -1))
    return np.where(last < 0, 0.0, np.sign(rate[last]))


def records(case: Case) -> tuple[list[Record], list[Record]]:
    """A case's manoeuvres, to fit and held out."""
    made = [fly_case(case, kind, k) for k, kind in enumerate((*case.fit_on, *case.hold_out))]
    return made[: len(case.fit_on)], made[len(case.fit_on) :]


def prepared(case: Case) -> list[Manoeuvre]:
    """The lateral manoeuvres to fit, ready to be compared with candidates."""
    rows = [lateral_record(r) for r in records(case)[0]]
    return [manoeuvre(r, aircraft(), ACROSS) for r in rows if isinstance(r, Record)]


def diagnosed(case: Case) -> Diagnosis:
    """Of both axes."""
    fit, kept = records(case)
    return diagnose(fit, kept, aircraft())


def score(case: Case, d: Diagnosis) -> str:
    """As blind.score, of the lateral names. A zero drawn so large that it is named, as what it is, is there."""
    d = d.lateral or d
    flown = true_aircraft(case).instruments
    drawn = {
        e.term.id
        for e in d.effects
        if e.term.id in ("p.bias", "r.bias") and abs(e.value - flown[e.term.id[0]].bias) < 3 * e.sd
    }
    true = set(case.effects)
    names = {e.term.id for e in d.effects} - (drawn - true)
    if not true:
        return "false" if names else "unexplained" if d.verdict == "unexplained" else "clean"
    if names == true:
        return (
            "suspect" if d.verdict == "unexplained" else "group" if any(e.alternatives for e in d.effects) else "exact"
        )
    possible = names | {r for e in d.effects for r in e.alternatives}
    if len(names) == len(true) and true <= possible and d.verdict != "unexplained":
        return "group"
    if not names:
        return "left over" if d.verdict == "unexplained" else "none"
    return "companion" if true < names else "partial" if true & names else "wrong"
