"""Identification of one capsule: the posterior of its membrane's modulus and of its radius."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, NamedTuple, TypeGuard

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Floats, Integers
from capsbayes.errors import DatabaseError, InputError
from capsbayes.experiment import Experiment, membrane_thickness, surface_shear_modulus
from capsbayes.infer.checks import Agreement, Gate, agreement
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid import ExactPosterior, GridPosterior
from capsbayes.infer.importance import ExactEngine, WeightedPosterior, engine_near, exact_engine
from capsbayes.infer.likelihood import LengthsLikelihood, ModelAtPoints
from capsbayes.infer.outline import (
    OutlineLikelihood,
    TabulatedOutline,
    check_view_of,
    drawn_outlines,
    lopsided,
    outline_likelihood,
    outline_misfit,
)
from capsbayes.infer.posterior import OF_VELOCITY, REPORTED, Posterior, deterministic_answer
from capsbayes.infer.prior import THICKNESS, Inputs, Marginal, Membrane, Prior
from capsbayes.infer.proposal import PLACE
from capsbayes.infer.quadrature import Quadrature
from capsbayes.infer.sampling import Chains, Effort, LogDensity, SheetDensity, ess_gates, sampled
from capsbayes.infer.verdict import Misfit, inertia, leanings, misfits_of, p_values, verdict
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.status import Status

if TYPE_CHECKING:
    from capsbayes.surrogate import MembraneSurrogate

# Expected width of G_s after one more measurement of a capsule, for a model with several further coordinates.
#
# A number that becomes known takes away, on the average, the variance of the mean of ln G_s from one of its values to
# another. What a measurement with errors takes away is estimated twice, and the narrower width counts, as neither
# estimate is narrower than the truth but for chance:
#
# - a linear estimate of ln G_s from it, over draws of the posterior, takes away c (S + E)^-1 c, with the covariance S
#   of what the draws predict, that of its errors E, and its covariance c with ln G_s; it is loose where the posterior
#   is wide and the model curved over it;
# - the model linearised at single draws, with the normal scores of the priors, has the inverse of the Fisher
#   information as its covariance; it is loose where the data tell little, as the borders of the model cut nothing off

OUTLINE_NOISE = OutlineNoise(0.005, 0.2)  # errors of an outline that is yet to be measured

THICKNESS_ERROR = 0.2  # relative error of a thickness of the membrane that is yet to be measured

FLOWS = {"half flow": 0.5, "double flow": 2.0}
"""Flow rates at which the same capsule may be measured again, over the present one."""

Theta = Mapping[str, Floats]
Data = Callable[[Theta], Floats]
"""What a measurement shows of shapes, as numbers (n, m) with independent errors of one; NaN where there is no shape."""

_DRAWS_OF_ESTIMATE, _PLACES = 1000, 16  # of the posterior, for either estimate
_STEPS, _SCORE_STEP = (0.02, 0.003), 0.05  # of log Ca and a/l, and of a score, for differences
_LEAST_INSIDE = 0.9  # share of the posterior for which the model has a shape at another flow rate
_FREE = 1e-6  # information on log Ca and a/l that no data have


def expected_log_modulus_sds(grid: WeightedPosterior, measurement: Measurement) -> dict[str, float]:
    """Return the expected standard deviation of ln G_s after each of several measurements, the narrowest first."""
    modulus = "surface_shear_modulus"
    total = grid.log_marginal(modulus).sd ** 2
    known = [name for name in grid.frame.columns if name != "bending" or not grid.density.by_thickness]
    left = {name: total - grid.variance_given(name, modulus) for name in known}
    rows = grid.resampled(np.random.default_rng([0, 5]), _DRAWS_OF_ESTIMATE)
    theta = grid.frame.theta(grid.points[rows])
    log_modulus = _log_modulus(grid, theta)
    between = grid.variance_of_mean(modulus)  # the rest is of viscosity and velocity

    def narrower(later: Callable[[Mapping[str, float]], Data]) -> float:
        numbers = later(grid.middle)(theta)
        if np.mean(np.isfinite(numbers[:, 0])) < _LEAST_INSIDE:
            return total
        linear = between * (1.0 - _explained(log_modulus, numbers))
        local = _linearised(grid, measurement, grid.points[rows[:_PLACES]], later)
        return total - between + float(np.fmin(linear, local))

    if "bending" in left:
        left[THICKNESS] = narrower(lambda pilot: _log_thickness)
    if measurement.outline is None:
        left["outline"] = narrower(functools.partial(_outlines, grid, OUTLINE_NOISE))
    for name, factor in FLOWS.items():
        left[name] = narrower(functools.partial(_faster, grid, measurement, factor))
    sds = {name: float(np.sqrt(max(part, 0.0))) for name, part in left.items() if part < total}
    return dict(sorted(sds.items(), key=lambda item: item[1]))


def _log_modulus(grid: WeightedPosterior, theta: Theta) -> Floats:
    """Return ln G_s up to what viscosity and velocity add, and NaN where there is no shape : (n,) array."""
    ratio = 1.0 if grid.density.inputs.by_flow_rate else _shapes(grid, theta).velocity_ratio
    return np.asarray(-np.log(theta["capillary_number"] * ratio))


def _explained(log_modulus: Floats, numbers: Floats) -> float:
    """Return the share of Var(ln G_s), (n,), that a linear estimate from data (n, m) explains, without rows of NaN."""
    inside = np.isfinite(numbers[:, 0])
    away = numbers[inside] - numbers[inside].mean(axis=0)
    other = log_modulus[inside] - log_modulus[inside].mean()
    both = other @ away / len(away)
    explained = both @ np.linalg.solve(away.T @ away / len(away) + np.eye(away.shape[1]), both)
    return float(explained / np.mean(other**2))


def _linearised(
    grid: WeightedPosterior, measurement: Measurement, points: Floats, later: Callable[[Mapping[str, float]], Data]
) -> float:
    """Return the variance of ln G_s with a later measurement, linearised at points (k, d); NaN if it cannot be."""
    dimensions = points.shape[1]
    steps = np.diag([*_STEPS, *np.full(dimensions - PLACE, _SCORE_STEP)])
    known = np.diag([_FREE] * PLACE + [1.0] * (dimensions - PLACE))
    found = []
    for point in points:
        pilot = {name: float(values[0]) for name, values in grid.frame.theta(point[None]).items()}
        pilot = {name: value for name, value in pilot.items() if name in grid.forward.names}
        theta = grid.frame.theta(np.concatenate([point + steps, point - steps]))
        now = _present(grid, measurement, pilot)
        numbers = np.column_stack([_log_modulus(grid, theta), now(theta), later(pilot)(theta)])
        slopes = (numbers[:dimensions] - numbers[dimensions:]) / (2.0 * np.diag(steps))[:, None]
        if np.all(np.isfinite(slopes)):
            wanted, data = slopes[:, 0], slopes[:, 1:]
            found.append(wanted @ np.linalg.solve(known + data @ data.T, wanted))
    return float(np.mean(found)) if found else np.nan


def _present(grid: WeightedPosterior, measurement: Measurement, pilot: Mapping[str, float]) -> Data:
    if measurement.outline is not None:
        return _outlines(grid, measurement.outline.noise, pilot)
    return _lengths(grid, pilot)


def _faster(grid: WeightedPosterior, measurement: Measurement, factor: float, pilot: Mapping[str, float]) -> Data:
    """Return what the same capsules show at another flow rate, measured like the present one."""
    there = {**pilot, "capillary_number": factor * pilot["capillary_number"]}
    seen = _present(grid, measurement, there)
    return lambda theta: seen({**theta, "capillary_number": factor * theta["capillary_number"]})


def _lengths(grid: WeightedPosterior, pilot: Mapping[str, float]) -> Data:
    """Return L_z, and L_a if it was measured, with the present errors and the model's own at a pilot."""
    width = grid.density.inputs.half_width
    seen = grid.density.likelihood.with_half_width(width.value, width.error)
    count = 1 if seen.length is None else 2
    errors = np.array([[seen.zz, seen.za], [seen.za, seen.aa]])[:count, :count]
    own = _shapes(grid, {name: np.array([value]) for name, value in pilot.items()}).covariance[0, :count, :count]
    root = np.linalg.cholesky(errors + np.nan_to_num(own))
    return lambda theta: np.asarray(np.linalg.solve(root, _shapes(grid, theta).values[:, :count].T).T)


