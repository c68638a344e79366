"""Trim, linear dynamics and signs against numbers and identities that the equations were not written from."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import hankel2, jv

from station.numerics.atmosphere import atmosphere
from station.profile import Aircraft, Doublet, Flight, Indicial, load_aircraft
from station.rows import ProfileError
from station.simulation import Simulation
from station.simulation import airframe as ac
from station.simulation import longitudinal as eq

FT = 0.3048
SPEED, HEIGHT = 185.66 * FT, 2500 * FT
CALM = (0.0,) * 6
NO_LAG = np.zeros((2, 0))


def quasi_steady(aircraft: Aircraft) -> Aircraft:
    return aircraft.model_copy(update={"unsteady": aircraft.unsteady.model_copy(update={"memory": False})})


def derivative(c: ac.Constants, x: np.ndarray, command: float | None = None, gust=CALM, past=0.0, tables=None):
    dx = np.zeros_like(x)
    responses = ac.Tables(*(tables or (NO_LAG, NO_LAG)), NO_LAG, NO_LAG)
    asked = c.trim_elevator if command is None else command
    met = eq.Met(eq.air_at(c, x[eq.HEIGHT]), eq.Gust(*gust), 0.0, past, x[eq.ELEVATOR], asked, 1.0)
    return dx, eq.rates(c, responses, x, met, dx)


def jacobian(c: ac.Constants, x: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((n, n))
    for j in range(n):
        d = np.zeros_like(x)
        d[j] = 1e-5
        out[:, j] = (derivative(c, x + d)[0][:n] - derivative(c, x - d)[0][:n]) / 2e-5
    return out


def test_trim_at_2500_ft_and_110_kt() -> None:
    aircraft = load_aircraft("twin_otter")
    c = ac.constants(aircraft, SPEED, HEIGHT)
    dx, flow = derivative(c, eq.trimmed_state(c, 0))
    assert flow.pressure / 47.880259 == pytest.approx(38.05, rel=1e-3)
    assert c.mass * 9.80665 / (flow.pressure * c.area) == pytest.approx(0.684, abs=1e-3)
    weight_borne_by_thrust = c.trim_thrust * math.sin(c.trim_alpha) / (flow.pressure * c.area)
    assert flow.cl + weight_borne_by_thrust == pytest.approx(0.6844, abs=5e-4)
    assert np.abs(dx[[eq.U, eq.W, eq.Q, eq.THETA, eq.HEIGHT, eq.ELEVATOR, eq.THRUST]]).max() < 1e-10
    assert math.radians(2) < c.trim_alpha < math.radians(4)
    assert flow.force_z == pytest.approx(-9.80665 * math.cos(c.trim_alpha), rel=1e-9)
    assert flow.force_x == pytest.approx(9.80665 * math.sin(c.trim_alpha), rel=1e-9)


def test_standard_atmosphere() -> None:
    pressure, temperature, density = atmosphere(HEIGHT)
    assert density / 515.378818 == pytest.approx(0.002208, rel=2e-4)
    assert atmosphere(5000.0)[0] == pytest.approx(54019.9, rel=1e-4)
    assert temperature == pytest.approx(283.197, abs=1e-3)
    assert pressure / 101325 == pytest.approx(0.9129, rel=2e-4)
    # ISO 2533, 15,000 m: 120.446 hPa, 216.65 K, 0.193674 kg/m3.
    np.testing.assert_allclose(atmosphere(15_000.0), (12_044.6, 216.65, 0.193674), rtol=1e-5)


@pytest.mark.parametrize("height", [762.0, 12_192.0])
def test_the_density_s_slope_is_that_of_the_atmosphere(height: float) -> None:
    c = ac.constants(load_aircraft("twin_otter").model_copy(update={"air_density": None}), 110.0, 762.0)
    _, density, slope = eq.air_at(c, height)
    there = [atmosphere(height + dz)[2] for dz in (-1.0, 1.0)]
    assert density == pytest.approx(0.5 * sum(there), rel=1e-6)
    assert slope == pytest.approx(0.5 * (there[1] - there[0]), rel=1e-4)


def test_an_aircraft_without_drag_is_trimmed_without_thrust() -> None:
    bare = load_aircraft("twin_otter").model_copy(update={"drag": None})
    trim = ac.find_trim(bare, 56.6, 762.0)
    assert trim.thrust == pytest.approx(0.0, abs=1e-3)
    assert trim.lift_coefficient == pytest.approx(0.684, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "frequency", "damping"), [("twin_otter_martos", 3.38, 0.79), ("twin_otter", 2.94, 0.67)]
)
def test_short_period_of_the_quasi_steady_aircraft(name: str, frequency: float, damping: float) -> None:
    c = ac.constants(quasi_steady(load_aircraft(name)), SPEED, HEIGHT, hold=False)
    a = jacobian(c, eq.trimmed_state(c, 0), 3)[1:, 1:]
    roots = np.linalg.eigvals(a)
    natural = math.sqrt(float(np.prod(roots).real))
    assert natural == pytest.approx(frequency, rel=0.01)
    assert -float(np.sum(roots).real) / 2 / natural == pytest.approx(damping, abs=0.01)


def test_phugoid_without_a_pilot_and_with_one() -> None:
    aircraft = quasi_steady(load_aircraft("twin_otter"))
    for hold in (False, True):
        c = ac.constants(aircraft, SPEED, HEIGHT, hold=hold)
        roots = np.linalg.eigvals(jacobian(c, eq.trimmed_state(c, 0), 8))
        slow = roots[(np.abs(roots) > 0.05) & (np.abs(roots) < 0.5) & (np.abs(roots.imag) > 0.05)]
        assert len(slow) == 2
        natural, damping = abs(slow[0]), -slow[0].real / abs(slow[0])
        assert natural == pytest.approx(math.sqrt(2) * 9.81 / SPEED, rel=0.2)  # Lanchester
        if hold:
            assert damping > 0.2
            assert roots.real.max() < 1e-9
        else:
            assert 0.02 < damping < 0.12  # about CD / (sqrt2 CL)


def test_energy_changes_only_by_the_work_of_the_specific_force() -> None:
    doublet = Doublet.model_validate({"kind": "doublet", "start": "1 s", "width": "1 s", "amplitude": "3 deg"})
    flown = Simulation(load_aircraft("twin_otter"), Flight(), [doublet]).advance(2000)
    ai, ve = flown["alpha_inertial"], np.hypot(flown["v_north"], flown["v_down"])
    u, w = ve * np.cos(ai), ve * np.sin(ai)
    energy = 0.5 * ve**2 + 9.80665 * flown["altitude"]
    power = flown["ax"] * u + flown["az"] * w
    work = np.concatenate(([0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) / 200)))
    # What is left is the trapezium's own error where the elevator steps.
    assert np.abs(energy - energy[0] - work).max() < 1e-4 * np.ptp(0.5 * ve**2)


def test_signs_elevator_down_pitches_down_and_lifts() -> None:
    c = ac.constants(load_aircraft("twin_otter"), SPEED, HEIGHT)
    x = eq.trimmed_state(c, 0)
    level, _ = derivative(c, x)
    x[eq.ELEVATOR] += math.radians(1)
    down, flow = derivative(c, x)
    assert down[eq.Q] < level[eq.Q] - 0.05
    assert flow.cl - c.cl_trim == pytest.approx(0.608 * math.radians(1))


def test_signs_a_climb_is_positive_and_an_updraught_lifts() -> None:
    c = ac.constants(load_aircraft("twin_otter"), SPEED, HEIGHT)
    x = eq.trimmed_state(c, 0)
    x[eq.THETA] += math.radians(3)
    assert derivative(c, x)[0][eq.HEIGHT] == pytest.approx(SPEED * math.sin(math.radians(3)), rel=1e-9)
    _, flow = derivative(c, eq.trimmed_state(c, 0), gust=(0.0, 1.0) * 3)
    assert flow.cl > c.cl_trim + 0.09  # CL_alpha 1/V


@pytest.mark.parametrize("name", ["twin_otter", "twin_otter_martos"])
def test_in_the_steady_limit_the_unsteady_aircraft_has_the_tabulated_derivatives(name: str) -> None:
    aircraft = load_aircraft(name)
    unsteady = ac.constants(aircraft, SPEED, HEIGHT)
    steady = ac.constants(quasi_steady(aircraft), SPEED, HEIGHT)
    tables = (ac.indicial_table(aircraft.unsteady.lift_motion), ac.indicial_table(aircraft.unsteady.lift_gust))
    rng = np.random.default_rng(4)
    for _ in range(5):
        angle, gust = rng.uniform(-0.05, 0.05, 2)
        x = eq.trimmed_state(unsteady, 4)
        x[eq.U], x[eq.W] = SPEED * math.cos(unsteady.trim_alpha + angle), SPEED * math.sin(unsteady.trim_alpha + angle)
        x[eq.ELEVATOR] += rng.uniform(-0.1, 0.1)
        wind = (0.0, SPEED * gust) * 3
        met = math.atan2(x[eq.W] + wind[1], x[eq.U]) - math.atan2(x[eq.W], x[eq.U])
        x[eq.LAGS : eq.LAGS + 2], x[eq.LAGS + 2 :] = angle, met
        dx, one = derivative(unsteady, x, gust=wind, past=angle + met, tables=tables)
        _, other = derivative(steady, x[: eq.LAGS].copy(), gust=wind)
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
        assert np.abs(dx[eq.LAGS :]).max() < 1e-12


def test_a_steady_pitch_rate_has_the_tabulated_effect() -> None:
    """Turning with the air at rest, the downwash at the tail is that of the wing's incidence: CL_q, Cm_q hold."""
    aircraft = load_aircraft("twin_otter")
    c = ac.constants(aircraft, SPEED, HEIGHT)
    x = eq.trimmed_state(c, 0)
    x[eq.Q] = 0.05
    qhat = 0.05 * c.chord / (2 * SPEED)
    _, flow = derivative(c, x)
    # The formula's e-terms are those of incidence growing at rate q (alpha-dot = q), as in a pull-up's beginning.
    share, arm, lag = 0.817, c.tail_arm / c.chord, 0.35 * 0.05 * c.tail_arm / SPEED
    _, late = derivative(c, x, past=-0.05 * c.tail_arm / SPEED)
    assert late.cl - flow.cl == pytest.approx(share * lag)
    assert late.cl - c.cl_trim == pytest.approx(19.97 * qhat, rel=1e-9)
    assert late.cm == pytest.approx(-34.2 * qhat, rel=1e-9)
    assert late.cm - flow.cm == pytest.approx(-share * arm * lag)


