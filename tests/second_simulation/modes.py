"""How an aircraft of this simulation flies, read from its own flights: modes from what it does when left alone, the
pull-up from its equations at rest. No linear theory of flight stands in between."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tests.second_simulation.air import air
from tests.second_simulation.aircraft import DEG, Drawn, G
from tests.second_simulation.motion import (
    COLUMNS,
    DT,
    POS,
    QUAT,
    RATES,
    STATES,
    SURF,
    VEL,
    WAKE,
    Feedback,
    Hidden,
    constants,
    fly,
    rates,
)

Array = NDArray[np.float64]

SECONDS: Final = 60.0
EVERY: Final = 20
"""Steps from one sample to the next: 0.05 s."""
ROWS: Final = 40
"""Samples that are one column of the Hankel matrix: 2 s, longer than a short period remembers."""
SMALLEST: Final = 2e-6
"""Of the largest singular value: below are what is not linear, the phugoid's double frequency first, and rounding; from
1e-6 to 3e-6 the modes stay."""
PULSE: Final = 0.01 * DEG
"""So small that the flight is linear to SMALLEST."""
SLOWEST: Final = 2 * math.pi / SECONDS
"""rad/s: of what takes longer than the flight lasts no period is seen, and a pole there may be anything that drifts."""
LAGS: Final = 5
"""Of the actuator, after which the pulse is over."""


def poles(responses: Array, dt: float) -> NDArray[np.complex128]:
    """Of free responses (k, n), 1/s: the eigensystem realisation (Juang and Pappa 1985) of their Hankel matrix."""
    k, n = responses.shape
    columns = n - ROWS
    hankel = np.concatenate([responses[:, i : i + columns] for i in range(ROWS)])
    u, s, _ = np.linalg.svd(hankel, full_matrices=False)
    order = int((s > SMALLEST * s[0]).sum())
    u = u[:, :order]
    found = np.linalg.eigvals(np.linalg.pinv(u[:-k]) @ u[k:])
    return np.asarray(np.log(found.astype(complex)) / dt)


def pair(found: NDArray[np.complex128], low: float, high: float) -> tuple[float, float]:
    """Undamped frequency (rad/s) and damping ratio of the least damped oscillation between two frequencies; NaN where
    there is none."""
    own = [p for p in found if p.imag > 1e-3 and low < abs(p) < high]
    if not own:
        return math.nan, math.nan
    p = min(own, key=lambda p: -p.real / abs(p))
    return float(abs(p)), float(-p.real / abs(p))


def free_flight(aircraft: Drawn, hidden: Hidden) -> dict[str, tuple[float, float]]:
    """Short period and phugoid in still air, after a short pulse of the elevator: (rad/s, damping ratio)."""
    rng = np.random.default_rng(0)
    n = int(SECONDS / DT)
    inputs = np.zeros((3, n))
    inputs[0, 400:600] = PULSE
    still = air(rng, aircraft, "dryden", 0.0, 500.0, aircraft.speed * SECONDS * 1.2)
    flown = fly(aircraft, still, inputs, hidden, Feedback(), rng)
    begin = 600 + round(LAGS * aircraft.actuator_lag / DT)
    units = {"q": 1.0, "alpha": 1.0, "theta": 1.0, "airspeed": 1 / aircraft.speed}
    steady = constants(aircraft, hidden)
    at = {"q": 0.0, "alpha": steady.alpha, "theta": steady.alpha, "airspeed": aircraft.speed}
    shown = np.stack([(flown[name][begin::EVERY] - at[name]) * unit for name, unit in units.items()])
    found = poles(shown, EVERY * DT)
    return {"short_period": pair(found, 0.8, 12.0), "phugoid": pair(found, SLOWEST, 0.6)}


def pull_up(aircraft: Drawn, hidden: Hidden) -> tuple[float, float]:
    """Load factor per angle of attack (1/rad) and elevator per load factor (rad) of a steady pull-up at the trimmed
    speed: the change of both where pitch rate goes through zero."""
    c = constants(aircraft, hidden)
    still = np.zeros(2000)
    gusts = (still,) * 6
    places, out = np.array([-1e6]), np.empty(len(COLUMNS))

    def left(alpha: float, elevator: float, q: float) -> Array:
        """Normal acceleration less that of the path, and pitch acceleration."""
        x = np.zeros(STATES)
        x[POS + 2] = -aircraft.altitude
        x[VEL], x[QUAT], x[QUAT + 2] = c.speed, math.cos(alpha / 2), math.sin(alpha / 2)
        x[RATES + 1], x[SURF], x[WAKE : WAKE + 2] = q, elevator, alpha
        rates(x, c, hidden, gusts, np.array([elevator, 0.0, 0.0]), elevator, places, np.array([alpha]), 0, out)
        fx, fz, qdot = out[7], out[9], out[21]
        return np.array([fx * math.sin(alpha) - fz * math.cos(alpha) - G - c.speed * q, qdot])

    def held(q: float) -> Array:
        at = np.array([c.alpha, c.elevator])
        for _ in range(8):
            here, h = left(at[0], at[1], q), 1e-6
            slope = np.stack([(left(at[0] + h, at[1], q) - here) / h, (left(at[0], at[1] + h, q) - here) / h], axis=1)
            at = at - np.linalg.solve(slope, here)
        return at

    step = 1e-3
    alpha, elevator = (held(step) - held(-step)) / 2
    load = c.speed * step / G
    return load / alpha, elevator / load


def qualities(aircraft: Drawn, hidden: Hidden) -> dict[str, float]:
    """By the names of station.identify/1's `derived`, SI."""
    modes, (n_alpha, per_g) = free_flight(aircraft, hidden), pull_up(aircraft, hidden)
    (omega, zeta), (slow, slow_zeta) = modes["short_period"], modes["phugoid"]
    return {
        "short_period_frequency": omega,
        "short_period_damping": zeta,
        "phugoid_frequency": slow,
        "phugoid_damping": slow_zeta,
        "n_per_alpha": n_alpha,
        "control_anticipation": omega**2 / n_alpha,
        "elevator_per_g": per_g,
    }
