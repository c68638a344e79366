"""NASA's Twin Otter records against what SIDPAC made of them (shared reference, kept outside the repository)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from records import record as kept
from scipy.io import loadmat

from station.conventions import UNITS
from station.estimation.published import sidpac
from station.model.coefficients import Airframe, Array, Coefficients, coefficients
from station.numerics.regression import Fit, least_squares, smoothed_start

LONGITUDINAL = ("totter_demo_data", "totter_pred_data")
GRIDS = {"rtpid_36": sidpac.GRID_36, "rtpid_191": sidpac.GRID_191}


@cache
def reference() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(kept("reference.json").read_text())
    return found


@dataclass(frozen=True)
class Record:
    dt: float
    motion: dict[str, Array]
    airframe: Airframe
    stored: dict[str, Array]

    @property
    def coefficients(self) -> Coefficients:
        return coefficients(self.motion, self.airframe, self.motion["alpha_vane"], self.dt)


@cache
def record(name: str) -> Record:
    """An fdata file in SI; SIDPAC's g is 32.174 ft/s2 exactly."""
    mat = loadmat(kept(f"twin_otter/{name}.mat"))
    fdata = mat["fdata"]

    def channel(number: int, unit: str) -> Array:
        column: Array = fdata[:, number - 1] * UNITS[unit].factor
        return column

    g = {n: fdata[:, n - 1] * 32.174 * UNITS["ft"].factor for n in (11, 12, 13)}
    motion = {
        "airspeed": channel(2, "ft/s"),
        "beta_vane": channel(3, "deg"),
        "alpha_vane": channel(4, "deg"),
        **{s: channel(i, "deg/s") for s, i in (("p", 5), ("q", 6), ("r", 7))},
        **{s: channel(i, "deg/s2") for s, i in (("pdot", 42), ("qdot", 43), ("rdot", 44))},
        "ax": g[11],
        "ay": g[12],
        "az": g[13],
        "elevator": channel(14, "deg"),
        "aileron": channel(15, "deg"),
        "rudder": channel(16, "deg"),
        "dynamic_pressure": channel(27, "psf"),
        "thrust": sum(channel(i, "lbf") for i in (38, 39, 40, 41)),
    }
    airframe = Airframe(
        area=float(channel(77, "ft2")[0]),
        span=float(channel(78, "ft")[0]),
        chord=float(channel(79, "ft")[0]),
        mass=channel(48, "slug"),
        **{s: channel(i, "slug ft2") for s, i in (("ixx", 49), ("iyy", 50), ("izz", 51), ("ixz", 52))},
    )
    stored = {
        **{s: channel(i, "1") for s, i in (("CY", 62), ("CZ", 63), ("Cl", 64), ("Cm", 65), ("Cn", 66))},
        **{s: channel(i, "1") for s, i in (("phat", 71), ("qhat", 72), ("rhat", 73))},
    }
    return Record(float(mat["dt"][0, 0]), motion, airframe, stored)


def columns(r: Record, names: list[str], stored: bool = False) -> Array:
    c = r.coefficients
    motion = {"alpha": "alpha_vane", "beta": "beta_vane"}
    rates = {n: r.stored[n] if stored else c.named(n) for n in ("phat", "qhat", "rhat")}
    return np.column_stack([rates[n] if n in rates else r.motion[motion.get(n, n)] for n in names])


def close(ours: Any, theirs: Any, rtol: float) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=0)


def check_lesq(fit: Fit, expected: dict[str, Any], rtol: float = 1e-8) -> None:
    close(fit.estimate, expected["est"], rtol)
    if "se_white" in expected:
        close(fit.se_white, expected["se_white"], rtol)
    close(fit.se_coloured, expected["se_colored"], rtol)


def equation_error(r: Record, names: list[str], z: Array, stored: bool = False, trim: bool = True) -> tuple[Fit, Array]:
    x = columns(r, names, stored)
    start = smoothed_start(x, 1.0, r.dt) if trim else np.zeros(x.shape[1])
    return least_squares(np.column_stack([x - start, np.ones(len(x))]), z), start


@pytest.mark.parametrize("name", LONGITUDINAL)
@pytest.mark.parametrize("equation", ["CZ", "CL", "Cm", "CZ_no_q", "CL_no_q"])
def test_least_squares_gives_sidpac_s_estimates(name: str, equation: str) -> None:
    expected = reference()["twin_otter_longitudinal"][name]["lesq"][equation]
    r = record(name)
    z = r.coefficients.named(equation[:2])
    fit, start = equation_error(r, expected["par"][:-1], z)
    check_lesq(fit, expected)
    close(fit.s, expected["s"], 1e-8)
    close(fit.r2, expected["R2"], 1e-8)
    close(start, expected["trim_removed"], 1e-8)
    close(fit.se_coloured / fit.se_white, expected["corr_ratio"], 1e-8)


@pytest.mark.parametrize("name", LONGITUDINAL)
@pytest.mark.parametrize("equation", ["CZ_alpha_de_bias", "CZ_alpha_q_de_bias", "Cm_alpha_q_de_bias"])
def test_least_squares_on_the_stored_rates_gives_sidpac_s_estimates(name: str, equation: str) -> None:
    expected = reference()["totter_demo_exact_replica"][name][equation]
    names = {"alpha": "alpha", "q": "qhat", "de": "elevator"}
    regressors = [names[n] for n in equation.split("_")[1:-1]]
    r = record(name)
    fit, _ = equation_error(r, regressors, r.coefficients.named(equation[:2]), stored=True)
    check_lesq(fit, expected)


