"""What the capsules of a session have in common: mean and spread of G_s and a with the errors removed.

Each capsule has its own (log G_s, log a), drawn from a Gaussian population with a slope d ln G_s / d ln a. Viscosity
and half width are those of all capsules: their errors do not shrink with the number of capsules, so they are integrated
outside the loop over capsules. A viscosity moves every log G_s by the same amount, which moves the mean and leaves
spread and slope as they are; so does a half width with log a.
"""

from __future__ import annotations

import json
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.inference.checks import Gate
from capsbayes.inference.inputs import Input
from capsbayes.inference.marginal import Marginal
from capsbayes.model import ForwardModel
from capsbayes.population.hyper_likelihood import PARAMETERS, log_likelihood
from capsbayes.population.population import Population
from capsbayes.population.pyramid import Pyramid
from capsbayes.population.selection import Selection, kept_rows
from capsbayes.status import Status

__all__ = ["Hierarchy", "LogPosterior", "hierarchy"]

Floats = NDArray[np.float64]

FEWEST = 3
PREFIX = "population_"
"""Of the draws in the file of a population."""
_UNITS = {"surface_shear_modulus": "N/m", "capsule_radius": "m"}
_STORED = 500
SPREADS, SLOPES = 1.0, 5.0  # scales of the priors: half-normal of both spreads, normal of the slope
_DRAWS, _KEPT, _FEWEST_DRAWS = 4000, 4000, 800
_BUDGET = 1e9  # Gaussians that are worked out for the draws: some ten seconds
_STEP = 1e-3  # of the parameters, for derivatives
_THREADS = 2
_ROUNDS = 4
_FREEDOM = 8  # of the t distribution that is drawn from
_LEAST_ESS, _MOST_PARETO = 400.0, 0.7
_LOWEST_SPREAD = np.log(1e-3)


