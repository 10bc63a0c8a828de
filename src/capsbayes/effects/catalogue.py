"""Catalogue of the effects that come with the library."""

from __future__ import annotations

from dataclasses import replace

from capsbayes.database import Database
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
from capsbayes.effects.simulated import SIMULATED, Simulated
from capsbayes.membrane_database import FREE_PARAMETERS, RANGES, MembraneDatabase
from capsbayes.model import Effect
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
