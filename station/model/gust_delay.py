"""How early the vane meets a gust, and its upwash, from the gusts themselves: never from lift against all of alpha.

The gust-only signal at the boom is what the vane shows beyond the motion; the lift (and moment) that it makes arrives
later (gust_model). Gust arrival offset and upwash k_u0 = k_f + k_w (their ratio is the profile's), the mean wind's
error, slopes and the rest are fitted by generalised total least squares to the spectra of what both equations leave:
each line weighs with the inverse of the covariance that the sensors' noise gives the two there. For a delay alone that
is the Hannan-Thomson (Knapp and Carter 1976) weight gamma^2/(|G|(1 - gamma^2)); with both equations the vane's noise,
which they share, is all but taken out. The covariance is that of the noise in the regressors too, so nothing is
attenuated. What the profile's constants may be wrong by (its section `uncertainty`) is reckoned to first order: by how
much the estimates would move were each of them one standard deviation larger.

Source: Hannan and Thomson 1973; Knapp and Carter 1976. SI, rad.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from station.model.gust_model import ARRIVAL, BAND, SLOPES, UPWASH, WIND, Array, Complex, Equation, GustModel
from station.model.inertial_path import InertialPath
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft, Indicial

MIN_S: Final = 20.0
ITERATIONS: Final = 40
GUST_ENERGY: Final = 4.0
"""Of the gust in the band over what the sensors' noise leaves there."""
MODEL_S: Final = 0.002
"""What the linear model leaves in a delay."""
STEPS: Final = (0.02, 0.005, 0.002, 0.01)
"""Of gust arrival offset, upwash, wind and slopes, for differences."""
SETTLED: Final = 1e-5
SECOND_ORDER: Final = 0.3
"""What the model leaves of gust times headwind gust, as a share of it in an equation's wing and tail (simulations
without noise, 10 ft/s)."""
TINY: Final = 1e-9
"""Keeps the covariance of two equations invertible where only the vane is noisy."""
UNMODELLED: Final = 1.15
"""On standard errors: what the linear model leaves (80 simulated minutes each with and without an input)."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """How far ahead of the CG the vane meets a gust, by one equation or by both, and the vane's steady upwash."""

    equations: tuple[Equation, ...]
    delay_s: float
    delay_sd: float
    """With what the profile's constants may be wrong by, as all `_sd`; `_statistical`: from noise alone."""
    distance_m: float
    """Delay times the mean speed."""
    distance_sd: float
    delay_statistical: float
    distance_statistical: float
    upwash: float
    """k_u0: the vane reads 1 + k_u0 times the flow angle when steady. The profile's, with an infinite error, where
    motion and gust act too much alike."""
    upwash_sd: float
    upwash_statistical: float
    slopes: Mapping[str, tuple[float, float]]
    """The other fitted numbers with their standard deviations."""
    excess: float
    """Mean square of the residual over what the sensors' noise explains."""


@dataclass(frozen=True, slots=True)
class GustDelay:
    """`joint` from lift and moment; `apart` by either alone, where it is identifiable. `agree`: whether the two ask for
    the same delay, were the profile's constants right. If not, the cause is not the vane but how the tail or the wing's
    unsteady lift meet the gust."""

    joint: Arrival
    apart: Mapping[Equation, Arrival]
    agree: bool
    speed: float
    seconds: float
    band_hz: tuple[float, float] = BAND


def gust_delay(
    motion: Mapping[str, Array],
    path: InertialPath,
    measured: Mapping[Equation, Array],
    aircraft: Aircraft,
    noise: Mapping[str, float],
    dt: float,
) -> GustDelay:
    """The vane's gust arrival offset and its upwash, from gusts with or without test inputs.

    `motion`: signals (n,) on a uniform grid at the CG, all finite: alpha_vane, q, airspeed, dynamic_pressure, elevator;
    `path` of the same rows; `measured`: CL and, with iyy known, Cm (n,); `noise`: standard deviations, SI. Raises
    NotIdentifiable for a record too short or without gusts, an aircraft without a boom, and gusts that do not fit it.
    """
    if aircraft.boom is None:
        raise NotIdentifiable("the aircraft profile has no boom")
    n = len(path.alpha)
    if n * dt < MIN_S:
        raise NotIdentifiable(f"{n * dt:.0f} s of record: a gust delay needs {MIN_S:g} s")
    model = GustModel(motion, path, measured, aircraft, noise, dt)
    energy = model.gust_energy()
    if energy < GUST_ENERGY:
        raise NotIdentifiable(f"no gusts: {energy:.2g} times the sensors' noise between {BAND[0]:g} and {BAND[1]:g} Hz")
    both: tuple[Equation, ...] = ("CL", "Cm") if "Cm" in measured else ("CL",)
    doubted = [
        GustModel(later, path, measured, other, noise, dt)
        for later, other in _in_doubt(motion, aircraft, model.speed, dt)
    ]
    joint = _fit(model, both, doubted)
    apart: dict[Equation, Arrival] = {} if len(both) > 1 else {"CL": joint}
    for name in both if len(both) > 1 else ():
        # With constants far from true an equation alone may ask for an offset beyond all bounds.
        with contextlib.suppress(NotIdentifiable):
            apart[name] = _fit(model, (name,), doubted)
    if not apart:
        raise NotIdentifiable(
            "neither CL nor Cm alone determines the gust arrival offset: the gusts do not fit the profile's aircraft"
        )
    spread = math.hypot(*(one.delay_statistical for one in apart.values()))
    delays = [one.delay_s for one in apart.values()]
    agree = len(apart) == len(both) and max(delays) - min(delays) <= 3 * spread + MODEL_S
    return GustDelay(joint, apart, agree, model.speed, n * dt)


