"""``conegraph calibrate``: a lens from pictures of a board."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.errors import ConegraphError, FileFormatError

if TYPE_CHECKING:
    from conegraph.frontend.board import Board, BoardView
    from conegraph.frontend.calibration import Calibration


def calibrate(
    images: Annotated[
        list[str],
        typer.Argument(metavar="IMAGES…", help="Pictures of the board, or folders."),
    ],
    out: Annotated[
        Path,
        typer.Option("--out", metavar="CAMERA.toml", help="The lens is written here."),
    ],
    board: Annotated[
        str,
        typer.Option(
            metavar="COLUMNSxROWS",
            help="Inner corners of a checkerboard; squares of a ChArUco board.",
        ),
    ] = "9x6",
    square: Annotated[
        float, typer.Option(metavar="M", help="Side of a square in metres.")
    ] = 0.025,
    marker: Annotated[
        float | None,
        typer.Option(metavar="M", help="Side of a marker: the board is ChArUco."),
    ] = None,
    dictionary: Annotated[
        str, typer.Option(help="Markers of a ChArUco board, by OpenCV's name.")
    ] = "DICT_4X4_50",
) -> None:
    """Calibrate a camera from pictures of a board."""
    from conegraph.frontend.board import Board
    from conegraph.frontend.calibration import calibrate as find_lens

    columns, rows = _size(board)
    shape = Board(columns, rows, square, marker, dictionary)
    views, size = _views(_files(images), shape)
    result = find_lens(views, size)
    _print(result)
    picture = _write(out, result)
    typer.echo(f"{out}: the lens; {picture}: where corners were seen")


def _size(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise typer.BadParameter(f"--board {text!r}: write COLUMNSxROWS, as in 9x6")
    return int(columns), int(rows)


def _files(images: list[str]) -> list[Path]:
    from conegraph.io.picture_file import PICTURE_SUFFIXES

    files: list[Path] = []
    for path in map(Path, images):
        if path.is_dir():
            inside = sorted(path.iterdir())
            files += [f for f in inside if f.suffix.lower() in PICTURE_SUFFIXES]
        else:
            files.append(path)
    if not files:
        raise ConegraphError(f"{images[0]}: no pictures in this folder")
    return files


def _views(files: list[Path], board: Board) -> tuple[list[BoardView], tuple[int, int]]:
    """Look for the board in every picture; say which ones are of no use."""
    from conegraph.cli.progress import progress_bar
    from conegraph.frontend.board import find_board
    from conegraph.io.picture_file import read_color

    views: list[BoardView] = []
    size: tuple[int, int] | None = None
    with progress_bar("looking for the board", len(files)) as advance:
        for done, path in enumerate(files, 1):
            try:
                picture = read_color(path)
            except FileFormatError as error:
                print(f"conegraph: left out: {error}", file=sys.stderr)
                continue
            seen = (picture.shape[1], picture.shape[0])
            size = size or seen
            if seen != size:
                raise FileFormatError(
                    path,
                    f"is {seen[0]} x {seen[1]}, and the pictures before it are "
                    f"{size[0]} x {size[1]}: one camera, one size",
                )
            view = find_board(path.name, picture, board)
            if view is None:
                print(f"conegraph: no board seen in {path}", file=sys.stderr)
            else:
                views.append(view)
            advance(done)
    return views, size or (0, 0)


def _print(result: Calibration) -> None:
    from rich.table import Table

    from conegraph.cli.tables import console

    table = Table("view", "corners", "error [px]")
    for view, error in zip(result.views, result.view_rms_px, strict=True):
        table.add_row(view.name, str(len(view.pixels)), f"{error:.3f}")
    for name, miss in result.left_out:
        table.add_row(f"{name} (left out)", "", f"{miss:.3f}")
    table.columns[1].justify = table.columns[2].justify = "right"
    out = console()
    out.print(table)
    camera = result.camera
    lens = ", ".join(f"{c:.4f}" for c in camera.distortion)
    out.print(
        f"fx {camera.fx_px:.1f}, fy {camera.fy_px:.1f} (± {result.focal_sigma:.2%}), "
        f"cx {camera.cx_px:.1f}, cy {camera.cy_px:.1f} px; "
        f"k1, k2, p1, p2, k3 = {lens}; "
        f"error {result.rms_px:.3f} px, corners in {result.coverage:.0%} of all cells",
        highlight=False,
    )


def _write(out: Path, result: Calibration) -> Path:
    """Write the lens; what the file says of mount and depth stays."""
    import cv2

    from conegraph.frontend.calibration import draw_coverage
    from conegraph.io.camera_toml import CameraFile, format_camera_toml

    about = CameraFile(result.camera)
    if out.is_file():
        from dataclasses import replace

        from conegraph.io.camera_toml import read_camera_toml

        about = replace(read_camera_toml(out), camera=result.camera)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(format_camera_toml(about), encoding="utf-8", newline="\n")
    picture = out.with_name(f"{out.stem}_coverage.png")
    drawn = cv2.cvtColor(draw_coverage(result), cv2.COLOR_RGB2BGR)
    picture.write_bytes(cv2.imencode(".png", drawn)[1].tobytes())
    return picture
