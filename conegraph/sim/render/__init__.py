"""An RGB-D renderer of cone tracks: numpy and OpenCV, exact truth, deterministic.

    rng = np.random.default_rng(3)
    scene = make_scene(truth_map, rng, light=draw_light(rng, "bright"))
    frame, truth = render_frame(scene, pose_world_car, rng)

`make_scene` builds a world around cones once, ground, sky, clutter and light;
`render_frame` takes a picture from a pose. `Rig` says which camera, `CarState` how
the car moves and pitches while the shutter is open.
"""

from __future__ import annotations

from conegraph.sim.render.depth_sensor import StereoDepth
from conegraph.sim.render.frame import CarState, FrameTruth, render_frame
from conegraph.sim.render.light import LIGHT_NAMES, Light, LightName, draw_light
from conegraph.sim.render.rig import D435, Rig
from conegraph.sim.render.scene import Scene, make_scene

__all__ = [
    "D435",
    "LIGHT_NAMES",
    "CarState",
    "FrameTruth",
    "Light",
    "LightName",
    "Rig",
    "Scene",
    "StereoDepth",
    "draw_light",
    "make_scene",
    "render_frame",
]
