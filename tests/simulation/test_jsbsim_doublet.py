"""Against JSBSim's DHC6, which nobody here wrote: trim, and the response to the same elevator doublet.

Another mass, inertia and set of derivatives: the answers must be alike, not the same.
"""

from __future__ import annotations

import math

import jsbsim
import numpy as np
import pytest

from station.profile import Flight, load_aircraft
from station.simulation import Simulation

DT, STEPS = 1 / 200, 1000


def jsbsim_doublet() -> dict[str, np.ndarray]:
    """Elevator, pitch rate and angle of attack, rad, from trim at 2,500 ft and 110 kt."""
    sim = jsbsim.FGFDMExec(None)
    sim.set_debug_level(0)
    sim.load_model("DHC6")
    sim.set_dt(DT)
    settings = {"ic/h-sl-ft": 2500.0, "ic/vt-kts": 110.0, "propulsion/set-running": -1}
    for engine in (0, 1):
        settings |= {f"fcs/throttle-cmd-norm[{engine}]": 0.5, f"fcs/mixture-cmd-norm[{engine}]": 0.9}
        settings |= {f"fcs/advance-cmd-norm[{engine}]": 1.0}
    for name, value in settings.items():
        sim[name] = value
    sim.run_ic()
    sim.do_trim(1)
    trimmed = sim["fcs/elevator-cmd-norm"]
    names = {"elevator": "fcs/elevator-pos-rad", "q": "velocities/q-rad_sec", "alpha": "aero/alpha-rad"}
    rows = []
    for k in range(STEPS):
        t = k * DT
        sim["fcs/elevator-cmd-norm"] = trimmed + (0.1 if 1 <= t < 1.6 else -0.1 if 1.6 <= t < 2.2 else 0.0)
        sim.run()
        rows.append([sim[name] for name in names.values()])
    return dict(zip(names, np.array(rows).T, strict=True))


def test_trim_and_doublet_are_like_jsbsim_s() -> None:
    theirs = jsbsim_doublet()
    aircraft = load_aircraft("twin_otter")
    # The elevator as JSBSim's moved: no actuator of ours in between.
    stiff = aircraft.elevator.model_copy(update={"time_constant": 0.004, "rate_limit": 50.0})
    moved = theirs["elevator"] - theirs["elevator"][0]
    halves = np.interp(np.arange(2 * STEPS + 1) * DT / 2, np.arange(STEPS) * DT, moved)
    ours = Simulation(aircraft.model_copy(update={"elevator": stiff}), Flight(), deflection=halves).advance(STEPS)
    assert math.degrees(abs(ours["alpha"][0] - theirs["alpha"][0])) < 1.5
    for name in ("q", "alpha"):
        one, other = ours[name] - ours[name][0], theirs[name] - theirs[name][0]
        assert np.corrcoef(one, other)[0, 1] > 0.97
        assert np.ptp(one) / np.ptp(other) == pytest.approx(1.0, abs=0.3)
