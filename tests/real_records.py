"""Real records that came in layouts of their own, as the station's CSV: what a user writes to import such a file.

Columns and constants as published (tests/records.toml says by whom). Time in s from the record's first row.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from records import record
from scipy.io import loadmat

ATTAS_BOOM: Final = (13.080, -0.010, -0.027)
"""m from the CG: of the flow vanes and the airspeed in the elevator, aileron and rudder records."""
ATTAS_IMU: Final = (-1.010, 0.886, 0.103)
"""m from the CG: of the accelerometers, in all its records, whose columns are called "at CG": the book's programs move
them from there, and only so the elevator's lift and moment have the tail's arm."""
ATTAS_FRAME: Final = {
    "wing_area": 64.0, "span": 21.5, "chord": 3.159, "mass": 17631.0, "ixx": 133367.0, "iyy": 252687.0, "izz": 359593.0,
    "ixz": 11442.0, "thrust_pitch_arm": -0.652,
}  # fmt: skip
ATTAS_KNOWN: Final = {
    "fAttasElv1": {"CL_alpha": 5.382, "CL_q": 2 * 3.75, "CL_de": 0.470, "Cm_alpha": -0.975, "Cm_q": 2 * -11.6,
                   "Cm_de": -1.414},
    "fAttasElv2": {"CL_alpha": 5.373, "CL_q": 2 * 3.49, "CL_de": 0.461, "Cm_alpha": -0.925, "Cm_q": 2 * -11.8,
                   "Cm_de": -1.394},
}  # fmt: skip
"""By least squares made apart from the station, moments about the book's reference point, 2 cm behind the CG; c/2V."""
_ATTAS: Final = {
    "ax [m/s2]": 2, "ay [m/s2]": 3, "az [m/s2]": 4, "p [deg/s]": 7, "q [deg/s]": 8, "r [deg/s]": 9,
    "phi [deg]": 10, "theta [deg]": 11, "psi [deg]": 12, "alpha_vane [deg]": 13, "beta_vane [deg]": 14,
    "airspeed [m/s]": 15, "altitude [ft]": 16, "elevator [deg]": 22, "rudder [deg]": 30,
    "air_temperature [K]": 32, "static_pressure [hPa]": 33,
}  # fmt: skip
_PHLAB: Final = {
    "alpha_vane [deg]": "vane_AOA", "elevator [deg]": "delta_e", "phi [deg]": "Ahrs1_Roll",
    "theta [deg]": "Ahrs1_Pitch",
    "p [deg/s]": "Ahrs1_bRollRate", "q [deg/s]": "Ahrs1_bPitchRate", "r [deg/s]": "Ahrs1_bYawRate",
    "ax [g]": "Ahrs1_bLongAcc", "ay [g]": "Ahrs1_bLatAcc", "airspeed [kt]": "Dadc1_tas", "altitude [ft]": "Dadc1_alt",
}  # fmt: skip
_DASMAT: Final = {
    "ax [m/s2]": "Ax", "ay [m/s2]": "Ay", "az [m/s2]": "Az", "p [rad/s]": "p", "q [rad/s]": "q", "r [rad/s]": "r",
    "phi [rad]": "phi", "theta [rad]": "theta", "psi [rad]": "psi", "alpha_vane [rad]": "alpha",
    "beta_vane [rad]": "beta",
    "airspeed [m/s]": "vtas", "elevator [rad]": "de", "aileron [rad]": "da", "rudder [rad]": "dr",
    "v_north [m/s]": "u_n", "v_east [m/s]": "v_n", "v_down [m/s]": "w_n",
}  # fmt: skip
_PHLAB_MASS_KG: Final = 6700.0
"""At engine start, by estimate: the operating empty mass and block fuel of such a flight; less the fuel used."""
NOISE: Final = {
    "ax": 0.02, "ay": 0.02, "az": 0.04, "p": 5e-4, "q": 5e-4, "r": 5e-4, "phi": 5e-4, "theta": 5e-4, "psi": 5e-4,
    "alpha_vane": 9e-4, "beta_vane": 9e-4, "airspeed": 0.1, "v_north": 0.03, "v_east": 0.03, "v_down": 0.03,
}  # fmt: skip
"""White, SI, 50 to 100 Hz: of a good flight-test installation."""
ALTITUDE_M: Final = 2000.0


