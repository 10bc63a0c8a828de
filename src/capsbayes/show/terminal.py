"""Results on the terminal: the same sentences and tables as on their pages."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from capsbayes.diagnosis import Study
from capsbayes.infer import Posterior
from capsbayes.infer.many import Hierarchy, Population
from capsbayes.infer.many.one_membrane.shared_membrane import SharedMembrane
from capsbayes.plan import MembraneFlowDesign
from capsbayes.show.tables import membrane as of_membrane
from capsbayes.show.tables import membrane_plan as of_membrane_plan
from capsbayes.show.tables import population as of_population
from capsbayes.show.tables import posterior as of_posterior
from capsbayes.show.tables import study as of_study
from capsbayes.show.tables.table import Strong
from capsbayes.show.words import membrane as membrane_words
from capsbayes.show.words import membrane_plan as membrane_plan_words
from capsbayes.show.words import population as population_words
from capsbayes.show.words import posterior as posterior_words
from capsbayes.show.words import study as study_words

Parts = Iterator[str | pd.DataFrame]


def posterior_parts(posterior: Posterior) -> Parts:
    """Yield what is printed of a posterior."""
    yield of_posterior.quantity_table(posterior)
    yield posterior_words.agreement_words(posterior)
    yield of_posterior.budget_table(posterior)
    yield posterior_words.budget_sentence(posterior)
    if posterior.expected_log_modulus_sds:
        yield of_posterior.narrowing_table(posterior)
    yield of_posterior.input_table(posterior)
    yield of_posterior.prior_table(posterior)
    yield from posterior_words.caveats(posterior)


def population_parts(population: Population) -> Parts:
    """Yield what is printed of many capsules."""
    yield Strong(population_words.headline(population))
    yield population_words.width_words(population)
    yield population_words.status_words(population)
    yield of_population.status_table(population.counts)
    yield of_population.summary_table(population)


def hierarchy_parts(hierarchy: Hierarchy) -> Parts:
    """Yield what is printed of the population that the capsules come from."""
    stored = hierarchy.as_dict()
    yield of_population.hierarchy_table(stored)
    yield population_words.spread_words(stored)
    yield population_words.shared_words(stored)
    yield population_words.missing_words(stored)
    yield from population_words.caveats(stored)


def membrane_parts(shared: SharedMembrane) -> Parts:
    """Yield what is printed of the membrane that a batch shares."""
    yield of_membrane.membrane_table(shared)
    yield membrane_words.told_words(shared)
    if len(shared.laws) > 1:
        yield of_membrane.law_table(shared)
        yield Strong(membrane_words.law_words(shared))
    if shared.flow.max() > 0:
        yield of_membrane.flow_table(shared)
    yield from membrane_words.caveats(shared)


def membrane_flow_parts(design: MembraneFlowDesign) -> Parts:
    """Yield what is printed of the flow rates at which a batch is to be filmed."""
    if design.sets:
        yield of_membrane_plan.membrane_flow_table(design)
    yield from membrane_plan_words.flow_words(design)


def study_parts(study: Study) -> Parts:
    """Yield what is printed of a study."""
    verdict, *further = study_words.opening(study)
    yield from (Strong(verdict), *further)
    left_out = study.session.left_out
    yield "\n  ".join([f"{len(left_out)} capsules were left out:", *left_out]) if left_out else ""
    if study.finding.deviations:
        yield of_study.finding_table(study.finding)
    if study.scores:
        yield of_study.candidate_table(study)
        yield from study_words.caveats(study)
        yield of_study.meaning_table(study)
    if study.verification is not None:
        yield of_study.held_out_table(study.verification)
        flow_rates = of_study.flow_rate_table(study.verification)
        yield "" if flow_rates is None else flow_rates
    yield study_words.origin_words(study)
