"""What is odd about a run, in sentences."""

from __future__ import annotations

import numpy as np

from conegraph.eval.odometry_gap import odometry_gap
from conegraph.eval.pose_pairs import MAX_TRUTH_GAP_S
from conegraph.eval.trajectory_metrics import TrajectoryMetrics
from conegraph.eval.words import counted
from conegraph.io.run_folder import RunFolder
from conegraph.types import Status, Trajectory


def run_warnings(
    run: RunFolder, causal: TrajectoryMetrics | None, truth: Trajectory | None
) -> list[str]:
    """Say what of the run could not be judged, or was not finished.

    Args:
        run: what it wrote.
        causal: what was found out about its path.
        truth: the true poses.
    """
    warnings = []
    if not run.finished:
        warnings.append("the run did not finish: what it wrote until then is judged")
    broken = int((~np.isfinite(run.trajectory.pose).all(axis=1)).sum())
    if broken:
        poses = counted(broken, "pose")
        warnings.append(f"{poses} of the trajectory with numbers that are not finite")
    if truth is not None and causal is None:
        warnings.append("no pose of the run lies within the true trajectory's time")
    if causal is not None and causal.left_out:
        warnings.append(
            f"{causal.left_out} of {len(run.trajectory)} poses have no truth: outside "
            f"its time, or in a gap of more than {MAX_TRUTH_GAP_S} s"
        )
    if (gap := odometry_gap(run)) is not None:
        warnings.append(gap.text)
    return warnings


def status_warnings(run: RunFolder, unplaced: int) -> list[str]:
    """Say where the run itself did not know where the car is.

    Args:
        run: what it wrote.
        unplaced: poses that are not judged, from before the car was found.
    """
    frames, warnings = len(run.status), []
    if unplaced:
        warnings.append(
            f"{unplaced} of {frames} frames passed until the car was found on the map: "
            "their poses are not judged"
        )
    lost = int((run.status.status == Status.LOST.value).sum())
    if lost:
        warnings.append(f"the car was LOST in {lost} of {frames} frames")
    return warnings
