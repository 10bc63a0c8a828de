"""The exam: many hidden sessions diagnosed, and the table of the answers."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import lru_cache, partial
from pathlib import Path

from capsbayes.database import Database
from capsbayes.hidden.answer import Answer, answered
from capsbayes.hidden.cells import Cell
from capsbayes.hidden.pools import pool_name
from capsbayes.output_file import replaced
from capsbayes.simulation.workers import computed
from capsbayes.surrogate import Surrogate

__all__ = ["Answers", "examine"]

Answers = dict[str, dict[int, Answer]]
"""By name of the cell and seed."""


def examine(
    cells: Sequence[Cell],
    pools: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    workers: int | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> Answers:
    """Diagnose every session of the cells that has no answer yet.

    The answers of a cell are kept in one file in `out`; each is added as soon as a handful more is known, so that
    the same call made again goes on where it was.

    Parameters
    ----------
    cells : sequence of Cell
    pools : path
        Folder of the databases of shapes, see `build_pools`.
    out : path
        Folder of the answers.
    workers : int, optional
        Number of worker processes; by default, one for each core.
    tell : callable
        Is told each handful that begins.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    found = {cell.name: _read(folder / _file(cell)) for cell in cells}
    for cell in cells:
        missing = [seed for seed in range(1, cell.sessions + 1) if seed not in found[cell.name]]
        for start in range(0, len(missing), _HANDFUL):
            seeds = missing[start : start + _HANDFUL]
            tell(f"{cell.name}: sessions {seeds[0]} to {seeds[-1]} of {cell.sessions}")
            tasks = [partial(_one, cell, seed, os.fspath(pools)) for seed in seeds]
            found[cell.name] |= dict(zip(seeds, computed(tasks, None, workers), strict=True))
            _write(folder / _file(cell), found[cell.name])
    return found


_HANDFUL = 24


def _one(cell: Cell, seed: int, pools: str) -> Answer:
    return answered(cell, seed, _shapes(pools, *cell.shapes), _model())


@lru_cache(maxsize=4)
def _shapes(pools: str, effect: str, size: float) -> Database:
    return Database.read(Path(pools) / f"{pool_name(effect, size)}.nc")


@lru_cache(maxsize=1)
def _model() -> Surrogate:
    model = Surrogate.open("square-neo-hookean")
    assert isinstance(model, Surrogate), "a plain database"
    return model


def _file(cell: Cell) -> str:
    words = "".join(letter if letter.isalnum() or letter in ".+" else "-" for letter in cell.name)
    return f"{words}.json"


def _read(path: Path) -> dict[int, Answer]:
    if not path.exists():
        return {}
    return {int(seed): Answer(**values) for seed, values in json.loads(path.read_text(encoding="utf-8")).items()}


def _write(path: Path, answers: dict[int, Answer]) -> None:
    told = {str(seed): asdict(answer) for seed, answer in sorted(answers.items())}
    replaced(path, json.dumps(told, indent=1) + "\n")
