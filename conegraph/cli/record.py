"""``conegraph record``: from a camera, or anything with pictures, to files."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from conegraph.errors import ConegraphError
from conegraph.eval.words import counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from conegraph.camera import RgbdFrame, Stream

RECORDING_SUFFIX = ".db3"


def record(
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="DIR|FILE.db3",
            help="A folder of pictures in the TUM layout, or RealSense's own format.",
        ),
    ],
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="realsense[:SERIAL], or any other source of pictures.",
        ),
    ] = "realsense",
    seconds: Annotated[
        float | None,
        typer.Option(min=0.1, help="Stop after this time; else with Ctrl-C."),
    ] = None,
    lossless: Annotated[
        bool, typer.Option(help="In a folder: PNG in place of JPEG for colour.")
    ] = False,
) -> None:
    """Record a camera into pictures or one file."""
    from conegraph.sources import open_stream

    stream = open_stream(source)
    if out.suffix == RECORDING_SUFFIX:
        count = _to_recording(stream, source, out, seconds)
    else:
        count = _to_folder(stream, source, out, seconds, lossless)
    for reason, times in stream.rejected.items():
        print(f"conegraph: {times} x {reason}", file=sys.stderr)
    typer.echo(f"{out}: {counted(count, 'frame')} of {stream.name}")


def _to_recording(stream: Stream, source: str, out: Path, seconds: float | None) -> int:
    from dataclasses import replace

    from conegraph.frontend.realsense_live import LiveCamera

    if not isinstance(stream, LiveCamera):
        raise ConegraphError(f"{source}: only a RealSense camera records into .db3")
    if out.exists():
        raise ConegraphError(f"{out}: exists already; name another file")
    return sum(1 for _ in _watched(replace(stream, record_to=out), source, seconds))


def _to_folder(
    stream: Stream, source: str, out: Path, seconds: float | None, lossless: bool
) -> int:
    from conegraph.camera import CameraMount
    from conegraph.io.rgbd_writer import RgbdWriter

    frames = _watched(stream, source, seconds)
    first = next(frames, None)
    if first is None:
        raise ConegraphError(f"{source}: no picture came")
    # A source that does not know where its camera sits says the default.
    mount = None if first.mount == CameraMount() else first.mount
    with RgbdWriter(out, first.camera, mount, lossless=lossless) as writer:
        writer.add(first)
        for frame in frames:
            writer.add(frame)
        writer.add_truth([], stream.truth_trajectory, stream.truth_map)
        return writer.frames


def _watched(stream: Stream, source: str, seconds: float | None) -> Iterator[RgbdFrame]:
    """Yield frames until the time is over or somebody presses Ctrl-C."""
    from conegraph.camera import RgbdFrame
    from conegraph.cli.progress import progress_bar

    with (
        progress_bar(f"recording {source}", stream.n_frames) as advance,
        suppress(KeyboardInterrupt),
    ):
        begin: float | None = None
        count = 0
        for event in stream.events():
            if not isinstance(event, RgbdFrame):
                continue
            begin = event.stamp_s if begin is None else begin
            if seconds is not None and event.stamp_s - begin > seconds:
                return
            count += 1
            advance(count)
            yield event
