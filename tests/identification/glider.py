"""A made-up glider of known derivatives: the record of a short-period motion, without any simulation of the station."""

from __future__ import annotations

import math

import numpy as np

from station.log import Table
from station.profile import Aircraft, Geometry, Inertia

TRUTH = {"CL_alpha": 5.5, "CL_q": 12.0, "CL_de": 0.5, "Cm_alpha": -1.3, "Cm_q": -30.0, "Cm_de": -1.7}
AIRCRAFT = Aircraft(
    name="glider",
    geometry=Geometry.model_validate({"wing_area": "39 m2", "span": "19.8 m", "chord": "2 m"}),
    inertia=Inertia.model_validate({"mass": "4950 kg", "iyy": "33000 kg m2"}),
)
V, RHO, G, DT = 60.0, 1.1, 9.80665, 0.02


def flight(seconds: float = 24.0, amplitude: float = 0.04, seed: int = 1) -> dict[str, np.ndarray]:
    """Short-period motion at constant speed, elevator doublets at 4 s and 13 s, sensor noise; thrust is drag."""
    n = round(seconds / DT)
    t = np.arange(n) * DT
    asked = np.zeros(n)
    for start, width in ((4.0, 0.5), (13.0, 1.0)):
        asked += amplitude * ((t >= start) & (t < start + width)) - amplitude * (
            (t >= start + width) & (t < start + 2 * width)
        )
    qbar = 0.5 * RHO * V**2
    m, s, c, iyy = 4950.0, 39.0, 2.0, 33000.0
    cl0 = m * G / (qbar * s)
    alpha, q, theta, de = 0.0, 0.0, 0.0, 0.0
    rows = []
    fine = 10
    for k in range(n):
        for step in range(fine):
            cl = cl0 + TRUTH["CL_alpha"] * alpha + TRUTH["CL_q"] * q * c / (2 * V) + TRUTH["CL_de"] * de
            cm = TRUTH["Cm_alpha"] * alpha + TRUTH["Cm_q"] * q * c / (2 * V) + TRUTH["Cm_de"] * de
            qdot = qbar * s * c * cm / iyy
            alphadot = q + (G * math.cos(theta - alpha) - qbar * s * cl / m) / V
            if step == 0:
                rows.append((alpha, q, theta, cl, qdot, de))
            alpha += alphadot * DT / fine
            theta += q * DT / fine
            q += qdot * DT / fine
            de += (asked[k] - de) / 0.08 * DT / fine
    a, q_, theta_, cl_, qdot_, elevator = np.array(rows).T
    rng = np.random.default_rng(seed)

    def noisy(x: np.ndarray, sd: float) -> np.ndarray:
        return x + rng.normal(scale=sd, size=n)

    lift = qbar * s * cl_ / m
    return {
        "alpha_vane": noisy(a, 5e-4),
        "airspeed": noisy(np.full(n, V), 0.05),
        "dynamic_pressure": noisy(np.full(n, qbar), 1.0),
        "q": noisy(q_, 3e-4),
        "qdot": noisy(qdot_, 3e-3),
        "ax": noisy(lift * np.sin(a), 0.01),
        "az": noisy(-lift * np.cos(a), 0.02),
        "theta": noisy(theta_, 3e-4),
        "elevator": noisy(elevator, 1e-4),
    }


def record(columns: dict[str, np.ndarray], aircraft: Aircraft = AIRCRAFT) -> Table:
    return Table(np.arange(len(columns["q"])) * DT, columns, aircraft, 0)
