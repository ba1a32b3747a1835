"""The extended Kalman filter over the car and every cone (thesis chapter 4)."""

from __future__ import annotations

from conegraph.backends.base import FrameEvents
from conegraph.backends.tracker import Tracker
from conegraph.types import Trajectory


class EkfBackend(Tracker):
    """The shared frame path holding the whole map: that *is* the thesis's filter.

    Prediction, joint correction and landmark addition are in `LandmarkFilter`
    (sections 4.3, 4.4.1, 4.4.4), association in `association` (4.4.3), velocity
    from cones in `velocity` (4.4.2), the start line in `closure` (4.4.5). With
    `add_cones` off it only localises (section 4.5).
    """

    has_mapper = False

    def finish(self) -> Trajectory | None:
        """Nothing is left to settle: a filter has no smoothed path."""
        self.last_events = FrameEvents()
        return None
