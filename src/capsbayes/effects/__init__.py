"""Effects that a simple model misses, one a file."""

from capsbayes.effects.catalogue import catalogue
from capsbayes.effects.channel_swelling import ChannelSwelling
from capsbayes.effects.halo import Halo
from capsbayes.effects.motion_blur import MotionBlur
from capsbayes.effects.pixel_scale import PixelScale
from capsbayes.effects.simulated import SIMULATED, Simulated

__all__ = ["SIMULATED", "ChannelSwelling", "Halo", "MotionBlur", "PixelScale", "Simulated", "catalogue"]
