"""Effects that explain why a session disagrees with a model: one, or one and what it leaves over."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from capsbayes.discrepancy.finding import Finding, find
from capsbayes.discrepancy.fits import Fits, fitted
from capsbayes.discrepancy.scoring import Scores, Trial
from capsbayes.discrepancy.session import Session
from capsbayes.discrepancy.whitening import Whitening
from capsbayes.effect import Effect, ExtendableModel, Held

__all__ = ["LEAST_GAIN", "LEFT", "Measured", "Step", "not_told_apart", "searched"]

Floats = NDArray[np.float64]
Measured = Mapping[str, tuple[float, float]]
"""By parameter of an effect: its size as measured apart from the capsules, and the standard error."""

LEFT = 0.01
"""Chance of what is left over, below which it is not explained."""

LEAST_GAIN = 3.0
"""In log likelihood, below which an effect explains nothing, or no more than another."""

_MOST = 2  # effects that are added
_FAR_BEHIND = 20.0  # in log likelihood, beyond which an effect is not looked at more closely
_APART = 2.5  # standard errors between the gains of two effects, below which they are not told apart


@dataclass(frozen=True, eq=False)
class Step:
    """One effect that is added.

    Parameters
    ----------
    scores : mapping of str to Scores
        Of every candidate, beside the effects added before, the likeliest first.
    alike : tuple of str
        The likeliest, and those that are not told apart from it; empty if none explains anything.
    model : ForwardModel
        To which it is added: with the effects added before, at their sizes.
    left : mapping of str to Finding
        What each that is not told apart from the likeliest leaves over.
    """

    scores: Mapping[str, Scores]
    alike: tuple[str, ...]
    model: ExtendableModel = field(repr=False)
    left: Mapping[str, Finding] = field(repr=False)

    @property
    def best(self) -> Scores:
        """Of the effect that is added."""
        return self.scores[self.alike[0]]

    @property
    def after(self) -> Held:
        """The model with the effect at its size."""
        return self.with_effect(self.alike[0])

    def with_effect(self, name: str) -> Held:
        """The model with one of the candidates at its size."""
        return _with(self.model, self.scores[name])


def searched(
    model: ExtendableModel,
    candidates: Mapping[str, Effect],
    session: Session,
    white: Whitening,
    fits: Fits,
    *,
    seed: int,
    measured: Measured,
    tell: Callable[[str], None],
) -> tuple[tuple[Step, ...], bool]:
    """Try every effect, and beside the likeliest every other if it leaves something over.

    Parameters
    ----------
    model : forward model
    candidates : mapping of str to Effect
        By name of their parameter.
    session : Session
    white : Whitening
        Made with the model.
    fits : Fits
        Of the model.
    seed : int
        Of the random signs.
    measured : mapping of str to (float, float)
    tell : callable
        Is told each effect that is tried.

    Returns
    -------
    steps, explained
        Whether nothing is left over beside the last step.
    """
    steps: list[Step] = []
    here = model
    for _ in range(_MOST):
        used = {step.alike[0] for step in steps}
        trials = {}
        for name, effect in candidates.items():
            if name not in used:
                tell(effect.name)
                trials[name] = Trial(here, effect, session, white, fits, measured.get(name))
        scores = _refined(trials)
        alike = _not_told_apart(scores)
        left = {name: find(_with(here, scores[name]), session, seed=seed) for name in alike}
        explaining = tuple(name for name in alike if left[name].leaves_nothing(LEFT))
        steps.append(Step(scores, explaining or alike, here, left))
        if explaining or not alike:
            break
        here = steps[-1].after
        fits = fitted(here, session, white)
    explained = bool(explaining)
    return (
        _beside_each_other(steps, session, white, measured) if len(steps) == _MOST and explained else tuple(steps)
    ), explained


def _refined(trials: Mapping[str, Trial]) -> dict[str, Scores]:
    """Scores of all, the likeliest first; of those that are not far behind at more sizes."""
    most = max((one.scores.gain for one in trials.values()), default=0.0)
    for one in trials.values():
        if one.scores.gain > min(0.5 * most, most - _FAR_BEHIND):
            one.refine()
    return dict(sorted(((name, one.scores) for name, one in trials.items()), key=lambda item: -item[1].gain))


def _beside_each_other(steps: list[Step], session: Session, white: Whitening, measured: Measured) -> tuple[Step, ...]:
    """The steps with the size of the first effect as it is beside the second."""
    first, second = steps
    name = first.alike[0]
    beside = _with(first.model, second.best)
    without = fitted(beside, session, white)
    again = Trial(beside, first.best.effect, session, white, without, measured.get(name))
    again.refine()
    first = replace(first, scores={**first.scores, name: again.scores})
    return first, replace(second, model=first.after)


def _with(model: ExtendableModel, scores: Scores) -> Held:
    return Held(model + scores.effect, {scores.effect.parameter.name: scores.size})


def _not_told_apart(scores: Mapping[str, Scores]) -> tuple[str, ...]:
    """The effect that gains most, and those that gain as much but for the scatter from capsule to capsule."""
    names = [name for name, one in scores.items() if one.gain > LEAST_GAIN]
    return tuple(name for name in names if _alike(scores[names[0]], scores[name]))


def _alike(best: Scores, other: Scores) -> bool:
    return not_told_apart(best.gain - other.gain, best.gains - other.gains)


def not_told_apart(lag: float, lags: Floats) -> bool:
    """Whether one effect lags behind another in log likelihood by no more than what a few capsules make of it.

    Parameters
    ----------
    lag : float
        Of all that was measured.
    lags : (n,) array
        Of each capsule.
    """
    return lag < max(LEAST_GAIN, _APART * float(np.sqrt(np.sum(lags**2))))
