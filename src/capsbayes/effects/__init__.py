"""Effects that a simple model misses."""

from capsbayes.effects.analytic import (
    ChannelSwelling,
    FlowRateError,
    HalfWidthApart,
    HalfWidthError,
    Halo,
    ModulusSlope,
    MotionBlur,
    OblongPixels,
    PictureRotation,
    PixelScale,
    RadialDistortion,
    Taper,
    VelocityScale,
    ViscosityError,
)
from capsbayes.effects.simulated import SIMULATED, Simulated, catalogue

__all__ = [
    "SIMULATED",
    "ChannelSwelling",
    "FlowRateError",
    "HalfWidthApart",
    "HalfWidthError",
    "Halo",
    "ModulusSlope",
    "MotionBlur",
    "OblongPixels",
    "PictureRotation",
    "PixelScale",
    "RadialDistortion",
    "Simulated",
    "Taper",
    "VelocityScale",
    "ViscosityError",
    "catalogue",
]
