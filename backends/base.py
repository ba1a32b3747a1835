"""What every back end offers, and what one frame yields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from conegraph.types import (
    Associations,
    ConeMap,
    ConeObservations,
    Consistency,
    Estimate,
    Lap,
    LoopClosure,
    OdometryStep,
    Revision,
    Trajectory,
    VelocityObservation,
)


@dataclass(frozen=True, slots=True)
class FrameEvents:
    """What happened in the last frame beside the estimate.

    Attributes:
        closures: loop closures tried.
        laps: laps completed.
        reason: why the status is what it is.
        stage_ms: time spent by stage.
        consistency: what the innovations of the last seconds say.
        revisions: sightings of earlier frames that were taken back, or found a cone
            after all; after `finish`, in the final solution.
        odometry: what odometry said of the motion since the frame before.
    """

    closures: tuple[LoopClosure, ...] = ()
    laps: tuple[Lap, ...] = ()
    reason: str = ""
    stage_ms: Mapping[str, float] | None = None
    consistency: Consistency = field(default_factory=Consistency)
    revisions: tuple[Revision, ...] = ()
    odometry: OdometryStep | None = None


class Backend(Protocol):
    """An estimator of the car's pose and the cone map.

    Events come in the order in which they reach the computer. Velocities are kept
    and applied in the order of their stamps when the next frame comes, so that a
    frame that arrives late is still applied at its own stamp; `estimate` looks
    ahead over velocities that are newer than the last frame.
    """

    def predict(self, stamp_s: float) -> None:
        """Ask for estimates at this stamp from now on; never moves back."""
        ...

    def observe_velocity(self, sample: VelocityObservation) -> None:
        """Take a velocity; bad ones are counted and dropped."""
        ...

    def observe_cones(self, frame: ConeObservations) -> Associations | None:
        """Take a frame of cones; None if it was stale and dropped.

        The rows of the result are those of `last_frame`, the frame as it passed
        the gate.
        """
        ...

    @property
    def last_frame(self) -> ConeObservations | None:
        """The last accepted frame, without the rows that the gate rejected."""
        ...

    @property
    def last_events(self) -> FrameEvents:
        """What happened in the last accepted frame."""
        ...

    @property
    def rejected(self) -> Mapping[str, int]:
        """Inputs that the gate rejected, counted by reason."""
        ...

    def estimate(self) -> Estimate:
        """Return the causal estimate at the last predicted or observed stamp."""
        ...

    def cone_map(self) -> ConeMap:
        """Return the confirmed cones."""
        ...

    def finish(self) -> Trajectory | None:
        """Settle everything; return the smoothed path if there is one."""
        ...
