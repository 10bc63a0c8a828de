"""Choice of the flow rates at which a batch tells its unknown membrane and its shear modulus best.

For each set of flow rates, out of some in equal ratios, the information of the measurements is computed at the
membrane that is expected; the best sets are those with the least variance of the mean of ln G_s, and with the least
volume of the covariance of K and h. Of these the posterior is sampled that measurements without noise would have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations

import numpy as np
from scipy.special import ndtri
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, bending, imposed_velocity
from capsbayes.infer.many.one_membrane.conditional import MODULUS
from capsbayes.infer.many.one_membrane.identify_membrane import unknowns_of
from capsbayes.infer.many.one_membrane.unknowns import Unknowns, key_of
from capsbayes.infer.membrane import Membrane
from capsbayes.infer.prior import THICKNESS, Prior
from capsbayes.model import FixedParameters
from capsbayes.plan.borders import Borders, range_at
from capsbayes.plan.expectation import Draws, Expectation
from capsbayes.plan.expected_membrane import EACH, ExpectedMembrane, prior_widths
from capsbayes.plan.flow import MARGIN, RISK, flow_rate
from capsbayes.plan.identifiability import Progress, lab_attributes
from capsbayes.plan.lab_errors import LabErrors
from capsbayes.plan.membrane_design import FlowRisk, MembraneFlowDesign, PlannedFlows
from capsbayes.plan.planned_batch import PlannedBatch
from capsbayes.quantity import Given
from capsbayes.status import Status
from capsbayes.surrogate import MembraneSurrogate

MOST_FLOWS = 5
"""Flow rates that are sought together."""

_CANDIDATES = 10  # flow rates of which sets are made
_POINTS, _DRAWS, _BORDERS = 96, 4000, 33  # velocities; capsules; sizes at which the ends of the model are found
_NEAREST = 0.01  # share of the prior beyond the membrane that is expected, at least
_LAW = ("area_dilation_modulus", "strain_hardening")


@checked
def membrane_flow_design(
    surface_shear_modulus: Given,
    capsule_radius: Given,
    experiment: Experiment,
    errors: LabErrors,
    *,
    seed: int,
    model: MembraneSurrogate | None = None,
    membrane: Membrane | None = None,
    guess: Membrane | None = None,
    prior: Prior | None = None,
    capsules: int = 40,
    same_capsule: bool = False,
    flows: int = 4,
    velocities: Sequence[float] = (),
    scale_error: float = 0.0,
    margin: float = MARGIN,
    risk: float = RISK,
    progress: Progress | None = None,
) -> MembraneFlowDesign:
    """Choose the flow rates at which a batch determines its membrane and its mean G_s best.

    Parameters
    ----------
    surface_shear_modulus, capsule_radius : Quantity [N/m], [m]
        Expected G_s and a, with their spreads from capsule to capsule.
    experiment : Experiment
        Channel and liquid, with their errors.
    errors : LabErrors
        Of lengths over l or of outlines, of the velocity, and of the flow rate if it is known.
    seed : int
        Of the capsules drawn; stored in the result.
    model : MembraneSurrogate, optional
        Default: that which comes with the library for the channel and the view of the outlines.
    membrane : Membrane, optional
        What is known of it; default: nothing.
    guess : Membrane, optional
        Expected values of what is not known; default: the middles of the priors.
    prior : Prior, optional
        Of the parameters of the membrane.
    capsules : int
        Number of capsules in all, in equal shares at the flow rates; ignored with `same_capsule`.
    same_capsule : bool
        One capsule is filmed at all flow rates.
    flows : int
        Number of flow rates, at most `MOST_FLOWS`.
    velocities : sequence of float, optional [m/s]
        Mean velocities of the flow; default: the best are sought.
    scale_error : float
        Relative standard error that all lengths share, as from the size of a pixel.
    margin, risk : float
        See `MARGIN` and `RISK` of `capsbayes.plan.flow`; the risk is that of too slow a flow as well.
    progress : callable, optional
        Wraps the iterable of computed points to show progress, see `capsbayes.plan.identifiability.Progress`.

    Returns
    -------
    MembraneFlowDesign

    Raises
    ------
    InputError
        If an argument cannot be used, or the model has no shape of the expected size.
    """
    _check(errors, capsules, flows, margin, risk)
    model = model or MembraneSurrogate.open(experiment.cross_section, view=errors.view)
    model.check_experiment(experiment)
    unknowns = unknowns_of(model, membrane or Membrane(), prior or Prior(), experiment, (None, None))
    expectation = Expectation.of(surface_shear_modulus, capsule_radius, experiment)
    scores, count = expected_scores(unknowns, guess, model), 1 if same_capsule else capsules
    expected = membrane_at(unknowns, scores, expectation)
    drawn = expectation.drawn(np.random.default_rng(seed), _DRAWS)
    with threadpool_limits(limits=1):
        risks, outside = _risks(model.fixed(**expected), expectation, drawn, experiment.cross_section, margin)
        safe = [one.mean_velocity for one in risks if max(one.beyond_margin, one.below) <= risk]
        tried = np.array(velocities or (np.geomspace(safe[0], safe[-1], _CANDIDATES) if safe else ()))
        lab = expectation, tried, errors, experiment, model, unknowns, scores
        batch = PlannedBatch.of(*lab, same_capsule=same_capsule, scale_error=scale_error) if len(tried) else None
        wanted = [tuple(range(len(tried)))] if velocities else _sets(len(tried), flows)
        shown = wanted if progress is None else progress(wanted, len(wanted), "sets of flow rates")
        told = {} if batch is None else {some: batch.told_by(some, count) for some in shown}
        sets, for_law = _best(told, partial(_planned, tried, expectation, experiment))
    return MembraneFlowDesign(
        sets=sets,
        for_law=for_law,
        prior_sds=prior_widths(unknowns),
        risks=tuple(risks),
        limits=(safe[0], safe[-1]) if safe else None,
        outside=outside,
        capsules=count,
        same_capsule=same_capsule,
        membrane=expected,
        expectation=expectation,
        margin=margin,
        risk=risk,
        lab=lab_attributes(model, experiment, errors),
        seed=seed,
        status=Status.DONE if sets else Status.NO_FLOW_RATE,
    )


def expected_scores(unknowns: Unknowns, guess: Membrane | None, model: MembraneSurrogate) -> Floats:
    """Return the normal scores under their priors of the unknown parameters that are guessed : (f,) array."""
    # A parameter that is not guessed has the middle of its prior; one at an end of its prior is taken just within.
    guessed, left = (guess or Membrane()).applied(model, Prior())
    values = dict(guessed.values) if isinstance(guessed, FixedParameters) else {}
    unknown = {key_of(one): one for one in unknowns.coordinates}
    for name in (*left.coordinates, *values):
        if name in left.coordinates or name not in unknown:
            expected = f"a number for one of {', '.join(unknown)}" if unknown else "none, as the membrane is known"
            got = str(left.coordinates[name]) if name in left.coordinates else f"{name} = {values[name]:g}"
            raise InputError("guess", name, expected, got)
    shares = [one.shares(values[name]) if name in values else 0.5 for name, one in unknown.items()]
    return np.asarray(ndtri(np.clip(np.array(shares, dtype=np.float64), _NEAREST, 1.0 - _NEAREST)))


def _check(errors: LabErrors, capsules: int, flows: int, margin: float, risk: float) -> None:
    if not (0.0 <= margin < 1.0 and 0.0 <= risk < 1.0):
        raise InputError("flow_design", "margin, risk", "shares from 0 to below 1", f"{margin:g}, {risk:g}")
    check_lengths(errors, "flow_design")
    if not (1 <= flows <= MOST_FLOWS and capsules >= 1):
        expected = f"1 to {MOST_FLOWS} flow rates and at least one capsule"
        raise InputError("flow_design", "flows, capsules", expected, f"{flows}, {capsules}")


def check_lengths(errors: LabErrors, where: str) -> None:
    """Refuse the errors of lengths in metres."""
    if not errors.over_half_width:
        expected = "those of lengths over l, as an unknown membrane needs them"
        raise InputError(where, "errors", expected, "those of lengths in metres")


def membrane_at(unknowns: Unknowns, scores: Floats, expectation: Expectation) -> dict[str, float]:
    """Return the parameters of the membrane, of the bending modulus that a thickness means at the expected radius."""
    found = {name: float(values[0]) for name, values in unknowns.membranes(scores[None]).items()}
    if THICKNESS in found:
        thickness, radius = found.pop(THICKNESS), expectation.capsule_radius.value
        found["bending"] = float(bending(membrane_thickness=thickness, capsule_radius=radius))
    return found


def _risks(
    model: FixedParameters, expectation: Expectation, drawn: Draws, cross_section: str, margin: float
) -> tuple[list[FlowRisk], float]:
    """Return the risks over the velocities of the flow, and the probability of a size that the model does not have."""
    first, last = model.domain.bounds[1]
    centre, inside = expectation.centre, (drawn.size_ratio >= first) & (drawn.size_ratio <= last)
    here = range_at(model, float(centre.size_ratio[0]))
    if here.empty:
        wanted = f"a radius between {first:.4g} and {last:.4g} l, as {model.name} has them"
        raise InputError("flow_design", "capsule_radius", wanted, f"a/l = {here.size_ratio:.4g}")
    sizes = drawn.size_ratio[inside]
    borders = Borders.of(model, np.unique(np.linspace(sizes.min(), sizes.max(), _BORDERS)))
    lowest, highest = borders.at(drawn.size_ratio)
    found = []
    for velocity in _velocities(here.inner(_POINTS), centre):
        ca = drawn.capillary_number(velocity)
        found.append(
            FlowRisk(
                mean_velocity=float(velocity),
                flow_rate=flow_rate(float(velocity), float(centre.half_width[0]), cross_section),
                capillary_number=float(centre.capillary_number(velocity)[0]),
                below=float(np.mean(inside & (ca < lowest))),
                beyond=float(np.mean(inside & (ca > highest))),
                beyond_margin=float(np.mean(inside & (ca > (1.0 - margin) * highest))),
                without_shape=float(np.mean(~model.domain.contains(ca, drawn.size_ratio))),
            )
        )
    return found, float(np.mean(~inside))


def _velocities(capillary_number: Floats, centre: Draws) -> Floats:
    return imposed_velocity(
        viscosity=centre.viscosity,
        capillary_number=capillary_number,
        surface_shear_modulus=centre.surface_shear_modulus,
    )


def _sets(count: int, flows: int) -> list[tuple[int, ...]]:
    """Return all sets of one to `flows` numbers below a count."""
    return [some for number in range(1, flows + 1) for some in combinations(range(count), number)]


def _best(
    told: Mapping[tuple[int, ...], ExpectedMembrane],
    planned: Callable[[tuple[int, ...], ExpectedMembrane], PlannedFlows],
) -> tuple[tuple[PlannedFlows, ...], PlannedFlows | None]:
    """Return of each number of flow rates the best set for G_s, and of the largest number that for the law."""
    sets, for_law = [], None
    for number in sorted({len(some) for some in told}):
        alike = [some for some in told if len(some) == number]
        best = min(alike, key=lambda some: told[some].log_modulus_variance)
        sets.append(planned(best, told[best]))
    if len(told) > 1 and told[best].seeks(*_LAW):
        lawful = min(alike, key=lambda some: told[some].log_volume(*_LAW))
        for_law = sets[-1] if lawful == best else planned(lawful, told[lawful])
    return tuple(sets), for_law


def _planned(
    velocities: Floats,
    expectation: Expectation,
    experiment: Experiment,
    some: tuple[int, ...],
    told: ExpectedMembrane,
) -> PlannedFlows:
    """Return a set of flow rates with the widths that are expected, errors of viscosity and half width included."""
    speeds = velocities[list(some)]
    sds = told.widths()
    of_inputs = {"surface_shear_modulus": experiment.viscosity, EACH: experiment.viscosity}
    of_inputs |= {"capsule_radius": experiment.half_width}
    for name, quantity in of_inputs.items():
        sds[name] = float(np.hypot(sds[name], quantity.sd / quantity.mean))
    viscosity = experiment.viscosity.sd / experiment.viscosity.mean
    width = float(expectation.centre.half_width[0])
    return PlannedFlows(
        mean_velocities=tuple(speeds.tolist()),
        flow_rates=tuple(flow_rate(float(speed), width, experiment.cross_section) for speed in speeds),
        capillary_numbers=tuple(float(expectation.centre.capillary_number(speed)[0]) for speed in speeds),
        sds=sds,
        sd_if_known=float(np.hypot(np.sqrt(told.given_membrane[MODULUS, MODULUS]), viscosity)),
    )