# Unsteady vortex lattice, gain and degrees. For the gust above 0.5 Hz the lattice's entry into it is not what the
# two-term fit of its step response has: only the slow part can be compared.
LIFT_MOTION = {0.1: (0.999, -1), 0.5: (0.973, -5), 1.0: (0.929, -7), 2.0: (0.853, -9), 5.0: (0.738, -7)}
LIFT_GUST = {0.1: (0.999, -2), 0.5: (0.983, -11)}


def wing_response(aircraft: Aircraft, f: float) -> tuple[complex, complex]:
    """Wing incidence per incidence of the motion and per gust met at the leading edge, at f Hz: the equations
    linearised numerically about trim."""
    c = ac.constants(aircraft, SPEED, HEIGHT)
    tables = (ac.indicial_table(aircraft.unsteady.lift_motion), ac.indicial_table(aircraft.unsteady.lift_gust))
    x0 = eq.trimmed_state(c, 4)

    def wing(x, w_le):
        dx, flow = derivative(c, x, gust=(0.0, 0.0, 0.0, w_le, 0.0, 0.0), tables=tables)
        return np.append(dx[eq.LAGS :], flow.wing)

    def slope(direction, w_le=0.0, d=1e-6):
        return (wing(x0 + d * direction, d * w_le) - wing(x0 - d * direction, -d * w_le)) / (2 * d)

    unit = np.eye(len(x0))
    states = np.stack([slope(unit[eq.LAGS + i]) for i in range(4)], axis=1)
    across = -math.sin(c.trim_alpha) * unit[eq.U] + math.cos(c.trim_alpha) * unit[eq.W]
    motion = slope(across) * SPEED
    gust = slope(0 * unit[0], 1.0) * SPEED / math.cos(c.trim_alpha)
    inverse = np.linalg.inv(2j * math.pi * f * np.eye(4) - states[:4])
    one, other = (complex(states[4] @ inverse @ column[:4] + column[4]) for column in (motion, gust))
    return one, other


