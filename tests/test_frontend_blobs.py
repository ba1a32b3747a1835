"""Pieces of one colour, and which of them are one cone."""

import numpy as np
import pytest
from numpy.typing import NDArray

from conegraph.frontend.blobs import (
    MAX_PIECES,
    Pieces,
    find_pieces,
    split_ledges,
    stack_pieces,
)
from conegraph.frontend.towers import split_towers


def picture_of(*rows: str) -> NDArray[np.uint8]:
    return np.array([[" by".index(c) for c in row] for row in rows], dtype=np.uint8)


def stacked(pieces: Pieces, px_per_m: float, height_m: float = 0.325) -> list[int]:
    n = len(pieces.box_px)
    foot = stack_pieces(
        pieces, np.full(n, px_per_m), np.full(n, height_m), np.ones(n, dtype=bool)
    )
    return [int(row) for row in foot]


def test_pieces_have_their_boxes_and_specks_are_left_out() -> None:
    pieces = find_pieces(picture_of("bb  y", "bb  y", "     ", "  b  "))
    assert pieces.colour.tolist() == [1, 2]
    assert pieces.box_px.tolist() == [[-0.5, -0.5, 1.5, 1.5], [3.5, -0.5, 4.5, 1.5]]
    assert np.bincount(pieces.owner).tolist() == [4, 2]


def test_touching_colours_are_two_pieces() -> None:
    pieces = find_pieces(picture_of("bbyy", "bbyy"))
    assert sorted(pieces.colour.tolist()) == [1, 2]
    assert pieces.box_px[:, 2].tolist() == [1.5, 3.5]


def test_confetti_is_cut_short() -> None:
    confetti = np.zeros((300, 300), dtype=np.uint8)
    confetti[::3, ::3] = confetti[::3, 1::3] = 1
    confetti[5, 5:9] = 1
    assert 1 <= len(find_pieces(confetti).box_px) <= MAX_PIECES


def test_an_empty_picture_has_no_pieces() -> None:
    pieces = find_pieces(np.zeros((20, 30), dtype=np.uint8))
    assert pieces.box_px.shape == (0, 4)
    assert stacked(pieces, 10.0) == []


def test_a_stripe_parts_no_cone() -> None:
    pieces = find_pieces(picture_of("  bb  ", "  bb  ", "      ", " bbbb ", "bbbbbb"))
    assert len(set(stacked(pieces, 15.0))) == 1


@pytest.mark.parametrize(
    ("px_per_m", "together"), [(15.0, True), (2.0, False)], ids=["near", "far"]
)
def test_a_gap_must_be_as_low_as_a_stripe(px_per_m: float, together: bool) -> None:
    gap = ["      "] * 2
    pieces = find_pieces(picture_of("  bb  ", "  bb  ", *gap, " bbbb ", "bbbbbb"))
    assert (len(set(stacked(pieces, px_per_m))) == 1) == together


def test_a_cone_behind_does_not_rest_on_the_one_in_front() -> None:
    wide_above = picture_of("bbbbbb", "bbbbbb", "      ", "  bb  ", " bbbb ")
    assert len(set(stacked(find_pieces(wide_above), 15.0))) == 2
    tall = picture_of(*[" bb "] * 2, "    ", *[" bb "] * 8, "    ", "bbbb", "bbbb")
    assert len(set(stacked(find_pieces(tall), 20.0))) == 2


def test_a_foot_above_a_top_is_cut_off() -> None:
    both = picture_of(
        "   bb   ",
        "  bbbb  ",
        " bbbbbb ",
        "    b   ",
        "   bbb  ",
        "  bbbb  ",
        " bbbbbb ",
    )
    pieces = find_pieces(both)
    assert len(pieces.box_px) == 1
    parts, origin = split_ledges(pieces, np.array([20.0]))
    assert origin.tolist() == [0, 0]
    assert parts.box_px[:, [1, 3]].tolist() == [[-0.5, 2.5], [2.5, 6.5]]


def test_a_corner_that_ends_a_foot_is_not_cut_off() -> None:
    foot = picture_of("   bb   ", "  bbbb  ", " bbbbbb ", "   b    ")
    parts, _ = split_ledges(find_pieces(foot), np.array([40.0]))
    assert len(parts.box_px) == 1


def towers(left_px: int, right_px: int, dip_px: int) -> NDArray[np.int64]:
    """Return the pixels of two triangles of one height over a common bar."""
    pixels = [
        (u, 20 - v)
        for u in range(left_px + right_px)
        for v in range(max(dip_px, 14 - 2 * min(abs(u - 5), abs(u - 5 - right_px))))
    ]
    return np.array(pixels)


def test_two_tops_are_two_cones() -> None:
    pixels = towers(11, 12, 2)
    owner, origin = split_towers(
        pixels, np.zeros(len(pixels), dtype=int), np.array([30])
    )
    assert origin.tolist() == [0, 0]
    left, right = (pixels[owner == k, 0] for k in (0, 1))
    assert left.max() < right.min()
    assert left.mean() == pytest.approx(5, abs=1.5)


def test_a_shallow_dip_parts_nothing() -> None:
    pixels = towers(11, 12, 11)
    _, origin = split_towers(pixels, np.zeros(len(pixels), dtype=int), np.array([30]))
    assert origin.tolist() == [0]
