"""The few numbers that say how noisy sensor and car are, as one vector.

A vector of logarithms: noise is positive, and an error of a factor two counts the
same upwards and downwards. Zero is the configuration that one starts from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from conegraph.backends.sensor_noise import effective_sensor
from conegraph.config import Config
from conegraph.types import Array, SensorModel

SensorNoise = Literal["model", "scale"]


@dataclass(frozen=True, slots=True)
class NoiseParameters:
    """What is estimated, and how a configuration is made from it.

    The sigma of the range is a curve ``c0 + c2 r^2`` through its values at a near
    and a far range; these two are the parameters, because both can be read off the
    data, which c0 and c2 cannot where all cones are at one range.

    Attributes:
        base: the configuration to start from.
        names: what each entry of the vector is, with its unit.
        start: (P,) its value at zero.
        ranges_m: the near and the far range; None to only scale what is reported.
        has_floor: whether the sensor has an error that is the same everywhere.
        has_odometry: whether the car's motion is measured or only guessed.
    """

    base: Config
    names: tuple[str, ...]
    start: Array
    ranges_m: tuple[float, float] | None
    has_floor: bool
    has_odometry: bool

    def values(self, theta: Array) -> Array:
        """Return the parameters (P,) themselves at a vector (P,) of logarithms."""
        values: Array = self.start * np.exp(theta)
        return values

    def config(self, theta: Array) -> Config:
        """Return the base configuration with the noise of a vector (P,)."""
        value = iter(self.values(theta).tolist())
        sensor: dict[str, Any] = {}
        if self.ranges_m is None:
            sensor["scale"] = next(value)
        else:
            near, far = next(value), next(value)
            sensor["noise_from"] = "model"
            sensor["scale"] = 1.0
            sensor["range_sigma_m"] = range_curve(self.ranges_m, (near, far))
            sensor["bearing_sigma_rad"] = next(value)
            if self.has_floor:
                sensor["floor_m"] = next(value)
        if self.has_odometry:
            motion: dict[str, Any] = {"odometry_scale": (next(value), next(value))}
        else:
            keys = ("accel_sigma_mps2", "yaw_accel_sigma_radps2")
            motion = {key: next(value) for key in keys}
        update = {
            "sensor": self.base.sensor.model_copy(update=sensor),
            "motion": self.base.motion.model_copy(update=motion),
        }
        return self.base.model_copy(update=update)


def noise_parameters(
    config: Config,
    sensor: SensorModel | None,
    range_m: Array,
    *,
    kind: SensorNoise,
    has_odometry: bool,
) -> NoiseParameters:
    """Say what is to be estimated.

    Args:
        config: where to start.
        sensor: the source's sensor.
        range_m: (N,) ranges of the cones seen; 10 % are nearer than the near range,
            10 % farther than the far one.
        kind: ``model`` estimates the sensor's curve, ``scale`` one factor on what
            the source reports.
        has_odometry: whether velocities are measured.
    """
    model = effective_sensor(config.sensor, sensor)
    names, start, ranges = ["sensor.scale"], [config.sensor.scale], None
    if kind == "model":
        near, far = np.quantile(range_m, [0.1, 0.9]).tolist()
        ranges = (near, max(far, 1.05 * near))
        c0, c1, c2 = model.range_sigma_m.tolist()
        names = [f"range sigma at {r:.1f} m [m]" for r in ranges]
        start = [max(c0 + c1 * r + c2 * r * r, 1e-4) for r in ranges]
        names.append("bearing sigma [rad]")
        start.append(model.bearing_sigma_rad)
        if model.floor_m > 0.0:
            names.append("position sigma [m]")
            start.append(model.floor_m)
        start = [config.sensor.scale * s for s in start]
    motion = config.motion
    if has_odometry:
        names += [
            "odometry: factor on speed sigma",
            "odometry: factor on yaw rate sigma",
        ]
        start += motion.odometry_scale
    else:
        names += ["acceleration sigma [m/s²]", "yaw acceleration sigma [rad/s²]"]
        start += [motion.accel_sigma_mps2, motion.yaw_accel_sigma_radps2]
    has_floor = kind == "model" and model.floor_m > 0.0
    return NoiseParameters(
        config, tuple(names), np.array(start), ranges, has_floor, has_odometry
    )


def range_curve(
    ranges_m: tuple[float, float], sigmas_m: Sequence[float]
) -> tuple[float, float, float]:
    """Return c0, c1 = 0, c2 >= 0 of the curve through two sigmas.

    Where no such curve has c0 >= 0 or rises, the nearest that does is through the
    far point alone, or is flat at the mean of the two.
    """
    (near, far), (low, high) = ranges_m, sigmas_m
    c2 = (high - low) / (far**2 - near**2)
    c0 = low - c2 * near**2
    if c2 < 0.0:
        return 0.5 * (low + high), 0.0, 0.0
    if c0 < 0.0:
        return 0.0, 0.0, high / far**2
    return c0, 0.0, c2
