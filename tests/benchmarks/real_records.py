"""Instruments against each other on real records, a foreign simulation and the foreign flights, with what is known.

    uv run python tests/benchmarks/real_records.py [--flights N]

ATTAS's and PH-LAB's figures are published or from kinematic fits made apart from the station (tests/records.toml); a
record's table is made as a user's: its columns as the station's CSV, `station import`, the table that `identify` begins
with. Of the foreign flights (every Nth) the share of 95 % intervals that hold the hidden lag and scale is counted, and
in how many an instrument that is sound is said to be late.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from real_records import attas, dasmat, phlab, write_csv
from records import record

from station.convert import import_file
from station.identification.instrument_table import CI95, InstrumentTable, cell, of_recording
from station.log import table
from station.profile import load_aircraft

SOUND_SD = 3.0
"""Standard deviations of a lag that is said to stand out."""
KNOWN = {
    "fAttasElv1": "q 12 ms late, scale 1.02 to 1.04, zero 0.195 deg/s; az zero 0.084 m/s2; psi 20 ms later still",
    "fAttasElv2": "the same aircraft again",
    "phlab": "vane 290 ms, altitude rate 840 ms late; vane scale 1.07",
    "dasmat": "no instruments: nothing late",
}
GUSTS = {
    (4419, 4479): 1.02,
    (534, 594): 0.58,
    (4284, 4344): 0.46,
    (849, 909): 0.04,
    (909, 969): 0.04,
    (4029, 4089): 0.04,
}
SHOWN = ("q", "az", "alpha_vane", "v_down", "airspeed", "altitude", "p", "psi", "r", "beta_vane")


def examined(columns: dict[str, np.ndarray], aircraft: str, folder: Path) -> InstrumentTable:
    """The table of a record that is imported as a user would."""
    log = folder / "record.mcap"
    log.unlink(missing_ok=True)
    subject = load_aircraft(aircraft)
    import_file(write_csv(columns, folder / "record.csv"), log, subject)
    made = of_recording(table(log), subject, (0.0, 0.0, 0.0), None)
    assert isinstance(made, InstrumentTable), made
    return made


def show(name: str, made: InstrumentTable, known: str) -> None:
    print(f"\n{name}; known: {known}")
    for row in made.rows:
        if row.signal in SHOWN:
            lag, scale = cell(row, "lag"), cell(row, "scale")
            print(f"  {row.signal:11s} lag {lag:>18s}  scale {scale:>16s}  zero {cell(row, 'zero')}")


def foreign(every: int, folder: Path) -> None:
    flights = record("flights/answers.json").parent
    answers = json.loads((flights / "answers.json").read_text())
    held: dict[str, list[bool]] = {}
    false: dict[str, list[bool]] = {}
    for name in sorted(answers)[::every]:
        answer = answers[name]
        lines = gzip.decompress((flights / f"{name}.csv.gz").read_bytes()).decode().splitlines()
        titles = lines[0].split(",")
        values = np.genfromtxt(lines[1:], delimiter=",")
        values = values[values[:, 0] >= answer["manoeuvre_from_s"]]
        made = examined(dict(zip(titles, values.T, strict=True)), "twin_otter", folder)
        hidden, constants = answer["hidden"], answer["constants"]
        vane = constants["ZV"] / (math.pi * constants["WN"])
        truth = {
            ("q", "lag"): hidden.get("q.delay", 0.0), ("q", "scale"): hidden.get("q.scale", 1.0),
            ("alpha_vane", "lag"): hidden.get("alpha_vane.delay", 0.0) + vane,
            ("alpha_vane", "scale"): hidden.get("alpha_vane.scale", 1.0) * (1 + constants["KU0"]),
            ("v_down", "lag"): hidden.get("velocity.delay", 0.0), ("v_down", "scale"): 1.0,
        }  # fmt: skip
        rows = {row.signal: row for row in made.rows}
        for (signal, kind), true in truth.items():
            value = rows[signal].of(kind)
            key = f"{signal} {kind}"
            if value.why:
                continue
            held.setdefault(key, []).append(abs(value.value - true) <= CI95 * value.sd)
            if (
                kind == "lag"
                and f"{signal}.delay" not in hidden
                and not (signal == "v_down" and "velocity.delay" in hidden)
            ):
                sound = vane if signal == "alpha_vane" else 0.0
                false.setdefault(key, []).append(abs(value.value - sound) > SOUND_SD * value.sd)
    print(f"\nforeign flights, every {every}: told in, 95 % intervals that hold; sound ones said to be late")
    for key, holds in held.items():
        late = false.get(key)
        words = f"; {sum(late)} of {len(late)}" if late else ""
        print(f"  {key:17s} {len(holds):4d}  {100 * sum(holds) / len(holds):3.0f} %{words}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=1, metavar="N", help="every Nth of the foreign flights")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("fAttasElv1", "fAttasElv2"):
            show(part, examined(attas(part), "attas", folder), KNOWN[part])
        made = examined(phlab(480.0, 4600.0), "unknown", folder)
        show("PH-LAB, in flight", made, KNOWN["phlab"])
        print("\nvertical gust 0.1 to 2 Hz, m/s: found, known")
        for (start, end), level in GUSTS.items():
            print(f"  {start}-{end} s: {examined(phlab(start, end), 'unknown', folder).gust_sd:.2f}  {level:.2f}")
        for noise in (0.0, 1.0):
            made = examined(dasmat("de3211_1", noise), "unknown", folder)
            show(f"DASMAT 3-2-1-1, {'noise laid over it' if noise else 'as it is'}", made, KNOWN["dasmat"])
        foreign(given.flights, folder)


if __name__ == "__main__":
    main()
