"""How one session of the exam was answered."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capsbayes.database import Database
from capsbayes.diagnosis import Comparison, Study, Verdict, diagnose
from capsbayes.effect import Effect
from capsbayes.effects import catalogue
from capsbayes.evidence.blind.decoy import Decoy
from capsbayes.evidence.blind.session import HiddenSession, drawn_session
from capsbayes.evidence.exam.cells import Cell
from capsbayes.model import ForwardModel

__all__ = ["Answer", "answered"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Answer:
    """One session: what was said of it, beside the truth.

    Parameters
    ----------
    outcome : str
        "none", "right", "ambiguous" (with the truth among the names of each effect that is added, if the catalogue
        has it), "unknown", or "wrong".
    names : list of str
        Effects that were named.
    p_value : float
        Of the finding.
    size, low, high : float
        Of what is hidden, as found, with its 95 % interval; NaN if it is not among the names.
    bias_before, bias_after : float
        Of the median of ln G_s of the held-out capsules; after is NaN if nothing was named.
    log_likelihood_ratio, log_likelihood_ratio_error : float
        Log likelihood ratio per held-out capsule.
    misfit_before, misfit_after : float
        Of those capsules, over its freedom.
    gap_before, gap_after : float [m]
        Root mean square distance of their edges from the predicted ones.
    distinguished : str
        Outcome once some of the effects in question were measured apart from the capsules; "" if one was named.
    measurements : int
        How many were.
    seconds : float
        Processor time.
    """

    outcome: str
    names: list[str]
    p_value: float
    size: float
    low: float
    high: float
    bias_before: float
    bias_after: float
    log_likelihood_ratio: float
    log_likelihood_ratio_error: float
    misfit_before: float
    misfit_after: float
    gap_before: float
    gap_after: float
    distinguished: str
    measurements: int
    seconds: float


_TWO_SIGMA = 1.92  # fall of the log likelihood at the ends of a 95 % interval
_ACCURACY = 0.1  # of the standard deviation of an effect's prior: error of what is measured apart from the capsules


def answered(cell: Cell, seed: int, shapes: Database, model: ForwardModel) -> Answer:
    """Draw one session of a cell and diagnose it.

    Parameters
    ----------
    cell : Cell
    seed : int
        Of the session and of the diagnosis.
    shapes : Database
        The cell's pool.
    model : forward model
        Without effects.
    """
    begin = time.process_time()
    drawn = drawn_session(
        shapes, cell.hidden, cell.size, lab=cell.lab, capsules=cell.capsules, seed=seed, outline=cell.outline
    )
    candidates = _candidates(cell, seed)
    study = diagnose(drawn.session, model, seed=seed, candidates=candidates)
    outcome = outcome_of(cell, study)
    distinguished, measurements = "", 0
    if cell.known and outcome == "ambiguous":
        distinguished, measurements = _distinguished(cell, seed, drawn, model, study, candidates)
    return Answer(
        outcome=outcome,
        names=list(study.names),
        p_value=study.finding.p_value,
        **_size(cell, study),
        **_held_out(drawn, study),
        distinguished=distinguished,
        measurements=measurements,
        seconds=time.process_time() - begin,
    )


def _candidates(cell: Cell, seed: int) -> dict[str, Effect]:
    if cell.decoy:
        return {Decoy.parameter.name: Decoy(seed)}
    return {name: effect for name, effect in catalogue().items() if name not in cell.removed}


def _distinguished(
    cell: Cell,
    seed: int,
    drawn: HiddenSession,
    model: ForwardModel,
    study: Study,
    candidates: Mapping[str, Effect],
) -> tuple[str, int]:
    """Outcome, and number of measurements, when the effects in question are measured, the likeliest first."""
    rng = np.random.default_rng([seed, len(study.names)])
    measured: dict[str, tuple[float, float]] = {}
    while study.verdict is Verdict.AMBIGUOUS:
        left = [
            name
            for step in study.steps
            if len(step.in_question) > 1
            for name in step.in_question
            if name not in measured
        ]
        if not left:
            break
        effect = candidates[left[0]]
        error = _ACCURACY * float(effect.prior.std())
        measured[left[0]] = float(rng.normal(cell.sizes.get(left[0], effect.null_value), error)), error
        study = diagnose(drawn.session, model, seed=seed, candidates=candidates, measured=measured, earlier=study)
    return outcome_of(cell, study), len(measured)


def outcome_of(cell: Cell, study: Study) -> str:
    """What kind of answer a verdict is, the truth known."""
    if study.verdict in (Verdict.NONE, Verdict.NOT_TESTABLE):
        return "none"
    if study.verdict is Verdict.UNKNOWN:
        return "unknown"
    named = study.verdict is Verdict.NAMED
    if not cell.known:
        return "wrong" if named else "ambiguous"
    if not all(cell.sizes.keys() & step.in_question for step in study.steps):
        return "wrong"
    return "right" if named else "ambiguous"


def _size(cell: Cell, study: Study) -> Mapping[str, float]:
    if cell.effect not in study.names:
        return {"size": np.nan, "low": np.nan, "high": np.nan}
    scores = study.scores[cell.effect]
    low, high = scores.interval(_TWO_SIGMA)
    return {"size": scores.size, "low": low, "high": high}


_OF_HELD_OUT = (
    "log_likelihood_ratio",
    "log_likelihood_ratio_error",
    "misfit_before",
    "misfit_after",
    "gap_before",
    "gap_after",
    "bias_after",
)


def _held_out(drawn: HiddenSession, study: Study) -> Mapping[str, float]:
    """Return ratio, misfit and bias of the held-out capsules; the bias of the first half if none were compared."""
    seen = study.verification
    if seen is None:
        found = dict.fromkeys(_OF_HELD_OUT, np.nan)
        return found | {"bias_before": np.nan if study.first_half is None else _bias(drawn, study.first_half)}
    before, after = (_bias(drawn, one) for one in seen.comparisons)
    named = study.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    return {
        "log_likelihood_ratio": seen.log_likelihood_ratio,
        "log_likelihood_ratio_error": seen.error,
        "misfit_before": seen.before.noise**2,
        "misfit_after": seen.after.noise**2,
        "gap_before": seen.comparisons[0].gap,
        "gap_after": seen.comparisons[1].gap,
        "bias_before": before,
        "bias_after": after if named else np.nan,
    }


def _bias(drawn: HiddenSession, compared: Comparison) -> float:
    """Median of the errors of ln G_s."""
    truth = dict(zip((one.source for one in drawn.session.measurements), drawn.log_modulus, strict=True))
    known = np.array([truth[one.source] for one in compared.session.measurements])
    return float(np.nanmedian(np.log(compared.modulus) - known))
