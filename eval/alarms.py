"""What makes every figure of a run worth little, and is said before them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from conegraph.eval.run_metrics import number
from conegraph.io.run_folder import RunFolder
from conegraph.types import Status

SLOW_S = 10.0
"""No sensor is that slow: stamps are of another unit."""

HINTS = {
    "frame: stamp leaps ahead": "are stamps in seconds, and not in milliseconds?",
    "frame: stamp does not increase": "are stamps rounded, or rows out of order?",
    "cones.csv: stamp goes backwards": "are its rows in order?",
    "cone: too far": "are x and y in metres?",
    "cone: covariance unusable": "are covariances in square metres?",
}
"""What may be behind a reason for which most of the input is left out."""


def alarms(run: RunFolder) -> tuple[str, ...]:
    """Say what makes the figures of a run worth little, empty of a sound one."""
    status = run.status.status
    if len(status) and (status == Status.INIT.value).all():
        reason = run.status.reason[-1] or "it never knew where the car is"
        return (*unusable_input(run), f"the status was INIT to the end: {reason}")
    return unusable_input(run)


def unusable_input(run: RunFolder) -> tuple[str, ...]:
    """Say where most of what a run was fed was left out, or has impossible stamps."""
    frames = len(run.trajectory)
    # An older run has no observations; what became of each it has.
    cones = max(len(run.observations), len(run.associations))
    found = [
        _mostly_left_out(run.summary, "frames", ("frame: ",), frames),
        _mostly_left_out(run.summary, "cones", ("cone: ", "cones.csv: "), cones),
    ]
    if frames > 1:
        apart_s = float(np.median(np.diff(run.trajectory.stamp_s)))
        if apart_s > SLOW_S:
            found.append(
                f"frames are {apart_s:.3g} s apart: {HINTS['frame: stamp leaps ahead']}"
            )
    return tuple(said for said in found if said)


def _mostly_left_out(
    summary: Mapping[str, object], what: str, kinds: tuple[str, ...], kept: int
) -> str:
    """Return a sentence if fewer were kept than left out, else nothing."""
    counts = summary.get("rejected")
    if not isinstance(counts, Mapping):
        return ""
    lost = {r: number(counts, r) for r in counts if str(r).startswith(kinds)}
    total = sum(lost.values())
    if not kept < total < math.inf:
        return ""
    worst = max(lost, key=lambda reason: lost[reason])
    hint = f"; {HINTS[worst]}" if worst in HINTS else ""
    lost_share = f"{total:.0f} of {total + kept:.0f} {what} were left out"
    return f"{lost_share}, most of them for: {worst}{hint}"
