"""Lateral warnings in flight: none for sound instruments in any air, and soon for one that is late, scaled or off.

The flights go through the live loop itself, from recorded rows, faster than real time.
"""

import math
import re

import numpy as np
import pytest

from station.conventions import LATERAL, STREAMS, TICK_HZ, TICK_NS, Stream
from station.estimation.methods import Estimator
from station.flight.alignment import Aligner
from station.flight.loop import Chain, recorded_beats, run
from station.model.disagreement import Disagreement
from station.profile import Card, Instrument, load_aircraft, load_rig
from station.rows import Code, Event, Frame, MethodEstimate, Sample, Status, Tick
from station.simulation.sortie import fly

RIG = load_rig("bench")
AIRCRAFT = load_aircraft("twin_otter")
SENSED = [name for stream in RIG.streams() for name in stream.signals]
ROWS = [
    Stream(f"imported.{s.name}", tuple(n for n in s.signals if n in SENSED), float(TICK_HZ), 0.5)
    for s in STREAMS.values()
    if any(n in SENSED for n in s.signals)
]
SECONDS = 75.0
START_NS = 10_000_000_000
DOUBLET = {"kind": "doublet", "amplitude": "6 deg", "width": "1.2 s", "repeat": "20 s"}
INPUTS = [{**DOUBLET, "surface": "rudder", "start": "26 s"}, {**DOUBLET, "surface": "aileron", "start": "34 s"}]


def card(sigma_ft_s, seed):
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma_ft_s} ft/s", "field": "plane"}
    made = {"name": "t", "aircraft": "twin_otter", "rig": "bench", "flight": {**flight, "seed": seed}}
    return Card.model_validate({**made, "manoeuvres": INPUTS, "lateral": True})


def made_of(sigma_ft_s, seed, errors=None, wrong=None, seconds=SECONDS):
    """Rows that the loop makes of a flight. `errors`: instruments' errors by signal; `wrong`: signal, what is added to
    it, and from when, s."""
    made = {name: Instrument.model_validate(e, context="si") for name, e in (errors or {}).items()}
    of = card(sigma_ft_s, seed)
    shown, _ = fly(AIRCRAFT.model_copy(update={"instruments": made}), RIG, of, seconds, seed)
    if wrong is not None:
        name, added, from_s = wrong
        shown[name] = shown[name].copy()
        shown[name][round(from_s * TICK_HZ) :] += added
    columns = {s.name: list(zip(*(shown[n].tolist() for n in s.signals), strict=True)) for s in ROWS}
    rows = []
    for k in range(len(shown["q"])):
        t_ns = START_NS + k * TICK_NS
        rows += [Sample(t_ns, name, None, k, values[k]) for name, values in columns.items()]
        rows += [Tick(t_ns + 60_000_000, k, t_ns), Frame(t_ns, k, (), (), ())]
    estimator = Estimator(AIRCRAFT, of, RIG.imu_position, RIG.noise_si(), methods=("split",))
    chain = Chain(estimator, Disagreement(AIRCRAFT, RIG.imu_position, RIG.noise_si(), estimator.sideslip))
    found = []
    aligner = Aligner(ROWS, RIG.noise_si())
    run(recorded_beats(rows), aligner, lambda: chain, None, None, lambda _, more: found.extend(more))
    return found


def warned(rows):
    """What was told, and when, s of flight."""
    events = [r for r in rows if isinstance(r, Event) and r.code is Code.DISAGREE]
    return [((e.t_ns - START_NS) * 1e-9, e.source, e.detail) for e in events]


@pytest.mark.parametrize("sigma", [pytest.param(0, marks=pytest.mark.slow), 5])
def test_sound_instruments_give_no_warning(sigma):
    assert warned(made_of(sigma, 7)) == []


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0, 3, 5, 10])
def test_sound_instruments_give_no_warning_in_ten_flights(sigma):
    assert [w for seed in range(100, 110) for w in warned(made_of(sigma, seed, seconds=125.0))] == []


ALONE = {
    "p scaled": ({"p": {"gain": 1.1}}, "p.scale", 10, "% more than phi turns"),
    "p late": ({"p": {"latency": 0.05}}, "p.delay", 50, "ms late against phi"),
    "r scaled": ({"r": {"gain": 0.9}}, "r.scale", 10, "% less than psi turns"),
    "r late": ({"r": {"latency": 0.05}}, "r.delay", 50, "ms late against psi"),
    "vane scaled": ({"beta_vane": {"gain": 1.25}}, "beta_vane.scale", 25, "% more than inertial β moves"),
    "vane late": ({"beta_vane": {"latency": 0.06}}, "beta_vane.delay", 60, "ms late against inertial β"),
}
"""Errors, what is to be told, its size and words."""


@pytest.mark.parametrize(
    "name",
    [n if n in ("p late", "vane scaled") else pytest.param(n, marks=pytest.mark.slow) for n in ALONE],
)
def test_an_instrument_at_fault_is_named_within_two_manoeuvres_and_no_other(name):
    errors, source, size, words = ALONE[name]
    rows = made_of(0, 3, errors)
    found = warned(rows)
    assert {said for _, said, _ in found} == {source}
    at_s, _, detail = found[0]
    assert words in detail
    assert float(re.search(r"[0-9.]+", detail)[0]) == pytest.approx(size, rel=0.15)
    assert at_s < 70.0
    # From then on no lateral estimate is one, and the longitudinal ones are what they were.
    after = [r for r in rows if isinstance(r, MethodEstimate) and r.t_ns > START_NS + round(at_s * 1e9)]
    assert after
    lateral = [p for m in after for p in m.parameters if p.name in LATERAL]
    assert not any(p.status is Status.ESTIMATED for p in lateral)
    assert any(words in p.why and math.isfinite(p.value) for p in lateral)


def test_a_rate_with_a_zero_is_told_within_half_a_minute():
    found = warned(made_of(5, 4, wrong=("r", math.radians(1), 45.0)))
    assert [said for _, said, _ in found] == ["r.bias"]
    assert "r 1.00 deg/s high against the change of psi" in found[0][2]
    assert 45.0 < found[0][0] < 75.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ALONE)
def test_an_instrument_at_fault_is_named_in_turbulence(name):
    errors, source, *_ = ALONE[name]
    named = [{said for _, said, _ in warned(made_of(5, seed, errors, seconds=125.0))} for seed in range(20, 25)]
    assert all(n <= {source} for n in named), named
    assert np.mean([source in n for n in named]) >= 0.8, named
