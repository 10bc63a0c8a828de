"""The gates a posterior passes before its intervals are believed, and the agreement of two engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capsbayes.infer.kernel import border_steps
from capsbayes.infer.marginal import Marginal
from capsbayes.infer.sampling.convergence import autocorrelation_time, bulk_ess, split_rhat, tail_ess
from capsbayes.parameters import COORDINATES

__all__ = ["Agreement", "Gate", "agreement", "chain_gates", "ess_gates", "leaning"]

Floats = NDArray[np.float64]

FEWEST_ENSEMBLES = 4
LARGEST_RHAT = 1.01
FEWEST_TIMES = 50.0
LEAST_STABLE_TIME = 0.01
SMALLEST_ESS = 400.0
ACCEPTANCE = (0.1, 0.9)
MEANS_AGREE, SDS_AGREE = 0.1, 0.02
_QUANTILES_AGREE = 0.1
LEANING_SHARE = 0.05


@dataclass(frozen=True)
class Gate:
    """One condition on a number.

    Parameters
    ----------
    name : str
    value : float
        What was found.
    least, most : float
        Between which it is wanted.

    Examples
    --------
    >>> str(Gate("stuck walkers", 2, most=0))
    'stuck walkers: 2, wanted at most 0 (FAILED)'
    """

    name: str
    value: float
    least: float = -np.inf
    most: float = np.inf

    @property
    def passed(self) -> bool:
        """Whether the number is where it is wanted; NaN is not."""
        return bool(self.least <= self.value <= self.most)

    @property
    def wanted(self) -> str:
        """What is wanted, for people."""
        ends = {"at least": self.least, "at most": self.most}
        return " and ".join(f"{words} {end:g}" for words, end in ends.items() if np.isfinite(end))

    def as_dict(self) -> dict[str, float | str | bool]:
        """Name, value, what is wanted and whether it passed, for files."""
        return {"name": self.name, "value": float(self.value), "wanted": self.wanted, "passed": self.passed}

    def __str__(self) -> str:
        return f"{self.name}: {self.value:.4g}, wanted {self.wanted}{'' if self.passed else ' (FAILED)'}"


@dataclass(frozen=True)
class Agreement:
    """How far two engines differ.

    Parameters
    ----------
    mean, sd, quantile : float
        Largest difference of the means and of the quantiles, in standard deviations, and of the standard deviations
        (or of the widths of the intervals, where these differ less), relative; over the logarithms of all quantities
        but a further coordinate of the model, taken as it is.
    worst : str
        The quantity that differs most.
    passed : bool
    """

    mean: float
    sd: float
    quantile: float
    worst: str
    passed: bool

    def __str__(self) -> str:
        verdict = "agree" if self.passed else "DISAGREE"
        return (
            f"the engines {verdict}: means within {self.mean:.3f} sd (wanted {MEANS_AGREE:g}), sds within "
            f"{self.sd:.1%} (wanted {SDS_AGREE:.0%}), quantiles within {self.quantile:.3f} sd"
        )


def chain_gates(chain: Floats) -> list[Gate]:
    """Gates that need every step: R-hat, length in autocorrelation times, their stability, acceptance, stuck walkers.

    Parameters
    ----------
    chain : (steps, ensembles, walkers, d) array
        After burn-in.
    """
    steps, ensembles, walkers, dimensions = chain.shape
    flat = chain.reshape(steps, ensembles * walkers, dimensions)
    times = np.array([autocorrelation_time(flat[..., k]) for k in range(dimensions)])
    before = np.array([autocorrelation_time(flat[: int(0.95 * steps), :, k]) for k in range(dimensions)])
    rhat = max(split_rhat(chain[..., k]) for k in range(dimensions))
    moved = np.any(np.diff(chain, axis=0) != 0.0, axis=-1)
    acceptance = moved.mean(axis=(0, 2))
    stuck = int(np.count_nonzero(~moved[len(moved) // 2 :].any(axis=0)))
    unstable = float(np.max(np.abs(before / times - 1.0)))
    low, high = ACCEPTANCE
    return [
        Gate("independent ensembles", ensembles, least=FEWEST_ENSEMBLES),
        Gate("split R-hat between ensembles", rhat, most=LARGEST_RHAT),
        Gate("steps over autocorrelation time", steps / float(times.max()), least=FEWEST_TIMES),
        Gate("change of autocorrelation time over the last twentieth", unstable, most=LEAST_STABLE_TIME),
        Gate("lowest acceptance", float(acceptance.min()), least=low),
        Gate("highest acceptance", float(acceptance.max()), most=high),
        Gate("stuck walkers", stuck, most=0),
    ]


def ess_gates(draws: Mapping[str, Floats]) -> list[Gate]:
    """Gates on the effective sample sizes of the reported quantities that vary.

    Parameters
    ----------
    draws : mapping of (chains, draws) arrays
    """
    varying = [values for values in draws.values() if np.ptp(values) > 0.0]
    found = {"smallest bulk ESS": min(map(bulk_ess, varying)), "smallest tail ESS": min(map(tail_ess, varying))}
    return [Gate(name, value, least=SMALLEST_ESS) for name, value in found.items()]


def agreement(draws: Mapping[str, Floats], reference: Mapping[str, Marginal]) -> Agreement:
    """Compare the draws of an engine with the summaries of another, both of the logarithms of positive quantities.

    Parameters
    ----------
    draws : mapping of arrays
        Of the quantities themselves.
    reference : mapping of Marginal
        Of their logarithms; of those of `COORDINATES`, which may vanish, of the quantities themselves.
    """
    means, sds, quantiles = {}, {}, {}
    for name, other in reference.items():
        if other.sd <= 1e-12:
            continue
        this = Marginal.of_draws(draws[name] if name in COORDINATES else np.log(draws[name]))
        means[name] = abs(this.mean - other.mean) / other.sd
        sds[name] = min(abs(this.sd / other.sd - 1.0), _widths_differ(this, other))
        ends = ("median", "lower_68", "upper_68", "lower_95", "upper_95")
        quantiles[name] = max(abs(getattr(this, end) - getattr(other, end)) for end in ends) / other.sd
    worst = max(means, key=lambda name: max(means[name] / MEANS_AGREE, sds[name] / SDS_AGREE))
    mean, sd, quantile = (max(found.values()) for found in (means, sds, quantiles))
    return Agreement(
        mean, sd, quantile, worst, bool(mean <= MEANS_AGREE and sd <= SDS_AGREE and quantile <= _QUANTILES_AGREE)
    )


def _widths_differ(this: Marginal, other: Marginal) -> float:
    """Relative difference of the widths of the intervals, the larger of the two.

    A shape far away with 1e-5 of the probability widens the standard deviation of the grid by 10 % and no interval, and
    walkers do not find it: then these decide.
    """
    widths = [(one.upper_68 - one.lower_68, one.upper_95 - one.lower_95) for one in (this, other)]
    return max(abs(here / there - 1.0) for here, there in zip(*widths, strict=True))


def leaning(  # type: ignore[no-untyped-def]
    draws: Mapping[str, Floats], names: Sequence[str], contains, held: Sequence[str] = ()
) -> float:
    """Share of the posterior within half a standard deviation of a border.

    Parameters
    ----------
    draws : mapping of arrays
        Positive quantities.
    names : sequence of str
        Those in which the border lies.
    contains : callable
        Takes one array for each name and says which points are within.
    held : sequence of str
        Further quantities that it takes, which are not moved; the steps are those of the others given these.

    Returns
    -------
    float
        Share of the draws that some step along a principal axis of their
        logarithms takes beyond the border.
    """
    logs = np.stack([np.log(np.ravel(draws[name])) for name in names])
    every = slice(None, None, max(1, logs.shape[1] // 4000))
    logs, others = logs[:, every], [np.ravel(draws[name])[every] for name in held]
    out = np.zeros(logs.shape[1], dtype=bool)
    for step in border_steps(np.atleast_2d(np.cov(_given(logs, others)))):
        out |= ~contains(*np.exp(logs + step[:, None]), *others)
    return float(out.mean())


def _given(logs: Floats, held: Sequence[Floats]) -> Floats:
    """What is left of each row once a parabola in each of the held quantities is taken out : (names, n) array."""
    if not held:
        return logs
    basis = np.stack([np.ones(logs.shape[1]), *held, *(one**2 for one in held)], axis=1)
    return logs - (basis @ np.linalg.lstsq(basis, logs.T, rcond=None)[0]).T
