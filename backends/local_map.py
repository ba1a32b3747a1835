"""The cones that the filter holds, and the book that knows them all."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from conegraph.backends.landmark_filter import LandmarkFilter
from conegraph.backends.landmarks import LandmarkBook
from conegraph.backends.motion import yaw_rate_bias_sigma
from conegraph.backends.sensor_noise import squared_mahalanobis
from conegraph.config import Config, LandmarkConfig
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    IntArray,
    SensorModel,
)

TOGETHER_M = 2.5
"""Cones nearer than this are remembered as two when one frame shows both."""

TWIN_M = 2.0
"""Cones farther apart than this are never taken for one."""

FETCHED_M = 0.3
"""Doubt about a cone that comes back into the filter without the graph's word."""

TWIN_SIGMA_M = 0.003
"""How exactly two rows that are one cone must coincide."""


class LocalMap:
    """A filter's cones and their book entries, kept in step.

    A slot is a place in the filter, a row one in the book; `row` maps the first
    to the second. The EKF's filter holds every row, the graph's tracker some.
    """

    def __init__(self, config: Config) -> None:
        """Start at the origin with no cones."""
        self.filter = LandmarkFilter(
            yaw_rate_bias_sigma(config.motion),
            config.motion.start_speed_sigma_mps,
            invariant=config.backend.invariant,
        )
        self.book = LandmarkBook(config.landmarks)
        self.row: IntArray = np.zeros(0, dtype=np.int64)
        self._config: LandmarkConfig = config.landmarks

    def start_from(self, known: ConeMap) -> None:
        """Fill an empty map with known cones, independent of the car."""
        self.row = self.book.append_known(known)
        self.filter.place_cones(known.xy_m, known.cov_m2)

    def visible(self, sensor: SensorModel) -> IntArray:
        """Slots of the cones that the sensor could report, with a margin."""
        xy = self.filter.cones_in_car_frame()
        range_m = np.hypot(xy[:, 0], xy[:, 1])
        beyond = np.abs(np.arctan2(xy[:, 1], xy[:, 0])) - sensor.half_fov_rad
        outside_m = range_m * np.sin(np.clip(beyond, 0.0, 0.5 * np.pi))
        inside = (range_m < sensor.max_range_m + 3.0) & (
            (beyond < 0.15) | (outside_m < TOGETHER_M)
        )
        return np.flatnonzero(inside).astype(np.int64)

    def add(self, frame: ConeObservations, driven_m: float) -> IntArray:
        """Add the cones of a frame as new; return their slots."""
        if len(frame) == 0:
            return np.zeros(0, dtype=np.int64)
        nobody = np.full(len(frame), -1, dtype=np.int64)
        truth = nobody if frame.truth_id is None else frame.truth_id
        rows = self.book.add(frame.class_prob, driven_m, truth)
        self.row = np.concatenate([self.row, rows])
        return self.filter.add_cones(frame.xy_m, frame.cov_m2)

    def remove(self, slot: IntArray) -> None:
        """Forget the cones in the slots altogether."""
        if len(slot) == 0:
            return
        keep_slot = np.ones(len(self.row), dtype=bool)
        keep_slot[slot] = False
        keep_row = np.ones(len(self.book), dtype=bool)
        keep_row[self.row[slot]] = False
        new_row = np.cumsum(keep_row) - 1
        self.filter.keep(keep_slot)
        self.book.keep(keep_row)
        self.row = new_row[self.row[keep_slot]].astype(np.int64)

    def load(
        self, state: Array, cov: Array, ids: IntArray, all_ids: IntArray, all_m: Array
    ) -> None:
        """Let the filter hold these cones, and tell the book where all cones are.

        Cones that the book has given up are left out.

        Args:
            state: (6 + 2 n,) the car and n cones.
            cov: covariance of these.
            ids: (n,) the cones' ids.
            all_ids: (m,) ids of every cone.
            all_m: (m, 2) their positions.
        """
        self.sync()
        row = _places(self.book.id, all_ids)
        self.book.xy_m[row[row >= 0]] = all_m[row >= 0]
        near = _places(self.book.id, ids)
        self.row = near[near >= 0]
        self.filter.load(state, cov)
        self.filter.keep(near >= 0)

    def slots_of(self, ids: IntArray) -> IntArray:
        """(k,) slots of the cones with the given ids, -1 where the filter has none."""
        return _places(self.book.id[self.row], ids)

    def add_again(self, ids: IntArray, xy_m: Array, cov_m2: Array) -> None:
        """Let the filter hold cones of the book as just seen, (k, 2) car frame."""
        if len(ids):
            self.row = np.concatenate([self.row, _places(self.book.id, ids)])
            self.filter.add_cones(xy_m, cov_m2)

    def fetch(self, radius_m: float) -> None:
        """Let the filter hold all cones of the book around the car.

        Those that it lacks come with what was last known of them and `FETCHED_M`:
        what ties them to the cones here is known to the graph alone.
        """
        gap = np.linalg.norm(self.book.xy_m - self.filter.vehicle[:2], axis=1)
        lacking = gap < radius_m
        lacking[self.row] = False
        rows = np.flatnonzero(lacking)
        if len(rows):
            cov = self.book.cov_m2[rows] + np.eye(2) * FETCHED_M**2
            self.filter.place_cones(self.book.xy_m[rows], cov)
            self.row = np.concatenate([self.row, rows]).astype(np.int64)

    def release(self) -> None:
        """Let the filter hold no cone any more; the book keeps them all."""
        self.sync()
        self.filter.keep(np.zeros(len(self.row), dtype=bool))
        self.row = self.row[:0]

    def sync(self) -> None:
        """Copy positions and covariances from the filter into the book."""
        self.book.xy_m[self.row] = self.filter.landmarks_m
        self.book.cov_m2[self.row] = self.filter.landmark_covs()

    def merge_twins(self) -> tuple[tuple[int, int], ...]:
        """Unite cones that lie on each other and were never seen in one frame.

        A pair is one cone when ``d' S^-1 d <= merge_d2`` for its difference d with
        covariance S, S itself is small, and neither has a second candidate.

        Returns:
            Pairs of ids (kept, gone).
        """
        xy = self.filter.landmarks_m
        if len(xy) == 0:
            return ()
        near = cKDTree(xy).query_pairs(TWIN_M, output_type="ndarray")
        i, j = near[np.lexsort((near[:, 1], near[:, 0]))].T
        apart = [
            not self.book.seen_together(a, b)
            for a, b in zip(self.row[i].tolist(), self.row[j].tolist(), strict=True)
        ]
        i, j = i[apart].astype(np.int64), j[apart].astype(np.int64)
        if len(i) == 0:
            return ()
        difference, cov = self.filter.separation(i, j)
        cov = cov + np.eye(2) * TWIN_SIGMA_M**2
        d2 = squared_mahalanobis(difference, cov)
        same = (d2 <= self._config.merge_d2) & (np.trace(cov, axis1=1, axis2=2) < 1.0)
        i, j = i[same], j[same]
        counts = np.bincount(np.concatenate([i, j]), minlength=len(xy))
        single = (counts[i] == 1) & (counts[j] == 1)
        merged = []
        for a, b in zip(i[single].tolist(), j[single].tolist(), strict=True):
            kept, gone = (a, b) if self._age(a) <= self._age(b) else (b, a)
            try:
                self.filter.equate(kept, gone, TWIN_SIGMA_M)
            except np.linalg.LinAlgError:
                continue  # Too uncertain to be compared.
            self.book.absorb(int(self.row[kept]), int(self.row[gone]))
            merged.append((kept, gone))
        ids = tuple((self._age(kept), self._age(gone)) for kept, gone in merged)
        self.remove(np.array([gone for _, gone in merged], dtype=np.int64))
        return ids

    def _age(self, slot: int) -> int:
        return int(self.book.id[self.row[slot]])

    def publish(self) -> ConeMap:
        """Return the confirmed cones of the whole book."""
        self.sync()
        book = self.book
        shown = book.published
        return ConeMap(
            book.id[shown],
            book.xy_m[shown],
            book.cov_m2[shown],
            book.class_prob[shown],
            book.hits[shown],
        )


def _places(held: IntArray, ids: IntArray) -> IntArray:
    """(k,) where each id stands among those held (n,), -1 where it does not."""
    order = np.argsort(held)
    place = np.append(order, -1)[np.searchsorted(held, ids, sorter=order)]
    found = place >= 0
    found[found] = held[place[found]] == ids[found]
    return np.where(found, place, -1).astype(np.int64)
