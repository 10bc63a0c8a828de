"""Diagnosis of a session: find, name, add, verify."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

import capsbayes
from capsbayes.arguments import checked
from capsbayes.diagnosis.finding import (
    Explanation,
    Finding,
    SessionModulus,
    find,
    limit_scores,
    limits_table,
    own_size_error,
    session_modulus,
)
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.scores import Measured, Scores, Trial, whitening
from capsbayes.diagnosis.search import (
    LEAST_RATIO,
    UNKNOWN,
    Comparison,
    Search,
    Step,
    by_ratio,
    evidences,
    probabilities,
    searched,
)
from capsbayes.diagnosis.session import Session, Whitening
from capsbayes.diagnosis.verification import Verification, verified
from capsbayes.effects import catalogue
from capsbayes.errors import NoShapeError
from capsbayes.model import Effect, ForwardModel
from capsbayes.readable import Readable

if TYPE_CHECKING:
    from capsbayes.infer.population import Population


# The capsules are divided before anything is compared. The first half shows whether they disagree with the model, and
# which effects would explain that; the second half is held out and shows whether the model with the effect predicts it
# better

Checked = Callable[[tuple[Step, ...]], tuple[tuple[Step, ...], Verification]]

_FEWEST = 12  # capsules of a session that can be divided


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
        Deviations of the first half from the model.
    steps : tuple of Step
        One for each effect that was added, or tried in vain, on the first half.
    verification : Verification or None
        Held-out capsules with the likeliest effect, or with both.
    model : ForwardModel
        With the effects, if they were named.
    sizes : mapping of str to float
        Sizes of the model's effects.
    session : Session
    seed : int
    level : float
    first_half : Comparison or None
        The first half and the model without effects, all capsules if the verdict is `by_all`; None if there were too
        few capsules to divide.
    second_finding : Finding or None
        Deviations of the second half, if it does not confirm those of the first.
    evidence : mapping of str to float
        Log evidence of each candidate alone on the first half, of "none" and of "unknown", relative to that of "none".
    trials : mapping of str to Trial
        Fits of each candidate alone to the first half.
    candidates : mapping of str to Effect
        Effects that are tried, or would be.
    not_testable : tuple of str
        Names of effects that were not tried, as nothing that shows them was measured, such as the flow rates.
    measured : mapping of str to (float, float)
        Sizes of effects measured independently of the capsules, and their standard errors.
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
    first_half: Comparison | None = None
    second_finding: Finding | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)
    trials: Mapping[str, Trial] = field(default_factory=dict)
    candidates: Mapping[str, Effect] = field(default_factory=dict)
    not_testable: tuple[str, ...] = ()
    measured: Measured = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters of the effects in question, the likeliest first; the nearest if none explains it."""
        return tuple(name for step in self.steps for name in step.in_question)

    @property
    def something_else(self) -> bool:
        """Whether something else is in question, too, next to the effects that may explain the deviations."""
        if self.verdict is not Verdict.AMBIGUOUS or self.verification is None:
            return False
        return self.verification.something_else_in_question

    @property
    def name(self) -> str:
        """Name of the effect that explains the deviations, two joined by "and"; else the verdict, as "unknown"."""
        named = self.verdict is Verdict.NAMED
        return " and ".join(step.best.effect.name for step in self.steps) if named else self.verdict.name.lower()

    @property
    def gap(self) -> tuple[float, float]:
        """Root mean square distances [m] of edges from the model without and with the effects.

        They are those of the held-out capsules; NaN where nothing was verified, or without outlines.
        """
        if self.verification is None:
            return float("nan"), float("nan")
        return self.verification.gaps

    @property
    def probabilities(self) -> Mapping[str, float]:
        """Probability of each candidate alone, of "none" and of "unknown", before held-out capsules are looked at.

        All are as probable beforehand; effects that change nothing that is seen are none of these.
        """
        return probabilities(self.evidence, self.trials)

    @property
    def by_all(self) -> bool:
        """Whether all capsules gave the verdict and the probabilities, as where no half alone shows an effect."""
        return self.verdict is Verdict.NONE or (self.first_half is not None and self.first_half.session is self.session)

    @cached_property
    def all_probabilities(self) -> Mapping[str, float]:
        """`probabilities`; by all capsules where no disagreement was found."""
        if self.verdict is not Verdict.NONE:
            return self.probabilities
        return probabilities(self._whole_evidence, self.trials)

    @property
    def _whole_evidence(self) -> Mapping[str, float]:
        return evidences(self._limit_scores, self._whole_finding)

    def _judged_by_all(self) -> Study:
        """Return the study, as UNKNOWN where all capsules together deny the verdict that nothing is missing."""
        # Neither half has confirmed what the other shows, so that no effect is named.
        evidence = self._whole_evidence
        if not _clearly_likelier(evidence):
            return self
        likelier = tuple(name for name in self._limit_scores if evidence[name] > LEAST_RATIO)
        step = Step(by_ratio(self._limit_scores), tuple(sorted(likelier, key=lambda name: -evidence[name])), {}, {})
        return replace(
            self,
            verdict=Verdict.UNKNOWN,
            finding=self._whole_finding,
            steps=(step,),
            first_half=Comparison(self.session, self.model, self._whole[1]),
            second_finding=None,
            evidence=evidence,
        )

    @cached_property
    def limits(self) -> pd.DataFrame:
        """Effects that could hide where no disagreement was found, a row each; empty for any other verdict.

        Columns: ``effect``; ``low`` and ``high`` [``unit``], the 95 % interval of its size; ``modulus_at_low`` and
        ``modulus_at_high``, the median G_s with these sizes over that without the effect; ``unbounded``, whether the
        data allow the effect up to the end of its prior. All capsules count. They are computed when they
        are first asked for, in some tens of seconds for the catalogue.
        """
        return limits_table(self._limit_scores)

    @cached_property
    @threadpool_limits.wrap(limits=1)
    def _limit_scores(self) -> Mapping[str, Scores]:
        if self.verdict is not Verdict.NONE:
            return {}
        white, fits = self._whole
        return limit_scores(self.model, self.candidates, self.session, white, fits, self.measured)

    @cached_property
    @threadpool_limits.wrap(limits=1)
    def _whole(self) -> tuple[Whitening, Fits]:
        """All capsules and the model without effects."""
        white = whitening(self.tested_model, self.session, halves=1)
        return white, fitted(self.tested_model, self.session, white)

    @cached_property
    @threadpool_limits.wrap(limits=1)
    def _whole_finding(self) -> Finding:
        white, fits = self._whole
        return find(self.tested_model, self.session, seed=self.seed, white=white, fits=fits)

    @cached_property
    def surface_shear_modulus(self) -> SessionModulus:
        """Median G_s of the session with what is not known of the effect, its size and the viscosity.

        With an effect that was named, or several in question, these are averaged over, as probable as their evidence.
        Where no disagreement was found, so are no effect, every other that the capsules allow, the law of the membrane
        among them, and something else, and all capsules count, otherwise the first half. Where no effect explains the
        capsules, none is the truth. How far G_s may be off is then shown, with equal weight, by all that explain a
        part, by two effects together if two were tried, and by something else, which also changes G_s as much as
        effects of the catalogue that would be as visible.
        """
        viscosity = self.session.experiment.viscosity
        error = 0.0 if viscosity is None else viscosity.sd / viscosity.mean
        if self.verdict is Verdict.NONE:
            apparent = Comparison(self.session, self.model, self._whole[1]).modulus
        else:
            apparent = np.empty(0) if self.first_half is None else self.first_half.modulus
        return session_modulus(self._explanations, apparent, error, self.seed)

    @property
    def _explanations(self) -> list[tuple[float, Explanation]]:
        if self.verdict is Verdict.NAMED:
            return [(1.0, self._together(*(step.best for step in self.steps)))]
        if self.verdict is Verdict.AMBIGUOUS:
            *settled, last = sorted(self.steps, key=lambda step: len(step.in_question))
            before = [step.best for step in settled]
            most = max(last.scores[name].evidence for name in last.in_question)
            alike = [last.scores[name] for name in last.in_question]
            either = [(float(np.exp(tried.evidence - most)), self._together(*before, tried)) for tried in alike]
            if self.verification is not None and self.verification.something_else_in_question:
                either.append((float(np.exp(-max(self.verification.ahead_by_both, 0.0))), (self.finding.discrepancy,)))
            return either
        if self.verdict is Verdict.NONE:
            something_else = self._whole_finding.discrepancy
            logs: list[tuple[float, Explanation]] = [(0.0, ()), (something_else.evidence, (something_else,))]
            logs += [(each.evidence, (each,)) for each in self._limit_scores.values()]
            most = max(log for log, _ in logs)
            return [(float(np.exp(log - most)), changes) for log, changes in logs]
        groups = [group for group in self._explaining_a_part if group]
        return [(1.0 / len(group), explanation) for group in groups for explanation in group]

    @property
    def _explaining_a_part(self) -> Iterator[list[Explanation]]:
        """Groups of explanations of which none is the truth."""
        something_else = self.finding.discrepancy
        alone = list(self.steps[0].scores.values()) if self.steps else []
        if not alone:
            yield [(something_else,)]
            return
        ratios = [each.log_likelihood_ratio for each in alone]
        seen = max(something_else.evidence, *ratios)
        yield [(each,) for each, ratio in zip(alone, ratios, strict=True) if ratio > LEAST_RATIO]
        yield [(something_else, each.as_visible(seen)) for each in alone]
        if len(self.steps) > 1 and all(step.in_question for step in self.steps):
            yield [self._together(*(step.best for step in self.steps))]

    def _together(self, *effects: Scores) -> Explanation:
        """Return what effects change that act together: the last, scored with the others, brings the change by all."""
        *others, last = effects
        if not others:
            return effects
        apparent = float("nan") if self.first_half is None else self.first_half.median_modulus
        spread = (replace(each, without=float(each.modulus[each.best])) for each in others)
        return *spread, replace(last, without=apparent)

    @property
    def scores(self) -> Mapping[str, Scores]:
        """Scores of every candidate on the first half, the likeliest first; two effects are scored together."""
        scores = dict(self.steps[0].scores) if self.steps else {}
        scores |= {name: step.scores[name] for step in self.steps[1:] for name in step.in_question}
        return by_ratio(scores)

    @property
    def tested_model(self) -> ForwardModel:
        """Model that was diagnosed, without the effects that were named."""
        return self.model if self.first_half is None else self.first_half.model

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
                "log_evidence": self.evidence.get(name, float("nan")),
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
        for step in self.steps:
            words |= {name: str(step.scores[name]) for name in step.in_question}
        return words | {"model": self.model.name}

    def __str__(self) -> str:
        """Return the verdict in one sentence."""
        if self.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
            second = "" if self.second_finding is None else f"; not confirmed: {self.second_finding}"
            return f"{self.verdict.value} ({self.finding}{second})"
        groups = (" or ".join(str(step.scores[name]) for name in step.in_question) for step in self.steps)
        other = " or something else" if self.something_else else ""
        return f"{self.verdict.value}: {'; with '.join(groups)}{other} ({self.finding})"


