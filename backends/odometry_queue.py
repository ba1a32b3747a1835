"""Velocities on their way to the filter, kept until a frame asks for them."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

from conegraph.backends.motion import OdometryIncrement, integrate_odometry
from conegraph.config import MotionConfig
from conegraph.types import VelocityObservation

SILENT = 5.0
"""Odometry that is silent for so many times its longest pause so far has stopped."""

FEW_SAMPLES = 20
"""Before so many samples nobody knows how often they come."""


class OdometryQueue:
    """Holds samples in order of stamp; hands out what lies in an interval."""

    def __init__(self, config: MotionConfig) -> None:
        """Start without any sample."""
        self._config = config
        self._waiting: deque[VelocityObservation] = deque()
        self._held: VelocityObservation | None = None
        self._spacing_s = 0.0
        self._longest_s = 0.0
        self._taken = 0

    def push(self, sample: VelocityObservation) -> None:
        """Take the next sample; stamps never decrease."""
        self._waiting.append(sample)

    @property
    def newest_s(self) -> float:
        """Stamp of the newest sample, minus infinity without any."""
        if self._waiting:
            return self._waiting[-1].stamp_s
        return self._held.stamp_s if self._held else float("-inf")

    def waiting(self, end_s: float) -> list[VelocityObservation]:
        """Return the samples up to a stamp, without taking them out."""
        return [v for v in self._waiting if v.stamp_s <= end_s]

    def samples(self, end_s: float) -> list[VelocityObservation]:
        """Take out the samples up to a stamp, one by one in order."""
        taken = []
        while self._waiting and self._waiting[0].stamp_s <= end_s:
            taken.append(self._waiting.popleft())
        stamps = [v.stamp_s for v in ([self._held] if self._held else []) + taken]
        pauses = [after - before for before, after in pairwise(stamps)]
        self._longest_s = max([self._longest_s, *pauses])
        self._taken += len(taken)
        if taken:
            before = taken[-2] if len(taken) > 1 else self._held
            if before is not None:
                self._spacing_s = taken[-1].stamp_s - before.stamp_s
            self._held = taken[-1]
        return taken

    def _hold_s(self) -> float:
        """How long the last sample speaks for the car.

        Some log a speed when it changes, a second apart; of others a tenth of a
        second without a sample means that a cable is off.
        """
        if self._taken < FEW_SAMPLES:
            return self._config.odometry_hold_s
        return min(SILENT * self._longest_s, self._config.odometry_hold_s)

    def take(self, start_s: float, end_s: float) -> OdometryIncrement | None:
        """Integrate the interval and forget its samples.

        None where no sample is fresh enough to speak for the interval.
        """
        held = self._held
        return self._integrate(held, self.samples(end_s), start_s, end_s)

    def peek(self, start_s: float, end_s: float) -> OdometryIncrement | None:
        """Integrate the interval and keep everything."""
        return self._integrate(self._held, self.waiting(end_s), start_s, end_s)

    def _integrate(
        self,
        held: VelocityObservation | None,
        samples: list[VelocityObservation],
        start_s: float,
        end_s: float,
    ) -> OdometryIncrement | None:
        first = held or (samples[0] if samples else None)
        if first is None or end_s <= start_s:
            return None
        newest = samples[-1].stamp_s if samples else first.stamp_s
        if start_s - newest > self._hold_s():
            return None
        inside = [v for v in samples if v.stamp_s >= start_s]
        skipped = samples[: len(samples) - len(inside)]
        return integrate_odometry(
            skipped[-1] if skipped else first,
            inside,
            start_s,
            end_s,
            self._config,
            self._spacing_s,
        )
