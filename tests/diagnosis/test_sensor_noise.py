"""How the noise of each sensor reaches the residual series: against the equations of motion, linearised by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import another_simulation as flown
import numpy as np
import pytest
from numpy.typing import NDArray

from station.diagnosis.corrections import AIR_DATA
from station.diagnosis.manoeuvre import Manoeuvre, manoeuvre
from station.diagnosis.measured_record import Record
from station.diagnosis.memo import Memo
from station.diagnosis.residuals import SERIES
from station.profile import Aircraft, load_aircraft
from station.profile.profile_changes import Extend, derivative, inertia, sensor_lag, speed_lift, unsteady

G, SPEED, PITCH, DENSITY = 9.80665, 55.0, 0.07, 1.0
PRESSURE = 0.5 * DENSITY * SPEED**2


def aircraft(folder: Path, unsteady: str = "", boom: bool = False) -> Aircraft:
    """The Navion, with lift that follows at once and a vane at the CG unless told otherwise."""
    profile = folder / "navion.toml"
    profile.write_text(flown.PROFILE.replace("[unsteady]", f"[unsteady]\n{unsteady}"))
    made = load_aircraft(str(profile))
    return made if boom else made.model_copy(update={"boom": None})


def level_flight() -> Record:
    """Straight and level, and nothing else: its mean is where the responses are taken."""
    n = 2000
    values = {
        "theta": PITCH, "q": 0.0, "ax": G * math.sin(PITCH), "az": -G * math.cos(PITCH), "airspeed": SPEED,
        "dynamic_pressure": PRESSURE, "alpha_vane": PITCH, "v_down": 0.0, "v_along": SPEED, "elevator": -0.02,
        "thrust": 1500.0,
    }  # fmt: skip
    return Record("level", 0.02, 0.0, {name: np.full(n, x) for name, x in values.items()}, DENSITY, 1000.0)


@dataclass(frozen=True)
class Shown:
    """Responses by series and sensor, and j w at the frequencies judged."""

    of: Manoeuvre
    responses: NDArray[np.complex128]
    jw: NDArray[np.complex128]

    def __call__(self, series: str, sensor: str) -> NDArray[np.complex128]:
        row = self.of.setting.judged.index(SERIES.index(series))
        column = -1 if sensor == "gust" else self.of.trim.sensors.index(sensor)
        return self.responses[:, row, column]


def shown(subject: Aircraft, smoothed: bool = False) -> Shown:
    """Responses with air data and gust as they are; `smoothed`: of a record whose air data show nothing but motion."""
    m = manoeuvre(level_flight(), subject)
    plain, trim = (replace(s, gust_share=None) for s in (m.setting, m.trim.setting))
    if not smoothed:
        plain, trim = (replace(s, air_share=None) for s in (plain, trim))
    m = replace(m, setting=plain, trim=replace(m.trim, setting=trim, memo=Memo()))
    return Shown(m, m.responses(subject), 2j * np.pi * m.setting.frequencies)


@pytest.fixture(scope="module")
def navion(tmp_path_factory: pytest.TempPathFactory) -> tuple[Aircraft, Shown]:
    subject = aircraft(tmp_path_factory.mktemp("navion"), "memory = false")
    return subject, shown(subject)


def close(found: NDArray[np.complex128], expected: object, size: float = 1.0) -> None:
    """Within two thousandths of the expected response, or of `size` where that is none: integrals of samples 40 ms
    apart are right to one up to 3 Hz, lines through responses 0.1 Hz apart to 1.4 of a vane of 9 Hz."""
    wanted = np.broadcast_to(np.asarray(expected, dtype=complex), found.shape)
    np.testing.assert_array_less(np.abs(found - wanted), 2e-3 * np.maximum(np.abs(wanted), size))


def vane(jw: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """A vane of 9 Hz, damped by 0.35, as those of profiles without one of their own."""
    natural = 2 * np.pi * 9.0
    return natural**2 / (jw**2 + 2 * 0.35 * natural * jw + natural**2)


def test_attitude_against_the_integral_of_the_rate(navion: tuple[Aircraft, Shown]) -> None:
    _, of = navion
    close(of("theta", "theta"), 1.0)
    close(of("theta", "q"), -1 / of.jw)
    for sensor in ("ax", "az", "v_down", "v_along", "airspeed", "alpha_vane", "elevator", "thrust", "gust"):
        close(of("theta", sensor), 0.0)


def test_velocity_against_the_integrals_of_the_accelerations(navion: tuple[Aircraft, Shown]) -> None:
    _, of = navion
    close(of("v_down", "v_down"), 1.0)
    close(of("v_down", "az"), -math.cos(PITCH) / of.jw)
    close(of("v_down", "ax"), math.sin(PITCH) / of.jw)
    # Where nothing but gravity acts along the vertical, turning the axes a little changes nothing there.
    close(of("v_down", "theta"), 0.0, G)
    close(of("v_north", "v_along"), 1.0)
    close(of("v_north", "ax"), -math.cos(PITCH) / of.jw)
    close(of("v_north", "az"), -math.sin(PITCH) / of.jw)
    # An attitude in error takes g for an acceleration along the path.
    close(of("v_north", "theta"), G / of.jw)


def test_the_vane_against_the_flow_that_the_motion_makes(navion: tuple[Aircraft, Shown]) -> None:
    _, of = navion
    close(of("alpha_vane", "alpha_vane"), 1.0)
    close(of("alpha_vane", "theta"), -vane(of.jw))
    close(of("alpha_vane", "v_down"), -vane(of.jw) / SPEED, 1 / SPEED)
    close(of("alpha_vane", "gust"), of("alpha_vane", "alpha_vane"))
    for series in SERIES[:3] + SERIES[4:]:
        close(of(series, "gust"), 0.0)


def test_lift_and_moment(navion: tuple[Aircraft, Shown]) -> None:
    subject, of = navion
    force = PRESSURE * subject.geometry.wing_area
    mass, iyy, chord = subject.inertia.mass, subject.inertia.iyy, subject.geometry.chord
    assert iyy is not None
    cx = (mass * G * math.sin(PITCH) - 1500.0) / force
    cz = -mass * G * math.cos(PITCH) / force
    lift, drag = cx * math.sin(PITCH) - cz * math.cos(PITCH), -cx * math.cos(PITCH) - cz * math.sin(PITCH)
    d = {n: subject.value(n) for n in ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")}
    close(of("lift", "az"), -mass * math.cos(PITCH) / force, 0.0)
    close(of("lift", "ax"), mass * math.sin(PITCH) / force, 0.0)
    close(of("lift", "elevator"), -d["CL_de"], 0.0)
    close(of("lift", "q"), -d["CL_q"] * chord / (2 * SPEED), 0.0)
    # The pressure is the square of the speed's, and the measured coefficient falls with it.
    close(of("lift", "pitot"), -2 * lift / SPEED, 0.0)
    close(of("moment", "elevator"), -d["Cm_de"], 0.0)
    # One-sided differences at the ends of the period see the highest lines wrong, by 1.2 % of all (rms).
    turning = of.jw * iyy / (force * chord) - d["Cm_q"] * chord / (2 * SPEED)
    assert np.sqrt(np.mean(np.abs(of("moment", "q") / turning - 1) ** 2)) < 0.02
    close(of("moment", "az"), 0.0)
    # Lift acts at the flow that the vane shows, wherever that comes from: the attitude drops out. Turning the axes of
    # the forces takes some drag besides.
    close(of("lift", "alpha_vane"), (-d["CL_alpha"] - drag) / vane(of.jw), 0.0)
    close(of("lift", "theta"), 0.0, d["CL_alpha"])
    close(of("moment", "alpha_vane"), -d["Cm_alpha"] / vane(of.jw), 0.0)
    close(of("moment", "theta"), 0.0, abs(d["Cm_alpha"]))


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_lift_depends_on_the_speed_of_gusts_that_the_span_meets_whole(tmp_path: Path, share: float) -> None:
    """At wavelengths of ten spans and more it does, at less than five by a share, the rest is left to the pressure:
    about, for responses are straight between lines 0.1 Hz apart."""
    subject = unsteady("speed_gusts")(speed_lift(aircraft(tmp_path), 0.4), share - 0.5)
    of = shown(subject)
    spans = 2 * np.pi * SPEED / of.jw.imag / subject.geometry.span
    assert (spans > 11).any()
    assert (spans < 4.5).any()
    lift = (subject.inertia.mass * G - 1500.0 * math.sin(PITCH)) / (PRESSURE * subject.geometry.wing_area)
    close(of("lift", "pitot")[spans > 11], -(2 * lift + 0.4) / SPEED, 0.0)
    close(of("lift", "pitot")[spans < 4.5], -(2 * lift + share * 0.4) / SPEED, 0.0)


def test_air_data_without_gusts_are_what_the_accelerations_say(navion: tuple[Aircraft, Shown]) -> None:
    """Nothing of the pitot's noise is left in lift; that of the acceleration along the path is in the pressure, as its
    integral."""
    subject, of = navion
    smooth = shown(subject, smoothed=True)
    force, mass = PRESSURE * subject.geometry.wing_area, subject.inertia.mass
    lift = (mass * G - 1500.0 * math.sin(PITCH)) / force
    close(smooth("lift", "pitot"), 0.0, 2 * lift / SPEED)
    integrated = -2 * lift / SPEED * math.cos(PITCH) / of.jw
    close(smooth("lift", "ax") - of("lift", "ax"), integrated, 2 * lift / SPEED)
    # What is not known of it is the share's root, a hundredth here, of its noise.
    at = smooth.of.trim.sensors.index("pitot")
    left = smooth("lift", "pitot") * np.sqrt(smooth.of.left[at])
    np.testing.assert_allclose(np.abs(left), 0.01 * 2 * lift / SPEED, rtol=0.05)


@pytest.mark.parametrize(("change", "by", "share"), [
    (inertia("mass"), 0.01, 0.01), (derivative("CL_alpha", relative=True), 0.01, 0.0),
    (sensor_lag(*AIR_DATA), 0.1, 0.0),
])  # fmt: skip
def test_the_error_of_smoothed_air_data_is_in_slopes_that_weigh_what_answers_it(
    navion: tuple[Aircraft, Shown], change: Extend, by: float, share: float
) -> None:
    """A pressure that is higher than thought lifts more than thought, and the accelerometer shows it: a mass 1 % larger
    makes 1 % of it more. A lag weighs no acceleration, nor does a lift slope. By hand where the aircraft has no time to
    give way: that lessens it by La/(j w), La = CL_alpha q S/(m V)."""
    subject, _ = navion
    of = shown(subject, smoothed=True)
    m, here = of.of, of.responses[of.of.grouped.pick]
    there = m.responses(change(subject, by), m.grouped.pick) - here
    variances = np.ones(2 * len(m.trim.sensors) + 1 + len(m.axis.missed))
    row, at = m.setting.judged.index(SERIES.index("lift")), m.trim.sensors.index("pitot")
    found = m.scaled_slopes(here, there[None], variances)[0, :, row, at] / m.scaled(here, variances)[:, row, at]
    slope = subject.value("CL_alpha") * PRESSURE * subject.geometry.wing_area / (subject.inertia.mass * SPEED)
    fast = np.abs(of.jw[m.grouped.pick]) > 8 * slope
    assert fast.any()
    np.testing.assert_array_less(np.abs(found - share)[fast], 0.01 / 4)


def test_a_boom_carries_the_noise_of_the_rate_to_the_vane(tmp_path: Path) -> None:
    """A vane 3 m ahead sinks with the rate, square to the body: atan((w - q x)/u) falls by q x u/V2, times the body's
    upwash."""
    of = shown(aircraft(tmp_path, boom=True))
    expected = (1 + flown.UPWASH) * flown.BOOM * math.cos(PITCH) / SPEED
    close(of("alpha_vane", "q"), expected * vane(of.jw), 0.0)
    close(of("alpha_vane", "theta"), -(1 + flown.UPWASH) * vane(of.jw), 0.0)


def test_what_is_missed_of_lift_is_a_share_of_lift_whatever_the_boom_does(tmp_path: Path) -> None:
    """A boom that bends shows the vane what the accelerometer shows, and lift is made with both: its own response is
    that to the acceleration at the flow that is there. So is the moment's to the rate, with a vane ahead of the CG."""
    subject = aircraft(tmp_path, boom=True)
    assert subject.boom is not None
    bent = subject.model_copy(update={"boom": subject.boom.model_copy(update={"flexure": -0.0015})})
    of = shown(bent)
    subject_alone = shown(aircraft(tmp_path))
    own = {name: of.of.own_responses(of.responses)[:, of.of.axis.missed.index(name)] for name in ("lift", "moment")}
    assert np.abs(of("lift", "az") / own["lift"])[0] > 1.1
    close(own["lift"], subject_alone("lift", "az"), 0.0)
    close(own["moment"], subject_alone("moment", "q"), 0.0)


