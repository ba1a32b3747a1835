"""MRCLAM: rows to frames, noise densities, and the real drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conegraph.errors import FileFormatError
from conegraph.io.mrclam import (
    BEARING_SIGMA_RAD,
    DEPTH_OFFSET_M,
    DEPTH_PER_M,
    R_DENSITY_DRIVE,
    R_DENSITY_TURN,
    RANGE_SIGMA_M,
    U_DENSITY,
    read_mrclam,
)
from conegraph.types import ConeObservations, VelocityObservation

FILES = {
    "Barcodes.dat": "# c\n 1 \t 5\n 6 \t 63\n 7 \t 81\n",
    "Landmark_Groundtruth.dat": "# c\n6 1.0 2.0 0 0\n7 -1.0 2.5 0 0\n",
    "Robot1_Odometry.dat": "10.0 0.5 0.2\n10.1 0.5 0.2\n10.3 0.5 0.2\n10.4 0 0\n",
    "Robot1_Groundtruth.dat": "9.0 1 2 0.5\n11.0 2 2 3.5\n",
    "Robot1_Measurement.dat": (
        "9.9 63 1.0 0.0\n"
        "10.2 63 2.0 0.5\n"
        "10.2 81 3.0 -0.25\n"
        "10.25 5 3.0 0.0\n"
        "10.25 99 3.0 0.0\n"
        "10.3 63 -1.0 0.0\n"
        "10.3 63 nan 0.0\n"
        "10.1 63 2.0 0.0\n"
        "10.4 81 1.0\n"
    ),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_frames_truth_and_rejections(folder: Path) -> None:
    read = read_mrclam(folder, "Robot1")
    (frame,) = [e for e in read.stream if isinstance(e, ConeObservations)]
    assert frame.stamp_s == 10.2
    assert frame.truth_id is not None
    assert frame.truth_id.tolist() == [6, 7]
    ahead_m = (np.array([2.0, 3.0]) - DEPTH_OFFSET_M) / DEPTH_PER_M
    assert frame.xy_m[:, 0] == pytest.approx(ahead_m)
    assert frame.xy_m[:, 1] == pytest.approx(ahead_m * np.tan([0.5, -0.25]))
    range_m = np.hypot(*frame.xy_m.T)
    assert np.linalg.det(frame.cov_m2) == pytest.approx(
        (RANGE_SIGMA_M * BEARING_SIGMA_RAD * range_m) ** 2
    )
    assert frame.class_prob == pytest.approx(np.full((2, 5), 0.2))
    assert read.rejected == {
        "Robot1_Measurement.dat: malformed row": 2,
        "Robot1_Measurement.dat: stamp goes backwards": 1,
        "measurements: unknown barcode": 1,
        "measurements: another robot": 1,
        "measurements: range not positive": 1,
        "measurements: outside the time of the odometry": 1,
    }
    assert read.sensor is not None
    assert read.sensor.detection_probability == 0.0
    assert read.sensor.min_range_m == pytest.approx(range_m[0])
    assert read.sensor.max_range_m == pytest.approx(range_m[1])
    assert read.sensor.half_fov_rad == pytest.approx(0.5)
    assert read.truth_map is not None
    assert read.truth_map.id.tolist() == [6, 7]
    assert read.truth_trajectory is not None
    assert read.truth_trajectory.pose[1, 2] == pytest.approx(3.5 - 2 * np.pi)


def test_odometry_noise_is_a_density_over_the_interval(folder: Path) -> None:
    """At 10.1 s a sample stands for (0.1 + 0.2) / 2 s."""
    read = read_mrclam(folder, "Robot1")
    samples = [e for e in read.stream if isinstance(e, VelocityObservation)]
    assert [s.stamp_s for s in samples] == [10.0, 10.1, 10.3, 10.4]
    var_u = U_DENSITY * 0.5 / 0.15 + 0.01**2
    var_r = (R_DENSITY_TURN * 0.2 + R_DENSITY_DRIVE * 0.5) / 0.15 + 0.01**2
    assert samples[1].cov == pytest.approx(np.diag([var_u, var_r]))
    assert samples[0].cov[0, 0] == pytest.approx(U_DENSITY * 0.5 / 0.1 + 0.01**2)
    assert samples[3].cov == pytest.approx(np.diag([0.01**2, 0.01**2]))


def test_unusable_files(folder: Path) -> None:
    with pytest.raises(FileFormatError, match="Robot2_Odometry"):
        read_mrclam(folder, "Robot2")
    (folder / "Robot1_Measurement.dat").write_text("1 2 3 4\n", encoding="utf-8")
    with pytest.raises(FileFormatError, match="no usable row"):
        read_mrclam(folder, "Robot1")
    (folder / "Barcodes.dat").write_text("# none\n", encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"Barcodes\.dat.*no row"):
        read_mrclam(folder, "Robot1")


@pytest.mark.parametrize(
    ("robot", "n_frames", "n_posts", "n_robots"),
    [
        ("Robot1", 962, 1534, 407),
        ("Robot2", 1856, 3239, 792),
        ("Robot3", 2033, 4348, 1277),
    ],
)
def test_real_drives(
    data_dir: Path, robot: str, n_frames: int, n_posts: int, n_robots: int
) -> None:
    """Counts from the files: rows whose barcode is a post's, and their stamps."""
    read = read_mrclam(data_dir / "mrclam6", robot)
    frames = [e for e in read.stream if isinstance(e, ConeObservations)]
    assert len(frames) == n_frames
    assert sum(map(len, frames)) == n_posts
    assert read.rejected["measurements: another robot"] == n_robots
    assert set(read.rejected) <= {
        "measurements: another robot",
        "measurements: unknown barcode",
    }
    seen = {i for f in frames if f.truth_id is not None for i in f.truth_id.tolist()}
    assert seen == set(range(6, 21))
    stamps = [e.stamp_s for e in read.stream]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize("robot", ["Robot1", "Robot2", "Robot3"])
