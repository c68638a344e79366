"""Method `physical`: streaming against batch, columns against what they are slopes of, and what it refuses."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from station.conventions import SIGNALS, TICK_NS
from station.estimation.methods import Estimator
from station.estimation.physical_method import SEGMENT, Equations, transform
from station.model import physical_columns as pc
from station.model.physical_constants import NUISANCES, PARAMETERS, WIND, constants
from station.numerics.spectra import grid
from station.profile import Aircraft, Card, Indicial, load_aircraft
from station.profile.uncertainty import Uncertainty
from station.rows import Frame, MethodEstimate, Status
from station.simulation import fly
from station.simulation.sensors import STANDARD

DT = 0.02
NAMES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
EXACT = Uncertainty.model_validate(dict.fromkeys(Uncertainty.model_fields, 0.0), context="si")
"""Every constant is right."""


def card(sigma: float = 5.0, warm_up: float = 40.0, **keys: object) -> Card:
    doublet = {"kind": "doublet", "start": f"{warm_up + 2} s", "width": "1.3 s", "amplitude": "3.5 deg"}
    flight = {"gust_sigma": f"{sigma} ft/s", "speed": "110 kt", "altitude": "2500 ft"}
    given = {"name": "t", "aircraft": "a", "rig": "b", "manoeuvres": [doublet], "flight": flight}
    return Card.model_validate({**given, "warm_up": f"{warm_up} s", **keys})


def changed(aircraft: Aircraft, part: str, **keys: object) -> Aircraft:
    return aircraft.model_copy(update={part: getattr(aircraft, part).model_copy(update=keys)})


def frames(shown: dict[str, np.ndarray]) -> list[Frame]:
    n = len(shown["q"])
    rows = np.stack([shown.get(name, np.full(n, math.nan)) for name in SIGNALS], axis=1).tolist()
    zeros = (0,) * len(SIGNALS)
    return [Frame(k * TICK_NS, k, tuple(row), tuple(map(float, zeros)), zeros) for k, row in enumerate(rows)]


def flown(aircraft: Aircraft, c: Card, seconds: float, seed: int = 1, real: Aircraft | None = None) -> list[Frame]:
    return frames(fly(real or aircraft, STANDARD, c, seconds, seed)[0])


def last(estimator: Estimator, given: list[Frame]) -> MethodEstimate:
    for frame in given:
        _, estimates = estimator.step(frame)
    return estimates[-1]


def test_a_span_that_meets_gusts_late_is_told_from_the_pitch_damping() -> None:
    """Lift and the wing's upwash at the vane follow gusts b/2 late, which the profile does not know; no noise. With the
    upwash at once, Cm_alpha was 7 % too large and Cm_q 3 % too small."""
    aircraft, c = load_aircraft("twin_otter_martos"), card(10.0, warm_up=20.0)
    real = changed(aircraft, "unsteady", gust_span=aircraft.geometry.span / 2)
    found = []
    for seed in range(4):
        estimate = last(Estimator(aircraft, c, methods=("physical",)), frames(fly(real, {}, c, 80.1, seed)[0]))
        found.append([p.value / aircraft.value(p.name) - 1 for p in estimate.parameters])
    off = dict(zip(NAMES, np.mean(found, axis=0), strict=True))
    assert abs(off["Cm_alpha"]) < 0.02
    assert abs(off["Cm_q"]) < 0.015


@pytest.mark.parametrize("quieter", [0.02, 0.2])
def test_instruments_quieter_than_is_stated_bias_nothing(quieter: float) -> None:
    """In calm air, by a profile that is right. What is taken from the normal equations for noise that is not there is
    taken from the motion: CL_alpha was a third too large."""
    aircraft, c = load_aircraft("twin_otter_martos"), card(0.0, warm_up=20.0)
    noise = {name: dataclasses.replace(sensor, noise=quieter * sensor.noise) for name, sensor in STANDARD.items()}
    found = last(Estimator(aircraft, c, methods=("physical",)), frames(fly(aircraft, noise, c, 60.1, 3)[0]))
    for p in found.parameters:
        assert p.value == pytest.approx(aircraft.value(p.name), rel=0.05), p.name


def test_streaming_equals_batch() -> None:
    """The estimate of the running sums is that of the whole record's filters and transforms (scipy) at once."""
    aircraft, c = load_aircraft("twin_otter_martos"), card()
    given = flown(aircraft, c, c.warm_up + SEGMENT / c.step + 0.1)
    estimator = Estimator(aircraft, c, methods=("physical",))
    physical = estimator._physical
    assert physical is not None
    kept, speeds, opens = [], [], None
    add = physical.add

    def watched(row: np.ndarray, sides: np.ndarray, t: float, speed: float, density: float, wind_sd: float) -> None:
        nonlocal opens
        if opens is None and t >= c.warm_up:
            opens = len(kept)
        kept.append(np.concatenate((row, sides)))
        speeds.append((speed, wind_sd, density))
        add(row, sides, t, speed, density, wind_sd)

    physical.add = watched  # type: ignore[method-assign]
    last(estimator, given)
    assert opens is not None
    streamed = physical.solution
    n = round(SEGMENT / c.step / DT)
    spectrum = transform(np.array(kept[: opens + n]).T, grid(c.low, c.high, c.step), DT, opens)
    mean, wind_sd = np.mean([v for v, *_ in speeds[opens : opens + n]]), speeds[opens][1]
    equations = Equations(aircraft, grid(c.low, c.high, c.step), DT, {"alpha_vane": math.radians(0.05)})
    density = speeds[opens + n - 1][2]
    batch = equations.solve(spectrum, n, n * DT * c.step, float(mean), density, wind_sd)
    assert batch is not None
    assert streamed is not None
    np.testing.assert_allclose(streamed.theta, batch.theta, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(streamed.stat, batch.stat, rtol=1e-8)
    np.testing.assert_allclose(streamed.total, batch.total, rtol=1e-8)


def test_the_same_frames_give_the_same_bits() -> None:
    aircraft, c = load_aircraft("twin_otter"), card(warm_up=5.0)
    given = flown(aircraft, c, 20.0)
    one, two = (last(Estimator(aircraft, c, methods=("physical",)), given) for _ in range(2))
    assert one == two
    assert any(p.status is Status.ESTIMATED for p in one.parameters)


def test_segments_add_up() -> None:
    """Two segments give smaller errors than one, and the estimate goes on from the first: with mass and inertia known,
    which no length of flight tells."""
    aircraft = load_aircraft("twin_otter")
    known = aircraft.uncertainty.model_copy(update={"mass": 0.0, "inertia": 0.0})
    aircraft = aircraft.model_copy(update={"uncertainty": known})
    c = card(warm_up=20.0)
    again = c.manoeuvres[0].model_copy(update={"repeat": 30.0})
    c = c.model_copy(update={"manoeuvres": (again,)})
    given = flown(aircraft, c, 81.0)
    estimator = Estimator(aircraft, c, methods=("physical",))
    first = last(estimator, given[:2551])
    one = estimator._physical.solution.stat[:6].copy()
    second = last(estimator, given[2551:])
    ratio = [b.sd / a.sd for a, b in zip(first.parameters, second.parameters, strict=True)]
    assert np.mean(ratio) < 0.98
    stat = np.mean(estimator._physical.solution.stat[:6] / one)
    assert stat < 0.9
    for p in second.parameters:
        assert p.value == pytest.approx(aircraft.value(p.name), abs=3 * p.sd)


def test_quiet_air_after_the_inputs_takes_nothing_back() -> None:
    """A doublet, then half a minute in which nothing moves, in calm air: what was found stands."""
    aircraft, c = load_aircraft("twin_otter"), card(0.0, warm_up=5.0)
    given = flown(aircraft, c, 80.0)
    found = last(Estimator(aircraft, c, methods=("physical",)), given)
    assert [p.status for p in found.parameters] == [Status.ESTIMATED] * 6
    for p in found.parameters:
        assert p.value == pytest.approx(aircraft.value(p.name), abs=3 * p.sd)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"memory": False}, "quasi-steady"),
        ({"tail_lift_slope": 0.0}, "tail_lift_slope"),
        ({"lift_gust": None, "lift_motion": None}, "unsteady.lift_motion, unsteady.lift_gust"),
    ],
)
def test_an_aircraft_without_the_constants_is_refused(change: dict[str, object], why: str) -> None:
    aircraft = changed(load_aircraft("twin_otter"), "unsteady", **change)
    found = last(Estimator(aircraft, card(0.0, 1.0), methods=("physical",)), flown(aircraft, card(0.0, 1.0), 4.0))
    assert not found.applicable
    assert why in found.why
    assert all(p.status is Status.INVALID and math.isnan(p.value) for p in found.parameters)


