"""What is wrong with what a run was fed: odometry, stamps, calibration, detections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from conegraph.eval.doctor_case import OVERCONFIDENT, Case
from conegraph.eval.doctor_evidence import Evidence, Examine
from conegraph.eval.doctor_fit import NAMES
from conegraph.eval.odometry_gap import LONGEST_S, odometry_gap
from conegraph.types import ConeClass

CERTAIN = 5.0
"""Sigmas from which on a fault of calibration is more than chance."""

EXPLAINS = 0.25
"""Share of the spread that a fault explains at least if no filter was surprised: real
errors are not white, and a fit finds something in them."""

NEAR_M = 15.0
"""Detectors find cones beyond this now and then, and name them badly."""

FEW_PER_M = 3.0
"""Sights per metre of way that a map wants at least."""

MISSED = 0.5
"""Share of looks at a near cone, from its first sight to its last, that may miss it:
with 40 % missed maps are still whole, with 60 % a third of the cones is gone."""

OFTEN, FEWEST = 5, 10
"""Sights of a cone, and such cones, that tell how often one is missed."""

LEAST_WAY_M = 30.0
"""A car that drove less has not seen much."""


def fault_of(
    name: str,
    limit: float,
    unit: str,
    meaning: str,
    *,
    without_odometry: float = np.inf,
) -> Examine:
    """Return what examines one of the faults that `fit_sensors` estimates.

    Args:
        name: of `NAMES`.
        limit: the greatest of a healthy run.
        unit: of the value.
        meaning: what the value says.
        without_odometry: the limit where the estimate's own motion was all there is.
    """
    k = NAMES.index(name)

    def examine(case: Case) -> Evidence | None:
        fit = case.fit
        if fit is None:
            return None
        value, sigma = float(fit.value[k]), float(fit.sigma[k])
        slight = fit.gain[k] < EXPLAINS and case.nis_per_dof < OVERCONFIDENT
        if slight or abs(value) < CERTAIN * sigma:
            return None
        share = 100 * float(fit.gain[k])
        shown = 100 if unit == "%" else 1
        text = (
            f"{meaning} {shown * value:+.3g} {unit} (sigma {shown * sigma:.1g}), which "
            f"explains {share:.0f} % of how far sights of one cone lie apart"
        )
        most = limit if case.has_odometry else without_odometry
        size, at_s = abs(value), float(fit.worst_s[k])
        return Evidence(name.replace("_", " "), unit, size, most, at_s, text)

    return examine


_scale = fault_of(
    "scale", 0.02, "%", "odometry's way differs from what the cones say by"
)


def _odometry_error(case: Case) -> float:
    """Return by what share odometry's way is too long; NaN where nothing can tell."""
    path = case.truth
    if path is None or not case.has_odometry:
        return float("nan")
    way = np.concatenate(
        [[0.0], np.cumsum(np.hypot(*np.diff(path.pose[:, :2], axis=0).T))]
    )
    known = (case.stamp_s >= path.stamp_s[0]) & (case.stamp_s <= path.stamp_s[-1])
    at = np.flatnonzero(known)
    if len(at) < 2:
        return float("nan")
    first, last = np.interp(case.stamp_s[at[[0, -1]]], path.stamp_s, way)
    told = float(np.hypot(*case.motion[at[0] + 1 : at[-1] + 1, :2].T).sum())
    return told / (last - first) - 1.0 if last > first else float("nan")


def scale_of(culprit: str) -> Examine:
    """Return what examines the scale, blaming wheels, ranges, or without truth both."""

    def examine(case: Case) -> Evidence | None:
        found, fit = _scale(case), case.fit
        if found is None or fit is None:
            return None
        wheels = _odometry_error(case)
        blamed = "either"
        if np.isfinite(wheels):
            blamed = "wheels" if abs(wheels) > 0.5 * abs(fit.value[0]) else "ranges"
            text = f"{found.text}; odometry is {100 * wheels:+.1f} % off the true way"
            found = replace(found, text=text)
        return found if blamed == culprit else None

    return examine


def silent_odometry(case: Case) -> Evidence | None:
    """Look for a time without odometry in which the car went on."""
    gap = odometry_gap(case.run)
    if gap is None:
        return None
    name = "time without odometry"
    return Evidence(name, "s", gap.length_s, LONGEST_S, gap.start_s, gap.text)


