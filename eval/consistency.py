"""Whether an estimator's covariances are as large as its errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from conegraph.eval.record import Record
from conegraph.geometry import wrap_angle
from conegraph.types import Array

POSE_DOF = 3

EXACT = 1e-12
"""A variance (m^2 or rad^2) below this is that of something given."""

LEAST_EIGENVALUE = 1e-9
"""A correlation matrix with a smaller one is singular to within rounding."""


@dataclass(frozen=True, slots=True)
class PoseConsistency(Record):
    """Normalised estimation error squared (NEES) of a path.

    Attributes:
        poses: poses with a usable covariance.
        nees_per_dof: mean of ``e' P^-1 e / 3``; 1 is consistent, more is overconfident.
        share_inside: share of the poses whose NEES lies below the 95 % quantile of
            chi² with 3 degrees of freedom; .95 is consistent.

    Source: Y. Bar-Shalom et al., "Estimation with Applications to Tracking and
    Navigation", 2001, section 5.4.
    """

    poses: int
    nees_per_dof: float
    share_inside: float


def pose_nees(estimate: Array, cov: Array, truth: Array) -> Array:
    """Return the NEES (N,) of poses.

    The gauge is the frame that estimate, covariance and truth are given in. A back
    end's own is the start frame: its world is the car at the first frame, which is
    exact, so the truth must be given as seen from the first true pose.

    Args:
        estimate: (N, 3) poses.
        cov: (N, 3, 3) covariances of x, y and yaw in the same frame.
        truth: (N, 3) true poses.

    Returns:
        ``e' P^-1 e`` with yaw errors wrapped; NaN where a covariance is not positive
        definite.
    """
    error = np.asarray(estimate, dtype=np.float64) - truth
    error[:, 2] = wrap_angle(error[:, 2])
    return nees(error, cov)


def nees(error: Array, cov: Array) -> Array:
    """Return ``e' C^-1 e`` (N,) of errors (N, d) with covariances (N, d, d).

    NaN where a covariance is not positive definite, or of an error known exactly: a
    path's first pose is the origin of its world.
    """
    result = np.full(len(error), np.nan)
    diagonal = np.diagonal(cov, axis1=1, axis2=2)
    finite = np.isfinite(cov).all(axis=(1, 2)) & np.isfinite(error).all(axis=1)
    usable = np.flatnonzero(finite & (diagonal > EXACT).all(axis=1))
    scale = np.sqrt(diagonal[usable])
    correlation = cov[usable] / (scale[:, :, None] * scale[:, None, :])
    sound = np.linalg.eigvalsh(correlation)[:, 0] > LEAST_EIGENVALUE
    usable, scaled = usable[sound], (error[usable] / scale)[sound]
    white = np.linalg.solve(correlation[sound], scaled[:, :, None])[..., 0]
    result[usable] = np.sum(scaled * white, axis=1)
    return result


def pose_consistency(estimate: Array, cov: Array, truth: Array) -> PoseConsistency:
    """Summarise `pose_nees` over a path."""
    values = pose_nees(estimate, cov, truth)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return PoseConsistency(0, float("nan"), float("nan"))
    inside = values <= chi2.ppf(0.95, POSE_DOF)
    return PoseConsistency(
        len(values), float(values.mean()) / POSE_DOF, float(inside.mean())
    )


def nees_bounds(dof: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return between what the mean NEES per dof of independent runs should lie.

    The sum of the NEES of n independent errors is chi² with ``n dof`` degrees of
    freedom. Errors along one path are not independent of each other: count runs, not
    frames.

    Args:
        dof: degrees of freedom of one error, 3 for a pose and 2 for a cone.
        runs: how many independent errors the mean is over.
        confidence: probability that a consistent estimator's mean lies inside.
    """
    total = dof * runs
    tail = 0.5 * (1.0 - confidence)
    low, high = chi2.ppf(tail, total), chi2.ppf(1.0 - tail, total)
    return float(low / total), float(high / total)
