"""The vocabulary of the project: frozen values that travel between its parts.

Units are in the names (``_m``, ``_s``, ``_rad``, ``_mps``, ``_radps``). The car
frame has x forward, y left, z up (REP-103); yaw is counter-clockwise in
(-pi, pi]; the world frame is the car's pose at the start unless a map is given.
Shapes are checked here; whether the numbers make sense is checked by the one
gate in front of the back ends, because bad data in a stream must not raise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Mask = NDArray[np.bool_]

N_CLASSES = 5


class ConeClass(IntEnum):
    """What a cone looks like; the index into every ``class_prob`` row."""

    BLUE = 0
    YELLOW = 1
    ORANGE = 2
    BIG_ORANGE = 3
    UNKNOWN = 4

    @property
    def label(self) -> str:
        """The lower-case name that files use."""
        return self.name.lower()


CLASS_LABELS: tuple[str, ...] = tuple(c.label for c in ConeClass)


class Status(StrEnum):
    """How far the estimate can be trusted."""

    INIT = "INIT"
    OK = "OK"
    DEGRADED = "DEGRADED"
    LOST = "LOST"


class MatchStatus(StrEnum):
    """What became of one observation."""

    MATCHED = "matched"
    NEW = "new"
    TENTATIVE = "tentative"
    AMBIGUOUS = "ambiguous"
    REJECTED = "rejected"


def _shaped(
    owner: object,
    name: str,
    value: ArrayLike,
    shape: tuple[int, ...],
    dtype: type[np.generic] = np.float64,
) -> None:
    """Store a read-only array of a given shape (-1 first is any) on a frozen value."""
    array: NDArray[Any] = np.asarray(value, dtype=dtype).view()
    if array.size == 0 and shape[0] in (-1, 0):
        array = array.reshape(0, *(max(n, 0) for n in shape[1:]))
    fits = array.shape == shape or (
        array.ndim == len(shape) and shape[0] == -1 and array.shape[1:] == shape[1:]
    )
    if not fits:
        wanted = tuple("N" if n == -1 else n for n in shape)
        kind = type(owner).__name__
        raise ValueError(
            f"{kind}.{name} must have shape {wanted}, but got {array.shape}"
        )
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


@dataclass(frozen=True, slots=True)
class ConeObservations:
    """The cones of one frame, seen from the car at the sensor's stamp.

    Attributes:
        stamp_s: time of the measurement.
        xy_m: (N, 2) positions in the car frame.
        cov_m2: (N, 2, 2) their covariances, as the detector reports them.
        class_prob: (N, 5) probabilities in the order of `ConeClass`.
        truth_id: (N,) id of the true cone, -1 for a false detection; None where
            the source has no truth.
        score: (N,) how sure the detector is that each is a cone, 0 to 1; None where
            it does not say.
    """

    stamp_s: float
    xy_m: Array
    cov_m2: Array
    class_prob: Array
    truth_id: IntArray | None = None
    score: Array | None = None

    def __post_init__(self) -> None:
        _shaped(self, "xy_m", self.xy_m, (-1, 2))
        n = len(self.xy_m)
        _shaped(self, "cov_m2", self.cov_m2, (n, 2, 2))
        _shaped(self, "class_prob", self.class_prob, (n, N_CLASSES))
        if self.truth_id is not None:
            _shaped(self, "truth_id", self.truth_id, (n,), np.int64)
        if self.score is not None:
            _shaped(self, "score", self.score, (n,))

    def __len__(self) -> int:
        return len(self.xy_m)

    @property
    def evidence(self) -> Array:
        """(N,) how much each counts as a sighting of a cone, 0 to 1."""
        return np.ones(len(self)) if self.score is None else self.score

    def subset(self, keep: NDArray[np.bool_] | IntArray) -> ConeObservations:
        """Return the rows that ``keep`` (mask or indices) selects."""
        return ConeObservations(
            self.stamp_s,
            self.xy_m[keep],
            self.cov_m2[keep],
            self.class_prob[keep],
            None if self.truth_id is None else self.truth_id[keep],
            None if self.score is None else self.score[keep],
        )


@dataclass(frozen=True, slots=True)
class VelocityObservation:
    """Forward speed u and yaw rate r at a stamp, with covariance (2, 2) in (u, r).

    Wheel odometry with a gyro and cone visual odometry both arrive as this. The
    covariance is that of one sample; errors of successive samples are taken as
    independent, so a sensor with noise density q sampled every dt reports q / dt.
    Between samples the velocity is taken to change linearly.
    """

    stamp_s: float
    u_mps: float
    r_radps: float
    cov: Array

    def __post_init__(self) -> None:
        _shaped(self, "cov", self.cov, (2, 2))


Event = ConeObservations | VelocityObservation


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a back end believes about the car at a stamp.

    Attributes:
        stamp_s: time the estimate speaks of.
        pose: (3,) x_m, y_m, yaw_rad of the car in the world.
        pose_cov: (3, 3) its covariance.
        velocity: (2,) u_mps, r_radps in the car frame.
        status: how far it can be trusted.
        reset_counter: how many times the estimate jumped by a reset.
    """

    stamp_s: float
    pose: Array
    pose_cov: Array
    velocity: Array
    status: Status = Status.OK
    reset_counter: int = 0

    def __post_init__(self) -> None:
        _shaped(self, "pose", self.pose, (3,))
        _shaped(self, "pose_cov", self.pose_cov, (3, 3))
        _shaped(self, "velocity", self.velocity, (2,))


