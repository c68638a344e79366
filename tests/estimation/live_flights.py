"""Flights for the live estimator, frame by frame, and what became of them."""

import functools
import math

import numpy as np

from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS
from station.estimation.method_table import LIVE
from station.estimation.methods import Estimator
from station.profile import Card, Doublet, Flight, load_aircraft, load_rig
from station.rows import Frame, Quality
from station.simulation.sortie import fly

RIG = load_rig("bench")
AIRCRAFT = load_aircraft("twin_otter")
ALPHA_AND_MOMENT = [0, 3, 4, 5]
"""CL_alpha, Cm_alpha, Cm_q, Cm_de."""
QUASI_STEADY = tuple(m for m in LIVE if m != "physical")
"""`physical` estimates other numbers: those of the profile, not those of equation error in calm air."""


def card(sigma_ft_s=0.0, flown=True, **more):
    doublets = (
        Doublet(kind="doublet", start="22 s", amplitude="3.5 deg", width="0.6 s"),
        Doublet(kind="doublet", start="32 s", amplitude="3.5 deg", width="1.2 s"),
    )
    flight = Flight(speed="110 kt", altitude="2500 ft", gust_sigma=f"{sigma_ft_s} ft/s")
    return Card(
        name="t", aircraft="twin_otter", rig="bench", flight=flight, manoeuvres=doublets if flown else (), **more
    )


def make_frames(columns):
    """Frames, one a tick, of the signals given; what is not finite is missing."""
    n = len(next(iter(columns.values())))
    table = np.full((n, len(SIGNALS)), math.nan)
    for name, values in columns.items():
        table[:, SIGNAL_INDEX[name]] = values
    there = np.isfinite(table)
    ages = np.where(there, 0.0, math.nan)
    quality = np.where(there, int(Quality.FRESH), int(Quality.MISSING))
    rows = zip(table.tolist(), ages.tolist(), quality.tolist(), strict=True)
    return [Frame(k * TICK_NS, k, tuple(v), tuple(a), tuple(q)) for k, (v, a, q) in enumerate(rows)]


@functools.cache
def flight(sigma=0.0, seconds=50.0, seed=1, flown=True):
    shown, truth = fly(AIRCRAFT, RIG, card(sigma, flown), seconds, seed)
    for name in ("thrust", "mass", "pdot", "qdot", "rdot"):
        shown.pop(name, None)
    return make_frames(shown), truth


def make(aircraft=AIRCRAFT, of=None, **options):
    return Estimator(aircraft, of or card(), RIG.imu_position, RIG.noise_si(), **options)


def run(estimator, frames):
    """The last estimates, and every angle of attack."""
    alphas = []
    methods = ()
    for frame in frames:
        alpha, methods = estimator.step(frame)
        alphas.append(alpha)
    return {m.method: m for m in methods}, alphas


def values(method):
    return np.array([p.value for p in method.parameters])


def sds(method):
    return np.array([p.sd for p in method.parameters])


@functools.cache
def calm_reference():
    """Split in calm air with the same inputs, the mean of four flights: what every flight should come to."""
    return np.mean([values(run(make(), flight(seed=s)[0])[0]["split"]) for s in (11, 12, 13, 14)], axis=0)


def error_percent(method):
    reference = calm_reference()
    return 100 * (values(method) - reference) / np.abs(reference)


def changed(frame, **columns):
    """The frame with other values (None: missing)."""
    v, a, q = list(frame.values), list(frame.age_s), list(frame.quality)
    for name, value in columns.items():
        i = SIGNAL_INDEX[name]
        v[i], a[i], q[i] = (math.nan, math.nan, 3) if value is None else (value, 0.0, 0)
    return Frame(frame.t_ns, frame.k, tuple(v), tuple(a), tuple(q))


def blank(frame):
    n = len(SIGNALS)
    return Frame(frame.t_ns, frame.k, (math.nan,) * n, (math.nan,) * n, (int(Quality.MISSING),) * n)
