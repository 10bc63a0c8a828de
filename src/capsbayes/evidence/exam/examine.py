"""Run the exam: diagnose the sessions of all cells, and keep the answers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from capsbayes import __version__
from capsbayes.database import Database
from capsbayes.evidence.blind.pools import read_pool
from capsbayes.evidence.exam.answer import Answer, answer_session
from capsbayes.evidence.exam.cells import HALVES, Cell
from capsbayes.evidence.exam.frozen import code_digest
from capsbayes.files.input_file import parsing
from capsbayes.files.output_file import make_folder
from capsbayes.interruption import keeping
from capsbayes.run import Records, Store, digest_of, only_run, run_tasks, steps_kept
from capsbayes.surrogate import Surrogate

Answers = dict[str, dict[int, Answer]]
"""Answers by name of the cell and seed."""

_APART = 1_000_000  # seeds between the halves


def examine(
    cells: Sequence[Cell],
    pools: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    half: str = "development",
    workers: int | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> Answers:
    """Diagnose every session of a half of the exam that has no answer yet, in rounds over all cells."""
    # The answers of a cell are kept in one file in the folder of the half in `out`, a line each, written as soon as it
    # is known, so that the same call repeated continues where it ended. A session is diagnosed anew if its cell, the
    # shapes or the model have changed since, not if the code of the diagnosis has, which each answer states. `pools` is
    # the folder of the databases of shapes; `tell` is called with a line for each round that begins.
    folder = Path(out) / half
    begin = _APART * HALVES[half]
    make_folder(folder)
    with only_run(folder), keeping(folder):
        code = code_digest()
        works = {cell.name: _work_of(cell, os.fspath(pools)) for cell in cells}
        known = {cell.name: _read(folder, cell, works[cell.name]) for cell in cells}
        for start, end in _rounds(max((cell.sessions for cell in cells), default=0)):
            tasks = [
                partial(_one, cell, begin + seed, os.fspath(pools), _records(folder, cell), works[cell.name], code)
                for seed in range(start, end + 1)
                for cell in cells
                if seed <= cell.sessions and begin + seed not in known[cell.name]
            ]
            if tasks:
                order = np.random.default_rng(start).permutation(len(tasks))  # a run that is stopped is a fair sample
                tasks = [tasks[place] for place in order]
                tell(f"sessions {start} to {end} of each of {len(cells)} cells: {len(tasks)} to diagnose")
                run_tasks(tasks, None, workers)
    return {cell.name: _read(folder, cell, works[cell.name]) for cell in cells}


def stored(
    cells: Sequence[Cell], pools: str | os.PathLike[str], out: str | os.PathLike[str], *, half: str = "development"
) -> Answers:
    """Return the answers that `examine` has kept."""
    return {cell.name: _read(Path(out) / half, cell, _work_of(cell, os.fspath(pools))) for cell in cells}


def _rounds(last: int) -> Iterator[tuple[int, int]]:
    """Yield first and last session of each round: one of every cell first, then twice as many each time."""
    start, end = 1, 1
    while start <= last:
        yield start, min(end, last)
        start, end = end + 1, 2 * end


def _one(cell: Cell, seed: int, pools: str, records: Records, work: str, code: str) -> None:
    store = Store(records.path.parent, digest_of(work, code))
    with steps_kept(store, f"{records.path.stem}-{seed}"):
        answer = answer_session(cell, seed, _shapes(pools, *cell.shapes), _model())
    records.add({"seed": seed, **asdict(answer), "work": work, "code": code})


def _work_of(cell: Cell, pools: str) -> str:
    """Return a hash of what the answers of a cell depend on, the seed excepted."""
    same = replace(cell, name="", sessions=0, clear=False, own={})  # whose code the hash of their file stands for
    return digest_of(__version__, same, _shapes(pools, *cell.shapes).sha256, _model())


@lru_cache(maxsize=4)
def _shapes(pools: str, effect: str, size: float) -> Database:
    return read_pool(pools, effect, size)


@lru_cache(maxsize=1)
def _model() -> Surrogate:
    model = Surrogate.open("square-neo-hookean")
    assert isinstance(model, Surrogate), "a plain database"
    return model


def _records(folder: Path, cell: Cell) -> Records:
    """Return the answers of a cell, in a file that is named by it."""
    words = "".join(letter if letter.isalnum() or letter in ".+" else "-" for letter in cell.name)
    return Records(folder / f"{words}.jsonl")


def _read(folder: Path, cell: Cell, work: str) -> dict[int, Answer]:
    """Return the answers of a cell by seed, the latest if there are several."""
    records = _records(folder, cell)
    with parsing(str(records.path), "answers as written by exam", "remove it to compute everything anew"):
        lines = [line for line in records.read() if line.pop("work") == work]
        for line in lines:
            line.pop("code")
        return {line.pop("seed"): Answer(**line) for line in lines}
