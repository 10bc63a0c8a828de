"""What is printed of a study."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from capsbayes.diagnosis import Study
from capsbayes.show.tables import study as of_study
from capsbayes.show.tables.table import Strong
from capsbayes.show.words import study as study_words

Parts = Iterator[str | pd.DataFrame]


def study_parts(study: Study) -> Parts:
    """Yield what is printed of a study."""
    verdict, *further = study_words.opening(study)
    yield from (Strong(verdict), *further)
    left_out = study.session.left_out
    yield "\n  ".join([f"{len(left_out)} capsules were left out:", *left_out]) if left_out else ""
    if study.finding.deviations:
        yield of_study.finding_table(study.finding)
    limits = of_study.limits_table(study)
    yield "" if limits is None else limits
    if study.scores:
        likeliest, rest = of_study.likeliest_table(study)
        yield likeliest
        yield study_words.less_likely_words(rest)
        yield from study_words.caveats(study)
        yield from study_words.meaning_words(study)
    if study.verification is not None:
        yield of_study.held_out_table(study.verification)
        flow_rates = of_study.flow_rate_table(study.verification)
        yield "" if flow_rates is None else flow_rates
    yield study_words.origin_words(study)
