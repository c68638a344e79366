"""A record ready to be compared with any candidate: residuals, and what noise, gusts and model errors make of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from station.conventions import to_si
from station.diagnosis.air_data import share_of
from station.diagnosis.axis import LONGITUDINAL, Axis
from station.diagnosis.corrections import all_corrected, instrument_of
from station.diagnosis.measured_record import Record
from station.diagnosis.memo import Memo
from station.diagnosis.processing import SLOW_S, STEP_S, Setting, Share, bridge_of, slow_spectrum, thinned
from station.diagnosis.residuals import DOWN, LIFT, NORTH, THETA, VANE, motion_of
from station.diagnosis.sensor_noise import Trim, answering, responses, trim_of
from station.diagnosis.series_spectra import Spectra, spectra
from station.numerics.default_noise import DEFAULT_NOISE
from station.profile import Aircraft, Instrument

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

AIR_DATA: Final = ("airspeed", "dynamic_pressure")
SLOW_SHARE: Final = 0.25
"""Of a sensor's variance, slow where nothing is known."""
FAST_S: Final = 0.025
"""Time step up to which fourth differences of the samples show a sensor's noise and no motion."""
REPEATED: Final = 0.2
"""Share of samples that repeat the one before, from which a signal is rounded coarsely."""
ROUNDED: Final = 1e-6
"""Of a signal's range: smaller steps are a file's rounding, or the grid's."""
FEWEST: Final = 4
"""Steps of rounding in a signal's range: of fewer, what it does is not seen, or it is a test input of few levels."""
GUST_SCALE_M: Final = to_si(1750, "ft")
"""Of the gust's spectrum (MIL-F-8785C, above 2,000 ft). Its shape decides nothing: lift is fed with the gust shown."""
RECORDED_THRUST: Final = 0.005
"""Of the mean thrust: noise of a recorded one."""
SPREAD_BINS: Final = 4.0
"""Over which the spectrum of a coefficient is smoothed to say where the model may miss a share of it."""


GROUP_HZ: Final = 0.07
GROUP_SHARE: Final = 0.2
"""Frequencies, and share of the frequency, over which the responses to noise change in proportion to it, at most: those
of integrals fall with the frequency, a delay of 0.2 s turns by 5 deg. The bin in the middle stands for the others."""
Pick = slice | NDArray[np.int64]
EVERY: Final = slice(None)


@dataclass(frozen=True, slots=True)
class Groups:
    """Neighbouring bins, for which one of them stands."""

    pick: NDArray[np.int64]
    """(groups,) the bin that stands for the others."""
    members: NDArray[np.int64]
    """(groups, most) bins; short groups repeat their last."""
    there: Array
    """(groups, most) 1, and 0 where repeated."""

    @property
    def count(self) -> Array:
        """(groups,) bins in each."""
        return np.asarray(self.there.sum(1))

    def gathered(self, x: Complex) -> Complex:
        """(bins, k) -> (groups, k, most)."""
        return np.asarray((x[self.members] * self.there[..., None]).swapaxes(-1, -2))


