"""The picture in the making: colour, depth, and which cone is where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount
from conegraph.sim.render.paint import Bytes, Floats


@dataclass(frozen=True, slots=True)
class Canvas:
    """Arrays that things are drawn into, far ones first.

    Attributes:
        color: (H, W, 3) uint8, RGB.
        depth_m: (H, W) along the optical axis, 0 where there is nothing.
        label: (H, W) index of the cone, -1 where there is none.
    """

    color: Bytes
    depth_m: Floats
    label: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Eye:
    """The camera at one moment.

    Attributes:
        camera: its lens.
        mount: where it sits, tilted as the car is.
        slope_x: (H, W) x/z of every pixel's ray in the optical frame.
        slope_y: (H, W) y/z of it.
    """

    camera: Camera
    mount: CameraMount
    slope_x: Floats
    slope_y: Floats
