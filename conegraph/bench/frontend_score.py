"""What a front end found in rendered pictures, against their truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from conegraph.camera import RgbdFrame
from conegraph.frontend import Detections
from conegraph.sim.render import FrameTruth
from conegraph.training.average_precision import overlaps
from conegraph.types import Array, ConeClass, IntArray, Mask

MIN_OVERLAP = 0.3
"""Intersection over union from which two boxes are of the same cone."""
MIN_VISIBLE = 0.5
"""Share of a cone that must be seen for a detector to be asked for it."""


@dataclass(frozen=True, slots=True)
class Score:
    """Detections against truth, pooled over pictures.

    Attributes:
        range_m: (T,) distance of true cones that are in the picture as a whole and at
            least half visible.
        found: (T,) whether each was found.
        error_m: (M, 2) position errors of what was found of any true cone, no gate.
        cov_m2: (M, 2, 2) the covariances that came with them.
        error_range_m: (M,) true distances of those.
        whole: (M,) whether each is of the cones counted in ``range_m``.
        colour_right: (M,) whether the class is right.
        false: how many detections are of no cone.
    """

    range_m: Array
    found: Mask
    error_m: Array
    cov_m2: Array
    error_range_m: Array
    whole: Mask
    colour_right: Mask
    false: int

    @property
    def precision(self) -> float:
        """Share of the detections that are of a cone."""
        detections = len(self.error_m) + self.false
        return len(self.error_m) / detections if detections else float("nan")

    def recall(self, near_m: float, far_m: float) -> float:
        """Return the share of the counted cones in a range that were found."""
        asked = (self.range_m >= near_m) & (self.range_m < far_m)
        return float(self.found[asked].mean()) if asked.any() else float("nan")

    def errors(self, near_m: float, far_m: float) -> Array:
        """Return position errors (K, 2) of counted cones in a range."""
        return self.error_m[self._within(near_m, far_m)]

    def rmse_m(self, near_m: float, far_m: float) -> float:
        """Return the root mean square distance of counted cones in a range."""
        error = self.errors(near_m, far_m)
        return float(np.sqrt((error**2).sum(axis=1).mean())) if len(error) else np.nan

    def nis_per_dof(self, near_m: float, far_m: float) -> float:
        """Return the mean of ``e' S^-1 e / 2`` of counted cones in a range."""
        within = self._within(near_m, far_m)
        if not within.any():
            return float("nan")
        error, cov = self.error_m[within], self.cov_m2[within]
        solved = np.linalg.solve(cov, error[:, :, None])[:, :, 0]
        return float(0.5 * (error * solved).sum(axis=1).mean())

    def _within(self, near_m: float, far_m: float) -> Mask:
        inside = (self.error_range_m >= near_m) & (self.error_range_m < far_m)
        return np.asarray(self.whole & inside)


NOTHING = Score(
    np.zeros(0),
    np.zeros(0, dtype=bool),
    np.zeros((0, 2)),
    np.zeros((0, 2, 2)),
    np.zeros(0),
    np.zeros(0, dtype=bool),
    np.zeros(0, dtype=bool),
    0,
)


def score_frame(frame: RgbdFrame, truth: FrameTruth, seen: Detections) -> Score:
    """Match boxes one to one and compare what stands where."""
    pairs = match_boxes(seen.box_px, truth.box_px[truth.visible_px > 0])
    row = np.flatnonzero(truth.visible_px > 0)[pairs[:, 1]]
    range_m = np.hypot(*truth.xy_m.T)
    whole = _whole(frame, truth)
    found = np.zeros(len(truth), dtype=bool)
    found[row] = True
    cones = seen.observations.subset(pairs[:, 0])
    true_class = truth.cone_class[row]
    return Score(
        range_m[whole],
        found[whole],
        cones.xy_m - truth.xy_m[row],
        cones.cov_m2,
        range_m[row],
        whole[row],
        np.asarray(cones.class_prob.argmax(axis=1) == true_class)
        | (true_class == ConeClass.UNKNOWN),
        len(seen.box_px) - len(pairs),
    )


def pooled(scores: Iterable[Score]) -> Score:
    """Return the scores of many pictures as one."""
    every = [NOTHING, *scores]
    return Score(
        np.concatenate([s.range_m for s in every]),
        np.concatenate([s.found for s in every]),
        np.concatenate([s.error_m for s in every]),
        np.concatenate([s.cov_m2 for s in every]),
        np.concatenate([s.error_range_m for s in every]),
        np.concatenate([s.whole for s in every]),
        np.concatenate([s.colour_right for s in every]),
        sum(s.false for s in every),
    )


def match_boxes(found_px: Array, true_px: Array) -> IntArray:
    """Return pairs (K, 2) of rows of boxes (N, 4) and (T, 4), each used once.

    A pair overlaps by `MIN_OVERLAP`; the sum of overlaps, less how far apart the lower
    edges are in heights, is the greatest possible: of two cones behind one another a
    detection is of the one on whose foot it stands.
    """
    if not (len(found_px) and len(true_px)):
        return np.zeros((0, 2), dtype=np.int64)
    overlap = overlaps(found_px, true_px)
    height = true_px[:, 3] - true_px[:, 1]
    off = np.abs(found_px[:, None, 3] - true_px[None, :, 3]) / height
    likeness = np.where(overlap >= MIN_OVERLAP, np.maximum(overlap - off, 1e-3), 0.0)
    rows, columns = linear_sum_assignment(-likeness)
    kept = likeness[rows, columns] > 0
    return np.column_stack([rows[kept], columns[kept]]).astype(np.int64)


def _whole(frame: RgbdFrame, truth: FrameTruth) -> Mask:
    """Say which true cones the picture's edges leave whole and that can be seen."""
    left, top, right, bottom = truth.box_px.T
    inside = (left > 0) & (top > 0)
    inside &= right < frame.camera.width_px - 1
    inside &= bottom < frame.camera.height_px - 1
    return np.asarray(inside & (truth.visible_fraction >= MIN_VISIBLE))
