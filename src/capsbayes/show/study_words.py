"""What a study says in sentences and in short: numbers with their units, as people read them."""

from __future__ import annotations

import math

import numpy as np

from capsbayes.diagnosis import LEAST_RATIO, Deviation, Finding, Scores, Session, Study, Verdict
from capsbayes.parameters import PARAMETERS

__all__ = [
    "deviation_words",
    "lengths_alone",
    "modulus_words",
    "odds_words",
    "p_value_words",
    "same_by_chance",
    "size_words",
    "told_words",
    "verdict_sentence",
]

_MODULUS = PARAMETERS["surface_shear_modulus"]
_MANY = 1e4  # odds beyond which their power of ten is enough


def verdict_sentence(study: Study) -> str:
    """What came of a study, in one sentence."""
    model = study.tested_model.name
    if study.verdict is Verdict.NOT_TESTABLE:
        return f"These data cannot tell: {len(study.session)} capsules are too few to compare with {model}."
    if study.verdict is Verdict.NONE:
        doubt = "" if study.second_finding is None else ": what the first half shows, the held-out capsules do not"
        return f"No disagreement was found between the capsules and {model}{doubt}."
    accused = f"The capsules disagree with {model}, and"
    if study.verdict is Verdict.NAMED:
        named = [step.best for step in study.steps]
        names = " and ".join(one.effect.name for one in named)
        sizes = "; ".join(f"{one.effect.parameter.symbol} = {size_words(one)}" for one in named)
        return f"{accused} {names} {'explains it' if len(named) == 1 else 'explain it together'}: {sizes}."
    if study.verdict is Verdict.AMBIGUOUS:
        groups = [[step.scores[name].effect.name for name in step.in_question] for step in study.steps]
        return f"{accused} several effects explain it equally well: {', with '.join(map(_one_of, groups))}."
    if study.verification is not None:
        best = study.scores[study.names[0]]
        return f"{accused} nothing that was tried explains it; {best.effect.name} comes nearest."
    return f"{accused} nothing that was tried explains it."


def _one_of(names: list[str]) -> str:
    """Names with commas and an "or"."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def lengths_alone(session: Session) -> str:
    """What it costs that capsules were given without outlines; empty if none was."""
    without = sum(one.outline is None for one in session.measurements)
    if not without:
        return ""
    if without < len(session):
        return f"{without} of {len(session)} capsules have no outline; they only count for the trends of G_s."
    return (
        "Lengths alone were given: Ca and a/l of a capsule take up both, so that only trends of G_s with velocity and "
        "size are left to compare, and most effects stay unseen; outlines show them, and where."
    )


def modulus_words(study: Study) -> str:
    """Between what the median G_s lies, by what is assumed to be missing; empty where that is settled.

    Under all effects in question, or, if none explains it, under the model as it was and all that raise the likelihood.
    """
    if study.verdict is Verdict.AMBIGUOUS:
        scores = [study.scores[name] for name in study.names]
    elif study.verdict is Verdict.UNKNOWN:
        scores = [one for one in study.scores.values() if one.log_likelihood_ratio >= LEAST_RATIO]
    else:
        return ""
    moduli = [one.modulus[one.best] for one in scores]
    if study.verdict is Verdict.UNKNOWN and study.first_half is not None:
        moduli.append(study.first_half.median_modulus)
    low, high = (_MODULUS.shown(end(moduli)) for end in (np.nanmin, np.nanmax))
    return f"By what is assumed to be missing, the median G_s is {low:.1f} to {high:.1f} {_MODULUS.shown_unit}."


def told_words(study: Study, name: str) -> str:
    """Whether a candidate is in question."""
    if study.verdict is Verdict.UNKNOWN or not study.names:
        return "does not explain it"
    return "in question" if name in study.names else "told apart"


def size_words(scores: Scores) -> str:
    """Size of an effect with its 68 % interval and unit."""
    one = scores.effect.parameter
    low, high = (one.shown(end) for end in scores.interval())
    unit = "" if one.shown_unit in ("", "-") else f" {one.shown_unit.replace('um', 'µm').replace('us', 'µs')}"
    return f"{one.shown(scores.size):.3g}{unit} (68 %: {low:.3g} to {high:.3g}{unit})"


def odds_words(log_ratio: float) -> str:
    """A likelihood ratio of which the logarithm is given."""
    if abs(log_ratio) > math.log(_MANY):
        power = round(abs(log_ratio) / math.log(10.0))
        return f"10^{power} : 1" if log_ratio > 0.0 else f"1 : 10^{power}"
    odds = math.exp(abs(log_ratio))
    text = f"{odds:.2g}" if odds < 10.0 else f"{odds:.0f}"
    return f"{text} : 1" if log_ratio >= 0.0 else f"1 : {text}"


def deviation_words(one: Deviation) -> str:
    """Amplitude of a deviation with its error, unit and significance."""
    unit = f" {one.unit.replace('um', 'µm')}" if one.unit else ""
    return f"{one.size:+.2f} ± {one.error:.2f}{unit} ({one.sigma:+.1f} σ)"


def same_by_chance(finding: Finding) -> str:
    """How often a right model shows a deviation as large as the largest."""
    return p_value_words(finding.p_value) if finding.deviations else "not tested"


def p_value_words(p_value: float) -> str:
    """A probability in per cent."""
    share = 100.0 * p_value
    return f"{share:.0f} %" if share >= 9.5 else f"{share:.2g} %"
