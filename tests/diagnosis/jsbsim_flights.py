"""Flights of JSBSim's DHC6, which nobody here wrote, with the station's sensors and hidden effects in them.

Its lift is a table that bends by half, its gusts act at the CG alone, its propellers and fuel are its own: the
structure of the aircraft differs from every profile's. Turbulence is a field frozen in space, so that the vane meets
it first; the vane's upwash and dynamics are those of the profile.
"""

from __future__ import annotations

import math
from functools import lru_cache

import jsbsim
import numpy as np
from blind import BIASES, DT, FT, IMU, SECONDS, Case, _sense, inputs
from scipy import fft
from scipy.signal import lfilter

from station.diagnosis import effects as catalogue
from station.diagnosis.measured_record import Record
from station.diagnosis.procedure import Diagnosis, diagnose
from station.diagnosis.residuals import _vane_response
from station.numerics.indicial import frequency_response, response
from station.profile import Aircraft, load_aircraft
from station.simulation.gusts import dryden
from station.simulation.manoeuvres import elevator_input

POUND = 4.4482216152605
SLUG = 14.59390293720636
BEFORE = 4.0
"""Seconds flown before the record begins, for the vane's memory."""

ACTUATOR_S = 0.08
"""The elevator's time constant, that of the profile."""
FINER = 4
"""JSBSim's steps in one of the record's: its integration is late by a step."""


def profile() -> Aircraft:
    """The station's Twin Otter with the mass and inertia that JSBSim's has: the loading is known, the rest is not."""
    a = load_aircraft("twin_otter")
    mass, iyy = loading()
    inertia = a.inertia.model_copy(update={"mass": mass, "iyy": iyy})
    return a.model_copy(update={"inertia": inertia})


@lru_cache(maxsize=1)
def loading() -> tuple[float, float]:
    sim = _trimmed(110.0)
    return sim["inertia/mass-slugs"] * SLUG, sim["inertia/iyy-slugs_ft2"] * SLUG * FT**2


def _trimmed(knots: float) -> jsbsim.FGFDMExec:
    sim = jsbsim.FGFDMExec(None)
    sim.set_debug_level(0)
    sim.load_model("DHC6")
    sim.set_dt(DT / FINER)
    settings = {"ic/h-sl-ft": 2500.0, "ic/vt-kts": knots, "propulsion/set-running": -1}
    for engine in (0, 1):
        settings |= {f"fcs/throttle-cmd-norm[{engine}]": 0.5, f"fcs/mixture-cmd-norm[{engine}]": 0.9}
        settings |= {f"fcs/advance-cmd-norm[{engine}]": 1.0}
    for name, value in settings.items():
        sim[name] = value
    sim.run_ic()
    sim.do_trim(1)
    return sim


def _gust(speed: float, sigma: float, n: int, seed: int) -> np.ndarray:
    """Vertical gust (m/s, down) at n points DT of flight apart, from the Dryden spectrum by Fourier."""
    if not sigma:
        return np.zeros(n)
    model = dryden(2500 * FT, sigma)
    m = 4 * n
    omega = 2 * np.pi * fft.rfftfreq(m, DT * speed)
    x2 = (model.length_w * omega) ** 2
    density = sigma**2 * model.length_w / np.pi * (1 + 3 * x2) / (1 + x2) ** 2
    step = omega[1]
    rng = np.random.default_rng([seed, 31])
    phases = rng.standard_normal(len(omega)) + 1j * rng.standard_normal(len(omega))
    return fft.irfft(phases * np.sqrt(density * step) * (m / 2), m)[:n]


