"""The distribution that the capsules of a session share."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Gate
from capsbayes.infer.likelihood import compiled
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.population import Population, merged
from capsbayes.infer.posterior import check_units, inference_data
from capsbayes.infer.prior import Marginal
from capsbayes.infer.proposal import effective, normalised, rows_by_weight, smoothed, weight_gates
from capsbayes.infer.selection import (
    NODES,
    NORMAL,
    TAILS,
    ScaleMixture,
    Selection,
    half_width_of,
    kept_rows,
    limit_of,
    log_prior_of_freedom,
)
from capsbayes.model import ForwardModel
from capsbayes.quantity import Given, Quantity, uncertain
from capsbayes.readable import Readable
from capsbayes.status import Status

# Log posterior density of a population of (log G_s, log a): likelihood of all capsules, priors, selection.
#
# A capsule's own likelihood is a mixture of Gaussians, so its integral over a Gaussian population is a sum of
# Gaussians,
#
#     p(capsule | population) = sum_k w_k N(m_k; mu, Sigma + S_k).
#
# A population with the tails of t distributions is a mixture of Gaussian ones, and the sum goes over these too

PARAMETERS = ("log_modulus", "log_radius", "log_spread", "log_radius_spread", "slope")
"""Means of log G_s and log a, logarithms of the standard deviations of log G_s at given size and of log a, and the
slope d ln G_s / d ln a."""

FREEDOMS = ("log_modulus_freedom", "log_radius_freedom")
"""Of t distributions further: logarithms of the freedom of log G_s at given size and of log a, whose scales then take
the place of the standard deviations."""

SPREADS, SLOPES = 1.0, 5.0  # scales of the priors: half-normal of both spreads, normal of the slope
_LOWEST_SPREAD = np.log(1e-3)
_FREEDOM = np.log(10.0)  # to begin from
_THREADS = 2


@dataclass(frozen=True, eq=False)
class LogPosterior:
    """Log posterior density of the `PARAMETERS` of a population, and of its `FREEDOMS` if its tails are not normal."""

    components: NDArray[np.float32]  # (n, c, 6): likelihood of each capsule in (log G_s, log a)
    selection: Selection | None = None
    tails: str = NORMAL

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return PARAMETERS if self.tails == NORMAL else (*PARAMETERS, *FREEDOMS)

    @property
    def size(self) -> int:
        """Number of Gaussians of one evaluation."""
        return self.components[..., 0].size * (1 if self.tails == NORMAL else NODES**2)

    def mixtures(self, parameters: Floats) -> tuple[ScaleMixture, ScaleMixture]:
        """Return the tails of log G_s at given size and of log a of some populations : (d, p) array."""
        if self.tails == NORMAL:
            normal = ScaleMixture.normal(len(parameters))
            return normal, normal
        first = len(PARAMETERS)
        return ScaleMixture.of_freedom(parameters[:, first]), ScaleMixture.of_freedom(parameters[:, first + 1])

    def __call__(self, parameters: Floats) -> Floats:
        """Return the log density of some populations, up to a constant : (d, p) -> (d,) array."""
        parameters = np.ascontiguousarray(np.atleast_2d(parameters))
        values = np.empty(len(parameters))
        halves = np.array_split(np.arange(len(parameters)), min(_THREADS, len(parameters)))
        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(lambda rows: self._fill(parameters, values, rows), halves))
        values += _log_prior(parameters)
        return values

    def _fill(self, parameters: Floats, values: Floats, rows: NDArray[np.intp]) -> None:
        some = parameters[rows]
        modulus, radius = self.mixtures(some)
        into = values[rows[0] : rows[-1] + 1]
        log_likelihood(self.components, some, *modulus, *radius, into)
        if self.selection is not None:
            into -= self.selection.log_probability(some, modulus, radius)

    def of_capsules(self, parameters: Floats) -> Floats:
        """Return the log likelihood of each capsule for some populations, up to a constant of the capsule."""
        parameters = np.ascontiguousarray(parameters)
        modulus, radius = self.mixtures(parameters)
        values = np.empty((len(self.components), len(parameters)))
        for n, into in enumerate(values):
            log_likelihood(self.components[n : n + 1], parameters, *modulus, *radius, into)
        if self.selection is None:
            return values.T
        return values.T - self.selection.log_probabilities(parameters, modulus, radius)

    @property
    def start(self) -> Floats:
        """Moments of the capsules, to begin from : (p,) array."""
        weights = self.components[:, :, 0]
        x, y = ((weights * self.components[:, :, k]).sum(axis=1) / weights.sum(axis=1) for k in (1, 2))
        spread = [0.5 * np.std(means) + 0.02 for means in (x, y)]
        freedoms = [_FREEDOM] * (len(self.names) - len(PARAMETERS))
        return np.array([np.median(x), np.median(y), *np.log(spread), 0.0, *freedoms], dtype=np.float64)


def _log_prior(parameters: Floats) -> Floats:
    """Return the log prior: half-normal spreads, as densities of their logarithms and none below 1e-3; normal slope."""
    spreads, slope = parameters[:, 2:4], parameters[:, 4]
    values = np.sum(spreads - 0.5 * (np.exp(spreads) / SPREADS) ** 2, axis=1) - 0.5 * (slope / SLOPES) ** 2
    values += np.sum(log_prior_of_freedom(parameters[:, len(PARAMETERS) :]), axis=1)
    return np.where((spreads > _LOWEST_SPREAD).all(axis=1), values, -1e10)


@compiled
def log_likelihood(
    components: NDArray[np.float32],
    parameters: Floats,
    modulus_variance: Floats,
    modulus_weight: Floats,
    radius_variance: Floats,
    radius_weight: Floats,
    into: Floats,
) -> None:
    """Fill in the log likelihood (d,) of all capsules, laid out by `mixture` (n, c, 6), for populations (d, p).

    The (d, j) arrays are the tails of log G_s at given size and of log a, as of `ScaleMixture`.
    """
    nodes = modulus_variance.shape[1]
    for d in range(len(parameters)):
        x, y, spread, radius_spread, slope = parameters[d, :5]
        total = 0.0
        for n in range(len(components)):
            density = 0.0
            for i in range(nodes):
                given = np.exp(2.0 * spread) * modulus_variance[d, i]
                for j in range(nodes):
                    of_radius = np.exp(2.0 * radius_spread) * radius_variance[d, j]
                    pop_xx, pop_xy, pop_yy = given + slope * slope * of_radius, slope * of_radius, of_radius
                    share = modulus_weight[d, i] * radius_weight[d, j]
                    for k in range(components.shape[1]):
                        weight = components[n, k, 0]
                        if weight > 0.0:
                            dx, dy = components[n, k, 1] - x, components[n, k, 2] - y
                            xx, xy = components[n, k, 3] + pop_xx, components[n, k, 4] + pop_xy
                            yy = components[n, k, 5] + pop_yy
                            determinant = xx * yy - xy * xy
                            square = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
                            if square < 1400.0:
                                density += share * weight * np.exp(-0.5 * square) / np.sqrt(determinant)
            total += np.log(max(density, 1e-300))
        into[d] = total


# Draws of the posterior of a population: importance sampling from a t distribution about its mode

_PROPOSAL_DRAWS, _KEPT, _FEWEST_DRAWS = 4000, 4000, 800
_DRAWS_OF_TAILS = 1000  # each costs twenty-five times as much
_BUDGET = 1e9  # Gaussians that are evaluated for the draws: some ten seconds
_STEP = 1e-3  # of the parameters, for derivatives
_TOLERANCE = 1e-18  # of the log density, still to be gained at the mode: 1e-9 of its widths
_POLISHED = 12  # steps at most that refine it
_PROPOSAL_ROUNDS = 8
_FEW = 0.1  # share of effective draws to which the proposal is fitted
_PROPOSAL_FREEDOM = 8  # of the t distribution that is drawn from
_LEAST_ESS = 400.0


def drawn(
    log_posterior: LogPosterior, place: tuple[Floats, Floats], rng: np.random.Generator
) -> tuple[Floats, list[Gate]]:
    """Draw from a posterior; return the draws (d, p) and the gates on their weights."""
    # `place` is that of its mode, with the covariance there. Where the weights fail their gates, the proposal is fitted
    # to the weighted draws and drawn from again; to draws whose weights are raised to a power below one if few of them
    # have all the weight.
    most = _PROPOSAL_DRAWS if log_posterior.tails == NORMAL else _DRAWS_OF_TAILS
    count = int(np.clip(_BUDGET / log_posterior.size, _FEWEST_DRAWS, most))
    centre, covariance = place
    for _ in range(_PROPOSAL_ROUNDS):
        # SciPy draws along eigenvectors, whose signs depend on the kernel
        normal = rng.standard_normal((count, len(centre))) @ np.linalg.cholesky(covariance).T
        tried = centre + normal / np.sqrt(rng.chisquare(_PROPOSAL_FREEDOM, (count, 1)) / _PROPOSAL_FREEDOM)
        proposal = stats.multivariate_t(centre, covariance, df=_PROPOSAL_FREEDOM)
        tailed, pareto = smoothed(log_posterior(tried) - proposal.logpdf(tried))
        weights = normalised(tailed)
        gates = [*weight_gates(tailed, pareto, _LEAST_ESS, "effective draws of the population")]
        if all(gate.passed for gate in gates):
            break
        tempered, power = weights, 1.0
        while effective(tempered) < _FEW * count:
            power *= 0.7
            tempered = normalised(power * tailed)
        centre, covariance = tempered @ tried, np.cov(tried.T, aweights=tempered)
    return tried[rows_by_weight(weights, rng, _KEPT)], gates


def mode(log_posterior: LogPosterior, start: Floats | None = None) -> tuple[Floats, Floats]:
    """Find the mode and the covariance by the curvature there : (p,), (p, p) arrays."""
    steps = np.eye(len(log_posterior.names)) * _STEP

    def downhill(place: Floats) -> tuple[float, Floats]:
        values = log_posterior(np.concatenate([place[None], place + steps, place - steps]))
        ahead, behind = np.split(values[1:], 2)
        return -float(values[0]), (behind - ahead) / (2.0 * _STEP)

    def curvature(place: Floats) -> Floats:
        rows = [(downhill(place + step)[1] - downhill(place - step)[1]) / (2.0 * _STEP) for step in steps]
        values, axes = np.linalg.eigh(0.5 * (np.array(rows) + np.transpose(rows)))
        # where the data do not constrain a direction, as a slope without a spread of sizes, the prior does
        return np.asarray((axes * np.maximum(values, 1.0 / SLOPES**2)) @ axes.T)

    start = log_posterior.start if start is None else start
    found = np.asarray(optimize.minimize(downhill, start, jac=True, method="BFGS", options={"gtol": 1e-3}).x)
    bend = curvature(found)
    for _ in range(_POLISHED):  # where BFGS ends, the last digits decide
        slope = downhill(found)[1]
        step = -np.linalg.solve(bend, slope)
        if -slope @ step < _TOLERANCE:
            break
        found = found + step
    return found, np.asarray(np.linalg.inv(curvature(found)))


# Posterior predictive check of the tails of a population.
#
# The residuals of the capsules from the population, over their standard errors, are compared with those of replicates:
# capsules drawn from the population, in the same flows, under the same selection and with the same errors. The
# discrepancy is the kurtosis, which heavy tails and odd capsules raise and two groups lower: A. Gelman, X.-L. Meng and
# H. Stern, Statistica Sinica 6 (1996) 733

_DRAWS, _MOST = 500, 2000  # of the posterior; of the capsules
_ROUNDS = 60  # of replicates drawn again because they would not be in the sample

RESIDUALS = ("surface_shear_modulus", "capsule_radius")
"""Residuals that are checked: of log G_s at given size, and of log a."""


def tail_p_values(log_posterior: LogPosterior, parameters: Floats, rng: np.random.Generator) -> dict[str, float]:
    """Return the share of replicates whose kurtosis is at least that of the capsules, for each of the `RESIDUALS`."""
    components, selection = log_posterior.components.astype(np.float64), log_posterior.selection
    chosen = np.sort(rng.choice(len(components), min(len(components), _MOST), replace=False))
    components = components[chosen]
    if selection is not None:
        selection = replace(selection, flow=selection.flow[chosen], half_width=selection.half_width[chosen])
    places, own = _moments(components)
    parameters = parameters[rng.choice(len(parameters), _DRAWS)]
    modulus, radius = log_posterior.mixtures(parameters)
    x, y, log_spread, log_radius_spread, slope = parameters[:, :5].T
    drawn = np.zeros((_DRAWS, len(chosen), 2))
    d, n = (index.ravel() for index in np.indices(drawn.shape[:2]))
    for _ in range(_ROUNDS):
        larger = np.exp(log_radius_spread[d]) * radius.drawn(rng, d) * rng.standard_normal(len(d))
        harder = np.exp(log_spread[d]) * modulus.drawn(rng, d) * rng.standard_normal(len(d)) + slope[d] * larger
        drawn[d, n] = np.stack([x[d] + harder, y[d] + larger], axis=1)
        if selection is None:
            break
        again = ~selection.holds(drawn[d, n, 0], drawn[d, n, 1], n, rng)
        d, n = d[again], n[again]
    first, second = rng.standard_normal((2, *drawn.shape[:2]))
    along = np.sqrt(own[:, 0, 0])
    across = own[:, 0, 1] / along
    noise = np.stack([along * first, across * first + np.sqrt(own[:, 1, 1] - across**2) * second], axis=-1)
    sizes = [_kurtoses(values, own, parameters) for values in (places[None], drawn + noise)]
    exceeding = np.sum(sizes[1] >= sizes[0], axis=1)
    return {name: (1.0 + float(count)) / (1.0 + _DRAWS) for name, count in zip(RESIDUALS, exceeding, strict=True)}


def _moments(components: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of the likelihood of each capsule : (n, 2), (n, 2, 2) arrays."""
    weights = components[..., 0] / components[..., 0].sum(axis=1, keepdims=True)
    means = np.sum(weights[..., None] * components[..., 1:3], axis=1)
    away = components[..., 1:3] - means[:, None]
    within = components[..., [3, 4, 4, 5]].reshape(*weights.shape, 2, 2)
    return means, np.sum(weights[..., None, None] * (within + away[..., :, None] * away[..., None, :]), axis=1)


