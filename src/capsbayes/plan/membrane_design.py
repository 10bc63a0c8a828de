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
    """Capsules that cannot be used at one velocity of the flow.

    Parameters
    ----------
    mean_velocity, flow_rate : float [m/s], [m^3/s]
    capillary_number : float
        Of the capsule in the middle of those expected.
    below, beyond : float
        Probability that a capsule lies below the lowest, above the highest Ca of the model at its size.
    beyond_margin : float
        As `beyond`, or nearer to it than the margin.
    without_shape : float
        Probability that the model has no shape of a capsule, for whatever reason.
    """

    mean_velocity: float
    flow_rate: float
    capillary_number: float
    below: float
    beyond: float
    beyond_margin: float
    without_shape: float


@dataclass(frozen=True)
class PlannedFlows:
    """Flow rates at which a batch is filmed, and the standard deviations that are expected.

    Parameters
    ----------
    mean_velocities, flow_rates : tuple of float [m/s], [m^3/s]
    capillary_numbers : tuple of float
        Of the capsule in the middle of those expected.
    sds : mapping of float
        Of the logarithms of the mean G_s and a of the population, of ln G_s of each capsule, and of the unknown
        parameters, see `capsbayes.plan.expected_membrane.ExpectedMembrane.widths`; they include the errors of viscosity
        and half width.
    sd_if_known : float
        Standard deviation of the mean ln G_s if the membrane were known.
    """

    mean_velocities: tuple[float, ...]
    flow_rates: tuple[float, ...]
    capillary_numbers: tuple[float, ...]
    sds: Mapping[str, float]
    sd_if_known: float


@dataclass(frozen=True, eq=False)
class MembraneFlowDesign:
    """Expected precision of the membrane and of G_s of a batch, at the best flow rates.

    Parameters
    ----------
    sets : tuple of PlannedFlows
        The best set for G_s of each size, from one flow rate to the number asked for; if velocities were stated, the
        set of these alone.
    for_law : PlannedFlows or None
        The best set for K and h, of the number asked for; None if it was not sought.
    prior_sds : mapping of float
        Standard deviations of the unknown parameters under their priors.
    risks : tuple of FlowRisk
        In rising velocity.
    limits : tuple of float or None [m/s]
        Lowest and highest velocity that may be chosen.
    outside : float
        Probability that a capsule has a size for which the model has no shape at any velocity.
    capsules : int
    same_capsule : bool
    membrane : mapping of float
        The membrane that is expected.
    expectation : Expectation
    margin, risk : float
    lab : mapping of str
        Model, its fingerprint, experiment, errors, version.
    seed : int
    status : Status
    """

    sets: tuple[PlannedFlows, ...]
    for_law: PlannedFlows | None
    prior_sds: Mapping[str, float]
    risks: tuple[FlowRisk, ...]
    limits: tuple[float, float] | None
    outside: float
    capsules: int
    same_capsule: bool
    membrane: Mapping[str, float]
    expectation: Expectation
    margin: float
    risk: float
    lab: Mapping[str, str]
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
