"""Profiles that a user writes for records whose aircraft the station does not ship, and least squares to hold its
results against.

`regression` shares no line with the station: forces and moments of the recorded motion by Newton and Euler, ordinary
least squares with a constant. Where a simulation states no derivatives, that on its noise-free record stands for them;
where a published program's result is its own least squares, that is it.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Final

import numpy as np
from real_records import DHC2, DHC2_SPEED, UNSTABLE, UNSTABLE_SPEED
from scipy.signal import lfilter

STILL: Final = 1e-9
"""rad: what moves less stands still."""
ACTUATED: Final = """
[instruments.elevator]     # its records have the actuators' commands
lag = "-0.085 s"
[instruments.rudder]
lag = "-0.085 s"
"""
ATTAS: Final = Path(__file__).parents[1] / "profiles" / "aircraft" / "attas.toml"
SEA_LEVEL_DENSITY: Final = 1.225
PROFILES: Final = {
    "tu144": """
name = "tu144"             # geometry, mass and inertia are the record's own; a delta's drag, by handbook
[geometry]
wing_area = "6760 ft2"
span = "94.5 ft"
chord = "76.5 ft"
[inertia]
mass = "10021 slug"
ixx = "1207878 slug ft2"
iyy = "13655759 slug ft2"
izz = "14640171 slug ft2"
ixz = "-139286 slug ft2"
[drag]
zero_lift = 0.012
induced = 0.2
""",
    "citation": """
name = "citation"          # a simulation's; its mass and inertia are not stated: any scale all derivatives alike
[geometry]
wing_area = "30 m2"
span = "15.9 m"
chord = "2.057 m"
[inertia]
mass = "4500 kg"
ixx = "17000 kg m2"
iyy = "27000 kg m2"
izz = "40000 kg m2"
[drag]
zero_lift = 0.02
induced = 0.05
[uncertainty]
mass = 0.0
recorded_mass = 0.0
inertia = 0.0
""",
    "dhc2": """
name = "dhc2"              # a simulation's accelerations: mass, inertia and lengths only scale its derivatives
[geometry]
wing_area = "23.2 m2"
span = "14.6 m"
chord = "1.59 m"
[inertia]
mass = "2200 kg"
ixx = "5400 kg m2"
iyy = "6800 kg m2"
izz = "11000 kg m2"
[uncertainty]
mass = 0.0
inertia = 0.0
""",
    "unstable": """
name = "unstable"          # as dhc2
[geometry]
wing_area = "20 m2"
span = "10 m"
chord = "2 m"
[inertia]
mass = "1500 kg"
iyy = "3000 kg m2"
[uncertainty]
mass = 0.0
inertia = 0.0
""",
    "phlab": """
name = "phlab"   # Cessna Citation II, lengths and radius of gyration as its course has them; where its vane is: a guess
[geometry]
wing_area = "30.00 m2"
span = "15.911 m"
chord = "2.0569 m"
[inertia]
mass = "6500 kg"
iyy = "38300 kg m2"
[boom]
vane_x = "4 m"
[drag]
zero_lift = 0.04
induced = 0.047
[instruments.alpha_vane]   # what identify tells of the whole flight
latency = "0.29 s"
gain = 1.07
""",
}
SI: Final = {
    "ft2": 0.3048**2, "ft": 0.3048, "slug": 14.593903, "slug ft2": 14.593903 * 0.3048**2, "deg": np.pi / 180,
    "deg/s": np.pi / 180, "deg/s2": np.pi / 180, "ft/s": 0.3048, "kt": 0.514444, "g": 9.80665, "hPa": 100.0,
}  # fmt: skip


NUMBER: Final = re.compile(r'^(\w+) = "?([-\d.]+) ?([\w ]*)"?', re.MULTILINE)


def profile(name: str, folder: Path) -> str:
    """What `--aircraft` takes: a name that the station ships, or the path of a profile written into `folder`."""
    text = PROFILES.get(name)
    if name == "attas_vane_at_cg":
        text = ATTAS.read_text().replace('vane_x = "13.080 m"', 'vane_x = "0 m"')
    if name == "citation_actuated":
        text = PROFILES["citation"] + ACTUATED
    if text is None:
        return name
    path = folder / f"{name}.toml"
    path.write_text(text)
    return str(path)


def frame(name: str) -> dict[str, float]:
    """The numbers of a profile, SI."""
    found = {}
    for key, value, unit in NUMBER.findall(PROFILES[name].split("[uncertainty]")[0]):
        found[key] = float(value) * SI.get(unit, 1.0)
    return found


Sides = dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]
"""Of each coefficient: itself (n,), and what it is regressed on, by its derivative's mark."""


