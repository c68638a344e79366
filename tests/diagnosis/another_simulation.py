"""A light aircraft in three degrees of freedom, flown without anything of the station's: quasi-steady coefficients, the
tail in the gust that met the wing, a throttle that nobody moves, white noise on the sensors. SI, rad."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]

G, DT, FINE = 9.80665, 0.02, 0.005
AREA, SPAN, CHORD, MASS, IYY, TAIL, BOOM, UPWASH = 17.09, 10.18, 1.737, 1247.0, 4067.0, 5.0, 3.0, 0.08
DENSITY, SPEED, TAIL_SLOPE = 1.0, 55.0, 0.6
NAVION = {
    "CL_0": 0.30, "CL_alpha": 4.44, "CL_q": 3.8, "CL_de": 0.355,
    "Cm_0": 0.02, "Cm_alpha": -0.683, "Cm_q": -13.6, "Cm_de": -0.923, "CD_0": 0.033, "K": 0.055,
}  # fmt: skip
"""About a Navion's (Nelson, Flight Stability and Automatic Control, 1998, table B.1)."""
NOISE = {
    "alpha_vane": math.radians(0.1), "q": math.radians(0.05), "theta": math.radians(0.1), "ax": 0.02, "az": 0.03,
    "airspeed": 0.2, "dynamic_pressure": 8.0, "v_north": 0.05, "v_down": 0.05, "elevator": math.radians(0.03),
}  # fmt: skip

PROFILE = f"""
name = "navion"
description = "a light aircraft"
sources = ["Nelson 1998"]
[geometry]
wing_area = "{AREA} m2"
span = "{SPAN} m"
chord = "{CHORD} m"
[inertia]
mass = "{MASS} kg"
iyy = "{IYY} kg m2"
[boom]
vane_x = "{BOOM} m"
upwash_body = {UPWASH}
[drag]
zero_lift = {NAVION["CD_0"]}
induced = {NAVION["K"]}
[unsteady]
tail_lift_slope = {TAIL_SLOPE}
tail_arm = "{TAIL} m"
[derivatives]
""" + "".join(f"{n} = {{ value = {v}, sd = {abs(v) / 10} }}\n" for n, v in NAVION.items() if n[:2] in ("CL", "Cm"))


@dataclass(frozen=True)
class Case:
    """`derivatives` replace the Navion's; the vane shows what it met `late` s ago, times `scale`; `gyro` is
    the gyro's zero."""

    seed: int
    sigma: float = 0.0
    late: float = 0.0
    scale: float = 1.0
    gyro: float = 0.0
    derivatives: dict[str, float] = field(default_factory=dict)
    seconds: float = 45.0


def dryden(rng: np.random.Generator, sigma: float, seconds: float) -> Array:
    """A vertical gust by its spectrum (MIL-F-8785C), L = 150 m, every FINE s of flight."""
    n, length = round(seconds / FINE), 150.0 / SPEED
    w = 2 * np.pi * np.fft.rfftfreq(n, FINE)
    shape = (1 + 3 * (length * w) ** 2) / (1 + (length * w) ** 2) ** 2
    drawn = np.sqrt(shape) * (rng.standard_normal(len(w)) + 1j * rng.standard_normal(len(w)))
    drawn[0] = 0.0
    gust = np.fft.irfft(drawn, n)
    return np.asarray(sigma * gust / gust.std())


def pilot(kind: int, t: Array, rng: np.random.Generator) -> Array:
    """Doublets, 3-2-1-1 or many sines, 3 deg, as an actuator of 30 ms makes them."""
    size, out = math.radians(3.0), np.zeros(len(t))
    if kind == 0:
        for start, width in zip(range(5, 38, 8), (0.8, 0.5, 0.4, 0.7, 0.6), strict=True):
            out += size * ((t >= start) & (t < start + width)) - size * ((t >= start + width) & (t < start + 2 * width))
    elif kind == 1:
        for start in (4.0, 18.0, 32.0):
            for steps, sign in ((3, 1), (2, -1), (1, 1), (1, -1)):
                out += sign * size * ((t >= start) & (t < start + 0.35 * steps))
                start += 0.35 * steps
    else:
        for k in range(2, 31):
            out += 0.35 * size * np.sin(2 * np.pi * k / 15 * t + rng.uniform(0, 2 * np.pi))
        out *= np.clip(t - 3, 0, 1) * np.clip(t[-1] - 2 - t, 0, 1)
    share = math.exp(-FINE / 0.03)
    return np.asarray(signal.lfilter([1 - share], [1.0, -share], out))


