"""RealSense recordings, made through a software device and played back for real."""

import sqlite3
import time
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.cli import main
from conegraph.errors import ConegraphError, FileFormatError, SourceError
from conegraph.frontend.realsense import RealsenseRecording, read_realsense
from conegraph.frontend.realsense_frames import MISSING, camera_of, turned_round
from conegraph.frontend.realsense_live import LiveCamera
from conegraph.io.camera_toml import CameraFile, format_camera_toml
from conegraph.sources import open_stream

rs = pytest.importorskip("pyrealsense2", exc_type=ImportError)

WIDTH, HEIGHT, FPS = 64, 48, 30
LENS = (-0.06, 0.02, 4e-4, -3e-4, 0.0)
COUNT = 12


def pictures(index: int) -> tuple[Any, Any]:
    rng = np.random.default_rng(index)
    depth = rng.integers(500, 9000, (HEIGHT, WIDTH)).astype(np.uint16)
    return depth, rng.integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def lens_of(coefficients: tuple[float, ...] = LENS) -> Any:
    given = rs.intrinsics()
    given.width, given.height = WIDTH, HEIGHT
    given.fx, given.fy, given.ppx, given.ppy = 46.5, 46.0, 32.1, 23.8
    given.model, given.coeffs = rs.distortion.brown_conrady, list(coefficients)
    return given


def stream_of(kind: Any, uid: int, form: Any, size: int) -> Any:
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fps = kind, 0, uid, FPS
    stream.width, stream.height, stream.bpp, stream.fmt = WIDTH, HEIGHT, size, form
    stream.intrinsics = lens_of()
    return stream


def frame_of(profile: Any, pixels: Any, index: int, size: int) -> Any:
    frame = rs.software_video_frame()
    frame.stride, frame.bpp, frame.pixels = WIDTH * size, size, pixels
    frame.timestamp, frame.frame_number = index * 1000.0 / FPS, index + 1
    frame.domain = rs.timestamp_domain.hardware_clock
    frame.profile = profile.as_video_stream_profile()
    return frame


def wait_until_written(path: Path, messages: int) -> None:
    """Wait until a recording that is being made holds so many pictures."""
    count = (
        "SELECT count(*) FROM messages JOIN topics ON topic_id = topics.id "
        "WHERE topics.name LIKE '%/image/data%'"
    )
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        # Without a lock, for the writer does not wait for one to be free; what is
        # seen may then be half a table.
        with (
            suppress(sqlite3.DatabaseError),
            closing(sqlite3.connect(f"{path.as_uri()}?immutable=1", uri=True)) as db,
        ):
            if db.execute(count).fetchone()[0] >= messages:
                return
        time.sleep(0.002)
    pytest.fail(f"the recorder did not write {messages} pictures in a minute")


def record(path: Path, indices: list[int], form: Any, shift_m: float = 0.0) -> None:
    """Record pictures of a camera that exists in software only."""
    device = rs.software_device()
    depths, colors = device.add_sensor("Stereo Module"), device.add_sensor("RGB Camera")
    depths.add_read_only_option(rs.option.depth_units, 0.001)
    depth = depths.add_video_stream(stream_of(rs.stream.depth, 0, rs.format.z16, 2))
    color = colors.add_video_stream(stream_of(rs.stream.color, 1, form, 3))
    beside = rs.extrinsics()
    beside.rotation, beside.translation = list(np.eye(3).ravel()), [shift_m, 0.0, 0.0]
    depth.register_extrinsics_to(color, beside)
    device.create_matcher(rs.matchers.default)
    recorder, syncer = rs.recorder(str(path), device), rs.syncer()
    sensors = recorder.query_sensors()[:2]
    for sensor, profile in zip(sensors, (depth, color), strict=True):
        sensor.open(profile)
        sensor.start(syncer)
    # The recorder reads the pixels when it likes: they must outlive it.
    held = [pictures(index) for index in indices]
    for written, (index, (z, picture)) in enumerate(zip(indices, held, strict=True), 1):
        shot = frame_of(depth, z, index, 2)
        shot.depth_units = 0.001
        depths.on_video_frame(shot)
        colors.on_video_frame(frame_of(color, picture, index, 3))
        assert syncer.try_wait_for_frames(2000)[0]
        # Its writer runs beside this loop, and a busy machine lets it fall behind:
        # then a frame's memory was seen to hold a later frame.
        wait_until_written(path, 2 * written)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    # The recorder writes its end when nobody holds it any more.
    del sensor, sensors, recorder, syncer
    assert len(held) == len(indices)


