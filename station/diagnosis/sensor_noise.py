"""How the noise of each sensor, and a gust at the vane, reach the residual series: responses in frequency.

The residual function itself is asked, on straight flight like the record's mean, with one sensor after the other
moved a little by a periodic signal: no second set of equations, no flights of a simulation. Noise enters several series
at once; those cross terms are half the matter (errors in variables: Pintelon and Schoukens 2012, System Identification,
chapter 8).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from station.diagnosis.air_data import STILL
from station.diagnosis.axis import LONGITUDINAL, Axis
from station.diagnosis.corrections import instrument_of, unlagged
from station.diagnosis.measured_record import Record
from station.diagnosis.memo import Memo
from station.diagnosis.processing import Setting
from station.diagnosis.residuals import LIFT, VANE
from station.profile import Aircraft, Instrument

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PERIOD_S: Final = 10.0
"""Of the periodic signal: its lines, 0.1 Hz apart, begin at the lowest frequency judged."""
STEP_S: Final = 0.1
"""Its time step: 10 Hz are enough for lines to 3.5 Hz."""
SMALL: Final = 1e-4
"""Its size, relative to 1 rad, 1 rad/s, or g and the speed: small enough to be linear, far above rounding."""


@dataclass(frozen=True, slots=True)
class Trim:
    """Straight flight as in a record's mean, one period of it for each of its sensors."""

    signals: dict[str, Array]
    """(n,)"""
    moved: dict[str, Array]
    """(sensors + 1, n): one moved after the other, the last row none."""
    setting: Setting
    sensors: tuple[str, ...]
    lines: NDArray[np.int64]
    frequencies: Array
    """Hz, of the lines."""
    given: Complex
    """(sensors, lines) transform of what each sensor was moved by."""
    axis: Axis
    memo: Memo = field(default_factory=Memo, repr=False)


def trim_of(record: Record, setting: Setting, axis: Axis = LONGITUDINAL) -> Trim:
    """About the mean of a record."""
    dt = max(STEP_S, record.dt)
    n = int(fft.next_fast_len(round(PERIOD_S / dt), real=True))
    f = fft.rfftfreq(n, dt)
    top = min(1.15 * setting.frequencies[-1] + f[1], 0.45 / dt)
    lines = np.flatnonzero((f > 0) & (f <= top))
    rng = np.random.default_rng(3)
    phases = np.exp(2j * np.pi * rng.random(len(lines)))
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[lines] = phases
    wave = fft.irfft(spectrum, n)
    wave *= SMALL / wave.std()
    sensors = tuple(s for s in axis.sensors if s in record.signals or s in axis.always)
    mean = {name: np.full(n, float(x.mean())) for name, x in record.signals.items()}
    mean.setdefault("thrust", np.full(n, setting.thrust))
    mean["q"] = np.zeros(n)
    for name in ("p", "r", "phi"):
        if name in mean:
            mean[name] = np.zeros(n)
    speed = float(mean["airspeed"][0])
    sizes = dict.fromkeys(("v_down", "v_along", "v_across", "airspeed", "pitot"), speed)
    sizes |= dict.fromkeys(("ax", "ay", "az"), 10.0)
    sizes["thrust"] = max(setting.thrust, 1.0)
    sizes["dynamic_pressure"] = float(mean["dynamic_pressure"][0])
    moved = {name: np.repeat(x[None], len(sensors) + 1, 0) for name, x in mean.items()}
    given = np.empty((len(sensors), len(lines)), dtype=complex)
    for k, name in enumerate(sensors):
        added = wave * sizes.get(name, 1.0)
        given[k] = fft.rfft(added)[lines]
        if axis.answers and name in axis.always:
            continue
        moved["airspeed" if name == "pitot" else name][k] += added
        if name == "pitot":
            moved["dynamic_pressure"][k] *= (moved["airspeed"][k] / mean["airspeed"]) ** 2
    own = replace(setting, dt=dt, n=n, bridge=0, held={})
    return Trim(mean, moved, own, sensors, lines, f[lines], given, axis)


