"""NASA's Twin Otter record flown over serial, CAN and MAVLink in real time and estimated live.

The same record fed to the same estimator straight from the imported file is the reference: what the wires may add is
quantisation, and skew between three device clocks hours apart. Tolerance 1 % of each derivative.
"""

import subprocess
import sys

import numpy as np
import pytest
from records import record

from station.conventions import SIGNALS, TICK_NS
from station.convert import import_file
from station.estimation.methods import Estimator
from station.log import metadata, read_rows, table
from station.profile import load_aircraft
from station.rows import AlphaEstimate, Frame, MethodEstimate, Quality, Status

LEAD_S = 25.0
CARD = """
name = "real_record"
aircraft = "twin_otter"
rig = "bench"
emulate = true
needs = ["alpha_vane", "airspeed", "q", "ax", "az", "theta", "elevator"]
[flight]
source = "recording"
recording = "{recording}"
lead_in = "{lead} s"
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The imported record and the station's own recording of it."""
    folder = tmp_path_factory.mktemp("real")
    imported, card = folder / "demo.mcap", folder / "real_record.toml"
    import_file(record("twin_otter/totter_demo_data.mat"), imported, load_aircraft("twin_otter"))
    card.write_text(CARD.format(recording=imported, lead=LEAD_S))
    words = ["run", str(card), "--duration", "36", "--view", "none", "--log", str(folder / "logs")]
    done = subprocess.run([sys.executable, "-m", "station", *words], capture_output=True, text=True, timeout=300)
    assert done.returncode in (0, 3), done.stderr
    (log,) = (folder / "logs").glob("*.mcap")
    return imported, log


def estimates_of(rows):
    """Each method's last estimates, as long as the angle of attack was measured."""
    last, usable = {}, False
    for row in rows:
        if isinstance(row, AlphaEstimate):
            usable = row.valid
        elif usable and row.applicable:
            last[row.method] = {p.name: p for p in row.parameters}
    return last


def reference(imported, log):
    """The estimator over the imported record, from the signals that the rig carries, behind the same lead-in."""
    record, about = table(imported), metadata(log).about
    carried = {s for stream in about.streams for s in stream.signals}
    columns = {n: c for n, c in record.columns.items() if n in carried}
    held = round(LEAD_S * 50)
    estimator = Estimator(about.aircraft, about.card, about.rig.imu_position, about.rig.frame_noise_si())
    rows = []
    for k in range(held + len(record.t_s)):
        now = {n: float(c[max(k - held, 0)]) for n, c in columns.items()}
        values = tuple(now.get(n, np.nan) for n in SIGNALS)
        ages = tuple(0.0 if n in now else np.nan for n in SIGNALS)
        quality = tuple(int(Quality.FRESH if n in now else Quality.MISSING) for n in SIGNALS)
        alpha, methods = estimator.step(Frame(k * TICK_NS, k, values, ages, quality))
        rows += [alpha, *methods]
    return estimates_of(rows)


def test_derivatives_over_the_wires_are_those_of_the_file(flown):
    imported, log = flown
    expected = reference(imported, log)
    live = estimates_of(read_rows(log, (AlphaEstimate, MethodEstimate)))
    for method in ("II", "split"):
        for name, p in expected[method].items():
            assert p.status is Status.ESTIMATED
            assert live[method][name].value == pytest.approx(p.value, rel=0.01), (method, name)


def test_replay_gives_the_same_bits_while_both_cores_are_busy(flown):
    _, log = flown
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        words = [sys.executable, "-m", "station", "replay", str(log), "--verify"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", 0 different" in done.stdout


def test_signals_over_the_wires_are_those_of_the_file(flown):
    """Within the wires' steps: 0.005 deg of the boom box, 0.025 deg/s and 1 mg of the CAN bus, averaged over a tick."""
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    imported, log = flown
    record, seen = table(imported), table(log)

    def differences(name, start_s):
        inside = (seen.t_s > start_s + 0.2) & (seen.t_s < start_s + 7.8) & np.isfinite(seen.columns[name])
        return seen.columns[name][inside] - CubicSpline(record.t_s, record.columns[name])(seen.t_s[inside] - start_s)

    guesses = np.arange(LEAD_S - 1, LEAD_S + 2, 0.01)
    near = guesses[np.argmin([np.mean(differences("alpha_vane", g) ** 2) for g in guesses])]
    bounds = (near - 0.02, near + 0.02)
    start = {}
    for name in ("alpha_vane", "elevator", "q", "az", "theta"):
        cost = lambda s, name=name: float(np.mean(differences(name, s) ** 2))  # noqa: E731
        start[name] = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6}).x
    # 1 ms of skew would move CL_q by 2 %.
    assert np.ptp(list(start.values())) < 1e-3
    for name, step in (("alpha_vane", np.radians(0.005)), ("elevator", np.radians(0.005)), ("q", np.radians(0.025))):
        assert np.std(differences(name, start[name])) < step
