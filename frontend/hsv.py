"""The colour detector: pixels of a cone's colour, joined to shapes of a cone.

It takes the idea of the thesis's chapter 3 (thresholds on hue, saturation and value,
then shape) without its mean shift, and mends what that chapter leaves open: red wraps
around, stripes part a cone into pieces, shade darkens colours, neighbours touch.
"""

from __future__ import annotations

import cv2
import numpy as np

from conegraph.config import HsvConfig
from conegraph.frontend.base import Candidates, Picture
from conegraph.frontend.blobs import boxes, find_pieces, split_ledges, stack_pieces
from conegraph.frontend.colours import COLOURS, colour_of_pixels
from conegraph.frontend.scale import (
    BIG_HEIGHT_M,
    CONE_HEIGHT_M,
    GroundScale,
)
from conegraph.frontend.shape import axis_points, cone_likeness, is_top_heavy
from conegraph.frontend.surround import own_colours, side_contrast
from conegraph.frontend.towers import split_towers
from conegraph.types import N_CLASSES, Array, ConeClass, IntArray, Mask

COLOUR_IS_RIGHT = 0.97
"""How often a cone of a colour's pixels is of that colour; the rest is shared."""
MIN_VIVID_FOOT = 2
"""Vivid pixels of what other pieces may rest on."""
LEAST_VOTES = 1.0
LEAST_ALONE = 24
"""Pixels that a cone must have in a picture of an unknown camera: what is smaller
has no shape, and nothing else would keep it out."""
BODY_M = 0.12
"""Width of the lowest piece, where nothing else tells the scale: a foot seen from
far, which blur and shade make narrower."""
HEIGHT_OF = np.array([0.0, CONE_HEIGHT_M, CONE_HEIGHT_M, BIG_HEIGHT_M])
"""Greatest height of cones by colour, numbered as `colour_of_pixels` does."""


class HsvDetector:
    """Finds cones by colour and shape."""

    def __init__(self, config: HsvConfig) -> None:
        """Take the thresholds."""
        self._config = config

    def find(self, picture: Picture, scale: GroundScale | None = None) -> Candidates:
        """Find cones in an RGB picture (H, W, 3), with its ``scale`` where known."""
        config = self._config
        top = 0 if scale is None else scale.first_row(config.max_range_m)
        seen = picture[top:]
        hsv = np.asarray(cv2.cvtColor(seen, cv2.COLOR_RGB2HSV), dtype=np.uint8)
        pieces = find_pieces(colour_of_pixels(hsv, config))
        if not len(pieces.box_px):
            return Candidates.empty()
        pieces, whole = split_ledges(pieces, _px_per_m(pieces.box_px, top, scale))
        px_per_m = _px_per_m(pieces.box_px, top, scale)
        vivid = self._is_vivid(hsv, pieces.pixel_uv)
        n_vivid = np.bincount(pieces.owner, weights=vivid)
        high = HEIGHT_OF[pieces.colour]
        foot = stack_pieces(pieces, px_per_m, high, n_vivid >= MIN_VIVID_FOOT)
        cones, row = np.unique(foot, return_inverse=True)
        owner, uv, vivid = _sorted(row[pieces.owner], pieces.pixel_uv, vivid)
        owner, origin = split_towers(uv, owner, px_per_m[cones])
        owner, uv, vivid = _sorted(owner, uv, vivid)
        prob = _class_prob(pieces.colour[cones][origin])
        touching = np.zeros(len(cones), dtype=bool)
        np.logical_or.at(touching, row, _several(whole))
        crowded = touching[origin] | _several(origin)
        least = config.min_pixels if scale else max(config.min_pixels, LEAST_ALONE)
        enough = np.bincount(owner, weights=vivid) >= least
        uv = uv + np.array([0, top])
        box = boxes(uv[:, 0], uv[:, 1], owner)
        contrast = side_contrast(
            picture, box, own_colours(picture, uv, owner, len(box))
        )
        stands_out = np.clip(contrast / config.min_contrast - 0.5, 0.0, 1.0)
        score = cone_likeness(box, uv, owner) * stands_out
        axis = axis_points(box, uv, owner)
        crowded |= is_top_heavy(box, uv, owner)
        found = Candidates(box, prob, score, uv, owner, axis, crowded)
        return found.subset((score >= config.min_score) & enough)

    def _is_vivid(self, hsv: Picture, uv: IntArray) -> Mask:
        saturation, value = hsv[uv[:, 1], uv[:, 0], 1:].astype(np.int64).T
        return np.asarray(saturation * value >= self._config.min_chroma * 255)


def _sorted(
    owner: IntArray, uv: IntArray, vivid: Mask
) -> tuple[IntArray, IntArray, Mask]:
    order = np.argsort(owner, kind="stable")
    return owner[order], uv[order], vivid[order]


def _several(origin: IntArray) -> Mask:
    """Say which rows share their origin with another."""
    return np.asarray(np.bincount(origin)[origin] > 1)


def _px_per_m(box_px: Array, top: int, scale: GroundScale | None) -> Array:
    """Return the size of a metre at each piece; without a camera, by its width."""
    if scale is None:
        return (box_px[:, 2] - box_px[:, 0]) / BODY_M
    middle = box_px[:, [0, 2]].mean(axis=1)
    return scale.px_per_m(np.column_stack([middle, box_px[:, 3] + top]))


def _class_prob(colour: IntArray) -> Array:
    """Return (N, 5) with the colour's share first, and what is left over the rest."""
    table = np.full((len(COLOURS) + 1, N_CLASSES), (1 - COLOUR_IS_RIGHT) / 4)
    for index, cone in enumerate(COLOURS):
        table[1 + index, cone] = COLOUR_IS_RIGHT
    both = [ConeClass.ORANGE, ConeClass.BIG_ORANGE]
    orange = 1 + COLOURS.index(ConeClass.ORANGE)
    table[orange, :] = (1 - COLOUR_IS_RIGHT) / 3
    table[orange, both] = COLOUR_IS_RIGHT / 2
    return table[colour]


def colours_of_boxes(picture: Picture, box_px: Array, config: HsvConfig) -> Array:
    """Return class probabilities (N, 5) of cones whose boxes (N, 4) are given.

    The pixels of each colour vote, those near the box's middle column more than those
    at its sides, where a neighbour may stand. Without any, the class is unknown.

    Args:
        picture: (H, W, 3) RGB.
        box_px: left, top, right, bottom edges.
        config: the hues and thresholds.
    """
    hsv = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2HSV), dtype=np.uint8)
    colours = colour_of_pixels(hsv, config)
    rows, columns = colours.shape
    limit = np.array([columns, rows, columns, rows])
    whole = np.clip(np.round(box_px + 0.5), 0, limit).astype(int)
    prob = np.zeros((len(box_px), N_CLASSES))
    for row, (left, top, right, bottom) in enumerate(whole):
        inside = colours[top:bottom, left:right]
        off = np.linspace(-1.0, 1.0, max(right - left, 1))[None, : inside.shape[1]]
        weight = np.broadcast_to(1.0 - off**2, inside.shape)
        votes = np.bincount(
            inside.ravel(), weights=weight.ravel(), minlength=len(COLOURS) + 1
        )[1:]
        shares = votes / max(votes.sum(), LEAST_VOTES)
        prob[row] = shares @ _class_prob(np.arange(1, len(COLOURS) + 1))
    prob[:, ConeClass.UNKNOWN] += 1.0 - prob.sum(axis=1)
    return prob
