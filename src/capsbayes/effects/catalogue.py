"""Catalogue of the effects that come with the library."""

from __future__ import annotations

from dataclasses import replace

from capsbayes.database import Database
from capsbayes.effect import Effect
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
from capsbayes.membrane_database import FREE_PARAMETERS, RANGES, MembraneDatabase
from capsbayes.quantity import Quantity


def catalogue(cross_section: str = "square") -> dict[str, Effect]:
    """Return the effects by name of their parameter.

    Parameters
    ----------
    cross_section : str
        Of the channel; of the simulated effects, those of the membrane hold for a circular one too, the others for a
        square one only.

    Returns
    -------
    dict of str to Effect

    Examples
    --------
    >>> sorted(catalogue())[:3]
    ['area_dilation_modulus', 'bending', 'corner_radius']
    """
    effects: list[Effect] = []
    shipped = Database.shipped()
    if cross_section == "square":
        effects += [effect for effect in SIMULATED.values() if effect.of_membrane or effect.database in shipped]
    elif cross_section in MembraneDatabase.shipped():
        effects += [_within_states(effect) for effect in SIMULATED.values() if effect.of_membrane]
    effects += [Halo(), MotionBlur(), PixelScale(), OblongPixels(), RadialDistortion(), Taper()]
    effects += [PictureRotation(), VelocityScale(), FlowRateError(), HalfWidthError(), HalfWidthApart()]
    effects += [ChannelSwelling(), ModulusSlope(), ViscosityError()]
    return {effect.parameter.name: effect for effect in effects}


def _within_states(effect: Simulated) -> Simulated:
    """Return an effect of the membrane for sizes that the scattered states have."""
    low, high = RANGES[FREE_PARAMETERS.index(effect.coordinate)]
    prior = effect.prior
    if low <= prior.low and prior.high <= high:
        return effect
    return replace(effect, prior=Quantity.log_uniform(max(low, prior.low), min(high, prior.high)))
