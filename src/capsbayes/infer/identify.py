"""From a measurement to the posterior of the capsule."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Agreement, Gate, agreement
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.deterministic import deterministic_answer
from capsbayes.infer.exact import exact_engine
from capsbayes.infer.grid.posterior import ExactPosterior, GridPosterior
from capsbayes.infer.grid.quadrature import Quadrature
from capsbayes.infer.importance.posterior import WeightedPosterior
from capsbayes.infer.marginal import Marginal
from capsbayes.infer.membrane import Membrane
from capsbayes.infer.misfit import Misfit, inertia, misfits_of, p_values
from capsbayes.infer.narrowing import expected_log_modulus_sds
from capsbayes.infer.outline.likelihood import OutlineLikelihood, check_view_of
from capsbayes.infer.outline.misfit import drawn_outlines, lopsided, outline_misfit
from capsbayes.infer.outline.table import TabulatedOutline
from capsbayes.infer.posterior import OF_VELOCITY, REPORTED, Posterior
from capsbayes.infer.prior import Prior
from capsbayes.infer.sampling.convergence import ess_gates
from capsbayes.infer.sampling.ensembles import Chains, Effort, sampled
from capsbayes.infer.sampling.log_density import LogDensity
from capsbayes.infer.sampling.on_sheet import SheetDensity
from capsbayes.infer.shares import variance_shares
from capsbayes.infer.verdict import leanings, verdict
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.status import Status

ENGINES = ("emcee", "quadrature")
_DRAWS = (4, 2500)  # chains and draws of the quadrature engine
_OUTLINES = 200
_WALKERS_ON_SHEET = 256  # of an ensemble: many points at once cost little more than few
_TRIED, _TABLE_ERROR, _BEYOND = (
    500,
    0.02,
    4,
)  # draws at which the table of log densities is tested, its largest error, nodes beyond the grid


@checked
def identify(
    measurement: Measurement,
    model: ForwardModel,
    experiment: Experiment,
    *,
    engine: str | None = None,
    seed: int,
    prior: Prior | None = None,
    membrane: Membrane | None = None,
    effort: Effort | None = None,
    error_budget: bool = True,
) -> Posterior:
    """Infer the shear modulus and the radius of one capsule.

    Parameters
    ----------
    measurement : Measurement
        Lengths and velocity, with their errors.
    model : ForwardModel
        For example a `Surrogate`. Its further coordinates, such as the pre-inflation, are inferred too.
    experiment : Experiment
        Channel and liquid.
    engine : str, optional
        ``"emcee"``, checked by quadrature, or ``"quadrature"`` alone. The default is ``"emcee"``, but ``"quadrature"``
        where chains take minutes and no effort is given: if the model has several further coordinates, or one and the
        measurement an outline. Quadrature replaces emcee where the measurement contradicts the model, so that the
        intervals cannot be used.
    seed : int
        Seed of all random numbers; stored in the result.
    prior : Prior, optional
        Priors of G_s and a, and of further coordinates of the model.
    membrane : Membrane, optional
        What is known of the membrane, if the model has its parameters as coordinates, as a `MembraneSurrogate` has.
    effort : Effort, optional
        How long emcee samples.
    error_budget : bool
        Also compute the share of each input in the variance of ln G_s, and what one more measurement would gain. With
        the membrane unknown this takes as long as everything else.

    Returns
    -------
    Posterior
        Its status tells whether the intervals can be used.

    Raises
    ------
    InputError
        If the model has no such shape, if it predicts outlines of another view than the measured one, or if an argument
        cannot be used.

    Examples
    --------
    ``identify(measurement, Surrogate.open("square-neo-hookean"), experiment, seed=1).summary()``

    References
    ----------
    Foreman-Mackey, Hogg, Lang, Goodman 2013, PASP 125, 306, doi:10.1086/670067 (emcee).
    """
    if engine is not None and engine not in ENGINES:
        raise InputError("identify", "engine", " or ".join(ENGINES), repr(engine))
    if membrane is not None:
        model, prior = membrane.applied(model, prior or Prior())
    check_applies(model, measurement, experiment, viscosity_needed=False)
    if engine is None:
        in_minutes = len(model.coordinates) > (measurement.outline is None)
        engine = "quadrature" if in_minutes and effort is None else "emcee"
    with threadpool_limits(limits=1):  # the matrices are tiny: threads would wait for each other
        quadrature = exact_engine(model, experiment, prior, outline=measurement.outline is not None)
        grid = quadrature(measurement)
        misfits = misfits_of(predicted := p_values(quadrature, measurement, grid))
        if not all(misfit.gate.passed for misfit in misfits):
            engine = "quadrature"  # nobody may use these intervals: the time of chains is saved
        run = _sampled if engine == "emcee" else _gridded
        draws, ensemble, gates, agreed = run(grid, seed, effort)
        reported = _reported(grid)
        exact = {name: grid.marginal(name) for name in reported}
        marginals = {name: Marginal.of_draws(draws[name]) for name in reported} if agreed else exact
        draws = _named_as_given(draws, grid)
        leans = leanings(draws, model, quadrature.prior)
        if measurement.outline is not None:
            misfits.insert(0, Misfit(outline_misfit(measurement.outline, model, draws), Status.OUTLINE_MISFIT))
            if (odd := lopsided(measurement.outline)) is not None:
                misfits.insert(0, Misfit(odd, Status.LOPSIDED))
        if not grid.density.inputs.viscous_tension:
            misfits.append(inertia(float(experiment.reynolds_number(marginals["mean_velocity"].median))))
        shares: dict[str, float] = {}
        if error_budget:
            shares = variance_shares(quadrature, measurement, grid, "surface_shear_modulus")["surface_shear_modulus"]
        return Posterior(
            draws=draws,
            ensemble=ensemble,
            marginals=marginals,
            reference=exact if agreed else {},
            measurement=measurement,
            experiment=experiment,
            prior=quadrature.prior,
            inputs=grid.density.inputs,
            model_name=model.name,
            model_sha256=model.sha256,
            engine=engine,
            seed=seed,
            gates=(*gates, *(misfit.gate for misfit in misfits)),
            agreement=agreed,
            shares=shares,
            deterministic=deterministic_answer(measurement, model, grid.density.inputs),
            leaning=leans,
            outlines=drawn_outlines(model, draws, _OUTLINES)[1],
            status=verdict(gates, agreed, leans, misfits, grid.unresolved),
            p_values=predicted,
            log_modulus_sd_if_known=_log_modulus_sd_if_known(grid, measurement, experiment),
            expected_log_modulus_sds=_expected(grid, measurement) if error_budget else {},
        )


def check_applies(
    model: ForwardModel, measurement: Measurement, experiment: Experiment, *, viscosity_needed: bool = True
) -> None:
    """Refuse a model of another cross-section than the experiment, or of another view than the measured outline.

    Where the viscosity is needed, an experiment without one is refused too.

    Raises
    ------
    InputError
    """
    model.check_experiment(experiment, viscosity_needed=viscosity_needed)
    if measurement.outline is not None:
        check_view_of(model, measurement.outline, measurement.source or "measurement")


def _log_modulus_sd_if_known(grid: ExactPosterior, measurement: Measurement, experiment: Experiment) -> float | None:
    """Return the standard deviation of ln G_s at the likeliest values of several further coordinates."""
    if not isinstance(grid, WeightedPosterior):
        return None
    density, likeliest = grid.density, grid.likeliest
    known = grid.forward.fixed(**{coordinate.name: likeliest[coordinate.name] for coordinate in density.coordinates})
    plain = Quadrature(known, experiment, replace(density.prior, coordinates={}))
    found = plain(measurement, inputs=density.inputs, outline=density.outline)
    return found.log_marginal("surface_shear_modulus").sd


def _expected(grid: ExactPosterior, measurement: Measurement) -> dict[str, float]:
    if not isinstance(grid, WeightedPosterior) or grid.density.inputs.viscous_tension:
        return {}  # another flow rate, which is among what may be measured, needs a velocity
    return expected_log_modulus_sds(grid, measurement)


def _reported(grid: ExactPosterior) -> tuple[str, ...]:
    """Return the names of the quantities that are reported: a thickness of the membrane with the bending it tells."""
    names = [coordinate.name for coordinate in grid.density.coordinates]
    known = set(OF_VELOCITY) if grid.density.inputs.viscous_tension else set()
    return (*(name for name in REPORTED if name not in known), *dict.fromkeys((*names, *grid.density.prior.uncertain)))


def _named_as_given(draws: dict[str, Floats], grid: ExactPosterior) -> dict[str, Floats]:
    """Return draws with that of mu U in place of viscosity and velocities where it was given as one quantity."""
    if not grid.density.inputs.viscous_tension:
        return draws
    return {name: values for name, values in draws.items() if name not in OF_VELOCITY} | {
        "viscous_tension": draws["viscosity"]
    }


def _sampled(grid: ExactPosterior, seed: int, effort: Effort | None) -> _Run:
    """Sample with emcee until the gates hold and the shape's parameters agree with the grid."""
    density, table_gates = _tabulated(grid)
    on_sheet = SheetDensity(grid) if isinstance(grid, WeightedPosterior) else None
    log_density = on_sheet or LogDensity(grid.forward, density)
    shape = {name: grid.log_marginal(name) for name in log_density.names}

    def agrees(chains: Chains) -> bool:
        return agreement(chains.named(), shape).passed

    beginning = {} if on_sheet is None else on_sheet.beginning(seed)
    usual = None if on_sheet is None else Effort(walkers=_WALKERS_ON_SHEET)
    chains = sampled(log_density, seed=seed, effort=effort or usual, enough=agrees, **beginning)
    kept = chains.thinned()
    steps, ensembles, walkers, _ = kept.coordinates.shape
    nodes = {name: np.ravel(values) for name, values in kept.named().items()}
    further = {coordinate.name: nodes[coordinate.name] for coordinate in grid.density.coordinates}
    place = nodes["capillary_number"], nodes["size_ratio"]
    points = grid.density.evaluated(grid.forward, *place, further, outline=False)
    rng = np.random.default_rng([seed, 1])
    flat = grid.density.completed(rng, nodes, points) | {"lp": np.ravel(kept.log_density)}
    draws = {name: values.reshape(steps, -1).T for name, values in flat.items()}
    gates = [*table_gates, *chains.gates, *ess_gates({name: draws[name] for name in _reported(grid)})]
    agreed = agreement(draws, {name: grid.log_marginal(name) for name in _reported(grid)})
    return _Run(draws, np.repeat(np.arange(ensembles), walkers), gates, agreed)