@dataclass(frozen=True, slots=True)
class Associations:
    """What a back end made of the cones of one frame, row by row.

    Attributes:
        stamp_s: the frame's stamp.
        status: (N,) one `MatchStatus` each.
        landmark_id: (N,) id of the landmark, -1 where there is none.
        d2: (N,) squared Mahalanobis distance to it (or to the nearest), NaN if none.
        nis: normalised innovation squared of the joint update, before any doubt was
            added because of it; NaN without one.
        nis_dof: its degrees of freedom.
    """

    stamp_s: float
    status: tuple[MatchStatus, ...]
    landmark_id: IntArray
    d2: Array
    nis: float = float("nan")
    nis_dof: int = 0

    def __post_init__(self) -> None:
        n = len(self.status)
        _shaped(self, "landmark_id", self.landmark_id, (n,), np.int64)
        _shaped(self, "d2", self.d2, (n,))


@dataclass(frozen=True, slots=True)
class ConeMap:
    """Cones with positions in the world, covariances and class probabilities.

    Attributes:
        id: (N,) landmark ids, unique.
        xy_m: (N, 2) positions.
        cov_m2: (N, 2, 2) covariances.
        class_prob: (N, 5) class probabilities.
        observations: (N,) how often each was seen.
    """

    id: IntArray
    xy_m: Array
    cov_m2: Array
    class_prob: Array
    observations: IntArray

    def __post_init__(self) -> None:
        _shaped(self, "id", self.id, (-1,), np.int64)
        n = len(self.id)
        _shaped(self, "xy_m", self.xy_m, (n, 2))
        _shaped(self, "cov_m2", self.cov_m2, (n, 2, 2))
        _shaped(self, "class_prob", self.class_prob, (n, N_CLASSES))
        _shaped(self, "observations", self.observations, (n,), np.int64)

    def __len__(self) -> int:
        return len(self.id)

    @property
    def cone_class(self) -> IntArray:
        """(N,) the most probable `ConeClass` of each cone."""
        best: IntArray = self.class_prob.argmax(axis=1).astype(np.int64)
        return best

    def subset(self, keep: NDArray[np.bool_] | IntArray) -> ConeMap:
        """Return the rows that ``keep`` (mask or indices) selects."""
        return ConeMap(
            self.id[keep],
            self.xy_m[keep],
            self.cov_m2[keep],
            self.class_prob[keep],
            self.observations[keep],
        )

    @staticmethod
    def empty() -> ConeMap:
        """A map without cones."""
        none = np.zeros(0)
        return ConeMap(none.astype(np.int64), none, none, none, none.astype(np.int64))


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses over time: stamps (N,) ascending, poses (N, 3) as x_m, y_m, yaw_rad."""

    stamp_s: Array
    pose: Array

    def __post_init__(self) -> None:
        _shaped(self, "stamp_s", self.stamp_s, (-1,))
        _shaped(self, "pose", self.pose, (len(self.stamp_s), 3))

    def __len__(self) -> int:
        return len(self.stamp_s)


@dataclass(frozen=True, slots=True)
class TruthMap:
    """True cones: ids (N,), positions (N, 2) and classes (N,) of `ConeClass`."""

    id: IntArray
    xy_m: Array
    cone_class: IntArray

    def __post_init__(self) -> None:
        _shaped(self, "id", self.id, (-1,), np.int64)
        _shaped(self, "xy_m", self.xy_m, (len(self.id), 2))
        _shaped(self, "cone_class", self.cone_class, (len(self.id),), np.int64)

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, slots=True)
class TrackLayout:
    """A track as a file or a generator describes it, in the file's own frame.

    Attributes:
        name: short name, the file's stem for files.
        xy_m: (N, 2) cones.
        cone_class: (N,) of `ConeClass`.
        start_pose: (3,) the car at the start, None where the file has none.
        closed: whether the track is a loop.
        centerline_m: (K, 2) the line to drive, None where it must be found.
        in_driving_order: whether the cones of each colour are listed so.
        dropped: what was left out on reading, counted by reason.
    """

    name: str
    xy_m: Array
    cone_class: IntArray
    start_pose: Array | None = None
    closed: bool = True
    centerline_m: Array | None = None
    in_driving_order: bool = False
    dropped: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _shaped(self, "xy_m", self.xy_m, (-1, 2))
        _shaped(self, "cone_class", self.cone_class, (len(self.xy_m),), np.int64)
        if self.start_pose is not None:
            _shaped(self, "start_pose", self.start_pose, (3,))
        if self.centerline_m is not None:
            _shaped(self, "centerline_m", self.centerline_m, (-1, 2))

    def __len__(self) -> int:
        return len(self.xy_m)


@dataclass(frozen=True, slots=True)
class SensorModel:
    """How the accuracy and the view of a cone sensor depend on range.

    The range sigma is ``c0 + c1 r + c2 r^2``; the covariance in the car frame is
    that of (range, bearing) plus ``floor_m**2`` in every direction.

    Attributes:
        range_sigma_m: (3,) the coefficients c0, c1, c2 of the range sigma.
        bearing_sigma_rad: sigma of the bearing.
        floor_m: sigma of an isotropic position error added to both.
        min_range_m: nearest range at which cones are reported.
        max_range_m: farthest range at which cones are reported.
        half_fov_rad: half the horizontal field of view.
        detection_probability: chance that a cone well inside the view is
            reported; 0 means that a missing report says nothing; None unknown.
    """

    range_sigma_m: Array
    bearing_sigma_rad: float
    floor_m: float = 0.0
    min_range_m: float = 0.1
    max_range_m: float = 50.0
    half_fov_rad: float = float(np.pi)
    detection_probability: float | None = None

    def __post_init__(self) -> None:
        _shaped(self, "range_sigma_m", self.range_sigma_m, (3,))

    def covariance(self, xy_m: Array) -> Array:
        """Return the covariance (N, 2, 2) of cones at (N, 2) in the car frame.

        With e the direction to the cone, n its normal and r the range::

            R = (c0 + c1 r + c2 r^2)^2 e e^T + (r sigma_b)^2 n n^T + floor^2 I

        Evaluated at the *predicted* position it is free of the pull that the noise
        of a measured range has on its own weight. At r = 0, e is taken as forward.
        """
        x, y = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2).T
        r = np.hypot(x, y)
        far = r > 0
        c = np.where(far, x, 1.0) / np.where(far, r, 1.0)
        s = np.where(far, y, 0.0) / np.where(far, r, 1.0)
        c0, c1, c2 = self.range_sigma_m
        along = (c0 + r * (c1 + r * c2)) ** 2
        across = (r * self.bearing_sigma_rad) ** 2
        floor = self.floor_m**2
        R = np.empty((len(r), 2, 2))
        R[:, 0, 0] = c * c * along + s * s * across + floor
        R[:, 1, 1] = s * s * along + c * c * across + floor
        R[:, 0, 1] = R[:, 1, 0] = c * s * (along - across)
        return R


class StreamInfo(Protocol):
    """What is known of a stream beside its events."""

    @property
    def name(self) -> str:
        """Short name for titles."""
        ...

    @property
    def n_frames(self) -> int | None:
        """How many cone frames will come, None when nobody knows."""
        ...

    @property
    def sensor(self) -> SensorModel | None:
        """The cone sensor where the source knows it."""
        ...

    @property
    def yaw_rate_bias_radps(self) -> float | None:
        """Sigma of the bias of odometry's yaw rate, None where nobody knows."""
        ...

    @property
    def ids_are_given(self) -> bool:
        """Whether the stream is published with its associations already made."""
        ...

    @property
    def truth_trajectory(self) -> Trajectory | None:
        """True poses, in any world frame."""
        ...

    @property
    def truth_map(self) -> TruthMap | None:
        """True cones, in the frame of `truth_trajectory`."""
        ...

    @property
    def rejected(self) -> Mapping[str, int]:
        """Rows that were left out on reading, counted by reason."""
        ...


