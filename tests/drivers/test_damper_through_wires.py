"""A pitch damper closed through wires damps as computed: the gyro's bytes in, a pot's bytes out, with their latency.

What it is held against is the textbook's linear equations and the loop's characteristic equation with the exact delay,
det(s - A - B K C exp(-s T)) = 0. The latency in T is measured open loop: by how much later pitch rate is heard than the
equations have it of the angles sent.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from linear_flight import textbook
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import curve_fit, root

from station.profile import Aircraft, Profiles, Unsteady
from station.rows import Sample
from station.simulation.stepped_flight import SteppedFlight
from tests.drivers.test_closed_loop import Hand, calm, events, flying, until

GAIN = 0.2
"""s"""
THINKS = 0.1
"""How late the hand answers what it has heard, s."""
CLOSE = 0.05
"""Of a root: that of a swing 30 times its sensor's noise, heard for one and a half periods; seen are 1 to 3 %."""
BUSY = 0.02
"""s: a loop whose steps come so late is not the one computed; it is flown again."""
KICK, WIDTH = 2.0, 0.5
"""Doublet, deg and s."""


def lively(profiles: Profiles) -> Profiles:
    """Without damping of its own but lift's, and quasi-steady: a short period that swings, of a closed form."""
    plain: Aircraft = profiles.aircraft.model_copy(update={"unsteady": Unsteady(memory=False)})
    none = plain.derivatives["Cm_q"].model_copy(update={"value": 0.0})
    return profiles.model_copy(
        update={"aircraft": plain.model_copy(update={"derivatives": {**plain.derivatives, "Cm_q": none}})}
    )


def gyro(heard: list[Sample]) -> NDArray[np.float64]:
    """(2, n): by the device's own stamps, as station time of what is heard soonest, s, and pitch rate, deg/s: a machine
    that is busy hears some of it late, which is no part of the swing."""
    rows = [s for s in list(heard) if s.stream == "can.gyro" and s.t_device_ns is not None]
    stamped = np.array([s.t_device_ns for s in rows], dtype=np.int64)
    came = np.array([s.t_ns for s in rows], dtype=np.int64)
    return np.array([(stamped + (came - stamped).min()) * 1e-9, [math.degrees(s.values[1]) for s in rows]])


