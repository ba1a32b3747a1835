"""Whether an estimator believes itself too much, told from its own innovations."""

from __future__ import annotations

from collections import deque

from scipy.special import chdtri

from conegraph.config import StatusConfig
from conegraph.types import Consistency

WINDOW_S = 5.0
"""Time over which innovations are summed."""

FALSE_ALARM = 1e-6
"""Chance of an alarm in one frame of a filter whose model is right: at 30 frames a
second less than one in nine hours, as frames share most of their window."""


class ConsistencyMonitor:
    """Sums the normalised innovations of the last seconds and tests the sum.

    Innovations of a filter whose model is right are white, so the sum of their NIS
    over a window is chi-squared with the sum of their degrees of freedom (Bar-Shalom,
    Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    section 5.4). Overconfident is one that exceeds the 1 - `FALSE_ALARM` quantile
    and the configured ratio too: over thousands of degrees of freedom an excess of a
    few percent is certain, and no reason for alarm.
    """

    def __init__(self, config: StatusConfig) -> None:
        """Start with an empty window."""
        self._ratio = config.overconfident_ratio
        self._window: deque[tuple[float, float, int]] = deque()

    def frame(self, stamp_s: float, nis: float, dof: int) -> Consistency:
        """Take the innovation of one frame (``dof`` 0 for none); test the window."""
        if dof > 0:
            self._window.append((stamp_s, nis, dof))
        while self._window and self._window[0][0] <= stamp_s - WINDOW_S:
            self._window.popleft()
        total = sum([nis for _, nis, _ in self._window])
        freedom = sum([dof for _, _, dof in self._window])
        return judge_window(total, freedom, self._ratio)


def judge_window(nis: float, dof: int, ratio: float) -> Consistency:
    """Test a sum of NIS with so many degrees of freedom.

    Args:
        nis: the sum.
        dof: its degrees of freedom; 0 where nothing was matched.
        ratio: NIS / dof up to which no window is overconfident.
    """
    if dof == 0:
        return Consistency()
    limit = max(float(chdtri(dof, FALSE_ALARM)) / dof, ratio)
    return Consistency(nis / dof, limit, nis / dof > limit)
