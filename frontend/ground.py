"""The ground plane of every frame, from its depth, in inverse depth.

A plane is affine in the picture there: ``1/Z = p . (X/Z, Y/Z, 1)``. A stereo
camera's error is the same everywhere in inverse depth, so that least squares in
it are efficient and free of the bias that depth has far away. Camera pitch is
what cone positions depend on most, and braking changes it from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from conegraph.camera import CameraMount, RgbdFrame
from conegraph.config import GroundConfig
from conegraph.frontend.camera import mount_on_plane, plane_of_mount, ray_grid
from conegraph.types import Array

GRID_STEP_PX = 8
ROUNDS = 3
MIN_POINTS = 60
PERSISTENT = 8
MAX_TILT_RAD, MAX_STRETCH = 0.2, 1.5
"""How far attitude and height may be from the mount's at most."""
WORST_CONDITION = 1e10
INLIER_SIGMAS = 2.5
FIRST_BAND_PER_M = 0.10
"""How far from the expected plane a point may be at first, in inverse depth."""
MAX_DEPTH_M = 12.0
"""Where the ground is expected beyond this it is left out: sensors drop what they
measure to be too far, and of far points the nearer half would be left."""
NOISE_FLOOR_PER_M = 1e-4
MOST_NOISE_PER_M = 0.05
"""Depth that scatters more than this shows nothing."""
NOISE_PRIOR_PER_M = 0.005
"""Inverse-depth noise that is taken for granted while none can be measured."""
NEIGHBOURS = 1.5
"""Factor on the plane's sigmas: points of the grid err together, about two at a time,
as smooth roads are not quite planes."""


@dataclass(frozen=True, slots=True)
class GroundPlane:
    """The ground in the optical frame.

    Attributes:
        plane: (3,) p of ``1/Z = p . (X/Z, Y/Z, 1)``, in 1/m.
        cov: (3, 3) its covariance.
        noise_per_m: sigma of one pixel's inverse depth, in 1/m.
        measured: whether this frame's depth showed it.
    """

    plane: Array
    cov: Array
    noise_per_m: float
    measured: bool

    def inverse_depth(self, ray: Array) -> Array:
        """Return 1/Z (N,) where rays (N, 3) meet the ground; 0 or less is never."""
        found: Array = ray @ self.plane
        return found

    def variance(self, ray: Array) -> Array:
        """Return the variance (N,) of `inverse_depth` that the plane's doubt makes."""
        found: Array = np.einsum("ni,ij,nj->n", ray, self.cov, ray)
        return found

    def mount(self, mount: CameraMount) -> CameraMount:
        """Return the mount as it sits over this plane."""
        return mount_on_plane(mount, self.plane)


@dataclass(slots=True)
class GroundTracker:
    """Fits every frame's plane, starting from what frames before it lead to expect.

    The expected plane is the mount's, plus what the last frame's deviated from it,
    fading with the suspension's time constant; its covariance grows from the last
    frame's towards that of the mount's prior (a first-order Gauss-Markov process).
    Depth that shows no ground near it leaves the expectation as it is. A plane that is
    far from it for `PERSISTENT` frames on end is believed, as the mount may be wrong,
    unless no camera on a car could sit so.
    """

    config: GroundConfig
    _deviation: Array = field(default_factory=lambda: np.zeros(3))
    _cov: Array | None = None
    _stamp_s: float | None = None
    _noise_per_m: float = NOISE_PRIOR_PER_M
    _strange: int = 0

    def update(self, frame: RgbdFrame) -> GroundPlane:
        """Return the plane of this frame."""
        expected = self._expected(frame)
        found = fit_plane(frame, expected) if self.config.fit else None
        plane = expected
        if found is not None and self._is_plausible(found, expected):
            plane = _fused(expected, found)
            self._noise_per_m, self._strange = plane.noise_per_m, 0
        elif found is not None and _is_possible(found.plane, frame.mount):
            self._strange += 1
            if self._strange >= PERSISTENT:
                plane, self._noise_per_m = found, found.noise_per_m
        self._deviation = plane.plane - plane_of_mount(frame.mount)
        self._cov, self._stamp_s = plane.cov, frame.stamp_s
        return plane

    def _expected(self, frame: RgbdFrame) -> GroundPlane:
        home = plane_of_mount(frame.mount)
        prior = _prior_covariance(home, self.config)
        if self._cov is None or self._stamp_s is None:
            return GroundPlane(home, prior, self._noise_per_m, False)
        lapse_s = frame.stamp_s - self._stamp_s
        keep = np.exp(-abs(lapse_s) / self.config.time_constant_s)
        cov = keep**2 * self._cov + (1.0 - keep**2) * prior
        return GroundPlane(home + keep * self._deviation, cov, self._noise_per_m, False)

    def _is_plausible(self, found: GroundPlane, expected: GroundPlane) -> bool:
        gap = found.plane - expected.plane
        d2 = gap @ np.linalg.solve(found.cov + expected.cov, gap)
        return bool(d2 <= self.config.gate_d2)


