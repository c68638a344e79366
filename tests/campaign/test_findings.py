"""Sentences about results, from rows made up so that the answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from station.campaign.figures import _errors, _estimates, draw
from station.campaign.findings import Rows, compare, judge
from station.campaign.spec import Plan, load_plan

SPEC = """
name = "t"
runs = 200
methods = ["II", "split"]
figures = ["estimates", "errors"]
show = ["Cm_q"]
[flight]
[factors]
turbulence = ["severe", "calm", "light"]
[[inputs.doublet]]
kind = "doublet"
start = "1 s"
width = "1 s"
amplitude = "2 deg"
[[claims]]
figure = "Figure 1"
parameter = "Cm_q"
finds = "more bias"
[[claims]]
figure = "Figure 1"
parameter = "Cm_q"
finds = "more scatter"
[[claims]]
figure = "Figure 1"
parameter = "Cm_q"
finds = "feasible"
[[comparisons]]
method = "split"
against = "II"
says = "asked"
"""
BIAS = {"II": {"calm": 0.02, "light": 0.15, "severe": 0.3}, "split": {"calm": 0.2, "light": 0.15, "severe": 0.05}}


@pytest.fixture
def rows(tmp_path: Path) -> Rows:
    """Errors whose mean is BIAS and whose standard deviation is 1 %, in every parameter."""
    spec = tmp_path / "t.toml"
    spec.write_text(SPEC, encoding="utf-8")
    plan = load_plan(str(spec))
    rng = np.random.default_rng(1)
    off = np.stack(
        [
            [BIAS[m][str(c.levels["turbulence"])] for m in ("II", "split")] + 0.01 * rng.standard_normal((200, 2))
            for c in plan.cases
        ]
    ).ravel()
    columns: dict[str, np.ndarray] = {}
    for name in plan.campaign.parameters:
        columns |= {name: 1.0 + off, f"{name}_sd": np.full_like(off, 0.01), f"{name}_reference": np.ones_like(off)}
        columns |= {f"{name}_error": off, f"{name}_covered": np.abs(off) < 0.02}
    result = tmp_path / "flights.parquet"
    pq.write_table(pa.table(columns), result)
    return Rows(plan, result)


def test_claims_are_judged_from_calm_to_severe(rows: Rows) -> None:
    bias, scatter, feasible = (judge(rows, claim) for claim in rows.plan.campaign.claims)
    assert bias.endswith("(calm, light, severe): we find it too.")
    assert "the bias is 1.9, 15.0, 29.9 %, its standard deviation 1.0, 1.0, 0.9 %" in bias
    assert scatter.endswith("we do not find it.")
    assert "here 2 of 3 cases have more than 20 of 200 flights beyond the tolerance (0 to 200; " in feasible
    assert "calm 0 of 1, light 1 of 1, severe 1 of 1): we do not find it." in feasible


def test_methods_are_compared_level_by_level(rows: Rows) -> None:
    plan: Plan = rows.plan
    cases = sorted(plan.cases, key=lambda c: c.scenario.turbulence)
    said = compare(rows, plan.campaign.comparisons[0], cases, "")
    assert said.startswith("split and II: asked; here the mean RMSE of CL_alpha, Cm_alpha, Cm_q, Cm_de is calm 20.")
    assert "better in severe, no different in light, worse in calm" in said
    assert said.endswith("below 10 % in severe.")


def test_figures_and_sentences_are_written(rows: Rows, tmp_path: Path) -> None:
    said = draw(rows.plan, tmp_path / "flights.parquet", tmp_path)
    assert (tmp_path / "findings.txt").read_text(encoding="utf-8").splitlines() == said
    assert len(said) == 4
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {
        "estimates_Cm_q_II.png",
        "estimates_Cm_q_split.png",
        "errors.png",
    }


def test_a_figure_says_below_it_what_it_shows(rows: Rows) -> None:
    below = {name: figure.get_supxlabel().replace("\n", " ") for name, figure in (*_estimates(rows), *_errors(rows))}
    claims, comparisons = rows.plan.campaign.claims, rows.plan.campaign.comparisons
    cases = sorted(rows.plan.cases, key=lambda c: c.scenario.turbulence)
    assert below == {
        "estimates_Cm_q_II": " ".join(judge(rows, claim) for claim in claims),
        "estimates_Cm_q_split": "",  # the claims are of the study's method, which is the first
        "errors": compare(rows, comparisons[0], cases, ""),
    }
