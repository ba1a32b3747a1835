"""Second thoughts: sightings and loops tested again once later frames have spoken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.backends.journal import Entry
from conegraph.backends.sensor_noise import squared_mahalanobis
from conegraph.geometry import to_child
from conegraph.types import Array, Mask

REVIEW_AFTER_S = 1.0
"""A sighting is tested again when it is this old."""

SUSPECT_D2 = 27.6
"""A sighting farther off than this is taken back: one true one in a million is."""

LOOP_D2 = 25.0
"""A loop whose sightings end up farther off than this, at the median, is undone."""

LOOP_TEST_S = 2.0
"""How long after its closing a loop is tested for good."""

RETURN_S = 10.0
"""A cone not seen for so long has come back: seeing it closes a loop."""

LOOP_CONES = 4
"""Cones that must come back for a loop that no start line closed."""


def residual_d2(entry: Entry, pose: Array, cones_m: Array) -> Array:
    """(n,) ``z' R^-1 z`` of an entry's kept sightings against a solution.

    Args:
        entry: the frame.
        pose: (3,) its pose in the solution.
        cones_m: (n, 2) the cones of its kept sightings there.
    """
    z = entry.frame.xy_m[entry.kept] - to_child(pose, cones_m.reshape(-1, 2))
    R = entry.frame.cov_m2[entry.kept]
    return squared_mahalanobis(z, R)


@dataclass(slots=True)
class Loop:
    """A loop that was closed and waits for its test.

    Attributes:
        entries: frames since then that show cones which had come back.
        returned: these cones.
    """

    entries: list[Entry]
    returned: set[int]

    @property
    def stamp_s(self) -> float:
        """When it was closed."""
        return self.entries[0].frame.stamp_s

    @property
    def closed(self) -> bool:
        """Whether the start line closed it, or enough cones, that still count."""
        if any(e.frame.closure and e.kept.any() for e in self.entries):
            return True
        kept = {cone for e in self.entries for cone in e.cones.tolist()}
        return len(kept & self.returned) >= LOOP_CONES

    def sightings(self, entry: Entry) -> Mask:
        """(n,) which sightings of an entry belong to the loop."""
        back = np.isin(entry.frame.landmark_id, list(self.returned))
        return back & entry.kept


class LoopWatch:
    """Notices loops, by start line or by cones that come back, and when to test."""

    def __init__(self, known_map: bool) -> None:
        """Start with no loop; a given map needs none.

        Attributes:
            stands: whether a loop has stood its test.
        """
        self.stands = known_map
        self.open: Loop | None = None
        self._last_seen_s: dict[int, float] = {}

    def note(self, entry: Entry) -> None:
        """Look at the newest entry."""
        stamp_s = entry.frame.stamp_s
        ids = entry.frame.landmark_id.tolist()
        back = {
            cone
            for cone in ids
            if stamp_s - self._last_seen_s.get(cone, stamp_s) > RETURN_S
        }
        self._last_seen_s.update(dict.fromkeys(ids, stamp_s))
        if self.open is None and (back or entry.frame.closure):
            self.open = Loop([], set())
        if self.open is not None:
            self.open.returned |= back
            self.open.entries.append(entry)

    def ripe(self, now_s: float) -> Loop | None:
        """Return the loop whose test is due, and forget it."""
        loop = self.open
        if loop is None or now_s - loop.stamp_s < LOOP_TEST_S:
            return None
        self.open = None
        return loop
