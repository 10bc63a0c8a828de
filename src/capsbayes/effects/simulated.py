"""Effects that were simulated, of the membrane several together, and the catalogue of all effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.database import Database
from capsbayes.effects.analytic import ANALYTIC
from capsbayes.membrane_database import MembraneDatabase
from capsbayes.model import Effect, ForwardModel, Kind, Theta
from capsbayes.parameters import OF_THE_MEMBRANE, PARAMETERS, Parameter
from capsbayes.prediction import NUMBERS, Prediction
from capsbayes.quantity import Quantity
from capsbayes.surrogate.open import joint_surrogate, plain_membrane


@dataclass(frozen=True)
class Simulated:
    """Effect of a parameter of the simulator whose value is not that of the model; see `capsbayes.model.Effect`."""

    name: str
    coordinate: str  # name of the parameter
    null_value: float
    prior: Quantity  # uniform or log-uniform over the range of the database
    kind: Kind
    changes: str = field(repr=False)  # the fingerprint of a model with the effect does not depend on the prose
    separated_by: str = field(repr=False)
    makes: tuple[str, str] = field(default=("", ""), repr=False)  # the membrane, with a size below and above the null
    circumstances: ClassVar[tuple[str, ...]] = ()

    @property
    def database(self) -> str:
        """Name of its database, which comes with the library."""
        return f"square-{self.coordinate.replace('_', '-')}"

    @property
    def of_membrane(self) -> bool:
        """Whether the states scattered over the membrane have the parameter too, together with others."""
        return self.coordinate in OF_THE_MEMBRANE

    @property
    def parameter(self) -> Parameter:
        """Parameter of the simulator."""
        return PARAMETERS[self.coordinate]

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict capsules of a model with another value of the parameter."""
        # A plain surrogate becomes the base of the joint surrogate, so that the limits of existence move with the
        # effect as well, and several effects of the membrane are computed together. To any other model the difference
        # from the null value is added, and both must have an answer.
        joint = self._joined(model)
        if joint is not None:
            return joint(theta, outline=outline)
        simulated = self._alone(model)
        seen = model(theta, outline=outline)
        known = {name: theta[name] for name in self._read}
        with_it = simulated(known, outline=outline)
        null = simulated({**known, self.coordinate: np.full(len(seen), self.null_value)}, outline=outline)
        both = seen.inside & with_it.inside & null.inside
        unknown = np.where(both, 0.0, np.nan)
        changed = theta[self.coordinate] != self.null_value
        moved = None
        if seen.outline is not None and with_it.outline is not None and null.outline is not None:
            moved = seen.outline + (with_it.outline - null.outline)
        each = {name: [getattr(prediction, name) for prediction in (seen, with_it, null)] for name in NUMBERS}
        return replace(
            seen,
            **{name: plain + (there - here) + unknown for name, (plain, there, here) in each.items()},
            covariance=seen.covariance + np.where(changed[:, None, None], with_it.covariance, 0.0),
            inside=both,
            outline=moved,
        )

    def outline_modes(self, model: ForwardModel, theta: Mapping[str, float]) -> Floats | None:
        """Return the own error of the outline at one point: that of the model and that of the slices."""
        joint = self._joined(model)
        if joint is not None:
            return joint.outline_modes(**theta)
        simulated = self._alone(model)
        own = simulated.outline_modes(**{name: theta[name] for name in self._read})
        inner = model.outline_modes(**theta)
        return own if inner is None else np.concatenate([inner, own])

    @property
    def _read(self) -> tuple[str, str, str]:
        return "capillary_number", "size_ratio", self.coordinate

    def _joined(self, model: ForwardModel) -> ForwardModel | None:
        """Return the model with the parameter as a further coordinate; None if it cannot be the base."""
        if not self.of_membrane:
            return model.joined(self.database)
        joint = model.with_membrane()
        own = self.database.replace("square", str(model.cross_section))
        return model.joined(own) if joint is None and own in Database.shipped() else joint

    def _alone(self, model: ForwardModel) -> ForwardModel:
        """Return the surrogate over the parameter that is added to a model: of plain capsules."""
        if self.of_membrane:
            return plain_membrane(model.cross_section or "square", model.view)
        return joint_surrogate(self.database, None, model.view)

    def in_words(self, size: float) -> str:
        """Return words for the membrane with a size of the effect; empty for effects that are not of the membrane."""
        return self.makes[size > self.null_value]


