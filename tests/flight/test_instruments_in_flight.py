"""Instrument errors that a profile states: estimates as if the instruments were sound, live and after the flight."""

from __future__ import annotations

import functools
import json
import math
from typing import Any

import numpy as np
import pytest

from station.clock import ManualClock
from station.conventions import STREAMS, TICK_HZ, TICK_NS, Stream
from station.diagnosis.checks import checked
from station.diagnosis.kinematic_diagnosis import diagnose_kinematics, judge
from station.estimation.instrument_errors import Corrector
from station.estimation.methods import Estimator
from station.flight.alignment import Aligner
from station.flight.chain import undone
from station.flight.loop import Chain, recorded_beats, run
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.log import About, LogWriter, Table, table, write_log
from station.model.disagreement import Disagreement
from station.profile import Aircraft, Card, Doublet, Flight, Instrument, load_aircraft, load_rig
from station.rows import AlphaEstimate, Code, Event, Frame, MethodEstimate, Sample, Tick
from station.simulation.sortie import fly

RIG, AIRCRAFT = load_rig("bench"), load_aircraft("twin_otter")
SENSED = [name for stream in RIG.streams() for name in stream.signals]
ROWS = tuple(
    Stream(f"imported.{s.name}", tuple(n for n in s.signals if n in SENSED), float(TICK_HZ), 0.5)
    for s in STREAMS.values()
    if any(n in SENSED for n in s.signals)
)
METHODS = ("II", "split", "split+gust")


def errs(**keys: float) -> Instrument:
    return Instrument.model_validate(keys, context="si")


ONE: dict[str, tuple[dict[str, Instrument], tuple[float, float, float]]] = {
    "vane": ({"alpha_vane": errs(latency=0.0587, gain=1.1, bias=0.0175)}, (0.0, 0.0, 0.0)),
    "gyro": ({"q": errs(gain=0.93, latency=0.03, bias=0.01)}, (0.0, 0.0, 0.0)),
    "elevator": ({"elevator": errs(lag=0.06, gain=1.1, cubic=3.0)}, (0.0, 0.0, 0.0)),
    "imu": (
        {"az": errs(gain=1.05, bias=0.2), "ax": errs(bias=0.1), "theta": errs(gain=0.95, bias=0.02)},
        (1.0, 0.0, 0.3),
    ),
    "velocity": ({n: errs(latency=0.2) for n in ("v_north", "v_east", "v_down")}, (0.0, 0.0, 0.0)),
    "pitot": ({"airspeed": errs(lag=0.2, gain=1.05), "dynamic_pressure": errs(lag=0.2, gain=1.1025)}, (0.0, 0.0, 0.0)),
}
EVERY = ({name: e for errors, _ in ONE.values() for name, e in errors.items()}, (1.0, 0.0, 0.3))


def faulty(case: str) -> Aircraft:
    errors, offset = EVERY if case == "every" else ONE[case]
    return AIRCRAFT.model_copy(update={"instruments": errors, "imu_offset": offset, "name": "faulty"})


def card(sigma_ft_s: float, seed: int) -> Card:
    manoeuvres = (
        Doublet(kind="doublet", start="22 s", amplitude="3.5 deg", width="0.6 s"),
        Doublet(kind="doublet", start="32 s", amplitude="3.5 deg", width="1.2 s"),
    )
    flight = Flight(speed="110 kt", altitude="2500 ft", gust_sigma=f"{sigma_ft_s} ft/s", seed=seed)
    return Card(name="t", aircraft="twin_otter", rig="bench", flight=flight, manoeuvres=manoeuvres)


@functools.cache
def flown(case: str, sigma: float, seed: int, seconds: float = 45.0) -> Table:
    """What the rig shows of the same flight, its instruments sound or with a case's errors; the noise is the same."""
    aircraft = AIRCRAFT if case == "sound" else faulty(case)
    shown, _ = fly(aircraft, RIG, card(sigma, seed), seconds, seed)
    return Table(np.arange(len(shown["q"])) * 0.02, {n: shown[n] for n in SENSED if n in shown}, aircraft, 0)


