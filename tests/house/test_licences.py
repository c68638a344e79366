"""What comes with the station may be used as its own licence promises: nothing under the GPL, nothing unlicensed."""

import pytest
from licences import brought, direct, licence


@pytest.mark.parametrize("name", sorted(brought()))
def test_a_package_states_a_licence_that_asks_nothing_of_the_station_s_own(name: str) -> None:
    stated = licence(name)
    assert stated
    apart = stated.replace("LGPL", "").replace("Lesser General Public", "")
    assert "GPL" not in apart
    assert "General Public" not in apart


def test_what_is_asked_for_is_looked_at() -> None:
    assert {"numpy", "pymavlink", "tornado"} <= set(direct())
    assert {"dask", "tornado", "lxml"} <= brought()
