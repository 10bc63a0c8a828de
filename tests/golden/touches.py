"""All that the tool knows of the package besides its public names and its command line.

If something here was renamed or moved, mend it here; the keys of the record stay as they are.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

COMMAND = [sys.executable, "-c", "import sys; sys.argv[0] = 'capsbayes'; from capsbayes.cli import main; main()"]

COMMANDS = (
    *("simulate", "build", "rebuild", "validate", "measure", "identify", "batch", "population", "diagnose", "report"),
    *("atlas", "transient", "verify", "hide", "exam", "sensitivity"),
    *("sensitivity budget", "sensitivity flow", "sensitivity map", "sensitivity sobol"),
)

PREDICTED = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio", "covariance", "inside", "outline")
PART = ".part"  # ending of the files of finished cases of a build
CIRCUMSTANCES = {"half_width": 25e-6, "capsule_velocity": 5e-3, "viscosity": 0.8, "mean_velocity": 4e-3}


def mistake() -> type[Exception]:
    """What the package raises where a user's input cannot be used."""
    from capsbayes.errors import CapsbayesError

    return CapsbayesError


def effects(section: str = "square") -> dict[str, Any]:
    """Every effect of the catalogue by the name of its parameter."""
    from capsbayes.effects import catalogue

    return dict(catalogue(section))


def size_of(effect: Any, share: float) -> float:
    """A size of an effect: that below which a share of its prior lies."""
    return float(effect.prior.ppf(share))


def coordinate_of(model: Any) -> tuple[str, tuple[float, float]] | None:
    """Name and range of the further coordinate of a model."""
    name = getattr(model, "coordinate", None)
    return None if name is None else (str(name), model.coordinate_range)


def fixed(model: Any, value: float) -> Any:
    """A model with a further coordinate, held at a value of it."""
    return model.fixed(value)


def predicted(model: Any, theta: Mapping[str, Any], *, outline: bool = False) -> dict[str, Any]:
    """What a model predicts, by name."""
    theta = {name: np.asarray(values, dtype=np.float64) for name, values in theta.items()}
    seen = model(theta, outline=outline)
    return {name: getattr(seen, name) for name in PREDICTED if getattr(seen, name) is not None}


def beside(model: Any, theta: Mapping[str, Any]) -> dict[str, Any]:
    """What else a model says: its doubts, its slopes, its own error of an outline."""
    found: dict[str, Any] = {"doubts": model.doubts(theta)}
    if hasattr(model, "gradient"):
        found["gradient"] = model.gradient(**{name: theta[name] for name in ("capillary_number", "size_ratio")})
    return found


def modes(model: Any, theta: Mapping[str, float]) -> Any:
    """A model's own error of the outline at one point, or why it has no answer there."""
    try:
        return model.outline_modes(**theta)
    except mistake() as error:
        return str(error)


def of_posterior(posterior: Any) -> dict[str, Any]:
    """All that a posterior holds: its summary, and digests of its draws and outlines."""
    from values import digest

    found: dict[str, Any] = {
        "said": posterior.as_dict(),
    }
    found["draws"] = {name: digest(values, 6) for name, values in posterior.draws.items()}
    if posterior.outlines is not None:
        found["outlines"] = digest(posterior.outlines, 12)
    return found


class Held:
    """A model with an effect of one size, as one's own forward model."""

    def __init__(self, model: Any, effect: Any, size: float) -> None:
        self._model = model + effect
        self._known = {effect.parameter.name: size}
        self._known |= {name: CIRCUMSTANCES[name] for name in effect.circumstances}
        self.name, self.sha256, self.domain = f"{self._model.name} held", self._model.sha256, self._model.domain
        self.view = self._model.view

    def __call__(self, theta: Mapping[str, Any], *, outline: bool = False) -> Any:
        """Predict a batch with the effect."""
        count = len(theta["capillary_number"])
        return self._model({**theta, **{k: np.full(count, v) for k, v in self._known.items()}}, outline=outline)

    def doubts(self, theta: Mapping[str, Any]) -> dict[str, Any]:
        """Those of the model."""
        return dict(self._model.doubts(theta))

    def outline_modes(self, **theta: float) -> Any:
        """Those of the model with the effect."""
        return self._model.outline_modes(**{**theta, **self._known})
