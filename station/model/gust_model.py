"""The gust that the vane sees before the wing does, and what wing and tail make of it: spectra for gust_delay.

Everything is laid out over distance flown through the mean air, where a frozen gust field and leads are constant
whatever the speed does. With y the vane (its own lag put on everything else), a the inertial angle of attack and S =
x/V the gust arrival offset,

    (1 + k_f) g(t) + k_w F_g{g at the wing} = y - (1 + k_f) (a - q x/V) - k_w F_m{a}        gust at the boom
    CL = CL_w (W{a} + K{g(t - S + c/4V)}) + a_h (a_t) + CL_q qhat + CL_de de + e            and Cm alike

with the indicial responses W, K, F_m, F_g and the tail (share a_h, arm, downwash) of the profile. They are of
angles, over chords flown through the gusty air; what the air carries along is the angle times the speed it is taken
over. What noise does is reckoned to first order, all speeds being the mean. SI, rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from station.model.coefficients import force_coefficients, lift_and_drag
from station.model.inertial_path import BLEND_S, InertialPath
from station.numerics.differentiation import differentiate_factor
from station.numerics.indicial import frequency_response, respond_throughout, response
from station.numerics.second_order import second_order_response
from station.numerics.turbulence import TURBULENCE_LENGTH
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Equation = Literal["CL", "Cm"]

BAND: Final = (0.03, 4.0)
"""Hz: below, the wind's mean is not known; above, lift and vane see different parts of it."""
EDGES_S: Final = (2.0, 0.5)
"""Indicial responses have decayed so long after the record's start, and what its end was continued with before its
end."""
SMOOTH_S: Final = 0.1
LOW_PASS_HZ: Final = 8.0
ARRIVAL, UPWASH, WIND, SLOPES = range(4)
"""Fitted: gust arrival offset, m; upwash; error of the mean wind along the path, as a share of the speed; then the
slopes."""


@dataclass(frozen=True, slots=True)
class _Lines:
    """Spectra of a series at the band's lines, (lines,). No taper: what the model leaves is as white as the sensors'
    noise and leaks little, and a taper would discard a part of the record."""

    bins: NDArray[np.int64]
    keep: slice

    def of(self, series: Array) -> Complex:
        kept = series[self.keep]
        return np.asarray(np.fft.rfft(kept - kept.mean())[self.bins] / math.sqrt(len(kept)))