def found(table: Table, aircraft: Aircraft, methods: tuple[str, ...] = METHODS) -> dict[str, Any]:
    of = card(0.0, 1)
    request = Request(methods, 15.0, card=of, imu_position=RIG.imu_position, noise=RIG.noise_si())
    return as_json(identify(table, aircraft, request))


def apart(one: dict[str, Any], other: dict[str, Any], method: str) -> np.ndarray:
    """Differences of the longitudinal derivatives in standard errors of the second."""
    p, q = (x["methods"][method]["parameters"] for x in (one, other))
    return np.array([(p[n]["estimate"] - q[n]["estimate"]) / q[n]["std_error"] for n in list(q)[:6]])


def compared(case: str, sigma: float, seed: int, bound: float) -> None:
    sound = found(flown("sound", sigma, seed), AIRCRAFT)
    undone = found(flown(case, sigma, seed), faulty(case))
    plain = found(flown(case, sigma, seed), AIRCRAFT)
    assert any("instrument errors corrected" in r for r in undone["remarks"])
    assert not any("instrument errors corrected" in r for r in plain["remarks"])
    for method in METHODS:
        assert np.abs(apart(undone, sound, method)).max() < bound, (case, method)
    # What the error would do, in standard errors that may allow for it, is nearly all gone.
    left, wrong = (np.abs(apart(x, sound, "split+gust")).max() for x in (undone, plain))
    assert left < 0.2 * wrong, (case, left, wrong)


def test_estimates_are_those_of_sound_instruments() -> None:
    """All errors at once. Noise is as it was but for the lags', which have their own; errors of the inverses are below
    a quarter of a standard error."""
    compared("every", 0.0, 3, 0.25)


@pytest.mark.slow
@pytest.mark.parametrize("case", ONE)
@pytest.mark.parametrize("sigma", [0.0, 5.0])
def test_each_instrument_is_undone(case: str, sigma: float) -> None:
    for seed in (4, 5, 6):
        compared(case, sigma, seed, 1.0 if case == "pitot" else 0.5)


@pytest.mark.slow
def test_post_flight_methods_get_the_same_signals() -> None:
    methods = ("I", "VI", "oe", "physical")
    sound, undone = (
        found(flown("sound", 0.0, 7), AIRCRAFT, methods),
        found(flown("vane", 0.0, 7), faulty("vane"), methods),
    )
    for method in methods:
        assert undone["methods"][method]["status"] == "ok", method
        assert np.abs(apart(undone, sound, method)).max() < 1.0, method


def rows_of(case: str, sigma: float, seed: int, seconds: float) -> list[Any]:
    shown = flown(case, sigma, seed, seconds).columns
    columns = {s.name: list(zip(*(shown[n].tolist() for n in s.signals), strict=True)) for s in ROWS}
    rows: list[Any] = []
    for k in range(len(shown["q"])):
        t_ns = 10**10 + k * TICK_NS
        rows += [Sample(t_ns, name, None, k, values[k]) for name, values in columns.items()]
        rows += [Tick(t_ns + 60_000_000, k, t_ns), Frame(t_ns, k, (), (), ())]
    return rows


def live(case: str, sigma: float, seed: int, seconds: float, writer: LogWriter | None = None) -> list[Any]:
    """The rows made of a flight by the loop, with the profile that states the case's errors."""
    aircraft, noise = faulty(case), RIG.frame_noise_si()
    estimator = Estimator(aircraft, card(sigma, seed), RIG.imu_position, noise)
    chain = Chain(estimator, Disagreement(aircraft, RIG.imu_position, noise), Corrector(aircraft, noise))
    made: list[Any] = []
    run(
        recorded_beats(rows_of(case, sigma, seed, seconds)),
        Aligner(ROWS, RIG.noise_si()),
        lambda: chain,
        writer,
        None,
        lambda _, rows: made.extend(rows),
    )
    return made


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, list[Any]]:
    """A recording with a vane 58.7 ms late, 10 % and 1 deg off, in light turbulence; and the rows made of it."""
    about = About(faulty("vane"), ROWS, RIG, card(3.0, 8))
    writer = LogWriter(tmp_path_factory.mktemp("live"), about, ManualClock(10**10), lambda _: None, "flight")
    made = live("vane", 3.0, 8, 40.0, writer)
    writer.close()
    return writer.path, made


