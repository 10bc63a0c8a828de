"""All that the tool knows of the package besides its public names and its command line.

If something here was renamed or moved, mend it here; the keys of the record stay as they are.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

COMMAND = [sys.executable, "-c", "import sys; sys.argv[0] = 'capsbayes'; from capsbayes.cli import main; main()"]

_MOVED = {"exam": "exam", "verify": "verification", "rebuild": "rebuild"}  # run as ``python -m evidence.NAME``


def command_line(arguments: Sequence[str]) -> list[str]:
    """Return the words that run a command with its arguments."""
    if arguments and arguments[0] in _MOVED:
        return [sys.executable, "-m", f"evidence.{_MOVED[arguments[0]]}", *arguments[1:]]
    return [*COMMAND, *arguments]


COMMANDS = (
    *("simulate", "build", "validate", "measure", "identify", "batch", "population", "diagnose", "report"),
    *("atlas", "transient", "hide", "sensitivity"),
    *("sensitivity budget", "sensitivity flow", "sensitivity map", "sensitivity sobol"),
)

PREDICTED = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio", "covariance", "inside", "outline")
PART = ".part"  # ending of the files of finished cases of a build
CIRCUMSTANCES = {
    "half_width": 25e-6,
    "capsule_velocity": 5e-3,
    "viscosity": 0.8,
    "mean_velocity": 4e-3,
    "flow_rate": 1e-11,
}


def mistake() -> type[Exception]:
    """What the package raises where a user's input cannot be used."""
    from capsbayes.errors import CapsbayesError

    return CapsbayesError


def effects(section: str = "square") -> dict[str, Any]:
    """Every effect of the catalogue by the name of its parameter."""
    from capsbayes.effects import catalogue

    return dict(catalogue(section))


def verified(folder: Path, topic: str) -> dict[str, Any]:
    """Return the stored outcomes of a topic of the verification, by item."""
    rows = [json.loads(line) for line in (folder / "results.jsonl").read_text().splitlines()]
    return {row.pop("item"): row for row in rows if row.pop("topic") == topic}


def size_of(effect: Any, share: float) -> float:
    """A size of an effect: that below which a share of its prior lies."""
    return float(effect.prior.ppf(share))


def coordinate_of(model: Any) -> tuple[str, tuple[float, float]] | None:
    """Return the name and the range of the further coordinate of a model."""
    for name, ends in model.coordinates.items():
        return name, (ends.low, ends.high)
    return None


def fixed(model: Any, value: float) -> Any:
    """Return a model with a known value of its further coordinate."""
    return model.fixed(**{next(iter(model.coordinates)): value})


def view_named(view: str) -> str:
    """Return the word of the package for a view of the record."""
    return {"section": "mid-plane"}.get(view, view)


def predicted(model: Any, theta: Mapping[str, Any], *, outline: bool = False) -> dict[str, Any]:
    """What a model predicts, by name."""
    theta = {name: np.asarray(values, dtype=np.float64) for name, values in theta.items()}
    seen = model(theta, outline=outline)
    return {name: getattr(seen, name) for name in PREDICTED if getattr(seen, name) is not None}


def beside(model: Any, theta: Mapping[str, Any]) -> dict[str, Any]:
    """What else a model says: its doubts, its slopes, its own error of an outline."""
    found: dict[str, Any] = {"doubts": model.caveats(theta)}
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

    draws = {name: digest(values, 6) for name, values in posterior.draws.items()}
    found: dict[str, Any] = {"said": posterior.as_dict(), "draws": draws}
    if posterior.outlines is not None:
        found["outlines"] = digest(posterior.outlines, 12)
    return found


def with_known_effect(model: Any, effect: Any, size: float) -> Any:
    """Return a model with an effect of known size under the circumstances of the record."""
    from capsbayes.model import ForwardModel

    extended = model + effect
    known = {effect.parameter.name: size, **{name: CIRCUMSTANCES[name] for name in effect.circumstances}}

    class Held(ForwardModel):
        name, sha256, domain = f"{extended.name} held", extended.sha256, extended.domain
        cross_section, view = extended.cross_section, extended.view

        def __call__(self, theta: Mapping[str, Any], *, outline: bool = False) -> Any:
            count = len(theta["capillary_number"])
            return extended({**theta, **{k: np.full(count, v) for k, v in known.items()}}, outline=outline)

        def caveats(self, theta: Mapping[str, Any]) -> dict[str, Any]:
            return dict(extended.caveats(theta))

        def outline_modes(self, **theta: float) -> Any:
            return extended.outline_modes(**{**theta, **known})

    return Held()
