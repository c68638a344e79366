"""Calibration flights, counted: programmes of the simulation whose truths are drawn wider than a profile's priors.

    uv run python tests/benchmarks/calibration_flights.py [--programmes 100] [--minutes 30] [--kept FILE]

Each flies the card `calibration` with an aircraft of its own (vane, boom, airspeed, attitude, mass, derivatives) in a
wind and air of its own, and is calibrated with the profile twin_otter, which knows nothing of it. Each is kept with its
number and the commit that flew it: slices add up. The table holds all that are kept.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

from station.flight.step_plan import planned
from station.log import About, Table
from station.profile import Aircraft, Instrument, load_aircraft, load_card
from station.profile.profile_text import write_profile
from station.programme.calibration import calibrate
from station.simulation.sortie import fly

DEG = math.pi / 180
SHOWN = {
    "airspeed_error": ("position error at the mean speed, m/s", 1.0, "0.5"),
    "airspeed_slope": ("its slope over speed, %", 100.0, "–"),
    "static_position": ("static port's error over q, %", 100.0, "–"),
    "vane_zero": ("vane zero, deg", 1 / DEG, "0.1"),
    "upwash": ("steady upwash at the mean dynamic pressure", 1.0, "0.02"),
    "upwash_slope": ("its slope, 1/kPa", 1.0, "–"),
    "vane_delay": ("vane's lag, ms", 1000.0, "5"),
    "vane_x": ("vane's place, m", 1.0, "–"),
    "theta_zero": ("pitch attitude's zero, deg", 1 / DEG, "–"),
    "phi_zero": ("bank's zero, deg", 1 / DEG, "–"),
    "beta_zero": ("beta vane's zero, deg", 1 / DEG, "–"),
}
"""Constant: its words, unit, and what is asked of its error."""


def drawn(rng: np.random.Generator, other: np.random.Generator) -> tuple[Aircraft, dict[str, float]]:
    """An aircraft, and what of it is to be found; the airspeed's error by bias and gain, the upwash without load.
    `other`: of what was drawn later, so that the rest stays."""
    a = load_aircraft("twin_otter")
    boom, u = a.boom, a.unsteady
    assert boom is not None
    assert u.upwash_motion is not None
    gain, bias = 1 + 0.03 * rng.standard_normal(), 1.5 * rng.standard_normal()
    wing = boom.upwash_wing * (1 + 0.25 * rng.standard_normal())
    memory = u.upwash_motion.model_copy(
        update={"b": tuple(b * math.exp(0.25 * rng.standard_normal()) for b in u.upwash_motion.b)}
    )
    true = {
        "gain": gain,
        "bias": bias,
        "airspeed_slope": gain - 1,
        "vane_zero": 0.6 * DEG * rng.standard_normal(),
        "upwash": 0.05 + 0.04 * rng.standard_normal() + wing,
        "tip_load": 0.02 * other.standard_normal(),
        "static_position": 0.03 * other.standard_normal(),
        "vane_delay": rng.uniform(0.0, 0.05),
        "vane_x": 5.3 + 0.4 * rng.standard_normal(),
        "theta_zero": 0.1 * DEG * rng.standard_normal(),
        "phi_zero": 0.3 * DEG * other.standard_normal(),
        "beta_zero": 0.6 * DEG * other.standard_normal(),
    }
    derivatives = {
        n: d.model_copy(update={"value": d.value * (1 + 0.08 * rng.standard_normal())})
        for n, d in a.derivatives.items()
    }
    instruments = {
        "airspeed": {"gain": gain, "bias": bias},
        "alpha_vane": {"latency": true["vane_delay"]},
        "theta": {"bias": true["theta_zero"]},
        "phi": {"bias": true["phi_zero"]},
        "beta_vane": {"bias": true["beta_zero"]},
        "ax": {"bias": 0.03 * rng.standard_normal()},
        "az": {"bias": 0.05 * rng.standard_normal()},
    }
    flown = {
        "boom": boom.model_copy(
            update={
                "zero": true["vane_zero"],
                "upwash_wing": wing,
                "upwash_body": true["upwash"] - wing,
                "vane_x": true["vane_x"],
                "tip_load": true["tip_load"],
                "vane_frequency": 9.0 * (1 + 0.1 * rng.standard_normal()),
                "vane_damping": 0.35 * (1 + 0.15 * rng.standard_normal()),
            }
        ),
        "unsteady": u.model_copy(update={"upwash_motion": memory}),
        "static_position": true["static_position"],
        "inertia": a.inertia.model_copy(update={"mass": a.inertia.mass * (1 + 0.05 * rng.standard_normal())}),
        "derivatives": derivatives,
        "instruments": {n: Instrument().model_copy(update=e) for n, e in instruments.items()},
    }
    return a.model_copy(update=flown), true


def recording(settings: dict[str, object], seed: int) -> tuple[Table, About]:
    """The card's flight as `simulate` records it, without the file."""
    made = load_card("calibration", overrides=settings)
    card, seconds = planned(made.card)
    shown, truth = fly(made.aircraft, made.rig, card, math.ceil(seconds), seed)
    table = Table(truth["time"], shown, made.aircraft, 0)
    return table, About(made.aircraft, (), made.rig, made.card, "simulation", imported=True)


