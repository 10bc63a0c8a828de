"""Tables of a study's page: what was found, the candidates, the held-out capsules before and after."""

from __future__ import annotations

import math

from markupsafe import Markup

from capsbayes.diagnosis import NOTHING, UNKNOWN, Finding, Scores, Study, Verification
from capsbayes.parameters import PARAMETERS
from capsbayes.show.page import table, typeset
from capsbayes.show.study_words import (
    deviation_words,
    odds_words,
    p_value_words,
    same_by_chance,
    size_words,
    told_words,
)

__all__ = ["candidate_table", "finding_table", "flow_rate_table", "held_out_table", "meaning_table"]

_MODULUS, _FLOW_RATE = PARAMETERS["surface_shear_modulus"], PARAMETERS["flow_rate"]
_OTHERS = {NOTHING: "none", UNKNOWN: "not in this list: regions displaced alike in all capsules"}


def finding_table(finding: Finding) -> Markup:
    """Every deviation that was looked for, the most surprising first."""
    rows = [(typeset(one.name), deviation_words(one), p_value_words(one.p_value)) for one in finding.deviations]
    return table(("where", "size ± standard error (significance)", "as large by chance"), rows)


def candidate_table(study: Study) -> Markup:
    """Odds and size of every candidate, of the model without one, and of what nobody has thought of."""
    best = max(study.evidence.values())
    rows: list[tuple[str, ...]] = []
    for name, evidence in study.evidence.items():
        odds = typeset(odds_words(evidence - best)), typeset(odds_words(evidence))
        if name in study.scores:
            one = study.scores[name]
            size = typeset(f"{one.effect.parameter.symbol} = {size_words(one)}")
            modulus = f"{_MODULUS.shown(one.modulus[one.best]):.1f} {_MODULUS.shown_unit}"
            rows.append((_marked(study, name, one), *odds, size, modulus, told_words(study, name)))
        else:
            rows.append((Markup("<i>{}</i>").format(_OTHERS[name]), *odds, "", "", ""))
    head = ("effect", "odds against the best", "odds against none", "size", typeset("median G_s"), "told apart?")
    return table(head, rows)


def meaning_table(study: Study) -> Markup:
    """What each candidate does, and what would separate it from the others."""
    rows = [
        (
            _marked(study, name, one),
            one.effect.kind.value,
            typeset(one.effect.changes),
            typeset(one.effect.separated_by),
        )
        for name, one in study.scores.items()
    ]
    return table(("effect", "kind", "what it changes", "what would separate it"), rows)


def held_out_table(verification: Verification) -> Markup:
    """Gap, noise, chance and shear modulus before and after."""
    pairs = (verification.before, verification.after)
    gaps = [f"{1e6 * one.gap:.3f} µm" if math.isfinite(one.gap) else "no outlines" for one in verification.comparisons]
    noise = [f"{one.noise:.2f} σ" if math.isfinite(one.noise) else "nothing is left over" for one in pairs]
    medians = [one.median_modulus for one in verification.comparisons]
    shift = 100.0 * (medians[1] / medians[0] - 1.0)
    ratio = f"{verification.log_likelihood_ratio:+.2f} ± {verification.error:.2f}"
    rows = [
        ("gap: rms distance of measured and predicted edge", *gaps),
        ("the same over the stated noise, correlations counted", *noise),
        ("largest deviation", *(deviation_words(one.deviations[0]) if one.deviations else "" for one in pairs)),
        ("as large by chance (residual p-value)", *(same_by_chance(one) for one in pairs)),
        ("log score per capsule, over that before", "0", ratio),
        (
            typeset("median G_s"),
            _shown_modulus(medians[0]),
            f"{_shown_modulus(medians[1])} ({shift:+.1f} %)",
        ),
    ]
    return table((f"{len(verification.log_likelihood_ratios)} held-out capsules", "before", "after"), rows)


def flow_rate_table(verification: Verification) -> Markup | None:
    """Median G_s at each flow rate before and after, None where flow rates are not known."""
    before, after = (one.modulus_at_flow_rates for one in verification.comparisons)
    if not before:
        return None
    rows = [
        (
            f"{_FLOW_RATE.shown(rate):.3g} {_FLOW_RATE.shown_unit}",
            str(count),
            _shown_modulus(median),
            _shown_modulus(after[rate][1]),
        )
        for rate, (count, median) in before.items()
    ]
    return table(("flow rate", "capsules", typeset("median G_s before"), "after"), rows, numbers=(1, 2, 3))


def _shown_modulus(value: float) -> str:
    return f"{_MODULUS.shown(value):.1f} {_MODULUS.shown_unit}" if math.isfinite(value) else "no such shape"


def _marked(study: Study, name: str, one: Scores) -> str:
    return Markup("<b>{}</b>").format(one.effect.name) if name in study.names else one.effect.name
