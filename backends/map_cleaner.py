"""Cones that turn out not to exist, to be one, or to mark the start line."""

from __future__ import annotations

import numpy as np

from conegraph.backends.laps import LapCounter
from conegraph.backends.local_map import LocalMap
from conegraph.backends.pairing import (
    ROLE_INDEX,
    FramePairer,
    Pairs,
)
from conegraph.config import Config
from conegraph.geometry import distances
from conegraph.types import (
    Array,
    ConeClass,
    ConeObservations,
    IntArray,
    Mask,
    SensorModel,
)

MERGE_EVERY = 10
"""Frames between searches for cones that were mapped twice."""

CROWDED_M = 25.0
"""Beyond this, cones hide each other too often for a missing one to mean much."""

EDGE_SHARE = 0.95
"""Share of the sensor's range up to which a cone's own past says what a miss means."""

BESIDE_M = 1.0
"""An ambiguous observation nearer than this may have been the cone."""

TRUST = 0.65
"""Share of a detection probability that is counted: misses come in runs."""


class MapCleaner:
    """Keeps a map true to what frames fail to show."""

    def __init__(
        self, config: Config, sensor: SensorModel, pairer: FramePairer
    ) -> None:
        """Start with no frame counted."""
        self._config = config
        self._sensor = sensor
        self._pairer = pairer
        self._frames = 0

    def missed(self, map_: LocalMap, frame: ConeObservations, pairs: Pairs) -> IntArray:
        """Weigh a frame's matches; return the slots of cones it speaks against.

        Those are the cones in view that no observation can have been.
        """
        config = self._config
        none = np.zeros(0, dtype=np.int64)
        known = config.association.method == "known"
        blind = self._sensor.detection_probability == 0.0
        if not config.landmarks.prune or known or blind:
            return none
        if len(pairs.visible) == 0 or not _speaks(pairs):
            return none
        cones = map_.filter.cones_in_car_frame()
        slot = pairs.visible
        reach_m = EDGE_SHARE * self._reach_m
        slot = slot[_in_view(cones[slot], self._sensor, reach_m)]
        matched = np.zeros(len(cones), dtype=bool)
        matched[pairs.slot[pairs.matched]] = True
        seen = matched[slot]
        unseen = slot[~seen]
        perhaps = _beside_ambiguous(cones[unseen], frame, pairs)
        self._weigh_places(map_, pairs, unseen, perhaps)
        missed = unseen[perhaps < 0]
        told = np.concatenate([slot[seen], missed])
        at_edge = self._at_edge(cones[told])
        map_.book.look_at_edge(map_.row[told[at_edge]], matched[told[at_edge]])
        return missed

    @property
    def _reach_m(self) -> float:
        return min(self._sensor.max_range_m, CROWDED_M)

    def _at_edge(self, xy: Array) -> Mask:
        """(k,) whether cones (k, 2) are beyond `view_share` of the reach, car frame."""
        inner_m = self._config.landmarks.view_share * self._reach_m
        beyond: Mask = np.hypot(xy[:, 0], xy[:, 1]) > inner_m
        return beyond

    def _weigh_places(
        self, map_: LocalMap, pairs: Pairs, slot: IntArray, perhaps: IntArray
    ) -> None:
        """Note how well cones stand where they are mapped.

        That is said by those that matched, and by those (slot) beside which an
        ambiguous observation (perhaps, -1 for none) was made.
        """
        sure = np.flatnonzero(pairs.matched & ~pairs.cluster.soft)
        row = np.concatenate([sure, perhaps[perhaps >= 0]])
        slots = np.concatenate([pairs.slot[sure], slot[perhaps >= 0]])
        map_.book.note_fit(map_.row[slots], pairs.d2[row])

    def clean(
        self, map_: LocalMap, missed: IntArray, laps: LapCounter
    ) -> tuple[tuple[tuple[int, int], ...], IntArray]:
        """Delete cones that are not there, unite twins, find the start gate.

        Returns:
            Pairs of ids (kept, gone) united, and the ids deleted.
        """
        if len(missed):
            self._miss(map_, missed)
        doomed = np.flatnonzero(map_.book.doomed()[map_.row]).astype(np.int64)
        deleted = map_.book.id[map_.row[doomed]]
        map_.remove(doomed)
        self._frames += 1
        merged: tuple[tuple[int, int], ...] = ()
        if self._frames % MERGE_EVERY == 0:
            known = self._config.association.method == "known"
            if self._config.landmarks.merge_d2 > 0.0 and not known:
                merged = map_.merge_twins()
            self._locate_gate(map_, laps)
        return merged, deleted

    def _miss(self, map_: LocalMap, slot: IntArray) -> None:
        """Count it against cones that a frame should have shown."""
        book, row = map_.book, map_.row[slot]
        assumed = self._config.landmarks.assumed_detection_probability
        reported = self._sensor.detection_probability
        inner = assumed if reported is None else min(assumed, TRUST * reported)
        edge = TRUST * book.chance_at_edge(row)
        at_edge = self._at_edge(map_.filter.cones_in_car_frame()[slot])
        book.miss(row, np.where(at_edge, edge, inner))

    def _locate_gate(self, map_: LocalMap, laps: LapCounter) -> None:
        """Tell the lap counter where the start cones are: the big ones, if any."""
        book = map_.book
        shown = book.published[map_.row]
        prob = book.class_prob[map_.row]
        xy = map_.filter.landmarks_m
        big = shown & (prob.argmax(axis=1) == ConeClass.BIG_ORANGE)
        start = shown & (self._pairer.roles(prob) == ROLE_INDEX["start"])
        laps.locate_gate(xy[big if big.sum() >= 2 else start])


def _speaks(pairs: Pairs) -> bool:
    """Whether so many cones matched that a missing one means something."""
    settled = pairs.matched | pairs.ambiguous
    return bool(pairs.matched.sum() >= 0.5 * max(1, settled.sum()))


def _in_view(xy: Array, sensor: SensorModel, reach_m: float) -> Mask:
    """(k,) whether cones (k, 2) lie well inside the sensor's view and reach."""
    range_m = np.hypot(xy[:, 0], xy[:, 1])
    bearing = np.abs(np.arctan2(xy[:, 1], xy[:, 0]))
    inside: Mask = (range_m < reach_m) & (range_m > sensor.min_range_m + 1.0)
    return inside & (bearing < sensor.half_fov_rad - 0.06)


def _beside_ambiguous(xy: Array, frame: ConeObservations, pairs: Pairs) -> IntArray:
    """(k,) the ambiguous observation within a metre of each cone (k, 2), -1 if none."""
    row = np.flatnonzero(pairs.ambiguous)
    if len(row) == 0:
        return np.full(len(xy), -1, dtype=np.int64)
    gap = distances(xy, frame.xy_m[row])
    near = gap.min(axis=1) <= BESIDE_M
    return np.where(near, row[gap.argmin(axis=1)], -1).astype(np.int64)
