"""Sentences and tables of a study, on the terminal as on its page: verdict, deviations, candidates, held-out ones."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from capsbayes.diagnosis import (
    LEAST_RATIO,
    NOTHING,
    UNKNOWN,
    Deviation,
    Finding,
    Scores,
    Study,
    Verdict,
    Verification,
)
from capsbayes.diagnosis.finding import TWO_SIGMA
from capsbayes.effects import Simulated
from capsbayes.parameters import PARAMETERS
from capsbayes.report.numbers import unit_of, with_unit
from capsbayes.report.tables import Strong, Symbols, table

ALONE = {NOTHING: "no effect", UNKNOWN: "something else"}
"""Explanations that are no effects of the catalogue."""

_MODULUS = PARAMETERS["surface_shear_modulus"]
_OTHERS = {
    NOTHING: "none",
    UNKNOWN: "something else: any smooth deformation that depends on the capsule, or a trend of G_s",
}
_SHOWN = 5  # effects on the terminal at least; a page has all of them
_NOISIER = 1.1  # noise over the stated one, from which it is said
_MANY = 1e3  # odds beyond which no number is trusted: it would be that of the tails of the stated noise


def opening(study: Study) -> list[str]:
    """Return the sentences that a study begins with: verdict, probabilities, range of G_s, and what the data lack."""
    further = (_limits, _probabilities, _session_modulus, _modulus_range, _noise, _outliers, _lacking)
    return [verdict_sentence(study), *(sentence for words in further for sentence in words(study))]


def verdict_sentence(study: Study) -> str:
    """Return the verdict of a study in one sentence."""
    model = study.tested_model.name
    if study.verdict is Verdict.NOT_TESTABLE:
        return f"These data cannot tell: {len(study.session)} capsules are too few to compare with {model}."
    if study.verdict is Verdict.NONE:
        caveat = "" if study.second_finding is None else ": the held-out capsules do not show what the first half shows"
        return f"No disagreement was found between the capsules and {model}{caveat}."
    disagree = f"The capsules disagree with {model}, and"
    if study.verdict is Verdict.NAMED:
        named = [step.best for step in study.steps]
        return f"{disagree} {_explanation(named)}: {'; '.join(map(size_words, named))}."
    if study.verdict is Verdict.AMBIGUOUS:
        groups = [[step.scores[name].effect.name for name in step.in_question] for step in study.steps]
        *others, last = groups
        last += [ALONE[UNKNOWN]] * study.something_else
        alike = ", with ".join(map(_listed, [*others, last]))
        return f"{disagree} more than one effect may explain it: {alike}."
    if study.by_all:
        return (
            f"All capsules together disagree with {model}, but the two halves of them do not confirm each other, so "
            "that no effect is named."
        )
    if study.verification is not None:
        best = study.scores[study.names[0]]
        return f"{disagree} nothing that was tried explains it; {best.effect.name} comes nearest."
    return f"{disagree} nothing that was tried explains it."


def _limits(study: Study) -> Iterator[str]:
    """Say which effect could hide and change G_s most where nothing was found."""
    limits = study.limits
    if not limits.empty:
        row, parameter = limits.iloc[0], study.candidates[str(limits.index[0])].parameter
        end = max(("low", "high"), key=lambda end: abs(math.log(row[f"modulus_at_{end}"])))
        change = 100.0 * (row[f"modulus_at_{end}"] - 1.0)
        what = f"{row['effect']} of {parameter.symbol} = {parameter.shown(row[end]):.2g}{unit_of(parameter)}"
        yield (
            f"Of all effects that were tried, one that could hide (95 %) changes G_s most: {what}, which would "
            f"{'lower' if change < 0.0 else 'raise'} it by {abs(change):.0f} %."
        )


def _probabilities(study: Study) -> Iterator[str]:
    """Say the probabilities of the likeliest effect, of something else, and of nothing, if any were compared."""
    known = study.all_probabilities
    if known:
        effects = [name for name in (*study.names[:1], *known) if name in known and name not in ALONE]
        words = [f"{study.candidates[name].name} {probability_words(known[name])}" for name in effects[:1]]
        words += [f"{ALONE[other]} {probability_words(known[other])}" for other in (UNKNOWN, NOTHING)]
        which = "all capsules" if study.by_all else "one half of the capsules"
        yield f"Probabilities by {which}, each effect alone: {', '.join(words)}."


def _session_modulus(study: Study) -> Iterator[str]:
    """Say the median G_s of the session with its interval, where a capsule was compared."""
    modulus = study.surface_shear_modulus
    if math.isfinite(modulus.median):
        median, low, high = (_MODULUS.shown(value) for value in (modulus.median, modulus.low, modulus.high))
        uncertainty = {
            Verdict.NAMED: "the uncertainty of the effect's size and of the viscosity",
            Verdict.AMBIGUOUS: "the uncertainty of which effect it is, of its size and of the viscosity",
        }.get(study.verdict, "what the effects that were tried could do, and the uncertainty of the viscosity")
        interval = f"{median:.3g}{unit_of(_MODULUS)} (95 %: {low:.3g} to {high:.3g})"
        yield f"Median G_s of the session: {interval}, including {uncertainty}."


def _modulus_range(study: Study) -> Iterator[str]:
    """Say how much the median G_s depends on the effect that is assumed, where that is not settled.

    Over all effects in question, or, if none explains it, over the model as it was and all effects that improve it.
    """
    if study.verdict is Verdict.AMBIGUOUS:
        scores = [study.scores[name] for name in study.names]
    elif study.verdict is Verdict.UNKNOWN:
        scores = [tried for tried in study.scores.values() if tried.log_likelihood_ratio >= LEAST_RATIO]
    else:
        return
    moduli = [tried.modulus[tried.best] for tried in scores]
    if study.verdict is Verdict.UNKNOWN and study.first_half is not None:
        moduli.append(study.first_half.median_modulus)
    low, high = (_MODULUS.shown(end(moduli)) for end in (np.nanmin, np.nanmax))
    yield f"Depending on the effect that is assumed, the median G_s is {low:.1f} to {high:.1f}{unit_of(_MODULUS)}."


def _noise(study: Study) -> Iterator[str]:
    """Say how much single outlines scatter beyond their stated noise, if they do."""
    further = study.finding.further_noise
    outlines = [measured.outline for measured in study.session.measurements if measured.outline is not None]
    stated = float(np.median([outline.noise.scale for outline in outlines])) if outlines else math.inf
    if math.hypot(1.0, further / stated) >= _NOISIER:
        micrometres = 1e6 * study.session.mean("half_width")
        yield (
            f"Single outlines scatter by {micrometres * further:.2g} µm beyond their stated noise of "
            f"{micrometres * stated:.2g} µm, which is allowed for."
        )


def _outliers(study: Study) -> Iterator[str]:
    """Name the capsules that have no shape of the model."""
    outliers = () if study.first_half is None else study.first_half.outliers
    if study.verification is not None:
        outliers += study.verification.comparisons[0].outliers
    if outliers:
        names = ", ".join(outliers)
        yield f"{len(outliers)} capsules have no shape of {study.tested_model.name}, or lie far off: {names}."


def _lacking(study: Study) -> Iterator[str]:
    """Say what missing outlines cost, and which effects these data cannot show."""
    session = study.session
    without = sum(measured.outline is None for measured in session.measurements)
    if 0 < without < len(session):
        yield f"{without} of {len(session)} capsules have no outline; they only count for the trends of G_s."
    elif without:
        yield (
            "Lengths alone were given: Ca and a/l of a capsule absorb both, so that only trends of G_s with velocity "
            "and size are left to compare, and most effects stay unseen; outlines show them, and where."
        )
    if study.not_testable:
        wanted = "" if "flow_rate" in session.circumstances else ", as no flow rates are stated"
        yield f"Not testable with these data{wanted}: {', '.join(study.not_testable)}."


def _explanation(named: list[Scores]) -> str:
    """Say which effects explain it; of several of the membrane, what the membrane is."""
    if len(named) == 1:
        return f"{named[0].effect.name} explains it"
    makes = [tried.effect.in_words(tried.size) for tried in named if isinstance(tried.effect, Simulated)]
    if len(makes) == len(named) and all(makes):
        return f"a membrane that is {' and '.join(makes)} explains it"
    return f"{' and '.join(tried.effect.name for tried in named)} explain it together"


def _listed(names: list[str]) -> str:
    """Names with commas and an "or"."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def caveats(study: Study) -> Iterator[str]:
    """Yield how to read the table of the effects, one sentence or a few each."""
    yield (
        "Odds are ratios of likelihoods, averaged over the prior of the size of each effect, before any belief about "
        "which effect is the more common. They trust the noise; where an effect lags behind the best by odds below "
        "3000 : 1, the two are distinguished only if the lag also stands out from the scatter between the capsules. "
        "The size of an effect that was hardly seen is overestimated, near the threshold by some 40 %, because only "
        "sizes that look large are seen at all."
    )
    if len(study.steps) > 1:
        yield (
            "Of effects that are added together, size, log-likelihood ratio and G_s are those with the other effect "
            "present, the odds those of each alone."
        )
    after = None if study.verification is None else study.verification.comparisons[1]
    if after is not None and after.added_up:
        yield (
            f"At {after.added_up} of {len(after.session)} held-out capsules the effects of the membrane are added up: "
            "these lie where no membranes with both were simulated. The sum is only roughly right."
        )
    if study.verdict is Verdict.AMBIGUOUS:
        best = next((step for step in study.steps if len(step.in_question) > 1), study.steps[0]).best.effect
        yield (
            "These data do not distinguish the effects in question. What would distinguish them: "
            f"{best.separated_by[0].lower()}{best.separated_by[1:]}"
        )