class GustModel:
    """Regressors of both equations for a gust arrival offset, an upwash and a mean wind, and what noise does to them.

    Made from what `gust_delay` takes; the profile must have a boom. Of the record: `speed`, its mean, m/s; `start`,
    gust arrival offset, upwash and wind error as the profile has them, and `wind_sd`, the standard deviation of the
    last; `gustiness`, of the headwind gusts over the speed; `is_flown`, whether the elevator moved beyond its noise.
    Lines (lines,) of `measured` coefficients, of `rate`, q c/2V, and of `elevator`, rad. `tail`: how the tail's
    incidence enters CL and Cm.
    """

    def __init__(
        self,
        motion: Mapping[str, Array],
        path: InertialPath,
        measured: Mapping[Equation, Array],
        aircraft: Aircraft,
        noise: Mapping[str, float],
        dt: float,
    ) -> None:
        boom, unsteady = aircraft.boom, aircraft.unsteady
        assert boom is not None
        n = len(path.alpha)
        flown = np.concatenate([[0.0], np.cumsum(0.5 * (path.speed[1:] + path.speed[:-1]) * dt)])
        v = self.speed = float(flown[-1] / ((n - 1) * dt))
        chord = aircraft.geometry.chord
        headwind = gaussian_filter1d(motion["airspeed"] - path.speed, SMOOTH_S / 2 / dt, mode="nearest")
        time = np.arange(n) * dt
        is_lagging = unsteady.memory
        self._arm, self._chord, self._quarter = boom.vane_x, chord, aircraft.gust_edge
        # A wing of quasi-steady lift takes a gust where the CG is.
        self._edge = self._quarter if is_lagging else 0.0
        slope, self._downwash, self._tail = (
            (unsteady.tail_lift_slope, unsteady.downwash, unsteady.tail_arm) if is_lagging else (0.0, 0.0, 0.0)
        )
        self._late, self._washed = self._tail * unsteady.tail_penetration, self._tail + unsteady.downwash_delay * v
        self.tail: dict[str, float] = {"CL": slope, "Cm": -slope * self._tail / chord}

        def laid_out(x: Array) -> Array:
            return np.asarray(CubicSpline(flown, x)(np.arange(n) * v * dt))

        def air_at(x: float) -> Array:
            """Airspeed so far ahead of the CG over the mean: a headwind gust is frozen, too."""
            return np.asarray((path.speed + np.interp(time + x / v, time, headwind)) / v)

        ahead, air, turn = air_at(boom.gust_x), air_at(0.0), _deviation(motion["q"]) * chord / (2 * v)
        self._air_ahead, self._air_edge, self._air_tail = (
            laid_out(x) for x in (ahead, air_at(self._edge), air_at(-self._late))
        )
        series: dict[str, Array] = {
            "vane": _deviation(motion["alpha_vane"]),
            "flow": _deviation(motion["alpha_vane"]) * ahead,
            "motion": _deviation(path.alpha),
            "sink": _deviation(path.alpha) * path.speed / v,
            "climb": _deviation(motion["theta"] - path.alpha),
            "pitch": _deviation(motion["theta"] * path.speed / v),
            "q": turn,
            "rate": turn / air,
            "de": _deviation(motion["elevator"]),
        }
        series |= {str(name): _deviation(x) for name, x in measured.items()}
        # Twice the length, mirrored oddly, so that nothing jumps where the transform closes on itself.
        self._n = n
        self._size = 2 * n
        jw: Complex = np.asarray(2j * np.pi * np.fft.rfftfreq(self._size, dt), dtype=np.complex128)
        self._jw = jw
        lag = np.asarray(second_order_response(boom.vane_frequency, boom.vane_damping, jw))
        laid = {name: laid_out(x) for name, x in series.items()}
        has_qdot = bool(np.isfinite(motion.get("qdot", np.full(1, np.nan))).all())
        self._spectra = _spectra(laid, jw, lag, None if has_qdot else dt)
        self._reference = unsteady.reference_chord or chord
        lift = (unsteady.lift_motion, unsteady.lift_gust) if is_lagging else (None, None)
        self._responses_of = [response(x) for x in (*lift, unsteady.upwash_motion, unsteady.upwash_gust)]
        self._chords = laid_out(motion["airspeed"] / path.speed) * v * dt / self._reference
        total = boom.upwash_body + boom.upwash_wing
        self._wing_share = boom.upwash_wing / total if total else 0.0
        self.start = np.array([boom.gust_x, total, 0.0])
        self.gustiness = float(np.std(headwind)) / v
        share = 2 / (float(flown[-1]) / TURBULENCE_LENGTH + 2)
        self.wind_sd = self.gustiness * math.sqrt(share / (1 - share)) + 1e-6
        self._lines, self._at = _lines(n, dt)
        self._common = _low_pass(jw[self._at])
        self.measured = {str(name): self._lines.of(self._back(self._spectra[name])) for name in measured}
        self.rate = self._lines.of(self._back(self._spectra["rate"]))
        self.elevator = self._lines.of(self._back(self._spectra["de"]))
        floor = noise.get("elevator", 0.0) ** 2
        self.is_flown = float(np.mean(np.abs(self.elevator / self._common) ** 2)) > 10 * floor + 1e-16
        self._noise = self._sources(motion, aircraft, noise, v, lag[self._at])
        if "CL" in self.measured:
            self.measured["CL"] = self.measured["CL"] - _along(motion, path, aircraft) * self._early()

    def _early(self) -> Complex:
        """Lines of what the calibrated vane's angle of attack, which lift was taken across, has more than that at the
        CG: it meets the gust early."""
        s, gust = self._spectra, self._gust(self.start)[0]
        early = s["flow"] / (1 + self.start[UPWASH]) + 2 * self._arm / self._chord * s["q"]
        early = early - s["sink"] - gust * np.exp(-self._jw * self._arm / self.speed)
        return self._lines.of(self._back(early))

    def _sources(
        self, motion: Mapping[str, Array], aircraft: Aircraft, noise: Mapping[str, float], v: float, lag: Complex
    ) -> Complex:
        """What one standard deviation of each source of noise, white from sample to sample, puts on the lines of vane,
        motion, rate, elevator, CL and Cm: (6, sources, lines)."""
        pressure = float(np.mean(motion["dynamic_pressure"]))
        force = aircraft.inertia.mass / (pressure * aircraft.geometry.wing_area)
        inertia = (aircraft.inertia.iyy or 0.0) / (pressure * aircraft.geometry.wing_area * self._chord)
        jw = self._jw[self._at]
        # The path has attitude and velocity below its blending band, integrals of rate and acceleration above it.
        slow = np.exp(-0.5 * (np.abs(jw) * BLEND_S) ** 2)
        fast = (1 - slow) / jw
        zero, one = np.zeros_like(jw), np.ones_like(jw)
        made = {
            "alpha_vane": (one / lag, zero, zero, zero, zero, zero),
            "theta": (zero, slow, zero, zero, zero, zero),
            "v_down": (zero, slow / v, zero, zero, zero, zero),
            "q": (zero, fast, one * self._chord / (2 * v), zero, zero, inertia * jw),
            "az": (zero, fast / v, zero, zero, -force * one, zero),
            "dynamic_pressure": (zero, zero, zero, zero, one * float(np.mean(motion["az"])) * force / pressure, zero),
            "elevator": (zero, zero, zero, one, zero, zero),
        }
        table = np.array([noise.get(name, 0.0) * np.array(row) for name, row in made.items()])
        return np.asarray(np.swapaxes(table, 0, 1) * lag * self._common)

    def _back(self, spectrum: Complex) -> Array:
        return np.asarray(np.fft.irfft(spectrum, self._size)[: self._n])

    def gust_energy(self) -> float:
        """Of the gust at the boom in the band, over that of the noise it is made with."""
        spectrum, shares = self._gust(self.start)
        gust = self._lines.of(self._back(spectrum))
        noise = np.einsum("cl,csl->sl", shares[:, self._at], self._noise[:3])
        return float(np.median(np.abs(gust) ** 2 / np.sum(np.abs(noise) ** 2, axis=0)))

    def _gust(self, p: Array) -> tuple[Complex, Complex]:
        """Gust at the boom, a velocity over the mean speed, as if angles were such too; its response to vane, motion
        and rate, (3, m)."""
        _, _, motion_upwash, gust_upwash = self._frequency_responses(p)
        wing = p[UPWASH] * self._wing_share
        body = p[UPWASH] - wing
        back = self._after(p[ARRIVAL] - self._quarter, p)
        whole = (1 + body) + wing * gust_upwash * back
        by_motion = ((1 + body) + wing * motion_upwash) / whole
        shares = np.array([1 / whole, -by_motion, (1 + body) * 2 * self._arm / self._chord / whole])
        s = self._spectra
        return shares[0] * s["flow"] + shares[1] * self._sink(p) + shares[2] * s["q"], shares

    def _after(self, distance: float, p: Array) -> Complex:
        """What it takes to fly a distance, m."""
        return np.asarray(np.exp(-self._jw * distance / (self.speed * (1 + p[WIND]))))

    def _frequency_responses(self, p: Array) -> list[Complex]:
        steps = self._jw * self._reference / (self.speed * (1 + p[WIND]))
        return [np.asarray(frequency_response(of, steps)) for of in self._responses_of]

    def _sink(self, p: Array) -> Complex:
        """The motion's velocity along z, over the mean speed: a mean wind that is wrong is a wrong share of the pitch
        in it, and of the climb in the angle of attack."""
        return np.asarray(self._spectra["sink"] + p[WIND] * self._spectra["pitch"])

    def _incidences(self, p: Array) -> Array:
        """Of the wing, and of the tail beyond the table's derivatives, (2, n), rad."""
        s = self._spectra
        motion, sink = self._back(s["motion"] + p[WIND] * s["climb"]), self._back(self._sink(p))
        lift_motion, lift_gust, upwash_motion, upwash_gust = self._responses_of

        def arrived(gust: Complex, distance: float) -> Array:
            return sink + self._back(gust * self._after(distance, p))

        met = arrived(self._gust(p)[0], p[ARRIVAL] - self._quarter) / self._air_edge - motion
        upwash = respond_throughout(upwash_motion, self._chords, motion)
        upwash += respond_throughout(upwash_gust, self._chords, met)
        wing_share = p[UPWASH] * self._wing_share
        flow = (self._back(s["vane"]) - wing_share * upwash) / (1 + p[UPWASH] - wing_share)
        turned = 2 * self._arm / self._chord * self._back(s["q"])
        gust = np.fft.rfft(_closed(flow * self._air_ahead - sink + turned))
        met = arrived(gust, p[ARRIVAL] - self._edge) / self._air_edge - motion
        wing = respond_throughout(lift_motion, self._chords, motion) + respond_throughout(lift_gust, self._chords, met)
        tail = arrived(gust, p[ARRIVAL] + self._late) / self._air_tail
        # The table's rate derivative holds the steady tail; its downwash is late, which q alone does not hold.
        steady = 2 * self._tail / self._chord * self._back(s["rate"])
        washed = self._back(np.fft.rfft(_closed(wing)) * self._after(self._washed, p))
        return np.array([wing, tail - self._downwash * (washed + steady)])

    def _responses(self, p: Array) -> Complex:
        """Of both incidences to vane, motion and rate, (2, 3, m)."""
        lift_motion, lift_gust, _, _ = self._frequency_responses(p)
        _, shares = self._gust(p)
        wing_gust = lift_gust * self._after(p[ARRIVAL] - self._edge, p)
        late = self._downwash * self._after(self._washed, p)
        tail_gust = self._after(p[ARRIVAL] + self._late, p) - late * wing_gust
        responses = np.array([wing_gust * shares, tail_gust * shares])
        responses[0, 1] += lift_motion
        responses[1, 1] += 1 - late * lift_motion
        responses[1, 2] -= 2 * self._tail / self._chord * self._downwash
        return responses

    def columns(self, p: Array) -> tuple[Complex, Complex]:
        """Lines of the incidences, (2, lines), and of their responses, (2, 3, lines)."""
        lines = np.array([self._lines.of(x) for x in self._incidences(p)])
        return lines, self._responses(p)[:, :, self._at]

    def residual(
        self, names: Sequence[Equation], columns: tuple[Complex, Complex], slopes: Array
    ) -> tuple[Complex, Complex]:
        """What the model leaves of each equation, (equations, lines), and what each source of noise puts there,
        (equations, sources, lines)."""
        (wing, tail), responses = columns
        residuals, noises = [], []
        for name, (by_wing, by_rate, by_elevator) in zip(names, slopes.reshape(len(names), 3), strict=True):
            known = self.tail[name]
            model = by_wing * wing + by_rate * self.rate + by_elevator * self.elevator + known * tail
            residuals.append(self.measured[name] - model)
            gains = np.zeros((6, responses.shape[2]), dtype=np.complex128)
            gains[:3] = -by_wing * responses[0] - known * responses[1]
            gains[2] -= by_rate
            gains[3] = -by_elevator
            gains[4 if name == "CL" else 5] = 1.0
            noises.append(np.einsum("cl,csl->sl", gains, self._noise))
        return np.array(residuals), np.array(noises)


