"""Catalogue of the effects that come with the library."""

from __future__ import annotations

from capsbayes.database import Database
from capsbayes.effect import Effect
from capsbayes.effects.channel_swelling import ChannelSwelling
from capsbayes.effects.halo import Halo
from capsbayes.effects.modulus_slope import ModulusSlope
from capsbayes.effects.motion_blur import MotionBlur
from capsbayes.effects.pixel_scale import PixelScale
from capsbayes.effects.simulated import SIMULATED
from capsbayes.effects.viscosity_error import ViscosityError


def catalogue(cross_section: str = "square") -> dict[str, Effect]:
    """Return the effects by name of their parameter.

    Parameters
    ----------
    cross_section : str
        Of the channel; the simulated effects hold for a square one only.

    Returns
    -------
    dict of str to Effect

    Examples
    --------
    >>> sorted(catalogue())[:3]
    ['bending', 'corner_radius', 'exposure']
    """
    shipped = Database.shipped()
    effects: list[Effect] = []
    if cross_section == "square":
        effects += [effect for effect in SIMULATED.values() if effect.database in shipped]
    effects += [ChannelSwelling(), Halo(), ModulusSlope(), MotionBlur(), PixelScale(), ViscosityError()]
    return {effect.parameter.name: effect for effect in effects}
