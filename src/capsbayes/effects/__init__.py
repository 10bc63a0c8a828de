"""Effects that a simple model misses, one file each."""

from capsbayes.effects.catalogue import catalogue
from capsbayes.effects.channel_swelling import ChannelSwelling
from capsbayes.effects.flow_rate_error import FlowRateError
from capsbayes.effects.half_width_apart import HalfWidthApart
from capsbayes.effects.half_width_error import HalfWidthError
from capsbayes.effects.halo import Halo
from capsbayes.effects.modulus_slope import ModulusSlope
from capsbayes.effects.motion_blur import MotionBlur
from capsbayes.effects.oblong_pixels import OblongPixels
from capsbayes.effects.picture_rotation import PictureRotation
from capsbayes.effects.pixel_scale import PixelScale
from capsbayes.effects.radial_distortion import RadialDistortion
from capsbayes.effects.simulated import SIMULATED, Simulated
from capsbayes.effects.taper import Taper
from capsbayes.effects.velocity_scale import VelocityScale
from capsbayes.effects.viscosity_error import ViscosityError

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
