"""What is wrong with what an estimator made of its input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from conegraph.eval.doctor_case import OVERCONFIDENT, Case
from conegraph.eval.doctor_evidence import Evidence
from conegraph.eval.run_metrics import number
from conegraph.geometry import wrap_angle
from conegraph.types import Array, ConeClass, MatchStatus, Status

STANDS_OUT_SIGMA = 5.0
"""A correction of the pose beyond so many of its own sigmas is no mere drift."""

RETURN_M, RETURN_SHARE = 3.0, 0.02
"""The car has come back if it is this near to its start, and more with the way."""

DRIFT_M, DRIFT_SHARE = 1.0, 0.004
"""Doubt about the place that a healthy run has at most, and as a share of the way."""

STRANGE = 0.6
"""Share of sights that a map may not know: of one that is extended, half a track."""

LEAST_LAP_M = 30.0
CLOSES_WITHIN_M = 30.0
"""Way about a return in which a closure belongs to it."""


def _jumps(case: Case) -> tuple[Array, Array]:
    """Return how far (F,) the estimate jumped off its motion, in m and in sigmas.

    Frames in which the car was lost or found again do not count.
    """
    off = np.hypot(*(case.moved - case.motion)[:, :2].T)
    status, cov = case.run.status, case.run.pose_cov
    if len(status) == len(off):
        off[np.flatnonzero(np.diff(status.reset_counter)) + 1] = 0.0
    off[case.lost] = 0.0
    if len(cov) != len(off):
        return off, np.zeros(len(off))
    before = np.sqrt(np.maximum(cov.cov[:, 0, 0] + cov.cov[:, 1, 1], 1e-6))
    return off, off / np.concatenate([before[:1], before[:-1]])


def false_closure(case: Case) -> Evidence | None:
    """Look for a jump of the pose that neither odometry nor its own doubt allows."""
    off, sigmas = _jumps(case)
    off = np.where(sigmas > STANDS_OUT_SIGMA, off, 0.0)
    if not case.has_odometry or not off.any():
        return None
    k = int(off.argmax())
    text = (
        f"the pose jumped {off[k]:.1f} m off what odometry says, {sigmas[k]:.0f} of "
        "its own sigmas: no loop that closes rightly does so"
    )
    return Evidence(
        "jump of the pose", "m", float(off[k]), 1.0, float(case.stamp_s[k]), text
    )


def wrong_map(case: Case) -> Evidence | None:
    """Count the sights that are of no cone of the map that was given."""
    known = case.run.summary.get("known_map")
    if not isinstance(known, Mapping) or len(case.seen) == 0:
        return None
    of_map = (case.made.landmark_id >= 0) & (
        case.made.landmark_id <= number(known, "greatest_id")
    )
    strange = ~(of_map & (case.made.status == MatchStatus.MATCHED.value))
    share, status = float(strange.mean()), case.run.status
    placed = np.isin(status.status, (Status.OK.value, Status.DEGRADED.value)).mean()
    text = (
        f"{100 * share:.0f} % of the cones seen match no cone of the given map; the "
        f"car knew its place in {100 * placed:.0f} % of the frames"
    )
    at_s = case.busiest_s(strange)
    name = "sights that the given map does not know"
    return Evidence(name, "%", share, STRANGE, at_s, text)


def starved_associations(case: Case) -> Evidence | None:
    """Count the cones that were seen by a car that knew its place, in vain."""
    here = ~case.lost[case.frame]
    if not here.any():
        return None
    status = case.made.status
    bad = [MatchStatus.AMBIGUOUS.value, MatchStatus.REJECTED.value]
    idle = here & np.isin(status, bad)
    share = float(idle.sum() / here.sum())
    counts = ", ".join(f"{100 * (status[here] == s).mean():.0f} % {s}" for s in bad)
    text = f"{100 * share:.0f} % of the cones seen are of no use: {counts}"
    return Evidence("sights of no use", "%", share, 0.25, case.busiest_s(idle), text)


def split_cones(case: Case) -> Evidence | None:
    """Count the cones that were taken for several while they were in view."""
    given = case.made.landmark_id >= 0
    pair = np.column_stack([case.track, case.made.landmark_id])[given]
    if len(pair) == 0:
        return None
    found, count = np.unique(pair, axis=0, return_counts=True)
    cone, landmarks = np.unique(found[count >= 3, 0], return_counts=True)
    if len(cone) == 0:
        return None
    share = float((landmarks > 1).mean())
    torn = np.isin(case.track, cone[landmarks > 1])
    text = f"{100 * share:.0f} % of the cones were taken for two or more while in view"
    return Evidence(
        "cones taken for several", "%", share, 0.1, case.busiest_s(torn), text
    )


def drift(case: Case) -> Evidence | None:
    """Look how far the estimate itself doubts its place."""
    cov = case.run.pose_cov
    off, sigmas = _jumps(case)
    off = np.where(sigmas <= STANDS_OUT_SIGMA, off, 0.0)
    if len(cov) == 0:
        return None
    own = np.sqrt(np.maximum(cov.cov[:, 0, 0] + cov.cov[:, 1, 1], 0.0))
    k, j = int(np.argmax(own)), int(off.argmax())
    text = (
        f"the estimate itself doubts its place by up to {own[k]:.2g} m (sigma); the "
        f"greatest correction is {off[j]:.2g} m at {case.stamp_s[j]:.1f} s"
    )
    limit = max(DRIFT_M, DRIFT_SHARE * case.driven_m)
    at_s = float(cov.stamp_s[k])
    return Evidence("doubt about the place", "m", float(own[k]), limit, at_s, text)


def missed_closure(case: Case) -> Evidence | None:
    """Look for visits to the start without a loop closure, on a track with colours.

    Only a run that finished says which loops it closed.
    """
    if not case.run.finished or (case.seen.cone_class == ConeClass.UNKNOWN).all():
        return None
    pose = case.run.trajectory.pose
    way = np.cumsum(np.hypot(case.moved[:, 0], case.moved[:, 1]))
    missed, returns = [], _returns(pose, way)
    for k in returns:
        near = np.abs(np.interp(_closed_s(case), case.stamp_s, way) - way[k])
        if not case.lost[k] and not (near < CLOSES_WITHIN_M).any():
            missed.append(k)
    if not missed:
        return None
    text = (
        f"of {len(returns)} times that the car came back to its start, the loop was "
        f"not closed {len(missed)} times; {_refusals(case)}"
    )
    share, at_s = len(missed) / len(returns), float(case.stamp_s[missed[0]])
    return Evidence("returns without a closure", "%", share, 0.1, at_s, text)


def _returns(pose: Array, way: Array) -> list[int]:
    """Return the frames in which the car is back at its start, one a visit."""
    apart = np.hypot(*(pose[:, :2] - pose[0, :2]).T)
    along = np.abs(wrap_angle(pose[:, 2] - pose[0, 2])) < np.pi / 4
    back = (
        along & (apart < np.maximum(RETURN_M, RETURN_SHARE * way)) & (way > LEAST_LAP_M)
    )
    frames = np.flatnonzero(back)
    visits = np.split(frames, np.flatnonzero(np.diff(way[frames]) > LEAST_LAP_M) + 1)
    return [int(v[apart[v].argmin()]) for v in visits if len(v)]


def _closures(case: Case) -> list[Mapping[str, object]]:
    closures = case.run.summary.get("loop_closures", ())
    if not isinstance(closures, Sequence):
        return []
    return [c for c in closures if isinstance(c, Mapping)]


def _closed_s(case: Case) -> Array:
    """Return the stamps of accepted closures."""
    stamps = [c.get("stamp_s") for c in _closures(case) if c.get("accepted") is True]
    return np.array([t for t in stamps if isinstance(t, int | float)], dtype=np.float64)


def _refusals(case: Case) -> str:
    refused = [str(c.get("reason")) for c in _closures(case) if not c.get("accepted")]
    return f"refused: {refused[-1]}" if refused else "none was even tried"


def overconfidence(case: Case) -> Evidence:
    """Compare the innovations with what the filter said of them."""
    text = (
        "sights lie farther from where the estimate expects them than it allows for: "
        f"squared, and over what it allows, {case.nis_per_dof:.2f} where 1 is right"
    )
    name = "NIS per degree of freedom"
    return Evidence(name, "", case.nis_per_dof, OVERCONFIDENT, case.worst_nis_s, text)


def colourless_map(case: Case) -> Evidence | None:
    """Count the cones of the map whose colour is unknown."""
    cones = case.run.cone_map
    if len(cones) == 0:
        return None
    share = float((cones.cone_class == ConeClass.UNKNOWN).mean())
    text = (
        f"{100 * share:.0f} % of the map's cones have no colour: neither the start nor "
        "the sides of the road can be told by it"
    )
    return Evidence("cones without a colour", "%", share, 0.5, float("nan"), text)
