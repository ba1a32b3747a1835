"""Whether an estimator's covariances are as large as its errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from conegraph.eval.record import Record
from conegraph.geometry import wrap_angle
from conegraph.types import Array, IntArray

POSE_DOF = 3

EXACT = 1e-12
"""A variance (m^2 or rad^2) below this is that of something given."""

LEAST_EIGENVALUE = 1e-9
"""A correlation matrix with a smaller one is singular to within rounding."""


@dataclass(frozen=True, slots=True)
class Band(Record):
    """Between what a mean per degree of freedom should lie, with 95 % probability.

    Attributes:
        low: lower bound, 2.5 % of chi².
        high: upper bound, 97.5 %.
        inside: whether the mean does; False where there is none.
    """

    low: float
    high: float
    inside: bool


@dataclass(frozen=True, slots=True)
class InnovationConsistency(Record):
    """Normalised innovation squared (NIS) of a run; needs no truth.

    Attributes:
        frames: frames with an innovation.
        dof: their degrees of freedom in all.
        nis_per_dof: sum of NIS / sum of degrees of freedom; 1 is consistent, more is
            overconfident.
        share_inside: share of the frames whose NIS lies below the 95 % quantile of
            chi² with its own degrees of freedom; .95 is consistent.
        band: for `nis_per_dof`, of all degrees of freedom: innovations of a filter
            whose model is right are white. With tens of thousands of them it is a few
            percent wide, and to lie outside it may mean little: look at how far.

    Source: Y. Bar-Shalom et al., "Estimation with Applications to Tracking and
    Navigation", 2001, section 5.4.
    """

    frames: int
    dof: int
    nis_per_dof: float
    share_inside: float
    band: Band


@dataclass(frozen=True, slots=True)
class PoseConsistency(Record):
    """Normalised estimation error squared (NEES) of a path.

    Attributes:
        poses: poses with a usable covariance.
        nees_per_dof: mean of ``e' P^-1 e / 3``; 1 is consistent, more is overconfident.
        share_inside: share of the poses whose NEES lies below the 95 % quantile of
            chi² with 3 degrees of freedom; .95 is consistent.
        independent: how many independent errors the poses are worth, see
            `independent_samples`.
        band: for `nees_per_dof`, of so many errors.

    Source: Y. Bar-Shalom et al., "Estimation with Applications to Tracking and
    Navigation", 2001, section 5.4.
    """

    poses: int
    nees_per_dof: float
    share_inside: float
    independent: float
    band: Band


def innovation_consistency(nis: Array, dof: IntArray) -> InnovationConsistency | None:
    """Summarise the NIS (N,) of frames with so many degrees of freedom (N,) each.

    None without a frame that has a finite one.
    """
    usable = np.isfinite(nis) & (dof > 0)
    nis, dof = nis[usable], dof[usable]
    if len(nis) == 0:
        return None
    total = int(dof.sum())
    mean = float(nis.sum()) / total
    return InnovationConsistency(
        frames=len(nis),
        dof=total,
        nis_per_dof=mean,
        share_inside=float((nis <= chi2.ppf(0.95, dof)).mean()),
        band=band(mean, 1, total),
    )


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
        nan = float("nan")
        return PoseConsistency(0, nan, nan, 0.0, Band(nan, nan, False))
    inside = values <= chi2.ppf(0.95, POSE_DOF)
    mean, independent = float(values.mean()) / POSE_DOF, independent_samples(values)
    return PoseConsistency(
        poses=len(values),
        nees_per_dof=mean,
        share_inside=float(inside.mean()),
        independent=independent,
        band=band(mean, POSE_DOF, independent),
    )


def independent_samples(values: Array) -> float:
    """Return how many independent values have a mean as uncertain as a series has.

    Errors along a path resemble each other: n values are worth n / (1 + 2 sum rho_k)
    independent ones, rho_k the series' own autocorrelation at lag k, summed up to the
    first that is not positive. A series that never changes is worth one. With few
    turns of the error in a run this is rough: many runs say more than a long one.

    Source: the integrated autocorrelation time, A. Sokal, "Monte Carlo methods in
    statistical mechanics", 1989.
    """
    n = len(values)
    off = values - values.mean()
    power = np.abs(np.fft.rfft(off, 2 * n)) ** 2
    correlation = np.fft.irfft(power)[:n]
    if not correlation[0] > 0.0:
        return 1.0
    rho = correlation / correlation[0]
    end = int(np.argmax(rho <= 0.0)) or n
    return max(n / (1.0 + 2.0 * float(rho[1:end].sum())), 1.0)


def band(mean: float, dof: int, samples: float) -> Band:
    """Return the 95 % band of a mean per degree of freedom, see `nees_bounds`."""
    low, high = nees_bounds(dof, samples)
    return Band(low, high, low <= mean <= high)


def nees_bounds(dof: int, runs: float, confidence: float = 0.95) -> tuple[float, float]:
    """Return between what the mean NEES per dof of independent runs should lie.

    The sum of the NEES of n independent errors is chi² with ``n dof`` degrees of
    freedom. Errors along one path are not independent of each other: count runs, not
    frames, or what frames are worth (`independent_samples`).

    Args:
        dof: degrees of freedom of one error, 3 for a pose and 2 for a cone.
        runs: how many independent errors the mean is over.
        confidence: probability that a consistent estimator's mean lies inside.
    """
    total = dof * runs
    tail = 0.5 * (1.0 - confidence)
    low, high = chi2.ppf(tail, total), chi2.ppf(1.0 - tail, total)
    return float(low / total), float(high / total)
