"""A simulated drive as an RGB-D camera on the car sees it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from conegraph.camera import RgbdFrame
from conegraph.geometry import wrap_angle
from conegraph.sim.drive import even_stamps, plan_drive, seen_from, true_path
from conegraph.sim.odometry import OdometrySensor, read_odometry
from conegraph.sim.render import (
    D435,
    CarState,
    FrameTruth,
    LightName,
    Rig,
    Scene,
    draw_light,
    make_scene,
    render_frame,
)
from conegraph.sim.render_pool import rendered
from conegraph.sim.vehicle import Motion, VehicleModel
from conegraph.types import (
    Array,
    Event,
    SensorModel,
    TrackLayout,
    Trajectory,
    TruthMap,
    VelocityObservation,
)

CAMERA_HZ = 15.0


@dataclass(frozen=True, slots=True)
class Suspension:
    """How the car's body leans under way.

    Attributes:
        pitch_per_mps2: pitch for each m/s2 of deceleration, in rad.
        roll_per_mps2: roll, outwards, for each m/s2 of lateral acceleration.
        shake_rad: sigma of pitch and roll from the road's bumps.
        settle_s: over which the body follows.
    """

    pitch_per_mps2: float = float(np.radians(0.14))
    roll_per_mps2: float = float(np.radians(0.12))
    shake_rad: float = float(np.radians(0.1))
    settle_s: float = 0.15


@dataclass(frozen=True, slots=True)
class CameraDrive:
    """A drive whose pictures are rendered when their turn comes; a `Stream`.

    Attributes:
        name: the track's name.
        scene: the world, in the frame of the car at its start.
        rig: the camera.
        pose_world_car: (F, 3) true poses at the frames.
        cars: how the car moves at each.
        velocities: odometry, empty without it.
        seed: makes the noise of every picture.
        workers: processes that render, see `rendered`.
        truth_trajectory: true poses.
        truth_map: true cones.
        sensor: None, the front end knows better.
        yaw_rate_bias_radps: None, as with a real log.
        ids_are_given: False, pictures have none.
    """

    name: str
    scene: Scene
    rig: Rig
    pose_world_car: Array
    cars: tuple[CarState, ...]
    velocities: tuple[VelocityObservation, ...]
    seed: int
    truth_trajectory: Trajectory
    truth_map: TruthMap
    sensor: SensorModel | None = None
    yaw_rate_bias_radps: float | None = None
    ids_are_given: bool = False
    workers: int = 1

    @property
    def n_frames(self) -> int:
        """How many pictures there are."""
        return len(self.cars)

    @property
    def rejected(self) -> Mapping[str, int]:
        """Nothing is ever left out."""
        return {}

    def render(self, index: int) -> tuple[RgbdFrame, FrameTruth]:
        """Return a picture and its truth; the same whatever was rendered before."""
        rng = np.random.default_rng([self.seed, index])
        return render_frame(
            self.scene,
            self.pose_world_car[index],
            rng,
            rig=self.rig,
            car=self.cars[index],
        )

    def frame(self, index: int) -> RgbdFrame:
        """Return a picture alone."""
        return self.render(index)[0]

    def events(self) -> Iterator[Event | RgbdFrame]:
        """Yield odometry and pictures by stamp, odometry first where they tie."""
        waiting = 0
        for frame in rendered(self.frame, self.n_frames, self.workers):
            while (
                waiting < len(self.velocities)
                and self.velocities[waiting].stamp_s <= frame.stamp_s
            ):
                yield self.velocities[waiting]
                waiting += 1
            yield frame
        yield from self.velocities[waiting:]


def drive_with_camera(
    layout: TrackLayout,
    *,
    laps: int = 2,
    seed: int = 0,
    rate_hz: float = CAMERA_HZ,
    light: LightName | None = None,
    rig: Rig = D435,
    vehicle: VehicleModel | None = None,
    odometry: OdometrySensor | None = None,
    suspension: Suspension | None = None,
    clutter: int | None = None,
) -> CameraDrive:
    """Drive a track with an RGB-D camera on the car.

    Path and odometry are those of `simulate` with the same seed. The body pitches
    when the car brakes, rolls in corners and shakes on the road; frames speak of
    the camera as it sits while the car stands.

    Args:
        layout: the track.
        laps: laps to drive on a closed one.
        seed: makes everything random.
        rate_hz: pictures per second.
        light: its name, by chance where none is given.
        rig: the camera.
        vehicle: the car.
        odometry: wheel speed and gyro, None without them.
        suspension: how the body leans, `Suspension` by default.
        clutter: how many things to place beside the track, by default some.

    Returns:
        The drive; its world is the car's pose at the start.

    Raises:
        SourceError: no lane can be made out.
    """
    paths, _, wheels, _, world, bumps = map(
        np.random.default_rng, np.random.SeedSequence(seed).spawn(6)
    )
    motion = plan_drive(layout, paths, laps=laps, vehicle=vehicle)
    stamps = even_stamps(motion, rate_hz)
    cones = TruthMap(np.arange(len(layout)), layout.xy_m, layout.cone_class)
    path, cones = seen_from("start", true_path(motion, stamps), cones)
    velocities: list[VelocityObservation] = []
    if odometry is not None:
        at = even_stamps(motion, odometry.rate_hz)
        velocities = read_odometry(odometry, at, motion.velocity(at), wheels)
    return CameraDrive(
        layout.name,
        make_scene(cones, world, light=draw_light(world, light), clutter=clutter),
        rig,
        _poses_at(path, stamps),
        car_states(motion, stamps, suspension or Suspension(), bumps),
        tuple(velocities),
        seed,
        path,
        cones,
    )


def _poses_at(path: Trajectory, stamps: Array) -> Array:
    """Return the poses of a path that holds all the stamps."""
    poses: Array = path.pose[np.searchsorted(path.stamp_s, stamps)]
    return poses


def car_states(
    motion: Motion, stamp_s: Array, suspension: Suspension, rng: np.random.Generator
) -> tuple[CarState, ...]:
    """Return how the car moves and leans at stamps (F,).

    The body follows the mean acceleration over the last ``settle_s``.
    """
    now = motion.velocity(stamp_s)
    before = motion.velocity(stamp_s - suspension.settle_s)
    forward = (now[:, 0] - before[:, 0]) / suspension.settle_s
    sideways = 0.5 * (now[:, 0] * now[:, 1] + before[:, 0] * before[:, 1])
    moving = np.minimum(now[:, 0] / 3.0, 1.0)
    shake = suspension.shake_rad * moving[:, None] * rng.standard_normal((len(now), 2))
    pitch = -suspension.pitch_per_mps2 * forward + shake[:, 0]
    roll = suspension.roll_per_mps2 * sideways + shake[:, 1]
    rows = np.column_stack([stamp_s, now, wrap_angle(pitch), wrap_angle(roll)])
    return tuple(CarState(*row) for row in rows.tolist())
