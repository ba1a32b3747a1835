"""The detector's training: pictures, labels, loss, average precision, resuming."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from conegraph.cli.train_detector import _own, _say_rounded
from conegraph.errors import FileFormatError
from conegraph.training.average_precision import Boxes, average_precision, overlaps
from conegraph.training.batches import STEPS_A_ROUND, Crops
from conegraph.training.collage import CLASSES, HEIGHT_PX, WIDTH_PX, make_collages
from conegraph.training.folder import held_out, read_folder, split
from conegraph.training.palette import make_sheets
from conegraph.training.photometric import photographed
from conegraph.training.report import as_boxes, judged
from conegraph.training.sample import IGNORED, Sample, crop
from conegraph.types import Array, IntArray

GREY = np.full((200, 300, 3), 90, np.uint8)


def boxes(box: list[list[float]], kind: list[int], score: list[float]) -> Boxes:
    return Boxes(
        np.array(box, dtype=float).reshape(-1, 4), np.array(kind), np.array(score)
    )


def test_overlap_of_shifted_squares() -> None:
    one = np.array([[0.0, 0, 10, 10]])
    np.testing.assert_allclose(overlaps(one, one + np.array([5, 0, 5, 0])), 1 / 3)
    np.testing.assert_allclose(overlaps(one, one + 10), 0.0)


def test_average_precision_by_hand() -> None:
    real = [boxes([[0, 0, 10, 20], [50, 0, 60, 20]], [0, 0], [1, 1])]
    # Right at 0.9, wrong at 0.8, right at 0.7: precision 1 up to a half, then 2 / 3.
    found = [
        boxes(
            [[0, 0, 10, 20], [100, 0, 110, 20], [51, 0, 61, 20]],
            [0, 0, 0],
            [0.9, 0.8, 0.7],
        )
    ]
    expected = 0.5 * 1 + 0.5 * 2 / 3
    assert average_precision(found, real, 0) == pytest.approx(expected)
    assert np.isnan(average_precision(found, real, 1))


def test_a_second_box_on_a_cone_is_wrong_and_an_ignored_cone_is_not() -> None:
    real = [boxes([[0, 0, 10, 20], [50, 0, 60, 20]], [0, IGNORED], [1, 1])]
    twice = [boxes([[0, 0, 10, 20], [0, 1, 10, 20]], [0, 0], [0.6, 0.9])]
    assert average_precision(twice, real, 0) == 1.0
    first = [boxes([[0, 4, 10, 20], [0, 0, 10, 20]], [0, 0], [0.5, 0.4])]
    assert average_precision(first, real, 0) == 1.0
    ignored = [boxes([[50, 0, 60, 20], [0, 0, 10, 20]], [0, 0], [0.9, 0.4])]
    assert average_precision(ignored, real, 0) == 1.0
    other = [boxes([[90, 0, 99, 20], [0, 0, 10, 20]], [0, 0], [0.9, 0.4])]
    assert average_precision(other, real, 0) == 0.5


def test_only_the_heights_asked_for_count() -> None:
    real = [boxes([[0, 0, 10, 20], [50, 0, 60, 9]], [0, 0], [1, 1])]
    found = [boxes([[50, 0, 60, 9], [80, 0, 90, 9]], [0, 0], [0.9, 0.8])]
    assert average_precision(found, real, 0, (8, 16)) == 1.0
    assert average_precision(found, real, 0, (16, 32)) == 0.0


def test_a_class_that_is_never_named_is_never_found() -> None:
    box = np.array([[0.0, 0, 10, 20]])
    blue = np.eye(5)[:1]
    there = [boxes((box + 0.5).tolist(), [1], [1])]
    found = [as_boxes(box, blue, np.array([0.9]))]
    assert judged(found, there).by_class[1] == 0.0
    either = np.array([[0.7, 0.3, 0.0, 0.0, 0.0]])
    found = [as_boxes(box, either, np.array([0.9]))]
    assert judged(found, there).by_class[1] == 1.0


@pytest.mark.parametrize("seed", range(20))
def test_a_crop_moves_boxes_with_their_pixels(seed: int) -> None:
    picture = GREY.copy()
    picture[60:100, 120:150] = (250, 0, 0)
    whole = Sample(picture, np.array([[120.0, 60, 150, 100]]), np.array([2]))
    piece = crop(whole, 96, np.random.default_rng(seed))
    red = (piece.picture[..., 0] > 170) & (piece.picture[..., 1] < 50)
    if not len(piece.box_px):
        assert red.sum() <= 96
        return
    v, u = np.nonzero(red)
    found = np.array([u.min(), v.min(), u.max() + 1, v.max() + 1])
    np.testing.assert_allclose(piece.box_px[0], found, atol=1.5)


def test_what_a_crop_cuts_off_is_ignored() -> None:
    box = np.array([[-40.0, 0, 10, 60], [20, 0, 60, 60], [70, 0, 80, 4]])
    from conegraph.training.sample import clipped

    cut, kind = clipped(box, np.array([0, 1, 2]), 100, 100)
    assert kind.tolist() == [IGNORED, 1, IGNORED]
    assert cut[0].tolist() == [0, 0, 10, 60]


def collage(seed: int) -> Sample:
    sheets = make_sheets(np.random.default_rng(0))
    return make_collages(2, sheets, np.random.default_rng(seed))[1]


def test_collages_follow_their_seed_and_label_what_they_show() -> None:
    one, again = collage(3), collage(3)
    assert (one.picture == again.picture).all()
    assert (one.box_px == again.box_px).all()
    assert one.picture.shape == (HEIGHT_PX, WIDTH_PX, 3)
    assert set(one.kind.tolist()) <= {IGNORED, *range(len(CLASSES))}
    assert (one.box_px[:, 2:] > one.box_px[:, :2]).all()


def hue_inside(picture: np.ndarray, box_px: Array) -> Array:
    """Return the hue (N,) of the most colourful tenth of every box."""
    found = []
    for left, top, right, low in np.clip(box_px, 0, None).astype(int):
        part = cv2.cvtColor(picture[top:low, left:right], cv2.COLOR_RGB2HSV)
        hue, deep = part[..., 0].ravel(), part[..., 1].ravel()
        strong = hue[deep >= np.quantile(deep, 0.9)].astype(float)
        found.append(np.median((strong + 20) % 180) - 20)
    return np.array(found)


def test_labels_of_collages_have_their_colours() -> None:
    kinds: list[IntArray] = []
    hues = []
    for seed in range(6):
        one = collage(seed)
        tall = (one.box_px[:, 3] - one.box_px[:, 1] > 25) & (one.kind != IGNORED)
        tall &= (one.box_px >= 0).all(axis=1)
        tall &= (one.box_px[:, 2:] <= (WIDTH_PX, HEIGHT_PX)).all(axis=1)
        kinds.append(one.kind[tall])
        hues.append(hue_inside(one.picture, one.box_px[tall]))
    kind, hue = np.concatenate(kinds), np.concatenate(hues)
    assert len(kind) > 20
    expected = np.array([106.0, 25.0, 0.0, 0.0])[kind]
    assert (np.abs(hue - expected) < 16).mean() > 0.9


def test_photographs_keep_size_and_follow_their_seed() -> None:
    first, second = (
        photographed(collage(5).picture, np.random.default_rng(8)) for _ in range(2)
    )
    assert first.shape == (HEIGHT_PX, WIDTH_PX, 3)
    assert (first == second).all()


def test_rounds_are_the_same_whoever_makes_them() -> None:
    kept = [Sample(GREY, np.zeros((0, 4)), np.zeros(0, dtype=np.int64))]
    alone, helped = (Crops(4, 1, 64, kept, jobs).rounds(0) for jobs in (0, 1))
    first, second = next(alone), next(helped)
    assert len(first) == len(second) == STEPS_A_ROUND
    for one, other in zip(first, second, strict=True):
        assert (one[0].picture == other[0].picture).all()
        assert (one[0].box_px == other[0].box_px).all()


def test_a_folder_of_labelled_pictures(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), GREY)
    cv2.imwrite(str(tmp_path / "unlabelled.png"), GREY)
    label = tmp_path / "a.txt"
    label.write_text("1 0.5 0.5 0.1 0.2\n")
    (sample,) = read_folder(tmp_path).values()
    np.testing.assert_allclose(sample.box_px, [[135.0, 80.0, 165.0, 120.0]])
    assert sample.kind.tolist() == [1]
    (tmp_path / "classes.txt").write_text("yellow\nbig_orange\n")
    assert read_folder(tmp_path)["a.png"].kind.tolist() == [3]
    label.write_text("1 0.5 0.5 -0.1 -0.2\n")
    with pytest.raises(FileFormatError, match=r"a\.txt:1: '1 0\.5 0\.5 -0\.1"):
        read_folder(tmp_path)
    label.write_text("1 0.5 0.5 0.1 0.2\n7 0.5 0.5 0.1 0.2\n")
    with pytest.raises(FileFormatError, match=r"a\.txt:2: '7 0.5"):
        read_folder(tmp_path)
    (tmp_path / "classes.txt").write_text("yellow\npink\n")
    with pytest.raises(FileFormatError, match="'pink' is none of"):
        read_folder(tmp_path)
    (tmp_path / "classes.txt").write_bytes(b"\xff\xfe")
    with pytest.raises(FileFormatError, match="is none of"):
        read_folder(tmp_path)


def test_one_of_ten_pictures_is_held_out_whatever_the_others_are() -> None:
    none = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
    pictures = {f"{k:04}.jpg": Sample(GREY, *none) for k in range(1000)}
    learn, test = split(pictures)
    assert len(learn) + len(test) == 1000
    assert 70 < len(test) < 130
    fewer = dict(list(pictures.items())[::2])
    assert [id(s) for s in split(fewer)[1]] == [
        id(s) for s in fewer.values() if any(s is t for t in test)
    ]
    alone = next(name for name, s in pictures.items() if s is test[0])
    assert split({alone: test[0]}) == ([test[0]], [])


def test_the_command_says_what_it_rounds_and_what_it_holds_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k in range(20):
        cv2.imwrite(str(tmp_path / f"{k}.png"), GREY)
        (tmp_path / f"{k}.txt").write_text("1 0.5 0.5 0.3 0.5\n", encoding="utf-8")
    _say_rounded(2 * STEPS_A_ROUND)
    assert capsys.readouterr().out == ""
    _say_rounded(STEPS_A_ROUND + 1)
    assert capsys.readouterr().out.startswith("48 steps in place of 25: rounds of 24")
    learn, test = _own(tmp_path)
    test_names = [f"{k}.png" for k in range(20) if held_out(f"{k}.png")]
    assert len(test) == len(test_names) == 20 - len(learn) > 0
    said = capsys.readouterr().out
    assert said.endswith(f"{len(learn)} pictures to learn from, {len(test)} held out\n")
    for name in test_names:
        (tmp_path / name).unlink()
    assert _own(tmp_path)[1] == []
    assert "0 held out (too few pictures: one of 10" in capsys.readouterr().out


def test_large_pictures_are_learned_at_the_size_they_are_looked_at(
    tmp_path: Path,
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((1000, 2560, 3), 90, np.uint8))
    (tmp_path / "a.txt").write_text("1 0.5 0.5 0.1 0.2\n")
    (sample,) = read_folder(tmp_path).values()
    assert sample.picture.shape == (500, 1280, 3)
    np.testing.assert_allclose(sample.box_px, [[576.0, 200.0, 704.0, 300.0]])


def test_a_folder_without_labels_is_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), GREY)
    with pytest.raises(FileFormatError, match="no picture with a label"):
        read_folder(tmp_path)


def test_without_torch_the_command_names_the_extra(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from conegraph.cli import main\n"
        f"main(['train-detector', '--out', {str(tmp_path)!r}])"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert ended.stderr.splitlines() == [
        "conegraph: training needs PyTorch and onnx: pip install 'conegraph[train]'"
    ]
