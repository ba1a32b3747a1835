"""The camera's vocabulary: its lens, where it sits on the car, one RGB-D picture.

Pixels are (u, v), u right, v down, pixel centres at whole numbers. The optical frame
is x right, y down, z forward; the car frame x forward, y left, z up from the ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from conegraph.types import Array, Event, StreamInfo


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole with radial and tangential distortion.

    Attributes:
        width_px: columns of the picture.
        height_px: rows of the picture.
        fx_px: focal length along u.
        fy_px: focal length along v.
        cx_px: principal point, u.
        cy_px: principal point, v.
        distortion: (5,) k1, k2, p1, p2, k3 (Brown and Conrady, as OpenCV has them).
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def matrix(self) -> Array:
        """(3, 3) the pinhole's matrix K."""
        return np.array(
            [
                [self.fx_px, 0.0, self.cx_px],
                [0.0, self.fy_px, self.cy_px],
                [0.0, 0.0, 1.0],
            ]
        )


@dataclass(frozen=True, slots=True)
class CameraMount:
    """Where the camera sits: its optical centre in the car frame, and its attitude.

    Attributes:
        x_m: forward of the car frame's origin.
        y_m: to the left of it.
        height_m: above the ground.
        pitch_rad: nose down is positive.
        roll_rad: right side down is positive.
        yaw_rad: to the left is positive.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    height_m: float = 1.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    yaw_rad: float = 0.0

    @property
    def rotation_car_optical(self) -> Array:
        """(3, 3) turns vectors of the optical frame into the car frame.

        ``Rz(yaw) Ry(pitch) Rx(roll) A`` where A takes optical axes (right, down,
        forward) to the car's (forward, left, up).
        """
        cy, sy = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        cp, sp = np.cos(self.pitch_rad), np.sin(self.pitch_rad)
        cr, sr = np.cos(self.roll_rad), np.sin(self.roll_rad)
        yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        pitch = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        turned: Array = yaw @ pitch @ roll @ axes
        return turned

    @property
    def position_m(self) -> Array:
        """(3,) the optical centre in the car frame."""
        return np.array([self.x_m, self.y_m, self.height_m])


@dataclass(frozen=True, slots=True)
class RgbdFrame:
    """A colour picture with the depth of every pixel.

    Attributes:
        stamp_s: time of the exposure.
        color: (H, W, 3) uint8, RGB.
        depth_m: (H, W) float32 along the optical axis, 0 where there is none.
        camera: the lens that both were taken with.
        mount: where it sits.
    """

    stamp_s: float
    color: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    camera: Camera
    mount: CameraMount

    def __post_init__(self) -> None:
        shape = (self.camera.height_px, self.camera.width_px)
        if self.color.shape != (*shape, 3) or self.color.dtype != np.uint8:
            raise ValueError(
                f"RgbdFrame.color must be uint8 of shape {(*shape, 3)}, but got "
                f"{self.color.dtype} of {self.color.shape}"
            )
        if self.depth_m.shape != shape or self.depth_m.dtype != np.float32:
            raise ValueError(
                f"RgbdFrame.depth_m must be float32 of shape {shape}, but got "
                f"{self.depth_m.dtype} of {self.depth_m.shape}"
            )


class Stream(StreamInfo, Protocol):
    """A source whose frames may be pictures that a front end still has to look at.

    Every `Source` is one. Where the pictures come from a file, each is read when its
    turn comes, and every call of ``events`` begins anew.
    """

    def events(self) -> Iterator[Event | RgbdFrame]:
        """Yield the events, ordered as they reach the computer."""
        ...
