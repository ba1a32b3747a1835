"""What can be wrong with a run, each with its evidence and what a good run shows.

Causes come in levels. What is wrong with a sensor shows in all that follows from it,
so that it explains the rest: a bent map has twins, its loops do not close, and its
filter believes too much. Of a level, what exceeds its limit most comes first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conegraph.eval.doctor_case import Case
from conegraph.eval.doctor_sensors import NAMES, SensorFit
from conegraph.geometry import wrap_angle
from conegraph.types import Array, ConeClass, MatchStatus

SENSOR, CLOSURE, MATCHING, DRIFT, NOISE = range(5)
"""Levels: sensors first, and last what nothing else explains."""

CERTAIN = 5.0
"""Sigmas from which on a fault of calibration is more than chance."""

STANDS_OUT_SIGMA = 5.0
"""A correction of the pose beyond so many of its own sigmas is no mere drift."""

NEAR_M = 15.0
"""Detectors find cones beyond this now and then, and name them badly."""

RETURN_M, RETURN_SHARE = 3.0, 0.02
"""The car has come back if it is this near to its start, and more with the way."""

FEW_PER_M = 3.0
"""Sights per metre of way that a map wants at least."""

LEAST_LAP_M = 30.0
CLOSES_WITHIN_M = 30.0
"""Way about a return in which a closure belongs to it."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """A figure of a run beside what a good run stays below.

    Attributes:
        measured: the figure.
        limit: what a healthy run does not exceed, in the same unit.
        at_s: the time to look at, NaN where there is none.
        text: what was measured, in words.
    """

    measured: float
    limit: float
    at_s: float
    text: str


@dataclass(frozen=True, slots=True)
class Cause:
    """Something that can be wrong.

    Attributes:
        name: in one word.
        level: which causes it explains.
        title: the diagnosis in words.
        advice: what to check or to configure.
        examine: returns the evidence, None where the run cannot tell.
    """

    name: str
    level: int
    title: str
    advice: str
    examine: Callable[[Case, SensorFit | None], Evidence | None]


def _fault(
    name: str,
    limit: float,
    unit: str,
    meaning: str,
    *,
    without_odometry: float = np.inf,
) -> Callable[[Case, SensorFit | None], Evidence | None]:
    """Return what examines one of the faults that `fit_sensors` estimates.

    Args:
        name: of `NAMES`.
        limit: the greatest of a healthy run.
        unit: of the value.
        meaning: what the value says.
        without_odometry: the limit where the estimate's own motion was all there is.
    """
    k = NAMES.index(name)

    def examine(case: Case, fit: SensorFit | None) -> Evidence | None:
        if fit is None:
            return None
        value, sigma = float(fit.value[k]), float(fit.sigma[k])
        if abs(value) < CERTAIN * sigma:
            return None
        share = 100 * float(fit.gain[k])
        text = (
            f"{meaning} {value:+.3g} {unit} (sigma {sigma:.1g}), which explains "
            f"{share:.0f} % of how far sights of one cone lie apart"
        )
        most = limit if case.has_odometry else without_odometry
        return Evidence(abs(value), most, float(fit.worst_s[k]), text)

    return examine


_scale = _fault(
    "scale", 0.02, "of the way", "odometry differs from what the cones say by"
)


def _odometry_error(case: Case) -> float:
    """Return by what share odometry's way is too long; NaN where nothing can tell."""
    path = case.truth.trajectory
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


def _scale_of(culprit: str) -> Callable[[Case, SensorFit | None], Evidence | None]:
    """Return what examines the scale, blaming wheels, ranges, or without truth both."""

    def examine(case: Case, fit: SensorFit | None) -> Evidence | None:
        found = _scale(case, fit)
        if found is None or fit is None:
            return None
        wheels = _odometry_error(case)
        blamed = "either"
        if np.isfinite(wheels):
            blamed = "wheels" if abs(wheels) > 0.5 * abs(fit.value[0]) else "ranges"
            text = f"{found.text}; odometry is {100 * wheels:+.1f} % off the true way"
            found = Evidence(found.measured, found.limit, found.at_s, text)
        return found if blamed == culprit else None

    return examine


def _noise(case: Case, fit: SensorFit | None) -> Evidence | None:
    if fit is None:
        return None
    text = f"sights of one cone scatter {fit.noise:.2f} times as far as is reported"
    return Evidence(fit.noise, 1.5, _worst_nis_s(case), text)


