"""The flow rate at which the posterior of G_s of the expected capsules is narrowest."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, imposed_velocity
from capsbayes.infer.prior import Prior
from capsbayes.infer.verdict import LEANING_SHARE
from capsbayes.model import ForwardModel
from capsbayes.plan.lab import (
    CapsuleDraws,
    CaRange,
    Expectation,
    LabErrors,
    ModelEnds,
    expected_range,
    flow_rate,
    lab_attributes,
    range_at,
)
from capsbayes.plan.map import Progress
from capsbayes.plan.widths import NOISES, WidthPredictor, check_model
from capsbayes.quantity import Given
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


# A slow flow tells little of a membrane, and too strong a flow has no steady shape. For each mean velocity U the
# expected width of G_s is averaged over the capsules that are expected; the best U is that of the smallest width among
# those at which the capsules stay below the limit of existence by a margin

MARGIN = 0.1
"""Share of the Ca at the limit of existence by which capsules are to stay below it."""

RISK = 0.05
"""Probability that a capsule comes nearer to the limit than that."""

_VELOCITIES = 96
_CAPSULES = 4000  # drawn
_AS_GOOD = 1.05  # width over the smallest, up to which a velocity counts as good


@dataclass(frozen=True)
class FlowPoint:
    """Expectation at one velocity of the flow."""

    # The widths are the mean, over the capsules expected that the model has, of those of `capsbayes.plan.widths.Width`.

    mean_velocity: float  # U [m/s]
    flow_rate: float  # Q [m^3/s]
    capillary_number: float  # of the capsule in the middle of those expected
    capsule_velocity: float  # [m/s] of that capsule; NaN where the model has no shape for it
    relative: float
    sd: float
    relative_radius: float
    noise_free: float
    leaning: float
    beyond_limit: float  # probability that a capsule lies above the highest Ca of the model at its size
    beyond_margin: float  # probability that it lies above it, or nearer to it than the margin
    without_shape: float  # probability that the model has no shape of a capsule, for whatever reason
    allowed: bool  # whether this velocity may be chosen


@dataclass(frozen=True, eq=False)
class FlowDesign:
    """Expected widths over the velocity of the flow, and the best of them."""

    points: tuple[FlowPoint, ...]  # in rising velocity
    best: FlowPoint | None  # the smallest width among those allowed
    limit: CaRange  # at the expected size
    limit_velocity: float  # U [m/s] at which the expected capsule reaches its upper end
    expectation: Expectation
    margin: float  # see `MARGIN` of `capsbayes.plan.flow`
    risk: float  # see `RISK` there
    lab: dict[str, str]  # model, its fingerprint, experiment, errors, version
    seed: int
    status: Status  # LEANS_ON_BORDER if the border of the model cuts the widths at every velocity below the limit

    @property
    def good(self) -> tuple[float, float] | None:
        """Range of mean velocities [m/s] around the best in which the width is within 5 % of the smallest."""
        if self.best is None:
            return None
        place = self.points.index(self.best)
        fine = [point.allowed and point.relative <= _AS_GOOD * self.best.relative for point in self.points]
        first, last = place, place
        while first > 0 and fine[first - 1]:
            first -= 1
        while last < len(fine) - 1 and fine[last + 1]:
            last += 1
        return self.points[first].mean_velocity, self.points[last].mean_velocity

    def table(self) -> pd.DataFrame:
        """Return a row for each velocity, SI."""
        import pandas as pd

        return pd.DataFrame([asdict(point) for point in self.points])

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, ready for JSON; unknown values are null."""
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "best": None if self.best is None else _plain(self.best),
            "good_mean_velocities": self.good,
            "limit": {
                "mean_velocity": self.limit_velocity,
                "capillary_number": self.limit.highest,
                "size_ratio": self.limit.size_ratio,
                "limit_of_existence": self.limit.limit,
                "margin": self.margin,
                "risk": self.risk,
            },
            "expected": self.expectation.as_dict(),
            "points": [_plain(point) for point in self.points],
            "seed": self.seed,
            **self.lab,
        }


