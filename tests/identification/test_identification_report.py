"""The report is one file that needs nothing else, says what identify said, and hides no refusal."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from station.estimation.published.cross_spectra import VaneSpectra
from station.identification.analysis import identify
from station.identification.identification_answer import answer
from station.identification.identification_report import write_report
from station.identification.request import Request
from station.log import Table
from station.profile import Aircraft, Geometry, Inertia
from station.rows import LogError

AIRCRAFT = Aircraft(
    name="<glider>",
    geometry=Geometry.model_validate({"wing_area": "39 m2", "span": "19.8 m", "chord": "2 m"}),
    inertia=Inertia.model_validate({"mass": "4950 kg", "iyy": "33000 kg m2"}),
)


def record(amplitude: float = 1.0) -> Table:
    """Coefficients that follow the regressors exactly, but for noise; no flight mechanics needed."""
    rng = np.random.default_rng(6)
    n, dt = 900, 0.02
    t = np.arange(n) * dt
    alpha = amplitude * 0.03 * np.sin(2 * np.pi * 0.4 * t)
    q = amplitude * 0.05 * np.sin(2 * np.pi * 0.7 * t + 1)
    elevator = amplitude * 0.02 * np.sign(np.sin(2 * np.pi * 0.25 * t))
    qhat = q * 2 / 120
    cl = 0.6 + 5.5 * alpha + 12 * qhat + 0.5 * elevator + rng.normal(scale=0.002, size=n)
    cm = -1.3 * alpha - 30 * qhat - 1.7 * elevator + rng.normal(scale=0.001, size=n)
    force = 2000.0 * 39
    columns = {
        "alpha_vane": alpha,
        "airspeed": np.full(n, 60.0),
        "dynamic_pressure": np.full(n, 2000.0),
        "q": q,
        "qdot": cm * force * 2 / 33000,
        "ax": cl * np.sin(alpha) * force / 4950,
        "az": -cl * np.cos(alpha) * force / 4950,
        "elevator": elevator,
    }
    return Table(t, columns, AIRCRAFT, 0)


class Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def read(path: Path) -> Tags:
    tags = Tags()
    tags.feed(path.read_text())
    return tags


def test_report_is_self_contained_and_says_what_was_found(tmp_path: Path) -> None:
    flown = record()
    found = identify(flown, AIRCRAFT, Request(["I", "II", "III", "sidpac", "oe"], log="flight.mcap"))
    path = write_report(found, tmp_path / "report")
    tags = read(path)
    assert len(tags.sources) == 3
    assert all(s.startswith("data:image/png;base64,") for s in tags.sources)
    text = " ".join(tags.text)
    assert "<glider>" in text
    assert "flight.mcap" in text
    p = found.methods["I"].parameter("CL_alpha")
    assert p is not None
    shown = re.findall(r"(-?[\d.]+) ± ([\d.]+)", text)[0]
    best = found.methods[found.recommended or ""].parameter("CL_alpha")
    assert best is not None
    assert abs(float(shown[0]) - best.value) < 0.1 * best.sd
    assert float(shown[1]) == pytest.approx(2 * best.sd, rel=0.06)
    assert f"{p.value:.3g}"[:4] in text
    assert "III: calm air" in text
    assert "oe: the record has no theta" in text
    assert path.stat().st_size < 600_000


def test_the_page_begins_with_a_sentence_that_holds_the_derivatives_flown(tmp_path: Path) -> None:
    """The lift slope that `record` is made with lies within three of the standard errors quoted; its moment, which
    the noise of its rates does not show, is said not to be estimated, and a doubted profile to be suspect."""
    found = identify(record(), AIRCRAFT, Request(["I", "II"]))
    page = write_report(found, tmp_path).read_text()
    said = re.findall(r'<p class="verdict">(.*?)</p>', page)
    assert said == [html.escape(answer(found))]
    assert page.index("verdict") < page.index("<table") < page.index("<img")
    value, twice = re.findall(r"CL_alpha ([\d.]+) ± ([\d.]+)", said[0])[0]
    assert abs(float(value) - 5.5) < 1.5 * float(twice)
    assert "not estimated: Cm_alpha, Cm_q, Cm_de." in said[0]
    assert "Cm_q -" not in said[0]
    assert "; SUSPECT: the flight contradicts the profile" in answer(replace(found, hint="is it the aircraft?"))


def test_a_report_without_any_estimate_says_why(tmp_path: Path) -> None:
    flown = record(amplitude=0.0)
    found = identify(flown, AIRCRAFT, Request(["I", "II"]))
    text = " ".join(read(write_report(found, tmp_path)).text)
    assert "nothing could be estimated" in text
    assert "no elevator input" in text


def test_a_folder_that_cannot_be_made_is_a_log_error(tmp_path: Path) -> None:
    flown = record()
    (tmp_path / "taken").write_text("")
    with pytest.raises(LogError, match=r"identification\.html: cannot be written"):
        write_report(identify(flown, AIRCRAFT, Request(["I"])), tmp_path / "taken")


def test_spectra_that_iv_measured_are_drawn(tmp_path: Path) -> None:
    flown = record()
    found = identify(flown, AIRCRAFT, Request(["I", "II", "IV"]))
    assert "Delay and upwash by frequency" not in write_report(found, tmp_path / "without").read_text()
    assert found.flown is not None
    lines = np.array([0.1, 0.5, 2.0])
    spectra = VaneSpectra(*(lines,) * 7, believed=np.full(3, True), segments=9, segment_s=20.0)
    page = write_report(replace(found, flown=replace(found.flown, spectra=spectra)), tmp_path / "with").read_text()
    assert "Delay and upwash by frequency" in page
    assert page.count("<img") == (tmp_path / "without" / "identification.html").read_text().count("<img") + 1
