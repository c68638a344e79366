"""Pressures of a probe's ports to flow angles, dynamic pressure and airspeed, and back for emulated devices.

What lies beyond the calibration is left out, never extrapolated. Airspeed is sqrt(2 q / rho), the density that of the
stream's static pressure and temperature: 0.4 % high at Mach 0.17, 0.8 % at Mach 0.25, where the calibration's q is the
impact pressure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from station.conventions import GAS_CONSTANT, from_si, to_si
from station.profile import PAIRS, PROBE, Probe, StreamProfile, own_ratio

_EMULATED_PRESSURE: Final = 1000.0
"""Dynamic pressure of an emulated probe of which the rig maps none, Pa: ratios do not depend on it."""
_BEYOND: Final = 0.1
"""Share of the calibrated range by which the emulated probe goes beyond it where the flow does."""
_TURNS: Final = 20
"""Steps of Newton's method; from the last message's ratios, two or three are enough."""
_CLOSE: Final = 1e-9
"""rad; far below a pressure transducer's last bit."""


class ProbeReader:
    """Ports to what the stream's signals name, in their units."""

    def __init__(self, stream: StreamProfile) -> None:
        assert stream.probe is not None
        self._probe = stream.probe
        self._ports = {port: (c.field, c.converter()) for port, c in stream.probe.ports.items()}
        self._units = {c.field: c.unit for c in stream.signals.values() if c.field.startswith(PROBE)}
        air = [stream.signals.get(n) for n in ("static_pressure", "air_temperature")]
        self._air = [(c.field, c.converter()) for c in air if c is not None] if all(air) else []
        self._told: set[str] = set()

    def read(self, fields: Mapping[str, float]) -> tuple[dict[str, float], list[str]]:
        """The message's fields with those that the probe makes of them, NaN where they cannot be told; why, the first
        time."""
        ratios, reference = ratios_of(self._probe, self._pressures(fields))
        why = self._unusable(ratios, reference)
        made = dict.fromkeys(("alpha", "beta", "dynamic_pressure", "airspeed"), math.nan)
        a, b = (ratios.get(name, 0.0) for name in ("alpha", "beta"))
        for name, curve in self._probe.curves.items():
            own = own_ratio(name)
            if not why.keys() & {"reference", *curve.over(own)}:
                made[name] = curve.at(ratios.get(own, 0.0), a, b)
        made["dynamic_pressure"] *= reference
        made["airspeed"] = self._airspeed(made["dynamic_pressure"], fields)
        shown = {f: from_si(made[f.removeprefix(PROBE)], unit) for f, unit in self._units.items()}
        news = [words for key, words in why.items() if words and key not in self._told]
        self._told |= {key for key, words in why.items() if words}
        return {**fields, **shown}, news

    def _pressures(self, fields: Mapping[str, float]) -> dict[str, float]:
        return {port: convert(fields.get(field, math.nan)) for port, (field, convert) in self._ports.items()}

    def _unusable(self, ratios: Mapping[str, float], reference: float) -> dict[str, str]:
        """Why the reference pressure or a ratio is not to be used; "" where a pressure is simply not there."""
        if not math.isfinite(reference):
            return {"reference": "" if math.isnan(reference) else "a pressure is beyond what its field can carry"}
        if reference < self._probe.least:
            words = f"the reference pressure is {reference:.3g} Pa, below {self._probe.least:.3g} Pa"
            return {"reference": f"{words}: flow angles are left out meanwhile"}
        found = {}
        for name, (low, high) in self._probe.ratios.items():
            ratio = ratios[name]
            if math.isnan(ratio):
                found[name] = ""
            elif not low <= ratio <= high:
                words = f"the {name} ratio is {ratio:+.3g}, calibrated from {low:+.3g} to {high:+.3g}"
                found[name] = f"{words}: what it gives is left out meanwhile"
        return found

    def _airspeed(self, q: float, fields: Mapping[str, float]) -> float:
        if not self._air:
            return math.nan
        pressure, temperature = (convert(fields.get(field, math.nan)) for field, convert in self._air)
        if not (pressure > 0 and temperature > 0 and q >= 0):
            return math.nan
        return math.sqrt(2 * q * GAS_CONSTANT * temperature / pressure)


