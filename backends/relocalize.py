"""Finding the car in a cone map without knowing where it was.

Constellations of cones are recognised by geometry and colour: poses that lay two
seen cones on two of the map are scored, refined and weighed against each other and
against "none of them". The answer may be "I do not know", and where a track looks
the same in two places it is.

Tracks are built by the same rules: a straight, a start gate, an even bend fit many of
them. How well a place fits by such likeness alone is measured on a decoy, as in
target-decoy searches of spectra (Elias and Gygi, 2007): the map's mirror image is a
course of the same kind, and the car is not on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from conegraph.backends.cone_index import ConeIndex
from conegraph.backends.pose_candidates import candidate_poses
from conegraph.backends.pose_score import (
    MAP_SIGMA_M,
    ScoredPoses,
    coarse_score,
    refine,
)
from conegraph.backends.sightings import Sightings
from conegraph.geometry import between
from conegraph.types import (
    Array,
    ConeClass,
    ConeMap,
    ConeObservations,
    IntArray,
    Mask,
    SensorModel,
)

REFINED = 40
"""Candidates that are refined."""

LOOKED_AT = 8 * REFINED
"""Best candidates among which these are chosen, one a place."""

SAME_M, SAME_RAD = 1.0, 0.15
"""Poses nearer to each other than this are one hypothesis."""

GRID_M, GRID_RAD = 0.6, 0.1
"""Cells of which only the best candidate is refined."""

MOST_HYPOTHESES = 10

ALIKE = 0.5
"""A map of which a larger share lies on its own mirror image is symmetric."""

SHORT_SIGHTED_M = 20.0
"""A sensor that sees no farther than this makes shorter pairs."""


@dataclass(frozen=True, slots=True)
class RelocaliserConfig:
    """When the car counts as found.

    Attributes:
        accept_probability: least probability of the best hypothesis.
        min_inliers: least number of sightings that show a cone of the map.
        temperature: exponent on likelihoods: errors of sightings are not
            independent, and models not exact.
        chance_per_cone: log-likelihood of a cone that fits by chance: another track of
            the kind has lanes too.
        elsewhere: log of the odds that the car is on another track of the kind.
        max_misfit: largest squared Mahalanobis distance per degree of freedom of what
            fits: a place that is right fits to the noise, one alike does not.
        margin: log-likelihood by which a pose must lead to verify a closure.
    """

    accept_probability: float = 0.99
    min_inliers: int = 6
    temperature: float = 0.5
    chance_per_cone: float = 3.6
    elsewhere: float = -5.0
    max_misfit: float = 1.3
    margin: float = 6.0


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A pose that may be the car's.

    Attributes:
        pose: (3,) in the map's frame.
        cov: (3, 3) its covariance, if it is the right one.
        log_likelihood: over "all that is seen is clutter".
        probability: that it is the car's pose, rather than another or none.
        row: (k,) sightings that show a cone.
        cone: (k,) the cones' rows in the map.
    """

    pose: Array
    cov: Array
    log_likelihood: float
    probability: float
    row: IntArray
    cone: IntArray


@dataclass(frozen=True, slots=True)
class Relocalisation:
    """What a search found.

    Attributes:
        hypotheses: the best, most probable first.
        accepted: whether the first may be relied on.
        reason: why, or why not.
    """

    hypotheses: tuple[Hypothesis, ...] = ()
    accepted: bool = False
    reason: str = ""

    @property
    def best(self) -> Hypothesis | None:
        """The most probable hypothesis, None if there is none."""
        return self.hypotheses[0] if self.hypotheses else None

    @property
    def probability(self) -> float:
        """Probability of the best hypothesis, 0 without any."""
        return self.hypotheses[0].probability if self.hypotheses else 0.0

    @property
    def inliers(self) -> int:
        """Sightings that show a cone of the map, under the best hypothesis."""
        return len(self.hypotheses[0].row) if self.hypotheses else 0


