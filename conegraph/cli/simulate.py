"""``conegraph simulate``: a drive that is known to the last cone, written down."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from conegraph.cli.options import OutOption
from conegraph.errors import ConegraphError
from conegraph.eval.words import counted
from conegraph.sources import (
    MAX_LAPS,
    MAX_RATE_HZ,
    SimOptions,
    render_track,
    simulate_track,
)


class Sensor(StrEnum):
    """The cone sensors that the simulator knows."""

    CAMERA = "camera"
    LIDAR = "lidar"


class LightName(StrEnum):
    """The lights that pictures can be taken in."""

    BRIGHT = "bright"
    OVERCAST = "overcast"
    LOW_SUN = "low_sun"
    DUSK = "dusk"


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
    camera: Annotated[
        bool,
        typer.Option("--camera", help="Render RGB-D pictures in place of cones."),
    ] = False,
    rate: Annotated[
        float, typer.Option(help="Pictures per second.", min=0.1, max=MAX_RATE_HZ)
    ] = 15.0,
    light: Annotated[
        LightName | None,
        typer.Option(help="Light of the pictures; by chance if not given."),
    ] = None,
) -> None:
    """Drive a track; write a cone log, or RGB-D pictures."""
    options = SimOptions(
        laps,
        seed,
        sensor.value,
        odometry,
        rate=rate,
        light="" if light is None else light.value,
    )
    if camera:
        _write_pictures(track, options, out)
    else:
        _write_cones(track, options, out)


def _write_cones(track: str, options: SimOptions, out: Path) -> None:
    from conegraph.cli.progress import progress_bar
    from conegraph.io.cone_log import write_cone_log

    if any(out.glob("cones.csv*")):
        raise ConegraphError(f"{out}: holds a cone log already; name another folder")
    with progress_bar(f"driving {track}"):
        recording = simulate_track(track, options)
        write_cone_log(out, recording)
    typer.echo(f"{out}: {counted(recording.n_frames, 'frame')} of {recording.name}")


def _write_pictures(track: str, options: SimOptions, out: Path) -> None:
    from conegraph.camera import RgbdFrame
    from conegraph.cli.progress import progress_bar
    from conegraph.io.rgbd_writer import RgbdWriter
    from conegraph.sim.render_pool import free_cores

    with progress_bar(f"building {track}"):
        drive = replace(render_track(track, options), workers=free_cores())
    with (
        RgbdWriter(out, drive.rig.camera, drive.rig.mount) as writer,
        progress_bar(f"rendering {track}", drive.n_frames) as advance,
    ):
        writer.add_truth(
            list(drive.velocities), drive.truth_trajectory, drive.truth_map
        )
        for event in drive.events():
            if isinstance(event, RgbdFrame):
                writer.add(event)
                advance(writer.frames)
    typer.echo(f"{out}: {counted(drive.n_frames, 'frame')} of {drive.name}")
