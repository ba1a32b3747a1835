"""The gate at the start line, and the laps that end there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.config import StartLineConfig
from conegraph.types import Array, Lap

GATE_REACH_M = 30.0
"""Start cones farther than this from the start pose are not the start gate."""

AHEAD_M = 1.0
"""The gate of a track without start cones, so far ahead that standing is no lap."""

AWAY_M = 4.0
"""How far from the gate a lap leads at least; a lap of 30 m in a circle leads 9."""


@dataclass(frozen=True, slots=True)
class Gate:
    """A line on the ground: its middle (2,) and the unit vector (2,) through it."""

    middle_m: Array
    forward: Array


class LapCounter:
    """Counts crossings of the gate in driving direction and times the laps.

    Until start cones are known the gate stands just ahead of the start pose, across
    the first heading.
    """

    def __init__(self, config: StartLineConfig) -> None:
        """Start at the origin, heading along x, with no lap driven."""
        self._config = config
        self.gate = Gate(np.array([AHEAD_M, 0.0]), np.array([1.0, 0.0]))
        self.driven_m = 0.0
        self._crossed: tuple[float, float] | None = None
        self._previous: tuple[float, Array] | None = None
        self._laps = 0
        self._farthest_m = 0.0

    def locate_gate(self, start_cones_m: Array) -> None:
        """Put the gate between start cones (k, 2) on both sides of the start.

        Sides are told by the sign of y in the start frame (thesis section 5.1.1).
        Once a lap is timed the gate stays where it is.
        """
        if self._laps or len(start_cones_m) < 2:
            return
        near = start_cones_m[np.hypot(*start_cones_m.T) < GATE_REACH_M]
        left, right = near[near[:, 1] > 0], near[near[:, 1] <= 0]
        if len(left) == 0 or len(right) == 0:
            return
        across = left.mean(axis=0) - right.mean(axis=0)
        width = float(np.hypot(*across))
        if not 1.0 <= width <= 2.0 * self._config.half_width_m:
            return
        middle = 0.5 * (left.mean(axis=0) + right.mean(axis=0))
        self.gate = Gate(middle, np.array([across[1], -across[0]]) / width)

    @property
    def count(self) -> int:
        """How many laps are completed."""
        return self._laps

    def interrupt(self) -> None:
        """Forget the last pose: from it to the next no line is crossed."""
        self._previous = None

    def restart(self) -> None:
        """Forget every crossing: the car never drove where it was thought to be."""
        self._previous, self._crossed, self._farthest_m = None, None, 0.0

    def advance(self, stamp_s: float, pose: Array, moved_m: float) -> Lap | None:
        """Take the next pose; return the lap if the gate was crossed to end one.

        The crossing's time is interpolated between the two poses. A crossing
        counts when the car faces along the gate, passes within its half width and,
        since the last, has driven `min_lap_m` and been `AWAY_M` from the gate: the
        odometer of a car that stands on the line runs on with every tremble. The
        first crossing starts the clock.
        """
        self.driven_m += moved_m
        from_gate_m = float(np.linalg.norm(pose[:2] - self.gate.middle_m))
        self._farthest_m = max(self._farthest_m, from_gate_m)
        crossed_s = self._crossing(stamp_s, pose)
        self._previous = (stamp_s, pose.copy())
        if crossed_s is None:
            return None
        start, self._crossed = self._crossed, (crossed_s, self.driven_m)
        away, self._farthest_m = self._farthest_m > AWAY_M, from_gate_m
        if start is None:
            return None
        if not away or self.driven_m - start[1] < self._config.min_lap_m:
            # The gate moved ahead of the car after the start: time from here.
            self._crossed = start if self._laps else self._crossed
            return None
        self._laps += 1
        return Lap(self._laps, start[0], crossed_s)

    def _crossing(self, stamp_s: float, pose: Array) -> float | None:
        if self._previous is None:
            return None
        before_s, before = self._previous
        forward = self.gate.forward
        path = np.stack([before[:2], pose[:2]]) - self.gate.middle_m
        along = path @ forward
        if not along[0] < 0.0 <= along[1]:
            return None
        share = float(along[0] / (along[0] - along[1]))
        beside = path @ np.array([-forward[1], forward[0]])
        offset = abs(beside[0] + share * (beside[1] - beside[0]))
        facing = np.cos(pose[2]) * forward[0] + np.sin(pose[2]) * forward[1]
        if offset > self._config.half_width_m or facing < 0.5:
            return None
        return before_s + share * (stamp_s - before_s)