def _kurtoses(values: Floats, own: Floats, parameters: Floats) -> Floats:
    """Return the kurtosis of both residuals over their standard errors : (2, d) array."""
    x, y, slope = (parameters[:, k, None] for k in (0, 1, 4))
    sd_x, sd_y = np.exp(parameters[:, 2, None]), np.exp(parameters[:, 3, None])
    of_radius = values[..., 1] - y
    of_modulus = values[..., 0] - x - slope * of_radius
    error = own[:, 0, 0] - 2.0 * slope * own[:, 0, 1] + slope**2 * own[:, 1, 1]
    found = []
    for residual, variance in ((of_modulus, sd_x**2 + error), (of_radius, sd_y**2 + own[:, 1, 1])):
        scaled = residual / np.sqrt(variance)
        scaled = scaled - scaled.mean(axis=1, keepdims=True)
        found.append(np.mean(scaled**4, axis=1) / np.mean(scaled**2, axis=1) ** 2)
    return np.stack(found)


# Population of the capsules of a session: mean and spread of G_s and a with the errors removed.
#
# Each capsule has its own (log G_s, log a), drawn from a Gaussian population with a slope d ln G_s / d ln a, or from
# one with heavier tails. Capsules too soft for their flow have no steady shape and are not in the sample. Viscosity and
# half width are those of all capsules: their errors do not shrink with the number of capsules, so they are integrated
# outside the loop over capsules. A viscosity moves every log G_s by the same amount, which moves the mean and leaves
# spread and slope as they are; so does a half width with log a