@dataclass(frozen=True, eq=False)
class Hierarchy:
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

    @property
    def passed(self) -> bool:
        """Whether the intervals can be used."""
        return all(gate.passed for gate in self.gates)

    @property
    def shared_share(self) -> dict[str, float]:
        """Share of the variance of the logarithm of each median that is owed to what all capsules share."""
        found = {}
        for name, values in self.without_shared.items():
            found[name] = 1.0 - float(np.var(np.log(values)) / np.var(np.log(self.draws[name])))
        return found

    def beside(self, population: Population) -> Population:
        """The capsules with this result beside them: draws as ``population_surface_shear_modulus`` and so on."""
        every = slice(None, None, max(len(self.draws["modulus_slope"]) // _STORED, 1))
        variables = {
            f"{PREFIX}{name}": ("draw", values[every], {"units": _UNITS.get(name, "1")})
            for name, values in self.draws.items()
        }
        known = population.dataset.drop_dims("draw", errors="ignore")
        return Population(known.assign(variables).assign_attrs(hierarchy=json.dumps(self.as_dict())))

    def as_dict(self) -> dict[str, Any]:
        """Everything but the draws, ready for JSON."""
        return {
            "capsules": self.capsules,
            "quantities": {name: one.as_dict() for name, one in self.marginals.items()},
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
        Keep the capsules with a larger median Lambda only, as the published cut of 1.04 does, and account for it.
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
    kept = population["likelihood"][:, :, 0].sum(axis=1) > 0.0
    selection = None
    if least_stretch is not None:
        if model is None:
            raise InputError("hierarchy", "model", "the model of the population, beside least_stretch", "nothing")
        kept &= kept_rows(population, least_stretch)
        pyramid = Pyramid.of(model)
        selection = Selection.of(population, least_stretch, pyramid, viscosity.centre, half_width.centre)
    if np.count_nonzero(kept) < FEWEST:
        expected = f"at least {FEWEST} capsules with a result"
        raise InputError("hierarchy", "population", expected, str(np.count_nonzero(kept)))
    components = np.ascontiguousarray(population["likelihood"][kept])
    components[:, :, 1] += np.float32(np.log(viscosity.centre))
    components[:, :, 2] += np.float32(np.log(half_width.centre))
    log_posterior = LogPosterior(components, selection)
    rng = np.random.default_rng([seed, 3])
    drawn, gates = _drawn(log_posterior, rng)
    plain = dict(zip(PARAMETERS, drawn.T, strict=True))
    count = len(drawn)
    shifts = {one.name: one.log_masses(-1).drawn(rng, count) / one.centre for one in (viscosity, half_width)}
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


@dataclass(frozen=True, eq=False)
class LogPosterior:
    """Log posterior density of the `PARAMETERS` of a population.

    Parameters
    ----------
    components : (n, c, 6) array
        Likelihood of each capsule in (log G_s, log a).
    selection : Selection, optional
    """

    components: NDArray[np.float32]
    selection: Selection | None = None

    def __call__(self, parameters: Floats) -> Floats:
        """Log density of some populations, up to a constant : (d, 5) -> (d,) array."""
        parameters = np.ascontiguousarray(np.atleast_2d(parameters))
        values = np.empty(len(parameters))
        halves = np.array_split(np.arange(len(parameters)), min(_THREADS, len(parameters)))
        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(lambda rows: self._fill(parameters, values, rows), halves))
        values += _log_prior(parameters)
        if self.selection is not None:
            values -= self.selection.log_probability(parameters)
        return values

    def _fill(self, parameters: Floats, values: Floats, rows: NDArray[np.intp]) -> None:
        log_likelihood(self.components, parameters[rows], values[rows[0] : rows[-1] + 1])

    @property
    def start(self) -> Floats:
        """Moments of the capsules, to begin from : (5,) array."""
        weights = self.components[:, :, 0]
        x, y = ((weights * self.components[:, :, k]).sum(axis=1) / weights.sum(axis=1) for k in (1, 2))
        spread = [0.5 * np.std(one) + 0.02 for one in (x, y)]
        return np.array([np.median(x), np.median(y), *np.log(spread), 0.0], dtype=np.float64)


def _log_prior(parameters: Floats) -> Floats:
    """Half-normal spreads, as densities of their logarithms, and a normal slope; nothing below a thousandth."""
    spreads, slope = parameters[:, 2:4], parameters[:, 4]
    values = np.sum(spreads - 0.5 * (np.exp(spreads) / SPREADS) ** 2, axis=1) - 0.5 * (slope / SLOPES) ** 2
    return np.where((spreads > _LOWEST_SPREAD).all(axis=1), values, -1e10)


def _drawn(log_posterior: LogPosterior, rng: np.random.Generator) -> tuple[Floats, list[Gate]]:
    """Draws of a posterior and whether they can be trusted : (d, 5) array and gates.

    Where the weights fail their gates, the proposal is fitted to the weighted draws and drawn from again.
    """
    count = int(np.clip(_BUDGET / log_posterior.components[..., 0].size, _FEWEST_DRAWS, _DRAWS))
    centre, covariance = _mode(log_posterior)
    for _ in range(_ROUNDS):
        proposal = stats.multivariate_t(centre, covariance, df=_FREEDOM)
        tried = np.atleast_2d(proposal.rvs(count, random_state=rng))
        smoothed, pareto = _smoothed(log_posterior(tried) - proposal.logpdf(tried))
        weights = np.exp(smoothed - smoothed.max())
        weights /= weights.sum()
        gates = [
            Gate("effective draws of the population", 1.0 / float(np.sum(weights**2)), least=_LEAST_ESS),
            Gate("Pareto k of the weights", pareto, most=_MOST_PARETO),
        ]
        if all(gate.passed for gate in gates):
            break
        centre = weights @ tried
        covariance = np.cov(tried.T, aweights=weights)
    # stratified, so that drawing again adds as little noise as can be
    places = (np.arange(_KEPT) + rng.uniform(size=_KEPT)) / _KEPT
    return tried[np.minimum(np.searchsorted(np.cumsum(weights), places), count - 1)], gates


def _mode(log_posterior: LogPosterior) -> tuple[Floats, Floats]:
    """Likeliest parameters and the covariance that the curvature there says : (5,), (5, 5) arrays."""
    steps = np.eye(len(PARAMETERS)) * _STEP

    def downhill(place: Floats) -> tuple[float, Floats]:
        values = log_posterior(np.concatenate([place[None], place + steps, place - steps]))
        ahead, behind = np.split(values[1:], 2)
        return -float(values[0]), (behind - ahead) / (2.0 * _STEP)

    found = optimize.minimize(downhill, log_posterior.start, jac=True, method="BFGS", options={"gtol": 1e-3})
    mode = np.asarray(found.x)
    curvature = np.stack([(downhill(mode + step)[1] - downhill(mode - step)[1]) / (2.0 * _STEP) for step in steps])
    values, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
    # along a direction that the data do not bind, as a slope without a spread of sizes, the prior does
    values = np.maximum(values, 1.0 / SLOPES**2)
    return mode, (axes / values) @ axes.T


def _smoothed(log_weights: Floats) -> tuple[Floats, float]:
    """Pareto-smoothed log weights and the shape k of the tail."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ArviZ itself
        import arviz

        smoothed, pareto = arviz.psislw(log_weights)
    return np.asarray(smoothed), float(pareto)


def _shared(population: Population, experiment: Experiment | None) -> tuple[Input, Input]:
    """Viscosity and half width of all capsules."""
    if experiment is not None:
        return Input.of("viscosity", experiment.viscosity), Input.of("half_width", experiment.half_width)
    stated = population.attributes.get("experiment") or {}
    if "viscosity" not in stated:
        advice = "give it: experiment=..."
        raise InputError("hierarchy", "experiment", "one experiment for all capsules", "a population without", advice)
    known = {name: Input(name, stated[name]["value"], stated[name]["error"]) for name in ("viscosity", "half_width")}
    return known["viscosity"], known["half_width"]
