"""Plans for a batch whose membrane is unknown: flow rates and maps."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.special import ndtri
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment, bending, imposed_velocity
from capsbayes.infer.conditional import COMMON, MODULUS, SIZE, Capsules, Lengths, Start, Unknowns, key_of
from capsbayes.infer.importance import ExactEngine, exact_engine
from capsbayes.infer.prior import THICKNESS, Membrane, Prior
from capsbayes.infer.shared_membrane import ONE_CAPSULE, capsules_of, step_of_all, unknowns_of
from capsbayes.measurement import Measurement
from capsbayes.membrane_database import lowest_ca
from capsbayes.model import FixedParameters, ForwardModel
from capsbayes.plan.flow import MARGIN, RISK, flow_rate
from capsbayes.plan.lab import Borders, LabErrors, range_at
from capsbayes.plan.map import Progress, lab_attributes
from capsbayes.plan.widths import EACH, Draws, Expectation, ExpectedMembrane, noise_lattice, prior_widths
from capsbayes.quantity import Given
from capsbayes.run import step_of
from capsbayes.status import Status
from capsbayes.surrogate import MembraneSurrogate

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


# Flow rates at which to film a batch whose membrane is unknown, and what they are expected to tell


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

        return pd.DataFrame([asdict(one) for one in self.risks])

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, ready for JSON."""
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "capsules": self.capsules,
            "same_capsule": self.same_capsule,
            "membrane": dict(self.membrane),
            "expected": self.expectation.as_dict(),
            "sets": [asdict(one) for one in self.sets],
            "for_law": None if self.for_law is None else asdict(self.for_law),
            "prior_sds": dict(self.prior_sds),
            "limits": {
                "mean_velocities": self.limits,
                "margin": self.margin,
                "risk": self.risk,
                "outside_sizes": self.outside,
            },
            "velocities": [asdict(one) for one in self.risks],
            "seed": self.seed,
            **self.lab,
        }


# Capsules of a batch that is yet to be filmed, at several flow rates, as they would be measured without noise

_MOST = 12  # different capsules of one flow rate
EVERY = 4
"""Vertices of a predicted outline for one that is measured."""