def _deviation(x: Array) -> Array:
    return np.asarray(x - x.mean())


def _low_pass(jw: Complex) -> Array:
    """The same gentle one on all: what lies above the band could only leak into it."""
    return np.asarray(np.exp(-0.5 * (np.abs(jw) / (2 * np.pi * LOW_PASS_HZ)) ** 2))


def _spectra(series: Mapping[str, Array], jw: Complex, lag: Complex, dt: float | None) -> dict[str, Complex]:
    """Of each series, (n,), what the vane did not measure with the vane's lag. `dt`: of the five-point slope that the
    angular acceleration in Cm was made with; None: it was measured."""
    made = {name: _low_pass(jw) * np.fft.rfft(_closed(x)) for name, x in series.items()}
    for name in made:
        if name not in ("vane", "flow"):
            made[name] = made[name] * lag
    if "Cm" in made and dt is not None:
        # What the slope takes from high frequencies.
        step = np.maximum(np.abs(jw) * dt, 1e-9)
        made["Cm"] *= np.where(step < 1.0, differentiate_factor(step), 1.0)
    return made


def _lines(n: int, dt: float) -> tuple[_Lines, NDArray[np.int64]]:
    """Lines of the band of a record of n samples, and where in a transform of twice the length they are."""
    keep = slice(round(EDGES_S[0] / dt), n - round(EDGES_S[1] / dt))
    frequencies: Array = np.asarray(np.fft.rfftfreq(keep.stop - keep.start, dt), dtype=np.float64)
    bins = np.flatnonzero((frequencies >= BAND[0]) & (frequencies <= BAND[1]))
    return _Lines(bins, keep), np.clip(np.round(frequencies[bins] * 2 * n * dt).astype(np.int64), 0, n)


