"""Depth of one eye moved to the pixels of another."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera
from conegraph.frontend.realsense_frames import bending
from conegraph.types import Array

MAX_SPREAD_PX = 16


@dataclass(frozen=True, slots=True)
class Registration:
    """Where depth pixels land in the colour picture.

    A depth pixel is a square: its upper left and lower right corners are put in
    space at its depth, moved to the colour eye (``p_color = R p_depth + t``) and
    projected; pixels whose centre lies between them get the depth along its axis.
    Where several land, the nearest hides the others.

    Attributes:
        color: the colour eye's lens.
        turned_rays: (2, h, w, 3) rays through the corners with z = 1, already
            turned into the colour eye's frame.
        shift_m: (3,) where the depth eye sits in that frame.
    """

    color: Camera
    turned_rays: Array
    shift_m: Array

    @classmethod
    def between(
        cls, depth: Camera, color: Camera, rotation: Array, shift_m: Array
    ) -> Registration:
        """Return the registration for two lenses and the pose between them.

        Args:
            depth: the depth eye's lens.
            color: the colour eye's lens.
            rotation: (3, 3) turns vectors of the depth eye into the colour eye's frame.
            shift_m: (3,) where the depth eye sits in that frame.
        """
        u, v = np.meshgrid(np.arange(depth.width_px), np.arange(depth.height_px))
        centres = np.stack([u, v], axis=-1)
        corners = np.stack([centres - 0.5, centres + 0.5]).reshape(-1, 1, 2)
        straight = cv2.undistortPoints(
            corners, depth.matrix, np.array(depth.distortion)
        ).reshape(-1, 2)
        rays = np.column_stack([straight, np.ones(len(straight))]) @ rotation.T
        shape = (2, depth.height_px, depth.width_px, 3)
        return cls(color, rays.reshape(shape), np.asarray(shift_m, dtype=float))

    def moved(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (H, W) depth of the colour pixels, 0 where none lands.

        Args:
            depth_m: (h, w) along the depth eye's axis, 0 where there is none.
        """
        seen = depth_m > 0
        points = self.turned_rays[:, seen] * depth_m[seen][:, None] + self.shift_m
        before = (points[..., 2] > 0).all(axis=0)
        points = points[:, before]
        wide, tall = self.color.width_px, self.color.height_px
        nearest = np.full(tall * wide, np.inf, dtype=np.float32)
        if points.size:
            z = points.mean(axis=0)[:, 2].astype(np.float32)
            first, count = self._pixels(points)
            for step_u, step_v in np.ndindex(*count.max(axis=0)):
                u, v = first[:, 0] + step_u, first[:, 1] + step_v
                lands = (
                    (count > (step_u, step_v)).all(axis=1)
                    & ((u >= 0) & (u < wide))
                    & ((v >= 0) & (v < tall))
                )
                np.minimum.at(nearest, v[lands] * wide + u[lands], z[lands])
        nearest[np.isinf(nearest)] = 0.0
        return nearest.reshape(tall, wide)

    def _pixels(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (N, 2) first pixels and (N, 2) how many, of (2, N, 3) corners."""
        x, y = np.moveaxis(points[..., :2] / points[..., 2:], -1, 0)
        lens = self.color
        if any(lens.distortion):
            bent = bending(x.ravel(), y.ravel()) @ np.array(lens.distortion)
            by_x, by_y = bent.reshape(2, *x.shape)
            x, y = x + by_x, y + by_y
        flat = np.stack(
            [x * lens.fx_px + lens.cx_px, y * lens.fy_px + lens.cy_px], axis=-1
        )
        # Far outside the picture a whole number would overflow.
        limit = 10 * max(self.color.width_px, self.color.height_px)
        at = np.ceil(np.clip(flat, -limit, limit))
        first, end = np.sort(at.astype(np.int64), axis=0)
        return first, np.minimum(end - first, MAX_SPREAD_PX)