def _in_doubt(
    motion: Mapping[str, Array], aircraft: Aircraft, speed: float, dt: float
) -> Iterator[tuple[Mapping[str, Array], Aircraft]]:
    """Motion and aircraft with one constant at a time larger by its standard deviation.

    A lag of the span is not among them: the gust is taken to be the same along the wing."""
    u, boom, doubt = aircraft.unsteady, aircraft.boom, aircraft.uncertainty
    assert boom is not None

    def grown(response: Indicial | None, amplitude: float, rate: float) -> Indicial | None:
        if response is None:
            return None
        return Indicial(a=tuple((1 + amplitude) * a for a in response.a), b=tuple((1 + rate) * b for b in response.b))

    lift, upwash = doubt.lift_rate, doubt.upwash_rate
    for change in (
        {"tail_lift_slope": u.tail_lift_slope * (1 + doubt.tail_lift_slope)},
        {"downwash": min(u.downwash * (1 + doubt.downwash), 0.99)},
        {"downwash_delay": u.downwash_delay + doubt.downwash_delay},
        {"tail_arm": u.tail_arm * (1 + doubt.tail_arm)},
        {"lift_motion": grown(u.lift_motion, doubt.lift_memory, 0.0)},
        {"lift_motion": grown(u.lift_motion, 0.0, lift), "lift_gust": grown(u.lift_gust, 0.0, lift)},
        {"upwash_motion": grown(u.upwash_motion, 0.0, upwash), "upwash_gust": grown(u.upwash_gust, 0.0, upwash)},
    ):
        yield motion, aircraft.model_copy(update={"unsteady": u.model_copy(update=change)})
    wing = boom.upwash_wing * (1 + doubt.upwash_wing)
    for place in (
        {"upwash_wing": wing, "upwash_body": boom.upwash_body + boom.upwash_wing - wing},
        {"vane_x": boom.vane_x + doubt.vane_x * speed},
    ):
        yield motion, aircraft.model_copy(update={"boom": boom.model_copy(update=place)})
    vane = motion["alpha_vane"]
    late = np.interp(np.arange(len(vane)) - doubt.vane_delay / dt, np.arange(len(vane)), vane)
    yield {**motion, "alpha_vane": late}, aircraft


def _fit(model: GustModel, names: Sequence[Equation], doubted: Sequence[GustModel]) -> Arrival:
    """Gust arrival offset, upwash and each equation's slopes by generalised total least squares; `doubted`: the model
    with one constant at a time wrong by its standard deviation."""
    (wing, tail), _ = model.columns(model.start)
    free = 3 if model.is_flown else 2
    regressors = np.array([wing, model.rate, model.elevator][:free]).reshape(free, -1)
    slopes = np.zeros((len(names), 3))
    for k, name in enumerate(names):
        target = (model.measured[name] - model.tail[name] * tail).ravel()
        normal = (regressors.conj() @ regressors.T).real
        slopes[k, :free] = np.linalg.solve(normal, (regressors.conj() @ target).real)
    start = np.concatenate([model.start, slopes.ravel()])
    moved = [i for i in range(len(start)) if i < SLOPES or (i - SLOPES) % 3 < free]
    try:
        return _arrival(model, names, start, moved, doubted)
    except NotIdentifiable:
        # Where motion and gust act alike on the lift, the vane's scale and the lift's are not identifiable together.
        return _arrival(model, names, start, [i for i in moved if i != UPWASH], doubted)