@checked
@threadpool_limits.wrap(limits=1)  # the matrices are tiny: threads would only wait for each other
def diagnose(
    session: Session | Population | str | Path,
    model: ForwardModel,
    *,
    seed: int,
    candidates: Mapping[str, Effect] | None = None,
    level: float = 0.05,
    measured: Measured | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    earlier: Study | None = None,
) -> Study:
    """Find what a model misses in a session, name the effect that explains it, and verify that on held-out capsules.

    Parameters
    ----------
    session : Session, Population or path
        A population or a path stands for the set of measurements there, see `Session.of`.
    model : ForwardModel
        For example ``Surrogate.open("square-neo-hookean")``.
    seed : int
        Seed of the division into halves and of the random signs.
    candidates : mapping of str to Effect, optional
        By name of their parameter; by default the catalogue of the session's cross-section.
    level : float
        Significance of a deviation, and of both halves together with the effect that is named.
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
        If the earlier study is of another session or model, or its capsules were divided with another seed.
    """
    session = Session.of(session)
    model.check_experiment(session.experiment)
    _check_earlier(earlier, session, model, seed)
    asked = catalogue(session.experiment.cross_section) if candidates is None else candidates
    effects = {
        name: effect for name, effect in asked.items() if session.circumstances.keys() >= {*effect.circumstances}
    }
    hidden = tuple(effect.name for name, effect in asked.items() if name not in effects)
    known = measured or {}
    made = partial(Study, session=session, seed=seed, level=level, candidates=effects, measured=known)
    if len(session) < _FEWEST:
        nothing = Finding((), float("nan"), len(session))
        return made(Verdict.NOT_TESTABLE, nothing, (), None, model, {})
    first, confirm = session.halves(seed)
    made = partial(made, not_testable=hidden)
    report = _Progress(progress, len(effects) + 2)
    report("the model as it is")
    white = whitening(model, first)
    fits = fitted(model, first, white)
    _check_shapes(model, fits)
    finding = find(model, first, seed=seed, white=white, fits=fits)
    made = partial(made, finding=finding, first_half=Comparison(first, model, fits))
    if not finding.deviations:
        return made(Verdict.NOT_TESTABLE, steps=(), verification=None, model=model, sizes={})
    if finding.p_value > level:
        quickly = limit_scores(model, effects, first, white, fits, known)
        if not _clearly_likelier(evidences(quickly, finding)):
            return made(Verdict.NONE, steps=(), verification=None, model=model, sizes={})._judged_by_all()
    search = Search(model, effects, first, white, seed, known, report, {} if earlier is None else earlier.trials)
    steps, explained, trials = searched(search, fits)
    report("the held-out capsules")
    evidence = evidences({name: trial.scores for name, trial in trials.items()}, finding)
    made = partial(made, evidence=evidence, trials=trials, model=model, sizes={})
    checked = partial(verified, model, confirm=confirm, seed=seed, measured=known, first=finding, level=level)
    return _confirmed(made, search, steps, checked, finding, confirm, explained=explained)


