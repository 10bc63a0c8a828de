"""Sentences and tables of a study, on the terminal as on its page: verdict, deviations, candidates, held-out ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
import pandas as pd

from capsbayes.diagnosis import NOTHING, UNKNOWN, Deviation, Finding, Scores, Study, Verdict, Verification
from capsbayes.diagnosis.finding import TRENDS
from capsbayes.effects import Simulated
from capsbayes.parameters import PARAMETERS
from capsbayes.report.numbers import counted, unit_of, with_unit
from capsbayes.report.tables import Strong, Symbols, table

ALONE = {NOTHING: "no effect", UNKNOWN: "something else"}
"""Explanations that are no effects of the catalogue."""

_MODULUS = PARAMETERS["surface_shear_modulus"]
_SHOWN = 5  # effects on the terminal at least; a page has all of them
_NOISIER = 1.1  # noise over the stated one, from which it is said
_FEW_WRONG = 0.0095  # share of wrong names below which it is not told
_NOT_KNOWN = 0.5  # probability of something else from which G_s is not to be used
_LEAST_SHARE = 0.01  # per cent, below which a p-value is not told
_MANY = 1e3  # odds beyond which no number is trusted: it would be that of the tails of the stated noise


def opening(study: Study) -> list[str]:
    """Return the sentences that a study begins with: verdict, probabilities, range of G_s, and what the data lack."""
    further = (_rates, _limits, _probabilities, _modulus_found, _noise, _lacking)
    return [verdict_sentence(study), *(sentence for words in further for sentence in words(study))]


def verdict_sentence(study: Study) -> str:
    """Return the verdict of a study in one sentence."""
    model = study.tested_model.name
    if study.verdict is Verdict.NOT_TESTABLE:
        few = counted(len(study.session), "capsule", "is", "are")
        return f"These data cannot tell: {few} too few to compare with {model}."
    if study.verdict is Verdict.NONE:
        return f"No disagreement was found between the capsules and {model}."
    disagree = f"The capsules disagree with {model}, and"
    if study.verdict is Verdict.NAMED:
        named = list(study.scores_of(study.in_question[0]))
        return f"{disagree} {_explanation(named)}: {'; '.join(map(size_words, named))}."
    if study.verdict is Verdict.AMBIGUOUS:
        alike = [_together(study, names) for names in study.in_question]
        alike += [ALONE[UNKNOWN]] * study.something_else
        return f"{disagree} more than one explanation is possible: {_listed(alike)}."
    if not study.candidates:
        return f"{disagree} no effect was tried."
    nearest = f"; {_together(study, study.names)} comes nearest" if study.names else ""
    return f"{disagree} nothing that was tried explains it{nearest}."


def _rates(study: Study) -> Iterator[str]:
    """Say how often a name is wrong in sessions like this one, and how often it is given."""
    rates = study.calibration
    if rates is not None and math.isfinite(rates.wrong):
        wrong = "less than 1" if rates.wrong < _FEW_WRONG else f"{100.0 * rates.wrong:.1g}"
        yield (
            f"An effect as visible that is not tried gets a name, a wrong one, in {wrong} % of sessions like this one; "
            f"of those that are tried, {100.0 * rates.power:.0f} % get theirs."
        )


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
    """Say the probabilities of the likeliest explanation, of something else, and of nothing, if any were compared."""
    known = study.probabilities
    if known:
        best = next((name for name in known if name not in ALONE), None)
        words = [] if best is None else [f"{_together(study, best.split(' and '))} {probability_words(known[best])}"]
        words += [f"{ALONE[other]} {probability_words(known[other])}" for other in (UNKNOWN, NOTHING)]
        yield f"Probabilities: {', '.join(words)}."


def _together(study: Study, names: Iterable[str], word: str = " with ") -> str:
    """Name the effects of an explanation, given by the names of their parameters."""
    return word.join(study.candidates[name].name for name in names)


def _modulus_found(study: Study) -> Iterator[str]:
    """Say the median G_s of the session with its interval, and whether one G_s holds in all circumstances."""
    modulus = study.surface_shear_modulus
    if math.isfinite(modulus.median):
        median, low, high = (_MODULUS.shown(value) for value in (modulus.median, modulus.low, modulus.high))
        if study.probabilities.get(UNKNOWN, 0.0) > _NOT_KNOWN:
            yield (
                "G_s is not known while what is missing is not: measure what would distinguish the explanations first. "
                f"Until then its median may lie anywhere from {low:.3g} to {high:.3g}{unit_of(_MODULUS)} (95 %)."
            )
        else:
            interval = f"{median:.3g}{unit_of(_MODULUS)} (95 %: {low:.3g} to {high:.3g})"
            yield (
                f"Median G_s of the session: {interval}, averaged over all explanations, with the uncertainty of their "
                "sizes and of the viscosity."
            )
    p_value = study.finding.one_modulus
    if math.isfinite(p_value):
        varied = any(deviation.name == TRENDS["viscosity"] for deviation in study.finding.deviations)
        where = "velocity, size and viscosity" if varied else "velocity and size"
        words = "is not the same" if p_value < study.level else "may be the same"
        yield f"The apparent G_s {words} at every {where}: p-value {p_value_words(p_value)}."


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


def _lacking(study: Study) -> Iterator[str]:
    """Name the capsules without a shape of the model; say what missing outlines cost, and what cannot be shown."""
    outliers = () if study.comparison is None else study.comparison.outliers
    if outliers:
        names = ", ".join(outliers)
        count = counted(len(outliers), "capsule", "is", "are")
        yield f"{count} without a shape of {study.tested_model.name}, or far off: {names}."
    session = study.session
    without = sum(measured.outline is None for measured in session.measurements)
    if 0 < without < len(session):
        yield f"No outline is known of {without} of {len(session)} capsules: only the trends of G_s use them."
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
        "Probabilities are those before any belief about which effect is the more common; they trust the noise. The "
        "size of an effect that was hardly seen is overestimated, as only sizes that look large are seen at all."
    )
    if any(len(names) > 1 for names in study.in_question):
        yield "Of effects that act together, size, log-likelihood ratio and G_s are those with the other one present."
    after = None if study.verification is None else study.verification.comparisons[1]
    if after is not None and after.added_up:
        yield (
            f"At {after.added_up} of {len(after.session)} capsules the effects of the membrane are added up: "
            "these lie where no membranes with both were simulated. The sum is only roughly right."
        )
    if study.verdict is Verdict.AMBIGUOUS:
        best = study.candidates[study.in_question[0][-1]]
        yield (
            "These data do not distinguish the explanations in question. What would distinguish them: "
            f"{best.separated_by[0].lower()}{best.separated_by[1:]}"
        )


def origin_words(study: Study) -> str:
    """Say what the study was made of."""
    model = study.tested_model
    outlines = sum(measured.outline is not None for measured in study.session.measurements)
    return (
        f"{counted(len(study.session), 'capsule')}, {outlines} with an outline; model {model.name}, "
        f"sha256 {model.sha256[:12]}; seed {study.seed}."
    )


def likeliest_words(study: Study) -> str:
    """Name the effects that are likeliest."""
    return _together(study, study.in_question[0], " and ")


def size_words(scores: Scores, share: str = "68 %: ") -> str:
    """Return the size of an effect with its symbol, 68 % interval and unit; `share` introduces the interval."""
    parameter = scores.effect.parameter
    low, high = map(parameter.shown, scores.interval())
    unit = unit_of(parameter)
    return f"{parameter.symbol} = {parameter.shown(scores.size):.3g}{unit} ({share}{low:.3g} to {high:.3g}{unit})"


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
    if share < _LEAST_SHARE:
        return f"< {_LEAST_SHARE:g} %"
    return f"{share:.0f} %" if share >= 9.5 else f"{share:.2g} %"


def finding_table(finding: Finding) -> pd.DataFrame:
    """Return every deviation that was tested, the most surprising first."""
    rows = [(Symbols(each.name), deviation_words(each), p_value_words(each.p_value)) for each in finding.deviations]
    title = f"Deviations of {counted(finding.capsules, 'capsule')} from the model"
    return table(("where", "size ± standard error (significance)", "p-value"), rows, title=title)


def explanation_table(study: Study, *, every: bool = True) -> tuple[pd.DataFrame, list[str]]:
    """Return probability, size and G_s of explanations, every one or the likeliest; and the names of the rest."""
    effects = [name for name in study.probabilities if name not in ALONE]
    unseen = [name for name in study.scores if name not in study.probabilities]
    wanted = {*effects[: None if every else _SHOWN], *(" and ".join(names) for names in study.in_question)}
    rows: list[tuple[str | Symbols, ...]] = []
    for name, probability in study.probabilities.items():
        if name in ALONE:
            rows.append((ALONE[name], probability_words(probability), "", ""))
        elif name in wanted:
            scores = study.scores_of(tuple(name.split(" and ")))
            rows.append((_named(study, name), probability_words(probability), *_explained(scores)))
    rows += [(_named(study, name), "cannot be tested", *_explained((study.scores[name],))) for name in unseen if every]
    further = () if every else (name.split(" and ") for name in (*effects, *unseen) if name not in wanted)
    rest = [_together(study, names) for names in further]
    head = ("effect", "probability", "size (68 %)", Symbols(f"median G_s,{unit_of(_MODULUS)}"))
    title = "The likeliest of the explanations that were tried" if rest else "Explanations that were tried"
    return table(head, rows, title=title, numbers=(3,)), rest


def _explained(scores: tuple[Scores, ...]) -> tuple[str, str]:
    """Return the sizes of effects that act together, and the median G_s with them."""
    modulus = _MODULUS.shown(float(scores[-1].modulus[scores[-1].best]))
    return Symbols("; ".join(size_words(each, "") for each in scores)), _finite(modulus, ".1f", "", "no such shape")


def meaning_table(study: Study) -> pd.DataFrame:
    """Return what each candidate does, and what would distinguish it from the others."""
    rows = []
    for name, effect in ((name, scores.effect) for name, scores in study.scores.items()):
        words = Strong(effect.name) if name in study.names else effect.name
        rows.append((words, effect.kind.value, Symbols(effect.changes), Symbols(effect.separated_by)))
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
        ("p-value of scores as clear by chance (ranks)", "", p_value_words(verification.p_value)),
        (Symbols("median G_s"), _modulus(before), f"{_modulus(after)} ({100.0 * (after / before - 1.0):+.1f} %)"),
    ]
    title = "Capsules predicted with the size that the other half tells"
    return table((counted(len(ratios), "capsule"), "before", "after"), rows, title=title)


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


def flow_rate_table(study: Study) -> pd.DataFrame | None:
    """Return the median G_s at each flow rate, and after effects are added; None where flow rates are not known."""
    compared = (study.comparison,) if study.verification is None else study.verification.comparisons
    medians = [each.modulus_at_flow_rates for each in compared if each is not None]
    if not medians or not medians[0]:
        return None
    rows = [
        (with_unit("flow_rate", rate), str(count), *(_modulus(each[rate][1]) for each in medians))
        for rate, (count, _) in medians[0].items()
    ]
    columns = (Symbols("median G_s"),) if len(medians) == 1 else (Symbols("median G_s before"), "after")
    head = ("flow rate", "capsules", *columns)
    return table(head, rows, title="Capsules by flow rate", numbers=range(1, len(head)))


def _finite(value: float, digits: str, unit: str, otherwise: str) -> str:
    return f"{value:{digits}}{unit}" if math.isfinite(value) else otherwise


def _modulus(value: float) -> str:
    return with_unit(_MODULUS.name, value, ".1f") or "no such shape"


def _named(study: Study, names: str) -> str:
    """Name the effects of an explanation, in bold if it is in question."""
    words = _together(study, parameters := tuple(names.split(" and ")))
    return Strong(words) if parameters in study.in_question else words


def study_parts(study: Study) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of a study."""
    verdict, *further = opening(study)
    yield from (Strong(verdict), *further)
    left_out = study.session.left_out
    if left_out:
        yield "\n  ".join([f"{counted(len(left_out), 'capsule', 'was', 'were')} left out:", *left_out])
    if study.finding.deviations:
        yield finding_table(study.finding)
    if (limits := limits_table(study)) is not None:
        yield limits
    if study.scores and study.verdict is not Verdict.NONE:
        likeliest, rest = explanation_table(study, every=False)
        yield likeliest
        if rest:
            yield f"Less likely: {', '.join(rest)}."
        yield from caveats(study)
        for name in study.names:
            effect = study.scores[name].effect
            yield f"{effect.name[0].upper()}{effect.name[1:]}: {effect.changes}"
    if study.verification is not None:
        yield held_out_table(study.verification)
    if (flow_rates := flow_rate_table(study)) is not None:
        yield flow_rates
    yield origin_words(study)