def regression(*sides: Sides) -> dict[str, float]:
    """Derivatives by name, of one manoeuvre or of several, each with a constant of its own."""
    found = {}
    for coefficient in sides[0]:
        marks = list(sides[0][coefficient][1])
        blocks, values = [], []
        for k, each in enumerate(sides):
            z, regressors = each[coefficient]
            inside = slice(3, len(z) - 3)  # the slopes' ends
            own = np.zeros((len(z), len(sides)))
            own[:, k] = 1.0
            blocks.append(np.column_stack([*(regressors[m] for m in marks), own])[inside])
            values.append(z[inside])
        estimate = np.linalg.lstsq(np.vstack(blocks), np.concatenate(values), rcond=None)[0]
        found |= {f"{coefficient}_{m}": float(e) for m, e in zip(marks, estimate, strict=False)}
    return found


def actuated(columns: dict[str, np.ndarray], f: dict[str, float], surface: str, mark: str) -> dict[str, np.ndarray]:
    """With the surface where its actuator has it, where a record has the actuator's command: a first-order lag, of
    those in steps of 5 ms the one that leaves least of the moment that the surface makes."""
    title = f"{surface} [rad]"
    command, dt = columns[title], columns["time [s]"][1] - columns["time [s]"][0]

    def followed(lag: float) -> dict[str, np.ndarray]:
        keep = math.exp(-dt / lag)
        return columns | {title: lfilter([1 - keep], [1, -keep], command - command[0]) + command[0]}

    def left(lag: float) -> float:
        z, regressors = sides(followed(lag), f)[mark]
        x = np.column_stack([*regressors.values(), np.ones(len(z))])[3:-3]
        return float(np.linalg.lstsq(x, z[3:-3], rcond=None)[1][0])

    return followed(min(np.arange(0.005, 0.2, 0.005), key=left))


