"""``conegraph simulate``: a drive that is known to the last cone, as a cone log."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from conegraph.cli.options import OutOption
from conegraph.errors import ConegraphError
from conegraph.sources import MAX_LAPS, SimOptions, simulate_track


class Sensor(StrEnum):
    """The sensors that the simulator knows."""

    CAMERA = "camera"
    LIDAR = "lidar"


def simulate(
    track: Annotated[
        str,
        typer.Argument(
            metavar="TRACK",
            help="A track file, or autocross, skidpad, acceleration, oval, random.",
        ),
    ],
    out: OutOption,
    laps: Annotated[int, typer.Option(help="Laps to drive.", min=1, max=MAX_LAPS)] = 2,
    seed: Annotated[int, typer.Option(help="Seed of all noise.", min=0)] = 0,
    sensor: Annotated[
        Sensor, typer.Option(help="The cone sensor on the car.")
    ] = Sensor.CAMERA,
    odometry: Annotated[bool, typer.Option(help="Record wheels and gyro too.")] = True,
) -> None:
    """Drive a track in the simulator; write a cone log."""
    from conegraph.cli.progress import progress_bar
    from conegraph.io.cone_log import write_cone_log

    if any(out.glob("cones.csv*")):
        raise ConegraphError(f"{out}: holds a cone log already; name another folder")
    with progress_bar(f"driving {track}"):
        recording = simulate_track(
            track, SimOptions(laps, seed, sensor.value, odometry)
        )
        write_cone_log(out, recording)
    typer.echo(f"{out}: {recording.n_frames} frames of {recording.name}")
