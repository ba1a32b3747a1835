"""Configuration: TOML in, frozen validated values out."""

from conegraph.config.detector import (
    ColourRange,
    DetectorConfig,
    GroundConfig,
    HsvConfig,
    HsvThesisConfig,
    LocalizationConfig,
)
from conegraph.config.loading import (
    config_to_toml,
    load_config,
    parse_override,
    resolve_config,
)
from conegraph.config.models import (
    AssociationConfig,
    BackendConfig,
    Config,
    EkfConfig,
    GateConfig,
    Isam2Config,
    LandmarkConfig,
    MotionConfig,
    RecoveryConfig,
    SensorConfig,
    StartLineConfig,
    StatusConfig,
    ViewerConfig,
)

__all__ = [
    "AssociationConfig",
    "BackendConfig",
    "ColourRange",
    "Config",
    "DetectorConfig",
    "EkfConfig",
    "GateConfig",
    "GroundConfig",
    "HsvConfig",
    "HsvThesisConfig",
    "Isam2Config",
    "LandmarkConfig",
    "LocalizationConfig",
    "MotionConfig",
    "RecoveryConfig",
    "SensorConfig",
    "StartLineConfig",
    "StatusConfig",
    "ViewerConfig",
    "config_to_toml",
    "load_config",
    "parse_override",
    "resolve_config",
]
