"""From a frame and a map to who is who: candidates, colours, rescue, births."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from conegraph.backends.association import associate, is_careful
from conegraph.backends.clusters import CLUSTER_M
from conegraph.backends.landmark_filter import PredictedCones
from conegraph.backends.landmarks import LandmarkBook
from conegraph.backends.local_map import LocalMap
from conegraph.backends.pairing_problem import (
    ClusterVerdict,
    Pairing,
    Problem,
    colour_cost,
    largest_sigma,
)
from conegraph.backends.sensor_noise import polar_sigmas
from conegraph.config import Config
from conegraph.geometry import distances
from conegraph.types import (
    CLASS_LABELS,
    Array,
    ConeObservations,
    IntArray,
    Mask,
    SensorModel,
)

KNOWN_AREA_M = 2.5
"""An observation nearer than this to a mapped cone lies where the map is known."""

LATELY_M = 5.0
"""A cone seen within so much of the way before the newest sighting is followed."""

CROWDED = 0.25
"""Share of the cones in view that stand in clusters where any may have a neighbour."""

FEW_MATCHES = 0.7
"""Below this share of the known area's cones a pairing is tried again."""

LOOSE_M = 0.5
"""Sigma of a predicted place, beside that of one measurement, that is too vague."""

MEMORY = 20
"""How many cones that came into view are remembered."""

RESCUE = 24.0
"""Factor on the process noise that a second try adds to the car."""

MAX_DOUBLINGS = 8
"""How often that factor doubles at most."""

ROLE_INDEX = {"left": 0, "right": 1, "start": 2, "none": 3}


@dataclass(frozen=True, slots=True)
class Pairs:
    """One frame's cones and the map's.

    Attributes:
        slot: (m,) the matched cone's slot, -1 where there is none.
        d2: (m,) squared Mahalanobis distance to the match or the nearest cone.
        birth: (m,) whether a new cone should be made of it.
        ambiguous: (m,) unmatched, yet too near to a known cone to be new.
        update: (m,) matches that are still to correct the filter.
        visible: slots of the cones whose places are known and were looked at.
        n_known: observations that lie where the map has cones.
        vague: (m,) matches with cones whose predicted places were vague.
        cluster: matches that may be a neighbour, and births beside one.
    """

    slot: IntArray
    d2: Array
    birth: Mask
    ambiguous: Mask
    update: Mask
    visible: IntArray
    n_known: int
    vague: Mask
    cluster: ClusterVerdict

    @property
    def matched(self) -> Mask:
        """(m,) whether each observation has a cone."""
        return self.slot >= 0

    def with_used(self, row: IntArray, slot: IntArray) -> Pairs:
        """Return these pairs with some fixed that have corrected the filter."""
        slots, update, birth = self.slot.copy(), self.update.copy(), self.birth.copy()
        vague = self.vague.copy()
        slots[np.isin(slots, slot)] = -1
        slots[row], update[row], birth[row], vague[row] = slot, False, False, True
        return replace(self, slot=slots, update=update, birth=birth, vague=vague)


