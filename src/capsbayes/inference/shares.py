"""Which input owns how much of the uncertainty of G_s.

Viscosity and velocity multiply G_s and are independent of the shape: they own
their variance of log G_s, exactly. A further coordinate of the model owns the
variance of the mean of log G_s from one of its values to another. For every
other input the posterior is worked out again with that input's error halved. Were log G_s linear in it, its
part V_i of the variance V would fall to V_i / 4, so V_i = 4/3 (V - V_halved),
and the parts would add up to V; what is missing to one is owed to the prior
and to the curvature of the model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from capsbayes.inference.grid_posterior import GridPosterior
from capsbayes.inference.mixed_posterior import MixedPosterior
from capsbayes.inference.mixed_quadrature import MixedQuadrature
from capsbayes.inference.quadrature import Quadrature
from capsbayes.measurement import Measurement

__all__ = ["variance_shares"]

REST = "prior and curvature"


AnyPosterior = GridPosterior | MixedPosterior


def variance_shares(
    engine: Quadrature | MixedQuadrature, measurement: Measurement, posterior: AnyPosterior
) -> dict[str, float]:
    """Share of the variance of log G_s owed to each input.

    Parameters
    ----------
    engine : Quadrature or MixedQuadrature
    measurement : Measurement
    posterior : GridPosterior or MixedPosterior
        Of that measurement.

    Returns
    -------
    dict
        By name of the input; adds up to one.
    """
    target, total = posterior.target, _variance(posterior)
    shares = {
        "viscosity": target.viscosity.variance / total,
        "capsule_velocity": target.capsule_velocity.variance / total,
    }
    if isinstance(posterior, MixedPosterior):
        shares[posterior.coordinate.name] = posterior.variance_between("surface_shear_modulus") / total
    for name, halved in _each_halved(engine, measurement, posterior):
        shares[name] = (total - _variance(halved)) / (0.75 * total)
    if not target.shape_depends_on_half_width:
        shares["half_width"] = 0.0
    return shares | {REST: 1.0 - sum(shares.values())}


def _variance(posterior: AnyPosterior) -> float:
    return posterior.log_marginal("surface_shear_modulus").sd ** 2


def _each_halved(
    engine: Quadrature | MixedQuadrature, measurement: Measurement, posterior: AnyPosterior
) -> Iterator[tuple[str, AnyPosterior]]:
    inputs = posterior.target.inputs
    if measurement.outline is not None:
        noise = measurement.outline.noise
        sharper = replace(measurement.outline, noise=replace(noise, scale=0.5 * noise.scale))
        yield "outline", engine(replace(measurement, outline=sharper), inputs=inputs)
        if measurement.length_beside_outline is not None:
            half = replace(measurement, axial_length_error=0.5 * measurement.length_beside_outline[1])
            yield "axial_length", engine(half, inputs=inputs)
        yield "surrogate", engine(measurement, inputs=inputs, error_scale=0.5)
        return
    half = replace(measurement, axial_extent_error=0.5 * measurement.axial_extent_error)
    yield "axial_extent", engine(half, inputs=inputs)
    if measurement.axial_length_error is not None:
        half = replace(measurement, axial_length_error=0.5 * measurement.axial_length_error)
        yield "axial_length", engine(half, inputs=inputs)
    if posterior.target.shape_depends_on_half_width:
        narrow = replace(inputs, half_width=inputs.half_width.narrowed(0.5))
        yield "half_width", engine(measurement, inputs=narrow)
    yield "surrogate", engine(measurement, inputs=inputs, error_scale=0.5)