def _tabulated(grid: ExactPosterior) -> tuple[PosteriorDensity, list[Gate]]:
    """Return the density with the likelihood of the outline interpolated on the grid, and the gate on its error."""
    exact = grid.density.outline
    if not isinstance(grid, GridPosterior) or not isinstance(exact, OutlineLikelihood):
        return grid.density, []
    log_ca, size = (_spread_out(axis) for axis in grid.window.axes)
    place = {"capillary_number": np.exp(np.repeat(log_ca, len(size))), "size_ratio": np.tile(size, len(log_ca))}
    values = exact.at(grid.forward, place).reshape(len(log_ca), len(size))
    table = TabulatedOutline(exact, log_ca, size, values)
    tried = grid.drawn(np.random.default_rng(0), _TRIED)
    error = table.error(grid.forward, {name: tried[name] for name in ("capillary_number", "size_ratio")})
    return replace(grid.density, outline=table), [Gate("error of the table of the outline", error, most=_TABLE_ERROR)]


def _spread_out(axis: Floats) -> Floats:
    """Return the nodes of an axis and a few more on either side, of the same spacing."""
    more = (axis[1] - axis[0]) * np.arange(1, _BEYOND + 1)
    return np.concatenate([axis[0] - more[::-1], axis, axis[-1] + more])


def _gridded(grid: ExactPosterior, seed: int, effort: Effort | None) -> _Run:
    """Draw from the grid, independently."""
    del effort
    drawn = grid.drawn(np.random.default_rng([seed, 1]), _DRAWS[0] * _DRAWS[1])
    draws = {name: values.reshape(_DRAWS) for name, values in drawn.items()}
    return _Run(draws, np.arange(_DRAWS[0]), list(grid.gates), None)


class _Run(NamedTuple):
    """Result of an engine: (chain, draw) arrays, the ensemble of each chain, gates, agreement with the grid."""

    draws: dict[str, Floats]
    ensemble: Integers
    gates: list[Gate]
    agreement: Agreement | None