Recorder = Callable[..., Path]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorder:
    folder = tmp_path_factory.mktemp("realsense")
    made: dict[str, Path] = {}

    def make(name: str, indices: list[int], form: Any = None, shift: float = 0) -> Path:
        if name not in made:
            made[name] = folder / f"{name}.db3"
            record(made[name], indices, form or rs.format.rgb8, shift)
        return made[name]

    return make


def frames_of(stream: RealsenseRecording) -> list[RgbdFrame]:
    return [e for e in stream.events() if isinstance(e, RgbdFrame)]


def test_a_recording_comes_back_to_the_last_bit(recorded: Recorder) -> None:
    stream = open_stream(str(recorded("whole", list(range(COUNT)))))
    assert isinstance(stream, RealsenseRecording)
    assert stream.name == "whole"
    assert stream.n_frames == COUNT
    for _ in range(2):
        frames = frames_of(stream)
        assert len(frames) == COUNT
        for index, frame in enumerate(frames):
            depth, color = pictures(index)
            assert frame.stamp_s == pytest.approx(index / FPS, abs=1e-6)
            assert np.array_equal(frame.color, color)
            assert np.array_equal(np.round(frame.depth_m * 1000), depth)
            assert frame.camera.distortion == pytest.approx(LENS, abs=1e-7)
            assert frame.camera.fx_px == 46.5
        assert stream.rejected == {}


def test_blue_first_is_turned_to_red_first(recorded: Recorder) -> None:
    stream = read_realsense(recorded("bgr", [0, 1], rs.format.bgr8))
    frames = frames_of(stream)
    assert np.array_equal(frames[1].color, pictures(1)[1][..., ::-1])


def test_lost_frames_are_counted(recorded: Recorder) -> None:
    kept = [k for k in range(COUNT) if k not in (4, 5, 9)]
    stream = read_realsense(recorded("gaps", kept))
    frames = frames_of(stream)
    assert [round(f.stamp_s * FPS) for f in frames] == kept
    assert stream.rejected == {MISSING: 3}


def test_depth_of_another_eye_is_moved_to_colour(recorded: Recorder) -> None:
    """Depth from an eye 5 cm to the left lands some columns further right."""
    stream = read_realsense(recorded("apart", [0], None, 0.05))
    frame = frames_of(stream)[0]
    depth = pictures(0)[0]
    assert not np.array_equal(np.round(frame.depth_m * 1000), depth)
    values = set(np.round(frame.depth_m[frame.depth_m > 0] * 1000).astype(int).tolist())
    assert values <= set(depth.ravel().tolist())


