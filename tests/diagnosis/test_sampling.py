"""What a record's rate must not change: how strong a gust is told, and when a surface moved."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from blind import Case, aircraft, fly_case
from scipy import integrate

from station.conventions import to_si
from station.diagnosis import null_fit
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import Record
from station.diagnosis.procedure import gusts
from station.diagnosis.surface_sampling import late_by_sampling

SIGMA, SCALE = to_si(5, "ft/s"), to_si(1750, "ft")


def slower(record: Record, step: int) -> Record:
    kept = {n: x[::step] for n, x in record.signals.items()}
    return replace(record, signals=kept, dt=record.dt * step)


@pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.slow), 5])
def test_a_gust_is_told_as_strong_as_it_is_at_any_rate(step: int) -> None:
    """Against Dryden's spectrum of the field flown, between the frequencies judged (MIL-F-8785C 3.7.1.2)."""
    records = [slower(fly_case(Case(seed=3, effects={}, sigma=SIGMA), kind, k), step)
               for k, kind in enumerate(("doublets", "3211"))]  # fmt: skip
    problem = Problem([manoeuvre(r, aircraft()) for r in records], aircraft())
    told = math.sqrt(float(np.mean(np.square(gusts(problem, null_fit.null(problem))))))
    passing = SCALE / float(records[0].signals["airspeed"].mean())
    f = problem.manoeuvres[0].setting.frequencies

    def dryden(hertz: float) -> float:
        reach = (2 * math.pi * hertz * passing) ** 2
        return 2 * passing * (1 + 3 * reach) / (1 + reach) ** 2

    share = integrate.quad(dryden, f[0], f[-1])[0]
    # Of two minutes of gusts of 0.1 Hz and more the standard deviation scatters by 8 %.
    assert told == pytest.approx(SIGMA * math.sqrt(share), rel=0.2)


@pytest.mark.parametrize(("dt", "tau"), [(0.1, 0.05), (0.1, 0.075), (0.1, 0.15), (0.2, 0.1), (0.04, 0.06)])
def test_a_surface_seems_late_by_its_samples_as_euler_and_maclaurin_have_it(dt: float, tau: float) -> None:
    """Steps behind a lag of tau, at a place of their own between two samples: dt2/(tau sqrt(720)) over all of those."""
    rng = np.random.default_rng(1)
    t, found = np.arange(0, 60, dt), []
    for _ in range(20):
        x, at, way = 3e-4 * rng.standard_normal(len(t)), 5 + rng.uniform(0, 1), 0.05
        while at < 55:
            x += way * np.where(t > at, 1 - np.exp(-np.maximum(t - at, 0) / tau), 0)
            at, way = at + rng.uniform(0.4, 3), -way
        record = SimpleNamespace(dt=dt, signals={"elevator": x}, stated={"elevator": 3e-4})
        own: Any = SimpleNamespace(
            recorded=record, setting=SimpleNamespace(frequencies=np.arange(0.1, 0.3 / dt, 1 / 60))
        )
        found.append(late_by_sampling("elevator", own))
    # The spectrum beyond half the rate is not known: it is taken to fall as a quick and a slow actuator's does.
    assert math.sqrt(float(np.mean(np.square(found)))) == pytest.approx(dt**2 / tau / math.sqrt(720), rel=0.5)


def test_where_samples_are_slow_a_surface_may_be_late_by_them() -> None:
    record = fly_case(Case(seed=3, effects={}), "doublets", 0)
    for step, sd_s in ((5, 5e-3), (1, 0.0)):
        problem = Problem([manoeuvre(slower(record, step), aircraft())], aircraft())
        (late,) = [f.sd for f in problem.frees if f.name == "elevator sampling"] or [0.0]
        assert late == pytest.approx(sd_s, abs=3e-3)
