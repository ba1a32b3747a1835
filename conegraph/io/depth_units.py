"""Whether depths are what they claim to be: metres, millimetres, or something else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount
from conegraph.types import Array

_LEAST_M, _MOST_M = 0.15, 60.0
_LOOKED_AT = (slice(-120, None, 8), slice(None, None, 8))
_NEAR_GROUND_M = 8.0
_WRONG_FACTOR = 2.5
_LEAST_PIXELS = 20


def unit_problem(
    depth_m: NDArray[np.float32], camera: Camera, mount: CameraMount | None
) -> str | None:
    """Return what is odd about the size of depths, None if nothing is.

    The middle of all depths must be one that a camera can measure. Where the mount
    is known, the ground close to the car must lie about where it has to: a factor
    of 5 (the TUM sequences' unit against millimetres) is noticed too.

    Args:
        depth_m: (H, W) in m, 0 where there is none.
        camera: the lens.
        mount: where it sits, None where nobody knows.
    """
    seen = depth_m[::4, ::4]
    seen = seen[seen > 0]
    if len(seen) < _LEAST_PIXELS:
        return None
    middle = float(np.median(seen))
    if not _LEAST_M <= middle <= _MOST_M:
        return f"the middle depth is {middle:.3g} m"
    if mount is None:
        return None
    below = depth_m[_LOOKED_AT]
    expected = _ground_depth(camera, mount)[_LOOKED_AT]
    near = (below > 0) & (expected > 0) & (expected < _NEAR_GROUND_M)
    if int(near.sum()) < _LEAST_PIXELS:
        return None
    factor = float(np.median(below[near] / expected[near]))
    if 1 / _WRONG_FACTOR <= factor <= _WRONG_FACTOR:
        return None
    return f"the ground is {factor:.3g} times as far away as the mount says"


def _ground_depth(camera: Camera, mount: CameraMount) -> Array:
    """Return the depth (H, W) of level ground, 0 above the horizon, pinhole only."""
    x = (np.arange(camera.width_px) - camera.cx_px) / camera.fx_px
    y = (np.arange(camera.height_px) - camera.cy_px) / camera.fy_px
    down = mount.rotation_car_optical[2]
    fall = down[0] * x[None] + down[1] * y[:, None] + down[2]
    depth: Array = np.where(
        fall < -1e-3, -mount.height_m / np.minimum(fall, -1e-3), 0.0
    )
    return depth