SIMULATED: Mapping[str, Simulated] = MappingProxyType(
    {
        effect.coordinate: effect
        for effect in (
            Simulated(
                *("pre-inflation", "pre_inflation", 0.0, Quantity.uniform(0.0, 0.1), Kind.SESSION),
                "The rear is less concave, and the apparent G_s too high, at low Ca most.",
                "A second flow rate; the radius of capsules in the liquid in which they were made.",
                ("", "pre-inflated"),
            ),
            Simulated(
                *("bending stiffness", "bending", 2e-4, Quantity.log_uniform(5e-5, 3e-3), Kind.SESSION),
                "The rim of the rear is rounder; little else changes.",
                "The curvature of the rear rim in a sharp picture.",
                ("less stiff in bending", "stiffer in bending"),
            ),
            Simulated(
                *("strain hardening", "strain_hardening", 0.0, Quantity.uniform(0.0, 1.0), Kind.STRAIN),
                "Shorter capsules with a shallower rear at high Ca; the apparent G_s grows with the flow rate.",
                "Higher flow rates, at which a neo-Hookean capsule would stretch without limit.",
                ("", "strain-hardening"),
            ),
            Simulated(
                *("generalised Hooke elasticity", "hooke_share", 0.0, Quantity.uniform(0.0, 1.0), Kind.STRAIN),
                "As strain hardening where the membrane is stretched, and softer where it is pressed together.",
                "Higher flow rates; the folds of a capsule in compression between two plates.",
                ("", "generalised Hooke"),
            ),
            Simulated(
                *("area dilation modulus", "area_dilation_modulus", 3.0, Quantity.log_uniform(1.0, 5.0), Kind.SESSION),
                "The rear is less concave with a larger modulus, more so with a smaller one.",
                "Outlines at low and at high flow rates; the compression of a capsule between two plates.",
                ("less resistant to a change of area", "more resistant to a change of area"),
            ),
            Simulated(
                *("shape at rest", "rest_aspect", 1.0, Quantity.uniform(0.9, 1.1), Kind.SESSION),
                "L_z is larger or smaller at equal Ca.",
                "A picture of the capsules at rest.",
            ),
            Simulated(
                *("rounded corners", "corner_radius", 0.0, Quantity.uniform(0.0, 0.2), Kind.SESSION),
                "Less liquid passes by in the corners: the velocity ratio and the length change together.",
                "A cut through the channel under the microscope.",
            ),
            Simulated(
                *("not yet steady", "unsteadiness", 0.0, Quantity.uniform(0.0, 2.0), Kind.SESSION),
                "The capsule is shorter than in steady state, its rear less concave, and its velocity still changes.",
                "A second window farther downstream.",
            ),
            Simulated(
                *("aspect of the cross-section", "section_aspect", 1.0, Quantity.uniform(0.9, 1.1), Kind.SESSION),
                "The gap along the direction of view differs from that across it.",
                "A cut through the channel, or a view from the side.",
            ),
        )
    }
)
"""Simulated effects by name of the coordinate, of capsules with a neo-Hookean membrane in a square channel."""


def catalogue(cross_section: str = "square") -> dict[str, Effect]:
    """Return the effects that come with the library, for a channel of a cross-section, by name of their parameter.

    Examples
    --------
    >>> sorted(catalogue())[:3]
    ['area_dilation_modulus', 'bending', 'corner_radius']
    """
    # Of the simulated effects, those of the membrane hold in a circular channel too, the others in a square one only.
    effects: list[Effect] = []
    shipped = Database.shipped()
    if cross_section == "square":
        effects += [effect for effect in SIMULATED.values() if effect.of_membrane or effect.database in shipped]
    elif cross_section in MembraneDatabase.shipped():
        effects += [effect for effect in SIMULATED.values() if effect.of_membrane]
    effects += [effect() for effect in ANALYTIC]
    return {effect.parameter.name: effect for effect in effects}
