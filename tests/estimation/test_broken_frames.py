"""The live estimator on everything that can go wrong with a frame, and on NASA's records."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from records import record

from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS, to_si
from station.estimation.methods import Estimator
from station.rows import Frame, Status, UsageError
from tests.estimation.live_flights import (
    AIRCRAFT,
    ALPHA_AND_MOMENT,
    RIG,
    blank,
    card,
    changed,
    error_percent,
    flight,
    make,
    make_frames,
    run,
    values,
)


def slow_velocity(frames, every, late):
    """The velocity as a receiver at 50/`every` Hz gives it, `late` ticks old when it comes, its age told."""
    names = ("v_north", "v_east", "v_down")
    made = []
    for k, frame in enumerate(frames):
        source = (k - late) // every * every
        if source < 0:
            made.append(changed(frame, **dict.fromkeys(names)))
            continue
        fresh = changed(frame, **{n: frames[source].values[SIGNAL_INDEX[n]] for n in names})
        ages = list(fresh.age_s)
        for n in names:
            ages[SIGNAL_INDEX[n]] = (k - source) * 0.02
        made.append(Frame(fresh.t_ns, fresh.k, fresh.values, tuple(ages), fresh.quality))
    return made


@pytest.mark.parametrize(("every", "late"), [(10, 0), (50, 0), (50, 10)])
def test_slow_velocity_gives_the_same_derivatives(every, late):
    frames = flight(5.0)[0]
    best, _ = run(make(), frames)
    slow, _ = run(make(), slow_velocity(frames, every, late))
    assert values(slow["split"])[ALPHA_AND_MOMENT] == pytest.approx(values(best["split"])[ALPHA_AND_MOMENT], rel=0.01)


def test_no_velocity_at_all_still_splits():
    frames = [changed(f, v_north=None, v_east=None, v_down=None) for f in flight()[0]]
    methods, _ = run(make(), frames)
    assert error_percent(methods["split"])[ALPHA_AND_MOMENT] == pytest.approx([0] * 4, abs=2)


NONE = {"no attitude": ("phi", "theta", "psi"), "no velocity": ("v_north", "v_east", "v_down")}


@pytest.mark.parametrize("what", NONE)
def test_an_angle_of_attack_without_attitude_or_velocity_says_so(what):
    """The split goes on by the rates alone, or by the air data, and its error still holds: 95 % but for one flight's
    scatter, 2.5 % where alpha has 150 independent values."""
    frames, truth = flight(5.0)
    without = [changed(f, **dict.fromkeys(NONE[what])) if k >= 1050 else f for k, f in enumerate(frames)]
    methods, alphas = run(make(), without)
    assert all(a.valid for a in alphas)
    assert alphas[10].why == "settling: motion and gust not told apart"
    assert {a.why for a in alphas[200:1050]} == {""}
    said = {a.why for a in alphas[1110:]}  # attitude and velocity count for a second
    assert len(said) == 1
    assert said.pop().startswith(f"{what}: by ")
    assert methods["split"].applicable
    off = np.array([a.alpha for a in alphas]) - truth["alpha"]
    held = np.abs(off) < 2 * np.array([a.alpha_sd for a in alphas])
    assert held[1110:].mean() > 0.88


def test_an_angle_of_attack_never_split_says_so_as_the_split_does():
    frames, truth = flight(5.0)
    methods, alphas = run(make(), [changed(f, theta=None) for f in frames])
    assert {(a.valid, a.why) for a in alphas} == {(True, "no attitude: motion and gust not told apart")}
    assert not methods["split"].applicable
    assert methods["split"].why == alphas[-1].why
    off = np.array([a.alpha for a in alphas]) - truth["alpha"]
    assert np.mean(np.abs(off[1000:]) < 2 * np.array([a.alpha_sd for a in alphas[1000:]])) > 0.92


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [2.5, 5.0, 10.0])
@pytest.mark.parametrize("lost", ["nothing", *NONE])
def test_two_standard_errors_hold_the_angle_of_attack_in_gusts(sigma, lost):
    """Alpha's error is coloured: eight flights have some 300 independent values in 2-7 Hz."""
    held = []
    for seed in range(31, 39):
        frames, truth = flight(sigma, 50.0, seed)
        if lost in NONE:
            frames = [changed(f, **dict.fromkeys(NONE[lost])) if k >= 1050 else f for k, f in enumerate(frames)]
        _, alphas = run(make(methods=("II", "split")), frames)
        off = np.array([a.alpha for a in alphas]) - truth["alpha"]
        held.append(np.mean(np.abs(off[1110:]) < 2 * np.array([a.alpha_sd for a in alphas[1110:]])))
    assert 0.92 < np.mean(held) < 0.995