class Damper(Hand):
    """Trim, a doublet where one is wanted, and GAIN times the pitch rate heard THINKS ago."""

    def __init__(self, channel: str, trim_deg: float) -> None:
        self.heard: list[Sample] = []
        self.gain, self.kick_s, self.answered = 0.0, math.inf, list[tuple[float, float]]()
        """`answered`: when, s, and which rate, deg/s."""
        super().__init__(channel, trim_deg)

    def wanted(self, now_s: float) -> float:
        since = now_s - self.kick_s
        kick = KICK * ((0 <= since < WIDTH) - (WIDTH <= since < 2 * WIDTH))
        if not self.gain:
            return self.angle_deg + kick
        for sample in reversed(self.heard):
            if sample.stream == "can.gyro" and now_s - sample.t_ns * 1e-9 >= THINKS:
                self.answered.append((now_s, math.degrees(sample.values[1])))
                return self.angle_deg + kick + self.gain * math.degrees(sample.values[1])
        return self.angle_deg + kick

    def kicked(self, heard: list[Sample], seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """When pitch rate was heard after the start of a doublet that it flies now, s, and what it was, deg/s."""
        begin = self.kick_s = time.monotonic() + 0.2
        until(lambda: time.monotonic() > begin + seconds)
        t, q = gyro(heard)
        t = t - begin
        level = q[(t > -0.2) & (t < 0)].mean()
        return t[t > 0], (q - level)[t > 0]


def latency(a: NDArray[np.float64], hand: Damper, t: NDArray[np.float64], q: NDArray[np.float64]) -> float:
    """s, from an angle sent to its pitch rate heard: that with which the equations have heard what was."""
    fine = np.arange(0.0, t[-1], 0.001)
    sent = np.array(hand.sent)
    at = np.searchsorted(sent[:, 0] - hand.kick_s, fine) - 1
    moved = np.radians(sent[at, 1] - hand.angle_deg)
    whole = expm(np.vstack((np.hstack((a[:4, :4], a[:4, 4:5])), np.zeros((1, 5)))) * 0.001)
    rates, state = np.empty(len(fine)), np.zeros(4)
    for k, de in enumerate(moved):
        rates[k] = math.degrees(state[2])
        state = (whole @ np.append(state, de))[:4]
    early = t < 2.0

    def missed(late: float) -> float:
        shown = np.interp(t[early] - late, fine, rates)
        return float(np.sum((q[early] - shown) ** 2))

    lates = np.arange(0.0, 0.1, 0.0005)
    return float(lates[np.argmin([missed(late) for late in lates])])


def thought(hand: Damper, t: NDArray[np.float64], q: NDArray[np.float64]) -> float:
    """s, from a pitch rate's stamp to the middle of the time that the answer to it stands for."""
    when, rate = np.array(hand.answered).T
    when = when - hand.kick_s
    fine = np.arange(0.3, 3.0, 0.001)
    answer = rate[np.searchsorted(when, fine) - 1]
    lates = np.arange(0.0, 0.3, 0.0005)
    missed = [np.std(answer - np.interp(fine - late, t, q)) for late in lates]
    return float(lates[np.argmin(missed)])


def computed(a: NDArray[np.float64], gain: float, late: float) -> complex:
    """The short period's root in the loop, followed from that without a gain."""
    own = np.linalg.eigvals(a[:4, :4])
    s = complex(own[np.argmax(own.imag)])
    for k in np.linspace(0.0, gain, 21):

        def characteristic(v: NDArray[np.float64], k: float = float(k)) -> list[float]:
            z = complex(v[0], v[1])
            loop = k * np.exp(-z * late) * np.outer(a[:4, 4], [0.0, 0.0, 1.0, 0.0])
            d = complex(np.linalg.det(z * np.eye(4) - a[:4, :4] - loop))
            return [d.real, d.imag]

        found = root(characteristic, [s.real, s.imag])
        assert found.success
        s = complex(*found.x)
    return s


def ratio(s: complex) -> float:
    """Of damping."""
    return -s.real / abs(s)


def swung(t: NDArray[np.float64], q: NDArray[np.float64]) -> complex:
    """The root of the decaying swing that is heard after the doublet, beside a phugoid's slow drift."""
    after = (t > 2 * WIDTH + 0.25) & (t < 2 * WIDTH + 3.25)

    def decay(x: Any, sigma: float, omega: float, c: float, s: float, level: float, drift: float) -> Any:
        x = x - 2 * WIDTH
        return np.exp(-sigma * x) * (c * np.cos(omega * x) + s * np.sin(omega * x)) + level + drift * x

    p, _ = curve_fit(decay, t[after], q[after], p0=(0.8, 2.1, 1.0, 1.0, 0.0, 0.0))
    return complex(-p[0], abs(p[1]))


def flown(profiles: Profiles, hand: Damper, a: NDArray[np.float64]) -> tuple[complex, complex, float, float]:
    """The swing without the damper and with it, the latency in the loop, s, and by how much a step was late at most."""
    with flying(profiles) as (said, heard, _):
        hand.heard, hand.gain = heard, 0.0
        until(lambda: events(said, "HEARD") and len(heard) > 400)
        t, q = hand.kicked(heard, 6.0)
        wires, free = latency(a, hand, t, q), swung(t, q)
        hand.gain = GAIN
        until(lambda: len(hand.answered) > 600)
        del hand.answered[:]
        t, q = hand.kicked(heard, 6.0)
        late = wires + thought(hand, t, q)
        worst = max(s["loop"].get("worst_late_ms", 0.0) for s in said if "loop" in s)
    return free, swung(t, q), late, 1e-3 * worst


@pytest.mark.slow
def test_a_damper_closed_through_wires_damps_as_computed() -> None:
    channel = "239.74.163.79"
    profiles = lively(calm(channel))
    flight = SteppedFlight(profiles.aircraft, profiles.card)
    a = textbook(profiles.aircraft, flight.aircraft.flown.constants)
    hand = Damper(channel, math.degrees(flight.rest["elevator"]))
    try:
        for _ in range(3):
            free, damped, late, worst = flown(profiles, hand, a)
            if worst < BUSY:
                break
    finally:
        hand.close()
    without, with_it, at_once = computed(a, 0.0, 0.0), computed(a, GAIN, late), computed(a, GAIN, 0.0)
    print(f"{1e3 * late:.1f} ms in the loop; free {free:.3f}, computed {without:.3f}; damped {damped:.3f}, computed")
    print(f"{with_it:.3f}, at once {at_once:.3f}; damping {ratio(free):.3f} {ratio(without):.3f} {ratio(damped):.3f}")
    assert THINKS < late < THINKS + 0.05
    assert abs(free - without) < CLOSE * abs(without)
    assert abs(damped - with_it) < CLOSE * abs(with_it)
    assert ratio(damped) > 1.4 * ratio(free)
    assert abs(damped - with_it) < 0.5 * abs(damped - at_once)
