"""How large things that stand on the ground are in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.camera import Camera
from conegraph.frontend.camera import rays
from conegraph.types import Array

CONE_HEIGHT_M = 0.325
BIG_HEIGHT_M = 0.505
FOOT_M = 0.228
BIG_FOOT_M = 0.285
MIN_INVERSE_DEPTH_PER_M = 0.01


@dataclass(frozen=True, slots=True)
class GroundScale:
    """A lens over a plane.

    Attributes:
        camera: the lens.
        plane: (3,) p of ``1/Z = p . (X/Z, Y/Z, 1)``.
    """

    camera: Camera
    plane: Array

    def px_per_m(self, uv_px: Array) -> Array:
        """Return the height in px (N,) of a metre that stands on the ground at (N, 2).

        A metre upwards moves the point by -n, with n the plane's downward normal;
        with ``v = f Y/Z + c`` that is ``f (n_y - (Y/Z) n_z) / Z`` rows. Above the
        horizon, where there is no ground, the scale is that of 100 m.
        """
        ray = rays(self.camera, uv_px)
        normal = self.plane / np.linalg.norm(self.plane)
        inverse_m = np.maximum(ray @ self.plane, MIN_INVERSE_DEPTH_PER_M)
        tilt = normal[1] - ray[:, 1] * normal[2]
        found: Array = self.camera.fy_px * inverse_m * np.maximum(tilt, 0.1)
        return found

    def first_row(self, max_range_m: float) -> int:
        """Return the row above which no cone within a range can be seen."""
        lens = self.camera
        rows = np.arange(0, lens.height_px, 8.0)
        tops = []
        for column in (0.0, lens.width_px / 2, lens.width_px - 1.0):
            uv = np.column_stack([np.full_like(rows, column), rows])
            inverse_m = rays(lens, uv) @ self.plane
            foot = inverse_m >= 1.0 / max_range_m
            if foot.any():
                row = rows[foot][0]
                height_px = self.px_per_m(np.array([[column, row]]))[0] * BIG_HEIGHT_M
                tops.append(row - height_px)
        return int(np.clip(min(tops, default=0.0) - 12.0, 0, lens.height_px - 1))
