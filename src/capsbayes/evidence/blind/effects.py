"""True effects of blind sessions: in the simulation, in the picture, or in the population of capsules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from capsbayes.errors import InputError
from capsbayes.evidence.blind.capsule import Capsule
from capsbayes.evidence.blind.lab import Lab
from capsbayes.evidence.blind.optics import (
    distorted,
    enlarged,
    grown,
    in_perspective,
    smeared,
    smooth_pattern,
)
from capsbayes.physics.membrane import GeneralisedHooke, HookeShare, Skalak, StrainHardening

Drawn = Callable[[Capsule, float, Lab, int], Capsule]


@dataclass(frozen=True)
class TrueEffect:
    """An effect that the capsules of a blind session have, and a plain model lacks."""

    name: str  # of the parameter of the catalogue's effect, if the catalogue has it
    unit: str = ""  # of its size in SI, empty for a ratio
    simulated: Callable[[float], dict[str, Any]] = lambda size: {}  # settings of the simulator that it changes
    drawn: Drawn = lambda capsule, size, lab, seed: capsule  # as the microscope shows it
    lab: Callable[[Lab, float], Lab] = lambda lab, size: lab  # the change of the population

    def combined(self, other: TrueEffect, other_size: float) -> TrueEffect:
        """Return this effect together with another of a given size, which acts first."""
        return replace(
            self,
            simulated=lambda size: {**other.simulated(other_size), **self.simulated(size)},
            drawn=lambda capsule, size, lab, seed: self.drawn(
                other.drawn(capsule, other_size, lab, seed), size, lab, seed
            ),
            lab=lambda lab, size: self.lab(other.lab(lab, other_size), size),
        )


def _setting(name: str) -> TrueEffect:
    return TrueEffect(name, simulated=lambda size: {name: size})


def _halo(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, outline=grown(capsule.outline, size / lab.half_width))


def _blurred(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, outline=smeared(capsule.outline, size * capsule.capsule_velocity / lab.half_width))


def _wrong_pixels(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    factor = 1.0 + size
    return replace(
        capsule, outline=enlarged(capsule.outline, factor, factor), velocity_seen=capsule.velocity_seen * factor
    )


def _oblong(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, outline=enlarged(capsule.outline, size, 1.0), velocity_seen=capsule.velocity_seen * size)


def _distorted(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, outline=distorted(capsule.outline, size))


def _in_perspective(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, outline=in_perspective(capsule.outline, size))


def _swollen(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Enlarge the capsule: it was simulated in the true channel, and the lab divides by the nominal half width."""
    factor = 1.0 + size * capsule.capsule_velocity
    return replace(
        capsule,
        outline=enlarged(capsule.outline, factor, factor),
        capsule_radius=capsule.capsule_radius * factor,
        flow_rate=capsule.flow_rate * factor**2,
    )


def _wrong_clock(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, velocity_seen=capsule.velocity_seen * (1.0 + size))


def _wrong_pump(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    return replace(capsule, flow_rate=capsule.flow_rate * (1.0 + size))


def _narrower(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Put the capsule into a channel narrower than the lab's value of it, which scales velocities in the picture."""
    factor = 1.0 + size
    return replace(
        capsule,
        capsule_radius=capsule.capsule_radius / factor,
        flow_rate=capsule.flow_rate / factor**2,
        velocity_seen=capsule.velocity_seen * factor,
    )


def _narrower_than_divided(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Put the capsule into a channel narrower than the lab's value of it, by which lengths in metres are divided."""
    factor = 1.0 + size
    return replace(
        capsule,
        outline=enlarged(capsule.outline, 1.0 / factor, 1.0 / factor),
        capsule_radius=capsule.capsule_radius / factor,
        flow_rate=capsule.flow_rate / factor**2,
    )


def _patterned(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Displace the edge by a smooth random function of the arc, of root mean square `size`, common to all capsules."""
    return replace(capsule, outline=capsule.outline + size * smooth_pattern(capsule.outline, seed))


TRUE_EFFECTS = MappingProxyType(
    {
        effect.name: effect
        for effect in (
            TrueEffect("none"),
            *map(_setting, ("pre_inflation", "bending", "rest_aspect", "corner_radius", "unsteadiness")),
            TrueEffect(
                "section_aspect", simulated=lambda size: {"cross_section": "rectangular", "section_aspect": size}
            ),
            TrueEffect("hardening", simulated=lambda size: {"law": Skalak(hardening=size)}),
            TrueEffect("strain_hardening", simulated=lambda size: {"law": StrainHardening(strain_hardening=size)}),
            TrueEffect(
                "hooke_share", simulated=lambda size: {"law": HookeShare(size) if size < 1.0 else GeneralisedHooke()}
            ),
            TrueEffect("halo", "m", drawn=_halo),
            TrueEffect("exposure", "s", drawn=_blurred),
            TrueEffect("pixel_scale", drawn=_wrong_pixels),
            TrueEffect("pixel_aspect", drawn=_oblong),
            TrueEffect("distortion", drawn=_distorted),
            TrueEffect("taper", drawn=_in_perspective),
            TrueEffect("swelling", "s/m", drawn=_swollen),
            TrueEffect("velocity_scale", drawn=_wrong_clock),
            TrueEffect("flow_rate_error", drawn=_wrong_pump),
            TrueEffect("half_width_error", drawn=_narrower),
            TrueEffect("half_width_apart", drawn=_narrower_than_divided),
            TrueEffect("modulus_slope", lab=lambda lab, size: replace(lab, slope=size)),
            TrueEffect("pattern", drawn=_patterned),
        )
    }
)
"""All true effects by name."""


def true_effect_named(name: str, own: Mapping[str, TrueEffect] = MappingProxyType({})) -> TrueEffect:
    """Return the true effect of a name, with hyphens or blanks for underscores; `own` ones are known too."""
    effects = {**TRUE_EFFECTS, **own}
    known = name.strip().lower().replace("-", "_").replace(" ", "_")
    if known not in effects:
        raise InputError("hide", "effect", f"one of {', '.join(effects)}", repr(name))
    return effects[known]