def _plain(point: FlowPoint) -> dict[str, Any]:
    """Return the fields with None in place of NaN, which JSON does not know."""
    return {name: value if np.isfinite(value) else None for name, value in asdict(point).items()}


@checked
def flow_design(
    surface_shear_modulus: Given,
    capsule_radius: Given,
    experiment: Experiment,
    errors: LabErrors,
    model: ForwardModel,
    *,
    seed: int,
    margin: float = MARGIN,
    risk: float = RISK,
    noises: int = NOISES,
    prior: Prior | None = None,
    progress: Progress | None = None,
) -> FlowDesign:
    """Choose the flow rate for capsules of expected G_s and a.

    Parameters
    ----------
    surface_shear_modulus, capsule_radius : Quantity [N/m], [m]
        Expected G_s and a; `Quantity.of` says in which forms.
    experiment : Experiment
        Channel and liquid, with their errors.
    errors : LabErrors
        Of the lengths and of the velocity.
    model : ForwardModel
    seed : int
        Of the capsules drawn; stored in the result.
    margin : float
        Share of the Ca at the limit of existence by which capsules are to stay below it.
    risk : float
        Probability that a capsule comes nearer.
    noises : int
        Measurements that each width is averaged over.
    prior : Prior, optional
        With which the capsules will be identified.
    progress : callable, optional
        Wraps the iterable of computed points to show progress, see `capsbayes.plan.map.Progress`.

    Returns
    -------
    FlowDesign

    Raises
    ------
    InputError
        If an argument cannot be used, or the model has no shape of the expected size.
    """
    check_risk(margin, risk)
    expectation = Expectation.of(surface_shear_modulus, capsule_radius, experiment)
    centre, limit = expectation.centre, expected_range(model, expectation)
    check_model(model, experiment)
    expected_modulus = float(centre.surface_shear_modulus[0])
    predictor = WidthPredictor(
        model, experiment, errors, prior=prior, surface_shear_modulus=expected_modulus, noises=noises
    )
    capsules = expectation.drawn(np.random.default_rng(seed), _CAPSULES)
    with threadpool_limits(limits=1):
        table = WidthTable.of(predictor, capsules.size_ratio, progress)
    per_ca = float(
        imposed_velocity(viscosity=centre.viscosity[0], capillary_number=1.0, surface_shear_modulus=expected_modulus)
    )
    lab = table, capsules, centre, model, margin, experiment.cross_section
    points, status = _judged([_expected(speed, *lab) for speed in per_ca * limit.inner(_VELOCITIES)], risk)
    allowed = [point for point in points if point.allowed]
    return FlowDesign(
        points=points,
        best=min(allowed, key=lambda point: point.relative) if allowed else None,
        limit=limit,
        limit_velocity=per_ca * limit.highest,
        expectation=expectation,
        margin=margin,
        risk=risk,
        lab=lab_attributes(model, experiment, errors),
        seed=seed,
        status=status,
    )


def check_risk(margin: float, risk: float) -> None:
    """Refuse a margin or a risk that is no share."""
    if not (0.0 <= margin < 1.0 and 0.0 <= risk < 1.0):
        raise InputError("flow_design", "margin, risk", "shares from 0 to below 1", f"{margin:g}, {risk:g}")