def _wrong_colours(case: Case, fit: SensorFit | None) -> Evidence | None:
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
    return Evidence(share, 0.2, case.busiest_s(odd), text)


def _few_sights(case: Case, fit: SensorFit | None) -> Evidence | None:
    if case.driven_m < LEAST_LAP_M or len(case.seen) == 0:
        return None
    per_m = len(case.seen) / case.driven_m
    seen_s = np.unique(case.seen.stamp_s)
    gap = np.diff(np.concatenate([case.stamp_s[:1], seen_s, case.stamp_s[-1:]]))
    k = int(gap.argmax())
    start_s = float(np.concatenate([case.stamp_s[:1], seen_s])[k])
    text = (
        f"{per_m:.1f} cones are seen per metre of way (a healthy run: more than "
        f"{FEW_PER_M:g}), none at all for {gap[k]:.1f} s"
    )
    return Evidence(FEW_PER_M / per_m, 1.0, start_s, text)


def _false_detections(case: Case, fit: SensorFit | None) -> Evidence | None:
    few = _few_sights(case, fit)
    if len(case.seen) == 0 or (few is not None and few.measured > few.limit):
        return None
    _, track, count = np.unique(case.track, return_inverse=True, return_counts=True)
    near = np.hypot(*case.seen.xy_m.T) < NEAR_M
    here = near & ~case.lost[case.frame]
    alone = here & (count[track] == 1)
    share = float(alone.sum() / max(here.sum(), 1))
    text = f"{100 * share:.0f} % of what is seen is never seen again nearby"
    return Evidence(share, 0.05, case.busiest_s(alone), text)


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


def _false_closure(case: Case, fit: SensorFit | None) -> Evidence | None:
    off, sigmas = _jumps(case)
    off = np.where(sigmas > STANDS_OUT_SIGMA, off, 0.0)
    if not case.has_odometry or not off.any():
        return None
    k = int(off.argmax())
    text = (
        f"the pose jumped {off[k]:.1f} m off what odometry says, {sigmas[k]:.0f} of "
        "its own sigmas: no loop that closes rightly does so"
    )
    return Evidence(float(off[k]), 1.0, float(case.stamp_s[k]), text)


def _unmatched(case: Case, fit: SensorFit | None) -> Evidence | None:
    here = ~case.lost[case.frame]
    if not here.any():
        return None
    status = case.made.status
    bad = [MatchStatus.AMBIGUOUS.value, MatchStatus.REJECTED.value]
    idle = here & np.isin(status, bad)
    share = float(idle.sum() / here.sum())
    counts = ", ".join(f"{100 * (status[here] == s).mean():.0f} % {s}" for s in bad)
    text = f"{100 * share:.0f} % of the cones seen are of no use: {counts}"
    return Evidence(share, 0.25, case.busiest_s(idle), text)


def _split(case: Case, fit: SensorFit | None) -> Evidence | None:
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
    return Evidence(share, 0.05, case.busiest_s(torn), text)


def _drift(case: Case, fit: SensorFit | None) -> Evidence | None:
    cov = case.run.pose_cov
    off, sigmas = _jumps(case)
    off = np.where(sigmas <= STANDS_OUT_SIGMA, off, 0.0)
    if len(cov) == 0:
        return None
    own = np.sqrt(np.maximum(cov.cov[:, 0, 0] + cov.cov[:, 1, 1], 0.0))
    k, j = int(np.nanargmax(own)), int(off.argmax())
    text = (
        f"the estimate itself doubts its place by up to {own[k]:.2g} m (sigma); the "
        f"greatest correction is {off[j]:.2g} m at {case.stamp_s[j]:.1f} s"
    )
    return Evidence(float(own[k]), 1.0, float(cov.stamp_s[k]), text)


def _missed_closure(case: Case, fit: SensorFit | None) -> Evidence | None:
    pose = case.run.trajectory.pose
    way = np.cumsum(np.hypot(case.moved[:, 0], case.moved[:, 1]))
    missed = []
    for k in _returns(pose, way):
        near = np.abs(np.interp(_closed_s(case), case.stamp_s, way) - way[k])
        if not case.lost[k] and not (near < CLOSES_WITHIN_M).any():
            missed.append(k)
    if not missed:
        return None
    text = (
        f"the car came back to its start {len(missed)} times without closing the loop; "
        f"{_refusals(case)}"
    )
    return Evidence(float(len(missed)), 0.5, float(case.stamp_s[missed[0]]), text)


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