def attas(name: str) -> dict[str, np.ndarray]:
    """Of the DLR ATTAS, such as "fAttasElv1": 25 Hz, vanes on the nose boom."""
    contents = loadmat(record(f"attas/{name}.mat"))
    columns = next(x for n, x in contents.items() if not n.startswith("__"))
    time = columns[:, 0] - columns[0, 0]
    made = {"time [s]": np.round(time, 6)} | {title: columns[:, n - 1] for title, n in _ATTAS.items()}
    made["aileron [deg]"] = (columns[:, 28] - columns[:, 27]) / 2  # right and left, as the book's test case 1
    made["thrust [N]"] = columns[:, 36] + columns[:, 37]
    return made


def attas_stall(start: float = 0.0, end: float = 120.0) -> dict[str, np.ndarray]:
    """Of its quasi-steady stall, between two times (s). The vane is the boom's here too: against pitch rate, attitude
    and accelerations it sits 15 m ahead, as in the elevator records. Altitude in m, thrust of both engines, mass less
    the fuel used since the elevator records."""
    columns = np.loadtxt(record("attas/fAttas_qst01.asc"))
    columns = columns[(columns[:, 0] >= start - 1e-6) & (columns[:, 0] <= end + 1e-6)]
    made = {"time [s]": np.round(columns[:, 0] - columns[0, 0], 6)}
    made |= {title.replace("[ft]", "[m]"): columns[:, n - 1] for title, n in _ATTAS.items()}
    made["thrust [N]"] = columns[:, 36] + columns[:, 37]
    made["mass [kg]"] = 17631.0 - (columns[:, 38] - 499.0)
    return made


def phlab(start: float = -np.inf, end: float = np.inf) -> dict[str, np.ndarray]:
    """Of the Cessna Citation PH-LAB, between two times of its own axis (s): 10 Hz. Its normal acceleration is in g,
    upwards and without gravity, and its altitude rate in ft/min upwards."""
    stored = np.load(record("phlab/flight_2019-03-12.npz"))
    steps = {n.split("__x")[0]: n for n in stored.files}

    def column(name: str) -> np.ndarray:
        key = steps[name]
        return stored[key] * float(key.split("__x")[1]) if "__x" in key else stored[key]

    time = column("time")
    rows = (time >= start) & (time <= end)
    made = {"time [s]": np.round(time[rows], 3)} | {title: column(n)[rows] for title, n in _PHLAB.items()}
    made["az [g]"] = -1.0 - column("Ahrs1_bNormAcc")[rows]
    made["v_down [m/s]"] = -column("Dadc1_altRate")[rows] * 0.3048 / 60
    made["mass [kg]"] = _PHLAB_MASS_KG - 0.45359237 * (column("lh_engine_FU") + column("rh_engine_FU"))[rows]
    return made


def dasmat(name: str, noise: float = 0.0, seed: int = 1) -> dict[str, np.ndarray]:
    """Of the DASMAT Citation simulation, such as "de3211_1": 100 Hz, forces at the CG, with `noise` times NOISE."""
    stored = np.load(record(f"dasmat/{name}.npz"))
    rng = np.random.default_rng(seed)
    made = {"time [s]": np.round(stored["t"], 6)} | {t: stored[n].astype(float) for t, n in _DASMAT.items()}
    for title in made:
        made[title] = made[title] + noise * NOISE.get(title.split(" ")[0], 0.0) * rng.standard_normal(len(made[title]))
    made["altitude [m]"] = np.full(len(stored["t"]), ALTITUDE_M)
    return made