@pytest.mark.parametrize("what", ["no values", "no frames", "only the vane"])
def test_dropout_of_two_seconds_in_a_manoeuvre(what):
    frames = list(flight()[0])
    lost = slice(1115, 1215)
    if what == "no values":
        frames[lost] = [blank(f) for f in frames[lost]]
    elif what == "only the vane":
        frames[lost] = [changed(f, alpha_vane=None) for f in frames[lost]]
    else:
        del frames[lost]
    methods, alphas = run(make(), frames)
    assert error_percent(methods["split"])[ALPHA_AND_MOMENT] == pytest.approx([0] * 4, abs=3)
    assert {p.status for p in methods["split"].parameters} == {Status.ESTIMATED}
    if what != "no frames":
        assert all(not a.valid and a.why for a in alphas[1130:1215])
        assert all(a.valid for a in alphas[1220:])


def test_scattered_gaps():
    frames = [changed(f, alpha_vane=None) if k % 9 == 4 else f for k, f in enumerate(flight()[0]) if k % 31 != 7]
    methods, _ = run(make(), frames)
    assert error_percent(methods["split"])[ALPHA_AND_MOMENT] == pytest.approx([0] * 4, abs=3)


def test_frozen_vane_is_said_and_not_used():
    frames = list(flight()[0])
    stuck = frames[1100].values[SIGNAL_INDEX["alpha_vane"]]
    frames[1100:1300] = [changed(f, alpha_vane=stuck) for f in frames[1100:1300]]
    methods, alphas = run(make(), frames)
    assert all(a.why == "alpha_vane frozen" and not a.valid for a in alphas[1120:1300])
    assert error_percent(methods["split"])[ALPHA_AND_MOMENT] == pytest.approx([0] * 4, abs=6)


def test_a_vane_late_by_a_tenth_of_a_second_is_told_in_calm_air():
    frames = flight()[0]
    late = [changed(f, alpha_vane=frames[max(f.k - 5, 0)].values[SIGNAL_INDEX["alpha_vane"]]) for f in frames]
    whys = {True: set(), False: set()}
    for is_late, flown in ((False, frames), (True, late)):
        estimator = make()
        for frame in flown:
            _, methods = estimator.step(frame)
            if frame.k > 500:
                whys[is_late].add(methods[3].why)
    assert whys[False] == {""}
    assert any("unexplained" in why for why in whys[True])


def test_a_method_that_does_not_run_live_is_refused():
    with pytest.raises(UsageError, match="oe is no live method"):
        make(methods=("II", "oe"))


def test_no_attitude_leaves_the_vane_methods():
    frames = [changed(f, theta=None) for f in flight()[0]]
    methods, alphas = run(make(), frames)
    assert methods["II"].parameters[0].status is Status.ESTIMATED
    assert methods["split"].parameters[0].status is Status.INVALID
    assert not methods["split"].applicable
    assert alphas[-1].valid
    assert math.isnan(alphas[-1].alpha_inertial)


def test_no_elevator_leaves_the_angle_of_attack():
    frames, truth = flight()
    methods, alphas = run(make(), [changed(f, elevator=None) for f in frames])
    assert alphas[-1].valid
    assert alphas[-1].alpha == pytest.approx(truth["alpha"][-1], abs=0.005)
    assert methods["split"].parameters[0].status is Status.UNESTIMATED
    assert methods["split"].parameters[0].why == "no elevator"


def test_no_air_density_leaves_the_angle_of_attack():
    """Nothing stands in for it: at 10,000 ft the sea's would make the derivatives a quarter too small."""
    lost = dict.fromkeys(("dynamic_pressure", "static_pressure", "altitude"))
    methods, alphas = run(make(), [changed(f, **lost) for f in flight()[0]])
    assert alphas[-1].valid
    for name in ("split", "physical"):
        assert {p.status for p in methods[name].parameters} == {Status.UNESTIMATED}
        assert "air density not known" in methods[name].parameters[0].why


