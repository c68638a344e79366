"""Live derivatives of both longitudinal equations by every live method: transforms, fits, and their acceptance.

    CL = CL_alpha alpha + CL_q q c/2V + CL_de de (+ C_d d),   Cm alike

Methods differ in their alpha only: II the calibrated vane with its rate term; III that, delayed by x/V; IV with delay
and scale 1/(1 + k_u(f)) by frequency, from spectra measured before (cross_spectra); V III with the scale
1/(1 + k_u(f)), k_u(f) = k_u0 |S(k)|/|S(0)|; split the angle of attack at the CG of alpha.py; split+gust also the
regressor d(t) = alpha_g(t) - alpha_g(t - l_t/V) for the tail, which meets the gust later, under a weak ridge that lets
it vanish in calm air. Per radian, rates normalised with q c/2V.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation import acceptance, method_fits
from station.estimation.acceptance import (
    ESTIMATED,
    EXCITED,
    MIN_PERIODS,
    NO_INERTIA,
    NO_SPLIT,
    NO_TAIL,
    SHORT,
    STILL,
    UNSOLVED,
    WARMING,
)
from station.estimation.equation_error import Fitted
from station.estimation.method_fits import (
    ELEVATOR,
    GROUP_OF,
    GROUPS,
    KINDS,
    PARAMETERS,
    SPLIT_ALPHA,
    SPLIT_CHANNELS,
    STEADY,
    STEADY_CHANNELS,
    Factors,
    Found,
    fit_methods,
)
from station.estimation.published.cross_spectra import VaneSpectra
from station.model import regressor_error, unsteady_lift
from station.model.airframe_error import relative_errors
from station.numerics import spectra
from station.numerics.spectra import Transform, central_difference_factor, grid
from station.numerics.thin_aerofoil import sears_magnitude
from station.profile import Aircraft, Card
from station.rows import MethodEstimate, ParamEstimate, Status

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Whole = NDArray[np.int64]

SLACK_S: Final = 3.0
"""A group of signals that comes this much after the first still opens with it."""


SEARS_K: Final = np.linspace(0.0, 4.0, 801)
SEARS: Final = sears_magnitude(SEARS_K)
"""|S| at SEARS_K."""


def lengths(aircraft: Aircraft) -> tuple[float, float, float]:
    """Half the chord and the tail's arm, m, and the steady upwash at the vane, which `weights` depend on."""
    boom = aircraft.boom
    upwash = boom.upwash_body + boom.upwash_wing if boom else 0.0
    return aircraft.geometry.chord / 2, aircraft.unsteady.tail_arm, upwash


@njit(cache=True)
def moved(mean: float, before: float) -> bool:
    """Whether a mean of the flight is so far from what weights were made for (NaN: never) that they want a change."""
    return not abs(mean - before) < 0.001 * mean


@njit(cache=True)
def weights(
    about: tuple[float, float, float],
    speed: float,
    frequencies: Array,
    sears_k: Array,
    sears: Array,
    scale: Array,
    tail: Array,
) -> None:
    """At a mean airspeed (m/s) and each frequency (Hz): V's `scale` of the vane and the `tail` of method_fits.Factors.

    `about`: see `lengths`; `sears`: |S| at reduced frequencies `sears_k`, which rise evenly from 0. (Not np.interp: it
    takes longer to compile than all else here.)
    """
    half_chord, tail_arm, upwash = about
    last = sears_k.shape[0] - 1
    for i in range(frequencies.shape[0]):
        wavenumber = 2.0 * math.pi * frequencies[i] / speed
        at = min(wavenumber * half_chord / sears_k[1], float(last))
        below = min(int(at), last - 1)
        magnitude = sears[below] + (at - below) * (sears[below + 1] - sears[below])
        scale[i] = (1.0 + upwash) / (1.0 + upwash * magnitude)
        tail[i] = math.tan(min(wavenumber * tail_arm / 4.0, 1.0))