def _expected(
    velocity: float,
    table: WidthTable,
    capsules: CapsuleDraws,
    centre: CapsuleDraws,
    model: ForwardModel,
    margin: float,
    cross_section: str,
) -> FlowPoint:
    """Return the expectation at one velocity, not yet marked as allowed."""
    ca, size = capsules.capillary_number(velocity), capsules.size_ratio
    has_shape = model.domain.contains(ca, size)
    highest = table.borders.at(size)[1]
    widths = {
        name: float(np.mean(width[has_shape])) if has_shape.any() else np.nan
        for name, width in table.at(ca, size).items()
    }
    middle = {"capillary_number": centre.capillary_number(velocity), "size_ratio": centre.size_ratio}
    return FlowPoint(
        mean_velocity=float(velocity),
        flow_rate=flow_rate(float(velocity), float(centre.half_width[0]), cross_section),
        capillary_number=float(middle["capillary_number"][0]),
        capsule_velocity=float(velocity * model(middle).velocity_ratio[0]),
        **widths,
        beyond_limit=float(np.mean(ca > highest)),
        beyond_margin=float(np.mean(ca > (1.0 - margin) * highest)),
        without_shape=float(np.mean(~has_shape)),
        allowed=False,
    )


def _judged(expected: list[FlowPoint], risk: float) -> tuple[tuple[FlowPoint, ...], Status]:
    """Mark the velocities that may be chosen: below the limit, with widths that the border does not cut."""
    below = [point.beyond_margin <= risk and bool(np.isfinite(point.relative)) for point in expected]
    measured = [fine and point.leaning <= LEANING_SHARE for fine, point in zip(below, expected, strict=True)]
    status = Status.DONE if any(measured) else Status.LEANS_ON_BORDER if any(below) else Status.NO_FLOW_RATE
    chosen = measured if any(measured) else below
    return tuple(replace(point, allowed=fine) for point, fine in zip(expected, chosen, strict=True)), status


# Table of expected widths over Ca and a/l, for many capsules at once

_POINTS = 32  # along log Ca in each column
_SPACING, _MOST = 0.015, 9  # of the columns, and how many
_TAIL = 0.002  # of the sizes beyond either end of the columns
_BORDERS = 65


@dataclass(frozen=True, eq=False)
class WidthTable:
    """Table of widths: Ca along columns of constant a/l."""

    columns: Floats  # (k,): a/l, rising
    log_ca: Floats  # (k, m): points of each column, from end to end of the model there
    values: dict[str, Floats]  # (k, m): the fields of `Width`
    borders: ModelEnds

    @classmethod
    def of(cls, predictor: WidthPredictor, sizes: Floats, progress: Progress | None = None) -> WidthTable:
        """Compute the table for capsules of given sizes (n,), within the model."""
        model = predictor.model
        columns = _columns(model, sizes)
        ca = np.stack([range_at(model, float(size)).inner(_POINTS) for size in columns])
        places = list(np.ndindex(ca.shape))
        shown = places if progress is None else progress(places, len(places), "expected widths")
        rows = [asdict(predictor.at(float(ca[place]), float(columns[place[0]]))) for place in shown]
        values = {name: np.array([row[name] for row in rows]).reshape(ca.shape) for name in rows[0]}
        sizes = columns if len(columns) == 1 else np.linspace(columns[0], columns[-1], _BORDERS)
        return cls(columns, np.log(ca), values, ModelEnds.of(model, sizes))

    def at(self, ca: Floats, size: Floats) -> dict[str, Floats]:
        """Interpolate the widths of capsules linearly in log Ca and a/l : (n,) arrays by name."""
        weights = [np.interp(size, self.columns, of_column) for of_column in np.eye(len(self.columns))]
        widths = {}
        for name, values in self.values.items():
            columns = zip(self.log_ca, values, np.isfinite(values), strict=True)
            by_column = [np.interp(np.log(ca), places[fine], along[fine]) for places, along, fine in columns]
            widths[name] = np.einsum("kn,kn->n", weights, by_column)
        return widths


def _columns(model: ForwardModel, sizes: Floats) -> Floats:
    """Return columns over the sizes within the model : (k,) array; one if all are of one size."""
    first, last = model.domain.bounds[1]
    low, high = np.clip(np.quantile(sizes, [_TAIL, 1.0 - _TAIL]), first, last)
    if high - low < 1e-9:
        return np.array([low])
    return np.linspace(low, high, int(np.clip(np.ceil((high - low) / _SPACING) + 1, 2, _MOST)))