def _outlines(grid: WeightedPosterior, noise: OutlineNoise, pilot: Mapping[str, float]) -> Data:
    """Return outlines with errors, the model's own at a pilot included."""
    model = grid.forward
    there = _shapes(grid, {name: np.array([value]) for name, value in pilot.items()}, outline=True).outline
    assert there is not None, "asked for"
    if not np.all(np.isfinite(there)):
        return lambda theta: np.full((len(theta["size_ratio"]), 1), np.nan)
    seen = outline_likelihood(model, MeasuredOutline(there[0], noise, view=model.view), pilot)

    def shown(theta: Theta) -> Floats:
        outlines = _shapes(grid, theta, outline=True).outline
        assert outlines is not None, "asked for"
        return seen.whitened(outlines)

    return shown


def _log_thickness(theta: Theta) -> Floats:
    log_thickness = np.log(membrane_thickness(bending=theta["bending"], capsule_radius=theta["size_ratio"]))
    return np.asarray(log_thickness[:, None] / THICKNESS_ERROR)


def _shapes(grid: WeightedPosterior, theta: Theta, *, outline: bool = False) -> Prediction:
    known = {name: theta[name] for name in grid.forward.names if name in theta}
    return grid.forward(known, outline=outline)


# What another law of the membrane would make of a capsule's shear modulus

