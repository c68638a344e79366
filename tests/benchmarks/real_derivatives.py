"""Derivatives of real records and foreign simulations as a user gets them, beside what is known of each.

    uv run python tests/benchmarks/real_derivatives.py [--listing]

Each record's columns become the station's CSV, `station import` a recording, `station identify --json` the estimates.
A line gives what is known (tests/real_records.py), the recommended method's estimate, or split's where that gives none,
with two standard errors, in brackets where it is not called estimated, by how many methods it is, and by which of these
in a 95 % interval that does not hold what is known. `--listing` prints what identify prints, too.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from real_aircraft import actuated, frame, known_of_dhc2, known_of_unstable, profile, regression, sides
from real_records import (
    ATTAS_BOOM,
    ATTAS_FRAME,
    ATTAS_IMU,
    ATTAS_KNOWN,
    COURSE,
    attas,
    dasmat,
    dhc2,
    fdata,
    phlab,
    unstable,
    write_csv,
)
from records import record

from station.__main__ import app
from station.conventions import LATERAL, LONGITUDINAL
from station.numerics.atmosphere import atmosphere

WINDOWS = ((4419, 4479), (534, 594), (4284, 4344))
CALM = ((3099, 3159), (3879, 3939))
STALL = ((2229, 2289),)
NO_NOISE = 1e-3
AS_PUBLISHED = ("sidpac",)
"""Whose errors are the published program's."""


class Station:
    """The command line in a folder."""

    def __init__(self, folder: Path, listing: bool) -> None:
        self.folder, self.listing = folder, listing

    def identify(self, source: Path | Mapping[str, np.ndarray], aircraft: str, *options: str) -> dict:
        path = source if isinstance(source, Path) else write_csv(dict(source), self.folder / "record.csv")
        log, out = self.folder / "record.mcap", self.folder / "out.json"
        for old in (log, out):
            old.unlink(missing_ok=True)
        text = io.StringIO()
        with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
            imported = ("import", path, "-o", log, "--aircraft", profile(aircraft, self.folder))
            for words in (imported, ("identify", log, "--json", out, *options)):
                app([str(w) for w in words], prog_name="station", standalone_mode=False)
        if self.listing:
            print(text.getvalue())
        return json.loads(out.read_text())


def cell(p: Mapping | None) -> str:
    if p is None or p["estimate"] is None:
        return "-"
    twice = 2 * (p["std_error"] or 0.0)
    places = max(0, min(5, 1 - math.floor(math.log10(twice)))) if twice > 0 else 4
    text = f"{p['estimate']:.{places}f} ± {twice:.{places}f}"
    return text if p["status"] == "estimated" else f"({text})"


def same(p: Mapping, truth: float) -> bool:
    """Without noise an interval is as wide as rounding."""
    return abs(p["estimate"] - truth) < NO_NOISE * abs(truth)


def show(title: str, result: Mapping, known: Mapping[str, float], names: Sequence[str]) -> None:
    """One line a derivative."""
    best = result["recommended"]
    print(f"\n{title}; recommended: {best}")
    for name in names:
        truth = known.get(name, math.nan)
        at = {m: r["parameters"].get(name) for m, r in result["methods"].items() if m not in AS_PUBLISHED}
        told = {m: p for m, p in at.items() if p and p["status"] == "estimated"}
        out = [m for m, p in told.items() if not (p["ci95"][0] <= truth <= p["ci95"][1] or same(p, truth))]
        shown = at.get(best) or at.get("split")
        missed = f"; not held by {', '.join(out)}" if out and math.isfinite(truth) else ""
        print(f"  {name:9s} {truth:9.4g} {cell(shown):>24s}   {len(told)} methods{missed}")
    for words in (w for w in result["remarks"] if "against the other signals" in w or "disagree" in w):
        print(f"  {words.split(': the standard errors')[0]}")