def test_a_recording_that_is_cut_off_says_how_much_is_there(
    recorded: Recorder, tmp_path: Path
) -> None:
    data = recorded("whole", list(range(COUNT))).read_bytes()
    path = tmp_path / "cut.db3"
    path.write_bytes(data[: len(data) * 6 // 10])
    with pytest.raises(FileFormatError, match=r"is cut off: \d\.\d of \d\.\d MiB"):
        read_realsense(path)


def test_frames_that_are_lost_to_damage_are_counted(
    recorded: Recorder, tmp_path: Path
) -> None:
    data = bytearray(recorded("whole", list(range(COUNT))).read_bytes())
    rng = np.random.default_rng(1)
    for at in rng.integers(len(data) // 2, len(data), 200).tolist():
        data[at] = int(rng.integers(256))
    path = tmp_path / "damaged.db3"
    path.write_bytes(bytes(data))
    try:
        stream = read_realsense(path)
        come = len(frames_of(stream))
    except FileFormatError:
        return
    lost = sum(stream.rejected.values())
    assert stream.n_frames is None or come + lost >= stream.n_frames


def test_the_mount_is_read_from_beside(recorded: Recorder, tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    path.write_bytes(recorded("bgr", [0, 1], rs.format.bgr8).read_bytes())
    assert read_realsense(path).mount == CameraMount()
    mount = CameraMount(height_m=0.7, pitch_rad=0.1)
    lens = Camera(WIDTH, HEIGHT, 50.0, 50.0, 32.0, 24.0)
    about = format_camera_toml(CameraFile(lens, mount))
    (tmp_path / "camera.toml").write_text(about, encoding="utf-8")
    assert frames_of(read_realsense(path))[0].mount == mount


def command(*arguments: object) -> object:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return ended.value.code


def test_a_recording_becomes_a_folder_of_pictures(
    recorded: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = recorded("gaps", [k for k in range(COUNT) if k not in (4, 5, 9)])
    out = tmp_path / "folder"
    took = ("--seconds", 0.25, "--lossless")
    assert command("record", source, "--out", out, *took) == 0
    said = capsys.readouterr()
    assert "6 frames of gaps" in said.out
    assert f"2 x {MISSING}" in said.err
    frames = [e for e in open_stream(str(out)).events() if isinstance(e, RgbdFrame)]
    for frame, index in zip(frames, (0, 1, 2, 3, 6, 7), strict=True):
        depth, color = pictures(index)
        assert np.array_equal(frame.color, color)
        assert np.array_equal(np.round(frame.depth_m * 1000), depth)


def test_recording_without_a_camera_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for out in (tmp_path / "a.db3", tmp_path / "folder"):
        assert command("record", "--out", out) == 1
        said = capsys.readouterr().err
        assert said.startswith("conegraph: realsense: no such RealSense camera")
        assert said.count("\n") == 1
        assert not out.exists()
    assert command("record", "sim:oval?sensor=rgbd", "--out", tmp_path / "b.db3") == 1
    assert "only a RealSense camera records into .db3" in capsys.readouterr().err


def test_no_camera_is_one_clear_sentence() -> None:
    for text in ("realsense", "realsense:123"):
        stream = open_stream(text)
        assert isinstance(stream, LiveCamera)
        with pytest.raises(SourceError, match="no such RealSense camera"):
            next(iter(stream.events()))


def test_an_inverse_lens_is_turned_round() -> None:
    given = lens_of()
    given.model = rs.distortion.inverse_brown_conrady
    camera = camera_of(given)
    u, v = np.meshgrid(np.linspace(0, WIDTH, 9), np.linspace(0, HEIGHT, 7))
    x = (u.ravel() - camera.cx_px) / camera.fx_px
    y = (v.ravel() - camera.cy_px) / camera.fy_px
    r2 = x * x + y * y
    k1, k2, p1, p2, _ = LENS
    bend = 1 + k1 * r2 + k2 * r2**2
    straight = np.column_stack(
        [
            x * bend + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * bend + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            np.ones(len(x)),
        ]
    )
    none = np.zeros(3)
    back, _ = cv2.projectPoints(
        straight, none, none, camera.matrix, np.array(camera.distortion)
    )
    expected = np.column_stack([u.ravel(), v.ravel()])
    np.testing.assert_allclose(back[:, 0], expected, atol=0.02)


def test_no_lens_turned_round_is_none() -> None:
    straight = turned_round((0.0, 0.0, 0.0, 0.0, 0.0), (0.7, 0.5))
    np.testing.assert_allclose(straight, 0.0, atol=1e-12)


def test_a_text_file_is_no_recording(tmp_path: Path) -> None:
    for name in ("a.db3", "a.bag"):
        path = tmp_path / name
        path.write_text("hello", encoding="utf-8")
        with pytest.raises(ConegraphError, match="is no RealSense recording"):
            read_realsense(path)


def test_who_stops_early_frees_the_file(recorded: Recorder) -> None:
    stream = read_realsense(recorded("whole", list(range(COUNT))))
    for taken in (1, 2, COUNT - 1):
        events = stream.events()
        for _ in range(taken):
            next(events)
        began = time.monotonic()
        assert isinstance(events, Generator)
        events.close()
        assert time.monotonic() - began < 5.0
    assert len(frames_of(stream)) == COUNT
