"""Which rows stay when stamps run backwards."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.io.stamps import ascending

NAN = float("nan")


@pytest.mark.parametrize(
    ("stamps", "kept"),
    [
        ([], []),
        ([1.0, 1.0, 2.0], [1, 1, 1]),
        ([0.0, 1.0, 0.5, 2.0], [1, 1, 0, 1]),
        ([0.0, 1e9, 1.0, 2.0, 3.0], [1, 0, 1, 1, 1]),
        ([5.0, 0.0, 1.0, 2.0], [0, 1, 1, 1]),
        ([NAN, 1.0, NAN, 0.5], [0, 1, 0, 0]),
    ],
)
def test_known_cases(stamps: list[float], kept: list[int]) -> None:
    assert ascending(np.array(stamps)).tolist() == [bool(k) for k in kept]


@settings(deadline=None)
@given(st.lists(st.integers(0, 6), max_size=9))
def test_no_longer_run_exists(stamps: list[int]) -> None:
    array = np.array(stamps, dtype=np.float64)
    kept = array[ascending(array)]
    assert np.all(np.diff(kept) >= 0)
    longest = max(
        size
        for size in range(len(stamps) + 1)
        if any(list(c) == sorted(c) for c in combinations(stamps, size))
    )
    assert len(kept) == longest
