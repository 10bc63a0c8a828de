"""Pictures that are rotated: the flow is not along their rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.effect import Kind, Theta
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class PictureRotation:
    """Angle between the flow and the rows of the picture, along which lengths and velocities are read.

    An outline is turned, which its own tilt absorbs. The extent along the rows grows, as a rim of the rear moves back;
    the length on the axis is read along a row through the nose.

    Parameters
    ----------
    prior : Quantity
        Of the angle in radians, in either sense.
    """

    prior: Quantity = Quantity.uniform(0.0, 0.1)
    name: ClassVar[str] = "rotation of the picture"
    parameter: ClassVar[Parameter] = PARAMETERS["rotation"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "L_z read along the rows is too large where the rear is broad; outlines are only turned."
    separated_by: ClassVar[str] = "The walls, which are not along the rows of the picture."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Turn what a model predicts."""
        seen = model(theta, outline=True)
        assert seen.outline is not None, "asked for"
        cosine, sine = np.cos(theta["rotation"]), np.sin(theta["rotation"])
        turned = _turned(seen.outline, cosine, sine)
        longer = np.ptp(turned[..., 0], axis=1) - np.ptp(seen.outline[..., 0], axis=1)
        return replace(
            seen,
            axial_extent=seen.axial_extent + longer,
            axial_length=seen.axial_length * cosine,
            velocity_ratio=seen.velocity_ratio * cosine,
            outline=turned if outline else None,
        )


def _turned(outline: Floats, cosine: Floats, sine: Floats) -> Floats:
    """Return outlines (n, p, 2) turned by angles (n,) about the origin."""
    along, across = outline[..., 0], outline[..., 1]
    c, s = cosine[:, None], sine[:, None]
    return np.stack([c * along - s * across, s * along + c * across], axis=-1)
