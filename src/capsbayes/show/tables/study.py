"""Tables of a study: the deviations, the candidates, and the held-out capsules before and after."""

from __future__ import annotations

import math

import pandas as pd

from capsbayes.diagnosis import NOTHING, UNKNOWN, Deviation, Finding, Study, Verification
from capsbayes.parameters import PARAMETERS
from capsbayes.show.tables.table import Strong, Symbols, table
from capsbayes.show.words.rounding import unit_of, with_unit
from capsbayes.show.words.study import (
    ALONE,
    deviation_words,
    largest_p_value,
    odds_words,
    p_value_words,
    probability_words,
    question_words,
    size_words,
)

_MODULUS = "surface_shear_modulus"
_SOMETHING_ELSE = "something else: any smooth deformation that depends on the capsule, or a trend of G_s"
_OTHERS = {NOTHING: "none", UNKNOWN: _SOMETHING_ELSE}
_UNSEEN = "cannot be tested"
_SHOWN = 5  # effects on the terminal at least; a page has all of them


def finding_table(finding: Finding) -> pd.DataFrame:
    """Return every deviation that was tested, the most surprising first."""
    rows = [
        (Symbols(deviation.name), deviation_words(deviation), p_value_words(deviation.p_value))
        for deviation in finding.deviations
    ]
    title = f"Deviations of {finding.capsules} capsules from the model"
    return table(("where", "size ± standard error (significance)", "p-value"), rows, title=title)


def candidate_table(study: Study) -> pd.DataFrame:
    """Return odds and size of every candidate, of the model without an effect, and of an effect not in the list."""
    rows: list[tuple[str, ...]] = []
    for name, evidence in study.evidence.items():
        odds = _probability(study, name), Symbols(odds_words(evidence))
        if name in study.scores:
            scores = study.scores[name]
            size = Symbols(f"{scores.effect.parameter.symbol} = {size_words(scores)}")
            modulus = _modulus(scores.modulus[scores.best])
            verdict = question_words(study, name)
            rows.append((_named(study, name), f"{scores.log_likelihood_ratio:.1f}", *odds, size, modulus, verdict))
        else:
            rows.append((_OTHERS[name], "", *odds, "", "", ""))
    head = (
        *("effect", "log-likelihood ratio", "probability", "odds relative to no effect", "size"),
        *(Symbols("median G_s"), "candidate?"),
    )
    return table(head, rows, title="Effects that were tried", numbers=(1,))


def likeliest_table(study: Study) -> tuple[pd.DataFrame, list[str]]:
    """Return probability, size and G_s of the effects in question and of the likeliest others; names of the rest."""
    effects = [name for name in study.evidence if name in study.scores]
    shown = {*study.names, *effects[:_SHOWN], *_OTHERS}
    rows: list[tuple[str, ...]] = []
    for name in (name for name in study.evidence if name in shown):
        probability = _probability(study, name)
        if name in study.scores:
            scores = study.scores[name]
            size = Symbols(f"{scores.effect.parameter.symbol} = {size_words(scores, share='')}")
            modulus = PARAMETERS[_MODULUS].shown(scores.modulus[scores.best])
            rows.append((_named(study, name), probability, size, _finite(modulus, ".1f", "", "no such shape")))
        else:
            rows.append((ALONE[name], probability, "", ""))
    head = ("effect", "probability", "size (68 %)", Symbols(f"median G_s,{unit_of(PARAMETERS[_MODULUS])}"))
    rest = [study.scores[name].effect.name for name in effects if name not in shown]
    title = "The likeliest of the effects that were tried" if rest else "Effects that were tried"
    return table(head, rows, title=title, numbers=(3,)), rest


def meaning_table(study: Study) -> pd.DataFrame:
    """Return what each candidate does, and what would distinguish it from the others."""
    rows = [
        (
            _named(study, name),
            scores.effect.kind.value,
            Symbols(scores.effect.changes),
            Symbols(scores.effect.separated_by),
        )
        for name, scores in study.scores.items()
    ]
    head = ("effect", "kind", "what it changes", "what would distinguish it")
    return table(head, rows, title="What the effects change")


