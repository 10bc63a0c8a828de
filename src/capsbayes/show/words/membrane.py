"""Sentences about the membrane that a batch shares."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from capsbayes.infer.shared_membrane import SharedMembrane
from capsbayes.parameters import PARAMETERS
from capsbayes.show.words.posterior import BY_MESH
from capsbayes.show.words.rounding import per_cent

_KEPT = 0.9  # width over that of the prior, above which a parameter kept its prior
_STRONG, _SOME = 20.0, 3.0  # odds


def told_words(shared: SharedMembrane) -> str:
    """Say which parameters of the membrane the batch tells, and which kept their prior."""
    widths = shared.widths_over_prior()
    kept = [PARAMETERS[name].symbol for name, width in widths.items() if width > _KEPT]
    told = [PARAMETERS[name].symbol for name, width in widths.items() if width <= _KEPT]
    parts = [f"The capsules tell {', '.join(told)}." if told else "The capsules tell nothing of the membrane."]
    if kept:
        parts.append(f"{', '.join(kept)} kept {'its prior' if len(kept) == 1 else 'their priors'}.")
    return " ".join(parts)


def law_words(shared: SharedMembrane) -> str:
    """Say which law the membrane obeys, with the odds against the next; empty if laws were not compared."""
    if len(shared.laws) < 2:
        return ""
    first, second = sorted(shared.laws, key=lambda law: -law.probability)[:2]
    odds = first.probability / max(second.probability, 1e-300)
    shown = "more than 1000" if odds > 1000.0 else f"{odds:.2g}"
    name = "a law between or beyond the known ones" if first is shared.laws[0] else f"the {first.name} law"
    against = "a general law" if second is shared.laws[0] else f"the {second.name} law"
    if odds > _STRONG:
        return f"The membrane obeys {name}: {shown} to 1 against {against}."
    if odds > _SOME:
        return f"The membrane rather obeys {name}, {shown} to 1 against {against}; more flow rates would tell."
    return f"The capsules do not tell the law: {name} against {against} stands {shown} to 1."


def caveats(shared: SharedMembrane) -> Iterator[str]:
    """Yield what a reader must keep in mind."""
    yield BY_MESH
    for gate in shared.gates:
        if not gate.passed:
            yield f"Check failed: {gate}."
    unusable = [law.name for law in shared.laws if not law.usable]
    if unusable:
        yield f"Checks of the computation failed under: {', '.join(unusable)}; its row is rough."
    odd = np.flatnonzero(shared.misfit > 2.0)
    if len(odd):
        names = ", ".join(shared.names[number] for number in odd[:5])
        more = "" if len(odd) <= 5 else f" and {len(odd) - 5} more"
        yield f"Shapes that differ by more than twice their errors: {names}{more}."
    if shared.flow.max() == 0:
        yield "All capsules were filmed in one flow; several flow rates tell the membrane much better."
    share = float(np.mean(shared.misfit > 2.0))
    if share > 0.1:
        yield f"That is {per_cent(share)} of the capsules: their errors may be understated."