class Source(StreamInfo, Protocol):
    """Anything that yields events in order, with whatever truth it has."""

    def events(self) -> Iterator[Event]:
        """Yield the events, ordered as they reach the computer."""
        ...


@dataclass(frozen=True, slots=True)
class Recording:
    """A finished stream held in memory; it is a `Source`."""

    name: str
    stream: tuple[Event, ...]
    sensor: SensorModel | None = None
    truth_trajectory: Trajectory | None = None
    truth_map: TruthMap | None = None
    rejected: Mapping[str, int] = field(default_factory=dict)
    yaw_rate_bias_radps: float | None = None
    ids_are_given: bool = False

    @property
    def n_frames(self) -> int:
        """How many cone frames it holds."""
        return sum(isinstance(e, ConeObservations) for e in self.stream)

    def events(self) -> Iterator[Event]:
        """Yield the events as stored."""
        return iter(self.stream)


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """One attempt to recognise the start line again.

    Attributes:
        stamp_s: when.
        distance_m: how far the car had driven since the last one.
        accepted: whether it was trusted.
        reason: what it was accepted on, or why it was refused.
    """

    stamp_s: float
    distance_m: float
    accepted: bool
    reason: str


@dataclass(frozen=True, slots=True)
class Lap:
    """One completed lap: number from 1, and when the line was crossed."""

    number: int
    start_s: float
    end_s: float

    @property
    def duration_s(self) -> float:
        """The lap time."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class Consistency:
    """What the innovations of the last seconds say about the noise assumed.

    Attributes:
        nis_per_dof: their NIS over their degrees of freedom, about 1 where the noise
            is as assumed; NaN without any.
        limit: the value above which chance and small faults do not explain it.
        overconfident: whether it is above.
    """

    nis_per_dof: float = float("nan")
    limit: float = float("nan")
    overconfident: bool = False


@dataclass(frozen=True, slots=True)
class OdometryStep:
    """What odometry said of the motion since the frame before.

    Attributes:
        delta: (3,) pose increment in the car frame at its start, the yaw rate as
            measured; zero for a car that was taken to stand.
        yaw_rate_bias_radps: what the estimator takes the bias of that yaw rate for.
    """

    delta: Array
    yaw_rate_bias_radps: float

    def __post_init__(self) -> None:
        _shaped(self, "delta", self.delta, (3,))


@dataclass(frozen=True, slots=True)
class Revision:
    """Sightings of an earlier frame that later ones made look different.

    Attributes:
        stamp_s: that frame's stamp.
        observation: (N,) their rows in it, as it passed the gate.
        landmark_id: (N,) the cones that they were taken for, or now are.
        d2: (N,) squared Mahalanobis distances to these in the solution.
        status: `REJECTED` where they did not stand the test after the fact,
            `MATCHED` where they had been left aside and now are sure.
        closure: whether a loop that they had closed at the start line is undone.
    """

    stamp_s: float
    observation: IntArray
    landmark_id: IntArray
    d2: Array
    status: MatchStatus = MatchStatus.REJECTED
    closure: bool = False

    def __post_init__(self) -> None:
        _shaped(self, "observation", self.observation, (-1,), np.int64)
        n = len(self.observation)
        _shaped(self, "landmark_id", self.landmark_id, (n,), np.int64)
        _shaped(self, "d2", self.d2, (n,))


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """Everything that is written down about one cone frame.

    Attributes:
        observations: the cones as they passed the gate.
        associations: what was made of them.
        estimate: the causal estimate after the frame.
        reason: why the status is what it is, empty when OK.
        closures: loop closures tried in this frame.
        laps: laps completed in this frame.
        stage_ms: time spent by stage, in ms; the key ``frame`` is the whole.
        consistency: what the innovations of the last seconds say.
        revisions: sightings of earlier frames that were taken back in this one, or
            found a cone after all.
        odometry: what odometry said, None without any.
    """

    observations: ConeObservations
    associations: Associations
    estimate: Estimate
    reason: str = ""
    closures: tuple[LoopClosure, ...] = ()
    laps: tuple[Lap, ...] = ()
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    consistency: Consistency = field(default_factory=Consistency)
    revisions: tuple[Revision, ...] = ()
    odometry: OdometryStep | None = None
