"""What is printed of the membrane that a batch shares, and a plan to find it."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from capsbayes.infer.shared_membrane import SharedMembrane
from capsbayes.plan import MembraneFlowDesign
from capsbayes.show.tables import membrane as of_membrane
from capsbayes.show.tables import membrane_plan as of_membrane_plan
from capsbayes.show.tables.table import Strong
from capsbayes.show.words import membrane as membrane_words
from capsbayes.show.words import membrane_plan as membrane_plan_words

Parts = Iterator[str | pd.DataFrame]


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