@lru_cache(maxsize=64)
def truth(kind: str, knots: float, sigma: float, seed: int, slack: float = 0.0) -> dict[str, np.ndarray]:
    """A flight at 200 Hz: true signals but for the vane's, and "field", the gust ahead of the vane and behind.

    With `slack` (rad) the elevator is driven through play, and "elevator" is what drives it."""
    sim = _trimmed(knots)
    n = round((SECONDS + BEFORE) / DT)
    speed = sim["velocities/vt-fps"] * FT
    ahead = round(12.0 / speed / DT)
    field = _gust(speed, sigma, n + 2 * ahead, seed)
    # An actuator moves the surface: a step between two samples of the record would have no time of its own.
    decay = math.exp(-DT / ACTUATOR_S)
    wanted = lfilter([1 - decay], [1, -decay], elevator_input(inputs(kind), np.arange(n) * DT - BEFORE))
    aileron, rudder = (sim[f"fcs/{s}-cmd-norm"] for s in ("aileron", "rudder"))
    heading = sim["attitude/psi-rad"]
    commands, stands = _stroke(knots)
    driving = sim["fcs/elevator-pos-rad"] + wanted
    moved = np.interp(_after_play(driving, slack), stands, commands)
    names = {
        "elevator": ("fcs/elevator-pos-rad", 1.0), "q": ("velocities/q-rad_sec", 1.0),
        "qdot": ("accelerations/qdot-rad_sec2", 1.0), "theta": ("attitude/theta-rad", 1.0),
        "phi": ("attitude/phi-rad", 1.0), "psi": ("attitude/psi-rad", 1.0), "airspeed": ("velocities/vt-fps", FT),
        "v_north": ("velocities/v-north-fps", FT), "v_east": ("velocities/v-east-fps", FT),
        "v_down": ("velocities/v-down-fps", FT), "altitude": ("position/h-sl-ft", FT),
        "dynamic_pressure": ("aero/qbar-psf", POUND / FT**2), "static_pressure": ("atmosphere/P-psf", POUND / FT**2),
        "air_temperature": ("atmosphere/T-R", 5 / 9), "alpha": ("aero/alpha-rad", 1.0),
        "fx": ("forces/fbx-total-lbs", POUND), "fz": ("forces/fbz-total-lbs", POUND),
        "mass": ("inertia/mass-slugs", SLUG), "left": ("propulsion/engine[0]/thrust-lbs", POUND),
        "right": ("propulsion/engine[1]/thrust-lbs", POUND),
    }  # fmt: skip
    rows = np.empty((n, len(names)))
    for k in range(n):
        # A pilot keeps the wings level and the heading.
        bank, roll = sim["attitude/phi-rad"], sim["velocities/p-rad_sec"]
        turn = math.remainder(sim["attitude/psi-rad"] - heading, 2 * math.pi)
        sim["fcs/aileron-cmd-norm"] = aileron - 1.5 * (bank + min(max(turn, -0.1), 0.1)) - 0.8 * roll
        sim["fcs/rudder-cmd-norm"] = rudder + 0.5 * sim["velocities/r-rad_sec"]
        # Held for a step, surface and gust would be half a step ahead of what is recorded.
        for part in np.arange(1, FINER + 1) / FINER:
            sim["fcs/elevator-cmd-norm"] = moved[k - 1] + part * (moved[k] - moved[k - 1]) if k else moved[0]
            i = k + ahead
            sim["atmosphere/gust-down-fps"] = float(field[i - 1] + part * (field[i] - field[i - 1])) / FT
            sim.run()
        rows[k] = [sim[name] for name, _ in names.values()]
    out = {name: rows[:, i] * scale for i, (name, (_, scale)) in enumerate(names.items())}
    out["psi"] = np.unwrap(out["psi"])
    out["thrust"] = out.pop("left") + out.pop("right")
    mass = out.pop("mass")
    out["ax"], out["az"] = out.pop("fx") / mass, out.pop("fz") / mass
    out["field"] = field
    if slack:
        out["elevator"] = driving
    return out


def flown(case: Case, kind: str, knots: float, k: int) -> Record:
    """The record of one manoeuvre of a case at an airspeed."""
    seed = case.seed * 100 + k if case.sigma else 0
    t = dict(truth(kind, knots, case.sigma, seed, case.effects.get("elevator.backlash", 0.0)))
    field = t.pop("field")
    a = profile()
    for name, value in case.effects.items():
        if name in ("alpha_vane.position", "alpha_vane.dynamics", "alpha_vane.upwash_memory", "boom.flexure"):
            a = catalogue.BY_ID[name].extend(a, value)
    t["alpha_vane"] = _vane(t, field, a)
    x = IMU[0] + case.effects.get("accelerometer.position", 0.0)
    q, qdot, az = t["q"], t.pop("qdot"), t["az"]
    t["az"] = az - qdot * x - q * q * IMU[2]
    t["ax"] = t["ax"] + qdot * IMU[2] - q * q * x
    begin = round(BEFORE / DT)
    t = {name: values[begin:] for name, values in t.items()} | {"time": DT * np.arange(len(q) - begin)}
    rng = np.random.default_rng([case.seed, 5])
    biases = {n: sd * rng.standard_normal() for n, sd in BIASES.items()}
    return _sense(case, t, biases, kind, k)