FEWEST = 3
PREFIX = "population_"  # of the draws in the file of a population
_MODULUS = "surface_shear_modulus"
_UNITS = {_MODULUS: "N/m", "capsule_radius": "m"}
_STORED, _CHAINS = 500, 4
_HEAVY_TAILS, _LIGHT_TAILS = 0.02, 0.995  # p-values; light ones, which two groups have, hardly concern the spread
_MERGED = 3  # neighbouring components of a capsule, where the sum goes over the parts of t distributions too
_LEAST_SEEN = 0.1  # share of the population in the sample, below which the rest is extrapolated too far
_LEAST = 1e-6  # share in the sample, below which the number of the others is not known
_COPIES = 8  # of each draw, each with its own shared errors, that a stated median is met with
_TAKING_PART = [status.name for status in Status if status.ok or status.name.startswith("LEANS")]


@dataclass(frozen=True)
class Update:
    """Median G_s of the batch as another experiment found it, and by the capsules alone [N/m].

    `apart` is the distance of the logarithms of the two over the standard deviation of their difference.
    """

    stated: Marginal
    alone: Marginal
    apart: float


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(Readable):
    """Posterior of a population.

    Parameters
    ----------
    draws : mapping of (d,) array
        ``surface_shear_modulus`` and ``capsule_radius``, medians of the population in SI; ``modulus_spread`` and
        ``radius_spread``, standard deviations of log G_s and of log a from capsule to capsule (with the tails of t
        distributions half the width of the central 68.3 %, which is the same for normal ones);
        ``modulus_spread_at_given_size``; ``modulus_slope``, d ln G_s / d ln a; ``modulus_freedom`` and
        ``radius_freedom`` of t distributions. They include all errors.
    without_shared : mapping of (d,) array
        The same medians as if viscosity, half width and the scale of the velocities were known exactly.
    shared_share : mapping of float
        Share of the variance of the logarithm of each median that is due to what all capsules share, by the capsules
        alone.
    capsules : int
        Number of capsules.
    least_stretch : float or None
        Smallest Lambda of the capsules kept, if that was accounted for.
    leaning : float
        Share of the capsules whose posterior leans on the border of the model: the population may extend beyond it.
    gates : tuple of Gate
        Checks of the computation.
    seed : int
    tails : str
        ``"normal"`` or ``"student"``.
    tail_p_values : mapping of float
        Posterior predictive p-values of the tails of log G_s at given size and of log a, by the name of the quantity:
        near zero where they are heavier than those of the population that was fitted, near one where lighter.
    missing : (d,) array
        Draws of the number of capsules that are not in the sample because they are too soft for a steady shape in
        their flow; empty if that was not modelled.
    changes : mapping of float
        Relative change of the medians of G_s and a when the missing capsules are accounted for.
    parameters : (d, p) array
        The draws as parameters of `log_posterior`.
    log_posterior : LogPosterior, optional
        The density from which the draws come.
    names : (n,) array of str
        Names of the capsules.
    update : Update, optional
        How a median of G_s that was stated of the batch changed that of the capsules.
    """

    draws: dict[str, Floats]
    without_shared: dict[str, Floats]
    shared_share: dict[str, float]
    capsules: int
    least_stretch: float | None
    leaning: float
    gates: tuple[Gate, ...]
    seed: int
    tails: str = NORMAL
    tail_p_values: dict[str, float] = field(default_factory=dict)
    missing: Floats = field(default_factory=lambda: np.empty(0))
    changes: dict[str, float] = field(default_factory=dict)
    parameters: Floats = field(default_factory=lambda: np.empty((0, 0)))
    log_posterior: LogPosterior | None = None
    names: NDArray[np.str_] = field(default_factory=lambda: np.empty(0, dtype=np.str_))
    update: Update | None = None

    @property
    def marginals(self) -> dict[str, Marginal]:
        """Summaries of the draws by name."""
        return {name: Marginal.of_draws(values) for name, values in self.draws.items()}

    def described(self) -> dict[str, str]:
        """Return the medians and 95 % intervals in display units."""
        intervals = {name: marginal.shown(name) for name, marginal in self.marginals.items()}
        return {"capsules": str(self.capsules), **intervals, **({} if self.passed else {"gates": "not passed"})}

    @property
    def passed(self) -> bool:
        """True if the intervals can be used."""
        return all(gate.passed for gate in self.gates)

    @property
    def odd_tails(self) -> tuple[str, ...]:
        """Quantities whose tails differ from those of the fitted population; their spreads are not reliable."""
        found = self.tail_p_values.items()
        return tuple(name for name, p in found if p < _HEAVY_TAILS or p > _LIGHT_TAILS)

    def added_to(self, population: Population) -> Population:
        """Return the capsules with this result added: draws as ``population_surface_shear_modulus`` and so on."""
        every = slice(None, None, max(len(self.draws["modulus_slope"]) // _STORED, 1))
        variables = {
            f"{PREFIX}{name}": ("draw", values[every], {"units": _UNITS.get(name, "1")})
            for name, values in self.draws.items()
        }
        known = population.dataset.drop_dims("draw", errors="ignore")
        return Population(known.assign(variables).assign_attrs(hierarchy=json.dumps(self.as_dict())))

    def to_inference_data(self, *, units: str = "si") -> Any:
        """Return an `arviz.InferenceData` of the population with one log-likelihood per capsule, for `arviz.loo`.

        ``posterior`` holds `_STORED` draws or more in `_CHAINS` chains, parts of one set of independent draws, and
        ``log_likelihood`` the variable ``capsules`` with the capsules as its last dimension, each integrated over the
        capsule's own G_s and a, at the viscosity and half width as stated.

        Parameters
        ----------
        units : str
            ``"si"`` or ``"shown"``, see `capsbayes.Posterior.to_inference_data`.

        Raises
        ------
        InputError
            If `units` is neither.
        """
        import xarray as xr

        check_units(units, "hierarchy")
        assert self.log_posterior is not None, "a hierarchy is made by `hierarchy`"
        every = np.arange(0, len(self.parameters), max(len(self.parameters) // _STORED, 1))
        kept = every[: len(every) // _CHAINS * _CHAINS].reshape(_CHAINS, -1)
        draws = {
            name: (("chain", "draw"), values[kept], {"units": _UNITS.get(name, "1")})
            for name, values in self.draws.items()
        }
        of_capsules = self.log_posterior.of_capsules(self.parameters[kept.ravel()]).reshape(*kept.shape, -1)
        likelihood = xr.Dataset({"capsules": (("chain", "draw", "capsule"), of_capsules)}, {"capsule": self.names})
        groups = {"posterior": xr.Dataset(draws), "log_likelihood": likelihood}
        return inference_data(groups, units)

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
            "tails": self.tails,
            "tail_p_values": self.tail_p_values,
            "odd_tails": list(self.odd_tails),
            "missing": Marginal.of_draws(self.missing).as_dict() if len(self.missing) else None,
            "changes_by_the_missing": self.changes,
            "update": None if self.update is None else asdict(self.update),
        }


@checked
def hierarchy(
    population: Population,
    *,
    seed: int,
    least_stretch: float | None = None,
    model: ForwardModel | None = None,
    experiment: Experiment | None = None,
    shared_velocity_error: float = 0.0,
    tails: str = NORMAL,
    existence: bool = True,
    median_modulus: Given = None,
) -> Hierarchy:
    """Infer the medians, the spreads and the slope of a population of capsules.

    Parameters
    ----------
    population : Population
        Capsules of one session. All with a result are used, also those that lean on the border of the model.
    seed : int
        Of the draws.
    least_stretch : float, optional
        Keep only the capsules with a larger median Lambda, as the published cut of 1.04 does, and account for it.
    model : ForwardModel, optional
        That of the population; needed with `least_stretch`, and for files that do not store its limit of steady shapes.
    experiment : Experiment, optional
        Replaces the one stored with the population; needed if its errors are not normal distributions.
    shared_velocity_error : float
        Relative standard error that all velocities have in common, as from the size of a pixel or the frame rate; the
        errors of the single velocities are then those without it. Of capsules with a flow rate and no velocity, the
        errors of flow rate and half width are taken as common.
    tails : str
        ``"normal"``, or ``"student"`` for t distributions, whose degrees of freedom are inferred: a few outlying
        capsules then hardly change the spread.
    existence : bool
        Account for the capsules that are missing because they are too soft for a steady shape in their flow. Turn this
        off for comparison only.
    median_modulus : Quantity, optional [N/m]
        Median G_s of the batch as another experiment found it, as ``"50 +/- 4 mN/m"`` by compression or AFM. Its error
        includes that of the other method, and must have nothing in common with the errors of this session.

    Returns
    -------
    Hierarchy

    Raises
    ------
    InputError
        If fewer than three capsules have a result, the experiment or the limit of steady shapes is not known, or an
        option is not one of those allowed.

    Notes
    -----
    Priors: flat in the means of log G_s and log a, half-normal of scale 1 in both spreads, normal of scale 5 in the
    slope, log-normal of median 5 and scale 1 in the degrees of freedom.
    The posterior is drawn from a t distribution about its mode, the draws weighted by Pareto-smoothed importance
    sampling (https://doi.org/10.48550/arXiv.1507.02646), whose diagnostic is among the gates.
    """
    if tails not in TAILS:
        raise InputError("hierarchy", "tails", " or ".join(TAILS), repr(tails))
    stated = None
    if median_modulus is not None:
        stated = uncertain(
            median_modulus,
            _MODULUS,
            where="hierarchy",
            key="median_modulus",
            units=("N/m",),
            example="50 +/- 4 mN/m",
            normal=False,
        )
    viscosity, half_width = _shared(population, experiment)
    kept = _taking_part(population, least_stretch, model)
    selection = None
    if existence or least_stretch is not None:
        selection = Selection.of(
            population,
            kept,
            _limit(population, model),
            viscosity=viscosity.value,
            half_width=half_width.value,
            least_stretch=least_stretch,
            model=model,
        )
    components = np.ascontiguousarray(population["likelihood"][kept])  # in (log G_s, log a), at what all share
    components[:, :, 1] += np.float32(np.log(viscosity.value))
    components[:, :, 2] += np.float32(np.log(half_width.value))
    if tails != NORMAL:
        components = merged(components, _MERGED)
    rng = np.random.default_rng([seed, 3])
    log_posterior = LogPosterior(components, selection if existence else _without_limit(selection), tails)
    place = mode(log_posterior)
    parameters, gates = drawn(log_posterior, place, rng)
    if stated is not None:
        parameters = np.repeat(parameters, _COPIES, axis=0)
    shifts = _shifts(population, kept, viscosity, half_width, shared_velocity_error, rng, len(parameters))
    without = {_MODULUS: np.exp(parameters[:, 0]), "capsule_radius": np.exp(parameters[:, 1])}
    medians = {name: without[name] * shift for name, shift in shifts.items()}
    shares = {name: 1.0 - float(np.var(np.log(without[name])) / np.var(np.log(medians[name]))) for name in medians}
    update = None
    if stated is not None:
        update = _update(stated, medians[_MODULUS])
        tailed, pareto = smoothed(stated.logpdf(medians[_MODULUS]))
        gates += weight_gates(tailed, pareto, _LEAST_ESS, "effective draws with the stated median")
        rows = rows_by_weight(normalised(tailed), rng, _KEPT)
        parameters = parameters[rows]
        without, medians = ({name: each[rows] for name, each in of.items()} for of in (without, medians))
    draws = medians | _spreads(log_posterior, parameters)
    leaning = float(np.mean(population["status"][kept] == Status.LEANS_ON_BORDER.name))
    missing, changes = np.empty(0), dict[str, float]()
    if existence:
        missing, changes, seen = _missing(log_posterior, place[0], parameters, seed)
        gates.append(Gate("share of the population that has a steady shape", seen, least=_LEAST_SEEN))
    return Hierarchy(
        draws,
        without,
        shares,
        int(kept.sum()),
        least_stretch,
        leaning,
        tuple(gates),
        seed,
        tails,
        tail_p_values(log_posterior, parameters, np.random.default_rng([seed, 4])),
        missing,
        changes,
        parameters,
        log_posterior,
        population["name"][kept],
        update,
    )


def _update(stated: Quantity, medians: Floats) -> Update:
    """Compare a stated median with that of the capsules : (d,) array."""
    other = stated.ppf((np.arange(_STORED) + 0.5) / _STORED)
    first, second = np.log(other), np.log(medians)
    apart = abs(first.mean() - second.mean()) / np.hypot(first.std(), second.std())
    return Update(Marginal.of_draws(other), Marginal.of_draws(medians), float(apart))


def _shifts(
    population: Population,
    kept: NDArray[np.bool_],
    viscosity: Quantity,
    half_width: Quantity,
    velocity_error: float,
    rng: np.random.Generator,
    count: int,
) -> dict[str, Floats]:
    """Draw the factors on the medians of G_s and a by which all capsules are wrong alike : (count,) arrays by name."""
    modulus, radius = (LogGrid.of(each).drawn(rng, count) / each.value for each in (viscosity, half_width))
    modulus *= np.exp(velocity_error * rng.standard_normal(count))
    by_rate = kept & np.isnan(population["capsule_velocity"]) & np.isfinite(population["flow_rate"])
    if by_rate.any():  # one pump and one channel: U = Q / A is wrong for all alike
        rate_error = np.max(np.nan_to_num(population["flow_rate_error"][by_rate]) / population["flow_rate"][by_rate])
        modulus *= np.exp(rate_error * rng.standard_normal(count)) / radius**2
    return {"surface_shear_modulus": modulus, "capsule_radius": radius}


def _taking_part(population: Population, least_stretch: float | None, model: ForwardModel | None) -> NDArray[np.bool_]:
    """Return which capsules take part : (n,) array."""
    kept = (population["likelihood"][:, :, 0].sum(axis=1) > 0.0) & np.isin(population["status"], _TAKING_PART)
    if least_stretch is not None:
        if not (np.isfinite(least_stretch) and least_stretch > 0.0):
            advice = "the published cut is 1.04"
            raise InputError("hierarchy", "least_stretch", "a Lambda above zero", f"{least_stretch:g}", advice)
        if model is None:
            raise InputError("hierarchy", "model", "the model of the population, with least_stretch", "nothing")
        kept &= kept_rows(population, least_stretch)
    if np.count_nonzero(kept) < FEWEST:
        expected = f"at least {FEWEST} capsules with a result"
        raise InputError("hierarchy", "population", expected, str(np.count_nonzero(kept)))
    return np.asarray(kept)


def _limit(population: Population, model: ForwardModel | None) -> tuple[Floats, Floats]:
    """Return the limit of steady shapes of the model given, or that which the population stores."""
    if model is not None:
        return limit_of(model)
    if (stored := population.limit) is not None:
        return stored
    advice = "give it: model=..., or identify the capsules again"
    raise InputError("hierarchy", "model", "the limit of steady shapes", "a population without", advice)


def _without_limit(selection: Selection | None) -> Selection | None:
    """Return a selection by the cut alone, None if there is no cut."""
    if selection is None or not np.isfinite(selection.cut).any():
        return None
    return replace(selection, limit=np.full_like(selection.limit, np.inf))


def _spreads(log_posterior: LogPosterior, parameters: Floats) -> dict[str, Floats]:
    """Return draws of the spreads, of the slope and of the freedoms."""
    modulus, radius = log_posterior.mixtures(parameters)
    named = dict(zip(log_posterior.names, parameters.T, strict=True))
    slope = named["slope"]
    given, of_radius = modulus.scaled(np.exp(named["log_spread"])), radius.scaled(np.exp(named["log_radius_spread"]))
    return {
        "modulus_spread": half_width_of(*given.plus(of_radius.scaled(slope))),
        "radius_spread": half_width_of(*of_radius),
        "modulus_spread_at_given_size": half_width_of(*given),
        "modulus_slope": slope,
        **{name.removeprefix("log_"): np.exp(named[name]) for name in FREEDOMS if name in named},
    }


def _missing(
    log_posterior: LogPosterior, found: Floats, parameters: Floats, seed: int
) -> tuple[Floats, dict[str, float], float]:
    """Return draws of the number of capsules too soft to be in the sample, their effect on the mode, others' share."""
    assert log_posterior.selection is not None
    some = parameters[:: max(len(parameters) // _STORED, 1)]
    kept, lost, number = log_posterior.selection.shares(some, *log_posterior.mixtures(some))
    seen = np.maximum(kept, _LEAST) / np.maximum(kept + lost, _LEAST)
    missing = np.random.default_rng([seed, 5]).negative_binomial(number, seen).sum(axis=1).astype(float)
    ignored = replace(log_posterior, selection=_without_limit(log_posterior.selection))
    changes = np.expm1(found[:2] - mode(ignored, found)[0][:2])
    named = dict(zip(("surface_shear_modulus", "capsule_radius"), map(float, changes), strict=True))
    return missing, named, float(np.median(seen @ number / number.sum()))


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


# The spread of G_s in a population with the errors removed: a normal distribution of its logarithm, or a t one


class ModulusSpread:
    """Distribution of ln(G_s / (1 N/m)) over the capsules, and how well it is known.

    `mean` and `sd` are those of ln G_s from capsule to capsule, or draws (d,) of both; of heavy tails `sd` is half the
    width of the central 68.3 %, and `tails` has one row a draw.
    """

    def __init__(self, mean: ArrayLike, sd: ArrayLike, tails: ScaleMixture | None = None) -> None:
        means, sds = (np.atleast_1d(np.asarray(values, dtype=float)) for values in (mean, sd))
        if means.ndim != 1 or means.shape != sds.shape:
            raise InputError("ModulusSpread", "mean, sd", "arrays of one length", f"{means.shape} and {sds.shape}")
        if not (np.isfinite(means).all() and np.isfinite(sds).all() and (sds > 0.0).all()):
            raise InputError("ModulusSpread", "mean, sd", "finite numbers, standard deviations above zero", "others")
        self.mean, self.sd, self.tails = means, sds, tails

    @classmethod
    def of_population(cls, population: Population) -> ModulusSpread | None:
        """Return the spread that is stored with a population; None if there is none."""
        names = ("population_surface_shear_modulus", "population_modulus_spread")
        if any(name not in population.dataset for name in names):
            return None
        median, sd = (population[name] for name in names)
        return cls(np.log(median), sd, _tails(population))

    def density(self, modulus: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return the density of ln G_s at given G_s: median and 95 % band over the draws."""
        off = np.log(modulus) - self.mean[:, None]
        variances, weights = self.tails or ScaleMixture.normal(len(off)).scaled(self.sd)
        each = np.zeros_like(off)
        for variance, weight in zip(variances.T[:, :, None], weights.T[:, :, None], strict=True):
            each += weight * np.exp(-0.5 * off**2 / variance) / np.sqrt(2.0 * np.pi * variance)
        middle, low, high = np.quantile(each, [0.5, 0.025, 0.975], axis=0)
        return middle, low, high

    @property
    def median(self) -> Floats:
        """Median G_s of the capsules, 50 %, 2.5 % and 97.5 % of its posterior : (3,) array [N/m]."""
        return np.exp(np.quantile(self.mean, [0.5, 0.025, 0.975]))

    @property
    def relative(self) -> Floats:
        """Spread of G_s over its median, 50 %, 2.5 % and 97.5 % of its posterior : (3,) array."""
        return np.quantile(self.sd, [0.5, 0.025, 0.975])


def _tails(population: Population) -> ScaleMixture | None:
    """Return ln G_s as the sum of what the size explains and of the rest, if t distributions were fitted to both."""
    parts = []
    for freedom, spread in (("modulus", "modulus_spread_at_given_size"), ("radius", "radius_spread")):
        if f"population_{freedom}_freedom" not in population.dataset:
            return None
        unit = ScaleMixture.of_freedom(np.log(population[f"population_{freedom}_freedom"]))
        parts.append(unit.scaled(population[f"population_{spread}"] / half_width_of(*unit)))
    return parts[0].plus(parts[1].scaled(population["population_modulus_slope"]))