def ratios_of(probe: Probe, p: Mapping[str, float]) -> tuple[dict[str, float], float]:
    """The ratios of alpha and beta that the ports give, and the reference pressure, Pa; NaN where there is none."""
    if "reference" in p:
        reference = p["reference"]
    else:
        reference = p["centre"] - sum(p[port] for port in probe.ring) / len(probe.ring)
    ratios = {}
    for name, (one, other, difference) in PAIRS.items():
        if difference in p:
            step = p[difference]
        elif one in p and other in p:
            step = p[other] - p[one]
        else:
            continue
        ratios[name] = step / reference if reference else math.nan
    return ratios, reference


class ProbePressures:
    """The inverse: what the ports of an emulated probe show. Beyond the calibration it shows somewhat more than its
    end, which no station takes."""

    def __init__(self, stream: StreamProfile) -> None:
        assert stream.probe is not None
        self._probe = stream.probe
        self._units = {c.field: c.unit for c in stream.signals.values() if c.field.startswith(PROBE)}
        self._curves = [(n, c) for n, c in self._probe.curves.items() if n in PAIRS and PROBE + n in self._units]
        self._ends = {}
        for name, (low, high) in self._probe.ratios.items():
            more = _BEYOND * (high - low)
            self._ends[name] = (low - more, high + more)
        self._last = {n: min(max(0.0, low), high) for n, (low, high) in self._ends.items()}

    def fields_of(self, fields: Mapping[str, float]) -> dict[str, float]:
        """A message's fields with the ports in place of what is made of them."""
        given = {f.removeprefix(PROBE): to_si(fields.get(f, math.nan), unit) for f, unit in self._units.items()}
        kept = {f: value for f, value in fields.items() if not f.startswith(PROBE)}
        return {**kept, **self._ports(given)}

    def _ports(self, given: Mapping[str, float]) -> dict[str, float]:
        ratios = self._ratios(given)
        q = given.get("dynamic_pressure", _EMULATED_PRESSURE)
        curve, (a, b) = self._probe.dynamic_pressure, (ratios.get(n, 0.0) for n in PAIRS)
        reference = q if curve is None else q / curve.at(a, a, b)
        ring = q - reference
        p = {"reference": reference, "centre": q}
        for (one, other, difference), ratio in zip(PAIRS.values(), (a, b), strict=True):
            step = ratio * reference
            p |= {one: ring - step / 2, other: ring + step / 2, difference: step}
        return {channel.field: channel.from_si(p[port]) for port, channel in self._probe.ports.items()}

    def _ratios(self, given: Mapping[str, float]) -> dict[str, float]:
        """At which the curves give the angles: Newton's method, held within the ends."""
        if any(math.isnan(given[name]) for name, _ in self._curves):
            return dict.fromkeys(self._ends, math.nan)
        at = dict(self._last)
        for _ in range(_TURNS):
            missing = self._missing(at, given)
            if all(abs(x) < _CLOSE for x in missing.values()):
                break
            for name, step in self._step(at, missing, given).items():
                low, high = self._ends[name]
                at[name] = min(max(at[name] + step, low), high)
        self._last = at
        return at

    def _missing(self, at: Mapping[str, float], given: Mapping[str, float]) -> dict[str, float]:
        a, b = (at.get(name, 0.0) for name in PAIRS)
        return {name: given[name] - curve.at(at.get(name, 0.0), a, b) for name, curve in self._curves}

    def _step(
        self, at: Mapping[str, float], missing: Mapping[str, float], given: Mapping[str, float]
    ) -> dict[str, float]:
        """The next one; each angle by its own ratio alone where the other's is not to be found."""
        slopes = {}
        for ratio in missing:
            low, high = self._ends[ratio]
            small = 1e-6 * (high - low)
            there = self._missing({**at, ratio: at[ratio] + small}, given)
            slopes[ratio] = {name: (missing[name] - there[name]) / small for name in missing}
        if missing.keys() != PAIRS.keys():
            return {n: x / slopes[n][n] if slopes[n][n] else 0.0 for n, x in missing.items()}
        (aa, ba), (ab, bb) = ((slopes[r]["alpha"], slopes[r]["beta"]) for r in PAIRS)
        both = aa * bb - ab * ba
        if both == 0:
            return dict.fromkeys(missing, 0.0)
        x, y = missing["alpha"], missing["beta"]
        return {"alpha": (bb * x - ab * y) / both, "beta": (aa * y - ba * x) / both}
