"""What goes wrong with detections, on top of what a sensor does by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from conegraph.geometry import rotation
from conegraph.sim.cone_sensor import ConeSensor, class_rows, false_detections
from conegraph.types import (
    Array,
    ConeClass,
    ConeObservations,
    TruthMap,
)

START_CLASSES = (ConeClass.ORANGE, ConeClass.BIG_ORANGE)
_COLOURS = 4
"""Classes that a cone can be painted in; what is beyond them is unknown."""


@dataclass(frozen=True, slots=True)
class StreamFaults:
    """Faults put into a stream of cones; none of them is reported.

    Attributes:
        wrong_colour: share of detections that get one of the three other colours.
        unknown_colour: share of detections whose class is taken away.
        missed: share of detections that are left out.
        false_cones: false detections for each one that there was, even over the
            view.
        noise_scale: factor on the noise, not on the covariance that is reported.
        range_scale: factor on every range, as of a wrong baseline.
        sensor_yaw_rad: the sensor is mounted turned to the right by this, so that
            every cone appears that much too far left.
        stamp_offset_s: every frame carries a stamp that is later than its moment by
            this, and arrives at that stamp.
        hide_start: orange cones are never detected.
        false_start: half a lap on, one cone on either side is big and orange.
    """

    wrong_colour: float = 0.0
    unknown_colour: float = 0.0
    missed: float = 0.0
    false_cones: float = 0.0
    noise_scale: float = 1.0
    range_scale: float = 1.0
    sensor_yaw_rad: float = 0.0
    stamp_offset_s: float = 0.0
    hide_start: bool = False
    false_start: bool = False

    @property
    def displace(self) -> bool:
        """Whether places or stamps are touched."""
        untouched = (1.0, 1.0, 0.0, 0.0)
        scales = (self.noise_scale, self.range_scale)
        return (*scales, self.sensor_yaw_rad, self.stamp_offset_s) != untouched

    def painted(self, cones: TruthMap, halfway_m: Array) -> TruthMap:
        """Return the cones as they stand on the track.

        Args:
            cones: as the layout has them.
            halfway_m: (2,) where the car is after half a lap.
        """
        if not self.false_start:
            return cones
        away = np.hypot(*(cones.xy_m - halfway_m).T)
        classes = cones.cone_class.copy()
        for side in (ConeClass.BLUE, ConeClass.YELLOW):
            nearest = np.argmin(np.where(cones.cone_class == side, away, np.inf))
            classes[nearest] = int(ConeClass.BIG_ORANGE)
        return replace(cones, cone_class=classes)

    def visible(self, cones: TruthMap) -> TruthMap:
        """Return the cones that can be detected at all."""
        if not self.hide_start:
            return cones
        seen = ~np.isin(cones.cone_class, START_CLASSES)
        return TruthMap(cones.id[seen], cones.xy_m[seen], cones.cone_class[seen])


def with_faults(
    frames: list[ConeObservations],
    faults: StreamFaults,
    sensor: ConeSensor,
    rng: np.random.Generator,
) -> list[ConeObservations]:
    """Return the frames with faults in them.

    Every fault draws from a generator of its own: colours change nothing in where
    and whether cones are seen, so that a stream with wrong colours has the same
    optimum as the one without.
    """
    miss, false, colour, noise = rng.spawn(4)
    if faults.missed > 0.0:
        frames = [f.subset(miss.random(len(f)) >= faults.missed) for f in frames]
    if faults.false_cones > 0.0:
        frames = _with_false(frames, faults.false_cones, sensor, false)
    if faults.wrong_colour > 0.0 or faults.unknown_colour > 0.0:
        frames = [_repainted(f, faults, sensor.certainty, colour) for f in frames]
    if faults.displace:
        frames = [_displaced(f, faults, noise) for f in frames]
    return frames


def _displaced(
    frame: ConeObservations, faults: StreamFaults, rng: np.random.Generator
) -> ConeObservations:
    """Return a frame seen at another time, by a worse and badly calibrated sensor.

    Noise of the scale k has k^2 the covariance; what it lacks is added.
    """
    xy = frame.xy_m
    if faults.noise_scale > 1.0:
        lacking = np.sqrt(faults.noise_scale**2 - 1.0) * np.linalg.cholesky(
            frame.cov_m2
        )
        xy = xy + np.einsum("nij,nj->ni", lacking, rng.standard_normal(xy.shape))
    xy = faults.range_scale * xy @ rotation(faults.sensor_yaw_rad).T
    return replace(frame, stamp_s=frame.stamp_s + faults.stamp_offset_s, xy_m=xy)


def _with_false(
    frames: list[ConeObservations],
    share: float,
    sensor: ConeSensor,
    rng: np.random.Generator,
) -> list[ConeObservations]:
    count = sum(len(f) for f in frames) / max(len(frames), 1)
    clutter = replace(sensor, false_per_frame=share * count)
    stamps = np.array([f.stamp_s for f in frames])
    added = false_detections(clutter, stamps, rng)
    return [_joined(f, extra, rng) for f, extra in zip(frames, added, strict=True)]


def _joined(
    frame: ConeObservations, extra: ConeObservations, rng: np.random.Generator
) -> ConeObservations:
    ids = np.full(len(frame), -1) if frame.truth_id is None else frame.truth_id
    both = ConeObservations(
        frame.stamp_s,
        np.vstack([frame.xy_m, extra.xy_m]),
        np.concatenate([frame.cov_m2, extra.cov_m2]),
        np.vstack([frame.class_prob, extra.class_prob]),
        np.concatenate([ids, np.full(len(extra), -1)]),
    )
    return both.subset(rng.permutation(len(both)))


def _repainted(
    frame: ConeObservations,
    faults: StreamFaults,
    certainty: float,
    rng: np.random.Generator,
) -> ConeObservations:
    """Give a share of the detections another colour, and a share none."""
    luck = rng.random(len(frame))
    named = frame.class_prob.argmax(axis=1)
    another = (named + rng.integers(1, _COLOURS, len(frame))) % _COLOURS
    wrong = (luck < faults.wrong_colour) & (named != ConeClass.UNKNOWN)
    lost = luck >= 1.0 - faults.unknown_colour
    named = np.where(lost, int(ConeClass.UNKNOWN), np.where(wrong, another, named))
    prob = np.where(
        (wrong | lost)[:, None], class_rows(named, certainty), frame.class_prob
    )
    return replace(frame, class_prob=prob)
