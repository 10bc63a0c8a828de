"""The search for the effect that explains a disagreement."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pandas as pd

from capsbayes.arrays import Floats
from capsbayes.diagnosis.finding import Deviation, Finding, find, score_jointly
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.scores import Measured, Scores, Trial
from capsbayes.diagnosis.session import Session, Whitening
from capsbayes.infer.outline import Footing, aligned_with
from capsbayes.model import Effect, FixedParameters, ForwardModel, Unseen

# Comparison of the capsules of a session with the best shapes of a model


@dataclass(frozen=True, eq=False)
class AlongOutline:
    """Mean displacement of the measured edges along the outline."""

    outline: Floats  # (p, 2) [l]: mean of the predicted outlines, closed, from the nose
    displacement: Floats  # (p,) [m]: mean normal distance of the measured edge, positive outside
    error: Floats  # (p,) [m]: its standard error


@dataclass(frozen=True, eq=False)
class Comparison:
    """Session of n capsules and the fits of a model to it."""

    session: Session = field(repr=False)
    model: ForwardModel = field(repr=False)
    fits: Fits = field(repr=False)

    def table(self) -> pd.DataFrame:
        """Return a row for each capsule, indexed by its source; G_s is NaN where the model has no such shape."""
        columns = {
            "surface_shear_modulus": self.modulus,
            "surface_shear_modulus_error": self.modulus_error,
            "size_ratio": self.fits.size,
            "capsule_velocity": self.session.circumstances["capsule_velocity"],
            "flow_rate": self.session.flow_rates,
        }
        return pd.DataFrame(columns, index=[measurement.source for measurement in self.session.measurements])

    @property
    def modulus(self) -> Floats:
        """Apparent G_s of each capsule : (n,) array [N/m], NaN where the model has no such shape."""
        return np.where(self.fits.settled, np.exp(self.fits.log_modulus), np.nan)

    @property
    def modulus_error(self) -> Floats:
        """Standard error of the apparent G_s : (n,) array [N/m], without the common error of the viscosity."""
        return self.modulus * np.sqrt(self.fits.covariance[:, 0, 0])

    @property
    def median_modulus(self) -> float:
        """Median of the apparent G_s [N/m]; NaN if the model has none of the shapes."""
        return self.fits.median_modulus

    @property
    def modulus_at_flow_rates(self) -> Mapping[float, tuple[int, float]]:
        """Number of capsules and median of their apparent G_s [N/m] by flow rate [m^3/s]."""
        # Empty if fewer than half of the capsules share theirs with another, as where a sensor has measured it.
        rates = self.session.flow_rates
        settings, counts = np.unique(rates[np.isfinite(rates)], return_counts=True)
        if len(settings) < 2 or counts[counts > 1].sum() < 0.5 * len(rates):
            return {}
        rows = {float(setting): rates == setting for setting in settings}
        return {rate: (int(at.sum()), _median(self.modulus[at])) for rate, at in rows.items()}

    @cached_property
    def outlines(self) -> Floats:
        """Predicted outlines of the best shapes : (n, p, 2) array [l], NaN where the model has none."""
        outlines = self.model(self._theta, outline=True).outline
        assert outlines is not None, "asked for"
        return np.where(self.fits.settled[:, None, None], outlines, np.nan)

    @property
    def added_up(self) -> int:
        """Number of capsules at whose best shape effects of the membrane are added up, not simulated together."""
        return int(np.count_nonzero(self.model.added_up(self._theta) & self.fits.settled))

    @cached_property
    def edges(self) -> Mapping[int, tuple[Floats, Footing]]:
        """Measured points (m, 2) [l] shifted and turned onto the predicted outline, and their feet on it, by row."""
        # There are those of the capsules that have an outline and a best shape.
        return {
            row: aligned_with(measurement.outline.points, self.outlines[row])
            for row, measurement in enumerate(self.session.measurements)
            if self.fits.settled[row] and measurement.outline is not None
        }

    @property
    def gap(self) -> float:
        """Root mean square normal distance of measured and predicted edges [m]; NaN without outlines."""
        return self.gap_of(self.edges)

    def gap_of(self, rows: Iterable[int]) -> float:
        """Return the root mean square normal distance of edges [m] over some of the capsules."""
        distances = [self.edges[row][1].distance for row in rows]
        return self._metres * float(np.sqrt(np.mean(np.square(np.concatenate(distances))))) if distances else np.nan

    @cached_property
    def along_outline(self) -> AlongOutline | None:
        """Mean distance along the outline; None for fewer than two outlines."""
        if len(self.edges) < 2:
            return None
        count = self.outlines.shape[1]
        vertices = np.arange(count)
        distances = np.array(
            [np.interp(vertices, feet.place, feet.distance, period=count) for _, feet in self.edges.values()]
        )
        error = distances.std(axis=0, ddof=1) / np.sqrt(len(distances))
        middle = self.outlines[list(self.edges)].mean(axis=0)
        return AlongOutline(middle, self._metres * distances.mean(axis=0), self._metres * error)

    def trend_line(self, slope: Deviation, places: Floats, at: Floats) -> Floats:
        """Return G_s along a trend of ln G_s, also with the slope less and plus its error : (3, k) array [N/m]."""
        # The line goes through the weighted middle of the settled capsules, at `places` (m,); `at` (k,) are those along
        # it.
        settled = self.fits.settled
        weight = 1.0 / self.fits.covariance[settled, 0, 0]
        middle, height = (np.average(values, weights=weight) for values in (places, self.fits.log_modulus[settled]))
        slopes = slope.size + slope.error * np.array([0.0, -1.0, 1.0])
        return np.asarray(np.exp(height + slopes[:, None] * (at - middle)))

    @property
    def misfit(self) -> Floats:
        """Misfit over degrees of freedom : (n,) array, about one under a right model, NaN without a shape."""
        known = self.fits.known & (self.fits.freedom > 0)
        return np.where(known, self.fits.misfit / np.maximum(self.fits.freedom, 1), np.nan)

    @property
    def outliers(self) -> tuple[str, ...]:
        """Sources of the capsules without a shape of the model: none, one at its border, or a misfit far too large."""
        return tuple(self.session.measurements[int(row)].source for row in np.flatnonzero(self.fits.ill))

    @property
    def _theta(self) -> dict[str, Floats]:
        """Best shapes and circumstances : dict of (n,) array."""
        places = {"capillary_number": np.exp(self.fits.theta[:, 0]), "size_ratio": self.fits.theta[:, 1]}
        return {**self.session.circumstances, **places}

    @property
    def _metres(self) -> float:
        return self.session.mean("half_width")


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


# Search for the effect that explains why a session disagrees with a model, or for two effects

LEFT = 0.01
"""P-value of the remaining deviations below which they are not explained."""

LEAST_RATIO = 3.0
"""Log-likelihood ratio below which an effect explains nothing, or no more than another, and log evidence of something
else up to which an effect is not refuted."""

AT_MOST = 8.0
"""Lag in log likelihood or log evidence from which an explanation is no longer in question: odds of 3000 to 1."""

NOTHING, UNKNOWN = "none", "unknown"
"""Names of no effect, and of an effect that is not in the catalogue, next to those of the effects."""

_TOGETHER = 4  # effects at most that are measured together with the first
_FAR_BEHIND = 20.0  # in log likelihood, beyond which an effect is not looked at more closely
_APART = 2.5  # standard errors between the log-likelihood ratios of two effects, below which they are not distinguished


@dataclass(frozen=True, eq=False)
class Step:
    """Effect that is added, with its alternatives."""

    # `scores` are of every candidate, together with the effects added before, the likeliest first; of the first of two
    # and of its alternatives, together with the second.

    scores: Mapping[str, Scores]
    in_question: tuple[str, ...]  # the likeliest, and those not distinguished from it; empty if none explains anything
    models: Mapping[str, ForwardModel] = field(repr=False)  # to which each is added: with that before, at its size
    left: Mapping[str, Finding] = field(repr=False)  # deviations that remain with each effect in question
    before: Mapping[str, Scores] = field(default_factory=dict, repr=False)  # of the effect before, with each scored

    @property
    def best(self) -> Scores:
        """Scores of the effect that is added."""
        return self.scores[self.in_question[0]]

    @property
    def after(self) -> FixedParameters:
        """Model with the effect at its size."""
        return self.with_effect(self.in_question[0])

    def with_effect(self, name: str) -> FixedParameters:
        """Return the model with one of the candidates at its size."""
        return _with(self.models[name], self.scores[name])


def searched(search: Search, fits: Fits) -> tuple[tuple[Step, ...], bool, Mapping[str, Trial]]:
    """Try every effect, and every second one with the likeliest if deviations remain; `fits` are the model's."""
    # Returns the steps, whether no deviation remains after the last, and the trials of each effect alone.
    trials = search.trials(search.model, fits, search.candidates)
    first, explained = search.judged(_refined(trials), dict.fromkeys(search.candidates, search.model), {})
    if explained or not first.in_question:
        return (first,), explained, trials
    return *search.add_second(first), trials


