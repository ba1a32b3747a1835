"""What can be configured: one frozen model a section, one docstring a key."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from conegraph.config.detector import (
    DetectorConfig,
    GroundConfig,
    LocalizationConfig,
    YoloConfig,
)
from conegraph.config.mount import MountConfig
from conegraph.config.section import (
    NonNegative,
    Positive,
    Probability,
    Profile,
    Section,
)

Coefficients = Annotated[
    tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)
]
Role = Literal["left", "right", "start", "none"]


class EkfConfig(Section):
    """The extended Kalman filter over the car and every cone (thesis chapter 4)."""

    kind: Literal["ekf"] = "ekf"
    """Which back end this section configures."""
    profile: Profile = "default"
    """`thesis` is the published method; `default` is the best that we measured."""
    invariant: bool = True
    """Keep the covariance consistent as the estimate turns; False as in the thesis."""


class Isam2Config(Section):
    """The factor graph solved by iSAM2, with a local filter in the frame path."""

    kind: Literal["isam2"] = "isam2"
    """Which back end this section configures."""
    profile: Profile = "default"
    """`thesis` takes the thesis's association and motion model into the graph."""
    invariant: bool = True
    """Keep the local filter's covariance consistent as the estimate turns."""
    update_period_s: NonNegative = 0.3
    """Time between graph updates; frames in between are tracked and kept."""
    robust_kernel: Literal["cauchy", "none"] = "cauchy"
    """Kernel on landmark factors: one wrong match must not bend the map."""
    robust_width: Positive = 3.0
    """Where the kernel starts to bend, in sigmas."""
    snapshot_margin_m: Positive = 10.0
    """Cones farther than the sensor's range plus this stay out of the local filter."""
    bounded: bool = True
    """Sum old poses up in one factor once a loop has closed; False keeps them all."""
    mapping: Literal["inline", "process"] = "inline"
    """`inline` solves the graph between two frames: the same bytes every time;
    `process` solves it beside them, so that no frame waits: for live cameras."""
    polish: bool = True
    """Solve the whole graph to convergence at the end of the run."""


BackendConfig = Annotated[EkfConfig | Isam2Config, Field(discriminator="kind")]
BACKENDS: dict[str, type[Section]] = {"ekf": EkfConfig, "isam2": Isam2Config}


class AssociationConfig(Section):
    """Which observation belongs to which cone; shared by all back ends."""

    method: Literal["sequential", "one_to_one", "jcbb", "nearest", "known"] = (
        "sequential"
    )
    """`sequential` conditions each pairing on the ones before it, `one_to_one` takes
    the likeliest assignment of a frame, `jcbb` its largest jointly compatible one,
    `nearest` is the thesis's section 4.4.3, `known` trusts the source's true ids."""
    gate_d2: Positive = 13.8
    """Largest squared Mahalanobis distance of a match; 13.8 is 0.999 of chi² at 2."""
    no_birth_d2: Positive = 25.0
    """No cone is born nearer than this to a known one: it would be a duplicate."""
    ambiguity_d2: NonNegative = 6.0
    """A match must beat every rival by this much, or nothing is matched."""
    new_margin: NonNegative = 3.0
    """A match must beat "a new cone" by this much in twice the log-likelihood, save
    with a cone that was seen just now, unless many cones stand in clusters."""
    colour: Literal["soft", "same_role"] = "soft"
    """`soft` lets colour tip the scales, `same_role` forbids other roles (thesis)."""
    colour_weight: NonNegative = 0.5
    """Weight of the colours' log-likelihood ratio beside the distance, for `soft`."""


