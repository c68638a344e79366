"""Lines of numbers, as loggers and home-made vanes write them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.codec import Reading
from drivers.serial_lines import LinesCodec


@pytest.mark.parametrize(
    ("line", "message", "numbers"),
    [
        (b"2.51,0.03,101.3\r\n", "line", [2.51, 0.03, 101.3]),
        (b"2.51; -0.03 ;1e3\n", "line", [2.51, -0.03, 1e3]),
        (b"  2.51   -0.03\n", "line", [2.51, -0.03]),
        (b"aoa 2.51\n", "aoa", [2.51]),
        (b"AIN,1.2,,3.4\r\n", "AIN", [1.2, None, 3.4]),
        (b"nan,1\n", "line", [None, 1.0]),
    ],
)
def test_a_line_is_read_however_its_numbers_are_parted(line: bytes, message: str, numbers: list[float | None]) -> None:
    codec = LinesCodec()
    (found,) = codec.feed(b"\n" + line)
    assert isinstance(found, Reading)
    assert found.message == message
    values = [None if value != value else value for value in found.fields.values()]
    assert values == numbers
    assert codec.bad == 0


@pytest.mark.parametrize("line", [b"alpha,beta\n", b"1.2.3\n", b"2.5 deg\n", b"\xff1\n", b"aoa\n", b"1," * 80 + b"\n"])
def test_what_is_no_line_of_numbers_is_counted(line: bytes) -> None:
    codec = LinesCodec()
    assert codec.feed(b"\n" + line) == []
    assert codec.bad == 1


@given(st.lists(st.binary(max_size=50)))
def test_lines_may_be_cut_anywhere_and_any_bytes_may_come(pieces: list[bytes]) -> None:
    whole, cut = LinesCodec(), LinesCodec()
    readings = whole.feed(b"".join(pieces))
    assert repr([r for piece in pieces for r in cut.feed(piece)]) == repr(readings)
    assert whole.bad == cut.bad


def test_who_listens_in_the_middle_of_a_line_waits_for_the_next() -> None:
    """Of `13.25` heard from the third character on, `.25` would be a number too; after a reconnect again."""
    codec = LinesCodec()
    assert codec.feed(b".25,-1.5\n") == []
    assert [r.fields["c0"] for r in codec.feed(b"13.5,-1.5\r\n13.75,-1.5\r\n")] == [13.5, 13.75]
    codec.reset()
    assert codec.feed(b"5,-1\n") == []
    assert codec.bad == 0
