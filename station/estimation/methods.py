"""The estimator: the angle of attack and every live method of method_table.py, at every tick."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal

import numpy as np

from station.conventions import BRIDGED_S, LONGITUDINAL, LONGITUDINAL_BODY, SIGNALS, TICK_HZ, TICK_NS, to_si
from station.estimation import conditioning as cond
from station.estimation import lateral_derivatives as lateral
from station.estimation import tick
from station.estimation.acceptance import banked
from station.estimation.alpha import Seen
from station.estimation.conditioning import Array, Conditioner
from station.estimation.derivatives import Derivatives
from station.estimation.engine_thrust import EngineThrust
from station.estimation.equation_error import Sides
from station.estimation.inertial import Flow
from station.estimation.lateral_derivatives import Lateral
from station.estimation.method_table import LIVE, LIVE_LATERAL, MEASURED, METHODS
from station.estimation.physical_method import Physical
from station.estimation.published.cross_spectra import VaneSpectra
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.gusts_at_vane import Shown
from station.numerics.named_state import blank
from station.numerics.second_order import vane_lag
from station.numerics.turbulence import BOUND, Sharp, Turbulence, gust_sigma
from station.profile import Aircraft, Card
from station.profile.aircraft import NO_BOOM
from station.rows import AlphaEstimate, Frame, MethodEstimate, ParamEstimate, Quality, UsageError

GAP_TICKS: Final = round(BRIDGED_S * TICK_HZ)
"""Frames missing between two are bridged by interpolation up to here; after more, filters start anew."""
UNEXPLAINED: Final = to_si(0.15, "deg")
"""In calm air the vane must show what the motion predicts, to this rms beyond its noise over tick.UNEXPLAINED_S."""
HELD_TICKS: Final = 3
"""An angle of attack from a vane or pitch rate held longer is not valid."""
SEEN_HZ: Final = 15.0
"""Rate of a record in which the band of the turbulence, up to 7 Hz, can be seen."""
WAIT_TICKS: Final = 150
"""Without inertial data for so long after a start, the turbulence is judged by the vane alone."""
WARMED: Final = tuple(dict.fromkeys((*cond.INPUTS, *lateral.MEASURED)))
WARM_CARD: Final = {"warm_up": 0.0, "low": 0.5, "high": 5.5, "step": 1.0}
WARM_TICKS: Final = 300
"""Of the flight that compiles: on the grid of WARM_CARD, Hz, every method closes a segment of its transforms in it."""
LATE_S: Final = 0.025
"""A vane that shows gusts later than this after the CG has met them is told of."""
FRESH_TICKS: Final = 3
"""A sample is of the tick before, from q of three: all of them must have been measured at their own time."""
SETTLE_TICKS: Final = 25
"""After a start the delay lines are full."""


class Estimator:
    """Angle of attack and derivatives, one 50 Hz frame at a time.

    II, III and V use the calibrated vane; split and split+gust also attitude and velocity. IV needs `spectra`, measured
    on the flight before. `force` applies III, IV and V in calm air too. `axes`: CL (wind) or CZ (body).
    `forgetting_s`: time constant with which the past fades from the transforms; by default it does not, and
    `start_point` begins anew. `step` never raises; the same frames give the same bits.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        card: Card,
        imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        noise: Mapping[str, float] | None = None,
        methods: tuple[str, ...] = LIVE,
        *,
        axes: Literal["wind", "body"] = "wind",
        force: bool = False,
        forgetting_s: float = math.inf,
        spectra: VaneSpectra | None = None,
        recorded_hz: float = TICK_HZ,
    ) -> None:
        """`imu_position`: m from the CG, body axes, by the rig. `noise`: standard deviation of each signal, SI.
        `recorded_hz`: rate of a slower record, which the frames are interpolated from.

        Raises UsageError for a method that does not run live, or IV without `spectra`.
        """
        for name in methods:
            if name == MEASURED and spectra is None:
                raise UsageError("IV needs spectra of the vane, measured on a flight before")
            if name not in LIVE and name != MEASURED:
                raise UsageError(f"{name} is no live method: choose from {', '.join(LIVE)}")
        self._dt = dt = 1.0 / TICK_HZ
        given = {k: v for k, v in (noise or {}).items() if v > 0}
        # White noise of fewer samples is as strong in every line as more noise of all of them.
        coarse = math.sqrt(max(TICK_HZ / recorded_hz, 1.0))
        self._noise = {name: coarse * sd for name, sd in {**DEFAULT_NOISE, **given}.items()}
        self._methods = methods
        self._force = force
        names = self._names = LONGITUDINAL if axes == "wind" else LONGITUDINAL_BODY
        self._conditioner = Conditioner(given)
        self._engine = EngineThrust(aircraft) if aircraft.engine is not None else None
        place = aircraft.imu_at(imu_position)
        self._constants = tick.constants(aircraft, place, dt, card.high, "physical" in methods)
        self.filters = blank(tick.State)
        """What the filters know."""
        tick.restart(self.filters)
        boom = aircraft.boom or NO_BOOM
        self._boom, self._known = boom, aircraft.uncertainty
        self._zero_sd = (aircraft.calibrated and aircraft.calibrated.vane_zero_sd) or 0.0
        ticks = max(round(TICK_HZ / recorded_hz), 1)
        self._shown = Shown(boom.vane_frequency, boom.vane_damping, 1 / recorded_hz if recorded_hz < TICK_HZ else 0.0)
        sharp = Sharp(ticks, self._shown.sharpness(ticks * dt), self._shown.white)
        self._vane_noise = self._noise["alpha_vane"] / coarse
        sees = recorded_hz > SEEN_HZ
        noise_there = self._noise["alpha_vane"] if sees else self._vane_noise
        self._turbulence = Turbulence(dt, noise_there, sharp=sharp, sees_band=sees)
        self._vane_lag = vane_lag(boom.vane_frequency, boom.vane_damping)
        self._sides = Sides(aircraft, place, dt, axes == "body")
        simple = tuple(name for name in methods if name != "physical")
        self._derivatives = Derivatives(aircraft, card, self._noise, simple, names, dt, forgetting_s, spectra)
        self._physical = (
            Physical(aircraft, card, self._noise, names, dt, forgetting_s) if "physical" in methods else None
        )
        self._lateral = (
            Lateral(aircraft, card, place, self._noise, dt, forgetting_s)
            if card.asks_lateral and set(LIVE_LATERAL) & set(methods)
            else None
        )
        self._zero, self._scale, self._arm = boom.zero, boom.steady_calibration, boom.vane_x
        self._body = (aircraft.air_density if aircraft.air_density is not None else math.nan, aircraft.inertia.mass)
        self._before = np.zeros(len(cond.INPUTS))
        self._of_vane, self._of_motion = self.filters["vane"]["seen"], self.filters["inertial"]["flow"]
        self._wind_sd, self._unexplained = self.filters["wind_sd"], self.filters["unexplained"]
        self._is_held = self.filters["inertial"]["is_held"]
        self._signals = self.filters["signals"]["signals"][0, 0]
        """Of the tick before."""
        self._seen = Seen(*self._of_vane.item())
        self._flow = Flow(*self._of_motion.item())
        self._start_ns: int | None = None
        self._last_ns = 0
        self._running = False
        self._ticks = 0
        self._fresh_run = 0
        self._split_run = 0
        self._held_run = 0
        self._copy = (aircraft, card, imu_position, dict(noise or {}), methods, axes, force, forgetting_s, spectra)

    def warm_up(self) -> None:
        """Compile every kernel, so that no tick of a flight has to: six seconds of flight through a twin of this one,
        whose segments last one."""
        aircraft, card, position, noise, methods, axes, force, forgetting, spectra = self._copy
        twin = Estimator(
            aircraft,
            card.model_copy(update=WARM_CARD),
            position,
            noise,
            methods,
            axes=axes,
            force=force,
            forgetting_s=forgetting,
            spectra=spectra,
        )
        steady = {"airspeed": 50.0, "az": -9.81, "ax": 0.5, "v_north": 50.0, "dynamic_pressure": 1500.0}
        steady["mass"] = aircraft.inertia.mass
        for k in range(WARM_TICKS):
            # Every signal moves, each in its own way: one that stood still would be taken for frozen.
            moves = {name: 0.02 * math.sin(0.05 * (i + 2) * k) for i, name in enumerate(WARMED)}
            twin.step(_frame(k, {name: steady.get(name, 0.0) + move for name, move in moves.items()}))

    def start_point(self) -> None:
        """A test point begins: empty the transforms; the filters stay warm."""
        self._derivatives.clear()
        if self._physical:
            self._physical.clear()
        if self._lateral:
            self._lateral.clear()

    def sideslip(self) -> float:
        """The inertial one at the CG as of the last tick, rad; NaN where there is none."""
        return self._flow.beta if self._running and self._flow.is_ready else math.nan

    def statistical(self) -> dict[str, dict[str, float]]:
        """The standard errors of each method's longitudinal derivatives as of the last tick, had its model no error:
        how well the manoeuvre, flown again, would give the same."""
        made = self._derivatives.statistical()
        if self._physical and self._physical.solution:
            made["physical"] = self._physical.solution.stat[:6].tolist()
        return {method: dict(zip(self._names, errors, strict=True)) for method, errors in made.items()}

    def within_model(self) -> dict[str, float]:
        """The standard errors of `physical`'s derivatives as of the last tick, without those that every flight with the
        profile shares: of mass and inertia, and of its model in another's place. Empty where there are none."""
        errors = self._physical.within_model().tolist() if self._physical else []
        return dict(zip(self._names, errors, strict=False))

    def thrust(self) -> tuple[float, str]:
        """As of the last tick, N: recorded, else by the profile's engine; NaN where nothing tells it, and why."""
        known = float(self._conditioner.u[cond.THRUST])
        if math.isfinite(known):
            return known, ""
        return known, self._engine.why if self._engine is not None else "thrust is not recorded"

    def quasi_steady(self) -> dict[str, tuple[ParamEstimate, ...]]:
        """Quasi-steady derivatives as of the last tick, of the methods whose own are not."""
        return {"physical": self._physical.quasi_steady()} if self._physical else {}

    def preference(self) -> float | None:
        """How much better the model of `physical` fits than split+gust's quasi-steady one: their deviances' difference,
        positive where it does; None before there is one."""
        solution = self._physical.solution if self._physical else None
        return solution.preference if solution else None

    def step(self, frame: Frame) -> tuple[AlphaEstimate, tuple[MethodEstimate, ...]]:
        """One frame in, the angle of attack and every method's estimates as of it out."""
        code = self._conditioner.step(frame)
        u = self._conditioner.u
        if self._engine is not None and not math.isfinite(u[cond.THRUST]):
            u[cond.THRUST] = self._engine.step(frame)
        why = self._conditioner.why(code)
        usable = not cond.LOST <= code < cond.FROZEN
        ticks = round((frame.t_ns - self._last_ns) / TICK_NS)
        if self._running and -TICK_HZ < ticks <= 0:
            usable, why = False, "time did not advance"
        elif usable:
            self._advance_to(frame.t_ns, ticks, u, code == cond.FRESH)
        else:
            self._running = False
        self._held_run = self._held_run + 1 if code == cond.HELD else 0
        if 0 < self._held_run <= HELD_TICKS:
            why = ""
        lacking = self._derivatives.lacking = self._conditioner.lacking(code, self._body[0])
        alpha = self._alpha(frame.t_ns, u, usable, why)
        applicable = self._not_applicable()
        air = (self._mean_speed(), self._sides.density, self._wind_sd.item())
        self._derivatives.mass_recorded = mass_recorded = bool(u[cond.MASS] > 0.0)
        estimates = self._derivatives.estimate(frame.t_ns, air, applicable)
        if self._physical:
            self._physical.mass_recorded, self._physical.rival = mass_recorded, self._derivatives.quasi_steady
            self._physical.lacking = lacking or ("" if self._conditioner.has_attitude else "no attitude")
            estimates += (self._physical.estimate(frame.t_ns),)
        if self._lateral:
            estimates = self._with_lateral(self._lateral, frame, u, usable, estimates)
        return alpha, estimates

    def _with_lateral(
        self, side: Lateral, frame: Frame, u: Array, usable: bool, estimates: tuple[MethodEstimate, ...]
    ) -> tuple[MethodEstimate, ...]:
        if usable:
            since_start = (frame.t_ns - (self._start_ns or 0)) * 1e-9
            density, mass = self._body
            side.mass_recorded = bool(u[cond.MASS] > 0.0)
            mass = float(u[cond.MASS]) if side.mass_recorded else mass
            pressure = cond.dynamic_pressure(u, density)
            beta = self._flow.beta if self._flow.is_ready else math.nan
            side.add(frame, float(u[cond.AIRSPEED]), pressure, mass, beta, since_start)
        more = side.estimate()
        return tuple(
            MethodEstimate(e.t_ns, e.method, e.parameters + more.get(e.method, ()), e.applicable, e.why)
            for e in estimates
        )

    def _advance_to(self, t_ns: int, ticks: int, u: Array, is_fresh: bool) -> None:
        """Run the filters to `t_ns`, over missing frames if they are few."""
        if self._start_ns is None:
            self._start_ns = t_ns
        if not self._running or not 0 < ticks <= GAP_TICKS + 1:
            tick.restart(self.filters)
            self._sides.restart()
            self._running = True
            self._ticks = self._fresh_run = self._split_run = 0
        else:
            for j in range(1, ticks):
                between = self._before + (u - self._before) * (j / ticks)
                between[cond.ATTITUDE :] = math.nan
                self._advance(self._last_ns + j * TICK_NS, between, False)
        self._advance(t_ns, u, is_fresh)
        self._before[:] = u
        self._last_ns = t_ns

    def _advance(self, t_ns: int, u: Array, is_fresh: bool) -> None:
        start_ns = self._start_ns if self._start_ns is not None else t_ns
        t = (t_ns - start_ns) * 1e-9
        if self._physical:
            if (why := banked(float(u[cond.ATTITUDE]))) != self._physical.banked:
                self._physical.turn(why)
            self._is_held[0] = self._physical.is_open
        done = tick.advance(self._constants, self.filters, self._sides.arrays, t, u, self._conditioner.age)
        seen = self._seen = Seen(*self._of_vane.item())
        self._flow = Flow(*self._of_motion.item())
        speed = float(u[cond.AIRSPEED])
        if math.isfinite(seen.boom_gust):
            self._turbulence.step(seen.boom_gust, speed, True)
        elif self._ticks > WAIT_TICKS:
            self._turbulence.step(seen.steady, speed, False)
        self._fresh_run = self._fresh_run + 1 if is_fresh else 0
        self._ticks += 1
        if done & tick.MADE and self._fresh_run >= FRESH_TICKS and self._ticks > SETTLE_TICKS:
            self._derivatives.add(self._sides.out, t, self._split_run > 0)
            if self._physical and self._split_run > SETTLE_TICKS:
                wind_sd = self._wind_sd.item()
                density = self._sides.density
                self._physical.add(self._signals, self._sides.out[:4], t, self._flow.speed, density, wind_sd)
        self._split_run = self._split_run + 1 if done & tick.SPLIT else 0

    def _mean_speed(self) -> float:
        return self._seen.speed_mean if self._running else 0.0

    def _not_applicable(self) -> dict[str, str]:
        """For each live method that should not be applied now, why."""
        reasons: dict[str, str] = {}
        level = self._turbulence.name
        if level in ("calm", "unknown") and not self._force:
            why = "calm air: the delay would do harm" if level == "calm" else "turbulence not known yet"
            reasons = {name: why for name in self._methods if METHODS[name].turbulence_only}
        if not self._seen.is_ready:
            why = self._conditioner.degraded(False)
            reasons |= {name: why for name in self._methods if METHODS[name].is_split}
        elif level == "calm" and self._unexplained.item() > self._calm_limit():
            rms = math.degrees(math.sqrt(self._unexplained.item()))
            left = f"in calm air the motion leaves {rms:.2f} deg of the vane unexplained: check delay and calibration"
            why = self._conditioner.degraded(True) or left
            reasons |= {name: why for name in self._methods if METHODS[name].is_split}
        return reasons

    def _calm_limit(self) -> float:
        """Mean square that the vane may differ by from what the motion makes of it in calm air, rad2."""
        speed = self._mean_speed()
        noise = self._noise["alpha_vane"]
        gust = BOUND * gust_sigma(self._turbulence.level, speed, noise, self._dt) / max(speed, 1.0)
        return UNEXPLAINED**2 + noise**2 + gust**2

    def _gust_error(self, late_s: float, speed: float) -> float:
        """Standard deviation, rad, of what the vane's dynamics, and doubt of them and of when a gust arrives, leave in
        its angle, moved by its lag and `late_s` late."""
        known, gust = self._known, self._turbulence.gust
        if not math.isfinite(gust):
            return 0.0
        late_sd = math.hypot(known.vane_x, known.vane_delay)
        dynamics_sd = known.vane_frequency, known.vane_damping
        return self._shown.left(round(late_s, 3), late_sd, dynamics_sd) * gust / max(speed, 1.0)

    def _late(self, late_s: float) -> str:
        """A word on a vane that shows gusts much later than they are at the CG."""
        if not late_s > LATE_S or self._turbulence.name in ("calm", "unknown"):
            return ""
        return "gusts reach the vane too late for the angle of attack at the CG"

    def _alpha(self, t_ns: int, u: Array, usable: bool, why: str) -> AlphaEstimate:
        seen, flow = self._seen, self._flow
        level, name = self._turbulence.level, self._turbulence.name
        if not usable:
            nan = math.nan
            return AlphaEstimate(t_ns, *(nan,) * 11, level, name, nan, nan, nan, False, why)
        vane, speed = float(u[cond.VANE]), float(u[cond.AIRSPEED])
        zero = -self._zero
        upwash = (self._scale - 1.0) * (vane - self._zero)
        rate = seen.rate
        steady = vane + zero + upwash + rate
        noise, shown = self._noise, self._turbulence.noise_shown / max(speed, 1.0)
        # Of what the vane shows but for its rate, and the zero as a calibration flight found it.
        parts = [self._known.vane_scale * (steady - rate), self._scale * self._zero_sd, self._arm * noise["q"] / speed]
        if seen.is_ready:
            fast, gust = seen.fast, seen.gust
            alpha, lag, arrival = seen.split, fast - steady, seen.split - fast
            inertial, late = flow.alpha, seen.behind
            # Streams smoothed over half a second.
            parts += [0.2 * noise["theta"], 0.2 * noise["v_down"] / speed]
            stated = self._vane_noise / (1.0 + self._boom.upwash_body)
        else:
            alpha, lag, arrival, inertial, gust = steady, 0.0, 0.0, math.nan, math.nan
            late, stated = self._vane_lag - self._boom.gust_x / max(speed, 1.0), self._scale * self._vane_noise
        parts += [max(stated, shown) if shown == shown else stated, self._gust_error(late, speed)]
        return AlphaEstimate(
            t_ns=t_ns,
            alpha=alpha,
            alpha_sd=math.sqrt(sum(x * x for x in parts)),
            vane=vane,
            zero=zero,
            upwash=upwash,
            rate=rate,
            lag=lag,
            gust=arrival,
            alpha_inertial=inertial,
            alpha_gust=gust,
            gust_vertical=gust * speed,
            turbulence_level=level,
            turbulence=name,
            wind_north=flow.wind_north,
            wind_east=flow.wind_east,
            wind_down=flow.wind_down,
            valid=not why,
            why=why or self._conditioner.degraded(seen.is_ready) or self._late(seen.behind),
        )


def _frame(k: int, values: Mapping[str, float]) -> Frame:
    """A frame with these signals measured and no others."""
    row = tuple(values.get(name, math.nan) for name in SIGNALS)
    there = tuple(x == x for x in row)
    ages = tuple(0.0 if x else math.nan for x in there)
    return Frame(k * TICK_NS, k, row, ages, tuple(int(Quality.FRESH if x else Quality.MISSING) for x in there))
