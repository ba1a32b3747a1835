"""``conegraph demo``: the main job, on a drive that needs no data."""

from __future__ import annotations

from pathlib import Path

from conegraph.cli.compare import DEFAULT_BACKENDS, compare
from conegraph.cli.options import DetectorOption, OutOption, ViewOption

DRIVE = "sim:random:7?laps=2&seed=1&sensor=rgbd&rate=10&light=bright&odometry=on"


def demo(
    out: OutOption = Path("out/demo"),
    detector: DetectorOption = None,
    view: ViewOption = False,
) -> None:
    """Render two laps, run both back ends over them, and judge.

    An earlier demo in DIR is replaced.
    """
    compare(out, DRIVE, DEFAULT_BACKENDS, detector=detector, view=view, save_rrd=True)