def test_lift_memory_in_frequency_is_the_vortex_lattices() -> None:
    aircraft = load_aircraft("twin_otter")
    for i, table, gain_off, phase_off in ((0, LIFT_MOTION, 0.002, 2.0), (1, LIFT_GUST, 0.011, 3.5)):
        for f, (gain, phase) in table.items():
            h = wing_response(aircraft, f)[i]
            assert abs(h) == pytest.approx(gain, abs=gain_off)
            assert math.degrees(np.angle(h)) == pytest.approx(phase, abs=phase_off)


@pytest.mark.parametrize("k", [0.01, 0.05, 0.1, 0.2, 0.5])
def test_a_wing_of_infinite_span_lifts_as_theodorsen_and_sears_say(k: float) -> None:
    """With R. T. Jones's exponentials of Wagner's and Kussner's functions (exponents per semichord, so twice that per
    chord), which are themselves within 0.02 and 0.05 of the exact ones."""
    aircraft = load_aircraft("twin_otter")
    motion = Indicial(a=(0.165, 0.335), b=(2 * 0.0455, 2 * 0.300))
    gust = Indicial(a=(0.5, 0.5), b=(2 * 0.130, 2 * 1.0))
    changes = {"lift_motion": motion, "lift_gust": gust, "reference_chord": None}
    plane = aircraft.model_copy(update={"unsteady": aircraft.unsteady.model_copy(update=changes)})
    theodorsen = hankel2(1, k) / (hankel2(1, k) + 1j * hankel2(0, k))
    sears = ((jv(0, k) - 1j * jv(1, k)) * theodorsen + 1j * jv(1, k)) * np.exp(-1j * k)  # seen at the leading edge
    one, other = wing_response(plane, k * SPEED / (math.pi * aircraft.geometry.chord))
    assert one == pytest.approx(theodorsen, abs=0.02)
    assert other == pytest.approx(sears, abs=0.05)


