"""Cones that turn out not to exist, to be one, or to mark the start line."""

from __future__ import annotations

import numpy as np

from conegraph.backends.laps import LapCounter
from conegraph.backends.local_map import LocalMap
from conegraph.backends.pairing import ROLE_INDEX, FramePairer, Pairs, overdue
from conegraph.config import Config
from conegraph.types import ConeClass, ConeObservations, IntArray, SensorModel

MERGE_EVERY = 10
"""Frames between searches for cones that were mapped twice."""


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
        """Slots of cones that this frame speaks against."""
        config = self._config.landmarks
        if not config.prune or self._config.association.method == "known":
            return np.zeros(0, dtype=np.int64)
        return overdue(map_, self._sensor, frame, pairs, config.view_share)

    def clean(
        self, map_: LocalMap, missed: IntArray, laps: LapCounter
    ) -> tuple[tuple[int, int], ...]:
        """Delete cones that are not there, unite twins, find the start gate.

        Returns:
            Pairs of ids (kept, gone) united.
        """
        book = map_.book
        assumed = self._config.landmarks.assumed_detection_probability
        reported = self._sensor.detection_probability
        chance = assumed if reported is None else min(assumed, 0.65 * reported)
        book.miss(map_.row[missed], chance)
        doomed = missed[book.doomed()[map_.row[missed]]]
        map_.remove(doomed)
        self._frames += 1
        merged: tuple[tuple[int, int], ...] = ()
        if self._frames % MERGE_EVERY == 0:
            known = self._config.association.method == "known"
            if self._config.landmarks.merge_d2 > 0.0 and not known:
                merged = map_.merge_twins()
            self._locate_gate(map_, laps)
        return merged

    def _locate_gate(self, map_: LocalMap, laps: LapCounter) -> None:
        """Tell the lap counter where the start cones are: the big ones, if any."""
        book = map_.book
        shown = book.published[map_.row]
        prob = book.class_prob[map_.row]
        xy = map_.filter.landmarks_m
        big = shown & (prob.argmax(axis=1) == ConeClass.BIG_ORANGE)
        start = shown & (self._pairer.roles(prob) == ROLE_INDEX["start"])
        laps.locate_gate(xy[big if big.sum() >= 2 else start])
