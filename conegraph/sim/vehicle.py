"""A car that follows a line as fast as its tyres allow, and where it is when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from conegraph.geometry import wrap_angle
from conegraph.sim.polyline import arc_length, normal
from conegraph.types import Array

_WANDER_M = 12.0
"""Distance over which the driver's offset from the line changes."""
_CALM_M = 10.0


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """What the car can do, and how it is driven.

    Attributes:
        max_speed_mps: it never drives faster.
        lateral_mps2: largest sideways acceleration.
        accelerate_mps2: largest forward acceleration.
        brake_mps2: largest deceleration.
        stand_s: how long it stands before it sets off, and after it has stopped.
        run_on_s: how long a lap drive goes on after the last crossing of the line.
        wander_m: sigma of its offset from the line, new on every lap.
    """

    max_speed_mps: float = 15.0
    lateral_mps2: float = 8.0
    accelerate_mps2: float = 5.0
    brake_mps2: float = 7.0
    stand_s: float = 1.0
    run_on_s: float = 2.0
    wander_m: float = 0.1


@dataclass(frozen=True, slots=True)
class Motion:
    """The true motion of a car: a path and the time at which it is where.

    Between knots of the path the acceleration is constant, so that the speed is
    continuous and linear in time. Before the first knot's stamp the car stands; a
    lap drive breaks off at full speed at ``duration_s``.

    Attributes:
        path: the curve xy(s), twice continuously differentiable, s in m.
        s_m: (K,) knots along the path.
        speed_mps: (K,) speed at the knots.
        stamp_s: (K,) time at the knots.
        duration_s: end of the drive.
        laps_s: times at which the start line is crossed, none on an open track.
    """

    path: CubicSpline[np.float64]
    s_m: Array
    speed_mps: Array
    stamp_s: Array
    duration_s: float
    laps_s: Array

    def _at(self, stamp_s: Array) -> tuple[Array, Array]:
        """Return arc length and speed at stamps: v + a t and v t + a t^2 / 2."""
        t = np.clip(stamp_s, self.stamp_s[0], self.stamp_s[-1])
        k = np.clip(np.searchsorted(self.stamp_s, t, "right") - 1, 0, len(self.s_m) - 2)
        dt = t - self.stamp_s[k]
        step = self.stamp_s[k + 1] - self.stamp_s[k]
        acceleration = (self.speed_mps[k + 1] - self.speed_mps[k]) / step
        speed = self.speed_mps[k] + acceleration * dt
        return self.s_m[k] + 0.5 * (self.speed_mps[k] + speed) * dt, speed

    def pose(self, stamp_s: Array) -> Array:
        """Return (N, 3) true poses at (N,) stamps; the car looks along its path."""
        s, _ = self._at(stamp_s)
        forward = self.path(s, 1)
        yaw = wrap_angle(np.arctan2(forward[:, 1], forward[:, 0]))
        return np.column_stack([self.path(s), yaw])

    def velocity(self, stamp_s: Array) -> Array:
        """Return (N, 2) true forward speed u and yaw rate r at (N,) stamps.

        With the path p(s): u = |p'| ds/dt and r = (p' x p'') / |p'|^2 ds/dt.
        """
        s, speed = self._at(stamp_s)
        first, second = self.path(s, 1), self.path(s, 2)
        length = np.hypot(*first.T)
        turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        return np.column_stack([length * speed, turn / length**2 * speed])


def drive_line(
    line_m: Array,
    closed: bool,
    rng: np.random.Generator,
    *,
    laps: int = 2,
    start_line_m: float = 0.0,
    model: VehicleModel | None = None,
) -> Motion:
    """Return the motion of a car along a line, from standstill.

    Args:
        line_m: (K, 2) evenly spaced smooth line, the car waiting at its first point.
        closed: a loop is driven for some laps, an open line to its end and a stop.
        rng: draws the wander.
        laps: how often a loop is driven.
        start_line_m: where along the loop laps are counted.
        model: the car.

    Returns:
        The motion, from stamp zero.
    """
    model = model or VehicleModel()
    length = float(arc_length(np.vstack([line_m, line_m[:1]]))[-1])
    crossings: Array = start_line_m + length * np.arange(float(laps + 1))
    crossings = crossings if closed else np.zeros(0)
    if closed:
        beyond = model.max_speed_mps * model.run_on_s + 10.0
        spacing = length / len(line_m)
        count = int(np.ceil((crossings[-1] + beyond) / spacing))
        line_m = line_m[np.arange(count) % len(line_m)]
    xy = _wandered(line_m, closed, model.wander_m, rng)
    s = arc_length(xy)
    path = CubicSpline(s, xy)
    speed = _speed_profile(path, s, model, stop=not closed)
    stamp = np.concatenate(
        [[0.0], np.cumsum(2 * np.diff(s) / (speed[1:] + speed[:-1]))]
    )
    stamp = stamp + model.stand_s
    if not closed:
        return Motion(path, s, speed, stamp, stamp[-1] + model.stand_s, crossings)
    knots = arc_length(line_m)
    crossed_m = np.asarray(np.interp(crossings, knots, s))
    crossed: Array = np.asarray(np.interp(crossed_m, s, stamp), dtype=np.float64)
    return Motion(path, s, speed, stamp, crossed[-1] + model.run_on_s, crossed)


def _wandered(
    line: Array, closed: bool, sigma_m: float, rng: np.random.Generator
) -> Array:
    """Return the unrolled line with a smooth random offset, none at its ends."""
    s = arc_length(line)
    width = _WANDER_M / (s[-1] / (len(s) - 1))
    noise = gaussian_filter1d(rng.standard_normal(len(s)), width, mode="wrap")
    # A Gaussian of that width leaves white noise a variance of 1 / (2 sqrt(pi) width).
    offset = sigma_m * np.sqrt(2 * np.sqrt(np.pi) * width) * noise
    to_end = s if closed else np.minimum(s, s[-1] - s)
    calm = np.clip(to_end / _CALM_M, 0.0, 1.0)
    fade = calm**3 * (10 - 15 * calm + 6 * calm**2)
    aside: Array = (offset * fade)[:, None] * normal(line, closed=False)
    return line + aside


def _speed_profile(
    path: CubicSpline[np.float64], s: Array, model: VehicleModel, stop: bool
) -> Array:
    """Return the fastest speeds at s that tyres, engine and brakes allow.

    Corners allow v^2 <= a_lateral / |curvature|. Speeding up allows
    v^2(s) <= v^2(q) + 2 a (s - q) for every q < s, which is a running minimum of
    v^2(q) - 2 a q; braking is the same from the other end.
    """
    first, second = path(s, 1), path(s, 2)
    turn = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    bend = turn / np.hypot(*first.T) ** 3
    limit = np.minimum(
        model.max_speed_mps**2, model.lateral_mps2 / np.maximum(bend, 1e-9)
    )
    limit[0] = 0.0
    if stop:
        limit[-1] = 0.0
    rise, fall = 2 * model.accelerate_mps2 * s, 2 * model.brake_mps2 * s
    ahead = np.minimum.accumulate(limit - rise) + rise
    both = np.minimum.accumulate((ahead + fall)[::-1])[::-1] - fall
    return np.sqrt(np.maximum(both, 0.0))