def held_out_table(verification: Verification) -> pd.DataFrame:
    """Return gap, noise, p-value and shear modulus before and after."""
    findings = (verification.before, verification.after)
    gaps = [_finite(1e6 * gap, ".3f", " µm", "no outlines") for gap in verification.gaps]
    noise = [_finite(finding.noise, ".2f", " σ", "nothing is left over") for finding in findings]
    before, after = (half.median_modulus for half in verification.comparisons)
    rows = [
        ("gap: rms distance of measured and predicted edge", *gaps),
        ("the same over the noise, correlations counted", *noise),
        (
            "largest deviation",
            *("" if not each.deviations else _largest(each.deviations[0]) for each in findings),
        ),
        ("its p-value (residual p-value)", *map(largest_p_value, findings)),
        (
            "log score per capsule, over that before",
            "0",
            f"{verification.log_likelihood_ratio:+.2f} ± {verification.error:.2f}",
        ),
        ("the same, sum of all capsules", "0", f"{float(verification.log_likelihood_ratios.sum()):+.1f}"),
        ("the same of something else, seen in the first half", "", f"{verification.of_something_else:+.1f}"),
        (
            Symbols("median G_s"),
            _modulus(before),
            f"{_modulus(after)} ({100.0 * (after / before - 1.0):+.1f} %)",
        ),
    ]
    return table(
        (f"{len(verification.log_likelihood_ratios)} held-out capsules", "before", "after"),
        rows,
        title="Held-out capsules",
    )


def _largest(deviation: Deviation) -> Symbols:
    return Symbols(f"{deviation.name}: {deviation_words(deviation)}")


def limits_table(study: Study) -> pd.DataFrame | None:
    """Return what could hide where nothing was found, and what it would do to G_s; None if nothing was limited."""
    limits = study.limits
    if limits.empty:
        return None
    rows = []
    for name, row in limits.iterrows():
        parameter = study.candidates[str(name)].parameter
        ends = " to ".join(f"{parameter.shown(row[end]):.2g}" for end in ("low", "high"))
        change = " to ".join(f"{100.0 * (row[f'modulus_at_{end}'] - 1.0):+.0f}" for end in ("low", "high"))
        note = "as far as it was tried" if row["unbounded"] else ""
        rows.append((row["effect"], Symbols(f"{parameter.symbol} = {ends}{unit_of(parameter)}"), f"{change} %", note))
    head = ("effect", "size that these data allow (95 %)", Symbols("change of G_s"), "limited?")
    return table(head, rows, title="Effects that could hide")


def flow_rate_table(verification: Verification) -> pd.DataFrame | None:
    """Return the median G_s at each flow rate before and after, None where flow rates are not known."""
    before, after = (compared.modulus_at_flow_rates for compared in verification.comparisons)
    if not before:
        return None
    rows = [
        (with_unit("flow_rate", rate), str(count), _modulus(median), _modulus(after[rate][1]))
        for rate, (count, median) in before.items()
    ]
    head = ("flow rate", "capsules", Symbols("median G_s before"), "after")
    return table(head, rows, title="Held-out capsules by flow rate", numbers=(1, 2, 3))


def _finite(value: float, digits: str, unit: str, otherwise: str) -> str:
    return f"{value:{digits}}{unit}" if math.isfinite(value) else otherwise


def _modulus(value: float) -> str:
    return with_unit(_MODULUS, value, ".1f") or "no such shape"


def _probability(study: Study, name: str) -> Symbols:
    found = study.all_probabilities
    return Symbols(probability_words(found[name]) if name in found else _UNSEEN)


def _named(study: Study, name: str) -> str:
    effect = study.scores[name].effect.name
    return Strong(effect) if name in study.names else effect