@njit(cache=True)
def measured_factors(
    frequencies: Array, delay: Array, upwash: Array, steady_upwash: float, lead: float, measured: Complex
) -> None:
    """Of IV: what turns the vane's part, scaled for `steady_upwash` and delayed by `lead` (s), and the rate's into ones
    with each frequency's own `delay` (s) and `upwash`. Fills `measured` (2, frequencies)."""
    for i in range(frequencies.shape[0]):
        angle = 2.0 * math.pi * frequencies[i] * (lead - delay[i])
        measured[1, i] = complex(math.cos(angle), math.sin(angle))
        measured[0, i] = measured[1, i] * (1.0 + steady_upwash) / (1.0 + upwash[i])


@njit(cache=True)
def add(
    design: spectra.Design,
    steady: spectra.State,
    split: spectra.State,
    x: Array,
    is_open: bool,
    with_split: bool,
    split_is_open: bool,
) -> None:
    """One sample `x`, see Derivatives.add, into the transforms of both groups."""
    spectra.step(design, steady, x[:7], is_open)
    if with_split:
        spectra.step(design, split, np.concatenate((x[:4], x[7:9])), split_is_open)


@njit(cache=True)
def energy(spectrum: Complex) -> float:
    """Sum of squares over all lines, (frequencies,)."""
    total = 0.0
    for i in range(spectrum.shape[0]):
        total += spectrum[i].real ** 2 + spectrum[i].imag ** 2
    return total


