"""The page of one capsule's posterior."""

from __future__ import annotations

from pathlib import Path

from capsbayes.infer import Posterior
from capsbayes.show.capsule_pictures import capsule_pictures
from capsbayes.show.corner_plot import SHOWN, corner_plot
from capsbayes.show.page import page, picture, typeset
from capsbayes.show.posterior_tables import (
    budget_table,
    gate_table,
    input_table,
    origin_table,
    prior_table,
    quantity_table,
)
from capsbayes.show.posterior_words import budget_sentence, status_words, warnings_of
from capsbayes.show.rounding import value_words

__all__ = ["posterior_page"]


def posterior_page(posterior: Posterior, *, capsule: str | Path | None = None, folder: Path | None = None) -> str:
    """Write a posterior as HTML.

    Parameters
    ----------
    posterior : Posterior
    capsule : path, optional
        Picture of the capsule; by default the one it was measured in, if that is still there.
    folder : Path, optional
        Where its files lie, for the picture that was drawn when the capsule was measured.

    Returns
    -------
    str
        A whole page; its pictures are within it.
    """
    shown = [typeset(value_words(name, posterior.marginals[name])) for name in SHOWN if name in posterior.marginals]
    names = (*SHOWN, *posterior.prior.coordinates)
    caption = "Every pair: contours hold 68 % and 95 % of the probability. Each alone: median and 68 % interval."
    return page(
        "posterior.html",
        title=f"Capsule {_name(posterior)}",
        name=_name(posterior),
        headlines=shown,
        status=status_words(posterior),
        ok=posterior.status.ok,
        warnings=[typeset(words) for words in warnings_of(posterior)],
        pictures=list(capsule_pictures(posterior, capsule, folder)),
        quantities=quantity_table(posterior),
        reference="" if posterior.agreement is None else str(posterior.agreement).capitalize(),
        deterministic=posterior.deterministic is not None,
        corner=picture(corner_plot(posterior, names), "corner plot of the posterior", caption, fit="scroll"),
        budget_sentence=typeset(budget_sentence(posterior)),
        budget=budget_table(posterior),
        modulus=typeset("G_s"),
        inputs=input_table(posterior),
        priors=prior_table(posterior),
        gates=gate_table(posterior),
        origin=origin_table(posterior),
    )


def _name(posterior: Posterior) -> str:
    return Path(posterior.measurement.source).name if posterior.measurement.source else "without a name"