def test_no_input_no_estimate() -> None:
    aircraft = load_aircraft("twin_otter")
    c = card(0.0, 5.0).model_copy(update={"manoeuvres": ()})
    found = last(Estimator(aircraft, c, methods=("physical",)), flown(aircraft, c, 30.0))
    assert all(p.status is Status.UNESTIMATED and p.why == "no elevator input" for p in found.parameters)


def test_an_error_of_the_mean_wind_does_what_its_column_says() -> None:
    """Wing, tail and downwash incidence of the same turbulent flight, the wind told 0.5 m/s wrong, less those with it
    right: the difference quotient against the column, whose memories and delays act in time, not on spectra."""
    aircraft, c = load_aircraft("twin_otter_martos"), card(10.0, warm_up=20.0)
    given = frames(fly(aircraft, {}, c, 50.06, 3)[0])
    omega = 2 * np.pi * grid(c.low, c.high, c.step)
    wings, bases, share = [], [], 0.0
    for wrong in (0.0, 0.5):
        estimator = Estimator(aircraft, c, methods=("physical",))
        seen: list[tuple[np.ndarray, float]] = []
        assert estimator._physical is not None
        equations = estimator._physical._equations
        assert equations is not None
        equations.solve = lambda f, n, s, v, *_, seen=seen: seen.append((f.copy(), v))  # type: ignore[method-assign]
        for frame in given:
            estimator.filters["inertial"]["wind"] = (wrong, 0.0, 0.0)
            estimator.step(frame)
        f, speed = seen[-1]
        made = columns_of(f, omega, speed, aircraft, np.ones(len(omega)))
        wings.append(made.wing)
        bases.append(made.nuisances[WIND])
        share = wrong / speed
    for was, now, column in zip(*wings, bases[0], strict=True):
        left = np.linalg.norm((now - was) / share - column) / np.linalg.norm(column)
        assert left < 0.1


