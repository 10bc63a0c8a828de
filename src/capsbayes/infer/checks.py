"""Gates, which a posterior must pass before its intervals are used, and the agreement of two engines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.prior import Marginal
from capsbayes.parameters import COORDINATES

MEANS_AGREE, SDS_AGREE = 0.1, 0.02
_QUANTILES_AGREE = 0.1

REFUSED_P, DOUBTFUL_P = 0.005, 0.05  # p-values below which intervals are not to be used, and below which it is said
FAR = 2.0  # standard deviations between two statements of one quantity, beyond which it is said


@dataclass(frozen=True)
class Gate:
    """One condition on a number."""

    name: str
    value: float
    least: float = -np.inf
    most: float = np.inf
    doubtful: float = -np.inf  # below it, a number that passes is said

    @classmethod
    def of_p_value(cls, name: str, p_value: float, tested: int = 1) -> Gate:
        """Return the gate on one of several independent p-values, of which the least has the stated levels."""
        return cls(name, p_value, least=REFUSED_P / tested, doubtful=DOUBTFUL_P / tested)

    @property
    def passed(self) -> bool:
        """True if the number lies within the limits; NaN does not."""
        return bool(self.least <= self.value <= self.most)

    @property
    def wanted(self) -> str:
        """The limits in words."""
        ends = {"at least": self.least, "at most": self.most}
        return " and ".join(f"{words} {end:g}" for words, end in ends.items() if np.isfinite(end))

    @property
    def caveat(self) -> str:
        """What a p-value that passes but is small means, and what would be expected; else empty."""
        if not self.passed or self.value >= self.doubtful:
            return ""
        return (
            f"The {self.name} is {self.value:.2g}. Were the model and the stated errors right, it would be below "
            f"{self.doubtful:.2g} in {100.0 * self.doubtful:.2g} % of measurements at most; below {self.least:.2g} the "
            "intervals are not to be used."
        )

    def as_dict(self) -> dict[str, float | str | bool]:
        """Return name, value, limits in words, the outcome and the caveat if there is one, for files."""
        caveat = {"caveat": self.caveat} if self.caveat else {}
        return {"name": self.name, "value": float(self.value), "wanted": self.wanted, "passed": self.passed, **caveat}

    def __str__(self) -> str:
        return f"{self.name}: {self.value:.4g}, wanted {self.wanted}{'' if self.passed else ' (FAILED)'}"


@dataclass(frozen=True)
class Agreement:
    """Largest differences of two engines: over the logarithms of all quantities but further coordinates."""

    mean: float  # of means and quantiles, in standard deviations
    sd: float  # of standard deviations, or of the widths of intervals where these differ less; relative
    quantile: float
    worst: str  # quantity, by its difference
    passed: bool

    def __str__(self) -> str:
        verdict = "agree" if self.passed else "DISAGREE"
        return (
            f"the engines {verdict}: means within {self.mean:.3f} sd (wanted {MEANS_AGREE:g}), sds within "
            f"{self.sd:.1%} (wanted {SDS_AGREE:.0%}), quantiles within {self.quantile:.3f} sd"
        )


def agreement(draws: Mapping[str, Floats], reference: Mapping[str, Marginal]) -> Agreement:
    """Compare the draws of an engine with the summaries of another, both of the logarithms of positive quantities."""
    means, sds, quantiles = {}, {}, {}
    for name, other in reference.items():
        if other.sd <= 1e-12:
            continue
        this = Marginal.of_draws(draws[name] if name in COORDINATES else np.log(draws[name]))
        means[name] = abs(this.mean - other.mean) / other.sd
        # A distant shape with 1e-5 of the probability widens the standard deviation of the grid by 10 %, but no
        # interval, and walkers do not find it: then the larger difference of the widths decides.
        widths = [[upper - lower for lower, upper in map(each.ends, (68, 95))] for each in (this, other)]
        wider = max(abs(here / there - 1.0) for here, there in zip(*widths, strict=True))
        sds[name] = min(abs(this.sd / other.sd - 1.0), wider)
        ends = ("median", "lower_68", "upper_68", "lower_95", "upper_95")
        quantiles[name] = max(abs(getattr(this, end) - getattr(other, end)) for end in ends) / other.sd
    worst = max(means, key=lambda name: max(means[name] / MEANS_AGREE, sds[name] / SDS_AGREE))
    mean, sd, quantile = (max(found.values()) for found in (means, sds, quantiles))
    return Agreement(
        mean, sd, quantile, worst, bool(mean <= MEANS_AGREE and sd <= SDS_AGREE and quantile <= _QUANTILES_AGREE)
    )
