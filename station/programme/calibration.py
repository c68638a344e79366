"""A calibration flight: air data, vane and zeros, pooled over the runs and speeds of its recordings.

Steady parts give position error, zeros and steady upwash with the wind solved along; manoeuvres the vane's lag and
place, and the upwash once more. The one has the other's place and upwash as what is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.model.air_data_calibration import PASCALS, PRIORS, Blocks, Place, Steady, solve
from station.model.inertial_path import inertial_path
from station.model.static_port import StaticPort, static_port
from station.model.vane_in_motion import InMotion, Stretch, vane_in_motion
from station.numerics.random_effects import NORMAL_95
from station.numerics.regression import NotIdentifiable
from station.profile import NO_BOOM, Aircraft
from station.programme.calibration_blocks import Calibrating, Opened, Recorded, Run, calibrating, opened
from station.rows import UsageError

Array = NDArray[np.float64]

AROUND_S: Final = 8.0
"""Before and after a manoeuvre that its vane is held against the motion, for the filters to settle and the answer to
die down."""
LONGEST_S: Final = 90.0
TOLD: Final = 0.7
"""Share of its prior's standard deviation from which a constant rests on the prior: half of what is known is."""
REVERSE: Final = math.radians(120.0)
"""Between the headings of steady runs, or turned through: below, wind and position error are one."""
SPEEDS: Final = 8.0
"""m/s between the slowest and the fastest run: below, the airspeed's slope is not told."""
ANGLES: Final = math.radians(2.0)
"""Of angle of attack between runs: below, the vane's zero is not told from its upwash."""
LEAST_UPWASH: Final = 1e-3
"""Least standard deviation of the wing's share, for a profile that says there is none: less than a turn shows."""
UPWASH_TOLD: Final = 0.05
"""Standard deviation of the upwash above which it is not: manoeuvres may tell it at one speed."""
LEAST_RUNS_S: Final = 120.0
"""Of steady runs: the mean of gusts that pass in ten seconds is known to a quarter of their own standard deviation."""
LEAST_BLOCKS: Final = 2
"""In a direction for it to count as flown."""
GUSTY: Final = 1.0
"""m/s: standard deviation of gusts over seconds in which no calibration is flown."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A calibrated constant, SI; `why` it is not told, or ""."""

    name: str
    key: str
    """Of the profile."""
    unit: str
    value: float
    sd: float
    before: float
    """By the profile."""
    why: str = ""

    @property
    def is_told(self) -> bool:
        return not self.why

    @property
    def ci95(self) -> tuple[float, float]:
        return self.value - NORMAL_95 * self.sd, self.value + NORMAL_95 * self.sd


