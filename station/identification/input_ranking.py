"""Which elevator input gives the most information on the least well known derivative.

Each candidate is flown through the linear short period of the aircraft's profile,

    alpha' = q - (rho V S/2m) dCL,   q' = (qbar S c/Iyy) dCm,   dC = C_a alpha + C_q q c/2V + C_de de

and its regressors give the information M = X'X/s^2 on each equation's three derivatives (constant removed), s being
the rms residual of the equation in the record, or a usual one. Predicted standard errors are sqrt(diag(M^-1));
candidates have the same peak and the same time, so the ranking is that of information for equal effort.

Sources: Klein and Morelli 2006, section 9.3 (input design, Cramer-Rao bounds); Plaetschke and Schulz 1979 (3-2-1-1).
SI, per rad.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import StateSpace, cont2discrete, lfilter

from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft

Array = NDArray[np.float64]

DT: Final = 0.02
SPAN_S: Final = 20.0
PEAK: Final = math.radians(2.0)
AFTER_S: Final = 3.0
"""Of the response after an input that counts for it."""
RESIDUAL: Final = {"CL": 0.01, "Cm": 0.005}
"""Of a good installation in light turbulence, where the record's own is unknown."""
INDEPENDENT_S: Final = 0.25
"""Correlation time of the residuals: samples within it count as one."""
DERIVATIVES: Final = ("alpha", "q", "de")


@dataclass(frozen=True, slots=True)
class Input:
    """A candidate of peak PEAK over SPAN_S, and the predicted standard error of each derivative."""

    name: str
    std_error: Mapping[str, float]
    relative: Mapping[str, float]
    """Two standard errors over the profile's value."""


def short_period(aircraft: Aircraft, speed: float, density: float) -> tuple[float, float]:
    """Natural frequency (rad/s) and damping of the profile's short period. Raises NotIdentifiable without one."""
    a, _ = _system(aircraft, speed, density)
    product, total = float(np.linalg.det(a)), float(np.trace(a))
    if product <= 0:
        raise NotIdentifiable("the profile's short period does not oscillate: it is unstable")
    return math.sqrt(product), -total / (2 * math.sqrt(product))


def rank_inputs(
    aircraft: Aircraft,
    speed: float,
    density: float,
    poorest: str,
    residual: Mapping[str, float] | None = None,
) -> list[Input]:
    """Candidates, the best for `poorest` first: a derivative's name such as Cm_q.

    `residual`: standard deviations of CL's and Cm's equation. Raises NotIdentifiable for a profile without the
    derivatives or inertia, and ValueError for a name that is none of the six.
    """
    equation, _, of = poorest.partition("_")
    if equation not in RESIDUAL or of not in DERIVATIVES:
        raise ValueError(f"{poorest}: not a longitudinal derivative")
    frequency, _ = short_period(aircraft, speed, density)
    predict = _predictor(aircraft, speed, density, {**RESIDUAL, **(residual or {})})
    made = [predict(name, PEAK * shape) for name, shape in _candidates(2 * math.pi / frequency)]
    return sorted(made, key=lambda one: one.std_error[poorest])


def better_input(aircraft: Aircraft, speed: float, density: float, derivative: str, own: Array) -> tuple[str, float]:
    """The candidate that tells most of a derivative, at the peak of `own` (n,), rad from trim every DT, and its error
    over that of `own`, both for the same time flown. Raises as rank_inputs does."""
    peak = float(np.abs(own).max()) if len(own) else 0.0
    if peak <= 0:
        raise NotIdentifiable("the elevator does not move")
    best = rank_inputs(aircraft, speed, density, derivative)[0]
    padded = np.concatenate([own, np.zeros(round(AFTER_S / DT))])
    mine = _predictor(aircraft, speed, density, RESIDUAL)("own", padded).std_error[derivative]
    seconds = len(padded) * DT
    return best.name, best.std_error[derivative] * PEAK / peak * math.sqrt(SPAN_S / seconds) / mine


