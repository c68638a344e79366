"""A calibration as station.calibrate/1, the JSON that `calibrate --json` writes: SI and radians."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from station.programme.calibration import Calibration, Constant
from station.programme.calibration_blocks import Run

SCHEMA: Final = "station.calibrate/1"

Json = dict[str, Any]


def as_json(made: Calibration) -> Json:
    """None for what is not known."""
    steady, motion = made.steady, made.motion
    low, high = made.speeds
    speeds = np.linspace(low, high, 9)
    error, sd = steady.error_at(speeds)
    return {
        "schema": SCHEMA,
        "aircraft": made.aircraft.name,
        "logs": [str(p) for p in made.logs],
        "constants": {n: _constant(c) for n, c in made.constants.items()},
        "position_error": {
            "reference_speed_mps": steady.speed,
            "speed_mps": speeds.tolist(),
            "error_mps": error.tolist(),
            "std_error_mps": sd.tolist(),
        },
        "wind": {
            "walk_mps_per_minute": steady.walk,
            "time_s": made.flown.blocks.time.tolist(),
            "north_mps": steady.wind[:, 0].tolist(),
            "east_mps": steady.wind[:, 1].tolist(),
        },
        "gusts_mps": {
            "along": math.hypot(*steady.noise["airspeed"][1:]),
            "across": math.hypot(*steady.noise["alpha_vane"][1:]) * steady.speed,
        },
        "manoeuvres_s": motion.seconds if motion else 0.0,
        "runs": [_run(r) for r in made.runs],
        "remarks": list(made.remarks),
    }


def _constant(c: Constant) -> Json:
    return {
        "estimate": c.value if c.is_told else None,
        "std_error": c.sd if c.is_told else None,
        "ci95": list(c.ci95) if c.is_told else None,
        "unit": c.unit,
        "profile_key": c.key,
        "before": c.before,
        "status": "estimated" if c.is_told else "unestimated",
        "why": c.why,
    }


def _run(r: Run) -> Json:
    return {
        "log": r.log,
        "kind": r.kind,
        "interval_s": [r.start_s, r.end_s],
        "airspeed_mps": r.speed,
        "track_rad": r.heading if math.isfinite(r.heading) else None,
        "bank_rad": r.bank,
        "mass_kg": r.mass if math.isfinite(r.mass) else None,
    }
