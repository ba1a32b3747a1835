"""Depth as an active stereo camera measures it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.sim.render.paint import Floats, cut

_SHEET_PX = (1024, 2048)


@dataclass(frozen=True, slots=True)
class StereoDepth:
    """A stereo matcher and its failings.

    Depth follows from disparity, ``Z = f b / d``, so that an error of the disparity
    makes one of ``sigma_Z = Z^2 sigma_d / (f b)``.

    Attributes:
        focal_px: focal length of the infrared pair, at the picture's resolution.
        baseline_m: distance between the two.
        disparity_sigma_px: sigma of the disparity.
        correlation_px: neighbouring pixels within about this err together.
        disparity_step_px: disparities are whole multiples of it.
        depth_step_m: and depths of this.
        min_m: nearest depth that is measured.
        max_m: farthest depth that is measured.
        hole_share: share of pixels without depth up close; it grows with depth.
    """

    focal_px: float = 385.0
    baseline_m: float = 0.050
    disparity_sigma_px: float = 0.08
    correlation_px: float = 2.0
    disparity_step_px: float = 1.0 / 32.0
    depth_step_m: float = 0.001
    min_m: float = 0.25
    max_m: float = 18.0
    hole_share: float = 0.01


def measure_depth(
    sensor: StereoDepth, depth_m: Floats, rng: np.random.Generator
) -> Floats:
    """Return the depth that the sensor reports of the true one.

    Foreground spreads over its edges, a strip beside it is seen by one eye only,
    holes come in blotches, more of them far away.

    Args:
        sensor: the matcher.
        depth_m: (H, W) true depth, 0 where there is nothing.
        rng: draws noise and holes.

    Returns:
        (H, W) reported depth, 0 where there is none.
    """
    scale = np.float32(sensor.focal_px * sensor.baseline_m)
    disparity = np.where(depth_m > 0, scale / np.maximum(depth_m, 0.05), 0)
    disparity = disparity.astype(np.float32, copy=False)
    spread = np.asarray(cv2.dilate(disparity, np.ones((3, 3), np.uint8)), np.float32)
    disparity = np.where(spread - disparity > 0.4, spread, disparity)
    one_eyed = _seen_by_one_eye(disparity)
    noise = cut(_noise_sheet(sensor.correlation_px), disparity.shape, rng)
    noisy = disparity + np.float32(sensor.disparity_sigma_px) * noise
    step = np.float32(sensor.disparity_step_px)
    noisy = np.round(noisy / step) * step
    measured = scale / np.maximum(noisy, step)
    blotch = cut(_noise_sheet(6.0), disparity.shape, rng)
    # The share of a normal variable above 2.33 is 1 %, above 1.3 it is 10 %.
    enough = np.interp(sensor.hole_share, [0.0, 0.01, 0.1, 0.5], [9.0, 2.33, 1.28, 0])
    holes = blotch > np.float32(enough) - 0.06 * np.maximum(measured - 4.0, 0.0)
    lost = one_eyed | holes | (depth_m <= 0)
    lost |= (measured < sensor.min_m) | (measured > sensor.max_m)
    unit = np.float32(sensor.depth_step_m)
    measured = np.round(measured / unit) * unit
    measured[lost] = 0.0
    return measured.astype(np.float32, copy=False)


def _seen_by_one_eye(disparity: Floats) -> NDArray[np.bool_]:
    """Return where something nearer, further right, hides a pixel from the other eye.

    A pixel at column u lands on ``u - d`` in the other picture; one further right
    that lands no further right lies in front of it.
    """
    column = np.arange(disparity.shape[1], dtype=np.float32)
    lands = column - disparity
    nearest = np.minimum.accumulate(lands[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(disparity.shape, dtype=bool)
    hidden[:, :-1] = lands[:, :-1] >= nearest[:, 1:] + 0.5
    return hidden


@lru_cache(maxsize=4)
def _noise_sheet(correlation_px: float) -> Floats:
    """Return a sheet of normal noise, correlated over some pixels; the same always."""
    white = np.random.default_rng(7).standard_normal(_SHEET_PX)
    smooth = cv2.GaussianBlur(white.astype(np.float32), (0, 0), correlation_px)
    sheet: Floats = np.asarray(smooth / smooth.std(), dtype=np.float32)
    sheet.flags.writeable = False
    return sheet
