"""The life of cones in a map: birth, sightings, colour, confirmation, death."""

from __future__ import annotations

import numpy as np

from conegraph.config import LandmarkConfig
from conegraph.geometry import distances
from conegraph.types import N_CLASSES, Array, ConeMap, IntArray, Mask

PRIOR = np.array([0.175, 0.175, 0.175, 0.175, 0.3])
"""Class of a cone that nobody looked at: the tie goes to unknown."""

LIKELIHOOD_FLOOR = 0.06
"""A detector that is sure is still wrong now and then, some in a row."""

CLASS_LOG_RANGE = 8.0
"""How far the classes' log-probabilities may part, so that they can be revised."""

EDGE_LOOKS = 5.0
"""Looks that the average of all cones is worth beside a cone's own."""

MISFIT_SHARE = 0.1
"""Weight of the newest sighting in the running mean of its misfit."""

MISFIT_LIMIT = 6.0
"""Mean d² of about twenty sightings at which a cone no longer stands where it is
mapped: that of two degrees of freedom is 2."""


class LandmarkBook:
    """What is known of each cone beside its position, one row a cone."""

    def __init__(self, config: LandmarkConfig) -> None:
        """Start empty."""
        self._config = config
        self._next_id = 0
        self.id: IntArray = np.zeros(0, dtype=np.int64)
        self.hits: IntArray = np.zeros(0, dtype=np.int64)
        self.log_odds: Array = np.zeros(0)
        self.last_seen_m: Array = np.zeros(0)
        self.truth_id: IntArray = np.zeros(0, dtype=np.int64)
        self.xy_m: Array = np.zeros((0, 2))
        self.cov_m2: Array = np.zeros((0, 2, 2))
        self._class_log: Array = np.zeros((0, N_CLASSES))
        self._looks: Array = np.zeros(0)
        self._glimpses: Array = np.zeros(0)
        self._misfit: Array = np.zeros(0)
        self._seen_together: set[tuple[int, int]] = set()

    def __len__(self) -> int:
        return len(self.id)

    @property
    def class_prob(self) -> Array:
        """(M, 5) posterior of the classes."""
        return _posterior(self._class_log)

    def class_prob_of(self, row: IntArray) -> Array:
        """(k, 5) posterior of the classes of the cones in the rows (k,)."""
        return _posterior(self._class_log[row])

    @property
    def published(self) -> Mask:
        """(M,) whether each is sure enough for the map that others see."""
        c = self._config
        return (self.hits >= c.publish_hits) & (self.log_odds >= c.publish_log_odds)

    def add(self, class_prob: Array, driven_m: float, truth_id: IntArray) -> IntArray:
        """Append cones seen for the first time (k, 5); return their rows (k,)."""
        k = len(class_prob)
        rows = self.append(self._next_id + np.arange(k), driven_m, truth_id)
        self._class_log[rows] += _log_likelihood(class_prob)
        return rows

    def append(self, ids: IntArray, driven_m: float, truth_id: IntArray) -> IntArray:
        """Append rows (k,) for cones with the given ids, as seen once; return rows."""
        k, m = len(ids), len(self.id)
        self._next_id = max(self._next_id, int(ids.max(initial=-1)) + 1)
        self.id = np.concatenate([self.id, ids])
        self.hits = np.concatenate([self.hits, np.ones(k, dtype=np.int64)])
        self.log_odds = np.concatenate([self.log_odds, np.zeros(k)])
        self.last_seen_m = np.concatenate([self.last_seen_m, np.full(k, driven_m)])
        self.truth_id = np.concatenate([self.truth_id, truth_id])
        self.xy_m = np.concatenate([self.xy_m, np.zeros((k, 2))])
        self.cov_m2 = np.concatenate([self.cov_m2, np.zeros((k, 2, 2))])
        self._looks = np.concatenate([self._looks, np.zeros(k)])
        self._glimpses = np.concatenate([self._glimpses, np.zeros(k)])
        self._misfit = np.concatenate([self._misfit, np.full(k, 2.0)])
        prior = np.tile(np.log(PRIOR), (k, 1))
        self._class_log = np.concatenate([self._class_log, prior])
        return np.arange(m, m + k, dtype=np.int64)

    def append_known(self, known: ConeMap) -> IntArray:
        """Append the cones of a given map as long confirmed; return their rows."""
        nobody = np.full(len(known), -1, dtype=np.int64)
        rows = self.append(known.id, -np.inf, nobody)
        self.hits[rows] = np.maximum(known.observations, self._config.publish_hits)
        self.log_odds[rows] = self._config.max_log_odds
        self.xy_m[rows], self.cov_m2[rows] = known.xy_m, known.cov_m2
        logs = np.log(np.maximum(known.class_prob, np.exp(-CLASS_LOG_RANGE)))
        self._class_log[rows] = logs
        return rows

    def hit(
        self,
        row: IntArray,
        class_prob: Array,
        driven_m: float,
        evidence: Array | float = 1.0,
    ) -> None:
        """Record sightings of the cones in the rows (k,).

        One that the detector is not sure of says less of whether there is a cone: it
        counts with its ``evidence`` (k,), 0 to 1.
        """
        c = self._config
        np.add.at(self.hits, row, 1)
        raised = self.log_odds[row] + evidence * c.hit_log_odds
        self.log_odds[row] = np.minimum(raised, c.max_log_odds)
        self.last_seen_m[row] = driven_m
        logs = self._class_log[row] + _log_likelihood(class_prob)
        top = logs.max(axis=1, keepdims=True)
        self._class_log[row] = np.maximum(logs - top, -CLASS_LOG_RANGE)

    def miss(self, row: IntArray, detection_probability: Array | float) -> None:
        """Record that cones should have been seen, with a chance each, and were not."""
        self.log_odds[row] += np.log1p(-detection_probability)

    def look_at_edge(self, row: IntArray, seen: Mask) -> None:
        """Record which cones (k,) at the edge of the view were seen."""
        self._looks[row] += 1.0
        self._glimpses[row] += seen

    def chance_at_edge(self, row: IntArray) -> Array:
        """(k,) how often each cone shows at the edge of the view.

        Some stand where others hide them, so each is judged by its own past, and
        by that of all until it has one.
        """
        overall = (self._glimpses.sum() + 1.0) / (self._looks.sum() + 2.0)
        shown = self._glimpses[row] + EDGE_LOOKS * overall
        chance: Array = shown / (self._looks[row] + EDGE_LOOKS)
        return chance

    def note_fit(self, row: IntArray, d2: Array) -> None:
        """Record how far, as d² (k,), cones were seen from where they are mapped."""
        self._misfit[row] += MISFIT_SHARE * (d2 - self._misfit[row])

    def doomed(self) -> Mask:
        """(M,) cones whose existence, or place, is no longer believed."""
        c = self._config
        young = self.hits < c.publish_hits
        limit = np.where(young, c.young_delete_log_odds, c.delete_log_odds)
        return (self.log_odds < limit) | (self._misfit > MISFIT_LIMIT)

    def keep(self, mask: Mask) -> None:
        """Drop the rows whose mask (M,) is False."""
        self.id, self.hits = self.id[mask], self.hits[mask]
        self.log_odds, self.truth_id = self.log_odds[mask], self.truth_id[mask]
        self.last_seen_m = self.last_seen_m[mask]
        self.xy_m, self.cov_m2 = self.xy_m[mask], self.cov_m2[mask]
        self._class_log = self._class_log[mask]
        self._looks, self._glimpses = self._looks[mask], self._glimpses[mask]
        self._misfit = self._misfit[mask]

    def absorb(self, kept: int, gone: int) -> None:
        """Give a cone the history of another that turned out to be the same."""
        self.hits[kept] += self.hits[gone]
        self.log_odds[kept] = max(self.log_odds[kept], self.log_odds[gone])
        self.truth_id[kept] = max(self.truth_id[kept], self.truth_id[gone])
        self.last_seen_m[kept] = max(self.last_seen_m[kept], self.last_seen_m[gone])
        logs = self._class_log[kept] + self._class_log[gone] - np.log(PRIOR)
        self._class_log[kept] = np.maximum(logs - logs.max(), -CLASS_LOG_RANGE)
        stays, goes = int(self.id[kept]), int(self.id[gone])
        for a, b in [pair for pair in self._seen_together if goes in pair]:
            other = a if b == goes else b
            self._seen_together.add((min(stays, other), max(stays, other)))

    def note_together(self, row: IntArray, xy_m: Array, within_m: float) -> None:
        """Remember which near cones were seen in one frame: they are two."""
        i, j = np.nonzero(distances(xy_m, xy_m) < within_m)
        i, j = i[i < j], j[i < j]
        ids = self.id[row]
        for a, b in zip(ids[i].tolist(), ids[j].tolist(), strict=True):
            self._seen_together.add((min(a, b), max(a, b)))

    def seen_together(self, first: int, second: int) -> bool:
        """Whether the cones in two rows were ever seen in one frame."""
        a, b = int(self.id[first]), int(self.id[second])
        return (min(a, b), max(a, b)) in self._seen_together


def class_likelihood(class_prob: Array) -> Array:
    """Return p(report | class), (n, 5) up to a factor, of reports (n, 5).

    Under a colour c it is ``p_c + p_unknown / 4``; under "unknown" every colour is
    as likely as another, so it is a quarter of the whole.
    """
    likelihood: Array = class_prob + 0.25 * class_prob[:, N_CLASSES - 1 :]
    likelihood[:, N_CLASSES - 1] = 0.25 * class_prob.sum(axis=1)
    return likelihood


def _posterior(class_log: Array) -> Array:
    """Return probabilities (n, 5) from their logarithms, known up to a constant."""
    p = np.exp(class_log - class_log.max(axis=1, keepdims=True))
    posterior: Array = p / p.sum(axis=1, keepdims=True)
    return posterior


def _log_likelihood(class_prob: Array) -> Array:
    """Return log p(report | class), (n, 5), never quite sure."""
    logs: Array = np.log(np.maximum(class_likelihood(class_prob), LIKELIHOOD_FLOOR))
    return logs
