"""MATLAB files as scipy writes them, as MATLAB itself wrote some records, and by hand after its format."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from records import record
from scipy.io import loadmat, savemat

from station.convert.mat_variables import variables
from station.rows import LogError

KINDS = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?")
MADE = [
    "tu144/tu144_f20_4d_data.mat",
    "attas/fAttasElv1.mat",
    "twin_otter/totter_f1_017_data.mat",
    "twin_otter/totter_demo_data.mat",
    "thor/thor_flight75.mat",
]
matrices = st.sampled_from(KINDS).flatmap(lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=2, min_side=0)))


@settings(max_examples=200, deadline=None)
@given(st.lists(matrices, min_size=1, max_size=3), st.booleans(), st.booleans())
def test_arrays_come_back_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, made: list[Any], packed: bool, in_struct: bool
) -> None:
    path = tmp_path_factory.mktemp("mat") / "a.mat"
    named = {f"x{i}": array for i, array in enumerate(made)}
    savemat(path, {"s": named} if in_struct else named, do_compression=packed)
    there = variables(path)
    assert list(there) == (["s"] if in_struct else list(named))
    found = there["s"].read() if in_struct else {name: there[name].read() for name in there}
    assert isinstance(found, dict)
    for name, array in named.items():
        np.testing.assert_array_equal(found[name], array.astype(np.float64), strict=True)


@pytest.mark.parametrize("name", MADE)
def test_files_that_matlab_wrote_are_read_as_scipy_reads_them(name: str) -> None:
    path = record(name)
    expected = loadmat(path, struct_as_record=False)
    for variable, here in variables(path).items():
        there = expected[variable]
        if not here.is_struct:
            check(here.read(), there)
        elif there.shape == (1, 1):
            fields = here.read()
            assert isinstance(fields, dict)
            assert list(fields) == there[0, 0]._fieldnames
            for field, value in fields.items():
                check(value, getattr(there[0, 0], field))


def check(found: object, expected: Any) -> None:
    if expected.dtype.kind in "fiub":
        np.testing.assert_array_equal(found, expected)
    else:
        assert found is None


def test_what_is_no_array_of_real_numbers_is_none(tmp_path: Path) -> None:
    cell = np.empty((1, 2), dtype=object)
    cell[:] = [[np.zeros(3), "text"]]
    content = {"complex": np.array([[1j]]), "text": "abc", "cell": cell}
    savemat(tmp_path / "a.mat", {**content, "s": content})
    there = variables(tmp_path / "a.mat")
    assert [there[name].read() for name in content] == [None] * 3
    assert there["s"].read() == dict.fromkeys(content)


def element(kind: int, content: bytes, order: str) -> bytes:
    """Tag and data, filled up to eight bytes; what has four bytes at most in its tag (*MAT-File Format*, 1-10)."""
    if len(content) <= 4:
        return struct.pack(order + "I", len(content) << 16 | kind) + content.ljust(4, b"\0")
    return struct.pack(order + "2I", kind, len(content)) + content + bytes(-len(content) % 8)


@pytest.mark.parametrize("order", ["<", ">"])
def test_bytes_in_either_order(tmp_path: Path, order: str) -> None:
    body = element(6, struct.pack(order + "2I", 6, 0), order) + element(5, struct.pack(order + "2i", 2, 2), order)
    body += element(1, b"ab", order) + element(3, struct.pack(order + "4h", 1, -2, 3, 4), order)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(order + "2H", 0x0100, 0x4D49)
    (tmp_path / "a.mat").write_bytes(head + struct.pack(order + "2I", 14, len(body)) + body)
    np.testing.assert_array_equal(variables(tmp_path / "a.mat")["ab"].read(), [[1.0, 3.0], [-2.0, 4.0]], strict=True)


def test_a_string_or_a_table_beside_the_matrix_is_passed_over(tmp_path: Path) -> None:
    """Opaque objects (class 17) have no dimensions: name, MCOS, class, and an array (as scipy reads them)."""
    savemat(tmp_path / "a.mat", {"fdata": np.arange(6.0).reshape(2, 3)})
    inside = element(6, struct.pack("<2I", 13, 0), "<") + element(5, struct.pack("<2i", 1, 1), "<")
    inside += element(1, b"", "<") + element(6, struct.pack("<I", 7), "<")
    body = element(6, struct.pack("<2I", 17, 0), "<") + element(1, b"note", "<") + element(1, b"MCOS", "<")
    body += element(1, b"string", "<") + struct.pack("<2I", 14, len(inside)) + inside
    data = (tmp_path / "a.mat").read_bytes()
    path = tmp_path / "b.mat"
    path.write_bytes(data[:128] + struct.pack("<2I", 14, len(body)) + body + data[128:])
    np.testing.assert_array_equal(loadmat(path)["fdata"], np.arange(6.0).reshape(2, 3))  # the file is one
    there = variables(path)
    assert list(there) == ["fdata"]
    np.testing.assert_array_equal(there["fdata"].read(), np.arange(6.0).reshape(2, 3), strict=True)


def test_a_file_of_level_4(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"fdata": np.arange(6.0).reshape(2, 3), "text": "abc"}, format="4")
    there = variables(tmp_path / "a.mat")
    np.testing.assert_array_equal(there["fdata"].read(), np.arange(6.0).reshape(2, 3), strict=True)
    assert there["text"].read() is None


@pytest.mark.parametrize(
    ("at", "value", "says"),
    [
        (132, 2**31, "an element of 2147483648 bytes where"),
        (140, 2**20, "an element of 1048576 bytes where"),
        (160, 7, r"x has 6 numbers for a shape of \(7, 3\)"),
        (164, -1, "no array of MATLAB's"),
        (176, 8, "data of type 8"),
        (180, 2**16, "an element of 65536 bytes where"),
    ],
)
def test_a_size_that_does_not_fit_is_told(tmp_path: Path, at: int, value: int, says: str) -> None:
    """Of the variable, its flags, its dimensions, the type of its numbers and their bytes."""
    path = tmp_path / "a.mat"
    savemat(path, {"x": np.arange(6.0).reshape(2, 3)})
    data = bytearray(path.read_bytes())
    data[at : at + 4] = struct.pack("<I", value % 2**32)
    path.write_bytes(data)
    with pytest.raises((LogError, ValueError), match=says):
        variables(path)["x"].read()


def test_a_file_of_version_7_3_is_told_how_to_be_saved(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(
        b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<2H", 0x0200, 0x4D49) + bytes(512)
    )
    with pytest.raises(LogError, match="save it with -v7"):
        variables(tmp_path / "a.mat")
