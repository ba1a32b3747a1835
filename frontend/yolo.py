"""The learned detector: a network in YOLO's layout, ours or the user's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conegraph.config import YoloConfig
from conegraph.errors import FileFormatError
from conegraph.frontend.base import Candidates, Picture
from conegraph.frontend.outline import axis_columns, foot_levels
from conegraph.frontend.scale import GroundScale
from conegraph.frontend.yolo_engine import SHIPPED, open_engine
from conegraph.frontend.yolo_layout import decoded, letterboxed, strongest
from conegraph.types import CLASS_LABELS, N_CLASSES, Array, ConeClass, IntArray, Mask

LEVELS = np.linspace(0.25, 1.0, 20)
"""How far down a box pixels are taken for the cone's; the top may be the sky."""
ACROSS = np.linspace(-1.0, 1.0, 13)
HALF_TOP, HALF_FOOT = 0.04, 0.34
"""Half widths of a cone's body at top and foot, in widths of its box."""
AXIS_LEVEL = 0.45
ORANGE = [ConeClass.ORANGE, ConeClass.BIG_ORANGE]
WEAK_SCORE = 0.3
"""Boxes of a lower score take no pixels from stronger ones, nor crowd them; there are
such only with a `min_score` below this."""


class YoloDetector:
    """Finds cones by a network."""

    def __init__(self, config: YoloConfig) -> None:
        """Open the network.

        Raises:
            FileFormatError: it cannot be opened.
            MissingDependencyError: its engine is not installed.
        """
        self._config = config
        self._path = Path(config.model) if config.model else SHIPPED
        self._engine = open_engine(self._path, config.engine)
        self._class = np.array([CLASS_LABELS.index(name) for name in config.classes])

    def find(self, picture: Picture, scale: GroundScale | None = None) -> Candidates:
        """Find cones in an RGB picture (H, W, 3), with its ``scale`` where known.

        With it, rows in which no cone can stand are cut away first.

        Raises:
            FileFormatError: the network has another layout, or takes another size.
        """
        config = self._config
        top = 0 if scale is None else scale.first_row(config.max_range_m)
        fitted = letterboxed(picture[top:], config.max_side_px, config.input_px)
        try:
            box, score = decoded(self._engine.run(fitted.blob), len(self._class))
        except ValueError as error:
            raise FileFormatError(self._path, str(error)) from None
        rows = strongest(box, score.max(axis=1), config.min_score, config.overlap)
        # Networks count from the corner of the picture, we from a pixel's middle.
        box_px = box[rows] * np.tile(fitted.scale, 2) + np.array([0, top, 0, top]) - 0.5
        edges = np.array([picture.shape[1], picture.shape[0]] * 2) - 0.5
        box_px = np.clip(box_px, -0.5, edges)
        whole = (box_px[:, 2:] - box_px[:, :2] >= 1.0).all(axis=1)
        return self._candidates(picture, box_px[whole], score[rows][whole])

    def _candidates(self, picture: Picture, box_px: Array, score: Array) -> Candidates:
        middle, clear = axis_columns(picture, box_px)
        box_px = box_px.copy()
        box_px[:, 3] = foot_levels(picture, box_px, middle)
        best = score.max(axis=1, initial=0.0)
        weak = best < WEAK_SCORE
        uv, owner = body_pixels(box_px, weak, picture.shape)
        level = box_px[:, 1] + AXIS_LEVEL * (box_px[:, 3] - box_px[:, 1])
        return Candidates(
            box_px,
            self._class_prob(score),
            best,
            uv,
            owner,
            np.column_stack([middle, level]),
            touching(box_px, weak) | ~clear,
        )

    def _class_prob(self, score: Array) -> Array:
        """Return probabilities (N, 5): the less sure, the more of them is unknown.

        A score says both that there is a cone and that it is of its class; of the
        class alone it says its square root. A network that knows but one class of
        orange cones leaves it to their sizes which they are.
        """
        best = score.max(axis=1, initial=0.0)
        total = np.maximum(score.sum(axis=1), 1e-9)
        share = score * (np.sqrt(best) / total)[:, None]
        prob = np.zeros((len(score), N_CLASSES))
        np.add.at(prob.T, self._class, share.T)
        if not np.isin(ORANGE, self._class).all():
            prob[:, ORANGE] = prob[:, ORANGE].mean(axis=1, keepdims=True)
        prob[:, ConeClass.UNKNOWN] += 1.0 - prob.sum(axis=1)
        return prob


def body_pixels(
    box_px: Array, weak: Mask, shape: tuple[int, ...]
) -> tuple[IntArray, IntArray]:
    """Return pixels (M, 2) on the cones that boxes (N, 4) hold, and their owners (M,).

    They lie between the sides of an upright cone, sorted by owner. Of cones that hide
    one another a pixel shows the one whose foot is lowest in the picture, and of those
    that are ``weak`` (N,) only what the others leave.
    """
    rank = np.lexsort((-box_px[:, 3], weak))
    left, top, right, low = box_px[rank].T[:, :, None, None]
    half = HALF_TOP + (HALF_FOOT - HALF_TOP) * LEVELS[:, None]
    column = left + (0.5 + half * ACROSS) * (right - left)
    row = top + LEVELS[:, None] * (np.ceil(low - 0.5) - top)
    rows, columns = shape[:2]
    u = np.clip(np.round(column), 0, columns - 1).astype(np.int64)
    v = np.clip(np.round(row), 0, rows - 1).astype(np.int64)
    # The first of equal pixels is the nearest cone's, as boxes are ranked.
    pixel, first = np.unique(v * columns + u, return_index=True)
    owner = rank[first // (LEVELS.size * ACROSS.size)].astype(np.int64)
    order = np.argsort(owner, kind="stable")
    v, u = np.divmod(pixel[order], columns)
    return np.column_stack([u, v]), owner[order]


def touching(box_px: Array, weak: Mask) -> Mask:
    """Say which boxes (N, 4) reach into another that is not ``weak`` (N,)."""
    low = np.maximum(box_px[:, None, :2], box_px[None, :, :2])
    high = np.minimum(box_px[:, None, 2:], box_px[None, :, 2:])
    meet = (high > low).all(axis=2) & ~weak
    np.fill_diagonal(meet, False)
    return np.asarray(meet.any(axis=1))
