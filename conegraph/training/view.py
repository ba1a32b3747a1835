"""A made-up camera over level ground: which pixel a point is seen at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conegraph.types import Array

Floats = NDArray[np.floating[Any]]
NEAREST_M = 0.4


@dataclass(frozen=True, slots=True)
class View:
    """A camera above the origin that looks along x, and how large its picture is.

    Attributes:
        width_px: of the picture.
        height_px: of the picture.
        focal_px: focal length.
        above_m: height over the ground.
        pitch_rad: nose down.
        roll_rad: right side down.
        bend: how much the lens bends lines at the edges; negative is a barrel.
    """

    width_px: int
    height_px: int
    focal_px: float
    above_m: float
    pitch_rad: float
    roll_rad: float
    bend: float

    def pixels(self, points_m: Array) -> tuple[Array, Array]:
        """Return pixels (N, 2) and depths (N,) of points (N, 3); x forward, z up.

        Those of points nearer than `NEAREST_M` mean nothing.
        """
        c, s = np.cos(self.pitch_rad), np.sin(self.pitch_rad)
        x, y, z = points_m[:, 0], points_m[:, 1], points_m[:, 2] - self.above_m
        depth = x * c - z * s
        safe = np.maximum(depth, NEAREST_M)
        right, down = -y / safe, (-x * s - z * c) / safe
        c, s = np.cos(self.roll_rad), np.sin(self.roll_rad)
        right, down = c * right + s * down, c * down - s * right
        bent = 1.0 + self.bend * np.minimum(right**2 + down**2, 1.0)
        scale = self.focal_px * bent
        u = 0.5 * self.width_px + scale * right
        v = 0.5 * self.height_px + scale * down
        return np.column_stack([u, v]), depth

    def ground(self) -> tuple[Floats, Floats, Floats]:
        """Return x, y in m and the size in m of a pixel (H, W) on the ground.

        The lens's bend is left out. Above the horizon x is infinite.
        """
        u = (np.arange(self.width_px, dtype=np.float32) + 0.5 - 0.5 * self.width_px)[
            None, :
        ] / np.float32(self.focal_px)
        v = (np.arange(self.height_px, dtype=np.float32) + 0.5 - 0.5 * self.height_px)[
            :, None
        ] / np.float32(self.focal_px)
        c, s = np.float32(np.cos(self.roll_rad)), np.float32(np.sin(self.roll_rad))
        right, down = c * u - s * v, c * v + s * u
        c, s = np.float32(np.cos(self.pitch_rad)), np.float32(np.sin(self.pitch_rad))
        fall = s + down * c
        with np.errstate(divide="ignore"):
            depth = np.where(fall > 1e-4, self.above_m / fall, np.inf)
        near = np.minimum(depth, 1e4)
        x = np.where(np.isfinite(depth), near * (c - down * s), np.inf)
        y = -near * right
        size = near / np.float32(self.focal_px)
        return x.astype(np.float32), y.astype(np.float32), size.astype(np.float32)

    def horizon_px(self) -> float:
        """Return the row of the horizon in the middle of the picture."""
        return 0.5 * self.height_px - self.focal_px * float(np.tan(self.pitch_rad))


def draw_view(
    rng: np.random.Generator, width_px: int, height_px: int
) -> tuple[View, tuple[float, float]]:
    """Return a camera on a car or of a spectator, and how near and far cones stand."""
    on_car = rng.random() < 0.65
    above = rng.uniform(0.35, 1.4) if on_car else rng.uniform(1.5, 9.0)
    fov = rng.uniform(45.0, 105.0) if on_car else rng.uniform(12.0, 60.0)
    focal = 0.5 * width_px / np.tan(np.radians(0.5 * fov))
    if on_car:
        near, far = rng.uniform(1.2, 3.0), rng.uniform(15.0, 45.0)
        pitch = np.radians(rng.uniform(-4.0, 16.0))
    else:
        # The picture shows cones 12 to 120 px high, wherever the spectator stands.
        middle = np.exp(rng.uniform(np.log(14.0), np.log(110.0)))
        away = max(focal * 0.33 / middle, 1.5 * above)
        near, far = 0.5 * away, 2.2 * away
        pitch = np.arctan2(above, away) + rng.normal(0.0, 0.1) * height_px / focal
    view = View(
        width_px,
        height_px,
        float(focal),
        float(above),
        float(pitch),
        float(rng.normal(0.0, 0.03)),
        float(rng.uniform(-0.25, 0.05)) if on_car else 0.0,
    )
    return view, (float(near), float(far))
