"""Why a run went wrong, from what it wrote down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from conegraph.eval.doctor_case import open_case
from conegraph.eval.doctor_causes import CAUSES
from conegraph.eval.record import Record
from conegraph.io.run_folder import RunFolder
from conegraph.types import Trajectory

HEALTHY = "healthy"
BAD_MAP_M = 0.2
"""Error of a map that calls for an explanation."""


@dataclass(frozen=True, slots=True)
class Finding(Record):
    """One thing that is wrong.

    Attributes:
        cause: in one word.
        title: in words.
        evidence: what was measured.
        measured: the figure behind it.
        limit: what a healthy run does not exceed, in the same unit.
        score: measured / limit, above 1.
        at_s: the time to look at, NaN where there is none.
        advice: what to check or to configure.
    """

    cause: str
    title: str
    evidence: str
    measured: float
    limit: float
    score: float
    at_s: float
    advice: str


@dataclass(frozen=True, slots=True)
class Diagnosis(Record):
    """What is wrong with a run, the likeliest root first.

    Attributes:
        findings: everything that exceeds what a healthy run shows; those further
            down may be consequences of the first.
        notes: what could not be looked at.
    """

    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    @property
    def cause(self) -> str:
        """The first finding's cause, or `HEALTHY`."""
        return self.findings[0].cause if self.findings else HEALTHY


def diagnose(run: RunFolder, truth: Trajectory | None = None) -> Diagnosis:
    """Explain a run.

    Args:
        run: what it wrote.
        truth: the true path, in any frame; without it a wrong scale of odometry
            cannot be told from one of the ranges.
    """
    if len(run.trajectory) < 2 or not np.isfinite(run.trajectory.pose).all():
        text = "the run has no path to look at: too short, or with poses that are NaN"
        return Diagnosis((), (text,))
    case = open_case(run, truth)
    found = []
    for cause in CAUSES:
        evidence = cause.examine(case)
        if evidence is None or not evidence.measured > evidence.limit:
            continue
        score = evidence.measured / evidence.limit
        finding = Finding(
            cause.name,
            cause.title,
            evidence.text,
            evidence.measured,
            evidence.limit,
            score,
            evidence.at_s,
            cause.advice,
        )
        found.append((cause.level, -score, finding))
    found.sort(key=lambda entry: entry[:2])
    notes = []
    if len(run.observations) == 0:
        notes.append("the run kept no observations: its sensors were not looked at")
    elif case.fit is None:
        notes.append("too few cones were seen twice: the sensors were not looked at")
    if not case.has_odometry:
        notes.append("without odometry neither its faults nor those of stamps show")
    if not found and (error_m := _map_error(run)) > BAD_MAP_M:
        notes.append(
            f"the map is {error_m:.2g} m off, and nothing that was found explains it"
        )
    if not run.finished:
        notes.append("the run did not finish: what it wrote until then is looked at")
    return Diagnosis(tuple(finding for _, _, finding in found), tuple(notes))


def _map_error(run: RunFolder) -> float:
    """Return the map's aligned error as the judge found it, NaN without truth."""
    metrics = run.summary.get("metrics")
    cones = metrics.get("map") if isinstance(metrics, Mapping) else None
    error = cones.get("rmse_aligned_m") if isinstance(cones, Mapping) else None
    return float(error) if isinstance(error, int | float) else float("nan")
