"""From true values to what a channel reports: lag, latency, gain, bias, noise, quantisation, dropout.

Drift comes before, in `instruments`: it is the same however fast a device samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final
from zlib import crc32

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX, to_si
from station.profile import Rig
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
    drift: float = 0.0
    """Random walk of the zero: standard deviation after a second."""
    dropout: float = 0.0
    """Share of the values that are lost (NaN)."""
    dropout_length: float = 0.0
    """Mean length of a gap; 0: each value is lost or not by itself."""
    stream: int = 0
    """Channels of one stream lose the same values."""


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
    """The rig's channels as the aligned frame shows them: noisy, drifting and with gaps; the alignment takes the
    latency out."""
    made = {}
    for number, stream in enumerate(s for device in rig.devices for s in device.streams):
        for name, channel in stream.signals.items():
            made[name] = Sensor(
                noise=channel.noise_si(),
                drift=channel.drift_si(),
                dropout=stream.dropout,
                dropout_length=stream.dropout_length,
                stream=number,
            )
    return made


def number_of(name: str) -> int:
    """Of a signal, for its own random numbers; of one that a rig declares, its name's."""
    return SIGNAL_INDEX[name] if name in SIGNAL_INDEX else crc32(name.encode())


@njit(cache=True)
def lagged(values: NDArray[np.float64], state: NDArray[np.float64], steps: float) -> NDArray[np.float64]:
    """First-order lag of a piece of a series; state (2): output and input before it, changed in place."""
    out = np.empty_like(values)
    for k in range(values.shape[0]):
        state[0] = lag(state[0], state[1], values[k], steps)
        state[1] = values[k]
        out[k] = state[0]
    return out


class Late:
    """A series as it was some time earlier, straight between its samples, fed in pieces; level before its begin."""

    def __init__(self, latency: float, dt: float) -> None:
        """`latency` (s) is not negative."""
        steps = latency / dt
        whole = math.floor(steps + 1e-9)
        self._part = max(0.0, steps - whole)
        self._whole = whole
        self._past: NDArray[np.float64] | None = None

    def feed(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) -> (n,)."""
        if not len(values):
            return values
        if self._past is None:
            self._past = np.full(self._whole + 1, values[0])
        line = np.concatenate((self._past, values))
        n = len(values)
        self._past = line[n:]
        if self._part == 0.0:
            return line[1 : n + 1]
        return (1 - self._part) * line[1 : n + 1] + self._part * line[:n]


class Walk:
    """Drift of a zero: a random walk from 0, a step a sample."""

    def __init__(self, drift: float, dt: float, rng: np.random.Generator) -> None:
        """`drift`: standard deviation after a second."""
        self._kick = drift * math.sqrt(dt)
        self._rng = rng
        self._at = 0.0

    def next(self, n: int) -> NDArray[np.float64]:
        """The next n values."""
        # Summed from where it stands, so that pieces give the same bits as the whole.
        line = np.cumsum(np.concatenate(([self._at], self._kick * self._rng.standard_normal(n))))
        self._at = float(line[-1])
        return line[:-1]


class Gaps:
    """Which samples are lost: each by itself, or in gaps of random length."""

    def __init__(self, share: float, length: float, rng: np.random.Generator) -> None:
        """`share` of the samples are lost, in gaps of `length` samples on average."""
        mean = max(length, 1.0 / (1.0 - share))
        self._ends = 1.0 / mean
        self._begins = share / ((1.0 - share) * mean)
        self._share = share
        self._rng = rng
        self._inside: bool | None = None

    def next(self, n: int) -> NDArray[np.bool_]:
        """Of the next n samples."""
        lost = np.zeros(n, dtype=np.bool_)
        for k, u in enumerate(self._rng.random(n).tolist()):
            if self._inside is None:
                self._inside = u < self._share
            else:
                self._inside = u >= self._ends if self._inside else u < self._begins
            lost[k] = self._inside
        return lost


class Channel:
    """One signal's sensor, fed pieces of the true series; the same seed gives the same bits however it is cut.

    Every `every`-th value is reported, counted from the first one fed. The noise depends on the seed and the signal
    only, the gaps on the seed and the stream.
    """

    def __init__(self, name: str, sensor: Sensor, dt: float, every: int, seed: int) -> None:
        self._sensor = sensor
        self._dt = dt
        self._every = every
        self._fed = 0
        self._rng = np.random.default_rng([seed, 1 + number_of(name)])
        gap = sensor.dropout_length / (dt * every)
        self._gaps = Gaps(sensor.dropout, gap, np.random.default_rng([seed, sensor.stream, 2]))
        self._late = Late(sensor.latency, dt)
        self._state: NDArray[np.float64] | None = None

    def measure(self, truth: NDArray[np.float64]) -> NDArray[np.float64]:
        """What is reported for the next true values (n,): about n/every values."""
        s = self._sensor
        values = truth
        if len(values) and s.lag > 0:
            if self._state is None:
                self._state = np.array([values[0], values[0]])
            values = lagged(np.ascontiguousarray(values), self._state, self._dt / s.lag)
        if s.latency > 0:
            values = self._late.feed(values)
        picked = values[(-self._fed) % self._every :: self._every]
        self._fed += len(truth)
        out = s.gain * picked + s.bias
        if s.noise > 0:
            out += s.noise * self._rng.standard_normal(len(picked))
        if s.quantum > 0:
            out = s.quantum * np.round(out / s.quantum)
        if s.dropout > 0:
            out[self._gaps.next(len(picked))] = np.nan
        return out
