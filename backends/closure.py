"""Watching for the start line: when a loop closes, and on what grounds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from conegraph.backends.laps import Gate
from conegraph.backends.local_map import LocalMap
from conegraph.backends.pairing import ROLE_INDEX, FramePairer, Pairs
from conegraph.backends.relocalize import Relocaliser
from conegraph.backends.start_line import GateMatch, match_gate, sides, verify_closure
from conegraph.config import StartLineConfig
from conegraph.types import (
    Array,
    ConeMap,
    ConeObservations,
    IntArray,
    LoopClosure,
    SensorModel,
)

REVISITED = 3
"""Cones of an earlier visit to the gate that must match again to close a loop."""

AT_GATE_M = 15.0
"""How near to the start gate these and the car must be: other places are only passed
again."""

REVISIT_WINDOW_M = 15.0
"""Distance over which these are counted: they come into view one by one."""

RETRY_M = 2.0
"""Distance after a refused closure before the next is tried."""


@dataclass(frozen=True, slots=True)
class ClosureResult:
    """What the watch found in one frame.

    Attributes:
        events: closures to report.
        match: start cones that must correct the filter before all else, if any.
    """

    events: tuple[LoopClosure, ...] = ()
    match: GateMatch | None = None

    @property
    def accepted(self) -> bool:
        """Whether the frame closes a loop."""
        return any(event.accepted for event in self.events)


class ClosureWatch:
    """Decides in each frame whether the car has come back to the start.

    Mostly the drift over a lap is small and the cones of the start match like any
    others; that closes the loop. What counts is when a cone was last matched by a car
    at the gate: a sensor that sees across the track never loses sight of the start,
    and a loop closes even so. When the drift is too large for that, the start
    cones themselves are tried (thesis section 4.4.5), and trusted only if

    - the car has driven far enough,
    - two of them lie as far apart as two of the map's,
    - no other pose on the whole map explains as many of the frame's cones,
    - at least `min_agreement` of all cones then lie on the map,
    - the innovation is possible under the filter's own covariance,
    - and a search for the car on what was mapped a while ago finds this very pose.
    """

    def __init__(
        self, config: StartLineConfig, pairer: FramePairer, sensor: SensorModel
    ) -> None:
        """Start with no closure seen."""
        self._config = config
        self._pairer = pairer
        self._sensor = sensor
        self._closed_m = 0.0
        self._refused_m = -np.inf
        self._revisits: deque[float] = deque()
        self._visited_m: dict[int, float] = {}

    def check(
        self,
        map_: LocalMap,
        frame: ConeObservations,
        pairs: Pairs,
        gate: Gate,
        driven_m: float,
    ) -> ClosureResult:
        """Look at a frame and its ordinary pairing.

        Args:
            map_: cones and car.
            frame: the observations.
            pairs: which cones they matched.
            gate: the start gate.
            driven_m: the odometer.
        """
        returned = self._returned(map_, pairs, gate, driven_m)
        if driven_m - self._closed_m < self._config.min_closure_m:
            return ClosureResult()
        self._revisits.extend([driven_m] * returned)
        while self._revisits and driven_m - self._revisits[0] > REVISIT_WINDOW_M:
            self._revisits.popleft()
        if len(self._revisits) >= REVISITED:
            reason = f"{len(self._revisits)} cones of the last visit match"
            return ClosureResult((self._close(frame.stamp_s, driven_m, reason),))
        start = np.flatnonzero(
            self._pairer.roles(frame.class_prob) == ROLE_INDEX["start"]
        ).astype(np.int64)
        ordinary = pairs.matched.sum() > 0.5 * len(frame)
        if self._config.forced or len(start) < 2 or ordinary:
            return ClosureResult()
        return self._try_gate(map_, frame, start, driven_m)

    def _returned(
        self, map_: LocalMap, pairs: Pairs, gate: Gate, driven_m: float
    ) -> int:
        """Count the cones at the gate whose last visit is a lap away; note this one.

        A cone of a given map counts as visited long ago.
        """
        if not _comes_to(map_.filter.vehicle, gate):
            return 0
        slot = pairs.slot[pairs.matched & ~pairs.cluster.soft]
        places = map_.filter.landmarks_m[slot]
        slot = slot[np.linalg.norm(places - gate.middle_m, axis=1) < AT_GATE_M]
        book, row = map_.book, map_.row[slot]
        known = np.where(np.isfinite(book.last_seen_m[row]), driven_m, -np.inf)
        ids = book.id[row].tolist()
        visited = self._visited_m
        last_m = np.array([visited.get(i, m) for i, m in zip(ids, known, strict=True)])
        visited.update(dict.fromkeys(ids, driven_m))
        old = driven_m - last_m > self._config.min_closure_m
        return int((old & book.published[row]).sum())

    def _try_gate(
        self,
        map_: LocalMap,
        frame: ConeObservations,
        start: IntArray,
        driven_m: float,
    ) -> ClosureResult:
        if driven_m - self._refused_m < RETRY_M:
            return ClosureResult()
        map_.sync()
        book = map_.book
        known = np.flatnonzero(book.published)
        away = driven_m - book.last_seen_m[known] > self._config.min_closure_m
        role = self._pairer.roles(book.class_prob[known])
        candidates = np.flatnonzero(away & (role == ROLE_INDEX["start"]))
        if len(candidates) < 2:
            return ClosureResult()
        found = match_gate(frame.xy_m, start, book.xy_m[known], candidates)
        if not isinstance(found, str):
            held = np.full(len(book), -1)
            held[map_.row] = np.arange(len(map_.row))
            slot = held[known[found.slot]]
            found = GateMatch(found.row, slot, found.pose, found.agreement)
            before = map_.publish().subset(away)
            reason = self._doubt(map_, frame, found, before)
            if not reason:
                reason = (
                    f"{len(found.row)} start cones, "
                    f"{100 * found.agreement:.0f} % of the frame agrees"
                )
                event = self._close(frame.stamp_s, driven_m, reason)
                return ClosureResult((event,), found)
            found = reason
        self._refused_m = driven_m
        gone_m = driven_m - self._closed_m
        return ClosureResult((LoopClosure(frame.stamp_s, gone_m, False, found),))

    def _close(self, stamp_s: float, driven_m: float, reason: str) -> LoopClosure:
        gone_m, self._closed_m = driven_m - self._closed_m, driven_m
        self._revisits.clear()
        return LoopClosure(stamp_s, gone_m, True, reason)

    def _doubt(
        self,
        map_: LocalMap,
        frame: ConeObservations,
        match: GateMatch,
        before: ConeMap,
    ) -> str:
        """Return why a match is not trusted, empty if it is.

        Args:
            map_: cones and car.
            frame: the observations.
            match: what the start cones say.
            before: the map without what was seen since the start was left.
        """
        if match.agreement < self._config.min_agreement:
            return f"only {100 * match.agreement:.0f} % of the frame agrees"
        if (match.slot < 0).any():
            return "the start is farther away than any drift"
        try:
            seen = map_.filter.innovation(
                match.slot, frame.xy_m[match.row], frame.cov_m2[match.row], None
            )
        except np.linalg.LinAlgError:
            return "the pose is too uncertain to test it"
        if not seen.nis <= self._config.closure_d2 * len(match.row):
            return f"innovation d2 {seen.nis:.0f} is impossible for this drift"
        relocaliser = Relocaliser(before, self._sensor)
        lead = verify_closure(relocaliser, frame, match.pose)
        if not lead > relocaliser.config.margin:
            return "a search over the whole map does not find this place"
        return ""


def _comes_to(vehicle: Array, gate: Gate) -> bool:
    """Whether the car is at the gate and heads through it."""
    facing = np.cos(vehicle[2]) * gate.forward[0] + np.sin(vehicle[2]) * gate.forward[1]
    near = np.linalg.norm(vehicle[:2] - gate.middle_m) < AT_GATE_M
    return bool(near and facing > 0.5)


def forced_start_pairs(
    pairer: FramePairer, map_: LocalMap, frame: ConeObservations, pairs: Pairs
) -> Pairs:
    """Match the two start cones by side, whatever the distance (section 4.4.5).

    The nearest start cone left and right of the car is given to the start cone of
    the map on the same side of the start frame that is predicted nearest.
    """
    role = ROLE_INDEX["start"]
    seen = np.flatnonzero(pairer.roles(frame.class_prob) == role)
    book = map_.book
    mapped = np.flatnonzero(pairer.roles(book.class_prob[map_.row]) == role)
    if len(seen) < 2 or len(mapped) < 2:
        return pairs
    predicted = map_.filter.cones_in_car_frame()[mapped]
    world = map_.filter.landmarks_m[mapped]
    row, slot = [], []
    for here, there in zip(sides(frame.xy_m[seen]), sides(world), strict=True):
        if len(here) == 0 or len(there) == 0:
            return pairs
        gap = np.linalg.norm(predicted[there] - frame.xy_m[seen[here[0]]], axis=1)
        row.append(int(seen[here[0]]))
        slot.append(int(mapped[there[gap.argmin()]]))
    slots, update, birth = pairs.slot.copy(), pairs.update.copy(), pairs.birth.copy()
    slots[row], update[row], birth[row] = slot, True, False
    return replace(pairs, slot=slots, update=update, birth=birth)
