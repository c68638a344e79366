"""A steep turn that the elevator only holds tells no derivatives: none are given of it, live or after the flight.

In it moments stay in balance, of which all of the moment's derivatives being less is a solution too: of one of 80 s
Cm_alpha came out as -0.9 ± 0.1 for -1.3, and the flight was told as ice on wing and tail.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from programme_flights import INPUTS, flown

from station.conventions import SIGNALS, TICK_NS
from station.estimation.methods import Estimator
from station.log import metadata, table
from station.profile import load_aircraft
from station.programme.changes import recommended
from station.programme.programme import programme
from station.rows import Frame, MethodEstimate, Quality, Status

WORDS = "banked beyond 30 deg: what is compared with flies wings level"
AIR = 'gust_sigma = "1 ft/s"\n[[flight.legs]]\nstart = "36 s"\nbank = "45 deg"\n'
POINTS = (
    {"name": "level", "condition": "baseline", "start": "4 s", "end": "36 s"},
    {"name": "turn", "condition": "turn", "start": "48 s", "end": "90 s"},
)
ONCE = INPUTS.replace('repeat = "30 s"\n', "")
"""All of them before the turn."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown(tmp_path_factory.mktemp("turn"), POINTS, 91.0, AIR, ONCE)


def test_a_point_in_a_steep_turn_has_no_derivatives(log: Path) -> None:
    made = programme([log], [], load_aircraft("twin_otter"), ("II", "split", "split+gust", "physical"), lambda _: None)
    level, turn = made.points
    assert recommended(level) == "physical"
    assert recommended(turn) is None
    assert turn.banked == WORDS
    assert turn.methods is not None
    assert (turn.methods["physical"].status, turn.methods["physical"].why) == ("not_applicable", WORDS)
    assert not [n for n, c in made.change(1).items() if c.is_known and n not in ("CD_0", "CL_0")]
    assert not any(c.is_known for c in made.changes[1]["physical"].values())
    # With 1.4 times the lift, twice the induced drag: a tenth of that is a tenth of CD_0.
    assert not [n for n, c in made.change(1).items() if c.is_significant]


def test_live_a_turn_adds_nothing_to_what_was_known_before_it(log: Path) -> None:
    """Frozen from 30 deg of bank on; in the turn alone, begun afresh as by a point, nothing is estimated."""
    flight, about = table(log), metadata(log).about
    estimator = Estimator(load_aircraft("twin_otter"), about.card, about.imu_position, methods=("physical",))
    rows = np.column_stack([flight.columns.get(n, np.full(len(flight.t_s), math.nan)) for n in SIGNALS])
    bank = flight.columns["phi"]
    before, last = None, None
    for k, row in enumerate(rows.tolist()):
        ages = tuple(0.0 if x == x else math.nan for x in row)
        quality = tuple(int(Quality.FRESH if x == x else Quality.MISSING) for x in row)
        if k == 70 * 50:
            assert last is not None
            assert before is not None
            assert [p.value for p in last.parameters] == [p.value for p in before.parameters]
            assert last.parameters[0].status is Status.ESTIMATED
            estimator.start_point()
        last = estimates(estimator, Frame(k * TICK_NS, k, tuple(row), ages, quality))
        if abs(bank[k]) < math.radians(30):
            before = last
    assert last is not None
    assert (last.applicable, last.why) == (False, WORDS)


def estimates(estimator: Estimator, frame: Frame) -> MethodEstimate:
    return next(m for m in estimator.step(frame)[1] if m.method == "physical")