def test_replay_gives_the_same_bits(recorded: tuple[Any, list[Any]], station: Any) -> None:
    code, out, err = station("replay", recorded[0], "--verify")
    assert code == 0, err
    assert out.strip().endswith(" 0 different")


def test_the_recording_holds_what_was_measured_and_alpha_what_was_made_of_it(recorded: tuple[Any, list[Any]]) -> None:
    log, made = recorded
    measured = table(log).columns["alpha_vane"]
    np.testing.assert_array_equal(measured, flown("vane", 3.0, 8, 40.0).columns["alpha_vane"])
    alphas = [r for r in made if isinstance(r, AlphaEstimate)]
    assert len(alphas) == len(measured) - 4  # 58.7 ms, and the sample after
    sound = flown("sound", 3.0, 8, 40.0).columns["alpha_vane"]
    for k, a in enumerate(alphas):
        assert a.vane == measured[k]
        if a.valid:
            total = a.vane + a.instrument + a.zero + a.upwash + a.rate + a.lag + a.gust
            assert a.alpha == pytest.approx(total, abs=1e-12)
    late = np.array([a.vane + a.instrument for a in alphas]) - sound[: len(alphas)]
    # What is left is the sensor's noise of another sample than the sound vane's.
    assert np.std(late[100:]) < 2 * RIG.noise_si()["alpha_vane"]
    assert abs(np.mean(late[100:])) < 1e-4
    assert np.std(measured - sound) > 3 * RIG.noise_si()["alpha_vane"]


def test_live_and_identify_agree(recorded: tuple[Any, list[Any]]) -> None:
    """From when the transforms open, to the last frame that the late vane reaches."""
    log, made = recorded
    last = {r.method: {p.name: p for p in r.parameters} for r in made if isinstance(r, MethodEstimate)}
    of, flight = card(3.0, 8), table(log)
    request = Request(["II", "split"], of.warm_up, card=of, imu_position=RIG.imu_position, noise=RIG.frame_noise_si())
    estimates = as_json(identify(flight, flight.aircraft, request))
    assert estimates["interval_s"][1] == pytest.approx(flight.t_s[-1] - 0.08)
    for method in ("II", "split"):
        for name, p in list(last[method].items())[:6]:
            again = estimates["methods"][method]["parameters"][name]["estimate"]
            # One frame more or less as the transforms open.
            assert again == pytest.approx(p.value, abs=0.1 * p.sd), (method, name)


def test_a_known_late_vane_is_not_warned_of() -> None:
    made = live("vane", 0.0, 9, 60.0)
    assert [e for e in made if isinstance(e, Event) and e.code is Code.DISAGREE] == []


def test_the_operator_is_told_what_is_undone_and_what_it_costs() -> None:
    aircraft = faulty("vane")
    words = undone(aircraft, Corrector(aircraft, {}))
    assert "states 1 instrument error, undone: alpha_vane 59 ms late, scale +10 %, bias +1 deg" in words
    assert words.endswith("estimates come 80 ms later")
    assert undone(AIRCRAFT, None) == ""
    slow = AIRCRAFT.model_copy(update={"instruments": {"v_down": errs(latency=0.9)}})
    assert "an instrument error stays in: v_down 900 ms late" in undone(slow, None)


