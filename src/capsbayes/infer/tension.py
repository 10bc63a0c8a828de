"""What the membrane of an identified capsule bears: its largest tension, where rupture and damage start, and E_s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.infer.posterior import Posterior
from capsbayes.infer.prior import LAWS, THICKNESS, Marginal
from capsbayes.membrane_database import FREE_PARAMETERS, MembraneDatabase, covered
from capsbayes.model import name_parts
from capsbayes.surrogate.membrane import StateCoordinates, averaged, local_fits, parameter_columns

_OF_MODELS = {  # law of the membrane by the names of models without their cross-section
    "membrane": LAWS["unknown"],
    "neo-hookean": LAWS["neo-Hookean"],
    "skalak-c-1": {"area_dilation_modulus": 3.0, "strain_hardening": 1.0},
}
_MOST_DRAWS = 10_000
_ERROR = 0.02  # of the stored tensions by their mesh, relative, beside the differences between polynomials
_FEWEST_KNOWN = 0.95  # share of the draws at which the tension has to be known


@dataclass(frozen=True)
class MembraneTension:
    """What the membrane bears, with the posterior of the capsule.

    Parameters
    ----------
    largest_tension : Marginal or None [N/m]
        Largest principal tension of the membrane; None if more than 5 % of the posterior lies beyond the stored states.
    surface_young_modulus : Marginal [N/m]
        Young's modulus times the thickness, E_s = 4 K_s G_s / (K_s + G_s).
    young_modulus : Marginal or None [Pa]
        Young's modulus; None if the thickness of the membrane is not stated.
    place : (3,) array [m]
        Where the largest tension lies, across the flow and along it from the centre of the capsule, to 0.25 l: in the
        simulated membrane that is most like this one.
    """

    largest_tension: Marginal | None
    surface_young_modulus: Marginal
    young_modulus: Marginal | None
    place: Floats


def membrane_tension(posterior: Posterior) -> MembraneTension | None:
    """Compute what the membrane of a capsule bears; None for a model whose law has no stored tensions."""
    # The tension over G_s is the diffuse approximation of those of the membrane's states, with its own error.
    stated = _parameters(posterior.model_name)
    if stated is None:
        return None
    draws = {name: np.ravel(values) for name, values in posterior.draws.items()}
    rng = np.random.default_rng([posterior.seed, 6])
    some = rng.permutation(len(draws["surface_shear_modulus"]))[:_MOST_DRAWS]
    modulus = draws["surface_shear_modulus"][some]
    theta: dict[str, Floats | float] = dict(stated)
    theta |= {name: draws[name][some] for name in FREE_PARAMETERS if name in draws}
    largest = LargestTension.open(posterior.model_name.partition("-")[0])
    over_modulus, errors = largest(theta)
    tensions = modulus * over_modulus * np.exp(errors * rng.standard_normal(len(modulus)))
    known = np.isfinite(tensions)
    dilation = np.asarray(theta["area_dilation_modulus"])
    surface_young = 4.0 * dilation / (1.0 + dilation) * modulus
    thickness = posterior.experiment.membrane_thickness
    thick = draws[THICKNESS][some] if THICKNESS in draws else thickness and thickness.drawn(rng, len(modulus))
    return MembraneTension(
        Marginal.of_draws(tensions[known]) if known.mean() >= _FEWEST_KNOWN else None,
        Marginal.of_draws(surface_young),
        None if thick is None else Marginal.of_draws(surface_young / thick),
        posterior.experiment.half_width.mean * largest.place({name: [np.median(each)] for name, each in theta.items()}),
    )


def _parameters(model: str) -> dict[str, float] | None:
    """Return what a model of some name holds of the membrane's parameters; None if its capsules have others."""
    plain, further, held = name_parts(model)
    law, at = _OF_MODELS.get(plain.partition("-")[2]), dict(part.split(" = ") for part in held)
    if law is None or not {*at, *filter(None, [further])} <= set(FREE_PARAMETERS):
        return None
    return {**law, **{name: float(value) for name, value in at.items()}}


class LargestTension:
    """Largest principal tension of the membrane over G_s, by diffuse approximation over the states of the membrane."""

    def __init__(self, states: MembraneDatabase) -> None:
        values, column = states["values"], list(states.dataset["extreme"].values).index("largest")
        tensions, along = states["tension"][:, [column]], states["tension_along"][:, [column]]
        known = np.isfinite(tensions[:, 0]) & np.isfinite(along).all(axis=(1, 2))
        values, tensions, along = values[known], tensions[known], along[known]
        self._places = states["tension_place"][known, column]
        self._cross_section, self._frame = states.cross_section, StateCoordinates.of(states["values"])
        slopes = self._frame.slopes(values, along / tensions[..., None])
        self._points, lost = self._frame.points(values), self._frame.points(states["lost"])
        self._fits = local_fits(self._points, np.log(tensions), slopes, lost, np.zeros_like(tensions))

    @classmethod
    @cache
    def open(cls, cross_section: str) -> LargestTension:
        """Return that of the shipped states of a cross-section, made once."""
        return cls(MembraneDatabase.open(cross_section))

    def __call__(self, theta: Mapping[str, Floats | float]) -> tuple[Floats, Floats]:
        """Return tensions over G_s and the standard errors of their logarithms, (n,) each; NaN beyond the states."""
        values = parameter_columns(theta)
        inside = covered(values, self._cross_section)
        found = np.full((2, len(values)), np.nan)
        means, covariances, _ = averaged(self._frame.points(values[inside]), *self._fits, 1, 1, False)
        found[:, inside] = np.exp(means[:, 0]), np.hypot(np.sqrt(covariances[:, 0, 0]), _ERROR)
        return found[0], found[1]

    def place(self, theta: Mapping[str, ArrayLike]) -> Floats:
        """Return where the tension is largest in the state nearest to parameters, (1,) each : (3,) array [l]."""
        away = self._points - self._frame.points(parameter_columns(theta))
        return np.asarray(self._places[np.argmin(np.sum(away**2, axis=1))])
