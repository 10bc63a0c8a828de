"""The page of one capsule's posterior."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from markupsafe import Markup

from capsbayes.files.input_file import PICTURES
from capsbayes.infer import Posterior
from capsbayes.show.figures.corner import SHOWN, corner_plot
from capsbayes.show.figures.outline import outline_figure
from capsbayes.show.figures.picture import bare_figure, picture_figure
from capsbayes.show.pages.page import image, page, picture
from capsbayes.show.tables import posterior as tables
from capsbayes.show.tables.table import html_table, typeset
from capsbayes.show.words import posterior as words
from capsbayes.show.words.rounding import value_words

_OVERLAY = "overlay.png"  # as capsbayes measure and identify name it
_WIDTH = 6.2  # inch: small enough for its letters to be read on a phone


def posterior_page(posterior: Posterior, *, capsule: str | Path | None = None, folder: Path | None = None) -> str:
    """Return a posterior as a whole page in HTML, with the pictures of `capsule_pictures` within it."""
    shown = [typeset(value_words(name, posterior.marginals[name])) for name in SHOWN if name in posterior.marginals]
    names = (*SHOWN, *posterior.prior.uncertain)
    caption = "Every pair: contours hold 68 % and 95 % of the probability. Each alone: median and 68 % interval."
    source = posterior.measurement.source
    name = Path(source).name if source else "without a name"
    return page(
        "posterior.html",
        title=f"Capsule {name}",
        name=name,
        headlines=shown,
        status=words.status_words(posterior),
        ok=posterior.status.ok,
        caveats=[typeset(sentence) for sentence in words.caveats(posterior)],
        pictures=list(capsule_pictures(posterior, capsule, folder)),
        quantities=html_table(tables.quantity_table(posterior)),
        agreement=words.agreement_words(posterior),
        deterministic=posterior.deterministic is not None,
        corner=picture(corner_plot(posterior, names), "corner plot of the posterior", caption, fit="scroll"),
        budget_sentence=typeset(words.budget_sentence(posterior)),
        budget="" if (budget := tables.budget_table(posterior)) is None else html_table(budget),
        modulus=typeset("G_s"),
        narrowing=html_table(tables.narrowing_table(posterior)) if posterior.expected_log_modulus_sds else "",
        inputs=html_table(tables.input_table(posterior)),
        priors=html_table(tables.prior_table(posterior)),
        gates=html_table(tables.check_table(posterior)),
        origin=html_table(tables.origin_table(posterior)),
    )


def capsule_pictures(
    posterior: Posterior, capsule: str | Path | None = None, folder: Path | None = None
) -> Iterator[Markup]:
    """Yield the pictures of a capsule, as many as there are.

    The photograph is by default that of the measurement, if it is still there unchanged; the folder is that with the
    ``overlay.png`` that was drawn when the capsule was measured, if there is one. Where the walls were stated by hand,
    only that shows them.
    """
    yield from _photograph(posterior, capsule, folder)
    if posterior.outlines is not None:
        caption = "Predicted outline with its 95 % band between the walls of the channel, and the measured lengths."
        alternative = "predicted outline and measured lengths in the channel"
        yield picture(outline_figure(posterior), alternative, caption, fit="narrow")


def _photograph(posterior: Posterior, capsule: str | Path | None, folder: Path | None) -> Iterator[Markup]:
    """The predicted outline over the picture; where that cannot be drawn, what was drawn when it was measured."""
    if posterior.measurement.walls:  # they would be sought in the picture again, and others found
        yield from _overlay(posterior, folder)
        return
    known = _measured_in(posterior) if capsule is None else Path(capsule)
    figure = None if known is None else picture_figure(posterior, known, width=_WIDTH)
    if known is not None and figure is not None:
        caption = f"{known.name}: the measured edge, and the predicted outline laid nose on nose."
        alternative = "picture of the capsule with measured and predicted outline"
        yield picture(figure, alternative, caption, png=True, fit="narrow")
    elif capsule is not None:
        caption = f"{Path(capsule).name}: no single capsule between two walls was found in it again."
        yield picture(bare_figure(capsule, width=_WIDTH), "picture of the capsule", caption, png=True, fit="narrow")
    else:
        yield from _overlay(posterior, folder)


def _overlay(posterior: Posterior, folder: Path | None) -> Iterator[Markup]:
    """The picture with the detected capsule, from the folder of the result or of the measurement."""
    source = posterior.measurement.source
    folders = [place for place in (folder, Path(source).parent if source else None) if place is not None]
    for place in filter(Path.is_file, (place / _OVERLAY for place in folders)):
        caption = "What was found in the picture: walls blue, edge red, length along the flow violet."
        if posterior.measurement.walls:
            caption += " Dashed walls and a dotted axis were stated by hand."
        alternative = "picture of the capsule with what was found in it"
        yield image(place.read_bytes(), "png", alternative, caption, fit="narrow")
        return


def _measured_in(posterior: Posterior) -> Path | None:
    """The picture that the capsule was measured in, if it is still there unchanged."""
    source = Path(posterior.measurement.source)
    if source.suffix.lower() not in PICTURES or not source.is_file():
        return None
    same = hashlib.sha256(source.read_bytes()).hexdigest() == posterior.measurement.sha256
    return source if same else None
