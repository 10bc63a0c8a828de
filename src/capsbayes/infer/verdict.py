"""The status of a posterior: its misfit and its gates."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.checks import Agreement, Gate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid import ExactPosterior, GridPosterior
from capsbayes.infer.importance import ExactEngine
from capsbayes.infer.likelihood import NUDGE, border_steps, p_value, p_values_of_lengths
from capsbayes.infer.prior import LIMITED, Prior
from capsbayes.measurement import Measurement
from capsbayes.model import TWO_SHAPES, UNSURE_SHAPES, WRINKLES, CoordinateRange, ForwardModel
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity
from capsbayes.status import Status

# Checks of a measurement against the model and the priors: predictive p-values, Reynolds number.
#
# The p-value of a number is the probability that it lies as far out on its side of the distribution that is predicted
# for it, or on the other side. Each number is predicted from those before it, and from the priors: L_z from the
# velocity, L_a from velocity and L_z, the flow rate from all of them. No number is used for its own prediction, so that
# the p-values are uniform and independent if all is as stated (M. Rosenblatt, Ann. Math. Stat. 23 (1952) 470; with the
# prior as part of the model: G. E. P. Box, J. R. Stat. Soc. A 143 (1980) 383). The velocity has none: the prior of the
# mean velocity is flat, and nothing before it predicts it. Where the velocity was not measured, the flow rate takes its
# place

PREDICTED = ("axial_extent", "axial_length", "flow_rate")
"""Quantities that have a p-value, where they were measured; each is predicted from those before it."""

LARGEST_REYNOLDS_NUMBER = 1.0  # rho U l / mu at which the stress of inertia rho U^2 equals the viscous stress mu U / l

_DRAWS = 4000


class Misfit(NamedTuple):
    """A gate on the measurement and the status of a posterior that fails it."""

    gate: Gate
    status: Status


def p_values(engine: ExactEngine, measurement: Measurement, posterior: ExactPosterior) -> dict[str, float]:
    """Return the p-values of what was measured, by name; of the lengths unless an outline takes their place."""
    found = {} if measurement.outline is not None else _of_lengths(engine, posterior.density)
    rate = posterior.density.flow_rate
    if rate is not None and not posterior.density.inputs.by_flow_rate:
        without = replace(posterior.density.inputs, flow_rate=None)
        mean, variance = _log_flow(engine(measurement, inputs=without))
        score = (rate.mean - mean) / np.sqrt(rate.variance + variance)
        found["flow_rate"] = p_value(np.ones(1), np.array([score]))
    return found


def _log_flow(posterior: ExactPosterior) -> tuple[float, float]:
    """Return mean and variance of the log of the flow rate: from the nodes if these tell all, else from draws."""
    area = posterior.density.inputs.area
    if not isinstance(posterior, GridPosterior) or posterior.cut or posterior.half_width is not None:
        draws = posterior.drawn(np.random.default_rng([0, 3]), _DRAWS)
        flow = np.log(draws["mean_velocity"] * draws["half_width"] ** 2 * area * posterior.forward.relative_area(draws))
        return float(flow.mean()), float(flow.var())
    weights, nodes, _ = posterior.kept
    theta = {"capillary_number": np.exp(nodes.log_ca), "size_ratio": nodes.size}
    of_flow, width = (posterior.distribution(name) for name in ("mean_velocity", "half_width"))
    log_area = np.log(area) + float(weights @ np.log(posterior.forward.relative_area(theta)))
    return of_flow.mean + 2.0 * width.mean + log_area, of_flow.variance + 4.0 * width.variance


def misfits_of(found: Mapping[str, float]) -> list[Misfit]:
    """Return the gates on p-values by name, first the one whose failure explains the others."""
    statuses = dict.fromkeys(PREDICTED, Status.LENGTHS_MISFIT) | {"flow_rate": Status.FLOW_CONFLICT}
    known = [name for name in reversed(PREDICTED) if np.isfinite(found.get(name, np.nan))]
    gates = {
        name: Gate.of_p_value(f"predictive p-value of {PARAMETERS[name].symbol}", found[name], len(known))
        for name in known
    }
    return [Misfit(gate, statuses[name]) for name, gate in gates.items()]


def inertia(reynolds_number: float) -> Misfit:
    """Return the gate on a Reynolds number."""
    return Misfit(Gate("Reynolds number", reynolds_number, most=LARGEST_REYNOLDS_NUMBER), Status.INERTIA)


def _of_lengths(engine: ExactEngine, density: PosteriorDensity) -> dict[str, float]:
    """Return the p-values of L_z and L_a."""
    model, logs = engine.predicted_shapes(density)
    width = density.inputs.half_width
    seen = density.likelihood.with_half_width(width.value, width.error)
    differences = np.broadcast_arrays(*seen.differences(model))
    found = p_values_of_lengths(np.exp(logs - logs.max()), *differences)
    return {name: p for name, p in zip(PREDICTED, found, strict=False) if np.isfinite(p)}


# Share of a posterior next to borders, and the status that follows from that and from its gates

LEANING_SHARE = 0.05  # share of a posterior next to a border from which on it leans on it

RANGE = "range of "  # how the name of a share next to the ends of a further coordinate's range begins
ONE_END = "end of the range of "  # the same of a coordinate that the data do not tell, but that piles up on an end

_NEGLIGIBLE = 1e-4  # of the largest probability of a node
_TOLD = 0.5  # of the prior's probability within 68 %: a coordinate of which the data tell less fills its range anyway
_PILED = 2.0  # times the prior's probability next to an end, above which a posterior piles up there
_SEVERAL = 2  # ranges: next to the ends of so many at once, the true membrane may be none of the model

_STATUSES = (
    Status.LEANS_ON_BORDER,
    Status.LEANS_ON_PRIOR,
    Status.LEANS_ON_TWO_SHAPES,
    Status.LEANS_ON_WRINKLES,
    Status.LEANS_ON_UNSURE_SHAPES,
)


def leanings(draws: Mapping[str, Floats], model: ForwardModel, prior: Prior) -> dict[str, float]:
    """Return the shares of a posterior next to the border of the model and the ends of the priors, and at caveats."""
    place = ("capillary_number", "size_ratio")
    shares = {"model": leaning(draws, place, model.domain.contains, tuple(model.coordinates))}
    drawn = {name: np.ravel(draws[name]) for name in (*place, *model.coordinates)}
    shares |= {kind: float(np.mean(concerned)) for kind, concerned in model.caveats(drawn).items()}
    for name, limits in zip(LIMITED, prior.both, strict=True):
        low, high = limits.low, limits.high
        shares[f"prior of {name}"] = leaning(draws, (name,), lambda x, a=low, b=high: (x >= a) & (x <= b))
    return shares | range_leanings(draws, model.coordinates, prior.uncertain)


def leanings_at_nodes(posterior: GridPosterior, prior: Prior) -> dict[str, float]:
    """Return the `leanings` of a posterior that no prior cuts, from its nodes."""
    weights, nodes, _ = posterior.kept
    likely = weights > _NEGLIGIBLE * weights.max()
    weights, nodes = weights[likely] / weights[likely].sum(), nodes.taken(likely)
    place = {"capillary_number": np.exp(nodes.log_ca), "size_ratio": nodes.size}
    model = posterior.forward
    shares = {"model": leaning(place, tuple(place), model.domain.contains, weights=weights)}
    shares |= {kind: float(weights @ concerned) for kind, concerned in model.caveats(place).items()}
    for name, limits in zip(LIMITED, prior.both, strict=True):
        found = posterior.distribution(name)
        near = NUDGE * np.sqrt(found.variance)
        below = found.below(np.log([limits.low, limits.high]) + np.array([near, -near]))
        shares[f"prior of {name}"] = float(1.0 - (below[1] - below[0]))
    return shares


def range_leanings(
    draws: Mapping[str, Floats], ranges: Mapping[str, CoordinateRange], priors: Mapping[str, Quantity]
) -> dict[str, float]:
    """Return the share of a posterior within half a standard deviation of the ends of each coordinate's range."""
    # A coordinate that the data do not tell fills its range: it has one only if it piles up on an end.
    shares = {}
    for name, ends in ranges.items():
        if name not in priors:
            continue
        known, drawn = priors[name], np.ravel(draws[name])
        at_ends = list(_next_to_ends(drawn, ends))
        piled = [share for share, interval in at_ends if share > _PILED * np.diff(known.cdf(interval))[0]]
        if np.diff(known.cdf(np.quantile(drawn, [0.16, 0.84])))[0] <= _TOLD * 0.68:
            shares[f"{RANGE}{name}"] = sum(share for share, _ in at_ends)
        elif piled:
            shares[f"{ONE_END}{name}"] = max(piled)
    return shares


