"""Tables: one bad row costs one row, one bad file is one clear error."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from conegraph.errors import FileFormatError
from conegraph.io.csv_table import find_file, read_table, read_text


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_are_found_by_name(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", '\ufeff# Y , other,"x"\r\n2,zz,1\r\n\r\n4,,3\r\n')
    table = read_table(path, ("x", "y"), ("z",))
    assert table.numbers("x")[0].tolist() == [1.0, 3.0]
    assert table.numbers("y")[0].tolist() == [2.0, 4.0]
    assert table.line == [2, 4]
    assert "z" not in table


def test_blank_and_malformed_cells_are_told_apart(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "x,y\n,1\n  ,1\nnan,1\ninf,1\n1e13,1\nabc,1\n7\n")
    table = read_table(path, ("x", "y"))
    x, blank = table.numbers("x")
    assert np.isnan(x).tolist() == [True] * 6 + [False]
    assert blank.tolist() == [True, True, False, False, False, False, False]
    assert table.numbers("y")[1].tolist() == [False] * 6 + [True]


def test_rows_that_are_too_long_are_left_out(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "x,y\n1,2,3\n4,5,\n6,7\n")
    table = read_table(path, ("x",))
    assert table.overlong == 1
    assert table.numbers("x")[0].tolist() == [4.0, 6.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("\n  \n", "is empty"),
        ("x,z\n1,2\n", "no column 'y'"),
        ("x,y,x\n1,2,3\n", "column 'x' twice"),
        ("x\0,y\n1,2\n", "not a text file"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, text: str, said: str) -> None:
    path = write(tmp_path / "a.csv", text)
    with pytest.raises(FileFormatError, match=said) as caught:
        read_table(path, ("x", "y"))
    assert str(path) in str(caught.value)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(FileFormatError, match="cannot be read"):
            read_text(path)


def test_compressed_files(tmp_path: Path) -> None:
    packed = gzip.compress(b"x\n" + b"1\n" * 1000)
    path = tmp_path / "a.csv.gz"
    path.write_bytes(packed)
    assert len(read_table(path, ("x",))) == 1000
    assert find_file(tmp_path, "a.csv") == path
    path.write_bytes(packed[:-20])
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_text(path)
    path.write_bytes(b"x\n1\n")
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_text(path)


def test_a_small_file_cannot_unfold_without_limit(tmp_path: Path) -> None:
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(gzip.compress(b"1\n" * 3_000_000))
    assert path.stat().st_size < 10_000
    with pytest.raises(FileFormatError, match="larger than 1 MiB"):
        read_text(path, max_bytes=2**20)
