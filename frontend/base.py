"""What a detector finds in a picture, and what the front end makes of it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.frontend.ground import GroundPlane
from conegraph.frontend.scale import GroundScale
from conegraph.types import Array, ConeObservations, IntArray, Mask, SensorModel

Picture = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Candidates:
    """Cones in the picture, before anybody asks where they stand.

    Attributes:
        box_px: (N, 4) left, top, right and bottom edge; a single pixel (u, v) has the
            box (u - 0.5, v - 0.5, u + 0.5, v + 0.5).
        class_prob: (N, 5) probabilities in the order of `ConeClass`; how an orange
            cone's is shared between small and big is settled by its height later.
        score: (N,) how much it looks like a cone, 0 to 1.
        pixel_uv: (M, 2) pixels that are on a cone for sure, sorted by owner.
        owner: (M,) row of the cone that each of them is on.
        axis_uv: (N, 2) a point on each cone's axis, well above the ground.
        crowded: (N,) whether it touches another of its colour, so that some of its
            outline may be the other's.
    """

    box_px: Array
    class_prob: Array
    score: Array
    pixel_uv: IntArray
    owner: IntArray
    axis_uv: Array
    crowded: Mask

    def __len__(self) -> int:
        return len(self.box_px)

    def subset(self, keep: Mask) -> Candidates:
        """Return the rows that the mask (N,) keeps, with their pixels."""
        row = np.cumsum(keep) - 1
        held = keep[self.owner]
        return Candidates(
            self.box_px[keep],
            self.class_prob[keep],
            self.score[keep],
            self.pixel_uv[held],
            row[self.owner[held]],
            self.axis_uv[keep],
            self.crowded[keep],
        )

    @staticmethod
    def empty() -> Candidates:
        """No cones at all."""
        none = np.zeros(0)
        return Candidates(
            np.zeros((0, 4)),
            np.zeros((0, 5)),
            none,
            np.zeros((0, 2), dtype=np.int64),
            none.astype(np.int64),
            np.zeros((0, 2)),
            none.astype(bool),
        )


@dataclass(frozen=True, slots=True)
class Detections:
    """One frame's cones, in the picture and on the ground.

    Attributes:
        observations: positions in the car frame, covariances, classes.
        box_px: (N, 4) boxes as in `Candidates`.
        score: (N,) how much each looks like a cone, 0 to 1.
        height_m: (N,) height of each.
        ground: the plane that they stand on.
    """

    observations: ConeObservations
    box_px: Array
    score: Array
    height_m: Array
    ground: GroundPlane


class Detector(Protocol):
    """Finds cones in pictures; a new one is one class and one line in the factory."""

    def find(self, picture: Picture, scale: GroundScale | None = None) -> Candidates:
        """Find cones in an RGB picture (H, W, 3), with its ``scale`` where known."""
        ...


class FrontEnd(Protocol):
    """From an RGB-D frame to cones in the car frame."""

    def sensor(self, camera: Camera, mount: CameraMount) -> SensorModel:
        """Return how precise and how far it sees with a camera that sits so."""
        ...

    @property
    def rejected(self) -> Counter[str]:
        """What of the frames could not be used, counted by reason."""
        ...

    @property
    def refused(self) -> Counter[str]:
        """What a detector found and is no cone, counted by reason."""
        ...

    def detect(self, frame: RgbdFrame) -> ConeObservations:
        """Return the frame's cones, with covariances."""
        ...

    def examine(self, frame: RgbdFrame) -> Detections:
        """Return the same, with all that a viewer shows."""
        ...

    def find(self, picture: Picture) -> Candidates:
        """Find cones in a picture alone: nothing is known of where they stand."""
        ...