_LAW = ("area_dilation_modulus", "strain_hardening")
_CELLS = 40, 30  # along log Ca and a/l
_HALVINGS = 5  # of the cells about the best of them
_FARTHEST = 3.0  # standard errors between the lengths and the nearest shape of a law that counts


def with_other_laws(posterior: Posterior) -> Posterior:
    """Return a posterior of one law with the range of G_s over others, where the cross-section has a model of them."""
    try:
        model = prepare(posterior.experiment.cross_section).result()
    except DatabaseError:
        return posterior
    return replace(posterior, modulus_over_laws=modulus_over_laws(posterior.measurement, posterior.experiment, model))


@functools.cache
def prepare(cross_section: str) -> Future[MembraneSurrogate]:
    """Begin to open the model that `with_other_laws` needs, on another processor while this one samples."""
    from capsbayes.surrogate import MembraneSurrogate  # slow to import

    thread = ThreadPoolExecutor(1)
    future = thread.submit(MembraneSurrogate.open, cross_section)
    thread.shutdown(wait=False)
    return future


def modulus_over_laws(
    measurement: Measurement, experiment: Experiment, model: ForwardModel
) -> tuple[float, float] | None:
    """Return the least and the largest G_s [N/m] that laws at the ends of a model's ranges of K and h give."""
    # Of each law it is that of the shape whose lengths are nearest to the measured ones; viscosity, velocity and half
    # width have their central values, and the other coordinates their null values.
    if measurement.axial_length is None:
        return None
    seen = LengthsLikelihood.of(measurement).with_half_width(experiment.half_width.value, experiment.half_width.error)
    coordinates = [model.coordinates[name] for name in _LAW]
    ends = [(known.low, known.null_value, known.high) for known in coordinates]
    inputs, found = Inputs.of(measurement, experiment), []
    for law in product(*ends):
        place = _nearest(model.fixed(**dict(zip(_LAW, law, strict=True))), seen)
        if place is not None:
            flow, viscosity = inputs.mean_velocity(place[1]), inputs.viscosity.value
            found.append(surface_shear_modulus(viscosity=viscosity, mean_velocity=flow, capillary_number=place[0]))
    return (float(min(found)), float(max(found))) if len(found) > 1 else None