COURSE: Final = {"CL_alpha": 5.7434, "CL_de": 0.69612, "Cm_alpha": -0.5626, "Cm_q": 2 * -8.79415, "Cm_de": -1.1642}
"""PH-LAB's as its course has them, CZ turned round; per c/2V. CZ_q, -5.6629 per c/V, holds the lift by alphadot."""
DHC2_SPEED: Final = 50.0
"""m/s; the record has the lateral velocity and no airspeed: any stands for it."""
DHC2: Final = {
    "p": (-5.81996, -0.664906, -0.278403), "r": (1.78187, -0.711906, 1.40995),
    "da": (-16.433794, -0.428722, -0.447117), "dr": (0.443456, -2.824319, 2.657059),
    "v": (-0.096877, 0.008438, -0.179944),
}  # fmt: skip
"""What the record was made with: roll and yaw acceleration (rad/s2) and side force (m/s2) by each, per rad/s, rad and
m/s: its own columns, whose states and accelerations have no measurement noise, obey these to their last digit."""
UNSTABLE_SPEED: Final = 44.5695
"""m/s"""
UNSTABLE: Final = {"w": (-1.4249, 0.2163), "q": (-1.4768, -3.7067), "de": (-6.2632, -12.784)}
"""What the record was made with: vertical (m/s2) and pitch acceleration (rad/s2) by each (Jategaonkar 2015, table 9.1;
the vertical ones are least squares' on the record, to its last digit)."""


def dhc2() -> dict[str, np.ndarray]:
    """DHC-2, simulated in turbulence, 20 Hz: lateral motion alone, so that the longitudinal columns stand still."""
    columns = np.loadtxt(record("attas/y13aus_da1.asc"))
    n = len(columns)
    made = {"time [s]": np.round(0.05 * np.arange(n), 6)}
    picked = {"pdot [rad/s2]": 12, "rdot [rad/s2]": 13, "ay [m/s2]": 14, "p [rad/s]": 15, "r [rad/s]": 16,
              "aileron [rad]": 17, "rudder [rad]": 18}  # fmt: skip
    made |= {title: columns[:, k - 1] for title, k in picked.items()}
    made["beta_vane [rad]"] = columns[:, 18] / DHC2_SPEED
    level = {"airspeed [m/s]": DHC2_SPEED, "alpha_vane [rad]": 0.0, "q [rad/s]": 0.0, "ax [m/s2]": 0.0,
             "az [m/s2]": -9.80665, "elevator [rad]": 0.0, "altitude [m]": 0.0}  # fmt: skip
    return made | {title: np.full(n, x) for title, x in level.items()}


def unstable() -> dict[str, np.ndarray]:
    """An unstable aircraft, simulated, that angle of attack fed to the elevator keeps in the air; 20 Hz."""
    time, _, w, q, elevator, az = np.loadtxt(record("attas/unStabAC_sim.asc")).T
    n = len(time)
    return {
        "time [s]": np.round(time, 6), "alpha_vane [rad]": w / UNSTABLE_SPEED, "q [rad/s]": q,
        "elevator [rad]": elevator, "az [m/s2]": az - 9.80665, "ax [m/s2]": np.zeros(n),
        "airspeed [m/s]": np.full(n, UNSTABLE_SPEED),
        "altitude [m]": np.zeros(n),
    }  # fmt: skip


def fdata(path: Path) -> dict[str, np.ndarray]:
    """Channels of a SIDPAC file that equation error is made of."""
    rows = loadmat(path)["fdata"]
    picked = {"time [s]": 1, "airspeed [ft/s]": 2, "alpha_vane [deg]": 4, "p [deg/s]": 5, "q [deg/s]": 6,
              "r [deg/s]": 7, "ax [g]": 11, "ay [g]": 12, "az [g]": 13, "elevator [deg]": 14, "altitude [ft]": 30,
              "qdot [deg/s2]": 43}  # fmt: skip
    return {title: rows[:, n - 1] for title, n in picked.items()}


def write_csv(columns: dict[str, np.ndarray], path: Path) -> Path:
    """As `station import` reads it."""
    np.savetxt(path, np.column_stack(list(columns.values())), "%.9g", ",", header=",".join(columns), comments="")
    return path
