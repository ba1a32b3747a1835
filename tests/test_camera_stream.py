"""Pictures become cones once, whatever looks at them; a run goes from pixels to map."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from conegraph.camera import RgbdFrame
from conegraph.camera_stream import CameraStream, with_front_end
from conegraph.cli.app import app
from conegraph.config import load_config
from conegraph.frontend.base import Detections
from conegraph.io.run_folder import read_run
from conegraph.pipeline import Pipeline
from conegraph.sim.camera_drive import CameraDrive
from conegraph.sources import SimOptions, open_stream, render_track, simulate_track
from conegraph.types import ConeObservations, VelocityObservation


@pytest.fixture(scope="module")
def drive() -> CameraDrive:
    options = SimOptions(laps=1, seed=2, rate=3.0, light="bright", stand=0.2)
    whole = render_track("acceleration", options)
    return replace(
        whole,
        cars=whole.cars[:6],
        pose_world_car=whole.pose_world_car[:6],
        velocities=tuple(v for v in whole.velocities if v.stamp_s < 2.0),
    )


def test_cones_are_kept_and_pictures_are_shown_once(drive: CameraDrive) -> None:
    shown: list[tuple[float, int]] = []

    def watch(frame: RgbdFrame, seen: Detections) -> None:
        shown.append((frame.stamp_s, len(seen.box_px)))

    stream = CameraStream(drive, load_config(), watch)
    first = list(stream.events())
    assert [s for s, _ in shown] == [car.stamp_s for car in drive.cars]
    assert sum(n for _, n in shown) > 6
    second = list(stream.events())
    assert len(shown) == len(drive.cars)
    assert all(a is b for a, b in zip(first, second, strict=True))
    assert sum(isinstance(e, VelocityObservation) for e in first) == 200


def test_the_mount_of_the_configuration_counts(drive: CameraDrive) -> None:
    seen: list[RgbdFrame] = []
    config = load_config(overrides=["mount.height_m=1.5", "mount.yaw_rad=0.1"])
    stream = CameraStream(drive, config, lambda frame, _: seen.append(frame))
    next(e for e in stream.events() if isinstance(e, ConeObservations))
    assert seen[0].mount == replace(drive.rig.mount, height_m=1.5, yaw_rad=0.1)


def test_the_assumed_noise_is_that_of_the_configured_mount(drive: CameraDrive) -> None:
    low, high = (
        CameraStream(drive, load_config(overrides=[f"mount.height_m={h}"])).sensor
        for h in (0.5, 1.5)
    )
    assert low is not None
    assert high is not None
    assert low.range_sigma_m[2] == pytest.approx(3 * high.range_sigma_m[2])


def test_a_stream_of_cones_stays_as_it_is() -> None:
    log = simulate_track("acceleration", SimOptions(laps=1))
    assert with_front_end(log, load_config()) is log


def test_a_run_writes_how_long_detection_took(
    drive: CameraDrive, tmp_path: Path
) -> None:
    result = Pipeline(load_config(), drive).run(tmp_path / "run")
    assert result.summary["frames"] == 6
    assert result.summary["latency_ms"]["detect"]["p50"] > 0.0
    assert result.metrics is not None


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a few pictures of a drive, written by the command itself."""
    out = tmp_path_factory.mktemp("drive") / "pictures"
    command = ["simulate", "acceleration", "--camera", "--out", str(out)]
    done = CliRunner().invoke(
        app, [*command, "--rate", "0.5", "--light", "overcast", "--seed", "4"]
    )
    assert done.exit_code == 0, done.output
    return out


def test_no_back_end_of_a_comparison_waits_for_the_detector(
    pictures: Path, tmp_path: Path
) -> None:
    """Its own row says what the pictures took, once for all."""
    command = ["compare", str(pictures), "--out", str(tmp_path)]
    done = CliRunner().invoke(app, [*command, "--backends", "ekf,ekf/thesis"])
    assert done.exit_code == 0, done.output
    assert "finding cones first, p50 [ms]" in done.output
    first, second = (read_run(tmp_path / name) for name in ("ekf", "ekf-thesis"))
    assert len(first.timing_ms["detect"]) == len(first.trajectory) > 3
    # The same times to the last digit: the pictures were looked at once, before.
    np.testing.assert_array_equal(first.timing_ms["detect"], second.timing_ms["detect"])


def test_rendered_pictures_are_a_source(pictures: Path) -> None:
    stream = open_stream(str(pictures))
    rendered = open_stream(
        "sim:acceleration?sensor=rgbd&rate=0.5&light=overcast&seed=4"
    )
    read, made = (
        [e for e in s.events() if isinstance(e, RgbdFrame)] for s in (stream, rendered)
    )
    assert len(read) == len(made) == stream.n_frames
    for a, b in zip(read, made, strict=True):
        assert a.stamp_s == b.stamp_s
        assert np.array_equal(a.depth_m, b.depth_m)
        assert np.abs(a.color.astype(int) - b.color).mean() < 2.0
        assert a.camera == b.camera
    assert stream.truth_map is not None
    assert rendered.truth_map is not None
    assert np.array_equal(stream.truth_map.xy_m, rendered.truth_map.xy_m)
