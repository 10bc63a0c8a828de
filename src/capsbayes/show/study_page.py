"""The page of a study: one HTML file that holds its pictures and needs nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from markupsafe import Markup

import capsbayes
from capsbayes.diagnosis import Study, Verdict, Verification
from capsbayes.show.page import page, picture, typeset
from capsbayes.show.study_candidates import candidate_ratios
from capsbayes.show.study_held_out import chosen_capsules, held_out
from capsbayes.show.study_moduli import moduli
from capsbayes.show.study_outline import outline_finding
from capsbayes.show.study_tables import (
    candidate_table,
    finding_table,
    flow_rate_table,
    held_out_table,
    meaning_table,
)
from capsbayes.show.study_trends import trends
from capsbayes.show.study_words import (
    deviation_words,
    lengths_alone,
    modulus_words,
    same_by_chance,
    verdict_sentence,
)

__all__ = ["study_page"]


def study_page(study: Study) -> str:
    """Write a study as HTML.

    Parameters
    ----------
    study : Study

    Returns
    -------
    str
        A whole page; its pictures are SVG within it.
    """
    parts = [*_top(study), *_finding(study), *_candidates(study)]
    if study.verification is not None:
        parts += _held_out(study, study.verification)
    parts += _origin(study)
    return page("page.html", title="What the model misses", body=Markup("\n".join(parts)))


def _top(study: Study) -> Iterator[str]:
    yield "<h1>What the model misses</h1>"
    yield f'<p class="verdict">{typeset(verdict_sentence(study))}</p>'
    for words in (modulus_words(study), lengths_alone(study.session)):
        if words:
            yield f"<p>{typeset(words)}</p>"
    if study.session.left_out:
        lines = "".join(f"<li>{escape(line)}</li>" for line in study.session.left_out)
        yield f'<p>{len(study.session.left_out)} capsules were left out:</p><ul class="note">{lines}</ul>'


def _finding(study: Study) -> Iterator[str]:
    finding, compared = study.finding, study.first_half
    if compared is None or not finding.deviations:
        return
    none = study.verdict is Verdict.NONE
    yield f"<h2>{'How the capsules compare with it' if none else 'Where the capsules disagree with it'}</h2>"
    if none:
        yield (
            f"<p>The largest deviation ({typeset(finding.deviations[0].name)}) would be as large by chance in "
            f"{same_by_chance(finding)} of such sessions. What is smaller than the errors below was not seen.</p>"
        )
    if study.second_finding is not None:
        there = {one.name: deviation_words(one) for one in study.second_finding.deviations}
        name = finding.deviations[0].name
        yield f"<p>In the held-out capsules it is {typeset(there.get(name, 'not there'))}.</p>"
    along = compared.along_outline
    if along is not None:
        caption = (
            f"Mean over {len(compared.edges)} capsules of the distance from the predicted to the measured edge, after "
            "each was given its best Ca and a/ℓ. In the boxes: how far out each region lies in all capsules alike, "
            "counting what Ca and a/ℓ have taken up of it, so it may exceed the distance that is left to see."
        )
        yield picture(outline_finding(along, finding), "mean residual along the outline", caption)
    caption = typeset("Of a right model the apparent G_s is the same at every velocity and of every size.")
    yield picture(trends(compared, finding), "apparent shear modulus against velocity and size", caption)
    yield finding_table(finding)
    yield (
        f'<p class="note">In {finding.capsules} capsules. The significance is that of the scatter from capsule to '
        "capsule, not of the stated noise. By chance: how often a right model shows a deviation as large in any row "
        f"of the table; a disagreement is claimed below {100.0 * study.level:g} %.</p>"
    )


def _candidates(study: Study) -> Iterator[str]:
    if not study.scores:
        return
    yield "<h2>What would explain it</h2>"
    those = "the nearest, which fail" if study.verdict is Verdict.UNKNOWN else "the effects in question"
    caption = f"In a dark colour: {those}. A ratio of 3 is the least that counts."
    yield picture(candidate_ratios(study), "log-likelihood ratio of each candidate", caption)
    yield candidate_table(study)
    yield (
        '<p class="note">Odds are ratios of likelihoods, averaged over what was held possible of the size of each '
        "effect, before any belief about which is the more common. They trust the stated noise; an effect is told "
        "apart only if its lag behind the best also stands out from the scatter between the capsules. The size of an "
        "effect that was hardly seen is overestimated, near the threshold by some 40 %, because only sizes that look "
        "large are seen at all.</p>"
    )
    if len(study.steps) > 1:
        yield (
            '<p class="note">Of effects that are added together, size, log-likelihood ratio and G<sub>s</sub> are '
            "those with the other, the odds those of each alone.</p>"
        )
    if study.verdict is Verdict.AMBIGUOUS:
        best = next((step for step in study.steps if len(step.in_question) > 1), study.steps[0]).best.effect
        yield (
            "<p>These data do not tell the effects in question apart. "
            f"What would: {typeset(best.separated_by[0].lower() + best.separated_by[1:])}</p>"
        )
    yield meaning_table(study)


def _held_out(study: Study, verification: Verification) -> Iterator[str]:
    best = " and ".join(step.best.effect.name for step in study.steps if step.in_question)
    yield "<h2>Does it hold on capsules that were held out?</h2>"
    yield (
        f"<p>The size of {escape(best)} was found on one half of the capsules. Here is the other half, which had no "
        "part in it, under the model before and after it is added.</p>"
    )
    if chosen_capsules(verification):
        caption = (
            "Above: a small, a middling and a large capsule, measured and predicted. Middle: distance of the measured "
            "edge from the predicted one, positive outside. Below: the same, mean of all held-out capsules."
        )
        yield picture(held_out(verification), "measured and predicted outlines before and after", caption)
    yield held_out_table(verification)
    caption = "Each held-out capsule with its standard error, without that of the viscosity, which all of them share."
    yield picture(moduli(verification), "shear moduli before and after", caption)
    at_flow_rates = flow_rate_table(verification)
    if at_flow_rates is not None:
        yield "<p>A membrane has one shear modulus: with the right model it is the same at every flow rate.</p>"
        yield at_flow_rates


def _origin(study: Study) -> Iterator[str]:
    model = study.tested_model
    outlines = sum(one.outline is not None for one in study.session.measurements)
    yield (
        f'<p class="note">{len(study.session)} capsules, {outlines} with an outline; model {escape(model.name)}, '
        f"sha256 {model.sha256[:12]}; seed {study.seed}; capsbayes {capsbayes.__version__}. The numbers are in "
        "study.json.</p>"
    )