class FramePairer:
    """Pairs frames with a map.

    It remembers how many frames in a row failed, and which of the cones that came
    into view lately were new: where all are known, nothing speaks for a new one.
    """

    def __init__(self, config: Config, sensor: SensorModel) -> None:
        """Take methods and gates from the configuration."""
        self._config = config
        self._sensor = sensor
        roles = config.roles.model_dump()
        self._failures = 0
        self._seen = 0.0
        self._appearances: deque[bool] = deque([True] * MEMORY, maxlen=MEMORY)
        self._role = np.array([ROLE_INDEX[roles[label]] for label in CLASS_LABELS])

    def roles(self, class_prob: Array) -> IntArray:
        """(N,) role of the most probable class: left 0, right 1, start 2, none 3."""
        role: IntArray = self._role[class_prob.argmax(axis=1)].astype(np.int64)
        return role

    def pair(self, map_: LocalMap, frame: ConeObservations, noise: Array) -> Pairs:
        """Pair a frame's cones with the map's.

        If fewer than `FEW_MATCHES` of the cones in the known area match, the car
        may have moved more than its model allows: with `noise` (6, 6), the process
        noise since the last match, added `RESCUE` times, doubled for every frame in
        a row that failed, the pairing is tried again. It is kept if at least two more
        match, and then so is the added noise.
        """
        if len(frame):
            self._seen += (len(frame) - self._seen) / MEMORY
        visible = self._candidates(map_, frame)
        predicted = map_.filter.predict_cones(visible)
        limit = self._loose_limit(predicted.xy_m)
        first = self._associate(map_, frame, predicted, limit)
        gap = distances(frame.xy_m, predicted.xy_m)
        gap[:, first.loose] = np.inf
        known = gap.min(axis=1, initial=np.inf) < KNOWN_AREA_M
        n_known = int(known.sum())
        hits = int((first.matched & known).sum())
        enough = n_known >= 3
        checked = is_careful(self._config.association)
        if checked and enough and hits < FEW_MATCHES * n_known:
            doubt = RESCUE * 2.0 ** min(self._failures, MAX_DOUBLINGS) * noise
            map_.filter.inflate(doubt)
            doubtful = map_.filter.predict_cones(visible)
            again = self._associate(map_, frame, doubtful, limit)
            better = int((again.matched & known).sum())
            if better > hits + 1:
                first, hits = again, better
            else:
                map_.filter.inflate(-doubt)
        if enough:
            failed = hits < 0.5 * n_known
            self._failures = self._failures + 1 if failed else 0
        pairs = self._decide(first, predicted, limit, n_known, hits)
        if frame.truth_id is not None and self._knows_ids(frame):
            unseen = ~np.isin(frame.truth_id, map_.book.truth_id)
            return replace(pairs, birth=unseen & (frame.truth_id >= 0))
        return pairs

    def _candidates(self, map_: LocalMap, frame: ConeObservations) -> IntArray:
        """Slots of the cones in view; with true ids, of those that were seen."""
        if frame.truth_id is not None and self._knows_ids(frame):
            seen = np.isin(map_.book.truth_id[map_.row], frame.truth_id)
            return np.flatnonzero(seen).astype(np.int64)
        return map_.visible(self._sensor)

    def _knows_ids(self, frame: ConeObservations) -> bool:
        method = self._config.association.method
        return method == "known" and frame.truth_id is not None

    def _associate(
        self,
        map_: LocalMap,
        frame: ConeObservations,
        predicted: PredictedCones,
        loose_m: Array,
    ) -> Pairing:
        config = self._config.association
        row = map_.row[predicted.slot]
        mapped = map_.book.class_prob_of(row)
        cost = np.zeros((len(frame), len(row)))
        allowed = np.ones(cost.shape, dtype=bool)
        if frame.truth_id is not None and self._knows_ids(frame):
            ids = map_.book.truth_id[row]
            allowed = (frame.truth_id[:, None] == ids) & (ids >= 0)
        elif config.colour == "same_role":
            allowed = self.roles(frame.class_prob)[:, None] == self.roles(mapped)
        else:
            cost = config.colour_weight * colour_cost(frame.class_prob, mapped)
        return associate(
            config,
            Problem(
                frame.xy_m,
                frame.cov_m2,
                predicted,
                cost,
                allowed,
                loose_m,
                self._new_cost(),
                self._margin(map_.book, row, predicted.xy_m),
            ),
        )

    def _loose_limit(self, xy_m: Array) -> Array:
        """(k,) sigma beyond which a cone's predicted place is too vague to match.

        A cone just born is as vague as one measurement; cones stand metres apart.
        """
        along, across = polar_sigmas(np.hypot(*xy_m.T), self._sensor)
        return LOOSE_M + 1.5 * np.maximum(along, across)

    def _new_cost(self) -> float:
        """Return ``-2 log(2 pi lambda)``: what a new cone costs beside a match.

        lambda is the density of new cones: of those that one frame shows in the
        sensor's view, times the share of new ones among the cones that lately came
        into view.
        """
        s = self._sensor
        area_m2 = s.half_fov_rad * (s.max_range_m**2 - s.min_range_m**2)
        share = (sum(self._appearances) + 0.5) / (MEMORY + 1.0)
        density = (self._seen + 0.5) / max(area_m2, 1.0) * share
        return float(-2.0 * np.log(2.0 * np.pi * density))

    def _margin(self, book: LandmarkBook, row: IntArray, xy_m: Array) -> Array:
        """Return by how much a match with each cone (k,) must beat "a new cone".

        A margin cuts off the tail of the errors of what is matched, the more the less
        precise it is. The rest says more than it should, and draws map and car to
        where they were believed to be. So a cone that is being followed
        asks none. One that comes back does, for it may close a loop, and so does any
        where cones stand in clusters: there the next may well be a new one.

        Args:
            book: what is known of the cones.
            row: (k,) the rows of those in view.
            xy_m: (k, 2) where they are predicted.
        """
        margin = np.full(len(row), self._config.association.new_margin)
        # Each is near itself.
        crowded = (distances(xy_m, xy_m) < CLUSTER_M).sum(axis=1) > 1
        if crowded.sum() <= CROWDED * len(row):
            newest_m = book.last_seen_m.max(initial=0.0)
            margin[book.last_seen_m[row] >= newest_m - LATELY_M] = 0.0
        return margin

    def note_appearances(self, n_new: int, n_returned: int) -> None:
        """Remember that so many new cones, and so many old ones, came into view."""
        self._appearances.extend([True] * n_new + [False] * n_returned)

    def _decide(
        self,
        pairing: Pairing,
        predicted: PredictedCones,
        loose_m: Array,
        n_known: int,
        hits: int,
    ) -> Pairs:
        """Choose what is born: nothing near a known cone, nothing while confused.

        Beside a cone that another observation of the frame matched, the gate
        suffices: one frame does not show one cone twice.
        """
        config = self._config.association
        visible = predicted.slot
        slot = pairing.column.copy()
        vague = np.zeros(len(slot), dtype=bool)
        if len(visible):
            loose = largest_sigma(predicted.cov_m2) > loose_m
            slot = np.where(pairing.matched, visible[pairing.column], -1)
            vague = pairing.matched & loose[pairing.column]
        free = ~pairing.matched
        birth = free & (pairing.free_d2 > config.no_birth_d2)
        birth &= pairing.d2 > config.gate_d2
        cluster = pairing.cluster or ClusterVerdict.none(len(slot))
        birth |= free & cluster.beside & (pairing.free_d2 > config.no_birth_d2)
        ambiguous = free & ~birth
        confused = n_known >= 2 and hits < 0.5 * n_known
        if confused and is_careful(config):
            birth = np.zeros_like(birth)
        return Pairs(
            slot.astype(np.int64),
            pairing.d2,
            birth,
            ambiguous,
            pairing.matched.copy(),
            visible[~pairing.loose],
            n_known,
            vague,
            cluster,
        )
