"""What every forward model promises: parameters in, a `Prediction` out, and a domain it stands for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.measured_outline import SECTION
from capsbayes.prediction import Prediction

__all__ = ["TWO_SHAPES", "WRINKLES", "Domain", "Doubting", "ForwardModel", "outline_modes_of", "view_of"]

TWO_SHAPES = "two shapes"
"""Doubt of a model that answers for capsules started from rest, where another shape is stable too."""

WRINKLES = "wrinkles"
"""Doubt of a model that answers with a smooth shape, where the membrane wrinkles."""


@runtime_checkable
class Domain(Protocol):
    """The set of (Ca, a/l) for which a model has an answer."""

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike) -> NDArray[np.bool_]:
        """Whether each point lies in the domain : (n,) bool array; NaN is outside."""
        ...

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box that holds the domain, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        ...


@runtime_checkable
class ForwardModel(Protocol):
    """A map ``theta -> Prediction``.

    ``theta`` maps names to arrays (n,); the names every model reads are
    ``"capillary_number"`` and ``"size_ratio"`` [-]. Points outside the domain
    come back with ``inside`` False and NaN, never extrapolated and never an
    exception, so that a batch does not stop.
    """

    @property
    def name(self) -> str:
        """What the model is called in results."""
        ...

    @property
    def sha256(self) -> str:
        """Fingerprint of the data behind the model, stored with every result."""
        ...

    @property
    def domain(self) -> Domain:
        """Where the model has an answer."""
        ...

    def __call__(self, theta: Mapping[str, NDArray[np.float64]], *, outline: bool = False) -> Prediction:
        """Predict a batch; outlines only on request, as they cost more than the lengths."""
        ...


@runtime_checkable
class Doubting(Protocol):
    """A forward model that says where its answer does not hold for every capsule."""

    def doubts(self, theta: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.bool_]]:
        """By kind of doubt (TWO_SHAPES, WRINKLES), whether it concerns each point of a batch : (n,) arrays."""
        ...


def view_of(model: ForwardModel) -> str:
    """Which outlines a model predicts, one of `capsbayes.measured_outline.VIEWS`; sections if it does not say."""
    return str(getattr(model, "view", SECTION))


def outline_modes_of(model: ForwardModel, theta: Mapping[str, float]) -> NDArray[np.float64] | None:
    """A model's own error of the outline at one point, as independent displacements along its normals.

    Each is one standard deviation : (k, p) array [l]; None if the model does not say.
    """
    modes = getattr(model, "outline_modes", None)
    return None if modes is None else modes(**theta)