def columns_of(f: np.ndarray, omega: np.ndarray, speed: float, aircraft: Aircraft, rho: np.ndarray) -> pc.Columns:
    """Every line of the equations' columns."""
    segment = pc.Segment(f, omega, np.ones(len(omega)), 1.0, 0.0, speed, 1.2, 0.0)
    _, wing, spans, tails, freed, base = (part[0] for part in pc.no_columns(1, len(omega)))
    made = pc.Columns(f, wing, spans, tails, freed, base, 1)
    pc.columns(segment, constants(aircraft), rho, made)
    return made


def scaled(response: Indicial | None, amplitude: float, rate: float) -> Indicial:
    assert response is not None
    return Indicial(a=tuple(amplitude * a for a in response.a), b=tuple(rate * b for b in response.b))


@pytest.mark.slow
def test_wrong_constants_do_what_their_columns_say() -> None:
    """Wing, tail and downwash incidence of the same flight by profiles that differ in one constant: the difference
    quotient against that constant's column, where a part of what the vane shows counts as gust."""
    aircraft, c = load_aircraft("twin_otter_martos"), card(0.0, warm_up=20.0)
    given = frames(fly(aircraft, STANDARD, c, 50.06, 3)[0])
    omega = 2 * np.pi * grid(c.low, c.high, c.step)

    def found(known: Aircraft) -> tuple[np.ndarray, np.ndarray]:
        estimator = Estimator(known, c, methods=("physical",))
        seen: list[tuple[np.ndarray, float]] = []
        assert estimator._physical is not None
        equations = estimator._physical._equations
        assert equations is not None
        equations.solve = lambda f, n, s, v, *_: seen.append((f.copy(), v))  # type: ignore[method-assign]
        for frame in given:
            estimator.step(frame)
        made = columns_of(seen[-1][0], omega, seen[-1][1], known, np.full(len(omega), 0.4))
        return made.wing, made.nuisances

    boom, unsteady, speed = aircraft.boom, aircraft.unsteady, 110 * 0.514444
    assert boom is not None
    wing, body = boom.upwash_wing, boom.upwash_body
    faster = math.exp(0.05)
    constants: list[tuple[str, float, str, dict[str, object]]] = [
        # Known to read more, it shows less gust: the other way round.
        ("vane gain", -0.01, "boom", {"upwash_wing": 1.01 * wing, "upwash_body": 1.01 * (1 + body) - 1}),
        ("boom length", 0.003, "boom", {"vane_x": boom.vane_x + 0.003 * speed}),
        ("upwash share", -0.1, "boom", {"upwash_wing": 1.1 * wing, "upwash_body": body - 0.1 * wing}),
        ("upwash rate, gust", -0.05, "unsteady", {"upwash_gust": scaled(unsteady.upwash_gust, 1, faster)}),
        ("upwash rate, motion", -0.05, "unsteady", {"upwash_motion": scaled(unsteady.upwash_motion, 1, faster)}),
        ("indicial amplitude", 0.1, "unsteady", {"lift_motion": scaled(unsteady.lift_motion, 1.1, 1)}),
        ("indicial rate, motion", 0.05, "unsteady", {"lift_motion": scaled(unsteady.lift_motion, 1, faster)}),
        ("indicial rate, gust", 0.05, "unsteady", {"lift_gust": scaled(unsteady.lift_gust, 1, faster)}),
        ("downwash delay", 0.003, "unsteady", {"downwash_delay": 0.003}),
        ("tail arm", 0.02, "unsteady", {"tail_arm": 1.02 * unsteady.tail_arm}),
    ]
    before, columns = found(aircraft)
    for name, by, part, keys in constants:
        after, _ = found(changed(aircraft, part, **keys))
        column = columns[NUISANCES.index(name)]
        left = np.linalg.norm((after - before) / by - column) / np.linalg.norm(column)
        # Memories act in time, their slopes on spectra of a record that begins somewhere: up to 0.17.
        assert left < 0.25, name


