"""What can be wrong with a run, and what to do about it.

Causes come in levels. What is wrong with a sensor shows in all that follows from it,
so that it explains the rest: a bent map has twins, its loops do not close, and its
filter believes too much. Of a level, what exceeds its limit most comes first. What
barely exceeds its limit comes last of all beside what is far beyond its own.
"""

from __future__ import annotations

from dataclasses import dataclass

from conegraph.eval.doctor_estimate import (
    colourless_map,
    drift,
    false_closure,
    missed_closure,
    overconfidence,
    split_cones,
    starved_associations,
    wrong_map,
)
from conegraph.eval.doctor_evidence import Examine
from conegraph.eval.doctor_sensing import (
    false_detections,
    fault_of,
    few_sights,
    scale_of,
    sensor_noise,
    silent_odometry,
    wrong_colours,
)

SENSOR, JUMP, MATCHING, LOOP, NOISE = range(5)
"""Levels: sensors first, and last what nothing else explains."""


@dataclass(frozen=True, slots=True)
class Cause:
    """Something that can be wrong.

    Attributes:
        name: in one word.
        level: which causes it explains.
        title: the diagnosis in words.
        advice: what to check or to configure.
        examine: returns the evidence, None where the run cannot tell.
    """

    name: str
    level: int
    title: str
    advice: str
    examine: Examine


CAUSES = (
    Cause(
        "yaw_rate_bias",
        SENSOR,
        "the odometry's yaw rate is biased",
        "let the car stand for a second before it sets off, calibrate the gyro, or "
        "raise motion.gyro_bias_sigma_radps",
        fault_of("yaw_rate_bias", 0.03, "rad/s", "by the cones the gyro is off by"),
    ),
    Cause(
        "wheel_scale",
        SENSOR,
        "the odometry's speed has a wrong scale",
        "check the wheel radius and the slip of the driven wheels, or raise "
        "motion.odometry_scale",
        scale_of("wheels"),
    ),
    Cause(
        "range_scale",
        SENSOR,
        "the sensor's ranges have a wrong scale",
        "check the baseline or depth unit of the camera and its calibration "
        "(conegraph calibrate)",
        scale_of("ranges"),
    ),
    Cause(
        "scale",
        SENSOR,
        "odometry's speed or the sensor's ranges have a wrong scale",
        "measure a known distance: without truth the two look the same; then the wheel "
        "radius, or the camera's baseline",
        scale_of("either"),
    ),
    Cause(
        "sensor_yaw",
        SENSOR,
        "the sensor looks another way than is assumed",
        "check the yaw of its mount: cones appear turned by this angle",
        fault_of(
            "sensor_yaw", 0.015, "rad", "cones appear turned by", without_odometry=0.002
        ),
    ),
    Cause(
        "stamp_offset",
        SENSOR,
        "the frames are stamped too late or too early",
        "stamp frames when they are taken, not when they arrive, with odometry's clock",
        fault_of("stamp_offset", 0.03, "s", "frames are older than their stamps by"),
    ),
    Cause(
        "odometry_stopped",
        SENSOR,
        "odometry stopped while the car went on",
        "look at its cable, its driver and its log at that time",
        silent_odometry,
    ),
    Cause(
        "sensor_noise",
        SENSOR,
        "the sensor is noisier than it says",
        "conegraph tune estimates it; or raise sensor.scale",
        sensor_noise,
    ),
    Cause(
        "wrong_colours",
        SENSOR,
        "cones are given wrong colours",
        "check detector and light; lower association.colour_weight",
        wrong_colours,
    ),
    Cause(
        "few_sights",
        SENSOR,
        "too few cones are seen",
        "check detector, exposure and field of view; lower "
        "landmarks.assumed_detection_probability and sensor.detection_probability",
        few_sights,
    ),
    Cause(
        "false_detections",
        SENSOR,
        "the detector sees cones where there are none",
        "raise the detector's thresholds, or landmarks.publish_hits",
        false_detections,
    ),
    Cause(
        "wrong_map",
        JUMP,
        "the given map is not of this place",
        "give the map of this track, or none; compare conegraph track MAP.csv with it",
        wrong_map,
    ),
    Cause(
        "false_closure",
        JUMP,
        "a loop was closed where there was none",
        "set start_line.forced = false; raise start_line.min_agreement, lower "
        "start_line.closure_d2; look for orange cones away from the start",
        false_closure,
    ),
    Cause(
        "starved_associations",
        MATCHING,
        "cones are seen, but few are matched",
        "raise association.gate_d2, lower association.ambiguity_d2",
        starved_associations,
    ),
    Cause(
        "split_cones",
        MATCHING,
        "single cones are taken for several",
        "raise association.gate_d2, association.no_birth_d2 or landmarks.merge_d2",
        split_cones,
    ),
    Cause(
        "drift",
        MATCHING,
        "the estimate drifted before the loop closed",
        "give it odometry, or more cones in view",
        drift,
    ),
    Cause(
        "missed_closure",
        LOOP,
        "the loop was not closed",
        "see that the start cones are detected; check start_line.min_closure_m and "
        "start_line.min_agreement",
        missed_closure,
    ),
    Cause(
        "overconfidence",
        NOISE,
        "the estimate believes itself too much",
        "conegraph tune estimates the noise; else raise "
        "motion.slip_sigma_m_per_sqrt_m or motion.odometry_scale",
        overconfidence,
    ),
    Cause(
        "colourless_map",
        NOISE,
        "the cones have no colours",
        "check detector and light; a source that knows no colours gives none",
        colourless_map,
    ),
)
"""Everything that is looked for."""
