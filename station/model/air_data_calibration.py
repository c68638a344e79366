"""Air data, vane and inertial zeros of flight in steady parts, with the wind solved along.

Of block means over a few seconds, GNSS velocity less wind is the velocity through the air; attitude turns it into body
axes, where it has a magnitude and two flow angles. Against these stand what is measured:

    airspeed          = V + error + slope (V - V0)                         position error, V0 the mean speed
    dynamic pressure  = (1 + scale) rho V^2/2
    alpha vane        = zero + (1 + k) (alpha - l) + k_wing l,   l = (q x - p y)/V          k: steady upwash
                        k = upwash + slope (dynamic pressure - its mean)                    a boom that bends
    beta vane         = zero + beta + (r x - p z)/V
    specific force    = zero + R' (dv/dt - g)

Attitude has zeros of its own. Over seconds lift balances weight and a pilot holds the airspeed: what the aircraft meets
stays, and its way through the mean air moves against the gusts. So gusts are errors of the motion's angles and speed,
not of readings, and readings are the regressors: the vane's row is divided by 1 + k, the airspeed's by 1 + slope; the
other way round, a vane's scale would be taken down by every slow gust. No pilot holds the airspeed against a gust that
passes in seconds, and it would take the airspeed's slope up: of that the run's mean reading is the instrument.

The wind is straight between knots and walks from one to the next. What is left of each row is a gust or noise: white,
and Gauss-Markov processes of a gust's and of a thermal's length in time, whose variances are the restricted maximum
likelihood's; generalised Gauss-Newton with them, and so the errors hold that residuals are correlated. SI, rad.

Sources: Haering 1990, NASA TM-104240 (air data by inertial velocity and wind); Gracey 1980, NASA RP-1046 (position
error); Klein and Morelli 2006, chapter 10; Patterson and Thompson 1971 (restricted likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from station.conventions import G0, ned_from_body
from station.numerics.gauss_markov import whitened

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

KNOT_S: Final = 60.0
"""Between two knots of the wind."""
WALKS: Final = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Standard deviations of a minute's change of either component of the wind, m/s, the likeliest of which is taken."""
USUAL_WALK: Final = 0.4
WALK_SPREAD: Final = math.log(3.0)
"""Prior of the walk: log-normal about the usual one, a factor of three one standard deviation."""
SHEAR: Final = 0.005
"""Change of the wind by height, 1/s: that of a well-mixed layer above its lowest 100 m, 0.5 m/s in 100 m."""
FIRST_WIND: Final = 30.0
"""Prior standard deviation of either component, m/s."""
LENGTHS_S: Final = np.array([8.0, 60.0])
"""Correlation times of what the rows leave: a gust of 500 m at 60 m/s, and air that rises for a minute."""
PRIORS: Final[Mapping[str, float]] = {
    "airspeed_error": 10.0, "airspeed_slope": 0.3, "pressure_scale": 0.5, "vane_zero": 0.2, "upwash": 0.5,
    "beta_zero": 0.1, "psi_zero": math.radians(10.0), "phi_zero": math.radians(0.5),
    "theta_zero": math.radians(0.1), "ax_zero": 0.03, "ay_zero": 0.05, "az_zero": 0.05, "vane_x": 0.6,
    "upwash_slope": 0.02, "upwash_wing": 0.03,
}  # fmt: skip
"""Standard deviations: far wider than what is looked for where a flight is to tell it; of the others those of a
profile, which its [uncertainty] replaces. That of the upwash's slope, 1/kPa, is an engineering estimate: a boom that
bends by 2 % of the flow angle for each kPa. The wing's share of the upwash (k_wing) meets no pitch rate: in a turn the
vane shows it, and nothing else does."""
PASCALS: Final = 1000.0
"""In a kPa."""
ROUNDS: Final = 3
"""Of Gauss-Newton: the rows are all but linear, the third changes nothing any more."""
NOISE_ROUNDS: Final = 3
"""Of the noise and of the wind's walk, each with the estimates before."""
LEAST_VARIANCE: Final = 1e-6
"""Of a part of the noise, as a share of the row's variance."""
_FIRST_NOISE: Final[Mapping[str, float]] = {
    "airspeed": 0.3, "dynamic_pressure": 15.0, "alpha_vane": 0.005, "beta_vane": 0.01, "ax": 0.02, "ay": 0.02,
    "az": 0.03,
}  # fmt: skip
"""Of each part, to begin with: light turbulence."""
ROWS: Final = ("airspeed", "dynamic_pressure", "alpha_vane", "beta_vane", "ax", "ay", "az")


