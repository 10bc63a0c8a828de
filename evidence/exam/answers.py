"""The answers to the sessions of the exam, judged by the truth and kept; the locked half needs a recorded diagnosis."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path

import numpy as np

import capsbayes
from capsbayes import __version__
from capsbayes.database import Database, shipped_folders
from capsbayes.diagnosis import NOTHING, UNKNOWN, Study, Verdict, diagnose
from capsbayes.diagnosis.blind import BlindSession, draw_session
from capsbayes.diagnosis.finding import TWO_SIGMA
from capsbayes.errors import InputError
from capsbayes.files.input_file import parsing
from capsbayes.files.output_file import make_folder, write_file
from capsbayes.interruption import keeping
from capsbayes.model import ForwardModel
from capsbayes.run import Store, digest_of, only_run, run_tasks, steps_kept
from capsbayes.surrogate import Surrogate
from evidence.exam.sessions import HALVES, Cell, read_pool
from evidence.records import Records

# One answer

SMALL = 3
"""Number of names at most of a small set."""

_LEAST = 1e-12  # probability of the truth, at least: a log score counts no further


@dataclass(frozen=True)
class Answer:
    """The diagnosis of one session, compared with the truth; a number that there is not is NaN."""

    # Outcomes are "none", "right", "small set" or "large set" (with the truth among the explanations, or something else
    # if the catalogue lacks it; something else counts as one), "part" (of two effects one alone is among them),
    # "elsewhere" (something else is, but not the truth), "unknown", or "wrong". The modulus and its 95 % interval are
    # ln of the median G_s over the true median of the batch.

    outcome: str
    names: list[str]  # effects that were named, or the nearest
    p_value: float  # of the finding
    shapes: list[int]  # rows of the pool that the capsules have
    log_score: float  # log of the probability of the truth: no effect, the hidden one, or something else
    modulus: float
    modulus_low: float
    modulus_high: float
    apparent: float  # as the modulus, of the first half without any effect
    seconds: float  # processor time
    true_size: float = np.nan
    size: float = np.nan  # estimate, if the effect is among the names
    low: float = np.nan  # end of its 95 % interval
    high: float = np.nan
    ahead: float = np.nan  # log evidence of what was named, or is nearest, over that of something else, by both halves


def answer_session(cell: Cell, seed: int, shapes: Database, model: ForwardModel) -> Answer:
    """Draw one session of a cell from its pool of shapes, and diagnose it with a model without effects and one seed."""
    begin = time.process_time()
    lab, capsules, other = cell.drawn(seed)
    size = cell.size_in(lab)
    blind = draw_session(
        shapes, cell.true_effect(lab), size, lab=lab, capsules=capsules, seed=other, outline=cell.outline
    )
    study = diagnose(blind.session, model, seed=seed, candidates=cell.candidates())
    return Answer(
        outcome=outcome_of(cell, study),
        names=list(study.names),
        p_value=study.finding.p_value,
        shapes=[capsule.row for capsule in blind.capsules],
        log_score=log_score(cell, study),
        **_modulus(blind, study),
        true_size=size,
        **_size(cell, study),
        seconds=time.process_time() - begin,
        ahead=study.odds.margin(study.odds.best) if study.odds is not None and study.odds.best else np.nan,
    )


def outcome_of(cell: Cell, study: Study) -> str:
    """Return the outcome of a verdict, given the truth."""
    if study.verdict in (Verdict.NONE, Verdict.NOT_TESTABLE):
        return "none"
    if study.verdict is Verdict.UNKNOWN:
        return "unknown"
    named = study.verdict is Verdict.NAMED
    found = [{*names} == cell.names for names in study.in_question]
    if cell.null or (named and not found[0]) or not (named or any(found) or study.something_else):
        return "wrong"
    if named:
        return "right"
    if not any(found) and cell.known:
        return "part" if any({*names} & cell.names for names in study.in_question) else "elsewhere"
    return "small set" if len(study.in_question) + study.something_else <= SMALL else "large set"


def log_score(cell: Cell, study: Study) -> float:
    """Return the log of the probability that a study gives to the truth; NaN for two effects, or without any."""
    truth = NOTHING if cell.null else cell.effect if cell.known else UNKNOWN
    found = study.probabilities
    return float(np.log(max(found.get(truth, 0.0), _LEAST))) if found and not cell.also else float("nan")


def _modulus(blind: BlindSession, study: Study) -> dict[str, float]:
    truth = blind.log_modulus_of_batch
    found = study.surface_shear_modulus
    apparent = np.nan if study.comparison is None else study.comparison.median_modulus
    values = {"": found.median, "_low": found.low, "_high": found.high}
    return {f"modulus{end}": float(np.log(value)) - truth for end, value in values.items()} | {
        "apparent": float(np.log(apparent)) - truth
    }


def _size(cell: Cell, study: Study) -> dict[str, float]:
    if not any(cell.effect in names for names in study.in_question):
        return {}
    scores = study.scores[cell.effect]
    low, high = scores.interval(TWO_SIGMA)
    return {"size": scores.size, "low": low, "high": high}


# The record of the diagnosis that the locked half is opened with

_OTHER = ("app", "cli", "image", "report")  # folders of the package with code that decides no answer
_RECORD = "frozen.json"


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Return a hash of the code that decides an answer, its thresholds among it, and of the databases shipped."""
    digest, package, exam = hashlib.sha256(), Path(str(files(capsbayes))), Path(__file__).parent
    for root in (package, exam):
        for file in sorted(root.rglob("*.py")):
            name = file.relative_to(root)
            if root == exam or name.parts[0] not in _OTHER:
                digest.update(name.as_posix().encode() + b"\0" + file.read_bytes())
    for folder in (*shipped_folders(), *shipped_folders("membranes")):
        for file in sorted(folder.glob("*.nc")):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def freeze(out: Path) -> None:
    """Record the code of the diagnosis in the folder of the exam, unless the locked half was opened with other code."""
    # What was seen of the locked half cannot be unseen.
    if frozen(out) != code_digest() and any((out / "locked").glob("*.jsonl")):
        expected, got = "a locked half that was not opened yet", "answers of another diagnosis"
        raise InputError(str(out / "locked"), "", expected, got, "draw a new half with other seeds")
    make_folder(out)
    write_file(out / _RECORD, json.dumps({"code": code_digest(), "version": capsbayes.__version__}) + "\n")


