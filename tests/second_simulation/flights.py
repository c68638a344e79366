"""Flights with answers, drawn wider than the station assumes: contract CSV, answers.json, the truth beside.

    uv run python -m tests.second_simulation.flights FOLDER [--identify 48] [--diagnose 20] [--lateral 8] [--seed 1]

`identify_NN`: one manoeuvre after 20 s of quiet flight. `diagnose_NN_a`, `_b` (to fit) and `_h` (held out): one
aircraft with one thing hidden, or nothing, two or three. `lateral_NN`: ailerons and rudder. answers.json has each
flight's `derivatives` (memory apart), `quasi_steady` (what equation error makes of the same flight in calm air with
the true angle of attack), what was drawn, `hidden`, and `deviations`: how all of it differs from the profile, by the
catalogue's ids.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tests.second_simulation import hidden as hides
from tests.second_simulation.air import KINDS, air
from tests.second_simulation.aircraft import CHORD, DEG, FT, Drawn, drawn
from tests.second_simulation.instruments import ZEROS, recorded
from tests.second_simulation.motion import DT, RATE, Feedback, Hidden, constants, fly

Array = NDArray[np.float64]

QUIET: Final = 20.0
"""Seconds of flight before the manoeuvre."""
INPUTS: Final = ("doublets", "3211", "multisine", "pulses", "pilot")
RATES: Final = (5.0, 10.0, 12.5, 20.0, 25.0, 40.0, 50.0, 50.0, 100.0)
UNITS: Final = {
    "airspeed": "m/s", "dynamic_pressure": "Pa", "ax": "m/s2", "ay": "m/s2", "az": "m/s2", "v_north": "m/s",
    "v_east": "m/s", "v_down": "m/s", "altitude": "m", "thrust": "N", "p": "rad/s", "q": "rad/s", "r": "rad/s",
}  # fmt: skip
"""rad, where none is named."""
PLANAR: Final = (
    "alpha_vane", "q", "theta", "az", "ax", "airspeed", "dynamic_pressure", "elevator", "v_down", "v_north", "altitude",
    "thrust",
)  # fmt: skip
"""What a longitudinal flight has recorded."""


@dataclass(frozen=True)
class Case:
    """One flight."""

    name: str
    seed: tuple[int, ...]
    aircraft: Drawn
    """Sound."""
    sigma: float
    """Of updraughts, m/s."""
    scale: float
    """Of the gusts, m."""
    spectrum: str
    kind: str
    rate: float
    noise: float
    feedback: Feedback
    hidden: dict[str, float]
    zeros: dict[str, float]
    thrust_recorded: bool
    seconds: float = 60.0
    lateral: bool = False


@dataclass(frozen=True)
class Flown:
    """What a case's recorder has, and what was true."""

    time: Array
    shown: dict[str, Array]
    true: dict[str, Array]
    answers: dict


def stick(kind: str, n: int, amplitude: float, rng: np.random.Generator) -> Array:
    """An input of `n` steps after QUIET, rad."""
    t = np.arange(n) * DT - QUIET
    out = np.zeros(n)
    if kind == "doublets":
        for start in np.arange(1.0, t[-1] - 6, 8.0):
            width = rng.uniform(0.4, 1.0)
            size = amplitude * rng.uniform(0.5, 1.0) * rng.choice([-1, 1])
            out += size * ((t >= start) & (t < start + width)) - size * ((t >= start + width) & (t < start + 2 * width))
    elif kind == "3211":
        for start in np.arange(1.0, t[-1] - 9, 13.0):
            unit, sign, begin = rng.uniform(0.3, 0.55), rng.choice([-1, 1]), start
            for steps in (3, 2, 1, 1):
                out += 0.8 * sign * amplitude * ((t >= begin) & (t < begin + steps * unit))
                begin, sign = begin + steps * unit, -sign
    elif kind == "multisine":
        period = t[-1] - 2
        for k in range(int(0.1 * period) + 1, int(1.9 * period), 2):
            out += np.sin(2 * np.pi * k / period * t + rng.uniform(0, 2 * np.pi))
        out *= amplitude * 0.6 / np.abs(out).max() * np.clip(t, 0, 1)
    elif kind == "pulses":
        for start in np.arange(1.0, t[-1] - 4, 5.0):
            width = rng.uniform(0.2, 0.6)
            out += amplitude * rng.choice([-1, 1]) * ((t >= start) & (t < start + width))
    else:  # hand-flown: a random walk of the stick, drawn back, through a hand of 0.15 s
        x = y = 0.0
        for i in range(n):
            x += -x * DT / 0.8 + rng.standard_normal() * np.sqrt(DT)
            y += (x - y) * DT / 0.15
            out[i] = y
        out *= amplitude * 0.5 / out.std()
        out = np.clip(out, -1.3 * amplitude, 1.3 * amplitude)
    return np.where(t >= 0, out, 0.0)


