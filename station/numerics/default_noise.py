"""Noise that a sensor is taken to have where the rig states none: standard deviations of a 50 Hz frame, by signal.

Those of a good flight-test installation: enough that the estimates' errors are not too small, and no filter waits for
more than a sensor shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from station.conventions import to_si

_VANE: Final = to_si(0.05, "deg")
"""A low-friction vane on a potentiometer or encoder of 12 bits over a turn: 0.09 deg steps, 0.025 deg rms, and the
friction that lets it stay within a step."""
_SURFACE: Final = to_si(0.02, "deg")
"""A string potentiometer of 12 bits over 60 deg of travel: 0.015 deg steps, and its cable."""
_RATE: Final = to_si(0.03, "deg/s")
"""A MEMS gyro of 0.005 deg/s/sqrt(Hz) in the 25 Hz of a frame; the same part measures all three."""
_ATTITUDE: Final = to_si(0.03, "deg")
"""What an attitude filter leaves of gyro and accelerometer noise, sample to sample."""
_VELOCITY: Final = to_si(0.1, "ft/s")
"""Doppler velocity of a GPS receiver, 0.03 m/s."""

DEFAULT_NOISE: Final[Mapping[str, float]] = MappingProxyType(
    {
        "alpha_vane": _VANE,
        "beta_vane": _VANE,
        "elevator": _SURFACE,
        "aileron": _SURFACE,
        "rudder": _SURFACE,
        "p": _RATE,
        "q": _RATE,
        "r": _RATE,
        "phi": _ATTITUDE,
        "theta": _ATTITUDE,
        "psi": _ATTITUDE,
        # The structure's vibration, more of it along the normal axis.
        "ax": to_si(0.002, "g"),
        "ay": to_si(0.002, "g"),
        "az": to_si(0.004, "g"),
        "v_north": _VELOCITY,
        "v_east": _VELOCITY,
        "v_down": _VELOCITY,
        # A differential pressure sensor of 6 Pa, and what that is in airspeed at 110 kt.
        "airspeed": to_si(0.3, "ft/s"),
        "dynamic_pressure": to_si(0.12, "psf"),
    }
)
