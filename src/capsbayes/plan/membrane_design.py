"""Flow rates at which to film a batch whose membrane is unknown, and what they are expected to tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from capsbayes.plan.expectation import Expectation
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


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
