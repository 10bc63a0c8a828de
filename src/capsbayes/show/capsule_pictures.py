"""Pictures of a capsule for its page: the photograph with the outline over it, and the outline with its lengths."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from markupsafe import Markup

from capsbayes.infer import Posterior
from capsbayes.show.outline_plot import outline_figure
from capsbayes.show.page import image, picture
from capsbayes.show.picture_plot import bare_figure, picture_figure

__all__ = ["capsule_pictures"]

_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
_OVERLAY = "overlay.png"  # as capsbayes measure and identify name it
_WIDTH = 6.2  # inch: small enough for its letters to be read on a phone


def capsule_pictures(
    posterior: Posterior, capsule: str | Path | None = None, folder: Path | None = None
) -> Iterator[Markup]:
    """Pictures of a capsule, as many as there are.

    Parameters
    ----------
    posterior : Posterior
    capsule : path, optional
        Photograph; by default the one the capsule was measured in, if it is still there unchanged.
    folder : Path, optional
        Where ``overlay.png`` may lie, which was drawn when the capsule was measured.
    """
    yield from _photograph(posterior, capsule, folder)
    yield from _outline(posterior)


def _outline(posterior: Posterior) -> Iterator[Markup]:
    if posterior.outlines is not None:
        caption = "Predicted outline with its 95 % band between the walls of the channel, and the measured lengths."
        alternative = "predicted outline and measured lengths in the channel"
        yield picture(outline_figure(posterior), alternative, caption, fit="narrow")


def _photograph(posterior: Posterior, capsule: str | Path | None, folder: Path | None) -> Iterator[Markup]:
    """The predicted outline over the picture; where that cannot be drawn, what was drawn when it was measured."""
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
    """What was drawn over the picture when it was measured, in the folder of the result or beside the measurement."""
    source = posterior.measurement.source
    places = [one / _OVERLAY for one in (folder, Path(source).parent if source else None) if one is not None]
    for place in filter(Path.is_file, places):
        caption = "What was found in the picture: walls blue, edge red, length along the flow violet."
        alternative = "picture of the capsule with what was found in it"
        yield image(place.read_bytes(), "png", alternative, caption, fit="narrow")
        return


def _measured_in(posterior: Posterior) -> Path | None:
    """The picture that the capsule was measured in, if it is still there unchanged."""
    source = Path(posterior.measurement.source)
    if source.suffix.lower() not in _PICTURES or not source.is_file():
        return None
    same = hashlib.sha256(source.read_bytes()).hexdigest() == posterior.measurement.sha256
    return source if same else None
