"""Cones seen around the car, from one frame or several, ready to be recognised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.backends.landmarks import class_likelihood
from conegraph.types import Array, ConeMap, ConeObservations

STANDING = np.zeros((1, 3))
"""The only place to have looked from in a single frame: where the car is."""


@dataclass(frozen=True, slots=True)
class Sightings:
    """A constellation of cones in the frame of the car as it stands now.

    Attributes:
        xy_m: (n, 2) positions.
        cov_m2: (n, 2, 2) their covariances.
        likelihood: (n, 5) how likely what was seen of each cone is under each class,
            up to a factor.
        views: (k, 3) poses of the car, seen from where it is now, from which it
            looked.
        frames_per_view: how many frames each view stands for.
    """

    xy_m: Array
    cov_m2: Array
    likelihood: Array
    views: Array
    frames_per_view: float = 1.0

    def __len__(self) -> int:
        return len(self.xy_m)

    @staticmethod
    def of_frame(frame: ConeObservations) -> Sightings:
        """Return the cones of a single frame."""
        return Sightings(
            frame.xy_m, frame.cov_m2, class_likelihood(frame.class_prob), STANDING
        )

    @staticmethod
    def of_map(cone_map: ConeMap) -> Sightings:
        """Return all cones of a map, seen from nowhere."""
        likelihood = class_likelihood(cone_map.class_prob)
        return Sightings(cone_map.xy_m, cone_map.cov_m2, likelihood, np.zeros((0, 3)))