def test_on_the_ground_there_is_no_angle_of_attack():
    frames = [changed(f, airspeed=0.0) for f in flight()[0][:1200]]
    methods, alphas = run(make(), frames)
    assert not any(a.valid for a in alphas)
    assert "airspeed below" in alphas[-1].why
    assert {p.status for m in methods.values() for p in m.parameters} == {Status.UNESTIMATED}


def test_time_standing_still_or_going_back_is_survived():
    frames = flight()[0]
    mixed = [*frames[:1200], frames[1199], frames[1190], *frames[1200:]]
    methods, _ = run(make(), mixed)
    assert error_percent(methods["split"])[ALPHA_AND_MOMENT] == pytest.approx([0] * 4, abs=3)


wild = st.one_of(st.floats(width=64), st.floats(-10, 10), st.just(0.0))


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(
        st.tuples(
            st.integers(-200, 2000),
            st.dictionaries(st.sampled_from(sorted(SIGNALS)), wild, max_size=len(SIGNALS)),
            wild,
            st.integers(0, 3),
        ),
        max_size=12,
    )
)
def test_never_raises_and_recovers(rows):
    """Any frames at all; afterwards a good flight still gives its estimates."""
    estimator = make(of=card(warm_up="0 s"))
    start = flight()[0]
    for frame in start[:30]:
        estimator.step(frame)
    for k, columns, age, quality in rows:
        v = tuple(columns.get(name, math.nan) for name in SIGNALS)
        frame = Frame(k * TICK_NS + 7, k, v, (age,) * len(v), (quality,) * len(v))
        alpha, methods = estimator.step(frame)
        assert all(p.status in Status for m in methods for p in m.parameters)
        assert math.isfinite(alpha.alpha) or not alpha.valid
    alpha, _ = [estimator.step(f) for f in start[2100:2200]][-1]
    assert alpha.valid
    assert abs(alpha.alpha) < 0.3


# --- NASA's calm records


@pytest.mark.parametrize("name", ["totter_demo_data", "totter_pred_data", "totter_f1_017_data"])
def test_nasa_records_are_calm_and_read_as_by_the_peers(name):
    from scipy.io import loadmat

    data = loadmat(record(f"twin_otter/{name}.mat"))["fdata"]
    deg = math.radians(1)
    speed, q = to_si(1.0, "ft/s") * data[:, 1], data[:, 5] * deg
    boom = AIRCRAFT.boom
    columns = {
        # The record's alpha is at the CG: what this boom would have shown, steadily.
        "alpha_vane": (data[:, 3] * deg - boom.vane_x * q / speed) / boom.steady_calibration,
        "airspeed": speed,
        "q": q,
        "dynamic_pressure": to_si(1.0, "psf") * data[:, 26],
        "thrust": to_si(1.0, "lbf") * data[:, 37:41].sum(axis=1),
        "mass": to_si(1.0, "slug") * data[:, 47],
    }
    columns |= {n: data[:, i] * deg for n, i in (("p", 4), ("r", 6), ("phi", 7), ("theta", 8), ("elevator", 13))}
    columns |= {n: data[:, i] * to_si(1.0, "g") for n, i in (("ax", 10), ("ay", 11), ("az", 12))}
    before = {n: np.concatenate([np.full(500, x[0]), x]) for n, x in columns.items()}
    estimator = Estimator(AIRCRAFT, card(warm_up="5 s"), noise=RIG.noise_si())
    methods, alphas = run(estimator, make_frames(before))
    assert {a.turbulence for a in alphas[300:]} == {"calm"}
    assert max(a.turbulence_level for a in alphas[300:]) < to_si(0.1, "ft/s")
    if name == "totter_demo_data":
        # SIDPAC's RTPID on 36 lines: 6.291, 17.8, 0.608; -1.466, -37.2, -1.889.
        found = values(methods["II"])
        assert found == pytest.approx([6.291, 17.8, 0.608, -1.466, -37.2, -1.889], rel=0.06)