@pytest.mark.parametrize("equation", ["CZ", "Cm"])
def test_least_squares_gives_what_matlab_printed(equation: str) -> None:
    expected = reference()["matlab_saved_results_shipped_with_sidpac"][equation]
    r = record("totter_demo_data")
    fit, _ = equation_error(r, expected["par"][:-1], r.coefficients.named(equation), stored=True)
    np.testing.assert_allclose(fit.estimate, expected["est"], rtol=0, atol=6e-6)
    np.testing.assert_allclose(fit.se_coloured, expected["se_colored"], rtol=0, atol=6e-6)


@pytest.mark.parametrize("equation", ["CY", "Cl", "Cn"])
def test_lateral_least_squares_gives_sidpac_s_estimates(equation: str) -> None:
    expected = reference()["twin_otter_lateral"]["totter_f1_017"]["lesq"][equation]
    r = record("totter_f1_017_data")
    fit, start = equation_error(r, expected["par"][:-1], r.coefficients.named(equation))
    check_lesq(fit, expected)
    close(fit.r2, expected["R2"], 1e-8)
    close(start, expected["trim_removed"], 1e-7)


@pytest.mark.parametrize("equation", ["CY", "Cl", "Cn"])
def test_lateral_least_squares_of_the_stored_coefficients_gives_sidpac_s_estimates(equation: str) -> None:
    expected = reference()["twin_otter_lateral"]["totter_f1_017"]["lesq_raw_stored"][equation]
    r = record("totter_f1_017_data")
    fit, _ = equation_error(r, expected["par"][:-1], r.stored[equation], trim=False)
    check_lesq(fit, expected)


def check_history(history: sidpac.History, expected: dict[str, Any], rtol: float) -> None:
    close(history.t_s, expected["th"], rtol)
    close(history.estimate, expected["ph"], rtol)
    close(history.se, expected["seh"], rtol)
    close(history.estimate[-1], expected["est"], rtol)
    close(history.se[-1], expected["se"], rtol)


def check_rtpid(r: Record, equation: str, z: Array, expected: dict[str, Any], grid: str) -> None:
    x = columns(r, expected["par"])
    history = sidpac.recursive_fourier(x, z, r.dt, sidpac.grid(GRIDS[grid]))
    check_history(history, expected, 1e-8)
    close(history.s2, expected["s2h"], 1e-8)
    close(np.sqrt(history.s2[-1]), expected["s"], 1e-8)
    close(x[0], expected["x0_removed"], 1e-8)
    close(z[0], expected["z0_removed"], 1e-8)
    close(sidpac.r_squared(x, z, history.estimate[-1]), expected["R2_time"], 1e-8)


@pytest.mark.parametrize("name", LONGITUDINAL)
@pytest.mark.parametrize("grid", GRIDS)
def test_the_recursive_fourier_transform_gives_sidpac_s_history(name: str, grid: str) -> None:
    expected = reference()["twin_otter_longitudinal"][name][grid]
    first, step, last = expected["f_hz_start_step_end"]
    f = sidpac.grid(GRIDS[grid])
    close([f[0], f[1] - f[0], f[-1]], [first, step, last], 1e-12)
    r = record(name)
    for equation in (e for e in expected if e.startswith("C")):
        check_rtpid(r, equation, r.coefficients.named(equation[:2]), expected[equation], grid)


@pytest.mark.parametrize("equation", ["CY", "Cl", "Cn"])
def test_the_lateral_recursive_fourier_transform_gives_sidpac_s_history(equation: str) -> None:
    expected = reference()["twin_otter_lateral"]["totter_f1_017"]["rtpid_36"][equation]
    r = record("totter_f1_017_data")
    check_rtpid(r, equation, r.coefficients.named(equation), expected, "rtpid_36")


@pytest.mark.parametrize("name", LONGITUDINAL)
def test_appendix_1_gives_the_dissertation_s_estimates(name: str) -> None:
    expected = reference()["twin_otter_longitudinal"][name]["appendix1_own"]
    r = record(name)
    f = sidpac.grid(sidpac.GRID_191)
    for equation in ("CZ", "CL"):
        history = sidpac.appendix1(columns(r, expected[equation]["par"]), r.coefficients.named(equation), r.dt, f)
        check_history(history, expected[equation], 1e-6)
    a, m = r.airframe, r.motion
    force = 1 / (m["dynamic_pressure"] * a.area * a.chord)
    rest = ((m["p"] ** 2 - m["r"] ** 2) * a.ixz + (a.ixx - a.izz) * m["p"] * m["r"]) * force
    x = columns(r, expected["Cm"]["par"])
    check_history(sidpac.appendix1_moment(x, m["q"] * a.iyy * force, rest, r.dt, f), expected["Cm"], 1e-6)


@pytest.mark.parametrize("name", LONGITUDINAL)
def test_a_delayed_alpha_gives_the_dissertation_s_estimates(name: str) -> None:
    r = record(name)
    x = columns(r, ["alpha", "qhat", "elevator"])
    t = np.arange(len(x)) * r.dt
    for case in reference()["alpha_delay_sensitivity"][name]:
        moved = x.copy()
        moved[:, 0] = np.interp(t - case["tau_s"], t, x[:, 0])
        for equation in ("CL", "Cm"):
            f = sidpac.grid(sidpac.GRID_191)
            history = sidpac.recursive_fourier(moved, r.coefficients.named(equation), r.dt, f)
            close(history.estimate[-1], case[equation], 1e-6)
            close(history.se[-1], case[f"{equation}_se"], 1e-6)
