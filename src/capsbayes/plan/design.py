"""Expected widths over the velocity of the flow, and the best velocity."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.plan.borders import CaRange
from capsbayes.plan.expectation import Expectation
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd

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
    values = asdict(point)
    return {
        name: None if isinstance(value, float) and not np.isfinite(value) else value for name, value in values.items()
    }