def origin_words(study: Study) -> str:
    """Say what the study was made of."""
    model = study.tested_model
    outlines = sum(measured.outline is not None for measured in study.session.measurements)
    return (
        f"{len(study.session)} capsules, {outlines} with an outline; model {model.name}, sha256 {model.sha256[:12]}; "
        f"seed {study.seed}."
    )


def question_words(study: Study, name: str) -> str:
    """Say whether a candidate may be what is missing: yes, no, or that the data allow all of its sizes alike."""
    if name not in study.all_probabilities or np.ptp(study.scores[name].total) < TWO_SIGMA:
        return "cannot be tested"
    explained = study.by_all or study.verdict is not Verdict.UNKNOWN
    return "yes" if explained and name in study.names else "no"


def size_words(scores: Scores, share: str = "68 %: ") -> str:
    """Return the size of an effect with its symbol, 68 % interval and unit; `share` introduces the interval."""
    parameter = scores.effect.parameter
    low, high = map(parameter.shown, scores.interval())
    unit = unit_of(parameter)
    return f"{parameter.symbol} = {parameter.shown(scores.size):.3g}{unit} ({share}{low:.3g} to {high:.3g}{unit})"


def odds_words(logarithm: float) -> str:
    """Return a likelihood ratio of which the logarithm is given, as no more than a thousand to one."""
    if abs(logarithm) > math.log(_MANY):
        return f"more than {_MANY:.0f} : 1" if logarithm > 0.0 else f"less than 1 : {_MANY:.0f}"
    odds = math.exp(abs(logarithm))
    text = f"{odds:.2g}" if odds < 10.0 else f"{odds:.0f}"
    return f"{text} : 1" if logarithm >= 0.0 else f"1 : {text}"


