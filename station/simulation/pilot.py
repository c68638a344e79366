"""The feedback that flies a card's surfaces: from what is measured, late and noisy, to what the actuator is asked for.

All the while, gusts too are answered: asked = trim + input + by_rate q + by_attitude (theta - trim) + by_height (h -
trim) - by_speed (V - wanted), of the instant `delay` ago, held for a tick. The noise of its sensors comes with the
input, weighted the same.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import G0, TICK_HZ
from station.profile import SIMULATION_HZ, Pilot
from station.simulation.sensors import STANDARD

Array = NDArray[np.float64]

RATE_HZ: Final = SIMULATION_HZ
"""Of the simulation's steps, where nothing from outside is in its loop."""
HEIGHT_NOISE: Final = 0.3
"""Standard deviation of the height that it measures, m: a barometric altimeter's, filtered."""
REMNANT_S: Final = 1 / 3
"""Time constant of a human's remnant, which falls off above 3 rad/s (Levison, Baron and Kleinman 1969)."""
_STREAM: Final = 4
"""Of the random numbers, beside those of the sensors."""


class Hands(NamedTuple):
    """What is asked of the surfaces, by the trim that is held."""

    by_rate: float
    """s"""
    by_attitude: float
    by_height: float
    """rad/m"""
    by_speed: float
    """rad/(m/s)"""
    by_roll: float
    """s, of the aileron,"""
    by_bank: float
    by_heading: float
    """of the bank,"""
    by_yaw: float
    """and of the rudder, s."""
    delay: int
    """Steps."""
    theta: float
    """Trim, rad."""
    height: float
    """Trim, m."""
    speed: float
    """Wanted true airspeed, m/s."""
    held: int
    """Steps that a command is held for: a tick."""
    catch_up: float
    """Share of the way to what is asked for that a hand makes in a step: 1 without a lag."""


def hands(pilot: Pilot, theta: float, height: float, speed: float, rate_hz: int = RATE_HZ) -> Hands:
    """`theta`, `height`, `speed`: what is held, rad, m and m/s; `rate_hz`: steps a second."""
    steps, held = round(pilot.delay * rate_hz), rate_hz // TICK_HZ
    gains = pilot.pitch_rate, pilot.attitude, pilot.altitude, pilot.speed
    across = pilot.roll_rate, pilot.bank, pilot.heading, pilot.yaw_rate
    catch_up = 1 - math.exp(-1 / (rate_hz * pilot.neuromuscular)) if pilot.neuromuscular else 1.0
    return Hands(*gains, *across, steps, theta, height, speed, held, catch_up)


def ring(h: Hands) -> Array:
    """What `asked` remembers: what is asked for now, of each of the last steps, and where the hand is; nothing yet."""
    return np.zeros(3 + h.delay)


def rings(h: Hands) -> Array:
    """What `asked_across` remembers, of aileron and rudder."""
    return np.zeros((2, 3 + h.delay))


@njit(cache=True, error_model="numpy", inline="always")
def asked(h: Hands, memory: Array, step: int, q: float, theta: float, height: float, speed: float) -> float:
    """What the elevator is asked for at a step beside trim and input, rad; `memory` as `ring` makes it."""
    n = memory.shape[0] - 2
    wanted = h.by_rate * q + h.by_attitude * (theta - h.theta) + h.by_height * (height - h.height)
    memory[1 + step % n] = wanted - h.by_speed * (speed - h.speed)
    if step % h.held == 0:
        memory[0] = memory[1 + (step + n - h.delay) % n]
    if h.catch_up == 1.0:
        return float(memory[0])
    memory[n + 1] += h.catch_up * (memory[0] - memory[n + 1])
    return float(memory[n + 1])


@njit(cache=True, error_model="numpy", inline="always")
def asked_across(
    h: Hands, memory: Array, step: int, p: float, r: float, bank: float, wanted: float
) -> tuple[float, float]:
    """What aileron and rudder are asked for at a step beside inputs, rad, of a bank of which so much is `wanted`;
    `memory` as `rings` makes it. A positive aileron rolls left, a positive rudder yaws left."""
    n = memory.shape[1] - 2
    memory[0, 1 + step % n] = h.by_roll * p + h.by_bank * (bank - wanted)
    memory[1, 1 + step % n] = h.by_yaw * (r - G0 * math.sin(bank) / h.speed)
    if step % h.held == 0:
        for i in range(2):
            memory[i, 0] = memory[i, 1 + (step + n - h.delay) % n]
    if h.catch_up == 1.0:
        return memory[0, 0], memory[1, 0]
    for i in range(2):
        memory[i, n + 1] += h.catch_up * (memory[i, 0] - memory[i, n + 1])
    return memory[0, n + 1], memory[1, n + 1]


def deviations_across(pilot: Pilot) -> tuple[float, float]:
    """As `deviation`, of aileron and rudder."""
    p, r, phi, psi = (STANDARD[name].noise for name in ("p", "r", "phi", "psi"))
    aileron = math.hypot(pilot.roll_rate * p, pilot.bank * phi, pilot.bank * pilot.heading * psi)
    return aileron, pilot.yaw_rate * r


def deviation(pilot: Pilot) -> float:
    """Standard deviation of what its sensors' noise asks of the elevator, rad."""
    q, theta, speed = (STANDARD[name].noise for name in ("q", "theta", "airspeed"))
    return math.hypot(pilot.pitch_rate * q, pilot.attitude * theta, pilot.altitude * HEIGHT_NOISE, pilot.speed * speed)


class Tremor:
    """What the noise of the feedback's sensors adds to the command, and a human's remnant, in pieces of the flight,
    held for a tick each."""

    def __init__(self, sd: float, seed: int, rate_hz: int = RATE_HZ, surface: int = 0, remnant: float = 0.0) -> None:
        """`sd` as `deviation` gives it; it depends on the flight's `seed` and the number of the surface only.
        `rate_hz`: steps a second; `remnant`: standard deviation, rad."""
        self._sd, self._remnant = sd, remnant
        self._human = np.random.default_rng([seed, 0, _STREAM, surface, 1])
        self._astray = remnant * float(self._human.standard_normal())
        self._held = rate_hz // TICK_HZ
        self._rng = np.random.default_rng([seed, 0, _STREAM, surface] if surface else [seed, 0, _STREAM])
        self._last = np.empty(0)

    def half_steps(self, ticks: int) -> Array:
        """Of the next `ticks`, at steps and half-steps: (2 ticks rate / TICK_HZ + 1,), the last of them the next
        piece's first."""
        drawn = self._rng.standard_normal(ticks + 1 - len(self._last)) if self._sd else np.zeros(ticks + 1)
        line = np.concatenate((self._last, drawn))[: ticks + 1]
        # A remnant that was drawn ahead stays the next piece's first.
        added = self._sd * line
        if self._remnant:
            added = added + self._strayed(ticks)
        self._last = line[-1:]
        return np.repeat(added, 2 * self._held)[: 2 * self._held * ticks + 1]

    def _strayed(self, ticks: int) -> Array:
        """The remnant of the next `ticks` and the one behind them: noise of the first order."""
        keeps = math.exp(-1 / (TICK_HZ * REMNANT_S))
        drawn = self._human.standard_normal(ticks) * self._remnant * math.sqrt(1 - keeps**2)
        line = np.empty(ticks + 1)
        line[0] = self._astray
        for i in range(ticks):
            line[i + 1] = keeps * line[i] + drawn[i]
        self._astray = float(line[-1])
        return line