def _vane(t: dict[str, np.ndarray], field: np.ndarray, a: Aircraft) -> np.ndarray:
    """What the vane shows, by Fourier over the flight with its ends joined."""
    n = len(t["q"])
    v = float(t["airspeed"].mean())
    ahead = (len(field) - n) // 2
    at = np.arange(n) + ahead

    def met(metres: float) -> np.ndarray:
        return -np.interp(at + metres / v / DT, np.arange(len(field)), field) / v

    moving = np.arctan2(t["v_down"], np.hypot(t["v_north"], t["v_east"])) + t["theta"]
    boom = a.boom
    pad = 2048
    w = 2 * np.pi * fft.rfftfreq(n + pad, DT)
    chords = np.array([v / a.unsteady.reference_chord])

    def spectrum(x: np.ndarray) -> np.ndarray:
        bridge = x[-1] + (x[0] - x[-1]) * (0.5 - 0.5 * np.cos(np.pi * np.arange(pad) / pad))
        return fft.rfft(np.concatenate([x, bridge]))

    inside = (1 + boom.upwash_body) * spectrum(moving - t["q"] * boom.vane_x / t["airspeed"] + met(boom.vane_x))
    inside += (
        boom.upwash_wing * frequency_response(response(a.unsteady.upwash_motion), 1j * w / chords) * spectrum(moving)
    )
    inside += (
        boom.upwash_wing
        * frequency_response(response(a.unsteady.upwash_gust), 1j * w / chords)
        * spectrum(met(0.25 * a.geometry.chord))
    )
    inside += boom.flexure * spectrum(t["az"])
    return fft.irfft(inside * _vane_response(boom, w), n + pad)[:n] + boom.zero


def _after_play(driving: np.ndarray, slack: float) -> np.ndarray:
    """Where a surface stands that is driven through play."""
    out = driving.copy()
    at = out[0]
    for i, x in enumerate(driving):
        at = min(max(at, x - slack / 2), x + slack / 2)
        out[i] = at
    return out


@lru_cache(maxsize=8)
def _stroke(knots: float) -> tuple[np.ndarray, np.ndarray]:
    """The elevator's command, and where it then stands (rad): the trim tab moves it."""
    sim = _trimmed(knots)
    commands = np.linspace(-1, 1, 81)
    stands = []
    for c in commands:
        sim["fcs/elevator-cmd-norm"] = c
        for _ in range(4):
            sim.run()
        stands.append(sim["fcs/elevator-pos-rad"])
    return commands, np.array(stands)


TWO_SPEEDS = (("doublets", 100.0), ("3-2-1-1", 125.0))


def diagnosed(case: Case, card=TWO_SPEEDS) -> Diagnosis:
    made = [flown(case, kind, knots, k) for k, (kind, knots) in enumerate((*card, card[0]))]
    return diagnose(made[:-1], made[-1:], profile())


def named(d: Diagnosis) -> dict[str, tuple[str, ...]]:
    """What is named that is not the aircraft's model, and its rivals."""
    return {e.term.id: e.alternatives for e in d.effects if not e.term.aerodynamic}


def score(case: Case, d: Diagnosis) -> str:
    true, found = set(case.effects), named(d)
    if not true:
        return "blamed" if found else "clean"
    if set(found) == true:
        return "group" if any(found.values()) else "exact"
    if not found:
        return "none"
    possible = set(found) | {r for alternatives in found.values() for r in alternatives}
    return "companion" if true < set(found) else "group" if true <= possible and len(found) == 1 else "wrong"
