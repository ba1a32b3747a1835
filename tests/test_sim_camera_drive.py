"""A drive with a camera: the same drive as without, body and pictures in step."""

from dataclasses import replace

import numpy as np
import pytest

from conegraph.camera import RgbdFrame
from conegraph.geometry import to_child
from conegraph.sim.camera_drive import (
    CameraDrive,
    Suspension,
    car_states,
    drive_with_camera,
)
from conegraph.sim.drive import plan_drive, simulate
from conegraph.sim.odometry import OdometrySensor
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import VelocityObservation

OVAL = built_in_track("oval", 0)
STILL = Suspension(shake_rad=0.0)


@pytest.fixture(scope="module")
def drive() -> CameraDrive:
    return drive_with_camera(
        OVAL,
        laps=1,
        seed=3,
        rate_hz=2.0,
        light="bright",
        odometry=OdometrySensor(rate_hz=20.0),
        clutter=5,
    )


def test_the_path_is_that_of_a_drive_without_pictures(drive: CameraDrive) -> None:
    log = simulate(OVAL, laps=1, seed=3, origin="start")
    assert log.truth_trajectory is not None
    path = drive.truth_trajectory
    for axis in (0, 1):
        other = np.interp(
            path.stamp_s,
            log.truth_trajectory.stamp_s,
            log.truth_trajectory.pose[:, axis],
        )
        np.testing.assert_allclose(path.pose[:, axis], other, atol=2e-3)
    np.testing.assert_allclose(drive.pose_world_car[0], 0.0, atol=1e-12)


def test_events_come_in_order_and_can_be_had_twice(drive: CameraDrive) -> None:
    events = drive.events()
    first = [next(events) for _ in range(30)]
    stamps = [e.stamp_s for e in first]
    assert stamps == sorted(stamps)
    frames = [e for e in first if isinstance(e, RgbdFrame)]
    wheels = [e for e in first if isinstance(e, VelocityObservation)]
    assert len(frames) == 3
    assert len(wheels) == 27
    again = drive.render(2)[0]
    assert np.array_equal(again.color, frames[2].color)
    assert np.array_equal(again.depth_m, frames[2].depth_m)


def test_several_processes_render_the_same(drive: CameraDrive) -> None:
    short = replace(drive, cars=drive.cars[:5], velocities=())
    serial = [e for e in short.events() if isinstance(e, RgbdFrame)]
    shared = [e for e in replace(short, workers=2).events() if isinstance(e, RgbdFrame)]
    assert [f.stamp_s for f in shared] == [car.stamp_s for car in short.cars]
    for a, b in zip(serial, shared, strict=True):
        assert np.array_equal(a.color, b.color)
        assert np.array_equal(a.depth_m, b.depth_m)


def test_truth_of_a_picture_is_the_map_seen_from_the_car(drive: CameraDrive) -> None:
    index = drive.n_frames // 2
    _, truth = drive.render(index)
    seen = to_child(drive.pose_world_car[index], drive.truth_map.xy_m)
    assert len(truth) >= 4
    np.testing.assert_allclose(truth.xy_m, seen[truth.cone_id], atol=1e-9)


def test_the_body_leans_by_what_the_tyres_do() -> None:
    motion = plan_drive(OVAL, np.random.default_rng(0), laps=1)
    stamps = np.arange(0.2, motion.duration_s, 0.01)
    cars = car_states(motion, stamps, STILL, np.random.default_rng(0))
    pitch = np.array([car.pitch_rad for car in cars])
    roll = np.array([car.roll_rad for car in cars])
    # Braking 7 and accelerating 5 m/s2 at 0.14 degrees for each; corners 8 at 0.12.
    assert np.degrees(pitch.max()) == pytest.approx(7 * 0.14, rel=0.1)
    assert np.degrees(pitch.min()) == pytest.approx(-5 * 0.14, rel=0.1)
    assert np.degrees(roll.max()) == pytest.approx(8 * 0.12, rel=0.1)
    assert np.degrees(roll.min()) > -0.2
    standing = car_states(
        motion, np.array([0.3]), Suspension(), np.random.default_rng(0)
    )
    assert standing[0].pitch_rad == standing[0].roll_rad == 0.0
