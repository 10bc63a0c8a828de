"""Plans for a batch whose membrane is unknown: flow rates and maps."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, bending, imposed_velocity
from capsbayes.infer.conditional import COMMON, MODULUS, SIZE, Capsules, ShapeModel, Start, Unknowns
from capsbayes.infer.prior import THICKNESS, Membrane, Prior
from capsbayes.infer.shared_membrane import ONE_CAPSULE, capsules_of, step_of_all, unknowns_of
from capsbayes.membrane_database import lowest_ca
from capsbayes.model import FixedParameters
from capsbayes.plan.flow import MARGIN, RISK, check_risk
from capsbayes.plan.lab import (
    CapsuleDraws,
    Expectation,
    LabErrors,
    ModelEnds,
    expected_range,
    flow_rate,
    lab_attributes,
)
from capsbayes.plan.map import WITHIN, Progress, over_plane
from capsbayes.plan.widths import EACH, EVERY, ExpectedMembrane, WidthPredictor, noise_lattice, prior_widths
from capsbayes.quantity import Given
from capsbayes.status import Status
from capsbayes.surrogate import MembraneSurrogate

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclass(frozen=True)
class FlowRisk:
    """Capsules that cannot be used at one velocity of the flow."""

    mean_velocity: float  # [m/s]
    flow_rate: float  # [m^3/s]
    capillary_number: float  # of the capsule in the middle of those expected
    below: float  # probability that a capsule lies below the lowest Ca of the model at its size
    beyond: float  # above the highest
    beyond_margin: float  # above the highest, or nearer to it than the margin
    without_shape: float  # probability that the model has no shape of a capsule, for whatever reason


@dataclass(frozen=True)
class PlannedFlows:
    """Flow rates at which a batch is filmed, and the standard deviations that are expected."""

    mean_velocities: tuple[float, ...]  # [m/s]
    flow_rates: tuple[float, ...]  # [m^3/s]
    capillary_numbers: tuple[float, ...]  # of the capsule in the middle of those expected
    sds: Mapping[str, float]  # see `ExpectedMembrane.widths`; with the errors of viscosity and half width
    sd_if_known: float  # of the mean ln G_s if the membrane were known


@dataclass(frozen=True, eq=False)
class MembraneFlowDesign:
    """Expected precision of the membrane and of G_s of a batch, at the best flow rates."""

    sets: tuple[PlannedFlows, ...]  # the best for G_s, one a size; or that of the stated velocities alone
    for_law: PlannedFlows | None  # the best set for K and h, of the number asked for; None if not sought
    prior_sds: Mapping[str, float]  # of the unknown parameters under their priors
    risks: tuple[FlowRisk, ...]  # in rising velocity
    limits: tuple[float, float] | None  # lowest and highest velocity [m/s] that may be chosen
    outside: float  # probability that a capsule has a size for which the model has no shape at any velocity
    capsules: int
    same_capsule: bool
    membrane: Mapping[str, float]  # that is expected
    expectation: Expectation
    margin: float
    risk: float
    lab: Mapping[str, str]  # model, its fingerprint, experiment, errors, version
    seed: int
    status: Status

    @property
    def best(self) -> PlannedFlows | None:
        """The set of as many flow rates as were asked for."""
        return self.sets[-1] if self.sets else None

    def table(self) -> pd.DataFrame:
        """Return a row for each velocity, SI."""
        import pandas as pd

        return pd.DataFrame([asdict(risk) for risk in self.risks])

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, ready for JSON."""
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "capsules": self.capsules,
            "same_capsule": self.same_capsule,
            "membrane": dict(self.membrane),
            "expected": self.expectation.as_dict(),
            "sets": [asdict(planned) for planned in self.sets],
            "for_law": None if self.for_law is None else asdict(self.for_law),
            "prior_sds": dict(self.prior_sds),
            "limits": {
                "mean_velocities": self.limits,
                "margin": self.margin,
                "risk": self.risk,
                "outside_sizes": self.outside,
            },
            "velocities": [asdict(risk) for risk in self.risks],
            "seed": self.seed,
            **self.lab,
        }


