"""Posteriors of capsules of all kinds, by quadrature and for some by emcee."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import inputs
import touches
from environment import REPOSITORY

ENGINES = ("quadrature", "emcee")

_OF_EFFECTS = {  # of each effect database a value that is not the usual one, of which a case is seen
    "square-bending": 1e-3,
    "square-corner-radius": 0.1,
    "square-hardening": 3.0,
    "square-pre-inflation": 0.025,
    "square-rest-aspect": 1.05,
    "square-section-aspect": 0.95,
    "square-strain-hardening": 0.5,
    "square-unsteadiness": 1.0,
    "circular-pre-inflation": 0.025,
}


@dataclass(frozen=True)
class Case:
    """A capsule and the model it is identified with."""

    key: str
    seen: tuple[Any, ...]  # database, Ca, a/l, and for some the value of the effect, of the shape that is seen
    database: str = ""  # with which it is identified; by default the one that is seen
    view: str | None = None  # of its outline; None for lengths alone
    length: bool = True  # whether L_a was measured
    held: float | None = None  # value of the further coordinate of the database
    effect: tuple[str, float] | None = None  # that the model is given, and the share of its prior below its size
    exact: bool = False  # whether the experiment is known without error
    error: float = inputs.ERROR  # of the lengths, over l
    metres: bool = False  # whether the lengths are in metres
    emcee: bool = False  # whether it is sampled with emcee as well, which takes a hundred times as long


def _cases() -> list[Case]:
    plain, tube = "square-neo-hookean", "circular-neo-hookean"
    places = ((0.05, 0.9), (0.08, 0.8), (0.1, 0.95), (0.03, 1.0), (0.06, 1.1), (0.12, 0.75))
    cases = [Case(f"lengths at {ca}, {size}", (plain, ca, size), emcee=ca in (0.08, 0.1)) for ca, size in places]
    cases += [
        Case(f"L_z alone at {ca}, {size}", (plain, ca, size), length=False, emcee=ca == 0.03)
        for ca, size in ((0.05, 0.9), (0.09, 1.0), (0.03, 0.8))
    ]
    cases += [
        Case(f"outline at {ca}, {size}", (plain, ca, size), view="section", emcee=ca == 0.05)
        for ca, size in ((0.05, 0.9), (0.1, 0.85), (0.03, 1.0))
    ]
    cases += [
        Case(f"silhouette at {ca}, {size}", (plain, ca, size), view="silhouette", emcee=ca == 0.05)
        for ca, size in ((0.05, 0.9), (0.09, 0.95))
    ]
    cases += [
        Case("silhouette without L_a", (plain, 0.06, 1.05), view="silhouette", length=False),
        Case("Skalak", ("square-skalak", 0.1, 0.9), emcee=True),
        Case("Hooke", ("square-hooke", 0.05, 1.0)),
        Case("another law seen", ("square-skalak", 0.1, 0.9), database=plain),
        Case("tube, lengths", (tube, 0.05, 0.9), emcee=True),
        Case("tube, L_z alone", (tube, 0.03, 0.8), length=False),
        Case("tube, Skalak", ("circular-skalak", 0.1, 1.0)),
        Case("tube, Hooke", ("circular-hooke", 0.05, 0.9)),
        Case("tube, silhouette", ("circular-skalak", 0.08, 0.9), view="silhouette"),
    ]
    cases += [
        Case(f"lengths, {name}", (name, 0.06, 0.9, value), emcee="inflation" in name)
        for name, value in _OF_EFFECTS.items()
    ]
    cases += [
        Case("outline, square-rest-aspect", ("square-rest-aspect", 0.06, 0.9, 1.05), view="section"),
        Case("lengths, inflation held", ("square-pre-inflation", 0.06, 0.9, 0.025), held=0.025),
        Case("outline, inflation held", ("square-pre-inflation", 0.06, 0.9, 0.025), held=0.025, view="section"),
        Case("lengths with pixel_scale", (plain, 0.06, 0.9), effect=("pixel_scale", 0.9), emcee=True),
        Case("outline with halo", (plain, 0.06, 0.9), effect=("halo", 0.7), view="section"),
        Case("lengths with exposure", (plain, 0.06, 0.9), effect=("exposure", 0.7)),
        Case("lengths with swelling", (plain, 0.06, 0.9), effect=("swelling", 0.7)),
        Case("outline with bending", (plain, 0.06, 0.9), effect=("bending", 0.7), view="section"),
        Case("next to the limit of existence", (plain, 0.2, 0.9), emcee=True),
        Case("next to the limit of existence, L_z alone", (plain, 0.2, 1.0), length=False),
        Case("where two shapes are stable", (plain, 0.01, 0.85), emcee=True),
        Case("where two shapes are stable, outline", (plain, 0.012, 0.9), view="section"),
        Case("lowest Ca, smallest capsule", (plain, 0.003, 0.7)),
        Case("largest capsule", (plain, 0.05, 1.15)),
        Case("wrinkles in a tube", (tube, 0.08, 1.1)),
        Case("outside", ("circular-skalak", 0.3, 1.15), database=plain),
        Case("lengths in metres", (plain, 0.06, 0.9), metres=True, emcee=True),
        Case("experiment without error", (plain, 0.06, 0.9), exact=True, emcee=True),
        Case("wide errors", (plain, 0.06, 0.9), error=0.05),
        Case("narrow errors", (plain, 0.06, 0.9), error=0.002),
    ]
    return cases


def identify(work: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Each capsule by its engines."""
    for number, one in enumerate(_cases()):
        for engine in ENGINES[: 1 + one.emcee]:
            yield f"{one.key}, {engine}", functools.partial(_identified, one, number, engine, work)
    for file in ("ovalbumin/capsule.toml", "drifting_modulus/capsules/capsule-001.toml"):
        for engine in ENGINES:
            yield f"{file}, {engine}", functools.partial(_example, REPOSITORY / "examples" / file, engine)


