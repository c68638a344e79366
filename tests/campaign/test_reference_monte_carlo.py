"""The reference study's Monte Carlo, reproduced by the campaign of the same cases with this simulation and these
estimators: mean RMSE of CL_alpha, Cm_alpha, Cm_q and Cm_de, per cent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.campaign.engine import Store, fly_local
from station.campaign.findings import Rows
from station.campaign.spec import load_plan

METHODS = ("perfect", "raw", "II", "III", "V", "split", "split+gust")
STUDY = {
    ("A", "unsteady", 0.0, 0.0, "doublet"): (0.5, 13.6, 2.9, 12.5, 12.7, 0.7, 0.7),
    ("A", "unsteady", 5.0, 0.0, "doublet"): (13.0, 24.2, 20.2, 12.8, 13.3, 13.1, 4.1),
    ("A", "unsteady", 2.5, 0.0, "doublet"): (4.6, 17.5, 8.6, 11.7, 12.0, 4.7, 2.4),
    ("A", "unsteady", 5.0, 16.0, "doublet"): (6.7, 18.9, 11.2, 11.8, 12.2, 6.8, 2.6),
    ("A", "steady", 0.0, 0.0, "doublet"): (0.5, 13.7, 2.2, 12.2, 12.3, 0.8, 0.8),
    ("A", "steady", 5.0, 0.0, "doublet"): (0.4, 16.6, 7.5, 9.3, 9.7, 0.8, 0.7),
    ("A", "steady", 2.5, 0.0, "doublet"): (0.4, 14.9, 4.0, 10.2, 10.5, 0.7, 0.7),
    ("A", "steady", 5.0, 16.0, "doublet"): (0.4, 15.5, 4.9, 9.6, 10.0, 0.6, 0.6),
    ("A", "unsteady", 5.0, 0.0, "multisine"): (7.4, 21.8, 13.6, 13.7, 14.1, 7.5, 2.0),
    ("A", "unsteady", 10.0, 0.0, "multisine"): (13.5, 24.3, 20.1, 14.3, 14.8, 13.6, 4.9),
    ("B", "unsteady", 0.0, 0.0, "doublet"): (0.4, 13.0, 2.7, 12.1, 12.3, 0.5, 0.5),
    ("B", "unsteady", 5.0, 0.0, "doublet"): (8.7, 18.7, 12.4, 11.5, 11.9, 8.8, 4.8),
    ("B", "unsteady", 2.5, 0.0, "doublet"): (3.5, 15.3, 6.2, 11.4, 11.7, 3.5, 2.4),
    ("B", "unsteady", 5.0, 16.0, "doublet"): (4.4, 16.1, 7.3, 11.2, 11.5, 4.5, 2.7),
    ("B", "steady", 0.0, 0.0, "doublet"): (0.4, 14.0, 2.3, 12.9, 13.0, 0.5, 0.5),
    ("B", "steady", 5.0, 0.0, "doublet"): (0.4, 15.5, 4.5, 10.6, 11.0, 0.6, 0.6),
    ("B", "steady", 2.5, 0.0, "doublet"): (0.4, 14.7, 3.2, 11.8, 12.0, 0.6, 0.6),
    ("B", "steady", 5.0, 16.0, "doublet"): (0.3, 14.9, 3.6, 11.2, 11.5, 0.5, 0.5),
    ("B", "unsteady", 5.0, 0.0, "multisine"): (5.9, 19.7, 11.1, 13.2, 13.6, 6.0, 2.2),
    ("B", "unsteady", 10.0, 0.0, "multisine"): (11.3, 22.7, 16.5, 14.1, 14.6, 11.3, 4.6),
}
"""By aircraft (Martos, UIUC), lift, gust in ft/s, its start in s, and input; in the order of METHODS."""

OFF, SHARE = 0.9, 0.14
"""Per cent, and share of the study's value: its 100 seeds and these, about 1.4 standard deviations of a row's scatter
over the square root of 100 each; its downwash came 8 ms later, and its gusts at wing and tail met the trim speed."""


@pytest.mark.slow
def test_the_reference_monte_carlo_is_reproduced(tmp_path: Path) -> None:
    plan = load_plan("monte_carlo")
    store = Store(tmp_path / "out", plan, resume=False)
    fly_local(plan, store, 2, lambda n: None)
    rows = Rows(plan, store.finish())
    wrong = []
    physical = []
    for case in plan.cases:
        s = case.scenario
        key = (
            "A" if s.aircraft == "twin_otter_martos" else "B",
            s.lift,
            round(s.turbulence / 0.3048, 3),
            s.turbulence_start,
            s.input,
        )
        names = ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")
        for method, wanted in zip(METHODS, STUDY[key], strict=True):
            found = float(np.mean([rows.summary(case, method, name).rmse for name in names]))
            # split+gust does better here than in the study, whose gusts at the tail were not those at the vane.
            low = 0.0 if method == "split+gust" else wanted - OFF - SHARE * wanted
            if not low <= found <= wanted + OFF + SHARE * wanted:
                wrong.append((key, method, found, wanted))
        if s.lift == "unsteady":
            physical.append(float(np.mean([rows.summary(case, "physical", name).rmse for name in names])))
    assert not wrong
    # The design study of `physical` has 0.5 to 1.9 %, from the tabulated derivatives.
    assert max(physical) < 2.2
