"""Shares of the inputs in the uncertainty of G_s and of a.

Viscosity and velocity multiply G_s and are independent of the shape: their shares are
their variances of log G_s, exactly, and nothing of that of log a. Where the
lengths are over l, the half width multiplies a in the same way. A further
coordinate of the model contributes the variance of the mean of the logarithm from one
of its values to another. For every other input the posterior is computed
again with the error of that input halved. Were the logarithm linear in it, its
part V_i of the variance V would fall to V_i / 4, so V_i = 4/3 (V - V_halved),
and the parts would add up to V; what is missing to one is due to the prior
and to the curvature of the model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from capsbayes.infer.exact import ExactEngine, engine_near
from capsbayes.infer.grid.mixed import MixedPosterior
from capsbayes.infer.grid.posterior import ExactPosterior
from capsbayes.infer.importance.posterior import WeightedPosterior
from capsbayes.measurement import Measurement

REST = "prior and curvature"
QUANTITIES = ("surface_shear_modulus", "capsule_radius")

_LARGEST_REST = 0.5
_ROUNDED = 5e-4  # of a share as it is printed


def add_up(shares: Mapping[str, float]) -> bool:
    """Tell whether shares are such: none is below zero or above one, and no more than half is owed to no input."""
    inputs = (share for name, share in shares.items() if name != REST)
    return all(-_ROUNDED <= share <= 1.0 + _ROUNDED for share in inputs) and abs(shares.get(REST, 0.0)) <= _LARGEST_REST


def variance_shares(
    engine: ExactEngine, measurement: Measurement, posterior: ExactPosterior, *quantities: str
) -> dict[str, dict[str, float]]:
    """Return the share of the variance of the logarithm of each quantity due to each input.

    Parameters
    ----------
    engine : ExactEngine
    measurement : Measurement
    posterior : ExactPosterior
        Of that measurement.
    *quantities : str
        Of `QUANTITIES`.

    Returns
    -------
    dict of dict
        By quantity, by name of the input; those of a quantity add up to one.
    """
    totals = {quantity: _variance(posterior, quantity) for quantity in quantities}
    shares = {quantity: _of_factors(posterior, quantity, total) for quantity, total in totals.items()}
    for name, halved in _each_halved(engine, measurement, posterior):
        for quantity, total in totals.items():
            shares[quantity][name] = (total - _variance(halved, quantity)) / (0.75 * total)
    return {quantity: found | {REST: 1.0 - sum(found.values())} for quantity, found in shares.items()}


def _of_factors(posterior: ExactPosterior, quantity: str, total: float) -> dict[str, float]:
    """Return the shares of the inputs that the shape does not depend on, and of a further coordinate."""
    density = posterior.density
    of_modulus = quantity == "surface_shear_modulus"
    shares = {
        "viscosity": density.viscosity.variance / total if of_modulus else 0.0,
        "capsule_velocity": density.capsule_velocity.variance / total if of_modulus else 0.0,
    }
    flow, by_rate_alone = density.flow(None), density.inputs.by_flow_rate
    if flow is not None:  # the weights of both sources of U, and those of a length and of the flow rate as sources of l
        width = 0.0 if density.shape_depends_on_half_width else flow.half_width
        whole = flow.velocity + flow.rate + 4.0 * width
        weight = 1.0 if by_rate_alone else flow.velocity / whole
        by_rate, own = (weight, 0.0) if of_modulus else (2.0 * width / whole, 1.0)
        shares["capsule_velocity"] = (1.0 - own - by_rate) ** 2 * flow.velocity / total
        shares["flow_rate"] = by_rate**2 * flow.rate / total
        shares["half_width"] = (own - 2.0 * by_rate) ** 2 * width / total
    if isinstance(posterior, MixedPosterior):
        shares[posterior.coordinate.name] = posterior.variance_between(quantity) / total
    if isinstance(posterior, WeightedPosterior):
        for coordinate in density.coordinates:
            shares[coordinate.name] = posterior.variance_given(coordinate.name, quantity) / total
    if not density.shape_depends_on_half_width and flow is None:
        shares["half_width"] = 0.0 if of_modulus else density.half_width.variance / total
    if by_rate_alone or density.inputs.viscous_tension:
        del shares["capsule_velocity"]
    if density.inputs.viscous_tension:
        shares["viscous_tension"] = shares.pop("viscosity")
    return shares


def _variance(posterior: ExactPosterior, quantity: str) -> float:
    return posterior.log_marginal(quantity).sd ** 2


def _each_halved(
    engine: ExactEngine, measurement: Measurement, posterior: ExactPosterior
) -> Iterator[tuple[str, ExactPosterior]]:
    inputs = posterior.density.inputs
    again = engine_near(engine, posterior)
    if measurement.outline is not None:
        noise = measurement.outline.noise
        sharper = replace(measurement.outline, noise=replace(noise, scale=0.5 * noise.scale))
        yield "outline", again(replace(measurement, outline=sharper), inputs=inputs)
        if measurement.length_with_outline is not None:
            half = replace(measurement, axial_length_error=0.5 * measurement.length_with_outline[1])
            yield "axial_length", again(half, inputs=inputs)
        if posterior.density.by_thickness:
            yield from _of_half_width(again, measurement, posterior)
        yield "surrogate", again(measurement, inputs=inputs, error_scale=0.5)
        return
    half = replace(measurement, axial_extent_error=0.5 * measurement.axial_extent_error)
    yield "axial_extent", again(half, inputs=inputs)
    if measurement.axial_length_error is not None:
        half = replace(measurement, axial_length_error=0.5 * measurement.axial_length_error)
        yield "axial_length", again(half, inputs=inputs)
    yield from _of_half_width(again, measurement, posterior)
    yield "surrogate", again(measurement, inputs=inputs, error_scale=0.5)


def _of_half_width(
    again: Callable[..., ExactPosterior], measurement: Measurement, posterior: ExactPosterior
) -> Iterator[tuple[str, ExactPosterior]]:
    if posterior.density.shape_depends_on_half_width:
        inputs = posterior.density.inputs
        narrow = replace(inputs, half_width=inputs.half_width.rescaled(inputs.half_width.value, 0.5))
        yield "half_width", again(measurement, inputs=narrow)