def frozen(out: Path) -> str | None:
    """Return the hash of the code that was recorded, None if none was."""
    record = out / _RECORD
    return str(json.loads(record.read_text(encoding="utf-8"))["code"]) if record.exists() else None


def check_frozen(out: Path) -> None:
    """Refuse to open the locked half with a diagnosis that was not frozen, or has changed since."""
    recorded = frozen(out)
    if recorded != code_digest():
        got = "none" if recorded is None else "that of another diagnosis"
        raise InputError("exam", "--half locked", "the record of this diagnosis", got, "freeze it first with --freeze")


# All sessions of a half

Answers = dict[str, dict[int, Answer]]
"""Answers by name of the cell and seed."""

_APART = 1_000_000  # seeds between the halves


def examine(
    cells: Sequence[Cell],
    pools: Path,
    out: Path,
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
    folder = out / half
    begin = _APART * HALVES[half]
    make_folder(folder)
    with only_run(folder), keeping(folder):
        code = code_digest()
        works = {cell.name: _work_of(cell, pools, half) for cell in cells}
        known = {cell.name: _read(folder, cell, works[cell.name]) for cell in cells}
        for start, end in _rounds(max((cell.sessions for cell in cells), default=0)):
            tasks = [
                partial(_one, cell, begin + seed, pools, half, _records(folder, cell), works[cell.name], code)
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


def stored(cells: Sequence[Cell], pools: Path, out: Path, *, half: str = "development") -> Answers:
    """Return the answers that `examine` has kept."""
    # The pool of a cell without answers need not be there.
    folder = out / half
    return {
        cell.name: _read(folder, cell, _work_of(cell, pools, half))
        for cell in cells
        if _records(folder, cell).path.exists()
    }


def _rounds(last: int) -> Iterator[tuple[int, int]]:
    """Yield first and last session of each round: one of every cell first, then twice as many each time."""
    start, end = 1, 1
    while start <= last:
        yield start, min(end, last)
        start, end = end + 1, 2 * end


def _one(cell: Cell, seed: int, pools: Path, half: str, records: Records, work: str, code: str) -> None:
    store = Store(records.path.parent, digest_of(work, code))
    with steps_kept(store, f"{records.path.stem}-{seed}"):
        answer = answer_session(cell, seed, _shapes(pools, *cell.shapes, half), _model())
    records.add({"seed": seed, **asdict(answer), "work": work, "code": code})


def _work_of(cell: Cell, pools: Path, half: str) -> str:
    """Return a hash of what the answers of a cell depend on, the seed excepted."""
    same = replace(cell, name="", sessions=0, clear=False, own={})  # whose code the hash of their file stands for
    return digest_of(__version__, same, _shapes(pools, *cell.shapes, half).sha256, _model())


@lru_cache(maxsize=4)
def _shapes(pools: Path, effect: str, size: float, half: str) -> Database:
    return read_pool(pools, effect, size, half)


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
