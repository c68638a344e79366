"""Live derivatives of both longitudinal equations by every live method: transforms, fits, and whether to believe them.

    CL = CL_alpha alpha + CL_q q c/2V + CL_de de (+ C_d d),   Cm alike

Methods differ in their alpha only: II the calibrated vane with its rate term; III that, delayed by x/V; V the delay and
the scale 1/(1 + k_u(f)), k_u(f) = k_u0 |S(k)|/|S(0)|; split the angle of attack at the CG of alpha.py; split+gust also the
regressor d(t) = alpha_g(t) - alpha_g(t - l_t/V) for the tail, which meets the gust later, under a weak ridge that lets it
vanish in calm air (physics.md 6.4). Per radian, rates normalised with q c/2V.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import hankel2, jv

from station.estimation.equation_error import MAX_PARAMETERS, fit_methods
from station.estimation.spectra import Transform, central_difference_factor, grid
from station.profile import Aircraft, Card
from station.rows import MethodEstimate, ParamEstimate, Status

Array = NDArray[np.float64]

KINDS: Final = ("II", "III", "V", "split", "split+gust")
"""In the order that equation_error.fit_methods numbers them."""

MIN_PERIODS: Final = 0.5
"""Of the lowest frequency, before anything counts as estimated."""
EXCITED: Final = 10.0
"""Elevator energy in the band over that of its noise."""
COLLINEAR: Final = 100.0
"""Variance inflation above which regressors cannot be told apart."""
MIN_R2: Final = 0.3
SLACK_S: Final = 3.0
"""A group of signals that comes this much after the first still opens with it."""


def sears_magnitude(k: Array) -> Array:
    """|S(k)| of a thin aerofoil, k = omega c/2V: S = (J0 - i J1) C + i J1 with Theodorsen's C (Sears 1941)."""
    k = np.maximum(np.asarray(k, dtype=np.float64), 1e-9)
    h0, h1 = hankel2(0, k), hankel2(1, k)
    c = h1 / (h1 + 1j * h0)
    return np.asarray(np.abs((jv(0, k) - 1j * jv(1, k)) * c + 1j * jv(1, k)))


