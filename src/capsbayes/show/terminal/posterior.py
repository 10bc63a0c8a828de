"""What is printed of one capsule."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from capsbayes.infer import Posterior
from capsbayes.show.tables import posterior as of_posterior
from capsbayes.show.words import posterior as posterior_words

Parts = Iterator[str | pd.DataFrame]


def posterior_parts(posterior: Posterior) -> Parts:
    """Yield what is printed of a posterior."""
    yield of_posterior.quantity_table(posterior)
    yield posterior_words.agreement_words(posterior)
    budget = of_posterior.budget_table(posterior)
    yield "" if budget is None else budget
    yield posterior_words.budget_sentence(posterior)
    if posterior.expected_log_modulus_sds:
        yield of_posterior.narrowing_table(posterior)
    yield of_posterior.input_table(posterior)
    yield of_posterior.prior_table(posterior)
    yield from posterior_words.caveats(posterior)