def _predictor(
    aircraft: Aircraft, speed: float, density: float, residual: Mapping[str, float]
) -> Callable[[str, Array], Input]:
    """What an input, rad from trim every DT, would leave of each derivative's uncertainty."""
    a, b = _system(aircraft, speed, density)
    discrete = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), DT, "foh")

    def predict(name: str, commanded: Array) -> Input:
        elevator = _through_actuator(commanded, aircraft.elevator.time_constant)
        states = _respond(discrete, elevator)
        x = np.column_stack([states[:, 0], states[:, 1] * aircraft.geometry.chord / (2 * speed), elevator])
        x = x - x.mean(axis=0)
        covariance = np.linalg.pinv(x.T @ x)
        errors, relative = {}, {}
        for of_equation, s in residual.items():
            for i, derivative in enumerate(DERIVATIVES):
                parameter = f"{of_equation}_{derivative}"
                sd = s * math.sqrt(covariance[i, i] * INDEPENDENT_S / DT)
                errors[parameter] = sd
                relative[parameter] = 2 * sd / max(abs(aircraft.value(parameter)), 1e-9)
        return Input(name, errors, relative)

    return predict


def _system(aircraft: Aircraft, speed: float, density: float) -> tuple[Array, Array]:
    """d/dt (alpha, q) = A (alpha, q) + B de."""
    value, inertia = aircraft.value, aircraft.inertia
    if aircraft.kinematics_only or inertia.iyy is None or value("CL_alpha") == 0 or value("Cm_alpha") == 0:
        raise NotIdentifiable("no errors can be predicted: the profile has no longitudinal derivatives or no iyy")
    area, chord = aircraft.geometry.wing_area, aircraft.geometry.chord
    lift = density * speed * area / (2 * inertia.mass)
    moment = 0.5 * density * speed**2 * area * chord / inertia.iyy
    per_rate = chord / (2 * speed)
    a = np.array(
        [
            [-lift * value("CL_alpha"), 1 - lift * value("CL_q") * per_rate],
            [moment * value("Cm_alpha"), moment * value("Cm_q") * per_rate],
        ]
    )
    return a, np.array([[-lift * value("CL_de")], [moment * value("Cm_de")]])


def _respond(system: StateSpace, elevator: Array) -> Array:
    ad, bd, cd, dd, _ = system
    out = np.empty((len(elevator), 2))
    x = np.zeros(2)
    for k, de in enumerate(elevator):
        out[k] = cd @ x + dd[:, 0] * de
        x = ad @ x + bd[:, 0] * de
    return out


def _through_actuator(shape: Array, time_constant: float) -> Array:
    keep = math.exp(-DT / time_constant)
    return np.asarray(lfilter([1 - keep], [1.0, -keep], shape))


def _candidates(period: float) -> Iterator[tuple[str, Array]]:
    """Doublets and 3-2-1-1 of widths around the short period's, doublets of three widths, a multisine."""
    n = round(SPAN_S / DT)
    t = np.arange(n) * DT

    def doublets(*widths: float) -> Array:
        shape, gap = np.zeros(n), SPAN_S / len(widths)
        for i, width in enumerate(widths):
            since = t - i * gap - 1.0
            shape += np.where((since >= 0) & (since < width), 1.0, 0.0)
            shape -= np.where((since >= width) & (since < 2 * width), 1.0, 0.0)
        return shape

    for share in (0.15, 0.25, 0.4, 0.6):
        width = round(share * period, 2)
        if 2 * width < SPAN_S / 3:
            yield f"three doublets of {width:g} s halves", doublets(width, width, width)
    mixed = [round(share * period, 2) for share in (0.15, 0.3, 0.6)]
    if 2 * max(mixed) < SPAN_S / 3:
        yield f"doublets of {mixed[0]:g}, {mixed[1]:g} and {mixed[2]:g} s halves", doublets(*mixed)
    for share in (0.15, 0.25, 0.35):
        unit = round(share * period, 2)
        if 7 * unit + 1 > SPAN_S / 2:
            continue
        since = (t - 1.0) % (SPAN_S / 2)
        edges = np.searchsorted(np.array([3.0, 5.0, 6.0, 7.0]) * unit, since, side="right")
        shape = np.where(t >= 1.0, np.array([1.0, -1.0, 1.0, -1.0, 0.0])[edges], 0.0)
        yield f"two 3-2-1-1 of {unit:g} s units", shape
    harmonics = np.arange(2, max(40, math.ceil(1.5 * SPAN_S / period)) + 1)
    phases = -math.pi * np.arange(len(harmonics)) * np.arange(1, len(harmonics) + 1) / len(harmonics)
    sum_of_sines = np.sin(2 * math.pi * np.outer(t, harmonics) / SPAN_S + phases).sum(axis=1)
    yield f"multisine, 20 s, 0.1 to {harmonics[-1] / SPAN_S:g} Hz", sum_of_sines / np.abs(sum_of_sines).max()
