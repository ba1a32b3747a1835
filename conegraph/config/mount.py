"""Where the camera sits, for sources that do not say."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from conegraph.config.section import Section

Length = Annotated[float, Field(ge=-10, le=10)]
Tilt = Annotated[float, Field(ge=-1.6, le=1.6)]


class MountConfig(Section):
    """Where the camera sits; a key that is given counts more than the source's."""

    x_m: Length | None = None
    """Forward of the car frame's origin."""
    y_m: Length | None = None
    """To the left of it."""
    height_m: Annotated[float, Field(gt=0, le=10)] | None = None
    """Above the ground."""
    pitch_rad: Tilt | None = None
    """Nose down is positive."""
    roll_rad: Tilt | None = None
    """Right side down is positive."""
    yaw_rad: Annotated[float, Field(ge=-3.2, le=3.2)] | None = None
    """To the left is positive."""