def controls(case: Case, rng: np.random.Generator) -> Array:
    n = int((QUIET + case.seconds) * RATE)
    inputs = np.zeros((3, n))
    amplitude = 3.0 * DEG * (56.6 / case.aircraft.speed) ** 2
    inputs[0] = (0.4 if case.lateral else 1.0) * stick(case.kind, n, amplitude, rng)
    if case.lateral:
        inputs[1], inputs[2] = (stick(case.kind, n, 1.2 * amplitude, rng) for _ in range(2))
    return inputs


def quasi_steady(true: Mapping[str, Array]) -> dict[str, float]:
    """Least squares of CL and Cm on the true alpha, q c/2V and elevator, 0.1 to 2 Hz by 0.04, of calm air."""
    begin = int(QUIET * RATE)
    y = {k: true[k][begin:] for k in ("alpha", "q", "airspeed", "surface", "CL", "Cm")}
    t, f = np.arange(len(y["q"])) * DT, np.arange(0.1, 2.0, 0.04)
    kernel = np.exp(-2j * np.pi * f[:, None] * t)
    columns = (y["alpha"], y["q"] * CHORD / (2 * y["airspeed"]), y["surface"])

    def transform(x: Array) -> Array:
        line = np.polynomial.polynomial.polyfit(t, x, 1)
        return np.asarray(kernel @ (x - line[0] - line[1] * t))

    a = np.stack([transform(x) for x in columns], axis=1)
    found = {}
    for head in ("CL", "Cm"):
        b = transform(y[head])
        x = np.linalg.lstsq(np.vstack((a.real, a.imag)), np.concatenate((b.real, b.imag)), rcond=None)[0]
        found |= dict(zip((f"{head}_alpha", f"{head}_q", f"{head}_de"), x.tolist(), strict=True))
    return found


def flown(case: Case) -> Flown:
    """Raises ValueError where the aircraft does not stay in the air that its model is of."""
    aircraft = hides.changed(case.aircraft, case.hidden)
    trim = constants(aircraft, Hidden()).alpha
    rng = np.random.default_rng(case.seed)
    inputs = controls(case, rng)
    metres = aircraft.speed * (QUIET + case.seconds)
    of_motion = hides.of_motion(aircraft, trim, case.hidden)
    met = air(rng, aircraft, case.spectrum, case.sigma, case.scale, metres)
    if not case.lateral:
        met = replace(met, side=np.zeros_like(met.side), roll=np.zeros_like(met.roll))
    true = fly(aircraft, met, inputs, of_motion, case.feedback, rng)
    if not np.isfinite(true["q"]).all() or np.abs(true["theta"]).max() > 0.8 or np.abs(true["alpha"]).max() > 0.5:
        raise ValueError(f"{case.name}: the aircraft departs")
    still = air(rng, aircraft, case.spectrum, 0.0, case.scale, metres)
    calm = fly(aircraft, still, inputs, of_motion, case.feedback._replace(noise=0.0), rng)
    # The recorder's clock knows nothing of the stick's: were its steps on samples, all would alias alike.
    start = np.random.default_rng((*case.seed, 1)).uniform(0, 1 / case.rate)
    time, shown, colours = recorded(true, case.hidden, case.rate, case.noise, case.zeros, rng, start)
    dropped = () if case.thrust_recorded else ("thrust",)
    wanted = [n for n in shown if n not in dropped and (case.lateral or n in PLANAR)]
    answers = {
        "derivatives": aircraft.derivatives | (aircraft.lateral if case.lateral else {}),
        "quasi_steady": quasi_steady(calm),
        "sigma_fps": case.sigma / FT,
        "gust_scale_ft": case.scale / FT,
        "spectrum": case.spectrum,
        "rate_hz": case.rate,
        "input": case.kind,
        "noise": {"all": case.noise, **colours},
        "feedback": {k: v for k, v in case.feedback._asdict().items() if v and k not in ("delay", "noise")},
        "manoeuvre_from_s": QUIET,
        "constants": asdict(aircraft),
        "zeros": case.zeros,
        "hidden": case.hidden,
        "deviations": hides.deviations(case.aircraft, case.zeros, case.hidden, of_motion),
        "thrust_recorded": case.thrust_recorded,
    }
    return Flown(time, {n: shown[n] for n in wanted}, true, answers)


def autopilot(rng: np.random.Generator, lateral: bool) -> Feedback:
    """None, a pitch damper, attitude hold or altitude hold; in lateral flight wings are held level."""
    kind = rng.choice(["none", "damper", "attitude", "altitude"], p=[0.4, 0.2, 0.2, 0.2])
    f = Feedback(delay=float(rng.uniform(0.0, 0.08)), noise=1.0)
    if kind != "none":
        f = f._replace(q=float(rng.uniform(0.2, 0.7)))
    if kind in ("attitude", "altitude"):
        f = f._replace(theta=float(rng.uniform(0.2, 0.8)))
    if kind == "altitude":
        f = f._replace(h=float(rng.uniform(0.001, 0.004)))
    return f._replace(phi=0.3, p=0.1, r=0.3) if lateral else f


def zeros_of(rng: np.random.Generator) -> dict[str, float]:
    return {n: float(sd * rng.standard_normal()) for n, sd in ZEROS.items()}


