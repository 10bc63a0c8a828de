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

from threadpoolctl import threadpool_limits

from capsbayes.diagnosis.compared import Compared
from capsbayes.diagnosis.evidence import UNKNOWN, evidences
from capsbayes.diagnosis.finding import Finding, find
from capsbayes.diagnosis.fits import fitted, whitening
from capsbayes.diagnosis.scoring import Measured, Scores, Trial
from capsbayes.diagnosis.search import LEAST_RATIO, Search, Step, searched
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.verification import Verification, verified
from capsbayes.effect import Effect
from capsbayes.effects import catalogue
from capsbayes.model import ForwardModel
from capsbayes.readable import Readable

__all__ = ["Study", "Verdict", "diagnose"]

Checked = Callable[[tuple[Step, ...]], tuple[tuple[Step, ...], Verification]]

_FEWEST = 12  # capsules of a session that can be divided


class Verdict(Enum):
    """What came of it."""

    NONE = "no disagreement was found"
    NAMED = "an effect explains it"
    AMBIGUOUS = "several effects explain it equally well"
    UNKNOWN = "no effect of the catalogue explains it"
    NOT_TESTABLE = "these data cannot tell"


@dataclass(frozen=True, eq=False, repr=False)
class Study(Readable):
    """Outcome of `diagnose`.

    Parameters
    ----------
    verdict : Verdict
    finding : Finding
        On the first half, under the model as it was.
    steps : tuple of Step
        Of the first half: one for each effect that was added, or tried in vain.
    verification : Verification or None
        Of the likeliest effect, or of both.
    model : ForwardModel
        With the effects, if they were named.
    sizes : mapping of str to float
        Sizes of the model's effects.
    session : Session
        All that was measured.
    seed : int
    level : float
    discover : Compared or None
        The first half beside the model as it was; None if there were too few to divide.
    again : Finding or None
        On the second half, if it does not show what the first did, and nothing explains it.
    evidence : mapping of str to float
        Logarithm of that of each candidate alone on the first half, of "none" and of "unknown", over that of "none".
    trials : mapping of str to Trial
        Of each candidate alone, on the first half.
    """

    verdict: Verdict
    finding: Finding
    steps: tuple[Step, ...]
    verification: Verification | None
    model: ForwardModel
    sizes: Mapping[str, float]
    session: Session
    seed: int
    level: float
    discover: Compared | None = None
    again: Finding | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)
    trials: Mapping[str, Trial] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """The effects in question, the likeliest first: names of their parameters."""
        return tuple(name for step in self.steps for name in step.alike)

    @property
    def scores(self) -> Mapping[str, Scores]:
        """Of every candidate on the first half, the likeliest first; of two effects, beside each other."""
        found = dict(self.steps[0].scores) if self.steps else {}
        found |= {name: step.scores[name] for step in self.steps[1:] for name in step.alike}
        return dict(sorted(found.items(), key=lambda item: -item[1].log_likelihood_ratio))

    def described(self) -> dict[str, str]:
        """Return the verdict, the finding and the effects in question with their sizes."""
        found = {"verdict": self.verdict.value, "capsules": str(len(self.session)), "finding": str(self.finding)}
        for step in self.steps:
            found |= {name: self._said(step.scores[name]) for name in step.alike}
        return found | {"model": self.model.name}

    def __str__(self) -> str:
        """One sentence."""
        if self.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
            again = "" if self.again is None else f"; not seen again: {self.again}"
            return f"{self.verdict.value} ({self.finding}{again})"
        groups = (" or ".join(self._said(step.scores[name]) for name in step.alike) for step in self.steps)
        return f"{self.verdict.value}: {'; with '.join(groups)} ({self.finding})"

    @staticmethod
    def _said(scores: Scores) -> str:
        parameter = scores.effect.parameter
        low, best, high = (parameter.shown(one) for one in (scores.interval()[0], scores.size, scores.interval()[1]))
        unit = "" if parameter.shown_unit in ("", "-") else f" {parameter.shown_unit}"
        return f"{scores.effect.name}, {parameter.symbol} = {best:.3g}{unit} [{low:.3g}, {high:.3g}]"