def _confirmed(
    made: Callable[..., Study],
    search: Search,
    steps: tuple[Step, ...],
    checked: Checked,
    finding: Finding,
    confirm: Session,
    *,
    explained: bool,
) -> Study:
    """Return the study once the held-out capsules have judged the steps, which the first half may have explained."""
    verification = None
    if steps[0].in_question:
        steps, verification = checked(steps)
        if explained and len(steps) == 1 and not verification.leaves_nothing:
            steps, verification = _with_a_second(search, steps, verification, checked)
    study = made(Verdict.UNKNOWN, steps=steps, verification=verification)
    if verification is None or not (explained and verification.holds and _likely(steps, study.evidence)):
        second = find(search.model, confirm, seed=search.seed) if verification is None else verification.before
        if _seen_again(finding, second, study.level):
            return study
        return made(Verdict.NONE, steps=(), verification=None, second_finding=second)._judged_by_all()
    steps = _with_own_errors(steps, search.session)
    made = partial(made, steps=steps, verification=verification)
    if verification.something_else_in_question or any(len(step.in_question) > 1 for step in steps):
        return made(Verdict.AMBIGUOUS)
    extended = search.model
    for step in steps:
        extended = extended + step.best.effect
    return made(Verdict.NAMED, model=extended, sizes={step.in_question[0]: step.best.size for step in steps})


