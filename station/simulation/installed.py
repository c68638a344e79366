"""A flight as the instruments of an aircraft's profile show it: the errors that a diagnosis wrote there.

    shown = gain * lagged(true + cubic true^3, latency earlier) + bias + drift

A negative latency or lag shows what comes: the flight is then flown a little ahead. The sensor of a surface with
backlash is on its drive. The drift is the rig's; its noise, quantisation and gaps come after.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from station.conventions import ANGLES_THAT_WRAP, SIGNALS
from station.profile import Aircraft, AlteredAircraft, Change, Instrument, Order
from station.rows import ProfileError
from station.simulation.declared_signals import EmulatedSignals
from station.simulation.engine_setting import engine_setting
from station.simulation.motion import DT
from station.simulation.sensors import Late, Walk, lagged, number_of

Array = NDArray[np.float64]

DRIVES: Final = {"elevator": "elevator_drive"}
"""Surfaces whose backlash is flown, and the signal on the other side of it."""


class Source(Protocol):
    """What flies: rows at 200 Hz."""

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Fly these, too, `start` in seconds of flight; none to fly what was asked no more."""
        ...

    def advance(self, n: int) -> Mapping[str, Array]:
        """The next n rows, (n,) each."""
        ...


class _Stage:
    """The errors of one signal, fed pieces of it."""

    def __init__(self, name: str, errors: Instrument, ahead: int) -> None:
        self._errors = errors
        self._wraps = name in ANGLES_THAT_WRAP
        self._late = Late(max(0.0, errors.latency + ahead * DT), DT)
        # The slope of a negative lag is the one over two steps, known one step late.
        self._before: Array | None = None
        self._state: Array | None = None

    def feed(self, values: Array, now: Mapping[str, Array] = {}) -> Array:
        """`now`: gain, bias and cubic part of each of the values, where they change."""
        e = self._errors
        gain, bias, cubic = now.get("gain", e.gain), now.get("bias", e.bias), now.get("cubic", e.cubic)
        if e.cubic or "cubic" in now:
            values = values + cubic * values**3
        if self._wraps:
            values = np.unwrap(values if self._before is None else np.concatenate((self._before[-1:], values)))
            values = values if self._before is None else values[1:]
        if self._before is None:
            self._before = np.full(2, values[0])
        line = np.concatenate((self._before, values))
        self._before = line[-2:]
        if e.lag > 0:
            if self._state is None:
                self._state = np.array([values[0], values[0]])
            values = lagged(np.ascontiguousarray(values), self._state, DT / e.lag)
        elif e.lag < 0:
            values = line[1:-1] - e.lag * (line[2:] - line[:-2]) / (2 * DT)
        out = gain * self._late.feed(values) + bias
        return np.remainder(out + math.pi, 2 * math.pi) - math.pi if self._wraps else out