_MOST = 12  # different capsules of one flow rate
_MODULUS, _RADIUS = "surface_shear_modulus", "capsule_radius"


@dataclass(frozen=True, eq=False)
class PlannedBatch:
    """Capsules that are expected at some velocities of the flow, of which some are to be filmed."""

    capsules: Capsules  # all of them, without the model's own error
    own: Floats  # (n, 2): ln Ca and a/l
    flow: Integers  # (n,): number of the velocity
    expectation: Expectation
    experiment: Experiment
    velocities: Floats  # (k,): mean velocities [m/s]
    unknowns: Unknowns  # with the spreads of the population that is expected
    scores: Floats  # (f,): normal scores of the membrane that is expected

    @classmethod
    def of(
        cls,
        expectation: Expectation,
        velocities: Floats,
        errors: LabErrors,
        experiment: Experiment,
        model: MembraneSurrogate,
        unknowns: Unknowns,
        scores: Floats,
        *,
        same_capsule: bool = False,
        scale_error: float = 0.0,
    ) -> PlannedBatch:
        """Set up the capsules of a population at mean velocities (k,) [m/s]; omit those without a shape."""
        # The spreads of G_s and a are those from capsule to capsule; `scale_error` is relative and common to all
        # lengths.
        centre, spreads = expectation.centre, spreads_of(expectation, same_capsule=same_capsule)
        lattice = noise_lattice(1 if same_capsule else _MOST)
        log_ca = np.log([centre.capillary_number(velocity)[0] for velocity in velocities])
        middle = np.stack([log_ca, np.full(len(velocities), centre.size_ratio[0])], axis=1)
        own = (middle[:, None] + np.array([-spreads[0], spreads[1]]) * lattice).reshape(-1, 2)
        flow = np.repeat(np.arange(len(velocities)), len(lattice))
        known = Unknowns(unknowns.coordinates, unknowns.known, spreads)
        theta = ShapeModel(model, experiment.half_width.value).theta(known.membranes(scores[None]), own[None])
        shapes = model(theta, outline=errors.outline is not None)
        rows = np.flatnonzero(shapes.inside)
        if not len(rows):
            expected = f"velocities at which {model.name} has a shape of such capsules"
            got = ", ".join(f"{speed:.3g} m/s" for speed in velocities)
            raise InputError("flow_design", "velocities", expected, got)
        channel = experiment.half_width.value, experiment.cross_section
        measurements = [
            errors.measured(
                shapes.values[row, :2],
                float(velocities[flow[row]] * shapes.velocity_ratio[row]),
                None if shapes.outline is None else shapes.outline[row, ::EVERY],
                flow_rate(float(velocities[flow[row]]), *channel),
            )
            for row in rows
        ]
        capsules = capsules_of(measurements, experiment, model, scale_error=scale_error)
        return cls(capsules, own[rows], flow[rows], expectation, experiment, velocities, known, scores)

    def expected_from(self, flows: Sequence[int], count: int) -> ExpectedMembrane:
        """Return what so many capsules, filmed in equal shares at some of the velocities, tell of the membrane."""
        shares = np.array_split(np.arange(max(count, len(flows))), len(flows))
        rows = np.concatenate([self._rows(k, len(share)) for k, share in zip(flows, shares, strict=True)])
        own, point, centre = self.own[rows], self.scores[None], self.expectation.centre
        common = np.zeros((1, COMMON))
        common[0, [MODULUS, SIZE]] = np.log(centre.surface_shear_modulus[0]), centre.size_ratio[0]
        filmed = replace(self.capsules, batch=self.capsules.batch.taken(rows))
        filmed = filmed.with_model_error(self.unknowns.membranes(point), own)
        values = Start(own[None], common)
        step = step_of_all(filmed, self.unknowns, point, values)
        return ExpectedMembrane(filmed, self.unknowns, self.scores, values, step.covariance[0])

    def _rows(self, flow: int, count: int) -> Integers:
        """Return rows of capsules at a velocity, spread over the population, some several times if they are few."""
        rows = np.flatnonzero(self.flow == flow)
        return rows[(2 * np.arange(count) + 1) * len(rows) // (2 * count)]

    def planned(self, flows: Sequence[int], expected: ExpectedMembrane) -> PlannedFlows:
        """Return a set of flow rates with the widths that are expected, errors of viscosity and half width included."""
        viscosity, width = self.experiment.viscosity, self.experiment.half_width
        of_viscosity = viscosity.sd / viscosity.mean
        sds = expected.widths()
        for name, error in ((EACH, of_viscosity), (_MODULUS, of_viscosity), (_RADIUS, width.sd / width.mean)):
            sds[name] = float(np.hypot(sds[name], error))
        speeds, centre = self.velocities[list(flows)].tolist(), self.expectation.centre
        channel = float(centre.half_width[0]), self.experiment.cross_section
        return PlannedFlows(
            mean_velocities=tuple(speeds),
            flow_rates=tuple(flow_rate(speed, *channel) for speed in speeds),
            capillary_numbers=tuple(float(centre.capillary_number(speed)[0]) for speed in speeds),
            sds=sds,
            sd_if_known=float(np.hypot(np.sqrt(expected.given_membrane[MODULUS, MODULUS]), of_viscosity)),
        )


def spreads_of(expectation: Expectation, *, same_capsule: bool) -> tuple[float, float]:
    """Return the spreads of ln G_s and of a/l among the capsules that are expected."""
    if same_capsule:
        return ONE_CAPSULE
    modulus, radius = expectation.surface_shear_modulus, expectation.capsule_radius
    of_size = radius.sd / expectation.half_width.value
    return max(modulus.sd / modulus.mean, ONE_CAPSULE[0]), max(of_size, ONE_CAPSULE[1])


# For each set of flow rates, out of some in equal ratios, the information of the measurements is computed at the
# membrane that is expected; the best sets are those with the least variance of the mean of ln G_s, and with the least
# volume of the covariance of K and h. Of these the posterior is sampled that measurements without noise would have

MOST_FLOWS = 5
"""Flow rates that are sought together."""

_CANDIDATES = 10  # flow rates of which sets are made
_VELOCITIES = 96
_CAPSULES = 4000  # drawn
_BORDERS = 33  # sizes at which the ends of the model are found
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
        Wraps the iterable of computed points to show progress, see `capsbayes.plan.map.Progress`.

    Returns
    -------
    MembraneFlowDesign

    Raises
    ------
    InputError
        If an argument cannot be used, or the model has no shape of the expected size.
    """
    check_risk(margin, risk)
    if not (1 <= flows <= MOST_FLOWS and capsules >= 1):
        wanted = f"1 to {MOST_FLOWS} flow rates and at least one capsule"
        raise InputError("flow_design", "flows, capsules", wanted, f"{flows}, {capsules}")
    model, unknowns, scores = _expected_membrane("flow_design", experiment, errors, model, membrane, guess, prior)
    expectation = Expectation.of(surface_shear_modulus, capsule_radius, experiment)
    count = 1 if same_capsule else capsules
    expected = membrane_at(unknowns, scores, expectation.capsule_radius.value)
    drawn = expectation.drawn(np.random.default_rng(seed), _CAPSULES)
    sets: tuple[PlannedFlows, ...] = ()
    for_law = None
    with threadpool_limits(limits=1):
        risks, outside = _risks(model.fixed(**expected), expectation, drawn, experiment.cross_section, margin)
        safe = [each.mean_velocity for each in risks if max(each.beyond_margin, each.below) <= risk]
        tried = np.array(velocities or (np.geomspace(safe[0], safe[-1], _CANDIDATES) if safe else ()))
        if len(tried):
            lab = expectation, tried, errors, experiment, model, unknowns, scores
            batch = PlannedBatch.of(*lab, same_capsule=same_capsule, scale_error=scale_error)
            numbers = [tuple(range(len(tried)))]
            if not velocities:
                numbers = [some for size in range(1, flows + 1) for some in combinations(range(len(tried)), size)]
            shown = numbers if progress is None else progress(numbers, len(numbers), "sets of flow rates")
            sets, for_law = best_sets(batch, {filmed: batch.expected_from(filmed, count) for filmed in shown})
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


def _expected_membrane(
    where: str,
    experiment: Experiment,
    errors: LabErrors,
    model: MembraneSurrogate | None,
    membrane: Membrane | None,
    guess: Membrane | None,
    prior: Prior | None,
) -> tuple[MembraneSurrogate, Unknowns, Floats]:
    """Return the model of a lab, what is unknown of its membrane, and the normal scores of what is expected."""
    if not errors.over_half_width:
        expected = "those of lengths over l, as an unknown membrane needs them"
        raise InputError(where, "errors", expected, "those of lengths in metres")
    model = model or MembraneSurrogate.open(experiment.cross_section, view=errors.view)
    model.check_experiment(experiment)
    unknowns = unknowns_of(model, membrane or Membrane(), prior or Prior(), experiment, (None, None))
    return model, unknowns, expected_scores(unknowns, guess, model)


def expected_scores(unknowns: Unknowns, guess: Membrane | None, model: MembraneSurrogate) -> Floats:
    """Return the normal scores under their priors of the unknown parameters that are guessed : (f,) array."""
    # A parameter that is not guessed has the middle of its prior; one at an end of its prior is taken just within.
    guessed, left = (guess or Membrane()).applied(model, Prior())
    values = dict(guessed.values) if isinstance(guessed, FixedParameters) else {}
    unknown = {coordinate.key: coordinate for coordinate in unknowns.coordinates}
    for name in (*left.coordinates, *values):
        if name in left.coordinates or name not in unknown:
            expected = f"a number for one of {', '.join(unknown)}" if unknown else "none, as the membrane is known"
            got = str(left.coordinates[name]) if name in left.coordinates else f"{name} = {values[name]:g}"
            raise InputError("guess", name, expected, got)
    shares = [coordinate.shares(values[name]) if name in values else 0.5 for name, coordinate in unknown.items()]
    return np.asarray(ndtri(np.clip(np.array(shares, dtype=np.float64), _NEAREST, 1.0 - _NEAREST)))


def membrane_at(unknowns: Unknowns, scores: Floats, radius: float) -> dict[str, float]:
    """Return the parameters of the membrane, with the bending modulus that a thickness means at a radius [m]."""
    membrane = {name: float(values[0]) for name, values in unknowns.membranes(scores[None]).items()}
    if THICKNESS in membrane:
        membrane["bending"] = float(bending(membrane_thickness=membrane.pop(THICKNESS), capsule_radius=radius))
    return membrane


def _risks(
    model: FixedParameters, expectation: Expectation, drawn: CapsuleDraws, cross_section: str, margin: float
) -> tuple[list[FlowRisk], float]:
    """Return the risks over the velocities of the flow, and the probability of a size that the model does not have."""
    first, last = model.domain.bounds[1]
    centre, inside = expectation.centre, (drawn.size_ratio >= first) & (drawn.size_ratio <= last)
    limit = expected_range(model, expectation)
    sizes = drawn.size_ratio[inside]
    borders = ModelEnds.of(model, np.unique(np.linspace(sizes.min(), sizes.max(), _BORDERS)))
    lowest, highest = borders.at(drawn.size_ratio)
    velocities = imposed_velocity(
        viscosity=centre.viscosity,
        capillary_number=limit.inner(_VELOCITIES),
        surface_shear_modulus=centre.surface_shear_modulus,
    )
    risks = []
    for velocity in velocities:
        ca = drawn.capillary_number(velocity)
        risks.append(
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
    return risks, float(np.mean(~inside))


def best_sets(
    batch: PlannedBatch, expected: Mapping[tuple[int, ...], ExpectedMembrane]
) -> tuple[tuple[PlannedFlows, ...], PlannedFlows | None]:
    """Return the best set for G_s of each number of flow rates, and of the largest number that for the law, if any."""
    by_size: dict[int, list[tuple[int, ...]]] = {}
    for flows in expected:
        by_size.setdefault(len(flows), []).append(flows)
    best = [min(by_size[size], key=lambda flows: expected[flows].log_modulus_variance) for size in sorted(by_size)]
    planned = {flows: batch.planned(flows, expected[flows]) for flows in best}
    sets = tuple(planned.values())
    if len(expected) < 2 or not expected[best[-1]].seeks(*_LAW):
        return sets, None
    for_law = min(by_size[max(by_size)], key=lambda flows: expected[flows].log_volume(*_LAW))
    return sets, planned[for_law] if for_law in planned else batch.planned(for_law, expected[for_law])


# Map of what one capsule tells of its shear modulus with the membrane unknown, next to that with it known. Each point
# is the posterior of a measurement without noise

MEMBRANE_GRID = (10, 6)
"""Points along log Ca and along a/l."""

MEASURED = {"lengths": "lengths", "outline": "outlines"}
"""What is measured, as variables of the map end, in words."""

UNKNOWN, KNOWN = "unknown", "known"
"""Of the membrane, as variables of the map begin."""

_USUAL = 0.05  # N/m, of G_s; the map does not depend on it


def membrane_map(
    experiment: Experiment,
    errors: LabErrors,
    *,
    model: MembraneSurrogate | None = None,
    membrane: Membrane | None = None,
    guess: Membrane | None = None,
    prior: Prior | None = None,
    grid: tuple[int, int] = MEMBRANE_GRID,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Compute the standard deviation of ln G_s from one capsule, over the plane (Ca, a/l)."""
    # Variables ``unknown_lengths`` and ``known_lengths``, with the membrane unknown and known, and ``unknown_outline``
    # and ``known_outline`` where outlines have errors, NaN where the model has no shape; over a/l ``lowest`` and
    # ``highest``, the borders in Ca of the membrane that is expected. The attributes hold that membrane, model, errors,
    # version.
    if min(grid) < 2:
        raise InputError("membrane_map", "grid", "two points along each axis", repr(grid))
    model, unknowns, scores = _expected_membrane("membrane_map", experiment, errors, model, membrane, guess, prior)
    (low, high), sizes = model.domain.bounds
    expected = membrane_at(unknowns, scores, float(np.mean(sizes)) * experiment.half_width.value)
    fixed = model.fixed(**expected)
    lowest = max(low, float(lowest_ca(expected["pre_inflation"])))
    ca, size = np.geomspace(lowest, (1.0 - WITHIN) * high, grid[0]), np.linspace(*sizes, grid[1])
    applied, believed = (membrane or Membrane()).applied(model, prior or Prior())
    of_expected = replace(experiment, membrane_thickness=None)
    predictors = {
        UNKNOWN: WidthPredictor(applied, experiment, errors, prior=believed, surface_shear_modulus=_USUAL),
        KNOWN: WidthPredictor(fixed, of_expected, errors, surface_shear_modulus=_USUAL),
    }
    kinds = ("lengths", "outline") if errors.outline is not None else ("lengths",)
    names = {f"{known}_{kind}": (known, kind) for kind in kinds for known in predictors}
    words = {
        name: f"standard deviation of ln G_s by {MEASURED[kind]}, membrane {known}"
        for name, (known, kind) in names.items()
    }

    def sds(*place: float) -> dict[str, float]:
        seen = {kind: predictors[KNOWN].without_noise(*place, outline=kind == "outline") for kind in kinds}
        return {name: predictors[known].log_modulus_sd(seen[kind]) for name, (known, kind) in names.items()}

    attributes = lab_attributes(model, experiment, errors) | {"membrane": json.dumps(expected)}
    return over_plane(fixed, ca, size, words, sds, attributes, progress=progress)
