"""Cones come in two sizes: what has neither is none; orange ones are told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.camera import RgbdFrame
from conegraph.frontend.base import Candidates
from conegraph.frontend.camera import project, rays
from conegraph.frontend.ground import GroundPlane
from conegraph.frontend.localize import Places
from conegraph.frontend.scale import BIG_HEIGHT_M, CONE_HEIGHT_M
from conegraph.frontend.surround import own_colours, top_shares
from conegraph.types import Array, ConeClass, Mask

HEIGHTS_M = np.array([CONE_HEIGHT_M, BIG_HEIGHT_M])
WIDTHS_M = np.array([0.275, 0.345])
"""Of the foot, turned by any angle."""
HEIGHT_SPREAD_M, WIDTH_SPREAD_M = 0.03, 0.045
WIDE_SIGMAS = 1.7
"""How much wider than the mean a cone may be before it is doubted to be one."""
CORNER_M = 0.1
EDGE_PX = 1.0
"""How far a box's edge may be off."""
TOP_SHARE = 0.3
"""So much of a cone's colour must be where its missing top should be."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """How large candidates are.

    Attributes:
        height_m: (N,) from the ground to the top.
        misfit_d2: (N, 2) squared distance of height and width from those of a small
            and a big cone, in sigmas.
        excess_m: (N, 2) how much wider each is than a small and a big cone are.
        box_px: (N, 4) boxes, completed where a faint top was found.
    """

    height_m: Array
    misfit_d2: Array
    excess_m: Array
    box_px: Array


def measure_sizes(
    frame: RgbdFrame, found: Candidates, places: Places, ground: GroundPlane
) -> Sizes:
    """Measure candidates at their places, and look for tops that are too faint.

    Args:
        frame: the picture.
        found: the candidates in it.
        places: where they stand.
        ground: the plane that they stand on.
    """
    # On the axis; towards the sides things are wider by up to 1 / cos^2 of the angle.
    # With that the cones of rendered courses were told no better from other things.
    metre_px = frame.camera.fx_px / places.range_m
    height = _heights(frame, found.box_px[:, 1], places, ground)
    edge_m = EDGE_PX / metre_px
    doubtful = np.hypot(edge_m, HEIGHT_SPREAD_M)
    short = height < CONE_HEIGHT_M - doubtful
    top = _tops(frame, places, ground, CONE_HEIGHT_M)
    own = own_colours(frame.color, found.pixel_uv, found.owner, len(found))
    share = top_shares(frame.color, own, top[:, 0], top[:, 1], CONE_HEIGHT_M * metre_px)
    faint = short & (share >= TOP_SHARE)
    height = np.where(faint, CONE_HEIGHT_M, height)
    box = found.box_px.copy()
    box[:, 1] = np.where(faint, np.minimum(top[:, 1], box[:, 1]), box[:, 1])
    # The corner of a foot that is nearest makes it look wider.
    width = (box[:, 2] - box[:, 0]) / metre_px * (1.0 - CORNER_M / places.range_m)
    rows, columns = frame.color.shape[:2]
    cut_low = box[:, 3] >= rows - 1.5
    cut_side = (box[:, 0] <= 0.5) | (box[:, 2] >= columns - 1.5)
    of_height = (height[:, None] - HEIGHTS_M) / doubtful[:, None]
    # The side of the picture may have cut the top away, but made nothing higher.
    of_height = np.where(cut_side[:, None], np.maximum(of_height, 0.0), of_height)
    spread = np.hypot(edge_m, WIDTH_SPREAD_M)[:, None]
    of_width = (width[:, None] - WIDTHS_M) / spread
    excess = np.maximum(width[:, None] - WIDTHS_M - WIDE_SIGMAS * spread, 0.0)
    misfit = np.where(cut_low, 0.0, 1.0)[:, None] * of_height**2
    misfit = misfit + np.where(cut_side, 0.0, 1.0)[:, None] * of_width**2
    return Sizes(height, misfit, excess, box)


def fits(prob: Array, sizes: Sizes, gate_d2: float) -> Mask:
    """Say which candidates (N,) have a size that cones of their colour have.

    Only orange ones come in both; how sure the detector is of a cone at all, which is
    what its class is not unknown, does not matter here.
    """
    orange = prob[:, ConeClass.ORANGE] + prob[:, ConeClass.BIG_ORANGE]
    either = 2.0 * orange >= 1.0 - prob[:, ConeClass.UNKNOWN]
    small, big = sizes.misfit_d2.T
    fit: Mask = np.where(either, np.minimum(small, big), small) <= gate_d2
    return fit


def with_doubt(cov_m2: Array, prob: Array, sizes: Sizes) -> Array:
    """Widen covariances (N, 2, 2) of what is too wide for one cone: it may be two.

    Where the one that is meant stands is then unknown by as much as it is too wide.
    """
    big = prob[:, ConeClass.BIG_ORANGE] > prob[:, ConeClass.ORANGE]
    excess_m = np.where(big, sizes.excess_m[:, 1], sizes.excess_m[:, 0])
    widened: Array = cov_m2 + (excess_m**2)[:, None, None] * np.eye(2)
    return widened


def with_size(prob: Array, sizes: Sizes) -> Array:
    """Share the orange probability (N, 5) between small and big cones by their sizes.

    By Bayes' rule the odds of big, as the detector has them, are multiplied by
    ``exp((d_small - d_big) / 2)``.
    """
    both = [ConeClass.ORANGE, ConeClass.BIG_ORANGE]
    orange = prob[:, both].sum(axis=1, keepdims=True)
    nearer = sizes.misfit_d2.min(axis=1, keepdims=True)
    odds = prob[:, both] * np.exp(np.maximum(-0.5 * (sizes.misfit_d2 - nearer), -30.0))
    shared = prob.copy()
    shared[:, both] = orange * odds / np.maximum(odds.sum(axis=1, keepdims=True), 1e-12)
    return shared


def _heights(
    frame: RgbdFrame, top_row: Array, places: Places, ground: GroundPlane
) -> Array:
    """Return how high (N,) the rays of the top rows pass over the feet."""
    mount = ground.mount(frame.mount)
    top = rays(frame.camera, np.column_stack([places.foot_uv[:, 0], top_row]))
    turn = mount.rotation_car_optical
    flat = np.linalg.norm(top @ turn[:2].T, axis=1)
    height: Array = mount.height_m + places.range_m * (top @ turn[2]) / flat
    return height


def _tops(
    frame: RgbdFrame, places: Places, ground: GroundPlane, height_m: float
) -> Array:
    """Return the pixels (N, 2) of points a height above the feet."""
    mount = ground.mount(frame.mount)
    away = places.xy_m - mount.position_m[:2]
    up = np.full((len(away), 1), height_m - mount.height_m)
    return project(frame.camera, np.hstack([away, up]) @ mount.rotation_car_optical)
