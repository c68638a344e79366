"""A record ready to be compared with any candidate: residuals, and what noise, gusts and model errors make of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from station.diagnosis.air_data import STILL, Unseen, share_beyond
from station.diagnosis.air_data_noise import air_share_of
from station.diagnosis.axis import LONGITUDINAL, Axis
from station.diagnosis.corrections import AIR_DATA, all_corrected
from station.diagnosis.inertial_motion import motion_of
from station.diagnosis.measured_record import Record
from station.diagnosis.memo import Memo
from station.diagnosis.processing import SLOW_S, STEP_S, AirShare, Setting, Share, bridge_of, slow_spectrum, thinned
from station.diagnosis.recorded_noise import GUST_SCALE_M, SLOW_SHARE, judged_noise, stated_noise, white_noise
from station.diagnosis.residuals import DOWN, LIFT, NORTH, THETA, VANE, gust_across, series
from station.diagnosis.sensor_noise import Trim, answering, of_force, responses, trim_of
from station.diagnosis.series_spectra import Spectra, spectra
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

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
    moves: Complex
    """(Axis.missed, bins) coefficients, over what their sensor makes of them, and signals of which the model may miss a
    share."""
    missed: Array
    """(Axis.missed, bins) their spectra, smoothed."""
    grouped: Groups
    left: Array
    """(sensors, bins) 1 over the share that is kept of a sensor's signal, see air_data; 1 of those that are not
    smoothed. A smoothed signal has the share squared of its noise's variance; what is not known of it, the share."""
    axis: Axis = LONGITUDINAL
    memo: Memo = field(default_factory=Memo, repr=False)

    def loaded(self, aircraft: Aircraft) -> Aircraft:
        """An aircraft in the record's air and with its loading."""
        own = aircraft.inertia
        iyy = 1.0 if own.iyy is None else own.iyy
        update = {"mass": own.mass * self.loading[0], "iyy": iyy * self.loading[1]}
        return aircraft.model_copy(
            update={"air_density": self.record.density, "inertia": own.model_copy(update=update)}
        )

    def differences(self, aircraft: Aircraft, unseen: Unseen = STILL) -> Spectra:
        """Measured less predicted, in the series judged."""
        return self.axis.spectra_of(self.record.signals, self.loaded(aircraft), self.setting, unseen, self.memo)

    @property
    def thinner(self) -> float:
        """Standard deviation of white noise at the rate at which it is compared, over that at its own."""
        return math.sqrt(self.recorded.dt / self.record.dt)

    def noise(self, name: str) -> float:
        """Standard deviation of a sensor's noise, SI, as the record shows it, at the rate at which it is compared."""
        return judged_noise(name, self.recorded) * self.thinner

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
                self._missing(response, np.abs(self.own_responses(response)), np.sqrt(self.missed[:, pick])),
            ],
            axis=-1,
        )

    @property
    def smoothed(self) -> NDArray[np.bool_]:
        """(sensors + 1,) of the columns of a response, those of sensors whose signal was smoothed, see `left`."""
        return np.append((self.left != 1).any(1), False)

    @property
    def heads(self) -> list[int]:
        """The columns of a response that are of the sensors at the heads of the series judged."""
        return [self.trim.sensors.index(self.axis.heads[j]) for j in self.setting.judged]

    def place(self, name: str) -> tuple[int, int] | None:
        """Of a series, its row and its head's column in a response; None where it is not judged."""
        j = self.axis.series.index(name)
        if j not in self.setting.judged:
            return None
        return self.setting.judged.index(j), self.trim.sensors.index(self.axis.heads[j])

    @property
    def _forces(self) -> slice:
        """Of the series judged, those of lift, moment and drag."""
        return slice(sum(j < LIFT for j in self.setting.judged), None)

    def own_responses(self, response: Complex, slopes: Complex | None = None) -> Complex:
        """(..., bins, Axis.missed): see `of_force`, of the forces judged; 1 of what is no force."""
        made = response if slopes is None else slopes
        out = np.ones((*made.shape[:-2], len(self.axis.missed)), dtype=complex)
        vane = self.place(self.axis.series[VANE])
        for k, name in enumerate(self.axis.missed):
            if name in self.axis.forces and (head := self.place(name)):
                out[..., k] = of_force(response, head, vane, slopes)
        return out

    def moving(self, response: Complex) -> Complex:
        """(bins, series, Axis.missed): what each series would miss, of a share of 1, in step with what moves."""
        return self._missing(response, self.own_responses(response), self.moves)

    def _missing(self, response: Complex, own: Array | Complex, moves: Array | Complex) -> Complex:
        """(..., bins, series, Axis.missed): of a force in its own series, of the size `own`; of a sensor wherever its
        noise goes. `moves`: (Axis.missed, bins) how much of it there is."""
        out = np.zeros((*response.shape[:-1], len(self.axis.missed)), dtype=complex)
        for k, name in enumerate(self.axis.missed):
            if name not in self.axis.forces:
                out[..., k] = response[..., self.trim.sensors.index(name)] * moves[k][:, None]
            elif head := self.place(name):
                out[..., head[0], k] = moves[k] * own[..., k]
        return out

    @property
    def _missed_by_group(self) -> Array:
        return np.sqrt(self.missed[:, self.grouped.pick])

    def _deviations(self, variances: Array) -> tuple[Array, Array]:
        """(groups, sensors + 1) standard deviations, white and slow together, the gust's; and those of the shares."""
        n = len(self.trim.sensors)
        white, slow, gust = (x[self.grouped.pick] for x in self.shapes)
        power = variances[:n] * white[:, None] + variances[n : 2 * n] * slow[:, None]
        power = power * self.left.T[self.grouped.pick]
        sd = np.sqrt(np.concatenate([power, (variances[2 * n] * gust)[:, None]], axis=1))
        return sd, np.sqrt(variances[2 * n + 1 :])

    def scaled(self, response: Complex, variances: Array) -> Complex:
        """`columns` in their standard deviations, a sensor's white and slow part as one, of a response by groups."""
        sd, missing = self._deviations(variances)
        shown = self._missing(response, np.abs(self.own_responses(response)), self._missed_by_group)
        return np.concatenate([response * sd[:, None, :], shown * missing], axis=-1)

    def scaled_slopes(self, response: Complex, slopes: Complex, variances: Array) -> Complex:
        """(p, groups, series, components) the noise of `scaled` in slopes, whose change of the responses is `slopes`.

        A smoothed signal is the mean of what is true, given what was shown, and its error is independent of it (Berkson
        1950, Are There Two Regressions?). So no slope that is made of that signal alone has the error in it: not a
        lag's, nor a lift slope's. But the aircraft flies in the pressure that is true, and the accelerometers show it:
        the slope of a mass, which weighs what they show, has it. They show as much of it as makes the same of the
        series as the error does.

        All this as far as the noise is known, for the slope is short or long by the part that is kept too much or too
        little: so the slow noise is estimated beside all else, see air_data.Unseen."""
        sd, missing = self._deviations(variances)
        own = self.own_responses(response)
        size = (np.conj(own) * self.own_responses(response, slopes)).real / np.maximum(np.abs(own), 1e-30)
        shown = self._missing(slopes, size, self._missed_by_group)
        moved, errs = slopes.copy(), self.smoothed
        if errs.any():
            answers = np.linalg.solve(response[..., self.heads], response[..., errs])
            moved[..., errs] = slopes[..., self.heads] @ answers
        moved[..., self._forces, -1] = 0.0  # slopes are made of the gust that forces are fed with, not of the rest
        return np.concatenate([moved * sd[:, None, :], shown * missing], axis=-1)

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
        each = self._missing(response, np.abs(self.own_responses(response)), np.sqrt(self.missed))
        each *= [shares.get(name, 0.0) for name in self.axis.missed]
        return np.asarray(np.sqrt((np.abs(each) ** 2).sum(-1).mean(0)) / np.maximum(self.motion(response), 1e-12))

    def of_heads(self, response: Complex) -> Complex:
        """(groups, series, series) of a response at all bins: to the sensors at the heads of the series judged."""
        return np.asarray(response[self.grouped.pick][..., self.heads])

    def motion(self, response: Complex) -> Array:
        """(series,) root mean square of what moves in each series judged: the signal at its head, the coefficient."""
        out, own = [], np.abs(self.own_responses(response)) ** 2
        for j in self.setting.judged:
            if j >= LIFT:
                k = self.axis.missed.index(self.axis.series[j])
                power = self.missed[k] * own[:, k]
            else:
                x = self.record.signals[self.axis.heads[j]]
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
    own = replace(own, air_share=None if axis.lateral else _air_share(record, recorded, aircraft, own))
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
        np.ones((len(axis.missed), len(f)), dtype=complex),
        np.ones((len(axis.missed), len(f))),
        groups_of(f),
        _left(trim.sensors, own),
        axis,
    )
    if not axis.lateral and VANE in judged:
        told = _gust_share(made, aircraft)
        own, straight = replace(own, gust_share=told), replace(trim.setting, gust_share=told)
        own = replace(own, gust_across=gust_across(x, made.loaded(aircraft), own))
        made = replace(made, setting=own, trim=replace(trim, setting=straight))
    made.moves[:] = _motion(made, aircraft)
    made.missed[:] = ndimage.gaussian_filter1d(np.abs(made.moves) ** 2, SPREAD_BINS, mode="nearest")
    made.memo._kept.clear()
    return made


