"""The tables of a run's folder in memory: one column, one array."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from conegraph.types import Array, IntArray

Names = NDArray[np.str_]
Table = TypeVar(
    "Table", "AssociationRows", "StatusRows", "MotionRows", "ObservationRows"
)


def _first(table: Table, n: int) -> Table:
    """Return a table cut to its first n rows."""
    cut = {column.name: getattr(table, column.name)[:n] for column in fields(table)}
    return replace(table, **cut)


@dataclass(frozen=True, slots=True)
class AssociationRows:
    """Row by row what became of every observation of the run.

    Attributes:
        stamp_s: (N,) the frame's stamp.
        observation: (N,) row of the cone in its frame.
        status: (N,) values of `MatchStatus`.
        landmark_id: (N,) the landmark, -1 where there is none.
        d2: (N,) squared Mahalanobis distance, NaN where there is none.
    """

    stamp_s: Array
    observation: IntArray
    status: Names
    landmark_id: IntArray
    d2: Array

    def __len__(self) -> int:
        return len(self.stamp_s)

    def first(self, n: int) -> AssociationRows:
        """Return the first n rows."""
        return _first(self, n)


@dataclass(frozen=True, slots=True)
class StatusRows:
    """The status after each frame.

    Attributes:
        stamp_s: (N,) the frame's stamp.
        status: (N,) values of `Status`.
        reason: (N,) why, empty where all is well.
        reset_counter: (N,) resets so far.
    """

    stamp_s: Array
    status: Names
    reason: tuple[str, ...]
    reset_counter: IntArray

    def __len__(self) -> int:
        return len(self.stamp_s)

    def first(self, n: int) -> StatusRows:
        """Return the first n rows."""
        return _first(self, n)


@dataclass(frozen=True, slots=True)
class ConsistencyRows:
    """The joint innovation of every frame that had one.

    Attributes:
        stamp_s: (N,) the frame's stamp.
        nis: (N,) normalised innovation squared of all its matches together.
        dof: (N,) degrees of freedom, above zero.
    """

    stamp_s: Array
    nis: Array
    dof: IntArray

    def __len__(self) -> int:
        return len(self.stamp_s)

    @classmethod
    def empty(cls) -> Self:
        """No frame at all."""
        return cls(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, slots=True)
class PoseCovariances:
    """How far each causal pose is trusted.

    Attributes:
        stamp_s: (N,) the estimate's stamp, as in the trajectory.
        cov: (N, 3, 3) covariance of x, y (m) and yaw (rad), in the run's world.
    """

    stamp_s: Array
    cov: Array

    def __len__(self) -> int:
        return len(self.stamp_s)

    def at(self, stamp_s: Array) -> Array:
        """Return the covariances (M, 3, 3) at stamps (M,), NaN where there is none."""
        found = np.full((len(stamp_s), 3, 3), np.nan)
        row = np.searchsorted(self.stamp_s, stamp_s)
        known = row < len(self)
        known[known] = self.stamp_s[row[known]] == stamp_s[known]
        found[known] = self.cov[row[known]]
        return found

    @classmethod
    def empty(cls) -> Self:
        """No pose at all."""
        return cls(np.zeros(0), np.zeros((0, 3, 3)))


@dataclass(frozen=True, slots=True)
class MotionRows:
    """What odometry said of the motion from frame to frame.

    Attributes:
        stamp_s: (N,) the frame's stamp; the estimate is of a later one where odometry
            was newer.
        odometry: (N, 3) pose increment since the frame before, in the car frame then,
            with the yaw rate as measured: m, m, rad; NaN where there was none.
        yaw_rate_bias_radps: (N,) what the estimator takes the bias of that for.
    """

    stamp_s: Array
    odometry: Array
    yaw_rate_bias_radps: Array

    def __len__(self) -> int:
        return len(self.stamp_s)

    def first(self, n: int) -> MotionRows:
        """Return the first n rows."""
        return _first(self, n)

    @classmethod
    def empty(cls) -> Self:
        """No frame at all."""
        return cls(np.zeros(0), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, slots=True)
class ObservationRows:
    """The cones of every frame as the back end took them.

    Attributes:
        stamp_s: (N,) the frame's stamp.
        observation: (N,) row of the cone in its frame.
        xy_m: (N, 2) where it was seen, car frame.
        cov_m2: (N, 2, 2) the covariance that was reported.
        cone_class: (N,) the likeliest `ConeClass`.
    """

    stamp_s: Array
    observation: IntArray
    xy_m: Array
    cov_m2: Array
    cone_class: IntArray

    def __len__(self) -> int:
        return len(self.stamp_s)

    def first(self, n: int) -> ObservationRows:
        """Return the first n rows."""
        return _first(self, n)

    @classmethod
    def empty(cls) -> Self:
        """A run without a cone."""
        none, ints = np.zeros(0), np.zeros(0, dtype=np.int64)
        return cls(none, ints, np.zeros((0, 2)), np.zeros((0, 2, 2)), ints)