class Installed:
    """A source of flights seen through the instruments of the aircraft's profile.

    `advance` gives what they show; `truth` the true rows of the last `advance`. Without errors both are the same.
    """

    def __init__(
        self,
        source: Source,
        aircraft: Aircraft,
        drifts: Mapping[str, float] = {},
        seed: int = 0,
        truth: Mapping[str, Change] = {},
        declared: EmulatedSignals | None = None,
    ) -> None:
        """`drifts`: random walk of each signal's zero, standard deviation after a second, SI; it depends on the `seed`
        and the signal only. `truth`: a card's; `declared`: what the rig declares. Raises ProfileError for an error that
        cannot be flown."""
        self._altered = AlteredAircraft(aircraft, truth)
        self._static = aircraft.static_position
        changing = {key.split(".")[1] for key in self._altered.keys if key.startswith("instruments.")}
        errors = {n: e for n, e in aircraft.instruments.items() if e != Instrument() or n in changing}
        errors |= {n: Instrument() for n in changing - errors.keys()}
        for name, e in errors.items():
            if e.backlash and name not in DRIVES:
                known = ", ".join(DRIVES)
                raise ProfileError(f"aircraft {aircraft.name}: instruments.{name}.backlash: flown of {known} only")
        self._source = source
        self._engine = aircraft.engine
        self._has_second = aircraft.second_vane is not None
        # One step of the time ahead goes into the slope of a negative lag.
        earliest = max((-e.latency + (DT if e.lag < 0 else 0.0) for e in errors.values()), default=0.0)
        self._ahead = max(0, math.ceil(earliest / DT - 1e-9))
        self._stages = {
            n: _Stage(n, e.model_copy(update={"latency": e.latency - (DT if e.lag < 0 else 0.0)}), self._ahead)
            for n, e in errors.items()
        }
        self._walks = {
            n: Walk(drift, DT, np.random.default_rng([seed, number_of(n), 3])) for n, drift in drifts.items() if drift
        }
        self._declared = declared
        self._kept: dict[str, Array] = {}
        self._given = self._fed = 0
        self.truth: Mapping[str, Array] = {}

    @property
    def ahead_s(self) -> float:
        """How far ahead of what is shown it flies, s: for instruments that show what comes."""
        return self._ahead * DT

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Fly these, too, `start` in seconds of flight; none to fly what was asked no more."""
        self._source.ask(manoeuvres)

    def advance(self, n: int) -> Mapping[str, Array]:
        """The next n rows as shown: SIGNALS that the source has, and what the rig declares."""
        flown = dict(self._source.advance(n + (self._ahead if not self._kept else 0)))
        if not self._has_second:
            flown.pop("alpha_vane_2", None)
        if self._engine is not None:
            name, setting = engine_setting(self._engine, *(flown[x] for x in ("thrust", "airspeed", "altitude")))
            flown[name] = setting
        rows = {name: np.concatenate((self._kept.get(name, values[:0]), values)) for name, values in flown.items()}
        ready = max(0, len(next(iter(rows.values()))) - self._ahead)
        shown = {name: values[:ready] for name, values in rows.items() if name in SIGNALS}
        for name, stage in self._stages.items():
            seen = flown.get(DRIVES.get(name, name))
            if name in shown and seen is not None:
                made = stage.feed(seen, self._now(name, len(seen)))
                shown[name] = made[len(made) - ready :]
        self.truth = {name: values[:ready] for name, values in rows.items()}
        times = np.arange(self._given, self._given + ready, dtype=np.float64) * DT
        self._of_aircraft(shown, times)
        if self._declared is not None:
            shown |= self._declared.rows(self.truth)
        for name, walk in self._walks.items():
            if name in shown:
                shown[name] = shown[name] + walk.next(ready)
        self.truth |= {key: self._altered.number(key, times) for key in self._altered.keys}
        self._given += ready
        self._fed += len(next(iter(flown.values())))
        self._kept = {name: values[ready:] for name, values in rows.items()}
        return shown

    def _of_aircraft(self, shown: dict[str, Array], times: Array) -> None:
        """What the aircraft does to its instruments: the air at the static port, and fuel that is burnt."""
        static = self._altered.number("static_position", times) if "static_position" in self._altered.keys else None
        error = self._static if static is None else static
        if np.any(error) and {"static_pressure", "dynamic_pressure"} <= self.truth.keys():
            shown["static_pressure"] = shown["static_pressure"] + error * self.truth["dynamic_pressure"]
        if "inertia.mass" in self._altered.keys and "fuel_flow" not in shown:
            burnt = self._altered.number("inertia.mass", times) - self._altered.number("inertia.mass", times + DT)
            shown["fuel_flow"] = np.maximum(burnt / DT, 0.0)

    def _now(self, name: str, n: int) -> dict[str, Array]:
        """Errors of the signal that change, for the next n rows of the flight."""
        times = np.arange(self._fed, self._fed + n, dtype=np.float64) * DT
        keys = {key.rpartition(".")[2]: key for key in self._altered.keys if key.startswith(f"instruments.{name}.")}
        return {field: self._altered.number(key, times) for field, key in keys.items()}