def _worst_nis_s(case: Case) -> float:
    """Return from when on NIS is greatest, over a second."""
    rows = case.run.consistency
    if len(rows) == 0:
        return float("nan")
    slot, k = np.unique(np.floor(rows.stamp_s), return_inverse=True)
    total = np.bincount(k, rows.nis) / np.maximum(np.bincount(k, rows.dof), 1)
    return float(slot[total.argmax()])


def _overconfident(case: Case, fit: SensorFit | None) -> Evidence | None:
    rows = case.run.consistency
    if len(rows) == 0:
        return None
    ratio = float(rows.nis.sum() / rows.dof.sum())
    text = f"NIS per degree of freedom is {ratio:.2f}, where 1 is right"
    return Evidence(ratio, 1.25, _worst_nis_s(case), text)


CAUSES = (
    Cause(
        "yaw_rate_bias",
        SENSOR,
        "the odometry's yaw rate is biased",
        "let the car stand for a second before it sets off, calibrate the gyro, or "
        "raise motion.gyro_bias_sigma_radps",
        _fault("yaw_rate_bias", 0.03, "rad/s", "the cones say that the gyro is off by"),
    ),
    Cause(
        "wheel_scale",
        SENSOR,
        "the odometry's speed has a wrong scale",
        "check the wheel radius and the slip of the driven wheels, or raise "
        "motion.odometry_scale",
        _scale_of("wheels"),
    ),
    Cause(
        "range_scale",
        SENSOR,
        "the sensor's ranges have a wrong scale",
        "check the baseline or depth unit of the camera and its calibration "
        "(conegraph calibrate)",
        _scale_of("ranges"),
    ),
    Cause(
        "scale",
        SENSOR,
        "odometry's speed or the sensor's ranges have a wrong scale",
        "measure a known distance: without truth the two look the same; then the wheel "
        "radius, or the camera's baseline",
        _scale_of("either"),
    ),
    Cause(
        "sensor_yaw",
        SENSOR,
        "the sensor looks another way than is assumed",
        "check the yaw of its mount: cones appear turned by this angle",
        _fault(
            "sensor_yaw", 0.015, "rad", "cones appear turned by", without_odometry=0.002
        ),
    ),
    Cause(
        "stamp_offset",
        SENSOR,
        "the frames are stamped too late or too early",
        "stamp frames when they are taken, not when they arrive, with odometry's clock",
        _fault("stamp_offset", 0.03, "s", "frames are older than their stamps by"),
    ),
    Cause(
        "sensor_noise",
        SENSOR,
        "the sensor is noisier than it says",
        "conegraph tune estimates it; or raise sensor.scale",
        _noise,
    ),
    Cause(
        "wrong_colours",
        SENSOR,
        "cones are given wrong colours",
        "check detector and light; lower association.colour_weight",
        _wrong_colours,
    ),
    Cause(
        "few_sights",
        SENSOR,
        "too few cones are seen",
        "check detector, exposure and field of view; lower "
        "landmarks.assumed_detection_probability and sensor.detection_probability",
        _few_sights,
    ),
    Cause(
        "false_detections",
        SENSOR,
        "the detector sees cones where there are none",
        "raise the detector's thresholds, or landmarks.publish_hits",
        _false_detections,
    ),
    Cause(
        "false_closure",
        CLOSURE,
        "a loop was closed where there was none",
        "set start_line.forced = false; raise start_line.min_agreement, lower "
        "start_line.closure_d2; look for orange cones away from the start",
        _false_closure,
    ),
    Cause(
        "starved_associations",
        MATCHING,
        "cones are seen, but few are matched",
        "raise association.gate_d2, lower association.ambiguity_d2",
        _unmatched,
    ),
    Cause(
        "split_cones",
        MATCHING,
        "single cones are taken for several",
        "raise association.gate_d2, association.no_birth_d2 or landmarks.merge_d2",
        _split,
    ),
    Cause(
        "drift",
        DRIFT,
        "the estimate drifted before the loop closed",
        "give it odometry, or more cones in view",
        _drift,
    ),
    Cause(
        "missed_closure",
        DRIFT,
        "the loop was not closed",
        "see that the start cones are detected; check start_line.min_closure_m and "
        "start_line.min_agreement",
        _missed_closure,
    ),
    Cause(
        "overconfidence",
        NOISE,
        "the estimate believes itself too much",
        "conegraph tune estimates the noise; else raise "
        "motion.slip_sigma_m_per_sqrt_m or motion.odometry_scale",
        _overconfident,
    ),
)
"""Everything that is looked for."""
