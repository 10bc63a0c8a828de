"""From a measurement to the posterior of the capsule."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.inference.checks import LEANING_SHARE, Agreement, Gate, agreement, ess_gates, leaning
from capsbayes.inference.deterministic import deterministic_answer
from capsbayes.inference.ensembles import Chains, Effort, sampled
from capsbayes.inference.grid_posterior import GridPosterior
from capsbayes.inference.inputs import Inputs
from capsbayes.inference.log_density import LogDensity
from capsbayes.inference.marginal import Marginal
from capsbayes.inference.posterior import REPORTED, Posterior
from capsbayes.inference.prior import Prior
from capsbayes.inference.quadrature import Quadrature
from capsbayes.inference.shares import variance_shares
from capsbayes.inference.target import evaluated
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.status import Status

__all__ = ["ENGINES", "identify"]

Floats = NDArray[np.float64]

ENGINES = ("emcee", "quadrature")
_DRAWS = (4, 2500)  # chains and draws of the quadrature engine
_OUTLINES = 200


def identify(
    measurement: Measurement,
    model: ForwardModel,
    experiment: Experiment,
    *,
    engine: str = "emcee",
    seed: int,
    prior: Prior | None = None,
    effort: Effort | None = None,
) -> Posterior:
    """Identify one capsule.

    Parameters
    ----------
    measurement : Measurement
        Lengths and velocity, with their errors.
    model : ForwardModel
        For example a `Surrogate`.
    experiment : Experiment
        Channel and liquid.
    engine : str
        ``"emcee"``, checked by quadrature, or ``"quadrature"`` alone.
    seed : int
        Of all randomness; stored in the result.
    prior : Prior, optional
        Of G_s and a.
    effort : Effort, optional
        How much emcee samples.

    Returns
    -------
    Posterior
        Its status says whether the intervals can be used.

    Raises
    ------
    InputError
        If no case of the model has such a shape, or an argument cannot be used.

    Examples
    --------
    ``identify(measurement, Surrogate.open("square-neo-hookean"), experiment, seed=1).summary()``
    """
    if engine not in ENGINES:
        raise InputError("identify", "engine", " or ".join(ENGINES), repr(engine))
    _check_section(model, experiment)
    prior, inputs = prior or Prior(), Inputs.of(measurement, experiment)
    quadrature = Quadrature(model, experiment, prior)
    grid = quadrature(measurement)
    exact = {name: grid.marginal(name) for name in REPORTED}
    rng = np.random.default_rng([seed, 1])
    if engine == "emcee":
        chains = sampled(LogDensity(model, grid.target), seed=seed, effort=effort)
        draws, ensemble = _draws_of(chains, grid, rng)
        gates = [*chains.gates, *ess_gates({name: draws[name] for name in REPORTED})]
        marginals = {name: Marginal.of_draws(draws[name]) for name in REPORTED}
        agreed = agreement(marginals, exact)
    else:
        drawn = grid.drawn(rng, _DRAWS[0] * _DRAWS[1])
        draws, ensemble = {name: values.reshape(_DRAWS) for name, values in drawn.items()}, np.arange(_DRAWS[0])
        gates, marginals, agreed = quadrature.gates(grid), exact, None
    leans = _leaning(draws, model, prior)
    return Posterior(
        draws=draws,
        ensemble=ensemble,
        marginals=marginals,
        reference=exact if engine == "emcee" else {},
        measurement=measurement,
        experiment=experiment,
        prior=prior,
        inputs=inputs,
        model_name=model.name,
        model_sha256=model.sha256,
        engine=engine,
        seed=seed,
        gates=tuple(gates),
        agreement=agreed,
        shares=variance_shares(quadrature, measurement, grid),
        deterministic=deterministic_answer(measurement, model, inputs),
        leaning=leans,
        outlines=_outlines(draws, model),
        status=_status(gates, agreed, leans),
    )


def _check_section(model: ForwardModel, experiment: Experiment) -> None:
    database = getattr(model, "database", None)
    section = None if database is None else database.dataset.attrs.get("section")
    if section is not None and section != experiment.section:
        where = experiment.source or "experiment"
        raise InputError(where, "section", f'"{section}", that of the model', f'"{experiment.section}"')


def _draws_of(
    chains: Chains, grid: GridPosterior, rng: np.random.Generator
) -> tuple[dict[str, Floats], NDArray[np.int64]]:
    """Thinned draws of every quantity as (chain, draw) arrays, one chain a walker, and the ensemble of each chain."""
    kept = chains.thinned()
    steps, ensembles, walkers, dimensions = kept.coordinates.shape
    flat = kept.coordinates.reshape(-1, dimensions)
    nodes = dict(zip(kept.names, flat.T, strict=True))
    nodes["capillary_number"] = np.exp(nodes["capillary_number"])
    points, stretch = evaluated(grid.forward, nodes["capillary_number"], nodes["size_ratio"], grid.target.error_scale)
    draws = grid.target.completed(rng, nodes, points, stretch) | {"lp": kept.log_density.ravel()}
    shaped = {name: values.reshape(steps, -1).T for name, values in draws.items()}
    return shaped, np.repeat(np.arange(ensembles), walkers)


def _leaning(draws: Mapping[str, Floats], model: ForwardModel, prior: Prior) -> dict[str, float]:
    shares = {"model": leaning(draws, ("capillary_number", "size_ratio"), model.domain.contains)}
    for name, one in (
        ("surface_shear_modulus", prior.surface_shear_modulus),
        ("capsule_radius", prior.capsule_radius),
    ):
        low, high = one.low, one.high
        shares[f"prior of {name}"] = leaning(draws, (name,), lambda x, a=low, b=high: (x >= a) & (x <= b))
    return shares


def _outlines(draws: Mapping[str, Floats], model: ForwardModel) -> Floats | None:
    """Outlines of some draws, evenly taken."""
    ca, size = np.ravel(draws["capillary_number"]), np.ravel(draws["size_ratio"])
    some = np.linspace(0, len(ca) - 1, _OUTLINES).astype(int)
    return model({"capillary_number": ca[some], "size_ratio": size[some]}, outline=True).outline


def _status(gates: Sequence[Gate], agreed: Agreement | None, leans: Mapping[str, float]) -> Status:
    """Worst first: what makes the intervals wrong, then what makes them those of the border."""
    if not all(gate.passed for gate in gates):
        return Status.NOT_MIXED if agreed is not None else Status.GRID_TOO_COARSE
    if agreed is not None and not agreed.passed:
        return Status.ENGINES_DISAGREE
    if leans["model"] > LEANING_SHARE:
        return Status.LEANS_ON_BORDER
    if max(leans.values()) > LEANING_SHARE:
        return Status.LEANS_ON_PRIOR
    return Status.DONE
