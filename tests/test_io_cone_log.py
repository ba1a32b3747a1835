"""The cone log: an exact round trip, defaults as documented, bad rows counted."""

from __future__ import annotations

import gzip
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conegraph.errors import FileFormatError
from conegraph.io.cone_log import read_cone_log, write_cone_log
from conegraph.types import (
    Array,
    ConeClass,
    ConeObservations,
    Event,
    Recording,
    Trajectory,
    TruthMap,
    VelocityObservation,
)

finite = st.floats(-1e6, 1e6)
yaw = st.floats(-np.pi, np.pi, exclude_min=True)


@st.composite
def covariances(draw: st.DrawFn) -> Array:
    a, b = draw(st.floats(1e-3, 1e2)), draw(st.floats(1e-3, 1e2))
    c = draw(st.floats(-0.99, 0.99)) * a * b
    return np.array([[a * a, c], [c, b * b]])


@st.composite
def probabilities(draw: st.DrawFn) -> Array:
    weight = np.array([draw(st.floats(0.001, 1.0)) for _ in range(5)])
    prob: Array = weight / weight.sum()
    return prob


@st.composite
def frames(draw: st.DrawFn, stamp_s: float) -> ConeObservations:
    n = draw(st.integers(0, 3))
    ids = st.integers(-1, 10**12)
    return ConeObservations(
        stamp_s,
        np.array([[draw(finite), draw(finite)] for _ in range(n)]),
        np.array([draw(covariances()) for _ in range(n)]),
        np.array([draw(probabilities()) for _ in range(n)]),
        np.array([draw(ids) for _ in range(n)], dtype=np.int64),
    )


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    stamps = st.lists(st.floats(0, 2e9), min_size=1, max_size=5, unique=True)
    cones = [draw(frames(t)) for t in draw(stamps)]
    velocities = [
        VelocityObservation(t, draw(finite), draw(finite), draw(covariances()))
        for t in draw(stamps)
    ]
    events: list[Event] = [*velocities, *cones]
    truth = sorted(draw(stamps))
    ids = draw(st.lists(st.integers(0, 10**12), min_size=1, max_size=3, unique=True))
    return Recording(
        "log",
        tuple(sorted(events, key=lambda e: e.stamp_s)),
        truth_trajectory=Trajectory(
            np.array(truth),
            np.array([[draw(finite), draw(finite), draw(yaw)] for _ in truth]),
        ),
        truth_map=TruthMap(
            np.array(ids),
            np.array([[draw(finite), draw(finite)] for _ in ids]),
            np.array([draw(st.integers(0, 4)) for _ in ids]),
        ),
    )


def same_event(a: Event, b: Event) -> bool:
    if isinstance(a, ConeObservations) and isinstance(b, ConeObservations):
        assert a.truth_id is not None
        assert b.truth_id is not None
        return (
            a.stamp_s == b.stamp_s
            and np.array_equal(a.xy_m, b.xy_m)
            and np.array_equal(a.cov_m2, b.cov_m2)
            and np.array_equal(a.class_prob, b.class_prob)
            and np.array_equal(a.truth_id, b.truth_id)
        )
    if isinstance(a, VelocityObservation) and isinstance(b, VelocityObservation):
        same = (a.stamp_s, a.u_mps, a.r_radps) == (b.stamp_s, b.u_mps, b.r_radps)
        return same and np.array_equal(a.cov, b.cov)
    return False


