"""The page of one capsule's posterior."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from markupsafe import Markup

from capsbayes.inference import Posterior
from capsbayes.report.corner_plot import SHOWN, corner_plot
from capsbayes.report.outline_plot import outline_figure
from capsbayes.report.page import image, page, picture, typeset
from capsbayes.report.picture_plot import picture_figure
from capsbayes.report.posterior_tables import (
    budget_table,
    gate_table,
    input_table,
    origin_table,
    prior_table,
    quantity_table,
)
from capsbayes.report.posterior_words import budget_sentence, status_words, warnings_of
from capsbayes.report.rounding import value_words

__all__ = ["PICTURES", "posterior_page"]

PICTURES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".tif": "", ".tiff": ""}
"""Endings of pictures; browsers do not show those of no kind."""

_WIDTH = 6.2  # inch: small enough for its letters to be read on a phone

OVERLAY = "overlay.png"
"""What `capsbayes measure` and `identify` draw over a picture, in the folder of their results."""


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
        pictures=[*_pictures(posterior, capsule, folder), *_outline(posterior)],
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


def _outline(posterior: Posterior) -> Iterator[Markup]:
    if posterior.outlines is not None:
        caption = "Predicted outline with its 95 % band between the walls of the channel, and the measured lengths."
        alternative = "predicted outline and measured lengths in the channel"
        yield picture(outline_figure(posterior), alternative, caption, fit="narrow")


def _pictures(posterior: Posterior, capsule: str | Path | None, folder: Path | None) -> Iterator[Markup]:
    """The predicted outline over the picture; where that cannot be drawn, what was drawn when it was measured."""
    known = _measured_in(posterior) if capsule is None else Path(capsule)
    if known is not None:
        figure = picture_figure(posterior, known, width=_WIDTH)
        if figure is not None:
            caption = f"{known.name}: the measured edge, and the predicted outline laid nose on nose."
            alternative = "picture of the capsule with measured and predicted outline"
            yield picture(figure, alternative, caption, png=True, fit="narrow")
            return
    beside = Path(posterior.measurement.source).parent if posterior.measurement.source else None
    for place in (folder, beside):
        if place is not None and (place / OVERLAY).is_file():
            caption = "What was found in the picture: walls blue, edge red, length along the flow violet."
            alternative = "picture of the capsule with what was found in it"
            yield image((place / OVERLAY).read_bytes(), "png", alternative, caption, fit="narrow")
            return
    if capsule is not None and PICTURES.get(Path(capsule).suffix.lower()):
        kind = PICTURES[Path(capsule).suffix.lower()]
        caption = f"{Path(capsule).name}; no single capsule between two walls was found in it again."
        yield image(Path(capsule).read_bytes(), kind, "picture of the capsule", caption, fit="narrow")


def _measured_in(posterior: Posterior) -> Path | None:
    """The picture that the capsule was measured in, if it is still there unchanged."""
    source = Path(posterior.measurement.source)
    if source.suffix.lower() not in PICTURES or not source.is_file():
        return None
    same = hashlib.sha256(source.read_bytes()).hexdigest() == posterior.measurement.sha256
    return source if same else None