def test_the_data_prefer_the_model_that_is_true() -> None:
    aircraft, c = load_aircraft("twin_otter"), card(warm_up=20.0)
    estimator = Estimator(aircraft, c, methods=("physical",))
    assert estimator.preference() is None
    assert last(estimator, flown(aircraft, c, 50.1)).applicable
    assert (estimator.preference() or 0.0) > 0.0
    steady = changed(aircraft, "unsteady", memory=False)
    estimator = Estimator(aircraft, c, methods=("physical",))
    found = last(estimator, flown(aircraft, c, 50.1, real=steady))
    assert (estimator.preference() or 0.0) < 0.0
    # Where the other model is true the interval goes so far as to hold what it gives.
    for p in found.parameters:
        assert p.value == pytest.approx(aircraft.value(p.name), abs=2.5 * p.sd)


def test_slopes_are_those_of_the_residual() -> None:
    """Of every parameter, at constants far from the profile's, by central differences."""
    aircraft = load_aircraft("twin_otter")
    rng = np.random.default_rng(4)
    lines, speed = 5, 57.0
    omega = 2 * np.pi * np.linspace(0.2, 1.8, lines)

    def complex_normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    f, rho = complex_normal(pc.CHANNELS, lines), rng.uniform(size=lines)
    con, made = constants(aircraft), columns_of(f, omega, speed, aircraft, rho)
    theta = rng.normal(size=PARAMETERS)
    g, rest = np.empty((2, PARAMETERS), dtype=complex), np.empty(2, dtype=complex)
    up, down = rest.copy(), rest.copy()
    pc.design(made, 3, 1.1, con, theta, g, rest)
    for a in range(PARAMETERS):
        step = np.zeros(PARAMETERS)
        step[a] = 1e-5
        spare = np.empty_like(g)
        pc.design(made, 3, 1.1, con, theta + step, spare, up)
        pc.design(made, 3, 1.1, con, theta - step, spare, down)
        np.testing.assert_allclose(g[:, a], (down - up) / 2e-5, rtol=1e-6, atol=1e-6)


def test_exact_constants_leave_the_statistical_error() -> None:
    """The profile says that its constants are right: the interval is that of the noise, and no constant moves."""
    aircraft, c = load_aircraft("twin_otter"), card(sigma=0.0, warm_up=20.0)
    given = flown(aircraft, c, 50.1)
    solutions = []
    for known in (Uncertainty(), EXACT):
        estimator = Estimator(aircraft.model_copy(update={"uncertainty": known}), c, methods=("physical",))
        last(estimator, given)
        assert estimator._physical is not None
        assert estimator._physical.solution is not None
        solutions.append(estimator._physical.solution)
    usual, exact = solutions
    np.testing.assert_allclose(exact.total[:6], exact.stat[:6], rtol=1e-3)
    assert (usual.total[:6] > exact.total[:6]).all()
    np.testing.assert_allclose(exact.theta[6:-1], 0.0, atol=1e-6)


def test_constants_come_from_the_profile() -> None:
    """Another tail gives other regressors: the same data, other derivatives."""
    aircraft, c = load_aircraft("twin_otter"), card(warm_up=20.0)
    given = flown(aircraft, c, 50.1)
    one = last(Estimator(aircraft, c, methods=("physical",)), given)
    other = changed(aircraft, "unsteady", tail_arm=1.15 * aircraft.unsteady.tail_arm)
    two = last(Estimator(other, c, methods=("physical",)), given)
    assert abs(two.parameters[4].value / one.parameters[4].value - 1) > 0.003