@dataclass(frozen=True, eq=False)
class Search:
    """Session and model on which the effects are tried."""

    model: ForwardModel
    candidates: Mapping[str, Effect]  # by name of their parameter
    session: Session
    white: Whitening  # made with the model
    seed: int  # of the random signs
    measured: Measured
    report: Callable[[str], None]  # called with the name of each effect that is tried
    earlier: Mapping[str, Trial] = field(default_factory=dict)  # of each effect alone, on the same session

    def trials(self, here: ForwardModel, fits: Fits, names: Iterable[str]) -> dict[str, Trial]:
        """Try effects on top of a model, whose fits are given."""
        trials = {}
        for name in names:
            self.report(self.candidates[name].name)
            known = self.earlier.get(name) if here is self.model else None
            if known is None:
                made = (here, self.candidates[name], self.session, self.white, fits)
                trials[name] = Trial(*made, self.measured.get(name)).explored()
            else:
                trials[name] = known.with_measured(self.measured.get(name))
        return trials

    def judged(
        self, scores: Mapping[str, Scores], models: Mapping[str, ForwardModel], before: Mapping[str, Scores]
    ) -> tuple[Step, bool]:
        """Select the effects that are not distinguished from the best, and tell whether any leaves no deviation."""
        # If one does, those that clearly leave something are dropped.
        alike = _indistinguishable_from_best(scores)
        left = {name: find(_with(models[name], scores[name]), self.session, seed=self.seed) for name in alike}
        explaining = tuple(name for name in alike if left[name].leaves_nothing(LEFT, LEAST_RATIO))
        return Step(scores, explaining or alike, models, left, before), bool(explaining)

    def add_second(self, first: Step, *, again: bool = True) -> tuple[tuple[Step, ...], bool]:
        """Find a second effect to add to the likeliest, and the alternatives to the first."""
        # If an alternative is likelier together with the second, the second is sought again with that.
        used = first.in_question[0]
        names = [name for name in self.candidates if name != used]
        before, scores = self._scored_with(first.best, names)
        models = {name: _with(self.model, before[name]) if name in before else first.after for name in names}
        second, explained = self.judged(by_ratio(scores), models, before)
        if not explained:
            return (first, second), False
        pairs = self._alternatives(first, second)
        if again and next(iter(pairs)) != used:
            both, explained = self.add_second(replace(first, in_question=tuple(pairs)), again=False)
            if explained:
                return both, True
        pairs.pop(used, None)
        return (replace(first, in_question=(used, *pairs), scores={**first.scores, **pairs}), second), True

    def _alternatives(self, first: Step, second: Step) -> dict[str, Scores]:
        """Score the effects not distinguished from the likeliest, which comes first, together with the second."""
        used, name = first.in_question[0], second.in_question[0]
        others = [other for other in self.candidates if other not in (used, name)]
        pairs = {used: second.best, **self._scored_with(second.best, others)[1]}
        best = max(pairs, key=lambda candidate: float(pairs[candidate].total.max()))
        alike = {
            name: score for name, score in pairs.items() if name != best and _alike_with_others(pairs[best], score)
        }
        return {best: pairs[best]} | dict(sorted(alike.items(), key=lambda pair: -float(pair[1].total.max())))

    def _scored_with(self, known: Scores, names: Iterable[str]) -> tuple[dict[str, Scores], dict[str, Scores]]:
        """Score effects with a known one; return its scores jointly with each of the likeliest, and those of all."""
        here = _with(self.model, known)
        alone = fitted(here, self.session, self.white)
        scores, known_scores = _refined(self.trials(here, alone, names)), {}
        for name in _worth_measuring_together(scores):
            self.report(f"{known.effect.name} with {self.candidates[name].name}")
            known_scores[name], scores[name] = score_jointly(
                self.model, known, scores[name], self.session, self.white, alone, self.measured
            )
        return known_scores, scores