def _nearest(model: ForwardModel, seen: LengthsLikelihood) -> tuple[float, float] | None:
    """Return Ca and v_o/U of the shape with the nearest lengths, None if it is too far."""
    bounds = np.array(model.domain.bounds)
    low, high = np.array([np.log(bounds[0, 0]), bounds[1, 0]]), np.array([np.log(bounds[0, 1]), bounds[1, 1]])
    cell = (high - low) / _CELLS
    offsets = np.stack(np.meshgrid(*(np.arange(count) + 0.5 for count in _CELLS), indexing="ij"), axis=-1)
    points: Floats = low + cell * offsets.reshape(-1, 2)
    for _ in range(_HALVINGS + 1):
        there = ModelAtPoints.of(model({"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}))
        distance = np.nan_to_num(seen.distance(there), nan=np.inf)
        best = int(np.argmin(distance))
        around = np.stack(np.meshgrid(*2 * [np.arange(-2, 3) / 2.0], indexing="ij"), axis=-1).reshape(-1, 2)
        nearest = points[best], distance[best], there.velocity_ratio[best]
        points, cell = points[best] + cell * around, 0.5 * cell
    if nearest[1] > _FARTHEST:
        return None
    return float(np.exp(nearest[0][0])), float(nearest[2])


# Shares of the inputs in the uncertainty of G_s and of a.
#
# Viscosity and velocity multiply G_s and are independent of the shape: their shares are their variances of log G_s,
# exactly, and nothing of that of log a. Where the lengths are over l, the half width multiplies a in the same way. A
# further coordinate of the model contributes the variance of the mean of the logarithm from one of its values to
# another. For every other input the posterior is computed again with the error of that input halved. Were the logarithm
# linear in it, its part V_i of the variance V would fall to V_i / 4, so V_i = 4/3 (V - V_halved), and the parts would
# add up to V; what is missing to one is due to the prior and to the curvature of the model

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
    """Return the share of the variance of the logarithm of each quantity due to each input."""
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
    inputs, outline = posterior.density.inputs, measurement.outline
    again = engine_near(engine, posterior)
    if outline is None:
        half = replace(measurement, axial_extent_error=0.5 * measurement.axial_extent_error)
        yield "axial_extent", again(half, inputs=inputs)
        error = measurement.axial_length_error
    else:
        sharper = replace(outline, noise=replace(outline.noise, scale=0.5 * outline.noise.scale))
        yield "outline", again(replace(measurement, outline=sharper), inputs=inputs)
        error = None if measurement.length_with_outline is None else measurement.length_with_outline[1]
    if error is not None:
        yield "axial_length", again(replace(measurement, axial_length_error=0.5 * error), inputs=inputs)
    if posterior.density.shape_depends_on_half_width and (outline is None or posterior.density.by_thickness):
        narrow = replace(inputs, half_width=inputs.half_width.rescaled(inputs.half_width.value, 0.5))
        yield "half_width", again(measurement, inputs=narrow)
    yield "surrogate", again(measurement, inputs=inputs, error_scale=0.5)


# From a measurement to the posterior of the capsule

ENGINES = ("emcee", "quadrature")
_DRAWS = (4, 2500)  # chains and draws of the quadrature engine
_OUTLINES = 200
_WALKERS_ON_SHEET = 256  # of an ensemble: many points at once cost little more than few
_TRIED = 500  # draws at which the table of log densities is tested
_TABLE_ERROR = 0.02  # of that table, at most: a tenth of what moves an end of an interval
_BEYOND = 4  # nodes of that table beyond the grid, where walkers start


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
    with threadpool_limits(limits=1):  # the matrices are tiny: threads would wait for each other
        quadrature = exact_engine(model, experiment, prior)
        grid = quadrature(measurement)
        misfits = misfits_of(predicted := p_values(quadrature, measurement, grid))
        if not all(misfit.gate.passed for misfit in misfits):  # nobody may use the intervals: the chains are saved
            engine = "quadrature"
        engine = engine or ("quadrature" if _has_many_unknowns(grid) and effort is None else "emcee")
        run = _sampled if engine == "emcee" else _gridded
        draws, ensemble, gates, agreed = run(grid, seed, effort)
        reported = _reported(grid)
        exact = {name: grid.marginal(name) for name in reported}
        marginals = {name: Marginal.of_draws(draws[name]) for name in reported} if agreed else exact
        draws = _named_as_given(draws, grid)
        leans = leanings(draws, model, quadrature.prior)
        if (seen := measurement.outline) is not None:  # the gravest first
            misfits.insert(0, Misfit(outline_misfit(seen, model, draws), Status.OUTLINE_MISFIT))
            if (odd := lopsided(seen)) is not None:
                misfits.insert(0, Misfit(odd, Status.LOPSIDED))
        if not grid.density.inputs.viscous_tension:
            misfits.append(inertia(float(experiment.reynolds_number(marginals["mean_velocity"].median))))
        modulus = "surface_shear_modulus"
        shares = variance_shares(quadrature, measurement, grid, modulus)[modulus] if error_budget else {}
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
    """Refuse a model of another cross-section than the experiment, or of another view than the measured outline."""
    # Where the viscosity is needed, an experiment without one is refused too.
    model.check_experiment(experiment, viscosity_needed=viscosity_needed)
    if measurement.outline is not None:
        check_view_of(model, measurement.outline, measurement.source or "measurement")


def _has_many_unknowns(grid: ExactPosterior) -> TypeGuard[WeightedPosterior]:
    """Return whether chains take minutes: of several further coordinates, or of one and an outline."""
    return isinstance(grid, WeightedPosterior) and len(grid.density.coordinates) > (grid.density.outline is None)


def _log_modulus_sd_if_known(grid: ExactPosterior, measurement: Measurement, experiment: Experiment) -> float | None:
    """Return the standard deviation of ln G_s at the likeliest values of several further coordinates."""
    if not _has_many_unknowns(grid):
        return None
    density, likeliest = grid.density, grid.likeliest
    known = grid.forward.fixed(**{coordinate.name: likeliest[coordinate.name] for coordinate in density.coordinates})
    plain = Quadrature(known, experiment, replace(density.prior, coordinates={}))
    found = plain(measurement, inputs=density.inputs, outline=density.outline)
    return found.log_marginal("surface_shear_modulus").sd


def _expected(grid: ExactPosterior, measurement: Measurement) -> dict[str, float]:
    if not _has_many_unknowns(grid) or grid.density.inputs.viscous_tension:
        return {}  # another flow rate, which is among what may be measured, needs a velocity
    return expected_log_modulus_sds(grid, measurement)


def _reported(grid: ExactPosterior) -> tuple[str, ...]:
    """Return the names of the quantities that are reported: a thickness of the membrane with the bending it tells."""
    names = [coordinate.name for coordinate in grid.density.coordinates]
    known = set(OF_VELOCITY) if grid.density.inputs.viscous_tension else set()
    modulus, *others = (name for name in REPORTED if name not in known)
    moduli = (modulus, *(["surface_dilation_modulus"] if grid.log_dilation is not None else []))
    return (*moduli, *others, *dict.fromkeys((*names, *grid.density.prior.uncertain)))


def _named_as_given(draws: dict[str, Floats], grid: ExactPosterior) -> dict[str, Floats]:
    """Return draws with that of mu U in place of viscosity and velocities where it was given as one quantity."""
    if not grid.density.inputs.viscous_tension:
        return draws
    left = {name: values for name, values in draws.items() if name not in OF_VELOCITY}
    return left | {"viscous_tension": draws["viscosity"]}


def _sampled(grid: ExactPosterior, seed: int, effort: Effort | None) -> _Run:
    """Sample with emcee until the gates hold and the shape's parameters agree with the grid."""
    density, table_gates = _tabulated(grid)
    on_sheet = SheetDensity(grid) if _has_many_unknowns(grid) else None
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
    points = grid.density.evaluated(grid.forward, nodes, outline=False)
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
