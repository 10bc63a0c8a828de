"""Every effect that comes with the library and whose data do."""

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

__all__ = ["catalogue"]


def catalogue(cross_section: str = "square") -> dict[str, Effect]:
    """Effects by name of their parameter.

    Parameters
    ----------
    cross_section : str
        Of the channel; the simulated effects are those of a square one.

    Returns
    -------
    dict of str to Effect

    Examples
    --------
    >>> sorted(catalogue())[:3]
    ['bending', 'corner_radius', 'exposure']
    """
    shipped = Database.shipped()
    effects: list[Effect] = [one for one in SIMULATED.values() if cross_section == "square" and one.database in shipped]
    effects += [ChannelSwelling(), Halo(), ModulusSlope(), MotionBlur(), PixelScale(), ViscosityError()]
    return {one.parameter.name: one for one in effects}