def answering(trim: Trim, record: Record, aircraft: Aircraft) -> Trim:
    """The same with what gusts that nothing measures make of each signal, as `aircraft` answers and shows them."""
    assert trim.axis.answers is not None
    moved, n = dict(trim.moved), trim.setting.n
    spectrum, turned = np.zeros(n // 2 + 1, dtype=complex), 2j * np.pi * trim.frequencies
    for gust, answer in trim.axis.answers(record, aircraft, trim.frequencies).items():
        k = trim.sensors.index(gust)
        for name in answer.keys() & trim.signals.keys():
            own = instrument_of(aircraft, name) or Instrument()
            shown = own.gain * np.exp(-turned * own.latency) / unlagged(turned, own.lag)
            spectrum[trim.lines] = trim.given[k] * answer[name] * shown
            moved[name] = moved[name].copy()
            moved[name][k] += fft.irfft(spectrum, n)
    return replace(trim, moved=moved, memo=Memo())


def responses(trim: Trim, aircraft: Aircraft, bins: Array) -> Complex:
    """(bins, series judged, sensors + 1): what a sensor's noise makes of each series, at frequencies `bins` (Hz). The
    last is the gust's, rad of flow angle at the vane: it shows in the vane's series, and in lift and moment as far as
    these are not fed with what the vane shows (Setting.gust_share)."""
    rows = list(trim.setting.judged)
    fed = replace(trim.setting, gust_share=None)
    there = trim.axis.series_of(trim.moved, aircraft, fed, STILL, trim.memo)[..., rows, :]
    moved = there[..., :-1, :, :] - there[..., -1:, :, :]
    shown = fft.rfft(moved, axis=-1)[..., trim.lines] / trim.given[:, None, :]
    # Integrals fall with frequency: between the lines the products with it are the straighter.
    f = trim.frequencies
    out = np.empty((*there.shape[:-3], len(bins), len(rows), len(trim.sensors) + 1), dtype=complex)
    scaled = shown * f
    place = np.clip(np.searchsorted(f, bins) - 1, 0, len(f) - 2)
    share = (bins - f[place]) / (f[place + 1] - f[place])
    mixed = scaled[..., place] * (1 - share) + scaled[..., place + 1] * share
    out[..., :-1] = np.moveaxis(mixed / bins, -1, -3).swapaxes(-1, -2)
    out[..., -1] = 0.0
    if VANE in rows:
        # As the vane shows it, less what is taken out of the vane by the lift that the gust itself makes: were it 1, a
        # vane scaled down, or a boom that bends with the load, would seem to leave less of a gust to explain.
        vane, lift = rows.index(VANE), rows.index(LIFT)
        at = trim.sensors.index(trim.axis.heads[VANE])
        out[..., vane, -1] = out[..., vane, at]
        if trim.axis.load:
            load = trim.sensors.index(trim.axis.load)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a candidate far beyond any aircraft
                out[..., vane, -1] -= out[..., vane, load] * out[..., lift, at] / out[..., lift, load]
        if (told := trim.setting.gust_share) is not None:
            forces = slice(lift, None)
            answer = out[..., forces, at] / out[..., vane, None, at]
            out[..., forces, :] -= ((1 - told.at(bins))[:, None] * answer)[..., None] * out[..., None, vane, :]
    return out


def of_force(
    response: Complex, head: tuple[int, int], vane: tuple[int, int] | None, slopes: Complex | None = None
) -> Complex:
    """What the sensor of a force makes of it, of responses (..., series, sensors), (...): at the flow that is there,
    which a vane that the sensor's signal corrects (a boom that bends, a vane ahead of the CG) would show changed. Both
    places are (series, sensor). With `slopes` (p, ..., series, sensors) of the responses, those of this, (p, ...)."""

    def at(x: Complex, row: int, column: int) -> Complex:
        return x[..., row, column]

    here = at(response, *head) if slopes is None else at(slopes, *head)
    if vane is None:
        return here
    shown, felt = at(response, *vane), at(response, head[0], vane[1])
    share = at(response, vane[0], head[1]) / shown
    if slopes is None:
        return np.asarray(here - share * felt)
    moved = (at(slopes, vane[0], head[1]) - share * at(slopes, *vane)) / shown
    return np.asarray(here - share * at(slopes, head[0], vane[1]) - moved * felt)
