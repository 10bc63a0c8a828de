"""Rows of many capsules of which lengths over l and velocities were measured, from one pyramid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.many.tabulated.mixture import COMPONENTS, NUMBERS
from capsbayes.infer.many.tabulated.pyramid import Pyramid
from capsbayes.infer.many.tabulated.row_kernel import FACTS, QUANTITIES, Shared, fill_rows
from capsbayes.infer.prior import Prior


@dataclass(frozen=True, eq=False)
class Rows:
    """Results of n capsules.

    Parameters
    ----------
    summaries : (n, 7, 7) array
        Mean, standard deviation, median and the ends of the 68 % and 95 % intervals, as the fields of `Marginal`, of
        the `QUANTITIES`, SI; NaN where nothing was found.
    facts : mapping of (n,) array
        `FACTS` by name.
    components : (n, k, 6) array
        Likelihood of (log(G_s / mu), log(a / l)) as a mixture of Gaussians.
    """

    summaries: Floats
    facts: dict[str, Floats]
    components: Floats


def lengths_rows(
    lengths: Floats,
    velocities: Floats,
    inputs: Inputs,
    prior: Prior,
    pyramid: Pyramid,
    *,
    rates: Floats | None = None,
    shifts: Floats | None = None,
) -> Rows:
    """Identify capsules, all under one experiment.

    Parameters
    ----------
    lengths : (n, 5) array [l]
        L_z, L_a (NaN where missing), and their covariance zz, za, aa.
    velocities : (n, 2) array [m/s]
        v_o and its standard error.
    inputs : Inputs
        Whose viscosity and half width are read.
    prior : Prior
    pyramid : Pyramid
        Of the model.
    rates : (n, 2) array, optional [m^3/s]
        Flow rate (NaN where it is unknown) and its standard error.
    shifts : (n, 2) array, optional
        Logarithms of the viscosity and of the half width of each capsule over those of the inputs.
    """
    modulus, radius = prior.surface_shear_modulus, prior.capsule_radius
    shared = Shared(
        viscosity=LogGrid.of(inputs.viscosity, modulus.power),
        half_width=LogGrid.of(inputs.half_width, radius.power),
        modulus_low=float(np.log(modulus.low)),
        modulus_high=float(np.log(modulus.high)),
        radius_low=float(np.log(radius.low)),
        radius_high=float(np.log(radius.high)),
        modulus_power=float(modulus.power),
        radius_power=float(radius.power),
        log_area=float(np.log(inputs.area * pyramid.model.relative_area({"capillary_number": 1.0}))),
    )
    count = len(lengths)
    shifts = np.zeros((count, 2)) if shifts is None else shifts
    rates = np.full((count, 2), np.nan) if rates is None else rates
    summaries, facts = np.empty((count, len(QUANTITIES), 7)), np.empty((count, len(FACTS)))
    components = np.empty((count, COMPONENTS, len(NUMBERS)))
    into = summaries, facts, components
    fill_rows(lengths, velocities, rates, shifts, shared, pyramid.levels, pyramid.low, pyramid.step, *into)
    return Rows(summaries, dict(zip(FACTS, facts.T, strict=True)), components)
