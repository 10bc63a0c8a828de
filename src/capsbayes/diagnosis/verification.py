"""Verification of a model with an effect on held-out capsules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import norm

from capsbayes.arrays import Floats
from capsbayes.diagnosis.finding import Finding, find
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import Measured, log_likelihood, whitening
from capsbayes.diagnosis.search import AT_MOST, LEAST_RATIO, LEFT, Comparison, Step, indistinguishable
from capsbayes.diagnosis.session import Session
from capsbayes.model import Effect, ForwardModel

_NOT_WORSE = 1.64  # standard errors by which an effect that was established elsewhere may fall behind
_WORTH_A_LOOK = 0.5  # p-value of a deviation remaining in the first half, up to which it is tested on the second
_ESTABLISHED = 3.0  # standard errors from the null value, from which an effect measured elsewhere is there


class MeanRatio(NamedTuple):
    """Mean log-likelihood ratio of an effect over the capsules, and its standard error."""

    mean: float
    error: float

    @classmethod
    def of(cls, ratios: Floats) -> MeanRatio:
        """Average the ratios of all capsules (n,)."""
        return cls(float(ratios.mean()), float(ratios.std(ddof=1) / np.sqrt(len(ratios))))


@dataclass(frozen=True)
class Verification:
    """Held-out capsules before and after the effect is added."""

    log_likelihood_ratio: float  # mean per capsule, with the effect to without
    error: float  # its standard error
    before: Finding
    after: Finding
    left: Finding  # deviations that remain in the first half with the effect
    log_likelihood_ratios: Floats = field(repr=False)  # (n,): of each capsule
    steps: tuple[MeanRatio, ...]  # of each effect over those before
    comparisons: tuple[Comparison, Comparison] = field(repr=False)  # with the model before and after
    established: tuple[bool, ...]  # of each step, whether its effect is known from what was measured elsewhere
    first_p_value: float  # of the disagreement that the first half shows
    of_something_else: float = -np.inf  # its log score here, once it has seen the first half, relative to no effect
    ahead_before: float = 0.0  # log evidence of the effects on the first half, over that of something else
    level: float = 0.05  # significance of both halves together, below which the effects hold

    def table(self) -> pd.DataFrame:
        """Return a row for the model ``before`` and ``after`` the effect is added, SI."""
        findings = {"before": self.before, "after": self.after}
        ratios = {"before": (0.0, 0.0), "after": (self.log_likelihood_ratio, self.error)}
        rows = {
            when: (gap, finding.noise, finding.p_value, comparison.median_modulus, *ratios[when])
            for (when, finding), comparison, gap in zip(findings.items(), self.comparisons, self.gaps, strict=True)
        }
        columns = ("gap", "noise_over_assumed", "p_value", "surface_shear_modulus")
        errors = ("log_likelihood_ratio", "log_likelihood_ratio_error")
        return pd.DataFrame.from_dict(rows, orient="index", columns=(*columns, *errors))

    @property
    def gaps(self) -> tuple[float, float]:
        """Root mean square distances of edges before and after [m], of the capsules with both shapes."""
        before, after = self.comparisons
        common = sorted(set(before.edges) & set(after.edges))
        return before.gap_of(common), after.gap_of(common)

    @property
    def leaves_nothing(self) -> bool:
        """True if no deviation remains here or in both halves, and these do not speak for something else besides."""
        both = self.left.discrepancy + self.after.discrepancy
        p_value = min(self.after.p_value, self.left.combined_p_value(self.after, _WORTH_A_LOOK))
        return p_value >= LEFT and both.evidence <= LEAST_RATIO

    @property
    def ahead(self) -> float:
        """Log score of the effects on these capsules, over that of something else that has seen the first half."""
        return float(self.log_likelihood_ratios.sum()) - self.of_something_else

    @property
    def ahead_by_both(self) -> float:
        """Log evidence of the effects over that of something else, by both halves."""
        return self.ahead_before + self.ahead

    @property
    def beats_something_else(self) -> bool:
        """True if the effects predict these capsules better than something else, or all were measured elsewhere."""
        # Also where they predict them hardly worse, and both halves together speak clearly for the effects.
        hardly_behind = self.ahead > -LEAST_RATIO and self.ahead_by_both > LEAST_RATIO
        return all(self.established) or self.ahead > 0.0 or hardly_behind

    @property
    def something_else_in_question(self) -> bool:
        """True if both halves together do not rule something else out, and no effect was measured elsewhere."""
        return not all(self.established) and self.ahead_by_both < AT_MOST

    @property
    def holds(self) -> bool:
        """True if each effect predicts these capsules better, an established one not worse, and nothing remains."""
        # Together they must predict them better than something else does. The first must do the better the less
        # surprising the disagreement was in the first half, so that under a right model both together are significant.
        wanted = float(norm.isf(self.level))
        together = max(np.sqrt(2.0) * wanted - float(norm.isf(self.first_p_value)), 0.0)
        least = (together, *(wanted for _ in self.steps[1:]))
        return (
            self.leaves_nothing
            and self.beats_something_else
            and all(
                ratio.mean >= (-_NOT_WORSE if known else sigma) * ratio.error
                for ratio, sigma, known in zip(self.steps, least, self.established, strict=True)
            )
        )


def verified(
    model: ForwardModel,
    steps: tuple[Step, ...],
    *,
    confirm: Session,
    seed: int,
    measured: Measured,
    first: Finding,
    level: float,
) -> tuple[tuple[Step, ...], Verification]:
    """Compare the held-out capsules with the model, and with each further effect."""
    # Of the effects that the first half did not distinguish, those stay in question that leave no deviation here and
    # that both halves together do not distinguish. Ratios use one covariance for all models; the remaining deviations
    # use that of the model with the effects. Of two effects, the first is returned at its size jointly with the second.
    white = whitening(model, confirm)
    *before, last = (step for step in steps if step.in_question)
    models: list[ForwardModel] = [model, *(step.after for step in before)]
    fits = [fitted(variant, confirm, white) for variant in models]
    chain = [log_likelihood(fit) for fit in fits]
    shown = find(model, confirm, seed=seed, white=white, fits=fits[0]), Comparison(confirm, model, fits[0])
    of_something_else = (first.discrepancy + shown[0].discrepancy).evidence - first.discrepancy.evidence

    evidence_before = sum(step.best.evidence for step in before)

    def tried(name: str) -> Verification:
        extended = last.with_effect(name)
        likelihoods = np.array([*chain, log_likelihood(fitted(extended, confirm, white))])
        ratios = likelihoods[-1] - likelihoods[0]
        whole = MeanRatio.of(ratios)
        own = whitening(extended, confirm)
        fit = fitted(extended, confirm, own)
        return Verification(
            log_likelihood_ratio=whole.mean,
            error=whole.error,
            before=shown[0],
            after=find(extended, confirm, seed=seed, white=own, fits=fit),
            left=last.left[name],
            log_likelihood_ratios=ratios,
            steps=tuple(MeanRatio.of(change) for change in np.diff(likelihoods, axis=0)),
            comparisons=(shown[1], Comparison(confirm, extended, fit)),
            established=tuple(
                _established(effect, measured)
                for effect in (*(step.best.effect for step in before), last.scores[name].effect)
            ),
            first_p_value=first.p_value,
            of_something_else=of_something_else,
            ahead_before=evidence_before + last.scores[name].evidence - first.discrepancy.evidence,
            level=level,
        )

    tries = {name: tried(name) for name in last.in_question}
    in_question = _in_question(last, tries)
    if not in_question:
        return steps, tries[last.in_question[0]]
    name = in_question[0]
    if name in last.before:
        before = [replace(step, scores={**step.scores, step.in_question[0]: last.before[name]}) for step in before]
    return (*before, replace(last, in_question=in_question)), tries[name]


def _in_question(step: Step, tries: Mapping[str, Verification]) -> tuple[str, ...]:
    """Select effects that both halves do not distinguish and that leave no deviation; one that holds comes first."""
    # Where the likeliest leaves a deviation that may be chance, it stays in question next to less likely ones that
    # leave none, if it is far likelier than they.
    ratios = {
        name: np.concatenate([step.scores[name].log_likelihood_ratios, verification.log_likelihood_ratios])
        for name, verification in tries.items()
    }
    total = {
        name: step.scores[name].log_likelihood_ratio + float(verification.log_likelihood_ratios.sum())
        for name, verification in tries.items()
    }
    best, *others = sorted(total, key=lambda name: -total[name])
    alike = [
        best,
        *(name for name in others if indistinguishable(total[best] - total[name], ratios[best] - ratios[name])),
    ]
    explaining = [name for name in alike if tries[name].leaves_nothing]
    if not explaining:
        return ()
    if best not in explaining and total[best] - total[explaining[0]] > LEAST_RATIO:
        explaining.append(best)
    return tuple(sorted(explaining, key=lambda name: not tries[name].holds))


def _established(effect: Effect, measured: Measured) -> bool:
    size, error = measured.get(effect.parameter.name, (effect.null_value, np.inf))
    return abs(size - effect.null_value) >= _ESTABLISHED * error
