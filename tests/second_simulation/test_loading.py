"""Mass and inertia beside the derivatives of their force: what scales a series with all that it is made of."""

from __future__ import annotations

import numpy as np

from station.diagnosis import null_fit
from tests.second_simulation.fitted import fitted

PITCHING = ("Cm_alpha", "Cm_q", "Cm_de")


def test_inertia_and_moment_are_not_scaled_down_together() -> None:
    """The inertia is the profile's. While noise was taken not to follow the parameters, less of both was less noise:
    the fit ended 22 % low in inertia and moment, 8 standard deviations off, at a cost 30 above this."""
    problem, flights = fitted(8, 22, hidden=False)
    null, true = null_fit.null(problem), flights[0].answers["deviations"]
    sd = np.sqrt(np.diag(null.solved.covariance))
    names = [f.name for f in problem.frees]
    for name, wanted in {"inertia": true["inertia.scale"], **{n: true[f"aero.{n}"] for n in PITCHING}}.items():
        at = names.index(name)
        off = null.state.a[at] - wanted / problem.frees[at].sd
        assert abs(off) < 3 * sd[at], name
        assert abs(off) * problem.frees[at].sd < 0.06, name