@dataclass(frozen=True, slots=True)
class Blocks:
    """Block means (n,) of recordings one after the other. `columns`: signals of SIGNALS, and "v_north_dot",
    "v_east_dot" and "v_down_dot"; velocity over ground by the means of its size and of its track; "swept": standard
    deviation of the heading within the block; `density`, kg/m3."""

    time: Array
    """s, increasing; a day's recordings on one axis."""
    columns: Mapping[str, Array]
    density: Array
    steady: NDArray[np.bool_]
    """Whether vanes and accelerometers are held against the motion there: no test input is flown."""
    held: Array
    """Airspeed (n,) of the run that each block belongs to, as measured: without the gusts in the block's own."""


@dataclass(frozen=True, slots=True)
class Place:
    """Of the vanes, m ahead, right and below the CG, and the wing's share of the upwash there."""

    x: float
    y: float
    z: float
    upwash_wing: float


@dataclass(frozen=True, slots=True)
class Steady:
    """What the steady parts tell: estimates, their covariance, and the flow that they make."""

    names: tuple[str, ...]
    values: Array
    covariance: Array
    speed: float
    """V0, m/s."""
    pressure: float
    """Mean dynamic pressure, Pa, at which the upwash is that told; NaN without the air's density."""
    wind: Array
    """(n, 2) north and east, m/s."""
    wind_sd: Array
    walk: float
    flow: Mapping[str, Array]
    """"speed", "alpha", "beta" (n,) through the air."""
    left: Mapping[str, Array]
    """What is left of each row (n,); NaN where it was not used."""
    noise: Mapping[str, tuple[float, float, float]]
    """Standard deviations of a row's white, gust's and slow part."""

    def value(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def sd(self, name: str) -> float:
        return math.sqrt(max(float(self.covariance[self.names.index(name), self.names.index(name)]), 0.0))

    def error_at(self, speed: Array | float) -> tuple[Array, Array]:
        """Position error of the airspeed at true airspeeds, and its standard deviation, m/s."""
        i, j = self.names.index("airspeed_error"), self.names.index("airspeed_slope")
        off = np.asarray(speed, dtype=np.float64) - self.speed
        c = self.covariance
        variance = c[i, i] + 2 * off * c[i, j] + off**2 * c[j, j]
        return self.values[i] + self.values[j] * off, np.sqrt(np.maximum(variance, 0.0))


def _at_mean_heading(ground: Complex, wind: Complex, swept: Array) -> Complex:
    """Velocity over ground, north + i east, at a block's mean heading, by the means of its size and track in the block:
    in a turn these are not those of the mean heading, for the wind does not turn. To second order in `swept`."""
    air = ground - wind
    turned = [air * np.exp(side * 1j * swept) + wind for side in (1, -1)]
    longer = np.mean([np.abs(g) for g in turned], axis=0) / np.abs(ground) - 1.0
    aside = np.mean([np.angle(g / ground) for g in turned], axis=0)
    return np.asarray(ground * (1.0 - longer) * np.exp(-1j * aside))


def headed(air: Array, bank: Array, pitch: Array, side: Array) -> Array:
    """Heading (n,) at which a velocity through the air (n, 3), north, east and down, has a sideslip `side`; rad.

    Banked, the nose points off the path by the share of the angle of attack that lies in the horizon.
    """
    level = np.hypot(air[:, 0], air[:, 1])
    across = np.linalg.norm(air, axis=1) * np.sin(side) - np.sin(bank) * np.cos(pitch) * air[:, 2]
    by_pitch, by_bank = np.sin(bank) * np.sin(pitch), np.cos(bank)
    drift = np.arcsin(np.clip(across / (level * np.hypot(by_pitch, by_bank)), -1, 1)) - np.arctan2(by_pitch, by_bank)
    return np.asarray(np.arctan2(air[:, 1], air[:, 0]) - drift)


def solve(
    blocks: Blocks,
    place: Place,
    priors: Mapping[str, float] = {},
    known: Mapping[str, tuple[float, float]] = {},
) -> Steady:
    """From blocks with airspeed, attitude, GNSS velocity and the vane. `priors`: standard deviations in place of
    PRIORS; `known`: mean and standard deviation of what another part of the flight has told."""
    problem = _Problem(blocks, place, {**PRIORS, **priors}, known)
    x, walk = problem.start(), USUAL_WALK
    noise: dict[str, Array] = {r: np.array([s, s, s]) for r, s in _FIRST_NOISE.items()}
    for _ in range(NOISE_ROUNDS):
        x = problem.fitted(x, walk, noise)[1]
        noise = problem.noise_at(x, problem.precision(walk), noise)
        walk = max(WALKS, key=lambda w: problem.fitted(x, w, noise)[0])
    _, x, spread = problem.fitted(x, walk, noise)
    return problem.steady(x, spread, walk, noise)


class _Problem:
    """The rows, their parameters and priors."""

    def __init__(
        self, blocks: Blocks, place: Place, priors: Mapping[str, float], known: Mapping[str, tuple[float, float]]
    ) -> None:
        self.blocks, self.place = blocks, place
        c = blocks.columns
        self.has_heading = "psi" in c
        present = [r for r in ROWS if r in c and (r != "beta_vane" or self.has_heading)]
        self.rows = tuple(present)
        every = np.ones(len(blocks.time), dtype=bool)
        self.used = {r: every if r in ("airspeed", "dynamic_pressure") else blocks.steady for r in self.rows}
        needs = {"dynamic_pressure": "pressure_scale", "beta_vane": "beta_zero", "ay": "ay_zero"}
        lacking = {name for row, name in needs.items() if row not in self.rows}
        if not np.isfinite(blocks.density).all():
            lacking.add("upwash_slope")
        if not self.has_heading:
            lacking |= {"psi_zero", "beta_zero"}
        self.names = tuple(n for n in priors if n not in lacking)
        before = {"vane_x": place.x, "upwash_wing": place.upwash_wing}
        self.mean = np.array([known[n][0] if n in known else before.get(n, 0.0) for n in self.names])
        self.sd = np.array([known[n][1] if n in known else priors[n] for n in self.names])
        self.speed = float(np.mean(c["airspeed"]))
        self.pressure = float(np.mean(0.5 * blocks.density * c["airspeed"] ** 2))
        self._knots()

    def _knots(self) -> None:
        t, h = self.blocks.time, self.blocks.columns.get("altitude")
        count = max(2, math.ceil((t[-1] - t[0]) / KNOT_S) + 1)
        knots = np.linspace(t[0], t[-1], count)
        near = np.abs(t[:, None] - knots).min(axis=0) < KNOT_S
        self.knots = knots[near]
        self.weights = np.stack([np.interp(t, self.knots, row) for row in np.eye(len(self.knots))], axis=1)
        heights = np.zeros(len(self.knots)) if h is None else np.interp(self.knots, t, h)
        self._steps = np.diff(self.knots) / 60.0, np.diff(heights)

    def precision(self, walk: float) -> Array:
        """Of all parameters: the rows' own, then the wind's knots north and east."""
        n, m = len(self.names), len(self.knots)
        minutes, rise = self._steps
        move = np.diff(np.eye(m), axis=0) / np.sqrt(walk**2 * minutes + (SHEAR * rise) ** 2)[:, None]
        wind = move.T @ move
        wind[0, 0] += FIRST_WIND**-2
        made = np.zeros((n + 2 * m, n + 2 * m))
        made[:n, :n] = np.diag(self.sd**-2.0)
        made[n : n + m, n : n + m] = made[n + m :, n + m :] = wind
        return made

    def start(self) -> Array:
        return np.concatenate((self.mean, np.zeros(2 * len(self.knots))))

    def wind(self, x: Array) -> Array:
        n, m = len(self.names), len(self.knots)
        return np.stack([self.weights @ x[n : n + m], self.weights @ x[n + m :]], axis=1)

    def flow(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Speed and flow angles through the air (n,), and the turn from body axes (n, 3, 3)."""
        c, p = self.blocks.columns, dict(zip(self.names, x, strict=False))
        wind = self.wind(x)
        drift = wind[:, 0] + 1j * wind[:, 1]
        level = _at_mean_heading(c["v_north"] + 1j * c["v_east"], drift, c["swept"]) - drift
        air = np.stack([level.real, level.imag, c["v_down"]], axis=1)
        bank, pitch = c["phi"] - p["phi_zero"], c["theta"] - p["theta_zero"]
        if self.has_heading:
            heading = c["psi"] - p["psi_zero"]
        else:
            lever = (c["r"] * p["vane_x"] - c["p"] * self.place.z) / np.linalg.norm(air, axis=1)
            side = c["beta_vane"] - lever if "beta_vane" in c else np.zeros(len(wind))
            heading = headed(air, bank, pitch, side)
        turn = ned_from_body(bank, pitch, heading)
        body = np.einsum("nij,ni->nj", turn, air)
        speed = np.linalg.norm(body, axis=1)
        return speed, np.arctan2(body[:, 2], body[:, 0]), np.arcsin(np.clip(body[:, 1] / speed, -1, 1)), turn

    def residuals(self, x: Array) -> dict[str, Array]:
        """What is left of each row, (n,)."""
        c, p, place = self.blocks.columns, dict(zip(self.names, x, strict=False)), self.place
        v, alpha, beta, turn = self.flow(x)
        q, roll, yaw = c["q"], c["p"], c["r"]
        # Corrected readings less the motion's: what is left is a gust.
        scale = 1 + p["airspeed_slope"]
        true = self.speed + (c["airspeed"] - self.speed - p["airspeed_error"]) / scale
        upwash = p["upwash"]
        if "upwash_slope" in p:
            upwash = upwash + p["upwash_slope"] * (0.5 * self.blocks.density * true**2 - self.pressure) / PASCALS
        lever = (q * p["vane_x"] - roll * place.y) / v * (1 - p["upwash_wing"] / (1 + upwash))
        made = {
            "airspeed": true - v,
            "alpha_vane": (c["alpha_vane"] - p["vane_zero"]) / (1 + upwash) + lever - alpha,
        }
        if "dynamic_pressure" in self.rows:
            made["dynamic_pressure"] = c["dynamic_pressure"] - (1 + p["pressure_scale"]) * (
                0.5 * self.blocks.density * true**2
            )
        if "beta_vane" in self.rows:
            made["beta_vane"] = c["beta_vane"] - p["beta_zero"] - (yaw * p["vane_x"] - roll * place.z) / v - beta
        rate = np.stack([c["v_north_dot"], c["v_east_dot"], c["v_down_dot"] - G0], axis=1)
        force = np.einsum("nij,ni->nj", turn, rate)
        for i, name in enumerate(("ax", "ay", "az")):
            if name in self.rows:
                made[name] = c[name] - force[:, i] - p[f"{name}_zero"]
        return made

    def slopes(self, x: Array, at: Mapping[str, Array]) -> dict[str, Array]:
        """Of each row's residual by each parameter, (n, parameters); of the airspeed by its slope with the run's
        reading in place of the block's."""
        steps = np.concatenate((1e-3 * np.minimum(self.sd, 1.0), np.full(2 * len(self.knots), 1e-3)))
        made = {r: np.empty((len(self.blocks.time), len(x))) for r in self.rows}
        for i, step in enumerate(steps):
            moved = x.copy()
            moved[i] += step
            for r, e in self.residuals(moved).items():
                made[r][:, i] = (e - at[r]) / step
        p = dict(zip(self.names, x, strict=False))
        beyond = self.blocks.held - self.speed - p["airspeed_error"]
        made["airspeed"][:, self.names.index("airspeed_slope")] = -beyond / (1 + p["airspeed_slope"]) ** 2
        return made

    def noise_at(self, x: Array, precision: Array, before: Mapping[str, Array]) -> dict[str, Array]:
        """Standard deviations of each row's white, gust's and slow part."""
        e = self.residuals(x)
        slope = self.slopes(x, e)
        return {r: self._noise(r, e[r], slope[r], precision, before[r]) for r in self.rows}

    def fitted(self, x: Array, walk: float, noise: Mapping[str, Array]) -> tuple[float, Array, Array]:
        """Log evidence of a walk of the wind, the parameters with it, begun at `x`, and their covariance."""
        mean, precision = self.start(), self.precision(walk)
        for _ in range(ROUNDS):
            e = self.residuals(x)
            slope = self.slopes(x, e)
            information, score, misfit = precision.copy(), -precision @ (x - mean), 0.0
            for r in self.rows:
                used = self.used[r]
                white, _ = _whitened(self.blocks.time[used], np.column_stack((slope[r], e[r]))[used], noise[r])
                j, y = white[:, :-1], white[:, -1]
                information += j.T @ j
                score -= j.T @ y
                misfit += float(y @ y)
            step = np.linalg.solve(information, score)
            x = x + step
        evidence = -0.5 * misfit - 0.5 * float((x - mean) @ precision @ (x - mean))
        evidence += 0.5 * float(np.linalg.slogdet(precision)[1] - np.linalg.slogdet(information)[1])
        evidence -= 0.5 * (math.log(walk / USUAL_WALK) / WALK_SPREAD) ** 2
        return evidence, x, np.asarray(np.linalg.inv(information))

    def _noise(self, row: str, e: Array, slope: Array, precision: Array, before: Array) -> Array:
        """Standard deviations of the row's white, gust's and slow part, by restricted maximum likelihood."""
        used = self.used[row]
        t, y, j = self.blocks.time[used], e[used], slope[used]
        flat = y - j @ np.linalg.lstsq(np.vstack((j, 1e-6 * np.eye(j.shape[1]))), np.r_[y, np.zeros(j.shape[1])])[0]
        total = max(float(np.var(flat)), 1e-12)
        start, columns = 2 * np.log(before), np.column_stack((j, y))
        low = math.log(LEAST_VARIANCE * total)

        def cost(logs: Array) -> float:
            white, size = _whitened(t, columns, np.exp(0.5 * np.maximum(logs, low)))
            product = white.T @ white
            seen, drawn = precision + product[:-1, :-1], product[:-1, -1]
            fit = float(product[-1, -1] - drawn @ np.linalg.solve(seen, drawn))
            return 0.5 * (fit + size + float(np.linalg.slogdet(seen)[1]))

        found = minimize(cost, np.maximum(start, low), method="Nelder-Mead", options={"xatol": 0.1, "fatol": 0.05})
        return np.asarray(np.exp(0.5 * np.maximum(found.x, low)))

    def steady(self, x: Array, c: Array, walk: float, noise: Mapping[str, Array]) -> Steady:
        n, m = len(self.names), len(self.knots)
        speed, alpha, beta, _ = self.flow(x)
        e = self.residuals(x)
        blocks = (c[n : n + m, n : n + m], c[n + m :, n + m :])
        sd = np.stack([np.sqrt(np.einsum("nk,kl,nl->n", self.weights, b, self.weights)) for b in blocks], axis=1)
        return Steady(
            names=self.names,
            values=x[:n],
            covariance=c[:n, :n],
            speed=self.speed,
            pressure=self.pressure,
            wind=self.wind(x),
            wind_sd=sd,
            walk=walk,
            flow={"speed": speed, "alpha": alpha, "beta": beta},
            left={r: np.where(self.used[r], e[r], np.nan) for r in self.rows},
            noise={r: (float(s[0]), float(s[1]), float(s[2])) for r, s in noise.items()},
        )


def _whitened(time: Array, columns: Array, noise: Array) -> tuple[Array, float]:
    """Of a row's columns (n, m), with the standard deviations of its white, gust's and slow part."""
    return whitened(time, columns, noise[0], noise[1:], LENGTHS_S)
