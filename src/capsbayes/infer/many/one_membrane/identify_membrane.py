"""From the measurements of a batch to the membrane that its capsules share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from scipy import stats
from scipy.special import softmax
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.checks import Gate
from capsbayes.infer.identify import check_applies
from capsbayes.infer.importance.frame import check_thickness
from capsbayes.infer.importance.weights import normalised, rows_by_weight
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.many.one_membrane.conditional import MODULUS, RATE, SIZE, Capsules, Start
from capsbayes.infer.many.one_membrane.engine import WITHIN, MembraneSampling, Sampled
from capsbayes.infer.many.one_membrane.measured import Batch, batch_of
from capsbayes.infer.many.one_membrane.numbers import Lengths, Outlines
from capsbayes.infer.many.one_membrane.search import with_model_error
from capsbayes.infer.many.one_membrane.shared_membrane import LawOdds, SharedMembrane
from capsbayes.infer.many.one_membrane.unknowns import Unknowns, key_of
from capsbayes.infer.membrane import LAWS, Membrane
from capsbayes.infer.prior import Coordinate, Prior
from capsbayes.measured_outline import MID_PLANE
from capsbayes.measurement import Measurement
from capsbayes.measurements import check_comparable
from capsbayes.model import FixedParameters
from capsbayes.status import Status
from capsbayes.surrogate import MembraneSurrogate
from capsbayes.work import keeping_steps, run_tasks

NONE_OF_THEM = "none of them"
"""The general law, beside those of `LAWS`."""

MISFIT = "p-value of the misfit of all shapes"

_HERE = "identify_membrane"
ONE_CAPSULE = (1e-3, 1e-4)
"""Spreads of ln G_s and of a/l among pictures of one capsule."""

_DRAWS = 1000
_AT_ONCE = 50  # draws whose capsules are drawn together
_LEAST_P = 1e-3
_MANY = 200  # capsules for which worker processes take less time than they need to start


@checked
def identify_membrane(
    measurements: Sequence[Measurement],
    experiment: Experiment,
    *,
    seed: int,
    model: MembraneSurrogate | None = None,
    membrane: Membrane | None = None,
    prior: Prior | None = None,
    same_capsule: bool = False,
    inflation_varies: bool = False,
    scale_error: float = 0.0,
    laws: bool = True,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[str, int, int], None] = lambda step, done, steps: None,
) -> SharedMembrane:
    """Infer the membrane that the capsules of a batch share, and the shear modulus and radius of each.

    Parameters
    ----------
    measurements : sequence of Measurement
        All with outlines, or all with lengths alone; at one flow rate or several.
    experiment : Experiment
        Channel and liquid of all.
    seed : int
        Seed of the draws of G_s, a and Ca of each capsule; stored in the result.
    model : MembraneSurrogate, optional
        Default: that which comes with the library for the channel and the view of the outlines.
    membrane : Membrane, optional
        What is known of the membrane; default: nothing.
    prior : Prior, optional
        Priors of the parameters of the membrane, by their names. Priors of G_s and a are refused, since the
        distribution of both in the batch is inferred.
    same_capsule : bool
        All measurements are of one capsule, which has one G_s and one a.
    inflation_varies : bool
        Each capsule has a pre-inflation of its own, log-normal about the median of the batch; else all have the same.
    scale_error : float
        Relative standard error that all lengths share, as from the size of a pixel.
    laws : bool
        Also compute the odds of known laws, and G_s under each. This takes three times the processor time.
    scheduler : str or None
    workers : int or None
        Where the tasks run, see `run_tasks`: one for each law if there are fewer than 200 capsules, otherwise shares of
        the capsules.
    progress : callable
        Called with the name of the work, the number of steps done, and of all.

    Returns
    -------
    SharedMembrane
        Its status tells whether the intervals can be used.

    Raises
    ------
    InputError
        If a measurement cannot be used, or the model has no membrane with which all capsules have a shape.

    References
    ----------
    Rue, Martino, Chopin 2009, J. R. Stat. Soc. B 71, 319, doi:10.1111/j.1467-9868.2008.00700.x (Laplace's method).
    Lie, Sullivan, Teckentrup 2018, SIAM/ASA J. Uncertain. Quantif. 6, 1600, doi:10.1137/18M1166523 (model error).
    """
    if not measurements:
        raise InputError(_HERE, "measurements", "at least one", "none")
    for measurement in measurements:
        check_comparable(measurement, measurement.source or "measurement")
    outline = measurements[0].outline
    view = MID_PLANE if outline is None else outline.view
    model = model or MembraneSurrogate.open(experiment.cross_section, view=view)
    for measurement in measurements:
        check_applies(model, measurement, experiment)
    spreads = _spreads(len(measurements), same_capsule=same_capsule, inflation_varies=inflation_varies)
    with threadpool_limits(limits=1):
        capsules = capsules_of(measurements, experiment, model, scale_error=scale_error)
        batch = capsules.batch
        unknowns = unknowns_of(model, membrane or Membrane(), prior or Prior(), experiment, spreads)
        if inflation_varies and unknowns.known.get("pre_inflation") == 0.0:
            raise InputError(_HERE, "inflation_varies", "a pre-inflation that is not 0", "0")
        capsules = with_model_error(capsules, unknowns)
        under = {NONE_OF_THEM: unknowns}
        if laws:
            under |= {name: unknowns.fixed(fixed) for name, fixed in _possible(unknowns)}
        few = len(measurements) < _MANY
        apart = few and len(under) > 1  # each law in a process, where the capsules are too few to be spread themselves
        inside = "synchronous" if apart or (few and scheduler is workers is None) else scheduler
        tasks = [keeping_steps(partial(_assumed, each, inside, workers, seed)) for each in under.values()]
        step = " and ".join(["membrane unknown", *(["known laws"] if len(under) > 1 else [])])
        told = partial(progress, step)
        told(0, len(under))
        found = run_tasks(
            tasks,
            scheduler if apart else "synchronous",
            workers,
            capsules,
            experiment,
            finished=lambda done: told(done, len(under)),
        )
    assumed = [(name, *each) for name, each in zip(under, found, strict=True)]
    sampled, draws = found[0]
    gates = (*sampled.gates, _misfit_gate(batch, draws["misfit"]))
    speeds = np.where(np.isnan(batch.log_mean_velocity), batch.log_velocity, batch.log_mean_velocity)
    return SharedMembrane(
        draws=draws,
        names=tuple(m.source or str(number + 1) for number, m in enumerate(measurements)),
        flow=batch.group,
        speed=np.exp(speeds),
        lengths=np.array(
            [[m.axial_extent, np.nan if m.axial_length is None else m.axial_length] for m in measurements]
        ),
        misfit=_misfit_of_each(batch, draws["misfit"]),
        laws=_with_odds(assumed) if laws else (),
        prior={key_of(one): one.distribution for one in unknowns.coordinates},
        experiment=experiment,
        model_name=model.name,
        model_sha256=model.sha256,
        seed=seed,
        gates=gates,
        status=_status(gates),
    )


def _assumed(
    unknowns: Unknowns,
    scheduler: str | None,
    workers: int | None,
    seed: int,
    capsules: Capsules,
    experiment: Experiment,
) -> tuple[Sampled, dict[str, Floats]]:
    """Sample what is unknown, and draw the capsules."""
    sampled = MembraneSampling(capsules, unknowns, scheduler, workers)()
    return sampled, _drawn(capsules, unknowns, sampled, experiment, seed)


def _spreads(count: int, *, same_capsule: bool, inflation_varies: bool) -> tuple[float | None, ...]:
    one = same_capsule or count == 1
    if one and inflation_varies:
        raise InputError(_HERE, "inflation_varies", "several capsules", "one")
    known = ONE_CAPSULE if one else (None, None)
    return (*known, None) if inflation_varies else known


def capsules_of(
    measurements: Sequence[Measurement], experiment: Experiment, model: MembraneSurrogate, *, scale_error: float = 0.0
) -> Capsules:
    """Return the capsules of a batch, to be found at given membranes; the model's own error is not yet in theirs."""
    batch = batch_of(measurements, experiment, model, scale_error=scale_error)
    numbers = Lengths if measurements[0].outline is None else Outlines
    viscosity = float(np.log(experiment.viscosity.value))
    return Capsules(batch, numbers(model, experiment.half_width.value), viscosity)


def unknowns_of(
    model: MembraneSurrogate,
    membrane: Membrane,
    prior: Prior,
    experiment: Experiment,
    spreads: tuple[float | None, ...],
) -> Unknowns:
    """Return what is unknown of a membrane that a batch shares.

    Raises
    ------
    InputError
        If the statements of the membrane, of its priors and of the experiment do not go together.
    """
    for name in ("surface_shear_modulus", "capsule_radius"):
        if getattr(prior, name) != getattr(Prior(), name):
            expected = "none, as the batch tells the mean of its capsules"
            raise InputError("prior", name, expected, str(getattr(prior, name)))
    fixed, believed = membrane.applied(model, prior.with_thickness(experiment))
    coordinates = Coordinate.all_of(fixed, believed)
    check_thickness(coordinates, experiment, model.domain)
    known = dict(fixed.values) if isinstance(fixed, FixedParameters) else {}
    return Unknowns.of(coordinates, known, spreads)


def _possible(unknowns: Unknowns) -> list[tuple[str, Mapping[str, float]]]:
    """Return the laws that what is known of the membrane leaves open."""
    free = {one.name for one in unknowns.coordinates}
    return [(name, fixed) for name, fixed in LAWS.items() if fixed and free.issuperset(fixed)]


def _drawn(
    capsules: Capsules, unknowns: Unknowns, sampled: Sampled, experiment: Experiment, seed: int
) -> dict[str, Floats]:
    """Draw membranes by their weights, and at each of them the capsules : (d,) and (d, n) arrays by name."""
    rng = np.random.default_rng([seed, 7])
    weights = normalised(sampled.log_weights)
    rows = rows_by_weight(weights, rng, _DRAWS)
    points, found = sampled.draws.points[rows], sampled.draws.found
    parts = []
    for first in range(0, _DRAWS, _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        start = Start(found.own[rows[some]], found.common[rows[some]])
        place = unknowns.membranes(points[some]), unknowns.spreads_at(points[some])
        parts.append(capsules.at(*place, start=start, rng=rng))
    own, common = (np.concatenate([getattr(part, name) for part in parts]) for name in ("own", "common"))
    spreads, membranes = unknowns.spreads_at(points), unknowns.membranes(points)
    seen = _seen(capsules, membranes, own)
    log_moduli = drawn_log_moduli(capsules, own, np.log(seen["velocity_ratio_each"]), common, spreads.modulus, rng)
    viscosity = LogGrid.of(experiment.viscosity).drawn(rng, _DRAWS) / experiment.viscosity.value
    width = LogGrid.of(experiment.half_width).drawn(rng, _DRAWS)
    varying = {}
    if spreads.inflation is not None:
        each = membranes["pre_inflation"][:, None] * np.exp(own[..., 2])
        varying = {"inflation_spread": spreads.inflation, "pre_inflation_each": each}
    return {
        **membranes,
        **varying,
        "surface_shear_modulus": np.exp(common[:, MODULUS]) * viscosity,
        "capsule_radius": common[:, SIZE] * width,
        "modulus_spread": spreads.modulus,
        "radius_spread": spreads.size / common[:, SIZE],
        "surface_shear_modulus_each": np.exp(log_moduli) * viscosity[:, None],
        "capsule_radius_each": own[..., 1] * width[:, None],
        **seen,
        "misfit": capsules.misfit(membranes, Start(own, common)),
    }


def _seen(capsules: Capsules, membranes: Mapping[str, Floats], own: Floats) -> dict[str, Floats]:
    """Return Ca of the capsules, and what is predicted of them : (d, n) arrays."""
    theta = capsules.model.theta(membranes, own)
    predicted = capsules.model.model(theta)
    names = ("axial_extent", "axial_length", "velocity_ratio")
    flat = {name: getattr(predicted, name) for name in names} | {"capillary_number": theta["capillary_number"]}
    return {f"{name}_each": values.reshape(own.shape[:2]) for name, values in flat.items()}


def drawn_log_moduli(
    capsules: Capsules, own: Floats, log_ratio: Floats, common: Floats, spread: Floats, rng: np.random.Generator
) -> Floats:
    """Draw ln G_s of each capsule at central viscosity : (d, n) array; its velocity and the population both tell it."""
    batch = capsules.batch
    seen = capsules.log_moduli(own, log_ratio)
    by_rate = np.isfinite(batch.log_mean_velocity)
    seen = seen + by_rate * batch.rate_error * common[:, RATE, None]
    variance = np.where(by_rate, 0.0, batch.velocity_error**2)
    share = variance / (variance + spread[:, None] ** 2)
    middle = (1.0 - share) * seen + share * common[:, MODULUS, None]
    return np.asarray(middle + np.sqrt(share) * spread[:, None] * rng.standard_normal(seen.shape))


def _with_odds(assumed: list[tuple[str, Sampled, dict[str, Floats]]]) -> tuple[LawOdds, ...]:
    logs = np.array([sampled.log_evidence for _, sampled, _ in assumed])
    shares = softmax(logs, axis=0).mean(axis=1)  # under each error of the model
    return tuple(
        LawOdds(name, float(share), sampled.evidence_error, all(g.passed for g in sampled.gates), draws)
        for (name, sampled, draws), share in zip(assumed, shares, strict=True)
    )


def _misfit_gate(batch: Batch, misfit: Floats) -> Gate:
    """Return the gate on the probability of a larger misfit of all shapes together.

    That of what was measured is compared with that of measurements drawn at the same draws of the posterior, which is
    chi squared with all the numbers measured: where the model is right, the probability is seldom small.
    """
    square = misfit.sum(axis=1) + batch.left.sum()
    return Gate(MISFIT, float(stats.chi2.sf(square, int(batch.known.sum())).mean()), least=_LEAST_P)


def _misfit_of_each(batch: Batch, misfit: Floats) -> Floats:
    """Return the root mean square difference of each shape in standard errors : (n,) array."""
    return np.asarray(np.sqrt((np.median(misfit, axis=0) + batch.left) / np.maximum(batch.known, 1)))


def _status(gates: Sequence[Gate]) -> Status:
    failed = {gate.name for gate in gates if not gate.passed}
    if not failed:
        return Status.DONE
    if failed == {MISFIT}:
        return Status.SHAPES_MISFIT
    return Status.LEANS_ON_BORDER if failed == {WITHIN} else Status.TOO_FEW_DRAWS