@settings(
    max_examples=50,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(recordings())
def test_round_trip_is_exact_to_the_last_bit(tmp_path: Path, wrote: Recording) -> None:
    write_cone_log(tmp_path / "log", wrote)
    read = read_cone_log(tmp_path / "log")
    assert read.rejected == {}
    assert read.name == "log"
    pairs = zip(wrote.stream, read.stream, strict=True)
    assert all(same_event(a, b) for a, b in pairs)
    assert wrote.truth_trajectory is not None
    assert read.truth_trajectory is not None
    assert np.array_equal(wrote.truth_trajectory.stamp_s, read.truth_trajectory.stamp_s)
    assert np.array_equal(wrote.truth_trajectory.pose, read.truth_trajectory.pose)
    assert wrote.truth_map is not None
    assert read.truth_map is not None
    assert np.array_equal(wrote.truth_map.id, read.truth_map.id)
    assert np.array_equal(wrote.truth_map.xy_m, read.truth_map.xy_m)
    assert np.array_equal(wrote.truth_map.cone_class, read.truth_map.cone_class)


def log(folder: Path, cones: str, **others: str) -> Recording:
    folder.mkdir(exist_ok=True)
    for name, text in {"cones": cones, **others}.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    return read_cone_log(folder)


def only_frames(recording: Recording) -> list[ConeObservations]:
    return [e for e in recording.stream if isinstance(e, ConeObservations)]


def test_frames_by_stamp_and_empty_frames(tmp_path: Path) -> None:
    read = log(tmp_path, "y,t,x\n1,0.5,5\n2,0.5,6\n,0.6,\n3,0.7\n")
    frames = only_frames(read)
    assert [f.stamp_s for f in frames] == [0.5, 0.6, 0.7]
    assert [len(f) for f in frames] == [2, 0, 0]
    assert frames[0].xy_m.tolist() == [[5.0, 1.0], [6.0, 2.0]]
    assert read.rejected == {"cones.csv: x or y is not a number": 1}
    assert read.truth_map is None
    assert frames[0].truth_id is None


def test_documented_defaults(tmp_path: Path) -> None:
    read = log(tmp_path, "t,x,y\n1,10,0\n", odometry="t,u,r\n1,5,0.1\n")
    velocity, frame = read.stream
    assert isinstance(velocity, VelocityObservation)
    assert isinstance(frame, ConeObservations)
    assert velocity.cov == pytest.approx(np.diag([0.1**2, 0.01**2]))
    assert frame.cov_m2[0] == pytest.approx(np.diag([(0.05 + 0.25) ** 2, 0.1**2]))
    assert frame.class_prob[0] == pytest.approx(np.full(5, 0.2))
    assert read.sensor is not None
    assert read.sensor.range_sigma_m.tolist() == [0.05, 0.0, 0.0025]
    assert read.sensor.max_range_m == pytest.approx(10.5)


def test_classes(tmp_path: Path) -> None:
    rows = "1,1,1,blue\n1,1,1,Big-Orange\n1,1,1,unknown\n1,1,1,\n1,1,1,pink\n"
    read = log(tmp_path, "t,x,y,class\n" + rows)
    prob = only_frames(read)[0].class_prob
    assert prob[0] == pytest.approx([0.9, 0.025, 0.025, 0.025, 0.025])
    assert prob[1].argmax() == ConeClass.BIG_ORANGE
    assert prob[2:] == pytest.approx(np.full((2, 5), 0.2))
    assert read.rejected == {"cones.csv: unknown class name": 1}


def test_class_probabilities(tmp_path: Path) -> None:
    header = "t,x,y,class,p_blue,p_yellow,p_orange,p_big_orange,p_unknown\n"
    rows = (
        "1,1,1,,2,1,1,0,0\n"
        "1,1,1,yellow,,,,,\n"
        "1,1,1,,-1,1,1,0,0\n"
        "1,1,1,,0,0,0,0,0\n"
        "1,1,1,,0.5,,,,\n"
        "1,1,1,,,,,,\n"
    )
    read = log(tmp_path, header + rows)
    prob = only_frames(read)[0].class_prob
    assert prob[0].tolist() == [0.5, 0.25, 0.25, 0.0, 0.0]
    assert prob[1].argmax() == ConeClass.YELLOW
    assert prob[2:] == pytest.approx(np.full((4, 5), 0.2))
    assert read.rejected == {"cones.csv: class probabilities replaced": 3}


def test_bad_rows_are_counted_by_reason(tmp_path: Path) -> None:
    cones = (
        "t,x,y,cov_xx,cov_xy,cov_yy,true_id\n"
        "1,1,1,0.1,0,0.1,7\n"
        "abc,1,1,0.1,0,0.1,7\n"
        "nan,1,1,0.1,0,0.1,7\n"
        "2,1,inf,0.1,0,0.1,7\n"
        "1.5,1,1,0.1,0,0.1,7\n"
        "2,1,1,0.1,0.2,0.1,7\n"
        "2,1,1,0.1,,0.1,7\n"
        "2,1,1,0,0,0,7\n"
        "2,1,1,1e8,0,1,7\n"
        "2,2,2,0.1,0,0.1,x\n"
        "2,2,2,0.1,0,0.1,7,8\n"
        "t,x,y,cov_xx,cov_xy,cov_yy,true_id\n"
    )
    odometry = "t,u,r\n0,1,1\n1,x,1\n0.5,1,1\n2,1,1\n"
    truth = "t,x,y,yaw\n0,0,0,7\n1,0,0,\n"
    cone_map = "id,x,y,class\n1,0,0,blue\n1,5,0,blue\n2,0,0,red\n3.5,0,0,blue\n"
    read = log(tmp_path, cones, odometry=odometry, truth=truth, map=cone_map)
    assert read.rejected == {
        "cones.csv: too many cells in a row": 1,
        "cones.csv: stamp is not a number": 3,
        "cones.csv: stamp goes backwards": 1,
        "cones.csv: x or y is not a number": 1,
        "cones.csv: covariance is not positive definite or absurd": 4,
        "cones.csv: true_id ignored": 1,
        "odometry.csv: u or r is not a number": 1,
        "odometry.csv: stamp goes backwards": 1,
        "truth.csv: yaw is not a number": 1,
        "map.csv: unknown class name": 1,
        "map.csv: id is not a whole number": 1,
        "map.csv: id occurs twice": 1,
    }
    first, second = only_frames(read)
    assert first.truth_id is not None
    assert second.truth_id is not None
    assert first.truth_id.tolist() == [7]
    assert second.truth_id.tolist() == [-1]
    assert read.truth_trajectory is not None
    assert read.truth_trajectory.pose[0, 2] == pytest.approx(7 - 2 * np.pi)


def test_odometry_comes_before_cones(tmp_path: Path) -> None:
    read = log(tmp_path, "t,x,y\n1,1,1\n2,1,1\n", odometry="t,u,r\n2,1,0\n1,9,9\n")
    kinds = [(e.stamp_s, type(e).__name__) for e in read.stream]
    assert kinds == [
        (1.0, "ConeObservations"),
        (2.0, "VelocityObservation"),
        (2.0, "ConeObservations"),
    ]


def test_sensor_is_fitted_to_reported_covariances(tmp_path: Path) -> None:
    rows = [
        f"{i},{r},0,{(0.02 + 0.003 * r) ** 2!r},0,{(0.01 * r) ** 2!r}"
        for i, r in enumerate(np.linspace(2, 20, 40).tolist())
    ]
    read = log(tmp_path, "t,x,y,cov_xx,cov_xy,cov_yy\n" + "\n".join(rows))
    assert read.sensor is not None
    assert read.sensor.range_sigma_m == pytest.approx([0.02, 0.003, 0.0], abs=1e-6)
    assert read.sensor.bearing_sigma_rad == pytest.approx(0.01, abs=1e-6)
    assert read.sensor.detection_probability is None


def test_compressed_parts_and_rewriting(tmp_path: Path) -> None:
    packed = tmp_path / "cones.csv.gz"
    packed.write_bytes(gzip.compress(b"t,x,y\n1,2,3\n"))
    (tmp_path / "truth.csv").write_text("t,x,y,yaw\n0,0,0,0\n", encoding="utf-8")
    read = read_cone_log(tmp_path)
    assert read.n_frames == 1
    assert read.truth_trajectory is not None
    write_cone_log(tmp_path, Recording("x", read.stream))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cones.csv"]
    assert read_cone_log(tmp_path).truth_trajectory is None


@pytest.mark.parametrize(
    ("cones", "said"),
    [
        ("", "is empty"),
        ("t,x\n1,2\n", "no column 'y'"),
        ("t,x,y,cov_xx\n1,2,3,4\n", "no column 'cov_xy'"),
        ("t,x,y,p_blue\n1,2,3,1\n", "no column 'p_yellow'"),
    ],
)
def test_unusable_files(tmp_path: Path, cones: str, said: str) -> None:
    with pytest.raises(FileFormatError, match=said):
        log(tmp_path, cones)


def test_a_folder_without_cones(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"cones\.csv.*is missing"):
        read_cone_log(tmp_path)
    (tmp_path / "cones.csv").write_text("t,x,y\n", encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"cones\.csv.*holds no frames"):
        read_cone_log(tmp_path)


def test_a_lidar_log_is_read_in_seconds(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cones = rng.normal(10.0, 3.0, (1000, 60, 2))
    cov = np.broadcast_to(0.01 * np.eye(2), (60, 2, 2))
    prob = np.tile([0.9, 0.025, 0.025, 0.025, 0.025], (60, 1))
    stream = tuple(
        ConeObservations(0.1 * i, xy, cov, prob) for i, xy in enumerate(cones)
    )
    write_cone_log(tmp_path, Recording("lidar", stream))
    begin = time.process_time()
    assert read_cone_log(tmp_path).n_frames == 1000
    assert time.process_time() - begin < 3.0
