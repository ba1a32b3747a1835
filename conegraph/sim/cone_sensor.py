"""A cone detector on a car whose true motion is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from conegraph.types import (
    N_CLASSES,
    Array,
    ConeClass,
    ConeObservations,
    IntArray,
    SensorModel,
    TruthMap,
)

_NEAREST_M = 0.15
"""Noise never brings a measured range below this."""


@dataclass(frozen=True, slots=True)
class RangeFalloff:
    """A probability that falls with range, as PacSim's perception sensors have it.

    With d the distance beyond the sensor's least range::

        p = max(least, near - per_m d - per_m2 d^2)
    """

    near: float
    per_m: float = 0.0
    per_m2: float = 0.0
    least: float = 0.0

    def at(self, beyond_m: Array) -> Array:
        """Return the probability (N,) at distances (N,) beyond the least range."""
        fallen = self.near - beyond_m * (self.per_m + self.per_m2 * beyond_m)
        return np.clip(fallen, self.least, 1.0)


@dataclass(frozen=True, slots=True)
class ConeSensor:
    """A cone detector and its failings.

    Attributes:
        model: view and noise; noise is drawn at the true range, and the covariance
            that is reported is the model's at the measured place, because a real
            detector knows no other.
        rate_hz: frames per second.
        detection: chance that a cone in view is reported.
        false_per_frame: mean number of false detections in a frame (Poisson), even
            over the area in view.
        classification: chance that a reported cone gets its true class.
        class_range_m: beyond it the class is always unknown.
        unknown_share: of the cones that do not get their true class, the share that
            is reported as unknown; the others get another class by chance.
        certainty: probability that a report gives to the class it names; the other
            classes share the rest.
        delay_s: time between a frame's stamp and its arrival.
    """

    model: SensorModel
    rate_hz: float
    detection: RangeFalloff
    false_per_frame: float
    classification: RangeFalloff
    class_range_m: float = np.inf
    unknown_share: float = 0.5
    certainty: float = 0.9
    delay_s: float = 0.0


CAMERA = ConeSensor(
    model=SensorModel(
        range_sigma_m=np.array([0.01, 0.0, 0.0025]),
        bearing_sigma_rad=0.005,
        min_range_m=0.5,
        max_range_m=12.0,
        half_fov_rad=0.75,
        detection_probability=0.93,
    ),
    rate_hz=30.0,
    detection=RangeFalloff(0.93),
    false_per_frame=0.05,
    classification=RangeFalloff(0.99, per_m=0.002),
)
"""A stereo camera: five to six cones a frame, precise in bearing, not in range."""

LIDAR = ConeSensor(
    model=SensorModel(
        range_sigma_m=np.array([0.02, 0.0, 0.0]),
        bearing_sigma_rad=0.001,
        floor_m=0.01,
        min_range_m=1.0,
        max_range_m=45.0,
        half_fov_rad=1.0472,
        detection_probability=0.53,
    ),
    rate_hz=10.0,
    detection=RangeFalloff(0.99, per_m=0.01, per_m2=0.00012, least=0.1),
    false_per_frame=0.05,
    classification=RangeFalloff(0.99, per_m=0.01, per_m2=0.000125, least=0.2),
    class_range_m=15.0,
    unknown_share=0.25,
)
"""The lidar of PacSim's ``perception.yaml``, without its delay of 0.2 s.

