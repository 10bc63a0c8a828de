"""Find, name, add, verify: what a model misses in a session of capsules.

The capsules are divided before anything is looked at. On the first half it is
found whether they disagree with the model, and which effects would explain it;
on the second half, whether the model with the effect does better.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capsbayes.discrepancy.compared import Compared
from capsbayes.discrepancy.finding import Finding, find
from capsbayes.discrepancy.fits import Whitening, fitted, whitening
from capsbayes.discrepancy.scoring import Scores, log_likelihood, scored
from capsbayes.discrepancy.session import Session
from capsbayes.effect import Effect, Extendable
from capsbayes.effects import catalogue
from capsbayes.model import ForwardModel

__all__ = ["Study", "Verdict", "Verification", "diagnose"]

Floats = NDArray[np.float64]

_FEWEST = 12  # capsules of a session that can be divided
_LEAST_GAIN = 3.0  # in log likelihood, below which an effect explains nothing, or no more than another
_APART = 2.5  # standard errors between the gains of two effects, below which they are not told apart
_LEFT = 0.01  # chance of what is left over, below which an effect does not explain enough
_VERIFIED = 2.0  # standard errors of the gain per capsule on the second half


class Verdict(Enum):
    """What came of it."""

    NONE = "no disagreement was found"
    NAMED = "an effect explains it"
    AMBIGUOUS = "several effects explain it equally well"
    UNKNOWN = "no effect of the catalogue explains it"
    NOT_TESTABLE = "these data cannot tell"


@dataclass(frozen=True)
class Verification:
    """The second half before and after the effect is added.

    Parameters
    ----------
    gain, error : float
        Log likelihood per capsule that the effect gains, and its standard error.
    before, after : Finding
    gains : (n,) array
        Of each capsule.
    compared : (Compared, Compared)
        The capsules beside the model before and after.
    """

    gain: float
    error: float
    before: Finding
    after: Finding
    gains: Floats = field(repr=False)
    compared: tuple[Compared, Compared] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Study:
    """Outcome of `diagnose`.

    Parameters
    ----------
    verdict : Verdict
    finding : Finding
        On the first half, under the model as it was.
    names : tuple of str
        The effect, or those that are not told apart, the likeliest first: names of their parameters.
    scores : mapping of str to Scores
        Of every candidate on the first half, the likeliest first.
    verification : Verification or None
        Of the likeliest effect.
    model : ForwardModel
        With the effect, if one was named.
    sizes : mapping of str to float
        Sizes of the model's effects.
    session : Session
        All that was measured.
    seed : int
    level : float
    discover : Compared or None
        The first half beside the model as it was; None if there were too few to divide.
    """

    verdict: Verdict
    finding: Finding
    names: tuple[str, ...]
    scores: Mapping[str, Scores]
    verification: Verification | None
    model: ForwardModel
    sizes: Mapping[str, float]
    session: Session = field(repr=False)
    seed: int
    level: float
    discover: Compared | None = field(default=None, repr=False)

    def __str__(self) -> str:
        """One sentence."""
        if self.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
            return f"{self.verdict.value} ({self.finding})"
        said = " or ".join(self._said(self.scores[name]) for name in self.names)
        return f"{self.verdict.value}: {said} ({self.finding})"

    @staticmethod
    def _said(scores: Scores) -> str:
        parameter = scores.effect.parameter
        low, best, high = (parameter.shown(one) for one in (scores.interval()[0], scores.size, scores.interval()[1]))
        unit = "" if parameter.shown_unit in ("", "-") else f" {parameter.shown_unit}"
        return f"{scores.effect.name}, {parameter.symbol} = {best:.3g}{unit} [{low:.3g}, {high:.3g}]"


def diagnose(
    session: Session,
    model: Extendable,
    *,
    seed: int,
    candidates: Mapping[str, Effect] | None = None,
    level: float = 0.05,
    progress: Callable[[str, int, int], None] | None = None,
) -> Study:
    """Say what a model misses in a session.

    Parameters
    ----------
    session : Session
    model : forward model
        As ``Surrogate.open("square-neo-hookean")``.
    seed : int
        Of the division into halves and of the random signs.
    candidates : mapping of str to Effect, optional
        By name of their parameter; by default the catalogue.
    level : float
        Probability of finding a disagreement where there is none.
    progress : callable, optional
        Told what is done next, and how many of how many steps are behind.

    Returns
    -------
    Study
    """
    assert isinstance(model, ForwardModel), "a model with an answer"
    made = partial(Study, session=session, seed=seed, level=level)
    if len(session) < _FEWEST:
        nothing = Finding((), float("nan"), len(session))
        return made(Verdict.NOT_TESTABLE, nothing, (), {}, None, model, {})
    discover, confirm = session.halves(seed)
    effects = catalogue() if candidates is None else candidates
    tell = progress or _silent
    tell("the model as it is", 0, len(effects) + 3)
    white = whitening(model, discover)
    fits = fitted(model, discover, white)
    finding = find(model, discover, seed=seed, white=white, fits=fits)
    made = partial(made, discover=Compared(discover, model, fits))
    if finding.chance > level:
        verdict = Verdict.NONE if finding.deviations else Verdict.NOT_TESTABLE
        return made(verdict, finding, (), {}, None, model, {})
    scores = {}
    for done, (name, effect) in enumerate(effects.items(), start=1):
        tell(effect.name, done, len(effects) + 3)
        scores[name] = scored(model, effect, discover, white)
    scores = dict(sorted(scores.items(), key=lambda item: -item[1].gains.sum()))
    tell("what is left over", len(effects) + 1, len(effects) + 3)
    alike = tuple(name for name in _not_told_apart(scores) if _explains(model, scores[name], discover, white, seed))
    if not alike:
        return made(Verdict.UNKNOWN, finding, (), scores, None, model, {})
    best = scores[alike[0]]
    tell("the capsules laid aside", len(effects) + 2, len(effects) + 3)
    verification = _verified(model, best, confirm, seed)
    if verification.gain < _VERIFIED * verification.error or verification.after.chance < _LEFT:
        return made(Verdict.UNKNOWN, finding, alike, scores, verification, model, {})
    if len(alike) > 1:
        return made(Verdict.AMBIGUOUS, finding, alike, scores, verification, model, {})
    sizes = {alike[0]: best.size}
    return made(Verdict.NAMED, finding, alike, scores, verification, model + best.effect, sizes)


def _silent(step: str, done: int, steps: int) -> None:
    """Tell nobody."""


def _not_told_apart(scores: Mapping[str, Scores]) -> tuple[str, ...]:
    """The effect that gains most, and those that gain as much but for the scatter from capsule to capsule."""
    names = [name for name, one in scores.items() if one.gains.sum() > _LEAST_GAIN]
    if not names:
        return ()
    best = scores[names[0]].gains
    return tuple(name for name in names if _alike(best - scores[name].gains))


def _alike(differences: Floats) -> bool:
    lead = float(differences.sum())
    return lead < max(_LEAST_GAIN, _APART * float(np.sqrt(np.sum(differences**2))))


def _explains(model: Extendable, scores: Scores, session: Session, white: Whitening, seed: int) -> bool:
    extended = model + scores.effect
    left = find(extended, session, seed=seed, white=white, sizes={scores.effect.parameter.name: scores.size})
    return left.chance >= _LEFT


def _verified(model: Extendable, scores: Scores, confirm: Session, seed: int) -> Verification:
    assert isinstance(model, ForwardModel), "a model with an answer"
    white = whitening(model, confirm)
    extended, name = model + scores.effect, scores.effect.parameter.name
    likelihoods, findings, compared = [], [], []
    for size in (scores.effect.null_value, scores.size):
        fits = fitted(extended, confirm, white, {name: size})
        likelihoods.append(log_likelihood(fits))
        findings.append(find(extended, confirm, seed=seed, white=white, sizes={name: size}, fits=fits))
        compared.append(Compared(confirm, extended, fits, {name: size}))
    gains = likelihoods[1] - likelihoods[0]
    error = float(gains.std(ddof=1) / np.sqrt(len(gains)))
    return Verification(
        float(gains.mean()), error, findings[0], findings[1], gains, compared=(compared[0], compared[1])
    )