def _left(sensors: Sequence[str], s: Setting) -> Array:
    """(sensors, bins) of Manoeuvre.left."""
    left, share = np.ones((len(sensors), len(s.frequencies))), s.air_share
    if share is not None:
        alike = ("pitot",) if len(share.sensors) == len(AIR_DATA) else ()
        left[[sensors.index(n) for n in (*share.sensors, *alike) if n in sensors]] /= share.at(s.frequencies).sum(0)
    return left


def _air_share(record: Record, recorded: Record, aircraft: Aircraft, s: Setting) -> AirShare | None:
    """Of airspeed and dynamic pressure, where they do not repeat their values, see air_data."""
    _, x = all_corrected(record.signals, aircraft, s, Memo())
    own = motion_of(x, aircraft, s).own
    root = np.sqrt(np.maximum(x["dynamic_pressure"], 0.0))
    beyond = {"airspeed": x["airspeed"] / own, "dynamic_pressure": root / own}
    fresh = {name: values / values.mean() for name, values in beyond.items() if name not in record.held}
    return air_share_of(record, recorded, fresh)


def _gust_share(m: Manoeuvre, aircraft: Aircraft) -> Share:
    """The share of what the vane shows beyond the motion that is more than the noise of all sensors there."""
    answer = m.responses(aircraft)[:, m.setting.judged.index(VANE)]
    noise = np.zeros(len(answer))
    for k, name in enumerate(m.trim.sensors):
        if name in m.record.signals:
            slow = SLOW_SHARE * white_noise(name, m.recorded) ** 2
            noise += np.abs(answer[:, k]) ** 2 * (m.noise(name) ** 2 + slow * m.shapes[1])
    shown = series(m.record.signals, m.loaded(aircraft), m.setting)[VANE]
    return share_beyond(shown, m.record.dt, m.setting.frequencies, noise)


def _motion(m: Manoeuvre, aircraft: Aircraft) -> Complex:
    """(Axis.missed, bins) the coefficients over what their sensor makes of them, and sensors' signals."""
    still = aircraft.unsteady.model_copy(update={"tail_lift_slope": 0.0})
    own = m.differences(aircraft.model_copy(update={**m.axis.still, "unsteady": still}))
    made = m.own_responses(m.responses(aircraft))
    out = np.zeros((len(m.axis.missed), len(made)), dtype=complex)
    for k, name in enumerate(m.axis.missed):
        if name not in m.axis.forces:
            x = np.broadcast_to(m.record.signals[name], (len(m.axis.series), m.record.n))
            out[k] = spectra(x, m.setting, (VANE,), False).bins[0]
        elif head := m.place(name):
            out[k] = own.bins[head[0]] / made[:, k]
    return out
