"""Sightings that were left aside, looked at again in a solution that knows better.

A cone is not told from its neighbour, or lies outside its gate, because the map was
still vague. To leave such sightings out for good is not harmless: which ones they are
depends on their errors, so that the rest is biased towards what was believed.
"""

from __future__ import annotations

import numpy as np

from conegraph.backends.sensor_noise import squared_mahalanobis, transport_covariance
from conegraph.backends.tracked_frame import Unclaimed
from conegraph.types import Array, IntArray, Mask, SensorModel

FIT_D2 = 13.8
"""A sighting farther off than this shows no cone of the map: 0.999 of chi² at 2."""

LEAD_D2 = 6.0
"""How much nearer than any other its cone must be: odds of twenty to one."""


def second_look(
    unclaimed: Unclaimed, there_m: Array, free: Mask, sensor: SensorModel
) -> tuple[IntArray, IntArray, Array]:
    """Find the cones that unclaimed sightings of one frame show.

    In a settled solution the doubt about cones and pose is small beside the sensor's,
    so ``d2 = z' R^-1 z`` with R at the cone's range. A sighting takes the cone that it
    fits if it fits no other nearly as well, no other sighting fits that one better,
    and the frame has not shown it yet.

    Args:
        unclaimed: m sightings.
        there_m: (n, 2) the map's cones in the car frame of the solution.
        free: (n,) cones that the frame has not shown otherwise.
        sensor: how noise follows the range.

    Returns:
        Places (k,) of sightings, places (k,) of their cones, and d2 (k,).
    """
    m, n = len(unclaimed), len(there_m)
    if m == 0 or n == 0:
        none = np.zeros(0, dtype=np.int64)
        return none, none, np.zeros(0)
    seen = np.repeat(unclaimed.xy_m, n, axis=0)
    cone = np.tile(there_m, (m, 1))
    R = transport_covariance(
        np.repeat(unclaimed.reported_m2, n, axis=0), seen, cone, sensor
    )
    d2 = squared_mahalanobis(seen - cone, R).reshape(m, n)
    best = d2.argmin(axis=1)
    least = d2[np.arange(m), best]
    others = d2.copy()
    others[np.arange(m), best] = np.inf
    nearest = least <= np.where(free, d2.min(axis=0), -np.inf)[best]
    sure = nearest & (least <= FIT_D2) & (others.min(axis=1) - least >= LEAD_D2)
    index = np.flatnonzero(sure).astype(np.int64)
    return index, best[index].astype(np.int64), least[index]
