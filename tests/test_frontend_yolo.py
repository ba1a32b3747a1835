"""The learned detector: YOLO's layouts, engines, wrong models, and what it finds."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from conegraph.camera import RgbdFrame
from conegraph.config import YoloConfig, load_config
from conegraph.config.detector import EngineName
from conegraph.errors import ConfigError, FileFormatError
from conegraph.frontend import make_front_end, yolo_engine
from conegraph.frontend.sizes import Sizes, fits
from conegraph.frontend.yolo import YoloDetector, body_pixels, touching
from conegraph.frontend.yolo_engine import SHIPPED, open_engine
from conegraph.frontend.yolo_layout import decoded, letterboxed, strongest
from conegraph.sim.render import FrameTruth, draw_light, make_scene, render_frame
from conegraph.types import ConeClass, TruthMap

Floats = NDArray[np.float32]
ENGINES: tuple[EngineName, ...] = ("onnxruntime", "opencv")
BOXES = np.array([[10.0, 20.0, 30.0, 60.0], [100.0, 50.0, 140.0, 90.0]])
SURE = np.zeros(4, dtype=bool)
SCORES = np.array([[0.9, 0.05, 0.0], [0.1, 0.2, 0.6]])


def rows() -> Floats:
    """Return middle, size and scores (N, 4 + C) of the boxes."""
    size = BOXES[:, 2:] - BOXES[:, :2]
    return np.hstack([BOXES[:, :2] + size / 2, size, SCORES]).astype(np.float32)


def padded(found: Floats) -> Floats:
    """Return the rows and 98 empty ones."""
    return np.vstack([found, np.zeros((98, found.shape[1]), np.float32)])


def test_every_layout_says_the_same() -> None:
    plain = padded(rows())
    sure = np.full((100, 1), 0.5, np.float32)
    v5 = np.hstack([plain[:, :4], sure, 2 * plain[:, 4:]])
    for output in (plain.T[None], v5[None]):
        box, score = decoded(output, 3)
        np.testing.assert_allclose(box[:2], BOXES, atol=1e-5)
        np.testing.assert_allclose(score[:2], SCORES, atol=1e-6)


@pytest.mark.parametrize(
    "shape", [(1, 9, 100), (1, 100, 7), (1, 7), (2, 7, 100), (7, 100)]
)
def test_other_layouts_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="output"):
        decoded(np.zeros(shape, np.float32), 3)


@pytest.mark.parametrize("wrong", [np.nan, -2.0, 7.3])
def test_scores_that_are_no_probabilities_are_refused(wrong: float) -> None:
    output = padded(rows())
    output[1, 5] = wrong
    with pytest.raises(ValueError, match="within 0 and 1"):
        decoded(output.T[None], 3)


def test_a_size_of_one_side_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"input_px.*one side"):
        load_config(None, ["detector.kind=yolo", "detector.input_px=[640,0]"])


@pytest.mark.parametrize("share", [0.9, 0.3])
def test_big_cones_fit_if_they_are_orange_however_weak(share: float) -> None:
    big = Sizes(
        np.array([0.5]), np.array([[40.0, 1.0]]), np.zeros((1, 2)), np.zeros((1, 4))
    )
    orange, blue = np.zeros((1, 5)), np.zeros((1, 5))
    orange[0, [ConeClass.BIG_ORANGE, ConeClass.UNKNOWN]] = share, 1 - share
    blue[0, [ConeClass.BLUE, ConeClass.UNKNOWN]] = share, 1 - share
    assert fits(orange, big, 14.0).tolist() == [True]
    assert fits(blue, big, 14.0).tolist() == [False]


def test_a_small_picture_is_padded_and_keeps_its_size() -> None:
    picture = np.full((70, 100, 3), 51, np.uint8)
    fitted = letterboxed(picture, 1280, (0, 0))
    assert fitted.blob.shape == (1, 3, 96, 128)
    np.testing.assert_allclose(fitted.scale, 1.0)
    np.testing.assert_allclose(fitted.blob[0, :, :70, :100], 0.2)
    np.testing.assert_allclose(fitted.blob[0, :, 70:], 114 / 255)


@pytest.mark.parametrize("input_px", [(0, 0), (320, 320)])
def test_a_large_picture_is_made_smaller(input_px: tuple[int, int]) -> None:
    fitted = letterboxed(np.zeros((480, 960, 3), np.uint8), 320, input_px)
    assert fitted.blob.shape[3] == 320
    assert fitted.blob.shape[2] == (input_px[1] or 160)
    np.testing.assert_allclose(fitted.scale, 3.0)


def test_the_strongest_of_overlapping_boxes_stays() -> None:
    box = np.array([[0.0, 0, 10, 20], [1, 0, 11, 20], [30, 0, 40, 20], [60, 0, 70, 20]])
    kept = strongest(box, np.array([0.5, 0.8, 0.6, 0.2]), 0.3, 0.5)
    assert kept.tolist() == [1, 2]


@given(
    st.lists(
        st.tuples(
            st.floats(-0.5, 90), st.floats(-0.5, 60), st.floats(1, 60), st.floats(1, 70)
        ),
        max_size=4,
    )
)
def test_pixels_of_a_body_lie_in_its_box(
    given_boxes: list[tuple[float, float, float, float]],
) -> None:
    corner = np.array(given_boxes).reshape(-1, 4)
    box = np.hstack([corner[:, :2], corner[:, :2] + corner[:, 2:]])
    box = np.minimum(box, np.array([99.5, 69.5, 99.5, 69.5]))
    uv, owner = body_pixels(box, SURE[: len(box)], (70, 100, 3))
    assert (np.diff(owner) >= 0).all()
    assert len(np.unique(uv, axis=0)) == len(uv)
    assert (uv >= np.floor(box[owner, :2])).all()
    assert (uv <= np.ceil(box[owner, 2:])).all()
    if len(box):
        assert int(box[:, 3].argmax()) in owner


def test_the_lowest_pixel_of_a_body_is_that_of_its_box() -> None:
    uv, _ = body_pixels(np.array([[9.5, 19.5, 29.5, 49.5]]), SURE[:1], (60, 60, 3))
    assert uv[:, 1].max() == 49


def test_pixels_of_two_cones_are_the_nearer_ones() -> None:
    box = np.array([[9.5, 19.5, 29.5, 49.5], [14.5, 29.5, 34.5, 59.5]])
    uv, owner = body_pixels(box, SURE[:2], (70, 60, 3))
    alone, _ = body_pixels(box[1:], SURE[:1], (70, 60, 3))
    assert uv[owner == 1].tolist() == alone.tolist()
    hidden = {tuple(pixel) for pixel in alone.tolist()}
    assert not hidden & {tuple(pixel) for pixel in uv[owner == 0].tolist()}
    assert (owner == 0).any()


def test_boxes_that_meet_touch() -> None:
    box = np.array([[0.0, 0, 10, 10], [9, 9, 20, 20], [20, 9, 30, 20]])
    assert touching(box, SURE[:3]).tolist() == [True, True, False]
    assert touching(box, np.array([False, True, False])).tolist() == [
        False,
        True,
        False,
    ]


def test_weak_boxes_take_no_pixels_from_others() -> None:
    box = np.array([[9.5, 19.5, 29.5, 49.5], [14.5, 29.5, 34.5, 59.5]])
    uv, owner = body_pixels(box, np.array([False, True]), (70, 60, 3))
    alone, _ = body_pixels(box[:1], SURE[:1], (70, 60, 3))
    assert uv[owner == 0].tolist() == alone.tolist()
    assert (owner == 1).any()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_file_that_is_no_network_is_refused(
    engine: EngineName, tmp_path: Path
) -> None:
    path = tmp_path / "net.onnx"
    with pytest.raises(FileFormatError, match="No such file"):
        open_engine(path, engine)
    path.write_bytes(b"\x08\x07 no network at all")
    with pytest.raises(FileFormatError, match="is no ONNX network"):
        open_engine(path, engine)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    with path.open("wb") as file:
        file.truncate(yolo_engine.MAX_BYTES + 1)
    with pytest.raises(FileFormatError, match="too many"):
        open_engine(path, "opencv")


def test_shipped_weights_that_were_changed_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "cones.onnx"
    path.write_bytes(SHIPPED.read_bytes() + b"\x00")
    monkeypatch.setattr(yolo_engine, "SHIPPED", path)
    with pytest.raises(FileFormatError, match="SHA-256"):
        open_engine(path, "opencv")


def test_the_shipped_file_is_small() -> None:
    assert SHIPPED.stat().st_size <= 5_000_000


def test_a_model_of_other_classes_is_refused() -> None:
    detector = YoloDetector(YoloConfig(classes=("blue", "yellow")))
    with pytest.raises(FileFormatError, match=r"detector\.classes names 2 classes"):
        detector.find(np.zeros((64, 64, 3), np.uint8))


def test_a_size_that_a_model_does_not_take_is_refused() -> None:
    detector = YoloDetector(YoloConfig(engine="onnxruntime", input_px=(50, 70)))
    with pytest.raises(FileFormatError, match=r"50 x 70 px; .* set detector\.input_px"):
        detector.find(np.zeros((64, 64, 3), np.uint8))


@pytest.fixture(scope="module")
def rendered() -> tuple[RgbdFrame, FrameTruth]:
    rng = np.random.default_rng(11)
    xy = np.array([[4.0, 1.2], [5.0, -1.4], [7.0, 0.6], [9.0, -1.6]])
    kinds = np.array([0, 1, 2, 3])
    cones = TruthMap(np.arange(4), xy, kinds)
    scene = make_scene(cones, rng, light=draw_light(rng, "overcast"), clutter=3)
    return render_frame(scene, np.zeros(3), rng)


def test_all_cones_of_a_render_are_found_and_placed(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    frame, truth = rendered
    seen = make_front_end(load_config(None, ["detector.kind=yolo"])).examine(frame)
    cones = seen.observations
    assert len(cones) == len(truth)
    away = np.hypot(*(cones.xy_m[:, None] - truth.xy_m[None]).transpose(2, 0, 1))
    nearest = away.argmin(axis=1)
    assert sorted(nearest.tolist()) == [0, 1, 2, 3]
    assert away.min(axis=1).max() < 0.25
    assert (cones.class_prob.argmax(axis=1) == truth.cone_class[nearest]).all()


def test_engines_find_the_same_boxes(rendered: tuple[RgbdFrame, FrameTruth]) -> None:
    frame, _ = rendered
    first, second = (
        YoloDetector(YoloConfig(engine=engine)).find(frame.color) for engine in ENGINES
    )
    assert len(first) >= 4
    np.testing.assert_allclose(first.box_px, second.box_px, atol=0.01)
    np.testing.assert_allclose(first.score, second.score, atol=1e-4)


def test_boxes_of_an_enlarged_picture_are_enlarged(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    """Every pixel is made four; made smaller again the network sees the same."""
    picture = rendered[0].color
    detector = YoloDetector(YoloConfig(max_side_px=picture.shape[1]))
    plain = detector.find(picture)
    large = detector.find(picture.repeat(2, axis=0).repeat(2, axis=1))
    # Edges: the first pixel's is at -0.5 in both. The foot is sought in the picture.
    expected = 2.0 * (plain.box_px + 0.5) - 0.5
    np.testing.assert_allclose(large.box_px[:, :3], expected[:, :3], atol=1e-3)
    np.testing.assert_allclose(large.box_px[:, 3], expected[:, 3], atol=2.0)
    np.testing.assert_allclose(large.score, plain.score, atol=1e-5)


def test_the_less_sure_the_more_is_unknown(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    frame, _ = rendered
    found = YoloDetector(YoloConfig(min_score=0.05)).find(frame.color)
    np.testing.assert_allclose(found.class_prob.sum(axis=1), 1.0)
    unknown = found.class_prob[:, ConeClass.UNKNOWN]
    np.testing.assert_allclose(unknown, 1 - np.sqrt(found.score), atol=1e-6)


def test_orange_cones_of_one_class_may_be_of_either_size(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    frame, _ = rendered
    config = YoloConfig(classes=("blue", "yellow", "orange", "orange"))
    prob = YoloDetector(config).find(frame.color).class_prob
    small, big = prob[:, ConeClass.ORANGE], prob[:, ConeClass.BIG_ORANGE]
    assert (small == big).all()
    assert (small + big > 0.5).sum() == 2
