"""A simulated drive: track, car and sensors in, a recording with its truth out."""

from __future__ import annotations

from typing import Literal

import numpy as np

from conegraph.geometry import between, to_child
from conegraph.sim.cone_sensor import CAMERA, ConeSensor, sense
from conegraph.sim.driving_line import closes, driving_line, start_line_at
from conegraph.sim.faults import StreamFaults, with_faults
from conegraph.sim.odometry import OdometrySensor, read_odometry
from conegraph.sim.vehicle import Motion, VehicleModel, drive_line
from conegraph.types import (
    Array,
    Event,
    Recording,
    TrackLayout,
    Trajectory,
    TruthMap,
)

_TRUTH_HZ = 100.0


def simulate(
    layout: TrackLayout,
    *,
    laps: int = 2,
    seed: int = 0,
    sensor: ConeSensor = CAMERA,
    vehicle: VehicleModel | None = None,
    odometry: OdometrySensor | None = None,
    faults: StreamFaults | None = None,
    origin: Literal["track", "start"] = "track",
) -> Recording:
    """Drive a track and record what the car's sensors report.

    The car stands for a moment, drives the line of `driving_line` from there for
    the given laps and 2 s on, or an open track to its end and a stop. Path, cone
    sensor, odometry and faults draw from generators of their own, so that leaving
    one out changes nothing in the others.

    Args:
        layout: the track.
        laps: laps to drive on a closed one.
        seed: makes every random draw.
        sensor: the cone detector.
        vehicle: the car, `VehicleModel` by default.
        odometry: wheel speed and gyro, None without them.
        faults: what goes wrong with the cones on top, None for nothing.
        origin: frame of the truth: the track's own, or the car's at its start.

    Returns:
        The recording, from stamp zero, its events in the order of their arrival
        (stamp and delay; odometry first where they tie). True poses are given at
        100 Hz and at every frame's stamp.

    Raises:
        SourceError: no lane can be made out.
    """
    paths, cones, wheels, mishaps = map(
        np.random.default_rng, np.random.SeedSequence(seed).spawn(4)
    )
    motion = plan_drive(layout, paths, laps=laps, vehicle=vehicle)
    truth = TruthMap(np.arange(len(layout)), layout.xy_m, layout.cone_class)
    stamps = even_stamps(motion, sensor.rate_hz)
    arrivals: list[tuple[float, Event]] = []
    if odometry is not None:
        read_at = even_stamps(motion, odometry.rate_hz)
        samples = read_odometry(odometry, read_at, motion.velocity(read_at), wheels)
        arrivals += [(v.stamp_s + odometry.delay_s, v) for v in samples]
    seen = truth
    if faults is not None:
        truth = faults.painted(truth, _halfway(motion))
        seen = faults.visible(truth)
    frames = sense(sensor, stamps, motion.pose(stamps), seen, cones)
    if faults is not None:
        frames = with_faults(frames, faults, sensor, mishaps)
    arrivals += [(f.stamp_s + sensor.delay_s, f) for f in frames]
    arrivals.sort(key=lambda item: item[0])
    trajectory, truth = seen_from(origin, true_path(motion, stamps), truth)
    return Recording(
        layout.name,
        tuple(event for _, event in arrivals),
        sensor=sensor.model,
        truth_trajectory=trajectory,
        truth_map=truth,
    )


def _halfway(motion: Motion) -> Array:
    """Return where (2,) the car is in the middle of its first lap, or of the drive."""
    ends = motion.laps_s[:2] if len(motion.laps_s) > 1 else (0.0, motion.duration_s)
    at = 0.5 * (ends[0] + ends[1])
    return np.asarray(motion.pose(np.array([at]))[0, :2])


def plan_drive(
    layout: TrackLayout,
    rng: np.random.Generator,
    *,
    laps: int = 2,
    vehicle: VehicleModel | None = None,
) -> Motion:
    """Return how the car drives a track, see `simulate`.

    Raises:
        SourceError: no lane can be made out.
    """
    line = driving_line(layout)
    return drive_line(
        line,
        closes(line),
        rng,
        laps=laps,
        start_line_m=start_line_at(layout, line),
        model=vehicle,
    )


def even_stamps(motion: Motion, rate_hz: float) -> Array:
    """Return stamps from zero to the end of the drive."""
    return np.arange(int(motion.duration_s * rate_hz) + 1) / rate_hz


def true_path(motion: Motion, frame_stamps: Array) -> Trajectory:
    """Return the true poses at 100 Hz and at the given stamps (F,)."""
    stamps = np.union1d(even_stamps(motion, _TRUTH_HZ), frame_stamps)
    return Trajectory(stamps, motion.pose(stamps))


def seen_from(
    origin: Literal["track", "start"], trajectory: Trajectory, cones: TruthMap
) -> tuple[Trajectory, TruthMap]:
    """Return the truth in the frame that was asked for."""
    if origin == "track":
        return trajectory, cones
    start = trajectory.pose[0]
    return (
        Trajectory(trajectory.stamp_s, between(start, trajectory.pose)),
        TruthMap(cones.id, to_child(start, cones.xy_m), cones.cone_class),
    )
