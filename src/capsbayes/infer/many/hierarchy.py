"""Population of the capsules of a session: mean and spread of G_s and a with the errors removed.

Each capsule has its own (log G_s, log a), drawn from a Gaussian population with a slope d ln G_s / d ln a. Viscosity
and half width are those of all capsules: their errors do not shrink with the number of capsules, so they are integrated
outside the loop over capsules. A viscosity moves every log G_s by the same amount, which moves the mean and leaves
spread and slope as they are; so does a half width with log a.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Gate
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.many.importance import drawn
from capsbayes.infer.many.log_posterior import PARAMETERS, LogPosterior
from capsbayes.infer.many.population import Population
from capsbayes.infer.many.selection import Selection, kept_rows
from capsbayes.infer.many.tabulated.pyramid import Pyramid
from capsbayes.infer.marginal import Marginal
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS as QUANTITIES
from capsbayes.quantity import Quantity
from capsbayes.readable import Readable
from capsbayes.status import Status

FEWEST = 3
PREFIX = "population_"
"""Of the draws in the file of a population."""
_UNITS = {"surface_shear_modulus": "N/m", "capsule_radius": "m"}
_STORED = 500
_TAKING_PART = [status.name for status in Status if status.ok or status.name.startswith("LEANS")]


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(Readable):
    """Posterior of a population.

    Parameters
    ----------
    draws : mapping of (d,) array
        ``surface_shear_modulus`` and ``capsule_radius``, medians of the population in SI; ``modulus_spread`` and
        ``radius_spread``, standard deviations of log G_s and of log a from capsule to capsule;
        ``modulus_spread_at_given_size``; ``modulus_slope``, d ln G_s / d ln a. All errors are in them.
    without_shared : mapping of (d,) array
        The same medians as if viscosity, half width and the scale of the velocities were known exactly.
    capsules : int
        Number of them.
    least_stretch : float or None
        Smallest Lambda of the capsules kept, if that was accounted for.
    leaning : float
        Share of the capsules whose posterior leans on the border of the model: the population may go on beyond it.
    gates : tuple of Gate
    seed : int
    """

    draws: dict[str, Floats]
    without_shared: dict[str, Floats]
    capsules: int
    least_stretch: float | None
    leaning: float
    gates: tuple[Gate, ...]
    seed: int

    @property
    def marginals(self) -> dict[str, Marginal]:
        """Summaries of the draws by name."""
        return {name: Marginal.of_draws(values) for name, values in self.draws.items()}

    def described(self) -> dict[str, str]:
        """Return the medians and 95 % intervals in the units that people read."""
        found = {"capsules": str(self.capsules)}
        for name, marginal in self.marginals.items():
            known = QUANTITIES[name]
            low, middle, high = (
                known.shown(value) for value in (marginal.lower_95, marginal.median, marginal.upper_95)
            )
            found[name] = f"{middle:.4g} [{low:.4g}, {high:.4g}] {known.shown_unit}".removesuffix(" -")
        return found | ({} if self.passed else {"gates": "not passed"})

    @property
    def passed(self) -> bool:
        """True if the intervals can be used."""
        return all(gate.passed for gate in self.gates)

    @property
    def shared_share(self) -> dict[str, float]:
        """Share of the variance of the logarithm of each median that is due to what all capsules share."""
        found = {}
        for name, values in self.without_shared.items():
            found[name] = 1.0 - float(np.var(np.log(values)) / np.var(np.log(self.draws[name])))
        return found

    def added_to(self, population: Population) -> Population:
        """Return the capsules with this result added: draws as ``population_surface_shear_modulus`` and so on."""
        every = slice(None, None, max(len(self.draws["modulus_slope"]) // _STORED, 1))
        variables = {
            f"{PREFIX}{name}": ("draw", values[every], {"units": _UNITS.get(name, "1")})
            for name, values in self.draws.items()
        }
        known = population.dataset.drop_dims("draw", errors="ignore")
        return Population(known.assign(variables).assign_attrs(hierarchy=json.dumps(self.as_dict())))

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the draws, ready for JSON."""
        return {
            "capsules": self.capsules,
            "quantities": {name: marginal.as_dict() for name, marginal in self.marginals.items()},
            "share_of_variance_owed_to_what_all_share": self.shared_share,
            "least_stretch": self.least_stretch,
            "share_leaning_on_border": self.leaning,
            "gates": [gate.as_dict() for gate in self.gates],
            "seed": self.seed,
        }


