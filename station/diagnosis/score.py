"""Gradient and information of Q, corrected for the noise in the slopes.

Slopes de/dtheta are made of measured signals. What noise puts into them and into the residuals alike, the mean of
(de/dtheta)* Sigma^-1 e, moves parameters however long the record: it is taken out of the gradient, and the noise's own
share of the squared slopes out of the information (Nakamura 1990, Corrected Score Function for Errors-in-Variables
Models, Biometrika 77).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.candidate import Normal, Slopes, State, numbers
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.variances import INDEPENDENT

Array = NDArray[np.float64]

WEIGHT: Final = 2 * INDEPENDENT


def normal_of(m: Manoeuvre, s: State, k: int, own: Slopes) -> Normal:
    """Normal equations of manoeuvre `k` at a state, for the parameters of its slopes `own`."""
    inverse, w, variances, response = np.linalg.inv(s.roots[k]), s.white[k], s.levels.of(k), s.responses[k]
    d = numbers(np.ascontiguousarray((inverse @ own.bins.transpose(2, 1, 0)).transpose(2, 0, 1)))
    e = own.steady / np.sqrt(m.steady_variances(variances, s.levels.zeros))
    pick, count = m.grouped.pick, np.sqrt(m.grouped.count)[:, None, None]
    within, response = inverse[pick], response[pick]
    here = within @ m.scaled(response, variances)
    there = within @ m.scaled_slopes(response, own.response, variances)
    shown = there @ np.conj(here.swapaxes(-1, -2))
    flat, said = numbers(there * count), numbers(shown * count)
    of_noise = WEIGHT * (flat @ flat.T)
    # What the residuals show of the noise in the slopes is taken out of the score: the rest scatters it.
    scatter = of_noise - WEIGHT * (said @ said.T)
    gathered = m.grouped.gathered(w)
    square = gathered @ np.conj(gathered.swapaxes(-1, -2))
    gradient = WEIGHT * (d @ numbers(w[None])[0]) + e @ s.steady[k]
    gradient -= WEIGHT * np.einsum("pgij,gji->p", shown, square, optimize=True).real
    return Normal(WEIGHT * (d @ d.T) + e @ e.T, of_noise, scatter, gradient)