def sensor_noise(case: Case) -> Evidence | None:
    """Compare how sights of one cone scatter with what is reported."""
    fit = case.fit
    if fit is None:
        return None
    text = f"sights of one cone scatter {fit.noise:.2f} times as far as is reported"
    name = "scatter beside what is reported"
    return Evidence(name, "times", fit.noise, 1.5, case.worst_nis_s, text)


def wrong_colours(case: Case) -> Evidence | None:
    """Count the sights of cones in another colour than their usual one."""
    near = np.hypot(*case.seen.xy_m.T) < NEAR_M
    named = near & (case.seen.cone_class != ConeClass.UNKNOWN)
    _, track = np.unique(case.track, return_inverse=True)
    count = np.zeros((int(track.max(initial=-1)) + 1, len(ConeClass)))
    np.add.at(count, (track[named], case.seen.cone_class[named]), 1)
    often = count.sum(axis=1) >= 5
    if not often.any():
        return None
    odd = named & often[track] & (case.seen.cone_class != count.argmax(axis=1)[track])
    share = float(odd.sum() / count[often].sum())
    text = f"{100 * share:.0f} % of the sights of a cone disagree with its usual colour"
    return Evidence(
        "sights in another colour", "%", share, 0.2, case.busiest_s(odd), text
    )


def few_sights(case: Case) -> Evidence | None:
    """Count the sights per metre of way, and the looks at a cone that miss it."""
    missed = _missed_looks(case)
    if missed is not None and missed.measured > missed.limit:
        return missed
    return _sights_per_way(case)


def _missed_looks(case: Case) -> Evidence | None:
    """Count the frames between a cone's first and last sight in which it is missed.

    Without odometry the estimate's own motion says which sights show one cone, so that
    a bad estimate would look like missed cones.
    """
    near = np.hypot(*case.seen.xy_m.T) < NEAR_M
    frame = case.frame[near]
    _, track, count = np.unique(
        case.track[near], return_inverse=True, return_counts=True
    )
    often = count >= OFTEN
    if not case.has_odometry or often.sum() < FEWEST:
        return None
    first = np.full(len(count), len(case.stamp_s))
    last = np.zeros(len(count), dtype=np.int64)
    np.minimum.at(first, track, frame)
    np.maximum.at(last, track, frame)
    looks = (last - first - 1)[often]
    share = 1.0 - float((count[often] - 2).sum() / looks.sum())
    worst = np.flatnonzero(often)[np.argmax(looks - count[often])]
    at_s = float(case.stamp_s[first[worst]])
    percent = 100 * share
    text = f"from first to last sight a cone is missed in {percent:.0f} % of the frames"
    return Evidence("looks at a cone that miss it", "%", share, MISSED, at_s, text)


def _sights_per_way(case: Case) -> Evidence | None:
    if case.driven_m < LEAST_WAY_M or len(case.seen) == 0:
        return None
    per_m = len(case.seen) / case.driven_m
    seen_s = np.unique(case.seen.stamp_s)
    gap = np.diff(np.concatenate([case.stamp_s[:1], seen_s, case.stamp_s[-1:]]))
    k = int(gap.argmax())
    start_s = float(np.concatenate([case.stamp_s[:1], seen_s])[k])
    text = (
        f"{per_m:.1f} cones are seen per metre of way, none at all for {gap[k]:.1f} s"
    )
    return Evidence("way per sight", "m", 1.0 / per_m, 1.0 / FEW_PER_M, start_s, text)


def false_detections(case: Case) -> Evidence | None:
    """Count what is seen but once; cones seen too seldom look the same."""
    few = few_sights(case)
    if len(case.seen) == 0 or (few is not None and few.measured > few.limit):
        return None
    _, track, count = np.unique(case.track, return_inverse=True, return_counts=True)
    near = np.hypot(*case.seen.xy_m.T) < NEAR_M
    here = near & ~case.lost[case.frame]
    alone = here & (count[track] == 1)
    share = float(alone.sum() / max(here.sum(), 1))
    text = f"{100 * share:.0f} % of what is seen is never seen again nearby"
    return Evidence(
        "sights of what is not seen again",
        "%",
        share,
        0.05,
        case.busiest_s(alone),
        text,
    )