def _arrival(
    model: GustModel, names: Sequence[Equation], x: Array, moved: list[int], doubted: Sequence[GustModel]
) -> Arrival:
    """From starting values `x`, with the errors of what is `moved`; the errors of the rest are infinite."""
    columns, _ = model.columns(x[:SLOPES])
    own = np.zeros((len(names), 1))
    parts = [(x[SLOPES + 3 * k] * columns[0], model.tail[name] * columns[1]) for k, name in enumerate(names)]
    rest = (SECOND_ORDER * model.gustiness) ** 2 * np.sum(np.abs(parts) ** 2, axis=1)
    for _ in range(2):
        x, covariance, towards = _settle(model, names, x, moved, own, rest)
        residual, noises = model.residual(names, model.columns(x[:SLOPES]), x[SLOPES:])
        excess = np.mean(np.abs(residual) ** 2 / (np.sum(np.abs(noises) ** 2, axis=1) + rest), axis=1)
        # What the sensors leave unexplained of an equation is taken for its own.
        own = np.maximum(excess - 1, 0.0)[:, None]
    by_noise, sd = np.full(len(x), math.inf), np.full(len(x), math.inf)
    by_noise[moved] = np.sqrt(np.diag(covariance))
    noise_only = covariance
    for other in doubted:
        change = other.residual(names, other.columns(x[:SLOPES]), x[SLOPES:])[0] - residual
        shift = np.einsum("iel,el->i", towards, change).real
        covariance = covariance + np.outer(shift, shift)
    sd[moved] = np.sqrt(np.diag(covariance))
    speed = model.speed * (1 + x[WIND])
    by = np.zeros(len(moved))
    by[moved.index(ARRIVAL)], by[moved.index(WIND)] = 1.0, -x[ARRIVAL] / (1 + x[WIND])
    labels = [f"{name}_{slope}" for name in names for slope in ("wing", "q", "de")]
    return Arrival(
        equations=tuple(names),
        delay_s=float(x[ARRIVAL] / speed),
        delay_sd=math.sqrt(by @ covariance @ by) / speed,
        distance_m=float(x[ARRIVAL]),
        distance_sd=float(sd[ARRIVAL]),
        delay_statistical=math.sqrt(by @ noise_only @ by) / speed,
        distance_statistical=float(by_noise[ARRIVAL]),
        upwash=float(x[UPWASH]),
        upwash_sd=float(sd[UPWASH]),
        upwash_statistical=float(by_noise[UPWASH]),
        slopes={labels[i - SLOPES]: (float(x[i]), float(sd[i])) for i in moved[SLOPES:]},
        excess=float(np.mean(excess)),
    )


def _settle(
    model: GustModel, names: Sequence[Equation], x: Array, moved: list[int], own: Array, rest: Array
) -> tuple[Array, Array, Complex]:
    """The least sum of squares, by scoring from `x`, the covariance there of what is `moved`, and how much that moves
    for a further residual (equations, lines): the real part of its product with the last.

    `own` (equations, 1): further variance of an equation, in shares of its sensors'; `rest` (equations, lines):
    and as it is.
    """

    def weighted(residual: Complex, noises: Complex) -> tuple[Complex, float]:
        covariance = np.einsum("esl,fsl->lef", noises, noises.conj())
        for k in range(len(names)):
            covariance[:, k, k] = covariance[:, k, k] * (1 + own[k] + TINY) + rest[k]
        weight = np.linalg.inv(covariance)
        return weight, float(np.einsum("el,lef,fl->", residual.conj(), weight, residual).real)

    for _ in range(ITERATIONS):
        columns = model.columns(x[:SLOPES])
        residual, noises = model.residual(names, columns, x[SLOPES:])
        weight, _ = weighted(residual, noises)
        slopes, slopes_noise, score = [], [], []
        for i in moved:
            step = STEPS[min(i, SLOPES)]
            up, down = x.copy(), x.copy()
            up[i] += step
            down[i] -= step
            above = model.residual(names, model.columns(up[:SLOPES]) if i < SLOPES else columns, up[SLOPES:])
            below = model.residual(names, model.columns(down[:SLOPES]) if i < SLOPES else columns, down[SLOPES:])
            slopes.append((above[0] - below[0]) / (2 * step))
            slopes_noise.append((above[1] - below[1]) / (2 * step))
            score.append((weighted(*below)[1] - weighted(*above)[1]) / (2 * step))
        j, h = np.array(slopes), np.array(slopes_noise)
        # Noise in the regressors carries no information: their sum of squares less its share.
        information = np.einsum("iel,lef,jfl->ij", j.conj(), weight, j).real
        information = 2 * (information - np.einsum("iesl,lef,jfsl->ij", h.conj(), weight, h).real)
        wind = moved.index(WIND)
        information[wind, wind] += model.wind_sd**-2
        score[wind] -= x[WIND] / model.wind_sd**2
        change = np.zeros(len(x))
        change[moved] = np.linalg.solve(information, np.array(score))
        most = 0.3 * np.array([abs(x[ARRIVAL]) + 1.0, 0.3])
        change *= min(1.0, float(np.min(most / np.maximum(np.abs(change[:2]), 1e-12))))
        x = x + change
        if np.all(np.abs(change[:2]) < SETTLED):
            inverse = np.linalg.inv(information)
            towards = -2 * np.einsum("ij,jel,lef->ifl", inverse, j.conj(), weight)
            return x, UNMODELLED**2 * inverse, towards
    raise NotIdentifiable(
        "gust arrival offset and upwash did not converge: the gusts do not fit the profile's aircraft"
    )
