"""RGB-D folders come back as they were written, and bad ones say what is wrong."""

import shutil
import struct
import zlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.errors import ConegraphError, FileFormatError
from conegraph.io.camera_toml import CameraFile, format_camera_toml, read_camera_toml
from conegraph.io.depth_units import unit_problem
from conegraph.io.picture_file import claimed_size, read_color, read_depth
from conegraph.io.picture_list import associate, read_picture_list
from conegraph.io.rgbd_folder import read_rgbd_folder
from conegraph.io.rgbd_writer import RgbdWriter
from conegraph.types import Trajectory, TruthMap, VelocityObservation

CAMERA = Camera(64, 48, 60.0, 61.0, 31.5, 23.5, (-0.05, 0.01, 1e-4, -2e-4, 0.0))
MOUNT = CameraMount(height_m=0.9, pitch_rad=0.3)
STAMPS = (0.1, 0.2, 1 / 3, 0.4)


def frame_at(stamp: float, depth_m: float = 2.0) -> RgbdFrame:
    rng = np.random.default_rng(int(stamp * 1000))
    color = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    whole = rng.integers(0, 500, (48, 64)) + int(1000 * depth_m)
    depth = whole.astype(np.float32) * np.float32(1 / 1000)
    depth[:10] = 0.0
    return RgbdFrame(stamp, color, depth, CAMERA, MOUNT)


def written(folder: Path) -> Path:
    velocities = [VelocityObservation(0.15, 3.0, 0.1, np.eye(2))]
    truth = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)))
    cones = TruthMap(np.array([4]), np.array([(1.0, 2.0)]), np.array([1]))
    with RgbdWriter(folder, CAMERA, MOUNT, lossless=True) as writer:
        for stamp in STAMPS:
            writer.add(frame_at(stamp))
        writer.add_truth(velocities, truth, cones)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return written(tmp_path / "drive")


def frames_of(folder: Path) -> list[RgbdFrame]:
    return [e for e in read_rgbd_folder(folder).events() if isinstance(e, RgbdFrame)]


def test_what_is_written_reads_back_to_the_last_bit(folder: Path) -> None:
    source = read_rgbd_folder(folder)
    assert source.name == "drive"
    assert source.n_frames == 4
    assert source.truth_map is not None
    assert source.truth_map.id.tolist() == [4]
    assert source.truth_trajectory is not None
    for _ in range(2):
        events = list(source.events())
        stamps = [e.stamp_s for e in events]
        assert stamps == [0.1, 0.15, 0.2, 1 / 3, 0.4]
        for event in events:
            if isinstance(event, RgbdFrame):
                original = frame_at(event.stamp_s)
                assert np.array_equal(event.color, original.color)
                assert np.array_equal(event.depth_m, original.depth_m)
                assert event.camera == CAMERA
                assert event.mount == MOUNT
    assert source.rejected == {}


def test_jpeg_is_smaller_and_near(tmp_path: Path) -> None:
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    color = np.stack([2 * u + v, 255 - 3 * u, 4 * v], -1).astype(np.uint8)
    frame = replace(frame_at(0.1), color=color)
    with RgbdWriter(tmp_path / "j", CAMERA, MOUNT) as writer:
        writer.add(frame)
    back = frames_of(tmp_path / "j")[0]
    assert np.abs(back.color.astype(int) - color).mean() < 1.5
    assert np.array_equal(back.depth_m, frame.depth_m)


def test_a_sequence_is_not_written_over(folder: Path) -> None:
    with pytest.raises(ConegraphError, match="holds an RGB-D sequence already"):
        RgbdWriter(folder, CAMERA, MOUNT)


def test_a_killed_recording_reads_up_to_its_last_frame(tmp_path: Path) -> None:
    with RgbdWriter(tmp_path / "killed", CAMERA, MOUNT) as writer:
        writer.add(frame_at(0.1))
        writer.add(frame_at(0.2))
        assert [f.stamp_s for f in frames_of(tmp_path / "killed")] == [0.1, 0.2]


def picture(folder: Path, kind: str, index: int) -> Path:
    return sorted((folder / kind).iterdir())[index]