def _identified(one: Case, number: int, engine: str, work: Path) -> dict[str, Any]:
    database = one.database or one.seen[0]
    section = database.partition("-")[0]
    file = inputs.experiment_file(work / f"{number}.experiment.toml", section=section, exact=one.exact)
    shape = inputs.case(*one.seen)
    options = {"length": one.length, "view": one.view, "error": one.error, "metres": one.metres}
    capsule = inputs.capsule_file(work / f"{number}.toml", shape, seed=number, experiment=file, **options)
    return _posterior(_model(database, one.view or "section", one.held, one.effect), capsule, file, engine)


def _example(capsule: Path, engine: str) -> dict[str, Any]:
    model = _model("square-neo-hookean", "section", None, None)
    return _posterior(model, capsule, capsule.parent / "experiment.toml", engine)


def _posterior(model: Any, capsule: Path, experiment: Path, engine: str) -> dict[str, Any]:
    """All of a posterior, or the mistake or the crash that it ended with."""
    import capsbayes as cb

    seen, known = cb.Measurement.read(capsule), cb.Experiment.read(experiment)
    try:
        posterior = cb.identify(seen, model, known, engine=engine, seed=1)
        shown = repr(posterior).replace(f"{capsule.parent}/", "")
        return touches.of_posterior(posterior) | {"repr": shown, "table": posterior.summary().to_string()}
    except touches.mistake() as error:
        return {"mistake": str(error).replace(str(capsule.parent), "<folder>")}
    except Exception as error:
        return {"crash": f"{type(error).__name__}: {error}"}


@functools.lru_cache(maxsize=2)
def _model(database: str, view: str, held: float | None, effect: tuple[str, float] | None) -> Any:
    import capsbayes as cb

    model = cb.Surrogate.open(database, view=touches.view_named(view))
    if held is not None:
        return touches.fixed(model, held)
    if effect is not None:
        added = touches.effects()[effect[0]]
        return touches.with_known_effect(model, added, touches.size_of(added, effect[1]))
    return model