@threadpool_limits.wrap(limits=1)  # the matrices are tiny: threads would only wait for each other
def diagnose(
    session: Session,
    model: ForwardModel,
    *,
    seed: int,
    candidates: Mapping[str, Effect] | None = None,
    level: float = 0.05,
    measured: Measured | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    earlier: Study | None = None,
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
        By name of their parameter; by default the catalogue of the session's cross-section.
    level : float
        Probability of finding a disagreement where there is none.
    measured : mapping of str to (float, float), optional
        Sizes of effects as measured apart from the capsules, and their standard errors, in SI.
    progress : callable, optional
        Told what is done next, and how many of how many steps are behind.
    earlier : Study, optional
        Of the same session with the same model and seed, before more was measured; its fits are used again.

    Returns
    -------
    Study

    Raises
    ------
    ValueError
        If the earlier study is of another session, or its capsules were divided with another seed.
    """
    if earlier is not None and (earlier.session is not session or earlier.seed != seed):
        raise ValueError("earlier: expected a study of the same session with the same seed")
    made = partial(Study, session=session, seed=seed, level=level)
    if len(session) < _FEWEST:
        nothing = Finding((), float("nan"), len(session))
        return made(Verdict.NOT_TESTABLE, nothing, (), None, model, {})
    discover, confirm = session.halves(seed)
    effects = catalogue(session.experiment.cross_section) if candidates is None else candidates
    told = _Told(progress, len(effects) + 2)
    told("the model as it is")
    white = whitening(model, discover)
    fits = fitted(model, discover, white)
    finding = find(model, discover, seed=seed, white=white, fits=fits)
    made = partial(made, finding=finding, discover=Compared(discover, model, fits))
    if finding.p_value > level:
        verdict = Verdict.NONE if finding.deviations else Verdict.NOT_TESTABLE
        return made(verdict, steps=(), verification=None, model=model, sizes={})
    trials = {} if earlier is None else earlier.trials
    search = Search(model, effects, discover, white, seed, measured or {}, told, trials)
    steps, explained, trials = searched(search, fits)
    evidence = evidences({name: one.scores for name, one in trials.items()}, finding)
    made = partial(made, evidence=evidence, trials=trials)
    told("the held-out capsules")
    verification = None
    if steps[0].alike:
        checked = partial(verified, model, confirm=confirm, seed=seed, measured=measured or {}, found=finding.p_value)
        steps, verification = checked(steps)
        if explained and len(steps) == 1 and not verification.leaves_nothing:
            steps, verification = _with_a_second(search, steps, verification, checked)
    made = partial(made, model=model, sizes={})
    if verification is None or not (explained and verification.holds and _likely(steps, evidence)):
        again = find(model, confirm, seed=seed) if verification is None else verification.before
        if finding.together(again, among=level) > level:
            return made(Verdict.NONE, steps=(), verification=None, again=again)
        return made(Verdict.UNKNOWN, steps=steps, verification=verification)
    made = partial(made, steps=steps, verification=verification)
    if any(len(step.alike) > 1 for step in steps):
        return made(Verdict.AMBIGUOUS)
    extended: ForwardModel = model
    for step in steps:
        extended = extended + step.best.effect
    return made(Verdict.NAMED, model=extended, sizes={step.alike[0]: step.best.size for step in steps})


def _with_a_second(
    search: Search, steps: tuple[Step, ...], verification: Verification, checked: Checked
) -> tuple[tuple[Step, ...], Verification]:
    """With a second effect, if one explains what only the second half shows, and both hold there; else as given."""
    both, explained = search.second_beside(steps[0])
    if explained:
        both, verified_both = checked(both)
        if verified_both.holds:
            return both, verified_both
    return steps, verification


def _likely(steps: tuple[Step, ...], evidence: Mapping[str, float]) -> bool:
    """Whether one effect that explains it is far likelier than none, and not far less likely than an unknown one."""
    here = evidence[steps[0].alike[0]]
    return len(steps) > 1 or (here >= LEAST_RATIO and here >= evidence[UNKNOWN] - LEAST_RATIO)


class _Told:
    """Counts what is done."""

    def __init__(self, progress: Callable[[str, int, int], None] | None, steps: int) -> None:
        self.progress, self.steps, self.done = progress, steps, 0

    def __call__(self, step: str) -> None:
        if self.progress is not None:
            self.progress(step, min(self.done, self.steps - 1), self.steps)
        self.done += 1