def _check_earlier(earlier: Study | None, session: Session, model: ForwardModel, seed: int) -> None:
    """Refuse an earlier study of another session or model, or one whose capsules were divided with another seed."""
    asked = session, model.sha256, seed
    if earlier is not None and (earlier.session, earlier.tested_model.sha256, earlier.seed) != asked:
        raise ValueError("earlier: expected a study of the same session and model with the same seed")


def _check_shapes(model: ForwardModel, fits: Fits) -> None:
    """Refuse capsules of which not one has a shape of the model: there is nothing to compare then."""
    if not fits.settled.any():
        expected = f"capsules some of which have a shape of {model.name}"
        advice = "check that lengths are over l, that z is along the flow, and the cross-section of the channel"
        raise NoShapeError("session", "measurements", expected, f"{len(fits.settled)} without one", advice)


def _with_a_second(
    search: Search, steps: tuple[Step, ...], verification: Verification, checked: Checked
) -> tuple[tuple[Step, ...], Verification]:
    """Add a second effect, if one explains what only the second half shows and both hold there."""
    both, explained = search.add_second(steps[0])
    if explained:
        both, verified_both = checked(both)
        if verified_both.holds:
            return both, verified_both
    return steps, verification


def _with_own_errors(steps: tuple[Step, ...], session: Session) -> tuple[Step, ...]:
    """Give the sizes of the effects in question the error that the model's own error makes."""
    with_errors = []
    for step in steps:
        scores = dict(step.scores)
        for name in step.in_question:
            own_error = own_size_error(step.models[name], scores[name], session)
            scores[name] = replace(scores[name], own_error=own_error)
        with_errors.append(replace(step, scores=scores))
    return tuple(with_errors)


def _clearly_likelier(evidence: Mapping[str, float]) -> bool:
    """Decide whether an effect or something else is far likelier than none."""
    return max(evidence.values()) > LEAST_RATIO


def _seen_again(first: Finding, second: Finding, level: float) -> bool:
    """Decide whether both halves show a deviation, or something else is far likelier, and the more so by both."""
    likelier = (first.discrepancy + second.discrepancy).evidence > first.discrepancy.evidence > LEAST_RATIO
    return likelier or first.combined_p_value(second, among=level) <= level


def _likely(steps: tuple[Step, ...], evidence: Mapping[str, float]) -> bool:
    """Decide whether a single effect is far likelier than none, and not far less likely than an unknown one."""
    best = evidence[steps[0].in_question[0]]
    return len(steps) > 1 or (best >= LEAST_RATIO and best >= evidence[UNKNOWN] - LEAST_RATIO)


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
        "something_else": study.something_else,
        "not_testable": list(study.not_testable),
        "sizes": dict(study.sizes),
        "finding": _finding(study.finding),
        "not_seen_again": None if study.second_finding is None else _finding(study.second_finding),
        "log_evidence": dict(study.evidence),
        "probabilities": dict(study.all_probabilities),
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
        "log_score_of_something_else": verification.of_something_else,
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
