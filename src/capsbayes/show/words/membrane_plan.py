"""Sentences about the plan of measurements whose membrane is unknown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from capsbayes.parameters import PARAMETERS
from capsbayes.plan import FlowRisk, MembraneFlowDesign
from capsbayes.show.words.rounding import per_cent, with_unit

_MODULUS = "surface_shear_modulus"
_KEPT = 0.9  # width over that of the prior, above which a parameter keeps its prior
_RARE = 0.005  # share of the capsules that is not mentioned


def flow_words(design: MembraneFlowDesign) -> Iterator[str]:
    """Yield what the flow rates tell, and which flow rates cannot be used."""
    if design.best is not None:
        yield _told_words(design)
    yield expected_words(design.membrane)
    yield from _limit_words(design)


def _told_words(design: MembraneFlowDesign) -> str:
    assert design.best is not None, "asked for"
    shares = {PARAMETERS[name].symbol: design.best.sds[name] / sd for name, sd in design.prior_sds.items()}
    told = [symbol for symbol, share in shares.items() if share <= _KEPT]
    kept = [symbol for symbol, share in shares.items() if share > _KEPT]
    speeds = ", ".join(f"{PARAMETERS['mean_velocity'].shown(speed):.3g}" for speed in design.best.mean_velocities)
    rates = ", ".join(f"{PARAMETERS['flow_rate'].shown(rate):.3g}" for rate in design.best.flow_rates)
    first = f"Film at U = {speeds} mm/s (Q = {rates} µL/min): G_s to ± {per_cent(design.best.sds[_MODULUS])}"
    parts = [f"{first}, were the membrane known to ± {per_cent(design.best.sd_if_known)}."]
    if shares:
        parts.append(f"The capsules tell {', '.join(told)}." if told else "The capsules tell nothing of the membrane.")
    if kept:
        parts.append(f"{', '.join(kept)} {'keeps its prior' if len(kept) == 1 else 'keep their priors'}.")
    return " ".join(parts)


def expected_words(membrane: Mapping[str, float]) -> str:
    """Say for which membrane an expectation holds."""
    numbers = ", ".join(f"{PARAMETERS[name].symbol} = {value:.3g}" for name, value in membrane.items())
    return f"This holds for capsules with about {numbers}; others tell more or less."


def _limit_words(design: MembraneFlowDesign) -> Iterator[str]:
    """Yield which velocities cannot be used, and why."""
    if design.limits is not None:
        low, high = design.limits
        yield (
            f"Slower than {with_unit('mean_velocity', low)}, more than {per_cent(design.risk)} of the capsules lie "
            "below the lowest Ca of the model, where the shape says little or snaps to another; faster than "
            f"{with_unit('mean_velocity', high)}, as many come nearer than {per_cent(design.margin)} in Ca to the "
            "highest, beyond which a steady shape may not exist."
        )
    if design.outside > _RARE:
        yield f"{per_cent(design.outside)} of the capsules have a size that the model does not have at any flow rate."
    for one in design.sets[-1:]:
        for speed in one.mean_velocities:
            risk = _nearest(design, speed)
            lost = risk.without_shape - design.outside
            if lost > max(design.risk, _RARE):
                yield (
                    f"At U = {with_unit('mean_velocity', speed)} the model has no shape of {per_cent(lost)} of the "
                    "capsules; what is expected is of the others."
                )


def _nearest(design: MembraneFlowDesign, speed: float) -> FlowRisk:
    return min(design.risks, key=lambda risk: abs(risk.mean_velocity - speed))
