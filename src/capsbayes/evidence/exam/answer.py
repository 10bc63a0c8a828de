"""The answer of the diagnosis to one session of the exam, judged by the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capsbayes.database import Database
from capsbayes.diagnosis import Comparison, Study, Verdict, diagnose
from capsbayes.effect import Effect
from capsbayes.evidence.blind.session import BlindSession, draw_session
from capsbayes.evidence.exam.cells import Cell
from capsbayes.model import ForwardModel

_TWO_SIGMA = 1.92  # fall of the log likelihood at the ends of a 95 % interval
_ACCURACY = 0.1  # of the standard deviation of an effect's prior: error of a measurement apart from the capsules


@dataclass(frozen=True)
class Answer:
    """The diagnosis of one session, compared with the truth; a number that there is not is NaN.

    Parameters
    ----------
    outcome : str
        "none", "right", "ambiguous" (with the truth among the names of each effect that is added, if the catalogue
        has it), "unknown", or "wrong".
    names : list of str
        Effects that were named.
    p_value : float
        Of the finding.
    bias_before, bias_after : float
        Of the median of ln G_s of the held-out capsules; after is NaN if nothing was named.
    seconds : float
        Processor time.
    size, low, high : float
        Estimated size of the true effect with its 95 % interval; NaN if it is not among the names.
    log_likelihood_ratio, log_likelihood_ratio_error : float
        Log likelihood ratio per held-out capsule.
    misfit_before, misfit_after : float
        Of those capsules, over its freedom.
    gap_before, gap_after : float [m]
        Root mean square distance of their edges from the predicted ones.
    distinguished : str
        Outcome once some of the effects in question were measured apart from the capsules; "" if one was named.
    measurements : int
        Number of these measurements.
    """

    outcome: str
    names: list[str]
    p_value: float
    bias_before: float
    seconds: float
    bias_after: float = np.nan
    size: float = np.nan
    low: float = np.nan
    high: float = np.nan
    log_likelihood_ratio: float = np.nan
    log_likelihood_ratio_error: float = np.nan
    misfit_before: float = np.nan
    misfit_after: float = np.nan
    gap_before: float = np.nan
    gap_after: float = np.nan
    distinguished: str = ""
    measurements: int = 0


def answer_session(cell: Cell, seed: int, shapes: Database, model: ForwardModel) -> Answer:
    """Draw one session of a cell from its pool of shapes, and diagnose it with a model without effects and one seed."""
    begin = time.process_time()
    blind = draw_session(
        shapes, cell.true_effect, cell.size, lab=cell.lab, capsules=cell.capsules, seed=seed, outline=cell.outline
    )
    candidates = cell.candidates(seed)
    study = diagnose(blind.session, model, seed=seed, candidates=candidates)
    outcome = outcome_of(cell, study)
    distinguished, measurements = "", 0
    if cell.known and outcome == "ambiguous":
        distinguished, measurements = _distinguished(cell, seed, blind, model, study, candidates)
    return Answer(
        outcome=outcome,
        names=list(study.names),
        p_value=study.finding.p_value,
        **_size(cell, study),
        **_held_out(blind, study),
        distinguished=distinguished,
        measurements=measurements,
        seconds=time.process_time() - begin,
    )


def outcome_of(cell: Cell, study: Study) -> str:
    """Return the outcome of a verdict, given the truth."""
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


def _distinguished(
    cell: Cell, seed: int, blind: BlindSession, model: ForwardModel, study: Study, candidates: Mapping[str, Effect]
) -> tuple[str, int]:
    """Return outcome and number of measurements when the effects in question are measured, the likeliest first."""
    rng = np.random.default_rng([seed, len(study.names)])
    measured: dict[str, tuple[float, float]] = {}
    while study.verdict is Verdict.AMBIGUOUS:
        ambiguous = [step.in_question for step in study.steps if len(step.in_question) > 1]
        left = [name for names in ambiguous for name in names if name not in measured]
        if not left:
            break
        effect = candidates[left[0]]
        error = _ACCURACY * effect.prior.sd
        measured[left[0]] = float(rng.normal(cell.sizes.get(left[0], effect.null_value), error)), error
        study = diagnose(blind.session, model, seed=seed, candidates=candidates, measured=measured, earlier=study)
    return outcome_of(cell, study), len(measured)


def _size(cell: Cell, study: Study) -> Mapping[str, float]:
    if cell.effect not in study.names:
        return {}
    scores = study.scores[cell.effect]
    low, high = scores.interval(_TWO_SIGMA)
    return {"size": scores.size, "low": low, "high": high}


def _held_out(blind: BlindSession, study: Study) -> Mapping[str, float]:
    """Return ratio, misfit and bias of the held-out capsules; the bias of the first half if none were compared."""
    verification = study.verification
    if verification is None:
        return {"bias_before": np.nan if study.first_half is None else _bias(blind, study.first_half)}
    before, after = verification.comparisons
    named = study.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    return {
        "log_likelihood_ratio": verification.log_likelihood_ratio,
        "log_likelihood_ratio_error": verification.error,
        "misfit_before": verification.before.noise**2,
        "misfit_after": verification.after.noise**2,
        "gap_before": before.gap,
        "gap_after": after.gap,
        "bias_before": _bias(blind, before),
        "bias_after": _bias(blind, after) if named else np.nan,
    }


def _bias(blind: BlindSession, comparison: Comparison) -> float:
    """Return the median of the errors of ln G_s."""
    sources = [measurement.source for measurement in blind.session.measurements]
    truth = dict(zip(sources, blind.log_modulus, strict=True))
    known = np.array([truth[measurement.source] for measurement in comparison.session.measurements])
    return float(np.nanmedian(np.log(comparison.modulus) - known))
