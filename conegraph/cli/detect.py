"""``conegraph detect``: the detectors alone, on pictures."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.cli.options import (
    ConfigOption,
    DetectorOption,
    SetOption,
    with_detector,
)
from conegraph.errors import ConegraphError, FileFormatError
from conegraph.eval.words import counted

if TYPE_CHECKING:
    from conegraph.camera import RgbdFrame
    from conegraph.frontend import FrontEnd
    from conegraph.frontend.base import Picture
    from conegraph.io.detections_csv import DetectionsCsv
    from conegraph.types import Array, ConeObservations


def detect(
    images: Annotated[
        list[str],
        typer.Argument(
            metavar="IMAGES…",
            help="Pictures, folders of them, or a SOURCE with depth: an RGB-D folder, "
            "a recording, sim:TRACK?sensor=rgbd.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE.csv", help="Table of what is found.")
    ],
    detector: DetectorOption = None,
    pictures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            file_okay=False,
            help="Where pictures of what is found go; FILE_pictures if not given.",
        ),
    ] = None,
    draw: Annotated[bool, typer.Option(help="Draw those pictures.")] = True,
    every: Annotated[
        int, typer.Option(min=1, help="With depth: take every N-th picture.")
    ] = 1,
    config: ConfigOption = None,
    set_: SetOption = None,
) -> None:
    """Find cones in pictures; write a table and drawings."""
    from conegraph.config import load_config
    from conegraph.frontend import make_front_end
    from conegraph.io.detections_csv import DetectionsCsv

    settings = with_detector(set_, detector)
    front_end = make_front_end(load_config(config, settings))
    folder = None
    if draw:
        folder = pictures or out.with_name(f"{out.stem}_pictures")
        folder.mkdir(parents=True, exist_ok=True)
    with DetectionsCsv(out) as table:
        job = _Job(front_end, table, folder)
        for image in images:
            _look_at(job, image, every)
    if job.failures and not job.pictures:
        raise job.failures[0]
    for reason, count in front_end.rejected.items():
        print(f"conegraph: {count} x {reason}: left out", file=sys.stderr)
    for failure in job.failures:
        print(f"conegraph: left out: {failure}", file=sys.stderr)
    shown = "" if folder is None else f", drawn in {folder}"
    cones, looked_at = counted(job.cones, "cone"), counted(job.pictures, "picture")
    typer.echo(f"{out}: {cones} in {looked_at}{shown}")


class _Job:
    """Looks at one picture after the other and keeps count."""

    def __init__(
        self, front_end: FrontEnd, table: DetectionsCsv, folder: Path | None
    ) -> None:
        self.pictures = 0
        self.cones = 0
        self.failures: list[FileFormatError] = []
        self._front_end = front_end
        self._table = table
        self._folder = folder
        self._drawn: Counter[str] = Counter()

    def file(self, path: Path) -> None:
        """Look at a picture file; one that cannot be read is remembered."""
        from conegraph.io.picture_file import read_color

        try:
            picture = read_color(path)
        except FileFormatError as error:
            self.failures.append(error)
            return
        found = self._front_end.find(picture)
        self._add(path.name, picture, found.box_px, found.class_prob, found.score)

    def frame(self, frame: RgbdFrame) -> None:
        """Look at a picture with depth."""
        seen = self._front_end.examine(frame)
        name, cones = f"{frame.stamp_s:.6f}", seen.observations
        prob = cones.class_prob
        self._add(name, frame.color, seen.box_px, prob, seen.score, cones)

    def _add(
        self,
        name: str,
        picture: Picture,
        box_px: Array,
        prob: Array,
        score: Array,
        cones: ConeObservations | None = None,
    ) -> None:
        from conegraph.frontend.drawing import as_png, draw_boxes

        self.pictures += 1
        self.cones += len(box_px)
        self._table.add(name, box_px, prob, score, cones)
        if self._folder is not None:
            xy_m = None if cones is None else cones.xy_m
            drawn = draw_boxes(picture, box_px, prob, xy_m)
            (self._folder / self._file_name(name)).write_bytes(as_png(drawn))

    def _file_name(self, name: str) -> str:
        """Return the name of a file that no picture before has had."""
        self._drawn[name] += 1
        again = self._drawn[name]
        return f"{name}.png" if again == 1 else f"{name}_{again}.png"


def _look_at(job: _Job, image: str, every: int) -> None:
    from conegraph.cli.progress import progress_bar
    from conegraph.io.picture_file import PICTURE_SUFFIXES

    path = Path(image)
    if path.is_file() and path.suffix.lower() in PICTURE_SUFFIXES:
        job.file(path)
    elif path.is_dir() and not (path / "rgb.txt").is_file():
        inside = sorted(path.iterdir())
        files = [file for file in inside if file.suffix.lower() in PICTURE_SUFFIXES]
        if not files:
            raise ConegraphError(f"{image}: no pictures in this folder")
        with progress_bar(image, len(files)) as advance:
            for done, file in enumerate(files, 1):
                job.file(file)
                advance(done)
    else:
        _look_at_stream(job, image, every)


def _look_at_stream(job: _Job, image: str, every: int) -> None:
    from conegraph.camera import RgbdFrame
    from conegraph.cli.progress import progress_bar
    from conegraph.sources import open_stream

    stream = open_stream(image)
    pictures = (e for e in stream.events() if isinstance(e, RgbdFrame))
    before = job.pictures
    with progress_bar(image, stream.n_frames) as advance:
        for number, frame in enumerate(pictures):
            if number % every == 0:
                job.frame(frame)
            advance(number + 1)
    if job.pictures == before:
        raise ConegraphError(f"{image}: holds no pictures")