def groups_of(frequencies: Array) -> Groups:
    """An odd number of neighbours each, as many as GROUP_HZ and GROUP_SHARE allow."""
    n = len(frequencies)
    first: list[int] = []
    size: list[int] = []
    step = float(frequencies[1] - frequencies[0]) if n > 1 else 1.0
    while (at := sum(size)) < n:
        side = int(min(GROUP_HZ, GROUP_SHARE * frequencies[at]) / step / 2)
        first.append(at)
        size.append(2 * side + 1 if at + 2 * side < n else 1)
    begin, own = np.array(first), np.arange(max(size))
    members = np.minimum(begin[:, None] + own, n - 1)
    return Groups(begin + np.array(size) // 2, members, (own < np.array(size)[:, None]).astype(float))


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A record, and what is needed to compare it with any candidate."""

    record: Record
    """At the rate at which it is compared, see `at_rate_judged`."""
    recorded: Record
    """At its own rate."""
    setting: Setting
    trim: Trim
    loading: tuple[float, float]
    """The record's mass and inertia over the profile's."""
    shapes: tuple[Array, Array, Array]
    """(bins,) white, slow and gust spectra of variance 1."""
    missed: Array
    """(Axis.missed, bins) spectra of the coefficients and signals of which the model may miss a share."""
    grouped: Groups
    left: Array
    """(sensors, bins) 1 over the share that is kept of a sensor's signal, see air_data; 1 of those that are not
    smoothed. A smoothed signal has the share squared of its noise's variance; what is not known of it, the share."""
    axis: Axis = LONGITUDINAL
    memo: Memo = field(default_factory=Memo, repr=False)

    def loaded(self, aircraft: Aircraft) -> Aircraft:
        """An aircraft in the record's air and with its loading."""
        own = aircraft.inertia
        update = {"mass": own.mass * self.loading[0], "iyy": (own.iyy or 1.0) * self.loading[1]}
        return aircraft.model_copy(
            update={"air_density": self.record.density, "inertia": own.model_copy(update=update)}
        )

    def differences(self, aircraft: Aircraft, drift: float = 0.0) -> Spectra:
        """Measured less predicted, in the series judged."""
        return self.axis.spectra_of(self.record.signals, self.loaded(aircraft), self.setting, drift, self.memo)

    @property
    def thinner(self) -> float:
        """Standard deviation of white noise at the rate at which it is compared, over that at its own."""
        return math.sqrt(self.recorded.dt / self.record.dt)

    def noise(self, name: str) -> float:
        """Standard deviation of a sensor's noise, SI, as the record shows it, at the rate at which it is compared."""
        return white_noise(name, self.recorded) * self.thinner

    def responses(self, aircraft: Aircraft, pick: Pick = EVERY, flown: Aircraft | None = None) -> Complex:
        """(bins, series, sensors + 1), see sensor_noise.responses, at the bins picked. `flown`: what answers the gusts
        that nothing measures; the aircraft itself, if left out."""
        trim = self.trim
        if self.axis.answers:
            own = self.loaded(flown or aircraft)
            values = tuple(sorted((name, d.value) for name, d in own.derivatives.items()))
            key = (values, own.inertia, own.fin, own.boom, own.imu_offset, tuple(sorted(own.instruments.items())))
            trim = self.memo.get("trim", key, lambda: answering(trim, self.record, own))
        return responses(trim, self.loaded(aircraft), self.setting.frequencies[pick])

    def columns(self, response: Complex, pick: Pick = EVERY) -> Complex:
        """(bins, series, components): a standard deviation of 1 of each component of the noise, in every series: per
        sensor white, per sensor slow, the gust, what the model misses; of a response at all bins, at those picked."""
        white, slow, gust = (x[pick] for x in self.shapes)
        response = response[pick]
        sensors = response[..., :-1] * np.sqrt(self.left.T[pick])[:, None, :]
        return np.concatenate(
            [
                sensors * np.sqrt(white)[:, None, None],
                sensors * np.sqrt(slow)[:, None, None],
                response[..., -1:] * np.sqrt(gust)[:, None, None],
                self._missing(response, np.abs(response), pick),
            ],
            axis=-1,
        )

    def _missing(self, response: Complex, size: Array, pick: Pick) -> Complex:
        """(..., bins, series, Axis.missed): of a force in its own series, of a sensor wherever its noise goes."""
        judged, sensors, forces = self.setting.judged, self.trim.sensors, self.axis.forces
        out = np.zeros((*response.shape[:-1], len(self.axis.missed)), dtype=complex)
        for k, name in enumerate(self.axis.missed):
            root = np.sqrt(self.missed[k, pick])
            if name in forces:
                if (j := self.axis.series.index(name)) in judged:
                    row = judged.index(j)
                    out[..., row, k] = root * size[..., row, sensors.index(forces[name])]
            else:
                out[..., k] = response[..., sensors.index(name)] * root[:, None]
        return out

    def _deviations(self, variances: Array) -> tuple[Array, Array]:
        """(groups, sensors + 1) standard deviations, white and slow together, the gust's; and those of the shares."""
        n = len(self.trim.sensors)
        white, slow, gust = (x[self.grouped.pick] for x in self.shapes)
        power = variances[:n] * white[:, None] + variances[n : 2 * n] * slow[:, None]
        sd = np.sqrt(np.concatenate([power, (variances[2 * n] * gust)[:, None]], axis=1))
        return sd, np.sqrt(variances[2 * n + 1 :])

    def scaled(self, response: Complex, variances: Array) -> Complex:
        """`columns` in their standard deviations, a sensor's white and slow part as one, of a response by groups; of
        the noise alone that is in the signals, for nothing else is in slopes."""
        sd, missing = self._deviations(variances)
        shown = self._missing(response, np.abs(response), self.grouped.pick)
        return np.concatenate([response * sd[:, None, :], shown * missing], axis=-1)

    def scaled_slopes(self, response: Complex, slopes: Complex, variances: Array) -> Complex:
        """The change of `scaled` per parameter, whose change of the responses is `slopes` (p, groups, ...)."""
        sd, missing = self._deviations(variances)
        size = (np.conj(response) * slopes).real / np.maximum(np.abs(response), 1e-30)
        shown = self._missing(slopes, size, self.grouped.pick)
        return np.concatenate([slopes * sd[:, None, :], shown * missing], axis=-1)

    def steady_variances(self, variances: Array, zeros: Array) -> Array:
        """(k,) variances of the steady parts: what sensors' noise and the gusts leave, zeros that wander by `zeros`
        (see Levels), and for forces what trims differ by from one manoeuvre to the next."""
        n, s = len(self.trim.sensors), self.setting
        seconds = s.n * s.dt
        density = dict.fromkeys(self.axis.sensors, 0.0)
        for i, name in enumerate(self.trim.sensors):
            density[name] = float(variances[i] * s.dt + variances[n + i] * 2 * SLOW_S)
        speed = float(self.trim.signals["airspeed"][0])
        gust = float(variances[2 * n]) * 2 * GUST_SCALE_M / speed
        of = (*self.axis.steady(density, seconds, speed, gust), *np.square(self.axis.trim_sd))
        judged = np.array(s.judged)
        wandered = np.where(judged < LIFT, zeros[np.minimum(judged, LIFT - 1)], 0.0)
        return np.array([of[j] for j in s.judged]) + self.of_zeros * wandered

    @property
    def of_zeros(self) -> Array:
        """(k,) what a zero of 1 in the sensor at the head of a series makes of its steady part, squared."""
        seconds = self.setting.n * self.setting.dt
        of = {THETA: seconds**2, DOWN: seconds**2, NORTH: seconds**2, VANE: 1.0}
        return np.array([of.get(j, 0.0) for j in self.setting.judged])

    def missing(self, response: Complex, shares: Mapping[str, float]) -> Array:
        """(series,) what misses `shares` of Axis.missed leave out of each series judged, over what moves in it."""
        each = self._missing(response, np.abs(response), EVERY) * [shares.get(name, 0.0) for name in self.axis.missed]
        return np.asarray(np.sqrt((np.abs(each) ** 2).sum(-1).mean(0)) / np.maximum(self.motion(response), 1e-12))

    def of_heads(self, response: Complex) -> Complex:
        """(groups, series, series) of a response at all bins: to the sensors at the heads of the series judged."""
        columns = [self.trim.sensors.index(self.axis.heads[j]) for j in self.setting.judged]
        return np.asarray(response[self.grouped.pick][:, :, columns])

    def motion(self, response: Complex) -> Array:
        """(series,) root mean square of what moves in each series judged: the signal at its head, the coefficient."""
        out = []
        for row, j in enumerate(self.setting.judged):
            name, head = self.axis.series[j], self.axis.heads[j]
            if j >= LIFT:
                by_head = np.abs(response[:, row, self.trim.sensors.index(head)]) ** 2
                power = self.missed[self.axis.missed.index(name)] * by_head
            else:
                x = self.record.signals[head]
                power = np.abs(spectra(np.broadcast_to(x, (1, len(x))), self.setting, (0,), False).bins[0]) ** 2
            out.append(math.sqrt(float(power.mean())))
        return np.array(out)


def at_rate_judged(record: Record) -> Record:
    """A record that is sampled more often than STEP_S asks, thinned by its transform: what is judged lies far below,
    and costs as much at any rate. One that repeats values stays as it is, for these have times of their own."""
    every = math.floor(STEP_S / record.dt + 1e-6)
    if every <= 1 or record.held:
        return record
    signals = {name: thinned(x, record.dt, every) for name, x in record.signals.items()}
    return replace(record, dt=every * record.dt, signals=signals)


def manoeuvre(recorded: Record, aircraft: Aircraft, axis: Axis = LONGITUDINAL) -> Manoeuvre:
    """Ready to be compared with candidates about `aircraft`."""
    record = at_rate_judged(recorded)
    judged = tuple(j for j, name in enumerate(axis.series) if not axis.unjudged(name, record, aircraft))
    x = record.signals
    force = float(np.mean(x["dynamic_pressure"])) * aircraft.geometry.wing_area
    polar = aircraft.drag
    mass = record.mass or aircraft.inertia.mass
    lift = mass * float(np.mean(-x["az"])) / force
    drag = polar.zero_lift + polar.induced * lift**2 if polar else 0.0
    thrust = float(np.mean(x["thrust"])) if "thrust" in x else max(force * drag, 0.0)
    own = Setting(
        record.dt, record.n, bridge_of(record.dt, record.n), judged, record.imu, thrust,
        stated_noise(axis.surfaces[0], record) * math.sqrt(recorded.dt / record.dt), "v_down" not in x, record.held,
    )  # fmt: skip
    shares = {} if axis.lateral else _air_shares(record, recorded, aircraft, own)
    own = replace(own, airspeed_share=shares.get("airspeed"), pressure_share=shares.get("dynamic_pressure"))
    f = own.frequencies
    slow = slow_spectrum(f, record.dt)
    reach = 2 * np.pi * f * GUST_SCALE_M / float(np.mean(x["airspeed"]))
    gust = (1 + 3 * reach**2) / (1 + reach**2) ** 2
    trim = trim_of(record, own, axis)
    loading = (
        mass / aircraft.inertia.mass,
        (record.iyy or aircraft.inertia.iyy or 1.0) / (aircraft.inertia.iyy or 1.0),
    )
    made = Manoeuvre(
        record,
        recorded,
        own,
        trim,
        loading,
        (np.ones(len(f)), slow, gust / gust.mean()),
        np.ones((len(axis.missed), len(f))),
        groups_of(f),
        _left(trim.sensors, {name: share.at(f) for name, share in shares.items()}, np.ones(len(f))),
        axis,
    )
    made.missed[:] = _motion(made, aircraft)
    made.memo._kept.clear()
    return made


def _left(sensors: Sequence[str], shares: Mapping[str, Array], whole: Array) -> Array:
    """(sensors, bins) of Manoeuvre.left."""
    if len(shares) == len(AIR_DATA):
        shares = {**shares, "pitot": np.maximum(*shares.values())}
    return np.stack([1 / shares.get(name, whole) for name in sensors])


def _air_shares(record: Record, recorded: Record, aircraft: Aircraft, s: Setting) -> dict[str, Share]:
    """Of airspeed and dynamic pressure, where they do not repeat their values, see air_data."""
    _, x = all_corrected(record.signals, aircraft, s, Memo())
    own, found = motion_of(x, aircraft, s).own, {}
    beyond = {"airspeed": x["airspeed"] - own, "dynamic_pressure": x["dynamic_pressure"] / own**2}
    units = {"airspeed": 1.0, "dynamic_pressure": float(np.mean(own)) ** 2}
    for name, values in beyond.items():
        if name not in record.held:
            gain = (instrument_of(aircraft, name) or Instrument()).gain
            shown = (white_noise(name, recorded) / (gain * units[name])) ** 2
            found[name] = share_of(values, record.dt, shown * recorded.dt / record.dt, SLOW_SHARE * shown)
    return found


def _motion(m: Manoeuvre, aircraft: Aircraft) -> Array:
    """(Axis.missed, bins) smoothed spectra of the coefficients over what their sensor makes of them, and of sensors."""
    still = aircraft.unsteady.model_copy(update={"tail_lift_slope": 0.0})
    own = m.differences(aircraft.model_copy(update={**m.axis.still, "unsteady": still}))
    response, judged, forces, series = m.responses(aircraft), m.setting.judged, m.axis.forces, m.axis.series
    out = np.zeros((len(m.axis.missed), response.shape[0]))
    for k, name in enumerate(m.axis.missed):
        if name in forces:
            if series.index(name) not in judged:
                continue
            row = judged.index(series.index(name))
            power = np.abs(own.bins[row] / response[:, row, m.trim.sensors.index(forces[name])]) ** 2
        else:
            x = np.broadcast_to(m.record.signals[name], (len(series), m.record.n))
            power = np.abs(spectra(x, m.setting, (VANE,), False).bins[0]) ** 2
        out[k] = ndimage.gaussian_filter1d(power, SPREAD_BINS, mode="nearest")
    return out


def lasting_gust(record: Record) -> float:
    """m/s, standard deviation of the mean of gusts along the path as strong as those of the record, where ground speed
    shows them (Dryden's spectrum along the path: a correlation of exp(-x/GUST_SCALE_M)); else 0."""
    x = record.signals
    along = x.get("v_along", x.get("v_ahead"))
    if along is None:
        return 0.0
    long = float(x["airspeed"].mean()) * record.seconds / GUST_SCALE_M
    lasting = 2 / long * (1 + math.expm1(-long) / long)
    noise = white_noise("airspeed", record) ** 2 + stated_noise("v_along", record) ** 2
    moving = max(float(np.var(x["airspeed"] - along)) - noise, 0.0)
    return math.sqrt(moving * lasting / (1 - lasting))


def white_noise(name: str, record: Record) -> float:
    """Noise of one sensor as the record shows it, sample against sample, where it is fast enough; else as stated."""
    if record.dt > FAST_S or name in record.held:
        return stated_noise(name, record)
    x = record.signals[name]
    rough = float(np.median(np.abs(np.diff(x, 4)))) / 0.6745 / math.sqrt(70.0)
    return max(rough, quantum(x) / math.sqrt(12.0), 0.1 * stated_noise(name, record))


def quantum(x: Array) -> float:
    """The step of a signal that a recorder has rounded so far that values repeat, where the middle of its differences
    says nothing of its noise; else 0. By the values that repeat: those between are of the grid that it was put on. What
    stands still and glides from one value to the next, as a surface that is simulated, is not rounded."""
    least = ROUNDED * float(np.ptp(x))
    moves = np.diff(x)
    still = np.abs(moves) <= least
    level = np.sort(x[1:][still])
    steps = np.diff(level)
    steps = steps[steps > least]
    if not len(steps) or len(level) <= REPEATED * len(x):
        return 0.0
    step = float(np.median(steps))
    return 0.0 if np.ptp(x) < FEWEST * step or _glides(moves, ~still, least) else step


def _glides(moves: Array, going: NDArray[np.bool_], least: float) -> bool:
    """Whether most ways from one value that repeats to the next are smooth: to one side, by steps that differ. Of one
    that a grid has split, the steps between its first and its last are alike."""
    edges = np.diff(np.concatenate([[0], going, [0]]))
    ways = [moves[a + 1 : b - 1] for a, b in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True)]
    smooth = [bool(len(w) > 1 and np.ptp(w) > least and (w * w[0] > 0).all()) for w in ways]
    return 2 * sum(smooth) > len(ways)


def stated_noise(name: str, record: Record) -> float:
    """Noise of one sensor that the rig states, or a good installation has."""
    signal = {"v_along": "v_north", "v_across": "v_east"}.get(name, name)
    if name == "thrust":
        return RECORDED_THRUST * max(float(np.mean(record.signals["thrust"])), 1.0)
    return float(record.stated.get(signal) or DEFAULT_NOISE[signal])