def attas_records(station: Station) -> None:
    for part, known in ATTAS_KNOWN.items():
        result = station.identify(attas(part), "attas")
        show(f"{part}; known by least squares made apart", result, known, LONGITUDINAL)
    result = station.identify(attas("fAttasElv1"), "attas_vane_at_cg")
    wrong = {"CL_q": 2 * 26.2, "Cm_q": 2 * -15.6}
    show("the same without the boom's rate term; what least squares then make of it", result, wrong, tuple(wrong))
    with_air = ATTAS_FRAME | {"density": 0.7387}
    both = [sides(attas(n), with_air, ATTAS_BOOM[0], ATTAS_IMU) for n in ("fAttasAil1", "fAttasRud1")]
    known = regression(*({k: v for k, v in each.items() if k[1] in "Yln"} for each in both)) | ATTAS_KNOWN["fAttasElv1"]
    result = station.identify(attas("fAttasAilRud1"), "attas")
    show("fAttasAilRud1; known by least squares on fAttasAil1 and fAttasRud1, and by fAttasElv1", result, known,
         (*LATERAL, *LONGITUDINAL))  # fmt: skip
    show("its first half, by every method", station.identify(attas("fAttasAilRud1"), "attas", "--to", "29.9"), known,
         LATERAL)  # fmt: skip
    show("fAttasElv1, where nobody moved aileron and rudder much; known by the lateral ones",
         station.identify(attas("fAttasElv1"), "attas"), known, LATERAL)  # fmt: skip


def simulations(station: Station) -> None:
    body = frame("citation") | {"density": atmosphere(2000.0)[2], "tables": 1.0}
    known = regression(sides(actuated(dasmat("de3211_1"), body, "elevator", "Cm"), body))
    words = "DASMAT, elevator 3-2-1-1, {}; known by least squares without noise, actuators followed"
    for noise, aircraft, how in ((0.0, "citation", "as it is"), (1.0, "citation", "with noise laid over it"),
                                 (1.0, "citation_actuated", "with noise, the actuators' lag stated")):  # fmt: skip
        result = station.identify(dasmat("de3211_1", noise), aircraft)
        show(words.format(how), result, known, LONGITUDINAL)
    for aircraft, how in (("citation", ""), ("citation_actuated", ", the actuators' lag stated")):
        clean = station.identify(dasmat("dr3211_1"), aircraft)["methods"]["II"]["parameters"]
        known = {n: p["estimate"] for n, p in clean.items() if p["estimate"] is not None}
        result = station.identify(dasmat("dr3211_1", 1.0), aircraft)
        show(f"DASMAT, rudder 3-2-1-1, with noise laid over it{how}; known: II without noise", result, known, LATERAL)
    show("DHC-2 with process noise; known from its making", station.identify(dhc2(), "dhc2"), known_of_dhc2(), LATERAL)
    show("unstable aircraft under feedback; known from its making", station.identify(unstable(), "unstable"),
         known_of_unstable(), LONGITUDINAL)  # fmt: skip


def records_of_nasa_and_dlr(station: Station) -> None:
    path = record("tu144/tu144_f20_4d_data.mat")
    columns = fdata(path)
    air = {"density": atmosphere(float(np.mean(columns["altitude [ft]"])) * 0.3048)[2]}
    known = regression(sides(columns, frame("tu144") | air))
    show("Tu-144LL, flight 20; known by SIDPAC's least squares, vane as it is", station.identify(path, "tu144"), known,
         LONGITUDINAL)  # fmt: skip
    for title, name, aircraft in (
        ("Twin Otter, lateral", "twin_otter/totter_f1_017_data.mat", "twin_otter"),
        ("HFB-320", "hfb320/hfb320_1_10.asc", "hfb320"),
    ):
        show(title, station.identify(record(name), aircraft), {}, LONGITUDINAL)


def citation_in_flight(station: Station) -> None:
    kinds = ("calm", CALM), ("slowly into the stall", STALL), ("turbulent", WINDOWS)
    for (start, end), air in ((w, a) for a, ws in kinds for w in ws):
        result = station.identify(phlab(start, end), "phlab")
        show(f"PH-LAB, {start} to {end} s, {air}; known: its course's values", result, COURSE, LONGITUDINAL)


PARTS = {
    "attas": attas_records,
    "simulations": simulations,
    "peers": records_of_nasa_and_dlr,
    "phlab": citation_in_flight,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all if left out")
    parser.add_argument("--listing", action="store_true", help="print what identify prints, too")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        station = Station(Path(name), given.listing)
        for part in given.parts or PARTS:
            PARTS[part](station)


if __name__ == "__main__":
    main()