def probability_words(probability: float) -> str:
    """Return the probability of an explanation, of which no more than three digits are trusted."""
    if probability < 1.0 / _MANY:
        return f"< {1.0 / _MANY:g}"
    return f"> {1.0 - 1.0 / _MANY:g}" if probability > 1.0 - 1.0 / _MANY else f"{probability:.2g}"


def deviation_words(deviation: Deviation) -> str:
    """Return the amplitude of a deviation with its error, unit and significance."""
    unit = f" {deviation.unit.replace('um', 'µm')}" if deviation.unit else ""
    return f"{deviation.size:+.2f} ± {deviation.error:.2f}{unit} ({deviation.sigma:+.1f} σ)"


def largest_p_value(finding: Finding) -> str:
    """Return the p-value of the largest deviation of a finding."""
    return p_value_words(finding.p_value) if finding.deviations else "not tested"


def p_value_words(p_value: float) -> str:
    """Return a probability in per cent."""
    share = 100.0 * p_value
    return f"{share:.0f} %" if share >= 9.5 else f"{share:.2g} %"


def finding_table(finding: Finding) -> pd.DataFrame:
    """Return every deviation that was tested, the most surprising first."""
    rows = [(Symbols(each.name), deviation_words(each), p_value_words(each.p_value)) for each in finding.deviations]
    title = f"Deviations of {finding.capsules} capsules from the model"
    return table(("where", "size ± standard error (significance)", "p-value"), rows, title=title)


def candidate_table(study: Study) -> pd.DataFrame:
    """Return odds and size of every candidate, of the model without an effect, and of an effect not in the list."""
    rows: list[tuple[str, ...]] = []
    for name, evidence in study.evidence.items():
        odds = _probability(study, name), Symbols(odds_words(evidence))
        if name in ALONE:
            rows.append((_OTHERS[name], "", *odds, "", "", ""))
        else:
            scores = study.scores[name]
            size, modulus = Symbols(size_words(scores)), _modulus(scores.modulus[scores.best])
            ratio = f"{scores.log_likelihood_ratio:.1f}"
            rows.append((_named(study, name), ratio, *odds, size, modulus, question_words(study, name)))
    head = ["effect", "log-likelihood ratio", "probability", "odds relative to no effect", "size"]
    head += [Symbols("median G_s"), "candidate?"]
    return table(head, rows, title="Effects that were tried", numbers=(1,))


