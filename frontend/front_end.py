"""The front end: ground, detector, places, and what is refused on the way."""

from __future__ import annotations

from collections import Counter

import numpy as np

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.config import GroundConfig, LocalizationConfig
from conegraph.frontend.base import Candidates, Detections, Detector, Picture
from conegraph.frontend.camera import half_fov_rad
from conegraph.frontend.ground import GroundTracker
from conegraph.frontend.localize import Places, localize
from conegraph.frontend.scale import GroundScale
from conegraph.frontend.sizes import fits, measure_sizes, with_doubt, with_size
from conegraph.types import ConeObservations, Mask, SensorModel

MILLIMETRES_ABOVE_M = 100.0
"""A median depth beyond this is no depth in metres."""
SIZE_GATE_D2 = 14.0
"""A size farther than this from a cone's is none; 13.8 is 0.999 of chi² at 2."""
MAX_LIFT_M = 0.12
SIGMAS = 2.0


class RgbdFrontEnd:
    """Finds cones with a detector and places them on the ground of every frame."""

    def __init__(
        self,
        detector: Detector,
        ground: GroundConfig,
        localization: LocalizationConfig,
        *,
        min_range_m: float,
        max_range_m: float,
    ) -> None:
        """Put the parts together; cones outside the ranges are not reported."""
        self._detector = detector
        self._tracker = GroundTracker(ground)
        self._localization = localization
        self._range_m = (min_range_m, max_range_m)
        self.rejected: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()

    def sensor(self, camera: Camera, mount: CameraMount) -> SensorModel:
        """Return how precise and how far it sees with a camera that sits so.

        The range of a cone at r is as uncertain as the row of its foot, by
        ``r^2 s_v / (f h)`` over level ground, and never better than its foot.
        """
        errors, (near, far) = self._localization, self._range_m
        row = errors.edge_sigma_px / (camera.fy_px * mount.height_m)
        return SensorModel(
            np.array([errors.foot_sigma_m, 0.0, row]),
            errors.center_sigma_px / camera.fx_px,
            errors.axis_sigma_m,
            near,
            far,
            half_fov_rad(camera),
        )

    def find(self, picture: Picture) -> Candidates:
        """Find cones in a picture alone."""
        return self._detector.find(picture)

    def detect(self, frame: RgbdFrame) -> ConeObservations:
        """Return the frame's cones in the car frame, with covariances."""
        return self.examine(frame).observations

    def examine(self, frame: RgbdFrame) -> Detections:
        """Return the same, with boxes, heights and the ground."""
        frame = self._checked(frame)
        ground = self._tracker.update(frame)
        scale = GroundScale(frame.camera, ground.plane)
        found = self._detector.find(frame.color, scale)
        places = localize(frame, found, ground, self._localization)
        sizes = measure_sizes(frame, found, places, ground)
        keep = self._kept(places, fits(found.class_prob, sizes, SIZE_GATE_D2))
        prob = with_size(found.class_prob, sizes)
        cov = with_doubt(places.cov_m2, prob, sizes)
        cones = ConeObservations(
            frame.stamp_s, places.xy_m, cov, prob, score=found.score
        )
        return Detections(
            cones.subset(keep),
            sizes.box_px[keep],
            found.score[keep],
            sizes.height_m[keep],
            ground,
        )

    def _checked(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame without depth where its depth cannot be true."""
        coarse = frame.depth_m[::16, ::16]
        some = coarse[(coarse > 0) & np.isfinite(coarse)]
        if not len(some):
            reason = "depth picture that is empty"
        elif np.median(some) > MILLIMETRES_ABOVE_M:
            reason = "depth picture that looks like millimetres"
        else:
            return frame
        self.rejected[reason] += 1
        return RgbdFrame(
            frame.stamp_s,
            frame.color,
            np.zeros_like(frame.depth_m),
            frame.camera,
            frame.mount,
        )

    def _kept(self, places: Places, sized: Mask) -> Mask:
        near, far = self._range_m
        known = places.range_sigma_m < 0.3 * places.range_m
        within = (places.range_m >= near) & (places.range_m <= far)
        grounded = places.lift_m <= MAX_LIFT_M + SIGMAS * places.lift_sigma_m
        for reason, passed in (
            ("of unknown range", known),
            ("out of range", within),
            ("not of a cone's size", sized),
            ("not on the ground", grounded),
        ):
            self.refused[reason] += int((~passed).sum())
        return known & within & sized & grounded
