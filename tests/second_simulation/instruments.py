"""What a recorder has of a flight: noise of several colours, zeros, lags, scales, a place for the accelerometer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tests.second_simulation.aircraft import DEG
from tests.second_simulation.motion import DT

Array = NDArray[np.float64]

LEVELS: Final = {
    "alpha_vane": 0.07 * DEG, "beta_vane": 0.07 * DEG, "airspeed": 0.15, "dynamic_pressure": 7.0,
    "p": 0.05 * DEG, "q": 0.05 * DEG, "r": 0.05 * DEG, "ax": 0.02, "ay": 0.02, "az": 0.04,
    "phi": 0.05 * DEG, "theta": 0.05 * DEG, "psi": 0.1 * DEG, "v_north": 0.05, "v_east": 0.05, "v_down": 0.05,
    "altitude": 0.3, "elevator": 0.03 * DEG, "aileron": 0.03 * DEG, "rudder": 0.03 * DEG, "thrust": 20.0,
}  # fmt: skip
"""Standard deviations at 50 Hz, before a flight's own factor."""
ZEROS: Final = {
    "alpha_vane": 0.4 * DEG, "beta_vane": 0.5 * DEG, "p": 0.1 * DEG, "q": 0.1 * DEG, "r": 0.1 * DEG, "ax": 0.04,
    "ay": 0.04, "az": 0.04, "phi": 0.2 * DEG, "theta": 0.2 * DEG, "elevator": 0.3 * DEG, "aileron": 0.3 * DEG,
    "rudder": 0.3 * DEG,
}  # fmt: skip
"""Standard deviations of what instruments show at nothing."""
COLOURS: Final = ("white", "flicker", "drifting", "quantised", "outliers", "slow")


def coloured(rng: np.random.Generator, colour: str, level: float, true: Array, rate: float) -> Array:
    """`true` as an instrument of that noise shows it; `level`: its standard deviation."""
    n = len(true)
    white = rng.standard_normal(n)
    if colour == "flicker":  # half of it white, half with a spectrum of 1/f
        lines = np.fft.rfft(rng.standard_normal(n))
        f = np.fft.rfftfreq(n, 1 / rate)
        lines[1:] /= np.sqrt(f[1:])
        lines[0] = 0.0
        pink = np.fft.irfft(lines, n)
        return np.asarray(true + level * math.sqrt(0.5) * (white + pink / pink.std()))
    if colour == "drifting":  # white, and a random walk that is as large after 20 s
        walk = np.cumsum(rng.standard_normal(n)) / math.sqrt(20 * rate)
        return np.asarray(true + level * (white + walk))
    if colour == "quantised":  # steps of three of its standard deviations, and a little noise below
        step = 3 * level
        return np.asarray(step * np.round((true + 0.3 * level * white) / step))
    if colour == "outliers":  # one in two hundred is ten times as far off
        return np.asarray(true + level * white * np.where(rng.random(n) < 0.005, 10.0, 1.0))
    if colour == "slow":  # a filter of 0.1 s
        e = math.exp(-1 / (0.1 * rate))
        return np.asarray(true + level * signal.lfilter([math.sqrt(1 - e * e)], [1, -e], white))
    return np.asarray(true + level * white)


def later(y: Array, seconds: float) -> Array:
    t = np.arange(len(y)) * DT
    return np.interp(t - seconds, t, y)


def lagging(y: Array, seconds: float) -> Array:
    """Of the first order, exact of what goes straight from one value to the next."""
    e = math.exp(-DT / seconds)
    straight = seconds / DT * (1 - e)
    return np.asarray(signal.lfilter([1 - straight, straight - e], [1, -e], y - y[0]) + y[0])


def sticking(y: Array, breakaway: float) -> Array:
    """Stays where it is until the flow is that far off, and then jumps to it."""
    out, stays = np.empty_like(y), y[0]
    for i, now in enumerate(y):
        if abs(now - stays) > breakaway:
            stays = now
        out[i] = stays
    return out


def damaged(true: dict[str, Array], hidden: Mapping[str, float]) -> dict[str, Array]:
    """Signals at every DT with what is wrong with instruments in them, by the ids of HIDDEN; SI."""
    y = dict(true)
    # Where the accelerometer is from the CG, which may itself have moved aft.
    if x := hidden.get("accelerometer.position", 0.0) + hidden.get("cg.shift", 0.0):
        y["ax"] = y["ax"] - x * (y["q"] ** 2 + y["r"] ** 2)
        y["ay"] = y["ay"] + x * (y["rdot"] + y["p"] * y["q"])
        y["az"] = y["az"] - x * (y["qdot"] - y["p"] * y["r"])
    groups = {
        "accelerometer": ("ax", "ay", "az"), "imu": ("p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az"),
        "velocity": ("v_north", "v_east", "v_down"), "dynamic_pressure": ("dynamic_pressure", "airspeed"),
    }  # fmt: skip
    for name, x in hidden.items():
        target, _, kind = name.partition(".")
        members = groups.get(target, (target,))
        if kind not in ("delay", "lag", "scale", "bias", "stiction", "nonlinearity"):
            continue
        if members[0] not in y:
            continue
        if kind == "bias" and target == "accelerometer":
            members = ("az",)
        for m in members:
            if kind == "delay":
                y[m] = later(y[m], x)
            elif kind == "lag":
                y[m] = lagging(y[m], x)
            elif kind == "scale":
                y[m] = y[m] * (math.sqrt(1 + x) if m == "airspeed" else 1 + x)
            elif kind == "bias":
                y[m] = y[m] + x
            elif kind == "stiction":
                y[m] = sticking(y[m], x)
            else:
                y[m] = y[m] * (1 + x * (y[m] / (10 * DEG)) ** 2)
    return y


def recorded(
    true: dict[str, Array],
    hidden: Mapping[str, float],
    rate: float,
    factor: float,
    zeros: Mapping[str, float],
    rng: np.random.Generator,
    start: float = 0.0,
) -> tuple[Array, dict[str, Array], dict[str, str]]:
    """Time and signals at `rate` from `start` (s) on, and the colour of each signal's noise, `factor` times LEVELS at
    any rate."""
    shown = damaged(true, hidden)
    n = len(true["q"])
    t = np.arange(start, (n - 1) * DT, 1 / rate)
    fine = np.arange(n) * DT
    out, colours = {}, {}
    for name, level in LEVELS.items():
        colours[name] = str(rng.choice(COLOURS, p=(0.35, 0.15, 0.15, 0.15, 0.1, 0.1)))
        y = np.interp(t, fine, shown[name]) + zeros.get(name, 0.0)
        out[name] = coloured(rng, colours[name], factor * level, y, rate)
    return t, out, colours