def fly(case: Case, kind: int) -> tuple[Array, dict[str, Array]]:
    """Time and what the sensors show, every DT s."""
    rng = np.random.default_rng([case.seed, kind])
    d = NAVION | case.derivatives
    t = np.arange(round(case.seconds / FINE)) * FINE
    before = 2.0
    gusts = (
        dryden(rng, case.sigma, case.seconds + 2 * before)
        if case.sigma
        else np.zeros(len(t) + round(2 * before / FINE))
    )
    along = np.arange(len(gusts)) * FINE - before
    met = [np.interp(t + metres / SPEED, along, gusts) for metres in (0.0, -TAIL, BOOM)]
    wing, tail, vane = met
    pressure = 0.5 * DENSITY * SPEED**2 * AREA
    lift, alpha, thrust, de = MASS * G / pressure, 0.0, 0.0, 0.0
    for _ in range(50):
        alpha, de = np.linalg.solve(
            [[d["CL_alpha"], d["CL_de"]], [d["Cm_alpha"], d["Cm_de"]]], [lift - d["CL_0"], -d["Cm_0"]]
        )
        drag = d["CD_0"] + d["K"] * lift**2
        thrust = MASS * G * math.sin(alpha) - pressure * (lift * math.sin(alpha) - drag * math.cos(alpha))
        lift = (MASS * G * math.cos(alpha) / pressure - drag * math.sin(alpha)) / math.cos(alpha)
    elevator = de + pilot(kind, t, rng)
    rows = np.empty((len(t), 8))

    def rates(x: Array, e: float, gw: float, gt: float) -> tuple[Array, float, float, float]:
        u, w, q, theta = x
        v = math.hypot(u, w + gw)
        a, late = math.atan2(w + gw, u), (gt - gw) / v
        cl = d["CL_0"] + d["CL_alpha"] * a + d["CL_q"] * q * CHORD / (2 * v) + d["CL_de"] * e + TAIL_SLOPE * late
        cm = d["Cm_0"] + d["Cm_alpha"] * a + d["Cm_q"] * q * CHORD / (2 * v) + d["Cm_de"] * e
        cm -= TAIL_SLOPE * TAIL / CHORD * late
        cd, force = d["CD_0"] + d["K"] * cl**2, 0.5 * DENSITY * v * v * AREA
        ax = (force * (cl * math.sin(a) - cd * math.cos(a)) + thrust) / MASS
        az = -force * (cl * math.cos(a) + cd * math.sin(a)) / MASS
        turn = force * CHORD * cm / IYY
        return np.array([ax - G * math.sin(theta) - q * w, az + G * math.cos(theta) + q * u, turn, q]), ax, az, v

    x = np.array([SPEED * math.cos(alpha), SPEED * math.sin(alpha), 0.0, alpha])
    for i in range(len(t)):
        j = min(i + 1, len(t) - 1)
        half = [0.5 * (y[i] + y[j]) for y in (elevator, wing, tail)]
        k1, ax, az, v = rates(x, elevator[i], wing[i], tail[i])
        rows[i] = *x, ax, az, v, elevator[i]
        k2 = rates(x + 0.5 * FINE * k1, *half)[0]
        k3 = rates(x + 0.5 * FINE * k2, *half)[0]
        k4 = rates(x + FINE * k3, elevator[j], wing[j], tail[j])[0]
        x = x + FINE / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    u, w, q, theta, ax_, az_, v_, e_ = rows.T
    flow = (1 + UPWASH) * np.arctan2(w - q * BOOM + vane, u)
    natural = 2 * np.pi * 9.0
    _, shown, _ = signal.lsim(([natural**2], [1, 2 * 0.35 * natural, natural**2]), flow - flow[0], t)
    columns = {
        "alpha_vane": case.scale * np.interp(t - case.late, t, shown + flow[0]), "q": q + case.gyro,
        "theta": theta, "ax": ax_, "az": az_, "airspeed": v_, "dynamic_pressure": 0.5 * DENSITY * v_**2, "elevator": e_,
        "v_north": u * np.cos(theta) + w * np.sin(theta), "v_down": w * np.cos(theta) - u * np.sin(theta),
    }  # fmt: skip
    every = round(DT / FINE)
    return t[::every], {
        name: y[::every] + NOISE[name] * rng.standard_normal(len(t[::every])) for name, y in columns.items()
    }
