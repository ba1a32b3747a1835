"""What goes wrong with detections, on top of what a sensor does by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from conegraph.sim.cone_sensor import ConeSensor, class_rows, false_detections
from conegraph.types import ConeClass, ConeObservations

_COLOURS = 4
"""Classes that a cone can be painted in; what is beyond them is unknown."""


@dataclass(frozen=True, slots=True)
class StreamFaults:
    """Faults put into a stream of cones, each a share of the detections.

    Attributes:
        wrong_colour: detections that are given one of the three other colours.
        unknown_colour: detections whose class is taken away.
        missed: detections that are left out.
        false_cones: false detections for each one that there was, even over the
            view.
    """

    wrong_colour: float = 0.0
    unknown_colour: float = 0.0
    missed: float = 0.0
    false_cones: float = 0.0


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
    miss, false, colour = rng.spawn(3)
    if faults.missed > 0.0:
        frames = [f.subset(miss.random(len(f)) >= faults.missed) for f in frames]
    if faults.false_cones > 0.0:
        frames = _with_false(frames, faults.false_cones, sensor, false)
    if faults.wrong_colour > 0.0 or faults.unknown_colour > 0.0:
        frames = [_repainted(f, faults, sensor.certainty, colour) for f in frames]
    return frames


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