def _along(motion: Mapping[str, Array], path: InertialPath, aircraft: Aircraft) -> float:
    """Mean coefficient of the aerodynamic force (and unmeasured thrust) along the flight path, forward."""
    force = np.asarray(motion["dynamic_pressure"]) * aircraft.geometry.wing_area
    forward = motion.get("ax")
    if forward is None or not np.isfinite(forward).all():
        return 0.0
    thrust = motion.get("thrust")
    push = thrust if thrust is not None and np.isfinite(thrust).all() else np.zeros_like(force)
    mass = aircraft.inertia.mass
    cx, cz = force_coefficients((mass * forward, mass * motion["az"]), (push, aircraft.thrust_angle), force)
    drag = lift_and_drag(cx, cz, np.sin(path.alpha), np.cos(path.alpha))[1]
    return -float(np.mean(drag))


def _closed(x: Array) -> Array:
    """A series of n continued to 2n so that it ends where it begins, without jump or kink there."""
    n = len(x)
    bridge = np.linspace(0.0, 1.0, n + 2)[1:-1]
    back = x[::-1]
    fade = 0.5 - 0.5 * np.cos(np.pi * bridge)
    return np.concatenate([x, (2 * x[-1] - back) * (1 - fade) + (2 * x[0] - back) * fade])