@dataclass(frozen=True, slots=True)
class Calibration:
    """The result."""

    aircraft: Aircraft
    logs: tuple[Path, ...]
    flown: Calibrating
    steady: Steady
    motion: InMotion | None
    motion_why: str
    static: StaticPort | None
    """Where static pressure, temperature and altitude are recorded, and speeds flown that tell it."""
    constants: Mapping[str, Constant]
    remarks: tuple[str, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        return self.flown.runs

    @property
    def speeds(self) -> tuple[float, float]:
        """True airspeeds flown, lowest and highest, m/s."""
        v = self.steady.flow["speed"]
        return float(v.min()), float(v.max())

    @property
    def is_whole(self) -> bool:
        """Whether all that a calibration flight is flown for is told."""
        wanted = ("airspeed_error", "airspeed_slope", "vane_zero", "upwash", "vane_delay")
        return all(self.constants[n].is_told for n in wanted)


def calibrate(
    logs: Sequence[Path], aircraft: Aircraft, say: Callable[[str], None] = lambda _: None, read: Opened = opened
) -> Calibration:
    """`read` opens a recording. Raises LogError, and UsageError for recordings that nothing can be calibrated with."""
    if aircraft.boom is None:
        raise UsageError(f"aircraft {aircraft.name}: it has no boom: there is no vane to calibrate")
    say(f"  reading {len(logs)} recording{'s' if len(logs) > 1 else ''}")
    flown = calibrating(logs, aircraft, read)
    boom, known = aircraft.boom, aircraft.uncertainty
    place = Place(boom.vane_x, boom.vane_y, boom.vane_z, boom.upwash_wing)
    place_sd = known.vane_x * float(np.mean(flown.blocks.columns["airspeed"]))
    priors = {"theta_zero": known.theta_zero, "ax_zero": known.ax_zero, "az_zero": known.az_zero, "vane_x": place_sd,
              "upwash_wing": max(known.upwash_wing * abs(boom.upwash_wing), LEAST_UPWASH)}  # fmt: skip
    say(f"  {len(flown.blocks.time)} blocks of air data and attitude")
    steady = solve(flown.blocks, place, priors)
    motion, why = None, ""
    try:
        stretches = _stretches(flown, steady)
        motion = vane_in_motion(stretches, aircraft, place_sd)
        say(f"  {motion.seconds:.0f} s of manoeuvres")
        told = {n: (motion.value(n), motion.sd(n)) for n in ("vane_x", "upwash")}
        told["upwash_slope"] = _with_prior(motion.value("upwash_slope"), motion.sd("upwash_slope"))
        # Of slow motion, a vane's lag and its upwash look alike: what steady flight tells of the one is the other's.
        upwash = steady.value("upwash"), steady.sd("upwash")
        slope = (steady.value("upwash_slope"), steady.sd("upwash_slope")) if "upwash_slope" in steady.names else None
        steady = solve(flown.blocks, place, priors, told)
        motion = vane_in_motion(stretches, aircraft, place_sd, upwash, slope)
    except NotIdentifiable as error:
        why = str(error)
    constants = _constants(aircraft, flown, steady, motion, why)
    port, blocked = _static_port(flown, steady)
    constants |= _ports(aircraft, port, blocked, constants.get("pressure_scale"))
    remarks = (*flown.remarks, *_remarks(flown, steady, why))
    return Calibration(aircraft, tuple(logs), flown, steady, motion, why, port, constants, remarks)


def _with_prior(value: float, sd: float) -> tuple[float, float]:
    """What manoeuvres tell of the upwash's slope, with what was known before."""
    precision = sd**-2 + PRIORS["upwash_slope"] ** -2
    return value * sd**-2 / precision, precision**-0.5


def _static_port(flown: Calibrating, steady: Steady) -> tuple[StaticPort | None, str]:
    """Its error, or why there is none to tell."""
    c = flown.blocks.columns
    lacking = [n for n in ("static_pressure", "altitude", "air_temperature") if n not in c]
    if lacking:
        return None, f"not recorded: {', '.join(lacking)}"
    speed = _corrected(c["airspeed"], steady)
    pressure = 0.5 * flown.blocks.density * speed**2
    try:
        port = static_port(flown.blocks.time, c["static_pressure"], c["altitude"], c["air_temperature"], pressure)
    except NotIdentifiable as why:
        return None, str(why)
    # What the airspeed's own error makes of the dynamic pressure.
    share = 2 * math.hypot(steady.sd("airspeed_error") / steady.speed, steady.sd("airspeed_slope"))
    return replace(port, sd=math.hypot(port.sd, port.error * share)), ""


def _corrected(airspeed: Array, steady: Steady) -> Array:
    """Without the errors found."""
    beyond = airspeed - steady.speed - steady.value("airspeed_error")
    return np.asarray(steady.speed + beyond / (1 + steady.value("airspeed_slope")))


def _ports(aircraft: Aircraft, port: StaticPort | None, why: str, whole: Constant | None) -> dict[str, Constant]:
    """Static port and pitot apart: dynamic pressure is wrong by the pitot's error less the static port's."""
    value, sd = (port.error, port.sd) if port else (0.0, math.inf)
    made = {
        "static_position": Constant("static_position", "static_position", "1", value, sd, aircraft.static_position, why)
    }
    if whole is not None:
        words = f"{whole.key}, less the static port's"
        before = whole.before + aircraft.static_position
        both = whole.value + value, math.hypot(whole.sd, sd)
        made["pitot_position"] = Constant("pitot_position", words, "1", *both, before, why or whole.why)
    return made


def _stretches(flown: Calibrating, steady: Steady) -> list[Stretch]:
    """The manoeuvres, with the airspeed corrected."""
    found = []
    for recorded in flown.recordings:
        mine = [r for r in flown.runs if r.kind == "input" and r.log == recorded.path.name]
        for begin, end in _joined(mine):
            found += _stretch(recorded, flown.blocks, steady, begin - AROUND_S, min(end, begin + LONGEST_S) + AROUND_S)
    return found


def _joined(runs: Sequence[Run]) -> list[tuple[float, float]]:
    """Spans of manoeuvres less than AROUND_S apart as one."""
    spans: list[tuple[float, float]] = []
    for r in runs:
        if spans and r.start_s - spans[-1][1] < 2 * AROUND_S:
            spans[-1] = spans[-1][0], r.end_s
        else:
            spans.append((r.start_s, r.end_s))
    return spans


def _stretch(recorded: Recorded, blocks: Blocks, steady: Steady, begin: float, end: float) -> list[Stretch]:
    """One manoeuvre of a record, s of its time; none where a signal has a gap in it."""
    record = recorded.record
    rows = slice(*np.searchsorted(record.t_s, (begin, end)).tolist())
    motion = {n: x[rows] for n, x in record.motion.items()}
    needed = ("alpha_vane", "q", "theta", "airspeed", "elevator", "v_down", "az", "ax")
    if any(n not in motion or not np.isfinite(motion[n]).all() for n in needed) or not len(motion["q"]):
        return []
    v = _corrected(motion["airspeed"], steady)
    alpha = (motion["alpha_vane"] - steady.value("vane_zero")) / (1 + steady.value("upwash"))
    side = motion.get("beta_vane", np.zeros(len(v)))
    whole = motion | {"airspeed": v, "theta": motion["theta"] - steady.value("theta_zero")}
    try:
        path = inertial_path(whole, alpha, side if np.isfinite(side).all() else np.zeros(len(v)), record.dt)
    except NotIdentifiable:
        return []
    # Of static pressure and temperature: that of dynamic pressure over airspeed has the error that is looked for.
    density = np.interp(record.t_s[rows] + recorded.start_s, blocks.time, blocks.density)
    beyond = (0.5 * density * path.speed**2 - steady.pressure) / PASCALS
    beyond = beyond if np.isfinite(beyond).all() else np.zeros(len(v))
    return [Stretch(motion["alpha_vane"], path.alpha, motion["q"], path.speed, motion["elevator"], beyond, record.dt)]


def _constants(
    aircraft: Aircraft, flown: Calibrating, steady: Steady, motion: InMotion | None, why: str
) -> dict[str, Constant]:
    boom = aircraft.boom or NO_BOOM
    stated = aircraft.instruments
    gain, bias = (getattr(stated.get("airspeed"), k, d) for k, d in (("gain", 1.0), ("bias", 0.0)))
    before = {
        "airspeed_error": bias + (gain - 1) * steady.speed,
        "airspeed_slope": gain - 1,
        "pressure_scale": getattr(stated.get("dynamic_pressure"), "gain", 1.0) - 1,
        "vane_zero": boom.zero,
        "upwash": boom.upwash_body + boom.upwash_wing,
        "upwash_slope": boom.tip_load * (1 + boom.upwash_body + boom.upwash_wing),
        "vane_x": boom.vane_x,
        **{f"{n}_zero": getattr(stated.get(n), "bias", 0.0) for n in ("phi", "theta", "psi", "ax", "ay", "az")},
        "beta_zero": getattr(stated.get("beta_vane"), "bias", 0.0),
        "vane_delay": getattr(stated.get("alpha_vane"), "latency", 0.0),
    }
    keys = {"airspeed_error": "instruments.airspeed.bias", "airspeed_slope": "instruments.airspeed.gain",
            "pressure_scale": "instruments.dynamic_pressure.gain", "vane_zero": "boom.zero",
            "upwash": "boom.upwash_body", "upwash_slope": "boom.tip_load", "vane_x": "boom.vane_x",
            "beta_zero": "instruments.beta_vane.bias", "vane_delay": "instruments.alpha_vane.latency"}  # fmt: skip
    units = {"airspeed_error": "m/s", "vane_x": "m", "vane_delay": "s", "upwash_slope": "1/kPa",
             **dict.fromkeys(("airspeed_slope", "pressure_scale", "upwash"), "1"),
             **dict.fromkeys(("ax_zero", "ay_zero", "az_zero"), "m/s2")}  # fmt: skip
    reasons = _not_told(flown, steady)
    made = {}
    for name in (n for n in steady.names if n != "upwash_wing"):  # of itself nothing tells it
        key = keys.get(name, f"instruments.{name.removesuffix('_zero')}.bias")
        made[name] = Constant(
            name, key, units.get(name, "rad"), steady.value(name), steady.sd(name), before[name], reasons.get(name, "")
        )
    late = (motion.value("delay"), motion.sd("delay")) if motion else (before["vane_delay"], math.inf)
    made["vane_delay"] = Constant("vane_delay", keys["vane_delay"], "s", *late, before["vane_delay"], why)
    if motion is None:
        made["vane_x"] = replace(made["vane_x"], why=why)
    return made


def _not_told(flown: Calibrating, steady: Steady) -> dict[str, str]:
    """Why constants are not told, by name."""
    found: dict[str, str] = {}
    usable = flown.blocks
    if _turned(usable.columns["v_north"] - steady.wind[:, 0], usable.columns["v_east"] - steady.wind[:, 1]) < REVERSE:
        why = "flown on one heading: wind and position error cannot be told apart; fly reverse headings or a full turn"
        found |= dict.fromkeys(("airspeed_error", "airspeed_slope", "pressure_scale"), why)
    v, alpha = steady.flow["speed"], steady.flow["alpha"][usable.steady]
    if np.ptp(np.percentile(v, (2, 98))) < SPEEDS:
        found.setdefault(
            "airspeed_slope", f"flown at one speed ({v.mean():.0f} m/s): the error is known there, not its slope"
        )
    if len(alpha) and np.ptp(np.percentile(alpha, (2, 98))) < ANGLES and steady.sd("upwash") > UPWASH_TOLD:
        why = "flown at one angle of attack: the vane's zero and its upwash cannot be told apart; fly two speeds"
        found |= {"vane_zero": why, "upwash": why}
    for name in steady.names:
        prior = PRIORS[name]
        if name not in found and steady.sd(name) > TOLD * prior and name != "vane_x":
            found[name] = "rests on what was known before: the flight does not tell it"
    return found


def _turned(north: Array, east: Array) -> float:
    """The widest angle between two directions flown for ten seconds and more, rad."""
    way = np.arctan2(east, north)
    bins = np.histogram(np.remainder(way, 2 * math.pi), 36, (0, 2 * math.pi))[0] >= LEAST_BLOCKS
    at = np.flatnonzero(bins) * math.radians(10.0)
    if not len(at):
        return 0.0
    apart = np.abs(np.angle(np.exp(1j * (at[:, None] - at))))
    return float(apart.max())


def _remarks(flown: Calibrating, steady: Steady, why: str) -> list[str]:
    made = []
    along, up = (steady.noise[r] for r in ("airspeed", "alpha_vane"))
    gust = math.hypot(along[1], along[2]), math.hypot(up[1], up[2]) * steady.speed
    if max(gust) > GUSTY:
        made.append(
            f"gusty air: {gust[0]:.1f} m/s along and {gust[1]:.1f} m/s across the path; the errors hold it, calmer air "
            "would make them smaller"
        )
    if why:
        made.append(f"vane's lag and place: {why}")
    short = sum(r.end_s - r.start_s for r in flown.runs if r.kind == "steady")
    if short < LEAST_RUNS_S:
        made.append(f"only {short:.0f} s of steady runs: fly each for 30 s and more")
    return made
