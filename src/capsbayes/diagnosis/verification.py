"""Verification of a model with effects on capsules that did not determine their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.interpolate import PchipInterpolator
from scipy.stats import wilcoxon

from capsbayes.arrays import Floats, Integers
from capsbayes.diagnosis.finding import Finding, find
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.scores import Scores, log_likelihood, whitening
from capsbayes.diagnosis.search import Comparison
from capsbayes.diagnosis.session import Session, Whitening
from capsbayes.model import FixedParameters, ForwardModel

_FINE = 2001  # sizes among which the likeliest by one half is sought


@dataclass(frozen=True)
class Verification:
    """All capsules before and after effects are added, each half with the sizes that the other half tells."""

    before: Finding
    after: Finding
    log_likelihood_ratios: Floats = field(repr=False)  # (n,): of each capsule, with the effects to without
    comparisons: tuple[Comparison, Comparison] = field(repr=False)  # with the model before and after
    sizes: tuple[Floats, ...] = ()  # (2,) of each effect: by the second half, and by the first

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
    def log_likelihood_ratio(self) -> float:
        """Mean log-likelihood ratio per capsule."""
        return float(self.log_likelihood_ratios.mean())

    @property
    def error(self) -> float:
        """Standard error of that mean."""
        return float(self.log_likelihood_ratios.std(ddof=1) / np.sqrt(len(self.log_likelihood_ratios)))

    @property
    def p_value(self) -> float:
        """Probability of ratios that speak as clearly for the effects if they are as likely to speak against them."""
        # By ranks (Wilcoxon 1945, doi:10.2307/3001968), so that one capsule does not decide.
        return float(wilcoxon(self.log_likelihood_ratios, alternative="greater").pvalue)

    @property
    def gaps(self) -> tuple[float, float]:
        """Root mean square distances of edges before and after [m], of the capsules with both shapes."""
        before, after = self.comparisons
        common = sorted(set(before.edges) & set(after.edges))
        return before.gap_of(common), after.gap_of(common)


def verified(
    model: ForwardModel,
    effects: Sequence[Scores],
    session: Session,
    white: Whitening,
    without: Fits,
    before: Finding,
    seed: int,
) -> Verification:
    """Compare each half of the capsules with the model and with effects of the sizes that the other half tells."""
    halves = session.halves(seed)
    each = {scores.effect.parameter.name: _by_halves(scores, halves) for scores in effects}
    sizes = {name: np.empty(len(session)) for name in each}
    for name, by in each.items():
        for half, size in zip(halves, reversed(by), strict=True):
            sizes[name][half] = size
    extended = model
    for scores in effects:
        extended = extended + scores.effect
    fits = fitted(extended, session, white, sizes)
    held = FixedParameters(extended, {scores.effect.parameter.name: scores.size for scores in effects})
    own = whitening(held, session)
    after = fitted(extended, session, own, sizes)
    return Verification(
        before=before,
        after=find(held, session, seed=seed, white=own, fits=after),
        log_likelihood_ratios=log_likelihood(fits) - log_likelihood(without),
        comparisons=(Comparison(session, model, without), Comparison(session, extended, after, sizes)),
        sizes=tuple(np.array(by) for by in each.values()),
    )


def _by_halves(scores: Scores, halves: Sequence[Integers]) -> list[float]:
    """Return the likeliest size of an effect by each half alone."""
    fine = np.linspace(scores.sizes[0], scores.sizes[-1], _FINE)
    totals = (scores.log_likelihood[:, half].sum(axis=1) + scores.elsewhere for half in halves)
    return [float(fine[np.argmax(PchipInterpolator(scores.sizes, total)(fine))]) for total in totals]