@dataclass(frozen=True)
class Relocaliser:
    """A cone map prepared for being recognised; holds no state beside it.

    Attributes:
        cone_map: the map.
        sensor: what the sensor sees, for what it should have seen.
        config: when the car counts as found.
    """

    cone_map: ConeMap
    sensor: SensorModel
    config: RelocaliserConfig = RelocaliserConfig()

    @property
    def _pair_m(self) -> float:
        return 12.0 if self.sensor.max_range_m < SHORT_SIGHTED_M else 18.0

    @cached_property
    def _index(self) -> ConeIndex:
        return ConeIndex(self.cone_map, self._pair_m)

    @cached_property
    def _decoy(self) -> ConeIndex | None:
        """The mirror image of the map; None where map and image are the same course."""
        decoy = ConeIndex(mirror_image(self.cone_map), self._pair_m)
        modes = self._modes(decoy, Sightings.of_map(self.cone_map))
        if modes is not None:
            fitting = np.count_nonzero(modes.cone < decoy.n, axis=1)
            if fitting.max() > ALIKE * decoy.n:
                return None
        return decoy

    def locate(
        self, observations: ConeObservations | Sightings, *, on_map: bool = False
    ) -> Relocalisation:
        """Look for the car on the whole map.

        Args:
            observations: a frame, or the sightings of several.
            on_map: whether the car is known to be on this map, and not on another
                course of its kind; the decoy is then not asked.

        Returns:
            The hypotheses, with the probabilities ``P_k = L_k^T / (sum_j L_j^T +
            L_0^T)``, T the temperature and L_0 the likelihood that the car is on
            none and the cones of the best fit by chance. Where a pose would be
            accepted, the places of the decoy take part in the sum as well, with the
            odds `RelocaliserConfig.elsewhere`.
        """
        seen = observations
        if isinstance(seen, ConeObservations):
            seen = Sightings.of_frame(seen)
        if len(seen) < 2 or len(self.cone_map) < 2:
            return Relocalisation(reason="fewer than two cones")
        modes = self._modes(self._index, seen)
        if modes is None:
            return Relocalisation(reason="no two cones as far apart as the map's")
        found = self._judged(modes, None)
        if on_map or not found.accepted or self._decoy is None:
            return found
        return self._judged(modes, self._modes(self._decoy, seen))

    def _modes(self, index: ConeIndex, seen: Sightings) -> ScoredPoses | None:
        """Return the best poses on a map, one a place, most likely first."""
        log_colour = index.log_colour(seen.likelihood)
        poses = candidate_poses(index, seen, log_colour, MAP_SIGMA_M)
        if len(poses) == 0:
            return None
        score = coarse_score(index, seen, log_colour, poses)
        order = np.argsort(-score, kind="stable")[:LOOKED_AT]
        cell = np.round(poses[order] / [GRID_M, GRID_M, GRID_RAD]).astype(np.int64)
        _, first = np.unique(cell, axis=0, return_index=True)
        chosen = poses[order[np.sort(first)][:REFINED]]
        scored = refine(index, seen, log_colour, chosen, self.sensor)
        rows: list[int] = []
        for row in np.argsort(-scored.log_likelihood, kind="stable").tolist():
            if not same_place(scored.pose[row], scored.pose[rows]).any():
                rows.append(row)
            if len(rows) == MOST_HYPOTHESES:
                break
        return scored.take(np.array(rows, dtype=np.int64))

    def _judged(self, modes: ScoredPoses, decoys: ScoredPoses | None) -> Relocalisation:
        shows = modes.cone < len(self.cone_map)
        n, n_seen = int(shows[0].sum()), shows.shape[1]
        chance = self.config.chance_per_cone * n
        every = np.append(modes.log_likelihood, chance)
        if decoys is not None:
            there = decoys.log_likelihood + self.config.elsewhere
            every = np.append(every, there)
        weight = np.exp(self.config.temperature * (every - every.max()))
        probability = weight / weight.sum()
        found = []
        for i in range(len(modes.pose)):
            row = np.flatnonzero(shows[i]).astype(np.int64)
            found.append(
                Hypothesis(
                    modes.pose[i],
                    modes.cov[i],
                    float(modes.log_likelihood[i]),
                    float(probability[i]),
                    row,
                    modes.cone[i, row],
                )
            )
        sure, misfit = found[0].probability, float(modes.misfit[0])
        reason = (
            f"{n} of {n_seen} cones on the map, {misfit:.1f} times their noise, "
            f"probability {sure:.4f}"
        )
        accepted = (
            sure > self.config.accept_probability
            and n >= self.config.min_inliers
            and misfit <= self.config.max_misfit
        )
        return Relocalisation(tuple(found), accepted, reason)


def mirror_image(cone_map: ConeMap) -> ConeMap:
    """Return a map reflected in the x axis, its left cones become right ones."""
    flip = np.array([1.0, -1.0])
    prob = cone_map.class_prob.copy()
    sides = [ConeClass.BLUE, ConeClass.YELLOW]
    prob[:, sides] = prob[:, sides[::-1]]
    return replace(
        cone_map,
        xy_m=cone_map.xy_m * flip,
        cov_m2=cone_map.cov_m2 * np.outer(flip, flip),
        class_prob=prob,
    )


def same_place(pose: Array, others: Array) -> Mask:
    """(k,) which of the poses (k, 3) are within `SAME_M` and `SAME_RAD` of one (3,)."""
    gap = between(pose, others.reshape(-1, 3))
    near: Mask = np.hypot(gap[:, 0], gap[:, 1]) < SAME_M
    return near & (np.abs(gap[:, 2]) < SAME_RAD)