def likeliest_table(study: Study) -> tuple[pd.DataFrame, list[str]]:
    """Return probability, size and G_s of the effects in question and of the likeliest others; names of the rest."""
    effects = [name for name in study.evidence if name in study.scores]
    shown = {*study.names, *effects[:_SHOWN], *ALONE}
    rows: list[tuple[str, ...]] = []
    for name in (name for name in study.evidence if name in shown):
        probability = _probability(study, name)
        if name in ALONE:
            rows.append((ALONE[name], probability, "", ""))
        else:
            scores = study.scores[name]
            modulus = _finite(_MODULUS.shown(scores.modulus[scores.best]), ".1f", "", "no such shape")
            rows.append((_named(study, name), probability, Symbols(size_words(scores, share="")), modulus))
    head = ("effect", "probability", "size (68 %)", Symbols(f"median G_s,{unit_of(_MODULUS)}"))
    rest = [study.scores[name].effect.name for name in effects if name not in shown]
    title = "The likeliest of the effects that were tried" if rest else "Effects that were tried"
    return table(head, rows, title=title, numbers=(3,)), rest


def meaning_table(study: Study) -> pd.DataFrame:
    """Return what each candidate does, and what would distinguish it from the others."""
    rows = [
        (_named(study, name), effect.kind.value, Symbols(effect.changes), Symbols(effect.separated_by))
        for name, effect in ((name, scores.effect) for name, scores in study.scores.items())
    ]
    head = ("effect", "kind", "what it changes", "what would distinguish it")
    return table(head, rows, title="What the effects change")


def held_out_table(verification: Verification) -> pd.DataFrame:
    """Return gap, noise, p-value and shear modulus before and after."""
    findings = (verification.before, verification.after)
    gaps = [_finite(1e6 * gap, ".3f", " µm", "no outlines") for gap in verification.gaps]
    noise = [_finite(finding.noise, ".2f", " σ", "nothing is left over") for finding in findings]
    before, after = (half.median_modulus for half in verification.comparisons)
    deviations = [each.deviations[0] if each.deviations else None for each in findings]
    largest = [Symbols(f"{each.name}: {deviation_words(each)}") if each else "" for each in deviations]
    score = f"{verification.log_likelihood_ratio:+.2f} ± {verification.error:.2f}"
    ratios = verification.log_likelihood_ratios
    rows = [
        ("gap: rms distance of measured and predicted edge", *gaps),
        ("the same over the noise, correlations counted", *noise),
        ("largest deviation", *largest),
        ("its p-value (residual p-value)", *map(largest_p_value, findings)),
        ("log score per capsule, over that before", "0", score),
        ("the same, sum of all capsules", "0", f"{float(ratios.sum()):+.1f}"),
        ("the same of something else, seen in the first half", "", f"{verification.of_something_else:+.1f}"),
        (Symbols("median G_s"), _modulus(before), f"{_modulus(after)} ({100.0 * (after / before - 1.0):+.1f} %)"),
    ]
    return table((f"{len(ratios)} held-out capsules", "before", "after"), rows, title="Held-out capsules")


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
    return with_unit(_MODULUS.name, value, ".1f") or "no such shape"


def _probability(study: Study, name: str) -> Symbols:
    known = study.all_probabilities
    return Symbols(probability_words(known[name]) if name in known else "cannot be tested")


def _named(study: Study, name: str) -> str:
    effect = study.scores[name].effect.name
    return Strong(effect) if name in study.names else effect


def study_parts(study: Study) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of a study."""
    verdict, *further = opening(study)
    yield from (Strong(verdict), *further)
    left_out = study.session.left_out
    if left_out:
        yield "\n  ".join([f"{len(left_out)} capsules were left out:", *left_out])
    if study.finding.deviations:
        yield finding_table(study.finding)
    if (limits := limits_table(study)) is not None:
        yield limits
    if study.scores:
        likeliest, rest = likeliest_table(study)
        yield likeliest
        if rest:
            yield f"Less likely: {', '.join(rest)}."
        yield from caveats(study)
        for name in study.names:
            effect = study.scores[name].effect
            yield f"{effect.name[0].upper()}{effect.name[1:]}: {effect.changes}"
    if study.verification is not None:
        yield held_out_table(study.verification)
        if (flow_rates := flow_rate_table(study.verification)) is not None:
            yield flow_rates
    yield origin_words(study)
