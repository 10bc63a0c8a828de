"""Compare two effects of the membrane computed together with their sum.

Run ``python -m evidence.benchmarks.membrane_effects``. To the mid-plane outline of each capsule of
``data/pools/membrane-pairs.npz``, and of those of ``membrane-capsules.npz`` for which both ways differ most, a model
fits Ca and a/l at the true sizes of the effects as in a diagnosis, with the noise of the exam: 0.01 l, correlated along
the outline.

``--write`` renews ``evidence/results/membrane-effects.json`` and the table in ``evidence/results/diagnosis.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import Experiment, MeasuredOutline, Measurement, OutlineNoise, Session, Surrogate
from capsbayes.arrays import Floats
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import whitening
from capsbayes.diagnosis.search import Comparison
from capsbayes.effects import SIMULATED
from capsbayes.errors import InputError
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES
from capsbayes.model import ForwardModel
from capsbayes.parameters import OF_THE_MEMBRANE
from capsbayes.prediction import Prediction
from evidence.benchmarks import membrane_pools
from evidence.benchmarks.stored import Stored, with_write
from evidence.markdown import table

VISCOSITY, HALF_WIDTH, VELOCITY = 0.8, 25e-6, 4e-3  # SI, the last one that of the undisturbed flow
NOISE, LENGTH_ERROR, EVERY = OutlineNoise(0.01, 0.2), 0.014, 4
MOST_DIFFERENT = 40
NUMBERS = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio")
INDEX = {name: place for place, name in enumerate(FREE_PARAMETERS)}
WAYS = ("added up", "together")
ALL_FOUR = "all four"
HEAD = (
    *("effects", "capsules", "ln G_s off, rms: added up", "together", "largest: added up", "together"),
    *("over its standard error, rms: added up", "together", "outline off, median, l/1000: added up", "together"),
)


class AddedUp(ForwardModel):
    """Model with effects, named by their parameters and each computed alone, whose changes are added up."""

    def __init__(self, plain: ForwardModel, effects: tuple[str, ...]) -> None:
        self.plain, self.effects = plain, effects
        self.name, self.sha256 = plain.name, plain.sha256
        self.domain, self.cross_section = plain.domain, plain.cross_section

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        flow = {name: theta[name] for name in FREE_PARAMETERS[:2]}
        found = without = self.plain(flow, outline=outline)
        for name in self.effects:
            alone = (self.plain + SIMULATED[name])(flow | {name: theta[name]}, outline=outline)
            changed = {key: getattr(found, key) + getattr(alone, key) - getattr(without, key) for key in NUMBERS}
            if found.outline is not None:
                changed["outline"] = found.outline + alone.outline - without.outline
            found = replace(found, **changed, inside=found.inside & alone.inside)
        return found


@cache
def models(names: tuple[str, ...]) -> dict[str, ForwardModel]:
    """Return the models with some effects in either of the `WAYS`."""
    plain = Surrogate.open("square-neo-hookean")
    together: ForwardModel = plain
    for name in names:
        together = together + SIMULATED[name]
    return {"added up": AddedUp(plain, names), "together": together}


def session_of(numbers: Floats, outline: Floats) -> Session:
    """Return a session of one capsule, measured without errors."""
    velocity = VELOCITY * float(numbers[2])
    seen = Measurement(
        axial_extent=float(numbers[0]),
        axial_extent_error=LENGTH_ERROR,
        axial_length=float(min(numbers[1], numbers[0])),
        axial_length_error=LENGTH_ERROR,
        capsule_velocity=velocity,
        capsule_velocity_error=0.01 * velocity,
        outline=MeasuredOutline(outline[::EVERY], NOISE),
    )
    return Session([seen], Experiment(cross_section="square", half_width=HALF_WIDTH, viscosity=VISCOSITY))


def errors(values: Floats, numbers: Floats, outline: Floats) -> dict[str, list[float]] | None:
    """Return by way how far ln G_s is off, its standard error, and the distance of the outlines [l] of one capsule.

    None where the effects are not known together, or a model has no such shape.
    """
    names = tuple(name for name in OF_THE_MEMBRANE if values[INDEX[name]] != NULL_VALUES[INDEX[name]])
    session, sizes = session_of(numbers, outline), {name: float(values[INDEX[name]]) for name in names}
    held = {way: model.fixed(**sizes) for way, model in models(names).items()}
    try:
        white = whitening(held["together"], session)
    except InputError:
        return None
    found = {}
    for way, model in held.items():
        fits = fitted(model, session, white)
        compared = Comparison(session, model, fits)
        if not fits.settled[0] or (way == "together" and compared.added_up):
            return None
        off = float(fits.log_modulus[0] - np.log(VISCOSITY * VELOCITY / values[0]))
        found[way] = [off, float(np.sqrt(fits.covariance[0, 0, 0])), compared.gap / HALF_WIDTH]
    return found


def rows() -> dict[str, dict[str, Any]]:
    """Return the numbers of the table, by the effects of a row."""
    pairs = membrane_pools.stored("pairs")
    kinds: dict[str, list[int]] = {
        f"{SIMULATED[one].name}, {SIMULATED[other].name}": [
            row
            for row, values in enumerate(pairs["values"])
            if values[INDEX[one]] != NULL_VALUES[INDEX[one]] and values[INDEX[other]] != NULL_VALUES[INDEX[other]]
        ]
        for one, other in combinations(OF_THE_MEMBRANE, 2)
    }
    counts = {name: counted(pairs, chosen) for name, chosen in kinds.items()}
    capsules = membrane_pools.stored("capsules")
    return counts | {f"{ALL_FOUR}, the {MOST_DIFFERENT} most different": counted(capsules, most_different(capsules))}


def most_different(pool: dict[str, Floats]) -> list[int]:
    """Return the rows of a pool at which the two ways predict the most different outlines."""
    theta = dict(zip(FREE_PARAMETERS, pool["values"].T, strict=True))
    shapes = [model(theta, outline=True).outline for model in models(OF_THE_MEMBRANE).values()]
    apart = np.sqrt(np.mean(np.sum((shapes[0] - shapes[1]) ** 2, axis=-1), axis=-1))
    return [int(row) for row in np.argsort(-np.nan_to_num(apart))[:MOST_DIFFERENT]]


def counted(pool: dict[str, Floats], chosen: list[int]) -> dict[str, Any]:
    """Return what a row of the table states of the chosen capsules of a pool."""
    of_each = [errors(*(pool[key][row] for key in ("values", "numbers", "profile"))) for row in chosen]
    compared = [capsule for capsule in of_each if capsule is not None]
    counts: dict[str, Any] = {"capsules": len(compared), "of": len(chosen)}
    for way in WAYS:
        off, error, gap = np.array([capsule[way] for capsule in compared]).T
        counts[way] = {
            "rms": float(np.sqrt(np.mean(off**2))),
            "largest": float(np.abs(off).max()),
            "score": float(np.sqrt(np.mean((off / error) ** 2))),
            "gap": float(np.median(gap)),
        }
    return counts


def tables(found: dict[str, dict[str, Any]]) -> dict[str, str]:
    """Return the table, a row for each pair of effects, and one for all four."""
    lines = []
    for name, counts in found.items():
        cells = [name, f"{counts['capsules']} of {counts['of']}"]
        for key, scale in (("rms", 1.0), ("largest", 1.0), ("score", 1.0), ("gap", 1e3)):
            cells += [f"{scale * counts[way][key]:.2g}" for way in WAYS]
        lines.append(cells)
    return {"two effects": table(HEAD, lines)}


STORED = Stored("membrane-effects.json", "evidence/results/diagnosis.md", tables)


def main() -> None:
    given = with_write(__doc__).parse_args()
    with threadpool_limits(limits=1):
        found = rows()
    STORED.show(found, write=given.write)


if __name__ == "__main__":
    main()