def fit_plane(frame: RgbdFrame, expected: GroundPlane) -> GroundPlane | None:
    """Fit the plane to a frame's depth by trimmed least squares in inverse depth.

    Args:
        frame: the picture; every `GRID_STEP_PX`-th pixel is used.
        expected: points near it are where the fit begins.

    Returns:
        The plane, or None where too few points lie on one.
    """
    step = GRID_STEP_PX
    ray = ray_grid(frame.camera, step).reshape(-1, 2)
    depth_m = frame.depth_m[::step, ::step].ravel()
    below = ray @ expected.plane[:2] + expected.plane[2] > 1.0 / MAX_DEPTH_M
    use = below & (depth_m > 0)
    x = np.column_stack([ray[use], np.ones(int(use.sum()))]).astype(np.float64)
    y = 1.0 / depth_m[use].astype(np.float64)
    plane: Array = expected.plane
    band = FIRST_BAND_PER_M
    noise = NOISE_PRIOR_PER_M
    information = np.eye(3)
    for _ in range(ROUNDS):
        residual = y - x @ plane
        near = np.abs(residual) <= band
        if near.sum() < MIN_POINTS:
            return None
        kept = x[near]
        information = kept.T @ kept
        if np.linalg.cond(information) > WORST_CONDITION:
            return None
        plane = np.linalg.solve(information, kept.T @ y[near])
        residual = y[near] - kept @ plane
        noise = max(1.4826 * float(np.median(np.abs(residual))), NOISE_FLOOR_PER_M)
        band = INLIER_SIGMAS * noise
    if noise > MOST_NOISE_PER_M:
        return None
    cov = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return GroundPlane(plane, (NEIGHBOURS * noise) ** 2 * cov, noise, True)


def _is_possible(plane: Array, mount: CameraMount) -> bool:
    """Say whether a camera that is meant to sit so could sit so over a plane."""
    home, found = plane_of_mount(mount), plane
    lengths = float(np.linalg.norm(home)), float(np.linalg.norm(found))
    upright = float(home @ found) >= np.cos(MAX_TILT_RAD) * lengths[0] * lengths[1]
    return upright and 1 / MAX_STRETCH <= lengths[0] / lengths[1] <= MAX_STRETCH


def _fused(expected: GroundPlane, found: GroundPlane) -> GroundPlane:
    gain = expected.cov @ np.linalg.inv(expected.cov + found.cov)
    plane = expected.plane + gain @ (found.plane - expected.plane)
    cov = (np.eye(3) - gain) @ expected.cov
    return GroundPlane(plane, 0.5 * (cov + cov.T), found.noise_per_m, True)


def _prior_covariance(home: Array, config: GroundConfig) -> Array:
    """Return the covariance of the mount's plane from its angles' and height's.

    With ``p = n/h``, doubt about the angles moves p across itself by ``sigma/h``,
    doubt about the height along itself by ``sigma_h/h^2``.
    """
    h = 1.0 / float(np.linalg.norm(home))
    n = home * h
    along = np.outer(n, n)
    across = (config.attitude_sigma_rad / h) ** 2
    cov: Array = across * (np.eye(3) - along)
    return cov + (config.height_sigma_m / h**2) ** 2 * along
