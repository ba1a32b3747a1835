"""The thesis's detector (chapter 3), step by step.

Undistort; flatten colours by mean shift, filter depth by a median; cut the region of
interest; then for each colour of Table 3.1: threshold in HSV, find contours, test area
and distance, take the centroid, look up the depth there and project it back. Nothing is
mended here: the centroid may lie on a stripe, a stripe parts a cone in two, and what is
reported is the visible surface.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.config import ColourRange, HsvThesisConfig
from conegraph.frontend.base import Candidates, Detections, Picture
from conegraph.frontend.camera import half_fov_rad, plane_of_mount, rays, undistorted
from conegraph.frontend.ground import GroundPlane
from conegraph.types import (
    CLASS_LABELS,
    N_CLASSES,
    Array,
    ConeObservations,
    IntArray,
    SensorModel,
)

NOISE = SensorModel(np.array([0.05, 0.0, 0.0025]), 0.01)
"""The thesis gives its cones no covariance: a stereo camera's of usual quality."""


class ThesisFrontEnd:
    """Chapter 3 of the thesis as a front end."""

    def __init__(self, config: HsvThesisConfig) -> None:
        """Take the table of colours and the limits."""
        self._config = config
        self.rejected: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()

    def sensor(self, camera: Camera, mount: CameraMount) -> SensorModel:
        """Return the noise that is assumed, within the limits of range and lens."""
        limits = self._config.min_range_m, self._config.max_range_m
        return replace(
            NOISE,
            min_range_m=limits[0],
            max_range_m=limits[1],
            half_fov_rad=half_fov_rad(camera),
        )

    def detect(self, frame: RgbdFrame) -> ConeObservations:
        """Return the frame's cones in the car frame."""
        return self.examine(frame).observations

    def examine(self, frame: RgbdFrame) -> Detections:
        """Return the same, with boxes in the picture without distortion."""
        flat = undistorted(frame)
        depth_m = cv2.medianBlur(flat.depth_m, self._config.median_px)
        found, centroid = self._contours(flat.color)
        u, v = np.round(centroid).astype(np.int64).T
        distance_m = np.asarray(depth_m, dtype=np.float64)[v, u]
        near = distance_m > self._config.min_range_m
        passed = near & (distance_m < self._config.max_range_m)
        self.refused["without a depth in range"] += int((~passed).sum())
        points = rays(flat.camera, centroid) * distance_m[:, None]
        to_car = frame.mount.rotation_car_optical
        at_m = points @ to_car.T + frame.mount.position_m
        xy_m = at_m[passed, :2]
        cones = ConeObservations(
            frame.stamp_s,
            xy_m,
            NOISE.covariance(xy_m - frame.mount.position_m[:2]),
            found.class_prob[passed],
        )
        home = plane_of_mount(frame.mount)
        ground = GroundPlane(home, np.zeros((3, 3)), 0.0, False)
        box, score = found.box_px[passed], found.score[passed]
        return Detections(cones, box, score, at_m[passed, 2], ground)

    def find(self, picture: Picture) -> Candidates:
        """Find contours in a picture alone; its lens, being unknown, bends nothing."""
        return self._contours(picture)[0]

    def _contours(self, picture: Picture) -> tuple[Candidates, Array]:
        """Return contours of every colour that pass the area test, and centroids."""
        config = self._config
        rows = len(picture)
        top = int(config.roi_top * rows)
        bottom = max(int(config.roi_bottom * rows), top + 1)
        flat = cv2.pyrMeanShiftFiltering(
            picture,
            config.spatial_radius_px,
            config.colour_radius,
            maxLevel=config.pyramid_levels,
        )
        hsv = cv2.cvtColor(np.asarray(flat)[top:bottom], cv2.COLOR_RGB2HSV)
        boxes: list[list[float]] = []
        centroids: list[tuple[float, float]] = []
        classes: list[int] = []
        for entry in config.colours:
            for outline, centroid in self._of_colour(hsv, entry):
                u, v, width, height = cv2.boundingRect(outline)
                low = v + top - 0.5
                boxes.append([u - 0.5, low, u + width - 0.5, low + height])
                centroids.append((centroid[0], centroid[1] + top))
                classes.append(CLASS_LABELS.index(entry.cone))
        prob = np.eye(N_CLASSES)[np.array(classes, dtype=np.int64)]
        at = np.array(centroids).reshape(-1, 2)
        none = np.zeros((0, 2), dtype=np.int64)
        owner: IntArray = np.zeros(0, dtype=np.int64)
        found = Candidates(
            np.array(boxes).reshape(-1, 4),
            prob,
            np.ones(len(at)),
            none,
            owner,
            at,
            np.zeros(len(at), dtype=bool),
        )
        return found, at

    def _of_colour(
        self, hsv: cv2.typing.MatLike, entry: ColourRange
    ) -> list[tuple[cv2.typing.MatLike, tuple[float, float]]]:
        mask = cv2.inRange(hsv, np.array(entry.low), np.array(entry.high))
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        found = []
        for outline in outlines:
            moments = cv2.moments(outline)
            area = cv2.contourArea(outline)
            if not self._config.min_area_px < area < self._config.max_area_px:
                self.refused["of another area"] += 1
                continue
            weight = moments["m00"]
            centroid = (moments["m10"] / weight, moments["m01"] / weight)
            found.append((outline, centroid))
        return found