def test_a_tail_meets_the_gust_of_the_vane_late(tmp_path: Path) -> None:
    """What the vane shows beyond the motion is a gust, which is l_t/V later at the tail; the motion is there at once.
    An error of the attitude is part of both, with opposite signs."""
    subject = aircraft(tmp_path)
    of = shown(subject)
    late = np.exp(-of.jw * flown.TAIL / SPEED)
    slope = subject.value("CL_alpha")
    close(of("lift", "theta"), -flown.TAIL_SLOPE * (1 - late), slope)
    close(of("moment", "theta"), flown.TAIL_SLOPE * flown.TAIL / flown.CHORD * (1 - late), 2 * slope)
    met = slope - flown.TAIL_SLOPE * (1 - late)
    # Turning the axes of the forces takes some drag besides, a hundredth of the slope.
    close(of("lift", "alpha_vane") * vane(of.jw), -met, 10 * slope)


def test_a_gust_shows_less_in_what_lift_bends_away(tmp_path: Path) -> None:
    """A boom that flexes with az takes f k of each gust out of the vane's series, for lift follows the gust at once:
    the gust's column is as much smaller, or a smaller gust would be the likelier."""
    plain = aircraft(tmp_path, "memory = false", boom=True)
    bent = plain.model_copy(update={"boom": plain.boom.model_copy(update={"flexure": -1e-3})})
    k = PRESSURE * plain.geometry.wing_area * plain.value("CL_alpha") / (plain.inertia.mass * (1 + flown.UPWASH))
    ratio = np.abs(shown(bent)("alpha_vane", "gust") / shown(plain)("alpha_vane", "gust"))
    np.testing.assert_allclose(ratio[:10], 1 - 1e-3 * k, atol=0.01)  # to 1 Hz: above, the vane itself answers