def test_ranges_hold_across_the_view(data_dir: Path, robot: str) -> None:
    """Against Vicon they are a sigma and a half off at most, ahead and at the edge."""
    read = read_mrclam(data_dir / "mrclam6", robot)
    assert read.truth_map is not None
    assert read.truth_trajectory is not None
    post = dict(zip(read.truth_map.id.tolist(), read.truth_map.xy_m, strict=True))
    truth = read.truth_trajectory
    bearing, off_m = [], []
    for frame in (e for e in read.stream if isinstance(e, ConeObservations)):
        assert frame.truth_id is not None
        here = [
            np.interp(frame.stamp_s, truth.stamp_s, truth.pose[:, i]) for i in (0, 1)
        ]
        there = np.array([post[i] for i in frame.truth_id.tolist()])
        off_m += (np.hypot(*frame.xy_m.T) - np.hypot(*(there - here).T)).tolist()
        bearing += np.arctan2(frame.xy_m[:, 1], frame.xy_m[:, 0]).tolist()
    for middle in (-0.5, -0.25, 0.0, 0.25, 0.5):
        part = np.array(off_m)[np.abs(np.array(bearing) - middle) < 0.15]
        assert abs(np.median(part)) < 1.5 * RANGE_SIGMA_M


def test_integrated_noise_matches_its_densities(data_dir: Path) -> None:
    """Summed over a drive, dt^2 var(u) is the density times the driven distance."""
    read = read_mrclam(data_dir / "mrclam6", "Robot1")
    samples = [e for e in read.stream if isinstance(e, VelocityObservation)]
    stamp = np.array([s.stamp_s for s in samples])
    speed = np.abs([s.u_mps for s in samples])
    weight = np.zeros(len(stamp))
    weight[:-1] += np.diff(stamp) / 2
    weight[1:] += np.diff(stamp) / 2
    variance = np.array([s.cov[0, 0] for s in samples]) - 0.01**2
    driven = float(weight @ speed)
    assert 20.0 < driven < 100.0
    assert weight**2 @ variance == pytest.approx(U_DENSITY * driven, rel=1e-3)
