"""Whether the estimate can be trusted: INIT, OK, DEGRADED or LOST, and why."""

from __future__ import annotations

from conegraph.config import StatusConfig
from conegraph.types import Status

MEMORY_S = 0.5
"""Time constant over which the share of matched cones is averaged."""


class HealthMonitor:
    """Watches how many cones match and whether odometry comes."""

    def __init__(self, config: StatusConfig) -> None:
        """Start in INIT."""
        self._config = config
        self._frames = 0
        self._share = 1.0
        self._last_s: float | None = None
        self._last_match_s: float | None = None

    def frame(self, stamp_s: float, n_matched: int, n_known_area: int) -> None:
        """Take one frame: cones matched, of those seen where the map has cones."""
        dt = 0.0 if self._last_s is None else stamp_s - self._last_s
        self._last_s = stamp_s
        if self._last_match_s is None or n_matched:
            self._last_match_s = stamp_s
        if n_matched:
            self._frames += 1
        if n_known_area:
            weight = min(1.0, max(dt, 0.02) / MEMORY_S)
            self._share += weight * (n_matched / n_known_area - self._share)

    def judge(self, stamp_s: float, odometry_s: float) -> tuple[Status, str]:
        """Return the status at a stamp, given the newest odometry's stamp."""
        c = self._config
        if self._frames < c.init_frames:
            return Status.INIT, f"{self._frames} frames with matched cones so far"
        last_s = stamp_s if self._last_match_s is None else self._last_match_s
        silent_s = stamp_s - last_s
        has_odometry = stamp_s - odometry_s <= c.degraded_after_s
        if silent_s > c.lost_after_s and not has_odometry:
            return Status.LOST, f"no cone matched for {silent_s:.1f} s, no odometry"
        if silent_s > c.degraded_after_s:
            return Status.DEGRADED, f"no cone matched for {silent_s:.1f} s"
        if self._share < c.min_matched_share:
            return Status.DEGRADED, f"only {100 * self._share:.0f} % of cones match"
        return Status.OK, ""