def _worth_measuring_together(scores: Mapping[str, Scores]) -> tuple[str, ...]:
    """Return the likeliest few on top of the first at its size."""
    most = max((score.log_likelihood_ratio for score in scores.values()), default=0.0)
    return tuple(
        name for name, score in scores.items() if score.log_likelihood_ratio > max(LEAST_RATIO, most - _FAR_BEHIND)
    )[:_TOGETHER]


def _refined(trials: Mapping[str, Trial]) -> dict[str, Scores]:
    """Return the scores of all, the likeliest first, refined for those that are not far behind."""
    most = max((trial.scores.log_likelihood_ratio for trial in trials.values()), default=0.0)
    for trial in trials.values():
        if trial.scores.log_likelihood_ratio > min(0.5 * most, most - _FAR_BEHIND):
            trial.refine()
    return by_ratio({name: trial.scores for name, trial in trials.items()})


def by_ratio(scores: Mapping[str, Scores]) -> dict[str, Scores]:
    """Return scores in the order of their log-likelihood ratio, the likeliest effect first."""
    return dict(sorted(scores.items(), key=lambda item: -item[1].log_likelihood_ratio))


def _with(model: ForwardModel, scores: Scores) -> FixedParameters:
    return FixedParameters(model + scores.effect, {scores.effect.parameter.name: scores.size})


