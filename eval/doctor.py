"""Why a run went wrong, from what it wrote down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from conegraph.eval.alarms import alarms, unusable_input
from conegraph.eval.doctor_case import open_case
from conegraph.eval.doctor_causes import CAUSES, Cause
from conegraph.eval.doctor_evidence import Evidence
from conegraph.eval.record import Record
from conegraph.eval.run_metrics import number
from conegraph.io.run_folder import RunFolder
from conegraph.types import Trajectory

HEALTHY, UNEXPLAINED, UNCLEAR = "healthy", "unexplained", "cannot_tell"
BAD_MAP_M, BAD_SHARE = 0.2, 0.9
"""Error of a map, and precision or recall, that call for an explanation."""

SLIGHT, MANYFOLD = 1.2, 2.0
"""Times its limit up to which a figure barely exceeds it, and from which on far."""


@dataclass(frozen=True, slots=True)
class Finding(Record):
    """One thing that is wrong.

    Attributes:
        cause: in one word.
        title: in words.
        follows: whether it may well be a consequence of what is found before it.
        evidence: what was measured.
        name: what the figure behind it is.
        unit: of that figure, empty for counts and factors; of a share ``%``.
        measured: the figure; a share from 0 to 1.
        limit: what a healthy run does not exceed, likewise.
        score: measured / limit, above 1.
        at_s: the time to look at, NaN where there is none.
        advice: what to check or to configure.
    """

    cause: str
    title: str
    follows: bool
    evidence: str
    name: str
    unit: str
    measured: float
    limit: float
    score: float
    at_s: float
    advice: str


@dataclass(frozen=True, slots=True)
class Diagnosis(Record):
    """What is wrong with a run, the likeliest root first.

    Attributes:
        findings: everything that exceeds what a healthy run shows.
        notes: what could not be looked at.
        harm: what the judge found wrong with the map, empty for nothing.
        unclear: why the run cannot be called healthy, empty if it can.
    """

    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    harm: str = ""
    unclear: str = ""

    @property
    def cause(self) -> str:
        """The first finding's; without any `UNCLEAR`, `UNEXPLAINED`, or `HEALTHY`."""
        if self.findings:
            return self.findings[0].cause
        if self.unclear:
            return UNCLEAR
        return UNEXPLAINED if self.harm else HEALTHY


def diagnose(run: RunFolder, truth: Trajectory | None = None) -> Diagnosis:
    """Explain a run.

    Args:
        run: what it wrote.
        truth: the true path, in any frame; without it a wrong scale of odometry
            cannot be told from one of the ranges.
    """
    frames = min(len(run.trajectory), len(run.status))
    if frames < 2 or not np.isfinite(run.trajectory.pose).all():
        text = "the run has no path to look at: too short, or with poses that are NaN"
        return Diagnosis((), (), unclear="; ".join([*unusable_input(run), text]))
    if spoilt := unusable_input(run):
        return Diagnosis((), (), unclear="; ".join(spoilt))
    case = open_case(run, truth)
    seen = [(cause, cause.examine(case)) for cause in CAUSES]
    wrong = _ranked([(c, e) for c, e in seen if e is not None and e.score > 1.0])
    findings = tuple(
        _finding(cause, evidence, follows=cause.level > wrong[0][0].level)
        for cause, evidence in wrong
    )
    notes = []
    if len(run.observations) == 0:
        notes.append("the run kept no observations: its sensors were not looked at")
    elif case.fit is None:
        notes.append("too few cones were seen twice: the sensors were not looked at")
    if not case.has_odometry:
        notes.append("without odometry neither its faults nor those of stamps show")
    if not run.finished:
        notes.append("the run did not finish: what it wrote until then is looked at")
    return Diagnosis(findings, tuple(notes), _harm(run), "; ".join(alarms(run)))


def _ranked(wrong: list[tuple[Cause, Evidence]]) -> list[tuple[Cause, Evidence]]:
    """Sort by level, then by how far beyond its limit each is, in terms of the limit.

    What barely exceeds its limit does not explain what exceeds its own manyfold, and
    comes after all else.
    """
    worst = max((evidence.score for _, evidence in wrong), default=0.0)

    def rank(found: tuple[Cause, Evidence]) -> tuple[bool, int, float]:
        cause, evidence = found
        slight = evidence.score < SLIGHT and worst > MANYFOLD
        return slight, cause.level, -evidence.score

    return sorted(wrong, key=rank)


def _finding(cause: Cause, evidence: Evidence, *, follows: bool) -> Finding:
    return Finding(
        cause=cause.name,
        title=cause.title,
        follows=follows,
        evidence=evidence.text,
        name=evidence.name,
        unit=evidence.unit,
        measured=evidence.measured,
        limit=evidence.limit,
        score=evidence.score,
        at_s=evidence.at_s,
        advice=cause.advice,
    )


def _harm(run: RunFolder) -> str:
    """Return what the judge found wrong with the map; nothing without truth."""
    metrics = run.summary.get("metrics")
    cones = metrics.get("map") if isinstance(metrics, Mapping) else None
    if not isinstance(cones, Mapping):
        return ""
    error_m, precision, recall = (
        number(cones, key) for key in ("rmse_aligned_m", "precision", "recall")
    )
    if error_m > BAD_MAP_M or precision < BAD_SHARE or recall < BAD_SHARE:
        return (
            f"the map is {error_m:.2g} m off, with precision {precision:.2g} and "
            f"recall {recall:.2g}"
        )
    return ""
