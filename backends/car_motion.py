"""Moving the filter's car from frame to frame, by odometry or without."""

from __future__ import annotations

import numpy as np

from conegraph.backends.landmark_filter import LandmarkFilter
from conegraph.backends.motion import (
    NV,
    OdometryIncrement,
    Prediction,
    predict_euler,
    predict_midpoint,
    predict_with_odometry,
    yaw_rate_bias_sigma,
)
from conegraph.backends.odometry_queue import OdometryQueue
from conegraph.backends.standstill import WINDOW_S, StandstillWatch, standing
from conegraph.config import MotionConfig
from conegraph.types import Array


class CarMotion:
    """Predicts a filter to the stamps of frames and remembers how it did.

    Attributes:
        queue: velocities that wait for the next frame.
        stamp_s: stamp of the last frame, None before the first.
        increment: odometry since the frame before it, None without any.
        noise: (6, 6) process noise since it was last taken.
        frames_standing: frames since the car was last seen to move.
    """

    def __init__(self, config: MotionConfig) -> None:
        """Start before the first frame."""
        self._config = config
        self.queue = OdometryQueue(config)
        self.stamp_s: float | None = None
        self.increment: OdometryIncrement | None = None
        self.noise: Array = np.zeros((NV, NV))
        self.frames_standing = 0
        self._standstill = StandstillWatch()

    def advance(self, filter_: LandmarkFilter, stamp_s: float) -> float:
        """Predict to a frame's stamp; return the distance driven.

        The first frame is the origin: nothing is predicted before it.
        """
        before_s, self.stamp_s = self.stamp_s, stamp_s
        for sample in self.queue.waiting(stamp_s):
            self._standstill.add(sample)
        if before_s is None:
            self.queue.samples(stamp_s)
            return 0.0
        start = filter_.vehicle
        if self._config.odometry_as_input:
            self.increment = self.queue.take(before_s, stamp_s)
            if self.increment is not None and self._stands(before_s, stamp_s):
                self.increment = standing(self.increment)
                self.frames_standing += 1
            else:
                self.frames_standing = 0
            step = self._step(start, stamp_s - before_s, self.increment)
        else:
            self.increment = self.queue.peek(before_s, stamp_s)
            before_s = self._correct_with_samples(filter_, before_s, stamp_s)
            step = self._step(filter_.vehicle, stamp_s - before_s, None)
        self._predict(filter_, step, self.increment)
        self.noise = self.noise + step.Q
        return float(np.hypot(*(step.state[:2] - start[:2])))

    def _stands(self, before_s: float, stamp_s: float) -> bool:
        """Whether the car has stood ever since the frame before."""
        told = stamp_s - before_s <= WINDOW_S
        return self._config.standstill and told and self._standstill.stands(stamp_s)

    def repeat(
        self, filter_: LandmarkFilter, dt_s: float, increment: OdometryIncrement | None
    ) -> None:
        """Predict a filter once more over a step that was taken before."""
        step = self._step(filter_.vehicle, dt_s, increment)
        self._predict(filter_, step, increment)

    def _predict(
        self,
        filter_: LandmarkFilter,
        step: Prediction,
        increment: OdometryIncrement | None,
    ) -> None:
        """Predict, and correct the bias that a standing car's gyro shows."""
        filter_.predict(step)
        seen = None if increment is None else increment.bias
        if seen is not None and yaw_rate_bias_sigma(self._config) > 0.0:
            filter_.update_bias(*seen)

    def look_ahead(self, state: Array, stamp_s: float) -> Prediction:
        """Predict a state beyond the last frame and change nothing."""
        last_s = stamp_s if self.stamp_s is None else self.stamp_s
        increment = None
        if self._config.odometry_as_input:
            increment = self.queue.peek(last_s, stamp_s)
        return self._step(state, stamp_s - last_s, increment)

    def take_noise(self) -> Array:
        """Return the process noise since it was last taken, and start anew."""
        taken, self.noise = self.noise, np.zeros((NV, NV))
        return taken

    def _correct_with_samples(
        self, filter_: LandmarkFilter, before_s: float, stamp_s: float
    ) -> float:
        """Predict to each waiting sample and correct with it (section 4.4.2)."""
        for sample in self.queue.samples(stamp_s):
            if sample.stamp_s > before_s:
                dt_s = sample.stamp_s - before_s
                filter_.predict(self._step(filter_.vehicle, dt_s, None))
                before_s = sample.stamp_s
            filter_.update_velocity(sample.u_mps, sample.r_radps, sample.cov)
        return before_s

    def _step(
        self, state: Array, dt_s: float, increment: OdometryIncrement | None
    ) -> Prediction:
        if increment is not None:
            return predict_with_odometry(state, increment, self._config)
        euler = self._config.integration == "euler"
        return (predict_euler if euler else predict_midpoint)(state, dt_s, self._config)
