"""Colour and depth joined by their stamps."""

from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from conegraph.frontend.realsense_frames import BACKWARDS, INCOMPLETE, MISSING
from conegraph.frontend.realsense_pairs import Pairs
from conegraph.frontend.realsense_playback import Picture

PIXELS = np.zeros((1, 1), dtype=np.uint8)


def picture(number: int, late_s: float = 0.0) -> Picture:
    return Picture(number / 30.0 + late_s, number, PIXELS, 0.0)


def joined(
    colors: list[Picture], depths: list[Picture]
) -> tuple[list[tuple[int, int]], Counter[str]]:
    left_out: Counter[str] = Counter()
    pairs = Pairs(0.5 / 30.0, left_out)
    made = [(c.number, d.number) for c, d in pairs.of(iter(colors), iter(depths))]
    assert pairs.colors_seen == len(colors)
    return made, left_out


@given(st.sets(st.integers(0, 40)), st.sets(st.integers(0, 40)))
def test_only_pictures_of_one_moment_are_joined(one: set[int], other: set[int]) -> None:
    colors = [picture(k) for k in sorted(one)]
    depths = [picture(k, 0.01) for k in sorted(other)]
    made, left_out = joined(colors, depths)
    assert made == [(k, k) for k in sorted(one & other)]
    assert left_out[INCOMPLETE] == len(one ^ other)
    assert left_out[MISSING] == (max(one) - min(one) + 1 - len(one) if one else 0)


def test_a_stamp_that_runs_backwards_is_counted() -> None:
    colors = [picture(1), picture(2), picture(1), picture(3)]
    made, left_out = joined(colors, [picture(k) for k in (1, 2, 3)])
    assert made == [(1, 1), (2, 2), (3, 3)]
    assert left_out == {BACKWARDS: 1}
