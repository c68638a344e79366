"""How lateral identification fares in air that varies across the span, against air on a line. Run by hand.

    uv run python tests/benchmarks/lateral_air.py [--flights 20] [--workers 2] [--length "300 m"] [--rows PATH]

A Twin Otter drawn within the doubt that the profile states of it (recorded mass, inertias, the scales of what shows
aileron and rudder, sidewash), for the intervals hold that doubt; 90 s, aileron and rudder by orthogonal multisines
(4 deg) or doublets (6 deg). On a line side gusts act at the CG, without sidewash; in a plane the fin meets them later,
in sidewash, and gradients of gusts across the span roll and yaw the wing. Printed, by air and method: the share of the
15 lateral derivatives within two standard errors of the profile's, of those called estimated; each axis' share, with
the median of its errors in per cent; and the derivatives that are within least often.
"""

from __future__ import annotations

import argparse
import itertools
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from station.conventions import LATERAL
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.profile import Aircraft, Card, Doublet, Flight, Manoeuvre, Multisine, load_aircraft
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

METHODS = ("II", "split", "split+gust", "ml", "oe", "fe", "sidpac")
SIGMAS = (0.0, 5.0, 10.0)
FIELDS = ("line", "plane")
START, END = 30.0, 90.0


def multisine(surface: str) -> Manoeuvre:
    shape = {"kind": "multisine", "start": "30 s", "duration": "20 s", "repeat": "20 s", "high": "1.5 Hz"}
    return Multisine.model_validate({**shape, "surface": surface, "amplitude": "4 deg"})


def doublet(surface: str, start: str) -> Manoeuvre:
    shape = {"kind": "doublet", "amplitude": "6 deg", "width": "1.2 s", "repeat": "20 s"}
    return Doublet.model_validate({**shape, "surface": surface, "start": start})


INPUTS = {
    "multisine": (multisine("aileron"), multisine("rudder")),
    "doublet": (doublet("rudder", "31 s"), doublet("aileron", "39 s")),
}


Errors = dict[tuple[str, str], tuple[float, float]]
"""By method and derivative: the error over its standard error, and over the derivative."""


@dataclass(frozen=True, slots=True)
class Job:
    field: str
    sigma: float
    form: str
    seed: int
    length: str | None
    methods: tuple[str, ...]


def drawn(aircraft: Aircraft, job: Job) -> tuple[Aircraft, dict[str, float]]:
    """Of the profile's [uncertainty]: an aircraft of its own for each air, and by what its mass, aileron and rudder are
    shown too large."""
    u, rng = aircraft.uncertainty, np.random.default_rng([job.seed, round(job.sigma), FIELDS.index(job.field)])
    inertias = {n: getattr(aircraft.inertia, n) * (1 + u.inertia * rng.normal()) for n in ("ixx", "izz", "ixz")}
    changed = {"inertia": aircraft.inertia.model_copy(update=inertias)}
    if aircraft.fin:
        changed["fin"] = aircraft.fin.model_copy(update={"sidewash": aircraft.fin.sidewash + u.sidewash * rng.normal()})
    sds = {"mass": u.recorded_mass, "aileron": u.surface_scale, "rudder": u.surface_scale}
    return aircraft.model_copy(update=changed), {n: 1 + sd * rng.normal() for n, sd in sds.items()}


def errors(job: Job) -> Errors:
    """Of one flight."""
    aircraft = load_aircraft("twin_otter")
    flown_by, shares = drawn(aircraft, job)
    keys = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{job.sigma} ft/s", "field": job.field}
    if job.length:
        keys["gust_length"] = job.length
    card = Card(
        name="t", aircraft="twin_otter", rig="", lateral=True, manoeuvres=INPUTS[job.form],
        flight=Flight.model_validate({**keys, "seed": job.seed}),
    )  # fmt: skip
    shown, truth = fly(flown_by, STANDARD, card, END, job.seed)
    shown |= {name: share * shown[name] for name, share in shares.items()}
    flown = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft, 0)
    found = identify(flown, aircraft, Request(job.methods, START, card=card))
    made = {}
    for method, name in itertools.product(job.methods, LATERAL):
        result = found.methods.get(method)
        p = result.parameter(name) if result is not None and result.status == "ok" else None
        if p is not None and p.status == "estimated" and p.sd > 0:
            value = aircraft.value(name)
            made[method, name] = ((p.value - value) / p.sd, p.value / value - 1.0)
    return made


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--flights", type=int, default=20)
    options.add_argument("--rows", type=Path, help="every flight's errors, one JSON line each; flown before, not again")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--length", help="scale length of the gusts; MIL-F-8785C's if left out")
    options.add_argument("--forms", nargs="+", default=list(INPUTS))
    options.add_argument("--methods", nargs="+", default=list(METHODS))
    asked = options.parse_args()
    airs = [(s, f) for s in SIGMAS for f in FIELDS]
    seeds, methods = range(1, asked.flights + 1), tuple(asked.methods)
    # Seed by seed, so that what is broken off has as many flights of each air.
    jobs = [Job(f, s, form, n, asked.length, methods) for n in seeds for form in asked.forms for (s, f) in airs]
    done = kept(asked.rows)
    left = [job for job in jobs if job not in done]
    with ProcessPoolExecutor(asked.workers) as pool:
        for job, found in zip(left, pool.map(errors, left), strict=True):
            done[job] = found
            keep(asked.rows, job, found)
    print("| input | sigma, ft/s | air | method | within 2 sd | CY | Cl | Cn | least often |")
    print("|---" * 9 + "|")
    for form, (sigma, field), method in itertools.product(asked.forms, airs, methods):
        flights = [e for j, e in done.items() if (j.form, j.sigma, j.field) == (form, sigma, field)]
        print(row(f"{form} | {sigma:g} | {field} | {method}", method, flights))


def kept(path: Path | None) -> dict[Job, Errors]:
    """What a file has of an earlier run."""
    done = {}
    for line in path.read_text().splitlines() if path and path.exists() else ():
        made = json.loads(line)
        job = Job(**{**made["job"], "methods": tuple(made["job"]["methods"])})
        done[job] = {(method, name): (z, share) for method, name, z, share in made["errors"]}
    return done


def keep(path: Path | None, job: Job, found: Errors) -> None:
    if path:
        with path.open("a") as file:
            file.write(json.dumps({"job": asdict(job), "errors": [[*k, *e] for k, e in found.items()]}) + "\n")


def row(head: str, method: str, flights: list[Errors]) -> str:
    by_name = {n: [f[method, n] for f in flights if (method, n) in f] for n in LATERAL}
    every = [e for found in by_name.values() for e in found]
    if not every:
        return f"| {head} | – | | | | |"
    cells = [f"{share(every)} of {len(every)}"]
    for axis in ("CY", "Cl", "Cn"):
        found = [e for n, es in by_name.items() if n.startswith(axis) for e in es]
        cells.append(f"{share(found)}, {100 * np.median([abs(e[1]) for e in found]):.1f} %" if found else "–")
    worst = sorted((n for n, es in by_name.items() if es), key=lambda n: np.mean([abs(z) <= 2 for z, _ in by_name[n]]))
    cells.append(
        ", ".join(f"{n} {share(by_name[n])} ({100 * np.median([e for _, e in by_name[n]]):+.0f} %)" for n in worst[:3])
    )
    return f"| {head} | {' | '.join(cells)} |"


def share(found: list[tuple[float, float]]) -> str:
    return f"{100 * np.mean([abs(z) <= 2 for z, _ in found]):.0f} %"


if __name__ == "__main__":
    main()