def _next_to_ends(drawn: Floats, ends: CoordinateRange) -> Iterator[tuple[float, Floats]]:
    """Yield the share of draws within half a standard deviation of an end, and the interval (2,) that this is."""
    # An end that is the null value, as no inflation, is where most membranes are, and none that cuts the posterior.
    scaled, back = (np.log, np.exp) if ends.logarithmic else (np.asarray, np.asarray)
    values = scaled(drawn)
    near = 0.5 * float(np.std(values))
    for end, low, high in ((ends.low, 0.0, near), (ends.high, -near, 0.0)):
        if end != ends.null_value:
            yield float(np.mean(np.abs(values - scaled(end)) < near)), back(scaled(end) + np.array([low, high]))


def leaning(  # type: ignore[no-untyped-def]
    draws: Mapping[str, Floats], names: Sequence[str], contains, held: Sequence[str] = (), weights: Floats | None = None
) -> float:
    """Return the share of a posterior within half a standard deviation of a border."""
    logs = np.stack([np.log(np.ravel(draws[name])) for name in names])
    every = slice(None, None, max(1, logs.shape[1] // 4000) if weights is None else 1)
    logs, others = logs[:, every], [np.ravel(draws[name])[every] for name in held]
    out = np.zeros(logs.shape[1], dtype=bool)
    if weights is None:
        covariance = np.atleast_2d(np.cov(_given(logs, others)))
    else:
        away = logs - np.sum(weights * logs, axis=1, keepdims=True)
        covariance = np.sum(weights * away * away[:, None], axis=2)
    for step in border_steps(covariance):
        out |= ~contains(*np.exp(logs + step[:, None]), *others)
    return float(out.mean() if weights is None else weights @ out)


def _given(logs: Floats, held: Sequence[Floats]) -> Floats:
    """Return the residuals of each row after a regression on parabolas in the held quantities : (names, n) array."""
    if not held:
        return logs
    pairs = itertools.combinations_with_replacement(held, 2)
    basis = np.stack([np.ones(logs.shape[1]), *held, *(first * second for first, second in pairs)], axis=1)
    return logs - (basis @ np.linalg.lstsq(basis, logs.T, rcond=None)[0]).T


def verdict(
    gates: Sequence[Gate],
    agreed: Agreement | None,
    leans: Mapping[str, float],
    misfits: Sequence[Misfit] = (),
    unresolved: Status = Status.GRID_TOO_COARSE,
) -> Status:
    """Return the status of a posterior: what makes the intervals wrong, then what makes them those of a border."""
    # `misfits` are the gates on the measurement, the gravest first; `unresolved` is that of an exact posterior whose
    # own gates failed.
    failed = next((misfit.status for misfit in misfits if not misfit.gate.passed), None)
    if failed not in (None, Status.INERTIA):
        return failed
    if not all(gate.passed for gate in gates):
        return Status.NOT_MIXED if agreed is not None else unresolved
    if agreed is not None and not agreed.passed:
        return Status.ENGINES_DISAGREE
    shares = zip(_STATUSES, shares_by_kind(leans), strict=True)
    return failed or next((kind for kind, share in shares if share > LEANING_SHARE), Status.DONE)


def shares_by_kind(leans: Mapping[str, float]) -> tuple[float, ...]:
    """Return the shares of `leanings` next to the border of the model and the prior, and at each kind of caveat."""
    # The ends of the ranges of further coordinates are a border of the model where a posterior lies next to several.
    of_ranges = sorted((share for name, share in leans.items() if name.startswith(RANGE)), reverse=True)
    of_model = max([leans["model"], *of_ranges[_SEVERAL - 1 : _SEVERAL]])
    of_prior = max(share for name, share in leans.items() if name.startswith("prior of"))
    at_caveats = (leans.get(kind, 0.0) for kind in (TWO_SHAPES, WRINKLES, UNSURE_SHAPES))
    return of_model, of_prior, *at_caveats
