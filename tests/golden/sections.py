"""The sections of a record: for each a function that yields keys and how to make what they stand for."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import inputs
import numpy as np
import touches
from commands import Desk
from environment import REPOSITORY
from identified import identify
from killed import build
from values import of_netcdf
from words import words

Items = Iterator[tuple[str, Callable[[], Any]]]

_PLACES = {
    "capillary_number": [0.004, 0.01, 0.02, 0.03, 0.05, 0.05, 0.06, 0.08, 0.09, 0.1, 0.12, 0.14, 0.3],
    "size_ratio": [0.72, 0.85, 0.9, 1.05, 0.8, 0.9, 1.12, 0.96, 1.0, 0.85, 0.9, 0.78, 0.9],
}


def models(work: Path) -> Items:
    """Predictions of every shipped database and of every effect."""
    del work
    for path in sorted((REPOSITORY / "data" / "databases").glob("*.nc")):
        yield f"{path.stem}", functools.partial(_database, path.stem, "section")
        if path.stem in ("square-neo-hookean", "circular-skalak", "square-rest-aspect"):
            yield f"{path.stem} silhouettes", functools.partial(_database, path.stem, "silhouette")
    for name in touches.effects():
        yield f"effect {name}", functools.partial(_effect, name)


def _database(name: str, view: str) -> dict[str, Any]:
    import capsbayes as cb

    model = cb.Surrogate.open(name, view=touches.view_named(view))
    places = {key: np.array(values) for key, values in _PLACES.items()}
    one = {"capillary_number": 0.06, "size_ratio": 0.9}
    found = {"name": model.name, "sha256": model.sha256}
    further = touches.coordinate_of(model)
    if further is None:
        said = touches.predicted(model, places, outline=True) | touches.beside(model, places)
        return found | said | {"modes": touches.modes(model, one)}
    coordinate, (low, high) = further
    for share in (0.0, 0.35, 0.9):
        value = low + share * (high - low)
        theta = places | {coordinate: np.full(len(places["size_ratio"]), value)}
        found[f"at {share}"] = touches.predicted(model, theta, outline=True)
        found[f"fixed at {share}"] = touches.predicted(touches.fixed(model, value), places)
    found["modes"] = touches.modes(model, one | {coordinate: low + 0.35 * (high - low)})
    return found


def _effect(name: str) -> dict[str, Any]:
    import capsbayes as cb

    effect = touches.effects()[name]
    found: dict[str, Any] = {"changes": effect.changes, "separated_by": effect.separated_by, "name": effect.name}
    model = cb.Surrogate.open("square-neo-hookean") + effect
    places = {key: np.array(values) for key, values in _PLACES.items()}
    for share in (0.3, 0.8):
        size = touches.size_of(effect, share)
        known = {one: touches.CIRCUMSTANCES[one] for one in effect.circumstances} | {name: size}
        theta = places | {one: np.full(len(places["size_ratio"]), value) for one, value in known.items()}
        found[f"at {share}"] = {"size": size} | touches.predicted(model, theta, outline=True)
    return found


def batch(work: Path) -> Items:
    """500 rows of a table, and what the capsules have in common."""
    desk = Desk(work)
    inputs.experiment_file(desk.folder / "experiment.toml")
    inputs.table_file(desk.folder / "capsules.csv", 500, seed=1)
    options = ("--experiment", "experiment.toml", "--workers", "1", "--check", "0.02", "--json")
    yield "batch", lambda: desk.run("batch", "capsules.csv", "--out", "run.nc", *options, keep=())
    yield "rows", lambda: of_netcdf(desk.folder / "run.nc", whole=40_000)
    yield "population", lambda: desk.run("population", "run.nc", "--json", keep=())
    cut = ("--least-stretch", "1.04", "--velocity-error", "0.5 %")
    yield "population with a cut", lambda: desk.run("population", "run.nc", *cut, "--json", keep=())


def exam(work: Path) -> Items:
    """The first session of each cell, diagnosed."""
    desk, pools = Desk(work), str(REPOSITORY / "data" / "pools")

    def page() -> dict[str, Any]:
        desk.run("exam", "--out", "exam", "--pools", pools, "--sessions", "1", "--workers", "1", keep=())
        return {"page": desk.cleaned((desk.folder / "exam" / "exam.md").read_text())}

    yield "page", page
    for path in sorted((desk.folder / "exam").rglob("*.jsonl")):
        yield path.stem, functools.partial(_answers, path)


def _answers(path: Path) -> list[dict[str, Any]]:
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


_SLOWEST = "transients"


def verify(work: Path) -> Items:
    """The sections of the verification page but the slowest, whose names the refusal of a wrong one tells."""
    desk = Desk(work)
    refused = desk.run("verify", "--out", "verify", "--only", "?", keep=())
    told = refused["stderr"].split("one of ")[1].split(", got")[0]
    for name in (one.strip() for one in told.split(",")):
        if name != _SLOWEST:
            yield name, functools.partial(_verified, desk, name)
    page = desk.folder / "verify" / "verification.md"
    yield "page", lambda: desk.cleaned(page.read_text())


def transients(work: Path) -> Items:
    """The slowest section of the verification page."""
    yield _SLOWEST, functools.partial(_verified, Desk(work), _SLOWEST)


def _verified(desk: Desk, name: str) -> dict[str, Any]:
    said = desk.run("verify", "--out", "verify", "--only", name, keep=())
    results = touches.verified(desk.folder / "verify", name)
    return {"status": said["status"], "stdout": said["stdout"], "results": _untimed(results)}


def _untimed(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _untimed(one) for name, one in value.items() if "seconds" not in name}
    return [_untimed(one) for one in value] if isinstance(value, list) else value


SECTIONS: dict[str, Callable[[Path], Items]] = {
    "models": models,
    "identify": identify,
    "batch": batch,
    "words": words,
    "build": build,
    "exam": exam,
    "verify": verify,
    "transients": transients,
}
