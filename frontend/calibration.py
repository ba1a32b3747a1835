"""A lens from pictures of a board (Zhang's method, as OpenCV has it)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera
from conegraph.errors import ConegraphError
from conegraph.frontend.board import BoardView, Points
from conegraph.types import Array, Mask

MIN_VIEWS = 6
MIN_TILT_SPREAD_RAD = float(np.radians(15.0))
MIN_COVERAGE = 0.4
MAX_FOCAL_SIGMA = 0.01
MAX_RMS_PX = 1.5
OUTLIER_FACTOR = 3.0
OUTLIER_PX = 0.5
CELLS = (6, 8)
"""Rows and columns of the grid that coverage is counted on."""
SIGNIFICANT = 3.0


class CalibrationError(ConegraphError):
    """Pictures that do not tell what the lens is; the text says what is lacking."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """A lens, and how far it can be trusted.

    Attributes:
        camera: the lens.
        views: the views that it was found from.
        view_rms_px: (V,) reprojection error of each.
        rms_px: of all corners.
        focal_sigma: sigma of the focal length, as a share of it.
        coverage: share of the picture's cells that corners were seen in.
        left_out: names of the views that did not fit, with their error in pixels.
    """

    camera: Camera
    views: tuple[BoardView, ...]
    view_rms_px: Array
    rms_px: float
    focal_sigma: float
    coverage: float
    left_out: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class _Fit:
    matrix: Array
    lens: Array
    rms_px: float
    view_rms_px: Array
    normals: Array
    sigma: Array


def calibrate(views: Sequence[BoardView], size: tuple[int, int]) -> Calibration:
    """Find the lens that explains the views best.

    Views with more than three times the middle error are left out once. The third
    radial coefficient stays zero unless it is three sigmas away from it, because
    outside the corners it runs wild.

    Args:
        views: from `find_board`.
        size: width and height of the pictures.

    Raises:
        CalibrationError: too few views, all of them alike, most of the picture
            never seen, or no lens fits.
    """
    _check_count(len(views))
    fit = _fit(views, size)
    keep: Mask = fit.view_rms_px <= max(
        OUTLIER_FACTOR * float(np.median(fit.view_rms_px)), OUTLIER_PX
    )
    left_out = tuple(
        (view.name, float(error))
        for view, error, kept in zip(views, fit.view_rms_px, keep, strict=True)
        if not kept
    )
    if left_out:
        views = [view for view, kept in zip(views, keep, strict=True) if kept]
        _check_count(len(views))
        fit = _fit(views, size)
    covered = coverage_of(views, size)
    coverage = float(np.mean(covered > 0))
    _check(fit, coverage)
    k1, k2, p1, p2, k3 = fit.lens[:5].tolist()
    camera = Camera(
        *size,
        float(fit.matrix[0, 0]),
        float(fit.matrix[1, 1]),
        float(fit.matrix[0, 2]),
        float(fit.matrix[1, 2]),
        (k1, k2, p1, p2, k3),
    )
    return Calibration(
        camera,
        tuple(views),
        fit.view_rms_px,
        fit.rms_px,
        _focal_sigma(fit),
        coverage,
        left_out,
    )


def _fit(views: Sequence[BoardView], size: tuple[int, int]) -> _Fit:
    full = _fitted(views, size, 0)
    if abs(full.lens[4]) >= SIGNIFICANT * full.sigma[8]:
        return full
    return _fitted(views, size, cv2.CALIB_FIX_K3)


def _fitted(views: Sequence[BoardView], size: tuple[int, int], flags: int) -> _Fit:
    try:
        rms, matrix, lens, turns, _, sigma, _, errors = cv2.calibrateCameraExtended(
            [view.points_m for view in views],
            [view.pixels for view in views],
            size,
            np.eye(3),
            np.zeros(5),
            flags=flags,
        )
    except cv2.error as error:
        raise CalibrationError(f"no lens fits these views: {error.err}") from error
    normals = np.array([cv2.Rodrigues(np.asarray(turn))[0][:, 2] for turn in turns])
    return _Fit(
        np.asarray(matrix, dtype=np.float64),
        np.asarray(lens, dtype=np.float64).ravel(),
        float(rms),
        np.asarray(errors, dtype=np.float64).ravel(),
        np.asarray(normals, dtype=np.float64),
        np.asarray(sigma, dtype=np.float64).ravel(),
    )


def _check_count(count: int) -> None:
    if count < MIN_VIEWS:
        raise CalibrationError(
            f"too few views: {count} pictures show the whole board, and {MIN_VIEWS} "
            f"are the least (20 are better)"
        )


def _check(fit: _Fit, coverage: float) -> None:
    """Raise if the views cannot tell what the lens is."""
    spread = tilt_spread(fit.normals)
    if spread < MIN_TILT_SPREAD_RAD:
        raise CalibrationError(
            f"the views are too alike: the board was turned by no more than "
            f"{np.degrees(spread):.0f} degrees between them, and "
            f"{np.degrees(MIN_TILT_SPREAD_RAD):.0f} are needed: tilt it to all sides"
        )
    if coverage < MIN_COVERAGE:
        raise CalibrationError(
            f"the board was seen in {coverage:.0%} of the picture only, and "
            f"{MIN_COVERAGE:.0%} are needed: show it in the corners too, and nearer"
        )
    if fit.rms_px > MAX_RMS_PX:
        raise CalibrationError(
            f"the corners miss by {fit.rms_px:.1f} pixels: is the board flat, sharp, "
            f"and of the size that was given?"
        )
    if _focal_sigma(fit) > MAX_FOCAL_SIGMA:
        raise CalibrationError(
            f"the focal length is known to {_focal_sigma(fit):.1%} only: tilt the "
            f"board more, and take more pictures"
        )


def _focal_sigma(fit: _Fit) -> float:
    return float(max(fit.sigma[0] / fit.matrix[0, 0], fit.sigma[1] / fit.matrix[1, 1]))


def tilt_spread(normals: Array) -> float:
    """Return the largest angle between the normals (V, 3) of boards in views."""
    cosine = np.clip(normals @ normals.T, -1.0, 1.0)
    return float(np.arccos(cosine.min()))


def coverage_of(views: Sequence[BoardView], size: tuple[int, int]) -> Array:
    """Return how many corners fell into each cell of the picture, see `CELLS`."""
    corners = _all_corners(views)
    edges = [
        np.linspace(0, side, n + 1) for side, n in zip(size[::-1], CELLS, strict=True)
    ]
    counts, *_ = np.histogram2d(corners[:, 1], corners[:, 0], bins=edges)
    return np.asarray(counts, dtype=np.float64)


def _all_corners(views: Sequence[BoardView]) -> Points:
    return np.vstack([view.pixels for view in views])


def draw_coverage(calibration: Calibration) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3), RGB: every corner that was seen, cells without red.

    Corners of views with larger errors are brighter yellow.
    """
    camera = calibration.camera
    size = (camera.width_px, camera.height_px)
    empty = coverage_of(calibration.views, size) == 0
    drawn = np.full((size[1], size[0], 3), 40, np.uint8)
    tall, wide = size[1] / CELLS[0], size[0] / CELLS[1]
    for row, column in np.argwhere(empty).tolist():
        corners = np.array([(column, row), (column + 1, row + 1)]) * (wide, tall)
        first, last = np.round(corners).astype(int).tolist()
        cv2.rectangle(drawn, tuple(first), tuple(last), (90, 30, 30), -1)
    worst = max(float(calibration.view_rms_px.max()), 1e-9)
    radius = max(size[0] // 250, 2)
    for view, error in zip(calibration.views, calibration.view_rms_px, strict=True):
        share = float(error) / worst
        color = (80 + 175 * share, 200.0, 80 * (1 - share))
        for u, v in np.round(view.pixels).astype(int).tolist():
            cv2.circle(drawn, (u, v), radius, color, -1, cv2.LINE_AA)
    return drawn
