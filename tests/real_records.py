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
_ATTAS: Final = {
    "ax [m/s2]": 2, "ay [m/s2]": 3, "az [m/s2]": 4, "p [deg/s]": 7, "q [deg/s]": 8, "r [deg/s]": 9,
    "phi [deg]": 10, "theta [deg]": 11, "psi [deg]": 12, "alpha_vane [deg]": 13, "beta_vane [deg]": 14,
    "airspeed [m/s]": 15, "altitude [ft]": 16, "elevator [deg]": 22, "aileron [deg]": 28, "rudder [deg]": 30,
    "air_temperature [K]": 32,
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
    "airspeed [m/s]": "vtas", "elevator [rad]": "de", "v_north [m/s]": "u_n", "v_east [m/s]": "v_n",
    "v_down [m/s]": "w_n",
}  # fmt: skip
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
    return {"time [s]": np.round(time, 6)} | {title: columns[:, n - 1] for title, n in _ATTAS.items()}


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


def write_csv(columns: dict[str, np.ndarray], path: Path) -> Path:
    """As `station import` reads it."""
    np.savetxt(path, np.column_stack(list(columns.values())), "%.9g", ",", header=",".join(columns), comments="")
    return path
