"""Where odometry fell silent while the car went on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conegraph.io.run_folder import RunFolder

LONGEST_S = 2.0
"""Odometry that is slow, or logged when it changes, is not silent for longer."""

LEAST_FRAMES = 10
"""Frames with odometry, without which there was none that could stop."""

LEAST_AWAY_M = 2.0
"""A car that got no farther stood, and needed none."""


@dataclass(frozen=True, slots=True)
class OdometryGap:
    """A time without odometry after one with it.

    Attributes:
        start_s: stamp of the last frame that had odometry.
        length_s: from then to the last frame that had none.
        away_m: how far the car got meanwhile by the estimate, as the crow flies:
            one that stands seems to go a long way in small steps.
        to_the_end: whether odometry never came back.
    """

    start_s: float
    length_s: float
    away_m: float
    to_the_end: bool

    @property
    def text(self) -> str:
        """What happened, and when."""
        end = "to the end" if self.to_the_end else f"for {self.length_s:.1f} s"
        return (
            f"odometry stopped at {self.start_s:.1f} s, {end}: the car got "
            f"{self.away_m:.0f} m away without it"
        )


def odometry_gap(run: RunFolder) -> OdometryGap | None:
    """Return the longest time without odometry, None where there is none to speak of.

    Args:
        run: what it wrote; tables of a killed run may differ in length.
    """
    n = min(len(run.motion), len(run.trajectory))
    stamp_s = run.motion.stamp_s[:n]
    told = np.flatnonzero(np.isfinite(run.motion.odometry[:n, 0]))
    if len(told) < LEAST_FRAMES:
        return None
    since = told[LEAST_FRAMES - 1 :]
    until = np.append(since[1:], n) - 1
    k = int((stamp_s[until] - stamp_s[since]).argmax())
    first, last = int(since[k]), int(until[k])
    path = run.trajectory.pose[first : last + 1, :2]
    gap = OdometryGap(
        start_s=float(stamp_s[first]),
        length_s=float(stamp_s[last] - stamp_s[first]),
        away_m=float(np.hypot(*(path - path[0]).T).max()),
        to_the_end=first == told[-1],
    )
    silent = gap.length_s > LONGEST_S and gap.away_m > LEAST_AWAY_M
    return gap if silent else None
