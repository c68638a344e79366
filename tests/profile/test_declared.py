"""Signals that a rig declares and derives: what is wrong with them is told by key; expressions are worked out as
Python works them out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from station.profile import Formula, FormulaError, Rig, from_json, load_rig, to_json
from station.rows import ProfileError

RIG = """
name = "r"
[signals.torque]
unit = "N m"
limit_low = "-10 N m"
limit_high = "1000 lbf ft"
low = "-100 N m"
high = "5000 N m"
[derived.load]
unit = "1"
expression = "-az/g0"
[derived.power]
unit = "kW"
expression = "torque*load*20/1000"
[[devices]]
name = "box"
link = "serial"
protocol = "boombox"
port = "emulated"
[[devices.streams]]
name = "a"
message = 1
rate = "50 Hz"
[devices.streams.signals]
az = { field = "v0", unit = "g" }
torque = { field = "v1", unit = "N m" }
"""


def rig(tmp_path: Path, text: str = RIG) -> Rig:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return load_rig(str(path))


def test_what_is_declared_stands_after_the_stations_signals_and_survives_a_recording(tmp_path: Path) -> None:
    made = rig(tmp_path)
    assert list(made.further.signals)[-3:] == ["torque", "load", "power"]
    torque = made.further.signals["torque"]
    assert (torque.unit, torque.low, torque.high) == ("N m", -100.0, 5000.0)
    assert made.signals["torque"].limit_high == pytest.approx(1355.8179, rel=1e-6)  # NIST SP 811: 1 lbf ft
    again = from_json(Rig, to_json(made))
    assert again == made
    assert list(again.further.index.items()) == list(made.further.index.items())


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ('unit = "N m"\nlimit', 'unit = "Nmm"\nlimit', "signals.torque", "unknown unit 'Nmm'; did you mean mm?"),
        ('unit = "N m"\nlimit', 'unit = "deg"\nlimit', "signals.torque", "low: write a number and a unit"),
        ('"-10 N m"', '"2000 N m"', "signals.torque", "limit_low is not below limit_high: they are reversed"),
        ('low = "-100 N m"', 'low = "6000 N m"', "signals.torque", "low is not below high: they are reversed"),
        ('"-10 N m"', "-10.0", "signals.torque", "limit_low: write a number and a unit"),
        ("[signals.torque]", "[signals.torqe]", "devices[0].streams[0].signals.torque", "did you mean torqe?"),
        ("[signals.torque]", '[signals.q]\nunit = "m"\n[signals.torque]', "signals.q", "in rad/s: unit 'm' does not"),
        ("[signals.torque]", '[signals.ice]\nunit = "V"\n[signals.torque]', "signals.ice", "no device gives it"),
        ("[signals.torque]", '[signals.time]\nunit = "s"\n[signals.torque]', "signals.time", "means something else"),
        ("[signals.torque]", '[signals."a b"]\nunit = "s"\n[signals.torque]', "signals.a b", "a name has letters"),
        ("[derived.load]", "[derived.torque]", "derived.torque", "is declared in [signals], too"),
        ("[derived.load]", "[derived.q]", "derived.q", "is a signal of the station, and measured"),
        ("-az/g0", "-ax/g0", "derived.load.expression", "ax: no device of the rig gives it"),
        ("-az/g0", "-torqu/g0", "derived.load.expression", "torqu: it names nothing; did you mean torque?"),
        ("-az/g0", "-power/g0", "derived.load.expression", "in a circle: load of power of load"),
        ("-az/g0", "load + az", "derived.load.expression", "in a circle: load of load"),
        ("-az/g0", "az/0", "derived.load", "'az / 0' divides by zero"),
        ("-az/g0", "az/(2 - 2)", "derived.load", "divides by zero"),
        ("-az/g0", "az +", "derived.load", "'az +' is not an expression"),
        ("-az/g0", "2*pi", "derived.load", "names no signal"),
        ('torque = { field = "v1", unit = "N m" }', 'torque = { field = "v1", unit = "kg" }',
         "devices[0].streams[0].signals.torque", "signal torque is in N m: unit 'kg' does not fit"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_key(tmp_path: Path, old: str, new: str, key: str, words: str) -> None:
    assert old in RIG
    with pytest.raises(ProfileError) as told:
        rig(tmp_path, RIG.replace(old, new, 1))
    assert f"rig.toml: {key}: " in str(told.value)
    assert words in str(told.value)


def test_a_table_that_is_there_twice_is_no_toml(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="not valid TOML: Cannot declare"):
        rig(tmp_path, RIG.replace("[derived.load]", '[signals.torque]\nunit = "N m"\n[derived.load]'))


@pytest.mark.parametrize(
    "text",
    ["__import__('os').getcwd()", "q.real", "[q for q in p]", "lambda: q", "q if p else r", "q @ p", "q == p", "f'{q}'",
     "(q := 1)", "open(q)", "q[0]", "True", "9**9**9**9", "1e999", "(" * 400 + "q" + ")" * 400, "sqrt(-1)", "max(q)"],
)  # fmt: skip
def test_what_is_no_formula_is_refused_and_never_run(text: str) -> None:
    with pytest.raises(FormulaError):
        Formula(text)


@pytest.mark.parametrize(
    "text",
    ["-az/g0 + 2**-q*3", "hypot(az, q) - atan2(q, az)", "min(az, q)*max(az, pi) - abs(q)", "exp(-q)*sin(az)**3",
     "-q**2", "sqrt(abs(az)) + log(abs(az)) - log10(abs(q)) + tanh(q)", "az - q - 1/az/q", "2**3**0.5*q"],
)  # fmt: skip
def test_a_formula_has_the_value_that_python_gives_it(text: str) -> None:
    """Of one instant and of columns, against the interpreter itself."""
    formula, rng = Formula(text), np.random.default_rng(1)
    columns = {"az": rng.normal(-9.8, 2.0, 50), "q": rng.normal(0.0, 1.0, 50)}
    known = {n: getattr(math, n) for n in dir(math)} | {"g0": 9.80665, "abs": abs, "min": min, "max": max}
    work = formula.numbers({"az": 0, "q": 1})
    rows = list(zip(*columns.values(), strict=True))
    expected = [eval(text, {}, known | {"az": float(a), "q": float(b)}) for a, b in rows]
    np.testing.assert_allclose([work([float(a), float(b)]) for a, b in rows], expected, rtol=1e-15)
    np.testing.assert_allclose(formula.over(columns), expected, rtol=1e-13)


def test_columns_are_missing_where_a_formula_has_no_value() -> None:
    made = Formula("az/q").over({"az": np.array([1.0, 1.0, 0.0, np.nan]), "q": np.array([2.0, 0.0, 0.0, 1.0])})
    np.testing.assert_array_equal(made, [0.5, np.nan, np.nan, np.nan])