class Derivatives:
    """Spectra of the flight so far and what each method makes of them."""

    def __init__(
        self,
        aircraft: Aircraft,
        card: Card,
        noise: Mapping[str, float],
        methods: tuple[str, ...],
        names: tuple[str, ...],
        dt: float,
        forgetting_s: float,
    ) -> None:
        """`noise`: standard deviations of alpha_vane and elevator, rad. `names`: of the six derivatives."""
        self._dt = dt
        self._warm_up_s = card.warm_up
        self._step_hz = card.step
        self._frequencies = grid(card.low, card.high, card.step)
        self._minimum = MIN_PERIODS / card.low
        self._derivative = central_difference_factor(self._frequencies, dt)
        self._steady = Transform(7, self._frequencies, dt, forgetting_s)
        self._split = Transform(6, self._frequencies, dt, forgetting_s)
        self._methods = methods
        self._names = names
        self._kinds = np.array([KINDS.index(m) for m in methods], dtype=np.int64)
        self._out = np.zeros((len(methods), 2, 4, MAX_PARAMETERS + 1))
        self._solved = np.zeros((len(methods), 2), dtype=np.bool_)
        self._independent = np.zeros(2)
        self._known = np.array([abs(aircraft.value(n.replace("CZ", "CL"))) for n in names]).reshape(2, 3)
        self._noise = noise
        boom = aircraft.boom
        self._upwash = boom.upwash_body + boom.upwash_wing if boom else 0.0
        self._has_inertia = aircraft.inertia.iyy is not None
        self._has_tail = aircraft.unsteady.tail_arm > 0.0
        self._half_chord = aircraft.geometry.chord / 2
        self._sears_k = np.linspace(0.0, 4.0, 801)
        self._sears = sears_magnitude(self._sears_k)

    def clear(self) -> None:
        """Begin anew; the high-passes stay warm."""
        self._steady.clear()
        self._split.clear()

    def add(self, x: Array, since_start_s: float, with_split: bool) -> None:
        """One sample: q c/2V, elevator, CL, Cm, alpha steady, its vane and rate parts delayed, split alpha, d."""
        due = since_start_s >= self._warm_up_s
        self._steady.step(x[:7], due and self._steady.filtered * self._dt >= self._warm_up_s - SLACK_S)
        if with_split:
            y = np.concatenate((x[:4], x[7:9]))
            self._split.step(y, due and self._split.filtered * self._dt >= self._warm_up_s - SLACK_S)

    def estimate(self, t_ns: int, mean_speed: float, applicable: Mapping[str, str]) -> tuple[MethodEstimate, ...]:
        """What every method makes of the spectra now. `applicable`: for a method that is not, why."""
        steady, split = self._steady, self._split
        self._independent[0] = steady.samples * self._dt * self._step_hz
        self._independent[1] = split.samples * self._dt * self._step_hz
        if steady.samples > 0 and mean_speed > 0:
            k = 2.0 * np.pi * self._frequencies * self._half_chord / mean_speed
            sears = np.interp(k, self._sears_k, self._sears)
            scale = (1.0 + self._upwash) / (1.0 + self._upwash * sears)
            # What the vane's noise alone leaves in d on all lines.
            ridge = len(k) * split.samples * self._noise["alpha_vane"] ** 2
            fit_methods(
                self._kinds,
                steady.spectrum,
                split.spectrum,
                self._derivative,
                scale,
                ridge,
                self._independent,
                self._out,
                self._solved,
            )
        sd = self._standard_errors()
        found = []
        for m, method in enumerate(self._methods):
            group = split if method.startswith("split") else steady
            blocked = self._blocked(group, method)
            parameters: list[ParamEstimate] = []
            for equation in range(2):
                parameters.extend(self._judge(m, equation, blocked, sd[m, equation]))
            why = applicable.get(method, "")
            found.append(MethodEstimate(t_ns, method, tuple(parameters), not why, why))
        return tuple(found)

    def _standard_errors(self) -> Array:
        """Statistical errors widened by the model's: how far a method lies from the richest model, (methods, 2, 3)."""
        return self._out[:, :, 1, :3]

    def _blocked(self, group: Transform, method: str) -> tuple[Status, str]:
        """Why a method has no estimates yet; an empty reason if it has."""
        if method == "split+gust" and not self._has_tail:
            return Status.INVALID, "the aircraft profile gives no tail arm"
        if group.samples == 0:
            if group is self._split and self._steady.samples > 0:
                return Status.INVALID, "no attitude to split the angle of attack with"
            return Status.UNESTIMATED, "warming up"
        if group.samples * self._dt < self._minimum:
            return Status.UNESTIMATED, f"less than {self._minimum:g} s of data"
        energy = float(np.mean(np.abs(group.spectrum[1]) ** 2))
        if energy < EXCITED * group.samples * self._noise["elevator"] ** 2:
            return Status.UNESTIMATED, "no elevator input"
        return Status.ESTIMATED, ""

    def _judge(self, m: int, equation: int, blocked: tuple[Status, str], sd: Array) -> list[ParamEstimate]:
        names = self._names[3 * equation : 3 * equation + 3]
        status, why = blocked
        if equation == 1 and not self._has_inertia:
            return [ParamEstimate(n, math.nan, math.nan, Status.INVALID, "profile has no iyy") for n in names]
        if not self._solved[m, equation]:
            if status is Status.ESTIMATED:
                status, why = Status.INVALID, "regressors cannot be told apart"
            return [ParamEstimate(n, math.nan, math.nan, status, why) for n in names]
        out = self._out[m, equation]
        last = 4 if self._methods[m] == "split+gust" else 3
        poor = out[0, last] < MIN_R2
        found = []
        for i, name in enumerate(names):
            value, error = float(out[0, i]), float(sd[i])
            this, reason = status, why
            if status is Status.ESTIMATED:
                if not (math.isfinite(value) and math.isfinite(error)):
                    this, reason = Status.INVALID, "no finite solution"
                elif out[3, i] > COLLINEAR:
                    this, reason = Status.INVALID, "moves together with other regressors: vary the input"
                elif poor:
                    this, reason = Status.INVALID, f"the model explains {max(out[0, last], 0.0):.0%} of the data"
                elif 2.0 * out[1, i] > max(abs(value), self._known[equation, i]):
                    this, reason = Status.UNESTIMATED, "2 sd exceed the value"
            found.append(ParamEstimate(name, value, error, this, reason))
        return found
