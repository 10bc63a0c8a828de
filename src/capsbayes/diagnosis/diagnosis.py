"""Diagnosis of a session: find, name, add, verify."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

import capsbayes
from capsbayes.arguments import checked
from capsbayes.diagnosis.finding import (
    Changes,
    Finding,
    Pair,
    SessionModulus,
    UnknownChange,
    find,
    limits_table,
    own_size_error,
    session_modulus,
)
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.odds import Calibration, Change, Explanation, Names, Odds
from capsbayes.diagnosis.scores import Measured, Scores, Trial, whitening
from capsbayes.diagnosis.search import AT_MOST, LEAST_RATIO, Comparison, Search
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.verification import Verification, verified
from capsbayes.effects import catalogue
from capsbayes.errors import NoShapeError
from capsbayes.model import Effect, FixedParameters, ForwardModel
from capsbayes.readable import Readable

if TYPE_CHECKING:
    from capsbayes.infer.population import Population


_FEWEST = 12  # capsules of a session that can be divided
_SHOWS = 3.5  # standard errors, from which a second effect is looked for
_HELD_OUT = 0.05  # p-value of the capsules that did not tell the sizes, from which they do not confirm a name
_OF_QUARTILES = 0.7413  # standard deviation of normal values over the distance of their quartiles
_ESTABLISHED = 3.0  # standard errors from the null value, from which an effect measured elsewhere is there
_IN_QUESTION = 0.1  # weight of something else at least, where it is in question, for G_s


class Verdict(Enum):
    """Result of a diagnosis."""

    NONE = "no disagreement was found"
    NAMED = "an effect explains it"
    AMBIGUOUS = "more than one effect may explain it"  # something else may be one of them
    UNKNOWN = "no effect of the catalogue explains it"
    NOT_TESTABLE = "these data cannot tell"


@dataclass(frozen=True, eq=False, repr=False)
class Study(Readable):
    """Diagnosis of a session, as returned by `diagnose`.

    Parameters
    ----------
    verdict : Verdict
    finding : Finding
        Deviations of the capsules from the model.
    in_question : tuple of tuple of str
        Explanations that may be right, the likeliest first: the names of the parameters of effects that act together.
    something_else : bool
        Whether what is in no candidate is in question, too.
    verification : Verification or None
        All capsules with the likeliest explanation, each half with the sizes that the other half tells.
    model : ForwardModel
        With the effects, if they were named.
    sizes : mapping of str to float
        Sizes of the model's effects.
    session : Session
    seed : int
    level : float
    comparison : Comparison or None
        The capsules and the model without effects; None if there are too few capsules.
    odds : Odds or None
        Log probabilities of all explanations.
    calibration : Calibration or None
        How often a name is wrong in sessions like this one, where the likeliest effects are seen.
    trials : mapping of str to Trial
        Fits of each candidate alone, the likeliest first.
    pairs : mapping of (str, str) to Pair
        Two effects together, if they were tried.
    own_errors : mapping of tuple of str to tuple of float
        Errors that the model's own error makes of the sizes of effects in question.
    candidates : mapping of str to Effect
        Effects that are tried, or would be.
    not_testable : tuple of str
        Names of effects that were not tried, as nothing that shows them was measured, such as the flow rates.
    measured : mapping of str to (float, float)
        Sizes of effects measured independently of the capsules, and their standard errors.
    """

    verdict: Verdict
    finding: Finding
    session: Session
    model: ForwardModel
    seed: int
    level: float
    in_question: tuple[Names, ...] = ()
    something_else: bool = False
    verification: Verification | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    comparison: Comparison | None = None
    odds: Odds | None = None
    calibration: Calibration | None = None
    trials: Mapping[str, Trial] = field(default_factory=dict)
    pairs: Mapping[Names, Pair] = field(default_factory=dict)
    own_errors: Mapping[Names, tuple[float, ...]] = field(default_factory=dict)
    candidates: Mapping[str, Effect] = field(default_factory=dict)
    not_testable: tuple[str, ...] = ()
    measured: Measured = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters of the effects in question, the likeliest first; the nearest if none explains it."""
        if self.verdict is Verdict.UNKNOWN and self.odds is not None:
            return self.odds.best
        return tuple(dict.fromkeys(name for names in self.in_question for name in names))

    @property
    def name(self) -> str:
        """Name of the effect that explains the deviations, two joined by "and"; else the verdict, as "unknown"."""
        if self.verdict is not Verdict.NAMED:
            return self.verdict.name.lower()
        return " and ".join(self.candidates[name].name for name in self.in_question[0])

    @property
    def gap(self) -> tuple[float, float]:
        """Root mean square distances [m] of edges from the model without and with the effects.

        The sizes of the effects are those that the other half of the capsules tells; NaN where nothing was verified, or
        without outlines.
        """
        return (np.nan, np.nan) if self.verification is None else self.verification.gaps

    @property
    def probabilities(self) -> Mapping[str, float]:
        """Probability of each candidate, of two together joined by "and", of "none" and of "unknown".

        Beforehand no effect has one half, one of the candidates 0.3, two together 0.05, and something else 0.15, of
        which one half resembles a candidate. Effects that change nothing that is seen are none of these.
        """
        return {} if self.odds is None else self.odds.probabilities

    @cached_property
    def scores(self) -> Mapping[str, Scores]:
        """Scores of every candidate, the likeliest first; of two effects in question, with each other."""
        scores = {name: trial.scores for name, trial in self.trials.items()}
        for names in reversed(self.in_question):
            scores |= dict(zip(names, self.scores_of(names), strict=True))
        return dict(sorted(scores.items(), key=lambda item: -item[1].log_likelihood_ratio))

    def scores_of(self, names: Names) -> tuple[Scores, ...]:
        """Return the scores of effects that act together."""
        scores = (
            (self.trials[names[0]].scores,) if len(names) == 1 else (self.pairs[names].first, self.pairs[names].second)
        )
        errors = self.own_errors.get(names, (0.0,) * len(names))
        return tuple(replace(each, own_error=error) for each, error in zip(scores, errors, strict=True))

    @cached_property
    def limits(self) -> pd.DataFrame:
        """Effects that could hide where no disagreement was found, a row each; empty for any other verdict.

        Columns: ``effect``; ``low`` and ``high`` [``unit``], the 95 % interval of its size; ``modulus_at_low`` and
        ``modulus_at_high``, the median G_s with these sizes over that without the effect; ``unbounded``, whether the
        data allow the effect up to the end of its prior.
        """
        seen = {name: trial.scores for name, trial in self.trials.items() if not trial.unseen}
        return limits_table(seen if self.verdict is Verdict.NONE else {})

    @cached_property
    def surface_shear_modulus(self) -> SessionModulus:
        """Median G_s of the session with what is not known of the effect, its size and the viscosity.

        All explanations count, as probable as they are: each effect, what is like it, something else and no effect.
        What is in no candidate changes G_s as effects of the catalogue do that displace the outlines as much. Where it
        is in question, it counts one tenth at least.
        """
        if self.comparison is None or self.odds is None:
            return SessionModulus(*(3 * [float("nan")]))
        viscosity = self.session.experiment.viscosity
        error = 0.0 if viscosity is None else viscosity.sd / viscosity.mean
        best = self.comparison.fits if self.verdict is Verdict.NONE else self._fits_of(self.odds.best)
        away = best.log_modulus[best.settled]
        scatter = _OF_QUARTILES * float(np.subtract(*np.quantile(away, (0.75, 0.25)))) if len(away) else np.nan
        return session_modulus(list(self._explanations()), self.comparison.modulus, scatter, error, self.seed)

    def _fits_of(self, names: Names) -> Fits:
        if not names:
            assert self.comparison is not None, "there are capsules"
            return self.comparison.fits
        return self.trials[names[0]].fits if len(names) == 1 else self.pairs[names].fits

    def _explanations(self) -> Iterator[tuple[float, Changes]]:
        """Yield the weight of each explanation, and what acts in it."""
        # What is only like an effect changes the outlines as it does, but not G_s: how it changes that is not known.
        odds, discrepancy = self.odds, self.finding.discrepancy
        assert odds is not None, "there are capsules"
        whole = odds.whole
        unknown = np.exp(odds.something_else - whole)
        least = _IN_QUESTION / (1.0 - _IN_QUESTION) * (1.0 - unknown) / unknown if self.something_else else 1.0
        raised = max(least, 1.0)
        yield np.exp(odds.nothing - whole), ()
        yield raised * np.exp(odds.other - whole), (UnknownChange(*discrepancy.amplitudes),)
        for names, log in odds.exact.items():
            yield np.exp(log - whole), self._together(names)
            amplitude = odds.visibility[names] / discrepancy.scale if odds.visibility[names] > 0.0 else 0.0
            like = UnknownChange(np.array([amplitude]), np.ones(1))
            yield raised * np.exp(odds.like[names] - whole), (like,)

    def _together(self, names: Names) -> tuple[Scores, ...]:
        """Return what effects change that act together: the last, scored with the others, brings the change by all."""
        *others, last = self.scores_of(names)
        if not others or self.comparison is None:
            return (*others, last)
        spread = (replace(each, without=float(each.modulus[each.best])) for each in others)
        return *spread, replace(last, without=self.comparison.median_modulus)

    @property
    def tested_model(self) -> ForwardModel:
        """Model that was diagnosed, without the effects that were named."""
        return self.model if self.comparison is None else self.comparison.model

    def table(self) -> pd.DataFrame:
        """Return a row for each candidate, the likeliest first, indexed by the name of its parameter.

        Logarithms are relative to no effect, `low` and `high` are the 68 % interval of the size [``unit``], and
        ``surface_shear_modulus`` is the median of the capsules [N/m].
        """
        explained = self.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
        rows = {
            name: {
                "effect": scores.effect.name,
                "kind": scores.effect.kind.name,
                "log_evidence": self.trials[name].scores.evidence,
                "log_likelihood_ratio": scores.log_likelihood_ratio,
                "size": scores.size,
                **dict(zip(("low", "high"), scores.interval(), strict=True)),
                "unit": scores.effect.parameter.unit,
                "surface_shear_modulus": float(scores.modulus[scores.best]),
                "may_explain": explained and name in self.names,
                "changes": scores.effect.changes,
                "separated_by": scores.effect.separated_by,
            }
            for name, scores in self.scores.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index")

    def described(self) -> dict[str, str]:
        """Return the verdict, the finding and the effects in question with their sizes."""
        words = {"verdict": self.verdict.value, "capsules": str(len(self.session)), "finding": str(self.finding)}
        return words | {name: str(self.scores[name]) for name in self.names} | {"model": self.model.name}

    def __str__(self) -> str:
        """Return the verdict in one sentence."""
        if self.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
            return f"{self.verdict.value} ({self.finding})"
        groups = ["; with ".join(map(str, self.scores_of(names))) for names in self.in_question]
        groups += ["something else"] * self.something_else
        return f"{self.verdict.value}: {' or '.join(groups)} ({self.finding})"


@checked
@threadpool_limits.wrap(limits=1)  # the matrices are tiny: threads would only wait for each other
def diagnose(
    session: Session | Population | str | Path,
    model: ForwardModel,
    *,
    seed: int,
    candidates: Mapping[str, Effect] | None = None,
    level: float = 0.01,
    measured: Measured | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    earlier: Study | None = None,
) -> Study:
    """Find what a model misses in a session, name the effect that explains it, and verify that.

    Parameters
    ----------
    session : Session, Population or path
        A population or a path stands for the set of measurements there, see `Session.of`.
    model : ForwardModel
        For example ``Surrogate.open("square-neo-hookean")``.
    seed : int
        Seed of the random signs, of the drawn sessions and of the division into halves.
    candidates : mapping of str to Effect, optional
        By name of their parameter; by default the catalogue of the session's cross-section.
    level : float
        Significance of a deviation.
    measured : mapping of str to (float, float), optional
        Sizes of effects measured independently of the capsules, and their standard errors, in SI.
    progress : callable, optional
        Called with the name of the next step, the number of finished steps and that of all steps.
    earlier : Study, optional
        Diagnosis of the same session with the same model and seed, with fewer `measured`; its fits are used again.

    Returns
    -------
    Study

    Raises
    ------
    NoShapeError
        If the model has no shape for any of the capsules.
    ValueError
        If the earlier study is of another session or model, or has another seed.
    """
    session = Session.of(session)
    model.check_experiment(session.experiment)
    _check_earlier(earlier, session, model, seed)
    asked = catalogue(session.experiment.cross_section) if candidates is None else candidates
    effects = {
        name: effect for name, effect in asked.items() if session.circumstances.keys() >= {*effect.circumstances}
    }
    hidden = tuple(effect.name for name, effect in asked.items() if name not in effects)
    made = Study(
        verdict=Verdict.NOT_TESTABLE,
        finding=Finding((), float("nan"), len(session)),
        session=session,
        model=model,
        seed=seed,
        level=level,
        candidates=effects,
        measured=measured or {},
    )
    if len(session) < _FEWEST:
        return made
    report = _Progress(progress, len(effects) + 2)
    report("the model as it is")
    white = whitening(model, session)
    fits = fitted(model, session, white)
    _check_shapes(model, fits)
    finding = find(model, session, seed=seed, white=white, fits=fits)
    made = replace(made, finding=finding, comparison=Comparison(session, model, fits), not_testable=hidden)
    if not finding.deviations:
        return made
    known = {} if earlier is None else earlier.trials
    search = Search(model, effects, session, white, fits, made.measured, report, known)
    return _judged(made, search, report)


def _judged(made: Study, search: Search, report: _Progress) -> Study:
    """Return the study once all explanations are weighed."""
    finding, session, fits = made.finding, made.session, search.without
    trials = search.trials()
    explanations = search.explanations(trials)
    odds = Odds.of(explanations, finding.discrepancy, session, fits)
    made = replace(made, trials=trials, odds=odds)
    if finding.p_value > made.level and odds.against_nothing < LEAST_RATIO:
        return replace(made, verdict=Verdict.NONE)
    if odds.best and (odds.something_else > odds.exact[odds.best] or _another_shows(explanations, odds.best)):
        found = search.pairs(trials)
        explanations |= {names: explanation for names, (_, explanation) in found.items()}
        odds = Odds.of(explanations, finding.discrepancy, session, fits)
        made = replace(made, odds=odds, pairs={names: pair for names, (pair, _) in found.items()})
    in_question, something_else = odds.in_question(AT_MOST)
    if not in_question:
        return replace(made, verdict=Verdict.UNKNOWN)
    made = replace(made, in_question=in_question, own_errors={names: _own_errors(made, names) for names in in_question})
    report("names that would be wrong")
    changes: dict[Names, Change] = {names: each.change for names, each in explanations.items() if len(names) == 1}
    seen = odds.least_visibility(odds.best)
    calibration = Calibration.of(changes, seen, finding.discrepancy, search.white, fits, session, made.seed)
    report("capsules that did not tell the sizes")
    effects = made.scores_of(odds.best)
    verification = verified(made.model, effects, session, search.white, fits, finding, made.seed)
    made = replace(made, calibration=calibration, verification=verification)
    known = all(_established(each.effect, made.measured) for each in effects)
    likely = odds.margin(odds.best) > (0.0 if known else calibration.threshold)
    searched = len(odds.best) > 1 and not known  # the best of many pairs, which the threshold does not know of
    alone = len(odds.alike[odds.best] & {*in_question}) == 1
    if searched or not likely or verification.p_value > _HELD_OUT or not alone:
        something_else = something_else or searched or len(in_question) == 1
        return replace(made, verdict=Verdict.AMBIGUOUS, something_else=something_else)
    _, after = verification.comparisons
    sizes = {scores.effect.parameter.name: scores.size for scores in effects}
    return replace(made, verdict=Verdict.NAMED, in_question=(odds.best,), model=after.model, sizes=sizes)


def _another_shows(explanations: Mapping[Names, Explanation], best: Names) -> bool:
    """Tell whether another effect shows in what the likeliest one leaves."""
    change = explanations[best].change
    return max((abs(change.beside(each.change)) for each in explanations.values()), default=0.0) > _SHOWS


def _own_errors(made: Study, names: Names) -> tuple[float, ...]:
    """Return the errors of the sizes of effects by the model's own error, of one with the other at its size."""
    effects, errors = made.scores_of(names), []
    for each in effects:
        here = made.model
        for other in effects:
            if other is not each:
                here = FixedParameters(here + other.effect, {other.effect.parameter.name: other.size})
        errors.append(own_size_error(here, each, made.session))
    return tuple(errors)


def _check_earlier(earlier: Study | None, session: Session, model: ForwardModel, seed: int) -> None:
    """Refuse an earlier study of another session or model, or one with another seed."""
    asked = session, model.sha256, seed
    if earlier is not None and (earlier.session, earlier.tested_model.sha256, earlier.seed) != asked:
        raise ValueError("earlier: expected a study of the same session and model with the same seed")


def _check_shapes(model: ForwardModel, fits: Fits) -> None:
    """Refuse capsules of which not one has a shape of the model: there is nothing to compare then."""
    if not fits.settled.any():
        expected = f"capsules some of which have a shape of {model.name}"
        advice = "check that lengths are over l, that z is along the flow, and the cross-section of the channel"
        raise NoShapeError("session", "measurements", expected, f"{len(fits.settled)} without one", advice)


def _established(effect: Effect, measured: Measured) -> bool:
    size, error = measured.get(effect.parameter.name, (effect.null_value, np.inf))
    return abs(size - effect.null_value) >= _ESTABLISHED * error


class _Progress:
    """Count of the finished steps."""

    def __init__(self, progress: Callable[[str, int, int], None] | None, steps: int) -> None:
        self.progress, self.steps, self.done = progress, steps, 0

    def __call__(self, step: str) -> None:
        if self.progress is not None:
            self.progress(step, min(self.done, self.steps - 1), self.steps)
        self.done += 1


# Numbers and text of a study, as they are stored


def summary(study: Study) -> dict[str, Any]:
    """Return the results of a diagnosis, ready for JSON: in SI, effects in their unit, None for no number."""
    model, modulus = study.tested_model, study.surface_shear_modulus
    return {
        "verdict": study.verdict.name,
        "sentence": str(study),
        "effects": list(study.names),
        "in_question": [list(names) for names in study.in_question],
        "something_else": study.something_else,
        "not_testable": list(study.not_testable),
        "sizes": dict(study.sizes),
        "finding": _finding(study.finding),
        "probabilities": dict(study.probabilities),
        "name_wrong": None if study.calibration is None else _number(study.calibration.wrong),
        "name_power": None if study.calibration is None else _number(study.calibration.power),
        "surface_shear_modulus": {
            "median": _number(modulus.median),
            "interval_95": [_number(modulus.low), _number(modulus.high)],
        },
        "limits_95": _records(study.limits, "parameter"),
        "candidates": _candidates(study),
        "held_out": None if study.verification is None else _verification(study.verification),
        "capsules": len(study.session),
        "with_outline": sum(measurement.outline is not None for measurement in study.session.measurements),
        "left_out": list(study.session.left_out),
        "model": {"name": model.name, "sha256": model.sha256},
        "files": {
            measurement.source: measurement.sha256 for measurement in study.session.measurements if measurement.sha256
        },
        "experiment": {"file": study.session.experiment.source, "sha256": study.session.experiment.sha256},
        "seed": study.seed,
        "level": study.level,
        "version": capsbayes.__version__,
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "p_value": finding.p_value,
        "noise_over_assumed": _number(finding.noise),
        "further_noise_over_l": finding.further_noise,
        "one_modulus_p_value": _number(finding.one_modulus),
        "capsules": finding.capsules,
        "deviations": _records(finding.table(), "name"),
    }


def _candidates(study: Study) -> list[dict[str, Any]]:
    rows = _records(study.table(), "parameter")
    for row in rows:
        row["interval_68"] = [row.pop("low"), row.pop("high")]
        row["median_surface_shear_modulus"] = row.pop("surface_shear_modulus")
    return rows


def _records(table: pd.DataFrame, index: str) -> list[dict[str, Any]]:
    """Return the rows of a table with the name of its index; None where there is no number."""
    named = table.rename_axis(index).reset_index().astype(object)
    return [dict(zip(named.columns, row, strict=True)) for row in named.where(named.notna(), None).to_numpy()]


def _verification(verification: Verification) -> dict[str, Any]:
    findings = verification.before, verification.after
    return {
        "capsules": len(verification.log_likelihood_ratios),
        "log_likelihood_ratio_per_capsule": verification.log_likelihood_ratio,
        "log_likelihood_ratio_error": verification.error,
        "p_value": verification.p_value,
        **{
            when: _finding(finding) | _moduli(compared, gap)
            for when, finding, compared, gap in zip(
                ("before", "after"), findings, verification.comparisons, verification.gaps, strict=True
            )
        },
    }


def _moduli(compared: Comparison, gap: float) -> dict[str, Any]:
    return {
        "gap": _number(gap),
        "without_a_shape": list(compared.outliers),
        "median_surface_shear_modulus": _number(compared.median_modulus),
        "surface_shear_modulus": [_number(value) for value in compared.modulus],
        "surface_shear_modulus_error": [_number(value) for value in compared.modulus_error],
        "size_ratio": [_number(value) for value in compared.fits.size],
        "by_flow_rate": [
            {"flow_rate": rate, "capsules": count, "median_surface_shear_modulus": _number(median)}
            for rate, (count, median) in compared.modulus_at_flow_rates.items()
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