def test_bad_pictures_are_counted_and_the_rest_is_read(folder: Path) -> None:
    first = picture(folder, "rgb", 0)
    first.write_bytes(first.read_bytes()[: first.stat().st_size // 2])
    picture(folder, "rgb", 1).write_text("<html>not found</html>", encoding="utf-8")
    picture(folder, "depth", 2).unlink()
    source = read_rgbd_folder(folder)
    frames = [e for e in source.events() if isinstance(e, RgbdFrame)]
    assert [f.stamp_s for f in frames] == [0.4]
    assert source.rejected == {
        "colour picture is cut off": 1,
        "colour picture is no picture that can be read here": 1,
        "depth picture cannot be read": 1,
    }
    list(source.events())
    assert sum(source.rejected.values()) == 3


def test_a_wrong_size_or_type_is_counted(folder: Path) -> None:
    small = np.zeros((24, 32, 3), np.uint8)
    cv2.imwrite(str(picture(folder, "rgb", 0)), small)
    cv2.imwrite(str(picture(folder, "depth", 1)), np.ones((48, 64), np.uint8))
    cv2.imwrite(str(picture(folder, "depth", 2)), np.ones((48, 64, 3), np.uint16))
    source = read_rgbd_folder(folder)
    assert len([e for e in source.events() if isinstance(e, RgbdFrame)]) == 1
    assert source.rejected == {
        "colour picture is 32 x 24, not 64 x 48 as in camera.toml": 1,
        "depth picture is 1 x uint8 a pixel, but depth is one uint16": 1,
        "depth picture is 3 x uint16 a pixel, but depth is one uint16": 1,
    }


def test_no_usable_frame_is_an_error(folder: Path) -> None:
    for path in (folder / "rgb").iterdir():
        path.write_bytes(b"GIF89a")
    with pytest.raises(FileFormatError, match="no frame can be used: 4 x colour"):
        frames_of(folder)


def huge_png(width: int, height: int) -> bytes:
    """Return a PNG of few bytes that claims a size."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        size, check = struct.pack(">I", len(body)), zlib.crc32(kind + body)
        return size + kind + body + struct.pack(">I", check)

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(bytes(100))
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", body)
        + chunk(b"IEND", b"")
    )


def test_a_hundred_megapixels_are_refused_before_decoding(tmp_path: Path) -> None:
    path = tmp_path / "big.png"
    path.write_bytes(huge_png(10000, 10001))
    with pytest.raises(FileFormatError, match=r"claims 10000 x 10001 pixels"):
        read_color(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".webp", ".ppm"])
def test_the_claimed_size_is_the_decoded_one(suffix: str) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (33, 57, 3), dtype=np.uint8)
    ok, coded = cv2.imencode(suffix, noise)
    assert ok
    assert claimed_size(coded.tobytes()) == (57, 33)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_only_a_picture_whose_own_end_is_missing_is_cut_off(
    tmp_path: Path, suffix: str
) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (40, 50, 3), dtype=np.uint8)
    coded = cv2.imencode(suffix, noise)[1].tobytes()
    path = tmp_path / f"phone{suffix}"
    path.write_bytes(coded + b"ftypmp42" * 1000)
    assert read_color(path).shape == (40, 50, 3)
    if suffix == ".jpg":
        thumbnail = b"\xff\xe1" + (6).to_bytes(2, "big") + b"ab\xff\xd9"
        path.write_bytes(coded[:2] + thumbnail + coded[2:])
        assert read_color(path).shape == (40, 50, 3)
        coded = coded[:2] + thumbnail + coded[2:]
    for kept in (len(coded) // 2, len(coded) - 9):
        path.write_bytes(coded[:kept])
        with pytest.raises(FileFormatError, match="is cut off"):
            read_color(path)


@pytest.fixture(scope="module")
def mutated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mutated") / "picture"


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_no_mutated_picture_does_more_than_raise(
    mutated: Path, data: st.DataObject
) -> None:
    kind = data.draw(st.sampled_from([".png", ".jpg", ".webp", ".ppm", ".bmp"]))
    noise = np.random.default_rng(0).integers(0, 255, (20, 30, 3), dtype=np.uint8)
    coded = bytearray(cv2.imencode(kind, noise)[1].tobytes())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, min(len(coded) - 1, 60)))
        coded[at] = data.draw(st.integers(0, 255))
    mutated.write_bytes(bytes(coded))
    try:
        shown = read_color(mutated)
    except FileFormatError:
        return
    assert shown.dtype == np.uint8
    assert shown.ndim == 3


def test_units_that_cannot_be_are_an_error(folder: Path) -> None:
    about = CameraFile(CAMERA, None, units_per_m=1.0)
    (folder / "camera.toml").write_text(format_camera_toml(about), encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"depth\.units_per_m: 1 cannot be"):
        frames_of(folder)


def ground(camera: Camera, mount: CameraMount) -> RgbdFrame:
    v = (np.arange(48) - camera.cy_px) / camera.fy_px
    fall = np.sin(mount.pitch_rad) + v * np.cos(mount.pitch_rad)
    depth = np.where(fall > 0.02, mount.height_m / np.maximum(fall, 0.02), 0)
    wide = np.repeat(depth[:, None], 64, 1).astype(np.float32)
    return RgbdFrame(0.0, np.zeros((48, 64, 3), np.uint8), wide, camera, mount)


@pytest.mark.parametrize("factor", [0.001, 0.2, 5.0, 1000.0])
def test_the_ground_tells_a_wrong_unit(factor: float) -> None:
    frame = ground(CAMERA, MOUNT)
    assert unit_problem(frame.depth_m, CAMERA, MOUNT) is None
    wrong = frame.depth_m * np.float32(factor)
    assert unit_problem(wrong, CAMERA, MOUNT) is not None


def test_depth_without_anything_is_no_question_of_units() -> None:
    assert unit_problem(np.zeros((48, 64), np.float32), CAMERA, MOUNT) is None


def test_pairs_are_the_closest_and_each_is_used_once() -> None:
    first = np.array([0.0, 0.033, 0.066, 0.1])
    second = np.array([0.001, 0.034, 0.036, 0.2])
    assert associate(first, second, 0.02).tolist() == [[0, 0], [1, 1]]
    assert associate(first, second, 0.05).tolist() == [[0, 0], [1, 1], [2, 2]]
    assert associate(np.zeros(0), second, 0.02).shape == (0, 2)


@given(
    st.lists(st.floats(0, 1), max_size=30).map(sorted),
    st.lists(st.floats(0, 1), max_size=30).map(sorted),
)
def test_pairs_are_one_to_one_and_near(first: list[float], second: list[float]) -> None:
    pairs = associate(np.array(first), np.array(second), 0.02)
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)
    for a, b in pairs.tolist():
        assert abs(first[a] - second[b]) <= 0.02 + 1e-12


def test_lists_drop_lines_that_make_no_sense(tmp_path: Path) -> None:
    path = tmp_path / "rgb.txt"
    path.write_text(
        "# timestamp filename\n1 a.png\nx b.png\n2\n3 ../c.png\n2.5 d e.png\n2 f.png\n",
        encoding="utf-8",
    )
    rejected: Counter[str] = Counter()
    pictures = read_picture_list(path, rejected)
    assert [p.name for p in pictures.path] == ["a.png", "d e.png"]
    assert rejected == {
        "rgb.txt: not a stamp and a file": 2,
        "rgb.txt: file outside the folder": 1,
        "rgb.txt: stamp out of order": 1,
    }


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fx_px = 60.0", "fx_px = -60.0", "camera.fx_px: input should be greater"),
        ("fx_px = 60.0\n", "", "camera.fx_px: is missing"),
        ("fx_px = 60.0", "fx_px = nan", "camera.fx_px: input should be"),
        ("cx_px = 31.5", "cx_px = 310.5", "camera.cx_px: 310.5 is off the picture"),
        ("width_px = 64", "width_px = 6400000", "camera.width_px: input should be"),
        ("height_m = 0.9", "height = 0.9", "mount.height: no such key"),
        ("[camera]", "[camera", "is no TOML"),
    ],
)
def test_a_wrong_camera_toml_names_the_key(
    folder: Path, old: str, new: str, message: str
) -> None:
    path = folder / "camera.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(FileFormatError) as caught:
        read_rgbd_folder(folder)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_a_camera_toml_reads_back_to_the_last_bit(tmp_path: Path) -> None:
    file = CameraFile(replace(CAMERA, fx_px=1 / 3), MOUNT, 5000.0, 0.01)
    path = tmp_path / "camera.toml"
    path.write_text(format_camera_toml(file), encoding="utf-8")
    assert read_camera_toml(path) == file


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "camera.toml"])
def test_a_missing_part_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(FileFormatError, match=f"{name}: is missing"):
        read_rgbd_folder(folder)


def test_a_real_pair_in_the_tum_layout_is_read(tmp_path: Path, data_dir: Path) -> None:
    """One real frame of the TUM sequences, whose depths are in 1/5000 m."""
    real = data_dir / "rgbd_open3d_testdata" / "RGBD" / "other_formats"
    folder = tmp_path / "tum"
    folder.mkdir()
    for kind in ("color", "depth"):
        shutil.copy(real / f"TUM_{kind}.png", folder / f"{kind}.png")
    (folder / "rgb.txt").write_text("1.0 color.png\n", encoding="utf-8")
    (folder / "depth.txt").write_text("1.01 depth.png\n", encoding="utf-8")
    lens = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    about = CameraFile(lens, None, units_per_m=5000.0)
    (folder / "camera.toml").write_text(format_camera_toml(about), encoding="utf-8")
    frame = frames_of(folder)[0]
    assert float(np.median(frame.depth_m[frame.depth_m > 0])) == pytest.approx(2.415)
    stored = read_depth(folder / "depth.png")
    assert frame.depth_m[300, 300] == pytest.approx(stored[300, 300] / 5000)
