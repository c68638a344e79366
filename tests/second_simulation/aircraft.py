"""Aircraft of the Twin Otter's kind, drawn wider than the station takes a profile to be known; SI, rad.

Nothing here is the station's: the numbers of profile `twin_otter` are written again, from the sources that it names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

G: Final = 9.80665
FT: Final = 0.3048
SLUG: Final = 14.593903
DEG: Final = np.pi / 180

AREA: Final = 420 * FT**2
SPAN: Final = 65 * FT
CHORD: Final = 6.5 * FT
MASS: Final = 340 * SLUG
IXX, IYY, IZZ, IXZ = (x * SLUG * FT**2 for x in (17302.0, 24640.0, 38626.0, 1190.0))
TAIL_ARM: Final = 24.5 * FT
BOOM_X: Final = 5.3

LONGITUDINAL: Final = {
    "CL_alpha": 5.66, "CL_q": 19.97, "CL_de": 0.608, "Cm_alpha": -1.31, "Cm_q": -34.2, "Cm_de": -1.74,
}  # fmt: skip
"""UIUC, Smart Icing Systems."""
LATERAL: Final = {
    "CY_beta": -0.822, "CY_p": 0.102, "CY_r": 1.035, "CY_da": 0.027, "CY_dr": 0.383,
    "Cl_beta": -0.1052, "Cl_p": -0.528, "Cl_r": 0.192, "Cl_da": -0.2117, "Cl_dr": 0.0298,
    "Cn_beta": 0.0855, "Cn_p": -0.0514, "Cn_r": -0.1973, "Cn_da": 0.0024, "Cn_dr": -0.1304,
}  # fmt: skip
"""Least squares on NASA's record totter_f1_017."""
LATERAL_SD: Final = {
    "CY_beta": 0.024, "CY_p": 0.091, "CY_r": 0.083, "CY_da": 0.030, "CY_dr": 0.042,
    "Cl_beta": 0.0025, "Cl_p": 0.010, "Cl_r": 0.008, "Cl_da": 0.0034, "Cl_dr": 0.0038,
    "Cn_beta": 0.0012, "Cn_p": 0.0041, "Cn_r": 0.0037, "Cn_da": 0.0013, "Cn_dr": 0.0019,
}  # fmt: skip

WAGNER: Final = {"a": (0.0766, 0.2485), "b": (0.1774, 0.5648)}
KUSSNER: Final = {"a": (0.3026, 0.6974), "b": (0.3073, 2.0716)}
UPWASH_MOTION: Final = {"a": (0.6916, 0.1875), "b": (0.3455, 0.1048)}
UPWASH_GUST: Final = {"a": (0.1985, 0.8015), "b": (0.1043, 0.3140)}
"""Indicial responses 1 - sum a exp(-b t), t in chords: of an unsteady vortex lattice, aspect ratio 10."""

SHAPES: Final = ("one lag", "strips", "elliptic")
"""How a wing's span follows a gust: an exponential, a strip after the other, or weighted with an elliptic loading."""


@dataclass(frozen=True)
class Drawn:
    """What one aircraft, its trim and its air are."""

    derivatives: dict[str, float]
    lateral: dict[str, float]
    CL_0: float
    Cm_0: float
    CD_0: float
    induced: float
    mass: float
    iyy: float
    tail_slope: float
    downwash: float
    tail_arm: float
    boom_x: float
    upwash_body: float
    upwash_wing: float
    sidewash: float
    vane_hz: float
    vane_damping: float
    memory: float
    """Amplitude of the wing's memory, times the vortex lattice's."""
    memory_rate: float
    upwash_memory: float
    upwash_rate: float
    span_lag: float
    """By b/2V."""
    span_shape: str
    speed: float
    altitude: float
    thrust_slope: float
    """d(T/T0)/d(V/V0)."""
    actuator_lag: float


def within(rng: np.random.Generator, sd: float, most: float = 2.0) -> float:
    """A normal draw, none beyond `most` standard deviations."""
    while abs(x := float(rng.standard_normal())) > most:
        pass
    return sd * x


def drawn(rng: np.random.Generator, derivative_sd: float, mass_known: bool) -> Drawn:
    """`derivative_sd`: relative, of each longitudinal derivative; trims, memories, span, boom and speed are as wide as
    profiles are wrong. `mass_known`: mass and inertia are the profile's."""
    derivatives = {n: v * (1 + within(rng, derivative_sd)) for n, v in LONGITUDINAL.items()}
    lateral = {n: v + within(rng, LATERAL_SD[n]) for n, v in LATERAL.items()}
    mass, inertia = (0.0, 0.0) if mass_known else (float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.10, 0.10)))
    return Drawn(
        derivatives=derivatives,
        lateral=lateral,
        CL_0=0.36 + float(rng.uniform(-0.3, 0.3)),
        Cm_0=0.04 + float(rng.uniform(-0.05, 0.05)),
        CD_0=0.04 * float(rng.uniform(0.75, 1.35)),
        induced=0.045 * float(rng.uniform(0.85, 1.15)),
        mass=MASS * (1 + mass),
        iyy=IYY * (1 + inertia),
        tail_slope=0.817 * float(rng.uniform(0.65, 1.35)),
        downwash=0.35 * float(rng.uniform(0.6, 1.4)),
        tail_arm=TAIL_ARM * float(rng.uniform(0.92, 1.08)),
        boom_x=BOOM_X * float(rng.uniform(0.93, 1.07)),
        upwash_body=0.070 * float(rng.uniform(0.6, 1.4)),
        upwash_wing=0.107 * float(rng.uniform(0.5, 1.5)),
        sidewash=float(rng.uniform(0.0, 0.1)),
        vane_hz=float(rng.uniform(7.0, 12.0)),
        vane_damping=float(rng.uniform(0.25, 0.5)),
        memory=float(rng.choice([0.0, rng.uniform(0.4, 1.7)], p=[0.15, 0.85])),
        memory_rate=float(rng.uniform(0.6, 1.6)),
        upwash_memory=float(rng.uniform(0.4, 1.3)),
        upwash_rate=float(rng.uniform(0.6, 1.6)),
        span_lag=float(rng.uniform(0.0, 1.0)),
        span_shape=str(rng.choice(SHAPES)),
        speed=float(rng.uniform(42.0, 72.0)),
        altitude=float(rng.uniform(300.0, 3000.0)),
        thrust_slope=float(rng.uniform(-1.2, 0.2)),
        actuator_lag=float(rng.uniform(0.03, 0.12)),
    )


@njit(cache=True)
def density(altitude: float) -> float:
    """Of the standard atmosphere's troposphere, kg/m3 (ISO 2533)."""
    return 1.225 * (1 - 0.0065 * altitude / 288.15) ** 4.2559
