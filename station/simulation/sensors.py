"""From true values to what a channel reports: lag, latency, gain, bias, noise, quantisation, in that order."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX, to_si
from station.profile import Instrument, Rig
from station.simulation.boom import lag


@dataclass(frozen=True, slots=True)
class Sensor:
    """One channel, in the signal's SI unit and seconds."""

    noise: float = 0.0
    """Standard deviation, white from sample to sample."""
    bias: float = 0.0
    gain: float = 1.0
    quantum: float = 0.0
    """Step of the reported value; 0 for none."""
    lag: float = 0.0
    """Time constant."""
    latency: float = 0.0
    """How old a value is when reported."""


STANDARD: Final[Mapping[str, Sensor]] = MappingProxyType(
    {
        "alpha_vane": Sensor(to_si(0.05, "deg")),
        "beta_vane": Sensor(to_si(0.05, "deg")),
        "airspeed": Sensor(to_si(0.3, "ft/s")),
        "dynamic_pressure": Sensor(to_si(0.12, "psf")),
        "p": Sensor(to_si(0.03, "deg/s")),
        "q": Sensor(to_si(0.03, "deg/s")),
        "r": Sensor(to_si(0.03, "deg/s")),
        "ax": Sensor(to_si(0.002, "g")),
        "ay": Sensor(to_si(0.002, "g")),
        "az": Sensor(to_si(0.004, "g")),
        "phi": Sensor(to_si(0.03, "deg")),
        "theta": Sensor(to_si(0.03, "deg")),
        "psi": Sensor(to_si(0.03, "deg")),
        "v_north": Sensor(to_si(0.1, "ft/s")),
        "v_east": Sensor(to_si(0.1, "ft/s")),
        "v_down": Sensor(to_si(0.1, "ft/s")),
        "elevator": Sensor(to_si(0.02, "deg")),
    }
)
"""The noise of a good flight-test installation, used where no rig is given."""


def sensors_of(rig: Rig) -> dict[str, Sensor]:
    """The rig's channels as the aligned frame shows them: noisy; latency is taken out by the alignment."""
    return {name: Sensor(noise) for name, noise in rig.noise_si().items()}


def with_errors(sensors: Mapping[str, Sensor], errors: Mapping[str, Instrument]) -> dict[str, Sensor]:
    """The channels with what a diagnosis found wrong with them (a profile's instruments) but for play."""
    made = dict(sensors)
    for name, e in errors.items():
        if name in made:
            s = made[name]
            made[name] = replace(
                s, gain=s.gain * e.gain, bias=s.bias + e.bias, lag=s.lag + e.lag, latency=s.latency + e.latency
            )
    return made


@njit(cache=True)
def _lagged(values: NDArray[np.float64], state: NDArray[np.float64], steps: float) -> NDArray[np.float64]:
    """First-order lag of a piece of a series; state (2): output and input before it, changed in place."""
    out = np.empty_like(values)
    for k in range(values.shape[0]):
        state[0] = lag(state[0], state[1], values[k], steps)
        state[1] = values[k]
        out[k] = state[0]
    return out


class Channel:
    """One signal's sensor, fed pieces of the true series; the same seed gives the same bits however it is cut.

    Every `every`-th value is reported, counted from the first one fed. The noise depends on the seed and the signal
    only.
    """

    def __init__(self, name: str, sensor: Sensor, dt: float, every: int, seed: int) -> None:
        self._sensor = sensor
        self._dt = dt
        self._every = every
        self._fed = 0
        self._rng = np.random.default_rng([seed, 1 + SIGNAL_INDEX[name]])
        self._state: NDArray[np.float64] | None = None
        self._past: NDArray[np.float64] | None = None

    def measure(self, truth: NDArray[np.float64]) -> NDArray[np.float64]:
        """What is reported for the next true values (n,): about n/every values."""
        s = self._sensor
        values = truth
        if len(values) and s.lag > 0:
            if self._state is None:
                self._state = np.array([values[0], values[0]])
            values = _lagged(np.ascontiguousarray(values), self._state, self._dt / s.lag)
        if len(values) and s.latency > 0:
            whole = math.floor(s.latency / self._dt)
            part = s.latency / self._dt - whole
            if self._past is None:
                self._past = np.full(whole + 1, values[0])
            line = np.concatenate((self._past, values))
            n = len(values)
            values = (1 - part) * line[1 : n + 1] + part * line[:n]
            self._past = line[n:]
        picked = values[(-self._fed) % self._every :: self._every]
        self._fed += len(truth)
        out = s.gain * picked + s.bias
        if s.noise > 0:
            out += s.noise * self._rng.standard_normal(len(picked))
        if s.quantum > 0:
            out = s.quantum * np.round(out / s.quantum)
        return out
