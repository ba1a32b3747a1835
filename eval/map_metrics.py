"""How good a cone map is: position, completeness, colour, honesty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from conegraph.eval.align import distance, rms
from conegraph.eval.colour_metrics import ColourMetrics, colour_metrics
from conegraph.eval.consistency import Band, band
from conegraph.eval.matching import (
    DEFAULT_GATE_M,
    Matching,
    best_match,
    find_twins,
    match_cones,
    one_row_each,
)
from conegraph.eval.record import Record
from conegraph.geometry import rotation, to_parent
from conegraph.types import (
    Array,
    ConeMap,
    IntArray,
    Mask,
    TruthMap,
)

CONE_DOF = 2
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class StartFrameMetrics(Record):
    """The map placed so that the two trajectories start from the same pose.

    A run's world is the car's pose at its start while the truth lives in the
    track's frame; this is the placement without any fit to the map, so that the
    drift of the run counts.

    Attributes:
        rmse_m: RMS distance, m, of the pairs that match when aligned: a gate in
            this placement would hide the very cones that have drifted most.
        precision: matched / estimated when cones are paired in this placement, 0..1.
        recall: matched / true, over observable cones, likewise, 0..1.
        nees_per_dof: as in `MapMetrics`; nothing has been removed by a fit, but it
            asks the first true pose to be exact.
    """

    rmse_m: float
    precision: float
    recall: float
    nees_per_dof: float


@dataclass(frozen=True, slots=True)
class MapMetrics(Record):
    """One-to-one comparison of a cone map with the true cones.

    *Aligned* is after the SE(2) motion that fits the matched cones best, so that
    only the shape of the map counts. Shares are 0 to 1.

    Of two true cones that stand implausibly close (`find_twins`) the truth is at
    fault: they count as one. A map is right with one of them and with both, and what
    it has there is measured neither in position nor in colour.

    Attributes:
        estimated: cones in the map.
        true: cones in the truth.
        observable: true cones that recall asks for: those that the sensor reported
            often enough, of twins those found or else one.
        matched: pairs of the one-to-one matching.
        measured: of those, with a true cone that has no twin.
        rmse_aligned_m: RMS distance of the measured pairs when aligned, m.
        median_aligned_m: median of the same, m.
        max_aligned_m: greatest of the same, m.
        precision: matched / estimated; duplicates and false cones lower it.
        recall: matched / true, over observable cones only.
        recall_all: matched / true, over all true cones.
        duplicates: unmatched cones within the gate of a true cone already taken.
        false_cones: unmatched cones with no true cone within the gate.
        missed: observable true cones without a partner.
        colour: classes of the matched cones; None where no true class is known.
        nees_per_dof: mean of e' C^-1 e / 2 over the measured pairs when aligned, e
            the error and C the map's own covariance; 1 is consistent, more is
            overconfident. Alignment removes error that C contains, so less than 1
            proves nothing.
        nees_band: for it, as if the cones' errors were independent; neighbours'
            resemble each other, which makes the true band wider.
        lenient_nearest_rmse_m: RMS distance from each cone of the map to the
            nearest true one when aligned, m, as teams publish it. One-sided: a map
            with half of its cones missing, or each one twice, still scores 0.
        start_frame: before alignment; None without a true trajectory.
        gate_m: farthest pair that could match, m.
        pose_truth_run: (3,) the run's world in the truth's frame, when aligned.

    Source: consistency as in Y. Bar-Shalom et al., "Estimation with Applications
    to Tracking and Navigation", 2001, section 5.4 (normalised estimation error
    squared).
    """

    estimated: int
    true: int
    observable: int
    matched: int
    measured: int
    rmse_aligned_m: float
    median_aligned_m: float
    max_aligned_m: float
    precision: float
    recall: float
    recall_all: float
    duplicates: int
    false_cones: int
    missed: int
    colour: ColourMetrics | None
    nees_per_dof: float
    nees_band: Band
    lenient_nearest_rmse_m: float
    start_frame: StartFrameMetrics | None
    gate_m: float
    pose_truth_run: Array


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else _NAN


def nees_per_dof(
    cone_map: ConeMap, truth: TruthMap, matching: Matching, pose: Array
) -> float:
    """Return the mean squared Mahalanobis error of the pairs per degree of freedom.

    Cones whose covariance is not positive definite are left out; NaN if all are.
    """
    turn = rotation(pose[2])
    error = to_parent(pose, cone_map.xy_m[matching.estimate])
    error = error - truth.xy_m[matching.truth]
    cov = turn @ cone_map.cov_m2[matching.estimate] @ turn.T
    determinant = cov[:, 0, 0] * cov[:, 1, 1] - cov[:, 0, 1] * cov[:, 1, 0]
    usable = (cov[:, 0, 0] > 0) & (determinant > 0)
    if not usable.any():
        return _NAN
    error, cov = error[usable], cov[usable]
    weighted = np.linalg.solve(cov, error[:, :, None])[:, :, 0]
    return float(np.mean(np.sum(error * weighted, axis=1)) / CONE_DOF)


def map_metrics(
    cone_map: ConeMap,
    truth: TruthMap,
    *,
    start_pose: Array | None = None,
    trajectory_pose: Array | None = None,
    observable: Mask | None = None,
    max_distance_m: float = DEFAULT_GATE_M,
) -> MapMetrics:
    """Compare a map with the true cones.

    Args:
        cone_map: the estimate, in the run's world.
        truth: the true cones, in the track's frame.
        start_pose: (3,) the run's world in the track's frame by the first pose of
            the trajectory; a first guess, and the start frame.
        trajectory_pose: (3,) the same by SE(2) alignment of the whole trajectory;
            another first guess.
        observable: (M,) which true cones the sensor reported often enough to be
            asked for; all by default.
        max_distance_m: the matching gate.
    """
    guesses = [p for p in (start_pose, trajectory_pose) if p is not None]
    pose, matching = best_match(
        cone_map.xy_m, truth.xy_m, tuple(guesses) or (np.zeros(3),), max_distance_m
    )
    twins = find_twins(truth.xy_m)
    asked = np.ones(len(truth), dtype=np.bool_) if observable is None else observable
    asked = asked & _needed(one_row_each(len(truth), twins), matching)
    measured = matching.subset(~np.isin(matching.truth, twins))
    placed = to_parent(pose, cone_map.xy_m)
    d = measured.distance_m
    nees = nees_per_dof(cone_map, truth, measured, pose)
    start_frame = None
    if start_pose is not None:
        start_frame = start_frame_metrics(
            cone_map, truth, measured, start_pose, asked, max_distance_m
        )
    return MapMetrics(
        estimated=len(cone_map),
        true=len(truth),
        observable=int(asked.sum()),
        matched=len(matching),
        measured=len(measured),
        rmse_aligned_m=rms(d),
        median_aligned_m=float(np.median(d)) if len(d) else _NAN,
        max_aligned_m=float(np.max(d)) if len(d) else _NAN,
        precision=_ratio(len(matching), len(cone_map)),
        recall=_recall(matching, asked),
        recall_all=_ratio(len(matching), len(truth)),
        duplicates=len(matching.duplicate),
        false_cones=len(matching.false),
        missed=int(asked[matching.missed].sum()),
        colour=colour_metrics(cone_map, truth, measured),
        nees_per_dof=nees,
        nees_band=band(nees, CONE_DOF, max(len(measured), 1)),
        lenient_nearest_rmse_m=lenient_nearest_rmse(placed, truth.xy_m),
        start_frame=start_frame,
        gate_m=max_distance_m,
        pose_truth_run=pose,
    )


def start_frame_metrics(
    cone_map: ConeMap,
    truth: TruthMap,
    aligned: Matching,
    start_pose: Array,
    asked: Mask,
    max_distance_m: float,
) -> StartFrameMetrics:
    """Measure pairs of the aligned matching where the start pose puts them."""
    placed = to_parent(start_pose, cone_map.xy_m)
    here = match_cones(placed, truth.xy_m, max_distance_m)
    return StartFrameMetrics(
        rmse_m=rms(distance(placed[aligned.estimate], truth.xy_m[aligned.truth])),
        precision=_ratio(len(here), len(cone_map)),
        recall=_recall(here, asked),
        nees_per_dof=nees_per_dof(cone_map, truth, aligned, start_pose),
    )


def lenient_nearest_rmse(estimate_xy_m: Array, truth_xy_m: Array) -> float:
    """Return the RMS distance in m from each estimated cone to the nearest true one.

    Cones whose position is not finite are left out.
    """
    estimate_xy_m = estimate_xy_m[np.isfinite(estimate_xy_m).all(axis=1)]
    if len(estimate_xy_m) == 0 or len(truth_xy_m) == 0:
        return _NAN
    nearest, _ = KDTree(truth_xy_m).query(estimate_xy_m)
    return rms(np.asarray(nearest, dtype=np.float64))


def _needed(stands: IntArray, matching: Matching) -> Mask:
    """Mark the true cones (M,) that count: of twins those found, or else one.

    Args:
        stands: (M,) the row that stands for each true cone.
        matching: which of them were found.
    """
    found = np.zeros((2, len(stands)), dtype=np.bool_)
    found[0, matching.truth] = found[1, stands[matching.truth]] = True
    needed: Mask = found[0] | (~found[1][stands] & (stands == np.arange(len(stands))))
    return needed


def _recall(matching: Matching, asked: Mask) -> float:
    return _ratio(int(asked[matching.truth].sum()), int(asked.sum()))
