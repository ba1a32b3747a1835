"""Scores that can be worked out by hand, and one small run of the whole."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from conegraph.bench.frontend import Measured, front_end_figures
from conegraph.bench.frontend_photos import read_photos
from conegraph.bench.frontend_score import Score, match_boxes, pooled, score_frame
from conegraph.cli.app import app
from conegraph.config import load_config
from conegraph.errors import FileFormatError
from conegraph.frontend import make_front_end
from conegraph.sim.render import make_scene, render_frame
from conegraph.types import ConeClass, ConeObservations, TruthMap

SCORE = Score(
    range_m=np.array([5.0, 6.0, 10.0, 15.0]),
    found=np.array([True, True, True, False]),
    error_m=np.array([[0.03, 0.04], [0.0, 0.1], [0.2, 0.0]]),
    cov_m2=np.tile(0.01 * np.eye(2), (3, 1, 1)),
    error_range_m=np.array([5.0, 6.0, 10.0]),
    whole=np.array([True, True, True]),
    colour_right=np.array([True, True, False]),
    false=1,
)


def test_figures_of_a_score() -> None:
    assert SCORE.precision == 0.75
    assert SCORE.recall(0, 8) == 1.0
    assert SCORE.recall(12, 20) == 0.0
    assert np.isnan(SCORE.recall(30, 40))
    assert SCORE.rmse_m(4, 5.5) == pytest.approx(0.05)
    assert SCORE.rmse_m(0, 8) == pytest.approx(np.sqrt((0.0025 + 0.01) / 2))
    # Squared errors of 0.0025 and 0.01 at a variance of 0.01, over two each.
    assert SCORE.nis_per_dof(0, 8) == pytest.approx((0.25 + 1.0) / 4)
    twice = pooled([SCORE, SCORE])
    assert (twice.false, len(twice.range_m), twice.precision) == (2, 8, 0.75)


def test_boxes_are_matched_once_and_by_overlap() -> None:
    true = np.array([[0.0, 0, 10, 10], [8, 0, 18, 10], [50, 50, 60, 60]])
    found = np.array([[7.0, 0, 17, 10], [1, 0, 11, 10], [56, 56, 66, 66]])
    assert match_boxes(found, true).tolist() == [[0, 1], [1, 0]]
    assert match_boxes(found[:0], true).shape == (0, 2)


def test_a_rendered_frame_is_scored() -> None:
    cones = TruthMap(
        np.arange(3), np.array([[5, 1.5], [5, -1.5], [3, 1.9]]), np.array([0, 1, 0])
    )
    rng = np.random.default_rng(3)
    scene = make_scene(cones, rng, clutter=0)
    frame, truth = render_frame(scene, np.zeros(3), rng)
    seen = make_front_end(load_config()).examine(frame)
    score = score_frame(frame, truth, seen)
    assert score.precision == 1.0
    assert score.colour_right.all()
    whole = (truth.box_px[:, 0] > 0) & (truth.box_px[:, 2] < 639)
    assert len(score.range_m) == int((whole & (truth.visible_fraction >= 0.5)).sum())
    extra = replace(
        seen,
        observations=ConeObservations(
            0.0,
            np.vstack([seen.observations.xy_m, [9.0, 9.0]]),
            np.concatenate([seen.observations.cov_m2, np.eye(2)[None]]),
            np.vstack([seen.observations.class_prob, np.eye(5)[0]]),
        ),
        box_px=np.vstack([seen.box_px, [600, 10, 620, 40]]),
    )
    assert score_frame(frame, truth, extra).false == 1
    blind = replace(
        seen,
        observations=seen.observations.subset(np.zeros(0, dtype=int)),
        box_px=np.zeros((0, 4)),
    )
    assert not score_frame(frame, truth, blind).found.any()


def test_every_figure_has_its_verdict() -> None:
    measured = Measured({"bright": SCORE}, SCORE, (5.0, 5.0), (150.0,), SCORE)
    figures = {f.name: f for f in front_end_figures(measured)}
    assert figures["frames/s on one core, 640x480"].values["value"] == 200.0
    assert figures["times the thesis profile's speed"].met
    assert figures["recall at 0 to 8 m, normal light"].met
    assert figures["recall at 12 to 20 m, normal light"].met is False
    assert figures["precision, normal light"].met is False
    assert figures["class right"].values["value"] == pytest.approx(2 / 3)


def test_of_lights_that_were_not_chosen_nothing_is_said() -> None:
    measured = Measured({"dusk": SCORE}, pooled([]), (5.0,), (), pooled([]))
    figures = {f.name: f for f in front_end_figures(measured)}
    for name in (
        "times the thesis profile's speed",
        "recall at 0 to 8 m, normal light",
        "precision, 1 degree of pitch",
    ):
        assert (figures[name].measured, figures[name].met) == ("not measured", None)
    assert figures["class right"].values["value"] == pytest.approx(2 / 3)
    assert figures["frames/s on one core, 640x480"].met


def test_photographs_and_their_labels(tmp_path: Path) -> None:
    import cv2

    picture = np.full((100, 200, 3), 90, dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    (tmp_path / "a.txt").write_text("2 0.5 0.5 0.1 0.4\n", encoding="utf-8")
    photo = next(iter(read_photos(tmp_path)))
    assert photo.box_px == pytest.approx(np.array([[89.5, 29.5, 109.5, 69.5]]))
    assert photo.cone_class.tolist() == [ConeClass.ORANGE]
    (tmp_path / "a.txt").write_text("0 0.5 0.5 0.1 0.4\n7 1 1 1 1\n", encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"a\.txt:2: '7 1 1 1 1' is no class"):
        list(read_photos(tmp_path))
    (tmp_path / "a.txt").unlink()
    with pytest.raises(FileFormatError, match="holds no picture with a label"):
        list(read_photos(tmp_path))


def test_a_small_run_is_measured(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    words = "bench frontend --seeds 1 --first-seed 3 --frames 2 --lights bright"
    result = CliRunner().invoke(app, [*words.split(), "--no-maps", "--json", str(file)])
    assert result.exit_code == 0, result.output
    figures = json.loads(file.read_text(encoding="utf-8"))["figures"]
    assert {"name", "target", "measured", "met", "values"} == set(figures[0])
    found = {figure["name"]: figure["values"] for figure in figures}
    assert found["recall at 0 to 8 m, normal light"]["value"] > 0.9
    assert found["times the thesis profile's speed"]["value"] > 3.0


def test_lights_are_those_there_are() -> None:
    result = CliRunner().invoke(app, ["bench", "frontend", "--lights", "moon"])
    assert result.exit_code == 2