def counted(number: int, folder: Path) -> dict[str, tuple[float, float]] | None:
    """Error and standard error of each constant of one programme; None where it could not be flown."""
    rng = np.random.default_rng((number, 15))
    aircraft, true = drawn(rng, np.random.default_rng((number, 16)))
    profile = folder / f"{number}.toml"
    write_profile(aircraft, profile, "drawn")
    wind, way = rng.uniform(0, 14), rng.uniform(0, 2 * math.pi)
    settings = {
        "aircraft": str(profile),
        "flight.truth": {},
        "flight.gust_sigma": f"{rng.uniform(0, 2):.3f} ft/s",
        "flight.wind_north": f"{wind * math.cos(way):.3f} m/s",
        "flight.wind_east": f"{wind * math.sin(way):.3f} m/s",
        "flight.wind_walk": f"{rng.uniform(0.05, 0.5):.3f} m/s",
    }
    try:
        made = calibrate([profile], load_aircraft("twin_otter"), read=lambda _: recording(settings, number))
    except Exception:
        traceback.print_exc()
        return None
    whole, load = 1 + true["upwash"], made.steady.pressure / 1000
    true["upwash"] = whole * (1 + true["tip_load"] * load) - 1
    true["upwash_slope"] = whole * true["tip_load"]
    true["airspeed_error"] = (true["gain"] - 1) * made.steady.speed + true["bias"]
    return {n: (made.constants[n].value - true[n], made.constants[n].sd) for n in SHOWN if made.constants[n].is_told}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programmes", type=int, default=100)
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin none later")
    parser.add_argument("--kept", type=Path, default=Path("logs/calibration.jsonl"))
    given = parser.parse_args()
    given.kept.parent.mkdir(parents=True, exist_ok=True)
    until = time.monotonic() + 60 * given.minutes
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], stdout=subprocess.PIPE, text=True).stdout.strip()
    lines = given.kept.read_text().splitlines() if given.kept.exists() else []
    kept = {row["number"]: row for row in map(json.loads, lines)}
    with tempfile.TemporaryDirectory() as folder, given.kept.open("a") as file:
        for number in range(given.programmes):
            if number in kept or time.monotonic() > until:
                continue
            kept[number] = {"number": number, "commit": commit, "found": counted(number, Path(folder))}
            print(json.dumps(kept[number]), file=file, flush=True)
    table([row["found"] for row in kept.values()])
    print(f"\nFlown by commit {', '.join(sorted({row['commit'] for row in kept.values()}))}.")


def table(programmes: list[dict[str, tuple[float, float]] | None]) -> None:
    found = [p for p in programmes if p]
    print("| constant | asked | rms error | mean error | mean standard error | in the 95 % interval |")
    print("|---|---|---|---|---|---|")
    for name, (words, unit, asked) in SHOWN.items():
        pairs = np.array([f[name] for f in found if name in f]) * unit
        if not len(pairs):
            continue
        error, sd = pairs.T
        inside = int((np.abs(error) < 1.96 * sd).sum())
        rms = math.sqrt(float(np.mean(error**2)))
        print(f"| {words} | {asked} | {rms:.3g} | {error.mean():+.2g} | {sd.mean():.3g} | {inside}/{len(pairs)} |")
    print(f"\n{len(found)} of {len(programmes)} programmes calibrated.")


if __name__ == "__main__":
    main()