def identify_case(seed: int, i: int, lateral: bool = False) -> Case:
    """Derivatives within 30 % (2 sd) of the profile's, mass within 5 %, inertia within 10 %."""
    rng = np.random.default_rng((seed, i, 2 if lateral else 1))
    sigma = float(rng.choice([0.0, 2.0, 3.0, 5.0, 7.0, 10.0, 12.0])) * FT
    return Case(
        name=f"{'lateral' if lateral else 'identify'}_{i:02d}",
        seed=(seed, i, 11),
        aircraft=drawn(rng, 0.15, mass_known=False),
        sigma=sigma,
        scale=float(rng.choice([500.0, 1000.0, 1750.0, 2500.0])) * FT,
        spectrum=str(rng.choice(KINDS)),
        kind=str(rng.choice(INPUTS)),
        rate=float(rng.choice((50.0, 100.0) if lateral else RATES)),
        noise=float(np.exp(rng.uniform(np.log(0.5), np.log(2.5)))),
        feedback=autopilot(rng, lateral),
        hidden={},
        zeros=zeros_of(rng),
        thrust_recorded=bool(rng.random() < 0.6),
        lateral=lateral,
    )


def diagnose_cases(
    seed: int, i: int, names: tuple[str, ...] | None = None, sigma: float | None = None, lateral: bool = False
) -> list[Case]:
    """Three flights of one aircraft. `names` of what is hidden, else every fifth case has nothing, every tenth two or
    three things. Derivatives are as the profile says, within its standard deviations. `lateral`: ailerons and rudder
    move too, and what is hidden is of lateral motion."""
    rng = np.random.default_rng((seed, i, 3))
    aircraft = drawn(rng, 0.10, mass_known=True)
    if names is None:
        several = 2 + int(rng.integers(2)) if i % 10 == 9 else 1
        count = 0 if i % 5 == 0 else several
        rows = {n for n, row in hides.HIDDEN.items() if row.lateral == lateral}
        pool = [n for n in hides.HIDDEN if n in rows and (count < 2 or n not in hides.OUTSIDE)]
        names = tuple(str(n) for n in rng.choice(pool, count, replace=False))
    planted = {n: hides.size(rng, n) for n in names}
    common = {
        "aircraft": aircraft,
        "sigma": float(rng.choice([0.0, 3.0, 5.0, 8.0, 12.0])) * FT if sigma is None else sigma,
        "scale": float(rng.choice([500.0, 1000.0, 1750.0, 2500.0])) * FT,
        "spectrum": str(rng.choice(KINDS)),
        "rate": float(rng.choice((10.0, 25.0, 50.0, 50.0, 100.0))),
        "noise": float(np.exp(rng.uniform(np.log(0.5), np.log(2.0)))),
        "feedback": autopilot(rng, lateral),
        "hidden": planted,
        "zeros": zeros_of(rng),
        "thrust_recorded": bool(rng.random() < 0.6),
        "seconds": 45.0,
        "lateral": lateral,
    }
    kinds = [str(k) for k in rng.permutation(INPUTS)[:3]]
    return [
        Case(name=f"diagnose_{i:02d}_{m}", seed=(seed, i, 20 + k), kind=kinds[k], **common) for k, m in enumerate("abh")
    ]


def header(name: str) -> str:
    return f"{name} [{UNITS.get(name, 'rad')}]"


def csv(flight: Flown) -> str:
    names = list(flight.shown)
    rows = np.column_stack([flight.time, *(flight.shown[n] for n in names)])
    lines = [",".join(("time [s]", *map(header, names)))]
    lines += [",".join(f"{x:.8g}" for x in row) for row in rows]
    return "\n".join(lines) + "\n"


def write(cases: list[Case], folder: Path) -> None:
    """Adds the cases' flights to a folder and to its answers.json."""
    folder.mkdir(parents=True, exist_ok=True)
    page = folder / "answers.json"
    answers = json.loads(page.read_text()) if page.exists() else {}
    for case in cases:
        try:
            flight = flown(case)
        except ValueError as departed:
            print(departed)
            continue
        with gzip.GzipFile(folder / f"{case.name}.csv.gz", "wb", mtime=0) as out:
            out.write(csv(flight).encode())
        at = np.clip(np.round(flight.time * RATE).astype(int), 0, len(flight.true["q"]) - 1)
        truth = {n: flight.true[n][at] for n in ("alpha", "w_gust", "CL", "Cm")}
        np.savez_compressed(folder / f"{case.name}.truth.npz", time=flight.time, **truth)
        answers[case.name] = flight.answers
    page.write_text(json.dumps(answers, indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--identify", type=int, default=48)
    parser.add_argument("--diagnose", type=int, default=20)
    parser.add_argument("--lateral", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    cases = [identify_case(given.seed, i) for i in range(given.identify)]
    cases += [c for i in range(given.diagnose) for c in diagnose_cases(given.seed, i)]
    cases += [identify_case(given.seed, i, lateral=True) for i in range(given.lateral)]
    write(cases, given.folder)


if __name__ == "__main__":
    main()
