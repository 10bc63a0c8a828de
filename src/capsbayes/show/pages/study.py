"""The page of a study: the verdict, the deviations, the candidates, and the held-out capsules."""

from __future__ import annotations

from typing import Any

import numpy as np

import capsbayes
from capsbayes.diagnosis import Comparison, Study, Verdict, Verification
from capsbayes.show.figures.study import candidate_ratios, misfits, moduli, trends
from capsbayes.show.figures.study_outlines import chosen_capsules, held_out, outline_finding
from capsbayes.show.pages.page import page, picture
from capsbayes.show.tables import study as tables
from capsbayes.show.tables.table import html_table, typeset
from capsbayes.show.words import study as words


def study_page(study: Study) -> str:
    """Return a study as HTML.

    Returns
    -------
    str
        A whole page; its pictures are SVG within it.
    """
    compared, verification = study.first_half, study.verification
    return page(
        "study.html",
        title="What the model misses",
        opening=[typeset(sentence) for sentence in words.opening(study)],
        left_out=study.session.left_out,
        none=study.verdict is Verdict.NONE,
        finding=_finding(study, compared) if compared is not None and study.finding.deviations else {},
        limits="" if (limits := tables.limits_table(study)) is None else html_table(limits),
        candidates=_candidates(study) if study.scores else {},
        held_out={} if verification is None else _held_out(study, verification),
        origin=f"{words.origin_words(study)} Made by capsbayes {capsbayes.__version__}. The numbers are in study.json.",
    )


def _finding(study: Study, compared: Comparison) -> dict[str, Any]:
    finding, along = study.finding, compared.along_outline
    largest = finding.deviations[0].name
    again = (
        {}
        if study.second_finding is None
        else {deviation.name: words.deviation_words(deviation) for deviation in study.second_finding.deviations}
    )
    of_outline = (
        f"Mean over {len(compared.edges)} capsules of the distance from the predicted to the measured edge, after each "
        "was given its best Ca and a/ℓ. In the boxes: how far out each region lies in all capsules alike, including "
        "what Ca and a/ℓ have absorbed of it, so it may exceed the distance that is left to see."
    )
    of_trends = typeset("Of a right model the apparent G_s is the same at every velocity and of every size.")
    of_misfits = typeset(
        "Misfit of each capsule over its degrees of freedom at its best Ca and a/ℓ: about 1 under a right model. "
        "Crosses are capsules without a shape of it."
    )
    shown = "apparent shear modulus against velocity and size"
    return {
        "largest": typeset(largest),
        "p_value": words.largest_p_value(finding),
        "again": "" if study.second_finding is None else typeset(again.get(largest, "not there")),
        "outline": ""
        if along is None
        else picture(outline_finding(along, finding), "mean residual along the outline", of_outline),
        "trends": picture(trends(compared, finding), shown, of_trends),
        "misfits": picture(misfits(compared), "misfit of each capsule over Ca and a/l", of_misfits)
        if np.isfinite(compared.misfit).any()
        else "",
        "table": html_table(tables.finding_table(finding)),
        "capsules": finding.capsules,
        "level": f"{100.0 * study.level:g}",
    }


def _candidates(study: Study) -> dict[str, Any]:
    unknown = "those likelier than no effect" if study.by_all else "the nearest, which fail"
    those = unknown if study.verdict is Verdict.UNKNOWN else "the effects in question"
    caption = f"In a dark colour: {those}. A log-likelihood ratio of 3 is the least that counts."
    return {
        "figure": picture(candidate_ratios(study), "log-likelihood ratio of each candidate", caption),
        "table": html_table(tables.candidate_table(study)),
        "caveats": [typeset(sentence) for sentence in words.caveats(study)],
        "meaning": html_table(tables.meaning_table(study)),
    }


def _held_out(study: Study, verification: Verification) -> dict[str, Any]:
    of_outlines = (
        "Above: a small, a middling and a large capsule, measured and predicted. Middle: distance of the measured edge "
        "from the predicted one, positive outside. Below: the same, mean of all held-out capsules."
    )
    of_moduli = "Each held-out capsule with its standard error, without that of the viscosity, which all of them share."
    shown = "measured and predicted outlines before and after"
    flow_rates = tables.flow_rate_table(verification)
    return {
        "effects": " and ".join(step.best.effect.name for step in study.steps if step.in_question),
        "outlines": picture(held_out(verification), shown, of_outlines) if chosen_capsules(verification) else "",
        "table": html_table(tables.held_out_table(verification)),
        "moduli": picture(moduli(verification), "shear moduli before and after", of_moduli),
        "flow_rates": "" if flow_rates is None else html_table(flow_rates),
    }
