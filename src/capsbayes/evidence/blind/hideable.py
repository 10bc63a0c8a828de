"""What can be hidden in a session: in the simulation, in the picture, or in the capsules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from capsbayes.errors import InputError
from capsbayes.evidence.blind.capsule import Capsule
from capsbayes.evidence.blind.lab import Lab
from capsbayes.evidence.blind.optics import enlarged, grown, smeared
from capsbayes.evidence.blind.pattern import smooth_pattern
from capsbayes.physics.membrane import GeneralisedHooke, Skalak, StrainHardening

__all__ = ["HIDEABLE", "Hideable", "hideable_named"]

Drawn = Callable[[Capsule, float, Lab, int], Capsule]


def _as_it_is(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return capsule


@dataclass(frozen=True)
class Hideable:
    """Something that a plain model of a session misses.

    Parameters
    ----------
    name : str
    unit : str
        Of its size in SI, empty for a ratio.
    simulated : callable
        ``(settings, size) -> settings``: what changes in the simulator's parameters.
    drawn : callable
        ``(capsule, size, lab, seed) -> capsule``: what changes in what is seen of a capsule.
    lab : callable
        ``(lab, size) -> lab``: what changes in the population of capsules.
    """

    name: str
    unit: str = ""
    simulated: Callable[[float], dict[str, Any]] = lambda size: {}
    drawn: Drawn = _as_it_is
    lab: Callable[[Lab, float], Lab] = lambda lab, size: lab

    def beside(self, other: Hideable, other_size: float) -> Hideable:
        """This, and another of a given size, which is drawn first."""
        return replace(
            self,
            simulated=lambda size: {**other.simulated(other_size), **self.simulated(size)},
            drawn=lambda capsule, size, lab, seed: self.drawn(
                other.drawn(capsule, other_size, lab, seed), size, lab, seed
            ),
            lab=lambda lab, size: self.lab(other.lab(lab, other_size), size),
        )


def _parameter(name: str) -> Hideable:
    return Hideable(name, simulated=lambda size: {name: size})


def _halo(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, outline=grown(capsule.outline, size / lab.half_width))


def _blurred(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, outline=smeared(capsule.outline, size * capsule.capsule_velocity / lab.half_width))


def _wrong_pixels(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    factor = 1.0 + size
    seen = enlarged(capsule.outline, factor)
    return replace(capsule, outline=seen, velocity_seen=capsule.velocity_seen * factor)


def _swollen(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """The shape was simulated in the channel as wide as it is; the lab divides by the nominal half width."""
    factor = 1.0 + size * capsule.capsule_velocity
    return replace(capsule, outline=enlarged(capsule.outline, factor), capsule_radius=capsule.capsule_radius * factor)


def _patterned(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Edges displaced by a smooth random function of the arc, of root mean square `size`, the same for all capsules."""
    return replace(capsule, outline=capsule.outline + size * smooth_pattern(capsule.outline, seed))


HIDEABLE = MappingProxyType(
    {
        one.name: one
        for one in (
            Hideable("none"),
            *map(_parameter, ("pre_inflation", "bending", "rest_aspect", "corner_radius", "unsteadiness")),
            Hideable("section_aspect", simulated=lambda size: {"section": "rectangular", "section_aspect": size}),
            Hideable("hardening", simulated=lambda size: {"law": Skalak(hardening=size)}),
            Hideable("strain_hardening", simulated=lambda size: {"law": StrainHardening(strain_hardening=size)}),
            Hideable("hooke", simulated=lambda size: {"law": GeneralisedHooke(poisson_ratio=size)}),
            Hideable("halo", "m", drawn=_halo),
            Hideable("exposure", "s", drawn=_blurred),
            Hideable("pixel_scale", drawn=_wrong_pixels),
            Hideable("swelling", "s/m", drawn=_swollen),
            Hideable("modulus_slope", lab=lambda lab, size: replace(lab, slope=size)),
            Hideable("pattern", drawn=_patterned),
        )
    }
)
"""By name: that of the parameter of the effect, where there is one."""


def hideable_named(name: str) -> Hideable:
    """What can be hidden under a name, in which hyphens stand for underscores.

    Raises
    ------
    InputError
        Naming those there are.
    """
    known = name.strip().lower().replace("-", "_").replace(" ", "_")
    if known not in HIDEABLE:
        raise InputError("hide", "effect", f"one of {', '.join(HIDEABLE)}", repr(name))
    return HIDEABLE[known]
