"""Where identification begins in a recording whose links, or whose estimators, came up after it had begun."""

import numpy as np
import pytest

from station.identification.preparation import begin
from station.log import Table
from station.profile import load_aircraft

N = 500


def table(**missing_until_s: float) -> Table:
    """Ten seconds at 50 Hz; each named signal is missing until its time."""
    t = np.arange(N) * 0.02
    names = ("alpha_vane", "airspeed", "q", "ax", "az", "theta", "elevator", "latitude")
    columns = {n: np.where(t < missing_until_s.get(n, missing_until_s.get("every", 0.0)), np.nan, 1.0) for n in names}
    return Table(t, columns, load_aircraft("twin_otter"), 0)


@pytest.mark.parametrize(
    ("missing_until_s", "begins_s"),
    [
        ({}, 0.0),
        ({"q": 0.1, "elevator": 0.06}, 0.1),  # the last link of the rig
        ({"every": 4.0}, 4.0),  # no frames before
        ({"every": 4.0, "theta": 4.5}, 4.5),
        ({"theta": 9.0}, 0.0),  # a signal that comes late is not waited for
        ({"theta": 99.0}, 0.0),  # or never comes
        ({"latitude": 1.0}, 0.0),  # nothing needs it
        ({"every": 99.0}, 0.0),
    ],
)
def test_identification_begins_with_the_signals(missing_until_s: dict[str, float], begins_s: float) -> None:
    assert begin(table(**missing_until_s)) == pytest.approx(begins_s, abs=0.011)
