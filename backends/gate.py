"""The one gate in front of every back end: only sane data pass, the rest is counted.

gtsam takes NaN ranges silently and raises later, or leaves its solver unusable;
so nothing that is not finite, positive definite, in range and in order gets by.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from conegraph.config import GateConfig
from conegraph.types import Array, ConeObservations, VelocityObservation

VELOCITY_SIGMAS = (1e-6, 1e3)
"""Sigmas (m/s, rad/s) outside of which a filter's arithmetic breaks down."""

LEAP_S = 10.0
"""A stamp farther ahead than this must be confirmed by the next: one that is wrong
would make all that follow look old."""


class _Clock:
    """The stamps of one kind of event."""

    def __init__(self) -> None:
        self.last_s = -np.inf
        self._leap_s = -np.inf

    def leaps(self, stamp_s: float, other_s: float) -> bool:
        """Whether a stamp is far ahead, and the one before it did not lead there.

        Args:
            stamp_s: the stamp, later than the last.
            other_s: the latest stamp of the other kind, which may lead there too.
        """
        step_s = min(stamp_s - self.last_s, abs(stamp_s - other_s))
        if not np.isfinite(self.last_s) or step_s <= LEAP_S:
            self._leap_s = -np.inf
            return False
        confirmed = 0.0 <= stamp_s - self._leap_s <= LEAP_S
        self._leap_s = stamp_s
        return not confirmed


class InputGate:
    """Checks events in the order in which they arrive."""

    def __init__(self, config: GateConfig) -> None:
        """Start with nothing seen."""
        self._config = config
        self._frames, self._samples = _Clock(), _Clock()
        self.rejected: Counter[str] = Counter()

    def cones(self, frame: ConeObservations) -> ConeObservations | None:
        """Return the frame with its sane cones, or None for one of a wrong stamp.

        The comparisons are written so that NaN fails them.
        """
        c = self._config
        if not np.isfinite(frame.stamp_s):
            self.rejected["frame: stamp is not a number"] += 1
            return None
        if not frame.stamp_s > self._frames.last_s:
            self.rejected["frame: stamp does not increase"] += 1
            return None
        if self._frames.leaps(frame.stamp_s, self._samples.last_s):
            self.rejected["frame: stamp leaps ahead"] += 1
            return None
        self._frames.last_s = frame.stamp_s
        xy = frame.xy_m
        with np.errstate(invalid="ignore", over="ignore"):
            range_m = np.hypot(xy[:, 0], xy[:, 1])
            prob = frame.class_prob
            total = prob.sum(axis=1)
            prob_ok = (prob >= 0).all(axis=1) & (total > 1e-6) & np.isfinite(total)
            checks: list[tuple[str, NDArray[np.bool_]]] = [
                ("cone: position is not a number", np.isfinite(range_m)),
                ("cone: too near", ~(range_m < c.min_range_m)),
                ("cone: too far", ~(range_m > c.max_range_m)),
                (
                    "cone: covariance unusable",
                    _usable(frame.cov_m2, c.min_sigma_m, c.max_sigma_m),
                ),
                ("cone: class probabilities unusable", prob_ok),
                ("cone: score unusable", (frame.evidence >= 0) & (frame.evidence <= 1)),
                ("cone: too many in one frame", np.arange(len(xy)) < c.max_cones),
            ]
        if all(passed.all() for _, passed in checks):
            return frame
        return frame.subset(self._count(checks, len(xy)))

    def _count(
        self, checks: list[tuple[str, NDArray[np.bool_]]], n: int
    ) -> NDArray[np.bool_]:
        good = np.ones(n, dtype=bool)
        for reason, passed in checks:
            bad = int((good & ~passed).sum())
            if bad:
                self.rejected[reason] += bad
            good &= passed
        return good

    def velocity(self, sample: VelocityObservation) -> VelocityObservation | None:
        """Return the sample if it is sane, else None."""
        c = self._config
        values = np.array([sample.stamp_s, sample.u_mps, sample.r_radps])
        reason = ""
        if not (np.isfinite(values).all() and np.isfinite(sample.cov).all()):
            reason = "odometry: not a number"
        elif not sample.stamp_s >= self._samples.last_s:
            reason = "odometry: stamp goes backwards"
        elif self._samples.leaps(sample.stamp_s, self._frames.last_s):
            reason = "odometry: stamp leaps ahead"
        elif abs(sample.u_mps) > c.max_speed_mps:
            reason = "odometry: too fast"
        elif abs(sample.r_radps) > c.max_yaw_rate_radps:
            reason = "odometry: turns too fast"
        elif not _usable(sample.cov[None], *VELOCITY_SIGMAS)[0]:
            reason = "odometry: covariance unusable"
        if reason:
            self.rejected[reason] += 1
            return None
        self._samples.last_s = sample.stamp_s
        return sample


def _usable(cov: Array, least: float, most: float) -> NDArray[np.bool_]:
    """(N,) whether covariances (N, 2, 2) are symmetric, with sigmas within bounds."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        trace = cov[:, 0, 0] + cov[:, 1, 1]
        det = cov[:, 0, 0] * cov[:, 1, 1] - cov[:, 0, 1] ** 2
        root = np.sqrt(np.maximum((0.5 * trace) ** 2 - det, 0.0))
        smaller = det / (0.5 * trace + root)
        symmetric = np.abs(cov[:, 0, 1] - cov[:, 1, 0]) <= 1e-6 * trace
        usable: NDArray[np.bool_] = (
            symmetric & (trace > 0.0) & (trace <= 2 * most**2) & (smaller >= least**2)
        )
    return usable
