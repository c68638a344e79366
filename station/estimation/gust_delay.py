"""How early the vane meets a gust, and its upwash, from the gusts themselves: never from lift against all of alpha.

The gust-only signal at the boom is what the vane shows beyond the motion; the lift (and moment) that it makes arrives
later. With y the vane (its own lag put on everything else), a the inertial angle of attack and S = x/V the lead,

    (1 + k_f) g(t) + k_w F_g{g at the wing} = y - (1 + k_f) (a - q x/V) - k_w F_m{a}        gust at the boom
    CL = CL_w (W{a} + K{g(t - S + c/4V)}) + a_h (a_t) + CL_q qhat + CL_de de + e            and Cm alike

with the indicial memories W, K, F_m, F_g and the tail (share a_h, arm, downwash) of the profile. Lead and upwash
k_u0 = k_f + k_w (their ratio is the profile's), slopes and the rest are fitted by maximum likelihood to the spectra of
e: each line weighs with the inverse of the noise that vane, inertial angle and sensors leave there, which is the
Hannan-Thomson (Knapp and Carter 1976) weight gamma^2/(|G|(1 - gamma^2)) for a delay, and the noise in the
regressors is in the likelihood, so it does not attenuate them. Everything is laid out over distance flown through the
mean air, where a frozen gust field, leads and memories are constant whatever the speed does.

Source: Hannan and Thomson 1973; Knapp and Carter 1976; Thomson 1982 (orthogonal tapers). SI, rad.
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
from scipy.signal.windows import dpss

from station.estimation.inertial_path import InertialPath
from station.estimation.regression import NotIdentifiable
from station.profile import Aircraft, Indicial

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Equation = Literal["CL", "Cm"]

BAND: Final = (0.15, 3.0)
"""Hz: below, the aircraft rides the gust; above, lift and vane see different parts of it."""
MIN_S: Final = 20.0
EDGE_S: Final = 2.0
"""Memories have died away so long after the record's ends."""
TIME_BANDWIDTH: Final = 2.5
TAPERS: Final = 4
ITERATIONS: Final = 40
GUST_ENERGY: Final = 4.0
"""Of the gust in the band over what the sensors' noise leaves there."""
SMOOTH_S: Final = 0.1
MODEL_S: Final = 0.002
"""What the linear model leaves in a delay."""
LEAD, UPWASH = 0, 1


@dataclass(frozen=True, slots=True)
class Lead:
    """How far ahead of the CG the vane meets a gust, by one equation or by both, and the vane's steady upwash."""

    equations: tuple[Equation, ...]
    delay_s: float
    delay_sd: float
    distance_m: float
    """Delay times the mean speed."""
    distance_sd: float
    upwash: float
    """k_u0: the vane reads 1 + k_u0 times the flow angle when steady."""
    upwash_sd: float
    slopes: Mapping[str, tuple[float, float]]
    """The other fitted numbers with their standard deviations."""
    excess: float
    """Mean square of the residual over what the sensors' noise explains; standard deviations hold its root."""


@dataclass(frozen=True, slots=True)
class GustDelay:
    """`joint` from lift and moment; `apart` by either alone. `agree`: whether the two ask for the same delay. If not,
    the cause is not the vane but how the tail or the wing's memory meets the gust."""

    joint: Lead
    apart: Mapping[Equation, Lead]
    agree: bool
    speed: float
    seconds: float
    band_hz: tuple[float, float] = BAND


@dataclass(frozen=True, slots=True)
class _Lines:
    """Tapered spectra of a series: (tapers, lines)."""

    tapers: Array
    bins: NDArray[np.int64]
    frequencies: Array
    keep: slice

    def of(self, series: Array) -> Complex:
        kept = np.diff(series[self.keep])
        kept = kept - kept.mean()
        return np.asarray(np.fft.rfft(self.tapers * kept, axis=1)[:, self.bins])


def response(indicial: Indicial | None, jw: Complex, metres_per_s: float, chord: float) -> Complex:
    """Frequency response of 1 - sum a exp(-b t), t in chords travelled, at jw (m,), rad/s."""
    out = np.ones_like(jw)
    if indicial is not None:
        for a, b in zip(indicial.a, indicial.b, strict=True):
            out -= a * jw / (jw + b * metres_per_s / chord)
    return out