def hierarchy(
    population: Population,
    *,
    seed: int,
    least_stretch: float | None = None,
    model: ForwardModel | None = None,
    experiment: Experiment | None = None,
    shared_velocity_error: float = 0.0,
) -> Hierarchy:
    """Find mean, spread and slope of a population.

    Parameters
    ----------
    population : Population
        Of one session: capsules with a result take part, also those that lean on the border of the model.
    seed : int
        Of the draws.
    least_stretch : float, optional
        Keep only the capsules with a larger median Lambda, as the published cut of 1.04 does, and account for it.
    model : ForwardModel, optional
        That of the population; read where capsules were selected.
    experiment : Experiment, optional
        In place of that which the population states, where its errors are no normal distributions.
    shared_velocity_error : float
        Relative standard error that all velocities have in common, as from the size of a pixel or the frame rate; the
        errors of the single velocities are then those without it.

    Returns
    -------
    Hierarchy

    Raises
    ------
    InputError
        If fewer than three capsules have a result, or the experiment is not known.

    Notes
    -----
    Priors: flat in the means of log G_s and log a, half-normal of scale 1 in both spreads, normal of scale 5 in the
    slope.
    The posterior is drawn from a t distribution about its mode, the draws weighted by Pareto-smoothed importance
    sampling (https://doi.org/10.48550/arXiv.1507.02646), whose diagnostic is among the gates.
    """
    viscosity, half_width = _shared(population, experiment)
    kept = (population["likelihood"][:, :, 0].sum(axis=1) > 0.0) & np.isin(population["status"], _TAKING_PART)
    selection = None
    if least_stretch is not None:
        if model is None:
            raise InputError("hierarchy", "model", "the model of the population, with least_stretch", "nothing")
        kept &= kept_rows(population, least_stretch)
        pyramid = Pyramid.of(model)
        selection = Selection.of(population, least_stretch, pyramid, viscosity.value, half_width.value)
    if np.count_nonzero(kept) < FEWEST:
        expected = f"at least {FEWEST} capsules with a result"
        raise InputError("hierarchy", "population", expected, str(np.count_nonzero(kept)))
    components = np.ascontiguousarray(population["likelihood"][kept])
    components[:, :, 1] += np.float32(np.log(viscosity.value))
    components[:, :, 2] += np.float32(np.log(half_width.value))
    rng = np.random.default_rng([seed, 3])
    parameters, gates = drawn(LogPosterior(components, selection), rng)
    plain = dict(zip(PARAMETERS, parameters.T, strict=True))
    count = len(parameters)
    shifts = {
        name: LogGrid.of(quantity).drawn(rng, count) / quantity.value
        for name, quantity in (("viscosity", viscosity), ("half_width", half_width))
    }
    scale = np.exp(shared_velocity_error * rng.standard_normal(count))
    spread, of_radius, slope = np.exp(plain["log_spread"]), np.exp(plain["log_radius_spread"]), plain["slope"]
    without = {"surface_shear_modulus": np.exp(plain["log_modulus"]), "capsule_radius": np.exp(plain["log_radius"])}
    draws = {
        "surface_shear_modulus": without["surface_shear_modulus"] * shifts["viscosity"] * scale,
        "capsule_radius": without["capsule_radius"] * shifts["half_width"],
        "modulus_spread": np.hypot(spread, slope * of_radius),
        "radius_spread": of_radius,
        "modulus_spread_at_given_size": spread,
        "modulus_slope": slope,
    }
    leaning = float(np.mean(population["status"][kept] == Status.LEANS_ON_BORDER.name))
    return Hierarchy(draws, without, int(kept.sum()), least_stretch, leaning, tuple(gates), seed)


def _shared(population: Population, experiment: Experiment | None) -> tuple[Quantity, Quantity]:
    """Return viscosity and half width of all capsules."""
    if experiment is not None:
        return experiment.viscosity, experiment.half_width
    stated = population.attributes.get("experiment") or {}
    if "viscosity" not in stated:
        advice = "give it: experiment=..."
        raise InputError("hierarchy", "experiment", "one experiment for all capsules", "a population without", advice)
    known = {name: Quantity(stated[name]["value"], stated[name]["error"]) for name in ("viscosity", "half_width")}
    return known["viscosity"], known["half_width"]