def sides(
    columns: dict[str, np.ndarray],
    f: dict[str, float],
    arm: float = 0.0,
    imu: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Sides:
    """Both sides of the equations of a record: columns such as tests/real_records.py makes.

    `arm`: of the vane ahead of the CG, m; `imu`: the accelerometers' place; `f`: of `frame`, with the air's density.
    """
    x = {t.split(" ")[0]: c * SI.get(t.split("[")[1][:-1], 1.0) for t, c in columns.items()}
    n, dt, v = len(x["time"]), x["time"][1] - x["time"][0], x["airspeed"]
    zero = np.zeros(n)
    p, q, r = (x.get(k, zero) for k in "pqr")
    pdot, qdot, rdot = (x[f"{k}dot"] if f"{k}dot" in x else _slope(w, dt) for k, w in (("p", p), ("q", q), ("r", r)))
    a, b, c = imu
    ax = x["ax"] + a * (q**2 + r**2) - b * (p * q - rdot) - c * (p * r + qdot)
    ay = x.get("ay", zero) - a * (p * q + rdot) + b * (p**2 + r**2) - c * (q * r - pdot)
    az = x["az"] - a * (p * r - qdot) - b * (q * r + pdot) + c * (p**2 + q**2)
    alpha, beta = x["alpha_vane"] + arm * q / v, x.get("beta_vane", zero) - arm * r / v
    force, mass = 0.5 * f["density"] * v**2 * f["wing_area"], f["mass"]
    push = x.get("thrust", zero)
    if "zero_lift" in f:  # not recorded: what the drag polar leaves over, constant
        cz = mass * az / force
        drag = f["zero_lift"] + f["induced"] * cz**2
        push = np.full(n, np.mean(mass * ax + force * (drag * np.cos(alpha) + cz * np.sin(alpha))))
    ixx, iyy, izz, ixz = (f.get(k, 0.0) for k in ("ixx", "iyy", "izz", "ixz"))
    cx, cz = (mass * ax - push) / force, mass * az / force
    pitch = iyy * qdot + ixz * (p**2 - r**2) + (ixx - izz) * p * r - push * f.get("thrust_pitch_arm", 0.0)
    roll = ixx * pdot - ixz * (rdot + p * q) + (izz - iyy) * q * r
    yaw = izz * rdot - ixz * (pdot - q * r) + (iyy - ixx) * p * q
    # Over a long manoeuvre the speed changes what a simulation's tables give.
    long = {"alpha": alpha, "q": q * f["chord"] / (2 * v), "de": x["elevator"], "V": v / v.mean() - 1}
    long = {k: w for k, w in long.items() if k != "V" or "tables" in f}
    side = {"beta": beta, "p": p * f["span"] / (2 * v), "r": r * f["span"] / (2 * v),
            "da": x.get("aileron", zero), "dr": x.get("rudder", zero)}  # fmt: skip
    side = {k: w for k, w in side.items() if np.ptp(w) > STILL}
    made = {"CL": (cx * np.sin(alpha) - cz * np.cos(alpha), long), "Cm": (pitch / (force * f["chord"]), long),
            "CY": (mass * ay / force, side), "Cl": (roll / (force * f["span"]), side),
            "Cn": (yaw / (force * f["span"]), side)}  # fmt: skip
    return {k: v for k, v in made.items() if v[1]}


def dimensionless(
    of: dict[str, tuple[float, ...]], forces: tuple[tuple[str, float], ...], speed: float, length: float
) -> dict[str, float]:
    """Derivatives of what accelerations by each motion are made of. `forces`: each coefficient and what it is per unit
    of its acceleration; `length`: chord or span."""
    per = {"p": 2 * speed / length, "q": 2 * speed / length, "r": 2 * speed / length, "w": speed, "v": speed}
    marks = {"w": "alpha", "v": "beta"}
    return {
        f"{coefficient}_{marks.get(motion, motion)}": unit * per.get(motion, 1.0) * values[i]
        for motion, values in of.items()
        for i, (coefficient, unit) in enumerate(forces)
    }


def known_of_dhc2() -> dict[str, float]:
    """What the DHC-2's record was made with, by the profile's lengths and mass."""
    f = frame("dhc2")
    force = 0.5 * SEA_LEVEL_DENSITY * DHC2_SPEED**2 * f["wing_area"]
    units = ("Cl", f["ixx"] / (force * f["span"])), ("Cn", f["izz"] / (force * f["span"])), ("CY", f["mass"] / force)
    return dimensionless(DHC2, units, DHC2_SPEED, f["span"])


def known_of_unstable() -> dict[str, float]:
    """What the unstable aircraft's record was made with; lift is up, its az down."""
    f = frame("unstable")
    force = 0.5 * SEA_LEVEL_DENSITY * UNSTABLE_SPEED**2 * f["wing_area"]
    units = ("CL", -f["mass"] / force), ("Cm", f["iyy"] / (force * f["chord"]))
    return dimensionless(UNSTABLE, units, UNSTABLE_SPEED, f["chord"])


def _slope(x: np.ndarray, dt: float) -> np.ndarray:
    """Fourth-order central difference."""
    made = np.gradient(x, dt)
    made[2:-2] = (x[:-4] - 8 * x[1:-3] + 8 * x[3:-1] - x[4:]) / (12 * dt)
    return made