def gust_delay(
    motion: Mapping[str, Array],
    path: InertialPath,
    measured: Mapping[Equation, Array],
    aircraft: Aircraft,
    noise: Mapping[str, float],
    dt: float,
) -> GustDelay:
    """The vane's lead over the CG and its upwash, from gusts with or without test inputs.

    `motion`: signals (n,) on a uniform grid at the CG, all finite: alpha_vane, q, airspeed, dynamic_pressure, elevator;
    `path` of the same rows; `measured`: CL and, with iyy known, Cm (n,); `noise`: standard deviations, SI. Raises
    NotIdentifiable for a record too short or without gusts, and an aircraft without a boom.
    """
    if aircraft.boom is None:
        raise NotIdentifiable("the aircraft profile has no boom")
    n = len(path.alpha)
    if n * dt < MIN_S:
        raise NotIdentifiable(f"{n * dt:.0f} s of record: a gust delay needs {MIN_S:g} s")
    model = _Model(motion, path, measured, aircraft, noise, dt)
    energy = model.gust_energy()
    if energy < GUST_ENERGY:
        raise NotIdentifiable(f"no gusts: {energy:.2g} times the sensors' noise between {BAND[0]:g} and {BAND[1]:g} Hz")
    both: tuple[Equation, ...] = ("CL", "Cm") if "Cm" in measured else ("CL",)
    apart: dict[Equation, Lead] = {name: model.fit((name,)) for name in both}
    joint = model.fit(both) if len(both) > 1 else apart["CL"]
    spread = math.hypot(*(lead.delay_sd for lead in apart.values()))
    delays = [lead.delay_s for lead in apart.values()]
    agree = max(delays) - min(delays) <= 3 * spread + MODEL_S
    return GustDelay(joint, apart, agree, model.speed, n * dt)