@dataclass(frozen=True, eq=False)
class PlannedBatch:
    """Capsules that are expected at some flow rates, of which some are to be filmed."""

    capsules: Capsules  # all of them, without the model's own error
    own: Floats  # (n, 2): ln Ca and a/l
    flow: Integers  # (n,): number of the flow rate
    means: tuple[float, float]  # of ln(G_s / (N/m)) and of a/l
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
        means = float(np.log(centre.surface_shear_modulus[0])), float(centre.size_ratio[0])
        own = (middle[:, None] + np.array([-spreads[0], spreads[1]]) * lattice).reshape(-1, 2)
        flow = np.repeat(np.arange(len(velocities)), len(lattice))
        known = Unknowns(unknowns.coordinates, unknowns.known, spreads)
        shape_model = Lengths(model, experiment.half_width.value)
        theta = shape_model.theta(known.membranes(scores[None]), own[None])
        seen = model(theta, outline=errors.outline is not None)
        rows = np.flatnonzero(seen.inside)
        if not len(rows):
            expected = f"velocities at which {model.name} has a shape of such capsules"
            got = ", ".join(f"{speed:.3g} m/s" for speed in velocities)
            raise InputError("flow_design", "velocities", expected, got)
        area = AREAS[experiment.cross_section] * experiment.half_width.value**2
        measurements = [
            errors.measured(
                seen.values[row, :2],
                float(velocities[flow[row]] * seen.velocity_ratio[row]),
                None if seen.outline is None else seen.outline[row, ::EVERY],
                float(velocities[flow[row]] * area),
            )
            for row in rows
        ]
        capsules = capsules_of(measurements, experiment, model, scale_error=scale_error)
        return cls(capsules, own[rows], flow[rows], means, known, scores)

    def told_by(self, flows: Sequence[int], count: int) -> ExpectedMembrane:
        """Return what so many capsules tell, filmed in equal shares at some of the flow rates."""
        shares = np.array_split(np.arange(max(count, len(flows))), len(flows))
        rows = np.concatenate([self._rows(k, len(share)) for k, share in zip(flows, shares, strict=True)])
        own, point = self.own[rows], self.scores[None]
        common = np.zeros((1, COMMON))
        common[0, [MODULUS, SIZE]] = self.means
        some = replace(self.capsules, batch=self.capsules.batch.taken(rows))
        known = some.with_model_error(self.unknowns.membranes(point), own)
        values = Start(own[None], common)
        step = step_of_all(known, self.unknowns, point, values)
        return ExpectedMembrane(known, self.unknowns, self.scores, values, step.covariance[0])

    def _rows(self, flow: int, count: int) -> Integers:
        """Return rows of capsules at a flow rate, spread over the population, some several times if they are few."""
        there = np.flatnonzero(self.flow == flow)
        return there[(2 * np.arange(count) + 1) * len(there) // (2 * count)]


def spreads_of(expectation: Expectation, *, same_capsule: bool) -> tuple[float, float]:
    """Return the spreads of ln G_s and of a/l among the capsules that are expected."""
    if same_capsule:
        return ONE_CAPSULE
    modulus, radius = expectation.surface_shear_modulus, expectation.capsule_radius
    of_size = radius.sd / expectation.half_width.value
    return max(modulus.sd / modulus.mean, ONE_CAPSULE[0]), max(of_size, ONE_CAPSULE[1])


# Choice of the flow rates at which a batch tells its unknown membrane and its shear modulus best.
#
# For each set of flow rates, out of some in equal ratios, the information of the measurements is computed at the
# membrane that is expected; the best sets are those with the least variance of the mean of ln G_s, and with the least
# volume of the covariance of K and h. Of these the posterior is sampled that measurements without noise would have

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
        Wraps the iterable of computed points to show progress, see `capsbayes.plan.map.Progress`.

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


# Map of what one capsule tells of its shear modulus with the membrane unknown, next to that with it known.
#
# Each point is the posterior of a measurement without noise, by the engine that identifies single capsules

MEMBRANE_GRID = (10, 6)
"""Points along log Ca and along a/l."""

MEASURED = {"lengths": "lengths", "outline": "outlines"}
"""What is measured, as variables of the map end, in words."""

UNKNOWN, KNOWN = "unknown", "known"
"""Of the membrane, as variables of the map begin."""

_MODULUS = 0.05  # N/m; the map does not depend on it
_WITHIN = 1e-9  # margin that keeps the ends of the grid inside the domain despite rounding


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
    check_lengths(errors, "membrane_map")
    model = model or MembraneSurrogate.open(experiment.cross_section, view=errors.view)
    model.check_experiment(experiment)
    unknowns = unknowns_of(model, membrane or Membrane(), prior or Prior(), experiment, (None, None))
    scores = expected_scores(unknowns, guess, model)
    expected = membrane_at(unknowns, scores, Expectation.of(_MODULUS, model_middle(model, experiment), experiment))
    fixed = model.fixed(**expected)
    (low, high), sizes = model.domain.bounds
    lowest = max(low, float(lowest_ca(expected["pre_inflation"])))
    ca, size = np.geomspace(lowest, (1.0 - _WITHIN) * high, grid[0]), np.linspace(*sizes, grid[1])
    inside = np.stack([fixed.domain.contains(ca, np.full(len(ca), ratio)) for ratio in size])
    applied, believed = (membrane or Membrane()).applied(model, prior or Prior())
    engines = {
        UNKNOWN: exact_engine(applied, experiment, believed),
        KNOWN: exact_engine(fixed, replace(experiment, membrane_thickness=None)),
    }
    kinds = ("lengths", "outline") if errors.outline is not None else ("lengths",)
    found = {f"{known}_{kind}": np.full(inside.shape, np.nan) for kind in kinds for known in engines}
    points = list(zip(*np.nonzero(inside), strict=True))
    with threadpool_limits(limits=1):
        for row, column in points if progress is None else progress(points, len(points), "points of the map"):
            seen = _measured(fixed, float(ca[column]), float(size[row]), errors, experiment)
            for name, values in found.items():
                known, kind = name.split("_")
                values[row, column] = _log_modulus_sd(engines[known], seen[kind])
    ranges = [range_at(fixed, float(ratio)) for ratio in size]
    borders = {end: np.array([getattr(one, end) for one in ranges]) for end in ("lowest", "highest")}
    attributes = lab_attributes(model, experiment, errors) | {"membrane": json.dumps(expected)}
    return _dataset(ca, size, found, borders, attributes)


def model_middle(model: MembraneSurrogate, experiment: Experiment) -> float:
    """Return the radius in the middle of those that a model has [m]."""
    return float(np.mean(model.domain.bounds[1])) * experiment.half_width.value


def _measured(
    model: ForwardModel, ca: float, size: float, errors: LabErrors, experiment: Experiment
) -> dict[str, Measurement]:
    """Return what is measured of a capsule without noise: its lengths alone, and its outline too."""
    there = model.at(capillary_number=ca, size_ratio=size, outline=True)
    assert there.outline is not None, "asked for"
    viscosity = experiment.viscosity.value
    speed = float(imposed_velocity(viscosity=viscosity, capillary_number=ca, surface_shear_modulus=_MODULUS))
    rate = flow_rate(speed, experiment.half_width.value, experiment.cross_section)
    velocity, lengths = speed * float(there.velocity_ratio[0]), there.values[0, :2]
    outline = there.outline[0, ::EVERY]
    return {
        "lengths": errors.measured(lengths, velocity, flow_rate=rate),
        "outline": errors.measured(lengths, velocity, outline, rate),
    }


class _Width(NamedTuple):
    sd: float


def _log_modulus_sd(engine: ExactEngine, seen: Measurement) -> float:
    """Return the standard deviation of ln G_s; NaN where the measurement has no posterior."""

    def compute() -> _Width:
        with contextlib.suppress(InputError):
            return _Width(engine(seen).log_marginal("surface_shear_modulus").sd)
        return _Width(np.nan)

    return step_of(_Width, ("membrane map", engine.model.sha256, engine.prior, engine.experiment, seen), compute).sd


def _dataset(
    ca: Floats, size: Floats, found: dict[str, Floats], borders: dict[str, Floats], attributes: dict[str, str]
) -> xr.Dataset:
    import xarray as xr

    variables: dict[str, Any] = {}
    for name, values in found.items():
        known, kind = name.split("_")
        words = f"standard deviation of ln G_s by {MEASURED[kind]}, membrane {known}"
        variables[name] = (("size_ratio", "capillary_number"), values, {"units": "-", "long_name": words})
    for end, values in borders.items():
        variables[end] = ("size_ratio", values, {"units": "-", "long_name": f"{end} Ca"})
    places = {
        "capillary_number": ("capillary_number", ca, {"units": "-", "long_name": "Ca, mu U / G_s"}),
        "size_ratio": ("size_ratio", size, {"units": "-", "long_name": "a/l"}),
    }
    return xr.Dataset(variables, places, attributes)