@pytest.mark.slow
def test_the_kinematic_diagnosis_of_a_profile_that_knows_its_errors_finds_nothing_more() -> None:
    unknown = load_aircraft("unknown")
    stated = unknown.model_copy(update={"instruments": {"alpha_vane": errs(latency=0.06, gain=1.3, bias=0.03)}})
    boom = AIRCRAFT.boom
    shown = flown("sound", 0.0, 10, 60.0).columns
    assert boom is not None
    wrong = dict(shown)
    vane = np.interp(np.arange(len(shown["q"])) * 0.02 - 0.06, np.arange(len(shown["q"])) * 0.02, shown["alpha_vane"])
    wrong["alpha_vane"] = 1.3 * vane + 0.03
    t = np.arange(len(vane)) * 0.02
    effects = []
    for aircraft in (unknown, stated):
        read = checked("flight", Table(t, wrong, aircraft, 0), aircraft, RIG.noise_si(), RIG.imu_position)
        judged = judge("flight", read, aircraft)
        found = diagnose_kinematics([judged], [], aircraft)
        effects.append({e.term.id: e.value for e in found.effects})
    before, after = effects
    # The boom's own zero, upwash and distance are unknown to both.
    assert before["alpha_vane.delay"] - after.get("alpha_vane.delay", 0.0) == pytest.approx(0.06, abs=0.01)
    scale = (1 + before["alpha_vane.scale"]) / (1 + after.get("alpha_vane.scale", 0.0))
    assert scale == pytest.approx(1.3, rel=0.02)


@pytest.fixture
def late(tmp_path: Any) -> list[Any]:
    """Recordings of two flights with a vane 58.7 ms late, 10 % and 1 deg off, which no profile knows of."""
    logs = []
    for seed in (41, 42):
        flight = flown("vane", 2.0, seed, 50.0)
        samples = [
            Sample(k * TICK_NS, s.name, k * TICK_NS, k, tuple(float(flight.columns[n][k]) for n in s.signals))
            for k in range(len(flight.t_s))
            for s in ROWS
        ]
        logs.append(tmp_path / f"{seed}.mcap")
        write_log(logs[-1], About(AIRCRAFT, ROWS, RIG, card(2.0, seed), "simulation", imported=True), iter(samples))
    return logs


@pytest.mark.slow
def test_an_effect_is_named_though_constants_far_from_the_profile_s_do_the_same(late: list[Any], station: Any) -> None:
    """Without effects the fit ends 6 standard deviations from the vane's frequency, which leaves its delay no room."""
    found = late[0].with_name("found.json")
    station("diagnose", *late, "--json", found)
    named = {e["id"]: e for e in json.loads(found.read_text())["effects"]}
    for name, truth in {"alpha_vane.delay": 0.0587, "alpha_vane.scale": 0.1}.items():
        low, high = named[name]["ci95"]
        assert low < truth < high, named[name]


@pytest.mark.slow
def test_a_flight_diagnosed_with_the_profile_written_from_it_shows_no_effect(
    tmp_path: Any, late: list[Any], station: Any
) -> None:
    written = tmp_path / "written.toml"
    code, out, err = station("diagnose", *late, "--write-profile", written)
    assert "alpha_vane.delay" in out, (out, err)
    assert load_aircraft(str(written)).instruments["alpha_vane"].latency == pytest.approx(0.0587, abs=0.006)
    code, out, err = station("diagnose", *late, "--aircraft", written)
    assert code == 0, (out, err)
    assert "no effect found" in out
    # And what is identified with it: nearer to the sound flight's by far than with the profile it came from.
    flight, sound = flown("vane", 2.0, 41, 50.0), found(flown("sound", 2.0, 41, 50.0), AIRCRAFT)
    off = {name: found(flight, load_aircraft(str(path))) for name, path in (("new", written), ("old", "twin_otter"))}
    new, old = (np.abs(apart(off[n], sound, "split+gust")).max() for n in ("new", "old"))
    assert new < 0.25 * old
    assert math.isfinite(old)