class MotionConfig(Section):
    """How the car moves between frames; shared by all back ends."""

    integration: Literal["midpoint", "euler"] = "midpoint"
    """`euler` is the thesis's section 4.3."""
    accel_sigma_mps2: Positive = 6.0
    """Forward acceleration that the car may have, as process noise."""
    yaw_accel_sigma_radps2: Positive = 4.0
    """Yaw acceleration that the car may have, as process noise."""
    slip_sigma_m_per_sqrt_m: NonNegative = 0.003
    """Sideways random walk of the wheels' path, per square root of metre driven: at
    0.003 it is 5 cm in 300 m. A car that drifts in corners needs more."""
    use_odometry: bool = True
    """Whether velocities from outside (wheels, gyro) drive the prediction."""
    odometry_as_input: bool = True
    """Integrate odometry between frames; False corrects the state with each sample
    (thesis section 4.4.2)."""
    odometry_scale: Annotated[tuple[Positive, Positive], Field(strict=False)] = (
        1.0,
        1.0,
    )
    """Factors on the reported sigmas of odometry's speed and yaw rate."""
    odometry_hold_s: Positive = 1.1
    """How long the last odometry sample is trusted when no newer one comes; real
    logs have gaps of a second."""
    standstill: bool = True
    """Predict a car that stands, by its odometry, to stay where it is."""
    gyro_bias_sigma_radps: NonNegative | None = None
    """Prior on the bias of odometry's yaw rate; 0 leaves it out; left out, the
    source's, or else 0.01, a cheap gyro's."""
    gyro_bias_walk: NonNegative = 1e-4
    """Random walk of that bias, rad/s per square root of second."""
    start_speed_sigma_mps: NonNegative = 2.0
    """Doubt about standing still at the first frame; the thesis has none."""
    cone_velocity: bool = False
    """Also measure the velocity from cones matched in two frames (section 4.4.2)."""
    max_step_s: Positive = 1.0
    """Longest step that the prediction takes without odometry; beyond it the car
    is taken to have stopped being predictable."""


class LandmarkConfig(Section):
    """Birth, confirmation and death of cones in the map."""

    prune: bool = True
    """Delete cones that should have been seen again and were not."""
    hit_log_odds: Positive = 1.5
    """Evidence for a cone's existence from one match, times the detector's score."""
    max_log_odds: Positive = 8.0
    """Cap, so that a removed cone is forgotten within seconds."""
    delete_log_odds: float = -4.0
    """Below this a cone is deleted."""
    young_delete_log_odds: float = -1.5
    """The same for a cone with fewer than `publish_hits` matches."""
    assumed_detection_probability: Probability = 0.6
    """Chance of seeing a cone well inside the view, where the sensor gives none."""
    view_share: Annotated[float, Field(gt=0, le=1)] = 0.75
    """Share of the sensor's range in which a missing sighting counts."""
    publish_hits: Annotated[int, Field(ge=1)] = 3
    """Sightings before a cone appears in the map."""
    publish_log_odds: float = 3.0
    """Evidence before a cone appears in the map."""
    merge_d2: NonNegative = 9.0
    """Two cones never seen together and nearer than this are one; 0 never merges."""


class StartLineConfig(Section):
    """Recognising the start line, counting laps and closing the loop."""

    min_lap_m: Positive = 30.0
    """Nothing shorter is a lap."""
    half_width_m: Positive = 6.0
    """How far beside the gate's middle a crossing still counts."""
    min_closure_m: Positive = 40.0
    """Distance to drive before the start cones may close a loop."""
    closure_d2: Positive = 25.0
    """Gate on the joint innovation of the start cones, per cone."""
    min_agreement: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Share of the frame's cones that must fit the map once the loop is closed."""
    forced: bool = False
    """Match the two start cones by side alone, unchecked (thesis section 4.4.5)."""


class SensorConfig(Section):
    """The cone sensor; a key left out is taken from the source, or guessed."""

    range_sigma_m: Coefficients | None = None
    """Coefficients c0, c1, c2 of the range sigma c0 + c1 r + c2 r²."""
    bearing_sigma_rad: Positive | None = None
    """Sigma of the bearing."""
    floor_m: NonNegative | None = None
    """Isotropic position error on top."""
    max_range_m: Positive | None = None
    """Farthest range at which cones are used."""
    half_fov_rad: Positive | None = None
    """Half the horizontal field of view."""
    detection_probability: Probability | None = None
    """Chance of seeing a cone well inside the view; 0 turns pruning off."""
    noise_at: Literal["predicted", "measured"] = "predicted"
    """Range at which sigma is evaluated; `measured` shrinks maps (thesis)."""
    noise_from: Literal["source", "model"] = "source"
    """Where a cone's covariance comes from: as the `source` reports it, or from the
    sensor's `model`, the keys above."""
    scale: Positive = 1.0
    """Factor on every sigma, reported or modelled."""


