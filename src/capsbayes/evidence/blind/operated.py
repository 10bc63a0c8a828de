"""True effects made from the operators of a user's own effects, applied to simulated shapes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans
from capsbayes.errors import InputError
from capsbayes.evidence.blind.capsule import Capsule
from capsbayes.evidence.blind.effects import TrueEffect
from capsbayes.evidence.blind.lab import Lab
from capsbayes.model import Domain, Effect, ForwardModel, Theta
from capsbayes.prediction import Prediction
from capsbayes.profile import Profile


def true_effect_of(effect: Effect) -> TrueEffect:
    """Return an effect whose operator acts on the simulated shape and velocity of each capsule."""
    # What is found again was put in by the same code then: a session tells whether the effect can be found and
    # distinguished, not whether its operator is right.

    def drawn(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
        return _operated(effect, capsule, size, lab)

    unit = effect.parameter.unit
    return TrueEffect(effect.parameter.name, "" if unit == "-" else unit, drawn=drawn)


def _operated(effect: Effect, capsule: Capsule, size: float, lab: Lab) -> Capsule:
    speed = capsule.capillary_number * capsule.surface_shear_modulus / lab.viscosity
    theta = {
        "capillary_number": capsule.capillary_number,
        "size_ratio": capsule.size_ratio,
        "capsule_velocity": capsule.velocity_seen,
        "mean_velocity": speed,
        "half_width": lab.half_width,
        "viscosity": lab.viscosity,
        "flow_rate": capsule.flow_rate,
        effect.parameter.name: size,
    }
    model = _OneCapsule(capsule, capsule.velocity_seen / speed)
    seen = (model + effect)({name: np.array([value]) for name, value in theta.items()}, outline=True)
    if seen.outline is None or not np.isfinite(seen.outline).all():
        raise InputError("hide", effect.parameter.name, "a size at which capsules have outlines", f"{size:g}")
    return replace(capsule, outline=seen.outline[0], velocity_seen=float(seen.velocity_ratio[0]) * speed)


@dataclass(frozen=True)
class _Everywhere(Domain):
    """All shapes that a channel can hold."""

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return (1e-6, 10.0), (1e-3, 10.0)

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        return np.isfinite(np.asarray(capillary_number) + np.asarray(size_ratio))


@dataclass(frozen=True, eq=False)
class _OneCapsule(ForwardModel):
    """Simulated shape and velocity of one capsule; no other was simulated."""

    capsule: Capsule
    velocity_ratio: float
    name: str = field(default="one simulated capsule", init=False)
    sha256: str = field(default="0", init=False)
    domain: Domain = field(default=_Everywhere(), init=False)

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        self.check_names(theta)
        capsule = self.capsule
        for name in ("capillary_number", "size_ratio"):
            asked, known = float(theta[name][0]), getattr(capsule, name)
            if not np.isclose(asked, known, rtol=1e-9):
                expected = "an effect on the picture or the velocity of a capsule"
                got = f"one for which it would be simulated at another {name}, {asked:.4g} in place of {known:.4g}"
                raise InputError("hide", "effect", expected, got)
        shape = Profile.from_outline(capsule.outline)
        one = np.ones(1)
        return Prediction(
            axial_extent=shape.axial_extent * one,
            axial_length=shape.axial_length * one,
            velocity_ratio=self.velocity_ratio * one,
            stretch_ratio=shape.stretch_ratio(capsule.size_ratio) * one,
            covariance=np.zeros((1, 3, 3)),
            inside=np.ones(1, bool),
            outline=capsule.outline[None] if outline else None,
        )