class _Model:
    """Regressors of both equations for a lead and an upwash, and the likelihood of their residuals."""

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
        air = gaussian_filter1d(motion["airspeed"], SMOOTH_S / 2 / dt, mode="nearest") / v
        chord = aircraft.geometry.chord

        # Angles times the speed they are taken over are vertical velocities, which the air carries along unchanged.
        def deviation(x: Array) -> Array:
            return np.asarray(x - x.mean())

        def laid_out(x: Array) -> Array:
            return np.asarray(CubicSpline(flown, x)(np.arange(n) * v * dt))

        series: dict[str, Array] = {
            "vane": deviation(motion["alpha_vane"]) * air,
            "motion": deviation(path.alpha) * path.speed / v,
            "q": deviation(motion["q"]) * chord / (2 * v),
            "de": deviation(motion["elevator"]) * air,
        }
        series |= {str(name): deviation(x) * air for name, x in measured.items()}
        # Twice the length, mirrored oddly, so that nothing jumps where the transform closes on itself.
        self._n = n
        self._size = 2 * n
        jw: Complex = np.asarray(2j * np.pi * np.fft.rfftfreq(self._size, dt), dtype=np.complex128)
        self._jw = jw
        # The same gentle low-pass on all: the highest frequencies would only alias into the differences.
        soft = np.exp(-0.5 * (np.abs(jw) / (2 * np.pi * 8.0)) ** 2)
        self._spectra = {name: soft * np.fft.rfft(_closed(laid_out(x))) for name, x in series.items()}
        omega = 2 * np.pi * boom.vane_frequency
        lag = 1 / (1 + 2 * boom.vane_damping * jw / omega + (jw / omega) ** 2)
        for name in self._spectra:
            if name != "vane":
                self._spectra[name] = self._spectra[name] * lag
        if "Cm" in self._spectra and not np.isfinite(motion.get("qdot", np.full(1, np.nan))).all():
            # What the five-point slope that the angular acceleration was made with takes from high frequencies.
            turn = np.maximum(np.abs(jw) * dt, 1e-9)
            self._spectra["Cm"] *= np.where(turn < 1.0, 10 * turn / (2 * np.sin(turn) + 4 * np.sin(2 * turn)), 1.0)
        reference = unsteady.reference_chord or chord
        is_lagging = unsteady.memory
        lift = (unsteady.lift_motion, unsteady.lift_gust) if is_lagging else (None, None)
        fits = (*lift, unsteady.upwash_motion, unsteady.upwash_gust)
        self._memories = tuple(response(fit, jw, v, reference) for fit in fits)
        total = boom.upwash_body + boom.upwash_wing
        self._wing_share = boom.upwash_wing / total if total else 0.0
        self._start = np.array([boom.vane_x, total])
        self._arm = boom.vane_x
        self._quarter = chord / 4
        # A wing with memory begins to feel a gust at its leading edge; one without takes it where the CG is.
        self._edge = self._quarter if is_lagging else 0.0
        self._chord = chord
        self._tail = (unsteady.tail_lift_slope, unsteady.downwash, unsteady.tail_arm) if is_lagging else (0.0, 0.0, 0.0)
        keep = slice(round(EDGE_S / dt), n - round(EDGE_S / dt))
        count = keep.stop - keep.start - 1
        frequencies: Array = np.asarray(np.fft.rfftfreq(count, dt), dtype=np.float64)
        step = round(2 * TIME_BANDWIDTH)
        bins = np.arange(step, len(frequencies), step)
        bins = bins[(frequencies[bins] >= BAND[0]) & (frequencies[bins] <= BAND[1])]
        self._lines = _Lines(np.asarray(dpss(count, TIME_BANDWIDTH, TAPERS)), bins, frequencies[bins], keep)
        # Where in the long transform the lines lie, for the noise.
        self._at = np.clip(np.round(frequencies[bins] * self._size * dt).astype(np.int64), 0, len(jw) - 1)
        self._difference = np.abs(np.exp(-jw[self._at] * dt) - 1) ** 2
        self._measured = {str(name): self._lines.of(self._back(self._spectra[name])) for name in measured}
        elevator = self._lines.of(self._back(self._spectra["de"]))
        floor = noise.get("elevator", 0.0) ** 2
        self._is_flown = float(np.mean(np.abs(elevator) ** 2 / self._difference)) > 10 * floor + 1e-16
        self._noise = self._variances(motion, aircraft, noise, v, np.abs(lag[self._at]) ** 2)

    def _variances(
        self,
        motion: Mapping[str, Array],
        aircraft: Aircraft,
        noise: Mapping[str, float],
        v: float,
        lag: Array,
    ) -> dict[str, Array]:
        """Of each source of noise at the lines, per sample before differencing, (lines,)."""
        pressure = float(np.mean(motion["dynamic_pressure"]))
        force = aircraft.inertia.mass / (pressure * aircraft.geometry.wing_area)
        share = noise.get("dynamic_pressure", 0.0) / pressure
        lift = float(np.mean(motion["az"])) * force
        omega = np.abs(self._jw[self._at])
        inertia = (aircraft.inertia.iyy or 0.0) / (pressure * aircraft.geometry.wing_area * self._chord)
        # The path's streams count below its blending band only.
        slow = np.exp(-((omega * 0.5) ** 2))
        angle = noise.get("theta", 0.0) ** 2 + (noise.get("v_down", 0.0) / v) ** 2
        one = np.ones(len(omega))
        return {
            "vane": one * noise.get("alpha_vane", 0.0) ** 2,
            "motion": lag * slow * angle,
            "q": lag * (noise.get("q", 0.0) * self._chord / (2 * v)) ** 2,
            "CL": lag * one * ((noise.get("az", 0.0) * force) ** 2 + (share * lift) ** 2),
            "Cm": lag * ((inertia * omega * noise.get("q", 0.0)) ** 2),
            "de": lag * one * noise.get("elevator", 0.0) ** 2,
        }

    def _back(self, spectrum: Complex) -> Array:
        return np.asarray(np.fft.irfft(spectrum, self._size)[: self._n])

    def gust_energy(self) -> float:
        """Of the gust at the boom in the band, over that of the noise it is made with."""
        gust = self._lines.of(self._back(self._gust(self._start)[0]))
        noise = (self._noise["vane"] + self._noise["motion"]) * self._difference
        return float(np.median(np.mean(np.abs(gust) ** 2, axis=0) / noise))

    def _gust(self, p: Array) -> tuple[Complex, Complex, Complex]:
        """Gust at the boom, and its transfer from the vane and from the inertial angle."""
        _, _, motion_upwash, gust_upwash = self._memories
        wing = p[UPWASH] * self._wing_share
        body = p[UPWASH] - wing
        back = np.exp(-self._jw * (p[LEAD] - self._quarter) / self.speed)
        whole = (1 + body) + wing * gust_upwash * back
        by_motion = ((1 + body) + wing * motion_upwash) / whole
        s = self._spectra
        rate = (1 + body) * 2 * self._arm / self._chord * s["q"] / whole
        return s["vane"] / whole - by_motion * s["motion"] + rate, 1 / whole, by_motion

    def _columns(self, p: Array) -> tuple[list[Complex], Complex, list[tuple[Complex, Complex]]]:
        """Wing incidence and tail incidence (transforms), the gust, and what vane and motion noise do to either."""
        lift_motion, lift_gust, _, _ = self._memories
        gust, from_vane, from_motion = self._gust(p)
        delay = np.exp(-self._jw * p[LEAD] / self.speed)
        wing_gust = lift_gust * np.exp(-self._jw * (p[LEAD] - self._edge) / self.speed)
        _, downwash, arm = self._tail
        late = np.exp(-self._jw * arm / self.speed)
        tail_motion, tail_gust = 1 - downwash * late * lift_motion, delay * late - downwash * late * wing_gust
        columns, noises = [], []
        for by_motion, by_gust in ((lift_motion, wing_gust), (tail_motion, tail_gust)):
            columns.append(by_motion * self._spectra["motion"] + by_gust * gust)
            noises.append(((by_gust * from_vane)[self._at], (by_motion - by_gust * from_motion)[self._at]))
        return columns, gust, noises

    def _regressors(self, p: Array, name: Equation) -> tuple[list[Complex], Complex, list[tuple[Complex, Complex]]]:
        """Lines of the fitted columns (wing slope, rate, elevator), of the known tail's part, and the noise."""
        (wing, tail), _, noises = self._columns(p)
        share, downwash, arm = self._tail
        ratio = arm / self._chord
        rate = self._spectra["q"]
        sign = share if name == "CL" else -share * ratio
        # The table's rate derivative holds the steady tail; its downwash is late, which q alone does not tell.
        known = sign * tail - (2 * sign * ratio * downwash) * rate
        lines = [self._lines.of(self._back(x)) for x in (wing, rate)]
        if self._is_flown:
            lines.append(self._lines.of(self._back(self._spectra["de"])))
        return lines, self._lines.of(self._back(known)), noises

    def fit(self, names: Sequence[Equation]) -> Lead:
        """Maximum likelihood of lead, upwash and each equation's slopes, by scoring."""
        p = self._start.copy()
        solved = {name: self._solve(p, name, None)[0] for name in names}
        for _ in range(ITERATIONS):
            information, score = np.zeros((2, 2)), np.zeros(2)
            parts = {name: self._terms(p, name, solved[name]) for name in names}
            for part in parts.values():
                information += part[0]
                score += part[1]
            step = np.linalg.solve(information + 1e-12 * np.eye(2), score)
            step = np.clip(step, -0.3 * np.array([abs(p[LEAD]) + 1.0, 0.3]), 0.3 * np.array([abs(p[LEAD]) + 1.0, 0.3]))
            p = p + step
            solved = {name: self._solve(p, name, solved[name])[0] for name in names}
            if np.all(np.abs(step) < 1e-5):
                break
        else:
            raise NotIdentifiable("lead and upwash did not settle: the gusts do not fit the profile's aircraft")
        lines = TAPERS * len(self._lines.frequencies)
        excess = sum(self._solve(p, name, solved[name])[2] for name in names) / (len(names) * lines)
        # Twice the likelihood's own variance: the rest is the linear model's, and so intervals cover (tests).
        covariance = np.linalg.inv(information) * max(excess, 1.0)
        delay_sd = math.sqrt(covariance[0, 0]) / self.speed
        slopes: dict[str, tuple[float, float]] = {}
        for name in names:
            errors = np.sqrt(np.diag(parts[name][2]) * max(excess, 1.0))
            labels = (f"{name}_wing", f"{name}_q", f"{name}_de")
            slopes |= {n: (float(x), float(e)) for n, x, e in zip(labels, solved[name], errors, strict=False)}
        return Lead(
            equations=tuple(names),
            delay_s=float(p[LEAD] / self.speed),
            delay_sd=delay_sd,
            distance_m=float(p[LEAD]),
            distance_sd=delay_sd * self.speed,
            upwash=float(p[UPWASH]),
            upwash_sd=math.sqrt(covariance[1, 1]),
            slopes=slopes,
            excess=float(excess),
        )

    def _variance(self, noises: list[tuple[Complex, Complex]], name: Equation, slopes: Array) -> Array:
        """Of the residual at the lines, differenced as it is."""
        share, _, arm = self._tail
        tail = share if name == "CL" else -share * arm / self._chord
        s = self._noise
        vane = slopes[0] * noises[0][0] + tail * noises[1][0]
        motion = slopes[0] * noises[0][1] + tail * noises[1][1]
        total = np.abs(vane) ** 2 * s["vane"] + np.abs(motion) ** 2 * s["motion"] + s[name]
        if self._is_flown:
            total = total + slopes[2] ** 2 * s["de"]
        return np.asarray(total * self._difference)

    def _solve(self, p: Array, name: Equation, near: Array | None) -> tuple[Array, Array, float]:
        """Slopes for a lead and an upwash: weighted least squares, less what the noise in the regressor would take."""
        columns, known, noises = self._regressors(p, name)
        target = self._measured[name] - known
        slopes = np.array([4.0 if name == "CL" else -1.0, 0.0, 0.0]) if near is None else near
        x = np.array(columns)
        share, _, arm = self._tail
        tail = share if name == "CL" else -share * arm / self._chord
        for _ in range(4):
            weight = 1 / self._variance(noises, name, slopes)
            normal = np.einsum("itl,jtl,l->ij", x.conj(), x, weight).real
            right = np.einsum("itl,tl,l->i", x.conj(), target, weight).real
            # Corrected score: E|noise in the wing's column|^2, and its product with the tail's.
            s, d = self._noise, self._difference * weight * TAPERS
            wing, late = noises
            own = np.sum(d * (np.abs(wing[0]) ** 2 * s["vane"] + np.abs(wing[1]) ** 2 * s["motion"]))
            cross = np.sum(
                d * ((wing[0].conj() * late[0]).real * s["vane"] + (wing[1].conj() * late[1]).real * s["motion"])
            )
            normal[0, 0] -= own
            right[0] += tail * cross
            if self._is_flown:
                normal[2, 2] -= np.sum(d * s["de"])
            slopes = np.zeros(3)
            slopes[: len(x)] = np.linalg.solve(normal, right)
        residual = target - np.einsum("i,itl->tl", slopes[: len(x)], x)
        weight = 1 / self._variance(noises, name, slopes)
        return slopes, residual, float(np.sum(np.abs(residual) ** 2 * weight))

    def _objective(self, p: Array, name: Equation, near: Array) -> float:
        """-2 log likelihood, slopes at their best; for the score, whose noise term keeps it unbiased."""
        slopes, _, cost = self._solve(p, name, near)
        _, _, noises = self._columns(p)
        return cost * 1.0 + TAPERS * float(np.sum(np.log(self._variance(noises, name, slopes))))

    def _terms(self, p: Array, name: Equation, near: Array) -> tuple[Array, Array, Array]:
        """Information on and score of lead and upwash, slopes taken out; covariance of the slopes."""
        steps = np.array([0.02, 0.005])
        slopes, _, _ = self._solve(p, name, near)
        columns, _, noises = self._regressors(p, name)
        weight = np.sqrt(1 / self._variance(noises, name, slopes))

        def modelled(at: Array) -> Complex:
            x, fixed, _ = self._regressors(at, name)
            return np.asarray(fixed + np.einsum("i,itl->tl", slopes[: len(x)], np.array(x)))

        jacobian, score = [], np.zeros(2)
        for i in range(2):
            up, down = p.copy(), p.copy()
            up[i] += steps[i]
            down[i] -= steps[i]
            jacobian.append(((modelled(up) - modelled(down)) / (2 * steps[i]) * weight).ravel())
            score[i] = -(self._objective(up, name, near) - self._objective(down, name, near)) / (4 * steps[i])
        jacobian += [(column * weight).ravel() for column in columns]
        j = np.array(jacobian)
        whole = (j.conj() @ j.T).real
        inner = np.linalg.inv(whole[2:, 2:])
        information = whole[:2, :2] - whole[:2, 2:] @ inner @ whole[2:, :2]
        return information, score, np.linalg.inv(whole)[2:, 2:]


def _closed(x: Array) -> Array:
    """A series of n continued to 2n so that it ends where it begins, without jump or kink there."""
    n = len(x)
    bridge = np.linspace(0.0, 1.0, n + 2)[1:-1]
    back = x[::-1]
    fade = 0.5 - 0.5 * np.cos(np.pi * bridge)
    return np.concatenate([x, (2 * x[-1] - back) * (1 - fade) + (2 * x[0] - back) * fade])