class GateConfig(Section):
    """What is let into a back end; everything else is counted and dropped."""

    min_range_m: NonNegative = 0.1
    """Nearer cones are rejected."""
    max_range_m: Positive = 100.0
    """Farther cones are rejected."""
    min_sigma_m: Positive = 1e-4
    """Smaller sigmas are rejected as impossible."""
    max_sigma_m: Positive = 1e3
    """Larger sigmas are rejected as saying nothing."""
    max_speed_mps: Positive = 60.0
    """Faster odometry is rejected."""
    max_yaw_rate_radps: Positive = 20.0
    """Faster turning is rejected."""
    max_cones: Annotated[int, Field(ge=1)] = 500
    """Further cones of one frame are rejected."""


class StatusConfig(Section):
    """When the estimate counts as degraded or lost."""

    degraded_after_s: Positive = 0.5
    """Time without a matched cone."""
    lost_after_s: Positive = 2.0
    """Time without a matched cone while no odometry comes either."""
    min_matched_share: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Share of recent cones that must match for the status to be OK."""
    init_frames: Annotated[int, Field(ge=0)] = 3
    """Frames with matched cones before the status is OK."""
    overconfident_ratio: Positive = 1.25
    """Innovations over 5 s with a mean NIS per degree of freedom above this, and
    above chance, are reported as overconfident."""


class RecoveryConfig(Section):
    """Noticing that the car is lost, and finding it again on the map."""

    enabled: bool = True
    """Whether a car that is carried away, or starts anywhere on a given map, is
    looked for."""
    accept_probability: Probability = 0.99
    """Least probability of the best pose on the map."""
    reset_probability: Probability = 0.999
    """The same to move the car at once; below, a second search must agree."""
    min_inliers: Annotated[int, Field(ge=1)] = 6
    """Least number of cones that must lie on the map."""
    search_period_s: Positive = 0.25
    """Time between searches while lost."""
    lost_share: Annotated[float, Field(gt=0, lt=1)] = 0.42
    """Share of cones that fit the map below which the car is lost."""


class ViewerConfig(Section):
    """What is sent to the Rerun viewer."""

    map_period_s: NonNegative = 0.5
    """Time between full maps with their covariances."""
    picture_period_s: NonNegative = 0.2
    """Time between pictures of a camera; they make up most of a recording."""


class TrackConfig(Section):
    """From a cone map to boundaries, road and centre line."""

    profile: Profile = "default"
    """`thesis` is chapter 5 as published; `default` is the best that we measured."""
    thesis_cost: Literal["product", "sum"] = "product"
    """How equation 5.3 joins distance d and turn: d (1 + w sin) or d + w sin."""
    thesis_weight: NonNegative = 2.0
    """The weight w in equation 5.3."""
    thesis_closure_m: Positive = 6.0
    """Threshold d of the boundary closure test (thesis section 5.1.3)."""


class Roles(Section):
    """What each cone class means on the track (thesis section 4.1)."""

    blue: Role = "left"
    """Role of blue cones."""
    yellow: Role = "right"
    """Role of yellow cones."""
    orange: Role = "start"
    """Role of small orange cones."""
    big_orange: Role = "start"
    """Role of big orange cones."""
    unknown: Role = "none"
    """Role of cones without a known class."""


class Config(Section):
    """The whole configuration of a run."""

    source: str = ""
    """The SOURCE that the run read; used when the command line gives none."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of everything random in a run (simulated sources)."""
    backend: BackendConfig = EkfConfig()
    """The estimator."""
    association: AssociationConfig = AssociationConfig()
    """Data association."""
    motion: MotionConfig = MotionConfig()
    """Motion model and odometry."""
    landmarks: LandmarkConfig = LandmarkConfig()
    """Life of cones."""
    start_line: StartLineConfig = StartLineConfig()
    """Start line and laps."""
    mount: MountConfig = MountConfig()
    """Where the camera sits."""
    detector: DetectorConfig = YoloConfig()
    """What finds cones in pictures."""
    ground: GroundConfig = GroundConfig()
    """The ground plane under the camera."""
    localization: LocalizationConfig = LocalizationConfig()
    """Where a detection is on the ground."""
    sensor: SensorConfig = SensorConfig()
    """Cone sensor."""
    gate: GateConfig = GateConfig()
    """Validation of the stream."""
    status: StatusConfig = StatusConfig()
    """Health of the estimate."""
    recovery: RecoveryConfig = RecoveryConfig()
    """Noticing that the car is lost, and finding it again."""
    viewer: ViewerConfig = ViewerConfig()
    """Rerun."""
    track: TrackConfig = TrackConfig()
    """Track detection."""
    roles: Roles = Roles()
    """Cone classes and their meaning."""