def _indistinguishable_from_best(scores: Mapping[str, Scores]) -> tuple[str, ...]:
    """Return the likeliest effect, and those as likely but for the scatter from capsule to capsule."""
    seen = {name: score for name, score in scores.items() if not isinstance(score.effect, Unseen)}
    names = [name for name, score in seen.items() if score.log_likelihood_ratio > LEAST_RATIO]
    return tuple(name for name in names if _alike(scores[names[0]], scores[name]))


def _alike(best: Scores, other: Scores) -> bool:
    return indistinguishable(
        best.log_likelihood_ratio - other.log_likelihood_ratio, best.log_likelihood_ratios - other.log_likelihood_ratios
    )


def _alike_with_others(best: Scores, other: Scores) -> bool:
    """Tell the same of scores together with different effects."""
    lags = best.log_likelihood[best.best] - other.log_likelihood[other.best]
    return indistinguishable(float(best.total.max() - other.total.max()), lags)


def indistinguishable(lag: float, lags: Floats) -> bool:
    """Tell whether an effect lags behind another in log likelihood by no more than a few capsules decide."""
    # The lag is that of all that was measured, the lags (n,) those of each capsule. Beyond `AT_MOST` it decides.
    return lag < max(LEAST_RATIO, min(_APART * float(np.sqrt(np.sum(lags**2))), AT_MOST))


def probabilities(evidence: Mapping[str, float], trials: Mapping[str, Trial]) -> dict[str, float]:
    """Return the probabilities of explanations as probable beforehand, the most probable first; unseen ones omitted."""
    seen = {name: value for name, value in evidence.items() if name not in trials or not trials[name].unseen}
    most = max(seen.values(), default=0.0)
    weights = {name: float(np.exp(value - most)) for name, value in seen.items()}
    whole = sum(weights.values())
    return {name: weight / whole for name, weight in sorted(weights.items(), key=lambda item: -item[1])}


def evidences(scores: Mapping[str, Scores], finding: Finding) -> dict[str, float]:
    """Return the log evidence of each effect, of `NOTHING` and of `UNKNOWN`, relative to that of `NOTHING`."""
    # With equal prior probabilities, the odds of two explanations are the ratio of their evidences: of the likelihoods
    # averaged over the prior of the size of an effect, or over smooth deformations for something else. All candidates
    # are added to the same model, with which the finding was made; the likeliest comes first.
    log_evidence = {name: score.evidence for name, score in scores.items()}
    log_evidence |= {NOTHING: 0.0, UNKNOWN: finding.discrepancy.evidence}
    return dict(sorted(log_evidence.items(), key=lambda item: -item[1]))
