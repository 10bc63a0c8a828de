"""Population of the capsules of a session: mean and spread of G_s and a with the errors removed.

Each capsule has its own (log G_s, log a), drawn from a Gaussian population with a slope d ln G_s / d ln a, or from one
with heavier tails. Capsules too soft for their flow have no steady shape and are not in the sample. Viscosity
and half width are those of all capsules: their errors do not shrink with the number of capsules, so they are integrated
outside the loop over capsules. A viscosity moves every log G_s by the same amount, which moves the mean and leaves
spread and slope as they are; so does a half width with log a.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Gate
from capsbayes.infer.inference_data import inference_data, shown
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.many.distribution.importance import drawn, mode
from capsbayes.infer.many.distribution.log_posterior import FREEDOMS, LogPosterior
from capsbayes.infer.many.distribution.predictive import tail_p_values
from capsbayes.infer.many.distribution.selection import Selection, kept_rows, limit_of
from capsbayes.infer.many.distribution.tails import NORMAL, TAILS, half_width_of
from capsbayes.infer.many.mixture import merged
from capsbayes.infer.many.population import Population
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
_HEAVY_TAILS, _LIGHT_TAILS = 0.02, 0.995  # p-values; light ones, which two groups have, hardly concern the spread
_MERGED = 3  # neighbouring components of a capsule, where the sum goes over the parts of t distributions too
_LEAST_SEEN = 0.1  # share of the population in the sample, below which the rest is extrapolated too far
_LEAST = 1e-6  # share in the sample, below which the number of the others is not known
_TAKING_PART = [status.name for status in Status if status.ok or status.name.startswith("LEANS")]


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
    """

    draws: dict[str, Floats]
    without_shared: dict[str, Floats]
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

    @property
    def marginals(self) -> dict[str, Marginal]:
        """Summaries of the draws by name."""
        return {name: Marginal.of_draws(values) for name, values in self.draws.items()}

    def described(self) -> dict[str, str]:
        """Return the medians and 95 % intervals in display units."""
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
    def odd_tails(self) -> tuple[str, ...]:
        """Quantities whose tails differ from those of the fitted population; their spreads are not reliable."""
        found = self.tail_p_values.items()
        return tuple(name for name, p in found if p < _HEAVY_TAILS or p > _LIGHT_TAILS)

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

    def to_inference_data(self, *, units: str = "si") -> Any:
        """Return an `arviz.InferenceData` of the population with one log-likelihood per capsule, for `arviz.loo`.

        ``posterior`` holds `_STORED` draws or more, ``log_likelihood`` the variable ``capsules`` with the capsules as
        its last dimension, each integrated over the capsule's own G_s and a, at the viscosity and half width as stated.

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

        if units not in ("si", "shown"):
            raise InputError("hierarchy", "units", '"si" or "shown"', repr(units))
        assert self.log_posterior is not None, "a hierarchy is made by `hierarchy`"
        every = slice(None, None, max(len(self.parameters) // _STORED, 1))
        draws = {
            name: (("chain", "draw"), values[every][None], {"units": _UNITS.get(name, "1")})
            for name, values in self.draws.items()
        }
        of_capsules = self.log_posterior.of_capsules(self.parameters[every])
        likelihood = xr.Dataset(
            {"capsules": (("chain", "draw", "capsule"), of_capsules[None])}, {"capsule": self.names}
        )
        groups = {"posterior": xr.Dataset(draws), "log_likelihood": likelihood}
        return inference_data(shown(groups) if units == "shown" else groups)

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
    components = _components(population, kept, viscosity, half_width)
    if tails != NORMAL:
        components = merged(components, _MERGED)
    rng = np.random.default_rng([seed, 3])
    log_posterior = LogPosterior(components, selection if existence else _without_limit(selection), tails)
    place = mode(log_posterior)
    parameters, gates = drawn(log_posterior, place, rng)
    without = {"surface_shear_modulus": np.exp(parameters[:, 0]), "capsule_radius": np.exp(parameters[:, 1])}
    shifts = {
        name: LogGrid.of(quantity).drawn(rng, len(parameters)) / quantity.value
        for name, quantity in (("surface_shear_modulus", viscosity), ("capsule_radius", half_width))
    }
    shifts["surface_shear_modulus"] *= np.exp(shared_velocity_error * rng.standard_normal(len(parameters)))
    by_rate = kept & np.isnan(population["capsule_velocity"]) & np.isfinite(population["flow_rate"])
    if by_rate.any():  # one pump and one channel: U = Q / A is wrong for all alike
        rate_error = np.max(np.nan_to_num(population["flow_rate_error"][by_rate]) / population["flow_rate"][by_rate])
        of_rate = np.exp(rate_error * rng.standard_normal(len(parameters)))
        shifts["surface_shear_modulus"] *= of_rate / shifts["capsule_radius"] ** 2
    draws = {name: without[name] * shifts[name] for name in without} | _spreads(log_posterior, parameters)
    leaning = float(np.mean(population["status"][kept] == Status.LEANS_ON_BORDER.name))
    missing, changes = np.empty(0), dict[str, float]()
    if existence:
        missing, changes, seen = _missing(log_posterior, place[0], parameters, seed)
        gates.append(Gate("share of the population that has a steady shape", seen, least=_LEAST_SEEN))
    return Hierarchy(
        draws,
        without,
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
    )


def _taking_part(population: Population, least_stretch: float | None, model: ForwardModel | None) -> NDArray[np.bool_]:
    """Return which capsules take part : (n,) array.

    Raises
    ------
    InputError
        If they are too few, or the cut is none.
    """
    kept = (population["likelihood"][:, :, 0].sum(axis=1) > 0.0) & np.isin(population["status"], _TAKING_PART)
    if least_stretch is not None:
        _check_cut(least_stretch, model)
        kept &= kept_rows(population, least_stretch)
    if np.count_nonzero(kept) < FEWEST:
        expected = f"at least {FEWEST} capsules with a result"
        raise InputError("hierarchy", "population", expected, str(np.count_nonzero(kept)))
    return np.asarray(kept)


def _components(
    population: Population, kept: NDArray[np.bool_], viscosity: Quantity, half_width: Quantity
) -> NDArray[np.float32]:
    """Return the likelihoods of the capsules in (log G_s, log a), at what they share : (n, c, 6) array."""
    components = np.ascontiguousarray(population["likelihood"][kept])
    components[:, :, 1] += np.float32(np.log(viscosity.value))
    components[:, :, 2] += np.float32(np.log(half_width.value))
    return components


def _check_cut(least_stretch: float, model: ForwardModel | None) -> None:
    if not (np.isfinite(least_stretch) and least_stretch > 0.0):
        advice = "the published cut is 1.04"
        raise InputError("hierarchy", "least_stretch", "a Lambda above zero", f"{least_stretch:g}", advice)
    if model is None:
        raise InputError("hierarchy", "model", "the model of the population, with least_stretch", "nothing")


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