Its detection probability is that at three quarters of its range, so that it never
promises more than comes. Where its class fails, any of the four other classes
comes, unknown among them. Its relative range noise of 1e-4 is below its other noise
by a factor of four at any range and left out.
"""


def sense(
    sensor: ConeSensor,
    stamp_s: Array,
    pose_world_car: Array,
    cones: TruthMap,
    rng: np.random.Generator,
) -> list[ConeObservations]:
    """Return what the sensor reports of the cones, a frame for each stamp.

    Args:
        sensor: the detector.
        stamp_s: (F,) stamps.
        pose_world_car: (F, 3) true poses at the stamps.
        cones: the true cones, in the same world.
        rng: draws everything random.

    Returns:
        F frames; `truth_id` is the cone's id, or -1 for a false detection. Within a
        frame the order is random.
    """
    frame, which, polar = _in_view(sensor.model, pose_world_car, cones.xy_m)
    beyond = polar[:, 0] - sensor.model.min_range_m
    kept = rng.random(len(frame)) < sensor.detection.at(beyond)
    frame, which, polar, beyond = frame[kept], which[kept], polar[kept], beyond[kept]
    truth = cones.cone_class[which]
    named = _named(sensor, truth, polar[:, 0], beyond, rng)
    xy = _measured(sensor.model, polar, rng)
    false_frame, false_xy, false_named = _false(sensor, len(stamp_s), rng)
    frame = np.concatenate([frame, false_frame])
    xy = np.vstack([xy, false_xy])
    named = np.concatenate([named, false_named])
    ids = np.concatenate([cones.id[which], np.full(len(false_frame), -1)])
    order = np.lexsort((rng.random(len(frame)), frame))
    return _frames(sensor, stamp_s, frame[order], xy[order], named[order], ids[order])


def _in_view(
    model: SensorModel, poses: Array, cones_m: Array
) -> tuple[IntArray, IntArray, Array]:
    """Return frame, cone and true (range, bearing) of every sight of a cone."""
    near = cKDTree(poses[:, :2]).sparse_distance_matrix(
        cKDTree(cones_m), model.max_range_m, output_type="ndarray"
    )
    near = near[np.lexsort((near["j"], near["i"]))]
    frame, which = near["i"].astype(np.int64), near["j"].astype(np.int64)
    away = cones_m[which] - poses[frame, :2]
    bearing = np.arctan2(away[:, 1], away[:, 0]) - poses[frame, 2]
    bearing = np.mod(bearing + np.pi, 2 * np.pi) - np.pi
    polar = np.column_stack([np.hypot(*away.T), bearing])
    seen = (polar[:, 0] >= model.min_range_m) & (np.abs(bearing) <= model.half_fov_rad)
    return frame[seen], which[seen], polar[seen]


def _measured(model: SensorModel, polar: Array, rng: np.random.Generator) -> Array:
    """Return noisy positions (N, 2) in the car frame of true (range, bearing)."""
    c0, c1, c2 = model.range_sigma_m
    true_range = polar[:, 0]
    sigma = c0 + true_range * (c1 + true_range * c2)
    distance = true_range + sigma * rng.standard_normal(len(polar))
    bearing = polar[:, 1] + model.bearing_sigma_rad * rng.standard_normal(len(polar))
    floor = model.floor_m * rng.standard_normal((len(polar), 2))
    return _cartesian(np.maximum(distance, _NEAREST_M), bearing) + floor


def _cartesian(distance: Array, bearing: Array) -> Array:
    return np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])


def _named(
    sensor: ConeSensor,
    truth: IntArray,
    distance: Array,
    beyond: Array,
    rng: np.random.Generator,
) -> IntArray:
    """Return the class (N,) that is reported of each cone."""
    luck, how = rng.random((2, len(truth)))
    right = luck < sensor.classification.at(beyond)
    colours = N_CLASSES - 1
    # A step of 1 to 3 around the four colours never comes back to the true one.
    another = (truth + rng.integers(1, colours, len(truth))) % colours
    any_colour = rng.integers(0, colours, len(truth))
    other = np.where(truth == ConeClass.UNKNOWN, any_colour, another)
    wrong = np.where(how < sensor.unknown_share, int(ConeClass.UNKNOWN), other)
    named = np.where(right, truth, wrong)
    far = distance > sensor.class_range_m
    return np.where(far, int(ConeClass.UNKNOWN), named).astype(np.int64)


def _false(
    sensor: ConeSensor, frames: int, rng: np.random.Generator
) -> tuple[IntArray, Array, IntArray]:
    """Return frame, place and class of false detections, even over the view."""
    frame = np.repeat(np.arange(frames), rng.poisson(sensor.false_per_frame, frames))
    model = sensor.model
    span = (model.min_range_m**2, model.max_range_m**2)
    distance = np.sqrt(rng.uniform(*span, len(frame)))
    bearing = rng.uniform(-model.half_fov_rad, model.half_fov_rad, len(frame))
    named = rng.integers(0, N_CLASSES, len(frame))
    return frame, _cartesian(distance, bearing), named


def false_detections(
    sensor: ConeSensor, stamp_s: Array, rng: np.random.Generator
) -> list[ConeObservations]:
    """Return only what the sensor reports where no cone is, a frame for each stamp."""
    frame, xy, named = _false(sensor, len(stamp_s), rng)
    return _frames(sensor, stamp_s, frame, xy, named, np.full(len(frame), -1))


def class_rows(named: IntArray, certainty: float) -> Array:
    """Return class probabilities (N, 5) with the certainty on the named class (N,)."""
    prob = np.full((len(named), N_CLASSES), (1 - certainty) / (N_CLASSES - 1))
    prob[np.arange(len(named)), named] = certainty
    return prob


def _frames(
    sensor: ConeSensor,
    stamp_s: Array,
    frame: IntArray,
    xy: Array,
    named: IntArray,
    ids: IntArray,
) -> list[ConeObservations]:
    """Cut rows that are sorted by frame into frames."""
    cov = sensor.model.covariance(xy)
    prob = class_rows(named, sensor.certainty)
    cuts = np.searchsorted(frame, np.arange(len(stamp_s) + 1))
    return [
        ConeObservations(stamp, xy[a:b], cov[a:b], prob[a:b], ids[a:b])
        for stamp, a, b in zip(stamp_s.tolist(), cuts[:-1], cuts[1:], strict=True)
    ]