@njit(cache=True)
def judge(
    fitted: Found,
    rows: Whole,
    known: Array,
    airframe: Array,
    has_inertia: bool,
    blocked: Whole,
    found: Array,
    verdicts: Whole,
) -> None:
    """Acceptance of the kinds in `rows` -> `found` (2, rows, 6): values and errors, and `verdicts` (rows, 6).

    `known` (6,): sizes of the profile's derivatives; `airframe` (6,): relative error by mass and inertia; `blocked`
    (rows,): a verdict over all of a kind's, or ESTIMATED.
    """
    fitted = Found(Fitted(*fitted[0]), fitted[1], fitted[2], fitted[3])
    out = fitted.fitted
    for row in range(rows.shape[0]):
        kind = rows[row]
        for i in range(6):
            e, j = i // PARAMETERS, i % PARAMETERS
            verdict = blocked[row]
            is_solved = fitted.solved[kind, e]
            if e == 1 and not has_inertia:
                verdict, is_solved = NO_INERTIA, False
            value, error = math.nan, math.nan
            if is_solved:
                value = out.value[kind, e, j]
                error = math.hypot(out.error[kind, e, j], fitted.model[kind, e, j])
                error = math.hypot(error, airframe[i] * value)
                if verdict == ESTIMATED:
                    verdict = acceptance.of_equation(fitted.r2[kind, e])
                if verdict == ESTIMATED:
                    verdict = acceptance.of_estimate(value, error, known[i], out.inflation[kind, e, j])
            elif verdict == ESTIMATED:
                verdict = UNSOLVED
            found[0, row, i], found[1, row, i] = value, error
            verdicts[row, i] = verdict


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
        vane_spectra: VaneSpectra | None = None,
    ) -> None:
        """`noise`: standard deviations of alpha_vane, q and elevator, SI. `names`: of the six derivatives.
        `vane_spectra`: of IV."""
        self._dt = dt
        self._warm_up_s = card.warm_up
        self._step_hz = card.step
        self._frequencies = grid(card.low, card.high, card.step)
        self._minimum = MIN_PERIODS / card.low
        self._derivative = central_difference_factor(self._frequencies, dt)
        self._steady_from_s: float | None = None
        self._split_from_s: float | None = None
        self._steady = Transform(STEADY_CHANNELS, self._frequencies, dt)
        self._split = Transform(SPLIT_CHANNELS, self._frequencies, dt)
        self._groups = (self._steady, self._split)
        self._samples = [0.0, 0.0]
        self._methods = methods
        self.lacking = ""
        """What has been missing for a while."""
        self._kinds = (*KINDS, "IV") if vane_spectra else KINDS
        kinds = len(self._kinds)
        self._past = method_fits.nothing_past(kinds)
        self._close = np.zeros(GROUPS, dtype=np.bool_)
        self._segment = 1.0 / card.step
        self._keep = math.exp(-self._segment / forgetting_s)
        self._closed = np.zeros((GROUPS, 2))
        """Of either group's closed segments: samples, and elevator energy on all lines."""
        self._made = method_fits.nothing_found(kinds)
        self._independent = np.zeros(GROUPS)
        self._known = np.array([abs(aircraft.value(n.replace("CZ", "CL"))) for n in names])
        self._rows = np.array([self._kinds.index(method) for method in methods], dtype=np.int64)
        self._of_kinds = np.zeros(len(methods), dtype=np.int64)
        self._found = np.zeros((2, len(methods), 6))
        self._verdicts = np.zeros((len(methods), 6), dtype=np.int64)
        self._judged, self._lacked = b"", ""
        self._labels = names * len(methods)
        self._statuses: list[Status] = []
        self._whys: list[str] = []
        self._noise = noise
        self._has_inertia = aircraft.inertia.iyy is not None
        self._airframe = relative_errors(aircraft, names)
        self.mass_recorded = False
        self._has_tail = aircraft.unsteady.tail_arm > 0.0
        self._lengths = lengths(aircraft)
        self._unsteady = unsteady_lift.known(aircraft, names[0].startswith("CZ"))
        self._paths = regressor_error.lengths(aircraft)
        self._noisy = regressor_error.deviations(aircraft, noise)
        self._speed = self._density = math.nan
        lines = len(self._frequencies)
        measured = np.ones((2, lines), dtype=np.complex128)
        self._factors = Factors(self._derivative, np.ones(lines), measured, np.zeros(lines))
        self._doubt = method_fits.no_doubt(lines)
        self._plain = (method_fits.plain(self._factors), method_fits.plain(self._doubt))
        self._plain_past, self._plain_made = method_fits.plain(self._past), method_fits.plain(self._made)
        self._by_frequency = vane_spectra.at(self._frequencies) if vane_spectra else None
        self._lead = aircraft.boom.gust_x if aircraft.boom else 0.0

    def clear(self) -> None:
        """Begin anew; the high-passes stay warm."""
        self._steady.clear()
        self._split.clear()
        method_fits.clear(self._past)
        self._closed[:] = 0.0

    def add(self, x: Array, since_start_s: float, with_split: bool) -> None:
        """One sample: q c/2V, elevator, CL, Cm, alpha steady, its vane and rate parts delayed, split alpha, d."""
        if self._steady_from_s is None:
            self._steady_from_s = since_start_s
        if with_split and self._split_from_s is None:
            self._split_from_s = since_start_s
        due = since_start_s >= self._warm_up_s
        late = since_start_s - self._warm_up_s + SLACK_S
        splits = with_split and self._split_from_s is not None and due and self._split_from_s <= late
        opens = due and self._steady_from_s <= late
        design, steady = self._steady.arrays
        add(design, steady, self._split.arrays[1], x, opens, with_split, splits)

    def estimate(
        self, t_ns: int, air: tuple[float, float, float], applicable: Mapping[str, str]
    ) -> tuple[MethodEstimate, ...]:
        """What every method makes of the spectra now.

        `air`: mean airspeed, m/s, density, kg/m3, and standard error of the mean wind, m/s. `applicable`: for a method
        that is not, why.
        """
        self._samples = [g.samples + c for g, c in zip(self._groups, self._closed[:, 0].tolist(), strict=True)]
        if self._samples[0] > 0 and air[0] > 0:
            self._fit(*air)
        of_groups = (self._blocked(0), self._blocked(1))
        for i, method in enumerate(self._methods):
            is_lost = method == "split+gust" and not self._has_tail
            self._of_kinds[i] = NO_TAIL if is_lost else of_groups[GROUP_OF[self._rows[i]]]
        sizes = (self._known, self._airframe[int(self.mass_recorded)], self._has_inertia)
        judge(self._plain_made, self._rows, *sizes, self._of_kinds, self._found, self._verdicts)
        verdicts = self._verdicts.tobytes()
        if verdicts != self._judged or self.lacking != self._lacked:
            self._judged, self._lacked = verdicts, self.lacking
            words = [self._in_words(verdict) for verdict in self._verdicts.ravel().tolist()]
            self._statuses, self._whys = [status for status, _ in words], [why for _, why in words]
        values, errors = self._found.reshape(2, -1).tolist()
        parameters = tuple(map(ParamEstimate, self._labels, values, errors, self._statuses, self._whys))
        found = []
        for i, method in enumerate(self._methods):
            reason = applicable.get(method, "")
            found.append(MethodEstimate(t_ns, method, parameters[6 * i : 6 * i + 6], not reason, reason))
        return tuple(found)

    def statistical(self) -> dict[str, list[float]]:
        """Each method's standard errors without what its model may leave out; before anything is fitted, 0."""
        errors = self._made.fitted.error[self._rows, :, :PARAMETERS].reshape(len(self._methods), 6)
        return dict(zip(self._methods, errors.tolist(), strict=True))

    @property
    def quasi_steady(self) -> Array | None:
        """What split+gust has for the six derivatives, whether asked for or not; None where nothing."""
        if not self._made.solved[method_fits.SPLIT_GUST].all():
            return None
        return np.asarray(self._made.fitted.value[method_fits.SPLIT_GUST, :, :PARAMETERS].ravel())

    def _in_words(self, verdict: int) -> tuple[Status, str]:
        if verdict == WARMING and self.lacking:
            return Status.UNESTIMATED, self.lacking
        if verdict == SHORT:
            return Status.UNESTIMATED, f"less than {self._minimum:g} s of data"
        return acceptance.worded(verdict)

    def _fit(self, mean_speed: float, density: float, wind_sd: float) -> None:
        steady, split = self._steady, self._split
        if moved(mean_speed, self._speed) or moved(density, self._density):
            self._speed, self._density = mean_speed, density
            factors, doubt = self._factors, self._doubt
            weights(self._lengths, mean_speed, self._frequencies, SEARS_K, SEARS, factors.scale, factors.tail)
            unsteady_lift.weights(self._unsteady, mean_speed, density, self._frequencies, doubt.lift)
            regressor_error.weights(self._paths, mean_speed, self._frequencies, self._noisy, doubt.regressors)
            if self._by_frequency:
                upwash, lead = self._lengths[2], self._lead / mean_speed
                measured_factors(self._frequencies, *self._by_frequency, upwash, lead, factors.measured)
        for i, group in enumerate(self._groups):
            self._independent[i] = group.samples * self._dt * self._step_hz
            self._close[i] = group.samples * self._dt >= self._segment
        samples = self._samples[SPLIT_ALPHA]
        extent: Any = (
            self._independent,
            self._close,
            samples,
            len(self._frequencies) * samples * self._noise["alpha_vane"] ** 2,
            regressor_error.wind_share(wind_sd, mean_speed, samples * self._dt),
        )
        fit_methods(steady.spectrum, split.spectrum, *self._plain, extent, self._plain_past, self._plain_made)
        for i, group in enumerate(self._groups):
            if self._close[i]:
                self._closed[i] += group.samples, energy(group.spectrum[ELEVATOR])
                self._closed[i] *= self._keep
                method_fits.fade(self._past, i, self._keep)
                group.clear()

    def _blocked(self, i: int) -> int:
        """Why a group of signals, 0 steady or 1 split, gives no estimates yet; ESTIMATED if it does."""
        samples = self._samples[i]
        if samples == 0:
            return NO_SPLIT if i == SPLIT_ALPHA and self._samples[STEADY] * self._dt > SLACK_S else WARMING
        if samples * self._dt < self._minimum:
            return SHORT
        moved = self._closed[i, 1] + energy(self._groups[i].spectrum[ELEVATOR])
        return STILL if moved < EXCITED * len(self._frequencies) * samples * self._noise["elevator"] ** 2 else ESTIMATED
