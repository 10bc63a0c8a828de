"""The answer of the diagnosis to one session of the exam, judged by the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from capsbayes.database import Database
from capsbayes.diagnosis import NOTHING, UNKNOWN, Study, Verdict, diagnose
from capsbayes.diagnosis.finding import TWO_SIGMA
from capsbayes.evidence.blind.session import BlindSession, draw_session
from capsbayes.evidence.exam.cells import Cell
from capsbayes.model import ForwardModel

SMALL = 3
"""Number of names at most of a small set."""

_LEAST = 1e-12  # probability of the truth, at least: a log score counts no further


@dataclass(frozen=True)
class Answer:
    """The diagnosis of one session, compared with the truth; a number that there is not is NaN."""

    # Outcomes are "none", "right", "small set" or "large set" (with the truth among the names of each effect that is
    # added, if the catalogue has it; something else counts as one), "part" (likewise, but of two effects one alone),
    # "unknown", or "wrong". The modulus and its 95 % interval are ln of the median G_s over the true median of the
    # batch.

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
        ahead=np.nan if study.verification is None else study.verification.ahead_by_both,
    )


def outcome_of(cell: Cell, study: Study) -> str:
    """Return the outcome of a verdict, given the truth."""
    if study.verdict in (Verdict.NONE, Verdict.NOT_TESTABLE):
        return "none"
    if study.verdict is Verdict.UNKNOWN:
        return "unknown"
    named = study.verdict is Verdict.NAMED
    if cell.null or (named and not cell.known):
        return "wrong"
    if cell.known and not all(cell.names & {*step.in_question} for step in study.steps):
        return "wrong"
    if not _all_found(cell, study):
        return "part"
    if named:
        return "right"
    largest = max(len(step.in_question) for step in study.steps) + study.something_else
    return "small set" if largest <= SMALL else "large set"


def _all_found(cell: Cell, study: Study) -> bool:
    """Tell whether every true effect is among the names of a step of its own, if the catalogue has it."""
    if not cell.known:
        return True
    names = sorted(cell.names)
    orders = permutations((step.in_question for step in study.steps), len(names))
    return any(all(name in step for name, step in zip(names, order, strict=True)) for order in orders)


def log_score(cell: Cell, study: Study) -> float:
    """Return the log of the probability that a study gives to the truth; NaN for two effects, or without any."""
    truth = NOTHING if cell.null else cell.effect if cell.known else UNKNOWN
    found = study.all_probabilities
    return float(np.log(max(found.get(truth, 0.0), _LEAST))) if found and not cell.also else float("nan")


def _modulus(blind: BlindSession, study: Study) -> dict[str, float]:
    truth = blind.log_modulus_of_batch
    found = study.surface_shear_modulus
    apparent = np.nan if study.first_half is None else study.first_half.median_modulus
    values = {"": found.median, "_low": found.low, "_high": found.high}
    return {f"modulus{end}": float(np.log(value)) - truth for end, value in values.items()} | {
        "apparent": float(np.log(apparent)) - truth
    }


def _size(cell: Cell, study: Study) -> dict[str, float]:
    step = next((step for step in study.steps if cell.effect in step.in_question), None)
    if step is None or study.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
        return {}
    scores = step.scores[cell.effect]
    low, high = scores.interval(TWO_SIGMA)
    return {"size": scores.size, "low": low, "high": high}