def test_the_short_period_flown_is_the_one_of_the_linear_equations() -> None:
    """A small pulse of the elevator in calm air: alpha and q against the exponential of the textbook's matrix."""
    aircraft = quasi_steady(load_aircraft("twin_otter"))
    c = ac.constants(aircraft, SPEED, HEIGHT, hold=False)
    pulse = Doublet.model_validate({"kind": "doublet", "start": "0.1 s", "width": "0.2 s", "amplitude": "0.2 deg"})
    f = Simulation(aircraft, Flight.model_validate({"speed": f"{SPEED} m/s"}), [pulse], hold=False).advance(500)
    qbar, v = f["dynamic_pressure"][0], f["airspeed"][0]
    lift, turn = qbar * c.area / (c.mass * v), qbar * c.area * c.chord / c.iyy
    hat = c.chord / (2 * v)
    drag = c.cd_0 + c.cd_induced * c.cl_trim**2
    a = np.array([[-lift * (c.cl_alpha + drag), 1 - lift * c.cl_q * hat], [turn * c.cm_alpha, turn * c.cm_q * hat]])
    b = np.array([-lift * c.cl_de, turn * c.cm_de])
    state, made = np.zeros(2), []
    step = expm(np.block([[a, b[:, None]], [np.zeros((1, 3))]]) / 200)
    middle = 0.5 * (f["elevator"][1:] + f["elevator"][:-1]) - f["elevator"][0]
    for de in middle:
        made.append(state)
        state = step[:2, :2] @ state + step[:2, 2] * de
    for i, name in enumerate(("alpha", "q")):
        flown = (f[name] - f[name][0])[:-1]
        # What the speed, which the short period leaves alone, changes in 2.5 s.
        np.testing.assert_allclose(flown, np.array(made)[:, i], atol=0.03 * np.abs(flown).max())


def test_actuator_lags_and_is_limited_in_rate_and_travel() -> None:
    c = ac.constants(load_aircraft("twin_otter"), SPEED, HEIGHT)
    x = eq.trimmed_state(c, 0)

    def rate(command: float) -> float:
        return float(derivative(c, x, c.trim_elevator + command)[0][eq.ELEVATOR])

    assert rate(0.01) == pytest.approx(0.01 / 0.08)
    assert rate(0.3) == pytest.approx(math.radians(60))
    assert rate(-0.3) == pytest.approx(-math.radians(60))
    x[eq.ELEVATOR] = math.radians(20)
    assert rate(3.0) == pytest.approx(0.0, abs=1e-12)


def test_aircraft_that_cannot_be_simulated_say_why() -> None:
    aircraft = load_aircraft("twin_otter")
    no_iyy = aircraft.model_copy(update={"inertia": aircraft.inertia.model_copy(update={"iyy": None})})
    with pytest.raises(ProfileError, match=r"inertia\.iyy"):
        ac.constants(no_iyy, SPEED, HEIGHT)
    with pytest.raises(ProfileError, match="no trim at 15"):
        ac.constants(aircraft, 15.0, HEIGHT)
    with pytest.raises(ProfileError, match="CL_alpha and Cm_de"):
        ac.constants(aircraft.model_copy(update={"derivatives": {}}), SPEED, HEIGHT)
    curved = aircraft.derivatives | {"CD_alpha3": aircraft.derivatives["CL_alpha"]}
    with pytest.raises(ProfileError, match="CD_alpha3"):
        ac.constants(aircraft.model_copy(update={"derivatives": curved}), SPEED, HEIGHT)


def test_hfb320_trims_and_flies_with_its_thrust_line_and_fixed_rate_reference() -> None:
    flown = Simulation(
        load_aircraft("hfb320"), Flight.model_validate({"speed": "104.67 m/s", "altitude": "4000 m"})
    ).advance(400)
    assert np.ptp(flown["alpha"]) < 1e-9
    assert flown["thrust"][0] == pytest.approx(12.5e3, rel=0.1)
    assert flown["Cm"][0] * flown["dynamic_pressure"][0] * 30.097216 * 2.43 == pytest.approx(
        0.6411 * flown["thrust"][0], rel=1e-9
    )
